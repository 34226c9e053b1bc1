"""The family element of the softened correspondence model: the weights w = w_whole T are in K, H, T and T_z alike.

    t = w (S xi + c eta + r e n),   S = (b P(H) - a c H K) L,   L = K^-1,   c = b c_whole,   r = (1 - b) r_whole

and so is the share b of the law, which is that of lambda_min of the softened K: as the bonds of a family fade, it goes
over to rods along what is left of them (Correspondence), and a bond that is removed at T = 0 changes nothing. With dw =
slope y.deta, z = eta - H xi and the unit eigenvector v of lambda_min,

    dH = [sum (w deta + dw z) (x) xi] L,   dK = sum dw xi (x) xi,   db = b'(q)/lambda_min(K_whole) v.dK v
    dt = w (Z L xi + c deta + d(r e n)) + dw (S xi + c eta + r e n) + w db (c_whole eta - r_whole e n)
    Z = A:dH - b P L dK + db (P - a c_whole H K),   A = b dP/dF - a c K

(the two terms with a c H dK cancel). Z and db are the modes of a family: `left` of a bond is w L xi and w (c_whole eta
- r_whole e n), `right` its parts of Z and db, (dim^2 + 1) dim numbers.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.correspondence_kernels import FADE, Gradients, GradientTangent, rod
from pdpetsc.materials.elasticity import first_piola
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
from pdpetsc.materials.softened_kernels import soften, unstretch
from pdpetsc.materials.softening import Softening
from pdpetsc.materials.tensors import eigen_symmetric


class SoftenedGradients(NamedTuple):
    """Data of the softened correspondence model.

    Attributes:
        base: of the unsoftened model; its arrays are scratch.
        softening: of the bonds.
        weight: of each bond before it softens [length^3].
        least: lambda_min(K_whole) of each family.
        control, rod: c_whole and r_whole of each family [force/length^7].
        removed: a.
        fading: db/dK of each family, scratch.
    """

    base: Gradients
    softening: Softening
    weight: np.ndarray
    least: np.ndarray
    control: np.ndarray
    rod: np.ndarray
    removed: float
    fading: np.ndarray


class SoftenedGradientTangent(NamedTuple):
    """What a family remembers of the state: as the unsoftened one, and H and P."""

    base: GradientTangent
    gradient: np.ndarray
    stress: np.ndarray


@njit(cache=True, inline="always")
def soften_family(D, data, f, first, size, space):
    """Fill the family's parts of the base data, its db/dK, and space.slope."""
    dim, base, xi = len(D), data.base, space.xi
    weight, K, inverse = base.weight, base.affine, base.inverse
    soften(D, data.softening, False, data.weight, weight, f, first, size, xi, space.eta, space.slope)
    spectrum, vectors = space.work[6], space.work[7]
    for p in range(dim):
        for r in range(p, dim):
            total = 0.0
            for q in range(size):
                total += weight[first + q] * xi[p, q] * xi[r, q]
            K[f, p, r] = K[f, r, p] = spectrum[p, r] = spectrum[r, p] = total
    eigen_symmetric(spectrum, vectors, dim)
    least = 0
    for p in range(1, dim):
        if spectrum[p, p] < spectrum[least, least]:
            least = p
    s = (spectrum[least, least] / data.least[f] - FADE[0]) / (FADE[1] - FADE[0])
    s = min(max(s, 0.0), 1.0)
    share = s * s * (3.0 - 2.0 * s)
    slope = 6.0 * s * (1.0 - s) / ((FADE[1] - FADE[0]) * data.least[f])
    base.share[f], base.control[f], base.rod[f] = share, share * data.control[f], (1.0 - share) * data.rod[f]
    for p in range(dim):
        for r in range(dim):
            total = 0.0
            if share > 0.0:
                for q in range(dim):
                    total += vectors[p, q] * vectors[r, q] / spectrum[q, q]
            inverse[f, p, r] = total
            data.fading[f, p, r] = slope * vectors[p, least] * vectors[r, least]
            K[f, p, r] *= data.removed * base.control[f]


@implements(force_state, SoftenedGradients)
def force(D, data, f, first, size, space):
    soften_family(D, data, f, first, size, space)
    force_state(D, data.base, f, first, size, space)


@implements(energy_state, SoftenedGradients)
def energy(D, data, f, first, size, space):
    soften_family(D, data, f, first, size, space)
    return energy_state(D, data.base, f, first, size, space)


@implements(size_state, SoftenedGradients)
def size(D, data, f, first, size, space):
    unstretch(D, size, space.eta)
    soften_family(D, data, f, first, size, space)
    size_state(D, data.base, f, first, size, space)


@implements(linearise_state, SoftenedGradients)
def linearise(D, data, tangent, f, first, size, space):
    soften_family(D, data, f, first, size, space)
    linearise_state(D, data.base, tangent.base, f, first, size, space)
    first_piola(data.base.law, space.H, space.P, space.work)
    for p in range(len(D)):
        for q in range(len(D)):
            tangent.gradient[f, p, q] = space.H[p, q]
            tangent.stress[f, p, q] = space.P[p, q]


@njit(cache=True, inline="always")
def stresses(D, data, tangent, f, S, law, faded):
    """Fill S, b P L ("law") and P - a c_whole H K ("faded")."""
    dim, base, H, P = len(D), data.base, tangent.gradient, tangent.stress
    share = base.share[f]
    for p in range(dim):
        for q in range(dim):
            control = 0.0
            for r in range(dim):
                control += H[f, p, r] * base.affine[f, r, q]
            law[p, q] = share * P[f, p, q] - control
            faded[p, q] = P[f, p, q] - control / share if share > 0.0 else 0.0
        for q in range(dim):
            S[p, q] = 0.0
            for r in range(dim):
                S[p, q] += law[p, r] * base.inverse[f, r, q]
        for q in range(dim):
            law[p, q] = 0.0
            for r in range(dim):
                law[p, q] += share * P[f, p, r] * base.inverse[f, r, q]


@implements(action_state, SoftenedGradients)
def action(D, data, tangent, f, first, size, space):
    dim, base, H, tensor = len(D), data.base, tangent.gradient, tangent.base.tensor
    xi, eta, d, t, slope, inverse = space.xi, space.eta, space.deta, space.t, space.slope, base.inverse
    soften_family(D, data, f, first, size, space)
    action_state(D, base, tangent.base, f, first, size, space)
    work = space.work
    S, law, faded, dH, dK, Z = work[0], work[1], work[2], work[3], work[4], work[5]
    stresses(D, data, tangent, f, S, law, faded)
    moment = space.P  # sum dw z (x) xi
    for p in range(dim):
        for r in range(dim):
            moment[p, r] = dK[p, r] = 0.0
    for q in range(size):
        along = 0.0
        for p in range(dim):
            along += (xi[p, q] + eta[p, q]) * d[p, q]
        slope[q] *= along  # dw
        for p in range(dim):
            z = eta[p, q]
            for r in range(dim):
                z -= H[f, p, r] * xi[r, q]
            for r in range(dim):
                moment[p, r] += slope[q] * z * xi[r, q]
                dK[p, r] += slope[q] * xi[p, q] * xi[r, q]
    db = 0.0
    for p in range(dim):
        for r in range(dim):
            db += data.fading[f, p, r] * dK[p, r]
            dH[p, r] = 0.0
            for q in range(dim):
                dH[p, r] += moment[p, q] * inverse[f, q, r]
    for p in range(dim):
        for r in range(dim):
            total = db * faded[p, r]
            for k in range(dim):
                total -= law[p, k] * dK[k, r]
                for m in range(dim):
                    total += tensor[f, p, r, k, m] * dH[k, m]
            Z[p, r] = total
    for p in range(dim):
        for r in range(dim):
            moment[p, r] = 0.0  # Z L
            for q in range(dim):
                moment[p, r] += Z[p, q] * inverse[f, q, r]
    y = space.H[0]
    for q in range(size):
        w, dw = base.weight[first + q], slope[q]
        control = dw * base.control[f] + w * db * data.control[f]
        for p in range(dim):
            total = control * eta[p, q]
            for r in range(dim):
                total += (w * moment[p, r] + dw * S[p, r]) * xi[r, q]
            t[p, q] += total
        if base.share[f] < 1.0:
            strain, _ = rod(D, xi, eta, q, y)
            strain *= dw * base.rod[f] - w * db * data.rod[f]
            for p in range(dim):
                t[p, q] += strain * y[p]


@implements(element_state, SoftenedGradients)
def element(D, data, tangent, f, first, size, space, block, left, right):
    dim, base, H, tensor = len(D), data.base, tangent.gradient, tangent.base.tensor
    xi, eta = space.xi, space.eta
    soften_family(D, data, f, first, size, space)
    element_state(D, base, tangent.base, f, first, size, space, block, left, right)
    work = space.work
    S, law, faded = work[0], work[1], work[2]
    stresses(D, data, tangent, f, S, law, faded)
    y, z, Lxi = work[3, 0], work[3, 1], work[3, 2]
    for q in range(size):
        w, slope = base.weight[first + q], space.slope[q]
        strain = 0.0
        if base.share[f] < 1.0:
            strain, _ = rod(D, xi, eta, q, y)
        fade = 0.0  # db = slope fade y.deta
        for p in range(dim):
            y[p] = xi[p, q] + eta[p, q]
            z[p], Lxi[p] = eta[p, q], 0.0
            for r in range(dim):
                z[p] -= H[f, p, r] * xi[r, q]
                Lxi[p] += base.inverse[f, p, r] * xi[r, q]
                fade += data.fading[f, p, r] * xi[p, q] * xi[r, q]
        for p in range(dim):
            left[q, dim + p] = w * (data.control[f] * eta[p, q] - data.rod[f] * strain * y[p])
            pull = base.control[f] * eta[p, q] + base.rod[f] * strain * y[p]
            for r in range(dim):
                pull += S[p, r] * xi[r, q]
            for r in range(dim):
                block[q, p, r] += slope * pull * y[r]
            right[q, dim**3 + p] = slope * fade * y[p]
        for p in range(dim):
            for m in range(dim):
                softening = fade * faded[p, m]
                for k in range(dim):
                    softening -= law[p, k] * xi[k, q] * xi[m, q]
                    for j in range(dim):
                        softening += tensor[f, p, m, k, j] * z[k] * Lxi[j]
                for r in range(dim):
                    total = slope * softening * y[r]
                    for j in range(dim):
                        total += w * tensor[f, p, m, r, j] * Lxi[j]
                    right[q, (p * dim + m) * dim + r] = total


@njit(cache=True, inline="always")
def mode(D, left, right, p, r):
    """Entry (p, r) of left right."""
    dim = len(D)
    total = left[dim + p] * right[dim**3 + r]
    for m in range(dim):
        total += left[m] * right[(p * dim + m) * dim + r]
    return total


@implements(mode_block, SoftenedGradients)
def coupling(D, data, tangent, f, left, right, block):
    for p in range(len(D)):
        for r in range(len(D)):
            block[p, r] = mode(D, left, right, p, r)


@implements(add_modes, SoftenedGradients)
def modes(D, data, tangent, f, left, right, first, last, neighbours, position, V, half, blocks):
    for b in range(first, last):
        k = position[neighbours[b]]
        for p in range(len(D)):
            for r in range(len(D)):
                blocks[k, p, r] += V * mode(D, left, right[b], p, r)


@njit(cache=True, **FAST)
def refresh(D, data, X, center, offsets, neighbours, u):
    """Fill the base data of all families at a state."""
    space = scratch(D, offsets)
    for f in range(len(center)):
        first, last = offsets[f], offsets[f + 1]
        gather_two(D, X, u, center[f], first, last, neighbours, space.xi, space.eta)
        soften_family(D, data, f, first, last - first, space)
