"""The Python API: the examples of its page, cases as dictionaries, classes of one's own, one run after another."""

import re
import subprocess
import sys
from pathlib import Path

import conftest
import numpy as np
import pytest

import pdpetsc
from pdpetsc.errors import ConvergenceError, InputError

DOCS = Path(__file__).parents[2] / "docs"
BAR = {
    "body": {"size": [10.0], "spacing": np.float64(1.0), "horizon": 2.015},
    "sets": {"left": "X < 1", "right": "X > 9"},
    "material": {"m": {"model": "correspondence", "E": 100.0, "nu": 0.0}},
    "load": (
        {"kind": "displacement", "set": "left", "component": "x", "value": 0.0},
        {"kind": "force", "set": "right", "component": "x", "value": "t"},
    ),
    "solver": {"steps": 2},
    "probe": [{"name": "end", "field": "u", "component": "x", "set": "right", "reduce": "mean"}],
}


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("example", ["plate", "spinning_strip", "crack_watch"])
def test_examples_hold_what_they_assert(tmp_path, example, ranks):
    launcher = [] if ranks == 1 else [conftest.mpirun(), "-n", str(ranks)]
    command = [*launcher, sys.executable, str(DOCS / "examples" / f"{example}.py")]
    run = subprocess.run(
        command, cwd=tmp_path, env=conftest.environment_for_mpirun(), capture_output=True, text=True, timeout=300
    )
    assert run.returncode == 0, run.stderr


def test_the_page_quotes_the_examples():
    examples = "\n".join(path.read_text() for path in (DOCS / "examples").glob("*.py"))
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "python.md").read_text(), re.S)
    assert len(blocks) == 3
    assert all(block in examples for block in blocks)


def test_the_package_is_cheap_to_import():
    code = "import sys, pdpetsc; pdpetsc.load('clamped_beam'); print(*{'petsc4py', 'mpi4py'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout.split() == []


def test_overrides_leave_the_tables_as_they_were():
    case = pdpetsc.load(BAR, {"load.1.value": 2.0, "body.thickness": 3.0})
    assert case.load[1].value.text == "2.0" and case.body.thickness == 3.0 and case.overridden
    assert BAR["load"][1]["value"] == "t" and not pdpetsc.load(BAR).overridden
    with pytest.raises(InputError, match=r"override load.7.value: there is no entry '7' to set"):
        pdpetsc.load(BAR, {"load.7.value": 1.0})
    with pytest.raises(InputError, match=r"case: load.0.kind: must be one of"):
        pdpetsc.load(BAR, {"load.0.kind": "shove"})


def test_classes_of_ones_own_are_known_and_may_be_defined_again():
    def define(least):
        class Shove(pdpetsc.Load):
            name = "shove"

            class Keys(pdpetsc.Load.Keys):
                strength: float = least

        return Shove

    changes = {"load.1": {"kind": "shove", "set": "right", "value": 1.0}}
    try:
        for least in (1.0, 2.0):
            define(least)
            assert pdpetsc.load(BAR, changes).load[1].strength == least
        with pytest.raises(InputError, match=r"load.1.strength: must be a number"):
            pdpetsc.load(BAR, changes | {"load.1.strength": "much"})
    finally:
        del pdpetsc.Load.kinds["shove"]
    with pytest.raises(InputError, match="must be one of"):
        pdpetsc.load(BAR, changes)


@pytest.mark.mpi
def test_one_run_after_another(comm, petsc_options):
    first = pdpetsc.solve(pdpetsc.load(BAR))
    loose = pdpetsc.solve(pdpetsc.load(BAR, {"petsc.ksp_type": "cg", "petsc.pc_type": "jacobi"}))
    again = pdpetsc.solve(pdpetsc.load(BAR))
    assert loose.summary["choices"]["preconditioner"] != first.summary["choices"]["preconditioner"]
    assert again.summary["choices"] == first.summary["choices"]
    assert np.array_equal(first.field("u"), again.field("u"))
    assert first.status == "converged" and first.history("time").tolist() == [0.5, 1.0]
    assert first.history("end")[-1] == first.summary["probes"]["end"]


@pytest.mark.mpi
def test_fields_are_this_ranks_or_whole(comm, petsc_options):
    run = pdpetsc.build(pdpetsc.load(BAR))
    assert run.status == "built" and run.field("u", gather=True).shape == (10, 1)
    assert run.solve() == "converged"
    whole, X = run.field("u", gather=True), run.field("position", gather=True)
    assert np.array_equal(X[:, 0], np.arange(10) + 0.5)
    assert np.array_equal(whole[run.field("id")], run.field("u"))
    assert run.field("stress", gather=True).shape == (10, 3, 3)
    assert comm.allreduce(len(run.field("stress"))) == 10
    with pytest.raises(InputError, match="there is no field 'stres'"):
        run.field("stres")
    with pytest.raises(InputError, match="there is no probe or column 'tip'"):
        run.history("tip")


class Stopper(pdpetsc.Observer):
    """Stops at a step; knows whether it was told of the end."""

    finished = False

    def step(self, run):
        if run.state.step == 2:
            raise pdpetsc.Stop

    def finish(self, run):
        self.finished = True


@pytest.mark.mpi
@pytest.mark.parametrize(
    "changes",
    [
        {"solver.steps": 5},
        {"solver": {"mode": "verlet", "end_time": 5.0}, "material.m.density": 1.0, "output.history": 1},
    ],
)
def test_observers_stop_runs(comm, petsc_options, changes):
    stopper = Stopper()
    run = pdpetsc.solve(pdpetsc.load(BAR, changes), observers=[stopper])
    assert run.status == "stopped" and run.state.step == 2 and stopper.finished


@pytest.mark.mpi
def test_a_run_that_fails_can_still_be_asked(comm, petsc_options):
    run = pdpetsc.build(pdpetsc.load(BAR, {"load.1.value": "-300 * t", "solver.adaptive": False}))
    with pytest.raises(ConvergenceError):
        run.solve()
    assert run.status == run.summary["status"] == "not_converged"


@pytest.mark.mpi
def test_files_are_written_on_request(comm, petsc_options, shared_tmp_path):
    run = pdpetsc.solve(pdpetsc.load(BAR), out=shared_tmp_path / "bar")
    assert (shared_tmp_path / "bar" / "summary.json").exists() and (shared_tmp_path / "bar" / "case.toml").exists()
    assert run.summary["status"] == "converged"
