"""Meshes of the unit square and cube, for tests of bodies from meshes and of their pictures."""

import meshio
import numpy as np

from pdpetsc.body.cells import KINDS

MESHED = ("tetra", "hexahedron", "triangle", "quad", "mixed")
"""Kinds of cells that `meshed` knows."""


def block(counts: tuple[int, ...], warp: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points and cells, quadrilaterals or hexahedra, of the unit square or cube; `warp` moves the points inside."""
    axes = np.meshgrid(*(np.linspace(0, 1, n + 1) for n in counts), indexing="ij")
    points = np.stack(axes, axis=-1).reshape(-1, len(counts))
    inside = np.prod(np.sin(np.pi * points), axis=1)[:, None] * (1 if warp else 0)
    points = points + warp * inside * np.sin(5 * points[:, ::-1])
    n = np.arange(len(points)).reshape([c + 1 for c in counts])
    corner = {0: slice(None, -1), 1: slice(1, None)}
    order = [(0, 0), (1, 0), (1, 1), (0, 1)]
    if len(counts) == 3:
        order = [(*xy, z) for z in (0, 1) for xy in order]
    return points, np.stack([n[tuple(corner[k] for k in at)].ravel() for at in order], axis=1)


def tetrahedra(cells: np.ndarray) -> np.ndarray:
    """Six of each hexahedron, around the diagonal from its first corner to the opposite one."""
    around = [1, 2, 3, 7, 4, 5]
    return np.concatenate([cells[:, [0, a, b, 6]] for a, b in zip(around, around[1:] + around[:1])])


def meshed(kind: str, warp: float = 0.05) -> meshio.Mesh:
    """A mesh of one kind of cells, or of hexahedra, wedges and pyramids; `warp` moves the points inside."""
    dim = 2 if kind in ("triangle", "quad") else 3
    points, cells = block((5, 4, 3)[:dim], warp)
    if kind == "triangle":
        parts = [("triangle", np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]]))]
    elif kind == "tetra":
        parts = [("tetra", tetrahedra(cells))]
    elif kind == "mixed":  # wedges below, pyramids around a point above, hexahedra between
        upper = points[cells][:, :, 0].mean(axis=1) > 0.75
        middle = points[cells][:, :, 0].mean(axis=1) < 0.25
        wedges = np.concatenate([cells[middle][:, [0, 1, 2, 4, 5, 6]], cells[middle][:, [0, 2, 3, 4, 6, 7]]])
        top = len(points) + np.arange(upper.sum())
        points = np.concatenate([points, points[cells[upper]].mean(axis=1)])
        pyramids = [np.c_[cells[upper][:, face], top] for face in np.array(KINDS["hexahedron"].facets)[:, ::-1]]
        parts = [("hexahedron", cells[~upper & ~middle]), ("wedge", wedges), ("pyramid", np.concatenate(pyramids))]
    else:
        parts = [(kind, cells)]
    return meshio.Mesh(np.c_[points, np.zeros((len(points), 3 - dim))], parts)
