"""Whole runs in which bonds fail: how they end, what is written, what a case file may ask for."""

import csv
import json

import h5py
import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc import cli
from pdpetsc.case import Case
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

STRIP = {  # two columns of particles clamped at either end, pulled apart; the load is beyond what it bears
    "body": {"size": [12.0, 4.0], "spacing": 1.0, "horizon": 2.015},
    "sets": {"left": "X < 2", "right": "X > 10", "ends": "X < 4 or X > 8"},
    "material": {"m": {"model": "ordinary", "E": 1.0, "nu": 0.25}},
    "damage": {"m": {"criterion": "critical_stretch", "critical": 0.002, "exempt": ["ends"]}},
    "load": [
        {"kind": "displacement", "set": "left", "component": "all", "value": 0.0},
        {"kind": "displacement", "set": "right", "component": "x", "value": "0.04 * t"},
        {"kind": "displacement", "set": "right", "component": "y", "value": 0.0},
    ],
    "probe": [
        {"name": "damage", "field": "damage", "set": "all", "reduce": "max"},
        {"name": "pull", "field": "reaction", "component": "x", "set": "right", "reduce": "sum"},
        {"name": "middle", "field": "damage", "at": [6.0, 2.0]},
    ],
}  # fmt: skip


FORCE = {"kind": "force", "set": "right", "component": "x", "value": "0.08 * t"}


def changed(table: str, **entries) -> dict:
    """The strip with entries of a table."""
    inner = STRIP.get(table, {})
    return STRIP | {table: {"m": inner["m"] | entries} if "m" in inner else inner | entries}


def rows_of(result) -> list[dict]:
    with (result.out / "history.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_body_that_comes_apart(comm, run):
    """That is a result: exit code 0, status "separated"; and nothing is left to do for a restart."""
    result = run(STRIP)
    assert result.code == 0, result.errors
    summary, rows = result.summary, rows_of(result)
    assert (summary["status"], summary["converged"]) == ("separated", True)
    last = summary["steps"][-1]
    assert last["time"] < 1.0 and last["broken_bonds"] > 0 and last["passes"] > 1
    assert [int(row["broken_bonds"]) for row in rows] == [step["broken_bonds"] for step in summary["steps"]]
    energies = summary["energies"]
    for key in ("external_work", "dissipated"):
        assert float(rows[-1][key]) == last[key] == energies[key] > 0
    assert float(rows[-1]["stored_energy"]) == last["stored_energy"] < 1e-6 * energies["dissipated"]
    assert abs(energies["imbalance"]) < 1e-3 * energies["external_work"]
    assert rows[-1]["held_particles"] == "0"
    assert float(rows[0]["damage"]) == 0.0 < float(rows[-1]["damage"]) == summary["probes"]["damage"] < 1.0
    assert abs(summary["probes"]["pull"]) < 1e-8 and float(rows[0]["pull"]) > 1e-4
    with h5py.File(result.out / "fields.h5", "r") as file:
        first, end = (file[f"{step['step']:05d}/damage"][...] for step in (summary["steps"][0], last))
    assert not first.any() and end.max() == summary["probes"]["damage"] and end.min() == 0.0
    with h5py.File(result.out / "checkpoint.h5", "r") as file:
        kept = file["damaged/broken_bonds"][...]
    assert kept.shape == (last["broken_bonds"], 3)
    with (result.out / "broken_bonds.csv").open() as file:
        bonds = list(csv.DictReader(file))
    assert [[int(bond[key]) for key in ("i", "j", "step")] for bond in bonds] == kept.tolist()
    times = {step["step"]: step["time"] for step in summary["steps"]}
    assert all(float(bond["time"]) == times[int(bond["step"])] for bond in bonds)
    ends = {(bond["i"], bond["j"]): (bond["X_i"], bond["Y_i"], bond["X_j"], bond["Y_j"]) for bond in bonds}
    assert all(ends[j, i] == (x_j, y_j, x_i, y_i) for (i, j), (x_i, y_i, x_j, y_j) in ends.items())


def test_restart_where_a_body_has_come_apart(comm, run, capsys):
    """Nothing is left to do, and that is no mistake."""
    result = run(STRIP)
    before = result.summary["steps"]
    capsys.readouterr()
    assert cli.main(["restart", str(result.out)]) == 0
    assert comm.rank or "the run has already come to its end, t = " in capsys.readouterr().err
    comm.Barrier()
    after = json.loads((result.out / "summary.json").read_text())
    assert after["steps"] == before and after["status"] == "separated"


def test_a_dead_load_that_tears(run):
    """A force has no equilibrium any more as soon as what it pulls is loose: that half is held, and the run ends."""
    result = run(STRIP | {"load": [STRIP["load"][0], FORCE]})
    assert result.code == 0, result.errors
    end = result.summary["steps"][-1]
    assert result.summary["status"] == "separated" and end["held_particles"] == 24
    assert abs(result.summary["energies"]["imbalance"]) < 1e-3 * end["external_work"]


def test_damage_is_written_where_bonds_fail(run):
    """And where it is asked for."""
    whole = {key: table for key, table in STRIP.items() if key != "damage"} | {"solver": {"steps": 1}}
    for document, written in ((whole, False), (changed("damage", critical=0.9) | {"solver": {"steps": 1}}, True)):
        result = run(document | {"output": {"fields": ["u"]}})
        assert result.code == 0, result.errors
        assert result.summary["steps"][0]["broken_bonds"] == 0 and result.summary["status"] == "converged"
        assert ("dissipated" in result.summary["energies"]) == written
        with h5py.File(result.out / "fields.h5", "r") as file:
            assert ("damage" in file["00001"]) == written


def test_damage_counts_cut_and_broken_bonds(comm):
    """A plate of 4 x 4 cells with 8 neighbours, a crack halfway across, and one broken pair."""
    document = STRIP | {
        "body": {
            "size": [4.0, 4.0], "spacing": 1.0, "horizon": 1.515, "cracks": [{"from": [-1.0, 2.0], "to": [2.2, 2.0]}]
        },
        "sets": {"left": "X < 1", "right": "X > 3"},
        "damage": {"m": {"criterion": "critical_stretch", "critical": 1.0}},
    }  # fmt: skip
    document = {key: table for key, table in document.items() if key != "probe"}
    built = Simulation(Case.from_document(document, "plate", None, "plate.toml", False), PETSc.COMM_WORLD)
    p, families = built.particles, built.fracture.families
    X = p.position
    i, j = X[families.per_bond(np.arange(p.local))], X[families.neighbours]
    pair = (i[:, 1] == 0.5) & (j[:, 1] == 0.5) & (np.minimum(i, j)[:, 0] == 2.5) & (np.maximum(i, j)[:, 0] == 3.5)
    assert built.fracture.fail(np.zeros((p.owned, 2)), np.where(pair, 1.5, 0.0), 1) == 2
    built.__dict__.pop("recovery", None)
    expected = {(0.5, 1.5): 2 / 5, (1.5, 1.5): 3 / 8, (2.5, 1.5): 1 / 8, (3.5, 1.5): 0.0, (0.5, 0.5): 0.0}
    expected |= {(3.5, 0.5): 1 / 3, (2.5, 0.5): 1 / 5, (0.5, 2.5): 2 / 5, (1.5, 2.5): 3 / 8, (2.5, 2.5): 1 / 8}
    found = dict(zip(map(tuple, X[: p.owned].tolist()), built.recovery.damage))
    found = {point: value for part in comm.allgather(found) for point, value in part.items()}
    for point, value in found.items():
        assert value == pytest.approx(expected.get(point, 0.0), abs=1e-14), point


@pytest.mark.parametrize("model", ["ordinary", "correspondence"])
def test_failure_by_failure(run, model):
    """The whole path, to where the strip comes apart."""
    document = changed("material", model=model) | {"solver": {"control": "failure", "steps": 5}}
    result = run(document)
    assert result.code == 0, result.errors
    steps = result.summary["steps"]
    assert result.summary["status"] == "separated" and result.summary["choices"]["control"] == "failure"
    assert all(step["passes"] == 1 for step in steps)
    broken = [step["broken_bonds"] for step in steps]
    assert broken[0] == 0 and all(np.diff(broken) > 0), "each step begins with what the last one brought to its end"
    for step in steps:
        missing = step["external_work"] - step["stored_energy"] - step["dissipated"]
        assert abs(missing) < 0.01 * step["external_work"]


def test_failure_by_failure_until_no_bond_can_fail(run):
    """The lower half does not fail: what is left is loaded to the end."""
    document = changed("damage", exempt=["ends", "lower"])
    document |= {"sets": STRIP["sets"] | {"lower": "Y < 2"}, "solver": {"control": "failure"}}
    result = run(document)
    assert result.code == 0, result.errors
    assert result.summary["status"] == "converged" and result.summary["steps"][-1]["time"] == 1.0
    before, end = result.summary["steps"][-2:]
    assert before["time"] < 1.0 and 0 < before["broken_bonds"] <= end["broken_bonds"]
    assert result.summary["steps"][-1]["relative_residual"] < 1e-8


def test_weighted_volume(run):
    """Bonds that are left carry what the broken ones did where the weighted volume is updated: more fail."""
    results = []
    for name in ("frozen", "updated"):
        result = run(changed("material", weighted_volume=name), out=name)
        assert result.code == 0, result.errors
        assert result.summary["choices"]["materials"]["m"]["weighted_volume"] == name
        results.append(result.summary)
    frozen, updated = (summary["energies"]["dissipated"] for summary in results)
    assert frozen != pytest.approx(updated, rel=1e-3)
    first = [next(s for s in summary["steps"] if s["broken_bonds"]) for summary in results]
    assert first[0]["time"] == first[1]["time"]  # nothing differs before


def test_exempt_set_without_particles(comm, run):
    result = run(STRIP | {"sets": STRIP["sets"] | {"ends": "X > 99"}})
    assert result.code == 2
    assert comm.rank or "sets.ends: no particle lies in this set" in result.errors
