"""Prescribed displacements, constant, ramped or any expression of place and time (seed 000 section 3.7)."""

import numpy as np

from pdpetsc.loads.base import Constraint, axes


class Displacement(Constraint):
    """u_c = value on a set; where sets overlap, the later load holds."""

    name = "displacement"

    def __init__(self, site, spec):
        super().__init__(site, spec)
        components = axes(spec.component, site.position.shape[1])
        self.entries = (
            np.repeat(site.members, len(components)),
            np.tile(np.array(components, int), len(site.members)),
        )
        self._count = len(components)

    def values(self, time):
        return np.repeat(self.site.values(time), self._count)
