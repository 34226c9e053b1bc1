"""Files that may come from strangers are read in a process of its own first, with limits of time and memory: libraries
crash on damaged ones, never end, or take all memory that there is."""

import os
import subprocess
import sys
from pathlib import Path

from pdpetsc.errors import InputError

SECONDS, RATE = 30.0, 5e4
"""Seconds that any file may take, and bytes for each further one."""

MEMORY, FACTOR = 2**31, 100
"""Bytes that the process may take, and more for each byte of the file."""

OF_MPI = ("OMPI_", "PMIX", "PMI_", "PRTE", "HYDRA")
"""How the environment begins of a process that MPI has started; the new one is none."""


def read_apart(script: Path, path: Path | str, *arguments: str) -> bytes:
    """What a script writes that reads a file.

    The script is run alone, without this package or the working directory among its modules. It gets the limits, the
    path and the arguments, says what is wrong in one sentence on its output with exit code 2, and sets its limits
    itself.

    Raises:
        InputError: something in the file is wrong, or the process did not come to its end.
    """
    try:
        size = os.stat(path).st_size
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    seconds, memory = SECONDS + size / RATE, MEMORY + FACTOR * size
    environment = {name: value for name, value in os.environ.items() if not name.startswith(OF_MPI)}
    command = [sys.executable, "-P", str(script), str(int(seconds)), str(int(memory)), os.path.abspath(path)]
    try:
        done = subprocess.run(
            [*command, *arguments], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            timeout=4 * seconds, env=environment | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: is damaged: reading it does not come to an end") from None
    if done.returncode == 2:
        raise InputError(f"{path}: {done.stdout.decode(errors='replace')}")
    if done.returncode:
        raise InputError(f"{path}: is damaged: reading it takes all memory or time, or ends in a crash of the library")
    return done.stdout
