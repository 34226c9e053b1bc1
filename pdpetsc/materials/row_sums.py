"""Bounds of the row sums of the tangent, family by family, without rows."""

import numpy as np
from numba import njit

from pdpetsc.materials.families import FAST, element_state, gather_two, mode_block, scratch


@njit(cache=True, **FAST)
def add_row_sums(D, data, tangent, X, center, offsets, neighbours, volume, u, couples, symmetric, L, R, sums):
    """Add to `sums` (particles, dim) a bound of sum_b |K_ab| over the families' columns, for each component.

    A family's element matrix has, in the row of bond j, D_j on the diagonal, -D_j for the center and left_j C right_k
    for all bonds k and the center, right_0 = -sum right_k. With C_s = left_j C e_s, e_s the unit vectors of the modes,

        sum_b |K_jb| <= 2 |D_j| + sum_s |C_s| (sum_k |right_ks| + |right_0s|)

    and the row of the center likewise, with all D_j and left_0. The lengths of the tuples L and R are those of left and
    right of a bond, known when this is compiled.
    """
    dim = len(D)
    space = scratch(D, offsets)
    largest = len(space.a)
    block, left = np.empty((largest, dim, dim)), np.empty((largest, len(L)))
    right = left if symmetric else np.empty((largest, len(R)))
    coupled, left_center, total = np.empty((dim, dim)), np.empty(len(L)), np.empty(len(R))
    unit = np.zeros(len(R))
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        V = volume[i]
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        element_state(D, data, tangent, f, first, last - first, space, block, left, right)
        for k in range(last - first):
            for p in range(dim):
                row = 0.0
                for q in range(dim):
                    row += abs(block[k, p, q])
                sums[neighbours[first + k], p] += 2.0 * V * row
                sums[i, p] += 2.0 * V * row
        if not couples:
            continue
        for s in range(len(R)):
            absolute, signed = 0.0, 0.0
            for k in range(last - first):
                absolute += abs(right[k, s])
                signed += right[k, s]
            total[s] = absolute + abs(signed)
        left_center[:] = 0.0
        for k in range(last - first):
            for p in range(len(L)):
                left_center[p] -= left[k, p]
        for k in range(last - first + 1):
            j = i if k == last - first else neighbours[first + k]
            for s in range(len(R)):
                unit[s] = 1.0
                if k == last - first:
                    mode_block(D, data, tangent, f, left_center, unit, coupled)
                else:
                    mode_block(D, data, tangent, f, left[k], unit, coupled)
                unit[s] = 0.0
                for p in range(dim):
                    row = 0.0
                    for q in range(dim):
                        row += abs(coupled[p, q])
                    sums[j, p] += V * total[s] * row
