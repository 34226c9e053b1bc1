"""The family element of softened models: bonds fade with their stretch by a factor T (materials/softening.py).

A softened model is the unsoftened one with weights that depend on the bonds, k = k_whole T (here) or w = w_whole T
(softened_gradients.py): its data hold those of the unsoftened model, in whose arrays of bonds the weights of a family
are put just before that family is evaluated. Forces are the gradient of the energy at constant T. What the tangent has
besides that of constant T is

    dk = k_whole dT = slope d.deta,   slope = k_whole T'/(|xi| |y|),  d = y     (linear: T'/|xi|^2, d = xi)
    dt = dk (a + B theta b) d + k b d B sum dk b a |d|^2        (a, b as in ordinary_kernels.extensions)

`PrintedSoftening` is the thesis' form, of any model: T on the bonds' forces alone.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.families import (
    action_state,
    add_modes,
    element_state,
    energy_state,
    force_state,
    implements,
    linearise_state,
    mode_block,
    size_state,
)
from pdpetsc.materials.ordinary_kernels import Extensions, extensions
from pdpetsc.materials.softening import Softening, softened


class SoftenedExtensions(NamedTuple):
    """Data of a softened ordinary model.

    Attributes:
        base: of the unsoftened model; its k is scratch.
        k: stiffness of each bond before it softens [force/length^4].
        softening: of the bonds.
    """

    base: Extensions
    k: np.ndarray
    softening: Softening


class PrintedSoftening(NamedTuple):
    """Data of any model whose forces are t_b = T_b t_b^whole (seed 004 Eq. 6.2).

    Attributes:
        base: data of the unsoftened model.
        softening: of the bonds.
        linear: whether kinematics are linear.
        symmetric: whether the tangent of the unsoftened model is, so that its `right` is `left`.
    """

    base: NamedTuple
    softening: Softening
    linear: bool
    symmetric: bool


class PrintedTangent(NamedTuple):
    """What is remembered of a state: by the unsoftened model, and the forces (bonds, dim) before they soften."""

    base: NamedTuple
    force: np.ndarray


@njit(cache=True, inline="always")
def softened_bond(D, softening, linear, f, first, q, xi, eta):
    """T of bond first + q, and the factor of d.deta in dT."""
    square, along, current = 0.0, 0.0, 0.0
    for p in range(len(D)):
        y = xi[p, q] + eta[p, q]
        square += xi[p, q] * xi[p, q]
        along += xi[p, q] * eta[p, q] if linear else (xi[p, q] + y) * eta[p, q]
        current += y * y
    if linear:
        T, slope = softened(softening, f, first + q, along / square)
        return T, slope / square
    length, reach = np.sqrt(current), np.sqrt(square)
    T, slope = softened(softening, f, first + q, along / (reach * (length + reach)))
    return T, slope / (length * reach) if slope != 0.0 else 0.0  # a bond of no length has no direction


@njit(cache=True, inline="always")
def soften(D, softening, linear, whole, weight, f, first, size, xi, eta, slope):
    """Fill the `weight` of the family's bonds with whole T, and `slope` so that it changes by slope d.deta."""
    for q in range(size):
        T, derivative = softened_bond(D, softening, linear, f, first, q, xi, eta)
        weight[first + q] = whole[first + q] * T
        slope[q] = whole[first + q] * derivative


@njit(cache=True, inline="always")
def unstretch(D, size, eta):
    """eta = 0, with which bonds are as they were committed."""
    for p in range(len(D)):
        for q in range(size):
            eta[p, q] = 0.0


@njit(cache=True, inline="always")
def soften_springs(D, data, f, first, size, space):
    base = data.base
    soften(D, data.softening, base.linear, data.k, base.k, f, first, size, space.xi, space.eta, space.slope)


@implements(force_state, SoftenedExtensions)
def force(D, data, f, first, size, space):
    soften_springs(D, data, f, first, size, space)
    force_state(D, data.base, f, first, size, space)


@implements(energy_state, SoftenedExtensions)
def energy(D, data, f, first, size, space):
    soften_springs(D, data, f, first, size, space)
    return energy_state(D, data.base, f, first, size, space)


@implements(size_state, SoftenedExtensions)
def size(D, data, f, first, size, space):
    unstretch(D, size, space.eta)
    soften_springs(D, data, f, first, size, space)
    size_state(D, data.base, f, first, size, space)


@implements(linearise_state, SoftenedExtensions)
def linearise(D, data, tangent, f, first, size, space):
    soften_springs(D, data, f, first, size, space)
    linearise_state(D, data.base, tangent, f, first, size, space)


@implements(action_state, SoftenedExtensions)
def action(D, data, tangent, f, first, size, space):
    dim, base = len(D), data.base
    xi, eta, d, t, a, b, k, slope = (
        space.xi, space.eta, space.deta, space.t, space.a, space.b, base.k, space.slope
    )  # fmt: skip
    dilates = len(base.B) > 0
    pressure = tangent.pressure[f] if dilates else 0.0
    soften_springs(D, data, f, first, size, space)
    extensions(D, k, dilates, base.s, base.rotation_weighted, base.linear, first, size, xi, eta, t, a, b, space.s)
    stress = 0.0  # what softening adds to dtheta
    for q in range(size):
        along, square = 0.0, 0.0
        for p in range(dim):
            along += t[p, q] * d[p, q]
            square += t[p, q] * t[p, q]
        change = slope[q] * along  # dk
        slope[q] = change * a[q]
        if dilates:
            slope[q] += change * pressure * b[q]
            stress += change * a[q] * b[q] * square
    if dilates:
        stress *= base.B[f]
        for q in range(size):
            slope[q] += stress * k[first + q] * b[q]
    action_state(D, base, tangent, f, first, size, space)
    for p in range(dim):
        for q in range(size):
            t[p, q] += slope[q] * (xi[p, q] if base.linear else xi[p, q] + eta[p, q])


@implements(element_state, SoftenedExtensions)
def element(D, data, tangent, f, first, size, space, block, left, right):
    dim, base = len(D), data.base
    dilates = len(base.B) > 0
    pressure = tangent.pressure[f] if dilates else 0.0
    soften_springs(D, data, f, first, size, space)
    element_state(D, base, tangent, f, first, size, space, block, left, right)
    y, a, b, slope = space.t, space.a, space.b, space.slope  # as `extensions` left them
    for q in range(size):
        square = 0.0
        for p in range(dim):
            square += y[p, q] * y[p, q]
        along = slope[q] * (a[q] + pressure * b[q]) if dilates else slope[q] * a[q]
        for p in range(dim):
            for r in range(dim):
                block[q, p, r] += along * y[p, q] * y[r, q]
            if dilates:
                if not base.rotation_weighted:
                    right[q, p] = left[q, p]
                right[q, p] += slope[q] * a[q] * b[q] * square * y[p, q]


@implements(mode_block, SoftenedExtensions)
def coupling(D, data, tangent, f, left, right, block):
    mode_block(D, data.base, tangent, f, left, right, block)


@implements(add_modes, SoftenedExtensions)
def modes(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    add_modes(D, data.base, tangent, f, left, right, first, last, neighbours, position, V, half, blocks)


# As printed ---------------------------------------------------------------------------------------------------


@implements(force_state, PrintedSoftening)
def printed_force(D, data, f, first, size, space):
    force_state(D, data.base, f, first, size, space)
    for q in range(size):
        T, _ = softened_bond(D, data.softening, data.linear, f, first, q, space.xi, space.eta)
        for p in range(len(D)):
            space.t[p, q] *= T


@implements(energy_state, PrintedSoftening)
def printed_energy(D, data, f, first, size, space):
    return energy_state(D, data.base, f, first, size, space)


@implements(size_state, PrintedSoftening)
def printed_size(D, data, f, first, size, space):
    size_state(D, data.base, f, first, size, space)


@implements(linearise_state, PrintedSoftening)
def printed_linearise(D, data, tangent, f, first, size, space):
    force_state(D, data.base, f, first, size, space)
    for q in range(size):
        for p in range(len(D)):
            tangent.force[first + q, p] = space.t[p, q]
    linearise_state(D, data.base, tangent.base, f, first, size, space)


@implements(action_state, PrintedSoftening)
def printed_action(D, data, tangent, f, first, size, space):
    xi, eta = space.xi, space.eta
    action_state(D, data.base, tangent.base, f, first, size, space)
    for q in range(size):
        T, slope = softened_bond(D, data.softening, data.linear, f, first, q, xi, eta)
        along = 0.0
        for p in range(len(D)):
            along += (xi[p, q] if data.linear else xi[p, q] + eta[p, q]) * space.deta[p, q]
        for p in range(len(D)):
            space.t[p, q] = T * space.t[p, q] + slope * along * tangent.force[first + q, p]


@implements(element_state, PrintedSoftening)
def printed_element(D, data, tangent, f, first, size, space, block, left, right):
    dim, xi, eta = len(D), space.xi, space.eta
    element_state(D, data.base, tangent.base, f, first, size, space, block, left, right)
    for q in range(size):
        T, slope = softened_bond(D, data.softening, data.linear, f, first, q, xi, eta)
        for p in range(dim):
            for r in range(dim):
                direction = xi[r, q] if data.linear else xi[r, q] + eta[r, q]
                block[q, p, r] = T * block[q, p, r] + slope * tangent.force[first + q, p] * direction
            if len(left) > 0:  # the family's bonds are coupled
                if data.symmetric:
                    right[q, p] = left[q, p]
                left[q, p] *= T


@implements(mode_block, PrintedSoftening)
def printed_coupling(D, data, tangent, f, left, right, block):
    mode_block(D, data.base, tangent.base, f, left, right, block)


@implements(add_modes, PrintedSoftening)
def printed_modes(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    add_modes(D, data.base, tangent.base, f, left, right, first, last, neighbours, position, V, half, blocks)
