"""Mesh files, read with meshio in a process of its own, and the surfaces that they hold."""

from importlib.util import find_spec
from pathlib import Path

import meshio
import numpy as np

from pdpetsc.apart import read_apart
from pdpetsc.body import meshfile
from pdpetsc.body.cells import CORNERS, base_name
from pdpetsc.body.groups import group_of
from pdpetsc.errors import InputError

EXODUS = (".e", ".ex2", ".exo", ".exodus", ".g")
"""How the names of Exodus files end."""

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
    mesh = read_mesh(path)
    points = np.asarray(mesh.points, float)
    if points.shape[1] < dim:
        raise InputError(f"{path}: has points of fewer than {dim} coordinates")
    if not np.isfinite(points).all():
        raise InputError(f"{path}: has points whose coordinates are no finite numbers")
    flat = dim == 3 or points.shape[1] < 3 or not len(points)
    if not flat and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points[:, :2], axis=0).max():
        raise InputError(f"{path}: does not lie in a plane z = constant, as a crack in 2D must")
    chosen = None if name is None else group_of(mesh, name, path).cells
    sheets = []
    for k, block in enumerate(mesh.cells):
        for corners in FACES[dim].get(block.type, []):
            cells = block.data[slice(None) if chosen is None else chosen.get(k, [])]
            sheets.append(points[cells[:, corners], :dim])
    if not sum(map(len, sheets)):
        kind = {2: "lines", 3: "triangles or quadrilaterals"}[dim]
        there = ", ".join(sorted({block.type for block in mesh.cells})) or "no cells"
        within = f" in {name!r}" if name else ""
        raise InputError(f"{path}: has no {kind}{within}, which a crack in {dim}D is made of; there are {there}")
    return np.concatenate(sheets)


def read_mesh(path: str) -> meshio.Mesh:
    """A file of a kind that meshio reads.

    Raises:
        InputError: there is no such file, or it is none.
    """
    try:
        there = Path(path).is_file()
    except ValueError:  # a null byte in it
        there = False
    if not there:
        raise InputError(f"{path}: there is no such file")
    if Path(path).suffix.lower() in EXODUS and find_spec("netCDF4") is None:
        raise InputError(f"{path}: Exodus files need the package netCDF4, which is not installed: pip install netCDF4")
    mesh = meshfile.unpacked(read_apart(Path(meshfile.__file__), path))
    _check_sound(mesh, path)
    return mesh


def _check_sound(mesh: meshio.Mesh, path: str) -> None:
    """See that points are numbers and that cells have corners among them.

    Raises:
        InputError: they are not, or have not.
    """
    if mesh.points.dtype.kind not in "iuf" or mesh.points.ndim != 2:
        raise InputError(f"{path}: has points whose coordinates are no numbers")
    first = 1
    for block in mesh.cells:
        cells, count = block.data, CORNERS.get(base_name(block.type), 0)
        if count:
            if cells.dtype.kind not in "iu" or cells.ndim != 2 or cells.shape[1] < count:
                raise InputError(f"{path}: has {block.type} cells that are none")
            missing = np.flatnonzero(((cells[:, :count] < 0) | (cells[:, :count] >= len(mesh.points))).any(axis=1))
            if len(missing):
                raise InputError(f"{path}: cell {first + missing[0]} has a point that the mesh does not have")
        first += len(cells)
