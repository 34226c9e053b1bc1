"""Softening: the factor T_s with which a bond fades between two stretches (seed 004 Eq. 6.1).

    T(s) = 1                               s < s_min
           1/2 (1 - tanh(n)/tanh(beta))    n = beta (s_min + s_cr - 2 s)/(s_min - s_cr)
           0                               s >= s_cr

    dT/ds = (dT/dn)(dn/ds),   dT/dn = -1/2 (1 - tanh^2 n)/tanh(beta),   dn/ds = 2 beta/(s_cr - s_min)

n runs from -beta at s_min to beta at s_cr, so T is continuous. The printed form has no tanh(beta) and jumps by
(1 - tanh beta)/2 at both ends, 0.0025 at beta = 3; the printed dT/dn (Eq. 6.7) is wrong. The stretch of a bond is s =
(|y| - |xi|)/|xi|, or xi.eta/|xi|^2 in linear kinematics. Bonds do not heal: s is the larger one of the present stretch
and the largest one that has been committed.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

ROUNDING = 1e-10
"""Below the largest stretch by less, a bond is at it: its derivative must not depend on how the loops round."""


class Softening(NamedTuple):
    """Softening of a material's bonds.

    Attributes:
        start, end: s_min and s_cr of each family's bonds (families,) [-].
        beta: rate of the fading [-].
        rescaled: whether T is 1 and 0 at the two ends, not as printed.
        largest: largest committed stretch of each bond (bonds,) [-], at first 0.
        softens: mask (bonds,) of the bonds that soften; the others are exempt.
        live: whether T follows the present stretch; if not it is T(largest), a constant, and the tangent is symmetric
            where that of the unsoftened model is.
    """

    start: np.ndarray
    end: np.ndarray
    beta: float
    rescaled: bool
    largest: np.ndarray
    softens: np.ndarray
    live: bool = True


@njit(cache=True, inline="always")
def softened(softening, f, bond, stretch):
    """(T, dT/ds) of a bond of family f; at the largest stretch dT/ds is that of loading, whatever the rounding."""
    if not softening.softens[bond]:
        return 1.0, 0.0
    largest = softening.largest[bond]
    loading = softening.live and stretch > largest - ROUNDING
    s = max(stretch, largest) if softening.live else largest
    start, end = softening.start[f], softening.end[f]
    if s < start:
        return 1.0, 0.0
    if s >= end:
        return 0.0, 0.0
    scale = np.tanh(softening.beta) if softening.rescaled else 1.0
    tanh = np.tanh(softening.beta * (start + end - 2.0 * s) / (start - end))
    slope = -(1.0 - tanh * tanh) * softening.beta / ((end - start) * scale) if loading else 0.0
    return 0.5 * (1.0 - tanh / scale), slope


@njit(cache=True)
def committed(softening, offsets, factors):
    """Fill `factors` (bonds,) with T of the largest committed stretches."""
    for f in range(len(offsets) - 1):
        for b in range(offsets[f], offsets[f + 1]):
            factors[b], _ = softened(softening, f, b, softening.largest[b])
