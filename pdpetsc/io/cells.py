"""The cells of particles as they are drawn: their sides, and which of their faces are free."""

from typing import NamedTuple

import numpy as np

from pdpetsc.io.frames import Frame, tile_places
from pdpetsc.io.tiles import Tiles, faces
from pdpetsc.io.view import Section

HALF = 1e-6
"""Fraction by which numbers that are halves may differ from them."""

ALIKE = 0.01
"""Spacings that differ by less than this fraction are drawn as if of one size."""

FULL = 0.05
"""Part of the particles that are at least in whole cells, where these are those of a lattice."""

OVERLAP = 1.4
"""Width of the drawn cells of points that a file gives, in spacings."""


def cell_sides(position: np.ndarray, spacing: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Where the sides of each particle's cell are drawn, from the particle: (n, dim, 2).

    A cube of the particle's volume, smaller than its spacing in cells that a border cuts. Particles on vertices, known
    by halves, quarters and eighths of the volume where the body ends, have whole cells that end there. Of points that a
    file gives, few have cells as full as the fullest, which lie at any angle: they are drawn larger than their
    spacing, or there would be gaps.
    """
    dim = position.shape[1]
    share = volume / spacing**dim
    share = share / share.max()
    if np.mean(share > 1 - HALF) < FULL:
        share = np.full_like(share, OVERLAP**dim)
    low, high = position.min(axis=0), position.max(axis=0)
    outermost = np.stack([np.abs(position - end) < HALF * spacing[:, None] for end in (low, high)], axis=-1)
    part = 2.0 ** outermost.sum(axis=(1, 2)) * share
    on_sides = outermost.any(axis=(1, 2))
    vertices = np.median(share[on_sides]) < 0.75
    halved = outermost & (vertices & (np.abs(part - 1) < HALF))[:, None, None]
    whole = halved.any(axis=(1, 2))
    width = spacing * np.where(whole, 1.0, share) ** (1 / dim)
    return np.where(halved, 0.0, 0.5) * width[:, None, None] * np.array([-1, 1])


def free_faces(position: np.ndarray, spacing: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether each particle's cell, a cube of its spacing, has other cells behind its face in a direction of the axes.

    A face is hidden by a cell of its own size that is where the next one in a lattice would be, within half a spacing.
    Where sizes differ, it is hidden when a point behind each quarter of it, a quarter of its own spacing deep, lies in
    a cell of any size: a large face beside small cells is free as long as one of its quarters is.
    """
    from scipy.spatial import cKDTree

    reach, last = float(spacing.max()) / 2, len(position) - 1
    behind = position + spacing[:, None] * direction
    distance, other = cKDTree(position).query(behind, distance_upper_bound=reach)
    hidden = distance < spacing / 2
    if spacing.min() > (1 - ALIKE) * spacing.max():
        return ~hidden
    hidden &= np.abs(spacing[np.minimum(other, last)] - spacing) <= ALIKE * spacing
    rest = np.flatnonzero(~hidden)
    across = np.flatnonzero(direction == 0)
    quarters = np.tile(0.75 * direction, (4, 1))
    quarters[:, across] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]
    points = (position[rest, None] + spacing[rest, None, None] * quarters).reshape(-1, 3)
    slack = 0.1 * np.repeat(spacing[rest], 4)  # cells of a stretched lattice are no cubes
    covered = np.zeros(len(points), bool)
    size = np.floor(np.log(spacing / spacing.min()) / np.log(1.2) + 0.5)
    for cells in (np.flatnonzero(size == kind) for kind in np.unique(size)):  # of about one size: the nearest will do
        bound = spacing[cells].max() / 2 + slack.max()
        distance, other = cKDTree(position[cells]).query(points, p=np.inf, distance_upper_bound=bound)
        covered |= distance <= spacing[cells[np.minimum(other, len(cells) - 1)]] / 2 + slack
    hidden[rest] = covered.reshape(-1, 4).all(axis=1)
    return ~hidden


def deformed(frame: Frame, factor: float, arms: np.ndarray, particles) -> np.ndarray:
    """Where points are drawn that move with particles, (n, points, dim).

    Args:
        factor: by which displacements are drawn enlarged.
        arms: (n, points, dim) from the particles to the points, before deformation.
        particles: of each row.
    """
    dim = arms.shape[2]
    x = (frame.position + factor * frame.u)[particles, :dim]
    shape = np.eye(dim) + factor * (frame.F[particles, :dim, :dim] - np.eye(dim))
    return x[:, None] + arms @ shape.transpose(0, 2, 1)


def deformed_tiles(frame: Frame, factor: float, tiles: Tiles) -> np.ndarray:
    """Where the corners of tiles are drawn: moved with the points of the mesh, or with the particle where bonds of it
    have failed, so that cracks open."""
    dim = tiles.corners.shape[2] // 2
    X, u = np.split(tiles.corners, 2, axis=2)
    corners, alone = X + factor * u, frame.alone[tiles.owner]
    own = tiles.owner[alone]
    corners[alone] = deformed(frame, factor, X[alone] - frame.position[own, None, :dim], own)
    return corners


class Surface(NamedTuple):
    """What is seen of a body of three dimensions: the free faces of its cells, deformed.

    Attributes:
        corners: (n, corners, 3) of each face; where there are fewer, the last one is repeated.
        values: (n,) those of its particles.
        normal: (n, 3) across each face, before deformation, of length one.
    """

    corners: np.ndarray
    values: np.ndarray
    normal: np.ndarray


def surface(frame: Frame, factor: float, cut: Section | None) -> Surface:
    """The free faces of a body's cells.

    Args:
        factor: by which displacements are drawn enlarged.
        cut: where cells end that a section cuts; particles beyond it are not in the frame.
    """
    if frame.mesh is not None:
        seen = faces(frame.mesh, tile_places(frame), frame.apart, cut)
        arms = seen.corners[..., :3] - seen.corners[:, :1, :3]
        normal = np.cross(arms, np.roll(arms, -1, axis=1)).sum(axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
        return Surface(deformed_tiles(frame, factor, seen), frame.values[seen.owner], normal)
    sides = cell_sides(frame.position, frame.spacing, frame.volume)
    if cut is not None:
        ends = sides[:, cut.axis, cut.side]
        distance = cut.at - frame.position[:, cut.axis]
        sides[:, cut.axis, cut.side] = (np.minimum if cut.side else np.maximum)(ends, distance)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    whole = np.abs(sides).max(axis=(1, 2)) > (1 - ALIKE) / 2 * frame.spacing  # smaller ones hide nothing behind them
    corners, values, across = [], [], []
    for axis in range(3):
        for side in (0, 1):
            free = ~whole
            free[whole] = free_faces(frame.position[whole], frame.spacing[whole], (2 * side - 1) * np.eye(3)[axis])
            free |= frame.torn[:, axis, side]
            cells = sides[free][:, [0, 1, 2], np.insert(square, axis, side, axis=1)]
            corners.append(deformed(frame, factor, cells, free))
            values.append(frame.values[free])
            across.append(np.full(free.sum(), axis))
    return Surface(np.concatenate(corners), np.concatenate(values), np.eye(3)[np.concatenate(across)])
