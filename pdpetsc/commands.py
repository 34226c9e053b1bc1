"""The commands and their options: the tables by which the command line is read, explained and completed."""

import textwrap
from pathlib import Path
from typing import Any, NamedTuple

from pdpetsc import __version__

DEFAULT_CASE = "clamped_beam"
WIDTH = 100


class Command(NamedTuple):
    """What can be asked for.

    Attributes:
        operand: what follows it.
        meaning: in a sentence or two.
        examples: (line, what it does).
        alone: whether one process answers it, without PETSc and MPI.
    """

    operand: str
    meaning: str
    examples: tuple[tuple[str, str], ...] = ()
    alone: bool = False


class Option(NamedTuple):
    """An option with two dashes.

    Attributes:
        commands: with which it goes.
        meaning: in a few words.
        value: what its value stands for; empty: it has none.
        choices: what the value may be, where that is a matter of few words.
        kind: the value's type.
        many: whether it may be given several times.
        words: whether any number of values follows it.
        dest: what `cli.parse` calls it, where that is not its name.
    """

    commands: tuple[str, ...]
    meaning: str
    value: str = ""
    choices: tuple[str, ...] = ()
    kind: type = str
    many: bool = False
    words: bool = False
    dest: str = ""

    def as_argument(self) -> dict[str, Any]:
        """Return what argparse wants to know."""
        dest = {"dest": self.dest} if self.dest else {}
        if not self.value:
            return {"action": "store_true"} | dest
        if self.words:
            return dest | {"nargs": "*"}
        return dest | ({"action": "append", "default": []} if self.many else {"type": self.kind})


LISTS = ("cases", "models", "elasticity", "influence", "criteria", "loads", "fields")
SHELLS = ("bash", "zsh", "fish")
COMMANDS = {
    "run": Command(
        "[CASE]",
        "Solve a case and write its results; the command may be left out.",
        (
            ("pdpetsc", "the built-in case, in seconds"),
            ("pdpetsc plate.toml:coarse --out /tmp/plate", "a variant of a case of your own"),
            ("mpirun -n 4 python -m pdpetsc plate.toml -snes_monitor -ksp_type cg -pc_type gamg", ""),
            ("pdpetsc plate.toml --json-lines | jq .event", "what happens, for machines"),
        ),
    ),
    "check": Command(
        "[CASE]",
        "Tell in seconds what a run will take: particles, bonds, matrices, solver, memory, the stable step of explicit "
        "dynamics; and what looks wrong with the physics.",
        (("pdpetsc check plate.toml --ranks 64", "would it fit?"),),
    ),
    "new": Command(
        "[NAME.toml]",
        "Write a commented case file that runs as it is, from options or, on a terminal, from questions "
        "(Enter takes what stands in brackets). Without a name it is my_case.toml.",
        (
            ("pdpetsc new", "asks what the case is to be"),
            ("pdpetsc new bar.toml --dim 1 --kind motion", "a wave in a bar"),
            ("pdpetsc new notch.toml --kind fracture --model bond --units mm --size 200,100", ""),
        ),
        alone=True,
    ),
    "list": Command(
        f"[CASE | {' | '.join(LISTS[1:])}]",
        "Name the bundled cases; tell a case's variants and what must come out; or what there is to choose from, with "
        "keys and meanings.",
        (
            ("pdpetsc list clamped_beam", "variants, expectations, sources"),
            ("pdpetsc list models", "materials and their keys"),
        ),
        alone=True,
    ),
    "restart": Command("DIR", "Go on from the last checkpoint of a result.", (("pdpetsc restart results/plate", ""),)),
    "plot": Command(
        "DIR",
        "Draw a result: a field, still or moving, a curve, or how Newton's method converged.",
        (
            ("pdpetsc plot results/plate --field damage --animate", ""),
            ("pdpetsc plot results/plate --field stress --component xx", ""),
        ),
    ),
    "report": Command(
        "DIR", "Put all of a result on one page, report.html.", (("pdpetsc report results/plate", "for a colleague"),)
    ),
    "schema": Command(
        "",
        "Print the JSON Schema of case files, for editors.",
        (("pdpetsc schema > pdpetsc.schema.json", "and '#:schema ./pdpetsc.schema.json' in the case file"),),
        alone=True,
    ),
    "completion": Command(
        " | ".join(SHELLS),
        "Print a script that completes pdpetsc's command line in a shell.",
        (
            ('eval "$(pdpetsc completion bash)"', "for this shell"),
            ("pdpetsc completion fish > ~/.config/fish/completions/pdpetsc.fish", "for good"),
        ),
        alone=True,
    ),
}
OPTIONS = {
    "--out": Option(("run",), "where results go (default: results/CASE); an earlier result there is replaced", "DIR",
                    kind=Path),
    "--set": Option(("run", "check"), "override one entry of the case: body.spacing=0.01, "
                    'load.0.value="-1e-4 * t"', "key=value", many=True, dest="overrides"),
    "--ranks": Option(("check",), "on how many ranks the case would run (default: as many as there are)", "N",
                      kind=int),
    "--field": Option(("plot",), "what colours DIR/NAME.png, as u, damage, stress (default: as in the case)", "NAME"),
    "--component": Option(("plot",), "of the field: x, xx, magnitude, von_mises, 1 (principal value)", "NAME"),
    "--step": Option(("plot",), "of the field file (default: the last)", "N", kind=int),
    "--section": Option(("plot",), "where a body of three dimensions is cut open, as x=0.05", "PLANE"),
    "--scale": Option(("plot",), "factor of the displacements that are drawn (default: 1, or what shows small ones)",
                      "NUMBER", kind=float),
    "--animate": Option(("plot",), "all steps of the field file, as DIR/NAME.gif"),
    "--curve": Option(("plot",), "columns of history.csv, Y over X, as DIR/curve.png (default: as in the case)",
                      "[X Y]", words=True),
    "--convergence": Option(("plot",), "residuals of Newton's method, as DIR/convergence.png"),
    "--quiet": Option(("run", "restart"), "print warnings and errors only"),
    "--json-lines": Option(("run", "check", "restart"), "tell on standard output what happens, for machines: a JSON "
                           "object a line"),
    "--kind": Option(("new",), "what happens (default: tension)", "KIND", ("tension", "fracture", "motion")),
    "--dim": Option(("new",), "of the body (default: as many as --size has, else 2)", "N", ("1", "2", "3")),
    "--model": Option(("new",), "of the material (default: correspondence)", "MODEL",
                      ("abd", "bond", "correspondence", "ordinary")),
    "--units": Option(("new",), "of all numbers: m with N, s, Pa, or mm with N, s, MPa (default: m)", "UNITS",
                      ("m", "mm")),
    "--size": Option(("new",), "lengths of the body's sides, as 0.1,0.04", "X,Y,Z"),
    "--thickness": Option(("new",), "of a plane body (default: a fourth of the shorter side)", "NUMBER"),
    "--plane": Option(("new",), "strain, of thick parts, or stress, of sheets (default: strain)", "STATE",
                      ("strain", "stress")),
    "--E": Option(("new",), "Young's modulus", "NUMBER"),
    "--nu": Option(("new",), "Poisson's ratio; not for bond, which has a fixed one", "NUMBER"),
    "--hole": Option(("new",), "radius of a round hole in the middle; 0 for none", "R"),
    "--schema": Option(("new",), "write the schema for editors beside the case, too"),
    "--force": Option(("new",), "replace a file that is there; no load"),
}  # fmt: skip
FOR_ALL = {"--version": "print the version", "-h, --help": "print this text, or that of a command; -help is PETSc's"}


def usage(name: str) -> str:
    """Return the line of a command."""
    words = [f"pdpetsc {name}".replace(" run", " [run]"), COMMANDS[name].operand]
    for option, about in OPTIONS.items():
        if name in about.commands:
            words.append(f"[{option} {about.value}{' ...' * about.many}]".replace(" ]", "]"))
    words += ["[PETSc options]"] if not COMMANDS[name].alone and name not in ("plot", "report") else []
    return " ".join(filter(None, words))


def explain() -> str:
    """Return the text of `pdpetsc --help`."""
    lines = [f"pdpetsc {__version__}: implicit peridynamics in parallel, on PETSc", ""]
    for name in COMMANDS:
        short = f"pdpetsc {name} {COMMANDS[name].operand} [options]" if name == "new" else usage(name)
        lines += textwrap.wrap(short, WIDTH, initial_indent="  ", subsequent_indent=" " * 6)
    lines += ["", *textwrap.wrap(
        "CASE is a path that ends in .toml or the name of a bundled case, NAME:VARIANT for a variant (default: "
        f"{DEFAULT_CASE}). Options with one dash go to PETSc and win over [petsc] in the case. "
        "`pdpetsc COMMAND --help` tells of one command.", WIDTH,
    ), ""]  # fmt: skip
    names = [name for name, about in OPTIONS.items() if about.commands != ("new",)]
    lines += _options(names, show_commands=True)
    lines += ["", "Examples:", *_examples([example for about in COMMANDS.values() for example in about.examples])]
    lines += ["", *textwrap.wrap(
        "Exit codes: 0 converged and as expected, 1 internal error or results that cannot be written, 2 bad input, "
        "3 not converged, 4 an expectation missed, 5 stopped by a signal.", WIDTH,
    ), "", *textwrap.wrap(
        "SIGTERM, SIGINT (Ctrl-C) and SIGUSR2 stop a run after its step with a checkpoint, SIGUSR1 asks for a "
        "checkpoint; mpirun passes on SIGUSR1 and SIGUSR2 (docs/solvers.md, \"When something goes wrong\").", WIDTH,
    )]  # fmt: skip
    return "\n".join(lines)


def explain_command(name: str) -> str:
    """Return the text of `pdpetsc COMMAND --help`."""
    about = COMMANDS[name]
    lines = textwrap.wrap(usage(name), WIDTH, subsequent_indent=" " * 4)
    lines += ["", *textwrap.wrap(about.meaning, WIDTH), ""]
    lines += _options([option for option, of in OPTIONS.items() if name in of.commands], show_commands=False)
    lines += ["", "Examples:", *_examples(about.examples)] if about.examples else []
    return "\n".join(lines)


def _options(names: list[str], show_commands: bool) -> list[str]:
    rows = []
    for name in names:
        about = OPTIONS[name]
        of = f"{', '.join(about.commands)}: " if show_commands and "run" not in about.commands else ""
        choices = f": {', '.join(about.choices)}" if about.choices else ""
        rows.append((f"{name} {about.value}".strip(), of + about.meaning + choices))
    rows += FOR_ALL.items()
    return _table(rows)


def _examples(examples) -> list[str]:
    return _table(examples) if examples else []


def _table(rows) -> list[str]:
    """Two columns; what is too long for the first one pushes the second one on."""
    rows = list(rows)
    indent = min(52, max(len(left) for left, _ in rows)) + 4
    lines = []
    for left, right in rows:
        text = f"  {left:{indent - 2}}{right}" if len(left) < indent - 2 else f"  {left}  {right}".rstrip()
        lines += textwrap.wrap(text, WIDTH, subsequent_indent=" " * indent, drop_whitespace=True)
    return [line.rstrip() for line in lines]
