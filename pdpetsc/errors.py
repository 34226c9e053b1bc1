"""The ways in which a run can fail for a reason that a person can mend."""

from contextlib import contextmanager


def plain(text: str) -> str:
    """A text of strangers without what a terminal would obey: characters that are not printed become question marks."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


class InputError(Exception):
    """The case, a file or an option is wrong: one sentence with place, cause and remedy (exit code 2).

    May be raised on any subset of ranks inside `parallel.collective`, which makes it an error of all ranks.
    """

    def __init__(self, message: str):
        super().__init__(plain(message))


class NoRoom(InputError):
    """The case asks for more than this machine can hold; raised on some ranks only, as memory differs."""


class ConvergenceError(Exception):
    """Equilibrium was not reached at a load step (exit code 3); raised on all ranks alike."""


class Stop(Exception):
    """An observer ends the run after a committed step; raised on all ranks alike."""


class OutputError(Exception):
    """Results cannot be written: one sentence with file and cause (exit code 1); raised on all ranks alike."""


class Interrupted(Exception):
    """A signal has asked the run to stop (exit code 5); raised on all ranks alike."""


@contextmanager
def at(place: str):
    """Put the place in front of an error."""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{place}: {error}") from None
