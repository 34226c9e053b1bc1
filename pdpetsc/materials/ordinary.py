"""Ordinary state-based materials: forces along the bonds, from their extensions and a dilatation.

All are quadratic in the extensions e = |y| - |xi| (ordinary_kernels.py):

    w = 1/2 A theta^2 + 1/2 sum k e^2,    theta = sum c e,    T<xi> V_j = (A theta c + k e) n

A model is its constants k and c of each bond and A of each family; c is k |xi|, or k times a number of each bond's own,
times a factor of the family that goes into A (B below). Moduli are those of n dimensions: lambda and mu in 3D and plane
strain, 2 lambda mu/(lambda + 2 mu) and mu in plane stress; K' = lambda + 2 mu/n.
"""

from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from pdpetsc.errors import InputError
from pdpetsc.influence import INFLUENCE
from pdpetsc.materials import families as kernels
from pdpetsc.materials import sums
from pdpetsc.materials.base import Elastic, Material, Neighbourhood, Quadrature
from pdpetsc.materials.elasticity import lame_constants
from pdpetsc.materials.ordinary_kernels import Extensions, ExtensionTangent, resist_strain
from pdpetsc.materials.softened_kernels import SoftenedExtensions
from pdpetsc.materials.surface import direction_factors
from pdpetsc.quadrature import matched_weights

Kinematics = Literal["nonlinear", "linear"]
SurfaceCorrection = Literal["none", "energy", "directional"]
WeightedVolume = Literal["frozen", "updated"]

SPHERE = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}
"""Surface of the unit sphere in n dimensions."""

SMALLEST_SHAPE = 1e-6
"""Directions of a shape tensor with a smaller part of its largest eigenvalue have no gradient in the output."""


class Moduli(NamedTuple):
    """Isotropic elasticity in n dimensions [force/area].

    Attributes:
        lame, shear: Lame's constants of n dimensions.
        plane: "strain", or "stress" in 2D (uniaxial stress in 1D).
        dim: n.
    """

    lame: float
    shear: float
    plane: str
    dim: int

    @classmethod
    def of(cls, young: float, poisson: float, plane: str, dim: int) -> "Moduli":
        return cls(*lame_constants(young, poisson, plane, dim), plane, dim)

    @property
    def bulk(self) -> float:
        """K' = lambda + 2 mu/n."""
        return self.lame + 2 * self.shear / self.dim

    @property
    def dilatation(self) -> float:
        """K' - (n + 2) mu/n, the part of the bulk modulus that springs between particles do not give."""
        return self.bulk - (self.dim + 2) * self.shear / self.dim


class Ordinary(Material):
    """What ordinary models have in common.

    Args:
        part: the particles and families that it acts on; its weights give the deformation gradient of the output.
        moduli: of the solid that the model stands for.
        k: stiffness of each bond: k e^2/2 is an energy per volume [force/length^4].
        B: modulus of each family's dilatation theta = sum k s e; None: there is none.
        s: of each bond; None: |xi|.
        kinematics: "nonlinear", or "linear" for small displacements (e = xi.eta/|xi| along the reference bond).
        rotation_weighted: whether a bond counts in the dilatation with the cosine of its rotation.
    """

    central = True

    def __init__(
        self, part: Neighbourhood, moduli: Moduli, k: np.ndarray, B: np.ndarray | None = None,
        s: np.ndarray | None = None, kinematics: str = "nonlinear", rotation_weighted: bool = False,
    ):  # fmt: skip
        linear = kinematics == "linear"
        rotation_weighted = rotation_weighted and not linear  # there bonds do not turn
        self.couples_family = dilates = B is not None
        self.symmetric, self.follows_bonds, self.linear = not rotation_weighted, not linear, linear
        self.moduli, self.kinematics = moduli, kinematics
        data = Extensions(k, B if dilates else np.empty(0), s, rotation_weighted, linear)
        tangent = ExtensionTangent(np.empty(len(data.B)))
        super().__init__(part, data, tangent, moduli.lame, moduli.shear, moduli.plane)
        self._whole = data
        self._fold()

    def _fold(self) -> None:
        """Without a dilatation, springs between two families are evaluated once."""
        if not self.couples_family:
            offsets, neighbours, *which = self._pairs
            network = self.families.center, offsets, neighbours
            self._mechanics = self._data._replace(k=sums.folded(*network, *which, self._volume, self._data.k)), network
        else:
            self._mechanics = self._data, self._bonds

    @cached_property
    def _pairs(self) -> tuple:
        return sums.fold(self.own, *self._bonds)

    def _keep(self, intact):
        self._data = self._whole._replace(k=self._whole.k * intact)
        self._fold()

    def _fade(self, parts):
        self._keep(parts > 0)
        self._data = self._data._replace(k=self._data.k * parts)
        self._mechanics = self._data, self._bonds  # not folded, as the tangent is laid out

    def _softened(self, softening):
        data = self._data
        return SoftenedExtensions(data._replace(k=np.empty_like(data.k)), data.k, softening), self._tangent

    def resists_strain(self):
        resists = np.empty(len(self.families), bool)
        resist_strain(self._D, *self._bonds, self._X, self._data.k, resists)
        return resists

    def choices(self):
        plane = {"plane": self.plane} if self.moduli.dim < 3 else {}
        return {**plane, "kinematics": self.kinematics}

    def displacement_gradient(self, u):
        """Of the output: sum w V eta (x) xi K^-1, as a correspondence model has it (zero in directions that the
        family does not span); in plane stress the free directions follow from linear elasticity."""
        part, dim = self._part, self._part.dim
        shape = part.weighted_moments(part.position, self.intact)
        H = np.zeros((len(self.families), 3, 3))
        H[:, :dim, :dim] = part.weighted_moments(u, self.intact) @ np.linalg.pinv(
            shape, rcond=SMALLEST_SHAPE, hermitian=True
        )
        if self.plane == "stress":
            free = range(dim, 3)
            H[:, free, free] = self._lateral_strain(H[:, :dim, :dim])[:, None]
        return H

    def _lateral_strain(self, H):
        """-lambda/(2 mu) tr(strain) with the constants of n dimensions, -nu/(1 - nu) in plane stress."""
        ratio = -self.moduli.lame / (2 * self.moduli.shear)
        if self.linear:
            return ratio * np.trace(H, axis1=1, axis2=2)
        J = np.linalg.det(np.eye(H.shape[1]) + H)
        return np.expm1(ratio * np.log(np.where(J > 0, J, np.nan)))

    def cauchy_stress(self, u):
        """sum T (x) y V_j/J of the family (FORMULATION's family stress), symmetric since T is along y; in plane
        strain with the normal stress of linear elasticity, lambda/(n lambda + 2 mu) of the others' sum."""
        part, dim = self._part, self._part.dim
        tau = np.zeros((len(self.families), dim, dim))
        kernels.stress_moments(self._D, self._data, part.position, *self._bonds, u, not self.linear, tau)
        J = 1.0 if self.linear else np.linalg.det(np.eye(3) + self.displacement_gradient(u))[:, None, None]
        sigma = np.zeros((len(self.families), 3, 3))
        sigma[:, :dim, :dim] = tau / J
        self.add_normal_stress(sigma)
        return sigma


class LinearPeridynamicSolid(Ordinary):
    """The linear peridynamic solid, LPS (Silling et al. 2007; seed 002 Eq. 42; FORMULATION "Models").

        m = sum w |xi|^2,  theta = (n/m) sum w |xi| e,  t = (n K' theta/m) w |xi| + (n (n + 2) mu/m) w e^d,
        e^d = e - theta |xi|/n

    that is c = n w |xi| V/m = k |xi|/((n + 2) mu), k = n (n + 2) mu w V/m, A = K' - (n + 2) mu/n. With matched weights
    sum w V |xi|^2 n n n n is isotropic, and with it the stiffness.

    Args:
        part, kinematics: as in `Ordinary`.
        young, poisson, plane: E [force/area], nu [-], "strain" or "stress".
        quadrature: "matched" or "plain" weights.
        weighted_volume: m where bonds are broken: "frozen", that of the whole family, or "updated", that of the bonds
            which are left.
    """

    name = "ordinary"

    class Keys(Elastic):
        quadrature: Quadrature = "matched"
        kinematics: Kinematics = "nonlinear"
        weighted_volume: WeightedVolume = "frozen"

    def __init__(
        self, part: Neighbourhood, young: float, poisson: float, plane: str = "strain", quadrature: str = "matched",
        kinematics: str = "nonlinear", weighted_volume: str = "frozen",
    ):  # fmt: skip
        moduli = Moduli.of(young, poisson, plane, part.dim)
        weight, families = part.weight, part.families
        self._quadrature, self._weighted_volume = quadrature, weighted_volume
        if quadrature == "matched":
            weight, matched = matched_weights(families, part.position, part.volume, weight)
            self.unmatched = int((~matched).sum())
        n, shear = part.dim, moduli.shear
        k = scaled_to(part, weight * part.volume[families.neighbours], 2, n * (n + 2) * shear)
        B = np.full(len(families), moduli.dilatation / ((n + 2) * shear) ** 2)
        super().__init__(part, moduli, k, B, kinematics=kinematics)

    @classmethod
    def from_case(cls, keys, part):
        return cls(part, keys.E, keys.nu, keys.plane, keys.quadrature, keys.kinematics, keys.weighted_volume)

    def _keep(self, intact):
        super()._keep(intact)
        if self._weighted_volume == "updated":
            n = self._part.dim
            scaled_to(self._part, self._data.k, 2, n * (n + 2) * self.shear)

    def choices(self):
        return super().choices() | {"quadrature": self._quadrature, "weighted_volume": self._weighted_volume}


class ABD(Ordinary):
    """The ordinary model with constants a, b, d of the full horizon (seed 000 Eq. 32-34, corrected in FORMULATION).

        W = a theta^2 + b delta sum |xi| s^2 V,  theta = d delta sum s Lambda V,  s = e/|xi|,
        T = 2 delta (d a theta Lambda/|xi| + b s) n
        a = (K' - (n + 2) mu/n)/2,  b = n (n + 1)(n + 2) mu/(2 S delta^(n+2)),  d = n^2/(S delta^(n+1))

    with S = 2 A, 2 pi h, 4 pi the surface of the unit sphere times cross-section or thickness; in 2D b = 6 mu/(pi h
    delta^4), d = 2/(pi h delta^3). It differs from the LPS: dilatation and shear have different influence functions,
    and families cut by a surface are not normalised. Lambda = n . xi/|xi| as printed makes T no gradient of W and
    the dilatation fade as the body turns; `rotation_weighted = False` has Lambda = 1.

    Args:
        part, kinematics, rotation_weighted: as in `Ordinary`; the influence function must be constant.
        young, poisson, plane: E [force/area], nu [-], "strain" or "stress".
        surface_correction: "energy" scales k and c in each family so that sum k |xi|^2 = n (n + 2) mu and
            sum c |xi| = n, "directional" those of each bond by the factors of `surface.direction_factors`, or "none".
    """

    name = "abd"

    class Keys(Elastic):
        kinematics: Kinematics = "nonlinear"
        rotation_weighted: bool = True
        surface_correction: SurfaceCorrection = "none"

    def __init__(
        self, part: Neighbourhood, young: float, poisson: float, plane: str = "strain",
        kinematics: str = "nonlinear", rotation_weighted: bool = True, surface_correction: str = "none",
    ):  # fmt: skip
        moduli = Moduli.of(young, poisson, plane, part.dim)
        n, length = part.dim, part.families.lengths(part.position)
        delta, surface = part.horizon[part.families.center], SPHERE[n] * part.thickness
        k = part.weight * part.volume[part.families.neighbours] / length
        k *= np.repeat(
            n * (n + 1) * (n + 2) * moduli.shear / (surface * delta ** (n + 1)), np.diff(part.families.offsets)
        )
        ratio = n * delta / ((n + 1) * (n + 2) * moduli.shear)  # of c = d delta V/|xi| to k
        if surface_correction == "energy":
            k = scaled_to(part, k, 2, n * (n + 2) * moduli.shear)
            ratio = n / part.families.sums(k * length)
        s = np.ones_like(k)
        if surface_correction == "directional":
            c = k * np.repeat(ratio, np.diff(part.families.offsets))
            factor = direction_factors(part, k, 2, 3 * moduli.shear)
            s = direction_factors(part, c, 1, 1.0) / factor
            k *= factor
        self._surface_correction = surface_correction
        B = moduli.dilatation * ratio**2
        super().__init__(part, moduli, k, B, s, kinematics, rotation_weighted)

    @classmethod
    def from_case(cls, keys, part):
        if part.influence is not INFLUENCE["constant"]:
            raise InputError(
                "influence: the a-b-d form has the constants of a constant influence function; "
                'model = "ordinary" takes any'
            )
        return cls(part, keys.E, keys.nu, keys.plane, keys.kinematics, keys.rotation_weighted, keys.surface_correction)

    def choices(self):
        switches = {"rotation_weighted": self._data.rotation_weighted, "surface_correction": self._surface_correction}
        return super().choices() | switches


def scaled_to(part: Neighbourhood, values: np.ndarray, power: float, total: float) -> np.ndarray:
    """The bonds' values, scaled in place in each family to sum values |xi|^power = total. Of springs k and power 2,
    that is the energy-based surface correction: a family that a surface cuts, or that a lattice fills unevenly, then
    stores the energy of the solid in a state of equal strain in all directions."""
    totals = np.full(len(part.families), total)
    sums.scale_to(kernels.dimension(part.dim), part.position, *part.bonds(), values, power, totals)
    return values
