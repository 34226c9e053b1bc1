"""Zones of finer particles round sets: the rim of a hole, the tip of a crack."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdpetsc.body.box import Lattice, blocks_of, coordinates
from pdpetsc.errors import InputError
from pdpetsc.memory import check_room


@dataclass
class Zone:
    """Cells near a set are divided.

    Attributes:
        name: of the set.
        where, nearest: its condition, or its point (dim,).
        within: distance up to which cells are divided [length].
        divide: particles along an edge of each.
    """

    name: str
    where: Any
    nearest: Any
    within: float
    divide: int
    _members: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    def reaches(self, lattice: Lattice, position: np.ndarray) -> np.ndarray:
        """Mask of the positions (n, dim) near the set: its point, or the middles of its undivided cells.

        Raises:
            InputError: there is no such cell.
        """
        if self.nearest is not None:
            return np.linalg.norm(position - np.array(self.nearest), axis=1) <= self.within
        from scipy.spatial import cKDTree  # slow to import, and rarely needed

        if lattice.cells not in self._members:
            self._members[lattice.cells] = self._middles(lattice)
        members = self._members[lattice.cells]
        if not len(members):
            raise InputError(f"body.zones: no undivided cell lies in the set {self.name!r}")
        return np.isfinite(cKDTree(members).query(position, distance_upper_bound=self.within * (1 + 1e-9))[0])

    def _middles(self, lattice: Lattice) -> np.ndarray:
        """Of the cells in the set, (n, dim)."""
        check_room("body.zones", "cells to look at", lattice.cells, 8 * lattice.dim)
        found = []
        for numbers in blocks_of(lattice.cells):
            position = lattice.middles(lattice.indices(numbers))
            place = coordinates(position, np.full(len(position), lattice.spacing))
            inside = np.ones(len(position), bool) if self.where is None else self.where.mask(**place)
            found.append(position[inside if lattice.keep is None else inside & lattice.keep.mask(**place)])
        return np.concatenate(found)


def zones_of(case) -> tuple[Zone, ...]:
    """Those of a case's `[[body.zones]]`."""
    sets = {"all": (None, None)} | {name: (spec.where, spec.nearest) for name, spec in case.sets.items()}
    return tuple(Zone(zone.near, *sets[zone.near], zone.within, zone.divide) for zone in case.body.zones)  # type: ignore[call-arg]
