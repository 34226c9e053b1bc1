"""The other direction of every bond: what the family of j says of j -> i, where i -> j is looked at."""

import numpy as np
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.exchange import swap
from pdpetsc.particles import Particles


class Opposite:
    """Values of j -> i for every bond i -> j of this rank, wherever the family of j lives.

    Args:
        particles: the distributed particles (collective).
        families: of the owned particles.
    """

    def __init__(self, particles: Particles, families: Families):
        p = particles
        self._mpi, self._neighbours = p.comm.tompi4py(), p.neighbours
        own = np.full(p.local, -1, np.int64)
        own[families.center] = np.arange(len(families))
        center, neighbours = families.per_bond(np.arange(p.local)), families.neighbours
        inside = np.flatnonzero(neighbours < p.owned)
        few = families.bonds < np.iinfo(np.int32).max  # half the memory
        self._here = np.full(families.bonds, -1, np.int32 if few else np.int64)
        self._here[inside] = _find(own[neighbours[inside]], p.id[center[inside]], families, p.id)
        # Bonds to ghosts: their owners are asked by the ids of both ends, once, and answer in the same order for good.
        self._asked, questions = [], []
        for ghosts in p.ghost_ranges:
            bonds = np.flatnonzero((neighbours >= ghosts.start) & (neighbours < ghosts.stop))
            self._asked.append(bonds)
            questions.append(np.stack([p.id[neighbours[bonds]], p.id[center[bonds]]], axis=1).ravel())
        self._answers = []
        for question in swap(self._mpi, self._neighbours, questions, np.int64):
            j, i = question.reshape(-1, 2).T
            self._answers.append(_find(own[np.searchsorted(p.id[: p.owned], j)], i, families, p.id))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values (bonds,) float of the other directions, 0 where there is none (collective)."""
        padded = np.append(values, 0.0)  # -1 is the last
        result = padded[self._here]
        answers = [padded[bonds] for bonds in self._answers]
        for bonds, answer in zip(self._asked, swap(self._mpi, self._neighbours, answers, float)):
            result[bonds] = answer
        return result

    def of_mask(self, mask: np.ndarray) -> np.ndarray:
        """Which bonds (bonds,) have their other direction in a mask of few (collective)."""
        result = np.zeros(len(mask), bool)
        other = self._here[np.flatnonzero(mask)]
        result[other[other >= 0]] = True
        padded = np.append(mask, False)
        answers = [padded[bonds] for bonds in self._answers]
        for bonds, answer in zip(self._asked, swap(self._mpi, self._neighbours, answers, np.int8)):
            result[bonds] = answer > 0
        return result


def _find(families_of_j: np.ndarray, ids_of_i: np.ndarray, families: Families, ids: np.ndarray) -> np.ndarray:
    """Numbers of the bonds j -> i of these families, -1 where there is none."""
    found = np.empty(len(ids_of_i), np.int64)
    _search(families_of_j, ids_of_i, families.offsets, families.neighbours, ids, found)
    return found


@njit(cache=True)
def _search(family, wanted, offsets, neighbours, ids, found):
    """By halves: the bonds of a family are in the order of the ids."""
    for k in range(len(family)):
        found[k] = -1
        if family[k] < 0:
            continue
        low, high = offsets[family[k]], offsets[family[k] + 1]
        while low < high:
            middle = (low + high) // 2
            if ids[neighbours[middle]] < wanted[k]:
                low = middle + 1
            else:
                high = middle
        if low < offsets[family[k] + 1] and ids[neighbours[low]] == wanted[k]:
            found[k] = low
