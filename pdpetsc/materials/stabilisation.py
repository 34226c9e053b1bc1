"""Zero-energy control of correspondence models.

F sees only the affine part of a family's deformation, so displacements that leave all F unchanged cost no energy.
Every control here is quadratic: it adds to the energy of family i

    1/2 V_i c_i ( sum_j w_j |eta_j|^2  -  a  H K : H ),      w_j = w beta_ij V_j,

with a = 1 for `silling` and 0 for `spring`. Since sum_j w_j |eta_j - H xi_j|^2 = sum_j w_j |eta_j|^2 - H K : H, the
first is the energy of the non-affine part z = y - F xi alone (seed 004 Eq. 5.12, 5.16; T_z = c w z because
sum_j w_j z_j (x) xi_j = 0, Eq. 5.17), and affine fields stay free of it.

    c_i = G mu / lambda_max(K_i)        [force/length^7; lambda_max: largest eigenvalue of the shape tensor K_i]

with the modulus mu of the softest wave (lambda + 2 mu in 1D, where there is no shear), so that one strength G serves
every dimension, Poisson's ratio, influence function and horizon. In the bulk, with m_p = sum_j w_j xi_1^p, F softens a
shear wave by 1 - k^2 m_4/(3 m_2) and the control gives back G k^2 m_4/(4 m_2): whatever the family, G = 4/3 is exact to
fourth order, and G = 1 takes nearest neighbours to the classical difference stencil. docs/theory/stabilisation.md has
the derivation and says why 1 is the default. (Seed 004 Eq. 5.12-5.14 has c_i = G 12 K'/(pi h delta^4 omega_0): there
the best G changes with horizon, Poisson's ratio and, through omega_0, with the unit of length.)
"""

from typing import NamedTuple

import numpy as np

AFFINE_PART_REMOVED = {"none": 0.0, "spring": 0.0, "silling": 1.0}
"""a of the energy above. `spring` is seed 004 Eq. 3.41: not objective, no patch test, for comparison only."""

DEFAULT_STRENGTH = {"none": 0.0, "spring": 0.1, "silling": 1.0}
"""G where the case gives none; nothing here needs tuning (docs/theory/stabilisation.md)."""


class Stabilisation(NamedTuple):
    """Zero-energy control: its kind and its dimensionless strength G."""

    kind: str
    strength: float


def control_modulus(softest: float, shape: np.ndarray) -> np.ndarray:
    """c_i / G of families with shape tensors (n, dim, dim), by the modulus of the softest wave [force/length^7]."""
    return softest / np.linalg.eigvalsh(shape)[:, -1]
