"""Compiled loops over collocation points: forces of tractions and their tangent (docs/theory/traction.md).

A point k, at y = X_k + sum phi_j u_j, gives its force T to the particles i of its family along the lines to them,

    f_i = a_i n_i (n_i . q),   q = M^-1 T,   M = sum a_i n_i (x) n_i,   n_i = d_i/|d_i|,   d_i = y - y_i,

a_i = alpha(|X_k - X_i|) V_i (seed 003 Eq. 1-3). A particle that lies on the point has no line; it takes part with the
mean over all directions, I/dim for n n, which has no moment either. With

    D_i = a_i/|d_i| [(n.q)(I - n n) + n (q - (n.q) n)] = df_i/dd_i,    L_i = a_i n n M^-1

its change is

    df_i = D_i (dy - du_i) + L_i (dT - sum_j D_j (dy - du_j)),   dy = sum phi_j du_j,
    dT = -p A (du_j x F (N x g_j))   summed over j   for a pressure, T = -p cof(F) N A,  F = I + sum u_j (x) g_j.

A family is an element once more: its matrix is the block of all pairs in it.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.families import largest_family


class Points(NamedTuple):
    """Collocation points and their families.

    Attributes:
        position: (n, dim) X_k.
        area: (n, dim) N A.
        offsets, neighbours: families in compressed rows, local particles.
        share: a_i of each bond.
        on: whether the particle of the bond lies on the point.
        phi: of each bond.
        gradient: (bonds, dim) g_j.
    """

    position: np.ndarray
    area: np.ndarray
    offsets: np.ndarray
    neighbours: np.ndarray
    share: np.ndarray
    on: np.ndarray
    phi: np.ndarray
    gradient: np.ndarray


@njit(cache=True)
def _force(points, k, dead, pressure, u, F, T):
    """Fill F, 3 x 3, and T of point k."""
    dim = points.position.shape[1]
    F[:] = np.eye(3)
    T[:] = dead[k]
    if pressure[k] == 0.0:
        return
    for b in range(points.offsets[k], points.offsets[k + 1]):
        for p in range(dim):
            for q in range(dim):
                F[p, q] += u[points.neighbours[b], p] * points.gradient[b, q]
    for p in range(dim):
        for q in range(dim):
            a, b, c, d = (p + 1) % 3, (p + 2) % 3, (q + 1) % 3, (q + 2) % 3
            T[p] -= pressure[k] * (F[a, c] * F[b, d] - F[a, d] * F[b, c]) * points.area[k, q]


@njit(cache=True, error_model="numpy")
def _directions(points, k, X, u, n, distance, M):
    """Fill n_i and |d_i| of the family of point k, and M."""
    dim = points.position.shape[1]
    first, last = points.offsets[k], points.offsets[k + 1]
    moved = np.zeros(dim)
    for b in range(first, last):
        for p in range(dim):
            moved[p] += points.phi[b] * u[points.neighbours[b], p]
    M[:] = 0.0
    for b in range(first, last):
        i, s = points.neighbours[b], b - first
        if points.on[b]:
            n[s] = 0.0
            distance[s] = np.inf
            for p in range(dim):
                M[p, p] += points.share[b] / dim
            continue
        square = 0.0
        for p in range(dim):
            n[s, p] = points.position[k, p] - X[i, p] + moved[p] - u[i, p]
            square += n[s, p] ** 2
        distance[s] = np.sqrt(square)
        for p in range(dim):
            n[s, p] /= distance[s]
        for p in range(dim):
            for q in range(dim):
                M[p, q] += points.share[b] * n[s, p] * n[s, q]


@njit(cache=True, error_model="numpy")
def _solve(M, right):
    """Put M^-1 right in place of `right` (dim, n); M, symmetric and positive definite, is used up.

    Where M is singular or no number the result is not finite, by which a step fails on all ranks; LAPACK would raise an
    error on this rank alone.
    """
    dim, n = right.shape
    for c in range(dim):
        for r in range(c + 1, dim):
            factor = M[r, c] / M[c, c]
            for k in range(c, dim):
                M[r, k] -= factor * M[c, k]
            for k in range(n):
                right[r, k] -= factor * right[c, k]
    for r in range(dim - 1, -1, -1):
        for k in range(n):
            for c in range(r + 1, dim):
                right[r, k] -= M[r, c] * right[c, k]
            right[r, k] /= M[r, r]


@njit(cache=True)
def add_forces(points, dead, pressure, X, u, force):
    """Add the forces on the particles."""
    dim, size = points.position.shape[1], largest_family(points.offsets)
    n, distance = np.empty((size, dim)), np.empty(size)
    M, F, q = np.empty((dim, dim)), np.empty((3, 3)), np.empty(dim)
    for k in range(len(points.offsets) - 1):
        _directions(points, k, X, u, n, distance, M)
        _force(points, k, dead, pressure, u, F, q)
        _solve(M, q.reshape(dim, 1))
        for b in range(points.offsets[k], points.offsets[k + 1]):
            s, along = b - points.offsets[k], 0.0
            for p in range(dim):
                along += n[s, p] * q[p]
            for p in range(dim):
                projected = q[p] / dim if points.on[b] else along * n[s, p]
                force[points.neighbours[b], p] += points.share[b] * projected


@njit(cache=True)
def totals(points, dead, pressure, u, position, force):
    """y and T of each point: where the whole force acts, and the force."""
    F = np.empty((3, 3))
    for k in range(len(points.offsets) - 1):
        _force(points, k, dead, pressure, u, F, force[k])
        position[k] = points.position[k]
        for b in range(points.offsets[k], points.offsets[k + 1]):
            position[k] += points.phi[b] * u[points.neighbours[b]]


@njit(cache=True, error_model="numpy")
def linearise(points, dead, pressure, X, u, own, mixed, turned):
    """Fill D_i, L_i and C_j = dT/du_j + D_j - phi_j sum D of each bond, with which df_i = D_i (dy - du_i) + L_i sum_j
    C_j du_j."""
    dim, size = points.position.shape[1], largest_family(points.offsets)
    n, distance = np.empty((size, dim)), np.empty(size)
    M, F, T, total = np.empty((dim, dim)), np.empty((3, 3)), np.empty(dim), np.empty((dim, dim))
    m, g, N = np.empty(3), np.zeros(3), np.zeros(3)
    for k in range(len(points.offsets) - 1):
        first, last = points.offsets[k], points.offsets[k + 1]
        _directions(points, k, X, u, n, distance, M)
        _force(points, k, dead, pressure, u, F, T)
        inverse = np.eye(dim)
        _solve(M, inverse)
        q = inverse @ T
        total[:] = 0.0
        for b in range(first, last):
            s, along = b - first, 0.0
            for p in range(dim):
                along += n[s, p] * q[p]
            for p in range(dim):
                for r in range(dim):
                    identity = 1.0 if p == r else 0.0
                    value = along * (identity - n[s, p] * n[s, r]) + n[s, p] * (q[r] - along * n[s, r])
                    own[b, p, r] = points.share[b] / distance[s] * value
                    total[p, r] += own[b, p, r]
                    mixed[b, p, r] = points.share[b] * inverse[p, r] / dim if points.on[b] else 0.0
                    for c in range(dim):
                        mixed[b, p, r] += points.share[b] * n[s, p] * n[s, c] * inverse[c, r]
        N[:dim] = points.area[k]
        for b in range(first, last):
            for p in range(dim):
                for r in range(dim):
                    turned[b, p, r] = own[b, p, r] - points.phi[b] * total[p, r]
            if pressure[k] == 0.0:
                continue
            g[:dim] = points.gradient[b]
            for p in range(3):  # F (N x g)
                m[p] = 0.0
                for c in range(3):
                    m[p] += F[p, c] * (N[(c + 1) % 3] * g[(c + 2) % 3] - N[(c + 2) % 3] * g[(c + 1) % 3])
            for p in range(dim):  # -p du x m
                r, c = (p + 1) % 3, (p + 2) % 3
                if r < dim:
                    turned[b, p, r] -= pressure[k] * m[c]
                if c < dim:
                    turned[b, p, c] += pressure[k] * m[r]


@njit(cache=True)
def add_action(points, own, mixed, turned, du, force):
    """Add -df, the part of the tangent of the residual."""
    dim = points.position.shape[1]
    dy, change = np.empty(dim), np.empty(dim)
    for k in range(len(points.offsets) - 1):
        dy[:] = 0.0
        change[:] = 0.0
        for b in range(points.offsets[k], points.offsets[k + 1]):
            for p in range(dim):
                dy[p] += points.phi[b] * du[points.neighbours[b], p]
                for r in range(dim):
                    change[p] += turned[b, p, r] * du[points.neighbours[b], r]
        for b in range(points.offsets[k], points.offsets[k + 1]):
            i = points.neighbours[b]
            for p in range(dim):
                for r in range(dim):
                    force[i, p] -= own[b, p, r] * (dy[r] - du[i, r]) + mixed[b, p, r] * change[r]


@njit(cache=True)
def block(b, c, phi, own, mixed, turned, out):
    """Fill out with the block of the tangent that couples the particle of bond b with the change of that of bond c."""
    dim = out.shape[0]
    for p in range(dim):
        for r in range(dim):
            value = own[b, p, r] * ((1.0 if b == c else 0.0) - phi[c])
            for m in range(dim):
                value -= mixed[b, p, m] * turned[c, m, r]
            out[p, r] = value


@njit(cache=True)
def add_diagonal(points, own, mixed, turned, diagonal):
    """Add the diagonal blocks."""
    dim = points.position.shape[1]
    out = np.empty((dim, dim))
    for b in range(len(points.neighbours)):
        block(b, b, points.phi, own, mixed, turned, out)
        diagonal[points.neighbours[b]] += out


@njit(cache=True)
def add_rows(points, dual_offsets, dual_family, dual_bond, own, mixed, turned, row_offsets, columns, blocks):
    """Add all blocks to block rows (`sparsity`)."""
    dim = points.position.shape[1]
    out = np.empty((dim, dim))
    place = np.full(len(dual_offsets), -1, np.int64)
    for a in range(len(dual_offsets) - 1):
        if dual_offsets[a] == dual_offsets[a + 1]:
            continue
        for s in range(row_offsets[a], row_offsets[a + 1]):
            if columns[s] >= 0:
                place[columns[s]] = s
        for d in range(dual_offsets[a], dual_offsets[a + 1]):
            k = dual_family[d]
            for c in range(points.offsets[k], points.offsets[k + 1]):
                block(dual_bond[d], c, points.phi, own, mixed, turned, out)
                blocks[place[points.neighbours[c]]] += out
