"""Compiled loops that put the tangent of families into blocks: diagonal ones, and rows of the assembled tangent."""

import numpy as np
from numba import njit

from pdpetsc.materials.families import FAST, add_modes, element_state, gather_two, mode_block, scratch


@njit(cache=True, inline="always")
def add_block(D, block, V, blocks, k):
    """Add V block to block k."""
    for p in range(len(D)):
        for q in range(len(D)):
            blocks[k, p, q] += V * block[p, q]


@njit(cache=True, **FAST)
def add_diagonal(D, data, tangent, X, center, offsets, neighbours, volume, u, couples, symmetric, L, R, diagonal):
    """Add the tangent's diagonal blocks (particles, dim, dim). The lengths of the
    tuples L and R are those of left and right of a bond, known when this is compiled."""
    dim = len(D)
    space = scratch(D, offsets)
    largest = len(space.a)
    block, left = np.empty((largest, dim, dim)), np.empty((largest, len(L)))
    right = left if symmetric else np.empty((largest, len(R)))
    coupled, left_center, right_center = np.empty((dim, dim)), np.empty(len(L)), np.empty(len(R))
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        V = volume[i]
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        element_state(D, data, tangent, f, first, last - first, space, block, left, right)
        left_center[:] = 0.0
        right_center[:] = 0.0
        for k in range(last - first):
            add_block(D, block[k], V, diagonal, neighbours[first + k])
            add_block(D, block[k], V, diagonal, i)
        if couples:
            for k in range(last - first):
                mode_block(D, data, tangent, f, left[k], right[k], coupled)
                add_block(D, coupled, V, diagonal, neighbours[first + k])
                for p in range(len(L)):
                    left_center[p] -= left[k, p]
                for p in range(len(R)):
                    right_center[p] -= right[k, p]
            mode_block(D, data, tangent, f, left_center, right_center, coupled)
            add_block(D, coupled, V, diagonal, i)


@njit(cache=True, inline="always")
def minus_sum(modes, first, last, center):
    """Fill `center` with minus the sum of the modes of the bonds first ... last - 1."""
    for p in range(len(center)):
        total = 0.0
        for b in range(first, last):
            total += modes[b, p]
        center[p] = -total


@njit(cache=True, **FAST)
def elements(
    D, data, tangent, X, center, offsets, neighbours, u, couples, block, left, right,
    left_center, right_center,
):  # fmt: skip
    """D_b, left_b, right_b of all bonds, and minus their families' sums for the centers."""
    space = scratch(D, offsets)
    for f in range(len(center)):
        first, last = offsets[f], offsets[f + 1]
        gather_two(D, X, u, center[f], first, last, neighbours, space.xi, space.eta)
        element_state(
            D, data, tangent, f, first, last - first, space, block[first:last], left[first:last], right[first:last]
        )
        if couples:
            minus_sum(left, first, last, left_center[f])
            minus_sum(right, first, last, right_center[f])


@njit(cache=True, **FAST)
def add_rows(
    D, data, tangent, center, offsets, neighbours, volume, own, dual_offsets, dual_family, dual_bond,
    block, left, right, left_center, right_center, couples, upper, row_offsets, columns, blocks,
):  # fmt: skip
    """Row by row: the contributions of the row's own family and of every family that contains it.

    `own[a]` is the number of particle a's own family or -1. With `upper`, of each family's element matrix only the
    rows' parts from the diagonal on (center first, then the bonds in their order); `sparsity.symmetrise` adds the rest.
    """
    dim = len(D)
    half = np.empty((dim, dim, dim))
    coupled = np.empty((dim, dim))
    position = np.empty(len(row_offsets) - 1, np.int64)  # block of each column in the current row
    for a in range(len(row_offsets) - 1):
        for k in range(row_offsets[a], row_offsets[a + 1]):
            if columns[k] >= 0:
                position[columns[k]] = k
        diagonal = position[a]
        f = own[a]
        if f >= 0:
            first, last, V = offsets[f], offsets[f + 1], volume[a]
            for b in range(first, last):
                add_block(D, block[b], V, blocks, diagonal)
                add_block(D, block[b], -V, blocks, position[neighbours[b]])
            if couples:
                mode_block(D, data, tangent, f, left_center[f], right_center[f], coupled)
                add_block(D, coupled, V, blocks, diagonal)
                add_modes(
                    D, data, tangent, f, left_center[f], right, first, last, neighbours, position, V, half, blocks
                )
        for k in range(dual_offsets[a], dual_offsets[a + 1]):
            f, bond = dual_family[k], dual_bond[k]
            i, first, last = center[f], offsets[f], offsets[f + 1]
            V = volume[i]
            add_block(D, block[bond], V, blocks, diagonal)
            if not upper:
                add_block(D, block[bond], -V, blocks, position[i])
            if couples:
                if not upper:
                    mode_block(D, data, tangent, f, left[bond], right_center[f], coupled)
                    add_block(D, coupled, V, blocks, position[i])
                first = bond if upper else first
                add_modes(D, data, tangent, f, left[bond], right, first, last, neighbours, position, V, half, blocks)
