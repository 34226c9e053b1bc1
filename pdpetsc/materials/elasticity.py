"""Hyperelastic laws P(F) and dP/dF for correspondence models, in closed form and from the displacement gradient.

A law is a NamedTuple of its parameters; `energy_density`, `first_piola` and `elasticity_tensor` are overloaded on its
type, so that the family kernels are compiled once per law. Everything is written in H = F - I: with F itself the
strains of a slender body drown in rounding (log1p and expanded differences keep full relative accuracy).

Arrays are `dim x dim` with dim = 1, 2 or 3; the directions that a body does not have are unstretched (plane strain,
uniaxial strain), so the same expressions serve. P is the first Piola-Kirchhoff stress [force/area], row = direction
of the force; A[i, J, k, L] = dP_iJ / dF_kL. Where F is inverted or singular, P is NaN: the solver takes it as
"outside the domain" and cuts the step. `work` is scratch space of shape (8, 3, 3).
"""

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from pdpetsc.materials.tensors import (
    green_strain,
    invalid,
    inverse_transpose,
    jacobian_excess,
    mean_logarithmic_slope,
    spectral_stretch,
)


class Hencky(NamedTuple):
    """tau = lambda tr(e) I + 2 mu e with e = 1/2 ln(F F^T) and P = tau F^-T (seed 004 Eq. 3.4-3.9, 1/2 restored)."""

    lame: float
    shear: float


class SaintVenantKirchhoff(NamedTuple):
    """S = lambda tr(E) I + 2 mu E with E = 1/2 (F^T F - I) and P = F S."""

    lame: float
    shear: float


class NeoHookean(NamedTuple):
    """W = mu/2 (tr C - 3 - 2 ln J) + lambda/2 (ln J)^2 (compressible; Bonet and Wood 2008, Eq. 6.27)."""

    lame: float
    shear: float


LAWS = {"hencky": Hencky, "saint_venant_kirchhoff": SaintVenantKirchhoff, "neo_hookean": NeoHookean}


def elastic_law(name: str, young: float, poisson: float) -> NamedTuple:
    """The law of that name with Lame's constants from Young's modulus and Poisson's ratio."""
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    return LAWS[name](lame, young / (2 * (1 + poisson)))


def energy_density(law, H, work):
    """Strain energy per reference volume [energy/volume]."""


def first_piola(law, H, P, work):
    """Fill P with the first Piola-Kirchhoff stress, NaN where F is inverted."""


def elasticity_tensor(law, H, A, work):
    """Fill A[i, J, k, L] = dP_iJ / dF_kL, shape (dim, dim, dim, dim)."""


def hencky_energy(law, H, work):
    D, Q = work[0], work[1]
    spectral_stretch(H, D, Q)
    trace = 0.0
    square = 0.0
    for a in range(H.shape[0]):
        e = 0.5 * np.log1p(D[a, a])
        trace += e
        square += e * e
    return 0.5 * law.lame * trace * trace + law.shear * square


def hencky_piola(law, H, P, work):
    n = H.shape[0]
    if invalid(H):
        P[:, :] = np.nan
        return
    tau, Q, G = work[0], work[1], work[2]
    spectral_stretch(H, tau, Q)
    inverse_transpose(H, 1.0 + jacobian_excess(H), G)
    trace = 0.0
    for a in range(n):
        tau[a, a] = 0.5 * np.log1p(tau[a, a])
        trace += tau[a, a]
    for a in range(n):
        tau[a, a] = law.lame * trace + 2.0 * law.shear * tau[a, a]
    for i in range(n):
        for j in range(n):
            P[i, j] = 0.0
        for a in range(n):
            # (tau F^-T)_ij = sum_a Q_ia tau_a (Q^T F^-T)_aj
            for j in range(n):
                projected = 0.0
                for k in range(n):
                    projected += Q[k, a] * G[k, j]
                P[i, j] += Q[i, a] * tau[a, a] * projected


def hencky_tensor(law, H, A, work):
    # dP = dtau F^-T - tau F^-T dF^T F^-T with dtau = lambda tr(de) I + 2 mu de and, in the frame Q of F F^T,
    # de_ab = 1/2 L_ab db_ab, db = dF F^T + F dF^T, L the divided differences of the logarithm.
    n = H.shape[0]
    P, D, Q, G, F, slope, de, dtau = (
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7],
    )  # fmt: skip
    first_piola(law, H, P, work[1:])
    spectral_stretch(H, D, Q)
    inverse_transpose(H, 1.0 + jacobian_excess(H), G)
    for i in range(n):
        for j in range(n):
            slope[i, j] = mean_logarithmic_slope(D[i, i], D[j, j])
            value = 0.0  # F in the frame of Q: (Q^T F)_ij
            for k in range(n):
                value += Q[k, i] * (H[k, j] + (1.0 if k == j else 0.0))
            F[i, j] = value
    for k in range(n):
        for L in range(n):
            trace = 0.0
            for a in range(n):
                for b in range(n):
                    de[a, b] = 0.5 * slope[a, b] * (Q[k, a] * F[b, L] + F[a, L] * Q[k, b])
                trace += de[a, a]
            for a in range(n):  # dtau, first index turned back: Q dtau
                for b in range(n):
                    value = law.lame * trace * Q[a, b]
                    for c in range(n):
                        value += 2.0 * law.shear * Q[a, c] * de[c, b]
                    dtau[a, b] = value
            for i in range(n):
                for J in range(n):
                    value = -P[i, L] * G[k, J]
                    for a in range(n):
                        projected = 0.0
                        for m in range(n):
                            projected += Q[m, a] * G[m, J]
                        value += dtau[i, a] * projected
                    A[i, J, k, L] = value


def saint_venant_kirchhoff_energy(law, H, work):
    n = H.shape[0]
    E = work[0]
    green_strain(H, E)
    trace = 0.0
    square = 0.0
    for i in range(n):
        trace += E[i, i]
        for j in range(n):
            square += E[i, j] * E[i, j]
    return 0.5 * law.lame * trace * trace + law.shear * square


def saint_venant_kirchhoff_piola(law, H, P, work):
    n = H.shape[0]
    if invalid(H):
        P[:, :] = np.nan
        return
    S = work[0]
    green_strain(H, S)
    trace = 0.0
    for i in range(n):
        trace += S[i, i]
    for i in range(n):
        for j in range(n):
            S[i, j] *= 2.0 * law.shear
        S[i, i] += law.lame * trace
    for i in range(n):
        for j in range(n):
            value = S[i, j]
            for k in range(n):
                value += H[i, k] * S[k, j]
            P[i, j] = value


def saint_venant_kirchhoff_tensor(law, H, A, work):
    n = H.shape[0]
    S, F, B = work[0], work[1], work[2]
    green_strain(H, S)
    trace = 0.0
    for i in range(n):
        trace += S[i, i]
    for i in range(n):
        for j in range(n):
            S[i, j] *= 2.0 * law.shear
            F[i, j] = H[i, j] + (1.0 if i == j else 0.0)
        S[i, i] += law.lame * trace
    for i in range(n):
        for k in range(n):
            value = 0.0
            for j in range(n):
                value += F[i, j] * F[k, j]
            B[i, k] = value
    for i in range(n):
        for J in range(n):
            for k in range(n):
                for L in range(n):
                    value = law.lame * F[i, J] * F[k, L] + law.shear * F[i, L] * F[k, J]
                    if i == k:
                        value += S[L, J]
                    if J == L:
                        value += law.shear * B[i, k]
                    A[i, J, k, L] = value


def neo_hookean_energy(law, H, work):
    n = H.shape[0]
    E = work[0]
    green_strain(H, E)
    trace = 0.0
    for i in range(n):
        trace += E[i, i]
    log_jacobian = np.log1p(jacobian_excess(H))
    return law.shear * (trace - log_jacobian) + 0.5 * law.lame * log_jacobian * log_jacobian


def neo_hookean_piola(law, H, P, work):
    n = H.shape[0]
    if invalid(H):
        P[:, :] = np.nan
        return
    E, G = work[0], work[1]
    excess = jacobian_excess(H)
    green_strain(H, E)
    inverse_transpose(H, 1.0 + excess, G)
    pressure = law.lame * np.log1p(excess)
    for i in range(n):
        for j in range(n):
            value = pressure * G[i, j]
            for k in range(n):  # F - F^-T = F^-T (C - I), without cancellation
                value += 2.0 * law.shear * G[i, k] * E[k, j]
            P[i, j] = value


def neo_hookean_tensor(law, H, A, work):
    n = H.shape[0]
    G = work[0]
    excess = jacobian_excess(H)
    inverse_transpose(H, 1.0 + excess, G)
    geometric = law.shear - law.lame * np.log1p(excess)
    for i in range(n):
        for J in range(n):
            for k in range(n):
                for L in range(n):
                    value = law.lame * G[i, J] * G[k, L] + geometric * G[i, L] * G[k, J]
                    if i == k and J == L:
                        value += law.shear
                    A[i, J, k, L] = value


COMPILED = {
    Hencky: (hencky_energy, hencky_piola, hencky_tensor),
    SaintVenantKirchhoff: (saint_venant_kirchhoff_energy, saint_venant_kirchhoff_piola, saint_venant_kirchhoff_tensor),
    NeoHookean: (neo_hookean_energy, neo_hookean_piola, neo_hookean_tensor),
}


@overload(energy_density)
def _energy_density(law, H, work):
    return COMPILED[law.instance_class][0]


@overload(first_piola)
def _first_piola(law, H, P, work):
    return COMPILED[law.instance_class][1]


@overload(elasticity_tensor)
def _elasticity_tensor(law, H, A, work):
    return COMPILED[law.instance_class][2]
