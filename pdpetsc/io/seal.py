"""Seals: a first line in a file that tells whether the rest is whole, before anything else reads it."""

import os
import re
import zlib
from pathlib import Path

from pdpetsc.errors import InputError
from pdpetsc.parallel import collective, written

SIZE = 512
"""Bytes in front of a file, which HDF5 passes over (its user block)."""

PIECE = 2**22
"""Bytes that have one check sum; ranks share the pieces."""

_LINE = re.compile(rb"pdpetsc checkpoint (\d+) of (\d+) bytes, sum ([0-9a-f]{8})\n *\n")


def seal(mpi, path: Path, kind: int) -> None:
    """Seal a file whose first bytes are kept free, and see it onto the disk (collective).

    Args:
        mpi: the ranks.
        path: of the file.
        kind: number of its format.

    Raises:
        OutputError: it cannot be written or read.
    """
    sums = {}
    with written(mpi, path):
        sums = _sums(path, mpi.rank, mpi.size)
    whole = _joined(mpi.allgather(sums))
    with written(mpi, path):
        if mpi.rank == 0:
            line = b"pdpetsc checkpoint %d of %d bytes, sum %08x\n" % (kind, path.stat().st_size, whole)
            with path.open("r+b") as file:
                file.write(line.ljust(SIZE - 1) + b"\n")
        _onto_disk(path)


def rename(mpi, path: Path, name: Path) -> None:
    """Give a file that is on the disk another name, for good (collective).

    Raises:
        OutputError: it cannot be done.
    """
    with written(mpi, path):
        if mpi.rank == 0:
            path.replace(name)
            _onto_disk(name.parent)


def read_seal(path: Path, kind: int) -> int:
    """The check sum of a file of this format and of the right size.

    Raises:
        InputError: it cannot be read, is not of this format, or not whole.
    """
    try:
        with path.open("rb") as file:
            line, there = _LINE.fullmatch(file.read(SIZE)), path.stat().st_size
    except FileNotFoundError:
        text = "there is no checkpoint; restart needs the results of a run that solved a load step"
        raise InputError(f"{path}: {text}") from None
    except NotADirectoryError:
        raise InputError(f"{path.parent}: is no directory; restart needs the result directory of a run") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if line is None:
        raise InputError(f"{path}: this is no pdpetsc checkpoint of format {kind}, or it is damaged")
    found, size = int(line[1]), int(line[2])
    if found != kind:
        raise InputError(f"{path}: the checkpoint is of format {found}; this version of pdpetsc reads format {kind}")
    if there != size:
        raise InputError(f"{path}: the checkpoint is damaged ({there} bytes, not {size})")
    return int(line[3], 16)


def check_seal(mpi, path: Path, kind: int) -> None:
    """See that a file is what it was when it was sealed (collective).

    Raises:
        InputError: on all ranks, where it is not.
    """
    expected, sums = 0, {}
    with collective(mpi):
        expected = read_seal(path, kind)
        try:
            sums = _sums(path, mpi.rank, mpi.size)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if _joined(mpi.allgather(sums)) != expected:
        raise InputError(f"{path}: the checkpoint is damaged (its check sum is not that of its contents)")


def _sums(path: Path, first: int, stride: int) -> dict[int, int]:
    """Check sums of every stride-th piece."""
    sums = {}
    with path.open("rb") as file:
        for place in range(SIZE + first * PIECE, path.stat().st_size, stride * PIECE):
            file.seek(place)
            sums[place] = zlib.crc32(file.read(PIECE))
    return sums


def _joined(parts: list[dict[int, int]]) -> int:
    sums = {place: value for part in parts for place, value in part.items()}
    return zlib.crc32(b"".join(sums[place].to_bytes(4, "little") for place in sorted(sums)))


def _onto_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
