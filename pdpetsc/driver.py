"""From a case to its results: build the simulation, run it, say how it ended."""

import shutil
import signal
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc import __version__, events
from pdpetsc.advice import advise
from pdpetsc.building import check_places
from pdpetsc.case import Case
from pdpetsc.census import QUICK
from pdpetsc.compiling import compiling_announced
from pdpetsc.errors import ConvergenceError, InputError, Interrupted, NoRoom, OutputError
from pdpetsc.io import tables, trust
from pdpetsc.io.checkpoint import CHECKPOINT, check_whole, read_description
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
from pdpetsc.parallel import collective, say, warn, written
from pdpetsc.pictures import draw
from pdpetsc.prediction import check_fits, predict, report
from pdpetsc.run import Run
from pdpetsc.signals import SILENCE, listening
from pdpetsc.terminal import painted

SMALL = 300_000
"""Particles of a body that is made to see whether its sets and surfaces hold something."""


def run(case: Case, out: Path, quiet: bool = False) -> int:
    """Build and solve a case and write its results; the exit code of the command line. Further as `solve`."""
    with listening():
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
    with compiling_announced(comm, quiet):
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
    with listening(), compiling_announced(PETSc.COMM_WORLD, quiet):
        return _restart(directory.parent if directory.name == CHECKPOINT else directory, quiet)


def _restart(directory: Path, quiet: bool) -> int:
    comm = PETSc.COMM_WORLD
    check_whole(comm.tompi4py(), directory)
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            trust.check_no_links(directory)
            trust.check_checkpoint(directory / CHECKPOINT)
    with collective(comm.tompi4py()):
        case = Case.from_document(**read_description(directory)["case"])
    simulation = build(case, directory)
    if simulation.ended:
        warn(comm, f"{directory}: the run has already come to its end, t = {simulation.state.time:g}")
    return _exit_code(_finish(simulation, directory, (), quiet))


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
    say(comm, report(prediction, case.units, available))
    events.tell(comm, "prediction", available=available, **asdict(prediction))
    for text in advise(case, prediction):
        warn(comm, text)
    if prediction.particles <= SMALL:
        check_places(PETSc.COMM_WORLD, case)
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
    available, prediction = memory_per_rank(comm), None
    with collective(comm):
        try:
            prediction = predict(case, comm.size, QUICK) if comm.rank == 0 else None
        except NoRoom:
            raise
        except InputError:
            pass  # building the body says what is wrong
    prediction = comm.bcast(prediction)
    if prediction is None:
        return None
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
        raise InputError(f"--out {out}: cannot be written ({error.strerror or error})") from None


def _exit_code(run: Run) -> int:
    """Of the command line, for a run that has converged."""
    return 0 if run.case.overridden or all(e["met"] for e in run.summary["expect"]) else 4


def _finish(simulation: Run, out: Path | None, observers: Iterable[Observer], quiet: bool) -> Run:
    """Solve, write and report."""
    comm, case = simulation.comm, simulation.case
    if not quiet:
        _announce(simulation)
    table = MOTION if case.solver.in_time else LOAD_STEPS
    shown = JsonLines() if events.wanted else ProgressTable(comm, quiet, table)
    writers = _writers(simulation, out) if out else []
    simulation.observers = [shown, *writers, *observers]
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
    summary, unwritten = simulation.summary, simulation.unwritten
    if out:
        try:
            with written(comm.tompi4py(), out / "summary.json"):
                if comm.rank == 0:
                    tables.write_summary(out / "summary.json", summary)
        except OutputError as error:
            unwritten = unwritten or error
        if comm.rank == 0 and simulation.rows and not unwritten:
            draw(comm, out, summary, case.output.picture)
    comm.tompi4py().Barrier()
    ending = {key: summary[key] for key in ("status", "converged", "probes", "expect", "unused_options", "timings")}
    events.tell(comm, "result", results=str(out), **ending)
    if not quiet:
        _report(comm, summary, out)
    if summary["unused_options"]:
        warn(comm, f"options that nobody used: {', '.join('-' + name for name in summary['unused_options'])}")
    if failure or unwritten:
        raise failure or OutputError(f"{unwritten}{_to_go_on(out, simulation)}")
    if simulation.status == "interrupted":
        raise Interrupted(f"{_of_stop(simulation)}{_to_go_on(out, simulation)}")
    return simulation


def _writers(simulation: Run, out: Path) -> list[Observer]:
    """The observers that write the result files."""
    output = simulation.output
    return [
        History(out),
        Checkpoint(out, output.checkpoint),  # the first of what takes time: somebody may be about to end us
        FieldOutput(out, output.fields, simulation.case.written),
        *([BrokenBonds(out, output.checkpoint)] if simulation.fracture else []),
    ]


def _of_stop(simulation: Run) -> str:
    state, stop = simulation.state, signal.Signals(simulation.requests.stop)
    what = "nobody reads its output any more" if stop == SILENCE else stop.name
    return f"the run was stopped after step {state.step}, t = {state.time:g} ({what})"


def _to_go_on(out: Path | None, simulation: Run) -> str:
    """What can be done next, with a semicolon in front."""
    last = max((observer.last for observer in simulation.observers if isinstance(observer, Checkpoint)), default=0)
    if not last:
        return "; there is no checkpoint yet to go on from"
    return f"; pdpetsc restart {out} goes on from step {last}, t = {simulation.time_of(last):g}"


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
