"""Cells that the border of a body cuts: the share inside, its middle, and the piece of border in it.

A body is known by a condition alone. A cell where the points in its middle, on its corners and in the middles of the
cells beside it disagree is looked at in n^d points (and one layer of points around them, so that a border along the
lattice is seen as well):

    share     = the points inside over all                        V = share V_cell,  X = their mean
    area_k    = (changes from inside to outside - back) along axis k, times the face's area over n^(d-1)
    point     = the mean place of the changes, moved along the normal onto the border (bisection)

On a side of the lattice the piece is as large as the points next to it that are inside. So the area vectors of a
closed surface add up to zero to rounding where all cells are of one size: what enters a line of points leaves it.
"""

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np

SAMPLES = {1: 1024, 2: 64, 3: 16}
"""Points along an edge of a cut cell."""

FEW_SAMPLES = {1: 64, 2: 8, 3: 4}
"""As many for an estimate."""

SMALLEST_SHARE = 0.02
"""Of a cell that becomes a particle."""

TOUCH = 1e-6
"""How far outside a cell, in half widths, a border is still one of its own."""

BORDER = 6
"""Stands for the border among the numbers of the sides."""

GROUP_BIT = 3
"""The bit from which on the number of a facet of a mesh says to which groups it belongs."""

BLOCK = 1 << 20
"""Points that are looked at together."""


class Cut(NamedTuple):
    """Cells as the border cuts them.

    Attributes:
        share: (n,) of each cell that is inside; 0 where less than `SMALLEST_SHARE` is.
        middle: (n, dim) of that share.
        row: the cell of each piece of border, and of each part of a side of the lattice in cut cells; also those of
            which too little is inside.
        face: 2 axis + side of a side of the lattice, `BORDER` of a border.
        point: (pieces, dim) on the surface.
        area: (pieces, dim) outward area vector, without the thickness of the body.
    """

    share: np.ndarray
    middle: np.ndarray
    row: np.ndarray
    face: np.ndarray
    point: np.ndarray
    area: np.ndarray


def cut_cells(inside: Callable, low: np.ndarray, high: np.ndarray, outermost: np.ndarray, size: int) -> Cut:
    """Cut cells [low, high], (n, dim), at the border of a body.

    Args:
        inside: function of (points (m, dim), row of the cell of each) that gives a mask.
        low, high: corners of the cells.
        outermost: (n, dim, 2) mask of the sides that are sides of the lattice, beyond which nothing is asked.
        size: points along an edge of a cut cell.
    """
    n, dim = low.shape
    share, middle = np.zeros(n), (low + high) / 2
    pieces = [_pieces(np.empty(0, np.int64), 0, np.empty((0, dim)), np.empty((0, dim)))]
    corners = np.array(list(product((-TOUCH / 2, 1 + TOUCH / 2), repeat=dim)))
    around = 0.5 + np.concatenate([np.zeros((1, dim)), np.eye(dim), -np.eye(dim)])  # a border that comes in between
    places = np.concatenate([corners, around])  # corners has crossed the middle of the next cell
    count = max(1, BLOCK // len(places))
    for first in range(0, n, count):
        block = np.arange(first, min(n, first + count))
        at = np.broadcast_to(places, (len(block), *places.shape))
        at = np.where(outermost[block, None, :, 0], np.maximum(at, TOUCH / 2), at)
        at = np.where(outermost[block, None, :, 1], np.minimum(at, 1 - TOUCH / 2), at)
        points = low[block, None] + at * (high - low)[block, None]
        seen = inside(points.reshape(-1, dim), np.repeat(block, len(places))).reshape(len(block), -1)
        share[block] = seen.all(axis=1)
        mixed = block[seen.any(axis=1) & (share[block] == 0)]
        step = max(1, BLOCK // (size + 2) ** dim)
        for some in (mixed[k : k + step] for k in range(0, len(mixed), step)):
            share[some], middle[some], found = _part(inside, low, high, outermost, some, size)
            pieces += found
    share[share < SMALLEST_SHARE] = 0.0
    return Cut(share, middle, *(np.concatenate(values) for values in zip(*pieces)))


def _pieces(row, face: int, point, area) -> tuple[np.ndarray, ...]:
    """What a `Cut` holds of some pieces of one face."""
    return row, np.full(len(row), face), point, area


def _look(inside, low, high, outermost, rows, places) -> np.ndarray:
    """Mask of the grid of `places` (fractions of the widths) in each direction of some cells, (cells, places ...)."""
    dim, first, last = low.shape[1], places[1], places[-2]
    axes = []
    for k in range(dim):
        at = np.broadcast_to(places, (len(rows), len(places))).copy()
        at[outermost[rows, k, 0], 0] = first
        at[outermost[rows, k, 1], -1] = last
        axes.append(low[rows, k, None] + at * (high - low)[rows, k, None])
    shape = (len(rows),) + (len(places),) * dim
    points = [
        np.broadcast_to(axis.reshape((len(rows),) + (1,) * k + (-1,) + (1,) * (dim - 1 - k)), shape).ravel()
        for k, axis in enumerate(axes)
    ]
    return inside(np.stack(points, axis=1), np.repeat(rows, len(places) ** dim)).reshape(shape)


def _part(inside, low, high, outermost, rows, size) -> tuple[np.ndarray, np.ndarray, list]:
    """Share and middle of what is inside of some cells, which the border may cut or touch, and their `_pieces`."""
    dim = low.shape[1]
    places = (np.arange(-1, size + 1) + 0.5) / size
    seen = _look(inside, low, high, outermost, rows, places)
    width = (high - low)[rows]
    core = seen[(slice(None), *(slice(1, -1),) * dim)]
    flat = core.reshape(len(rows), -1)
    count = flat.sum(axis=1)
    middle, area = np.empty((len(rows), dim)), np.empty((len(rows), dim))
    weight, place = np.zeros(len(rows)), np.zeros((len(rows), dim))
    pieces, cut = [], (count > 0) & (count < size**dim)
    edges = np.arange(size + 1) / size
    for k in range(dim):
        along = np.moveaxis(core, k + 1, -1).reshape(len(rows), -1, size).sum(axis=1)
        middle[:, k] = np.where(count == size**dim, 0.5, along @ places[1:-1] / np.maximum(count, 1))
        others = [slice(None)] + [slice(None) if j == k else slice(1, -1) for j in range(dim)]
        line = np.moveaxis(seen[tuple(others)], k + 1, -1).astype(np.int8)
        change = line[..., :-1] - line[..., 1:]  # 1 where it goes out, -1 where it comes in
        change[..., 0] = np.minimum(change[..., 0], 0)  # on a side the change belongs to the cell that is inside
        change[..., -1] = np.maximum(change[..., -1], 0)
        face = width.prod(axis=1) / width[:, k] / size ** (dim - 1)
        area[:, k] = face * change.reshape(len(rows), -1).sum(axis=1)
        for side in (0, 1):
            some = np.flatnonzero(outermost[rows, k, side] & cut)
            within = np.take(core[some], -side, axis=k + 1).reshape((len(some),) + (size,) * (dim - 1))
            pieces.append(_side(within, k, side, rows[some], low, width[some]))
        crossings = np.abs(change)
        weight += face * crossings.reshape(len(rows), -1).sum(axis=1)
        for j in range(dim):
            axis = -1 if j == k else (1 + j if j < k else j)
            sums = np.moveaxis(crossings, axis, -1).reshape(len(rows), -1, crossings.shape[axis]).sum(axis=1)
            place[:, j] += face * (sums @ (edges if j == k else places[1:-1]))
    share = count / size**dim
    found = np.flatnonzero((np.abs(area).sum(axis=1) > 0) & (count > 0))
    point = low[rows[found]] + place[found] / weight[found, None] * width[found]
    point = _onto_border(inside, rows[found], point, area[found], width[found].min(axis=1) / 2)
    return share, low[rows] + middle * width, [*pieces, _pieces(rows[found], BORDER, point, area[found])]


def _side(within, axis: int, side: int, rows, low, width) -> tuple[np.ndarray, ...]:
    """The pieces of cells `rows` on a side of the lattice, of which the points next to it `within` (cells, ...) are
    inside."""
    n, size = len(rows), within.shape[-1]
    share = within.mean(axis=tuple(range(1, within.ndim)))
    place = np.full((n, low.shape[1]), float(side))
    for j, k in enumerate(k for k in range(low.shape[1]) if k != axis):
        sums = within.mean(axis=tuple(a for a in range(1, within.ndim) if a != j + 1))
        place[:, k] = sums @ (np.arange(size) + 0.5) / size / np.maximum(share * size, 1e-300)
    area = np.zeros_like(place)
    area[:, axis] = (2 * side - 1) * share * width.prod(axis=1) / width[:, axis]
    some = share > 0
    return _pieces(rows[some], 2 * axis + side, (low[rows] + place * width)[some], area[some])


def _onto_border(inside, rows, point, area, reach) -> np.ndarray:
    """Points moved along the normals of their areas by up to `reach` onto the border; where there is none they stay."""
    normal = area / np.linalg.norm(area, axis=1, keepdims=True)
    low, high = -reach, reach.copy()

    def at(step):
        return point + step[:, None] * normal

    crosses = inside(at(low), rows) & ~inside(at(high), rows)
    for _ in range(50):
        middle = (low + high) / 2
        within = inside(at(middle), rows)
        low, high = np.where(within, middle, low), np.where(within, high, middle)
    return np.where(crosses[:, None], at((low + high) / 2), point)
