"""Whether zones of small horizons are wide enough for the large horizons around them."""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.bonds import HORIZON_TOLERANCE, Families
from pdpetsc.parallel import warn
from pdpetsc.particles import Particles

SMALLER = 1e-6
"""A horizon is smaller than another when it is so by more than this fraction."""

SLOPE = 0.75
"""Horizons that grow by less than this for each length are a gradual grading, without zones: with horizons of three
spacings, spacings that differ by less than a quarter from one particle to the next."""

ASIDE = 0.3
"""How far from a bond's line, in lengths of the bond, the middle of the smaller horizons around it may lie when the
bond crosses a strip or spot of them. In half a plane it lies at 0.42, in half a space at 0.37, in a corner further."""


class ThinZone(NamedTuple):
    """The worst place where a zone of small horizons is too thin.

    Attributes:
        count: particles of the whole body that see across such a zone.
        position: (dim,) a point in the zone.
        width: of the zone there [length].
        horizon: the larger one of the two particles that see each other across it [length].
    """

    count: int
    position: np.ndarray
    width: float
    horizon: float


def thin_zones(particles: Particles, families: Families) -> ThinZone | None:
    """The worst violation of W > max(delta) / 2, W the width of a zone of smaller horizons (seed 000 Eq. 100).

    A bond xi = X_k - X_i sees across a zone when both its ends have larger horizons than the particle that is nearest
    to its midpoint, steeply so (SLOPE), and the particles with smaller horizons around it lie to both sides of it, or
    to none (ASIDE): a bond that only cuts the corner of a zone has them on one. The zone's width along such a bond is
    W = |xi| - (dx_i + dx_k) / 2, and max(delta_i, delta_k) is the horizon that it must fit.

    Args:
        particles, families: of the whole body (collective).

    Returns:
        The worst place, the same on all ranks and any number of them, or None.
    """
    p = particles
    count, family, bond, score, width = _look(
        families.center, families.offsets, families.neighbours, p.position, p.horizon, p.spacing
    )
    found = (np.inf, -1, -1, None, 0.0, 0.0)
    if count:
        i, k = families.center[family], families.neighbours[bond]
        middle = (p.position[i] + p.position[k]) / 2
        found = (score, int(p.id[i]), int(p.id[k]), middle, width, float(max(p.horizon[i], p.horizon[k])))
    mpi = p.comm.tompi4py()
    count = mpi.allreduce(int(count))
    *_, position, width, horizon = min(mpi.allgather(found), key=lambda entry: entry[:3])
    return ThinZone(count, position, width, horizon) if count else None


def warn_thin_zones(particles: Particles, families: Families) -> None:
    """Say once where a zone of small horizons is too thin (collective)."""
    zone = thin_zones(particles, families)
    if zone:
        where = ", ".join(f"{x:g}" for x in zone.position)
        warn(
            particles.comm,
            f"body: around ({where}) a zone of smaller horizons is only {zone.width:g} wide, no more than half of the "
            f"horizon {zone.horizon:g} beside it, and {zone.count} particles see across such zones, which can make the "
            "solution unstable: widen the zone or lower the ratio of the horizons (seed 000 Eq. 100)",
        )


@njit(cache=True)
def _look(center, offsets, neighbours, X, horizon, spacing):
    """Families that see across a thin zone: their number, then family, bond, score and width of the worst."""
    dim = X.shape[1]
    count = 0
    worst = (-1, -1, np.inf, 0.0)
    low = np.empty(3)
    high = np.empty(3)
    middle = np.empty(3)
    for f in range(len(center)):
        i = center[f]
        smallest = horizon[i]
        for b in range(offsets[f], offsets[f + 1]):
            smallest = min(smallest, horizon[neighbours[b]])
        if smallest >= horizon[i] * (1 - SMALLER):
            continue
        low[:] = np.inf
        high[:] = -np.inf
        for b in range(offsets[f], offsets[f + 1]):  # the box of the smaller horizons
            j = neighbours[b]
            if horizon[j] < horizon[i] * (1 - SMALLER):
                for a in range(dim):
                    low[a] = min(low[a], X[j, a])
                    high[a] = max(high[a], X[j, a])
        seen = False
        for b in range(offsets[f], offsets[f + 1]):
            k = neighbours[b]
            if smallest >= horizon[k] * (1 - SMALLER):
                continue
            square, outside = 0.0, 0.0
            for a in range(dim):
                middle[a] = (X[i, a] + X[k, a]) / 2
                square += (X[k, a] - X[i, a]) ** 2
                outside += max(low[a] - middle[a], middle[a] - high[a], 0.0) ** 2
            larger = max(horizon[i], horizon[k])
            width = np.sqrt(square) - (spacing[i] + spacing[k]) / 2
            if width > larger / 2 * (1 + HORIZON_TOLERANCE) or outside >= square / 4:
                continue
            if not _crosses(i, k, neighbours[offsets[f] : offsets[f + 1]], X, horizon, spacing, middle, square):
                continue
            seen = True
            score = np.rint(2e8 * width / larger)  # rounding errors do not choose the worst
            if score < worst[2]:
                worst = (f, b, score, width)
        count += seen
    return count, worst[0], worst[1], worst[2], worst[3]


@njit(cache=True)
def _crosses(i, k, family, X, horizon, spacing, middle, square):
    """Whether the bond i -> k, of length^2 `square`, crosses a strip or spot of smaller horizons."""
    dim = X.shape[1]
    nearest, distance = i, square / 4
    for j in family:
        d = 0.0
        for a in range(dim):
            d += (X[j, a] - middle[a]) ** 2
        if d < distance:
            nearest, distance = j, d
    least = min(horizon[i], horizon[k]) * (1 - SMALLER)
    if horizon[nearest] >= least:
        return False
    for end in (i, k):
        d = 0.0
        for a in range(dim):
            d += (X[end, a] - X[nearest, a]) ** 2
        if horizon[end] - horizon[nearest] <= SLOPE * np.sqrt(d):
            return False
    weight, along = 0.0, 0.0
    offset = np.zeros(3)  # of the middle of the smaller horizons from the bond's, within |xi| of it, by their volumes
    for j in family:
        d = 0.0
        for a in range(dim):
            d += (X[j, a] - middle[a]) ** 2
        if d <= square and horizon[j] < least:
            size = spacing[j] ** dim
            weight += size
            for a in range(dim):
                offset[a] += size * (X[j, a] - middle[a])
    aside = 0.0
    for a in range(dim):
        along += offset[a] * (X[k, a] - X[i, a])
        aside += offset[a] ** 2
    return aside - along**2 / square <= (ASIDE * weight) ** 2 * square
