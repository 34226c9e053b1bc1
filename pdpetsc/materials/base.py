"""What every material model gives to the assembler, and the table in which models are found by name.

A material sees one process only: arrays of this rank's particles (owned ones first, then ghosts) and the families of
its own particles. It evaluates whole families ("a family is an element"): forces and stiffness of family i are
scattered to i and to its neighbours, which makes every model a dual-horizon one (seed 002 Eq. 14). Internal forces
are gradients of the stored energy: +dW/du, so that equilibrium reads force(u) = external force.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.bonds import DualFamilies, Families


@dataclass(frozen=True)
class Neighbourhood:
    """The part of the body that a material acts on, as seen by one rank.

    Attributes:
        families: families of the material's own particles.
        dual: the same turned round, for every local particle.
        position, volume, horizon, spacing: of all local particles.
        thickness: of a 2D body, cross-section of a 1D one, 1 in 3D; the volumes contain it.
    """

    families: Families
    dual: DualFamilies
    position: np.ndarray
    volume: np.ndarray
    horizon: np.ndarray
    spacing: np.ndarray
    thickness: float

    @classmethod
    def of(cls, families, position, volume, horizon, spacing, thickness=1.0) -> "Neighbourhood":
        """With the dual families found here."""
        return cls(families, families.dual(len(position)), position, volume, horizon, spacing, thickness)


class Material:
    """One constitutive model on its families; subclasses are found by `name` in case files.

    All displacement and force arrays are (local, dim). Methods are pure: they change no history.
    """

    models: ClassVar[dict[str, type["Material"]]] = {}
    name: ClassVar[str]
    symmetric: ClassVar[bool] = True
    """Whether the tangent is symmetric (hyperelastic models)."""
    couples_family: ClassVar[bool] = True
    """Whether the neighbours of a particle interact through it (rows then reach two horizons)."""

    families: Families
    dual: DualFamilies
    modulus: float
    """P-wave modulus lambda + 2 mu [force/area], the size of the stiffness."""

    def __init_subclass__(cls):
        if "name" in cls.__dict__:
            Material.models[cls.name] = cls

    @classmethod
    def from_case(cls, spec, neighbourhood: Neighbourhood, weight: np.ndarray) -> "Material":
        """From the case's `[material.NAME]` table and the weights w beta of the bonds.

        Raises:
            InputError: a family on which the model is not defined (on this rank only).
        """
        raise NotImplementedError

    def add_force(self, u: np.ndarray, force: np.ndarray) -> None:
        """Add the internal forces dW/du [force] to `force`; NaN where the state is outside the model's domain."""
        raise NotImplementedError

    def add_force_scale(self, u: np.ndarray, scale: np.ndarray) -> None:
        """Add to `scale` (local,) the sum of the absolute terms that cancel in `add_force`: its rounding error is
        about machine precision times this."""
        raise NotImplementedError

    def linearise(self, u: np.ndarray) -> None:
        """Prepare `add_action` and `add_rows` at u."""
        raise NotImplementedError

    def add_action(self, du: np.ndarray, force: np.ndarray) -> None:
        """Add K du, with the tangent of the last `linearise`."""
        raise NotImplementedError

    def add_rows(self, row_offsets: np.ndarray, columns: np.ndarray, blocks: np.ndarray) -> None:
        """Add the tangent to block rows: row a of the local particles has blocks row_offsets[a] ...; `columns` holds
        their local particle (-1: not on this rank), `blocks` (n, dim, dim) the values."""
        raise NotImplementedError

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Stored energy of each family [energy]."""
        raise NotImplementedError

    def displacement_gradient(self, u: np.ndarray) -> np.ndarray:
        """H = F - I of each family, (families, 3, 3) with the directions that the body does not have."""
        raise NotImplementedError

    def cauchy_stress(self, u: np.ndarray) -> np.ndarray:
        """Cauchy stress of each family, (families, 3, 3) [force/area]."""
        raise NotImplementedError

    def choices(self) -> dict:
        """Model switches for summary.json."""
        raise NotImplementedError
