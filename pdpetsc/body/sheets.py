"""Plane pieces that bonds may meet: points in 1D, pieces of lines in 2D, polygons and discs in 3D, one or very many."""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.errors import InputError

TOUCH = 1e-10
"""A bond meets a sheet that is this near, in lengths of the bond; edges of the sheet and ends of the bond count."""

FLATNESS = 1e-6
"""How far from their plane the corners of a sheet may lie, as a fraction of its size."""

MOST_CELLS = 128
"""Along an axis of the grid in which the sheets near a particle are found."""


class Sheets(NamedTuple):
    """Sheets in coordinates of their own.

    Attributes:
        origin: (sheets, dim) a point of each.
        normal: (sheets, dim) unit vector across it.
        tangents: (sheets, dim - 1, dim) orthonormal vectors along it.
        corners: (sheets, corners, dim - 1) of a polygon along the tangents, seen from the origin.
        radius: (sheets,) of a disc around the origin; 0: it is a polygon.
        low, high: (sheets, dim) the box around it.
    """

    origin: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    corners: np.ndarray
    radius: np.ndarray
    low: np.ndarray
    high: np.ndarray


def polygons(vertices: np.ndarray, place: str) -> Sheets:
    """Sheets with corners (sheets, corners, dim): one point in 1D, two in 2D, three or more in a plane in 3D, convex
    or not.

    Raises:
        InputError: one has no extent or is not plane; the message begins with the place, and its number if there are
            others.
    """
    n, _, dim = vertices.shape

    def refuse(wrong: np.ndarray, reason) -> None:
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(f"{place}: {f'cell {k} of the mesh' if n > 1 else 'the crack'} {reason(k)}")

    refuse(~np.isfinite(vertices).all(axis=(1, 2)), lambda k: "has a point without finite coordinates")
    origin = vertices.mean(axis=1)
    arms = vertices - origin[:, None]
    box = vertices.min(axis=1), vertices.max(axis=1)
    size = (box[1] - box[0]).max(axis=1)
    if dim == 1:
        return Sheets(origin, np.ones((n, 1)), np.empty((n, 0, 1)), np.empty((n, 1, 0)), np.zeros(n), *box)
    # Twice the area as a vector (Newell): that of a polygon, or of a strip one high along a segment.
    across = np.cross(arms, np.roll(arms, -1, axis=1)).sum(axis=1) if dim == 3 else arms[:, 1, ::-1] * [-2, 2]
    extent = np.linalg.norm(across, axis=1)
    rounding = 1e-12 * np.abs(vertices).max(axis=(1, 2))
    kind = "length" if dim == 2 else "area"
    refuse((size <= rounding) | (extent <= 1e-9 * size ** (dim - 1)), lambda k: f"has no {kind}")
    normal = across / extent[:, None]
    height = np.einsum("ncd,nd->nc", arms, normal)
    far = np.abs(height).max(axis=1)
    refuse(
        far > FLATNESS * size,
        lambda k: f"is not plane: a corner is {far[k]:.3g} away from the plane of the others",
    )
    flat = arms - height[..., None] * normal[:, None]
    first = flat[np.arange(n), np.argmax((flat**2).sum(axis=2), axis=1)]
    first /= np.linalg.norm(first, axis=1)[:, None]
    tangents = np.stack([first] if dim == 2 else [first, np.cross(normal, first)], axis=1)
    return Sheets(origin, normal, tangents, np.einsum("ncd,ntd->nct", flat, tangents), np.zeros(n), *box)


def disc(center: tuple, normal: tuple, radius: float) -> Sheets:
    """A round sheet in 3D; the normal is a unit vector."""
    origin, across = np.array([center], float), np.array(normal, float)
    arm = np.eye(3)[np.argmin(np.abs(across))]
    first = np.cross(across, arm) / np.linalg.norm(np.cross(across, arm))
    reach = radius * np.sqrt(np.clip(1 - across**2, 0.0, 1.0))
    return Sheets(
        origin, across[None], np.array([[first, np.cross(across, first)]]), np.zeros((1, 1, 2)), np.array([radius]),
        origin - reach, origin + reach,
    )  # fmt: skip


def meet(families: Families, position: np.ndarray, ids: np.ndarray, sheets: Sheets) -> np.ndarray:
    """Mask (bonds,) of the bonds whose segment meets a sheet, but for those that lie in its own plane.

    Args:
        families: of any particles.
        position, ids: of all local particles; a bond is looked at from its end with the lower id.
    """
    cut = np.zeros(families.bonds, bool)
    if families.bonds and len(sheets.origin):
        _meet(families.center, families.offsets, families.neighbours, position, ids, sheets, cut)
    return cut


@njit(cache=True)
def _meet(center, offsets, neighbours, X, ids, sheets, cut):
    """Mark the bonds that meet a sheet; sheets are found in a grid of cells as wide as the longest bond or wider."""
    dim = X.shape[1]
    longest = 0.0
    for f in range(len(center)):
        for b in range(offsets[f], offsets[f + 1]):
            longest = max(longest, _square(X[center[f]], X[neighbours[b]]))
    longest = np.sqrt(longest)
    reach = longest * (1.0 + 1e-6)
    start, counts, stride = np.empty(dim), np.ones(dim, np.int64), np.ones(dim, np.int64)
    width = np.empty(dim)
    cells = 1
    for k in range(dim):
        start[k] = X[:, k].min()
        extent = X[:, k].max() - start[k]
        if longest > 0.0:
            counts[k] = max(1, min(MOST_CELLS, int(extent / longest)))
        width[k] = max(extent / counts[k], 1e-300)
        stride[k] = cells
        cells *= counts[k]
    first, last = np.empty(dim, np.int64), np.empty(dim, np.int64)
    begin = np.zeros(cells + 1, np.int64)
    for s in range(len(sheets.origin)):
        if _range(sheets.low[s], sheets.high[s], reach, start, width, counts, first, last):
            for cell in range(_volume(first, last)):
                begin[_cell(cell, first, last, stride) + 1] += 1
    for cell in range(cells):
        begin[cell + 1] += begin[cell]
    place, member = begin[:-1].copy(), np.empty(begin[cells], np.int32)
    for s in range(len(sheets.origin)):
        if _range(sheets.low[s], sheets.high[s], reach, start, width, counts, first, last):
            for cell in range(_volume(first, last)):
                at = _cell(cell, first, last, stride)
                member[place[at]] = s
                place[at] += 1
    for f in range(len(center)):
        i, cell = center[f], 0
        for k in range(dim):
            cell += stride[k] * max(0, min(counts[k] - 1, int((X[i, k] - start[k]) / width[k])))
        if begin[cell] == begin[cell + 1]:
            continue
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            p, q = (i, j) if ids[i] < ids[j] else (j, i)
            for m in range(begin[cell], begin[cell + 1]):
                if _meets(X[p], X[q], sheets, member[m]):
                    cut[b] = True
                    break


@njit(cache=True)
def _square(a, b):
    square = 0.0
    for k in range(len(a)):
        square += (b[k] - a[k]) ** 2
    return square


@njit(cache=True)
def _range(low, high, reach, start, width, counts, first, last):
    """Fill the first and last cell along each axis that a box comes near; whether there are any."""
    for k in range(len(start)):
        below, above = (low[k] - reach - start[k]) / width[k], (high[k] + reach - start[k]) / width[k]
        if above < 0.0 or below > counts[k]:
            return False
        first[k], last[k] = int(max(below, 0.0)), int(min(above, counts[k] - 1.0))
        first[k] = min(first[k], counts[k] - 1)
    return True


@njit(cache=True)
def _volume(first, last):
    volume = 1
    for k in range(len(first)):
        volume *= last[k] - first[k] + 1
    return volume


@njit(cache=True)
def _cell(number, first, last, stride):
    """The cell with a number among those from first to last."""
    cell = 0
    for k in range(len(first)):
        wide = last[k] - first[k] + 1
        cell += stride[k] * (first[k] + number % wide)
        number //= wide
    return cell


@njit(cache=True)
def _meets(start, end, sheets, s):
    """Whether a bond meets a sheet."""
    dim = len(start)
    near = TOUCH * np.sqrt(_square(start, end))
    above, below = 0.0, 0.0  # heights of the ends above the sheet's plane
    for k in range(dim):
        above += (start[k] - sheets.origin[s, k]) * sheets.normal[s, k]
        below += (end[k] - sheets.origin[s, k]) * sheets.normal[s, k]
    if (above > near and below > near) or (above < -near and below < -near):
        return False
    if abs(above) <= near and abs(below) <= near:  # along the crack
        return False
    share = min(max(above / (above - below), 0.0), 1.0)
    x, y = 0.0, 0.0
    for k in range(dim):
        arm = start[k] + share * (end[k] - start[k]) - sheets.origin[s, k]
        if dim > 1:
            x += arm * sheets.tangents[s, 0, k]
        if dim > 2:
            y += arm * sheets.tangents[s, 1, k]
    if dim == 1:
        return True
    if sheets.radius[s] > 0.0:
        return np.hypot(x, y) <= sheets.radius[s] + near
    return _covers(sheets.corners[s], x, y, near)


@njit(cache=True)
def _covers(corners, x, y, near):
    """Whether a point of the plane (of the line) lies in the polygon (between the two ends) or within `near` of it."""
    if corners.shape[1] == 1:
        return min(corners[0, 0], corners[1, 0]) - near <= x <= max(corners[0, 0], corners[1, 0]) + near
    inside = False
    for k in range(len(corners)):
        ax, ay = corners[k - 1, 0] - x, corners[k - 1, 1] - y
        bx, by = corners[k, 0] - x, corners[k, 1] - y
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        share = min(max(-(ax * ex + ay * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
        if (ax + share * ex) ** 2 + (ay + share * ey) ** 2 <= near * near:
            return True
        if (ay > 0.0) != (by > 0.0) and (ax * by - bx * ay > 0.0) == (by > ay):  # the edge crosses the ray to the right
            inside = not inside
    return inside
