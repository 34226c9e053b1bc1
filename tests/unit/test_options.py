"""PETSc's options: told from ours, given in the right order, and checked for use."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from pdpetsc import options


def is_case(word):
    return word.endswith(".toml") or ".toml:" in word or word.partition(":")[0] == "clamped_beam"


@pytest.mark.parametrize(
    ("line", "ours", "petsc"),
    [
        ("", "", ""),
        ("my.toml -ksp_type cg", "my.toml", "-ksp_type cg"),
        ("-ksp_type cg my.toml", "my.toml", "-ksp_type cg"),
        ("-snes_monitor my.toml", "my.toml", "-snes_monitor"),
        ("-snes_monitor my.toml:fine -ksp_view", "my.toml:fine", "-snes_monitor -ksp_view"),
        ("-snes_monitor clamped_beam:rows3_d1", "clamped_beam:rows3_d1", "-snes_monitor"),
        ("-shift -1.5 -other -.5e-3 my.toml", "my.toml", "-shift -1.5 -other -.5e-3"),
        ("-snes_monitor --out DIR my.toml", "--out DIR my.toml", "-snes_monitor"),
        ("-log_view :log.txt --quiet", "--quiet", "-log_view :log.txt"),
        ("-log_view -h", "-h", "-log_view"),
        ("-help", "", "-help"),
        ("run --set body.spacing=1 -pc_type lu plate", "run --set body.spacing=1 plate", "-pc_type lu"),
        ("--set load.0.value=-1 -a b c", "--set load.0.value=-1 c", "-a b"),
    ],
)
def test_split(line, ours, petsc):
    assert options.split(line.split(), is_case) == (ours.split(), petsc.split())


def in_a_new_process(script: str, **environment) -> dict:
    """PETSc starts once in a process: run a script that prints JSON."""
    run = subprocess.run(
        [sys.executable, "-c", "import json\nfrom pdpetsc import options\n" + textwrap.dedent(script)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert run.stderr == ""
    return json.loads(run.stdout.splitlines()[0])


def test_command_line_wins_over_environment_wins_over_defaults():
    found = in_a_new_process(
        """
        options.start(["-a", "line", "-flag"], {"a": "case", "b": "case", "c": 1e-10, "d": -2, "e": True, "f": False,
                                                "g": "two words", "h": ""})
        from petsc4py import PETSc
        given = PETSc.Options()
        assert given.getString("g") == "two words"
        print(json.dumps(given.getAll() | {"g": given.getString("g")}))
        """,
        PETSC_OPTIONS="-a environment -b environment",
    )
    expected = {"a": "line", "b": "environment", "c": "1e-10", "d": "-2", "e": None, "f": "false", "g": "two words"}
    assert {key: found[key] for key in expected} == expected
    assert found["h"] is None and found["flag"] is None


def test_options_of_the_start_work_as_defaults():
    found = in_a_new_process(
        """
        options.start([], {"log_view": ":/dev/null"})
        from petsc4py import PETSc
        print(json.dumps([PETSc.Log.isActive() if hasattr(PETSc.Log, "isActive") else True, options.unused()]))
        """
    )
    assert found == [True, []]


def test_unused_options_are_named_once():
    found = in_a_new_process(
        """
        options.start(["-ksp_type", "cg", "-snes_montior", "-get_total_flops"], {"ksp_rtoll": 1e-3, "pc_type": "none"})
        from petsc4py import PETSc
        ksp = PETSc.KSP().create()
        ksp.setFromOptions()
        assert ksp.getType() == "cg"
        print(json.dumps(options.unused()))
        """,
        PETSC_OPTIONS="-from_environment 1",
    )
    assert found == ["from_environment", "ksp_rtoll", "snes_montior"]
