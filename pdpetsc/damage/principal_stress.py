"""Maximum principal stress of a bond, with Mohr-Coulomb's shear (seed 004 section 2.4.4)."""

from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Lt

from pdpetsc.damage.base import Criterion, Positive, per_family, value_of
from pdpetsc.materials.base import Keys
from pdpetsc.materials.tensors import eigen_symmetric


class PrincipalStress(NamedTuple):
    """Tensile strength of each family [force/area], c cos(phi) (0: no shear criterion) and sin(phi); `work` (2, 3, 3)
    is scratch."""

    strength: np.ndarray
    cohesive: float
    sine: float
    work: np.ndarray


class MaximumPrincipalStress(Criterion):
    """The larger of sigma_1/f_t and, with cohesion c and friction angle phi, Mohr-Coulomb's ratio, from the principal
    values sigma_1 >= sigma_2 >= sigma_3 of the mean Cauchy stress of both ends, tension positive.

    Shear slips where |tau_n| >= c - sigma_n tan(phi) on some plane. Mohr's circle has the centre m = (sigma_1 +
    sigma_3)/2 and the radius tau = (sigma_1 - sigma_3)/2; its distance from that line is (c - m tan(phi)) cos(phi), so

        tau >= tau_c = c cos(phi) - m sin(phi)

    seed 004 Eq. 2.34-2.35 with the other sign of m, for it is printed with compression positive. The ratio is (tau +
    m sin(phi))/(c cos(phi)): 1 where tau/tau_c is, but proportional to the load, as sigma_1/f_t, and a number beyond
    the apex of the cone too, where tau_c <= 0.
    """

    name = "principal_stress"
    field = "cauchy_stress"

    class Keys(Keys):
        critical: Positive
        cohesion: Positive | None = None
        friction_angle: Annotated[float, Ge(0), Lt(90)] | None = None

        def check(self, dim):
            if (self.cohesion is None) != (self.friction_angle is None):
                raise ValueError("cohesion and friction_angle (in degrees) go together; give both or none")

    @classmethod
    def from_case(cls, keys, material):
        cohesive = sine = 0.0
        if keys.cohesion is not None:
            angle = np.deg2rad(keys.friction_angle)
            cohesive, sine = float(keys.cohesion * np.cos(angle)), float(np.sin(angle))
        strength = per_family(material, keys.critical)
        return cls(material, PrincipalStress(strength, cohesive, sine, np.empty((2, 3, 3))))


@value_of(PrincipalStress)
def principal_stress(D, data, f, i, j, X, u, tensor):
    S = data.work[0]
    for p in range(3):
        for q in range(3):
            S[p, q] = 0.25 * ((tensor[i, p, q] + tensor[j, p, q]) + (tensor[i, q, p] + tensor[j, q, p]))
    eigen_symmetric(S, data.work[1], 3)
    largest = max(S[0, 0], S[1, 1], S[2, 2])
    smallest = min(S[0, 0], S[1, 1], S[2, 2])
    ratio = largest / data.strength[f]
    if data.cohesive > 0.0:
        shear = 0.5 * (largest - smallest) + 0.5 * (largest + smallest) * data.sine
        ratio = max(ratio, shear / data.cohesive)
    return ratio
