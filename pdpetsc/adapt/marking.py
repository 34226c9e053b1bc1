"""Which particles are split: those that an indicator marks, their neighbourhood, and what keeps spacings in proportion.

The neighbourhood of a marked particle holds all that it sees and all that see it, so that a crack's tip stays inside
the refined zone (seed 002 section 5.3). A particle is split only together with every coarser one in its neighbourhood:
then no two that have seen each other differ by more than a factor of two. (One at the rim of a coarse horizon may come
to be seen by its parts alone.)
"""

import numpy as np
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.particles import Particles

COARSER = 1e-6
"""Fraction by which a spacing is larger than another where it is larger at all."""


def neighbourhood(p: Particles, families: Families, marked: np.ndarray) -> np.ndarray:
    """Mask (owned,) of the particles that see one of an (owned,) mask or are seen by one (collective)."""
    return _told(p, families, marked, 0.0)


def with_coarser(p: Particles, families: Families, marked: np.ndarray) -> np.ndarray:
    """A mask (owned,) with all particles that must be split, too, for spacings to stay in proportion (collective)."""
    while True:
        more = _told(p, families, marked, 1 + COARSER) & ~marked
        if not p.comm.tompi4py().allreduce(int(more.sum())):
            return marked
        marked = marked | more


def _told(p: Particles, families: Families, marked: np.ndarray, least: float) -> np.ndarray:
    """The particles that share a bond with one of the mask whose spacing times `least` is below theirs."""
    local = np.zeros(p.local)
    local[: p.owned] = marked
    found = np.zeros(p.local)
    bonds = families.center, families.offsets, families.neighbours
    _tell(*bonds, p.exchange.forward(local) > 0, p.spacing, least, found)
    return p.exchange.reverse_add(found)[: p.owned] > 0


@njit(cache=True)
def _tell(center, offsets, neighbours, marked, spacing, least, found):
    """Note the ends of bonds whose other end is marked, where their spacing is above `least` times that one's."""
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            if marked[i] and spacing[j] > least * spacing[i]:
                found[j] = 1.0
            if marked[j] and spacing[i] > least * spacing[j]:
                found[i] = 1.0
