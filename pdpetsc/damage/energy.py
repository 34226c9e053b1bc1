"""Critical energy density of a bond (seed 004 section 2.4.3, after Foster et al. 2011)."""

import numpy as np
from numba import njit

from pdpetsc.damage.base import Criterion, Critical, per_family, where_defined
from pdpetsc.damage.stretch import MEAN_COSINE
from pdpetsc.materials.base import Material
from pdpetsc.materials.families import FAST, dimension, force_state, gather_two, scratch
from pdpetsc.materials.ordinary import SPHERE


class CriticalBondEnergy(Criterion):
    """w/w_c with the energy density w of a pair of bonds [energy/volume^2], both directions together:

        w = 1/2 T_i<xi>.(y - R_i xi) - 1/2 T_j<-xi>.(y - R_j xi)

    R is the rotation of the family, F = R U; where forces are central (bond-based and ordinary models), that of the
    bond, which leaves the force times the extension. That is the integral of seed 004 Eq. 2.33 on a proportional path
    (forces grow with the deformation, as from a reference state they do while strains are small): exact for bonds
    whose energy is quadratic in the extension, 1/2 k e^2 for each direction. A bond that is compressed stores energy,
    too, and the criterion does not tell (Eq. 2.33 neither).
    """

    name = "bond_energy"

    class Keys(Critical):
        pass

    @classmethod
    def from_case(cls, keys, material):
        result = cls(material, None)
        critical = keys.critical or energy_of_release_rate(material, keys.G_c, result.horizon)
        result._critical = per_family(material, critical)
        return result

    def ratio(self, u, tensor, both):
        sizes = np.diff(self._material.families.offsets)
        return where_defined(both(bond_energies) / np.repeat(self._critical, sizes))


def energy_of_release_rate(material: Material, release_rate: float, horizon: np.ndarray) -> np.ndarray:
    """w_c of families with these horizons: pairs that break at w_c take the energy G_c per area with them.

    Of the pairs of a length and direction, |xi . n| cross a unit of area; half of the directions count each pair once:

        G_c = w_c S/2 a int_0^delta xi^n dxi = w_c S a delta^(n+1)/(2 (n + 1)),     a = 1, 2/pi, 1/2 (mean cosine)

    with S = 2 A, 2 pi h, 4 pi: w_c = 4 G_c/(pi delta^4) in 3D (seed 004 Eq. 2.31-2.32), 3 G_c/(2 h delta^3) in 2D and
    2 G_c/(A delta^2) in 1D.
    """
    n = material._part.dim
    return 2 * (n + 1) * release_rate / (SPHERE[n] * material._part.thickness * MEAN_COSINE[n] * horizon ** (n + 1))


def bond_energies(material: Material, u: np.ndarray) -> np.ndarray:
    """What each direction of a bond stores by itself, 1/2 T<xi>.(y - R xi) [energy/volume^2]."""
    m = material
    energy, rotation = np.empty(m.families.bonds), np.empty((0, m._part.dim, m._part.dim))
    if not m.central:
        rotation = rotations(m.displacement_gradient(u)[:, : m._part.dim, : m._part.dim])
    _bond_energies(
        dimension(m._part.dim), m._data, m._part.position, *m._part.bonds(), m._part.volume, u, m.central, m.linear,
        rotation, energy,
    )  # fmt: skip
    return energy


def rotations(H: np.ndarray) -> np.ndarray:
    """R of F = I + H = R U of each family; NaN where H is."""
    F = np.eye(H.shape[1]) + H
    defined = np.isfinite(F).all(axis=(1, 2))
    left, _, right = np.linalg.svd(np.where(defined[:, None, None], F, 0.0))
    return np.where(defined[:, None, None], left @ right, np.nan)


@njit(cache=True, **FAST)
def _bond_energies(D, data, X, center, offsets, neighbours, volume, u, central, linear, rotation, energy):
    dim = len(D)
    space = scratch(D, offsets)
    xi, eta, t = space.xi, space.eta, space.t
    for f in range(len(center)):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, u, i, first, last, neighbours, xi, eta)
        force_state(D, data, f, first, last - first, space)
        for k in range(last - first):
            work = 0.0
            if linear:  # t is along xi
                for p in range(dim):
                    work += t[p, k] * eta[p, k]
            elif central:  # t.n e, n = y/|y|, e = (2 xi.eta + eta.eta)/(|y| + |xi|)
                square, current, change, along = 0.0, 0.0, 0.0, 0.0
                for p in range(dim):
                    y = xi[p, k] + eta[p, k]
                    square += xi[p, k] * xi[p, k]
                    current += y * y
                    change += (xi[p, k] + y) * eta[p, k]
                    along += t[p, k] * y
                length = np.sqrt(current)
                work = along * change / (length * (length + np.sqrt(square)))
            else:
                for p in range(dim):
                    turned = 0.0
                    for q in range(dim):
                        turned += rotation[f, p, q] * xi[q, k]
                    work += t[p, k] * (xi[p, k] + eta[p, k] - turned)
            energy[first + k] = 0.5 * work / volume[neighbours[first + k]]
