"""Bodies whose particles a file gives: the cells or vertices of a mesh, or points."""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

from pdpetsc.body.box import coordinates
from pdpetsc.body.clouds import count_of_hdf5, is_hdf5, points_of_file, points_of_hdf5
from pdpetsc.body.columns import GROUPS, Given
from pdpetsc.body.solids import particles_of_mesh
from pdpetsc.errors import InputError
from pdpetsc.parallel import collective
from pdpetsc.particles import Facets, Points

LARGEST_RATIO = 1e6
"""Of a body's size to its smallest spacing."""


class Source(NamedTuple):
    """What is asked of a file.

    Attributes:
        path, stamp: the file, and what changes when it is written anew.
        shape: "mesh" or "points".
        dim, particles, thickness, scale: as in the case's `[body]`.
        sets, surfaces: pairs of the name in the case and the group of the file.
        facets: whether the facets of the surface are wanted.
    """

    path: str
    stamp: tuple[int, int]
    shape: str
    dim: int
    particles: str
    thickness: float
    scale: float
    sets: tuple[tuple[str, str], ...]
    surfaces: tuple[tuple[str, str], ...]
    facets: bool

    @property
    def noun(self) -> str:
        """What a row of the file is called."""
        if self.shape == "mesh":
            return {"cells": "cell", "vertices": "point"}[self.particles]
        return "line" if Path(self.path).suffix.lower() in (".csv", ".txt") else "row" if self.in_slices else "point"

    @property
    def in_slices(self) -> bool:
        """Whether each rank can read a part of it alone."""
        return self.shape == "points" and is_hdf5(self.path)


def source_of(case) -> Source:
    """What a case asks of the file of its body."""
    body, path = case.body, Path(case.body.mesh or case.body.points)
    about = path.stat() if path.is_file() else None
    named = (
        tuple((name, spec.group) for name, spec in specs.items() if spec.group is not None)
        for specs in (case.sets, case.surfaces)
    )
    return Source(
        str(path), (about.st_mtime_ns, about.st_size) if about else (0, 0), body.shape, body.dim, body.particles,
        body.thickness, body.scale, *named, any(getattr(load, "surface", None) is not None for load in case.load),
    )  # fmt: skip


@lru_cache(maxsize=1)
def whole(source: Source) -> Given:
    """All of a file, kept until another one is read or `forget` is called: nothing is read twice between a look
    before a run and the run.

    Raises:
        InputError: something in the file is wrong.
    """
    return particles_of_mesh(source) if source.shape == "mesh" else points_of_file(source)


def forget() -> None:
    """Give back the memory of what was read."""
    whole.cache_clear()


def count_of(source: Source) -> int:
    """How many particles a file holds, before any is left out."""
    return count_of_hdf5(source.path, source.stamp) if source.in_slices else len(whole(source).position)


def rows_of(source: Source, start: int, stop: int) -> Given:
    """The particles of some consecutive rows, without facets."""
    if source.in_slices:
        return points_of_hdf5(source, start, stop)
    return whole(source).rows(start, stop)


def made(given: Given, keep, horizon, first: int = 0) -> tuple[Points, np.ndarray]:
    """Points of rows that begin with `first`, with their row as id, and the mask of those that `keep` leaves.

    Raises:
        InputError: a horizon is not greater than 0, or there is none.
    """
    place = coordinates(given.position, given.spacing)
    kept = np.ones(len(given.position), bool) if keep is None else keep.mask(**place)
    some = [values[kept] for values in (given.position, given.volume, given.spacing)]
    horizons = horizon(some[0], some[2], None if given.horizon is None else given.horizon[kept])
    if np.any(horizons <= 0):
        where = ", ".join(f"{x:g}" for x in some[0][np.argmin(horizons)])
        raise InputError(f"body.horizon: is {horizons.min():g} at ({where}); it must be greater than 0")
    groups = {GROUPS: given.member[kept].astype(float)} if given.member.shape[1] else {}
    return Points(first + np.flatnonzero(kept), *some, horizons, carried=groups), kept


def given_particles(comm, source: Source, keep, horizon) -> Points:
    """This rank's share of the particles of a file, in its order.

    The first rank reads it and deals it out in blocks of rows; of HDF5 every rank reads its own.

    Args:
        comm: mpi4py communicator.
        keep: condition of X, Y, Z, spacing that tells which particles exist, or None.
        horizon: function of (position, spacing, horizons of the file or None) that gives each particle's horizon.

    Raises:
        InputError: the file cannot be read or something in it is wrong (collective).
    """
    count = None
    with collective(comm):
        if comm.rank == 0:
            count = count_of(source)
            if count * source.dim > np.iinfo(PETSc.IntType).max:
                raise InputError(f"{source.path}: has {count} particles, more than this PETSc's integers can number")
    count = comm.bcast(count)
    starts = [count * rank // comm.size for rank in range(comm.size + 1)]
    first, given, mesh = starts[comm.rank], None, None
    if source.in_slices:
        with collective(comm):
            given = rows_of(source, first, starts[comm.rank + 1])
    else:
        read = whole(source) if comm.rank == 0 else None
        given, mesh = _dealt(comm, read, starts), read and read.mesh
        forget()
    _check_whole(comm, source, given)
    with collective(comm):
        points, kept = made(given, keep, horizon, first)
    n = len(points.id)
    if comm.allreduce(n) == 0:
        raise InputError("body.keep: no particle is left; the condition is false everywhere")
    begin = comm.scan(n) - n
    points.id = np.arange(begin, begin + n)
    if source.shape == "mesh":
        masks = comm.gather(kept)
        if mesh is not None:
            left = np.concatenate(masks)
            mesh = mesh._replace(particle=np.where(left, np.cumsum(left) - 1, -1)[mesh.particle])
            points.mesh = mesh.part(mesh.peopled())
    if given.facets is not None:
        parent = given.facets.parent - first
        facets = given.facets.chosen(kept[parent])
        facets.parent = begin + (np.cumsum(kept) - 1)[parent[kept[parent]]]
        points.facets = facets
    return points


def _dealt(comm, given: Given | None, starts: list[int]) -> Given:
    """The rows of a table of the first rank that belong to this one."""
    columns, facets = {}, None
    if comm.rank == 0:
        columns = {name: values for name, values in given._asdict().items() if isinstance(values, np.ndarray)}
        facets = given.facets
    what = comm.bcast((list(columns), facets is not None))
    columns = {name: _block(comm, columns.get(name), starts) for name in what[0]}
    if what[1]:
        ends = np.searchsorted(facets.parent, starts) if comm.rank == 0 else None
        ends = [int(end) for end in comm.bcast(ends)]
        names = ("parent", "face", "position", "area")
        facets = Facets(*(_block(comm, getattr(facets, name, None), ends) for name in names))
    return Given(**columns, facets=facets) if "horizon" in columns else Given(**columns, horizon=None, facets=facets)


def _block(comm, values: np.ndarray | None, starts: list[int]) -> np.ndarray:
    """The rows starts[rank] ... starts[rank + 1] of an array of the first rank."""
    shape, kind = comm.bcast((values.shape[1:], values.dtype.str) if comm.rank == 0 else None)
    block = np.empty((starts[comm.rank + 1] - starts[comm.rank], *shape), kind)
    if comm.rank == 0:
        for rank in range(1, comm.size):
            comm.Send(np.ascontiguousarray(values[starts[rank] : starts[rank + 1]]), dest=rank)
        block[...] = values[: starts[1]]
    else:
        comm.Recv(block, source=0)
    return block


def _check_whole(comm, source: Source, given: Given) -> None:
    """What only all ranks together can see (collective)."""
    members = comm.allreduce(given.member.sum(axis=0))
    for (name, group), count in zip(source.sets, members):
        if not count:
            raise InputError(f"sets.{name}.group: {source.path}: no particle belongs to {group!r}")
    far = np.finfo(float).max
    low, high = np.full(source.dim, far), np.full(source.dim, -far)
    smallest = (far, -1)
    if len(given.position):
        low, high = given.position.min(axis=0), given.position.max(axis=0)
        smallest = float(given.spacing.min()), int(given.number[given.spacing.argmin()])
    ends = comm.allgather((low, high, smallest))
    size = float((np.max([end[1] for end in ends], axis=0) - np.min([end[0] for end in ends], axis=0)).max())
    spacing, number = min(end[2] for end in ends)
    if size > LARGEST_RATIO * spacing:
        raise InputError(
            f"{source.path}: the body is {size:.3g} large, but {source.noun} {number} has a spacing of {spacing:.3g}, "
            "too small to go with it; is a point far away from the others, or a cell a sliver?"
        )
