"""Surfaces that meshes hold, read with meshio."""

from pathlib import Path

import meshio
import numpy as np

from pdpetsc.apart import read_apart
from pdpetsc.body import meshfile
from pdpetsc.errors import InputError

FACES = {
    2: {"line": [[0, 1]], "line3": [[0, 1]]},
    3: {
        "triangle": [[0, 1, 2]],
        "triangle6": [[0, 1, 2]],
        "quad": [[0, 1, 2], [0, 2, 3]],
        "quad8": [[0, 1, 2], [0, 2, 3]],
        "quad9": [[0, 1, 2], [0, 2, 3]],
    },
}
"""Cells that are pieces of a surface in a space of so many dimensions, as lines or triangles between their corners."""


def surface_of_mesh(path: str, dim: int, name: str | None) -> np.ndarray:
    """The lines (2D) or triangles (3D) of a mesh, (sheets, dim, dim) coordinates of their corners.

    Args:
        path: a file of a kind that meshio reads.
        dim: of the space; in 2D the mesh lies in a plane z = constant.
        name: of a set of cells or a physical group, or None: all cells of that dimension.

    Raises:
        InputError: the file cannot be read, has no such set or nothing of that dimension in it.
    """
    mesh = _read(path)
    if np.asarray(mesh.points).dtype.kind not in "iuf" or not np.isfinite(mesh.points).all():
        raise InputError(f"{path}: has points whose coordinates are no finite numbers")
    points = np.asarray(mesh.points, float)
    if points.ndim != 2 or points.shape[1] < dim:
        raise InputError(f"{path}: has points of fewer than {dim} coordinates")
    if dim == 2 and points.shape[1] > 2 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points[:, :2], axis=0).max():
        raise InputError(f"{path}: does not lie in a plane z = constant, as a crack in 2D must")
    chosen = _chosen(mesh, name, path)
    sheets = []
    for k, block in enumerate(mesh.cells):
        for corners in FACES[dim].get(block.type, []):
            cells = np.asarray(block.data)[chosen[k]]
            if cells.dtype.kind not in "iu" or cells.ndim != 2 or cells.shape[1] <= np.max(corners):
                raise InputError(f"{path}: has {block.type} cells that are none")
            if cells.size and not 0 <= cells.min() <= cells.max() < len(points):
                raise InputError(f"{path}: a cell has a point that the mesh does not have")
            sheets.append(points[cells[:, corners], :dim])
    if not sum(map(len, sheets)):
        kind = {2: "lines", 3: "triangles or quadrilaterals"}[dim]
        there = ", ".join(sorted({block.type for block in mesh.cells})) or "no cells"
        within = f" in {name!r}" if name else ""
        raise InputError(f"{path}: has no {kind}{within}, which a crack in {dim}D is made of; there are {there}")
    return np.concatenate(sheets)


def _read(path: str) -> meshio.Mesh:
    try:
        there = Path(path).is_file()
    except ValueError:  # a null byte in it
        there = False
    if not there:
        raise InputError(f"{path}: there is no such file")
    return meshfile.unpacked(read_apart(Path(meshfile.__file__), path))


def _chosen(mesh: meshio.Mesh, name: str | None, path: str) -> list:
    """Indices of the chosen cells of each block."""
    if name is None:
        return [slice(None)] * len(mesh.cells)
    if name in mesh.cell_sets:
        try:
            some = [np.array([] if part is None else part, np.int64) for part in mesh.cell_sets[name]]
        except (TypeError, ValueError):
            some = []
        sizes = [len(block.data) for block in mesh.cells]
        if len(some) != len(sizes) or not all(
            part.ndim == 1 and (not part.size or 0 <= part.min() <= part.max() < size)
            for part, size in zip(some, sizes)
        ):
            raise InputError(f"{path}: the set {name!r} cannot be read; list the numbers of its cells in it")
        return some
    if name in mesh.field_data and "gmsh:physical" in mesh.cell_data:
        number, dim = (int(value) for value in mesh.field_data[name])
        tags = mesh.cell_data["gmsh:physical"]  # groups of each dimension have numbers of their own
        return [np.flatnonzero((np.asarray(t) == number) & (block.dim == dim)) for t, block in zip(tags, mesh.cells)]
    names = sorted({*mesh.cell_sets, *mesh.field_data} - {"gmsh:bounding_entities"})
    raise InputError(f"{path}: has no set of cells {name!r}; choices: {', '.join(names) or 'none'}")
