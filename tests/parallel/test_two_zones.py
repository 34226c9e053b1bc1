"""Two zones of different spacing and horizon: what every model keeps where families of different size meet.

Coarse particles see fine ones that do not see them (dual horizons, seed 002): both momenta must hold all the same, a
rigid motion must be free of force, and nothing may depend on the ranks.
"""

import numpy as np
import pytest
from bodies import assembler, refined, rows_of, whole
from models import MODELS, NAMES, Sample, deformation, force, rotation

pytestmark = pytest.mark.mpi

every_model = pytest.mark.parametrize("row", MODELS, ids=NAMES)
every_dimension = pytest.mark.parametrize("dim", (1, 2, 3))

SIZE = {1: [9.0], 2: [7.0, 4.0], 3: [4.0, 3.0, 2.0]}
FACTOR = {1: 3.015, 2: 2.015, 3: 1.515}
RATIO = {1: 4, 2: 3, 3: 2}
INTERFACE = {1: 5.0, 2: 5.0, 3: 3.0}


def two_zones(dim: int):
    """A box of cells of width 1, divided beyond INTERFACE; the horizon is FACTOR times the local spacing."""
    return refined(SIZE[dim], f"where(X > {INTERFACE[dim]}, {RATIO[dim]}, 1)", FACTOR[dim])


def everywhere(comm, p):
    """Positions, volumes, horizons and spacings of all particles, by their ids, on every rank."""
    return [whole(comm, p, field) for field in (p.position, p.volume, p.horizon, p.spacing)]


def forces(comm, p, a, u):
    """Internal forces of all particles, by their ids, on every rank."""
    return whole(comm, p, a.internal_force(u[p.id[: p.owned]]))


def moments(x, f):
    """x cross f of each particle, (n, 1 or 3)."""
    if x.shape[1] == 2:
        return (x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0])[:, None]
    return np.cross(x, f)


@every_dimension
def test_the_zones(comm, dim):
    """Volumes sum to the body's, both zones are there, and coarse particles see fine ones that do not see them."""
    p = two_zones(dim)
    X, volume, horizon, spacing = everywhere(comm, p)
    assert volume.sum() == pytest.approx(np.prod(SIZE[dim]), rel=1e-14)
    fine = X[:, 0] > INTERFACE[dim]
    assert fine.sum() == RATIO[dim] ** dim * (SIZE[dim][0] - INTERFACE[dim]) * np.prod(SIZE[dim][1:])
    assert spacing == pytest.approx(np.where(fine, 1 / RATIO[dim], 1.0), rel=1e-14)
    assert horizon == pytest.approx(FACTOR[dim] * spacing, rel=1e-14)
    distance = np.linalg.norm(X[:, None] - X[None], axis=2)
    sees = distance <= horizon[:, None]
    assert (sees[~fine][:, fine] & ~sees[fine][:, ~fine].T).any()


@every_dimension
@every_model
def test_forces(comm, row, dim):
    """Of a strong deformation: their momenta, against the sums of the absolute values, and that they are those of the
    same model on one process, with every particle there."""
    p = two_zones(dim)
    X, volume, horizon, spacing = everywhere(comm, p)
    u = deformation(X)
    f = forces(comm, p, assembler(p, row), u)
    assert np.abs(f.sum(axis=0)).max() < 1e-15 * np.abs(f).sum()
    if dim > 1 and row.angular:
        x = X + u - (X + u).mean(axis=0)
        size = (np.linalg.norm(x, axis=1) * np.linalg.norm(f, axis=1)).sum()
        assert np.abs(moments(x, f).sum(axis=0)).max() < 1e-14 * size
    alone = Sample(X, volume, horizon, spacing, np.empty(0))
    alone.weight = np.ones(alone.families().bonds)
    expected = force(alone.material(row), u)
    assert np.abs(f - expected).max() < 1e-14 * np.abs(expected).max()


@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize("row", [row for row in MODELS if row.objective or not row.hyperelastic], ids=lambda r: r.name)
def test_rigid_motions_are_free_of_force(comm, row, dim):
    p = two_zones(dim)
    a = assembler(p, row)
    X, *_ = everywhere(comm, p)
    u = X @ (rotation(dim, np.deg2rad(90)) - np.eye(dim)).T + 0.7
    strained = forces(comm, p, a, 0.1 * X)
    assert np.abs(forces(comm, p, a, u)).max() < 1e-13 * np.abs(strained).max()


@every_dimension
@pytest.mark.parametrize("row", [row for row in MODELS if row.hyperelastic], ids=lambda r: r.name)
def test_the_tangent_is_symmetric(comm, row, dim):
    p = two_zones(dim)
    a = assembler(p, row)
    X, *_ = everywhere(comm, p)
    J = np.concatenate(comm.allgather(rows_of(a.assemble(deformation(X)[p.id[: p.owned]]))))
    assert np.abs(J - J.T).max() < 1e-14 * np.abs(J).max()
