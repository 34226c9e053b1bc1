"""What the bonds of a refined body take over from those before: a crack stays open.

A bond a-b has the state of the bond A-B between the particles from which its ends were made, of its own direction where
that was there, of the other else. Parts of one particle are whole. Where A and B did not see each other, the bond is as
the two bonds are that lead from A to B by way of the nearest particle to b that A saw: broken if one of them is.
"""

import numpy as np
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.particles import Particles


def inherited(
    p: Particles, families: Families, before: tuple[np.ndarray, np.ndarray, np.ndarray], listed: np.ndarray,
    tolerance: float,
) -> np.ndarray:  # fmt: skip
    """The value of each bond, (bonds,), 0 where it takes over none.

    Args:
        p: the refined body.
        families: of its owned particles.
        before: ids, positions and horizons that the local particles, or those from which they were made, had before.
        listed: (n, 3) ids of both ends and value of each directed bond of all ranks that had one, in the former body.
        tolerance: of horizons.
    """
    values = np.zeros(families.bonds)
    if len(listed):
        id, position, horizon = before
        size = int(max(id.max(initial=0), listed[:, :2].max())) + 1
        keys = listed[:, 0].astype(np.int64) * size + listed[:, 1].astype(np.int64)
        order = np.argsort(keys)
        touched = np.isin(id, listed[:, :2].astype(np.int64))
        _inherit(
            families.center, families.offsets, families.neighbours, p.position, id.astype(np.int64), position,
            horizon * (1 + tolerance), touched, keys[order], listed[order, 2].astype(float), size, values,
        )  # fmt: skip
    return values


@njit(cache=True)
def _inherit(center, offsets, neighbours, X, id, Y, reach, touched, keys, listed, size, values):
    """Fill the values; Y and reach are positions and horizons before."""
    for f in range(len(center)):
        i = center[f]
        near = touched[i]
        for b in range(offsets[f], offsets[f + 1]):
            near |= touched[neighbours[b]]
        if not near:
            continue
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            if id[i] == id[j]:
                continue
            if _sees(i, j, Y, reach) or _sees(j, i, Y, reach):
                if touched[i] and touched[j]:
                    values[b] = _between(i, j, id, Y, reach, keys, listed, size)
                continue
            nearest, least = -1, np.inf
            for c in range(offsets[f], offsets[f + 1]):
                k = neighbours[c]
                d = 0.0
                for a in range(X.shape[1]):
                    d += (X[k, a] - X[j, a]) ** 2
                if k != j and d < least and (id[k] == id[i] or _sees(i, k, Y, reach) or _sees(k, i, Y, reach)):
                    nearest, least = k, d
            if nearest >= 0:
                first = _between(i, nearest, id, Y, reach, keys, listed, size)
                values[b] = max(first, _between(nearest, j, id, Y, reach, keys, listed, size))


@njit(cache=True)
def _sees(i, j, Y, reach):
    """Whether the former particle of i had that of j in its horizon."""
    d = 0.0
    for a in range(Y.shape[1]):
        d += (Y[j, a] - Y[i, a]) ** 2
    return d <= reach[i] ** 2


@njit(cache=True)
def _between(i, j, id, Y, reach, keys, listed, size):
    """The value of the bond between the former particles of i and j, 0 if there was none."""
    if id[i] == id[j]:
        return 0.0
    key = id[i] * size + id[j] if _sees(i, j, Y, reach) else id[j] * size + id[i]
    place = np.searchsorted(keys, key)
    return listed[place] if place < len(keys) and keys[place] == key else 0.0
