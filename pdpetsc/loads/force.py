"""Dead loads: body force, total force on a set, pressure in a layer of particles."""

import numpy as np

from pdpetsc.loads.base import Load
from pdpetsc.materials.base import Keys


class BodyForce(Load):
    """Force per reference volume b: f_i = b V_i [force/length^3]."""

    name = "body_force"
    along_axes = True

    class Keys(Keys):
        """Force per volume."""

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self._axes = spec.component

    def add(self, time, external):
        external[np.ix_(self.site.members, self._axes)] += (self.site.values(time) * self._weight())[:, None]

    def _weight(self):
        return self.site.volume


class Force(BodyForce):
    """Total force on a set, shared by volume: f_i = value V_i / sum V [force]. A set of one particle is a point."""

    name = "force"

    class Keys(Keys):
        """Total force on a set, shared by volume."""

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self._total = site.total_volume()

    def _weight(self):
        return self.site.volume / self._total


class Pressure(Load):
    """Pressure p against a flat layer, as a body force b = -p n / width in it (seed 000 Eq. 96); a dead load.

    The layer's width is its extent along the outward normal n, one spacing for a single row, unless it is given;
    the total force is then p times the layer's area.
    """

    name = "pressure"

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self._normal = np.array(spec.normal)
        depth = site.position @ self._normal
        ends = np.array([depth.max(), -depth.min(), site.spacing.max()]) if len(depth) else np.full(3, -np.inf)
        ends = site.largest(ends)
        self._width = spec.width or ends[0] + ends[1] + ends[2]

    def add(self, time, external):
        force = -self.site.values(time) * self.site.volume / self._width
        external[self.site.members] += force[:, None] * self._normal
