"""Named sets of particles, by a condition on the reference position or by the nearest particle to a point."""

import numpy as np
from mpi4py import MPI

from pdpetsc.body.box import coordinates
from pdpetsc.errors import InputError
from pdpetsc.parallel import collective
from pdpetsc.particles import Particles


class Sets:
    """Masks over this rank's owned particles, by name; "all" is always there.

    Args:
        particles: the distributed particles.
        conditions: Expression of each set given by a condition.
        points: position of each set given by its nearest particle.

    Raises:
        InputError: a set that is used contains no particle on any rank (collective).
    """

    def __init__(self, particles: Particles, conditions: dict, points: dict):
        n = particles.owned
        X = particles.position[:n]
        self._mpi = particles.comm.tompi4py()
        self._masks = {"all": np.ones(n, bool)}
        place = coordinates(X, particles.spacing[:n])
        with collective(self._mpi):
            for name, condition in conditions.items():
                self._masks[name] = condition.mask(**place)
        for name, point in points.items():
            self._masks[name] = self._nearest(X, particles.id[:n], np.array(point))

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
            raise InputError(f"sets.{name}: no particle lies in this set; its condition is false at every particle")
        return mask
