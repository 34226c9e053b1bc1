"""Probes: numbers that are followed at a point, along a line, over a set of particles, a section or around a crack."""

import numpy as np
from mpi4py import MPI

from pdpetsc.body.box import coordinates
from pdpetsc.j_integral import JIntegral
from pdpetsc.parallel import collective
from pdpetsc.particles import Particles
from pdpetsc.quantities import component
from pdpetsc.recover import Recovery
from pdpetsc.sections import Section

REACH = 2.0
"""Particles within this many of their own spacings of a point take part in its interpolation."""


THRESHOLD = 0.35
"""Of the damage of particles that a crack has passed: one beside a straight crack has lost nearly half of its bonds."""


class Interpolation:
    """Weights with which the owned particles give the value at points, exact for affine fields.

    Moving least squares with linear basis p = (1, X): phi_j = w_j p(X_j)^T M^-1 p(X), M = sum w_j p p^T, in terms of
    the particles' weighted middle; w = (1 - r/R)^2 with r = |X_j - X| / dx_j, so that where spacings differ the value
    goes steadily from one zone to the next. Across a single row of particles fields are constant. A point on a particle
    takes that particle alone. Points outside the lattice's hull, up to one spacing, are extrapolated, so that a face of
    the body can be probed.

    Args:
        particles: the distributed particles.
        points: (n, dim) reference positions, the same on all ranks (collective).
    """

    def __init__(self, particles: Particles, points: np.ndarray):
        mpi, owned, dim = particles.comm.tompi4py(), particles.owned, particles.dim
        X, spacing = particles.position[:owned], particles.spacing[:owned]
        near = _within(X, REACH * spacing, points)
        # The basis of a point is in units of the largest spacing of those that take part.
        unit = _maximum(mpi, np.array([[spacing[index].max(initial=0.0) for index in near]]))
        local, moments, nearest = [], [], []
        for point, index, length in zip(points, near, unit):
            r = np.linalg.norm(X[index] - point, axis=1) / spacing[index]
            basis = np.concatenate([np.ones((len(index), 1)), (X[index] - point) / length], axis=1)
            weight = (1 - r / REACH) ** 2
            moments.append(np.einsum("j,ja,jb->ab", weight, basis, basis))
            nearest.append(r.min(initial=REACH))
            local.append((index, r, weight, basis))
        moment = mpi.allreduce(np.array(moments).reshape(len(points), dim + 1, dim + 1))
        closest = -_maximum(mpi, -np.array([nearest]))
        self.reached = closest < REACH / 2
        """Whether a particle is near enough to each point."""
        total, first, second = moment[:, 0, 0], moment[:, 0, 1:], moment[:, 1:, 1:]
        total = np.where(total > 0, total, 1.0)
        middle = first / total[:, None]
        slope = _slopes(second / total[:, None, None] - middle[:, :, None] * middle[:, None, :], -middle)
        self._mpi = mpi
        self._weights = []
        for k, (index, r, weight, basis) in enumerate(local):
            if closest[k] < 1e-6:
                index, share = index[r < 1e-6], np.ones(int((r < 1e-6).sum()))
            else:
                share = weight / total[k] * (1 + (basis[:, 1:] - middle[k]) @ slope[k])
            self._weights.append((index, share))

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """Values at the points, (n, ...), of an owned field (collective)."""
        local = [np.tensordot(share, field[index], axes=1) for index, share in self._weights]
        return self._mpi.allreduce(np.array(local))


class Probe:
    """A probe of the case file, ready to be read.

    Args:
        spec: the case's `[[probe]]` table.
        particles: the distributed particles.
        members: mask of the owned particles of the probe's set, or None.

    Raises:
        InputError: a section or the ring of a J-integral outside the body (collective).
    """

    def __init__(self, spec, particles: Particles, members: np.ndarray | None):
        self.name = spec.name
        self._spec = spec
        self._particles = particles
        self._members = members
        self._interpolation = self._section = self._integral = None
        if spec.field == "J":
            self._integral = JIntegral(spec.name, spec, particles)
        elif spec.section is not None:
            self._section = Section(spec.name, spec.section, particles)
        elif members is None and spec.field != "crack_tip":
            self.points = np.array([spec.at]) if spec.at is not None else _line(*spec.line)
            self._interpolation = Interpolation(particles, self.points)

    @property
    def reached(self) -> bool:
        """Whether all points of the probe lie in the body."""
        return self._interpolation is None or bool(self._interpolation.reached.all())

    def read(self, recovery: Recovery, time: float) -> float | list:
        """A number, or nested lists for lines and for fields without a component (collective)."""
        if self._integral is not None:
            return self._integral.read(recovery)
        if self._spec.field == "crack_tip":
            return self._tip(recovery.field("damage"))
        if self._section is not None:
            values = getattr(self._section, self._spec.field)(recovery)[None]
            return (values if self._spec.component is None else component(values, self._spec.component))[0].tolist()
        values = recovery.field(self._spec.field)
        if self._spec.component is not None:
            values = component(values, self._spec.component)
        if self._interpolation is None:
            return self._reduce(values[self._members], time).tolist()
        found = self._interpolation(values)
        return (found[0] if self._spec.at is not None else found).tolist()

    def _tip(self, damage: np.ndarray) -> float:
        """How far a crack has come: the largest X.d of the particles whose damage is above the threshold; where there
        are none, the smallest X.d of all (collective)."""
        p = self._particles
        along = sum(p.position[: p.owned, k] * d for k, d in enumerate(self._spec.direction))
        inside = np.ones(p.owned, bool) if self._members is None else self._members
        torn = inside & (damage > (self._spec.threshold or THRESHOLD))
        first = -_maximum(p.comm.tompi4py(), -along[inside])
        return float(max(first, _maximum(p.comm.tompi4py(), along[torn])))

    def _reduce(self, values: np.ndarray, time: float) -> np.ndarray:
        p = self._particles
        mpi, volume = p.comm.tompi4py(), p.volume[: p.owned][self._members]
        weighted = volume.reshape(-1, *(1,) * (values.ndim - 1))
        match self._spec.reduce:
            case "sum":
                return mpi.allreduce(values.sum(axis=0))
            case "mean":
                return mpi.allreduce((weighted * values).sum(axis=0)) / mpi.allreduce(volume.sum())
            case "min":
                return -_maximum(mpi, -values)
            case "max":
                return _maximum(mpi, values)
        X = p.position[: p.owned][self._members]
        with collective(mpi):
            exact = self._spec.exact(**coordinates(X, p.spacing[: p.owned][self._members]), t=time)
        squares = mpi.allreduce(np.array([(volume * (values - exact) ** 2).sum(), (volume * exact**2).sum()]))
        return np.sqrt(squares[0] / squares[1]) if squares[1] > 0 else np.sqrt(squares[0])


def _maximum(mpi, values: np.ndarray) -> np.ndarray:
    local = values.max(axis=0, initial=-np.finfo(float).max)
    result = np.empty_like(local)
    mpi.Allreduce(local, result, MPI.MAX)
    return result


def _line(start, end, count: int) -> np.ndarray:
    """`count` points from start to end, both included."""
    return np.linspace(start, end, count)


def _slopes(moment: np.ndarray, position: np.ndarray) -> np.ndarray:
    """moment^+ position, without the directions in which the particles lie in one row."""
    values, vectors = np.linalg.eigh(moment)
    inverse = np.where(values > 1e-10, 1 / np.where(values > 1e-10, values, 1.0), 0.0)
    return np.einsum("nab,nb,ncb,nc->na", vectors, inverse, vectors, position)


def _within(X: np.ndarray, reach: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """For each point the particles, ascending, that reach it. There is a tree for each factor of two in reach."""
    from scipy.spatial import cKDTree  # slow to import, and needed for probes at points alone

    found = [[] for _ in points]
    size = np.floor(np.log2(reach / reach.min(initial=np.inf)))
    for members in (np.flatnonzero(size == kind) for kind in np.unique(size)):
        inside = cKDTree(X[members]).query_ball_point(points, reach[members].max())
        for candidates, index in zip(found, inside):
            candidates.append(members[index])
    result = []
    for point, candidates in zip(points, found):
        index = np.sort(np.concatenate([np.empty(0, np.int64), *candidates]))
        result.append(index[np.linalg.norm(X[index] - point, axis=1) < reach[index]])
    return result
