"""Zero-energy control of correspondence models.

F sees only the affine part of a family's deformation, so displacements that leave all F unchanged cost no energy.
Every control here is quadratic: it adds to the energy of family i

    1/2 V_i c_i ( sum_j w_j |eta_j|^2  -  a  H K : H ),      w_j = w beta_ij V_j,

with a = 1 for `silling` and 0 for `spring`. Since sum_j w_j |eta_j - H xi_j|^2 = sum_j w_j |eta_j|^2 - H K : H, the
first is the energy of the non-affine part z = y - F xi alone (seed 004 Eq. 5.12, 5.16; T_z = c w z because
sum_j w_j z_j (x) xi_j = 0, Eq. 5.17), and affine fields stay free of it.

    c_i = G C_delta, C_delta = 18 K/(pi delta^5) in 3D, 12 K'/(pi h delta^4) in 2D, 2 M/(A delta^3) in 1D

is the micromodulus of the bond-based solid over the horizon [force/length^7]; no omega_0 (seed 004 Eq. 5.12 has it,
and with it G depends on the unit of length).
"""

from typing import NamedTuple

import numpy as np

AFFINE_PART_REMOVED = {"none": 0.0, "spring": 0.0, "silling": 1.0}
"""a of the energy above. `spring` is seed 004 Eq. 3.41: not objective, no patch test, for comparison only."""

DEFAULT_STRENGTH = {"none": 0.0, "spring": 0.1, "silling": 0.1}
"""G where the case gives none."""


class Stabilisation(NamedTuple):
    """Zero-energy control: its kind and its dimensionless strength G."""

    kind: str
    strength: float


def micromodulus(dim: int, lame: float, shear: float, horizon: np.ndarray, thickness: float) -> np.ndarray:
    """C_delta of plane strain (2D), 3D and uniaxial strain (1D); see the module's equation [force/length^7]."""
    bulk = lame + 2 * shear / dim  # n-dimensional; in 2D lambda + mu = E / (2 (1 + nu)(1 - 2 nu)) (seed 004 Eq. 5.14)
    if dim == 1:
        return 2 * bulk / (thickness * horizon**3)
    if dim == 2:
        return 12 * bulk / (np.pi * thickness * horizon**4)
    return 18 * bulk / (np.pi * horizon**5)
