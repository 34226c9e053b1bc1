"""Probes: numbers that are followed at a point, along a line or over a set of particles."""

import numpy as np
from mpi4py import MPI

from pdpetsc.body.box import coordinates
from pdpetsc.parallel import collective
from pdpetsc.particles import Particles
from pdpetsc.recover import Recovery, component

REACH = 2.0
"""Particles within this many spacings of a point take part in its interpolation."""


class Interpolation:
    """Weights with which the owned particles give the value at points, exact for affine fields.

    Moving least squares with linear basis: phi_j = w_j p(X_j)^T M^-1 p(X), M = sum w_j p p^T, w = (1 - r/R)^2. A point
    on a particle takes that particle alone. Points outside the lattice's hull, up to one spacing, are extrapolated, so
    that a face of the body can be probed.

    Args:
        particles: the distributed particles.
        points: (n, dim) reference positions, the same on all ranks (collective).
    """

    def __init__(self, particles: Particles, points: np.ndarray):
        mpi, owned, dim = particles.comm.tompi4py(), particles.owned, particles.dim
        X = particles.position[:owned]
        spacing = mpi.allreduce(float(particles.spacing[:owned].max(initial=0.0)), MPI.MAX)
        local, moments, nearest = [], [], []
        for point in points:
            r = np.linalg.norm(X - point, axis=1) / spacing
            index = np.flatnonzero(r < REACH)
            basis = np.concatenate([np.ones((len(index), 1)), (X[index] - point) / spacing], axis=1)
            weight = (1 - r[index] / REACH) ** 2
            moments.append(np.einsum("j,ja,jb->ab", weight, basis, basis))
            nearest.append(r.min(initial=np.inf))
            local.append((index, r[index], weight, basis))
        moment = mpi.allreduce(np.array(moments).reshape(len(points), dim + 1, dim + 1))
        closest = np.array([mpi.allreduce(float(value), MPI.MIN) for value in nearest])
        self.reached = closest < REACH / 2
        """Whether a particle is near enough to each point."""
        inverse = np.linalg.pinv(moment, rcond=1e-10, hermitian=True)
        self._mpi = mpi
        self._weights = []
        for k, (index, r, weight, basis) in enumerate(local):
            if closest[k] < 1e-6:
                index, share = index[r < 1e-6], np.ones(int((r < 1e-6).sum()))
            else:
                share = weight * (basis @ inverse[k][:, 0])
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
    """

    def __init__(self, spec, particles: Particles, members: np.ndarray | None):
        self.name = spec.name
        self._spec = spec
        self._particles = particles
        self._members = members
        self._interpolation = None
        if members is None:
            self.points = np.array([spec.at]) if spec.at is not None else _line(*spec.line)
            self._interpolation = Interpolation(particles, self.points)

    @property
    def reached(self) -> bool:
        """Whether all points of the probe lie in the body."""
        return self._interpolation is None or bool(self._interpolation.reached.all())

    def read(self, recovery: Recovery, time: float) -> float | list:
        """A number, or nested lists for lines and for fields without a component (collective)."""
        values = recovery.field(self._spec.field)
        if self._spec.component is not None:
            values = component(values, self._spec.component)
        if self._interpolation is None:
            return self._reduce(values[self._members], time).tolist()
        found = self._interpolation(values)
        return (found[0] if self._spec.at is not None else found).tolist()

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
