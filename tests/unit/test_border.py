"""Cells at the border of a body: share, middle, pieces of surface, against closed forms."""

import numpy as np
import pytest

from pdpetsc.body.border import BORDER, SAMPLES, SMALLEST_SHARE, cut_cells


def cut_unit_box(inside, counts, size=None):
    """The cells of [0, 1]^dim, x fastest, and their `Cut`."""
    counts = np.array(counts)
    index = np.stack(np.unravel_index(np.arange(counts.prod()), counts, order="F"), axis=1)
    low, high = index / counts, (index + 1) / counts
    outermost = np.stack([index == 0, index == counts - 1], axis=-1)
    dim = len(counts)
    return low, cut_cells(lambda X, row: inside(*X.T), low, high, outermost, size or SAMPLES[dim])


def ball(dim, radius, outside=True):
    middle = (0.503, 0.497, 0.51)

    def inside(*X):
        near = sum((x - m) ** 2 for x, m in zip(X, middle)) < radius**2
        return ~near if outside else near

    return inside


def size_of(cut):
    """Total length of the area vectors of the border."""
    return np.linalg.norm(cut.area[cut.face == BORDER], axis=1).sum()


BALLS = {1: (0.23, 0.46, 2.0), 2: (0.21, np.pi * 0.21**2, 2 * np.pi * 0.21), 3: (0.3, 0.036 * np.pi, 0.36 * np.pi)}
"""Radius, volume, surface."""


@pytest.mark.parametrize("outside", (True, False))
@pytest.mark.parametrize("dim", (1, 2, 3))
def test_balls(dim, outside):
    """Volume and surface of a body with a round hole, and of a round body; slivers that are no particles are missing
    from the volume, not from the surface."""
    radius, volume, surface = BALLS[dim]
    volume = 1 - volume if outside else volume
    for n in (10, 20) if dim == 3 else (10, 20, 40, 80):
        _, cut = cut_unit_box(ball(dim, radius, outside), (n,) * dim)
        found = cut.share.sum() / n**dim
        cells = len(np.unique(cut.row))
        assert abs(found - volume) < (SMALLEST_SHARE / 4 if dim > 1 else 1 / SAMPLES[1]) * cells / n**dim
        # pieces are flat, and as exact as 1/64 or 1/16 of a cell: measured 1e-2 ... 1e-4 (2D), 2e-2 and 6e-3 (3D)
        assert size_of(cut) == pytest.approx(surface, rel={1: 1e-12, 2: 1.5 / n**2 + 2e-4, 3: 0.2 / n}[dim])


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_closed_surfaces(dim):
    """The area vectors of a closed surface add up to zero, those of the sides of the box included."""
    for inside, alone in (
        (ball(dim, 0.21), True),
        (ball(dim, 0.21, False), True),
        (lambda *X: (X[0] - 0.1) ** 2 + sum((x - 0.45) ** 2 for x in X[1:]) > 0.2**2, False),  # across a side
        (lambda *X: X[0] > 0.0004 + 0.37 * sum(X[1:]), False),
        (lambda *X: X[0] < 0.5001, False),  # slivers in a whole row of cells
    ):
        _, cut = cut_unit_box(inside, (20,) * dim)
        whole = np.zeros(dim)  # the sides of whole cells make no pieces
        full = cut.share.reshape((20,) * dim, order="F") == 1
        for k in range(dim):
            whole[k] = (full.take(-1, k).sum() - full.take(0, k).sum()) / 20 ** (dim - 1)
        total = cut.area.sum(axis=0) + (0 if alone else whole)
        assert (len(cut.row) > 0) and np.abs(total).max() < 1e-14
        if alone:
            assert np.all(cut.face == BORDER)


@pytest.mark.parametrize("normal", [(1.0, 0.37), (-0.2, 1.0), (1.0, 1.0)])
def test_slanted_half_planes(normal):
    """Share and centroid of each cell of a lattice, in a first order of the distance of the samples or better."""
    n = 10
    normal = np.array(normal) / np.linalg.norm(normal)
    errors = []
    for size in (8, 16, 32, 64):
        low, cut = cut_unit_box(lambda x, y: normal @ (x - 0.47, y - 0.52) < 0, (n, n), size)
        share, middle = half_plane(low * n, normal, (normal @ (0.47, 0.52)) * n)
        cells = (share > 2 * SMALLEST_SHARE) & (share < 1)
        assert cells.sum() > 5
        away = np.linalg.norm(cut.middle * n - low * n - middle, axis=1)
        errors.append([np.abs(cut.share - share)[cells].max(), away[cells & (share > 0.3)].max()])
        border = cut.face == BORDER
        assert np.abs((cut.point[border] - (0.47, 0.52)) @ normal).max() < 1e-12  # on it
    errors = np.array(errors)
    assert np.all(errors[-1] < (0.012, 0.012))  # in cells' widths; samples are 1/64 apart
    assert np.all(errors[-1] < errors[0] / 4)
    area = cut.area[border].sum(axis=0)
    assert np.abs(np.cross(area, normal)) < 2 / n / 64  # where it ends it is cut off at a sample
    np.testing.assert_allclose(area / np.linalg.norm(area), normal, atol=0.01)


def half_plane(low, normal, level):
    """Share and centroid, from `low`, of the part of unit squares where normal . x < level: by fine lines."""
    t = (np.arange(20000) + 0.5) / 20000
    share, middle = np.zeros(len(low)), np.zeros((len(low), 2))
    for k, (x, y) in enumerate(low):
        end = (level - normal[0] * (x + t)) / normal[1] - y
        a, b = (np.zeros_like(t), np.clip(end, 0, 1)) if normal[1] > 0 else (np.clip(end, 0, 1), np.ones_like(t))
        share[k] = (b - a).mean()
        moment = ((b - a) * t).mean(), ((b**2 - a**2) / 2).mean()
        middle[k] = np.array(moment) / max(share[k], 1e-300)
    return share, middle


@pytest.mark.parametrize("dim", (1, 2, 3))
@pytest.mark.parametrize("beyond", (True, False))
def test_a_border_along_the_lattice(dim, beyond):
    """Cells stay whole, and each along it has one piece of its full side."""
    n = 8
    low, cut = cut_unit_box(lambda *X: X[0] > 0.5 if beyond else X[0] < 0.5, (n,) * dim)
    kept = low[:, 0] > 0.49 if beyond else low[:, 0] < 0.49
    assert np.array_equal(cut.share, kept.astype(float))
    assert len(cut.row) == n ** (dim - 1) == len(np.unique(cut.row)) and np.all(kept[cut.row])
    assert np.all(cut.face == BORDER)
    middles = low[cut.row] + 0.5 / n
    middles[:, 0] = 0.5
    np.testing.assert_allclose(cut.point, middles, atol=1e-12)
    area = np.zeros((len(cut.row), dim))
    area[:, 0] = (-1 if beyond else 1) / n ** (dim - 1)
    np.testing.assert_allclose(cut.area, area, atol=1e-15)


def test_a_border_that_bulges_into_a_cell():
    """Where a hole enters a row of cells between the points of the first look, its pieces are there."""
    top = 0.5 + 1e-3  # the hole's topmost point, 1 % of a cell above the line y = 0.5
    for x in (0.53, 0.55, 0.57):
        _, cut = cut_unit_box(lambda X, Y, x=x: np.hypot(X - x, Y - top + 0.17) > 0.17, (10, 10))
        assert np.abs(cut.area.sum(axis=0)).max() < 1e-15
        assert size_of(cut) == pytest.approx(2 * np.pi * 0.17, rel=0.02)


def test_small_things():
    """What is smaller than a cell may be between the points of the first look: then it is not there."""
    _, cut = cut_unit_box(lambda X, Y: np.hypot(X - 0.27, Y - 0.23) > 0.015, (10, 10))
    assert np.all(cut.share == 1) and len(cut.row) == 0
    _, cut = cut_unit_box(lambda X, Y: np.hypot(X - 0.25, Y - 0.25) > 0.015, (10, 10))
    assert cut.share.min() == pytest.approx(1 - np.pi * 0.15**2, abs=2e-3)  # the middle of a cell is seen
    assert np.abs(cut.area).sum() == 0  # a closed border within a cell pulls at nothing
    _, cut = cut_unit_box(lambda X, Y: np.hypot(X - 0.25, Y - 0.25) < 0.015, (10, 10))
    assert cut.share.sum() == pytest.approx(np.pi * 0.15**2, abs=2e-3)
    _, cut = cut_unit_box(lambda X, Y: X < -1, (10, 10))
    assert cut.share.sum() == 0 and len(cut.row) == 0
