"""Observers: what is shown and written, and when. Each is told of the start, of every committed step and of the end."""

import time as clock
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pdpetsc import events
from pdpetsc.errors import OutputError
from pdpetsc.events import heard
from pdpetsc.io.checkpoint import write_checkpoint
from pdpetsc.io.fields import FieldWriter
from pdpetsc.io.tables import write_broken_bonds, write_history
from pdpetsc.parallel import warn, written

SILENCE = 5.0
"""Seconds after which a load step in which bonds fail is heard of."""


class Observer:
    """Sees a run go by; every method is called on all ranks."""

    def start(self, run) -> None:
        """Before the first step; `run` is the Simulation."""

    def step(self, run) -> None:
        """After a step was committed; its row is `run.rows[-1]`."""

    def passed(self, run, record) -> None:
        """After a pass in which bonds failed; `record` is that of the step so far."""

    def failed(self, run, reached: float, tried: float, reason: str) -> None:
        """After a step was cut."""

    def refined(self, run) -> None:
        """After the body was refined at the last committed state; `run.refinements[-1]` says how."""

    def finish(self, run) -> None:
        """After the last step that was committed, whether the run converged or not."""


LOAD_STEPS = (
    ("step", "{step:5d}"),
    ("time", "{time:10.4g}"),
    ("newton", "{newton_iterations:7d}"),
    ("linear", "{linear_iterations:7d}"),
    ("passes", "{passes:8d}"),
    ("residual", "{relative_residual:10.2e}"),
    ("broken", "{broken_bonds:8d}"),
    ("seconds", "{seconds:9.3f}"),
)
"""Columns of the table of load steps."""

MOTION = (
    ("step", "{step:8d}"),
    ("time", "{time:12.5g}"),
    ("kinetic", "{kinetic_energy:11.4g}"),
    ("stored", "{stored_energy:11.4g}"),
    ("imbalance", "{imbalance:11.2e}"),
    ("broken", "{broken_bonds:8d}"),
    ("seconds", "{seconds:9.3f}"),
)
"""Columns of the table of a motion."""


class Written(Observer):
    """Writes something of the steps that are wanted and of the last one that was committed.

    Where that fails a run goes on, and tries again at the next of those steps; at the end it is an OutputError.

    Args:
        directory: existing result directory.
        wanted: function of the step's number.
    """

    def __init__(self, directory: Path, wanted: Callable[[int], bool]):
        self._directory = directory
        self._wanted = wanted
        self.last = 0
        """The last step that has been written, or 0."""

    def step(self, run):
        if self._wanted(run.state.step):
            self._try(run)

    def finish(self, run):
        if run.state.step and run.state.step != self.last:
            self._do(run)

    def _try(self, run):
        try:
            self._do(run)
        except OutputError as error:
            warn(run.comm, f"{error}; the run goes on without and tries again later")

    def _do(self, run):
        with run.timings("output"):
            self._write(run)
        self.last = run.state.step

    def _write(self, run):
        raise NotImplementedError


class ProgressTable(Observer):
    """A line for each step, and below them a progress bar where a single process has a terminal."""

    def __init__(self, comm, quiet: bool, columns: tuple[tuple[str, str], ...]):
        self._columns = columns
        self._console = _Console(quiet=quiet or comm.rank > 0, highlight=False, soft_wrap=True)
        self._progress = Progress(
            TextColumn("load steps"),
            BarColumn(),
            TextColumn("t = {task.fields[time]:g}"),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            # Open MPI gives its first rank a terminal even when the output goes to a file.
            disable=comm.size > 1 or not self._console.is_terminal or self._console.quiet,
        )

    def start(self, run):
        widths = [len(template.format_map(_Sample())) for _, template in self._columns]
        self._print("".join(f"{name:>{width}}" for (name, _), width in zip(self._columns, widths)))
        self._progress.start()
        self._spoken = clock.monotonic()
        self._task = self._progress.add_task("", total=run.schedule.end, completed=run.state.time, time=run.state.time)

    def step(self, run):
        if run.case.solver.in_time and not run.output.fields(run.state.step):
            return
        row, self._spoken = {"broken_bonds": 0, "rounding_floor": False} | run.rows[-1], clock.monotonic()
        remark = "  (residual at the rounding floor)" if row["rounding_floor"] else ""
        self._print("".join(t.format_map(row) for _, t in self._columns) + remark)
        self._progress.update(self._task, completed=row["time"], time=row["time"])

    def passed(self, run, record):
        if clock.monotonic() > self._spoken + SILENCE:
            self._spoken = clock.monotonic()
            self._print(f"      pass {len(record.passes)}: {record.broken} bonds broken")

    def failed(self, run, reached, tried, reason):
        self._print(f"      step to t = {tried:g} cut in half: {reason}")

    def refined(self, run):
        if run.case.solver.in_time and clock.monotonic() < self._spoken + SILENCE:
            return
        self._spoken = clock.monotonic()
        self._print(f"      refined: {run.particles.count} particles")

    def finish(self, run):
        with heard():
            self._progress.stop()

    def _print(self, line: str) -> None:
        with heard():
            self._progress.console.print(line)


class _Console(Console):
    def on_broken_pipe(self):
        raise BrokenPipeError  # rich would end the program


class JsonLines(Observer):
    """What happens, for machines (events.py)."""

    def start(self, run):
        p, case = run.particles, run.case
        bonds = run.comm.tompi4py().allreduce(run.families.bonds)
        events.tell(
            run.comm, "start", case=case.name, variant=case.variant, title=case.title, path=case.path, dim=p.dim,
            particles=p.count, bonds=bonds, ranks=run.comm.size, time=run.state.time, end_time=run.schedule.end,
            mode=case.solver.mode, **run.solver.choices(),
        )  # fmt: skip

    def step(self, run):
        events.tell(run.comm, "step", **run.rows[-1])

    def passed(self, run, record):
        step = run.state.step + 1
        events.tell(run.comm, "pass", step=step, passes=len(record.passes), broken_bonds=record.broken)

    def failed(self, run, reached, tried, reason):
        events.tell(run.comm, "failed_step", time=reached, tried=tried, reason=reason)

    def refined(self, run):
        events.tell(run.comm, "refined", **run.refinements[-1])


class _Sample(dict):
    """Any column as a number, to measure its width."""

    def __missing__(self, key):
        return 0


class History(Written):
    """history.csv, a row for each step."""

    def __init__(self, directory: Path):
        super().__init__(directory, lambda step: True)
        self._rows = 0  # that are in the file

    def _write(self, run):
        path = self._directory / "history.csv"
        with written(run.comm.tompi4py(), path):
            if run.comm.rank == 0:
                write_history(path, run.rows, self._rows)
        self._rows = len(run.rows)


class Checkpoint(Written):
    """Checkpoints, at the steps that are wanted and where the run is asked for one."""

    def start(self, run):
        self.last = run.state.step  # which comes from a checkpoint

    def step(self, run):
        if self._wanted(run.state.step) or run.requests.save or run.requests.stop:
            self._try(run)
            run.requests.saved()

    def _write(self, run):
        write_checkpoint(self._directory, run.particles, run.state, run.description, run.damaged)


class FieldOutput(Written):
    """Fields of the steps that are wanted and of the last one that was committed."""

    def __init__(self, directory: Path, wanted: Callable[[int], bool], fields: tuple[str, ...]):
        super().__init__(directory, wanted)
        self._fields = fields

    def start(self, run):
        known = {row["step"]: row["time"] for row in run.rows}
        self._writer = FieldWriter(self._directory, run.particles, known, self._fields, run.cracked)
        if run.state.step in self._writer.steps:
            self.last = run.state.step
        elif run.state.step and self._wanted(run.state.step):  # an earlier run has ended on the way
            self._try(run)

    def _write(self, run):
        self._writer.write(run.particles, run.state.step, run.state.time, run.recovery)


class BrokenBonds(Written):
    """broken_bonds.csv."""

    def _write(self, run):
        path = self._directory / "broken_bonds.csv"
        lists = run.fracture.broken(), np.concatenate(run.fracture.broken_ends(), axis=1)
        gathered = run.comm.tompi4py().gather(lists)
        with written(run.comm.tompi4py(), path):
            if gathered is not None:
                bonds, ends = (np.concatenate(parts) for parts in zip(*gathered))
                write_broken_bonds(path, bonds, ends, run.time_of)
