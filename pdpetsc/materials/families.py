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
    slope: np.ndarray  # (largest,) of bonds that soften
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
        np.empty((dim, largest)), np.empty(largest), np.empty(largest), np.empty(largest),
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
    """Fill block[k] (dim, dim), left[k] and right[k] (as long as the material's `mode_sizes` say) with those of bond
    first + k; left may be right where the tangent is symmetric."""


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
def energies(D, data, X, center, offsets, neighbours, volume, u, members, energy):
    """Of the families with these numbers."""
    space = scratch(D, offsets)
    for n in range(len(members)):
        f = members[n]
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        energy[n] = volume[i] * energy_state(D, data, f, first, last - first, space)


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
