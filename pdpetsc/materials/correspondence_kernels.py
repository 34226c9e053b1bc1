"""The family element of the correspondence model.

g[b] = w beta V_j K^-1 xi, so that H_i = sum eta (x) g; `spring[b]` = c_i w beta V_j and `affine[f]` = a c_i K_i hold
the zero-energy control (stabilisation.py). t = P_eff g + spring eta with P_eff = P - H affine.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.elasticity import elasticity_tensor, energy_density, first_piola, lateral_strain
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


class Gradients(NamedTuple):
    """Data of the correspondence model.

    Attributes:
        law: elastic law P(F).
        g, spring: of each bond; affine: of each family (see above).
        modulus: P-wave modulus [force/area].
    """

    law: NamedTuple
    g: np.ndarray
    spring: np.ndarray
    affine: np.ndarray
    modulus: float


class GradientTangent(NamedTuple):
    """Its tangent: `tensor[f]` = dP/dF minus the affine part of the zero-energy control; g_center = -sum g."""

    g: np.ndarray
    g_center: np.ndarray
    spring: np.ndarray
    tensor: np.ndarray


@njit(cache=True)
def shape_gradients(D, center, offsets, neighbours, X, weight, inverse, g, g_center):
    """g = w beta V_j K^-1 xi of each bond and g_center = -sum g of each family, with the inverse shape tensors."""
    dim = len(D)
    for f in range(len(center)):
        i = center[f]
        g_center[f] = 0.0
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            for p in range(dim):
                value = 0.0
                for q in range(dim):
                    value += inverse[f, p, q] * (X[j, q] - X[i, q])
                g[b, p] = weight[b] * value
                g_center[f, p] -= g[b, p]


@njit(cache=True, inline="always")
def gradient(D, i, first, last, neighbours, g, u, H):
    """H = sum eta (x) g of the family of i."""
    dim = len(D)
    for p in range(dim):
        for q in range(dim):
            H[p, q] = 0.0
    for b in range(first, last):
        j = neighbours[b]
        for p in range(dim):
            eta = u[j, p] - u[i, p]
            for q in range(dim):
                H[p, q] += eta * g[b, q]


@njit(cache=True, inline="always")
def gradient_forces(D, i, first, last, neighbours, g, spring, P, u, t):
    """t = P g + spring eta."""
    dim = len(D)
    for b in range(first, last):
        j = neighbours[b]
        for p in range(dim):
            value = spring[b] * (u[j, p] - u[i, p])
            for q in range(dim):
                value += P[p, q] * g[b, q]
            t[b - first, p] = value


@implements(force_state, Gradients)
def force(D, data, f, i, first, last, neighbours, u, space):
    dim = len(D)
    H, P, g, affine = space.H, space.P, data.g, data.affine
    gradient(D, i, first, last, neighbours, g, u, H)
    first_piola(data.law, H, P, space.work)
    for p in range(dim):
        for q in range(dim):
            for r in range(dim):
                P[p, q] -= H[p, r] * affine[f, r, q]
    gradient_forces(D, i, first, last, neighbours, g, data.spring, P, u, space.t)


@implements(energy_state, Gradients)
def energy(D, data, f, i, first, last, neighbours, u, space):
    dim = len(D)
    H = space.H
    gradient(D, i, first, last, neighbours, data.g, u, H)
    control = 0.0
    for b in range(first, last):
        j = neighbours[b]
        for p in range(dim):
            control += data.spring[b] * (u[j, p] - u[i, p]) ** 2
    for p in range(dim):
        for q in range(dim):
            for r in range(dim):
                control -= H[p, q] * data.affine[f, q, r] * H[p, r]
    return energy_density(data.law, H, space.work) + 0.5 * control


@implements(size_state, Gradients)
def size(D, data, f, i, first, last, neighbours, u, space):
    stress = 0.0  # modulus |H|
    for b in range(first, last):
        stress += data.modulus * length(D, data.g, b) * (length(D, u, i) + length(D, u, neighbours[b]))
    for b in range(first, last):
        eta = length(D, u, i) + length(D, u, neighbours[b])
        space.a[b - first] = stress * length(D, data.g, b) + data.spring[b] * eta


@implements(linearise_state, Gradients)
def linearise(D, data, tangent, f, i, first, last, neighbours, u, space):
    dim = len(D)
    gradient(D, i, first, last, neighbours, data.g, u, space.H)
    elasticity_tensor(data.law, space.H, tangent.tensor[f], space.work)
    for p in range(dim):
        for q in range(dim):
            for r in range(dim):
                tangent.tensor[f, p, q, p, r] -= data.affine[f, r, q]


@implements(action_state, GradientTangent)
def action(D, tangent, f, i, first, last, neighbours, du, space):
    dim = len(D)
    H, P = space.H, space.P
    gradient(D, i, first, last, neighbours, tangent.g, du, H)
    for p in range(dim):
        for q in range(dim):
            value = 0.0
            for r in range(dim):
                for s in range(dim):
                    value += tangent.tensor[f, p, q, r, s] * H[r, s]
            P[p, q] = value
    gradient_forces(D, i, first, last, neighbours, tangent.g, tangent.spring, P, du, space.t)


@implements(bond_stiffness, GradientTangent)
def stiffness(D, tangent, b, block):
    spring = tangent.spring[b]
    for p in range(len(D)):
        for q in range(len(D)):
            block[p, q] = 0.0
        block[p, p] = spring


@implements(add_modes, GradientTangent)
def modes(D, tangent, f, b, first, last, neighbours, i, V, position, half, blocks):
    """V g_b . tensor . g of every particle of the family."""
    dim = len(D)
    g, g_center, tensor = tangent.g, tangent.g_center, tangent.tensor
    for p in range(dim):
        for r in range(dim):
            for s in range(dim):
                value = 0.0
                for q in range(dim):
                    g_row = g_center[f, q] if b < 0 else g[b, q]
                    value += tensor[f, p, q, r, s] * g_row
                half[p, r, s] = V * value
    k = position[i]
    for p in range(dim):
        for r in range(dim):
            for s in range(dim):
                blocks[k, p, r] += half[p, r, s] * g_center[f, s]
    for c in range(first, last):
        k = position[neighbours[c]]
        for p in range(dim):
            for r in range(dim):
                value = 0.0
                for s in range(dim):
                    value += half[p, r, s] * g[c, s]
                blocks[k, p, r] += value


@njit(cache=True)
def gradients(D, law, center, offsets, neighbours, g, u, out):
    """H of each family (n, 3, 3), in the directions that the body does not have as the law wants it."""
    dim = len(D)
    H = np.empty((dim, dim))
    work = np.empty((8, 3, 3))
    for f in range(len(center)):
        gradient(D, center[f], offsets[f], offsets[f + 1], neighbours, g, u, H)
        out[f, :dim, :dim] = H
        for p in range(dim, 3):
            out[f, p, p] = lateral_strain(law, H, work)


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
