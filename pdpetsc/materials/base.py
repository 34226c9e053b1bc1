"""What every material model gives to the assembler, and the table in which models are found by name.

A material sees one process only: arrays of this rank's particles (owned ones first, then ghosts) and the families of
its own particles. It evaluates whole families ("a family is an element"): forces and stiffness of family i are
scattered to i and to its neighbours, which makes every model a dual-horizon one (seed 002 Eq. 14), and settles a bond
across an interface: i -> j belongs to the material of i, j -> i to that of j. Internal forces are gradients of the
stored energy: +dW/du, so that equilibrium reads force(u) = external force.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Gt, Lt

from pdpetsc.bonds import DualFamilies, Families
from pdpetsc.influence import INFLUENCE, Influence
from pdpetsc.materials import families as kernels
from pdpetsc.materials import flux, rows, sums
from pdpetsc.materials.families import dimension
from pdpetsc.materials.one_way import remove_reactions
from pdpetsc.materials.row_sums import add_row_sums
from pdpetsc.materials.softened import Softenable

Positive = Annotated[float, Gt(0)]
PoissonRatio = Annotated[float, Gt(-1), Lt(0.5)]
Plane = Literal["strain", "stress"]
Quadrature = Literal["matched", "plain"]


def whole(field: np.ndarray) -> np.ndarray:
    """The field of a body without ghosts, as it is."""
    return field


@dataclass(frozen=True)
class Neighbourhood:
    """The part of the body that a material acts on, as seen by one rank.

    Attributes:
        families: families of the material's own particles.
        weight: influence times partial-volume factor w beta of each bond [-].
        position, volume, horizon, spacing: of all local particles.
        thickness: of a 2D body, cross-section of a 1D one, 1 in 3D; the volumes contain it.
        influence: the function w(r) that is in the weights.
        interior: number of the first families that are known to contain no ghost, for `Assembler`.
        forward: fills the ghosts' entries of a (local, dim) field from their owners, in place, and returns it. All
            ranks must call it alike: a model that does must not have raised an error on some ranks only before.
    """

    families: Families
    weight: np.ndarray
    position: np.ndarray
    volume: np.ndarray
    horizon: np.ndarray
    spacing: np.ndarray
    thickness: float = 1.0
    influence: Influence = INFLUENCE["constant"]
    interior: int = 0
    forward: Callable[[np.ndarray], np.ndarray] = whole

    @property
    def dim(self) -> int:
        return self.position.shape[1]

    def bonds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """center, offsets and neighbours, as kernels take them."""
        return self.families.center, self.families.offsets, self.families.neighbours

    def weighted_moments(self, vectors: np.ndarray, intact: np.ndarray | None = None) -> np.ndarray:
        """sum w beta V_j (vectors_j - vectors_i) (x) xi of each family, over its `intact` bonds; of the positions, the
        shape tensor K (seed 004 Eq. 3.19)."""
        moments = np.zeros((len(self.families), self.dim, self.dim))
        weight = self.weight if intact is None else self.weight * intact
        sums.weighted_moments(dimension(self.dim), self.position, *self.bonds(), weight, self.volume, vectors, moments)
        return moments


class Keys:
    """Base of the keys of a model's own in `[material.NAME]`: annotated attributes, with defaults where they may be
    left out. The case file is validated against them and gives an object with these attributes. Bounds of numbers are
    those of `annotated_types`; an attribute may be another class of keys, a table in the table."""

    def check(self, dim: int) -> None:
        """Check what the types cannot say, for a body of this dimension.

        Raises:
            ValueError: what is wrong, in one sentence.
        """


class Elastic(Keys):
    """Isotropic elasticity, as most models have it."""

    E: Positive
    nu: PoissonRatio
    plane: Plane = "strain"

    def check(self, dim):
        if dim == 3 and self.plane == "stress":
            raise ValueError("plane stress is for bodies of two dimensions (and uniaxial stress for one), not three")


class Material(Softenable):
    """One constitutive model on its families; subclasses are found by `name` in case files.

    All displacement and force arrays are (local, dim). Methods are pure: they change no history.

    Args:
        part: the particles and families that it acts on.
        data, tangent: NamedTuples of the model's arrays, for which its family kernels are registered (families.py).
        lame, shear: Lame's constants of the reduced dimension [force/area].
        plane: "strain", or "stress" where directions that the body does not have are free of stress.
    """

    models: ClassVar[dict[str, type["Material"]]] = {}
    name: ClassVar[str]
    Keys: ClassVar[type[Keys]]

    symmetric = True
    """Whether the tangent is symmetric (hyperelastic models)."""
    intact: np.ndarray | None = None
    """Mask of the bonds that are not broken; None: all."""
    one_way: np.ndarray | None = None
    """Mask of the bonds whose reactions are left out (one_way.py); None: none are."""
    couples_family = True
    """Whether the neighbours of a particle interact through it (rows then reach two horizons)."""
    follows_bonds = False
    """Whether the tangent depends on the current bonds, not only on what a family remembers."""
    force_power = 1
    """q of the forces w(r) r^q of bonds of length r delta in a state of equal stretch."""
    linear = False
    """Whether kinematics are those of small displacements: forces act at the reference positions."""
    central = False
    """Whether forces act along the bonds."""
    unmatched = 0
    """Families that could not be matched by `quadrature = "matched"`."""

    def __init_subclass__(cls):
        if "name" in cls.__dict__:
            Material.models[cls.name] = cls

    def __init__(
        self, part: Neighbourhood, data: NamedTuple, tangent: NamedTuple, lame: float, shear: float,
        plane: Plane = "strain",
    ):  # fmt: skip
        self.families, self.lame, self.shear, self.plane = part.families, lame, shear, plane
        self.interior, self.thickness = part.interior, part.thickness
        self._part, self._data, self._tangent = part, data, tangent
        self._D = dimension(part.dim)
        self._X, self._volume = part.position, part.volume
        self._bonds = part.bonds()
        self._mechanics = data, self._bonds
        """Data and bonds of forces and tangent; a model may take other ones that give the same."""
        self.mode_sizes = part.dim, part.dim
        """Lengths of `left` and `right` of a bond in the tangent (families.py)."""

    @property
    def modulus(self) -> float:
        """P-wave modulus lambda + 2 mu of the reduced dimension [force/area], the size of the stiffness."""
        return self.lame + 2 * self.shear

    def add_normal_stress(self, sigma: np.ndarray) -> None:
        """Give tensors (families, 3, 3) the stress in directions that the body does not have: lambda/(n lambda + 2 mu)
        of the others' sum in plane strain, as in linear elasticity (nu in 2D), none in plane stress."""
        dim = self._part.dim
        if self.plane == "strain":
            free = range(dim, 3)
            ratio = self.lame / (dim * self.lame + 2 * self.shear)
            sigma[:, free, free] += (ratio * np.trace(sigma, axis1=1, axis2=2))[:, None]

    @classmethod
    def from_case(cls, keys, part: Neighbourhood) -> "Material":
        """From the keys of the case's `[material.NAME]` table.

        Raises:
            InputError: a family on which the model is not defined (on this rank only; on all ranks alike where the
                model calls `part.forward`).
        """
        raise NotImplementedError

    def set_bonds(self, intact: np.ndarray) -> None:
        """Go on with the bonds of a mask (bonds,); others carry nothing and count in no sum of their family."""
        self.intact = intact
        self._renew()

    @property
    def span(self) -> np.ndarray:
        """lambda_min(K)/lambda_min(K_whole) of each family's shape tensors, of its intact and of all bonds: 1 where it
        is whole, 1/2 beside a straight crack, 0 where its bonds no longer span the space."""
        return np.ones(len(self.families)) if self.intact is None else self._span(self.intact)

    def _span(self, parts: np.ndarray) -> np.ndarray:
        """The same with these parts of the bonds (bonds,)."""
        return np.linalg.eigvalsh(self._part.weighted_moments(self._X, parts))[:, 0] / self._whole_shape

    @cached_property
    def _whole_shape(self) -> np.ndarray:
        return np.linalg.eigvalsh(self._part.weighted_moments(self._X))[:, 0]

    def _keep(self, intact: np.ndarray) -> None:
        """Make the model's data anew from those of the whole families and a mask of bonds."""
        raise NotImplementedError

    def _fade(self, parts: np.ndarray) -> None:
        """The same with parts of the bonds, 0 to 1, that stay as they are."""
        raise NotImplementedError

    def transfer(self, r: np.ndarray) -> np.ndarray:
        """alpha(r), the weight with which a traction at distance r delta enters the material: what the bonds through
        there would carry that a surface has cut (docs/theory/traction.md),

            alpha(r) = r^(1 - n) integral from r to 1 of w(s) s^(q + n - 1) ds

        In 1D that is seed 003 Eq. 22-24: 1 - r for prototype microelastic bonds of constant influence (q = 0) and (1 -
        r^2)/2 for the other models (q = 1).

        Args:
            r: distances in horizons, above 0 and up to 1.
        """
        n = self._part.dim
        x, weights = np.polynomial.legendre.leggauss(8)
        s = r[:, None] + (1 - r)[:, None] * (x + 1) / 2
        forces = self._part.influence(s) * s ** (self.force_power + n - 1)
        return r ** (1 - n) * (1 - r) / 2 * (forces @ weights)

    def choices(self) -> dict:
        """Model switches for summary.json; among them `quadrature` and `surface_correction` where there is a choice."""
        raise NotImplementedError

    def resists_strain(self) -> np.ndarray:
        """Whether each family resists every strain (families,); where none around a particle does, nothing holds it."""
        return np.ones(len(self.families), bool)

    def displacement_gradient(self, u: np.ndarray) -> np.ndarray:
        """H = F - I of each family, (families, 3, 3) with the directions that the body does not have."""
        raise NotImplementedError

    def cauchy_stress(self, u: np.ndarray) -> np.ndarray:
        """Cauchy stress of each family, (families, 3, 3) [force/area]."""
        raise NotImplementedError

    def add_force(self, u: np.ndarray, force: np.ndarray, begin: int = 0, end: int | None = None) -> None:
        """Add the forces dW/du of the families begin ... end - 1 to `force`; NaN outside the model's domain."""
        data, bonds = self._mechanics
        part = force, begin, len(self.families) if end is None else end
        kernels.add_force(self._D, data, self._X, *bonds, self._volume, u, *part)
        if self.one_way is not None:
            remove_reactions(self._D, data, self._X, *bonds, self._volume, u, self.one_way, *part)

    def add_force_scale(self, u: np.ndarray, scale: np.ndarray) -> None:
        """Add to `scale` (local,) the absolute terms that cancel in `add_force`; its rounding is eps times this."""
        data, bonds = self._mechanics
        kernels.add_force_scale(self._D, data, self._X, *bonds, self._volume, u, scale)

    def linearise(self, u: np.ndarray) -> None:
        """Prepare `add_action`, `add_diagonal` and `add_rows` at u."""
        self._u, (data, bonds) = u, self._mechanics
        kernels.linearise(self._D, data, self._tangent, self._X, *bonds, u)

    def add_action(self, du: np.ndarray, force: np.ndarray, begin: int = 0, end: int | None = None) -> None:
        """Add K du of the families begin ... end - 1, K of the last `linearise`."""
        (data, bonds), end = self._mechanics, len(self.families) if end is None else end
        state = data, self._tangent, self._X, *bonds, self._volume, self._u
        kernels.add_action(self._D, *state, self.follows_bonds, du, force, begin, end)

    def add_diagonal(self, diagonal: np.ndarray) -> None:
        """Add the tangent's diagonal blocks to `diagonal` (local, dim, dim)."""
        data, bonds = self._mechanics
        rows.add_diagonal(
            self._D, data, self._tangent, self._X, *bonds, self._volume, self._u, self.couples_family, self.symmetric,
            *map(dimension, self.mode_sizes), diagonal,
        )  # fmt: skip

    def add_row_sums(self, sums: np.ndarray) -> None:
        """Add bounds of the sums of the tangent's absolute entries in each row to `sums` (local, dim)."""
        data, bonds = self._mechanics
        add_row_sums(
            self._D, data, self._tangent, self._X, *bonds, self._volume, self._u, self.couples_family, self.symmetric,
            *map(dimension, self.mode_sizes), sums,
        )  # fmt: skip

    @property
    def network(self) -> Families:
        """The families by which forces and tangent are evaluated."""
        return Families(*self._mechanics[1])

    @cached_property
    def dual(self) -> DualFamilies:
        """The network turned round, for every local particle."""
        return self.network.dual(len(self._X))

    @cached_property
    def own(self) -> np.ndarray:
        """Number of each local particle's family, -1 where it has none here."""
        own = np.full(len(self._X), -1, np.int32)
        own[self.families.center] = np.arange(len(self.families))
        return own

    def add_rows(self, row_offsets: np.ndarray, columns: np.ndarray, blocks: np.ndarray, upper: bool = False) -> None:
        """Add the tangent to block rows: row a of the local particles has blocks row_offsets[a] ...; `columns` holds
        their local particle (-1: not on this rank), `blocks` (n, dim, dim) the values. With `upper`, half of each
        family's element matrix only, which `sparsity.symmetrise` completes."""
        data, bonds = self._mechanics
        dim, (_, _, neighbours) = len(self._D), bonds
        count, families = (len(neighbours), len(self.families)) if self.couples_family else (0, 0)
        block = np.empty((len(neighbours), dim, dim))
        left, left_center = (np.empty((n, self.mode_sizes[0])) for n in (count, families))
        right, right_center = left, left_center
        if not self.symmetric:
            right, right_center = (np.empty((n, self.mode_sizes[1])) for n in (count, families))
        element = block, left, right, left_center, right_center
        state = self._D, data, self._tangent
        rows.elements(*state, self._X, *bonds, self._u, self.couples_family, *element)
        dual = self.dual
        rows.add_rows(
            *state, *bonds, self._volume, self.own, dual.offsets, dual.family, dual.bond,
            *element, self.couples_family, upper, row_offsets, columns, blocks,
        )  # fmt: skip

    def energy(self, u: np.ndarray, members: np.ndarray | None = None) -> np.ndarray:
        """Stored energy of each family, or of those with these numbers [energy]."""
        members = np.arange(len(self.families)) if members is None else members
        energy = np.empty(len(members))
        kernels.energies(self._D, self._data, self._X, *self._bonds, self._volume, u, members, energy)
        return energy

    def add_virial(self, u: np.ndarray, virial: np.ndarray) -> None:
        """Add what each bond carries, T<xi> (x) xi V_i V_j, to the particles whose cells it crosses (flux.py).

        Args:
            virial: (local, dim, dim) [energy]; divided by the volumes, the peridynamic stress.
        """
        flux.add_virials(self._D, self._data, self._X, *self._bonds, self._volume, u, virial)

    def crossing_forces(self, u: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the bonds that lead from one side of the body to the other.

        Args:
            beyond: (local,) whether each particle lies on the side that exerts the forces.

        Returns:
            (n, dim) what that side exerts on the other [force]; (n, 2) the bonds' local particles i and j.
        """
        offsets = flux.crossing_bonds(*self._bonds, beyond)
        force, bond = np.empty((offsets[-1], self._part.dim)), np.empty((offsets[-1], 2), np.int32)
        flux.crossing_forces(self._D, self._data, self._X, *self._bonds, self._volume, u, beyond, offsets, force, bond)
        return force, bond
