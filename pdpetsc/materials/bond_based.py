"""Bond-based materials: each bond is a spring (seed 002 Eq. 31-40; seed 003 Eq. 16-21; seed 004 Eq. 2.8-2.16)."""

from typing import Literal

import numpy as np

from pdpetsc.influence import influence_moment
from pdpetsc.materials.base import Elastic, Neighbourhood, PoissonRatio, Quadrature
from pdpetsc.materials.ordinary import SPHERE, Kinematics, Moduli, Ordinary, SurfaceCorrection, scaled_to
from pdpetsc.materials.surface import direction_factors
from pdpetsc.quadrature import matched_weights

SAME_RATIO = 0.005
"""Largest difference of a given Poisson's ratio from the fixed one: 0.33 is meant as 1/3."""

Microelastic = Literal["prototype", "general"]


class BondBased(Ordinary):
    """Microelastic bonds: T<xi> = C w s n (prototype, "PM" or "PMB") or C w (|y| - |xi|) n (general).

    C is *half* the classical micromodulus c, since both directions of a bond act. It makes the bulk modulus right:
    sum k |xi|^2 = n^2 K' over the full horizon, where k = C w V/|xi| or C w V. With w = 1, in 3D, 2D, 1D:

        prototype  c = 18 K/(pi delta^4),    12 K'/(pi h delta^3),  2 K'/(A delta^2)
        general    c = 22.5 K/(pi delta^5),  16 K'/(pi h delta^4),  3 K'/(A delta^3)

    With matched weights sum k |xi|^2 n n n n = n^2 K' times the isotropic tensor in every family, cut ones included.

    Central forces fix Poisson's ratio at 1/4 in 3D and plane strain and at 1/3 in plane stress (Cauchy's relation
    lambda = mu of the n-dimensional constants); another one gives a body of the right K' and the wrong shear modulus.

    Args:
        part, kinematics: as in `Ordinary`.
        young, poisson, plane: E [force/area], nu [-], "strain" or "stress".
        quadrature: "matched" or "plain" weights.
        microelastic: "prototype" or "general".
        surface_correction: of plain weights: "energy" scales k in each family so that sum k |xi|^2 = n^2 K',
            "directional" that of each bond by the factors of `surface.direction_factors`, or "none".
    """

    name = "bond"

    class Keys(Elastic):
        nu: PoissonRatio | None = None
        quadrature: Quadrature = "matched"
        microelastic: Microelastic = "prototype"
        kinematics: Kinematics = "nonlinear"
        surface_correction: SurfaceCorrection = "none"
        allow_any_poisson: bool = False

        def check(self, dim):
            Elastic.check(self, dim)
            if self.surface_correction != "none" and self.quadrature != "plain":
                raise ValueError('surface_correction goes with quadrature = "plain"; matched weights need none')
            fixed = fixed_poisson(dim, self.plane)
            if None in (fixed, self.nu) or self.allow_any_poisson or abs(self.nu - fixed) < SAME_RATIO:
                return
            raise ValueError(
                f"nu = {self.nu:g}, but a bond-based material has Poisson's ratio {fixed:.4g} in "
                f'{"3D" if dim == 3 else f"plane {self.plane}"}: leave nu out, choose model = "ordinary" or '
                '"correspondence", or accept a wrong shear modulus with allow_any_poisson = true'
            )

    def __init__(
        self, part: Neighbourhood, young: float, poisson: float, plane: str = "strain", quadrature: str = "matched",
        microelastic: str = "prototype", kinematics: str = "nonlinear", surface_correction: str = "none",
    ):  # fmt: skip
        moduli = Moduli.of(young, poisson, plane, part.dim)
        n, families = part.dim, part.families
        self.force_power = 0 if microelastic == "prototype" else 1
        power = n if microelastic == "prototype" else n + 1  # of r in the integral of w(r) over the horizon
        weight = part.weight.copy()
        if microelastic == "prototype":
            weight /= families.lengths(part.position)
        moment = n**2 * moduli.bulk
        if quadrature == "matched":
            moments = np.full(len(families), moment)
            weight, matched = matched_weights(families, part.position, part.volume, weight, moments)
            self.unmatched = int((~matched).sum())
        else:
            surface = SPHERE[n] * part.thickness * influence_moment(part.influence, power)
            weight *= np.repeat(
                moment / (surface * part.horizon[families.center] ** (power + 1)), np.diff(families.offsets)
            )
        k = weight * part.volume[families.neighbours]
        if surface_correction == "energy":
            k = scaled_to(part, k, 2, moment)
        elif surface_correction == "directional":
            k *= direction_factors(part, k, 2, 3 * moment / (n * (n + 2)))
        self._switches = {
            "nu": poisson, "quadrature": quadrature, "microelastic": microelastic,
            "surface_correction": surface_correction,
        }  # fmt: skip
        super().__init__(part, moduli, k, kinematics=kinematics)

    @classmethod
    def from_case(cls, keys, part):
        fixed = fixed_poisson(part.dim, keys.plane)
        nu = (fixed or 0.0) if keys.nu is None else keys.nu
        if fixed and not keys.allow_any_poisson:
            nu = fixed
        return cls(
            part, keys.E, nu, keys.plane, keys.quadrature, keys.microelastic, keys.kinematics, keys.surface_correction
        )

    def choices(self):
        return super().choices() | self._switches


def fixed_poisson(dim: int, plane: str) -> float | None:
    """Poisson's ratio of bond-based materials; None in 1D, where there is no lateral strain."""
    return None if dim == 1 else 1 / 3 if dim == 2 and plane == "stress" else 1 / 4
