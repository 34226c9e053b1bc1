"""Cracks that are there from the start: bonds that cross one do not exist."""

from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.errors import InputError

TOUCH = 1e-10
"""A bond meets a crack that is this near, in lengths of the bond; edges of the crack and ends of the bond count."""

FLATNESS = 1e-6
"""How far from their plane the corners of a crack may lie, as a fraction of its size."""


class Sheet(NamedTuple):
    """A crack in coordinates of its own: a point in 1D, a piece of a line in 2D, a plane polygon in 3D.

    Attributes:
        origin: (dim,) a point of it.
        normal: (dim,) unit vector across it.
        tangents: (dim - 1, dim) orthonormal vectors along it.
        corners: (corners, dim - 1) coordinates of its corners along the tangents, seen from the origin.
    """

    origin: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    corners: np.ndarray


def cut_bonds(
    families: Families, position: np.ndarray, ids: np.ndarray, cracks: list, place: str = "body.cracks"
) -> np.ndarray:
    """Which bonds each crack cuts: those whose segment X_i X_j meets it, but for bonds that lie in its own plane.

    A bond is always looked at from its end with the lower id, so that i -> j and j -> i agree on any rank. A particle
    on a crack keeps the bonds along it only: let cracks run between the particles.

    Args:
        families: of any particles.
        position, ids: of all local particles.
        cracks: the vertices of each: one point in 1D, two in 2D, the corners of a plane polygon, convex or not, in 3D.
        place: of the cracks in the case, for errors.

    Returns:
        Masks of the bonds, (cracks, bonds).

    Raises:
        InputError: a crack has no extent or is not plane.
    """
    cut = np.zeros((len(cracks), families.bonds), bool)
    for number, vertices in enumerate(cracks):
        sheet = _sheet(np.array(vertices, float), position.shape[1], f"{place}.{number}")
        _cut(families.center, families.offsets, families.neighbours, position, ids, sheet, cut[number])
    return cut


def _sheet(vertices: np.ndarray, dim: int, place: str) -> Sheet:
    if vertices.shape[1:] != (dim,) or not (len(vertices) == dim if dim < 3 else len(vertices) >= 3):
        needs = {1: "one position", 2: "two points", 3: "three points or more"}[dim]
        raise InputError(f"{place}: a crack in {dim}D needs {needs} of {dim} coordinate(s)")
    if not np.all(np.isfinite(vertices)):
        raise InputError(f"{place}: the crack has a point without finite coordinates")
    origin = vertices.mean(axis=0)
    arms = vertices - origin
    size = float(np.ptp(vertices, axis=0).max())
    if dim == 1:
        return Sheet(origin, np.ones(1), np.empty((0, 1)), np.empty((1, 0)))
    # Twice the area as a vector (Newell): that of a polygon, or of a strip one high along a segment.
    across = np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0) if dim == 3 else arms[1, ::-1] * [-2, 2]
    extent = float(np.linalg.norm(across))
    rounding = 1e-12 * float(np.abs(vertices).max())
    if size <= rounding or extent <= 1e-9 * size ** (dim - 1):
        raise InputError(f"{place}: the crack has no {'length' if dim == 2 else 'area'}")
    normal = across / extent
    height = arms @ normal
    if np.abs(height).max() > FLATNESS * size:
        raise InputError(
            f"{place}: the corners of the crack do not lie in a plane: "
            f"one is {np.abs(height).max():.3g} away from that of the others"
        )
    flat = arms - height[:, None] * normal
    first = flat[np.argmax((flat**2).sum(axis=1))]
    first = first / np.linalg.norm(first)
    tangents = np.array([first] if dim == 2 else [first, np.cross(normal, first)])
    return Sheet(origin, normal, tangents, np.ascontiguousarray(flat @ tangents.T))


@njit(cache=True)
def _cut(center, offsets, neighbours, X, ids, sheet, cut):
    """Mark the bonds that meet the sheet."""
    height = np.zeros(len(X))
    far = 0.0  # from the plane of the sheet for a bond of any length
    for i in range(len(X)):
        distance = 0.0
        for k in range(X.shape[1]):
            arm = X[i, k] - sheet.origin[k]
            height[i] += arm * sheet.normal[k]
            distance += abs(arm)
        far = max(far, 2 * TOUCH * distance)
    for f in range(len(center)):
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            if min(height[i], height[j]) > far or max(height[i], height[j]) < -far:
                continue
            p, q = (i, j) if ids[i] < ids[j] else (j, i)
            cut[b] = _meets(X[p], X[q], height[p], height[q], sheet)


@njit(cache=True)
def _meets(start, end, above, below, sheet):
    """Whether a bond meets the sheet; its ends have these heights above the sheet's plane."""
    dim = len(start)
    square = 0.0
    for k in range(dim):
        square += (end[k] - start[k]) ** 2
    near = TOUCH * np.sqrt(square)
    if (above > near and below > near) or (above < -near and below < -near):
        return False
    if abs(above) <= near and abs(below) <= near:  # along the crack
        return False
    share = min(max(above / (above - below), 0.0), 1.0)
    point = np.zeros(2)
    for t in range(dim - 1):
        for k in range(dim):
            point[t] += (start[k] + share * (end[k] - start[k]) - sheet.origin[k]) * sheet.tangents[t, k]
    return dim == 1 or _covers(sheet.corners, point, near)


@njit(cache=True)
def _covers(corners, point, near):
    """Whether a point of the plane (of the line) lies in the polygon (between the two ends) or within `near` of it."""
    if corners.shape[1] == 1:
        return min(corners[0, 0], corners[1, 0]) - near <= point[0] <= max(corners[0, 0], corners[1, 0]) + near
    inside = False
    for k in range(len(corners)):
        ax, ay = corners[k - 1, 0] - point[0], corners[k - 1, 1] - point[1]
        bx, by = corners[k, 0] - point[0], corners[k, 1] - point[1]
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        share = min(max(-(ax * ex + ay * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
        if (ax + share * ex) ** 2 + (ay + share * ey) ** 2 <= near * near:
            return True
        if (ay > 0.0) != (by > 0.0) and (ax * by - bx * ay > 0.0) == (by > ay):  # the edge crosses the ray to the right
            inside = not inside
    return inside
