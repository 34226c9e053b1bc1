"""What is looked at before a result directory is believed: it may come from a stranger, or be damaged."""

from contextlib import contextmanager
from pathlib import Path

from pdpetsc import hdf5_check
from pdpetsc.apart import read_apart
from pdpetsc.errors import InputError
from pdpetsc.io.tables import is_ours


def check_no_links(directory: Path) -> None:
    """See that what is written into a result directory stays in it.

    Raises:
        InputError: one of its files is a link, through which another file would be written.
    """
    for path in sorted(directory.iterdir()) if directory.is_dir() else ():
        if is_ours(path.name) and path.is_symlink():
            raise InputError(f"{path}: is a link, and what is written there would go elsewhere; remove it")


def check_checkpoint(path: Path) -> None:
    """See that a checkpoint, which is there, holds what was written, and nothing that a reader would stumble over or be
    led away by.

    Raises:
        InputError: it does not.
    """
    read_apart(Path(hdf5_check.__file__), path, "checkpoint")


def check_fields(path: Path) -> None:
    """See the same of a field file.

    Raises:
        InputError: it does not, or is not there.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file, and pictures are made of it")
    read_apart(Path(hdf5_check.__file__), path, "fields")


@contextmanager
def believed(directory: Path, *more: type[Exception]):
    """A block that takes case.toml, history.csv and summary.json for what we write: what it trips over is an error of
    theirs.

    Args:
        more: exceptions, beside those of Python, that say so.

    Raises:
        InputError: there is one.
    """
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, *more) as error:
        raise InputError(f"{directory}: case.toml, history.csv or summary.json is damaged ({error})") from None
