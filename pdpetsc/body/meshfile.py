"""Reads a mesh with meshio, as a script of its own (pdpetsc/apart.py): SECONDS BYTES PATH.

What comes out are plain arrays and names, never Python's pickles.
"""

import io
import json
import resource
import sys
from contextlib import redirect_stderr, redirect_stdout

import meshio
import numpy as np

LONGEST = 200
"""Characters of a reason."""

FAMILIES = ("cell_tags", "point_tags")
"""What meshio's reader of MED adds to a mesh."""


def packed(path: str) -> bytes:
    """A mesh as an archive of numpy's, with an index of what each array is.

    Raises:
        ValueError: it cannot be read.
    """
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            mesh = meshio.read(path)
        return _pack(mesh)
    except MemoryError:
        raise ValueError("is damaged: reading it takes all memory") from None
    except (Exception, SystemExit) as error:  # its readers raise whatever comes up in a damaged file
        reason = " ".join(str(error).split()) if not isinstance(error, SystemExit) else ""
        raise ValueError("is not a mesh that can be read" + (f": {reason[:LONGEST]}" if reason else "")) from None


def _pack(mesh: meshio.Mesh) -> bytes:
    arrays: list[np.ndarray] = []

    def keep(values) -> int | None:
        """The number of an array; None for what is no table of numbers or text."""
        try:
            array = np.asarray([] if values is None else values)
        except ValueError:  # rows of different lengths
            return None
        if array.dtype.kind not in "biufUS":
            return None
        arrays.append(array)
        return len(arrays) - 1

    index = {
        "points": keep(mesh.points),
        "cells": [(block.type, keep(block.data)) for block in mesh.cells],
        "cell_sets": {name: [keep(part) for part in parts] for name, parts in mesh.cell_sets.items()},
        "cell_data": {name: [keep(part) for part in parts] for name, parts in mesh.cell_data.items()},
        "point_data": {name: keep(values) for name, values in mesh.point_data.items()},
        "point_sets": {name: keep(values) for name, values in mesh.point_sets.items()},
        "field_data": {name: keep(values) for name, values in mesh.field_data.items()},
        "tags": {key: _plain_families(getattr(mesh, key, {})) for key in FAMILIES},
    }
    out = io.BytesIO()
    np.savez(out, np.frombuffer(json.dumps(index).encode(), np.uint8), *arrays)
    return out.getvalue()


def _plain_families(families) -> list:
    """Numbers of families of MED, and the names of the groups that each is in."""
    return [(int(number), [str(name) for name in names]) for number, names in dict(families).items()]


def unpacked(archive: bytes) -> meshio.Mesh:
    """The mesh of `packed`; data that were no tables of numbers or text are left out, and points, cells and sets that
    were none are empty tables of no columns."""
    with np.load(io.BytesIO(archive), allow_pickle=False) as file:
        arrays = [file[name] for name in file.files]
    index = json.loads(arrays.pop(0).tobytes())

    def table(number: int | None) -> np.ndarray:
        return np.empty((0, 0), np.int64) if number is None else arrays[number]

    def of(tables: dict) -> dict:
        return {name: arrays[number] for name, number in tables.items() if number is not None}

    mesh = meshio.Mesh(table(index["points"]), [])
    mesh.cells = [meshio.CellBlock(kind, table(number)) for kind, number in index["cells"]]
    mesh.point_sets = {name: table(number) for name, number in index["point_sets"].items()}
    mesh.cell_sets = {name: [table(number) for number in numbers] for name, numbers in index["cell_sets"].items()}
    mesh.point_data, mesh.field_data = of(index["point_data"]), of(index["field_data"])
    whole = {name: numbers for name, numbers in index["cell_data"].items() if None not in numbers}
    mesh.cell_data = {name: [arrays[number] for number in numbers] for name, numbers in whole.items()}
    for key, families in index["tags"].items():
        setattr(mesh, key, dict(families))
    return mesh


if __name__ == "__main__":
    seconds, memory, path = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    try:
        sys.stdout.buffer.write(packed(path))
    except ValueError as error:
        sys.stdout.buffer.write(str(error).encode(errors="replace"))
        sys.stdout.flush()
        sys.exit(2)
