"""What happens, for machines: with `--json-lines` one JSON object a line on standard output, and nothing else there.

docs/command-line.md has the schema of the events.
"""

import json
import math
import os
import sys
from contextlib import contextmanager
from typing import Any

wanted = False
"""Whether this run tells machines what happens, and people nothing but errors."""


@contextmanager
def heard():
    """Where nobody reads our output any more, as in `pdpetsc | head`, be silent and ask the run to stop."""
    try:
        yield
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
        from pdpetsc import signals  # which needs MPI

        signals.ask(signals.SILENCE)


def tell(comm, event: str, **values) -> None:
    """Write an event on the first rank, where events are wanted; numbers that are not finite become null."""
    if wanted and comm.rank == 0:
        with heard():
            print(json.dumps(_plain({"event": event} | values), allow_nan=False), flush=True)


def _plain(value: Any) -> Any:
    """As JSON has it."""
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    if hasattr(value, "tolist"):  # of numpy
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float)) else str(value)
