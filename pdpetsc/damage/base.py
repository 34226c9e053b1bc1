"""What every failure criterion gives: how near each bond is to failing, and the table in which criteria are found.

A criterion compares a quantity of each bond with its critical value, d/d_c (seed 004 Eq. 2.20). It sees the families of
one material on one rank; of the neighbours it may know what is forwarded to ghosts, so that both ends of a bond come to
the same number.
"""

from collections.abc import Callable
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from annotated_types import Gt
from numba import njit
from numba.extending import overload

from pdpetsc.errors import InputError
from pdpetsc.materials.base import Keys, Material
from pdpetsc.materials.families import dimension
from pdpetsc.materials.tensors import EXACT

Positive = Annotated[float, Gt(0)]


class Critical(Keys):
    """A critical value, or the energy release rate G_c from which it follows."""

    critical: Positive | None = None
    G_c: Positive | None = None

    def check(self, dim):
        if (self.critical is None) == (self.G_c is None):
            raise ValueError("exactly one of critical and G_c is needed")


class Criterion:
    """A failure criterion on the families of one material; subclasses are found by `name` in case files.

    Args:
        material: whose bonds are looked at.
        data: NamedTuple of critical values, for which a `bond_value` is registered (`value_of`).
    """

    criteria: ClassVar[dict[str, type["Criterion"]]] = {}
    name: ClassVar[str]
    Keys: ClassVar[type[Keys]]
    field: ClassVar[str | None] = None
    """Method of materials that gives a tensor of each family, (families, 3, 3), which the criterion needs at both ends
    of a bond: "displacement_gradient" or "cauchy_stress"."""

    def __init_subclass__(cls):
        if "name" in cls.__dict__:
            Criterion.criteria[cls.name] = cls

    def __init__(self, material: Material, data: NamedTuple):
        self._material, self._data = material, data

    @classmethod
    def from_case(cls, keys, material: Material) -> "Criterion":
        """From the keys of the case's `[damage.NAME]` table.

        Raises:
            InputError: the criterion is not defined for this material (on all ranks alike).
        """
        raise NotImplementedError

    def ratio(self, u: np.ndarray, tensor: np.ndarray | None, both: Callable) -> np.ndarray:
        """d/d_c of each bond, in its own direction; it fails at 1. Where the state is no number it is 0.

        Args:
            u: (local, dim) displacements.
            tensor: (local, 3, 3) what `field` names, at all particles.
            both: gives for a function of a material and u, values (bonds,) of its families' bonds, the sum of those of
                both directions, for these bonds; a criterion that calls it does so on all ranks.
        """
        m = self._material
        values = np.empty(m.families.bonds)
        tensor = np.empty((0, 3, 3)) if tensor is None else tensor
        X, families = m._part.position, m.families
        _bond_values(
            dimension(m._part.dim), self._data, X, families.center, families.offsets, families.neighbours, u, tensor,
            values,
        )  # fmt: skip
        return where_defined(values)

    @property
    def horizon(self) -> np.ndarray:
        """Of each family [length]."""
        return self._material._part.horizon[self._material.families.center]


def bond_value(D, data, f, i, j, X, u, tensor):
    """d/d_c of the bond i -> j of family f."""


VALUES: dict[type, Callable] = {}


def value_of(kind: type):
    """Register what is decorated as `bond_value` for data of a NamedTuple type."""

    def register(implementation):
        VALUES[kind] = implementation
        return implementation

    return register


@overload(bond_value, jit_options=EXACT)  # sums in the order written: i -> j and j -> i come to the same number
def _(D, data, f, i, j, X, u, tensor):
    return VALUES[data.instance_class]


@njit(cache=True, **EXACT)
def _bond_values(D, data, X, center, offsets, neighbours, u, tensor, values):
    for f in range(len(center)):
        for b in range(offsets[f], offsets[f + 1]):
            values[b] = bond_value(D, data, f, center[f], neighbours[b], X, u, tensor)


def where_defined(values: np.ndarray) -> np.ndarray:
    """The values with 0 where they are no number, in place."""
    values[np.isnan(values)] = 0.0
    return values


def per_family(material: Material, value: float | np.ndarray) -> np.ndarray:
    """A value of the material, or one for each family, as one for each family."""
    return np.broadcast_to(np.asarray(value, float), len(material.families)).copy()


def only_in(dim: int, allowed: tuple[int, ...], what: str, remedy: str) -> None:
    """Raise where something is not defined in this dimension.

    Raises:
        InputError: naming what, and the remedy.
    """
    if dim not in allowed:
        raise InputError(f"{what} is not defined in {dim}D; {remedy}")
