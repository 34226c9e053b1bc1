"""Motions through the command line: what is written, restarts, tips of cracks, ghost forces."""

import csv
import json

import numpy as np
import pytest

from pdpetsc import cli

pytestmark = pytest.mark.mpi

PLATE = {
    "body": {
        "size": [12.0, 8.0], "spacing": 1.0, "horizon": 2.015,
        "cracks": [{"from": [-1.0, 4.0], "to": [5.0, 4.0]}],
    },
    "sets": {"top": "Y > 7", "bottom": "Y < 1", "ahead": "X > 4.4"},
    "material": {"glass": {"model": "bond", "E": 1.0, "plane": "stress", "density": 1.0}},
    "damage": {"glass": {"criterion": "critical_stretch", "critical": 0.02, "exempt": ["top", "bottom"]}},
    "load": [
        {"kind": "velocity", "set": "top", "component": "y", "value": 0.02},
        {"kind": "velocity", "set": "bottom", "component": "y", "value": -0.02},
    ],
    "probe": [
        {"name": "tip", "field": "crack_tip", "direction": "x", "set": "ahead"},
        {"name": "speed", "field": "v", "component": "y", "set": "top", "reduce": "mean"},
    ],
    "solver": {"mode": "verlet", "end_time": 30.0, "steps": 100},
    "output": {"every": 25, "history": 10, "checkpoint": 25, "picture": "damage", "curve": {"x": "time", "y": "tip"}},
}  # fmt: skip
"""A plate with an edge crack that is torn in two."""


def test_a_crack_that_runs(run):
    result = run(PLATE)
    assert result.code == 0, result.errors
    summary = result.summary
    assert (summary["status"], summary["choices"]["solver"]) == ("converged", "velocity Verlet")
    assert summary["time_step"]["size"] == 0.3 < summary["time_step"]["stable"]
    with (result.out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == sorted({*range(10, 101, 10), 25, 75})
    tip = np.array([float(row["tip"]) for row in rows])
    assert tip[0] == 4.5 and tip[-1] == 11.5 and (np.diff(tip) >= 0).all()
    assert float(rows[-1]["speed"]) == pytest.approx(0.02)
    energies = summary["energies"]
    assert energies["dissipated"] > 0 and abs(energies["imbalance"]) < 0.01 * energies["external_work"]
    with (result.out / "broken_bonds.csv").open() as file:
        bonds = list(csv.DictReader(file))
    assert len(bonds) == summary["fracture"]["broken_bonds"] == int(rows[-1]["broken_bonds"])
    assert all(float(bond["time"]) == pytest.approx(0.3 * int(bond["step"])) for bond in bonds)
    assert {path.name for path in result.out.iterdir()} >= {"result.png", "curve.png", "fields.h5", "checkpoint.h5"}


def test_restart_has_nothing_left_to_do(comm, run, capsys):
    result = run(PLATE)
    before = result.summary
    capsys.readouterr()
    assert cli.main(["restart", str(result.out)]) == 0
    comm.Barrier()
    after = json.loads((result.out / "summary.json").read_text())
    assert after["steps"] == before["steps"] and after["energies"] == before["energies"]


@pytest.mark.parametrize("dual", (True, False))
def test_ghost_forces(run, dual):
    """Where horizons differ, reactions that are left out take momentum away; dual horizons lose none."""
    plate = {key: PLATE[key] for key in ("body", "material", "solver")}
    plate["body"] = {"size": [12.0, 8.0], "spacing": 1.0, "horizon": 2.015, "refine": "where(X > 6, 2, 1)"}
    plate["material"] = {"glass": PLATE["material"]["glass"] | {"dual": dual}}
    plate["initial"] = [{"component": "x", "displacement": "0.01 * exp(-((X - 5) / 2) ** 2)"}]
    plate["probe"] = [{"name": "drift", "field": "v", "component": "x", "set": "all", "reduce": "mean"}]
    drift = run(plate).summary["extremes"]["drift"]
    largest = max(abs(drift["min"]), abs(drift["max"]))
    assert largest < 1e-15 if dual else largest > 1e-6


DOES_NOT = "does not go with field = 'crack_tip'"


@pytest.mark.parametrize(("keys", "message"), [
    ({"field": "crack_tip"}, "probe.0.direction: is missing"),
    ({"field": "crack_tip", "direction": "x", "component": "x"}, f"probe.0.component: {DOES_NOT}"),
    ({"field": "u", "component": "x", "at": [1.0, 1.0], "threshold": 0.3}, "probe.0.threshold: goes with field = "),
])  # fmt: skip
def test_probes_of_tips(run, comm, keys, message):
    result = run(PLATE | {"probe": [{"name": "tip", **keys}], "output": {}})
    assert result.code == 2
    assert comm.rank or message in result.errors
