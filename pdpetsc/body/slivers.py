"""Slivers of a fitted body: too small for particles, but with a piece of its surface."""

import numpy as np
from mpi4py import MPI

from pdpetsc.parallel import warn
from pdpetsc.particles import Facets, Points

NEAREST = 8
"""Particles that may be equally near to a point on the surface."""

ALIKE = 1e-9
"""Distances that differ by less than this fraction are equal."""


def adopted(comm, points: Points) -> Facets:
    """The facets with those of slivers, that are no particles, given to the nearest particle on any rank; among equally
    near ones to that of the lowest id. One that is farther than its horizon has no use for it; such pieces are lost,
    with a warning (collective)."""
    facets = points.facets
    alone = facets.parent < 0
    orphans = Facets.joined(comm.allgather(facets.chosen(alone)))
    n = len(orphans)
    distance, id = np.full(n, np.inf), np.full(n, np.iinfo(np.int64).max)
    if n and len(points.id):
        from scipy.spatial import cKDTree  # slow to import, and rarely needed

        few = min(NEAREST, len(points.id))
        found, row = cKDTree(points.position).query(orphans.position, few)
        found, row = found.reshape(n, few), row.reshape(n, few)
        tied = found <= found[:, :1] * (1 + ALIKE)
        row = np.where(tied, row, len(points.id)).min(axis=1)  # rows are in the order of the ids
        distance, id = found[:, 0], points.id[row]
        distance[distance > points.horizon[row]] = np.inf
    nearest = distance.copy()
    comm.Allreduce(MPI.IN_PLACE, nearest, MPI.MIN)
    lost = ~np.isfinite(nearest)
    if lost.any():
        where = ", ".join(f"{x:g}" for x in orphans.position[lost][0])
        warn(
            comm,
            f"body.keep: {int(lost.sum())} pieces of the border, one at ({where}), have no particle within its horizon "
            "and take no traction; lower the spacing there",
        )
    tied = np.isfinite(distance) & (distance <= nearest * (1 + ALIKE))
    lowest = np.where(tied, id, np.iinfo(np.int64).max)
    comm.Allreduce(MPI.IN_PLACE, lowest, MPI.MIN)
    orphans.parent[:] = id
    return Facets.joined([facets.chosen(~alone), orphans.chosen(tied & (id == lowest))])
