"""Distribution, ghosts and families on any number of ranks, against one process with a KD-tree."""

import numpy as np
import pytest
from bodies import distributed, families_of, jittered, whole
from models import lattice
from mpi4py import MPI
from scipy.spatial import KDTree

from pdpetsc.bonds import HORIZON_TOLERANCE

pytestmark = pytest.mark.mpi

BODIES = {  # positions, horizon, spacing
    "line": (lattice((40,)), 3.015, 1.0),
    "plate": (lattice((14, 9)), 3.015, 1.0),
    "block": (lattice((7, 6, 5)), 2.015, 1.0),
    "strip of one row": (lattice((40, 1)), 2.015, 1.0),
    "column": (lattice((1, 40)), 2.015, 1.0),
    "sheet in space": (lattice((1, 9, 8)), 2.015, 1.0),
    "wire in space": (lattice((1, 1, 20)), 1.015, 1.0),
    "jittered plate": (jittered((14, 9), 0.3), 2.5, 1.0),
    "tiny spacing": (1e-9 * lattice((9, 8)), 3.015e-9, 1e-9),
    "far from the origin": (1e4 + lattice((9, 8)), 3.015, 1.0),
    "horizon beyond the body": (lattice((5, 4)), 100.0, 1.0),
    "hole": (lattice((14, 9))[np.hypot(*(lattice((14, 9)) - [7.0, 4.5]).T) > 3], 1.5, 1.0),
    "L": (lattice((16, 16))[(lattice((16, 16)) < 4).any(axis=1)], 2.015, 1.0),
    "two far parts": (np.vstack([lattice((6, 6)), lattice((6, 6)) + 1e3]), 2.015, 1.0),
}
rng = np.random.default_rng(0)
BODIES["variable horizons"] = (jittered((14, 9), 0.2), rng.uniform(1.6, 4.0, 126), 1.0)
BODIES["graded"] = (np.exp(0.1 * lattice((20, 10))), 2.015 * 0.1 * np.exp(0.1 * lattice((20, 10))).max(axis=1), None)
BODIES["graded"] = (*BODIES["graded"][:2], BODIES["graded"][1] / 2.015)
every_body = pytest.mark.parametrize("body", [pytest.param(body, id=name) for name, body in BODIES.items()])


def families_by_tree(X, horizon):
    found = KDTree(X).query_ball_point(X, horizon * (1 + HORIZON_TOLERANCE))
    return [sorted(set(members) - {i}) for i, members in enumerate(found)]


def check_distribution(comm, X, p):
    """Every particle once, the owned ones in the order of their ids, and all numbering consistent."""
    n = len(X)
    assert p.count == n
    own = p.id[: p.owned]
    assert np.all(np.diff(own) > 0)
    assert np.array_equal(np.sort(np.concatenate(comm.allgather(own))), np.arange(n))
    assert len(set(p.id.tolist())) == p.local, "a ghost twice, or a ghost that is owned"
    assert np.array_equal(p.position, X[p.id])
    number = np.concatenate(comm.allgather(own))  # ids in the order of the global numbers
    assert np.array_equal(number[p.global_index], p.id)
    for rank, ghosts in zip(p.neighbours, p.ghost_ranges):
        assert rank != comm.rank
        assert ghosts.start >= p.owned
    assert sum(g.stop - g.start for g in p.ghost_ranges) == p.local - p.owned
    mirrored = comm.alltoall([p.id[m] for m in by_rank(comm, p.neighbours, p.mirrors, np.empty(0, int))])
    for rank, ghosts in zip(p.neighbours, p.ghost_ranges):
        assert np.array_equal(mirrored[rank], p.id[ghosts])


def by_rank(comm, neighbours, values, nothing):
    found = dict(zip(neighbours, values))
    return [found.get(rank, nothing) for rank in range(comm.size)]


@every_body
def test_particles_and_families(comm, body):
    X, horizon, spacing = body
    p = distributed(X, horizon, spacing=spacing)
    check_distribution(comm, X, p)
    horizon = np.broadcast_to(horizon, len(X))
    assert np.array_equal(p.horizon, horizon[p.id])
    assert np.array_equal(p.volume, (np.broadcast_to(spacing, len(X)) ** X.shape[1])[p.id])
    families = families_of(p)
    expected = families_by_tree(X, horizon)
    for f in range(len(families)):
        members = p.id[families.neighbours[families.offsets[f] : families.offsets[f + 1]]]
        assert members.tolist() == expected[p.id[f]]


@pytest.mark.parametrize("dim", (1, 2, 3))
@pytest.mark.parametrize("n", (1, 2, 3, 5))
def test_bodies_of_a_few_particles(comm, n, dim):
    """Fewer particles than ranks: some ranks are empty, and everything still works."""
    X = np.zeros((n, dim))
    X[:, 0] = np.arange(n)
    X[:, -1] = 0.5 * np.arange(n)
    p = distributed(X, 1.5)
    check_distribution(comm, X, p)
    if n > 1:
        families = families_of(p)
        assert comm.allreduce(families.bonds) == sum(map(len, families_by_tree(X, np.full(n, 1.5))))
    f = np.zeros((p.local, 2))
    p.exchange.forward(f)
    p.exchange.reverse_add(f)
    assert np.array_equal(p.directory.to_blocks(p.id[: p.owned]), np.arange(p.directory.start, p.directory.stop))


def test_particles_brought_by_one_rank(comm):
    """A body that starts on one rank alone, as from a file."""
    from petsc4py import PETSc

    from pdpetsc.particles import Points, distribute

    X = lattice((10, 8))
    mine = np.arange(80) if comm.rank == comm.size - 1 else np.arange(0)
    one = np.ones(len(mine))
    p = distribute(PETSc.COMM_WORLD, Points(mine, X[mine], one, one, 2.0 * one))
    check_distribution(comm, X, p)


@pytest.mark.parametrize(
    ("counts", "most"), [((400,), 1.05), ((60, 40), 1.1), ((200, 3), 1.1), ((3, 200), 1.1), ((16, 14, 12), 1.2)]
)
def test_balance(comm, counts, most):
    """The largest share of the work (sizes of the families) against the mean."""
    p = distributed(lattice(counts), 3.015)
    work = families_of(p).bonds
    assert comm.allreduce(work, MPI.MAX) <= most * comm.allreduce(work) / comm.size


def test_balance_of_variable_horizons(comm):
    """Left half with three times the horizon: nearly nine times the work of a particle."""
    X = lattice((60, 30))
    p = distributed(X, np.where(X[:, 0] < 30, 6.015, 2.015))
    work = families_of(p).bonds
    assert comm.allreduce(work, MPI.MAX) <= 1.25 * comm.allreduce(work) / comm.size


def test_ghosts_are_no_wider_than_they_must_be(comm):
    """One horizon of the receiver's own particles, not the largest of the body."""
    X = lattice((300, 2))
    p = distributed(X, np.where(X[:, 0] < 2, 8.015, 2.015))
    if p.owned and X[p.id[: p.owned], 0].min() > 20:
        assert p.local - p.owned <= 2 * 2 * 2
    check_distribution(comm, X, p)


def test_gathered_fields(comm):
    X = jittered((9, 8), 0.2)
    p = distributed(X, 2.0)
    assert np.array_equal(whole(comm, p, p.position), X)
