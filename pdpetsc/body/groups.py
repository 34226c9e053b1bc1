"""Groups of a mesh: sets of cells and of points, physical groups, families of MED, and numbers in its data."""

from typing import NamedTuple

import meshio
import numpy as np

from pdpetsc.errors import InputError

NOT_GROUPS = {"gmsh:bounding_entities"}


class Group(NamedTuple):
    """Attributes:
    cells: of each block of the mesh the numbers of those that belong to it, where there are any.
    points: numbers of those that do.
    """

    cells: dict[int, np.ndarray]
    points: np.ndarray


def group_of(mesh: meshio.Mesh, name: str, place: str) -> Group:
    """A group by its name, or by "DATA=NUMBER": the cells or points whose datum of that name has that value.

    Cells come first: points count where no cells have the name.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    parts, points = _cells_of(mesh, name, place), _points_of(mesh, name, place)
    if parts is None and points is None:
        names = sorted({*mesh.cell_sets, *mesh.field_data, *mesh.point_sets, *_families(mesh)} - NOT_GROUPS)
        data = sorted({*mesh.cell_data, *mesh.point_data})
        more = f"; or NAME=NUMBER of the data {', '.join(data)}" if data else ""
        raise InputError(f"{place}: has no group {name!r}; choices: {', '.join(names) or 'none'}{more}")
    cells = {k: part for k, part in enumerate(parts or ()) if len(part)}
    return Group(cells, np.empty(0, np.int64) if cells or points is None else points)


def _cells_of(mesh: meshio.Mesh, name: str, place: str) -> list[np.ndarray] | None:
    """Numbers of the cells of each block in a group; None: there is no such group."""
    sizes = [len(block.data) for block in mesh.cells]
    if name in mesh.cell_sets and name not in NOT_GROUPS:
        return _of_set(mesh.cell_sets[name], sizes, name, place)
    if name in mesh.field_data and "gmsh:physical" in mesh.cell_data:
        pair = np.ravel(mesh.field_data[name])
        if len(pair) != 2 or pair.dtype.kind not in "iuf":
            raise InputError(f"{place}: the physical group {name!r} has no number and dimension")
        tagged = _of_data(mesh.cell_data["gmsh:physical"], pair[:1], sizes, name, place)
        some = [block.dim == pair[1] for block in mesh.cells]  # groups of each dimension have numbers of their own
        return [part if of_dim else part[:0] for part, of_dim in zip(tagged, some)]
    families = [number for number, names in getattr(mesh, "cell_tags", {}).items() if name in names]
    if families and "cell_tags" in mesh.cell_data:
        return _of_data(mesh.cell_data["cell_tags"], families, sizes, name, place)
    key, value = _datum(name)
    if key in mesh.cell_data:
        return _of_data(mesh.cell_data[key], [value], sizes, name, place)
    return None


def _points_of(mesh: meshio.Mesh, name: str, place: str) -> np.ndarray | None:
    """Numbers of the points in a group; None: there is no such group."""
    if name in mesh.point_sets:
        return _of_set([mesh.point_sets[name]], [len(mesh.points)], name, place)[0]
    families = [number for number, names in getattr(mesh, "point_tags", {}).items() if name in names]
    if families and "point_tags" in mesh.point_data:
        return _of_data([mesh.point_data["point_tags"]], families, [len(mesh.points)], name, place)[0]
    key, value = _datum(name)
    if key in mesh.point_data and np.ndim(mesh.point_data[key]) == 1:
        return _of_data([mesh.point_data[key]], [value], [len(mesh.points)], name, place)[0]
    return None


def _datum(name: str) -> tuple[str, float]:
    """The two sides of NAME=NUMBER; no name where it is something else."""
    key, equals, text = name.rpartition("=")
    try:
        return (key, float(text)) if equals else ("", 0.0)
    except ValueError:
        return "", 0.0


def _families(mesh: meshio.Mesh) -> set[str]:
    tables = (getattr(mesh, key, {}) for key in ("cell_tags", "point_tags"))
    return {name for table in tables for names in table.values() for name in names}


def _of_set(parts, sizes: list[int], name: str, place: str) -> list[np.ndarray]:
    """The parts of a set, each of so many things."""
    try:
        some = [np.array([] if part is None else part, np.int64) for part in parts]
    except (TypeError, ValueError):
        some = []
    if len(some) != len(sizes) or not all(
        part.ndim == 1 and (not part.size or 0 <= part.min() <= part.max() < size) for part, size in zip(some, sizes)
    ):
        raise InputError(f"{place}: the set {name!r} cannot be read; list the numbers of its cells in it")
    return some


def _of_data(parts, values, sizes: list[int], name: str, place: str) -> list[np.ndarray]:
    """Numbers of the things, so many in each part, whose datum is one of some values.

    Raises:
        InputError: there is not one for each.
    """
    if [np.size(part) for part in parts] != sizes:
        raise InputError(f"{place}: the data behind {name!r} cannot be read; there must be one for each cell or point")
    return [np.flatnonzero(np.isin(part, values)) for part in parts]
