"""Critical stretch: a bond fails at s = (|y| - |xi|)/|xi| = s_c (seed 004 Eq. 2.13, 2.20; seed 002 Eq. 36-37)."""

from typing import NamedTuple

import numpy as np

from pdpetsc.damage.base import Criterion, Critical, Positive, per_family, value_of
from pdpetsc.errors import InputError
from pdpetsc.influence import influence_moment
from pdpetsc.materials.base import Keys, Material
from pdpetsc.materials.ordinary import SPHERE
from pdpetsc.materials.softening import Softening

MEAN_COSINE = {1: 1.0, 2: 2 / np.pi, 3: 0.5}
"""Mean of |cos| over the directions of n dimensions."""


class Stretch(NamedTuple):
    """Critical stretch of each family, and whether kinematics are linear."""

    critical: np.ndarray
    linear: bool


class SofteningKeys(Keys):
    """The table `softening`: bonds fade between s_min and the critical stretch (materials/softening.py)."""

    s_min: Positive
    beta: Positive = 3.0
    printed: bool = False


class CriticalStretch(Criterion):
    """s/s_c, with s_c given or from the energy release rate."""

    name = "critical_stretch"

    class Keys(Critical):
        softening: SofteningKeys | None = None

        def check(self, dim):
            Critical.check(self, dim)
            if self.softening and self.critical and not self.softening.s_min < self.critical:
                raise ValueError(f"softening begins at s_min = {self.softening.s_min}, which must be below critical")

    @classmethod
    def from_case(cls, keys, material):
        result = cls(material, Stretch(np.empty(0), material.linear))
        critical = keys.critical
        if critical is None:
            critical = stretch_of_release_rate(material, keys.G_c, result.horizon)
            if keys.softening:
                critical = _softened_critical(critical, keys.softening)
        result._data = Stretch(per_family(material, critical), material.linear)
        return result

    @property
    def critical(self) -> np.ndarray:
        """s_c of each family."""
        return self._data.critical

    def softening(self, keys: SofteningKeys, softens: np.ndarray) -> Softening:
        """Of the bonds (bonds,) of a mask, which fade from s_min to s_c."""
        start = np.full_like(self.critical, keys.s_min)
        return Softening(start, self.critical, keys.beta, not keys.printed, np.zeros(len(softens)), softens)


def _softened_critical(brittle: np.ndarray, keys: SofteningKeys) -> np.ndarray:
    """s_c of bonds that soften from s_min and take as much energy as brittle ones at a given stretch.

    With s = s_min + d (x + 1)/2:  int T s ds = s_min^2/2 + d s_min int T dx/2 + d^2 int T (x + 1) dx/4 = brittle^2/2.

    Raises:
        InputError: s_min takes that energy already.
    """
    if not (keys.s_min < brittle).all():
        raise InputError(f"softening.s_min: is {keys.s_min:g}, but bonds of that G_c break at {brittle.min():g}")
    x, weight = np.polynomial.legendre.leggauss(24)
    weight = weight * (1 - np.tanh(keys.beta * x) / np.tanh(keys.beta)) / 2
    a, b = keys.s_min * weight.sum() / 2, (weight * (x + 1)).sum() / 4
    rest = (brittle**2 - keys.s_min**2) / 2
    return keys.s_min + (np.sqrt(a**2 + 4 * b * rest) - a) / (2 * b)


def pairs_across(horizon: np.ndarray, dim: int, thickness: float) -> np.ndarray:
    """Pairs of volumes within a horizon whose bond crosses a plane, per area: sum V_i V_j = a S delta^(n+1)/(2 (n+1)),
    the integral of |xi . n| over half a horizon; S = 2 A, 2 pi h, 4 pi. A crack's area is that of its broken pairs."""
    return MEAN_COSINE[dim] * SPHERE[dim] * thickness * horizon ** (dim + 1) / (2 * (dim + 1))


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
