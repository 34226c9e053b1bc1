"""What loads have in common: where they act, and their values there in time."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pdpetsc.expressions import coordinates
from pdpetsc.materials.base import Keys


@dataclass(frozen=True)
class Site:
    """The owned particles that a load acts on, and its value there.

    Attributes:
        mpi: mpi4py communicator; every rank builds every load.
        members: owned particles of the load's set.
        position: (members, dim).
        volume, spacing: (members,).
        value: Expression of X, Y, Z, spacing, t.
    """

    mpi: Any
    members: np.ndarray
    position: np.ndarray
    volume: np.ndarray
    spacing: np.ndarray
    value: Any

    def values(self, time: float) -> np.ndarray:
        """The load's value at each member."""
        return self.value(**coordinates(self.position, self.spacing), t=time)

    def total_volume(self) -> float:
        """Volume of the set on all ranks."""
        return self.mpi.allreduce(float(self.volume.sum()))

    def largest(self, values: np.ndarray) -> np.ndarray:
        """The largest of each value over all ranks."""
        return np.max(self.mpi.allgather(values), axis=0)


class Load:
    """A load on a set of particles; subclasses are found by `name`, the `kind` in case files. There they take `set`,
    `value`, and the keys of their own."""

    kinds: ClassVar[dict[str, type["Load"]]] = {}
    name: ClassVar[str]
    Keys: ClassVar[type[Keys]] = Keys
    along_axes: ClassVar[bool] = False
    """Whether it takes `component` too."""

    def __init_subclass__(cls):
        if "name" in cls.__dict__:
            Load.kinds[cls.name] = cls

    def __init__(self, site: Site, spec):
        """Args: where and how much; the case's table with the kind's own keys."""
        self.site = site
        self.steady = "t" not in site.value.names
        """Whether its values do not depend on the time."""

    def add(self, time: float, external: np.ndarray) -> None:
        """Add the forces at a time to the owned (n, dim) external forces."""
        raise NotImplementedError


class Constraint(Load):
    """A load that prescribes displacements.

    Attributes:
        entries: (particles, components) index arrays of the constrained entries of an owned field.
    """

    entries: tuple[np.ndarray, np.ndarray]

    def values(self, time: float) -> np.ndarray:
        """Prescribed value of each entry [length]."""
        raise NotImplementedError
