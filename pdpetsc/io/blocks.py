"""Particle fields in HDF5 files, in the order of the ids, so that files do not depend on the number of ranks."""

import h5py
import numpy as np

from pdpetsc.exchange import Directory
from pdpetsc.io.shared_file import SharedFile


def write_field(file: SharedFile, name: str, directory: Directory, count: int, owned: np.ndarray) -> None:
    """Write an owned field as dataset `name` with `count` rows (collective).

    Raises:
        OutputError: as of `SharedFile.write`.
    """
    file.write(name, count, directory.start, directory.to_blocks(owned))


def read_field(path, name: str, directory: Directory) -> np.ndarray:
    """Read an owned field; every rank reads its own block."""
    with h5py.File(path, "r") as file:
        block = file[name][directory.start : directory.stop]
    return directory.from_blocks(block)
