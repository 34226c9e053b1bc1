"""The compressible neo-Hookean law, with lateral directions that are unstretched or free of stress.

Free: k = 3 - dim such directions have the same squared stretch C33. With J of the body's own dimensions,

    tau_33 = mu (C33 - 1) + lambda ln(J C33^(k/2)) = 0

or, with x = ln C33, the ratio of small strains l = e_33 / tr(e) = -lambda / (k lambda + 2 mu), and a = 1 + k l,

    a (e^x - 1) + (1 - a) x = 2 l ln J.

By the first form lambda drops out of what follows from W: P = mu (F - C33 F^-T).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.materials.tensors import (
    EXACT,
    green_strain,
    invalid,
    inverse_transpose,
    jacobian_excess,
    logarithm_deficit,
    spectral_stretch,
)


class NeoHookean(NamedTuple):
    """W = mu/2 (tr C - 3 - 2 ln J) + lambda/2 (ln J)^2 (compressible; Bonet and Wood 2008, Eq. 6.27)."""

    lame: float
    shear: float


class NeoHookeanPlaneStress(NamedTuple):
    """Minimum of the neo-Hookean W over the lateral stretch: plane stress in 2D, uniaxial stress in 1D.

    `lame` is lambda' = -2 lateral mu of the body's dimension, `lateral` is e_33 / tr(e) of small strains.
    """

    lame: float
    shear: float
    lateral: float


def neo_hookean_energy(law, H, work):
    log_jacobian = np.log1p(jacobian_excess(H))
    return law.shear * shear_energy(H, work) + 0.5 * law.lame * log_jacobian * log_jacobian


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
    G = work[0]
    excess = jacobian_excess(H)
    inverse_transpose(H, 1.0 + excess, G)
    fill_tensor(law.shear, law.lame, law.shear - law.lame * np.log1p(excess), G, A)


def neo_hookean_lateral(law, H, work):
    return 0.0


def plane_stress_energy(law, H, work):
    free = 3 - H.shape[0]
    log_jacobian = np.log1p(jacobian_excess(H))
    x = lateral_logarithm(law.lateral, free, log_jacobian)
    excess = np.expm1(x)
    energy = shear_energy(H, work) + 0.5 * free * logarithm_deficit(excess)
    return law.shear * (energy - 0.5 * excess * (log_jacobian + 0.5 * free * x))


def plane_stress_piola(law, H, P, work):
    n = H.shape[0]
    if invalid(H):
        P[:, :] = np.nan
        return
    E, G = work[0], work[1]
    jacobian = jacobian_excess(H)
    green_strain(H, E)
    inverse_transpose(H, 1.0 + jacobian, G)
    excess = np.expm1(lateral_logarithm(law.lateral, 3 - n, np.log1p(jacobian)))
    for i in range(n):
        for j in range(n):
            value = -excess * G[i, j]
            for k in range(n):  # F - C33 F^-T = F^-T (C - I - (C33 - 1) I)
                value += 2.0 * G[i, k] * E[k, j]
            P[i, j] = law.shear * value


def plane_stress_tensor(law, H, A, work):
    n = H.shape[0]
    G = work[0]
    jacobian = jacobian_excess(H)
    inverse_transpose(H, 1.0 + jacobian, G)
    excess = np.expm1(lateral_logarithm(law.lateral, 3 - n, np.log1p(jacobian)))
    squared = 1.0 + excess
    slope = 1.0 + (1.0 + (3 - n) * law.lateral) * excess  # d/dx of the left side; > 0 where there is a solution
    fill_tensor(law.shear, law.lame * squared / slope, law.shear * squared, G, A)


def plane_stress_lateral(law, H, work):
    if invalid(H):
        return np.nan
    return np.expm1(0.5 * lateral_logarithm(law.lateral, 3 - H.shape[0], np.log1p(jacobian_excess(H))))


@njit(cache=True, **EXACT)
def shear_energy(H, work):
    """1/2 (tr C - n) - ln J as a sum over the principal stretches: nothing cancels at small strains."""
    D, Q = work[0], work[1]
    spectral_stretch(H, D, Q)
    value = 0.0
    for a in range(H.shape[0]):
        value += 0.5 * logarithm_deficit(D[a, a])
    return value


@njit(cache=True, **EXACT)
def fill_tensor(shear, volumetric, geometric, G, A):
    """A_iJkL = shear delta_ik delta_JL + volumetric G_iJ G_kL + geometric G_iL G_kJ with G = F^-T."""
    n = A.shape[0]
    for i in range(n):
        for J in range(n):
            for k in range(n):
                for L in range(n):
                    value = volumetric * G[i, J] * G[k, L] + geometric * G[i, L] * G[k, J]
                    if i == k and J == L:
                        value += shear
                    A[i, J, k, L] = value


@njit(cache=True, **EXACT)
def lateral_logarithm(lateral, free, log_jacobian):
    """The x = ln C33 that frees `free` directions from stress, to rounding; NaN where none does.

    Newton from above: f = x - x0 + a (e^x - 1 - x) is convex, and x0 and what is below it here bound the root from
    above, so that the iterates only fall. For nu < 0 (a > 1) f has a minimum, and the root above it is the one that the
    undeformed body leads to; under strong compression there is none, and the iterates fall past the minimum.
    """
    a = 1.0 + free * lateral
    x0 = 2.0 * lateral * log_jacobian
    x = x0
    if x0 > 0.0 and a >= 1.0:
        x = np.log1p(x0)
    elif x0 > 0.0 and a > 0.0:
        x = min(x0, np.log1p(x0 / a))
    for _ in range(100):
        excess = np.expm1(x)
        slope = 1.0 + a * excess
        if not slope > 0.0:
            return np.nan
        step = (x - x0 + a * (excess - x)) / slope
        x -= step
        if not step > 4e-16 * abs(x):
            break
    return x
