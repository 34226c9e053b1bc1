"""Parts of cells in a horizon, against the whole ball and against points."""

import numpy as np
import pytest

from pdpetsc.partial_volume import exact, linear

BALL = {1: 2.0, 2: np.pi, 3: 4 * np.pi / 3}


def grid(dim: int, reach: int) -> np.ndarray:
    axis = np.arange(-reach, reach + 1.0)
    return np.stack([a.ravel() for a in np.meshgrid(*[axis] * dim)], axis=1)


@pytest.mark.parametrize("radius", (0.3, 0.5, 1.0, 1.2, 2.0, 3.015, 6.7))
@pytest.mark.parametrize("dim", (1, 2, 3))
def test_all_cells_together_are_the_ball(dim, radius):
    """Wherever the lattice lies, with its own cell and those whose centers are outside; another unit of length too."""
    for shift in (np.zeros(dim), np.full(dim, 0.5), np.random.default_rng(dim).uniform(-0.5, 0.5, dim)):
        xi = grid(dim, int(radius + 2)) + shift
        for unit in (1.0, 1e-6):
            part = exact(xi * unit, np.full(len(xi), radius * unit), np.full(len(xi), unit))
            assert part.sum() == pytest.approx(BALL[dim] * radius**dim, rel=1e-13)
            assert part.min() >= 0 and part.max() <= 1


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_single_cells(dim):
    """Of any size and place, against a lattice of points in them; and the limits."""
    rng = np.random.default_rng(3)
    xi, spacing = rng.uniform(-3, 3, (40, dim)), rng.uniform(0.3, 4, 40)
    fine = {1: 4000, 2: 400, 3: 60}[dim]
    points = (grid(dim, fine // 2) + 0.0) / (fine + 1)
    radius = np.full(40, 2.5)
    part = exact(xi, radius, spacing)
    for x, width, found in zip(xi, spacing, part):
        inside = np.linalg.norm(x + width * points, axis=1) <= 2.5
        assert found == pytest.approx(inside.mean(), abs=3 / fine)
    assert ((part > 0) & (part < 1)).sum() > 10
    away = np.zeros((2, dim))
    away[:, 0] = 1.9, 3.1
    assert np.array_equal(exact(away[:, ::-1].copy(), np.array([2.5, 2.5]), np.array([0.4, 0.4])), [1.0, 0.0])
    tiny = exact(np.array([[0.0] * dim]), np.array([0.1]), np.array([1.0]))
    assert tiny[0] == pytest.approx(BALL[dim] * 0.1**dim, rel=1e-13)


def test_an_axis_in_the_horizon():
    """In 1D both rules are exact."""
    xi = np.linspace(-4, 4, 33)[:, None]
    radius, spacing = np.full(33, 3.015), np.ones(33)
    assert np.abs(exact(xi, radius, spacing) - linear(xi, radius, spacing)).max() < 1e-15
