"""Particle fields in HDF5 files, in the order of the ids, so that files do not depend on the number of ranks."""

from contextlib import contextmanager

import h5py
import numpy as np

from pdpetsc.exchange import Directory


@contextmanager
def open_file(comm, path, mode: str):
    """An HDF5 file that all ranks write: through MPI-IO where this h5py has it, else through the first rank.

    Yields the h5py file; None on ranks that do not touch it.
    """
    if h5py.get_config().mpi and comm.size > 1:
        with h5py.File(path, mode, driver="mpio", comm=comm.tompi4py()) as file:
            yield file
    elif comm.rank == 0:
        with h5py.File(path, mode) as file:
            yield file
    else:
        yield None
    comm.tompi4py().Barrier()


def write_field(comm, file, name: str, directory: Directory, count: int, owned: np.ndarray) -> None:
    """Write an owned field as dataset `name` with `count` rows (collective)."""
    block = directory.to_blocks(owned)
    shape = (count, *block.shape[1:])
    if file is not None and file.driver == "mpio":
        dataset = file.create_dataset(name, shape, block.dtype)
        dataset[directory.start : directory.stop] = block
        return
    mpi = comm.tompi4py()
    if comm.rank:
        mpi.send((directory.start, block), dest=0)
        return
    dataset = file.create_dataset(name, shape, block.dtype)
    dataset[directory.start : directory.stop] = block
    for rank in range(1, comm.size):  # one block at a time: the first rank never holds the whole field
        start, part = mpi.recv(source=rank)
        dataset[start : start + len(part)] = part


def read_field(path, name: str, directory: Directory) -> np.ndarray:
    """Read an owned field; every rank reads its own block."""
    with h5py.File(path, "r") as file:
        block = file[name][directory.start : directory.stop]
    return directory.from_blocks(block)
