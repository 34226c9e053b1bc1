"""Hyperelastic laws P(F) and dP/dF for correspondence models, in closed form and from the displacement gradient.

A law is a NamedTuple of its parameters; `energy_density`, `first_piola` and `elasticity_tensor` are overloaded on its
type, so that the family kernels are compiled once per law. Everything is written in H = F - I: with F itself the
strains of a slender body drown in rounding (log1p and expanded differences keep full relative accuracy).

Arrays are `dim x dim` with dim = 1, 2 or 3. The 3 - dim directions that a body does not have are unstretched (plane
strain, uniaxial strain), or free of stress (plane stress, uniaxial stress): then their stretch, one for all of them, is
eliminated inside the law by tau_33 = 0, and `lateral_strain` gives it. P is the first Piola-Kirchhoff stress
[force/area], row = direction of the force; A[i, J, k, L] = dP_iJ / dF_kL. Where F is inverted or singular, or no
lateral stretch is free of stress, P is NaN: the solver takes it as "outside the domain" and cuts the step. `work` is
scratch space of shape (8, 3, 3).
"""

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from pdpetsc.materials.neo_hookean import (
    NeoHookean,
    NeoHookeanPlaneStress,
    neo_hookean_energy,
    neo_hookean_lateral,
    neo_hookean_piola,
    neo_hookean_tensor,
    plane_stress_energy,
    plane_stress_lateral,
    plane_stress_piola,
    plane_stress_tensor,
)
from pdpetsc.materials.tensors import (
    EXACT,
    green_strain,
    invalid,
    inverse_transpose,
    jacobian_excess,
    mean_logarithmic_slope,
    spectral_stretch,
)


class Hencky(NamedTuple):
    """tau = lambda tr(e) I + 2 mu e with e = 1/2 ln(F F^T) and P = tau F^-T (seed 004 Eq. 3.4-3.9, 1/2 restored).

    Exact in plane stress too, with the constants of `lame_constants` and e_33 = lateral tr(e).
    """

    lame: float
    shear: float
    lateral: float = 0.0


class SaintVenantKirchhoff(NamedTuple):
    """S = lambda tr(E) I + 2 mu E with E = 1/2 (F^T F - I) and P = F S.

    Exact in plane stress too, with the constants of `lame_constants` and E_33 = lateral tr(E), as long as that is more
    than -1/2, thickness zero.
    """

    lame: float
    shear: float
    lateral: float = 0.0


LAWS = {"hencky": Hencky, "saint_venant_kirchhoff": SaintVenantKirchhoff, "neo_hookean": NeoHookean}
IN_PLANE_STRESS = LAWS | {"neo_hookean": NeoHookeanPlaneStress}


def elastic_law(name: str, young: float, poisson: float, plane: str = "strain", dim: int = 3) -> NamedTuple:
    """The law of that name for bodies of one, two or three dimensions, from Young's modulus and Poisson's ratio.

    Args:
        name: one of `LAWS`.
        young, poisson: E [force/area] and nu [-] of the solid in three dimensions.
        plane: whether the directions that the body does not have are unstretched ("strain") or free of stress
            ("stress": plane stress in 2D, a bar in 1D). In 3D it makes no difference.
        dim: dimensions of the body.

    Returns:
        A law whose `lame` and `shear` are those of `lame_constants`.
    """
    lateral = lateral_ratio(poisson, plane, dim)
    lame, shear = lame_constants(young, poisson, plane, dim)
    if name == "neo_hookean" and lateral == 0.0:
        return NeoHookean(lame, shear)
    return IN_PLANE_STRESS[name](lame, shear, lateral)


def lame_constants(young: float, poisson: float, plane: str = "strain", dim: int = 3) -> tuple[float, float]:
    """Lame's constants lambda', mu of the solid in `dim` dimensions: sigma = lambda' tr(e) I + 2 mu e there.

    In plane stress lambda' = 2 lambda mu / (lambda + 2 mu), in uniaxial stress lambda' = E - 2 mu. The bulk modulus in
    `dim` dimensions is K' = lambda' + 2 mu / dim: K in 3D, K + mu/3 in plane strain, E / (2 (1 - nu)) in plane stress,
    E in uniaxial stress.
    """
    shear = young / (2 * (1 + poisson))
    if is_free(plane, dim):
        return -2 * lateral_ratio(poisson, plane, dim) * shear, shear
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), shear


def lateral_ratio(poisson: float, plane: str = "strain", dim: int = 3) -> float:
    """e_33 / tr(e) of small strains, tr(e) in the dimensions of the body: -lambda / ((3 - dim) lambda + 2 mu)."""
    if not is_free(plane, dim):
        return 0.0
    return -poisson / (1 - poisson) if dim == 2 else -float(poisson)


def is_free(plane: str, dim: int) -> bool:
    """Whether there are directions that are free of stress."""
    if plane not in ("strain", "stress"):
        raise ValueError(f'plane is "strain" or "stress", not {plane!r}')
    return plane == "stress" and dim < 3


def energy_density(law, H, work):
    """Strain energy per reference volume [energy/volume]."""


def first_piola(law, H, P, work):
    """Fill P with the first Piola-Kirchhoff stress, NaN where F is inverted."""


def elasticity_tensor(law, H, A, work):
    """Fill A[i, J, k, L] = dP_iJ / dF_kL, shape (dim, dim, dim, dim)."""


def lateral_strain(law, H, work):
    """H_33, the stretch minus one of the directions that the body does not have; 0 where they cannot stretch."""


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


def hencky_lateral(law, H, work):
    if law.lateral == 0.0:
        return 0.0
    if invalid(H):
        return np.nan
    return np.expm1(law.lateral * np.log1p(jacobian_excess(H)))  # tr(e) = ln J


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
    if not 2.0 * law.lateral * trace > -1.0:
        P[:, :] = np.nan
        return
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


def saint_venant_kirchhoff_lateral(law, H, work):
    if law.lateral == 0.0:
        return 0.0
    E = work[0]
    green_strain(H, E)
    excess = 0.0  # C33 - 1
    for i in range(H.shape[0]):
        excess += 2.0 * law.lateral * E[i, i]
    if invalid(H) or not excess > -1.0:
        return np.nan
    return excess / (1.0 + np.sqrt(1.0 + excess))


COMPILED = {
    Hencky: (hencky_energy, hencky_piola, hencky_tensor, hencky_lateral),
    SaintVenantKirchhoff: (
        saint_venant_kirchhoff_energy,
        saint_venant_kirchhoff_piola,
        saint_venant_kirchhoff_tensor,
        saint_venant_kirchhoff_lateral,
    ),
    NeoHookean: (neo_hookean_energy, neo_hookean_piola, neo_hookean_tensor, neo_hookean_lateral),
    NeoHookeanPlaneStress: (plane_stress_energy, plane_stress_piola, plane_stress_tensor, plane_stress_lateral),
}


@overload(energy_density, jit_options=EXACT)
def _energy_density(law, H, work):
    return COMPILED[law.instance_class][0]


@overload(first_piola, jit_options=EXACT)
def _first_piola(law, H, P, work):
    return COMPILED[law.instance_class][1]


@overload(elasticity_tensor, jit_options=EXACT)
def _elasticity_tensor(law, H, A, work):
    return COMPILED[law.instance_class][2]


@overload(lateral_strain, jit_options=EXACT)
def _lateral_strain(law, H, work):
    return COMPILED[law.instance_class][3]
