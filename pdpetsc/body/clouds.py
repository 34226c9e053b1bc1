"""Points with volumes: tables of text (CSV), HDF5, and what meshio reads, such as VTK."""

import re
import warnings
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np

from pdpetsc import hdf5_check
from pdpetsc.apart import read_apart
from pdpetsc.body.columns import Given, checked_apart, checked_positions, checked_positive
from pdpetsc.body.meshes import read_mesh
from pdpetsc.errors import InputError
from pdpetsc.memory import check_room

AXES = ("X", "Y", "Z")
OPTIONAL = ("horizon", "spacing")
ROW = 128
"""Bytes at least that are held of a point."""

TEXT = "U64"
"""Type of the names in the column `set`."""


def is_hdf5(path: str) -> bool:
    """Whether a file is one of HDF5, by its name."""
    return Path(path).suffix.lower() in (".h5", ".hdf5")


def points_of_file(source) -> Given:
    """The particles of a table or of a file that meshio reads.

    Args:
        source: what is asked of the file (body/given.py).

    Raises:
        InputError: naming the file, and the line or the point that is wrong.
    """
    text = Path(source.path).suffix.lower() in (".csv", ".txt")
    columns = _of_text(source.path) if text else _of_mesh(source.path)
    number = np.arange(len(columns["volume"])) + (2 if text else 1)
    given = _given(source, columns, number)
    checked_apart(given.position, given.spacing, source.path, source.noun, number, "leave one of them out")
    return given


@lru_cache(maxsize=1)
def count_of_hdf5(path: str, stamp: tuple[int, int]) -> int:
    """How many particles there are, of a file that has been read in a process of its own first.

    Args:
        stamp: what changes when the file is written anew.

    Raises:
        InputError: there are none, or it cannot be read, or would not fit into memory.
    """
    if Path(path).is_file():
        read_apart(Path(hdf5_check.__file__), path, "points")
    if rows := len(_opened(path, lambda file: file["volume"])):
        check_room("body.points", "points", rows, ROW)
        return rows
    raise InputError(f"{path}: volume has no rows, so there is no particle")


def points_of_hdf5(source, start: int, stop: int) -> Given:
    """The particles of some rows of the datasets position, volume and, where they are there, horizon, spacing, set.

    Raises:
        InputError: naming the file, and the row that is wrong.
    """

    def read(file):
        columns = {}
        for name in ("volume", *OPTIONAL, "set"):
            if name in file:
                data = file[name]
                text = h5py.check_string_dtype(data.dtype)
                if data.ndim != 1 or not (data.dtype.kind in "biuf" or (text and name == "set")):
                    raise InputError(f"{source.path}: {name} is no column of numbers{' or text' * (name == 'set')}")
                if len(data) != len(file["volume"]):
                    raise InputError(f"{source.path}: {name} has {len(data)} rows, volume {len(file['volume'])}")
                columns[name] = (data.asstr() if text else data)[start:stop]
        position = file["position"][start:stop]
        if len(file["position"]) != len(file["volume"]) or position.ndim != 2 or position.dtype.kind not in "iuf":
            raise InputError(f"{source.path}: position has the shape {file['position'].shape}, not (rows, dimensions)")
        return columns | dict(zip(AXES, position.T)), dict(zip(AXES, file["position"][0]))

    columns, first = _opened(source.path, read)
    return _given(source, columns, np.arange(start + 1, stop + 1), first)


def _opened(path: str, read):
    """What a function reads of an HDF5 file."""
    try:
        with h5py.File(path, "r") as file:
            for name in ("position", "volume"):
                if name not in file or not file[name].shape:
                    raise InputError(f"{path}: has no dataset {name!r}; points need position and volume")
            result = read(file)
            return result[...] if isinstance(result, h5py.Dataset) else result
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, RuntimeError, ValueError, TypeError, LookupError, AttributeError) as error:  # of h5py
        raise InputError(f"{path}: cannot be read as HDF5 ({error})") from None


def _of_text(path: str) -> dict[str, np.ndarray]:
    """Columns by the names in the first line, which may be in any order and case; others are not read."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            header = [name.strip().strip('"') for name in file.readline().split(",")]
            known = {name.lower(): name for name in (*AXES, "volume", *OPTIONAL, "set")}
            columns = {known[name.lower()]: k for k, name in enumerate(header) if name.lower() in known}
            if missing := [name for name in ("X", "volume") if name not in columns]:
                raise InputError(
                    f"{path}: the first line names no column {missing[0]}; it must be like X,Y,Z,volume,set, "
                    f"not {','.join(header)[:80]!r}"
                )
            kinds = [(name, TEXT if name == "set" else float) for name in columns]
            with warnings.catch_warnings(action="ignore"):  # of a table without rows, which is an error below
                table = np.loadtxt(file, kinds, delimiter=",", usecols=list(columns.values()), ndmin=1)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text") from None
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: {_reason(str(error))}") from None
    if not len(table):
        raise InputError(f"{path}: has no rows below its first line")
    return {name: np.char.strip(table[name]) if name == "set" else table[name] for name in columns}


def _reason(text: str) -> str:
    """What numpy says of a table, with the number of the line in the file."""
    if found := re.search(r"could not convert string (.*) to float64 at row (\d+)", text):
        return f"line {int(found[2]) + 2}: {found[1]} is no number"
    if found := re.search(r"at row (\d+)", text):
        return f"line {int(found[1]) + 1} has too few columns"  # here numpy counts from 1
    return f"cannot be read as a table: {' '.join(text.split())[:200]}"


def _of_mesh(path: str) -> dict[str, np.ndarray]:
    """Columns of the points of a mesh and of their data."""
    mesh = read_mesh(path)
    data = {name.lower(): np.asarray(values) for name, values in mesh.point_data.items()}
    if "volume" not in data:
        there = ", ".join(sorted(mesh.point_data)) or "none"
        raise InputError(f"{path}: its points have no data 'volume', only {there}; for its cells take body.mesh")
    if not len(mesh.points):
        raise InputError(f"{path}: is empty")
    columns = {}
    for name in ("volume", *OPTIONAL, "set"):
        if name in data:
            values = data[name]
            wanted = "biufUS" if name == "set" else "biuf"
            if values.shape[:1] != mesh.points.shape[:1] or not values.size or values.dtype.kind not in wanted:
                raise InputError(f"{path}: its data {name!r} are no numbers, one for each point")
            columns[name] = values.reshape(len(mesh.points), -1)[:, 0]
    return columns | dict(zip(AXES, np.asarray(mesh.points, float).T))


def _given(source, columns: dict[str, np.ndarray], number: np.ndarray, first: dict | None = None) -> Given:
    """Columns of rows with these numbers, checked; `first`: coordinates of the first row of the file, where that may be
    another one."""
    path, dim, noun = source.path, source.dim, source.noun
    axes = [columns[name] for name in AXES if name in columns]
    if len(axes) < dim:
        raise InputError(
            f"{path}: has points of {len(axes)} coordinates, not of {dim}; take body.dimension = {len(axes)}"
        )
    checked_positions(np.stack(axes, axis=1).astype(float), path, noun, number)
    for name, flat in zip(AXES[dim:], axes[dim:]):
        apart = np.flatnonzero(flat != (first[name] if first else flat[:1]))
        if len(apart):
            raise InputError(
                f"{path}: {noun} {number[apart[0]]} has another {name} than the others; take body.dimension = "
                f"{len(axes)}"
            )
    scale = source.scale
    volume = columns["volume"].astype(float) * scale**3
    checked_positive(volume, "volume", path, noun, number)
    spacing = (volume / source.thickness) ** (1 / dim)
    if "spacing" in columns:
        spacing = columns["spacing"].astype(float) * scale
        checked_positive(spacing, "spacing", path, noun, number)
    horizon = columns["horizon"].astype(float) * scale if "horizon" in columns else None
    if horizon is not None:
        checked_positive(horizon, "horizon", path, noun, number)
    position = np.stack(axes[:dim], axis=1).astype(float) * scale
    return Given(number, position, volume, spacing, horizon, _members(source, columns, len(volume)))


def _members(source, columns: dict[str, np.ndarray], count: int) -> np.ndarray:
    """(count, sets) mask of the rows whose `set` is that of each."""
    if not source.sets:
        return np.zeros((count, 0), bool)
    if "set" not in columns:
        raise InputError(f"sets.{source.sets[0][0]}.group: {source.path}: has no column 'set'")
    values = np.asarray(columns["set"])
    if values.dtype.kind == "f":
        values = np.where(values == np.rint(values), np.rint(values), -1.0).astype(np.int64)
    values = values.astype(str)
    return np.stack([values == group for _, group in source.sets], axis=1)
