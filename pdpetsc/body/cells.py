"""Cells of meshes: their volumes, middles and facets, from their corners.

Volumes and middles of straight-sided cells are exact, those of cells with warped faces as well: a quadrilateral is the
bilinear patch between its corners, the same one from both sides, so that the cells of a mesh fill the body once. With
x from a point of the cell and N the area vector of a patch (divergence theorem)

    V = 1/n sum int x.N,     V X_k = 1/2 sum int x_k^2 N_k .

Points of higher order, in the middles of edges and faces, are not looked at.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np


class Kind(NamedTuple):
    """A kind of cell.

    Attributes:
        dim: its dimension.
        corners: how many it has; they come first among its points.
        facets: corners of each, seen from outside counter-clockwise where the cell is not inverted.
        filling: how many of them fill a square or a cube as large as what belongs to a vertex of theirs.
    """

    dim: int
    corners: int
    facets: tuple[tuple[int, ...], ...]
    filling: float


KINDS = {
    "triangle": Kind(2, 3, ((0, 1), (1, 2), (2, 0)), 2),
    "quad": Kind(2, 4, ((0, 1), (1, 2), (2, 3), (3, 0)), 1),
    "tetra": Kind(3, 4, ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)), 6),
    "hexahedron": Kind(
        3, 8, ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)), 1
    ),
    "wedge": Kind(3, 6, ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)), 2),
    "pyramid": Kind(3, 5, ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)), 3),
}  # fmt: skip

BY_CORNERS = {(kind.dim, kind.corners): kind for kind in KINDS.values()}

CORNERS = {"vertex": 1, "line": 2} | {name: kind.corners for name, kind in KINDS.items()}

TWIST = 0.2
"""Part of what is seen from a cell's middle that may turn its back, where the cell is warped."""

GAUSS = (0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5)
"""Two points on [0, 1], exact to the third degree."""


class Mesh(NamedTuple):
    """The cells of a body, as they are drawn.

    Attributes:
        points: (points, dim) before deformation [length].
        cells: (cells, most corners) points, in the order of their kind; -1 behind the last one.
        particle: id of that in each cell, or on each point; -1: it was left out.
        on: where particles are, "cells" or "points".
    """

    points: np.ndarray
    cells: np.ndarray
    particle: np.ndarray
    on: str

    def corners_of(self, values: np.ndarray, missing) -> np.ndarray:
        """What its points have, by cells, (cells, most corners, ...); behind the last corner `missing`."""
        there = self.cells >= 0
        return np.where(there.reshape(*there.shape, *[1] * (values.ndim - 1)), values[self.cells], missing)

    def peopled(self) -> np.ndarray:
        """Mask of the cells that have a particle, in them or on a corner."""
        if self.on == "cells":
            return self.particle >= 0
        return (self.corners_of(self.particle, -1) >= 0).any(axis=1)

    def part(self, some: np.ndarray) -> "Mesh":
        """The cells of a mask, and the points that they have."""
        cells = self.cells[some]
        used = np.zeros(len(self.points), bool)
        used[cells[cells >= 0]] = True
        cells = np.where(cells >= 0, (np.cumsum(used) - 1)[cells], -1).astype(np.int32)
        return Mesh(self.points[used], cells, self.particle[some if self.on == "cells" else used], self.on)

    def kinds(self) -> Iterator[tuple[Kind, np.ndarray]]:
        """The kinds of its cells, and the rows of each."""
        corners, dim = (self.cells >= 0).sum(axis=1), self.points.shape[1]
        for count in np.unique(corners):
            yield BY_CORNERS[dim, int(count)], np.flatnonzero(corners == count)


def base_name(kind: str) -> str:
    """The kind without the number of its points: tetra10 is a tetra."""
    return re.sub(r"\d+$", "", kind)


def volumes_and_middles(kind: Kind, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Volume (n,), negative of inverted cells, and middle (n, dim) of cells with corners (n, corners, dim); a middle is
    not finite where there is no volume."""
    origin = corners.mean(axis=1)
    arms = corners - origin[:, None]
    volume, moment = np.zeros(len(arms)), np.zeros_like(origin)
    for facet in kind.facets:
        for x, area in _points(arms[:, facet]):
            volume += (x * area).sum(axis=1) / kind.dim
            moment += x**2 * area / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        return volume, origin + moment / volume[:, None]


def twisted(kind: Kind, corners: np.ndarray) -> np.ndarray:
    """Mask of the cells whose facets cross, as of corners in another order: seen from their middle, some turn their
    back and others their face, by more than `TWIST` of all."""
    arms = corners - corners.mean(axis=1)[:, None]
    parts = []
    for facet in kind.facets:
        x = arms[:, facet]
        if kind.dim == 2:
            parts.append((x.mean(axis=1) * area_vectors(x)).sum(axis=1))
        else:  # seen from the middle, the triangle at each corner
            after, before = np.roll(x, -1, axis=1), np.roll(x, 1, axis=1)
            parts += list((np.cross(after - x, before - x) * x).sum(axis=2).T)
    return np.abs(parts).sum(axis=0) > (1 + TWIST) * np.abs(np.sum(parts, axis=0))


def _points(corners: np.ndarray):
    """Places and area vectors (n, dim) on facets whose sums of fields of the second degree times N are integrals."""
    count, dim = corners.shape[1:]
    if dim == 2:
        a, b = corners[:, 0], corners[:, 1]
        area = np.stack([b[:, 1] - a[:, 1], a[:, 0] - b[:, 0]], axis=1)
        for s in GAUSS:
            yield a + s * (b - a), area / 2
    elif count == 3:
        area = area_vectors(corners)
        for k in range(3):
            yield (corners[:, k] + corners[:, k - 1]) / 2, area / 3
    else:
        a, b, c, d = (corners[:, k] for k in range(4))
        for s in GAUSS:
            for t in GAUSS:
                along, up = (1 - t) * (b - a) + t * (c - d), (1 - s) * (d - a) + s * (c - b)
                yield (1 - t) * (a + s * (b - a)) + t * (d + s * (c - d)), np.cross(along, up) / 4


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """Area vectors (n, dim) of facets with corners (n, corners, dim), outward in the sense of `Kind.facets`."""
    if corners.shape[2] == 2:
        a, b = corners[:, 0], corners[:, 1]
        return np.stack([b[:, 1] - a[:, 1], a[:, 0] - b[:, 0]], axis=1)
    if corners.shape[1] == 3:
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    return np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2


def middles_of_facets(corners: np.ndarray) -> np.ndarray:
    """Middles (n, dim) of facets, of warped ones those of their patches."""
    if corners.shape[1] < 4:
        return corners.mean(axis=1)
    places, areas = zip(*_points(corners))
    weights = np.linalg.norm(areas, axis=2)
    return (weights[..., None] * places).sum(axis=0) / weights.sum(axis=0)[:, None]


def shares_of_facets(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Area vectors and middles, (n, corners, dim), of what of each facet is nearest to each of its corners: halves of
    lines, thirds of triangles, what the lines between the middles of opposite edges cut of quadrilaterals."""
    count = corners.shape[1]
    if count < 4:
        area = np.repeat(area_vectors(corners)[:, None] / count, count, axis=1)
        own = {2: 3 / 4, 3: 11 / 18}[count]  # of the barycentric coordinate of the corner
        others = (1 - own) / (count - 1)
        return area, (own - others) * corners + others * corners.sum(axis=1)[:, None]
    parts = parts_of_corners(corners)
    return area_vectors(parts).reshape(corners.shape), middles_of_facets(parts).reshape(corners.shape)


def parts_of_corners(corners: np.ndarray) -> np.ndarray:
    """What of polygons (n, corners, dim) lies towards each of their corners, (n corners, 4, dim): the corner, the
    middles of the edges at it and that of the polygon."""
    after, before = (corners + np.roll(corners, -1, axis=1)) / 2, (corners + np.roll(corners, 1, axis=1)) / 2
    middle = np.broadcast_to(corners.mean(axis=1)[:, None], corners.shape)
    return np.stack([corners, after, middle, before], axis=2).reshape(-1, 4, corners.shape[2])


def facets_of(kind: Kind, cells: np.ndarray) -> np.ndarray:
    """Points (facets of the kind, n, 2 or 4) of the facets of cells (n, corners); -1 behind the last one."""
    return np.stack([padded(cells[:, facet], 2 if kind.dim == 2 else 4) for facet in kind.facets])


def padded(corners: np.ndarray, width: int) -> np.ndarray:
    """Rows of as many columns, filled up with -1."""
    return np.pad(corners, ((0, 0), (0, width - corners.shape[1])), constant_values=-1)


def numbered(rows: np.ndarray) -> np.ndarray:
    """A number for each row of points, the same for those with the same ones in any order."""
    rows = np.sort(rows, axis=1)
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    numbers = np.empty(len(rows), np.int64)
    numbers[order] = np.cumsum(new) - 1
    return numbers
