"""Runs that lose a rank by kill -9, and what can be made of what is left."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from conftest import environment_for_mpirun, mpirun

BODY = """
title = "A notched plate is pulled"
body = { size = [12.0, 8.0], spacing = 1.0, horizon = 2.015, cracks = [{ from = [0.0, 4.0], to = [4.0, 4.0] }] }
sets = { bottom = "Y < 1", top = "Y > 7" }
material.glass = { model = "bond", E = 1.0, density = 1.0 }
output = { every = 1, checkpoint = 1 }
probe = [{ name = "pull", field = "reaction", component = "y", set = "top", reduce = "sum" }]
load = [
  { kind = "displacement", set = "bottom", component = "all", value = 0.0 },
  { kind = "displacement", set = "top", component = "all", value = "0.2 * t / end" },
]
[damage.glass]
criterion = "critical_stretch"
critical = 0.03
"""
EXPLICIT = BODY.replace("checkpoint = 1", "checkpoint = 1, history = 1").replace("t / end", "t / 20")
CASES = {
    "load steps": BODY.replace("t / end", "t") + "[solver]\nsteps = 40\n",
    "motion": EXPLICIT + '[solver]\nmode = "verlet"\nend_time = 20.0\nsteps = 80\n',
}
"""Of some seconds, which write everything in every step."""


@dataclass(frozen=True)
class Outcome:
    """What came of a run that was killed, went on from its checkpoint, was killed again, and so on.

    Attributes:
        codes: of mpirun, for each kill; the chain ends with a run that was quicker.
        seconds: until mpirun and all ranks were gone, likewise.
        steps: of the checkpoints, likewise.
        restarted: exit code of the last restart, which was let alone.
        difference: largest relative one of displacements and history to the run that was let alone; 0: not a bit.
    """

    codes: list[int]
    seconds: list[float]
    steps: list[int]
    restarted: int
    difference: float


def start(ranks: int, directory: Path, *arguments) -> subprocess.Popen:
    """`mpirun -n ranks python -m pdpetsc ...` in a directory."""
    command = [mpirun(), "-n", str(ranks), sys.executable, "-m", "pdpetsc", *map(str, arguments)]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, cwd=directory, env=environment_for_mpirun(), **quiet)


def whole(directory: Path, case: str, ranks: int) -> float:
    """Let a run come to its end, for comparison; the seconds from its first step on."""
    (directory / "case.toml").write_text(CASES[case])
    job = start(ranks, directory, "case.toml", "--out", "whole")
    _wait_for_checkpoint(job, directory / "whole", 0)
    began = time.monotonic()
    assert job.wait(300) == 0
    return time.monotonic() - began


def killed(directory: Path, ranks: int, others: int, span: float, seed: int, times: int = 1) -> Outcome:
    """Kill one rank of a run at a random moment, and go on from its checkpoint.

    Args:
        directory: where `whole` has been.
        ranks, others: of the run and of the last restart.
        span: seconds that the run takes after its first step; the kill comes within its share of them.
        seed: of the moments and the ranks.
        times: how often; in between, the run is restarted.
    """
    chance, out = random.Random(seed), directory / f"killed-{seed}"
    codes, seconds, steps = [], [], []
    for number in range(times):
        arguments = ("restart", out.name) if number else ("case.toml", "--out", out.name)
        before = _written_at(out)
        job = start(ranks, directory, *arguments)
        _wait_for_checkpoint(job, out, before)
        time.sleep(chance.uniform(0, 0.9 * span / times))
        if job.poll() is not None:  # it was quicker
            break
        children = Path(f"/proc/{job.pid}/task/{job.pid}/children").read_text().split()
        for child in chance.sample(children, min(1, len(children))):
            os.kill(int(child), signal.SIGKILL)
        began = time.monotonic()
        codes.append(job.wait(120))
        while any(_lives(child) for child in children):
            time.sleep(0.01)
        seconds.append(round(time.monotonic() - began, 2))
        with h5py.File(out / "checkpoint.h5", "r") as file:
            steps.append(json.loads(file.attrs["state"])["step"])
    restarted = start(others, directory, "restart", out.name).wait(300)
    return Outcome(codes, seconds, steps, restarted, difference(directory / "whole", out))


def difference(one: Path, other: Path) -> float:
    """The largest relative difference of all displacements and of the history, but for the times it took."""
    worst = 0.0
    with h5py.File(one / "fields.h5") as a, h5py.File(other / "fields.h5") as b:
        steps = [name for name in a if name.isdigit()]
        if set(steps) - set(b):
            return np.inf
        for name in steps:
            u, v = a[name]["u"][...], b[name]["u"][...]
            worst = max(worst, np.abs(u - v).max() / np.abs(u).max())
    rows, others = _history(one), _history(other)
    if len(rows) != len(others) or [row["broken_bonds"] for row in rows] != [row["broken_bonds"] for row in others]:
        return np.inf
    pulls = np.array([[float(row["pull"]) for row in table] for table in (rows, others)])
    return max(worst, np.abs(pulls[0] - pulls[1]).max() / np.abs(pulls[0]).max())


def _history(directory: Path) -> list[dict]:
    with (directory / "history.csv").open() as file:
        return list(csv.DictReader(file))


def _wait_for_checkpoint(job: subprocess.Popen, directory: Path, before: int) -> None:
    """Until there is a newer one."""
    while job.poll() is None and _written_at(directory) <= before:
        time.sleep(0.01)


def _written_at(directory: Path) -> int:
    path = directory / "checkpoint.h5"
    return path.stat().st_mtime_ns if path.exists() else 0


def _lives(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
