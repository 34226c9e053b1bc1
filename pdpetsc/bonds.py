"""Families: who is bonded to whom, found in O(N)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit

from pdpetsc.errors import InputError

HORIZON_TOLERANCE = 1e-10
"""A family is 0 < |xi| <= delta (1 + 1e-10), where a case has no tolerance of its own (FORMULATION, Notation)."""

BLOCK = 1024
"""Families whose bonds are looked at together."""


@dataclass(frozen=True)
class Families:
    """Families H_i = {j : 0 < |X_j - X_i| <= delta_i (1 + 1e-10)} in compressed rows.

    Attributes:
        center: (n,) local index of the particle i that owns each family.
        offsets: (n + 1,) int64; the bonds of family f are offsets[f] ... offsets[f + 1].
        neighbours: int32 local index j of each bond, in the order of the particles' ids.
    """

    center: np.ndarray
    offsets: np.ndarray
    neighbours: np.ndarray

    def __len__(self) -> int:
        return len(self.center)

    @property
    def bonds(self) -> int:
        """Number of directed bonds."""
        return len(self.neighbours)

    def without(self, cut: np.ndarray) -> "Families":
        """The families less the bonds of a mask."""
        if not cut.any():
            return self
        kept = ~cut
        return Families(self.center, _offsets(self.sums(kept)), self.neighbours[kept])

    def subset(self, chosen: np.ndarray) -> "Families":
        """The families with these (ascending) numbers."""
        if len(chosen) == len(self):
            return self
        sizes = np.diff(self.offsets)
        kept = np.zeros(len(self), bool)
        kept[chosen] = True
        return Families(self.center[kept], _offsets(sizes[kept]), self.neighbours[np.repeat(kept, sizes)])

    def interior_first(self, owned: int) -> tuple["Families", int]:
        """The families that contain owned particles only, then those with ghosts, and how many the first are: they can
        be evaluated while ghosts are on their way."""
        inside = _inside(self.offsets, self.neighbours, owned)
        if inside.all():
            return self, len(self)
        order = np.argsort(~inside, kind="stable")
        neighbours = np.empty_like(self.neighbours)
        offsets = _offsets(np.diff(self.offsets)[order])
        _reorder(order, self.offsets, self.neighbours, offsets, neighbours)
        return Families(self.center[order], offsets, neighbours), int(inside.sum())

    def blocks(self) -> Iterator[tuple["Families", slice]]:
        """Some consecutive families at a time and the slice of their bonds, for what would take much memory at once."""
        for first in range(0, len(self), BLOCK):
            offsets = self.offsets[first : first + BLOCK + 1]
            bonds = slice(int(offsets[0]), int(offsets[-1]))
            yield Families(self.center[first : first + BLOCK], offsets - offsets[0], self.neighbours[bonds]), bonds

    def per_bond(self, values: np.ndarray) -> np.ndarray:
        """Values of the families' centers repeated for each of their bonds."""
        return np.repeat(values[self.center], np.diff(self.offsets), axis=0)

    def lengths(self, position: np.ndarray) -> np.ndarray:
        """|xi| of each bond [length]."""
        length = np.empty(self.bonds)
        _lengths(self.center, self.offsets, self.neighbours, position, length)
        return length

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums of the bonds' values over each family."""
        return _sums(self.offsets, values)

    def dual(self, particles: int) -> "DualFamilies":
        """The families turned round: for each local particle, the families that contain it."""
        return DualFamilies(*_dual(self.offsets, self.neighbours, particles))


@dataclass(frozen=True)
class DualFamilies:
    """Dual horizons H'_j = {i : j in H_i} (seed 002 Eq. 8) of all local particles, in compressed rows.

    Attributes:
        offsets: (local + 1,) int64.
        family: int32 number of each family that contains the particle.
        bond: int64 number of the bond by which it does.
    """

    offsets: np.ndarray
    family: np.ndarray
    bond: np.ndarray


def find_families(
    position: np.ndarray, horizon: np.ndarray, ids: np.ndarray, owned: int, tolerance: float = HORIZON_TOLERANCE
) -> Families:
    """Families of the first `owned` particles among all given ones (owned, then ghosts)."""
    if not owned:
        return Families(np.empty(0, np.int32), np.zeros(1, np.int64), np.empty(0, np.int32))
    # Particles are looked at in the order of their ids, in which the members of a family then nearly come.
    order = np.argsort(ids, kind="stable").astype(np.int32)
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    X = np.zeros((len(order), 3))
    X[:, : position.shape[1]] = position[order]
    reach = horizon[:owned] * (1 + tolerance)
    counts, width = _cell_sizes(position, reach)
    place = (X - X.min(axis=0)) / width
    start, members = _cells(place, counts)
    centers, buffer = number[:owned], np.empty(len(X), np.int32)
    sizes, neighbours = [], []
    for first in range(0, owned, BLOCK):
        block = slice(first, first + BLOCK)
        size, found = _search(centers[block], reach[block], X, place, start, members, counts, width, buffer)
        sizes.append(size)
        neighbours.append(order[found])
    return Families(np.arange(owned, dtype=np.int32), _offsets(np.concatenate(sizes)), np.concatenate(neighbours))


def _offsets(sizes: np.ndarray) -> np.ndarray:
    """Offsets of compressed rows of these sizes."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes, dtype=np.int64)])


def _cell_sizes(position: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, float]:
    """Numbers of cells in x, y and z, about as many as particles, and their width.

    On a lattice of one spacing a row of cells has one row of particles at most: they come in the order of their ids.
    """
    dim = position.shape[1]
    extent = np.ptp(position, axis=0)
    thick = np.maximum(extent, np.quantile(reach, 0.1) / 2)
    width = float((np.prod(thick) / len(position)) ** (1 / dim))
    counts = np.ones(3, np.int64)
    counts[:dim] += np.floor(extent / width).astype(np.int64)
    return counts, width


def check_not_lonely(families: Families, position: np.ndarray, horizon: np.ndarray) -> None:
    """Raise where a particle has no bond.

    Raises:
        InputError: naming the first such particle.
    """
    lonely = families.center[np.flatnonzero(np.diff(families.offsets) == 0)]
    if len(lonely):
        where = ", ".join(f"{x:g}" for x in position[lonely[0]])
        raise InputError(
            f"body.horizon: the particle at ({where}) has no neighbour within its horizon of "
            f"{horizon[lonely[0]]:g}; enlarge the horizon, remove isolated particles with body.keep, or move the cracks"
        )


@njit(cache=True)
def _lengths(center, offsets, neighbours, X, length):
    """Write |X_j - X_i| of each bond."""
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            square = 0.0
            for k in range(X.shape[1]):
                square += (X[neighbours[b], k] - X[i, k]) ** 2
            length[b] = np.sqrt(square)


@njit(cache=True)
def _sums(offsets, values):
    """Sum of the bonds' values over each family."""
    sums = np.zeros(len(offsets) - 1)
    for f in range(len(sums)):
        for b in range(offsets[f], offsets[f + 1]):
            sums[f] += values[b]
    return sums


@njit(cache=True)
def _cells(place, counts):
    """Points sorted by cell, x fastest: (start of each cell, points)."""
    cell = np.empty(len(place), np.int64)
    start = np.zeros(counts.prod() + 1, np.int64)
    for i in range(len(place)):
        cell[i] = (int(place[i, 2]) * counts[1] + int(place[i, 1])) * counts[0] + int(place[i, 0])
        start[cell[i] + 1] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    members = np.empty(len(place), np.int32)
    for i in range(len(place)):
        members[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return start, members


@njit(cache=True)
def _search(centers, reach, X, place, start, members, counts, width, buffer):
    """Sizes of the families of these points, and their members, ascending, one family after the other."""
    sizes = np.empty(len(centers), np.int64)
    found = np.empty(0, np.int32)
    end = 0
    for f in range(len(centers)):
        size = _family(centers[f], reach[f], X, place, start, members, counts, width, buffer)
        _sort(buffer, size)
        sizes[f] = size
        if end + size > len(found):
            larger = np.empty(2 * len(found) + size * (len(centers) - f), np.int32)
            larger[:end] = found[:end]
            found = larger
        for b in range(size):
            found[end + b] = buffer[b]
        end += size
    return sizes, found[:end]


@njit(cache=True)
def _family(i, reach, X, place, start, members, counts, width, family):
    """Write the points within reach of point i, and give their number.

    What a sphere a little larger covers of a row of cells, x fastest, is one range of `members`.
    """
    x, y, z = X[i, 0], X[i, 1], X[i, 2]
    u, v, w = place[i, 0], place[i, 1], place[i, 2]
    limit = reach * reach
    radius = reach / width + 1e-6
    size = 0
    for c2 in range(int(max(w - radius, 0.0)), int(min(w + radius, counts[2] - 1.0)) + 1):
        square = radius**2 - max(c2 - w, w - c2 - 1, 0.0) ** 2
        half = np.sqrt(max(square, 0.0))
        for c1 in range(int(max(v - half, 0.0)), int(min(v + half, counts[1] - 1.0)) + 1):
            chord = np.sqrt(max(square - max(c1 - v, v - c1 - 1, 0.0) ** 2, 0.0))
            row = (c2 * counts[1] + c1) * counts[0]
            first = start[row + int(max(u - chord, 0.0))]
            last = start[row + int(min(u + chord, counts[0] - 1.0)) + 1]
            for k in range(first, last):
                j = members[k]
                family[size] = j  # the next one overwrites it unless it counts
                size += 0.0 < (X[j, 0] - x) ** 2 + (X[j, 1] - y) ** 2 + (X[j, 2] - z) ** 2 <= limit
    return size


@njit(cache=True)
def _sort(values, size):
    """Bring the first values into ascending order: by insertion, the quickest for few or nearly ordered ones."""
    moves = 32 * size
    for b in range(1, size):
        value = values[b]
        k = b
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
        moves -= b - k
        if moves < 0:
            values[:size].sort()
            return


@njit(cache=True)
def _inside(offsets, neighbours, owned):
    """Whether all members of each family are below `owned`."""
    inside = np.ones(len(offsets) - 1, np.bool_)
    for f in range(len(inside)):
        for b in range(offsets[f], offsets[f + 1]):
            if neighbours[b] >= owned:
                inside[f] = False
                break
    return inside


@njit(cache=True)
def _reorder(order, offsets, neighbours, new_offsets, new_neighbours):
    for f in range(len(order)):
        first, last = offsets[order[f]], offsets[order[f] + 1]
        new_neighbours[new_offsets[f] : new_offsets[f + 1]] = neighbours[first:last]


@njit(cache=True)
def _dual(offsets, neighbours, particles):
    starts = np.zeros(particles + 1, np.int64)
    for j in neighbours:
        starts[j + 1] += 1
    for p in range(particles):
        starts[p + 1] += starts[p]
    fill = starts[:-1].copy()
    family = np.empty(len(neighbours), np.int32)
    bond = np.empty(len(neighbours), np.int64)
    for f in range(len(offsets) - 1):
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            family[fill[j]] = f
            bond[fill[j]] = b
            fill[j] += 1
    return starts, family, bond
