"""The family element of bond-based and ordinary state-based models, all quadratic in the extensions of the bonds:

    w = 1/2 B theta^2 + 1/2 sum k e^2,   theta = sum k s Lambda e,   t = (B theta k s Lambda + k e) n

with e = |y| - |xi|, n = y/|y|, a stiffness k of each bond that holds the neighbour's volume and weight, a modulus B of
each family, and s = |xi| or a number of each bond's own, up to a factor of the family that is in B. Lambda = 1, or the
cosine n . xi/|xi| of the bond's rotation with which seed 000 Eq. 32-34 weighs the dilatation (t is then no gradient,
and the tangent unsymmetric). Linear kinematics have e = xi.eta/|xi| and n = xi/|xi| (seed 003 Eq. 17, 20).

e is computed as (2 xi.eta + eta.eta)/(|y| + |xi|), which keeps all digits of small strains.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload

from pdpetsc.materials.families import (
    FAST,
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

SMALLEST_PIVOT = 1e-6
"""Share of the trace below which a family does not resist some strain."""


class Extensions(NamedTuple):
    """Data of an ordinary model.

    Attributes:
        k: stiffness of each bond [force/length^4].
        B: modulus of each family's dilatation, of length 0 where there is none.
        s: of each bond; None where it is |xi|, or there is no dilatation.
        rotation_weighted: whether Lambda is the cosine, not 1.
        linear: whether kinematics are linear.
    """

    k: np.ndarray
    B: np.ndarray
    s: np.ndarray | None
    rotation_weighted: bool
    linear: bool


class ExtensionTangent(NamedTuple):
    """What a family remembers of the state: pressure = B theta, of length 0 where there is no dilatation."""

    pressure: np.ndarray


def lever(s, bond, length):
    """s of a bond of this length. Two functions and not a branch: s is known when the loops are compiled."""


@overload(lever, inline="always")
def _(s, bond, length):
    if isinstance(s, types.NoneType):
        return lambda s, bond, length: length
    return lambda s, bond, length: s[bond]


@njit(cache=True, inline="always")
def extensions(D, k, dilates, given, weighted, linear, first, size, xi, eta, y, a, b, s):
    """Fill y with vectors along the bonds (y, or xi in linear kinematics), a with e/|y| and, with a dilatation, b with
    s Lambda/|y|, so that t = k (a + B theta b) y; return theta. `given` is the s of the data, s is scratch."""
    dim = len(D)
    theta = 0.0
    if linear:
        for q in range(size):
            square, along = 0.0, 0.0
            for p in range(dim):
                y[p, q] = xi[p, q]
                square += xi[p, q] * xi[p, q]
                along += xi[p, q] * eta[p, q]
            a[q] = along / square
            if dilates:
                b[q] = lever(given, first + q, np.sqrt(square)) / np.sqrt(square)
                theta += k[first + q] * b[q] * along
        return theta
    length = s[0]  # |y|
    for q in range(size):  # no branches in here
        square, change, current = 0.0, 0.0, 0.0
        for p in range(dim):
            x = xi[p, q]
            z = x + eta[p, q]
            square += x * x
            change += (x + z) * eta[p, q]
            current += z * z
            y[p, q] = z
        xi_length, y_length = np.sqrt(square), np.sqrt(current)
        inverse = 1.0 / (y_length * (y_length + xi_length))  # y = 0 has no direction: 0 times inf below
        a[q] = change * inverse
        b[q] = lever(given, first + q, xi_length) * (y_length + xi_length) * inverse
        length[q] = y_length
    if not dilates:
        return theta
    if weighted:
        for q in range(size):
            square, along = 0.0, 0.0
            for p in range(dim):
                square += xi[p, q] * xi[p, q]
                along += xi[p, q] * y[p, q]
            b[q] *= along / (np.sqrt(square) * length[q])
    for q in range(size):
        theta += k[first + q] * b[q] * a[q] * length[q] * length[q]
    return theta


@implements(force_state, Extensions)
def force(D, data, f, first, size, space):
    k, B, t, a, b = data.k, data.B, space.t, space.a, space.b
    dilates = len(B) > 0
    theta = extensions(
        D, k, dilates, data.s, data.rotation_weighted, data.linear, first, size, space.xi, space.eta, t, a, b,
        space.s,
    )  # fmt: skip
    if dilates:
        pressure = B[f] * theta
        for q in range(size):
            a[q] += pressure * b[q]
    for q in range(size):
        a[q] *= k[first + q]
    for p in range(len(D)):
        for q in range(size):
            t[p, q] *= a[q]


@implements(energy_state, Extensions)
def energy(D, data, f, first, size, space):
    k, B, y, a = data.k, data.B, space.t, space.a
    dilates = len(B) > 0
    theta = extensions(
        D, k, dilates, data.s, data.rotation_weighted, data.linear, first, size, space.xi, space.eta, y, a,
        space.b, space.s,
    )  # fmt: skip
    w = 0.5 * B[f] * theta * theta if dilates else 0.0
    for q in range(size):
        square = 0.0
        for p in range(len(D)):
            square += y[p, q] ** 2
        w += 0.5 * k[first + q] * a[q] ** 2 * square
    return w


@implements(size_state, Extensions)
def size(D, data, f, first, size, space):
    k, B, xi, a, b = data.k, data.B, space.xi, space.a, space.b
    theta = 0.0
    for q in range(size):
        b[q] = k[first + q] * a[q]
        if len(B) > 0:
            square = 0.0
            for p in range(len(D)):
                square += xi[p, q] ** 2
            a[q] = lever(data.s, first + q, np.sqrt(square))
            theta += b[q] * a[q]
    if len(B) > 0:
        for q in range(size):
            b[q] += abs(B[f]) * theta * k[first + q] * a[q]


@implements(linearise_state, Extensions)
def linearise(D, data, tangent, f, first, size, space):
    if len(data.B) > 0:
        theta = extensions(
            D, data.k, True, data.s, data.rotation_weighted, data.linear, first, size, space.xi, space.eta,
            space.t, space.a, space.b, space.s,
        )  # fmt: skip
        tangent.pressure[f] = data.B[f] * theta


# With theta fixed dt = k n (n.deta) + tau (I - n n) deta + B theta k s n dLambda, tau = k (e + B theta s Lambda)/|y|,
# dLambda = turn.deta, turn = (xi/|xi| - Lambda n)/|y|; and dtheta = sum k s (Lambda n + e turn).deta.


@implements(action_state, Extensions)
def action(D, data, tangent, f, first, size, space):
    dim = len(D)
    k, B, xi, eta, d, t, a, b = data.k, data.B, space.xi, space.eta, space.deta, space.t, space.a, space.b
    dilates, weighted = len(B) > 0, data.rotation_weighted
    pressure = tangent.pressure[f] if dilates else 0.0
    stress = 0.0  # dtheta
    if data.linear:
        for q in range(size):
            square, along = 0.0, 0.0
            for p in range(dim):
                square += xi[p, q] * xi[p, q]
                along += xi[p, q] * d[p, q]
            a[q] = along / square
            b[q] = lever(data.s, first + q, np.sqrt(square)) / np.sqrt(square)
            stress += k[first + q] * b[q] * along
        stress = B[f] * stress if dilates else 0.0
        for q in range(size):
            a[q] = k[first + q] * (a[q] + stress * b[q])
        for p in range(dim):
            for q in range(size):
                t[p, q] = a[q] * xi[p, q]
        return
    tau = space.s[0]
    for q in range(size):
        square, current, cross, along, turned = 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(dim):
            x = xi[p, q]
            y = x + eta[p, q]
            square += x * x
            current += y * y
            cross += x * y
            along += y * d[p, q]
            turned += x * d[p, q]
            t[p, q] = y
        xi_length, y_length = np.sqrt(square), np.sqrt(current)
        stiffness, inverse = k[first + q], 1.0 / y_length
        share = stiffness * lever(data.s, first + q, xi_length) * inverse  # k s/|y|
        if weighted:
            cosine = cross * inverse / xi_length
            turn = (turned / xi_length - cosine * along * inverse) * inverse  # turn.deta
            e = y_length - xi_length
            tau[q] = stiffness * (1.0 - xi_length * inverse) + pressure * share * cosine
            a[q] = (stiffness - tau[q]) * along * inverse * inverse + pressure * share * turn
            stress += share * (cosine * along + e * turn * y_length)
            b[q] = share * cosine
        else:
            tau[q] = stiffness * (1.0 - xi_length * inverse) + pressure * share
            a[q] = (stiffness - tau[q]) * along * inverse * inverse
            stress += share * along
            b[q] = share
    if dilates:
        stress *= B[f]
        for q in range(size):
            a[q] += stress * b[q]
    for p in range(dim):
        for q in range(size):
            t[p, q] = a[q] * t[p, q] + tau[q] * d[p, q]


@implements(element_state, Extensions)
def element(D, data, tangent, f, first, size, space, block, left, right):
    dim = len(D)
    k, xi, eta, t, a, b = data.k, space.xi, space.eta, space.t, space.a, space.b
    dilates, weighted, linear = len(data.B) > 0, data.rotation_weighted, data.linear
    pressure = tangent.pressure[f] if dilates else 0.0
    extensions(D, k, dilates, data.s, weighted, linear, first, size, xi, eta, t, a, b, space.s)
    n, turn = space.H[0], space.P[0]
    for q in range(size):
        square, current, cross = 0.0, 0.0, 0.0
        for p in range(dim):
            square += xi[p, q] ** 2
            current += t[p, q] ** 2
            cross += xi[p, q] * t[p, q]
        xi_length, y_length = np.sqrt(square), np.sqrt(current)
        cosine = cross / (xi_length * y_length) if weighted else 1.0
        for p in range(dim):
            n[p] = t[p, q] / y_length
            turn[p] = (xi[p, q] / xi_length - cosine * n[p]) / y_length
        stiffness = k[first + q]
        share = stiffness * lever(data.s, first + q, xi_length)  # k s
        tau = 0.0 if linear else stiffness * a[q]
        if dilates and not linear:
            tau += pressure * share * cosine / y_length
        for p in range(dim):
            for r in range(dim):
                value = (stiffness - tau) * n[p] * n[r]
                if p == r:
                    value += tau
                if weighted:
                    value += pressure * share * n[p] * turn[r]
                block[q, p, r] = value
            if dilates:
                left[q, p] = share * cosine * n[p]
                if weighted:
                    right[q, p] = share * (cosine * n[p] + a[q] * y_length * turn[p])


@implements(mode_block, Extensions)
def coupling(D, data, tangent, f, left, right, block):
    for p in range(len(D)):
        for q in range(len(D)):
            block[p, q] = data.B[f] * left[p] * right[q]


@implements(add_modes, Extensions)
def modes(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    dim = len(D)
    row = half[0, 0]
    for p in range(dim):
        row[p] = V * data.B[f] * left[p]
    for b in range(first, last):
        k = position[neighbours[b]]
        for p in range(dim):
            for q in range(dim):
                blocks[k, p, q] += row[p] * right[b, q]


@njit(cache=True, **FAST)
def resist_strain(D, center, offsets, neighbours, X, k, resists):
    """Whether sum k e^2 is positive for every strain, in each family: the pivots of that quadratic form."""
    dim = len(D)
    modes = dim * (dim + 1) // 2
    gram = np.empty((modes, modes))
    mode = np.empty(modes)
    for f in range(len(center)):
        gram[:] = 0.0
        for b in range(offsets[f], offsets[f + 1]):
            square, a = 0.0, 0
            for p in range(dim):
                square += (X[neighbours[b], p] - X[center[f], p]) ** 2
                for q in range(p, dim):
                    mode[a] = (X[neighbours[b], p] - X[center[f], p]) * (X[neighbours[b], q] - X[center[f], q])
                    a += 1
            for p in range(modes):
                for q in range(modes):
                    gram[p, q] += k[b] / square * mode[p] * mode[q]
        least = SMALLEST_PIVOT * np.trace(gram)
        resists[f] = True
        for a in range(modes):
            if not gram[a, a] > least:
                resists[f] = False
                break
            for p in range(a + 1, modes):
                for q in range(a + 1, modes):
                    gram[p, q] -= gram[p, a] * gram[a, q] / gram[a, a]
