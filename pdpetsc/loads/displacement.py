"""Prescribed displacements, constant, ramped or any expression of place and time (seed 000 section 3.7)."""

import numpy as np

from pdpetsc.loads.base import Constraint
from pdpetsc.materials.base import Keys


class Displacement(Constraint):
    """u_c = value on a set; where sets overlap, the later load holds."""

    name = "displacement"
    along_axes = True

    class Keys(Keys):
        """Prescribed components of the displacement."""

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self.entries = (
            np.repeat(site.members, len(spec.component)),
            np.tile(np.array(spec.component), len(site.members)),
        )
        self._count = len(spec.component)

    def values(self, time):
        return np.repeat(self.site.values(time), self._count)
