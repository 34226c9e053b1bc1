"""Named sets of particles, by a condition on the reference position, by the nearest particle to a point, or by a group
of the file that the body is from."""

import numpy as np
from mpi4py import MPI

from pdpetsc.body.box import coordinates
from pdpetsc.body.columns import GROUPS
from pdpetsc.errors import InputError
from pdpetsc.parallel import collective
from pdpetsc.particles import Particles


class Sets:
    """Masks over this rank's owned particles, by name; "all" is always there.

    Args:
        mpi: mpi4py communicator.
        masks: (owned,) of each set.
        X: (owned, dim) where the particles are.

    Raises:
        InputError: a set that is used contains no particle on any rank (collective).
    """

    def __init__(self, mpi, masks: dict[str, np.ndarray], X: np.ndarray):
        self._mpi, self._masks, self._X = mpi, masks, X

    @classmethod
    def of(cls, particles: Particles, specs: dict) -> "Sets":
        """By the tables of a case's `[sets]`: a condition, the nearest particle to a point, or a group, to which the
        particles carry in a column of their own whether they belong; it ends here (collective)."""
        n = particles.owned
        X = particles.position[:n]
        sets = cls(particles.comm.tompi4py(), {"all": np.ones(n, bool)}, X)
        place = coordinates(X, particles.spacing[:n])
        with collective(sets._mpi):
            for name, spec in specs.items():
                if spec.where:
                    sets._masks[name] = spec.where.mask(**place)
        groups = [name for name, spec in specs.items() if spec.group is not None]
        if groups:
            sets._masks |= dict(zip(groups, particles.carried.pop(GROUPS).T > 0))
        for name, spec in specs.items():
            if spec.nearest:
                sets._masks[name] = sets._nearest(X, particles.id[:n], np.array(spec.nearest))
        return sets

    @property
    def columns(self) -> np.ndarray:
        """(owned, sets) of zeros and ones, in which particles carry what sets they belong to."""
        return np.stack(list(self._masks.values()), axis=1).astype(float)

    def inherited(self, particles: Particles, columns: np.ndarray) -> "Sets":
        """The sets of particles that have carried these columns with them."""
        return Sets(self._mpi, dict(zip(self._masks, columns.T > 0)), particles.position[: particles.owned])

    def _nearest(self, X, ids, point) -> np.ndarray:
        """The nearest particle; among equally near ones that of the lowest id."""
        distance = np.linalg.norm(X - point, axis=1)
        closest = self._mpi.allreduce(float(distance.min()) if len(X) else np.inf, MPI.MIN)
        ties = distance <= closest * (1 + 1e-9)
        winner = self._mpi.allreduce(int(ids[ties].min()) if ties.any() else np.iinfo(np.int64).max, MPI.MIN)
        return ids == winner

    def __getitem__(self, name: str) -> np.ndarray:
        mask = self._masks[name]
        if not self._mpi.allreduce(int(mask.sum())):
            raise InputError(
                f"sets.{name}: no particle lies in this set; its condition is false at every particle, and they have "
                f"{self._range()}"
            )
        return mask

    def _range(self) -> str:
        """Where particles are, in words (collective)."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        if len(self._X):
            low[: self._X.shape[1]], high[: self._X.shape[1]] = self._X.min(axis=0), self._X.max(axis=0)
        low = np.min(self._mpi.allgather(low), axis=0)
        high = np.max(self._mpi.allgather(high), axis=0)
        ends = [f"{axis} from {a:g} to {b:g}" for axis, a, b in zip("XYZ", low, high) if np.isfinite(a)]
        return ", ".join(ends)
