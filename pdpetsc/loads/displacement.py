"""Prescribed displacements, constant, ramped or any expression of place and time (seed 000 section 3.7)."""

import numpy as np

from pdpetsc.loads.base import Constraint


class Displacement(Constraint):
    """u_c = value on a set; where sets overlap, the later load holds."""

    name = "displacement"

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self.entries = (
            np.repeat(site.members, len(spec.component)),
            np.tile(np.array(spec.component), len(site.members)),
        )
        self._count = len(spec.component)

    def values(self, time):
        return np.repeat(self.site.values(time), self._count)
