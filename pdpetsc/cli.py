"""The command line: what is asked for, and how a run ends."""

import argparse
import shutil
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path

from mpi4py import MPI

from pdpetsc import __version__, case, parallel
from pdpetsc.errors import ConvergenceError, InputError, Interrupted, OutputError
from pdpetsc.expressions import hint

DEFAULT_CASE = "clamped_beam"
COMMANDS = ("run", "check", "list", "restart", "plot")
HELP = f"""\
pdpetsc {__version__}: implicit peridynamics in parallel, on PETSc

  pdpetsc [run] [CASE] [--out DIR] [--set key=value ...] [--quiet] [PETSc options]
  pdpetsc check [CASE] [--set key=value ...] [--ranks N] [PETSc options]
  pdpetsc restart DIR [--quiet] [PETSc options]
  pdpetsc plot DIR [--field NAME] [--animate]
  pdpetsc list

CASE is a path that ends in .toml or the name of a bundled case, NAME:VARIANT for a variant
(default: {DEFAULT_CASE}).

  --out DIR         where results go (default: results/CASE); an earlier result there is replaced
  --set key=value   override one entry of the case: body.spacing=0.01, load.0.value="-1e-4 * t"
  --ranks N         check: on how many ranks the case would run (default: as many as there are)
  --field NAME      plot: what colours DIR/NAME.png, as u, damage, stress (default: as in the case)
  --animate         plot: all steps of the field file, as DIR/NAME.gif
  --quiet           print warnings and errors only
  --version         print the version
  -h, --help        print this text; -help is PETSc's own

Options with one dash go to PETSc and win over [petsc] in the case. `check` tells in seconds what a
run will take: particles, bonds, matrices, solver, memory, the stable step of explicit dynamics.

Examples:
  pdpetsc                                          the built-in case, in seconds
  pdpetsc plate.toml:coarse --out /tmp/plate       a variant of a case of your own
  mpirun -n 4 python -m pdpetsc plate.toml -snes_monitor -ksp_type cg -pc_type gamg
  pdpetsc check plate.toml --ranks 64              would it fit?
  pdpetsc restart results/plate                    go on from the last checkpoint
  pdpetsc plot results/plate --field damage --animate

Exit codes: 0 converged and as expected, 1 internal error or results that cannot be written,
2 bad input, 3 not converged, 4 an expectation missed, 5 stopped by a signal.

SIGTERM, SIGINT (Ctrl-C) and SIGUSR2 stop a run after its step with a checkpoint, SIGUSR1 asks for a
checkpoint; mpirun passes on SIGUSR1 and SIGUSR2 (docs/solvers.md, "When something goes wrong")."""


class _Parser(argparse.ArgumentParser):
    """Reports mistakes as InputError, so that they are said once and not by every rank."""

    def error(self, message: str):
        raise InputError(f"{message}; see pdpetsc --help")


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read our own arguments: `command`, `operand` (a case or a directory), `out`, `overrides`, `ranks`,
    `field`, `animate`, `quiet`.

    Raises:
        InputError: The command line makes no sense.
    """
    parser = _Parser(prog="pdpetsc", add_help=False, allow_abbrev=False)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="key=value")
    parser.add_argument("--ranks", type=int)
    parser.add_argument("--field")
    parser.add_argument("--animate", action="store_true")
    parser.add_argument("--quiet", action="store_true")
    parser.add_argument("--version", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    request = parser.parse_intermixed_args(arguments)
    words = request.words
    request.command = words.pop(0) if words and words[0] in COMMANDS else "run"
    if request.help or request.version:
        request.command = "help" if request.help else "version"
        return request
    takes_case = request.command in ("run", "check")
    known = 0 if request.command == "list" else 1
    unknown = [word for word in words if not case.is_case(word)] if takes_case else words[known:]
    if unknown:
        names = [*COMMANDS, *case.bundled()]
        raise InputError(
            f"unknown word {unknown[0]!r}{hint(unknown[0].partition(':')[0], names)}; commands: {', '.join(COMMANDS)}; "
            f"bundled cases: {', '.join(case.bundled())}; a case of your own is a path that ends in .toml"
        )
    if len(words) > known:
        raise InputError(f"more than one case: {', '.join(words)}")
    if request.command in ("restart", "plot") and not words:
        raise InputError(f"{request.command} needs the directory of an earlier result")
    if request.command != "plot" and (request.field or request.animate):
        raise InputError("--field and --animate go with plot; a run's picture is that of output.picture in the case")
    if not takes_case and (request.out or request.overrides):
        raise InputError(f"{request.command} takes neither --out nor --set")
    if request.command == "check" and request.out:
        raise InputError("check takes no --out: it writes nothing")
    if request.ranks is not None and (request.command != "check" or request.ranks < 1):
        raise InputError("--ranks is a positive number of ranks and goes with check; a run is on those of mpirun -n")
    request.operand = words[0] if words else DEFAULT_CASE
    return request


def petsc_defaults(arguments: list[str]) -> Mapping:
    """Return the [petsc] table of the case that is asked for, read before PETSc starts.

    A mistake is passed over here: `main` meets it again and reports it.
    """
    try:
        request = parse(arguments)
        if request.command in ("run", "check"):
            return case.load(request.operand, request.overrides).petsc
        if request.command == "restart":
            return case.load(str(Path(request.operand) / "case.toml")).petsc  # the case as run
    except InputError:
        pass
    return {}


def main(arguments: list[str]) -> int:
    """Do what the command line asks for, on all ranks.

    Args:
        arguments: Our own part of the command line.

    Returns:
        The exit code.
    """
    parallel.abort_on_exception()
    comm = MPI.COMM_WORLD
    try:
        return _do(parse(arguments), comm)
    except InputError as error:
        code, message = 2, str(error)
    except ConvergenceError as error:
        code, message = 3, str(error)
    except Interrupted as error:
        code, message = 5, str(error)
    except OutputError as error:
        code, message = 1, str(error)
    if comm.rank == 0:
        print(f"pdpetsc: error: {message}", file=sys.stderr, flush=True)
    return code


def _do(request: argparse.Namespace, comm) -> int:
    if request.command == "help":
        parallel.say(comm, HELP)
    elif request.command == "version":
        parallel.say(comm, f"pdpetsc {__version__}")
    elif request.command == "list":
        parallel.say(comm, _catalogue())
    elif request.command == "restart":
        from pdpetsc import driver

        return driver.restart(Path(request.operand), request.quiet)
    elif request.command == "plot":
        from pdpetsc import driver

        return driver.plot(Path(request.operand), request.field, request.animate)
    else:
        with parallel.collective(comm):
            chosen = case.load(request.operand, request.overrides)
        from pdpetsc import driver

        if request.command == "check":
            return driver.check(chosen, request.ranks)
        folder = f"{chosen.name}-{chosen.variant}" if chosen.variant else chosen.name
        return driver.run(chosen, request.out or Path("results") / folder, request.quiet)
    return 0


def _catalogue() -> str:
    """Return the bundled cases, with titles and variants, as a table."""
    entries = case.catalogue()
    indent = max((len(name) for name, _, _ in entries), default=0) + 2
    width = max(40, shutil.get_terminal_size().columns)
    lines = []
    for name, title, variants in entries:
        lines += textwrap.wrap(f"{name:{indent}}{title}", width, subsequent_indent=" " * indent)
        if variants:
            text = f"variants: {', '.join(variants)}"
            lines += textwrap.wrap(text, width, initial_indent=" " * indent, subsequent_indent=" " * (indent + 10))
    return "\n".join(lines)
