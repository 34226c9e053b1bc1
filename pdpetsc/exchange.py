"""Moving particle fields between ranks: owner to ghost, ghost to owner, and to the order of the ids."""

from contextlib import contextmanager

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc


def _unit(field: np.ndarray) -> MPI.Datatype:
    """The MPI type of one particle's entry of `field`."""
    scalar = MPI._typedict[field.dtype.char]
    components = int(np.prod(field.shape[1:]))
    return scalar if components == 1 else _vector(scalar, components)


_vectors: dict[tuple, MPI.Datatype] = {}


def _vector(scalar: MPI.Datatype, components: int) -> MPI.Datatype:
    key = (scalar.Get_name(), components)
    if key not in _vectors:
        _vectors[key] = scalar.Create_contiguous(components).Commit()
    return _vectors[key]


def star_forest(comm, roots: int, leaves: np.ndarray, rank: np.ndarray, index: np.ndarray) -> PETSc.SF:
    """A PetscSF whose leaf `leaves[k]` of this rank hangs on root `index[k]` of rank `rank[k]`."""
    forest = PETSc.SF().create(comm)
    remote = np.stack([rank, index], axis=1).astype(PETSc.IntType)
    forest.setGraph(int(roots), np.ascontiguousarray(leaves, PETSc.IntType), np.ascontiguousarray(remote))
    forest.setUp()
    return forest


def broadcast(forest: PETSc.SF, roots: np.ndarray, leaves: np.ndarray) -> None:
    """Copy every root's entry to its leaves."""
    unit = _unit(leaves)
    forest.bcastBegin(unit, roots, leaves, MPI.REPLACE)
    forest.bcastEnd(unit, roots, leaves, MPI.REPLACE)


def reduce(forest: PETSc.SF, leaves: np.ndarray, roots: np.ndarray, operation: MPI.Op = MPI.SUM) -> None:
    """Combine every leaf's entry with its root's."""
    unit = _unit(leaves)
    forest.reduceBegin(unit, leaves, roots, operation)
    forest.reduceEnd(unit, leaves, roots, operation)


class Exchange:
    """Ghost exchange: local arrays hold the `owned` particles first, then their ghosts, grouped by owner.

    Args:
        comm: PETSc communicator.
        owned: number of owned particles.
        rank, index: owner and index there, for each ghost in turn.
    """

    def __init__(self, comm, owned: int, rank: np.ndarray, index: np.ndarray):
        ghosts = np.arange(owned, owned + len(rank))
        self._forest = star_forest(comm, owned, ghosts, rank, index)

    def forward(self, field: np.ndarray) -> np.ndarray:
        """Fill the ghost entries of a local field from their owners, in place."""
        with self.forwarding(field):
            return field

    def reverse_add(self, field: np.ndarray) -> np.ndarray:
        """Add the ghost entries of a local field to their owners, in place; ghost entries are then stale."""
        with self.adding(field):
            return field

    @contextmanager
    def forwarding(self, field: np.ndarray):
        """`forward` with something to do meanwhile that changes nothing in the field and reads owned entries only."""
        unit = _unit(field)
        self._forest.bcastBegin(unit, field, field, MPI.REPLACE)
        yield
        self._forest.bcastEnd(unit, field, field, MPI.REPLACE)

    @contextmanager
    def adding(self, field: np.ndarray):
        """`reverse_add` with something to do meanwhile that adds to owned entries only."""
        unit = _unit(field)
        self._forest.reduceBegin(unit, field, field, MPI.SUM)
        yield
        self._forest.reduceEnd(unit, field, field, MPI.SUM)

    def reverse_minimum(self, field: np.ndarray) -> np.ndarray:
        """Give owners the minimum of their entry of a scalar local field and of their ghosts', in place."""
        reduce(self._forest, field, field, MPI.MIN)
        return field


class Directory:
    """Owned fields to and from the order of the particles' ids, cut into equal blocks, one for each rank.

    Files are written in this order, so they do not depend on the number of ranks.
    """

    def __init__(self, comm, ids: np.ndarray, count: int):
        self._owned = len(ids)
        edges = count * np.arange(comm.size + 1, dtype=np.int64) // comm.size
        self.start, self.stop = int(edges[comm.rank]), int(edges[comm.rank + 1])
        rank = np.searchsorted(edges, ids, side="right") - 1
        self._forest = star_forest(comm, self.stop - self.start, np.arange(len(ids)), rank, ids - edges[rank])
        self._mpi, self._edges = comm.tompi4py(), edges

    def to_blocks(self, field: np.ndarray) -> np.ndarray:
        """This rank's block of ids, from the owners."""
        field = np.ascontiguousarray(field)
        block = np.zeros((self.stop - self.start, *field.shape[1:]), field.dtype)
        reduce(self._forest, field, block, MPI.REPLACE)
        return block

    def gathered(self, field: np.ndarray) -> np.ndarray:
        """The field of all particles in the order of their ids, whole on every rank."""
        block = self.to_blocks(field)
        whole = np.empty((self._edges[-1], *block.shape[1:]), block.dtype)
        self._mpi.Allgatherv([block, _unit(block)], [whole, np.diff(self._edges), self._edges[:-1], _unit(whole)])
        return whole

    def from_blocks(self, block: np.ndarray) -> np.ndarray:
        """The owned entries of a field given in blocks of ids."""
        block = np.ascontiguousarray(block)
        field = np.zeros((self._owned, *block.shape[1:]), block.dtype)
        broadcast(self._forest, block, field)
        return field


def swap(comm, neighbours: list[int], parts: list[np.ndarray], dtype) -> list[np.ndarray]:
    """Send `parts[k]` to rank `neighbours[k]` and return what each of them sent here (neighbourhood is mutual)."""
    requests = [comm.Isend(np.ascontiguousarray(part, dtype), dest=rank) for rank, part in zip(neighbours, parts)]
    received = []
    for rank in neighbours:
        status = MPI.Status()
        comm.Probe(source=rank, status=status)
        scalar = MPI._typedict[np.dtype(dtype).char]
        buffer = np.empty(status.Get_count(scalar), dtype)
        comm.Recv(buffer, source=rank)
        received.append(buffer)
    MPI.Request.Waitall(requests)
    return received
