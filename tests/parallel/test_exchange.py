"""Ghost exchange, the directory of ids, and messages between neighbours."""

import numpy as np
import pytest
from bodies import distributed, jittered, whole

from pdpetsc.exchange import swap

pytestmark = pytest.mark.mpi


@pytest.fixture(scope="module", params=[((30,), 2.5), ((12, 8), 3.1), ((6, 5, 4), 2.1), ((2, 1), 1.5)], ids=str)
def particles(request):
    counts, horizon = request.param
    return distributed(jittered(counts, 0.1), horizon)


SHAPES = ((), (1,), (3,), (3, 3), (5,))


@pytest.mark.parametrize("dtype", (np.float64, np.int64, np.int32))
@pytest.mark.parametrize("shape", SHAPES)
def test_forward_brings_the_owners_entries(particles, shape, dtype):
    p = particles
    components = np.arange(np.prod(shape, dtype=int)).reshape(shape)
    expected = (100 * p.id.reshape(-1, *(1,) * len(shape)) + components).astype(dtype)
    field = expected.copy()
    field[p.owned :] = -7
    result = p.exchange.forward(field)
    assert result is field
    assert np.array_equal(field, expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_reverse_add_counts_every_copy(comm, particles, shape):
    """What lies on ghosts arrives once: sums over all ranks are kept, particle by particle."""
    p = particles
    value = np.random.default_rng(comm.rank).uniform(size=(p.local, *shape))
    total = np.zeros((p.count, *shape))
    np.add.at(total, p.id, value)
    total = comm.allreduce(total)
    p.exchange.reverse_add(value)
    assert np.allclose(value[: p.owned], total[p.id[: p.owned]], rtol=1e-14, atol=0)


def test_reverse_add_is_the_transpose_of_forward(comm, particles):
    p = particles
    rng = np.random.default_rng(comm.rank)
    a, b = rng.normal(size=(p.local, 2)), rng.normal(size=(p.local, 2))
    owned = a[: p.owned].copy()
    forward = p.exchange.forward(np.concatenate([owned, np.zeros((p.local - p.owned, 2))]))
    left = comm.allreduce((forward * b).sum())
    right = comm.allreduce((owned * p.exchange.reverse_add(b)[: p.owned]).sum())
    assert left == pytest.approx(right, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("dtype", (np.float64, np.int32))
@pytest.mark.parametrize("shape", SHAPES)
def test_directory(comm, particles, shape, dtype):
    p = particles
    d = p.directory
    assert d.stop - d.start in (p.count // comm.size, p.count // comm.size + 1)
    field = (np.random.default_rng(1).integers(0, 1000, (p.count, *shape))[p.id[: p.owned]]).astype(dtype)
    block = d.to_blocks(field)
    assert block.dtype == dtype
    assert np.array_equal(block, whole(comm, p, field)[d.start : d.stop])
    assert np.array_equal(d.from_blocks(block), field)
    strided = np.asfortranarray(np.stack([field] * 2, axis=1))[:, 1]
    assert np.array_equal(d.to_blocks(strided), block)


def test_swap(comm):
    """Each rank sends the others messages of different lengths, some of them empty."""
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    for dtype in (np.int64, np.float64):
        parts = [np.full(10 * rank, comm.rank) for rank in others]
        received = swap(comm, others, parts, dtype)
        for rank, part in zip(others, received):
            assert part.dtype == dtype
            assert np.array_equal(part, np.full(10 * comm.rank, rank))


def test_swaps_in_a_row_do_not_mix(comm):
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    for number in range(20):
        parts = [np.full(1 + number % 3, 100 * number + comm.rank) for _ in others]
        received = swap(comm, others, parts, np.int64)
        assert [part.tolist() for part in received] == [[100 * number + rank] * (1 + number % 3) for rank in others]


def test_swap_of_long_messages(comm):
    """Longer than MPI sends at once."""
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    received = swap(comm, others, [np.full(300_000, comm.rank)] * len(others), np.int64)
    assert all(len(part) == 300_000 and part[-1] == rank for part, rank in zip(received, others))
