"""Correspondence material (non-ordinary state-based): a classical law P(F) on the nonlocal deformation gradient.

    K = sum_j w beta V_j xi (x) xi,  g_j = w beta V_j K^-1 xi_j,  F = I + H,  H = sum_j eta_j (x) g_j,
    T<xi> = w P(F) K^-1 xi + T_z<xi>                     (seed 004 Eq. 3.16-3.22, 5.11; FORMULATION "Correspondence")

The energy of a family is V_i (W(F) + zero-energy control), the family's forces are its gradient, and its tangent
V_i g . dP/dF . g is symmetric.
"""

import numpy as np

from pdpetsc.errors import InputError
from pdpetsc.materials import correspondence_kernels as kernels
from pdpetsc.materials.base import Material, Neighbourhood
from pdpetsc.materials.elasticity import elastic_law
from pdpetsc.materials.stabilisation import AFFINE_PART_REMOVED, Stabilisation, control_modulus

SMALLEST_SHAPE = 1e-6
"""Smallest ratio of the eigenvalues of a shape tensor: below, the family does not span the body's dimension."""


class Correspondence(Material):
    """Correspondence material on its families.

    Args:
        neighbourhood: the particles and families that it acts on.
        weight: influence times partial-volume factor w beta of each bond [-].
        elasticity: name of the law P(F) ("hencky", "saint_venant_kirchhoff", "neo_hookean").
        young, poisson: E [force/area] and nu [-].
        stabilisation: the zero-energy control.

    Raises:
        InputError: a family whose bonds do not span the dimension (singular shape tensor K).
    """

    name = "correspondence"

    def __init__(
        self,
        neighbourhood: Neighbourhood,
        weight: np.ndarray,
        elasticity: str,
        young: float,
        poisson: float,
        stabilisation: Stabilisation,
    ):
        self.families = families = neighbourhood.families
        self.dual = neighbourhood.dual
        self._elasticity = elasticity
        self._stabilisation = stabilisation
        self._law = law = elastic_law(elasticity, young, poisson)
        self.modulus = law.lame + 2 * law.shear
        self._volume = neighbourhood.volume
        X = neighbourhood.position
        dim = X.shape[1]
        self._dim = kernels.dimension(dim)

        n = len(families)
        shape = np.zeros((n, dim, dim))
        kernels.shape_tensors(self._dim, *self._bonds(), X, weight, self._volume, shape)
        _check_shape(shape, families, X)
        self._g, self._g_center = np.empty((families.bonds, dim)), np.empty((n, dim))
        kernels.shape_gradients(
            self._dim, *self._bonds(), X, weight, self._volume, np.linalg.inv(shape), self._g, self._g_center
        )
        delta = neighbourhood.horizon[families.center]
        c = control_modulus(stabilisation, law.lame, law.shear, shape, delta, neighbourhood.thickness)
        self._spring = np.repeat(c, np.diff(families.offsets)) * weight * self._volume[families.neighbours]
        self._affine = AFFINE_PART_REMOVED[stabilisation.kind] * c[:, None, None] * shape
        self._own = np.full(len(X), -1, np.int32)
        self._own[families.center] = np.arange(len(families))
        self._tensor = np.empty((0,) * 5)

    @classmethod
    def from_case(cls, spec, neighbourhood, weight):
        control = spec.stabilisation
        if control.strength is None:
            stabilisation = Stabilisation(control.kind)
        else:
            stabilisation = Stabilisation(control.kind, control.strength, control.scale or "horizon")
        return cls(neighbourhood, weight, spec.elasticity, spec.E, spec.nu, stabilisation)

    def _bonds(self):
        return self.families.center, self.families.offsets, self.families.neighbours

    def _family_arrays(self):
        return *self._bonds(), self._g

    def add_force(self, u, force):
        kernels.add_force(
            self._dim, self._law, *self._family_arrays(), self._spring, self._affine, self._volume, u, force
        )

    def add_force_scale(self, u, scale):
        kernels.add_force_scale(self._dim, self.modulus, *self._family_arrays(), self._spring, self._volume, u, scale)

    def linearise(self, u):
        if not len(self._tensor):
            self._tensor = np.empty((len(self.families), *(u.shape[1],) * 4))
        kernels.linearise(self._dim, self._law, *self._family_arrays(), self._affine, u, self._tensor)

    def add_action(self, du, force):
        kernels.add_action(self._dim, *self._family_arrays(), self._spring, self._tensor, self._volume, du, force)

    def add_rows(self, row_offsets, columns, blocks):
        dual = self.dual
        kernels.add_rows(
            self._dim, *self._family_arrays(), self._g_center, self._spring, self._tensor, self._volume, self._own,
            dual.offsets, dual.family, dual.bond, row_offsets, columns, blocks,
        )  # fmt: skip

    def energy(self, u):
        energy = np.empty(len(self.families))
        kernels.energies(
            self._dim, self._law, *self._family_arrays(), self._spring, self._affine, self._volume, u, energy
        )
        return energy

    def displacement_gradient(self, u):
        H = np.zeros((len(self.families), 3, 3))
        kernels.gradients(self._dim, *self._family_arrays(), u, H)
        return H

    def cauchy_stress(self, u):
        H = self.displacement_gradient(u)
        sigma = np.empty_like(H)
        kernels.cauchy_stresses(self._law, H, sigma)
        return sigma

    def choices(self):
        return {
            "model": self.name,
            "elasticity": self._elasticity,
            "stabilisation": self._stabilisation._asdict(),
        }


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
