"""The cells of meshes as they are drawn: what of each belongs to a particle, and where that ends.

A particle in a cell has all of it. One on a point has of each cell around what is nearest to this corner: the pyramids
(triangles in two dimensions) whose base is the corner's share of a facet and whose tip is the middle of the cell, as in
`shares_of_facets`.

Corners of tiles are found from `places`, an array (points, m) of the mesh's points: their coordinates before
deformation and any further columns, of which corners between points have what is between the points' own.
"""

from typing import NamedTuple

import numpy as np

from pdpetsc.body.cells import Mesh, facets_of, numbered, parts_of_corners
from pdpetsc.io.view import Section

PYRAMID = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 4], [1, 4], [2, 4], [3, 4]])
"""Corners at the ends of its edges; the tip is the last one."""


class Tiles(NamedTuple):
    """Pieces of lines or surfaces, and to which particle each belongs.

    Attributes:
        corners: (n, corners, m) columns of places; where there are fewer, the last one is repeated.
        owner: (n,) ids of particles.
    """

    corners: np.ndarray
    owner: np.ndarray

    def chosen(self, mask: np.ndarray) -> "Tiles":
        return Tiles(self.corners[mask], self.owner[mask])

    @classmethod
    def joined(cls, parts: list["Tiles"]) -> "Tiles":
        """All of them, with as many corners as any has."""
        most = max(part.corners.shape[1] for part in parts)
        filled = [part.corners[:, np.minimum(np.arange(most), part.corners.shape[1] - 1)] for part in parts]
        return cls(np.concatenate(filled), np.concatenate([part.owner for part in parts]))


class _Facets(NamedTuple):
    """The facets of cells, each once for every cell.

    Attributes:
        corners: (n, 2 or 4) points, -1 behind the last one; cell: (n,) of each.
        beyond: (n,) the cell on the other side; -1: none.
    """

    corners: np.ndarray
    cell: np.ndarray
    beyond: np.ndarray


def areas(mesh: Mesh, places: np.ndarray) -> Tiles:
    """What belongs to the particles of a plane body."""
    parts = []
    for kind, rows in mesh.kinds():
        corners = mesh.cells[rows, : kind.corners]
        if mesh.on == "cells":
            parts.append(Tiles(_filled(places[corners], 4), mesh.particle[rows]))
        else:
            parts.append(Tiles(parts_of_corners(places[corners]), mesh.particle[corners].ravel()))
    return _kept(Tiles.joined(parts))


def edges(mesh: Mesh, places: np.ndarray, apart: np.ndarray) -> Tiles:
    """Where the areas of particles have come apart, in two dimensions: on both sides of each crack.

    Args:
        apart: (k, 2) ids of particles whose bonds have failed.
    """
    return _between(mesh, places, _facets(mesh), apart)


def faces(mesh: Mesh, places: np.ndarray, apart: np.ndarray, cut: Section | None) -> Tiles:
    """The surface of a body of three dimensions: of its cells, where it has come apart, and where it is cut open.

    Args:
        apart: (k, 2) ids of particles whose bonds have failed.
        cut: only what is behind this plane; the mesh has no cells that are not (`behind`).
    """
    facets = _facets(mesh)
    seen = [_outside(mesh, places, facets), _between(mesh, places, facets, apart)]
    if cut is not None:
        seen = [_behind(tiles, cut) for tiles in seen] + [_section(mesh, places, facets, cut)]
    return Tiles.joined(seen)


def behind(mesh: Mesh, cut: Section) -> Mesh:
    """The cells of a mesh that have something behind a plane."""
    return mesh.part(mesh.corners_of(depth(mesh.points, cut), -np.inf).max(axis=1) > 0)


def depth(points: np.ndarray, cut: Section) -> np.ndarray:
    """How far behind a plane places (..., m) are."""
    return (1 if cut.side else -1) * (cut.at - points[..., cut.axis])


def _facets(mesh: Mesh) -> _Facets:
    """Those of all cells that have a particle."""
    corners, cell = [], []
    for kind, rows in mesh.kinds():
        if mesh.on == "cells":
            rows = rows[mesh.particle[rows] >= 0]
        of = facets_of(kind, mesh.cells[rows, : kind.corners])
        corners.append(of.reshape(-1, of.shape[2]))
        cell.append(np.tile(rows, len(of)))
    corners, cell = np.concatenate(corners), np.concatenate(cell)
    key = numbered(corners)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    beyond = np.full(len(cell), -1)
    beyond[order[first]], beyond[order[first + 1]] = cell[order[first + 1]], cell[order[first]]
    return _Facets(corners, cell, beyond)


def _kept(tiles: Tiles) -> Tiles:
    return tiles.chosen(tiles.owner >= 0)


def _filled(corners: np.ndarray, width: int) -> np.ndarray:
    return corners[:, np.minimum(np.arange(width), corners.shape[1] - 1)]


def _by_corners(facets: _Facets):
    """Rows and points of the facets with the same number of corners."""
    count = (facets.corners >= 0).sum(axis=1)
    for corners in np.unique(count):
        rows = np.flatnonzero(count == corners)
        yield rows, facets.corners[rows, :corners]


def _pieces(mesh: Mesh, places: np.ndarray, facets: _Facets) -> tuple[Tiles, np.ndarray]:
    """What of facets of three dimensions belongs to which particle, and the cell that it is a piece of."""
    parts, cells = [Tiles(np.empty((0, 4, places.shape[1])), np.empty(0, np.int64))], [np.empty(0, np.int64)]
    for rows, corners in _by_corners(facets):
        place, cell = places[corners], facets.cell[rows]
        if mesh.on == "cells":
            parts.append(Tiles(_filled(place, 4), mesh.particle[cell]))
            cells.append(cell)
        else:
            parts.append(Tiles(parts_of_corners(place), mesh.particle[corners].ravel()))
            cells.append(np.repeat(cell, corners.shape[1]))
    return Tiles.joined(parts), np.concatenate(cells)


def _outside(mesh: Mesh, places: np.ndarray, facets: _Facets) -> Tiles:
    """The surface of a mesh."""
    alone = facets.beyond < 0
    return _kept(_pieces(mesh, places, _Facets(*(values[alone] for values in facets)))[0])


def _between(mesh: Mesh, places: np.ndarray, facets: _Facets, apart: np.ndarray) -> Tiles:
    """Where two particles meet that are apart, or one that was left out: once for each of them."""
    dim = mesh.points.shape[1]
    keys = np.unique(_pair(apart[:, 0], apart[:, 1]))
    found = [Tiles(np.empty((0, dim, places.shape[1])), np.empty(0, np.int64))]
    middle = _middles(mesh, places)
    for rows, corners in _by_corners(facets):
        if mesh.on == "cells":
            beyond = facets.beyond[rows]
            own, other = mesh.particle[facets.cell[rows]], mesh.particle[beyond]
            torn = (beyond >= 0) & np.isin(_pair(own, other), keys)
            found.append(Tiles(places[corners[torn]], own[torn]))
            continue
        for k in range(corners.shape[1] if dim == 3 else 1):
            ends = corners[:, [k, (k + 1) % corners.shape[1]]]
            pair = mesh.particle[ends]
            torn = np.isin(_pair(*pair.T), keys) | ((pair < 0).sum(axis=1) == 1)
            between = [places[ends[torn]].mean(axis=1), middle[facets.cell[rows[torn]]]]
            if dim == 3:
                between.insert(1, places[corners[torn]].mean(axis=1))
            found += [Tiles(np.stack(between, axis=1), side) for side in pair[torn].T]
    return _kept(Tiles.joined(found))


def _pair(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A number for each pair of particles, whichever comes first."""
    return np.maximum(a, b).astype(np.int64) * 2**31 + np.minimum(a, b)


def _middles(mesh: Mesh, places: np.ndarray) -> np.ndarray:
    """The mean of each cell's corners."""
    return mesh.corners_of(places, 0.0).sum(axis=1) / (mesh.cells >= 0).sum(axis=1)[:, None]


def _behind(tiles: Tiles, cut: Section) -> Tiles:
    """What of tiles is behind a plane."""
    corners = tiles.corners
    following = np.roll(corners, -1, axis=1)
    here, there = depth(corners, cut), depth(following, cut)
    some = here.max(axis=1) > 0  # not what lies in the plane
    corners, following, here, there = (values[some] for values in (corners, following, here, there))
    points = np.stack([corners, _crossings(corners, following, here, there)], axis=2)
    kept = np.stack([here >= 0, here * there < 0], axis=2)
    count = 2 * corners.shape[1]
    return _compact(
        points.reshape(len(corners), count, corners.shape[2]), kept.reshape(len(corners), count), tiles.owner[some]
    )


def _section(mesh: Mesh, places: np.ndarray, facets: _Facets, cut: Section) -> Tiles:
    """The plane that cuts a mesh open."""
    crossed = mesh.corners_of(depth(mesh.points, cut), np.inf).min(axis=1) <= 0
    some = crossed[facets.cell]
    base, cell = _pieces(mesh, places, _Facets(*(values[some] for values in facets)))
    kept = base.owner >= 0
    pyramid = np.concatenate([base.corners, _middles(mesh, places)[cell][:, None]], axis=1)[kept]
    a, b = pyramid[:, PYRAMID[:, 0]], pyramid[:, PYRAMID[:, 1]]
    first, second = depth(a, cut), depth(b, cut)
    crossing = (first > 0) != (second > 0)
    points = _crossings(a, b, first, second)
    weight = crossing / np.maximum(crossing.sum(axis=1), 1)[:, None]
    centre = (points * weight[..., None]).sum(axis=1, keepdims=True)
    across = [axis for axis in range(3) if axis != cut.axis]
    angle = np.arctan2(*np.moveaxis((points - centre)[..., across], -1, 0))
    order = np.argsort(np.where(crossing, angle, np.inf), axis=1)
    return _compact(
        np.take_along_axis(points, order[..., None], axis=1), np.take_along_axis(crossing, order, axis=1),
        base.owner[kept],
    )  # fmt: skip


def _crossings(a: np.ndarray, b: np.ndarray, depth_a: np.ndarray, depth_b: np.ndarray) -> np.ndarray:
    """Where a plane crosses the lines between points of these depths; anywhere between them, where it does not."""
    span = depth_a - depth_b
    part = np.clip(depth_a / np.where(span == 0, 1.0, span), 0, 1)
    return a + part[..., None] * (b - a)


def _compact(points: np.ndarray, kept: np.ndarray, owner: np.ndarray) -> Tiles:
    """Polygons of the points (n, points, m) of a mask, in their order; none of those with fewer than three."""
    count = kept.sum(axis=1)
    whole = count >= 3
    points, kept, count = points[whole], kept[whole], count[whole]
    order = np.argsort(~kept, axis=1, kind="stable")[:, : max(3, count.max(initial=3))]
    last = np.minimum(np.arange(order.shape[1]), count[:, None] - 1)
    order = np.take_along_axis(order, last, axis=1)
    return Tiles(np.take_along_axis(points, order[..., None], axis=1), owner[whole])
