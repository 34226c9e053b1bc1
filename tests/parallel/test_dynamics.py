"""Motion in time: order, energies, momenta, ranks, restarts, stable steps, failing bonds, supports that move."""

import numpy as np
import pytest
from bodies import whole
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.errors import ConvergenceError, InputError
from pdpetsc.io.checkpoint import gathered_bonds, read_damaged, read_state, write_checkpoint
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

BLOCK = {
    "body": {"size": [8.0, 5.0], "spacing": 1.0, "horizon": 2.015},
    "sets": {"left": "X < 2", "right": "X > 6"},
    "material": {"steel": {"model": "ordinary", "E": 1.0, "nu": 0.3, "density": 1.0}},
    "initial": [
        {"component": "x", "velocity": "1e-3 * sin(pi * X / 8)"},
        {"component": "y", "displacement": "1e-3 * X * Y / 40"},
    ],
    "solver": {"mode": "verlet", "end_time": 40.0, "steps": 100},
}
MATERIALS = {
    "bond": {"model": "bond", "E": 1.0, "plane": "stress"},
    "abd": {"model": "abd", "E": 1.0, "nu": 0.2},
    "correspondence": {"model": "correspondence", "E": 1.0, "nu": 0.3},
    "ordinary": {"model": "ordinary", "E": 1.0, "nu": 0.3},
}


def document(material: str = "ordinary", load=(), damage=None, **solver) -> dict:
    table = {"steel": MATERIALS[material] | {"density": 1.0}}
    described = BLOCK | {"material": table, "load": list(load), "solver": BLOCK["solver"] | solver}
    return described | ({"damage": {"steel": damage}} if damage else {})


def simulation(described: dict) -> Simulation:
    return Simulation(Case.from_document(described, "block", None, "block.toml", False), PETSc.COMM_WORLD)


def final(comm, described: dict) -> np.ndarray:
    built = simulation(described)
    built.solve()
    assert built.state.time == described["solver"]["end_time"]
    return whole(comm, built.particles, built.state.u)


def test_second_order(comm):
    """Of both methods, towards the same motion."""
    for solver in ({"mode": "verlet"}, {"mode": "generalised_alpha", "adaptive": False}):
        fields = [final(comm, document(**solver, steps=n)) for n in (100, 200, 400, 1600)]
        errors = [np.linalg.norm(u - fields[-1]) for u in fields[:-1]]
        rates = np.log2(np.array(errors[:-1]) / errors[1:])
        assert (rates > 1.9).all() and (rates < 2.25).all()
        solver["best"] = fields[-1]
        last = solver["best"]
    verlet = final(comm, document(steps=1600))
    assert np.linalg.norm(verlet - last) < 2e-3 * np.linalg.norm(last)


@pytest.mark.parametrize("material", MATERIALS)
def test_energies_and_momenta(comm, material):
    """Elastic, free: energy drifts by less than 0.1 % in 10,000 steps, both momenta stay to rounding."""
    built = simulation(document(material, end_time=4000.0, steps=10_000))
    p, first = built.particles, built.state

    def momenta(state):
        m = built.solver.mass[:, None]
        x = p.position[: p.owned] + state.u
        turning = (m[:, 0] * (x[:, 0] * state.v[:, 1] - x[:, 1] * state.v[:, 0])).sum()
        return comm.allreduce(np.array([*(m * state.v).sum(axis=0), turning]))

    before, size = momenta(first), comm.allreduce(float(np.abs(built.solver.mass[:, None] * first.v).sum()))
    built.solve()
    assert built.state.step == 10_000
    energies = built.solver.energies(built.state)
    assert abs(energies["imbalance"]) < 1e-4 * energies["brought"]
    assert energies["kinetic"] + energies["stored"] == pytest.approx(energies["brought"], rel=1e-4)
    assert np.abs(momenta(built.state) - before).max() < 1e-12 * size


def test_the_stable_step_is_a_bound(comm):
    """Not above the true limit, and not below half of it; beyond the limit the motion blows up, with a sentence."""
    built = simulation(document("bond", steps=1))
    a, p = built.assembler, built.particles
    a.assemble(built.state.u)
    K = a.matrix()
    mass = a.vector()
    mass.getArray()[...] = np.repeat(built.solver.mass, 2)
    root = mass.duplicate()
    root.getArray()[...] = mass.getArray() ** -0.5
    x = a.vector()
    x.setRandom()
    y = x.duplicate()
    for _ in range(2000):  # power iteration on m^-1/2 K m^-1/2
        x.scale(1 / x.norm())
        y.pointwiseMult(root, x)
        z = K * y
        x.pointwiseMult(root, z)
    limit = 2 / x.norm() ** 0.5
    stable = built.solver.steps.stable
    assert limit / 2 < stable <= limit
    assert p.count == 40
    with pytest.raises(ConvergenceError, match=r"blown up in step .* too long; .* was estimated to be stable"):
        simulation(document("bond", steps=2000, end_time=2000 * 1.05 * limit)).solve()


def test_restart_is_bitwise_the_same(comm, shared_tmp_path):
    damage = {"criterion": "critical_stretch", "critical": 4e-4}
    through = simulation(document(damage=damage, steps=120))
    through.solve()
    assert comm.allreduce(len(through.fracture.broken())) > 0
    begun = simulation(document(damage=damage, steps=120))
    committed = begun._commit_motion
    kept = {}

    def commit(state):
        committed(state)
        if state.step == 60:
            write_checkpoint(shared_tmp_path, begun.particles, begun.state, {}, begun.damaged)
            kept["rows"] = list(begun.rows)

    begun._commit_motion = commit
    begun.solve()
    again = simulation(document(damage=damage, steps=120))
    again.go_on_from(read_state(shared_tmp_path, again.particles), kept["rows"], read_damaged(shared_tmp_path))
    again.solve()
    assert np.array_equal(again.state.u, through.state.u) and np.array_equal(again.state.v, through.state.v)
    assert again.state.external_work == through.state.external_work
    assert again.state.dissipated == through.state.dissipated
    assert [row["step"] for row in again.rows] == [row["step"] for row in through.rows]


def test_the_same_on_any_number_of_ranks(comm):
    """With bonds that fail while the body moves; what they take balances."""
    described = document("correspondence", damage={"criterion": "critical_stretch", "critical": 4e-4})
    built, alone = (
        simulation(described),
        Simulation(Case.from_document(described, "block", None, "block.toml", False), PETSc.COMM_SELF),
    )
    for each in (built, alone):
        each.solve()
    u = whole(comm, built.particles, built.state.u)
    alone_u = np.empty_like(u)
    alone_u[alone.particles.id[: alone.particles.owned]] = alone.state.u
    assert np.abs(u - alone_u).max() < 1e-10 * np.abs(u).max()
    broken = gathered_bonds(comm, built.fracture.broken())
    assert len(broken) and np.array_equal(broken, gathered_bonds(alone.comm.tompi4py(), alone.fracture.broken()))
    energies = built.solver.energies(built.state)
    assert energies["dissipated"] > 0.01 * energies["brought"]
    assert abs(energies["imbalance"]) < 1e-3 * energies["brought"]


@pytest.mark.parametrize("mode", ("verlet", "generalised_alpha"))
def test_supports_that_move(comm, mode):
    """A velocity is held and its work counted; the body then goes with its support."""
    loads = [
        {"kind": "velocity", "set": "left", "component": "x", "value": "2e-3"},
        {"kind": "velocity", "set": "left", "component": "y", "value": "1e-4 * t"},
    ]
    described = document(load=loads, mode=mode, steps=400, **({} if mode == "verlet" else {"adaptive": False}))
    described.pop("initial")
    built = simulation(described)
    built.solve()
    p, state = built.particles, built.state
    left = p.position[: p.owned, 0] < 2
    assert np.allclose(state.u[left], [2e-3 * 40, 1e-4 * 40**2 / 2], rtol=1e-12 if mode == "verlet" else 1e-5)
    assert np.allclose(state.v[left], [2e-3, 1e-4 * 40], rtol=0.02)
    energies = built.solver.energies(state)
    total = energies["kinetic"] + energies["stored"]
    assert energies["external_work"] > 0.5 * total
    assert abs(energies["imbalance"]) < (2e-3 if mode == "verlet" else 2e-2) * total


def test_a_force_and_its_work(comm):
    """One free particle's motion is known: the block as a whole moves with F t^2/2m."""
    load = [{"kind": "body_force", "set": "all", "component": "x", "value": "1e-4 * t"}]
    described = document(load=load, steps=500)
    described.pop("initial")
    built = simulation(described)
    built.solve()
    assert np.allclose(built.state.u[:, 0], 1e-4 * 40**3 / 6, rtol=1e-4)
    assert np.abs(built.state.u[:, 1]).max(initial=0.0) < 1e-9
    energies = built.solver.energies(built.state)
    assert abs(energies["imbalance"]) < 1e-4 * energies["kinetic"]


def test_adaptive_steps(comm):
    """TS chooses them by its error; the end is met."""
    built = simulation(document(mode="generalised_alpha", steps=40))
    built.solve()
    sizes = np.diff([0.0, *(row["time"] for row in built.rows)])
    assert built.state.time == pytest.approx(40.0, rel=1e-12) and sizes.max() > 1.5 * sizes.min()


def test_rows_and_outputs(comm):
    """As many as asked for, and the steps nearest to given times."""
    described = document(steps=200)
    described["output"] = {"every": 50, "history": 20, "checkpoint": 100, "times": [7.03, 31.0]}
    built = simulation(described)
    built.solve()
    steps = [row["step"] for row in built.rows]
    assert steps == sorted({*range(20, 201, 20), 50, 150, 35, 155})
    assert [step for step in range(1, 201) if built.output.fields(step)] == [35, 50, 100, 150, 155, 200]
    assert [step for step in range(1, 201) if built.output.checkpoint(step)] == [100, 200]


EQUAL_STEPS = {"verlet": {"mode": "verlet"}, "generalised_alpha": {"mode": "generalised_alpha", "adaptive": False}}


@pytest.fixture
def options():
    """Set PETSc options for one test."""
    given = []

    def put(**values):
        for name, value in values.items():
            PETSc.Options()[name] = value
            given.append(name)

    yield put
    for name in given:
        PETSc.Options().delValue(name)


@pytest.mark.parametrize("mode", EQUAL_STEPS)
def test_a_ts_that_ends_early(options, mode):
    """What it has reached is committed, and the sentence says why it went no further."""
    options(ts_max_steps=30)
    described = document(**EQUAL_STEPS[mode])
    described["output"] = {"every": 100, "history": 100}
    built = simulation(described)
    with pytest.raises(ConvergenceError, match=r"has ended at t = 12, short of end_time: CONVERGED_ITS"):
        built.solve()
    assert [row["step"] for row in built.rows] == [20, 30] and built.state.time == pytest.approx(12.0)


@pytest.mark.parametrize("mode", EQUAL_STEPS)
def test_what_a_ts_is_cannot_be_chosen(options, mode):
    options(ts_type="euler")
    with pytest.raises(InputError, match="-ts_type: cannot be chosen here"):
        simulation(document(mode=mode)).solve()


@pytest.mark.parametrize("mode", EQUAL_STEPS)
def test_a_load_that_loses_its_value(mode):
    """In the middle of the way, on the ranks that have it: all of them end, with what was committed before."""
    load = {"kind": "body_force", "set": "right", "component": "x", "value": "1e-9 * sqrt((t - 20) * (t - 30))"}
    built = simulation(document(load=[load], **EQUAL_STEPS[mode]) | {"output": {"history": 10}})
    with pytest.raises(InputError, match=r"load\.0.*value"):
        built.solve()
    assert 0 < built.state.time <= 20.0


def test_a_motion_that_fails_keeps_the_bonds_of_its_last_row(comm):
    """Bonds that have broken since are whole again."""
    damage = {"criterion": "critical_stretch", "critical": 0.11}
    pull = [{"kind": "velocity", "set": "right", "component": "x", "value": "where(t > 31, 1e300, 0.04)"},
            {"kind": "displacement", "set": "left", "component": "x", "value": 0.0}]  # fmt: skip
    described = document(load=pull, damage=damage)
    described["output"] = {"every": 100, "history": 20, "checkpoint": 100}
    built = simulation(described)
    with pytest.raises(ConvergenceError, match="the motion has blown up in step 7"):
        built.solve()
    assert built.rows[-1]["step"] == 60
    assert built.fracture.count == built.rows[-1]["broken_bonds"]
    assert len(gathered_bonds(comm, built.fracture.broken())) == built.fracture.count


@pytest.mark.parametrize(("change", "message"), [
    ({"material": {"steel": {"model": "abd", "E": 1.0, "nu": 0.2}}}, "mode: \"verlet\" needs material.steel.density"),
    ({"solver": {"mode": "newton"}}, "initial: goes with mode = \"verlet\""),
    ({"solver": {"mode": "newton", "time_step": 1.0}}, "time_step: goes with mode = \"verlet\""),
    ({"solver": {"mode": "verlet", "time_step": 1.0, "steps": 3}}, "time_step: goes without steps"),
    ({"initial": [{"component": "x"}]}, "needs exactly one of displacement, velocity"),
    ({"solver": {"mode": "newton"}, "initial": [],
      "load": [{"kind": "velocity", "set": "left", "component": "x", "value": 1.0}]}, "knows no velocity"),
    ({"solver": {"mode": "newton"}, "initial": [], "output": {"history": 3}}, "output.history: is of motion"),
    ({"solver": {"mode": "generalised_alpha"}, "material": {"steel": MATERIALS["ordinary"] | {
        "density": 1.0, "dual": False}}}, "needs a tangent, which material.steel.dual = false does not have"),
    ({"damage": {"steel": {"criterion": "critical_stretch", "critical": 0.1, "softening": {
        "s_min": 0.05, "beta": 1.2}}}},
     "does not go with damage.steel.softening"),
])  # fmt: skip
def test_what_does_not_go_together(change, message):
    with pytest.raises(InputError, match=message):
        Case.from_document(BLOCK | change, "block", None, "block.toml", False)


def test_an_initial_value_that_is_none_on_one_rank(comm):
    """And further ones after it."""
    none = {"component": "x", "velocity": "sqrt(X - 4)"}
    described = document() | {"initial": [none, {"component": "y", "velocity": 0.0}]}
    with pytest.raises(InputError, match=r"initial.0.velocity: .* is nan"):
        simulation(described)
