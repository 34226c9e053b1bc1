"""Adaptive dynamic relaxation against Newton's method: the same equilibria, with and without failing bonds."""

import numpy as np
import pytest
from bodies import whole
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.errors import ConvergenceError, InputError
from pdpetsc.io.checkpoint import gathered_bonds
from pdpetsc.simulation import Simulation
from pdpetsc.solvers.record import StepFailed

pytestmark = pytest.mark.mpi

MATERIALS = {
    "bond": {"model": "bond", "E": 1.0, "plane": "stress"},
    "linear-bond": {"model": "bond", "E": 1.0, "plane": "stress", "kinematics": "linear"},
    "ordinary": {"model": "ordinary", "E": 1.0, "nu": 0.3},
    "abd": {"model": "abd", "E": 1.0, "nu": 0.2},
    "correspondence": {"model": "correspondence", "E": 1.0, "nu": 0.3},
}
"""One of each family of models; the first two are only for two dimensions."""


def document(material: str, dim: int = 2, **solver) -> dict:
    """A block on a foot, pulled sideways, two steps."""
    steel = {key: value for key, value in MATERIALS[material].items() if key != "plane" or dim == 2}
    return {
        "body": {"size": [8.0, 5.0, 4.0][:dim], "spacing": 1.0, "horizon": 2.015},
        "sets": {"left": "X < 2", "right": "X > 6"},
        "material": {"steel": steel},
        "load": [
            {"kind": "displacement", "set": "left", "component": "all", "value": 0.0},
            {"kind": "displacement", "set": "right", "component": "x", "value": "0.5 * t"},
            {"kind": "body_force", "set": "all", "component": "y", "value": "2e-3 * t"},
        ],
        "solver": {"steps": 2, **solver},
    }


def simulation(described: dict) -> Simulation:
    return Simulation(Case.from_document(described, "block", None, "block.toml", False), PETSc.COMM_WORLD)


def final(comm, built: Simulation) -> np.ndarray:
    built.solve()
    return whole(comm, built.particles, built.state.u)


@pytest.mark.parametrize(("material", "dim"), [*((name, 2) for name in MATERIALS), ("ordinary", 3), ("bond", 3)])
def test_the_same_as_newton(comm, material, dim):
    expected = final(comm, simulation(document(material, dim)))
    relaxed = simulation(document(material, dim, mode="relaxation"))
    u = final(comm, relaxed)
    assert np.abs(u - expected).max() < 1e-7 * np.abs(expected).max()
    assert all(0 < row["relaxation_steps"] < 3000 and row["newton_iterations"] == 0 for row in relaxed.rows)
    assert all(row["relative_residual"] <= 1e-9 for row in relaxed.rows)


@pytest.mark.parametrize("utol", (1e-3, 1e-5, 1e-7))
def test_what_is_left_of_the_way(comm, utol):
    """Of a slender body, is what it is estimated to be: by it alone (a wide rtol) the motion ends where it should."""
    described = document("correspondence")
    described["body"] = {"size": [40.0, 3.0], "spacing": 1.0, "horizon": 2.015}
    described["load"] = [
        described["load"][0],
        {"kind": "body_force", "set": "all", "component": "y", "value": "1e-7 * t"},
    ]
    expected = final(comm, simulation(described))
    options = PETSc.Options()
    options["pd_adr_rtol"], options["pd_adr_utol"] = 1.0, utol
    try:
        built = simulation(described | {"solver": {"steps": 1, "mode": "relaxation"}})
    finally:
        options.delValue("pd_adr_rtol")
        options.delValue("pd_adr_utol")
    error = np.abs(final(comm, built) - expected).max() / np.abs(expected).max()
    assert 0.1 * utol < error < 1.5 * utol


def test_a_rigid_motion(comm):
    """Whose forces are rounding alone."""
    described = document("correspondence", mode="relaxation", steps=1)
    described["load"] = [{"kind": "displacement", "set": "left", "component": "all", "value": "0.5 * t"}]
    built = simulation(described)
    assert np.abs(final(comm, built) - 0.5).max() < 1e-6
    assert built.rows[-1]["rounding_floor"]


def test_failing_bonds(comm):
    """Between converged states of rest: the same bonds in the same steps as under Newton's method."""
    described = document("ordinary")
    described["damage"] = {"steel": {"criterion": "critical_stretch", "critical": 0.11, "exempt": ["left", "right"]}}
    lists = []
    for mode in ("newton", "relaxation"):
        built = simulation(described | {"solver": {"steps": 4, "mode": mode}})
        lists.append((built.solve(), gathered_bonds(comm, built.fracture.broken())))
    assert lists[0][0] == lists[1][0]
    assert len(lists[0][1]) and np.array_equal(lists[0][1], lists[1][1])


def test_handing_over(comm):
    """Where Newton's method fails relaxation solves the step, and the next one is Newton's again."""
    built = simulation(document("correspondence", hand_over=True, steps=3))
    newton, calls = built.solver._newton, []
    advance = newton.advance

    def failing(*arguments):
        calls.append(len(calls))
        if len(calls) == 2:
            raise StepFailed("DIVERGED_MAX_IT")
        return advance(*arguments)

    newton.advance = failing
    u = final(comm, built)
    assert [row["relaxation_steps"] > 0 for row in built.rows] == [False, True, False]
    assert [row["newton_iterations"] > 0 for row in built.rows] == [True, False, True]
    expected = final(comm, simulation(document("correspondence", steps=3)))
    assert np.abs(u - expected).max() < 1e-8


def test_a_motion_that_does_not_come_to_rest(comm, monkeypatch):
    """Ends with a sentence that says how far it came and what to do."""
    options = PETSc.Options()
    options["pd_adr_ts_max_steps"] = 20
    try:
        built = simulation(document("ordinary", mode="relaxation", adaptive=False))
        with pytest.raises(ConvergenceError, match=r"\|r\| = .* of the loads after 20 steps; -pd_adr_ts_max_steps"):
            built.solve()
    finally:
        options.delValue("pd_adr_ts_max_steps")


def test_a_stiffening_body_gets_other_masses(comm):
    """Masses of the tangent at rest are too small for one that is stretched to twice its length: saint_venant."""
    described = document("correspondence", mode="relaxation", steps=1)
    described["material"]["steel"] |= {"elasticity": "saint_venant_kirchhoff"}
    described["load"][1]["value"] = "6.0 * t"
    newton = document("correspondence", steps=10) | {key: described[key] for key in ("material", "load")}
    expected = final(comm, simulation(newton))
    u = final(comm, simulation(described))
    assert np.abs(u - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize(("solver", "message"), [
    ({"mode": "relaxation", "control": "arc_length"}, 'control: is "arc_length", which goes with mode = "newton"'),
    ({"mode": "relaxation", "hand_over": True}, 'solver.hand_over: goes with mode = "newton"'),
])  # fmt: skip
def test_what_does_not_go_together(solver, message):
    with pytest.raises(InputError, match=message):
        Case.from_document(document("ordinary", **solver), "block", None, "block.toml", False)
