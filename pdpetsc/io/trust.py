"""What is looked at before a result directory is believed: it may come from a stranger, or be damaged."""

from pathlib import Path

from pdpetsc.apart import read_apart
from pdpetsc.errors import InputError
from pdpetsc.io import hdf5_check
from pdpetsc.io.checkpoint import CHECKPOINT
from pdpetsc.io.fields import HDF5
from pdpetsc.io.tables import FILES


def check_no_links(directory: Path) -> None:
    """See that what is written into a result directory stays in it.

    Raises:
        InputError: one of its files is a link, through which another file would be written.
    """
    for name in sorted(FILES):
        if (directory / name).is_symlink():
            raise InputError(f"{directory / name}: is a link, and what is written there would go elsewhere; remove it")


def check_checkpoint(directory: Path) -> None:
    """See that a checkpoint holds what was written, and nothing that a reader would stumble over or be led away by.

    Raises:
        InputError: it does not.
    """
    if (directory / CHECKPOINT).is_file():  # reading it says what else is wrong
        read_apart(Path(hdf5_check.__file__), directory / CHECKPOINT, "checkpoint")


def check_fields(directory: Path, whole: bool) -> None:
    """See the same of a field file, if there is one.

    Args:
        whole: whether all of its steps are looked at, or its bodies only: a run that was ended while it wrote a step
            goes on without that step.

    Raises:
        InputError: it does not.
    """
    if (directory / HDF5).is_file():
        read_apart(Path(hdf5_check.__file__), directory / HDF5, "fields" if whole else "bodies")
    elif whole:
        raise InputError(f"{directory / HDF5}: there is no such file, and pictures are made of it")
