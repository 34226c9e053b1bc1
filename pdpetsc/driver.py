"""From a case to its results: build the simulation, run it, say how it ended."""

import os
import shutil
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc import __version__, events
from pdpetsc.advice import advise
from pdpetsc.case import Case, load
from pdpetsc.census import QUICK
from pdpetsc.errors import ConvergenceError, InputError
from pdpetsc.io import tables
from pdpetsc.io.checkpoint import CHECKPOINT, read_description
from pdpetsc.io.curves import plot_convergence, plot_curve
from pdpetsc.io.plot import animate_result, plot_result
from pdpetsc.io.report import write_report
from pdpetsc.io.view import View
from pdpetsc.memory import available_memory, memory_per_rank
from pdpetsc.observers import (
    LOAD_STEPS,
    MOTION,
    BrokenBonds,
    Checkpoint,
    FieldOutput,
    History,
    JsonLines,
    Observer,
    ProgressTable,
)
from pdpetsc.parallel import collective, say, warn
from pdpetsc.prediction import check_fits, predict
from pdpetsc.prediction import report as report_of
from pdpetsc.run import Run
from pdpetsc.terminal import painted
from pdpetsc.units import labels_of_history


def run(case: Case, out: Path, quiet: bool = False) -> int:
    """Build and solve a case and write its results; the exit code of the command line. Further as `solve`."""
    return _exit_code(solve(case, out, quiet=quiet))


def solve(case: Case, out: str | Path | None = None, observers: Iterable[Observer] = (), quiet: bool = True) -> Run:
    """Build and solve a case.

    Args:
        case: what to do.
        out: result directory; an earlier result there is replaced whole. None: nothing is written.
        observers: who is told, after those that write.
        quiet: print warnings and errors only.

    Raises:
        InputError: on all ranks alike, before anything is written.
        ConvergenceError: likewise, when all has been written.
    """
    comm, out = PETSc.COMM_WORLD, None if out is None else Path(out)
    with collective(comm.tompi4py()):
        if out:
            _check_replaceable(out, case)
    if not quiet and not Path(os.environ["NUMBA_CACHE_DIR"]).exists():
        say(comm, "compiling the kernels, once for this version: about half a minute")
    simulation = build(case)
    with collective(comm.tompi4py()):
        if out and comm.rank == 0:
            _replace(out, case)
    return _finish(simulation, out, observers, quiet)


def build(case: Case, checkpoint: Path | None = None) -> Run:
    """Build a case that fits, at its start or at a checkpoint in a result directory."""
    comm = PETSc.COMM_WORLD
    return Run(case, comm, _blocks_that_fit(case, comm.tompi4py()), checkpoint)


def restart(directory: Path, quiet: bool = False) -> int:
    """Go on from the checkpoint of a result directory, on any number of ranks; results are continued there."""
    comm = PETSc.COMM_WORLD
    directory = directory.parent if directory.name == CHECKPOINT else directory
    with collective(comm.tompi4py()):
        case = Case.from_document(**read_description(directory)["case"])
    simulation = build(case, directory)
    if simulation.ended:
        warn(comm, f"{directory}: the run has already come to its end, t = {simulation.state.time:g}")
    return _exit_code(_finish(simulation, directory, (), quiet))


def plot(
    directory: Path, view: View, animate: bool = False, curve: list[str] | None = None, convergence: bool = False
) -> int:
    """Draw a result: a field of a step or of all of them moving, a curve, or how Newton's method converged; the exit
    code of the command line.

    Args:
        directory: of the result.
        view: what is seen of the body; without a field, that of `output.picture`.
        animate: whether all steps are drawn.
        curve: two columns of history.csv, x and y, one over the other instead of the body; [] as `output.curve` says.
        convergence: whether residuals are drawn instead of the body.

    Raises:
        InputError: there is no such result, field or column.
    """
    comm = PETSc.COMM_WORLD
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            summary = tables.read_summary(directory)
            title = summary["title"] or summary["case"]
            if convergence:
                path = plot_convergence(directory, title, summary["steps"])
            elif curve is not None:
                path = _plot_curve(directory, title, summary, curve)
            else:
                view = view._replace(field=view.field or load(str(directory / "case.toml")).output.picture)
                path = (animate_result if animate else plot_result)(directory, summary, view, view.name)
            say(comm, f"{path}")
    return 0


def _plot_curve(directory: Path, title: str, summary: dict, axes: list[str]) -> Path:
    """The curve of two columns, or that of the case."""
    document = tables.read_case(directory)
    chosen = document.get("output", {}).get("curve")
    if not axes and not chosen:
        raise InputError("--curve: the case has no output.curve; name two columns of history.csv, x and y")
    x, y = axes or (chosen["x"], chosen["y"])
    labels = labels_of_history(document, summary["units"], tables.in_time(summary))
    return plot_curve(directory, title, tables.read_history(directory), x, y, labels)


def report(directory: Path) -> int:
    """Write the report of a result, one page that stands alone; the exit code of the command line.

    Raises:
        InputError: there is no such result.
    """
    comm = PETSc.COMM_WORLD
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            say(comm, f"{write_report(directory)}")
    return 0


def check(case: Case, ranks: int | None = None) -> int:
    """Say what a run of a case will take, and whether it fits; the exit code of the command line, that of the refused
    run where it does not.

    Args:
        case: what would be done.
        ranks: on how many; as many as there are now if None.

    Raises:
        InputError: on all ranks alike, what a run would find wrong before it builds the body.
    """
    comm = MPI.COMM_WORLD
    with collective(comm):
        prediction = predict(case, ranks or comm.size) if comm.rank == 0 else None
    prediction = comm.bcast(prediction)
    available = available_memory()
    say(comm, f"{case.title or case.name}  ({case.path})")
    say(comm, report_of(prediction, case.units, available))
    events.tell(comm, "prediction", available=available, **asdict(prediction))
    for text in advise(case, prediction):
        warn(comm, text)
    try:
        check_fits(prediction, available and available / prediction.ranks)
    except InputError as error:
        where = f"on {prediction.ranks} ranks" if prediction.ranks > 1 else "on one rank"
        events.tell(comm, "error", text=error)
        say(comm, f"refused    {where} of this machine: {error}")
        return 2
    return 0


def _blocks_that_fit(case: Case, comm) -> float | None:
    """About how many blocks the assembled tangent has; None where a quick look misses the body.

    Raises:
        InputError: on all ranks, where the case cannot fit into memory or integers.
    """
    available = memory_per_rank(comm)
    try:
        with collective(comm):
            prediction = predict(case, comm.size, QUICK) if comm.rank == 0 else None
    except InputError:
        return None  # on all ranks alike; building the body says what is wrong
    prediction = comm.bcast(prediction)
    with collective(comm):
        try:
            check_fits(prediction, available)
        except InputError as error:
            raise InputError(f"{case.path}: {error}") from None
    return prediction.blocks


def _check_replaceable(out: Path, case: Case) -> None:
    if not out.exists():
        return
    if not (out.is_dir() and (tables.is_result(out) or not any(out.iterdir()))):
        raise InputError(f"--out {out}: holds more than a result of pdpetsc, so it is not replaced; choose another")
    if Path(case.path).resolve().parent == out.resolve():
        raise InputError(f"--out {out}: holds the case that is to be run, so it is not replaced; choose another")


def _replace(out: Path, case: Case) -> None:
    """An empty result directory that holds the case as run."""
    try:
        if out.exists():
            shutil.rmtree(out)
        out.mkdir(parents=True)
        tables.write_case(out, case.document, f"{__version__}, {case.path}")
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written ({error.strerror})") from None


def _exit_code(run: Run) -> int:
    """Of the command line, for a run that has converged."""
    return 0 if run.case.overridden or all(e["met"] for e in run.summary["expect"]) else 4


def _finish(simulation: Run, out: Path | None, observers: Iterable[Observer], quiet: bool) -> Run:
    """Solve, write and report."""
    comm, case = simulation.comm, simulation.case
    if not quiet:
        _announce(simulation)
    progress = ProgressTable(comm, quiet or events.wanted, MOTION if case.solver.in_time else LOAD_STEPS)
    simulation.observers = [progress, JsonLines(), *(_writers(simulation, out) if out else ()), *observers]
    failure = None
    try:
        simulation.solve()
    except ConvergenceError as error:
        failure = error
    except InputError as error:
        if not simulation.rows:
            if out:
                _remove(comm, out)
            raise
        failure = error
    summary = simulation.summary
    if out and comm.rank == 0:
        tables.write_summary(out / "summary.json", summary)
        if simulation.rows:
            _plot(comm, out, summary, case.output)
    comm.tompi4py().Barrier()
    ending = {key: summary[key] for key in ("status", "converged", "probes", "expect", "unused_options", "timings")}
    events.tell(comm, "result", results=str(out), **ending)
    if not quiet:
        _report(comm, summary, out)
    if summary["unused_options"]:
        warn(comm, f"options that nobody used: {', '.join('-' + name for name in summary['unused_options'])}")
    if failure:
        raise failure
    return simulation


def _writers(simulation: Run, out: Path) -> list[Observer]:
    """The observers that write the result files."""
    output = simulation.output
    return [
        History(out),
        FieldOutput(out, output.fields, simulation.case.written),
        Checkpoint(out, output.checkpoint),
        *([BrokenBonds(out, output.checkpoint)] if simulation.fracture else []),
    ]


def _plot(comm, out: Path, summary: dict, output) -> None:
    """The pictures; a run is not lost for want of them."""
    try:
        plot_result(out, summary, View(output.picture), "result")
        if output.curve:
            _plot_curve(out, summary["title"] or summary["case"], summary, [])
    except Exception as error:
        warn(comm, f"a picture was not made: {error}")


def _remove(comm, out: Path) -> None:
    if comm.rank == 0:
        shutil.rmtree(out)
    comm.tompi4py().Barrier()


def _announce(simulation: Run) -> None:
    p, comm, case = simulation.particles, simulation.comm, simulation.case
    bonds = comm.tompi4py().allreduce(simulation.families.bonds)
    choices = simulation.solver.choices()
    say(comm, f"{case.title or case.name}  ({case.path})")
    say(
        comm,
        f"{p.count} particles in {p.dim}D, {bonds} bonds, {comm.size} rank{'s' if comm.size > 1 else ''}; "
        f"{choices['solver']}, tangent {choices['tangent'].replace('_', '-')}, {choices['preconditioner']}",
    )


def _report(comm, summary: dict, out: Path | None) -> None:
    for name, value in summary["probes"].items():
        if isinstance(value, float):
            say(comm, f"{name} = {value:.6g}")
    for e in summary["expect"]:
        tolerance = f" +- {e['tolerance']:.2g}" if e["tolerance"] else ""
        verdict = painted("met", "green", sys.stdout) if e["met"] else painted("MISSED", "red", sys.stdout)
        say(comm, f"{verdict}: {e['name']} = {_short(e['value'])}, expected {_short(e['expected'])}{tolerance}")
    t = summary["timings"]
    say(comm, f"{summary['status']} in {t['total']:.2f} s{f'; results in {out}' if out else ''}")


def _short(value) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
