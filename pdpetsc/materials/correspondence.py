"""Correspondence material (non-ordinary state-based): a classical law P(F) on the nonlocal deformation gradient.

    K = sum_j w beta V_j xi (x) xi,  g_j = w beta V_j K^-1 xi_j,  F = I + H,  H = sum_j eta_j (x) g_j,
    T<xi> = w P(F) K^-1 xi + T_z<xi>                     (seed 004 Eq. 3.16-3.22, 5.11; FORMULATION "Correspondence")

The energy of a family is V_i (W(F) + zero-energy control), the family's forces are its gradient, and its tangent
V_i g . dP/dF . g is symmetric.

Bonds that break leave K, F, T and T_z together, and F stays exact for affine motions of the bonds that are left. That
ends where these no longer span the space. With the smallest eigenvalue of K as a measure,

    q = lambda_min(K)/lambda_min(K_whole),    b = s^2 (3 - 2 s),  s = (q - 0.1)/0.2 between 0 and 1,

a family keeps the share b of its law and of its zero-energy control, and 1 - b of it is rods along its bonds, 1/2 r w
e^2 with r = n^2 K'/tr(K_whole): what each bond would have in a bond-based solid. A straight crack beside a particle
leaves it q = 1/2, so crack faces are b = 1; it is splinters between cracks that become rods, and come loose at q = 0.1.
Without that, bonds across the load hold them like hinges: they turn, and a criterion that sees their stretch only never
breaks them.
"""

from typing import Literal

import numpy as np

from pdpetsc.errors import InputError
from pdpetsc.materials import correspondence_kernels as kernels
from pdpetsc.materials.base import Elastic, Material, Neighbourhood
from pdpetsc.materials.elasticity import LAWS, elastic_law
from pdpetsc.materials.families import dimension
from pdpetsc.materials.softened_gradients import SoftenedGradients, SoftenedGradientTangent, refresh
from pdpetsc.materials.stabilisation import (
    AFFINE_PART_REMOVED,
    Stabilisation,
    ZeroEnergyControl,
    control_modulus,
)

SMALLEST_SHAPE = 1e-6
"""Smallest ratio of the eigenvalues of a shape tensor: below, the family does not span the body's dimension."""


class Correspondence(Material):
    """Correspondence material on its families.

    Args:
        part: the particles and families that it acts on.
        elasticity: name of the law P(F) ("hencky", "saint_venant_kirchhoff", "neo_hookean").
        young, poisson: E [force/area] and nu [-].
        stabilisation: the zero-energy control.
        plane: "strain", or "stress" (in 1D uniaxial stress).

    Raises:
        InputError: a family whose bonds do not span the dimension (singular shape tensor K).
    """

    name = "correspondence"

    class Keys(Elastic):
        elasticity: Literal[*LAWS] = "hencky"
        stabilisation: ZeroEnergyControl = {"kind": "silling"}

    def __init__(
        self, part: Neighbourhood, elasticity: str, young: float, poisson: float, stabilisation: Stabilisation,
        plane: str = "strain",
    ):  # fmt: skip
        self._stabilisation = stabilisation
        self._choices = {"elasticity": elasticity} | ({"plane": plane} if part.dim < 3 else {})
        dim, families = part.dim, part.families
        self._law = law = elastic_law(elasticity, young, poisson, plane, dim)
        self._stress_dim = dimension(dim if plane == "stress" else 3)
        shape = part.weighted_moments(part.position)
        _check_shape(shape, families, part.position)
        weight = part.weight * part.volume[families.neighbours]
        c = control_modulus(stabilisation, law.lame, law.shear, shape, part.horizon[families.center], part.thickness)
        affine = AFFINE_PART_REMOVED[stabilisation.kind] * c[:, None, None] * shape
        whole = np.ones(len(families)), np.zeros(len(families))
        data = kernels.Gradients(law, weight, np.linalg.inv(shape), c, affine, law.lame + 2 * law.shear, *whole)
        tangent = kernels.GradientTangent(np.empty((len(families), *(dim,) * 4)))
        super().__init__(part, data, tangent, law.lame, law.shear, plane)
        self._whole = data
        self._rod = dim**2 * (self.lame + 2 * self.shear / dim) / np.trace(shape, axis1=1, axis2=2)

    def _keep(self, intact):
        part, whole, dim = self._part, self._whole, self._part.dim
        shape = part.weighted_moments(part.position, intact)
        s = np.clip((self._span(intact) - kernels.FADE[0]) / (kernels.FADE[1] - kernels.FADE[0]), 0, 1)
        share = s**2 * (3 - 2 * s)
        shape[share == 0] = np.eye(dim)  # not inverted
        inverse = np.linalg.inv(shape) * (share > 0)[:, None, None]
        control = share * whole.control
        affine = AFFINE_PART_REMOVED[self._stabilisation.kind] * control[:, None, None] * shape
        rod = (1 - share) * self._rod
        self._data = whole._replace(
            weight=whole.weight * intact, inverse=inverse, control=control, affine=affine, share=share, rod=rod
        )
        self.follows_bonds = bool(rod.any())
        self._mechanics = self._data, self._bonds

    def _fade(self, parts):
        self._keep(parts)

    def _softened(self, softening):
        data, whole, dim = self._data, self._whole, self._part.dim
        self.mode_sizes = 2 * dim, dim**3 + dim
        base = data._replace(weight=np.empty_like(data.weight))
        softened = SoftenedGradients(
            base, softening, data.weight, self._whole_shape, whole.control, self._rod,
            float(AFFINE_PART_REMOVED[self._stabilisation.kind]), np.empty_like(data.inverse),
        )  # fmt: skip
        H = np.empty_like(data.inverse)
        return softened, SoftenedGradientTangent(self._tangent, H, H.copy())

    def _data_at(self, u):
        """Data of the unsoftened model with the weights that its bonds have in a state."""
        if isinstance(self._data, SoftenedGradients):
            refresh(self._D, self._data, self._X, *self._bonds, u)
        return getattr(self._data, "base", self._data)

    @classmethod
    def from_case(cls, keys, part):
        control = keys.stabilisation
        if control.strength is None:
            stabilisation = Stabilisation(control.kind)
        else:
            stabilisation = Stabilisation(control.kind, control.strength, control.scale or "horizon")
        return cls(part, keys.elasticity, keys.E, keys.nu, stabilisation, keys.plane)

    def displacement_gradient(self, u):
        H = np.zeros((len(self.families), 3, 3))
        d = self._data_at(u)
        kernels.gradients(self._D, d.law, d.weight, d.inverse, self._X, *self._bonds, u, H)
        return H

    def cauchy_stress(self, u):
        H = self.displacement_gradient(u)
        sigma = np.empty_like(H)
        kernels.cauchy_stresses(self._stress_dim, self._law, H, sigma)
        return sigma

    def choices(self):
        return {**self._choices, "stabilisation": self._stabilisation._asdict()}


def _check_shape(shape: np.ndarray, families, X: np.ndarray) -> None:
    eigenvalues = np.linalg.eigvalsh(shape)
    flat = np.flatnonzero(~(eigenvalues[:, 0] > SMALLEST_SHAPE * eigenvalues[:, -1]))
    if len(flat):
        where = ", ".join(f"{x:g}" for x in X[families.center[flat[0]]])
        bonds = families.offsets[flat[0] + 1] - families.offsets[flat[0]]
        raise InputError(
            f"the family of the particle at ({where}), {bonds} bonds, does not span {X.shape[1]} dimensions "
            "(singular shape tensor), so a correspondence material has no deformation gradient there; "
            "enlarge body.horizon or add rows of particles"
        )
