"""Prescribed velocities: loads that go by their rate."""

import numpy as np

from pdpetsc.loads.displacement import Displacement
from pdpetsc.materials.base import Keys

PANELS, POINTS = 32, 4
"""Of the integral over time of a velocity that depends on it."""


class Velocity(Displacement):
    """v_c = value on a set: u_c = u_c(0) + integral of the value from 0 to t, exact where it does not depend on t or is
    smooth (Gauss's rule on 32 equal panels)."""

    name = "velocity"

    class Keys(Keys):
        """Prescribed components of the velocity."""

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self.start = np.zeros(len(self.entries[0]))
        """Displacement of each entry at t = 0."""

    def values(self, time):
        if "t" not in self.site.value.names:
            return self.start + np.repeat(self.site.values(0.0) * time, self._count)
        x, weights = np.polynomial.legendre.leggauss(POINTS)
        width = time / PANELS
        total = np.zeros(len(self.site.members))
        for panel in range(PANELS):
            for point, weight in zip(x, weights):
                total += weight * width / 2 * self.site.values((panel + (point + 1) / 2) * width)
        return self.start + np.repeat(total, self._count)

    def rates(self, time: float) -> np.ndarray:
        """Prescribed velocity of each entry."""
        return np.repeat(self.site.values(time), self._count)
