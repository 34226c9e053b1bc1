"""The J-integral of a crack, as an integral over a ring of particles around its tip."""

import numpy as np
from mpi4py import MPI

from pdpetsc.errors import InputError
from pdpetsc.parallel import warn
from pdpetsc.particles import Particles
from pdpetsc.recover import Recovery

SAMPLES = 8
"""Points along each edge of a particle's cell at which the gradient of q is taken: the ring's borders cut cells."""

SECTORS = 6
"""Parts of the ring's inner and outer half by area, each, in which the body is looked for."""

FILLED = 0.85
"""Share of the fullest part's volume that each part must have: the rest is outside the body."""

CLEAR = 1.5
"""Horizons from the tip where a ring may begin; J is up to 3 % too low with one, 0.5 % with 1.5."""


class JIntegral:
    """J around the tip of a crack, the energy that its growth sets free per area [force/length].

    The domain form of Li, Shih and Needleman (1985) of Rice's integral (1968), in the reference configuration
    (docs/theory/fracture.md):

        J = 1/L sum_k V_k (P_jK H_j1 - W delta_1K)_k q,K,   q = 1 for r < r1, 0 for r > r2, linear in r between

    with r the distance from the tip (from the front in 3D), 1 the direction of growth, P the first Piola-Kirchhoff
    stress and W the energy per reference volume of the particles' families, q,K its mean over the particle's cell, L
    the length of the front: volume of the ring over its area, in 2D the thickness. H = F - R with R the rotation of the
    ring's mean F: any constant R would do in equilibrium, as the ring's stresses have no resultant; this one makes J
    independent of rigid rotations and as small a difference of large terms as F - I where there are none.

    It holds for faces without tractions and a body without forces in the ring, up to r2.

    Args:
        name: of the probe, for messages.
        spec: `tip`, unit `direction`, unit `front` (None in 2D), `radii` of the case's `[[probe]]` table.
        particles: the distributed particles.

    Raises:
        InputError: the ring is not in the body (collective).
    """

    def __init__(self, name: str, spec, particles: Particles):
        p, self._mpi = particles, particles.comm.tompi4py()
        X, spacing = p.position[: p.owned], p.spacing[: p.owned]
        inner, outer = spec.radii
        along = np.array(spec.direction)
        across = np.array([-along[1], along[0]]) if p.dim == 2 else np.cross(spec.front, along)
        plane = np.stack([along, across], axis=1)
        place = (X - np.array(spec.tip)) @ plane
        reach = spacing * np.sqrt(p.dim) / 2
        distance = np.hypot(*place.T)
        self._ring = np.flatnonzero((distance > inner - reach) & (distance < outer + reach))
        gradient, filled = _ring(place[self._ring], spacing[self._ring], plane, inner, outer)
        self._volume = volume = p.volume[self._ring]
        parts = self._mpi.allreduce(volume @ filled)
        if parts.min() < FILLED * parts.max() or parts.max() <= 0:
            raise InputError(
                f"probe: the ring of the J-integral {name!r}, {inner:g} to {outer:g} from its tip, is not in the body "
                "on all sides; move tip or take smaller radii"
            )
        horizon = self._mpi.allreduce(p.horizon[self._ring].max(initial=0.0), MPI.MAX)
        if inner < CLEAR * horizon:
            warn(
                self._mpi,
                f"probe: the ring of the J-integral {name!r} begins {inner:g} from the tip, too near for families with "
                f"a horizon of {horizon:g}; take a first radius of two horizons",
            )
        self._along = along
        self._weight = volume[:, None] * (gradient @ plane.T)
        self.length = float(parts.sum()) / (np.pi * (outer**2 - inner**2))
        """Of the front, in 2D the thickness [length]."""

    def read(self, recovery: Recovery) -> float:
        """J of a state (collective)."""
        ring, dim = self._ring, len(self._along)
        stress, H = recovery.first_piola[ring, :dim, :dim], recovery.displacement_gradient[ring, :dim, :dim]
        total = self._mpi.allreduce(np.tensordot(self._volume, H, axes=1))
        mean = total / self._mpi.allreduce(self._volume.sum())
        if not np.isfinite(mean).all():
            return float("nan")
        left, _, right = np.linalg.svd(np.eye(dim) + mean)
        flux = np.einsum("njk,nji,i->nk", stress, H - (left @ right - np.eye(dim)), self._along)
        flux -= recovery.energy_density[ring, None] * self._along
        return float(self._mpi.allreduce(np.sum(flux * self._weight))) / self.length


def _ring(place, spacing, plane, inner: float, outer: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean of q's gradient over cells, (n, 2), and how much of each is in each part of the ring, (n, 2 SECTORS).

    Args:
        place: (n, 2) of the particles in the plane across the front, seen from it.
        spacing: (n,) edges of the cells.
        plane: (dim, 2) the plane's axes, the direction of growth first.
    """
    gradient, filled = np.zeros_like(place), np.zeros((len(place), 2 * SECTORS))
    inside = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    along_axes = [inside if np.abs(axis).max() > 1e-9 else [0.0] for axis in plane]  # not along the front itself
    offsets = np.stack(np.meshgrid(*along_axes), axis=-1).reshape(-1, len(plane)) @ plane
    share, every, halfway = 1 / len(offsets), np.arange(len(place)), np.hypot(inner, outer) / np.sqrt(2)
    for offset in offsets:
        point = place + spacing[:, None] * offset
        r = np.hypot(*point.T)
        part = share * ((r > inner) & (r < outer))
        sector = np.floor(np.arctan2(point[:, 1], point[:, 0]) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
        filled[every, sector + SECTORS * (r > halfway)] += part
        gradient -= (part / (np.where(part > 0, r, 1.0) * (outer - inner)))[:, None] * point
    return gradient, filled
