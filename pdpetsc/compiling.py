"""Says when kernels are compiled: half a minute without a word looks like a hang."""

from collections.abc import Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener

from pdpetsc.parallel import say


class _Announcer(Listener):
    """Says it once."""

    def __init__(self, comm):
        self._comm, self._said = comm, False

    def on_start(self, event: Event) -> None:
        if not self._said:
            say(self._comm, "compiling kernels, once for this version and kind of model: up to two minutes")
        self._said = True

    def on_end(self, event: Event) -> None:
        pass


@contextmanager
def compiling_announced(comm, quiet: bool) -> Iterator[None]:
    """A block in which the first rank says so when a kernel that no earlier run has left is compiled."""
    if quiet:
        yield
        return
    with install_listener("numba:compile", _Announcer(comm)):
        yield
