"""Looks into an HDF5 file, as a script of its own (pdpetsc/apart.py): SECONDS BYTES PATH KIND.

Of ours, what is read later is what was written by io's `checkpoint` and `fields`: plain datasets, stored in one piece
in the file itself, whose sizes go with each other. So a file cannot make a reader take more memory than it is large,
nor read other files. Points of a body may be compressed: they are all read here first, where a damaged file ends
nothing else.
"""

import json
import os
import resource
import sys

import h5py
import numpy as np

ROWS = 1 << 16
"""That are looked at together."""

STATE = {"u": "f", "increment": "f", "v": "f"}
REFINED = {"volume": "f", "spacing": "f", "horizon": "f", "parent": "iu", "ancestor": "iu"}
FACETS = {"parent": "iu", "face": "iu", "position": "f", "area": "f"}
DAMAGED = ("broken_bonds", "softened_bonds")
BODY = {"position": 3, "volume": None, "horizon": None, "spacing": None}
"""Of a field file, with their columns."""
COLUMNS = (None, 3, 9)
"""That a field may have."""
PACKED = 2000
"""How many times smaller than its numbers a compressed dataset may be; HDF5's gzip makes it at most 1032 times."""
CELLS = {2: (3, 4), 3: (4, 5, 6, 8)}
"""How many corners the cells of a mesh may have in so many dimensions."""


class Damaged(ValueError):
    """What is wrong, in a sentence."""


def entry(group: h5py.Group, name: str, kind: type):
    """What a group holds itself: a dataset or a group, not a link to another file or place."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise Damaged(f"{name} is not in the file but a link to somewhere else" if name in group else f"no {name}")
    found = group[name]
    if not isinstance(found, kind):
        raise Damaged(f"{name} is no {kind.__name__.lower()}")
    return found


def dataset(group: h5py.Group, name: str, kinds: str) -> h5py.Dataset:
    """A dataset of numbers, in one piece in the file itself."""
    data = entry(group, name, h5py.Dataset)
    layout = data.id.get_create_plist().get_layout()
    if data.is_virtual or data.external or layout not in (h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT):
        raise Damaged(f"{name} is not stored in one piece in the file itself")
    if data.shape is None or data.dtype.kind not in kinds or data.dtype.subdtype or data.dtype.names:
        raise Damaged(f"{name} holds no numbers of the kind that it must")
    end = (data.id.get_offset() or 0) + data.id.get_storage_size()
    if end > os.path.getsize(group.file.filename) or data.id.get_storage_size() != data.size * data.dtype.itemsize:
        raise Damaged(f"{name} is not as large as it says")
    return data


def shaped(group: h5py.Group, name: str, kinds: str, *shape: int | None) -> h5py.Dataset:
    """A dataset of a shape; None: of any length."""
    data = dataset(group, name, kinds)
    if data.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, data.shape)):
        raise Damaged(f"{name} has the shape {data.shape}")
    return data


def check_values(data: h5py.Dataset, low: float = -np.inf, high: float = np.inf, columns: slice = slice(None)) -> None:
    """Every number is finite and within limits, both included."""
    for first in range(0, len(data), ROWS):
        part = data[first : first + ROWS]
        if not np.isfinite(part).all():
            raise Damaged(f"{data.name[1:]} holds values that are not finite")
        part = part[:, columns] if part.ndim > 1 else part
        if part.size and not (low <= part.min() and part.max() <= high):
            raise Damaged(f"{data.name[1:]} holds values that cannot be")


def check_checkpoint(file: h5py.File) -> None:
    """See that a checkpoint (checkpoint.py) is one.

    Raises:
        Damaged: it is not.
    """
    check_values(shaped(file, "description", "u", None), 0, 255)
    text = file.attrs["state"]
    if not isinstance(text, str):
        raise Damaged("the state is no text")
    step = json.loads(text)["step"]
    position = shaped(file, "position", "f", None, None)
    count, dim = position.shape
    if not count or not 1 <= dim <= 3:
        raise Damaged(f"position has the shape {position.shape}")
    for name in STATE:
        if name == "u" or name in file:
            check_values(shaped(file, name, "f", count, dim))
    check_values(position)
    if "ancestor" in file:
        for name, kinds in REFINED.items():
            low = np.finfo(float).tiny if kinds == "f" else 0
            check_values(shaped(file, name, kinds, count), low)
        check_facets(entry(file, "facets", h5py.Group), count, dim)
    if "damaged" in file:
        damaged = entry(file, "damaged", h5py.Group)
        for name in damaged:
            if name not in DAMAGED:
                raise Damaged(f"damaged/{name} is unknown")
            bonds = shaped(damaged, name, "fiu", None, 3)
            check_values(bonds, 0, count - 1, slice(0, 2))
            check_values(bonds, 0, step if name == "broken_bonds" else np.inf, slice(2, 3))


def check_facets(group: h5py.Group, count: int, dim: int) -> None:
    """See that facets of a refined body belong to its particles."""
    facets = len(shaped(group, "parent", "iu", None))
    check_values(shaped(group, "parent", "iu", facets), 0, count - 1)
    check_values(shaped(group, "face", "iu", facets), 0, 6)
    for name in ("position", "area"):
        check_values(shaped(group, name, "f", facets, dim))


def check_bodies(file: h5py.File) -> tuple[dict[int, int], list[str]]:
    """See that a field file (fields.py) holds bodies and steps; how many particles the bodies have by their first
    step, and the names of all steps.

    Raises:
        Damaged: it does not.
    """
    counts = {0: check_body(file)}
    if "refined" in file:
        refined = entry(file, "refined", h5py.Group)
        for name in refined:
            counts[number(name)] = check_body(entry(refined, name, h5py.Group))
    if "mesh" in file:
        check_mesh(entry(file, "mesh", h5py.Group), counts[0])
    steps = [name for name in file if name not in (*BODY, "vertex", "refined", "mesh")]
    for name in steps:
        number(name)
        entry(file, name, h5py.Group)
    return counts, steps


def check_fields(file: h5py.File) -> None:
    """See that a field file holds the fields of steps, each on its body.

    Raises:
        Damaged: it does not.
    """
    counts, steps = check_bodies(file)
    for name in steps:
        count = counts[max(first for first in counts if first <= number(name))]
        group = entry(file, name, h5py.Group)
        entry(group, "u", h5py.Dataset)
        for field in group:
            data = dataset(group, field, "fiu")
            columns = data.shape[1] if data.ndim == 2 else None
            wrong = columns not in COLUMNS or (field == "u" and columns != 3)
            if data.ndim not in (1, 2) or len(data) != count or wrong:
                raise Damaged(f"{name}/{field} has the shape {data.shape}")


def check_mesh(group: h5py.Group, count: int) -> None:
    """See that the cells of a mesh have corners among its points, and particles of the body."""
    points = shaped(group, "points", "f", None, None)
    check_values(points)
    cells, on = shaped(group, "cells", "i", None, None), group.attrs["on"]
    known = CELLS.get(points.shape[1], ())
    if not known or cells.shape[1] > max(known) or on not in ("cells", "points"):
        raise Damaged(f"mesh/points has the shape {points.shape}, mesh/cells {cells.shape}, of {on}")
    check_values(cells, -1, len(points) - 1)
    for first in range(0, len(cells), ROWS):
        there = cells[first : first + ROWS] >= 0
        corners = there.sum(axis=1)
        if not np.isin(corners, known).all() or (there != (np.arange(there.shape[1]) < corners[:, None])).any():
            raise Damaged("mesh/cells holds cells that are none")
    particle = shaped(group, "particle", "i", len(cells if on == "cells" else points))
    check_values(particle, -1, count - 1)
    known = particle[...]
    known = known[known >= 0]
    if not len(cells) or len(np.unique(known)) != count or len(known) != count:
        raise Damaged("mesh/particle does not hold each particle once")
    check_values(shaped(group, "cracked", "i", count), 0, 1)


def check_body(group: h5py.Group) -> int:
    """How many particles a body has."""
    count = len(dataset(group, "position", "f"))
    if not count:
        raise Damaged("it holds no particle")
    for name, columns in BODY.items():
        shape = (count,) if columns is None else (count, columns)
        positive = np.finfo(float).tiny if columns is None else -np.inf
        check_values(shaped(group, name, "f", *shape), positive)
    return count


def check_points(file: h5py.File) -> None:
    """See that what a body of points may be read from (body/clouds.py) is in the file, and can be read.

    Raises:
        Damaged: it is not.
    """
    for name in ("position", "volume", "horizon", "spacing", "set"):
        if name not in file:
            continue
        data = entry(file, name, h5py.Dataset)
        if data.is_virtual or data.external:
            raise Damaged(f"{name} is not stored in the file itself")
        if data.shape is None or data.id.get_storage_size() * PACKED < data.size * data.dtype.itemsize:
            raise Damaged(f"{name} is not as large as it says, or packed more than {PACKED} times; write it anew")
        step = -(-ROWS // data.chunks[0]) * data.chunks[0] if data.chunks else ROWS  # every chunk is unpacked once
        for first in range(0, len(data) if data.ndim else 0, step):
            data[first : first + step]


def number(name: str) -> int:
    """Of the step that a group is called by."""
    if not (name.isascii() and name.isdigit() and len(name) < 12):
        raise Damaged(f"{name!r} is no step")
    return int(name)


CHECKS = {
    "checkpoint": (check_checkpoint, "is no checkpoint of this version of pdpetsc, or damaged"),
    "fields": (check_fields, "is no field file of this version of pdpetsc, or damaged"),
    "points": (check_points, "cannot be read as HDF5 of points"),
}
"""By the kind of a file that is asked for, and what it is where that fails."""


def check(path: str, kind: str) -> None:
    """See that a file is what it is said to be.

    Raises:
        Damaged: in a sentence, what is wrong.
    """
    look, otherwise = CHECKS[kind]
    try:
        with h5py.File(path, "r") as file:
            look(file)
    except Damaged as error:
        raise Damaged(f"{otherwise}: {error}") from None
    except (Exception, RecursionError) as error:  # h5py raises whatever comes up in a damaged file
        raise Damaged(f"is damaged ({' '.join(str(error).split())[:200]})") from None


if __name__ == "__main__":
    seconds, memory, path, kind = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    try:
        check(path, kind)
    except Damaged as error:
        sys.stdout.buffer.write(str(error).encode(errors="replace"))
        sys.stdout.flush()
        sys.exit(2)
