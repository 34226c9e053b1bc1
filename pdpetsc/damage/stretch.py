"""Critical stretch: a bond fails at s = (|y| - |xi|)/|xi| = s_c (seed 004 Eq. 2.13, 2.20; seed 002 Eq. 36-37)."""

from typing import NamedTuple

import numpy as np

from pdpetsc.damage.base import Criterion, Critical, per_family, value_of
from pdpetsc.influence import influence_moment
from pdpetsc.materials.base import Material

MEAN_COSINE = {1: 1.0, 2: 2 / np.pi, 3: 0.5}
"""Mean of |cos| over the directions of n dimensions."""


class Stretch(NamedTuple):
    """Critical stretch of each family, and whether kinematics are linear."""

    critical: np.ndarray
    linear: bool


class CriticalStretch(Criterion):
    """s/s_c, with s_c given or from the energy release rate."""

    name = "critical_stretch"

    class Keys(Critical):
        pass

    @classmethod
    def from_case(cls, keys, material):
        result = cls(material, Stretch(np.empty(0), material.linear))
        critical = keys.critical or stretch_of_release_rate(material, keys.G_c, result.horizon)
        result._data = Stretch(per_family(material, critical), material.linear)
        return result

    @property
    def critical(self) -> np.ndarray:
        """s_c of each family."""
        return self._data.critical


def stretch_of_release_rate(material: Material, release_rate: float, horizon: np.ndarray) -> np.ndarray:
    """s_c of families with these horizons: bonds that break at s_c take the energy G_c per area with them.

    A pair of bonds of the stiffness k stores k s^2 |xi|^2 per volume squared, both directions together, and |xi . n| of
    the pairs of a length and direction cross a unit of area. Where sum k |xi|^2 = n^2 K' and k ~ w(r) r^(q-1),

        G_c = s_c^2 n^2 K' delta a/2  int_0^1 w r^(n+1+q) dr / int_0^1 w r^(n+q) dr,     a = 1, 2/pi, 1/2 (mean cosine)

    which is seed 002 Eq. 36 for prototype microelastic bonds (q = 0, w = 1): 9 K delta s_c^2/5 in 3D, 9 E delta s_c^2/
    (4 pi) in plane stress. Other models have q = 1; their n^2 K' is the energy of a state of equal stretch, too.
    """
    part, q = material._part, material.force_power
    n = part.dim
    bulk = material.lame + 2 * material.shear / n
    ratio = influence_moment(part.influence, n + 1 + q) / influence_moment(part.influence, n + q)
    return np.sqrt(release_rate / (n**2 * bulk * horizon * MEAN_COSINE[n] / 2 * ratio))


@value_of(Stretch)
def stretch_ratio(D, data, f, i, j, X, u, tensor):
    square, change = 0.0, 0.0  # |xi|^2, (|y|^2 - |xi|^2)
    for p in range(len(D)):
        xi, eta = X[j, p] - X[i, p], u[j, p] - u[i, p]
        square += xi * xi
        change += 2.0 * xi * eta
        if not data.linear:
            change += eta * eta
    if data.linear:
        return 0.5 * change / square / data.critical[f]
    return change / (square + np.sqrt(square * (square + change))) / data.critical[f]
