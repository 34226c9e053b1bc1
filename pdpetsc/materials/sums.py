"""Compiled sums over families that need no model: moments of bonds, scaled bonds, pairs of springs as one."""

import numpy as np
from numba import njit

from pdpetsc.materials.families import FAST


@njit(cache=True, **FAST)
def weighted_moments(D, X, center, offsets, neighbours, weight, volume, vectors, moments):
    """Add sum w beta V_j (vectors_j - vectors_i) (x) xi to the moments of each family; with X for the vectors, the
    shape tensor K = sum w beta V_j xi (x) xi (seed 004 Eq. 3.19)."""
    dim = len(D)
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            w = weight[b] * volume[j]
            for p in range(dim):
                for q in range(dim):
                    moments[f, p, q] += w * (vectors[j, p] - vectors[i, p]) * (X[j, q] - X[i, q])


@njit(cache=True, **FAST)
def scale_to(D, X, center, offsets, neighbours, values, power, total):
    """Scale the bonds' values of each family in place to sum values |xi|^power = total (of each family); zeros stay."""
    for f in range(len(center)):
        i, sum = center[f], 0.0
        for b in range(offsets[f], offsets[f + 1]):
            square = 0.0
            for p in range(len(D)):
                square += (X[neighbours[b], p] - X[i, p]) ** 2
            sum += values[b] * square ** (0.5 * power)
        for b in range(offsets[f], offsets[f + 1]):
            if values[b] != 0.0:
                values[b] *= total[f] / sum


@njit(cache=True, **FAST)
def stretch_moments(D, X, center, offsets, neighbours, values, power, moments):
    """Add to the moments (families, dim) the sums of values e^power, e = xi_p^2/|xi| the extension of a bond by a unit
    strain in direction p."""
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            square = 0.0
            for p in range(len(D)):
                square += (X[neighbours[b], p] - X[i, p]) ** 2
            for p in range(len(D)):
                extension = (X[neighbours[b], p] - X[i, p]) ** 2 / np.sqrt(square)
                moments[f, p] += values[b] * extension**power


@njit(cache=True, **FAST)
def between_ends(D, X, center, offsets, neighbours, factors, result):
    """Fill result (bonds,) with the radius along each bond of the ellipsoid whose half axes are the means of the
    factors (local, dim) of its ends; an end without factors has NaN and takes no part."""
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            square, total = 0.0, 0.0
            for p in range(len(D)):
                xi = X[j, p] - X[i, p]
                axis = factors[i, p]
                if not np.isnan(factors[j, p]):
                    axis = 0.5 * (axis + factors[j, p])
                square += xi * xi
                total += (xi / axis) ** 2
            result[b] = np.sqrt(square / total)


@njit(cache=True)
def fold(own, center, offsets, neighbours):
    """Which springs between two families of the same process can be one: (offsets, neighbours, kept, partner) where the
    family of the lower center keeps bond kept[n] with the other direction partner[n] (-1: there is none), and the other
    one nothing.

    For each particle, in order, a pointer walks along its bonds as the lower ends of its pairs come up; bonds are in
    an order in which the particles of this process ascend.
    """
    families = len(center)
    pointer = offsets[:-1].copy()
    keep = np.ones(len(neighbours), np.bool_)
    other = np.full(len(neighbours), -1, np.int64)
    for i in range(len(own)):
        f = own[i]
        if f < 0:
            continue
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            g = own[j]
            if g < 0 or j < i:
                continue
            n = pointer[g]
            while n < offsets[g + 1] and (own[neighbours[n]] < 0 or neighbours[n] < i):
                n += 1
            pointer[g] = n
            if n < offsets[g + 1] and neighbours[n] == i:
                other[b] = n
                keep[n] = False
    new_offsets = np.zeros(families + 1, np.int64)
    n = 0
    for f in range(families):
        for b in range(offsets[f], offsets[f + 1]):
            n += keep[b]
        new_offsets[f + 1] = n
    return new_offsets, neighbours[keep], np.flatnonzero(keep), other[keep]


@njit(cache=True)
def folded(center, offsets, neighbours, kept, partner, volume, k):
    """k_ij + V_j k_ji / V_i of each pair that `fold` has kept, which with its V_i is the stiffness of the pair."""
    stiffness = np.empty(len(kept))
    for f in range(len(center)):
        for n in range(offsets[f], offsets[f + 1]):
            stiffness[n] = k[kept[n]]
            if partner[n] >= 0:
                stiffness[n] += volume[neighbours[n]] * k[partner[n]] / volume[center[f]]
    return stiffness
