"""Compiled loops over families, the same for every model: forces, tangent, its action and rows, energies.

A family f belongs to the particle i = center[f]; its bonds first = offsets[f] ... last - 1 lead to neighbours[b]. With
w_f(eta_first, eta_first+1, ...) the energy of a family per volume V_i of its center, a model says

    t_b = dw_f/deta_b                      `force_state`
    w_f                                    `energy_state`
    dt_b = D_b deta_b + modes              `linearise_state` fills a tangent of the model's kind, for `action_state`,
                                           `bond_stiffness` (D_b) and `add_modes` (what couples the bonds of a family)
    a bound of the terms that cancel       `size_state`

and everything else is done here: V_i t_b acts on the neighbour, the opposite on i (seed 002 Eq. 14), and the tangent
follows. The functions are chosen by the type of the NamedTuples `data` and `tangent` that hold a model's arrays and
parameters (`implements`).

The dimension comes as the length of a tuple D, `dimension(2) = (0, 0)`: that is part of the tuple's type, so numba
compiles the loops for it with fixed bounds, once for all runs. (A factory that closes over the dimension and over other
compiled functions would be compiled again in every process.)
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload


def dimension(dim: int) -> tuple[int, ...]:
    """The tuple that stands for a dimension in calls of the kernels."""
    return (0,) * dim


class Scratch(NamedTuple):
    """Memory that `force_state` and its like may use as they wish; `t`, `a` and `b` are as long as the families."""

    t: np.ndarray  # (largest family, dim)
    a: np.ndarray  # (largest family,)
    b: np.ndarray
    H: np.ndarray  # (dim, dim)
    P: np.ndarray
    work: np.ndarray  # (8, 3, 3)


@njit(cache=True)
def scratch(D, offsets):
    dim = len(D)
    largest = 0
    for f in range(len(offsets) - 1):
        largest = max(largest, offsets[f + 1] - offsets[f])
    return Scratch(
        np.empty((largest, dim)), np.empty(largest), np.empty(largest),
        np.empty((dim, dim)), np.empty((dim, dim)), np.empty((8, 3, 3)),
    )  # fmt: skip


# What a model gives -------------------------------------------------------------------------------------------


def force_state(D, data, f, i, first, last, neighbours, u, space):
    """Fill space.t[k] with t of bond first + k [force/volume]; NaN outside the model's domain."""


def energy_state(D, data, f, i, first, last, neighbours, u, space):
    """w_f [energy/volume]."""


def size_state(D, data, f, i, first, last, neighbours, u, space):
    """Fill space.a[k] with the sum of the absolute terms of t of bond first + k, with |u_i| + |u_j| for |eta|."""


def linearise_state(D, data, tangent, f, i, first, last, neighbours, u, space):
    """Fill the parts of `tangent` that belong to family f."""


def action_state(D, tangent, f, i, first, last, neighbours, du, space):
    """Fill space.t[k] with dt of bond first + k."""


def bond_stiffness(D, tangent, b, block):
    """Fill block (dim, dim) with D_b."""


def add_modes(D, tangent, f, b, first, last, neighbours, i, V, position, half, blocks):
    """Add V dt_b/du of what couples the bonds to the blocks position[...] of one row; b < 0: the center's row,
    which is minus the sum of all bonds'. `half` (dim, dim, dim) is scratch."""


IMPLEMENTED = {
    function: {}
    for function in (
        force_state, energy_state, size_state, linearise_state, action_state, bond_stiffness, add_modes,
    )
}  # fmt: skip


def implements(function, kind: type):
    """Register what is decorated as `function` for data (or a tangent) of a NamedTuple type."""

    def register(implementation):
        IMPLEMENTED[function][kind] = implementation
        return implementation

    return register


@overload(force_state)
def _(D, data, f, i, first, last, neighbours, u, space):
    return IMPLEMENTED[force_state][data.instance_class]


@overload(energy_state)
def _(D, data, f, i, first, last, neighbours, u, space):
    return IMPLEMENTED[energy_state][data.instance_class]


@overload(size_state)
def _(D, data, f, i, first, last, neighbours, u, space):
    return IMPLEMENTED[size_state][data.instance_class]


@overload(linearise_state)
def _(D, data, tangent, f, i, first, last, neighbours, u, space):
    return IMPLEMENTED[linearise_state][data.instance_class]


@overload(action_state)
def _(D, tangent, f, i, first, last, neighbours, du, space):
    return IMPLEMENTED[action_state][tangent.instance_class]


@overload(bond_stiffness)
def _(D, tangent, b, block):
    return IMPLEMENTED[bond_stiffness][tangent.instance_class]


@overload(add_modes)
def _(D, tangent, f, b, first, last, neighbours, i, V, position, half, blocks):
    return IMPLEMENTED[add_modes][tangent.instance_class]


# The loops ----------------------------------------------------------------------------------------------------


@njit(cache=True)
def length(D, vectors, k):
    """Euclidean norm of vector k."""
    square = 0.0
    for p in range(len(D)):
        square += vectors[k, p] ** 2
    return np.sqrt(square)


@njit(cache=True)
def scatter(D, t, i, first, last, neighbours, V, force):
    """Add V t to the neighbours and take it from the center."""
    dim = len(D)
    for k in range(last - first):
        j = neighbours[first + k]
        for p in range(dim):
            force[j, p] += V * t[k, p]
            force[i, p] -= V * t[k, p]


@njit(cache=True)
def add_force(D, data, center, offsets, neighbours, volume, u, force):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        force_state(D, data, f, i, first, last, neighbours, u, space)
        scatter(D, space.t, i, first, last, neighbours, volume[i], force)


@njit(cache=True)
def add_force_scale(D, data, center, offsets, neighbours, volume, u, scale):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        size_state(D, data, f, i, first, last, neighbours, u, space)
        for k in range(last - first):
            term = volume[i] * space.a[k]
            scale[neighbours[first + k]] += term
            scale[i] += term


@njit(cache=True)
def energies(D, data, center, offsets, neighbours, volume, u, energy):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        energy[f] = volume[i] * energy_state(D, data, f, i, first, last, neighbours, u, space)


@njit(cache=True)
def linearise(D, data, tangent, center, offsets, neighbours, u):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        linearise_state(D, data, tangent, f, i, first, last, neighbours, u, space)


@njit(cache=True)
def add_action(D, tangent, center, offsets, neighbours, volume, du, force):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        action_state(D, tangent, f, i, first, last, neighbours, du, space)
        scatter(D, space.t, i, first, last, neighbours, volume[i], force)


@njit(cache=True)
def add_block(D, block, V, blocks, plus, minus):
    """Add V block to one block of a row and take it from another."""
    dim = len(D)
    for p in range(dim):
        for q in range(dim):
            blocks[plus, p, q] += V * block[p, q]
            blocks[minus, p, q] -= V * block[p, q]


@njit(cache=True)
def add_rows(
    D, tangent, center, offsets, neighbours, volume, own,
    dual_offsets, dual_family, dual_bond, row_offsets, columns, blocks,
):  # fmt: skip
    """Row by row: the contributions of the row's own family and of every family that contains it.

    `own[a]` is the number of particle a's own family or -1.
    """
    dim = len(D)
    half = np.empty((dim, dim, dim))
    block = np.empty((dim, dim))
    position = np.empty(len(row_offsets) - 1, np.int64)  # block of each column in the current row
    for a in range(len(row_offsets) - 1):
        for k in range(row_offsets[a], row_offsets[a + 1]):
            if columns[k] >= 0:
                position[columns[k]] = k
        f = own[a]
        if f >= 0:
            first, last, V = offsets[f], offsets[f + 1], volume[a]
            add_modes(D, tangent, f, -1, first, last, neighbours, a, V, position, half, blocks)
            for b in range(first, last):
                bond_stiffness(D, tangent, b, block)
                add_block(D, block, V, blocks, position[a], position[neighbours[b]])
        for k in range(dual_offsets[a], dual_offsets[a + 1]):
            f, bond = dual_family[k], dual_bond[k]
            i, first, last = center[f], offsets[f], offsets[f + 1]
            V = volume[i]
            add_modes(D, tangent, f, bond, first, last, neighbours, i, V, position, half, blocks)
            bond_stiffness(D, tangent, bond, block)
            add_block(D, block, V, blocks, position[a], position[i])


@njit(cache=True)
def stress_moments(D, data, center, offsets, neighbours, x, u, stress):
    """Add sum t (x) (x_j - x_i) to the stress of each family: with x = X the first Piola-Kirchhoff stress that is
    conjugate to F, with x = X + u Kirchhoff's (seed 000 section 2.5)."""
    dim = len(D)
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        force_state(D, data, f, i, first, last, neighbours, u, space)
        for k in range(last - first):
            j = neighbours[first + k]
            for p in range(dim):
                for q in range(dim):
                    stress[f, p, q] += space.t[k, p] * (x[j, q] - x[i, q])


@njit(cache=True)
def weighted_moments(D, center, offsets, neighbours, X, weight, vectors, moments):
    """Add sum weight (vectors_j - vectors_i) (x) xi to the moments of each family; with X for the vectors, the shape
    tensor K = sum w beta V_j xi (x) xi (seed 004 Eq. 3.19). `weight` contains the volumes."""
    dim = len(D)
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            for p in range(dim):
                for q in range(dim):
                    moments[f, p, q] += weight[b] * (vectors[j, p] - vectors[i, p]) * (X[j, q] - X[i, q])
