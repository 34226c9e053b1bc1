"""The family element of the correspondence model.

    H = M K^-1,  M = sum w eta (x) xi,   t = w (S xi + c eta + r e n),   S = (b P(H) - a c H K) K^-1

with w = w beta V_j of each bond. c and a of each family are those of the zero-energy control (stabilisation.py); its
part in S takes the affine motion out. A family that has lost most of its bonds has a share b < 1 of the law and rods of
stiffness r along its bonds instead, with e = |y| - |xi|, n = y/|y| (Correspondence).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.elasticity import elasticity_tensor, energy_density, first_piola, lateral_strain
from pdpetsc.materials.families import (
    FAST,
    action_state,
    add_modes,
    element_state,
    energy_state,
    force_state,
    gather_two,
    implements,
    linearise_state,
    mode_block,
    scratch,
    size_state,
)

FADE = (0.1, 0.3)
"""q between which a family goes over from rods to the law."""


class Gradients(NamedTuple):
    """Data of the correspondence model.

    Attributes:
        law: elastic law P(F).
        weight: w beta V_j of each bond [length^3].
        inverse: K^-1 of each family.
        control: c of each family [force/length^7].
        affine: a c K of each family.
        modulus: P-wave modulus [force/area].
        share: b of each family, 1 where it is whole.
        rod: r of each family [force/length^7], 0 where it is whole.
    """

    law: NamedTuple
    weight: np.ndarray
    inverse: np.ndarray
    control: np.ndarray
    affine: np.ndarray
    modulus: float
    share: np.ndarray
    rod: np.ndarray


class GradientTangent(NamedTuple):
    """What a family remembers of the state: `tensor` = dP/dF less the affine part of the zero-energy control."""

    tensor: np.ndarray


@njit(cache=True, inline="always")
def gradient(D, f, first, size, weight, inverse, xi, eta, s, M, H):
    """Fill s with w xi, M with sum w eta (x) xi and H with M K^-1."""
    dim = len(D)
    for p in range(dim):
        for q in range(size):
            s[p, q] = weight[first + q] * xi[p, q]
    for p in range(dim):
        for r in range(dim):
            total = 0.0
            for q in range(size):
                total += eta[p, q] * s[r, q]
            M[p, r] = total
    for p in range(dim):
        for r in range(dim):
            total = 0.0
            for q in range(dim):
                total += M[p, q] * inverse[f, q, r]
            H[p, r] = total


@njit(cache=True, inline="always")
def gradient_forces(D, f, first, size, weight, inverse, control, P, eta, s, t):
    """t = P K^-1 (w xi) + c w eta, with w xi in s."""
    dim = len(D)
    c = control[f]
    for p in range(dim):
        for q in range(size):
            t[p, q] = c * weight[first + q] * eta[p, q]
        for r in range(dim):
            S = 0.0
            for q in range(dim):
                S += P[p, q] * inverse[f, q, r]
            for q in range(size):
                t[p, q] += S * s[r, q]


@njit(cache=True, inline="always")
def rod(D, xi, eta, q, y):
    """Fill y with xi + eta of a bond; (e/|y|, |y|^2)."""
    square, change, current = 0.0, 0.0, 0.0
    for p in range(len(D)):
        y[p] = xi[p, q] + eta[p, q]
        square += xi[p, q] ** 2
        change += (xi[p, q] + y[p]) * eta[p, q]
        current += y[p] ** 2
    length = np.sqrt(current)
    return change / (length * (length + np.sqrt(square))), current


@implements(force_state, Gradients)
def force(D, data, f, first, size, space):
    dim = len(D)
    H, P, eta, s, weight, inverse, affine = space.H, space.P, space.eta, space.s, data.weight, data.inverse, data.affine
    gradient(D, f, first, size, weight, inverse, space.xi, eta, s, P, H)
    first_piola(data.law, H, P, space.work)
    for p in range(dim):
        for q in range(dim):
            P[p, q] *= data.share[f]
            for r in range(dim):
                P[p, q] -= H[p, r] * affine[f, r, q]
    gradient_forces(D, f, first, size, weight, inverse, data.control, P, eta, s, space.t)
    if data.rod[f] > 0.0:
        y = space.H[0]
        for q in range(size):
            strain, _ = rod(D, space.xi, eta, q, y)
            for p in range(dim):
                space.t[p, q] += data.rod[f] * weight[first + q] * strain * y[p]


@implements(energy_state, Gradients)
def energy(D, data, f, first, size, space):
    dim = len(D)
    H, P, eta, weight, affine = space.H, space.P, space.eta, data.weight, data.affine
    gradient(D, f, first, size, weight, data.inverse, space.xi, eta, space.s, P, H)
    control = 0.0
    for q in range(size):
        for p in range(dim):
            control += weight[first + q] * eta[p, q] ** 2
    control *= data.control[f]
    for p in range(dim):
        for q in range(dim):
            for r in range(dim):
                control -= H[p, q] * affine[f, q, r] * H[p, r]
    if data.rod[f] > 0.0:
        y = space.P[0]
        for q in range(size):
            strain, square = rod(D, space.xi, eta, q, y)
            control += data.rod[f] * weight[first + q] * strain**2 * square
    return data.share[f] * energy_density(data.law, H, space.work) + 0.5 * control


@njit(cache=True, inline="always")
def shape_gradient(D, f, b, q, weight, inverse, xi, g):
    """g = w K^-1 xi of one bond; H = sum eta (x) g."""
    for p in range(len(D)):
        total = 0.0
        for r in range(len(D)):
            total += inverse[f, p, r] * xi[r, q]
        g[p] = weight[b] * total


@implements(size_state, Gradients)
def size(D, data, f, first, size, space):
    dim = len(D)
    g, a, b = space.H[0], space.a, space.b
    stress = 0.0  # modulus |H|
    for q in range(size):
        shape_gradient(D, f, first + q, q, data.weight, data.inverse, space.xi, g)
        square = 0.0
        for p in range(dim):
            square += g[p] ** 2
        b[q] = np.sqrt(square)
        stress += data.modulus * b[q] * a[q]
    for q in range(size):
        b[q] = stress * b[q] + (data.control[f] + data.rod[f]) * data.weight[first + q] * a[q]


@implements(linearise_state, Gradients)
def linearise(D, data, tangent, f, first, size, space):
    dim = len(D)
    gradient(D, f, first, size, data.weight, data.inverse, space.xi, space.eta, space.s, space.P, space.H)
    elasticity_tensor(data.law, space.H, tangent.tensor[f], space.work)
    for p in range(dim):
        for q in range(dim):
            for r in range(dim):
                for s in range(dim):
                    tangent.tensor[f, p, q, r, s] *= data.share[f]
            for r in range(dim):
                tangent.tensor[f, p, q, p, r] -= data.affine[f, r, q]


@implements(action_state, Gradients)
def action(D, data, tangent, f, first, size, space):
    dim = len(D)
    H, P, deta, s, weight, inverse, tensor = (
        space.H, space.P, space.deta, space.s, data.weight, data.inverse, tangent.tensor
    )  # fmt: skip
    gradient(D, f, first, size, weight, inverse, space.xi, deta, s, P, H)
    for p in range(dim):
        for q in range(dim):
            total = 0.0
            for r in range(dim):
                for m in range(dim):
                    total += tensor[f, p, q, r, m] * H[r, m]
            P[p, q] = total
    gradient_forces(D, f, first, size, weight, inverse, data.control, P, deta, s, space.t)
    if data.rod[f] > 0.0:
        y = space.H[0]
        for q in range(size):
            strain, square = rod(D, space.xi, space.eta, q, y)
            along = 0.0
            for p in range(dim):
                along += y[p] * deta[p, q]
            k = data.rod[f] * weight[first + q]
            for p in range(dim):
                space.t[p, q] += k * ((1.0 - strain) * along / square * y[p] + strain * deta[p, q])


@implements(element_state, Gradients)
def element(D, data, tangent, f, first, size, space, block, left, right):
    dim = len(D)
    for q in range(size):
        b = first + q
        for p in range(dim):
            for r in range(dim):
                block[q, p, r] = 0.0
            block[q, p, p] = data.control[f] * data.weight[b]
        if data.rod[f] > 0.0:
            y, k = space.H[0], data.rod[f] * data.weight[b]
            strain, square = rod(D, space.xi, space.eta, q, y)
            for p in range(dim):
                for r in range(dim):
                    block[q, p, r] += k * (1.0 - strain) * y[p] * y[r] / square
                block[q, p, p] += k * strain
        shape_gradient(D, f, b, q, data.weight, data.inverse, space.xi, left[q])


@implements(mode_block, Gradients)
def coupling(D, data, tangent, f, left, right, block):
    dim = len(D)
    for p in range(dim):
        for r in range(dim):
            total = 0.0
            for q in range(dim):
                for s in range(dim):
                    total += tangent.tensor[f, p, q, r, s] * left[q] * right[s]
            block[p, r] = total


@implements(add_modes, Gradients)
def modes(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    dim = len(D)
    for p in range(dim):
        for r in range(dim):
            for s in range(dim):
                total = 0.0
                for q in range(dim):
                    total += tangent.tensor[f, p, q, r, s] * left[q]
                half[p, r, s] = V * total
    for b in range(first, last):
        k = position[neighbours[b]]
        for p in range(dim):
            for r in range(dim):
                total = 0.0
                for s in range(dim):
                    total += half[p, r, s] * right[b, s]
                blocks[k, p, r] += total


@njit(cache=True, **FAST)
def gradients(D, law, weight, inverse, X, center, offsets, neighbours, u, out):
    """H of each family (n, 3, 3), in the directions that the body does not have as the law wants it."""
    dim = len(D)
    space = scratch(D, offsets)
    H = space.H
    for f in range(len(center)):
        first, last = offsets[f], offsets[f + 1]
        gather_two(D, X, u, center[f], first, last, neighbours, space.xi, space.eta)
        gradient(D, f, first, last - first, weight, inverse, space.xi, space.eta, space.s, space.P, H)
        out[f, :dim, :dim] = H
        for p in range(dim, 3):
            out[f, p, p] = lateral_strain(law, H, space.work)


@njit(cache=True)
def cauchy_stresses(D, law, H, sigma):
    """sigma = P F^T / J of 3 x 3 displacement gradients; the law sees their first len(D) directions."""
    dim = len(D)
    work = np.empty((8, 3, 3))
    P = np.empty((dim, dim))
    h = np.empty((dim, dim))
    for f in range(len(H)):
        h[:, :] = H[f, :dim, :dim]
        first_piola(law, h, P, work)
        F = H[f] + np.eye(3)
        J = np.linalg.det(F)
        sigma[f] = 0.0
        for p in range(dim):
            for q in range(dim):
                for r in range(dim):
                    sigma[f, p, q] += P[p, r] * F[q, r] / J
