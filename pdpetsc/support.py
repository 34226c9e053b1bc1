"""Whether a body is held: rigid motions that no constraint stops would make the tangent singular."""

import numpy as np
from mpi4py import MPI
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.errors import InputError
from pdpetsc.parallel import warn
from pdpetsc.particles import Particles

SMALLEST_HOLD = 1e-12
"""Eigenvalue of the constraints' hold on rigid motions, relative to the largest, below which a motion is free."""


def check_support(particles: Particles, families: Families, constrained: np.ndarray) -> None:
    """Raise where a piece of the body can move rigidly (collective, on all ranks alike).

    Args:
        particles, families: of the whole body.
        constrained: (owned, dim) mask of prescribed displacements.

    Raises:
        InputError: naming the piece and its free motion.
    """
    holds = _Holds(particles, pieces(particles, families)[: particles.owned], constrained)
    if len(holds.loose):
        share = np.abs(holds.motion)
        turns = np.flatnonzero(
            share[particles.dim :] > 1e-6
        )  # a rotation about any point contains one about the centre
        motion = holds.names[particles.dim + int(turns[0]) if len(turns) else int(share.argmax())]
        first, several = holds.loose[0], len(holds.counts) > 1
        where = ", ".join(f"{x:g}" for x in holds.centre[first])
        what = f"a piece of {int(holds.counts[first])} particles around ({where})" if several else "the body"
        raise InputError(
            f"load: {what} is not held: {motion} meets no prescribed displacement; hold it with [[load]] of kind "
            "displacement"
            + (", remove the piece with body.keep, or move the crack that cuts it off" if several else "")
        )


def loose_pieces(particles: Particles, piece: np.ndarray, constrained: np.ndarray) -> np.ndarray:
    """Mask of the owned particles in pieces that can move rigidly (collective).

    Args:
        particles: of the whole body.
        piece: (owned,) which one each belongs to, as `pieces` says.
        constrained: (owned, dim) mask of prescribed displacements.
    """
    holds = _Holds(particles, piece, constrained)
    return np.isin(holds.number, holds.loose)


class _Holds:
    """What constraints leave to the pieces of a body.

    For every piece that bonds hold together, the rigid motions m_k (translations, rotations about its centre) are
    looked at on its constrained entries c: the Gram matrix sum_c m_k(c) m_l(c) is singular if a combination of them
    moves no constrained entry.

    Attributes:
        number: (owned,) of each particle's piece; `counts`, `centre`: of the pieces.
        loose: numbers of the pieces that can move; `motion`: of the first, in terms of the motions called `names`.
    """

    def __init__(self, particles: Particles, piece: np.ndarray, constrained: np.ndarray):
        mpi, n = particles.comm.tompi4py(), particles.owned
        heads = np.unique(np.concatenate(mpi.allgather(np.unique(piece))))
        self.number = np.searchsorted(heads, piece)
        X = particles.position[:n]
        sums = np.stack([np.bincount(self.number, values, len(heads)) for values in (*X.T, np.ones(n))], axis=1)
        sums = mpi.allreduce(sums)
        self.counts, self.centre = sums[:, -1], sums[:, :-1] / sums[:, -1:]
        arms = X - self.centre[self.number]
        size = max(mpi.allreduce(float(np.abs(arms).max(initial=0.0)), MPI.MAX), 1e-300)
        some = np.flatnonzero(constrained.any(axis=1))
        modes, self.names = rigid_motions(arms[some] / size)
        gram = np.zeros((len(heads), len(self.names), len(self.names)))
        _add_products(self.number[some], np.where(constrained[some, :, None], modes, 0.0), gram)
        values, vectors = np.linalg.eigh(mpi.allreduce(gram))
        self.loose = np.flatnonzero(values[:, 0] <= SMALLEST_HOLD * np.maximum(values[:, -1], 1.0))
        self.motion = vectors[self.loose[:1], :, 0].ravel()


def check_resistance(particles: Particles, materials: list, constrained: np.ndarray) -> None:
    """Warn of particles around which no family resists every strain, and refuse a body of nothing else (collective).

    Args:
        particles: of the whole body.
        materials: with `families` and `resists_strain()`.
        constrained: (owned, dim) mask of prescribed displacements.

    Raises:
        InputError: no family of the body resists, and no constraint of single components may hold it.
    """
    mpi, n = particles.comm.tompi4py(), particles.owned
    around = np.zeros(particles.local)
    for material in materials:
        families, resists = material.families, material.resists_strain()
        around[families.center] += resists
        _add_to_neighbours(families.offsets, families.neighbours, resists, around)
    around = particles.exchange.reverse_add(around)[:n]
    loose = np.flatnonzero((around == 0) & ~constrained.all(axis=1))
    first = (int(particles.id[loose[0]]), tuple(particles.position[loose[0]])) if len(loose) else (np.inf, ())
    count = mpi.allreduce(len(loose))
    if not count:
        return
    where = ", ".join(f"{x:g}" for x in min(mpi.allgather(first))[1])
    whole = mpi.allreduce(float(around.sum())) == 0
    partly = mpi.allreduce(int((constrained.any(axis=1) & ~constrained.all(axis=1)).sum()))
    text = (
        f"material: the bonds around {count} particles, the first at ({where}), do not resist every strain, because "
        "they are too few or lie along the axes alone, so that they may be a mechanism; enlarge the horizon to more "
        "than 1.42 spacings or add rows of particles"
    )
    if whole and not partly:
        raise InputError(text)
    warn(mpi, text)


def rigid_motions(X: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Displacements (n, dim, motions) of translations and of rotations about the origin, and their names."""
    dim = X.shape[1]
    modes, names = [], []
    for k in range(dim):
        modes.append(np.broadcast_to(np.eye(dim)[k], X.shape))
        names.append(f"a translation along {'xyz'[k]}")
    for a in range(dim):
        for b in range(a + 1, dim):
            mode = np.zeros(X.shape)
            mode[:, a], mode[:, b] = -X[:, b], X[:, a]
            modes.append(mode)
            names.append(f"a rotation in the {'xyz'[a]}{'xyz'[b]} plane")
    return np.stack(modes, axis=-1), names


def pieces(particles: Particles, families: Families) -> np.ndarray:
    """For every local particle the lowest id of the piece, connected by bonds, that it belongs to (collective)."""
    mpi, exchange = particles.comm.tompi4py(), particles.exchange
    label = particles.id.astype(np.int64)
    head = _connect(families.center, families.offsets, families.neighbours, particles.local)
    while True:
        before = label.copy()
        np.minimum.at(label, head, before)
        label = label[head]
        exchange.forward(exchange.reverse_minimum(label))
        if not mpi.allreduce(int(np.any(label != before))):
            return label


@njit(cache=True)
def _connect(center, offsets, neighbours, particles):
    """For every particle the lowest one of those that bonds on this rank connect it with (union and find)."""
    head = np.arange(particles)
    for f in range(len(center)):
        i = _find(head, center[f])
        for b in range(offsets[f], offsets[f + 1]):
            if head[neighbours[b]] != i:
                j = _find(head, neighbours[b])
                i, j = min(i, j), max(i, j)
                head[j] = i
    for i in range(particles):
        head[i] = head[head[i]]
    return head


@njit(cache=True)
def _find(head, i):
    """The head of i's piece so far; the way there is made shorter."""
    while head[i] != i:
        head[i] = head[head[i]]
        i = head[i]
    return i


@njit(cache=True)
def _add_to_neighbours(offsets, neighbours, values, out):
    """Add each family's value to all its neighbours."""
    for f in range(len(values)):
        for b in range(offsets[f], offsets[f + 1]):
            out[neighbours[b]] += values[f]


@njit(cache=True)
def _add_products(piece, held, gram):
    """Add each particle's sum over its directions d of held_dk held_dl to its piece."""
    n, dim, motions = held.shape
    for i in range(n):
        for d in range(dim):
            for k in range(motions):
                for l in range(motions):
                    gram[piece[i], k, l] += held[i, d, k] * held[i, d, l]
