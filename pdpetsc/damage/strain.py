"""Equivalent and volumetric strain of a bond: the mean of what the families of both ends are strained (seed 004 section
2.4.2, after Warren et al. 2009).

E = (E_i + E_j)/2 with Green's strain E_i = 1/2 (F^T F - I) of each end, or 1/2 (H + H^T) where kinematics are linear:
rigid rotations are no strain.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.damage.base import Criterion, Positive, per_family, value_of
from pdpetsc.materials.base import Keys
from pdpetsc.materials.tensors import EXACT, green_strain, jacobian_excess


class EquivalentStrain(NamedTuple):
    """Critical value of each family."""

    critical: np.ndarray


class VolumetricStrain(NamedTuple):
    """Critical value of each family; `work` (3, 3) is scratch."""

    critical: np.ndarray
    work: np.ndarray


class StrainCriterion(Criterion):
    """A criterion on the mean strain of both ends of a bond. Its critical value does not follow from G_c."""

    field = "displacement_gradient"

    class Keys(Keys):
        critical: Positive

    def ratio(self, u, tensor, both):
        strain = np.empty_like(tensor)
        _strains(tensor, self._material.linear, strain)
        return super().ratio(u, strain, both)


class CriticalEquivalentStrain(StrainCriterion):
    """E_eq/E_c (seed 004 Eq. 2.27-2.28) with

        E_eq = sqrt(2/3 E':E') = sqrt(2/9 [(E11 - E22)^2 + (E22 - E33)^2 + (E11 - E33)^2]
                                      + 4/3 [E12^2 + E13^2 + E23^2])

    (printed with (E12 + E13)^2, which depends on the axes). Uniaxial strain E gives 2/3 E, shear gamma = 2 E12 gives
    gamma/sqrt(3); compression counts like tension.
    """

    name = "equivalent_strain"

    @classmethod
    def from_case(cls, keys, material):
        return cls(material, EquivalentStrain(per_family(material, keys.critical)))


class CriticalVolumetricStrain(StrainCriterion):
    """E_vol/E_c with E_vol = I1 + I2 + I3 = det(I + E) - 1, I the invariants of E (seed 004 Eq. 2.29-2.30, which is
    printed for principal axes). Compression never breaks a bond."""

    name = "volumetric_strain"

    @classmethod
    def from_case(cls, keys, material):
        return cls(material, VolumetricStrain(per_family(material, keys.critical), np.empty((3, 3))))


@njit(cache=True, **EXACT)
def _strains(H, linear, E):
    for k in range(len(H)):
        if linear:
            for p in range(3):
                for q in range(3):
                    E[k, p, q] = 0.5 * (H[k, p, q] + H[k, q, p])
        else:
            green_strain(H[k], E[k])


@value_of(EquivalentStrain)
def equivalent(D, data, f, i, j, X, u, tensor):
    A, B = tensor[i], tensor[j]
    normal, shear = 0.0, 0.0
    for p in range(3):
        q = (p + 1) % 3
        normal += (0.5 * (A[p, p] + B[p, p]) - 0.5 * (A[q, q] + B[q, q])) ** 2
        shear += (0.5 * (A[p, q] + B[p, q])) ** 2
    return np.sqrt(2.0 / 9.0 * normal + 4.0 / 3.0 * shear) / data.critical[f]


@value_of(VolumetricStrain)
def volumetric(D, data, f, i, j, X, u, tensor):
    for p in range(3):
        for q in range(3):
            data.work[p, q] = 0.5 * (tensor[i, p, q] + tensor[j, p, q])
    return jacobian_excess(data.work) / data.critical[f]
