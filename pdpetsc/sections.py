"""Sections: what the bonds that cross a plane transmit, the exact integral of the peridynamic stress over it."""

import numpy as np
from mpi4py import MPI

from pdpetsc.body.box import coordinates
from pdpetsc.errors import InputError
from pdpetsc.parallel import collective, warn
from pdpetsc.particles import Particles
from pdpetsc.recover import Recovery

ON_THE_PLANE = 1e-9
"""A particle that is nearer to the plane than this part of the smallest spacing lies on the side of the normal."""


class Section:
    """A plane that cuts the body in two; all bonds between its sides, or those that cross it where a condition holds.

    A family's forces V_i t on its neighbours and their opposite on its center are in equilibrium, moments too where the
    model keeps angular momentum (no single bond need be). The part of them that acts on one side is therefore the
    opposite of the part that acts on the other, with the neighbour y_j of each bond as the arm of both, and their sum
    over all families balances the loads of a side: force and moment equal them to the residual.

    Args:
        name: of the probe, for messages.
        spec: `at`, unit `normal`, `where` of the case's `section` table.
        particles: the distributed particles.

    Raises:
        InputError: all particles lie on one side (collective).
    """

    def __init__(self, name: str, spec, particles: Particles):
        p, self._mpi = particles, particles.comm.tompi4py()
        self._name, self._warned = name, False
        self._particles, self._where, self._at = p, spec.where, np.array(spec.at)
        self._depth = (p.position - self._at) @ np.array(spec.normal)
        smallest = self._mpi.allreduce(float(p.spacing[: p.owned].min(initial=np.inf)), MPI.MIN)
        self._beyond = self._depth >= -ON_THE_PLANE * smallest
        beyond = self._mpi.allreduce(int(self._beyond[: p.owned].sum()))
        if beyond in (0, p.count):
            raise InputError(
                f"probe: the section {name!r} has all particles on one side of its plane; move section.at into the body"
            )

    def force(self, recovery: Recovery) -> np.ndarray:
        """(dim,) force that the side of the normal exerts on the other (collective) [force]."""
        return self._mpi.allreduce(self._crossing(recovery)[0].sum(axis=0))

    def moment(self, recovery: Recovery) -> np.ndarray:
        """Its moment about `at`, in the deformed state, with linear kinematics in the reference: () in 2D, (3,) in 3D
        (collective) [force length]."""
        force, place = self._crossing(recovery)
        arm = place - self._at
        if self._particles.dim == 2:
            return self._mpi.allreduce(np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]))
        return self._mpi.allreduce(np.cross(arm, force).sum(axis=0))

    def _crossing(self, recovery: Recovery) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the bonds that count and where they act, (n, dim)."""
        force, place, bond = recovery.crossing_forces(self._beyond)
        if self._where is None:
            return force, place
        p, (i, j) = self._particles, bond.T
        share = (self._depth[i] / (self._depth[i] - self._depth[j]))[:, None]
        position = (1 - share) * p.position[i] + share * p.position[j]
        spacing = (1 - share[:, 0]) * p.spacing[i] + share[:, 0] * p.spacing[j]
        with collective(self._mpi):
            inside = self._where.mask(**coordinates(position, spacing))
        if not (self._warned or self._mpi.allreduce(int(inside.sum()))):
            self._warned = True
            warn(self._mpi, f"probe: no bond crosses the section {self._name!r} where {self._where.text}")
        return force[inside], place[inside]
