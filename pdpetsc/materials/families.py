"""Compiled loops over families, the same for every model: forces, tangent, its action and rows, energies.

A family f belongs to the particle i = center[f]; its bonds first = offsets[f] ... last - 1 lead to neighbours[b]. A
model sees one family at a time and never the mesh: the loops here gather its reference bonds xi and relative
displacements eta into contiguous buffers, the model fills the bonds' forces

    t_b = dw_f/deta_b                      `force_state`       w_f the energy per volume V_i of its center
    w_f                                    `energy_state`
    a bound of the terms that cancel       `size_state`

and V_i t_b acts on the neighbour, the opposite on i (seed 002 Eq. 14). The tangent has what each bond feels by itself
and what couples the bonds of a family through a few modes,

    dt_b = D_b deta_b + left_b C_f sum_c right_c deta_c

    what a family remembers of a state     `linearise_state`
    dt of given deta                       `action_state`
    D_b, left_b, right_b                   `element_state`     (right = left where the tangent is symmetric)
    left C right of two vectors            `mode_block`
    the same for one left and many rights  `add_modes`

so that its action costs as much as the forces and nothing is stored per bond. The functions are chosen by the type of
the NamedTuples `data` and `tangent` that hold a model's arrays and parameters (`implements`).

The dimension comes as the length of a tuple D, `dimension(2) = (0, 0)`: that is part of the tuple's type, so numba
compiles the loops for it with fixed bounds, once for all runs. (A factory that closes over the dimension and over other
compiled functions would be compiled again in every process.) Sums over bonds may be reordered for vector instructions
(`FAST`); a family's sums do not depend on the rank, so neither do results.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

FAST = {"error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz", "arcp"}}
"""How loops over bonds are compiled: no checks for divisions by zero, sums in any order; NaN and inf as usual."""

INLINED = FAST | {"forceinline": True, "_nrt": False}
"""A call hands over the buffers' descriptors and counts references, 150 ns for each family."""


def dimension(dim: int) -> tuple[int, ...]:
    """The tuple that stands for a dimension in calls of the kernels."""
    return (0,) * dim


class Scratch(NamedTuple):
    """Buffers of one family. The loops fill xi, eta and (for actions) deta, models fill t; the others they may use as
    they wish. Bonds are the last index."""

    xi: np.ndarray  # (dim, largest family) reference bonds X_j - X_i [length]
    eta: np.ndarray  # (dim, largest) relative displacements u_j - u_i [length]
    deta: np.ndarray  # (dim, largest) their changes
    t: np.ndarray  # (dim, largest) forces [force/volume]
    s: np.ndarray  # (dim, largest)
    a: np.ndarray  # (largest,)
    b: np.ndarray
    H: np.ndarray  # (dim, dim)
    P: np.ndarray
    work: np.ndarray  # (8, 3, 3)


@njit(cache=True)
def largest_family(offsets):
    largest = 0
    for f in range(len(offsets) - 1):
        largest = max(largest, offsets[f + 1] - offsets[f])
    return largest


@njit(cache=True)
def scratch(D, offsets):
    dim, largest = len(D), largest_family(offsets)
    return Scratch(
        np.empty((dim, largest)), np.empty((dim, largest)), np.empty((dim, largest)), np.empty((dim, largest)),
        np.empty((dim, largest)), np.empty(largest), np.empty(largest),
        np.empty((dim, dim)), np.empty((dim, dim)), np.empty((8, 3, 3)),
    )  # fmt: skip


# What a model gives -------------------------------------------------------------------------------------------


def force_state(D, data, f, first, size, space):
    """Fill space.t[:, k] with t of bond first + k [force/volume]; NaN outside the model's domain."""


def energy_state(D, data, f, first, size, space):
    """w_f [energy/volume]."""


def size_state(D, data, f, first, size, space):
    """Fill space.b[k] with the sum of the absolute terms of t of bond first + k, given |u_i| + |u_j| for |eta| in
    space.a."""


def linearise_state(D, data, tangent, f, first, size, space):
    """Fill the parts of `tangent` that belong to family f."""


def action_state(D, data, tangent, f, first, size, space):
    """Fill space.t[:, k] with dt of bond first + k, from space.deta."""


def element_state(D, data, tangent, f, first, size, space, block, left, right):
    """Fill block[k] (dim, dim), left[k] and right[k] (dim,) with those of bond first + k; left may be right."""


def mode_block(D, data, tangent, f, left, right, block):
    """Fill block (dim, dim) with left C_f right."""


def add_modes(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    """Add V left C_f right[b] to blocks[position[neighbours[b]]] for all bonds from `first` to `last`. `half`
    (dim, dim, dim) is scratch."""


IMPLEMENTED = {
    function: {}
    for function in (
        force_state, energy_state, size_state, linearise_state, action_state, element_state, mode_block, add_modes,
    )
}  # fmt: skip


def implements(function, kind: type):
    """Register what is decorated as `function` for data of a NamedTuple type."""

    def register(implementation):
        IMPLEMENTED[function][kind] = implementation
        return implementation

    return register


@overload(force_state, jit_options=INLINED)
def _(D, data, f, first, size, space):
    return IMPLEMENTED[force_state][data.instance_class]


@overload(energy_state, jit_options=INLINED)
def _(D, data, f, first, size, space):
    return IMPLEMENTED[energy_state][data.instance_class]


@overload(size_state, jit_options=INLINED)
def _(D, data, f, first, size, space):
    return IMPLEMENTED[size_state][data.instance_class]


@overload(linearise_state, jit_options=INLINED)
def _(D, data, tangent, f, first, size, space):
    return IMPLEMENTED[linearise_state][data.instance_class]


@overload(action_state, jit_options=INLINED)
def _(D, data, tangent, f, first, size, space):
    return IMPLEMENTED[action_state][data.instance_class]


@overload(element_state, jit_options=INLINED)
def _(D, data, tangent, f, first, size, space, block, left, right):
    return IMPLEMENTED[element_state][data.instance_class]


@overload(mode_block, jit_options=INLINED)
def _(D, data, tangent, f, left, right, block):
    return IMPLEMENTED[mode_block][data.instance_class]


@overload(add_modes, jit_options=INLINED)
def _(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    return IMPLEMENTED[add_modes][data.instance_class]


# The loops ----------------------------------------------------------------------------------------------------


@njit(cache=True, inline="always")
def gather(D, field, i, first, last, neighbours, out):
    """Differences field_j - field_i of the bonds."""
    family = neighbours[first:last]
    for p in range(len(D)):
        own = field[i, p]
        for k in range(len(family)):
            out[p, k] = field[family[k], p] - own


@njit(cache=True, inline="always")
def gather_two(D, field, other, i, first, last, neighbours, out, out_other):
    """The same of two fields at once."""
    family = neighbours[first:last]
    for p in range(len(D)):
        own, own_other = field[i, p], other[i, p]
        for k in range(len(family)):
            j = family[k]
            out[p, k] = field[j, p] - own
            out_other[p, k] = other[j, p] - own_other


@njit(cache=True, inline="always")
def scatter(D, t, i, first, last, neighbours, V, force):
    """Add V t to the neighbours and take it from the center."""
    family = neighbours[first:last]
    for p in range(len(D)):
        total = 0.0
        for k in range(len(family)):
            total += t[p, k]
        force[i, p] -= V * total
    for k in range(len(family)):
        j = family[k]
        for p in range(len(D)):
            force[j, p] += V * t[p, k]


@njit(cache=True, **FAST)
def add_force(D, data, X, center, offsets, neighbours, volume, u, force, begin, end):
    """Forces of the families begin ... end - 1."""
    space = scratch(D, offsets)
    xi, eta, t = space.xi, space.eta, space.t
    for f in range(begin, end):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, u, i, first, last, neighbours, xi, eta)
        force_state(D, data, f, first, last - first, space)
        scatter(D, t, i, first, last, neighbours, volume[i], force)


@njit(cache=True, **FAST)
def add_force_scale(D, data, X, center, offsets, neighbours, volume, u, scale):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather(D, X, i, first, last, neighbours, space.xi)
        own = length(D, u, i)
        for b in range(first, last):
            space.a[b - first] = own + length(D, u, neighbours[b])
        size_state(D, data, f, first, last - first, space)
        for b in range(first, last):
            term = volume[i] * space.b[b - first]
            scale[neighbours[b]] += term
            scale[i] += term


@njit(cache=True)
def length(D, vectors, k):
    """Euclidean norm of vector k."""
    square = 0.0
    for p in range(len(D)):
        square += vectors[k, p] ** 2
    return np.sqrt(square)


@njit(cache=True, **FAST)
def energies(D, data, X, center, offsets, neighbours, volume, u, energy):
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        energy[f] = volume[i] * energy_state(D, data, f, first, last - first, space)


@njit(cache=True, **FAST)
def linearise(D, data, tangent, X, center, offsets, neighbours, u):
    space = scratch(D, offsets)
    for f in range(len(center)):
        first, last = offsets[f], offsets[f + 1]
        gather_two(D, X, u, center[f], first, last, neighbours, space.xi, space.eta)
        linearise_state(D, data, tangent, f, first, last - first, space)


@njit(cache=True, **FAST)
def add_action(D, data, tangent, X, center, offsets, neighbours, volume, u, follows, du, force, begin, end):
    """Action of the families begin ... end - 1. `follows`: whether action_state looks at eta, the state u."""
    space = scratch(D, offsets)
    xi, eta, deta, t = space.xi, space.eta, space.deta, space.t
    for f in range(begin, end):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, du, i, first, last, neighbours, xi, deta)
        if follows:
            gather(D, u, i, first, last, neighbours, eta)
        action_state(D, data, tangent, f, first, last - first, space)
        scatter(D, t, i, first, last, neighbours, volume[i], force)


@njit(cache=True, inline="always")
def add_block(D, block, V, blocks, k):
    """Add V block to block k."""
    for p in range(len(D)):
        for q in range(len(D)):
            blocks[k, p, q] += V * block[p, q]


@njit(cache=True, **FAST)
def add_diagonal(D, data, tangent, X, center, offsets, neighbours, volume, u, couples, symmetric, diagonal):
    """Add the tangent's diagonal blocks (particles, dim, dim)."""
    dim = len(D)
    space = scratch(D, offsets)
    largest = len(space.a)
    block, left = np.empty((largest, dim, dim)), np.empty((largest, dim))
    right = left if symmetric else np.empty((largest, dim))
    coupled, left_center, right_center = np.empty((dim, dim)), np.empty(dim), np.empty(dim)
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
                for p in range(dim):
                    left_center[p] -= left[k, p]
                    right_center[p] -= right[k, p]
            mode_block(D, data, tangent, f, left_center, right_center, coupled)
            add_block(D, coupled, V, diagonal, i)


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
        for p in range(len(D) if couples else 0):
            sum_left, sum_right = 0.0, 0.0
            for b in range(first, last):
                sum_left += left[b, p]
                sum_right += right[b, p]
            left_center[f, p] = -sum_left
            right_center[f, p] = -sum_right


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


@njit(cache=True, **FAST)
def stress_moments(D, data, X, center, offsets, neighbours, u, current, stress):
    """Add sum t (x) x to the stress of each family: with x = xi the first Piola-Kirchhoff stress that is conjugate to
    F, with x = y (`current`) Kirchhoff's (seed 000 section 2.5)."""
    dim = len(D)
    space = scratch(D, offsets)
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        force_state(D, data, f, first, last - first, space)
        for k in range(last - first):
            for q in range(dim):
                x = space.xi[q, k]
                if current:
                    x += space.eta[q, k]
                for p in range(dim):
                    stress[f, p, q] += space.t[p, k] * x


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
    """Scale the bonds' values of each family in place to sum values |xi|^power = total (of each family)."""
    for f in range(len(center)):
        i, sum = center[f], 0.0
        for b in range(offsets[f], offsets[f + 1]):
            square = 0.0
            for p in range(len(D)):
                square += (X[neighbours[b], p] - X[i, p]) ** 2
            sum += values[b] * square ** (0.5 * power)
        for b in range(offsets[f], offsets[f + 1]):
            values[b] *= total[f] / sum


@njit(cache=True)
def folded(own, center, offsets, neighbours, volume, k):
    """Springs between two families of the same process as one: (offsets, neighbours, k) where the family of the lower
    center has k_ij + V_j k_ji / V_i, which with its V_i is the stiffness of the pair, and the other one nothing.

    For each particle, in order, a pointer walks along its bonds as the lower ends of its pairs come up; bonds are in
    an order in which the particles of this process ascend.
    """
    families = len(center)
    pointer = offsets[:-1].copy()
    keep = np.ones(len(neighbours), np.bool_)
    stiffness = k.copy()
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
                stiffness[b] += volume[j] * k[n] / volume[i]
                keep[n] = False
    new_offsets = np.zeros(families + 1, np.int64)
    n = 0
    for f in range(families):
        for b in range(offsets[f], offsets[f + 1]):
            n += keep[b]
        new_offsets[f + 1] = n
    return new_offsets, neighbours[keep], stiffness[keep]
