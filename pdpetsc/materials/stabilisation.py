"""Zero-energy control of correspondence models.

F sees only the affine part of a family's deformation, so displacements that leave all F unchanged cost no energy.
Every control here is quadratic: it adds to the energy of family i

    1/2 V_i c_i ( sum_j w_j |eta_j|^2  -  a  H K : H ),      w_j = w beta_ij V_j,

with a = 1 for `silling` and 0 for `spring`. Since sum_j w_j |eta_j - H xi_j|^2 = sum_j w_j |eta_j|^2 - H K : H, the
first is the energy of the non-affine part z = y - F xi alone (seed 004 Eq. 5.12, 5.16; T_z = c w z because
sum_j w_j z_j (x) xi_j = 0, Eq. 5.17), and affine fields stay free of it.

Its modulus c_i [force/length^7] is a strength G times one of two scales:

    "family":   c_i = G mu / lambda_max(K_i)           lambda_max: largest eigenvalue of the shape tensor K_i

with the modulus mu of the softest wave (lambda + 2 mu in 1D, where there is no shear), so that one strength serves
every dimension, Poisson's ratio, influence function and horizon. In the bulk, with m_p = sum_j w_j xi_1^p, F softens a
shear wave by 1 - k^2 m_4/(3 m_2) and the control gives back G k^2 m_4/(4 m_2): whatever the family, G = 4/3 is exact to
fourth order, and G = 1 takes nearest neighbours to the classical difference stencil. A case that names no strength
gets this scale with G = 1; docs/theory/stabilisation.md has the derivation and says why.

    "horizon":  c_i = G C_delta,  C_delta = 18 K/(pi delta^5) in 3D, 12 K'/(pi h delta^4) in 2D, 2 M/(A delta^3) in 1D

the micromodulus of the bond-based solid, in which the literature counts G (seed 004 Eq. 5.12-5.14 divides it by omega_0
besides, and with that G depends on the unit of length). The best G then changes with the horizon, Poisson's ratio and
the problem. This is what a strength in the case file means, unless it names the other scale.
"""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge

from pdpetsc.materials.base import Keys

AFFINE_PART_REMOVED = {"none": 0.0, "spring": 0.0, "silling": 1.0}
"""a of the energy above. `spring` is seed 004 Eq. 3.41: not objective, no patch test, for comparison only."""


class ZeroEnergyControl(Keys):
    """The table `stabilisation` of a case: without a strength, the control that needs no tuning."""

    kind: Literal["none", "spring", "silling"]
    strength: Annotated[float, Ge(0)] | None = None
    scale: Literal["horizon", "family"] | None = None

    def check(self, dim):
        if self.scale and self.strength is None:
            raise ValueError("scale goes with strength")


class Stabilisation(NamedTuple):
    """Zero-energy control: its kind, its dimensionless strength G and the scale in which G counts."""

    kind: str
    strength: float = 1.0
    scale: str = "family"


def control_modulus(
    control: Stabilisation, lame: float, shear: float, shape: np.ndarray, horizon: np.ndarray, thickness: float
) -> np.ndarray:
    """c_i of families with shape tensors (n, dim, dim) and horizons (n,) [force/length^7]."""
    dim = shape.shape[-1]
    if control.kind == "none":
        return np.zeros(len(shape))
    if control.scale == "family":
        softest = shear if dim > 1 else lame + 2 * shear
        return control.strength * softest / np.linalg.eigvalsh(shape)[:, -1]
    bulk = lame + 2 * shear / dim  # n-dimensional: in 2D E / (2 (1 + nu)(1 - 2 nu)), seed 004 Eq. 5.14
    factor = {1: 2 / thickness, 2: 12 / (np.pi * thickness), 3: 18 / np.pi}[dim]
    return control.strength * factor * bulk / horizon ** (dim + 2)
