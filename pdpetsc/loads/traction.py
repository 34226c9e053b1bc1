"""Tractions on surfaces as induced body forces, traction-associated peridynamics (seed 003; theory/traction.md)."""

import math
from functools import cached_property

import numpy as np

from pdpetsc.body.cracks import Ends, cut_bonds
from pdpetsc.body.surfaces import facet_coordinates
from pdpetsc.bonds import DualFamilies, Families, find_families
from pdpetsc.errors import InputError
from pdpetsc.loads import traction_kernels as kernels
from pdpetsc.particles import Facets

SMALLEST_SPAN = 1e-9
"""Smallest ratio of the eigenvalues of M: below, a point sees its particles along too few directions."""

ON_PARTICLE = 1e-9
"""Distance, in horizons, at which a collocation point lies on a particle."""

OWN_REACH = 0.3
"""Where the weight is taken for a particle on the point, in spacings: about its mean over half a cell of alpha ~ r^(1 -
n)."""

TRANSFER = {"linear": lambda r: 1 - r, "quadratic": lambda r: 1 - r**2}
"""Weights alpha of seed 003: Eq. 26 for prototype microelastic bonds, and Eq. 25 for general ones, its minus mended."""


class Surface:
    """Collocation points, the particles that they see, and with what weights.

    Args:
        facets: with local parents.
        position, volume, horizon, spacing: of all local particles; those within a parent's horizon of a point are here.
        transfer: function of (parent, r) that gives alpha of bonds, r = |X_k - X_i|/delta.
        ids: of all local particles.
        cracks: as of `cut_bonds`; a point sees the particles that its parent sees.

    Raises:
        InputError: a point sees its particles along too few directions (on this rank only).
    """

    def __init__(self, facets: Facets, position, volume, horizon, spacing, transfer, ids, cracks):
        n = len(facets)
        delta = horizon[facets.parent]
        every = np.concatenate([facets.position, position])
        families = find_families(every, delta, np.arange(len(every)), n)
        neighbours = families.neighbours
        kept = neighbours >= n
        sizes = families.sums(kept.astype(float)).astype(np.int64)
        own = np.repeat(np.arange(n), np.diff(families.offsets))[kept]
        neighbours = neighbours[kept] - n
        on = np.flatnonzero(np.linalg.norm(facets.position - position[facets.parent], axis=1) <= ON_PARTICLE * delta)
        missing = on[~np.isin(on, own[neighbours == facets.parent[own]])]  # find_families leaves out what lies on it
        own, neighbours = np.append(own, missing), np.append(neighbours, facets.parent[missing]).astype(np.int32)
        sizes[missing] += 1
        order = np.argsort(own, kind="stable")
        offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
        families = Families(facets.parent.astype(np.int32), offsets, neighbours[order])
        families = families.without(cut_bonds(families, Ends(position, horizon, ids), cracks).any(axis=0))
        offsets, neighbours = families.offsets, families.neighbours
        own = np.repeat(np.arange(n), np.diff(offsets))

        arm = (position[neighbours] - facets.position[own]) / delta[own, None]
        r = np.linalg.norm(arm, axis=1)
        far = r > ON_PARTICLE
        least = (OWN_REACH * spacing / horizon)[facets.parent[own]]
        share = transfer(facets.parent[own], np.clip(r, least, 1.0)) * volume[neighbours]
        self._check_span(facets, arm[far], r[far], share[far], own[far])
        phi, gradient = _interpolation(own, arm, np.exp(-((2 * r) ** 2)) * volume[neighbours], n)
        exact = np.isin(own, on)
        phi[exact] = ~far[exact]
        self.facets, self.spacing = facets, spacing[facets.parent]
        self.points = kernels.Points(
            facets.position, facets.area, offsets, neighbours, share, ~far, phi, gradient / delta[own, None]
        )
        self._position, self._particles = position, len(position)

    @staticmethod
    def _check_span(facets, arm, r, share, point) -> None:
        n = len(facets)
        products = (share / r**2)[:, None, None] * arm[:, :, None] * arm[:, None, :]
        values = np.linalg.eigvalsh(_sums(point, products, n))
        flat = np.flatnonzero(~(values[:, 0] > SMALLEST_SPAN * values[:, -1]))
        if len(flat):
            where = ", ".join(f"{x:g}" for x in facets.position[flat[0]])
            raise InputError(
                f"the point ({where}) of the surface sees particles along too few directions within its horizon to "
                "give them a traction; enlarge body.horizon or add rows of particles"
            )

    @property
    def X(self) -> np.ndarray:
        """Reference positions of all local particles."""
        return self._position

    @property
    def families(self) -> Families:
        """The points' families, each with the particle whose cell holds the point as its center."""
        return Families(self.facets.parent.astype(np.int32), self.points.offsets, self.points.neighbours)

    @cached_property
    def dual(self) -> DualFamilies:
        """The families turned round, for every local particle."""
        return self.families.dual(self._particles)


class Traction:
    """Force per reference area p, or a pressure, on a surface.

        b_i = sum_k G(X_i, X_k) p_k A_k,   G = P S,   P = alpha d (x) d/|d|^2,   S = [sum P V]^-1   (seed 003 Eq. 1-3)

    with d in the deformed configuration: the forces of each point add up to p A, and as they act along lines through
    the point, their moments to that of p A there. A pressure acts as T = -p cof(F) N A, on the deformed surface (in
    plane stress with the reference thickness).

    Args:
        surface: where.
        axes: components of the traction; none for a pressure.
        value: Expression of X, Y, Z, NX, NY, NZ, spacing, t.
        follower: whether lines and normals follow the deformation; otherwise they stay as they were.
    """

    def __init__(self, surface: Surface, axes: tuple[int, ...], value, follower: bool):
        self.surface, self._axes, self._value, self.follower = surface, axes, value, follower
        self.steady = "t" not in value.names
        points = surface.points
        self._dead, self._pressure = np.zeros_like(points.position), np.zeros(len(points.position))
        dim, bonds = points.position.shape[1], len(points.neighbours)
        self._tangent = tuple(np.empty((bonds, dim, dim)) for _ in range(3)) if follower else ()

    def set_time(self, time: float) -> None:
        """Take the traction at a time."""
        surface = self.surface
        place = facet_coordinates(surface.facets, surface.spacing)
        values = self._value(**{name: place[name] for name in place}, t=time)
        if self._axes:
            self._dead[:, self._axes] = (values * np.linalg.norm(surface.points.area, axis=1))[:, None]
        else:
            self._pressure[:] = values

    def unload(self) -> None:
        """No traction, until the next `set_time`."""
        self._dead[:], self._pressure[:] = 0, 0

    def _at(self, u: np.ndarray) -> np.ndarray:
        return u if self.follower else np.zeros_like(u)

    def add_external(self, u: np.ndarray, force: np.ndarray) -> None:
        """Add the forces on the particles at local displacements to `force` (local, dim)."""
        kernels.add_forces(self.surface.points, self._dead, self._pressure, self.surface.X, self._at(u), force)

    def totals(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where each point is, and its force: (points, dim) both."""
        position, force = np.empty_like(self._dead), np.empty_like(self._dead)
        kernels.totals(self.surface.points, self._dead, self._pressure, self._at(u), position, force)
        return position, force

    def linearise(self, u: np.ndarray) -> None:
        """Prepare `add_action`, `add_diagonal` and `add_rows` at u."""
        kernels.linearise(self.surface.points, self._dead, self._pressure, self.surface.X, u, *self._tangent)

    def add_action(self, du: np.ndarray, force: np.ndarray) -> None:
        """Add the action of the tangent of the residual, -df/du du."""
        kernels.add_action(self.surface.points, *self._tangent, du, force)

    def add_diagonal(self, diagonal: np.ndarray) -> None:
        """Add the diagonal blocks of the tangent of the residual."""
        kernels.add_diagonal(self.surface.points, *self._tangent, diagonal)

    def add_rows(self, row_offsets: np.ndarray, columns: np.ndarray, blocks: np.ndarray, upper: bool) -> None:
        """Add the tangent of the residual to block rows, as a material does; it is not symmetric."""
        assert not upper
        dual = self.surface.dual
        kernels.add_rows(
            self.surface.points, dual.offsets, dual.family, dual.bond, *self._tangent, row_offsets, columns, blocks
        )


def _interpolation(own, arm, weight, n) -> tuple[np.ndarray, np.ndarray]:
    """phi and its gradient at each point: moving least squares with a linear basis, exact for affine fields.

        g_j = w_j/W C^+ (r_j - R),   phi_j = w_j/W - R . g_j,   W = sum w,  R = sum w r/W,  C = sum w (r - R)(r - R)/W

    r from the point. In a direction in which the particles lie in one row there is no gradient (C^+).
    """

    weight = weight / _sums(own, weight, n)[own]
    middle = _sums(own, weight[:, None] * arm, n)
    arm = arm - middle[own]
    C = _sums(own, weight[:, None, None] * arm[:, :, None] * arm[:, None, :], n)
    gradient = weight[:, None] * np.einsum("bpq,bq->bp", np.linalg.pinv(C, rcond=1e-9, hermitian=True)[own], arm)
    return weight - np.einsum("bp,bp->b", middle[own], gradient), gradient


def _sums(own: np.ndarray, values: np.ndarray, n: int) -> np.ndarray:
    """Sums of the bonds' values, of any shape, over each of n points."""
    shape = values.shape[1:]
    columns = values.reshape(len(values), math.prod(shape)).T
    return np.stack([np.bincount(own, column, n) for column in columns], axis=1).reshape(n, *shape)
