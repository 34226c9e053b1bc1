"""Every failure criterion breaks the same bonds in the same steps on any number of ranks."""

import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.damage.base import Criterion
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

PULLED = 0.06  # strain at the end, E = 1
TABLES = {
    "critical_stretch": {"critical": 0.03},
    "equivalent_strain": {"critical": 0.03},
    "volumetric_strain": {"critical": 0.03},
    "bond_energy": {"G_c": 1e-3},
    "principal_stress": {"critical": 0.04, "cohesion": 0.02, "friction_angle": 30.0},
    "bond_strain": {"critical": 0.02},
}


def notched(criterion: str, model: str) -> dict:
    """A plate of 12 x 12 cells with a crack from its left side to the middle, pulled apart at both ends."""
    return {
        "body": {
            "size": [12.0, 12.0], "spacing": 1.0, "horizon": 2.015,
            "cracks": [{"from": [-1.0, 6.0], "to": [5.0, 6.0]}],
            "layers": {"bottom": 2.0, "top": 2.0},
        },
        "sets": {"ends": "Y < 0 or Y > 12", "exempt": "Y < 2 or Y > 10"},
        "material": {"m": {"model": model, "E": 1.0, "nu": 0.25}},
        "damage": {"m": {"criterion": criterion, "exempt": ["exempt"]} | TABLES[criterion]},
        "load": [
            {"kind": "displacement", "set": "ends", "component": "y", "value": f"{PULLED} * t * (Y - 6)"},
            {"kind": "displacement", "set": "ends", "component": "x", "value": 0.0},
        ],
        "solver": {"steps": 3, "overshoot": 1e3, "bonds_per_pass": 0.7},
    }  # fmt: skip


def broken(document: dict, comm) -> np.ndarray:
    """(n, 3) ids of both ends and step of all bonds that fail, in order."""
    simulation = Simulation(Case.from_document(document, "plate", None, "plate.toml", False), comm)
    simulation.solve()
    lists = comm.tompi4py().allgather(simulation.fracture.broken())
    return np.array(sorted(map(tuple, np.concatenate(lists))))


def test_every_criterion_is_here():
    assert set(TABLES) == set(Criterion.criteria)


@pytest.mark.parametrize("model", ["ordinary", "correspondence"])
@pytest.mark.parametrize("criterion", TABLES)
def test_same_bonds_on_any_number_of_ranks(criterion, model):
    document = notched(criterion, model)
    found, alone = broken(document, PETSc.COMM_WORLD), broken(document, PETSc.COMM_SELF)
    assert len(found) > 20
    assert np.array_equal(found, alone)
    pairs = {(i, j) for i, j, _ in found.tolist()}
    assert pairs == {(j, i) for i, j in pairs}


@pytest.mark.parametrize("criterion", TABLES)
def test_an_interface_of_like_materials_is_none(criterion):
    """Bonds between two materials of the same law are as near to failure as those in one."""
    one = notched(criterion, "correspondence")
    two = one | {
        "sets": one["sets"] | {"left": "X < 7", "right": "X > 7"},
        "material": {name: one["material"]["m"] | {"where": name} for name in ("left", "right")},
        "damage": {name: one["damage"]["m"] for name in ("left", "right")},
    }
    ratios = []
    for document in (one, two):
        case = Case.from_document(document, "plate", None, "plate.toml", False)
        simulation = Simulation(case, PETSc.COMM_WORLD)
        X = simulation.particles.position[: simulation.particles.owned]
        ratios.append(simulation.fracture.ratios(0.1 * X + 0.01 * np.sin(X[:, ::-1])))
    assert ratios[1] == pytest.approx(ratios[0], rel=1e-10)
    assert np.any(ratios[0] > 0) or not len(ratios[0])
