"""What signals ask of a run: a checkpoint (SIGUSR1), or an end with one (SIGTERM, SIGINT, SIGUSR2)."""

import os
import signal
import threading
import time as clock
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI

SILENCE = signal.SIGPIPE
"""Stands for an output that nobody reads any more."""
STOP = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR2)
SAVE = signal.SIGUSR1

PATIENCE = 1.0
"""Seconds after the first signal to stop from which another one ends the process at once. Batch systems send it to all
processes, and mpirun passes it on once more."""

PACE, MOST = 0.1, 64
"""Seconds between looks of quick steps at what is asked, about, and the most steps between them."""

_asked: dict[int, float] = {}  # signals, and when they came


@contextmanager
def listening() -> Iterator[None]:
    """Have signals ask the run, instead of ending it, as long as the block lasts.

    Python has signals in its main thread only; elsewhere nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _asked.clear()
    before = {number: signal.signal(number, _note) for number in (*STOP, SAVE)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: one of another language


def ask(number: int) -> None:
    """Ask as a signal does."""
    _asked.setdefault(number, clock.monotonic())


def _note(number: int, frame) -> None:
    earlier = [_asked[other] for other in STOP if other in _asked]
    if number in STOP and earlier and clock.monotonic() > min(earlier) + PATIENCE:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    if number == signal.SIGINT and not earlier:
        os.write(2, b" pdpetsc: stops after this step with a checkpoint; once more stops at once\n")
    ask(number)


class Requests:
    """What is asked of a run by signals that any rank has got, and by the clock; the same on all ranks.

    Args:
        mpi: the ranks.
        minutes: between checkpoints; None: the clock asks for none.
        quick: whether steps may be so quick that an agreement in each would be felt.

    Attributes:
        stop: the signal that asks for the end, or 0.
        save: whether a checkpoint is asked for.
    """

    def __init__(self, mpi: MPI.Comm, minutes: float | None, quick: bool):
        self._mpi, self._minutes, self._quick = mpi, minutes, quick
        self._steps = self._left = 1  # between looks, and until the next one
        self._looked = self._saved = clock.monotonic()
        self.stop, self.save = 0, False

    def look(self) -> None:
        """Agree on what is asked (collective: in the same places on all ranks)."""
        self._left -= 1
        if self._left:
            return
        now = clock.monotonic()
        stop = max((number for number in (*STOP, SILENCE) if number in _asked), default=0)
        save = _asked.pop(SAVE, None) is not None
        mine = np.array([stop, save, now - self._saved, now - self._looked])
        if self._mpi.rank:
            mine[2:] = 0.0  # the first rank's clock is that of all
        agreed = np.empty_like(mine)
        self._mpi.Allreduce(mine, agreed, MPI.MAX)
        self.stop = int(agreed[0])
        self.save |= agreed[1] > 0 or self._minutes is not None and agreed[2] >= 60 * self._minutes
        if self._quick:
            self._steps = max(1, min(MOST, 8 * self._steps, int(self._steps * PACE / max(agreed[3], 1e-9))))
        self._left, self._looked = self._steps, now

    def saved(self) -> None:
        """A checkpoint was written, or could not be."""
        self.save, self._saved = False, clock.monotonic()
