"""Cells that the border of a body cuts: the share inside, its middle, and the piece of border in it.

A body is known by a condition alone. A cell where points in the middle, on the corners and on the sides disagree is
looked at in n^d points (and one layer of points around them, so that a border along the lattice is seen as well):

    share     = the points inside over all                        V = share V_cell,  X = their mean
    area_k    = (changes from inside to outside - back) along axis k, times the face's area over n^(d-1)
    point     = the mean place of the changes, moved along the normal onto the border (bisection)

so that the area vectors of a closed border add up to zero exactly, whatever its shape: what enters a line leaves it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

SAMPLES = {1: 1024, 2: 64, 3: 16}
"""Points along an edge of a cut cell."""

SMALLEST_SHARE = 0.02
"""Of a cell that becomes a particle."""

TOUCH = 1e-6
"""How far outside a cell, in half widths, a border is still one of its own."""

BLOCK = 1 << 20
"""Points that are looked at together."""


class Cut(NamedTuple):
    """Cells as the border cuts them.

    Attributes:
        share: (n,) of each cell that is inside; 0 where less than `SMALLEST_SHARE` is.
        middle: (n, dim) of that share.
        row: the cell of each piece of border.
        point: (pieces, dim) on the border.
        area: (pieces, dim) outward area vector, without the thickness of the body.
    """

    share: np.ndarray
    middle: np.ndarray
    row: np.ndarray
    point: np.ndarray
    area: np.ndarray


def cut_cells(inside: Callable, low: np.ndarray, high: np.ndarray, outermost: np.ndarray) -> Cut:
    """Cut cells [low, high], (n, dim), at the border of a body.

    Args:
        inside: function of (points (m, dim), row of the cell of each) that gives a mask.
        low, high: corners of the cells.
        outermost: (n, dim, 2) mask of the sides that are sides of the lattice, beyond which nothing is asked.
    """
    n, dim = low.shape
    share, middle = np.zeros(n), (low + high) / 2
    size = SAMPLES[dim]
    rows, points, areas = [], [], []
    for first in range(0, n, max(1, BLOCK // 3**dim)):
        block = np.arange(first, min(n, first + max(1, BLOCK // 3**dim)))
        seen = _look(inside, low, high, outermost, block, np.array([-TOUCH, 1.0, 2 + TOUCH]) / 2)
        share[block] = seen.reshape(len(block), -1).all(axis=1)
        mixed = block[seen.reshape(len(block), -1).any(axis=1) & (share[block] == 0)]
        step = max(1, BLOCK // (size + 2) ** dim)
        for some in (mixed[k : k + step] for k in range(0, len(mixed), step)):
            part = _part(inside, low, high, outermost, some)
            share[some], middle[some] = part.share, part.middle
            rows.append(some[part.row])
            points.append(part.point)
            areas.append(part.area)
    small = share < SMALLEST_SHARE
    share[small] = 0.0
    row = np.concatenate([np.empty(0, np.int64), *rows])
    kept = share[row] > 0
    point, area = (np.concatenate([np.empty((0, dim)), *values])[kept] for values in (points, areas))
    return Cut(share, middle, row[kept], point, area)


def _look(inside, low, high, outermost, rows, places) -> np.ndarray:
    """Mask of the grid of `places` (fractions of the widths) in each direction of some cells, (cells, places ...)."""
    dim, first, last = low.shape[1], places[1], places[-2]
    axes = []
    for k in range(dim):
        at = np.broadcast_to(places, (len(rows), len(places))).copy()
        at[outermost[rows, k, 0], 0] = first if len(places) > 3 else TOUCH / 2
        at[outermost[rows, k, 1], -1] = last if len(places) > 3 else 1 - TOUCH / 2
        axes.append(low[rows, k, None] + at * (high - low)[rows, k, None])
    shape = (len(rows),) + (len(places),) * dim
    points = [
        np.broadcast_to(axis.reshape((len(rows),) + (1,) * k + (-1,) + (1,) * (dim - 1 - k)), shape).ravel()
        for k, axis in enumerate(axes)
    ]
    return inside(np.stack(points, axis=1), np.repeat(rows, len(places) ** dim)).reshape(shape)


def _part(inside, low, high, outermost, rows) -> Cut:
    """What is inside of some cells, which the border may cut or touch."""
    dim, size = low.shape[1], SAMPLES[low.shape[1]]
    places = (np.arange(-1, size + 1) + 0.5) / size
    seen = _look(inside, low, high, outermost, rows, places)
    width = (high - low)[rows]
    core = seen[(slice(None), *(slice(1, -1),) * dim)]
    flat = core.reshape(len(rows), -1)
    count = flat.sum(axis=1)
    middle, area = np.empty((len(rows), dim)), np.empty((len(rows), dim))
    weight, place = np.zeros(len(rows)), np.zeros((len(rows), dim))
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
    return Cut(share, low[rows] + middle * width, found, point, area[found])


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
