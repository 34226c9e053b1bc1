"""How a bond is shared among the cells that it crosses."""

import numpy as np
import pytest
from models import lattice

from pdpetsc.bonds import find_families
from pdpetsc.materials.flux import candidates, walk


def shares(X, i, j, horizon) -> np.ndarray:
    """The fraction of the bond from i to j in each particle's cell, from the family of i alone."""
    families = find_families(X, np.full(len(X), horizon), np.arange(len(X)), len(X))
    members = families.neighbours[families.offsets[i] : families.offsets[i + 1]]
    b = int(np.flatnonzero(members == j)[0])
    xi = X[members] - X[i]
    slope, start, fraction = np.empty((3, len(members) + 1))
    member = np.empty(len(members) + 1, np.int32)
    count = candidates(xi @ xi[b], (xi**2).sum(axis=1), b, len(members), slope, start, member)
    result = np.zeros(len(X))
    result[i] = walk(slope, start, count, fraction)
    np.add.at(result, members[member[:count]], fraction[:count])
    return result


def cut_at_all_bisectors(X, i, j) -> np.ndarray:
    """The same by brute force: between the points where the line meets the bisecting planes of any two particles, the
    nearest of all particles is that at the middle."""
    xi = X[j] - X[i]
    along, square = (X - X[i]) @ xi, ((X - X[i]) ** 2).sum(axis=1)
    with np.errstate(all="ignore"):
        s = ((square[:, None] - square) / (2 * (along[:, None] - along))).ravel()
    s = np.unique(np.concatenate([[0.0, 1.0], s[(s > 0) & (s < 1)]]))
    middle = X[i] + ((s[1:] + s[:-1]) / 2)[:, None] * xi
    nearest = np.linalg.norm(middle[:, None] - X, axis=2).argmin(axis=1)
    return np.bincount(nearest, np.diff(s), minlength=len(X))


@pytest.mark.parametrize("counts", [(30,), (9, 8), (5, 5, 4)])
@pytest.mark.parametrize("amount", (0.1, 0.45))
def test_a_jittered_cloud(counts, amount):
    """No cell but those of the family is crossed, and each by what brute force over all particles says."""
    rng = np.random.default_rng([*counts])
    X = lattice(counts) + amount * rng.uniform(-1, 1, (np.prod(counts), len(counts)))
    horizon = 3.3 if len(counts) < 3 else 2.4
    families = find_families(X, np.full(len(X), horizon), np.arange(len(X)), len(X))
    centers = families.per_bond(np.arange(len(X)))
    crossed = 0
    for bond in rng.choice(families.bonds, min(families.bonds, 60), replace=False):
        i, j = int(centers[bond]), int(families.neighbours[bond])
        found = shares(X, i, j, horizon)
        assert np.abs(found - cut_at_all_bisectors(X, i, j)).max() < 1e-12
        assert found == pytest.approx(shares(X, j, i, horizon), abs=1e-12)
        crossed = max(crossed, np.count_nonzero(found > 1e-12))
    assert crossed >= 4


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        ((1, 0), {(0, 0): 1 / 2, (1, 0): 1 / 2}),
        ((3, 0), {(0, 0): 1 / 6, (1, 0): 1 / 3, (2, 0): 1 / 3, (3, 0): 1 / 6}),
        ((2, 1), {(0, 0): 1 / 4, (1, 0): 1 / 4, (1, 1): 1 / 4, (2, 1): 1 / 4}),
        ((2, 2), {(0, 0): 1 / 4, (1, 1): 1 / 2, (2, 2): 1 / 4}),  # through corners
        ((-1, 2), {(0, 0): 1 / 4, (0, 1): 1 / 4, (-1, 1): 1 / 4, (-1, 2): 1 / 4}),
    ],
)
@pytest.mark.parametrize("spacing", (1.0, 0.3))
def test_cells_of_a_lattice(end, expected, spacing):
    """By the lengths that a ruler shows."""
    X = lattice((9, 9), spacing)
    number = {place: 9 * (4 + place[1]) + 4 + place[0] for place in (end, *expected)}
    found = shares(X, number[0, 0], number[end], 3.015 * spacing)
    exact = np.zeros(len(X))
    for place, share in expected.items():
        exact[number[place]] = share
    assert found == pytest.approx(exact, abs=1e-12)


def test_particles_that_are_equally_near_share_evenly():
    """The middle of a diagonal between two rows, with no particle on it."""
    X = np.array([[0.0, 0.0], [2.0, 2.0], [1.1, 0.9], [0.9, 1.1], [0.3, 1.7]])
    found = shares(X, 0, 1, 3.0)
    assert found[2] == pytest.approx(found[3], rel=1e-12)
    assert found.sum() == pytest.approx(1.0, rel=1e-14)
    X = np.concatenate([[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], [[2.0, y, z] for y in (-1, 1) for z in (-1, 1)]])
    assert shares(X, 0, 1, 5.0)[2:] == pytest.approx(np.full(4, (1 - 2 * 3 / 8) / 4), rel=1e-12)
