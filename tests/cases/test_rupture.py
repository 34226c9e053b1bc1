"""A notched plate that is pulled in two: where its bonds may fail, and what summary.json says of the run."""

import csv

import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc import case
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

MIDDLE = [{"from": [0.0, 6.0], "to": [12.0, 6.0]}]


def plate(along=MIDDLE, criterion="equivalent_strain", two=False) -> dict:
    """12 x 12 cells with a crack from the left side to the middle, pulled apart at both ends; of one material, or
    of two of which only the upper one fails."""
    document = {
        "body": {
            "size": [12.0, 12.0], "spacing": 1.0, "horizon": 2.015,
            "cracks": [{"from": [-1.0, 6.0], "to": [5.0, 6.0]}],
            "layers": {"bottom": 2.0, "top": 2.0},
        },
        "sets": {"bottom": "Y < 0", "top": "Y > 12"},
        "material": {"m": {"model": "correspondence", "E": 1.0, "nu": 0.25}},
        "damage": {"m": {"criterion": criterion, "critical": 0.03, "exempt": ["bottom", "top"]}},
        "load": [
            {"kind": "displacement", "set": name, "component": "all", "value": 0.0} for name in ("bottom", "top")
        ],
        "solver": {"steps": 4, "overshoot": 1e3, "bonds_per_pass": 0.7},
        "probe": [{"name": "pull", "field": "reaction", "component": "y", "set": "top", "reduce": "sum"}],
    }  # fmt: skip
    document["load"].append({"kind": "displacement", "set": "top", "component": "y", "value": "0.8 * t"})
    if along:
        document["damage"]["m"]["along"] = along
    if two:
        document["sets"] |= {"upper": "Y > 6", "lower": "Y < 6"}
        document["material"]["m"]["where"] = "upper"
        document["material"]["n"] = document["material"]["m"] | {"where": "lower"}
    return document


def broken(document: dict, comm) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) ids of both ends and step of all bonds that fail, in order, and y by id."""
    simulation = Simulation(case.Case.from_document(document, "plate", None, "plate.toml", False), comm)
    simulation.solve()
    p, mpi = simulation.particles, comm.tompi4py()
    y = np.zeros(p.count)
    y[p.id[: p.owned]] = p.position[: p.owned, 1]
    lists = mpi.allgather(simulation.fracture.broken())
    return np.array(sorted(map(tuple, np.concatenate(lists)))), mpi.allreduce(y)


@pytest.mark.parametrize("two", (False, True))
def test_bonds_fail_along_a_line_only(two):
    """Pairs that cross it, both directions, the same on any number of ranks; without it others fail, too."""
    found, y = broken(plate(two=two), PETSc.COMM_WORLD)
    alone, _ = broken(plate(two=two), PETSc.COMM_SELF)
    assert len(found) > 20
    assert np.array_equal(found, alone)
    crosses = (y[found[:, 0]] - 6) * (y[found[:, 1]] - 6) < 0
    assert crosses.all()
    pairs = {(i, j) for i, j, _ in found}
    assert {(j, i) for i, j in pairs} == pairs
    if not two:
        free, _ = broken(plate(along=None), PETSc.COMM_WORLD)
        assert not np.all((y[free[:, 0]] - 6) * (y[free[:, 1]] - 6) < 0)


def test_a_line_that_meets_no_bond(comm, run):
    result = run(plate(along=[{"from": [0.0, 60.0], "to": [12.0, 60.0]}]))
    assert result.code == 2
    assert comm.rank or "damage.m.along: meets no bond" in result.errors


def test_what_the_summary_says(run):
    """That the body is in two pieces, the extremes of probes over all steps and the worst pass can be expected."""
    document = plate(criterion="critical_stretch")
    document["solver"] = {"steps": 16}
    document["expect"] = [
        {"value": "fracture.separated", "equals": 1, "source": "pulled by 7 %"},
        {"value": "extremes.pull.min", "equals": 0.0, "atol": 1e-9, "source": "nothing holds"},
        {"value": "fracture.most_newton_iterations", "below": 9, "source": "measured"},
    ]
    result = run(document)
    assert (result.code, result.summary["status"]) == (0, "separated")
    with (result.out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    pulls = [float(row["pull"]) for row in rows]
    assert result.summary["extremes"] == {"pull": {"min": min(pulls), "max": max(pulls)}}
    assert max(pulls) > 0.01
    assert result.summary["fracture"]["most_newton_iterations"] == max(
        int(row["most_newton_iterations"]) for row in rows
    )


def test_an_extreme_of_no_probe(comm, run):
    document = plate()
    document["expect"] = [{"value": "extremes.pul.max", "equals": 1.0, "source": "a slip of the pen"}]
    result = run(document)
    assert result.code == 2
    assert comm.rank or "names no probe" in result.errors
