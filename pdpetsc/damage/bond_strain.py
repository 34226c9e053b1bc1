"""Critical bond strain: the part of a bond's deformation that is neither rotation nor dilatation (seed 004 section
2.4.5, after Ren et al. 2016)."""

from typing import NamedTuple

import numpy as np

from pdpetsc.damage.base import Criterion, Critical, only_in, per_family, value_of
from pdpetsc.materials.tensors import jacobian_excess, spectral_stretch

NO_DILATATION = 1e-6
"""Share of the critical strain below which a dilatation counts as none: in pure shear it is 0 up to rounding, which
does not decide."""


class BondStrain(NamedTuple):
    """Critical value of each family, and whether kinematics are linear; `work` (3, 3, 3) is scratch."""

    critical: np.ndarray
    linear: bool
    work: np.ndarray


class CriticalBondStrain(Criterion):
    """eps_d/eps_c where at least one end's volume does not shrink (J >= 1), else 0 (seed 004 Eq. 2.36, in which 1 and 0
    are swapped), with

        eps_d = |R^T y - xi - theta/3 xi|/|xi|,    F = (F_i + F_j)/2 = R U,    theta = tr U - 3

    R takes out the rotation, theta the dilatation: in a homogeneous state eps_d = |dev(U) n|, n = xi/|xi|, which is 0
    for every rotation with equal stretch in all directions, and dev(eps) n where strains are small (linear
    kinematics: y - xi - W xi - tr(H)/3 xi with W the skew part of H, and tr H >= 0).

    G_c in 3D only: with e = (3 mu/m) w |eta_d|^2, w = |xi|^-2, m = 4 pi delta^3/3 each direction stores 9 mu eps_d^2/
    (4 pi delta^3) (Eq. 2.37), and the pairs that cross a unit of area number pi delta^4/4 (Eq. 2.38). Both directions
    of a pair go, so

        G_c = 9 mu delta eps_c^2/8,    eps_c = sqrt(8 G_c/(9 mu delta))

    Eq. 2.40 counts one direction and is larger by sqrt(2).
    """

    name = "bond_strain"
    field = "displacement_gradient"

    class Keys(Critical):
        pass

    @classmethod
    def from_case(cls, keys, material):
        result = cls(material, None)
        critical = keys.critical
        if critical is None:
            only_in(material._part.dim, (3,), "G_c of bond_strain", "give critical")
            critical = np.sqrt(8 * keys.G_c / (9 * material.shear * result.horizon))
        result._data = BondStrain(per_family(material, critical), material.linear, np.empty((3, 3, 3)))
        return result


@value_of(BondStrain)
def bond_strain(D, data, f, i, j, X, u, tensor):
    H, V, Q = data.work[0], data.work[1], data.work[2]
    for p in range(3):
        for q in range(3):
            H[p, q] = 0.5 * (tensor[i, p, q] + tensor[j, p, q])
    if data.linear:
        theta = H[0, 0] + H[1, 1] + H[2, 2]
        of_i = tensor[i, 0, 0] + tensor[i, 1, 1] + tensor[i, 2, 2]
        of_j = tensor[j, 0, 0] + tensor[j, 1, 1] + tensor[j, 2, 2]
    else:
        of_i, of_j = jacobian_excess(tensor[i]), jacobian_excess(tensor[j])
        spectral_stretch(H, V, Q)  # F F^T - I, of which U has the same eigenvalues
        theta = 0.0
        for a in range(3):
            V[a, a] = np.sqrt(1.0 + V[a, a])
        for a in range(3):
            theta += V[a, a] - 1.0
    square, strain = 0.0, 0.0
    for p in range(3):
        part = 0.0  # of y - R xi - theta/3 R xi, as long as R^T of it
        if data.linear:
            for q in range(len(D)):
                part -= 0.5 * (H[p, q] - H[q, p]) * (X[j, q] - X[i, q])
            if p < len(D):
                part += (u[j, p] - u[i, p]) - theta / 3.0 * (X[j, p] - X[i, p])
        else:
            for r in range(3):  # R xi = V^-1 F xi
                along = 0.0
                for q in range(len(D)):
                    along += H[r, q] * (X[j, q] - X[i, q])
                if r < len(D):
                    along += X[j, r] - X[i, r]
                for a in range(3):
                    part -= (1.0 + theta / 3.0) * Q[p, a] / V[a, a] * Q[r, a] * along
            if p < len(D):
                part += (X[j, p] - X[i, p]) + (u[j, p] - u[i, p])
        strain += part * part
        if p < len(D):
            square += (X[j, p] - X[i, p]) ** 2
    if max(of_i, of_j) < -NO_DILATATION * data.critical[f]:
        return 0.0
    return np.sqrt(strain / square) / data.critical[f]
