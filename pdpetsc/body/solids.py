"""The particles of a mesh: one in each cell, or one on each vertex, and the facets of its surface."""

from typing import NamedTuple

import meshio
import numpy as np

from pdpetsc.body.border import BORDER, GROUP_BIT
from pdpetsc.body.cells import (
    CORNERS,
    KINDS,
    Mesh,
    area_vectors,
    base_name,
    facets_of,
    middles_of_facets,
    numbered,
    padded,
    shares_of_facets,
    twisted,
    volumes_and_middles,
)
from pdpetsc.body.columns import Given, checked_apart, checked_positions
from pdpetsc.body.groups import group_of
from pdpetsc.body.meshes import read_mesh
from pdpetsc.errors import InputError
from pdpetsc.particles import Facets

FLATTEST = 1e-10
"""Volume of a cell, in terms of its size, that is none."""

SURFACE_GROUPS = 24
"""Most groups that surfaces are made of: each has a bit in a facet's number."""


class _Cells(NamedTuple):
    """The cells of a body, in the order of the file.

    Attributes:
        parts: for each kind of cell its row among them, and its corners (n, corners): numbers of points.
        number: (cells,) in the file, counted from 1.
        volume, middle: of each, (cells,), (cells, dim); not negative.
        inverted: mask of those that are numbered the other way round.
        where: (block of the mesh, rows) of each block that holds some.
    """

    parts: list[tuple[str, np.ndarray, np.ndarray]]
    number: np.ndarray
    volume: np.ndarray
    middle: np.ndarray
    inverted: np.ndarray
    where: dict[int, np.ndarray]

    def incidence(self) -> tuple[np.ndarray, np.ndarray]:
        """Point and cell of every corner of a cell."""
        points = np.concatenate([corners.ravel() for _, _, corners in self.parts])
        cells = np.concatenate([np.repeat(rows, corners.shape[1]) for _, rows, corners in self.parts])
        return points, cells


class _Faces(NamedTuple):
    """Facets of cells.

    Attributes:
        cell: (faces,) the row of the cell of each.
        corners: (faces, 2 or 4) points, counter-clockwise from outside of a cell that is not inverted; -1: none.
        key: (faces,) a number that the same facet of two cells shares.
        border: mask of those of one cell alone.
        of_block: keys of the cells of each block of surface cells.
    """

    cell: np.ndarray
    corners: np.ndarray
    key: np.ndarray
    border: np.ndarray
    of_block: dict[int, np.ndarray]


def particles_of_mesh(source) -> Given:
    """The particles of a mesh.

    `particles = "cells"`: in the middle of each cell, with its volume. The spacing is (mean volume)^(1/dim), the mean
    over the corners of the means over the cells that share them, so that it varies slowly.
    `particles = "vertices"`: on each vertex that a cell has, with equal shares of the volumes of its cells; the spacing
    is that of a lattice of as many vertices as these cells would have inside of a body: f V, f of the cells filling a
    cube (body/cells.py), takes the place of V, and its mean over the cells that share the vertex is taken once more.

    Args:
        source: what is asked of the file (body/given.py).

    Raises:
        InputError: naming the file, and the cell or the point that is wrong.
    """
    path, dim = source.path, source.dim
    mesh = read_mesh(path)
    points = _points(mesh, source)
    cells = _cells(mesh, points, source)
    point, cell = cells.incidence()
    used = np.bincount(point, minlength=len(points))
    _check_no_double_points(points, used > 0, path)
    checked_apart(
        cells.middle, cells.volume ** (1 / dim), path, "cell", cells.number, "leave out the one that is there twice"
    )
    thickness = source.thickness if dim < 3 else 1.0
    faces = _faces(mesh, cells, points, path) if source.facets or source.sets else None
    member = [_members(mesh, cells, faces, len(points), source, *named) for named in source.sets]
    facets = _facets(mesh, cells, faces, points, source) if source.facets else None
    on_corners = np.bincount(cell, minlength=len(cells.volume))

    def at_points(values):
        """Mean over the cells that share each point."""
        return np.bincount(point, values[cell], len(points)) / np.maximum(used, 1)

    def smoothed(values):
        """Mean over the corners of each cell of these means."""
        return np.bincount(cell, at_points(values)[point], len(cells.volume)) / on_corners

    if source.particles == "cells":
        spacing = smoothed(cells.volume) ** (1 / dim)
        member = np.array([of_cells for of_cells, _ in member], bool).reshape(len(member), len(spacing)).T
        mesh = _mesh(cells, points, used > 0, np.arange(len(spacing)), "cells")
        return Given(cells.number, cells.middle, cells.volume * thickness, spacing, None, member, facets, mesh)
    share, full = np.empty_like(cells.volume), np.empty_like(cells.volume)
    for name, rows, corners in cells.parts:
        share[rows] = cells.volume[rows] / corners.shape[1]
        full[rows] = cells.volume[rows] * KINDS[name].filling
    there = np.flatnonzero(used)
    volume = np.bincount(point, share[cell], len(points))[there]
    spacing = at_points(smoothed(full))[there] ** (1 / dim)
    member = np.array([of_points[there] for _, of_points in member], bool).reshape(len(member), len(there)).T
    mesh = _mesh(cells, points, used > 0, np.arange(len(there)), "points")
    return Given(there + 1, points[there], volume * thickness, spacing, None, member, facets, mesh)


def _mesh(cells: _Cells, points: np.ndarray, used: np.ndarray, particle: np.ndarray, on: str) -> Mesh:
    """The cells as they are drawn, with the points that they have."""
    width = max(corners.shape[1] for _, _, corners in cells.parts)
    drawn, number = np.empty((len(cells.volume), width), np.int32), np.cumsum(used) - 1
    for _, rows, corners in cells.parts:
        drawn[rows] = padded(number[corners], width)
    return Mesh(points[used], drawn, particle, on)


def _points(mesh: meshio.Mesh, source) -> np.ndarray:
    """Places (points, dim), scaled."""
    path, dim, points = source.path, source.dim, np.asarray(mesh.points, float)
    if points.shape[1] < dim:
        raise InputError(
            f"{path}: has points of fewer than {dim} coordinates; take body.dimension = 2 for a plane mesh"
        )
    checked_positions(points, path, "point", np.arange(1, len(points) + 1))
    if dim == 2 and points.shape[1] > 2 and len(points):
        size = np.ptp(points[:, :2], axis=0).max()
        if np.ptp(points[:, 2]) > 1e-9 * size:
            raise InputError(
                f"{path}: does not lie in a plane z = constant, as a body of two dimensions must; take "
                "body.dimension = 3 for a solid"
            )
    return points[:, :dim] * source.scale


def _cells(mesh: meshio.Mesh, points: np.ndarray, source) -> _Cells:
    """The cells of the body's dimension."""
    path, dim = source.path, source.dim
    parts, where, rows, first = {}, {}, 0, 1
    number = []
    for k, block in enumerate(mesh.cells):
        name, size = base_name(block.type), len(block.data)
        if block.dim == dim and size:
            if name not in KINDS:
                raise InputError(f"{path}: has cells of type {block.type}, which cannot be particles")
            corners = np.asarray(block.data)[:, : KINDS[name].corners].astype(np.int64)
            where[k] = np.arange(rows, rows + size)
            parts.setdefault(name, []).append((where[k], corners))
            number.append(np.arange(first, first + size))
            rows += size
        first += size
    if not rows:
        there = sorted({(block.dim, block.type) for block in mesh.cells if len(block.data)})
        others = sorted({d for d, _ in there if d in (2, 3)})
        remedy = f"; take body.dimension = {others[-1]}" if others else ""
        kinds = f"its cells are {', '.join(kind for _, kind in there)}" if there else "it is empty"
        raise InputError(f"{path}: has no cells of {dim} dimensions, {kinds}{remedy}")
    joined = [(name, *(np.concatenate(values) for values in zip(*some))) for name, some in parts.items()]
    number = np.concatenate(number)
    volume, middle = np.empty(rows), np.empty((rows, dim))
    for name, some, corners in joined:
        place = points[corners]
        volume[some], middle[some] = volumes_and_middles(KINDS[name], place)
        size = np.ptp(place, axis=1).max(axis=1)
        flat = np.flatnonzero(~(np.abs(volume[some]) > FLATTEST * size**dim) | (size == 0))
        if len(flat):
            what = "area" if dim == 2 else "volume"
            raise InputError(f"{path}: cell {number[some[flat]].min()} ({name}) has no {what}; mend the mesh there")
        crossed = np.flatnonzero(twisted(KINDS[name], place))
        if len(crossed):
            raise InputError(
                f"{path}: cell {number[some[crossed]].min()} ({name}) has facets that cross each other; are its "
                "corners in the order of the format, round one face and then round the opposite one?"
            )
    return _Cells(joined, number, np.abs(volume), middle, volume < 0, where)


def _check_no_double_points(points: np.ndarray, used: np.ndarray, path: str) -> None:
    """Cells that meet in points of their own do not share a facet: there would be a surface inside the body."""
    rows = np.flatnonzero(used)
    size = np.full(len(rows), np.ptp(points[rows], axis=0).max() * 1e-3)  # a millionth of a thousandth of the body
    remedy = "merge them, or the body has a surface inside (in Gmsh: Coherence Mesh, or gmsh.model.mesh." \
             "removeDuplicateNodes())"  # fmt: skip
    checked_apart(points[rows], size, path, "point", rows + 1, remedy)


def _faces(mesh: meshio.Mesh, cells: _Cells, points: np.ndarray, path: str) -> _Faces:
    """The facets of all cells, and which of them the surface cells of the mesh are."""
    dim = points.shape[1]
    width = 2 if dim == 2 else 4
    owner, corners = [], []
    for name, rows, of in cells.parts:
        owner.append(np.tile(rows, len(KINDS[name].facets)))
        corners.append(facets_of(KINDS[name], of).reshape(-1, width))
    owner, corners = np.concatenate(owner), np.concatenate(corners)
    blocks = {}
    for k, block in enumerate(mesh.cells):
        name = base_name(block.type)
        if block.dim == dim - 1 and name in CORNERS and len(block.data):
            blocks[k] = padded(np.asarray(block.data)[:, : CORNERS[name]].astype(np.int64), width)
    keys = numbered(np.concatenate([corners, *blocks.values()]))
    own, *others = np.split(keys, np.cumsum([len(corners), *(len(of) for of in blocks.values())])[:-1])
    shared = np.bincount(own, minlength=keys.max() + 1)[own]
    if shared.max() > 2:
        first = cells.number[owner[shared > 2]].min()
        raise InputError(f"{path}: cell {first} shares a facet with more than one other cell; mend the mesh there")
    return _Faces(owner, corners, own, shared == 1, dict(zip(blocks, others)))


def _members(
    mesh: meshio.Mesh, cells: _Cells, faces: _Faces, count: int, source, name: str, group: str
) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the cells and of the points that belong to a group.

    Cells: those of the group, those that have a surface cell of it as a facet, those that touch its edges or points.
    Points: all corners of its cells, and its points.
    """
    found = group_of(mesh, group, f"sets.{name}.group: {source.path}")
    of_cells, of_points = np.zeros(len(cells.volume), bool), np.zeros(count, bool)
    touching = np.zeros(count, bool)
    touching[found.points] = of_points[found.points] = True
    for k, some in found.cells.items():
        block = mesh.cells[k]
        corners = np.asarray(block.data)[some, : CORNERS.get(base_name(block.type), 0)]
        of_points[corners] = True
        if k in cells.where:
            of_cells[cells.where[k][some]] = True
        elif k in faces.of_block:
            of_cells[faces.cell[np.isin(faces.key, faces.of_block[k][some])]] = True
        elif block.dim < source.dim - 1:
            touching[corners] = True
    if touching.any():
        point, cell = cells.incidence()
        of_cells[cell[touching[point]]] = True
    return of_cells, of_points


def _facets(mesh: meshio.Mesh, cells: _Cells, faces: _Faces, points: np.ndarray, source) -> Facets:
    """The pieces of the surface, by their particles: the facets of one cell alone, or for particles on vertices the
    shares of them that are nearest to each."""
    if len(source.surfaces) > SURFACE_GROUPS:
        raise InputError(f"surfaces: {len(source.surfaces)} are groups of a mesh, {SURFACE_GROUPS} can be")
    border = np.flatnonzero(faces.border)
    code = np.full(len(border), BORDER)
    for bit, (name, group) in enumerate(source.surfaces):
        code |= _on_group(mesh, cells, faces, border, source, name, group).astype(np.int64) << (GROUP_BIT + bit)
    vertices, there = source.particles == "vertices", np.zeros(len(points), bool)
    for _, _, corners in cells.parts:
        there[corners] = True
    row = np.cumsum(there) - 1
    found = [Facets.none(points.shape[1])]
    for count in np.unique((faces.corners[border] >= 0).sum(axis=1)):
        some = np.flatnonzero((faces.corners[border] >= 0).sum(axis=1) == count)
        corners, cell = faces.corners[border[some], :count], faces.cell[border[some]]
        outward = np.where(cells.inverted[cell], -1.0, 1.0)[:, None]
        place = points[corners]
        if vertices:
            area, middle = shares_of_facets(place)
            area = (area * outward[:, None]).reshape(-1, points.shape[1])
            found.append(Facets(row[corners].ravel(), np.repeat(code[some], count), middle.reshape(area.shape), area))
        else:
            found.append(Facets(cell, code[some], middles_of_facets(place), area_vectors(place) * outward))
    facets = Facets.joined(found)
    facets.area *= source.thickness if points.shape[1] < 3 else 1.0
    return facets.chosen(np.argsort(facets.parent, kind="stable"))


def _on_group(
    mesh: meshio.Mesh, cells: _Cells, faces: _Faces, border: np.ndarray, source, name: str, group: str
) -> np.ndarray:
    """Mask of the facets of the border that belong to a group: those that are surface cells of it; without any, those
    whose corners are all points of it; without these, those of its cells."""
    found = group_of(mesh, group, f"surfaces.{name}.group: {source.path}")
    keys = [faces.of_block[k][some] for k, some in found.cells.items() if k in faces.of_block]
    if sum(map(len, keys)):
        return np.isin(faces.key[border], np.concatenate(keys))
    if len(found.points):
        inside = np.zeros(len(mesh.points) + 1, bool)
        inside[found.points] = inside[-1] = True  # -1 stands for no corner
        return inside[faces.corners[border]].all(axis=1)
    of_cells = np.zeros(len(cells.volume), bool)
    for k, some in found.cells.items():
        if k in cells.where:
            of_cells[cells.where[k][some]] = True
    return of_cells[faces.cell[border]]
