"""What every rank must do together: fail, speak once, and agree."""

import sys
import traceback
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

from pdpetsc import events, terminal
from pdpetsc.errors import InputError, OutputError


def abort_on_exception() -> None:
    """End all ranks when one of them meets an exception that nobody handles; the others would wait for ever."""

    def abort(kind, error, trace):
        if issubclass(kind, KeyboardInterrupt):
            print("pdpetsc: error: stopped by SIGINT", file=sys.stderr, flush=True)
        else:
            sys.stdout.flush()
            traceback.print_exception(kind, error, trace)
            sys.stderr.flush()
        MPI.COMM_WORLD.Abort(130 if issubclass(kind, KeyboardInterrupt) else 1)

    sys.excepthook = abort


@contextmanager
def collective(comm):
    """Turn an InputError raised on any rank inside the block into one InputError on all ranks.

    The block itself must be free of collective calls: a rank that failed does not reach them. When several
    ranks fail, all raise the message of the lowest one.
    """
    message = None
    try:
        yield
    except InputError as error:
        message = str(error)
    _raise_first(comm, message, InputError)


@contextmanager
def written(comm, path: Path):
    """Turn an OSError on any rank inside the block, which writes a file, into one OutputError on all ranks.

    As in `collective`, the block itself must be free of collective calls.
    """
    message = None
    try:
        yield
    except OSError as error:
        message = f"{path}: cannot be written ({error.strerror or error})"
    _raise_first(comm, message, OutputError)


def _raise_first(comm, message: str | None, kind: type[Exception]) -> None:
    first = next((m for m in comm.allgather(message) if m is not None), None)
    if first is not None:
        raise kind(first)


def say(comm, *text) -> None:
    """Print on the first rank, where people and not machines are told."""
    if comm.rank == 0 and not events.wanted:
        with events.heard():
            print(*text, flush=True)


def warn(comm, text: str) -> None:
    """Print a warning on the first rank, on the error stream; to machines it is an event."""
    events.tell(comm, "warning", text=text)
    if comm.rank == 0 and not events.wanted:
        print(terminal.painted(f"pdpetsc: warning: {text}", "yellow", sys.stderr), file=sys.stderr, flush=True)
