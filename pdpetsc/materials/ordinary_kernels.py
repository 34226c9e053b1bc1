"""The family element of bond-based and ordinary state-based models, all quadratic in the extensions of the bonds:

    w = 1/2 A theta^2 + 1/2 sum k e^2,   theta = sum c Lambda e,   t = (A theta c Lambda + k e) n

with e = |y| - |xi|, n = y/|y|, and constants k and c of each bond and A of each family that hold the neighbours'
volumes and weights. Lambda = 1, or the cosine n . xi/|xi| of the bond's rotation with which seed 000 Eq. 32-34 weighs
the dilatation (t is then no gradient, and the tangent unsymmetric). Linear kinematics have e = xi.eta/|xi| and
n = xi/|xi| (seed 003 Eq. 17, 20).

e is computed as (2 xi.eta + eta.eta)/(|y| + |xi|), which keeps all digits of small strains.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.families import (
    action_state,
    add_modes,
    bond_stiffness,
    energy_state,
    force_state,
    implements,
    length,
    linearise_state,
    size_state,
)

SMALLEST_PIVOT = 1e-6
"""Share of the trace below which a family does not resist some strain."""


class Extensions(NamedTuple):
    """Data of an ordinary model.

    Attributes:
        X: reference positions.
        k: stiffness of each bond; c: its weight in the dilatation, of length 0 where there is none.
        A: of each family.
        rotation_weighted: whether Lambda is the cosine, not 1.
        linear: whether kinematics are linear.
    """

    X: np.ndarray
    k: np.ndarray
    c: np.ndarray
    A: np.ndarray
    rotation_weighted: bool
    linear: bool


class ExtensionTangent(NamedTuple):
    """dt_b = D_b deta_b + gamma_b A sum h . deta: `block[b]` = D_b; gamma = c Lambda n, h = dtheta/deta (the same
    array as gamma where the tangent is symmetric), and minus their sums for the center; all of length 0 but `block`
    where there is no dilatation."""

    block: np.ndarray
    A: np.ndarray
    gamma: np.ndarray
    gamma_center: np.ndarray
    h: np.ndarray
    h_center: np.ndarray


@njit(cache=True, inline="always")
def extension(D, X, rotation_weighted, linear, i, j, u, n):
    """Fill n; (e, |y|, Lambda, |xi|) of the bond from i to j."""
    dim = len(D)
    square, xi_eta, eta_eta, y_square = 0.0, 0.0, 0.0, 0.0
    for p in range(dim):
        xi = X[j, p] - X[i, p]
        eta = u[j, p] - u[i, p]
        square += xi * xi
        xi_eta += xi * eta
        eta_eta += eta * eta
        y_square += (xi + eta) * (xi + eta)
    xi_length = np.sqrt(square)
    y_length, e, cosine = np.inf, xi_eta / xi_length, 1.0
    if linear:
        for p in range(dim):
            n[p] = (X[j, p] - X[i, p]) / xi_length
    else:
        y_length = np.sqrt(y_square)
        if y_length == 0.0:
            y_length = np.nan  # no direction
        for p in range(dim):
            n[p] = (X[j, p] - X[i, p] + u[j, p] - u[i, p]) / y_length
        e = (2.0 * xi_eta + eta_eta) / (y_length + xi_length)
        if rotation_weighted:
            cosine = (square + xi_eta) / (y_length * xi_length)
    return e, y_length, cosine, xi_length


@njit(cache=True, inline="always")
def extensions(D, X, c, rotation_weighted, linear, i, first, last, neighbours, u, t, a, b):
    """Fill t with n and a with e; with a dilatation, b with c Lambda and return theta."""
    theta = 0.0
    dilates = len(c) > 0
    for bond in range(first, last):
        k = bond - first
        e, _, cosine, _ = extension(D, X, rotation_weighted, linear, i, neighbours[bond], u, t[k])
        a[k] = e
        if dilates:
            b[k] = c[bond] * cosine
            theta += b[k] * e
    return theta


@implements(force_state, Extensions)
def force(D, data, f, i, first, last, neighbours, u, space):
    stiffness, c, t, a, share = data.k, data.c, space.t, space.a, space.b
    theta = extensions(D, data.X, c, data.rotation_weighted, data.linear, i, first, last, neighbours, u, t, a, share)
    pressure = data.A[f] * theta if len(c) > 0 else 0.0
    for b in range(first, last):
        k = b - first
        size = stiffness[b] * a[k]
        if len(c) > 0:
            size += pressure * share[k]
        for p in range(len(D)):
            t[k, p] *= size


@implements(energy_state, Extensions)
def energy(D, data, f, i, first, last, neighbours, u, space):
    theta = extensions(
        D, data.X, data.c, data.rotation_weighted, data.linear, i, first, last, neighbours, u, space.t, space.a, space.b
    )
    w = 0.5 * data.A[f] * theta * theta if len(data.c) > 0 else 0.0
    for b in range(first, last):
        w += 0.5 * data.k[b] * space.a[b - first] ** 2
    return w


@implements(size_state, Extensions)
def size(D, data, f, i, first, last, neighbours, u, space):
    dilates = len(data.c) > 0
    theta = 0.0
    for b in range(first, last):
        eta = length(D, u, i) + length(D, u, neighbours[b])
        space.a[b - first] = data.k[b] * eta
        if dilates:
            theta += abs(data.c[b]) * eta
    if dilates:
        for b in range(first, last):
            space.a[b - first] += abs(data.A[f] * data.c[b]) * theta


@implements(linearise_state, Extensions)
def linearise(D, data, tangent, f, i, first, last, neighbours, u, space):
    # With theta fixed: dt = k n (n.deta) + tau (I - n n) deta/|y| + A theta c n dLambda, tau = k e + A theta c Lambda,
    # dLambda = (xi/|xi| - Lambda n).deta/|y|; and dtheta = sum c (Lambda n + e dLambda).
    dim = len(D)
    X, c, stiffness, weighted, linear = data.X, data.c, data.k, data.rotation_weighted, data.linear
    block, gamma, h = tangent.block, tangent.gamma, tangent.h
    gamma_center, h_center = tangent.gamma_center, tangent.h_center
    theta, A = 0.0, 0.0
    if len(c) > 0:
        A = data.A[f]
        tangent.A[f] = A
        theta = extensions(D, X, c, weighted, linear, i, first, last, neighbours, u, space.t, space.a, space.b)
        for p in range(dim):
            gamma_center[f, p] = 0.0
            h_center[f, p] = 0.0
    n, turn = space.H[0], space.P[0]
    for b in range(first, last):
        j = neighbours[b]
        e, y_length, cosine, xi_length = extension(D, X, weighted, linear, i, j, u, n)
        for p in range(dim):  # dLambda/dy
            turn[p] = ((X[j, p] - X[i, p]) / xi_length - cosine * n[p]) / y_length
        pressure = A * theta * c[b] if len(c) > 0 else 0.0
        transverse = (stiffness[b] * e + pressure * cosine) / y_length
        for p in range(dim):
            for q in range(dim):
                value = (stiffness[b] - transverse) * n[p] * n[q]
                if p == q:
                    value += transverse
                if weighted:
                    value += pressure * n[p] * turn[q]
                block[b, p, q] = value
        if len(c) > 0:
            for p in range(dim):
                gamma[b, p] = c[b] * cosine * n[p]
                gamma_center[f, p] -= gamma[b, p]
                if weighted:
                    h[b, p] = c[b] * (cosine * n[p] + e * turn[p])
                    h_center[f, p] -= h[b, p]


@implements(action_state, ExtensionTangent)
def action(D, tangent, f, i, first, last, neighbours, du, space):
    dim = len(D)
    dilates = len(tangent.gamma) > 0
    stress = 0.0
    if dilates:
        for b in range(first, last):
            for p in range(dim):
                stress += tangent.A[f] * tangent.h[b, p] * (du[neighbours[b], p] - du[i, p])
    for b in range(first, last):
        for p in range(dim):
            t = stress * tangent.gamma[b, p] if dilates else 0.0
            for q in range(dim):
                t += tangent.block[b, p, q] * (du[neighbours[b], q] - du[i, q])
            space.t[b - first, p] = t


@implements(bond_stiffness, ExtensionTangent)
def stiffness(D, tangent, b, block):
    for p in range(len(D)):
        for q in range(len(D)):
            block[p, q] = tangent.block[b, p, q]


@implements(add_modes, ExtensionTangent)
def modes(D, tangent, f, b, first, last, neighbours, i, V, position, half, blocks):
    """V A gamma_b (x) h of every particle of the family."""
    dim = len(D)
    if len(tangent.gamma) == 0:
        return
    row = half[0, 0]
    for p in range(dim):
        row[p] = V * tangent.A[f] * (tangent.gamma_center[f, p] if b < 0 else tangent.gamma[b, p])
    k = position[i]
    for p in range(dim):
        for q in range(dim):
            blocks[k, p, q] += row[p] * tangent.h_center[f, q]
    for c in range(first, last):
        k = position[neighbours[c]]
        for p in range(dim):
            for q in range(dim):
                blocks[k, p, q] += row[p] * tangent.h[c, q]


@njit(cache=True)
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
