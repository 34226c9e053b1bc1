"""Compiled family loops of the correspondence model.

Conventions: family f belongs to particle i = center[f]; its bond b leads to j = neighbours[b];
g[b] = w beta V_j K^-1 xi, so that H_i = sum eta (x) g; `spring[b]` = c_i w beta V_j and `affine[f]` = a c_i K_i hold
the zero-energy control (stabilisation.py). The force of a family on its neighbour j is V_i (P_eff g + spring eta) with
P_eff = P - H affine, and the opposite on i.

The dimension comes as the length of a tuple D, `dimension(2) = (0, 0)`: that is part of the tuple's type, so numba
compiles the loops for it with fixed bounds, once for all runs. (A factory that closes over the dimension and over other
compiled functions would be compiled again in every process.)
"""

import numpy as np
from numba import njit

from pdpetsc.materials.elasticity import elasticity_tensor, energy_density, first_piola


def dimension(dim: int) -> tuple[int, ...]:
    """The tuple that stands for a dimension in calls of the kernels."""
    return (0,) * dim


@njit(cache=True)
def shape_tensors(D, center, offsets, neighbours, X, weight, volume, shape):
    """K = sum w beta V_j xi (x) xi of each family (seed 004 Eq. 3.19)."""
    dim = len(D)
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            omega = weight[b] * volume[j]
            for p in range(dim):
                for q in range(dim):
                    shape[f, p, q] += omega * (X[j, p] - X[i, p]) * (X[j, q] - X[i, q])


@njit(cache=True)
def shape_gradients(D, center, offsets, neighbours, X, weight, volume, inverse, g, g_center):
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
                g[b, p] = weight[b] * volume[j] * value
                g_center[f, p] -= g[b, p]


@njit(cache=True)
def gradient(D, f, center, offsets, neighbours, g, u, H):
    """H = sum eta (x) g of family f."""
    dim = len(D)
    i = center[f]
    for p in range(dim):
        for q in range(dim):
            H[p, q] = 0.0
    for b in range(offsets[f], offsets[f + 1]):
        j = neighbours[b]
        for p in range(dim):
            eta = u[j, p] - u[i, p]
            for q in range(dim):
                H[p, q] += eta * g[b, q]


@njit(cache=True)
def scatter(D, f, center, offsets, neighbours, g, spring, V, P, u, force):
    """Add the force of family f with effective stress P to its particles."""
    dim = len(D)
    i = center[f]
    for b in range(offsets[f], offsets[f + 1]):
        j = neighbours[b]
        for p in range(dim):
            t = spring[b] * (u[j, p] - u[i, p])
            for q in range(dim):
                t += P[p, q] * g[b, q]
            force[j, p] += V * t
            force[i, p] -= V * t


@njit(cache=True)
def remove_affine(D, P, H, affine):
    """P - H affine: what the zero-energy control takes from the stress."""
    dim = len(D)
    for p in range(dim):
        for q in range(dim):
            for r in range(dim):
                P[p, q] -= H[p, r] * affine[r, q]


@njit(cache=True)
def add_force(D, law, center, offsets, neighbours, g, spring, affine, volume, u, force):
    dim = len(D)
    work = np.empty((8, 3, 3))
    H = np.empty((dim, dim))
    P = np.empty((dim, dim))
    for f in range(len(center)):
        gradient(D, f, center, offsets, neighbours, g, u, H)
        first_piola(law, H, P, work)
        remove_affine(D, P, H, affine[f])
        scatter(D, f, center, offsets, neighbours, g, spring, volume[center[f]], P, u, force)


@njit(cache=True)
def add_force_scale(D, modulus, center, offsets, neighbours, g, spring, volume, u, scale):
    """Sizes of the terms that cancel in `add_force`: each bond with (|u_i| + |u_j|) for eta, stress as modulus |H|."""
    for f in range(len(center)):
        i = center[f]
        stress = 0.0
        for b in range(offsets[f], offsets[f + 1]):
            stress += modulus * length(D, g, b) * (length(D, u, i) + length(D, u, neighbours[b]))
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            size = length(D, u, i) + length(D, u, j)
            term = volume[i] * (stress * length(D, g, b) + spring[b] * size)
            scale[j] += term
            scale[i] += term


@njit(cache=True)
def length(D, vectors, k):
    """Euclidean norm of vector k."""
    square = 0.0
    for p in range(len(D)):
        square += vectors[k, p] ** 2
    return np.sqrt(square)


@njit(cache=True)
def linearise(D, law, center, offsets, neighbours, g, affine, u, tensor):
    """tensor[f] = dP/dF minus the affine part of the zero-energy control."""
    dim = len(D)
    work = np.empty((8, 3, 3))
    H = np.empty((dim, dim))
    for f in range(len(center)):
        gradient(D, f, center, offsets, neighbours, g, u, H)
        elasticity_tensor(law, H, tensor[f], work)
        for p in range(dim):
            for q in range(dim):
                for r in range(dim):
                    tensor[f, p, q, p, r] -= affine[f, r, q]


@njit(cache=True)
def add_action(D, center, offsets, neighbours, g, spring, tensor, volume, du, force):
    dim = len(D)
    H = np.empty((dim, dim))
    P = np.empty((dim, dim))
    for f in range(len(center)):
        gradient(D, f, center, offsets, neighbours, g, du, H)
        for p in range(dim):
            for q in range(dim):
                value = 0.0
                for r in range(dim):
                    for s in range(dim):
                        value += tensor[f, p, q, r, s] * H[r, s]
                P[p, q] = value
        scatter(D, f, center, offsets, neighbours, g, spring, volume[center[f]], P, du, force)


@njit(cache=True)
def add_family_to_row(D, f, g_row, center, offsets, neighbours, g, g_center, tensor, V, position, half, blocks):
    """Blocks V g_row . tensor . g_b of one row, for every particle b of family f."""
    dim = len(D)
    for p in range(dim):
        for r in range(dim):
            for s in range(dim):
                value = 0.0
                for q in range(dim):
                    value += tensor[f, p, q, r, s] * g_row[q]
                half[p, r, s] = V * value
    k = position[center[f]]
    for p in range(dim):
        for r in range(dim):
            for s in range(dim):
                blocks[k, p, r] += half[p, r, s] * g_center[f, s]
    for b in range(offsets[f], offsets[f + 1]):
        k = position[neighbours[b]]
        for p in range(dim):
            for r in range(dim):
                value = 0.0
                for s in range(dim):
                    value += half[p, r, s] * g[b, s]
                blocks[k, p, r] += value


@njit(cache=True)
def add_rows(
    D, center, offsets, neighbours, g, g_center, spring, tensor, volume, own,
    dual_offsets, dual_family, dual_bond, row_offsets, columns, blocks,
):  # fmt: skip
    """Row by row: the contributions of the row's own family and of every family that contains it.

    `own[a]` is the number of particle a's own family or -1; `g_center[f]` = -sum g is the center's share of H.
    """
    dim = len(D)
    half = np.empty((dim, dim, dim))
    position = np.empty(len(row_offsets) - 1, np.int64)  # block of each column in the current row
    for a in range(len(row_offsets) - 1):
        for k in range(row_offsets[a], row_offsets[a + 1]):
            if columns[k] >= 0:
                position[columns[k]] = k
        f = own[a]
        if f >= 0:
            V = volume[a]
            add_family_to_row(
                D, f, g_center[f], center, offsets, neighbours, g, g_center, tensor, V, position, half, blocks
            )
            for b in range(offsets[f], offsets[f + 1]):
                for p in range(dim):
                    blocks[position[a], p, p] += V * spring[b]
                    blocks[position[neighbours[b]], p, p] -= V * spring[b]
        for k in range(dual_offsets[a], dual_offsets[a + 1]):
            f, bond = dual_family[k], dual_bond[k]
            i = center[f]
            V = volume[i]
            add_family_to_row(
                D, f, g[bond], center, offsets, neighbours, g, g_center, tensor, V, position, half, blocks
            )
            for p in range(dim):
                blocks[position[a], p, p] += V * spring[bond]
                blocks[position[i], p, p] -= V * spring[bond]


@njit(cache=True)
def energies(D, law, center, offsets, neighbours, g, spring, affine, volume, u, energy):
    dim = len(D)
    work = np.empty((8, 3, 3))
    H = np.empty((dim, dim))
    for f in range(len(center)):
        i = center[f]
        gradient(D, f, center, offsets, neighbours, g, u, H)
        control = 0.0
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            for p in range(dim):
                control += spring[b] * (u[j, p] - u[i, p]) ** 2
        for p in range(dim):
            for q in range(dim):
                for r in range(dim):
                    control -= H[p, q] * affine[f, q, r] * H[p, r]
        energy[f] = volume[i] * (energy_density(law, H, work) + 0.5 * control)


@njit(cache=True)
def gradients(D, center, offsets, neighbours, g, u, out):
    dim = len(D)
    H = np.empty((dim, dim))
    for f in range(len(center)):
        gradient(D, f, center, offsets, neighbours, g, u, H)
        out[f, :dim, :dim] = H


@njit(cache=True)
def cauchy_stresses(law, H, sigma):
    """sigma = P F^T / J of 3 x 3 displacement gradients."""
    work = np.empty((8, 3, 3))
    P = np.empty((3, 3))
    for f in range(len(H)):
        first_piola(law, H[f], P, work)
        F = H[f] + np.eye(3)
        J = np.linalg.det(F)
        for p in range(3):
            for q in range(3):
                value = 0.0
                for r in range(3):
                    value += P[p, r] * F[q, r]
                sigma[f, p, q] = value / J
