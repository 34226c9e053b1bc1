"""Values at points between particles, on lattices of one spacing and of several."""

import numpy as np
import pytest
from bodies import distributed, jittered, refined
from models import lattice
from petsc4py import PETSc

from pdpetsc.probes import REACH, Interpolation

pytestmark = pytest.mark.mpi

GRADED = {  # size in cells of width 1, refine
    "line": ([12], "where(X < 5, 8, 1)"),
    "plate": ([9, 7], "where(X < 4, 4, 1)"),
    "corner": ([9, 7], "where(X < 4 and Y < 3, 3, 1)"),
    "steps": ([12, 6], "where(X < 4, 16, where(X < 6, 4, 1))"),
    "thin": ([9, 1], "where(X < 4, 2, 1)"),
    "block": ([6, 4, 4], "where(X < 2, 3, 1)"),
}


def inside(size, count: int = 60) -> np.ndarray:
    """Points of the body, its faces and those between zones of 4 and 5 cells included."""
    points = np.random.default_rng(0).uniform(0, 1, (count, len(size))) * size
    points[:5, 0] = min(4.0, size[0])
    points[5:10, 0] = 0.0
    points[10:15, 0] = size[0]
    points[15:20] = size
    return points


def one_spacing(X, spacing, field, points):
    """The interpolation by its first formula, of particles with one spacing on one process."""
    values = []
    for point in points:
        r = np.linalg.norm(X - point, axis=1) / spacing
        if r.min() < 1e-6:
            values.append(field[r.argmin()])
            continue
        basis = np.concatenate([np.ones((len(X), 1)), (X - point) / spacing], axis=1)
        weight = np.where(r < REACH, (1 - r / REACH) ** 2, 0.0)
        moment = (weight[:, None] * basis).T @ basis
        values.append(np.linalg.pinv(moment, rcond=1e-10, hermitian=True)[0] @ basis.T @ (weight * field))
    return np.array(values)


@pytest.mark.parametrize(
    "X", [lattice((14,)), lattice((9, 7)), jittered((9, 7), 0.2), lattice((6, 4, 4)), jittered((4, 3, 5), 0.2)]
)
def test_one_spacing(X):
    p = distributed(0.3 * X, 0.9, spacing=0.3)
    field = np.sin(7 * X.sum(axis=1))
    points = 0.3 * inside(np.ceil(X.max(axis=0)))
    points[20] = 0.3 * X[7]
    interpolation = Interpolation(p, points)
    assert interpolation.reached.all()
    found = interpolation(field[p.id[: p.owned]])
    assert found == pytest.approx(one_spacing(0.3 * X, 0.3, field, points), rel=1e-11, abs=1e-11)


def test_a_single_row():
    """Beside it fields are those of the row."""
    X = lattice((9, 1))
    p = distributed(X, 3.0)
    points = np.array([[2.2, 0.1], [4.0, 0.5], [4.5, 0.9], [9.0, 1.0]])
    assert Interpolation(p, points)(3.0 + 2 * p.position[: p.owned, 0]) == pytest.approx(3.0 + 2 * points[:, 0])


@pytest.mark.parametrize("name", GRADED)
def test_affine_fields_across_zones(name):
    size, refine = GRADED[name]
    p = refined(size, refine)
    gradient = np.array([[1.0, -2.0], [0.5, 3.0], [-1.0, 0.2]])[: len(size)]
    if size[-1] == 1:
        gradient[-1] = 0.0  # one row tells no slope
    points = inside(size)
    interpolation = Interpolation(p, points)
    assert interpolation.reached.all()
    found = interpolation(p.position[: p.owned] @ gradient + [3.0, 4.0])
    assert found == pytest.approx(points @ gradient + [3.0, 4.0], rel=1e-9, abs=1e-9)


def test_a_particle_in_a_zone_gives_its_own_value():
    size, refine = GRADED["steps"]
    p = refined(size, refine)
    alone = refined(size, refine, comm=PETSc.COMM_SELF)
    numbers = np.arange(0, alone.count, 97)
    found = Interpolation(p, alone.position[numbers])(np.sin(p.id[: p.owned].astype(float)))
    assert np.array_equal(found, np.sin(numbers.astype(float)))


def test_the_value_is_continuous_across_a_zone_boundary():
    size, refine = GRADED["plate"]
    p = refined(size, refine)
    line = np.stack([np.linspace(2.0, 7.0, 2001), np.full(2001, 3.3)], axis=1)
    value = Interpolation(p, line)((p.position[: p.owned] ** 2).sum(axis=1))
    assert np.abs(np.diff(value)).max() < 0.06  # the slope is 2 X < 14, a step 0.0025
    assert np.abs(value - (line**2).sum(axis=1)).max() < 1.0


def test_the_same_on_any_number_of_ranks():
    size, refine = GRADED["corner"]
    p, alone = refined(size, refine), refined(size, refine, comm=PETSc.COMM_SELF)
    points = inside(size)
    values = [Interpolation(q, points)(np.sin(q.position[: q.owned, 0])) for q in (p, alone)]
    assert values[0] == pytest.approx(values[1], rel=1e-12)


def test_points_out_of_reach():
    """A point must be within a spacing of a particle, that of the particle."""
    p = refined([8, 4], "where(X < 4, 4, 1)")
    points = np.array([[8.3, 2.0], [8.4, 2.5], [8.6, 2.5], [-0.1, 2.1], [-0.2, 2.1], [100.0, 0.0]])
    assert Interpolation(p, points).reached.tolist() == [True, True, False, True, False, False]
