"""Families: which particles are bonded to which, found by cells in O(N), and the influence of each bond."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from pdpetsc.errors import InputError

HORIZON_TOLERANCE = 1e-10
"""A family is 0 < |xi| <= delta (1 + 1e-10), where a case has no tolerance of its own (FORMULATION, Notation)."""

Influence = Callable[[np.ndarray], np.ndarray]

INFLUENCE: dict[str, Influence] = {
    "constant": lambda r: np.ones_like(r),
    "inverse": lambda r: 1 / r,
    "linear": lambda r: 1 - r,
    "cubic": lambda r: 1 - 3 * r**2 + 2 * r**3,
    "gaussian": lambda r: np.exp(-((2 * r) ** 2)),
}
"""Influence functions w(r), r = |xi| / delta: 1, 1/r, 1 - r, the cubic spline 1 - 3r^2 + 2r^3 and exp(-(2r)^2)."""


def _linear_partial_volume(length, horizon, spacing):
    """beta = (delta + r - |xi|) / 2r in [0, 1] with r = dx/2 (seed 000 Eq. 81, which prints r = 2 dx)."""
    return np.clip((horizon + spacing / 2 - length) / spacing, 0, 1)


PARTIAL_VOLUME = {"none": lambda length, horizon, spacing: np.ones_like(length), "linear": _linear_partial_volume}
"""Partial-volume factors beta of a neighbour whose cell of width `spacing` is cut by the horizon."""


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
        sums = np.concatenate([[0], np.cumsum(~cut)])
        return Families(self.center, sums[self.offsets], self.neighbours[~cut])

    def subset(self, chosen: np.ndarray) -> "Families":
        """The families with these (ascending) numbers."""
        if len(chosen) == len(self):
            return self
        sizes = np.diff(self.offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        bonds = np.repeat(self.offsets[chosen] - offsets[:-1], sizes) + np.arange(offsets[-1])
        return Families(self.center[chosen], offsets, self.neighbours[bonds])

    def per_bond(self, values: np.ndarray) -> np.ndarray:
        """Values of the families' centers repeated for each of their bonds."""
        return np.repeat(values[self.center], np.diff(self.offsets), axis=0)

    def lengths(self, position: np.ndarray) -> np.ndarray:
        """|xi| of each bond [length]."""
        xi = position[self.neighbours] - self.per_bond(position)
        return np.sqrt((xi**2).sum(axis=1))

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums of the bonds' values over each family."""
        rows = np.repeat(np.arange(len(self)), np.diff(self.offsets))
        return np.bincount(rows, values, len(self))

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
    dim = position.shape[1]
    reach = horizon[:owned] * (1 + tolerance)
    low = position.min(axis=0)
    extent = position.max(axis=0) - low
    # Half the smaller horizons is the quickest width of a cell; never many more cells than particles.
    typical = float(np.quantile(reach, 0.1)) / 2
    sparse = float((np.prod(np.maximum(extent, typical)) / len(position)) ** (1 / dim))
    width = max(typical, sparse)
    counts = np.floor(extent / width).astype(np.int64) + 1
    offsets, neighbours = _search(position, reach, ids.astype(np.int64), owned, low, width, counts)
    return Families(np.arange(owned, dtype=np.int32), offsets, neighbours)


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


def bond_weights(
    families: Families, position: np.ndarray, horizon: np.ndarray, spacing: np.ndarray, influence: Influence,
    partial: str,
) -> np.ndarray:  # fmt: skip
    """Influence times partial-volume factor w beta of each bond [-]; bonds up to the tolerance have w(1) at most.

    Raises:
        InputError: a weight is negative or no number, or all weights of a family are zero.
    """
    length = families.lengths(position)
    delta = families.per_bond(horizon)
    r = np.minimum(length / delta, 1.0)
    weight = influence(r) * PARTIAL_VOLUME[partial](length, delta, spacing[families.neighbours])
    wrong = np.flatnonzero(~((weight >= 0) & (weight < np.inf)))
    if len(wrong):
        raise InputError(
            f"influence: is {weight[wrong[0]]:g} at r = {r[wrong[0]]:g}; it must be finite and not negative"
        )
    without = families.center[np.flatnonzero(families.sums(weight) == 0)]
    if len(without):
        where = ", ".join(f"{x:g}" for x in position[without[0]])
        raise InputError(
            f"influence: is zero at all neighbours of the particle at ({where}), so that no bond holds it; choose "
            "another function or a larger horizon"
        )
    return weight


@njit(cache=True)
def _cells(X, low, width, counts):
    """Particles sorted by cell: (start of each cell, particles)."""
    n, dim = X.shape
    total = 1
    for k in range(dim):
        total *= counts[k]
    cell = np.empty(n, np.int64)
    start = np.zeros(total + 1, np.int64)
    for i in range(n):
        c = 0
        for k in range(dim - 1, -1, -1):
            c = c * counts[k] + min(int((X[i, k] - low[k]) / width), counts[k] - 1)
        cell[i] = c
        start[c + 1] += 1
    for c in range(total):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    members = np.empty(n, np.int32)
    for i in range(n):
        members[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return start, members


@njit(cache=True)
def _search(X, reach, ids, owned, low, width, counts):
    """Two passes over the cells around each owned particle: count, then fill; families sorted by id."""
    dim = X.shape[1]
    start, members = _cells(X, low, width, counts)
    offsets = np.zeros(owned + 1, np.int64)
    neighbours = np.empty(0, np.int32)
    first = np.zeros(3, np.int64)
    last = np.zeros(3, np.int64)
    for filling in range(2):
        if filling == 1:
            for i in range(owned):
                offsets[i + 1] += offsets[i]
            neighbours = np.empty(offsets[owned], np.int32)
        for i in range(owned):
            for k in range(dim):
                first[k] = max(0, int(np.floor((X[i, k] - reach[i] - low[k]) / width)))
                last[k] = min(counts[k] - 1, int((X[i, k] + reach[i] - low[k]) / width))
            found = 0
            limit = reach[i] * reach[i]
            for c2 in range(first[2], last[2] + 1):
                for c1 in range(first[1], last[1] + 1):
                    for c0 in range(first[0], last[0] + 1):
                        cell = c0
                        if dim > 1:
                            cell += counts[0] * c1
                        if dim > 2:
                            cell += counts[0] * counts[1] * c2
                        for p in range(start[cell], start[cell + 1]):
                            j = members[p]
                            square = 0.0
                            for k in range(dim):
                                square += (X[j, k] - X[i, k]) ** 2
                            if 0.0 < square <= limit:
                                if filling == 1:
                                    neighbours[offsets[i] + found] = j
                                found += 1
            if filling == 0:
                offsets[i + 1] = found
            else:
                family = neighbours[offsets[i] : offsets[i + 1]]
                family[:] = family[np.argsort(ids[family])]
    return offsets, neighbours


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
