"""The command line: what is asked for, and how a run ends."""

import argparse
import atexit
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from pdpetsc import __version__, catalogue, commands, events, terminal
from pdpetsc.commands import COMMANDS, DEFAULT_CASE, LISTS, OPTIONS, SHELLS
from pdpetsc.errors import ConvergenceError, InputError, Interrupted, OutputError


def hint(word: str, choices) -> str:
    """As `expressions.hint`, which is loaded only when it is needed."""
    from pdpetsc import expressions

    return expressions.hint(word, choices)


class _Parser(argparse.ArgumentParser):
    """Reports mistakes as InputError, so that they are said once and not by every rank."""

    def error(self, message: str):
        unknown = message.removeprefix("unrecognized arguments: ").split()[0]
        near = hint(unknown, OPTIONS) if message.startswith("unrecognized") else ""
        command = next((word for word in sys.argv[1:] if word in COMMANDS), "")
        raise InputError(f"{message}{near}; see {' '.join(filter(None, ('pdpetsc', command, '--help')))}")


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read our own arguments: `command`, `operand` (a case, a directory, a list ...), and the options of `commands` by
    name, --set as `overrides`.

    Raises:
        InputError: The command line makes no sense.
    """
    parser = _Parser(prog="pdpetsc", add_help=False, allow_abbrev=False)
    parser.add_argument("words", nargs="*")
    for name, about in OPTIONS.items():
        parser.add_argument(name, **about.as_argument())
    parser.add_argument("--version", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    request = parser.parse_intermixed_args(arguments)
    words = request.words
    request.command = words.pop(0) if words and words[0] in COMMANDS else "run"
    if request.help or request.version:
        request.operand = request.command if request.command in arguments else None
        request.command = "help" if request.help else "version"
        return request
    _check_words(request.command, words)
    for name, about in OPTIONS.items():
        dest = about.dest or name.strip("-").replace("-", "_")
        if getattr(request, dest) != parser.get_default(dest) and request.command not in about.commands:
            raise InputError(f"{name} goes with {', '.join(about.commands)}, not with {request.command}")
    if request.ranks is not None and request.ranks < 1:
        raise InputError("--ranks is a positive number of ranks")
    _check_picture(request)
    request.operand = words[0] if words else DEFAULT_CASE if request.command in ("run", "check") else None
    return request


def _check_words(command: str, words: list[str]) -> None:
    """Check what follows a command.

    Raises:
        InputError: It is not what the command takes.
    """
    if len(words) > 1 and command in ("run", "check") and all(map(catalogue.is_case, words)):
        raise InputError(f"more than one case: {', '.join(words)}")
    if command in ("restart", "plot", "report") and not words:
        raise InputError(f"{command} needs the directory of an earlier result")
    if command == "completion" and not (words and words[0] in SHELLS):
        near = hint(words[0], SHELLS) if words else ""
        raise InputError(f"completion needs the name of a shell{near}: {', '.join(SHELLS)}")
    if command == "new" and words and not words[0].endswith(".toml"):
        raise InputError(f"new writes a file that ends in .toml, not {words[0]!r}")
    fits = {
        "run": catalogue.is_case,
        "check": catalogue.is_case,
        "list": lambda word: word in LISTS or catalogue.is_case(word),
        "schema": lambda word: False,
    }.get(command, lambda word: True)
    unknown = [word for place, word in enumerate(words) if place > 0 or not fits(word)]
    if unknown:
        word, bundled = unknown[0], list(catalogue.bundled())
        lists = LISTS if command == "list" else ()
        raise InputError(
            f"unknown word {word!r}{hint(word.partition(':')[0], [*COMMANDS, *lists, *bundled])}; "
            f"{'lists: ' if lists else 'commands: '}{', '.join(lists or COMMANDS)}; bundled cases: "
            f"{', '.join(bundled)}; a case of your own is a path that ends in .toml"
        )


PICTURES = {"field": None, "component": None, "step": None, "section": None, "scale": None, "animate": False}
"""What is drawn of a body, and what is where it is not given."""


def _check_picture(request: argparse.Namespace) -> None:
    of_body = [name for name, default in PICTURES.items() if getattr(request, name) != default]
    instead = ["curve"] * (request.curve is not None) + ["convergence"] * request.convergence
    if len(instead) > 1 or (instead and of_body):
        raise InputError(f"--{instead[0]} does not go with --{(instead[1:] + of_body)[0]}: one picture at a time")
    if request.curve and len(request.curve) != 2:
        raise InputError("--curve takes two columns of history.csv, x and y, or none, and stands behind the directory")
    if request.animate and request.step is not None:
        raise InputError("--animate draws all steps, so it does not go with --step")


def petsc_defaults(arguments: list[str]) -> Mapping:
    """Return the [petsc] table of the case that is asked for, read before PETSc starts.

    A mistake is passed over here: `main` meets it again and reports it.
    """
    from pdpetsc import case

    try:
        request = parse(arguments)
        if request.command in ("run", "check"):
            return case.load(request.operand, request.overrides).petsc
        if request.command == "restart":
            directory = Path(request.operand)
            directory = directory.parent if directory.name == "checkpoint.h5" else directory
            return case.load(str(directory / "case.toml")).petsc  # the case as run
    except InputError:
        pass
    return {}


def answer(arguments: list[str]) -> int | None:
    """Do what needs neither PETSc nor MPI, where there are no other ranks; they could not be made to fail together.

    Returns:
        The exit code, or None: nothing was done, `main` must.
    """
    if terminal.launched():
        return None
    try:
        request = parse(arguments)
        if request.command in COMMANDS and not COMMANDS[request.command].alone:
            return None
        print(_answer(request), flush=True)
    except BrokenPipeError:  # the reader has seen enough; Python would complain when it closes the stream
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except InputError as error:
        _complain(error)
        return 2
    return 0


def main(arguments: list[str]) -> int:
    """Do what the command line asks for, on all ranks.

    Args:
        arguments: Our own part of the command line.

    Returns:
        The exit code.
    """
    from mpi4py import MPI

    from pdpetsc import parallel

    parallel.abort_on_exception()
    comm = MPI.COMM_WORLD
    events.wanted = "--json-lines" in arguments
    code, message = 0, None
    try:
        code = _do(parse(arguments), comm)
    except InputError as error:
        code, message = 2, str(error)
    except ConvergenceError as error:
        code, message = 3, str(error)
    except Interrupted as error:
        code, message = 5, str(error)
    except OutputError as error:
        code, message = 1, str(error)
    if message and comm.rank == 0:
        _complain(message)
    if message:
        events.tell(comm, "error", text=message)
    events.tell(comm, "end", exit_code=code)
    if colours := sys.modules.get("colorama.initialise"):  # it would end the output with an escape
        atexit.unregister(colours.reset_all)
    return code


def _complain(error: Exception | str) -> None:
    print(terminal.painted(f"pdpetsc: error: {error}", "red", sys.stderr), file=sys.stderr, flush=True)


def _do(request: argparse.Namespace, comm) -> int:
    from pdpetsc import case, parallel

    if request.command == "new" and comm.size > 1:
        raise InputError("new writes one file: start it without mpirun")
    if request.command not in COMMANDS or COMMANDS[request.command].alone:
        with parallel.collective(comm):
            text = _answer(request)
        parallel.say(comm, text)
    elif request.command == "restart":
        from pdpetsc import driver

        return driver.restart(Path(request.operand), request.quiet)
    elif request.command == "plot":
        from pdpetsc import pictures
        from pdpetsc.io.view import View, section

        cut = request.section and section(request.section)
        view = View(request.field, request.component, request.step, cut, request.scale)
        return pictures.plot(Path(request.operand), view, request.animate, request.curve, request.convergence)
    elif request.command == "report":
        from pdpetsc import pictures

        return pictures.report(Path(request.operand))
    else:
        with parallel.collective(comm):
            chosen = case.load(request.operand, request.overrides)
        from pdpetsc import driver

        if request.command == "check":
            return driver.check(chosen, request.ranks)
        folder = f"{chosen.name}-{chosen.variant}" if chosen.variant else chosen.name
        return driver.run(chosen, request.out or Path("results") / folder, request.quiet)
    return 0


def _answer(request: argparse.Namespace) -> str:
    """Return what a command says that needs neither PETSc nor MPI; `new` writes its file as well."""
    if request.command == "help":
        return commands.explain_command(request.operand) if request.operand else commands.explain()
    if request.command == "version":
        return f"pdpetsc {__version__}"
    if request.command == "completion":
        from pdpetsc import completion

        return completion.script(request.operand)
    if request.command == "schema":
        from pdpetsc.schema import editors

        return editors.schema_text()
    if request.command == "new":
        from pdpetsc import newcase

        return newcase.write(request)
    from pdpetsc import lists

    return lists.show(request.operand)
