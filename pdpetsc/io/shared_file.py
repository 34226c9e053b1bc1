"""One HDF5 file that all ranks write.

HDF5 itself runs on the first rank alone and writes to memory: the structure of a file, which is small. It reserves the
places of fields, where every rank then writes its rows as into any file. So an error, as of a full disk, is an OSError
that the ranks agree upon and never one inside a collective call of HDF5 that others wait in; and the structure comes to
the disk last, at once: until then the file holds what it held before.
"""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np

from pdpetsc.parallel import written

LARGEST = 2**30
"""Bytes of one call of the system."""


@contextmanager
def open_file(comm, path: Path, mode: str, **kind) -> Iterator["SharedFile"]:
    """A file that is written in the block, as a whole or not at all (collective).

    Args:
        comm: PETSc's communicator.
        path: of the file.
        mode: "w" for a new one, "r+" to change one.
        kind: further arguments of h5py.File.

    Raises:
        OutputError: it cannot be written (on all ranks alike); a file that is changed is what it was.
    """
    shared = SharedFile(comm.tompi4py(), path, mode, kind)
    try:
        yield shared
        shared.settle()
    finally:
        shared.close()


class SharedFile:
    """What `open_file` yields.

    Attributes:
        file: the h5py file, to which the first rank adds what is small; None on the others.
    """

    def __init__(self, mpi, path: Path, mode: str, kind: dict):
        self._mpi, self._path = mpi, path
        self._descriptor: int | None = None
        self._draft: _Draft | None = None
        self._failure: OSError | None = None
        self.file: h5py.File | None = None
        try:
            with written(mpi, path):
                if mpi.rank == 0:
                    self._descriptor = os.open(path, os.O_RDWR | (os.O_CREAT | os.O_TRUNC if mode == "w" else 0), 0o666)
                    self._draft = _Draft(self._descriptor)
                    self.file = h5py.File(self._draft, mode, **kind)
            with written(mpi, path):
                if mpi.rank:
                    self._descriptor = os.open(path, os.O_RDWR)
        except BaseException:
            self.close()
            raise

    def write(self, name: str, count: int, start: int, rows: np.ndarray) -> None:
        """Write a dataset (collective).

        Args:
            name: of it.
            count: of rows on all ranks.
            start, rows: this rank's, and the number of their first one.

        Raises:
            OutputError: on all ranks alike. That of this rank's rows alone comes when the file is settled.
        """
        place, rows = 0, np.ascontiguousarray(rows)
        with written(self._mpi, self._path):
            if self.file is not None:
                place = _reserve(self.file, name, (count, *rows.shape[1:]), rows.dtype)
        place = self._mpi.bcast(place)
        try:
            _write_at(self._descriptor, place + start * rows[:1].nbytes, rows.reshape(-1).view(np.uint8).data)
        except OSError as error:
            self._failure = self._failure or error

    def settle(self) -> None:
        """Put the structure of the file onto the disk, where all rows are (collective)."""
        with written(self._mpi, self._path):
            if self._failure:
                raise self._failure
        with written(self._mpi, self._path):
            if self._draft is not None:
                self.file.close()
                self._draft.settle()
        with written(self._mpi, self._path):
            descriptor, self._descriptor = self._descriptor, None
            os.close(descriptor)

    def close(self) -> None:
        """Leave what has not been settled."""
        if self.file is not None:
            self.file.close()
        with suppress(OSError):
            if self._descriptor is not None and self._draft is not None:
                os.ftruncate(self._descriptor, self._draft.former)
        with suppress(OSError):
            if self._descriptor is not None:
                os.close(self._descriptor)
        self._descriptor = None


class _Draft(io.RawIOBase):
    """The changes of a file, kept in memory.

    Attributes:
        former: size of the file without them [byte].
    """

    def __init__(self, descriptor: int):
        super().__init__()
        self._descriptor = descriptor
        self._changes: list[tuple[int, bytes]] = []
        self._place = 0
        self.former = self._size = os.fstat(descriptor).st_size

    def readable(self) -> bool:
        return True

    writable = seekable = readable

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._place = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._place, io.SEEK_END: self._size}[whence]
        return self._place

    def tell(self) -> int:
        return self._place

    def readinto(self, buffer) -> int:
        view, begin = memoryview(buffer).cast("B"), self._place
        end = self._place = begin + len(view)
        view[:] = os.pread(self._descriptor, len(view), begin).ljust(len(view), b"\0")
        for start, data in self._changes:
            low, high = max(start, begin), min(start + len(data), end)
            if low < high:
                view[low - begin : high - begin] = data[low - start : high - start]
        return len(view)

    def write(self, data) -> int:
        self._changes.append((self._place, bytes(data)))
        self._place += len(data)
        self._size = max(self._size, self._place)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        self._size = self._place if size is None else size
        return self._size

    def settle(self) -> None:
        """Make the changes: those beyond the former end, at which nothing in the file points yet, come first."""
        for start, data in sorted(self._changes, key=lambda change: change[0] < self.former):
            _write_at(self._descriptor, start, data)
        os.ftruncate(self._descriptor, self._size)


def _reserve(file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype) -> int:
    """Make a dataset without values; the place of the first one in the file [byte]."""
    kind = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    kind.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    kind.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    group, _, last = name.rpartition("/")
    parent = file.require_group(group) if group else file
    space, stored = h5py.h5s.create_simple(shape), h5py.h5t.py_create(dtype)
    return h5py.h5d.create(parent.id, last.encode(), stored, space, kind).get_offset()


def _write_at(descriptor: int, place: int, data) -> None:
    data = memoryview(data)
    while data:
        written = os.pwrite(descriptor, data[:LARGEST], place)
        data, place = data[written:], place + written
