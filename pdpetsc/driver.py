"""From a case to its results: build the simulation, run it, say how it ended."""

import os
import shutil
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc import __version__
from pdpetsc.case import Case, load
from pdpetsc.census import QUICK
from pdpetsc.errors import ConvergenceError, InputError, NoRoom
from pdpetsc.io import tables, trust
from pdpetsc.io.checkpoint import CHECKPOINT, read_description
from pdpetsc.io.plot import animate_result, plot_curve, plot_result
from pdpetsc.memory import available_memory, memory_per_rank
from pdpetsc.observers import LOAD_STEPS, MOTION, BrokenBonds, Checkpoint, FieldOutput, History, ProgressTable
from pdpetsc.parallel import collective, say, warn
from pdpetsc.prediction import check_fits, predict, report
from pdpetsc.simulation import Simulation
from pdpetsc.summary import summary_of


def run(case: Case, out: Path, quiet: bool = False) -> int:
    """Build and solve a case and write its results.

    Args:
        case: what to do.
        out: result directory; an earlier result there is replaced whole.
        quiet: print warnings and errors only.

    Returns:
        The exit code of the command line.

    Raises:
        InputError: on all ranks alike, before anything is written.
    """
    comm = PETSc.COMM_WORLD
    with collective(comm.tompi4py()):
        _check_replaceable(out, case)
    if not quiet and not Path(os.environ["NUMBA_CACHE_DIR"]).exists():
        say(comm, "compiling the kernels, once for this version: about half a minute")
    simulation = Simulation(case, comm, _blocks_that_fit(case, comm.tompi4py()))
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            _replace(out, case)
    return _finish(simulation, out, quiet)


def restart(directory: Path, quiet: bool = False) -> int:
    """Go on from the checkpoint of a result directory, on any number of ranks; results are continued there."""
    comm = PETSc.COMM_WORLD
    directory = directory.parent if directory.name == CHECKPOINT else directory
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            trust.check_no_links(directory)
            trust.check_checkpoint(directory)
            trust.check_fields(directory, whole=False)
    with collective(comm.tompi4py()):
        case = Case.from_document(**read_description(directory)["case"])
    simulation = Simulation(case, comm, _blocks_that_fit(case, comm.tompi4py()), directory)
    if simulation.ended:
        warn(comm, f"{directory}: the run has already come to its end, t = {simulation.state.time:g}")
    return _finish(simulation, directory, quiet)


def plot(directory: Path, field: str | None, animate: bool) -> int:
    """Draw a field of a result, its last step or all of them moving; the exit code of the command line.

    Args:
        directory: of the result.
        field: of `quantities`; None: as the case says.
        animate: whether all steps are drawn.

    Raises:
        InputError: there is no such result or field.
    """
    comm = PETSc.COMM_WORLD
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            trust.check_no_links(directory)
            summary = tables.read_summary(directory)
            trust.check_fields(directory, whole=True)
            field = field or load(str(directory / "case.toml")).output.picture
            draw = animate_result if animate else plot_result
            say(comm, f"{draw(directory, summary, field, field)}")
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
        prediction = predict(case, ranks or comm.size)
    available = available_memory()
    say(comm, f"{case.title or case.name}  ({case.path})")
    say(comm, report(prediction, case.units, available))
    try:
        check_fits(prediction, available and available / prediction.ranks)
    except InputError as error:
        where = f"on {prediction.ranks} ranks" if prediction.ranks > 1 else "on one rank"
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
            prediction = predict(case, comm.size, QUICK)
        except NoRoom:
            raise
        except InputError:
            pass  # on all ranks alike; building the body says what is wrong
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


def _finish(simulation: Simulation, out: Path, quiet: bool) -> int:
    """Solve, write and report; the exit code."""
    comm, case = simulation.comm, simulation.case
    if not quiet:
        _announce(simulation)
    output = simulation.output
    simulation.observers = [
        ProgressTable(comm, quiet, MOTION if case.solver.in_time else LOAD_STEPS),
        History(out),
        FieldOutput(out, output.fields, case.written),
        Checkpoint(out, output.checkpoint),
        *([BrokenBonds(out, output.fields)] if simulation.fracture else []),
    ]
    status, failure = "converged", None
    try:
        status = simulation.solve()
    except ConvergenceError as error:
        status, failure = "not_converged", error
    except InputError as error:
        if not simulation.rows:
            _remove(comm, out)
            raise
        status, failure = "interrupted", error
    summary = summary_of(simulation, status)
    if comm.rank == 0:
        tables.write_summary(out / "summary.json", summary)
        if simulation.rows:
            _plot(comm, out, summary, simulation.rows, case.output)
    comm.tompi4py().Barrier()
    if not quiet:
        _report(comm, summary, out)
    if summary["unused_options"]:
        warn(comm, f"options that nobody used: {', '.join('-' + name for name in summary['unused_options'])}")
    if failure:
        raise failure
    return 0 if case.overridden or all(e["met"] for e in summary["expect"]) else 4


def _plot(comm, out: Path, summary: dict, rows: list[dict], output) -> None:
    """The pictures; a run is not lost for want of them."""
    try:
        plot_result(out, summary, output.picture, "result")
        if output.curve:
            plot_curve(out, summary["title"] or summary["case"], rows, output.curve.x, output.curve.y)
    except Exception as error:
        warn(comm, f"a picture was not made: {error}")


def _remove(comm, out: Path) -> None:
    if comm.rank == 0:
        shutil.rmtree(out)
    comm.tompi4py().Barrier()


def _announce(simulation: Simulation) -> None:
    p, comm, case = simulation.particles, simulation.comm, simulation.case
    bonds = comm.tompi4py().allreduce(simulation.families.bonds)
    choices = simulation.solver.choices()
    say(comm, f"{case.title or case.name}  ({case.path})")
    say(
        comm,
        f"{p.count} particles in {p.dim}D, {bonds} bonds, {comm.size} rank{'s' if comm.size > 1 else ''}; "
        f"{choices['solver']}, tangent {choices['tangent'].replace('_', '-')}, {choices['preconditioner']}",
    )


def _report(comm, summary: dict, out: Path) -> None:
    for name, value in summary["probes"].items():
        if isinstance(value, float):
            say(comm, f"{name} = {value:.6g}")
    for e in summary["expect"]:
        tolerance = f" +- {e['tolerance']:.2g}" if e["tolerance"] else ""
        verdict = "met" if e["met"] else "MISSED"
        say(comm, f"{verdict}: {e['name']} = {_short(e['value'])}, expected {_short(e['expected'])}{tolerance}")
    t = summary["timings"]
    say(comm, f"{summary['status']} in {t['total']:.2f} s; results in {out}")


def _short(value) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
