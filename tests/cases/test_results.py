"""Whole runs as a user starts them: `python -m pdpetsc`, on several numbers of ranks."""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import conftest
import h5py
import meshio
import numpy as np
import pytest

CLOSE = 1e-10  # results do not depend on the number of ranks (direct solver)
STEPS = 4


def summary_of(directory: Path) -> dict:
    return json.loads((directory / "summary.json").read_text())


def fields_of(directory: Path) -> dict[str, np.ndarray]:
    """All data sets of fields.h5 by their paths."""
    found = {}
    with h5py.File(directory / "fields.h5", "r") as file:
        file.visititems(lambda name, item: found.update({name: item[...]}) if isinstance(item, h5py.Dataset) else None)
    return found


def assert_same_fields(a: Path, b: Path):
    left, right = fields_of(a), fields_of(b)
    assert list(left) == list(right)
    for name, values in left.items():
        size = np.abs(values).max() or 1.0
        assert np.abs(values - right[name]).max() <= CLOSE * size, name


def assert_same_summaries(a: Path, b: Path):
    left, right = summary_of(a), summary_of(b)
    for key in ("case", "status", "dim", "particles", "bonds"):
        assert left[key] == right[key]
    assert left["choices"]["materials"] == right["choices"]["materials"]  # the linear solver may depend on the ranks
    assert left["probes"].keys() == right["probes"].keys()
    for name, value in left["probes"].items():
        assert np.allclose(value, right["probes"][name], rtol=CLOSE, atol=0)
    assert left["energies"]["stored"] == pytest.approx(right["energies"]["stored"], rel=CLOSE)
    assert len(left["steps"]) == len(right["steps"])
    for one, other in zip(left["steps"], right["steps"]):
        for key in ("step", "time", "load_factor", "broken_bonds"):
            assert one[key] == other[key]
        assert one["residual_scale"] == pytest.approx(other["residual_scale"], rel=CLOSE)
        first = (one["residual_norms"][0], other["residual_norms"][0])
        assert first[0] == pytest.approx(first[1], rel=1e-6)


def said_by_us(run) -> list[str]:
    """Lines of the error stream that are not mpirun's own remarks on an exit code."""
    assert "Traceback" not in run.stderr and "MPI_ABORT" not in run.stderr
    return [line for line in run.stderr.splitlines() if line.startswith("pdpetsc")]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return tmp_path_factory.mktemp("results")


@pytest.mark.parametrize("ranks", (None, 2, 3))
def test_bundled_case(run_pdpetsc, results, ranks):
    """`clamped_beam`, as it is: its expectations are met, and every file of the contract is there."""
    out = results / f"beam{ranks or 1}"
    run = run_pdpetsc(ranks, "clamped_beam", "--out", out)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stderr == ""
    assert run.stdout.count("MISSED") == 0
    assert run.stdout.count("step      time") == 1  # said by the first rank alone
    summary = summary_of(out)
    assert summary["ranks"] == (ranks or 1)
    assert summary["converged"] and summary["status"] == "converged"
    assert summary["expect"] and all(e["met"] for e in summary["expect"])
    assert summary["unused_options"] == []
    assert summary["balance"]["force"] < 1e-14 and summary["balance"]["moment"] < 1e-14
    assert set(summary["timings"]) == {
        "setup", "families", "first_tangent", "residual", "tangent", "solve", "output", "total",
    }  # fmt: skip
    assert all(seconds >= 0 for seconds in summary["timings"].values())
    files = {"summary.json", "history.csv", "fields.h5", "fields.xdmf", "result.png", "checkpoint.h5", "case.toml"}
    assert {path.name for path in out.iterdir()} == files
    if ranks:
        assert_same_summaries(results / "beam1", out)
        assert_same_fields(results / "beam1", out)


# A run that ends at a checkpoint: as after a power cut, on all ranks at once.
CUT = """
import sys
from pdpetsc import __main__, cli
go = cli.main
def main(arguments):
    from pdpetsc import observers
    write = observers.Checkpoint.step
    def step(self, run):
        write(self, run)
        if run.state.step == {step}:
            sys.stdout.flush()
            raise SystemExit(99)
    observers.Checkpoint.step = step
    return go(arguments)
cli.main = main
sys.exit(__main__.main())
"""


def run_until(step, ranks, *arguments):
    """A run that is ended after a step, once its checkpoint is written."""
    launcher = [] if ranks is None else [conftest.mpirun(), "-n", str(ranks)]
    return subprocess.run(
        [*launcher, sys.executable, "-c", CUT.format(step=step), *map(str, arguments)],
        env=conftest.environment_for_mpirun(), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120,
    )  # fmt: skip


SMALL = ("clamped_beam", "--set", f"solver.steps={STEPS}", "--set", "output.picture=u")


@pytest.fixture(scope="module")
def uninterrupted(results):
    return results / "whole"


@pytest.mark.parametrize(("before", "after", "step"), [(None, 3, 2), (3, 2, 3)])
def test_restart_on_other_ranks(run_pdpetsc, results, uninterrupted, before, after, step):
    if not uninterrupted.exists():
        assert run_pdpetsc(None, *SMALL, "--out", uninterrupted).returncode == 0
    out = results / f"cut{step}"
    run = run_until(step, before, *SMALL, "--out", out)
    assert run.returncode == 99, run.stdout + run.stderr
    assert not (out / "summary.json").exists()
    run = run_pdpetsc(after, "restart", out)
    assert run.returncode == 0, run.stdout + run.stderr
    assert_same_summaries(uninterrupted, out)
    assert_same_fields(uninterrupted, out)
    with (out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == list(range(1, STEPS + 1))
    assert [float(row["time"]) for row in rows] == [k / STEPS for k in range(1, STEPS + 1)]
    assert (out / "case.toml").read_text() == (uninterrupted / "case.toml").read_text()


def test_xdmf_opens(run_pdpetsc, results, uninterrupted):
    """With meshio's reader of time series, as ParaView would."""
    if not uninterrupted.exists():
        assert run_pdpetsc(None, *SMALL, "--out", uninterrupted).returncode == 0
    fields = fields_of(uninterrupted)
    with meshio.xdmf.TimeSeriesReader(uninterrupted / "fields.xdmf") as reader:
        points, cells = reader.read_points_cells()
        assert np.array_equal(points, fields["position"])
        assert [block.type for block in cells] == ["vertex"]
        assert np.array_equal(cells[0].data.ravel(), np.arange(len(points)))
        assert reader.num_steps == STEPS
        for k in range(STEPS):
            time, point_data, _ = reader.read_data(k)
            assert time == pytest.approx((k + 1) / STEPS)
            for name in ("u", "F", "stress", "strain", "energy", "reaction", "force"):
                stored = fields[f"{k + 1:05d}/{name}"]
                assert np.array_equal(np.reshape(point_data[name], stored.shape), stored)
            assert np.array_equal(point_data["volume"], fields["volume"])


BAD = """
[body]
size = [12.0, 3.0]
spacing = 1.0
horizon = 1.515
[material.rubber]
model = "correspondence"
E = 1.0
nu = 0.25
[[load]]
kind = "displacement"
set = "all"
component = "all"
value = {value}
"""


def test_bad_input_ends_with_two(run_pdpetsc, tmp_path):
    """Found on one rank of two (X > 11), said once, and without a directory of results; test_runs.py has more."""
    (tmp_path / "bad.toml").write_text(BAD.format(value='"log(11.2 - X)"'))
    run = run_pdpetsc(2, "bad.toml", limit=60)
    assert run.returncode == 2
    (line,) = said_by_us(run)
    assert line.startswith("pdpetsc: error: bad.toml: load.0.value: 'log(11.2 - X)' is nan at X = 11.5")
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]


def test_a_foreign_directory_is_refused(run_pdpetsc, tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("Abstract")
    run = run_pdpetsc(2, "clamped_beam", "--out", "thesis", limit=60)
    assert run.returncode == 2
    (line,) = said_by_us(run)
    assert "thesis: holds more than a result of pdpetsc" in line
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "Abstract"


def test_not_converged_ends_with_three(run_pdpetsc, tmp_path):
    """With results up to there, the reason said once, and no traceback."""
    run = run_pdpetsc(
        2, "clamped_beam", "--set", "load.1.value=276e6*t", "--set", "solver.adaptive=false", "--set", "solver.steps=2"
    )
    assert run.returncode == 3, run.stdout + run.stderr
    (line,) = said_by_us(run)
    assert re.search(r"load step 1,? from t = 0 to 0\.5,? did not converge: DIVERGED_\w+", line)
    summary = summary_of(tmp_path / "results" / "clamped_beam")
    assert summary["status"] == "not_converged" and not summary["converged"]
