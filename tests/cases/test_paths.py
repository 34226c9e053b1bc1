"""Whole runs along a path on which t falls: what is written."""

import csv
from xml.etree import ElementTree

import pytest
from bodies import ARCH

pytestmark = pytest.mark.mpi


def test_run_along_a_path(run):
    result = run(ARCH | {"solver": ARCH["solver"] | {"steps": 3}, "output": {"fields": ["u"]}})
    assert result.code == 0, result.errors
    summary = result.summary
    assert summary["choices"]["control"] == "arc_length" and summary["unused_options"] == []
    first, second = summary["limit_points"]
    times = [step["time"] for step in summary["steps"]]
    assert first["time"] == pytest.approx(max(times[: second["step"]]), rel=0.05) and first["time"] > second["time"] > 0
    assert times[-1] == 1.0 and summary["balance"]["force"] < 1e-12
    with (result.out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time"]) for row in rows] == times
    assert all(float(row["arc_length"]) > 0 for row in rows)
    shown = [float(grid.get("Value")) for grid in ElementTree.parse(result.out / "fields.xdmf").iter("Time")]
    assert shown == list(range(1, len(times) + 1))  # times must ascend


def test_limit_of_steps_goes_with_paths(run):
    result = run(ARCH | {"solver": {"max_steps": 5}})
    assert result.code == 2
    if "error" in result.errors:
        assert 'solver.max_steps: goes with control = "arc_length"' in result.errors
