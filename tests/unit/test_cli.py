"""The command line: what it asks for, what it refuses, and the exit codes."""

import io
import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import conftest
import pytest
from numba import njit

import pdpetsc
from pdpetsc import __main__, catalogue, cli, terminal
from pdpetsc.commands import COMMANDS, OPTIONS
from pdpetsc.compiling import compiling_announced
from pdpetsc.errors import ConvergenceError, InputError
from pdpetsc.io.view import Section, View

ROD = """
title = "A rod"
[body]
size = [1.0]
spacing = 0.1
horizon = 2.015
[material.steel]
model = "correspondence"
E = 1.0
nu = 0.0
[petsc]
ksp_type = "cg"
[variant.fine]
body.spacing = 0.05
"""


@pytest.fixture(autouse=True)
def bundled(tmp_path, monkeypatch):
    """Bundle two cases of our own and work in an empty directory."""
    cases = tmp_path / "cases"
    cases.mkdir()
    (cases / "rod.toml").write_text(ROD)
    (cases / "clamped_beam.toml").write_text(
        ROD.replace("A rod", "A beam").replace("[variant.fine]", "[variant.rows3]")
    )
    monkeypatch.setattr(catalogue, "BUNDLED", cases)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # `main` sets it; put it back afterwards
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def driver(monkeypatch):
    """A driver that notes what it is asked to do."""
    calls = []

    def run(chosen, out, quiet):
        calls.append((chosen.name, chosen.variant, chosen.overridden, out, quiet))
        return 0

    def restart(directory, quiet):
        calls.append((directory, quiet))
        return 4

    def check(chosen, ranks):
        calls.append((chosen.name, chosen.variant, chosen.overridden, ranks))
        return 0

    def plot(directory, view, animate, curve, convergence):
        calls.append((directory, view, animate, curve, convergence))
        return 0

    def report(directory):
        calls.append(directory)
        return 0

    stub = SimpleNamespace(run=run, restart=restart, check=check, plot=plot, report=report, calls=calls)
    for room in ("driver", "pictures"):
        monkeypatch.setattr(pdpetsc, room, stub, raising=False)
        monkeypatch.setitem(sys.modules, f"pdpetsc.{room}", stub)
    return stub


@pytest.mark.parametrize(
    ("line", "call"),
    [
        ("", ("clamped_beam", None, False, Path("results/clamped_beam"), False)),
        ("run", ("clamped_beam", None, False, Path("results/clamped_beam"), False)),
        ("rod", ("rod", None, False, Path("results/rod"), False)),
        ("--quiet rod:fine", ("rod", "fine", False, Path("results/rod-fine"), True)),
        ("run --out here/it rod", ("rod", None, False, Path("here/it"), False)),
        ("cases/rod.toml:fine", ("rod", "fine", False, Path("results/rod-fine"), False)),
        ("rod --set body.spacing=0.2 --set solver.steps=3", ("rod", None, True, Path("results/rod"), False)),
    ],
)
def test_run(line, call, driver):
    assert cli.main(line.split()) == 0
    assert driver.calls == [call]


@pytest.mark.parametrize(
    ("line", "call"),
    [
        ("check", ("clamped_beam", None, False, None)),
        ("check rod:fine --ranks 64", ("rod", "fine", False, 64)),
        ("check rod --set body.spacing=0.2", ("rod", None, True, None)),
    ],
)
def test_check(line, call, driver):
    assert cli.main(line.split()) == 0
    assert driver.calls == [call]


def test_restart(driver):
    assert cli.main(["restart", "results/rod", "--quiet"]) == 4
    assert driver.calls == [(Path("results/rod"), True)]


@pytest.mark.parametrize(
    ("line", "call"),
    [
        ("", (View(None), False, None, False)),
        ("--field damage --animate", (View("damage"), True, None, False)),
        ("--field stress --component xx --step 3", (View("stress", "xx", 3), False, None, False)),
        ("--section y=-0.05", (View(None, section=Section(1, -0.05)), False, None, False)),
        ("--curve", (View(None), False, [], False)),
        ("--curve pull load", (View(None), False, ["pull", "load"], False)),
        ("--convergence", (View(None), False, None, True)),
    ],
)
def test_plot(line, call, driver):
    assert cli.main(["plot", "results/rod", *line.split()]) == 0
    assert driver.calls == [(Path("results/rod"), *call)]


def test_report(driver):
    assert cli.main(["report", "results/rod"]) == 0
    assert driver.calls == [Path("results/rod")]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "rodd",
            "unknown word 'rodd' (did you mean 'rod'?); commands: run, check, new, list, restart, plot, ",
        ),
        ("rodd:fine", "unknown word 'rodd:fine' (did you mean 'rod'?)"),
        ("rnu rod", "unknown word 'rnu' (did you mean 'run'?)"),
        ("rod clamped_beam", "more than one case: rod, clamped_beam"),
        ("rod:coarse", "rod.toml: there is no variant 'coarse'; choices: fine"),
        ("no.toml", "no.toml: there is no such file"),
        ("rod --set body.spacing", "--set body.spacing: must be key=value"),
        ("rod --set body.spacing=-1", "rod.toml: body.spacing: must be greater than 0, not -1"),
        ("rod --ouput x", "unrecognized arguments: --ouput x (did you mean '--out'?); see pdpetsc --help"),
        ("rod --out", "argument --out: expected one argument; see pdpetsc --help"),
        ("list modles", "unknown word 'modles' (did you mean 'models'?); lists: cases, models, "),
        ("list rod models", "unknown word 'models'"),
        ("list no.toml", "no.toml: there is no such file"),
        ("list --out x", "--out goes with run, not with list"),
        ("schema rod", "unknown word 'rod'"),
        ("completion", "completion needs the name of a shell: bash, zsh, fish"),
        ("completion bsh", "completion needs the name of a shell (did you mean 'bash'?)"),
        ("new plate", "new writes a file that ends in .toml, not 'plate'"),
        ("restart", "restart needs the directory of an earlier result"),
        ("restart x --set a=1", "--set goes with run, check, not with restart"),
        ("plot", "plot needs the directory of an earlier result"),
        ("plot x --out y", "--out goes with run, not with plot"),
        ("rod --animate", "--animate goes with plot, not with run"),
        ("rod --field u", "--field goes with plot, not with run"),
        ("report", "report needs the directory of an earlier result"),
        ("plot x --curve a", "--curve takes two columns of history.csv, x and y, or none, and stands behind"),
        ("plot x --field u --convergence", "--convergence does not go with --field: one picture at a time"),
        ("plot x --convergence --curve", "--curve does not go with --convergence: one picture at a time"),
        ("plot x --animate --step 2", "--animate draws all steps, so it does not go with --step"),
        ("plot x --section w=2", "--section w=2: must be a plane across an axis, as x=0.05"),
        ("plot x --step last", "invalid int value: 'last'"),
        ("check rod --curve", "--curve goes with plot, not with check"),
        ("report rod --convergence", "--convergence goes with plot, not with report"),
        ("check rod clamped_beam", "more than one case: rod, clamped_beam"),
        ("check rod:coarse", "rod.toml: there is no variant 'coarse'; choices: fine"),
        ("check rod --set body.spacing=-1", "rod.toml: body.spacing: must be greater than 0, not -1"),
        ("check rod --out x", "--out goes with run, not with check"),
        ("check rod --ranks 0", "--ranks is a positive number of ranks"),
        ("check rod --ranks many", "argument --ranks: invalid int value: 'many'"),
        ("rod --ranks 2", "--ranks goes with check, not with run"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(line, message, driver, capsys):
    assert cli.main(line.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("pdpetsc: error: ") and said.err.count("\n") == 1
    assert message in said.err
    assert driver.calls == []


@pytest.mark.parametrize(("error", "code"), [(InputError("no horizon"), 2), (ConvergenceError("diverged"), 3)])
def test_errors_of_the_driver(error, code, driver, capsys):
    def fail(*_):
        raise error

    driver.run = fail
    assert cli.main(["rod"]) == code
    assert capsys.readouterr().err == f"pdpetsc: error: {error}\n"


@pytest.mark.parametrize(
    "line",
    ["--version", "--help", "list", "list clamped_beam:rows3_d2", "list models", "schema", "completion fish"],
)
def test_what_needs_no_petsc_is_answered_without_it(line, run_pdpetsc):
    """And without MPI; under mpirun, by one of the ranks."""
    code = "import sys; sys.modules |= {'mpi4py': None, 'petsc4py': None}; from pdpetsc.__main__ import main; main()"
    command = [sys.executable, "-c", code, *line.split()]
    alone = subprocess.run(command, env=conftest.environment_for_mpirun(), capture_output=True, text=True)
    assert (alone.returncode, alone.stderr) == (0, "") and alone.stdout
    assert line != "--version" or run_pdpetsc(2, line).stdout == alone.stdout


def test_list(capsys):
    assert cli.main(["list"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "clamped_beam  A beam",
        "              variants: rows3",
        "rod           A rod",
        "              variants: fine",
    ]


@pytest.mark.parametrize("line", ["-h", "--help", "rod --help"])
def test_help(line, capsys):
    assert cli.main(line.split()) == 0
    said = capsys.readouterr().out
    assert "pdpetsc restart DIR" in said and "mpirun -n 4" in said and max(map(len, said.splitlines())) <= 100


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(command, capsys):
    """Its options and no others."""
    assert cli.main([command, "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"pdpetsc {'[run]' if command == 'run' else command}")
    assert max(map(len, said.splitlines())) <= 100
    for option, about in OPTIONS.items():
        assert (re.search(rf"^  {option}\b", said, re.M) is not None) == (command in about.commands)


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"pdpetsc {pdpetsc.__version__}\n"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("rod", {"ksp_type": "cg"}),
        ("rod --set petsc.ksp_type=gmres --set petsc.x=1", {"ksp_type": "gmres", "x": 1}),
        ("check rod --ranks 3", {"ksp_type": "cg"}),
        ("nonsense", {}),
        ("no.toml", {}),
        ("rod --set body.spacing=-1", {}),
        ("--nonsense", {}),
        ("list", {}),
        ("restart nowhere", {}),
        ("restart earlier", {"ksp_type": "cg"}),
        ("restart earlier/checkpoint.h5", {"ksp_type": "cg"}),
    ],
)
def test_petsc_defaults_pass_over_mistakes(line, expected, tmp_path):
    (tmp_path / "earlier").mkdir()
    (tmp_path / "earlier" / "case.toml").write_text(ROD)
    assert cli.petsc_defaults(line.split()) == expected


def test_missing_petsc4py_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "petsc4py", None)
    monkeypatch.setattr(sys, "argv", ["pdpetsc"])
    assert __main__.main() == 2
    said = capsys.readouterr().err
    assert said.startswith("pdpetsc: error: petsc4py is missing; on Debian or Ubuntu 'scripts/setup' installs it")
    assert said.count("\n") == 1


def test_bad_input_on_several_ranks(run_pdpetsc):
    run = run_pdpetsc(2, "-snes_monitor", "no.toml", limit=60)
    assert run.returncode == 2
    assert run.stderr.count("pdpetsc: error: no.toml: there is no such file") == 1
    assert "Traceback" not in run.stderr and "MPI_ABORT" not in run.stderr


@pytest.mark.parametrize(("change", "code"), [("solver.steps=2", 0), ("body.spacing=-1", 2)])
def test_json_lines(change, code, run_pdpetsc):
    """Each line of standard output is an event, on several ranks too, and the last one tells the exit code."""
    run = run_pdpetsc(2, "clamped_beam", "--set", change, "--json-lines", "--out", "it", "-nobody", "1", limit=300)
    events = [json.loads(text) for text in run.stdout.splitlines()]
    names = [event["event"] for event in events]
    assert run.returncode == code and events[-1] == {"event": "end", "exit_code": code}
    if code:
        assert names == ["error", "end"] and run.stderr.count("pdpetsc: error: ") == 1
        return
    assert [name for name in names if name != "warning"] == ["start", "step", "step", "result", "end"]
    start, first, result = (events[names.index(name)] for name in ("start", "step", "result"))
    assert (start["particles"], start["ranks"], first["step"], first["time"]) == (456, 2, 1, 0.5)
    assert (result["status"], result["results"]) == ("converged", "it")
    assert any("-nobody" in event["text"] for event in events if event["event"] == "warning")


def test_colours_are_for_terminals_without_other_ranks(monkeypatch):
    class Screen(io.StringIO):
        def isatty(self):
            return True

    for name in (*terminal.LAUNCHERS, "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert terminal.painted("x", "red", Screen()) == "\033[31mx\033[0m"
    assert terminal.painted("x", "red", io.StringIO()) == "x"
    for name, value in (("NO_COLOR", "1"), ("TERM", "dumb"), ("OMPI_COMM_WORLD_SIZE", "1")):
        with monkeypatch.context() as changed:
            changed.setenv(name, value)
            assert terminal.painted("x", "red", Screen()) == "x"


def test_compiling_is_announced_once(capsys):
    from mpi4py import MPI

    with compiling_announced(MPI.COMM_SELF, False):
        njit(lambda x: x + 1)(1)
        njit(lambda x: x + 2)(1)
    with compiling_announced(MPI.COMM_SELF, True):
        njit(lambda x: x + 3)(1)
    said = capsys.readouterr().out
    assert said.count("compiling kernels, once for this version and kind of model") == said.count("\n") == 1
