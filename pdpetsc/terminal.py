"""Who speaks, and in which colours: nothing here needs MPI."""

import os
from typing import TextIO

LAUNCHERS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK", "SLURM_PROCID", "MPI_LOCALNRANKS")
"""What mpirun and its like leave in the environment of the ranks."""

STYLES = {"red": "\033[31m", "yellow": "\033[33m", "green": "\033[32m"}


def launched() -> bool:
    """Whether this process is one of the ranks of mpirun or the like."""
    return any(name in os.environ for name in LAUNCHERS)


def painted(text: str, colour: str, stream: TextIO) -> str:
    """A text in a colour of `STYLES` where a person sees the stream; https://no-color.org is respected.

    Open MPI gives its first rank a terminal even when the output goes to a file: there are no colours under mpirun.
    """
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or launched() or not stream.isatty()
    return text if plain else f"{STYLES[colour]}{text}\033[0m"
