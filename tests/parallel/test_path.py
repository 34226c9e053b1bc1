"""Paths past limit points: the bordered solution, an exact truss that snaps back, an arch that snaps through."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import ARCH, assembler, distributed, jittered, rows_of, site, whole
from models import model
from petsc4py import PETSc

from pdpetsc import case
from pdpetsc.errors import ConvergenceError
from pdpetsc.io.checkpoint import read_state, write_checkpoint
from pdpetsc.loads.force import BodyForce
from pdpetsc.simulation import Simulation
from pdpetsc.solvers.constraints import ArcLength, arc
from pdpetsc.solvers.newton import Newton
from pdpetsc.solvers.passes import Passes
from pdpetsc.solvers.path import Path, follow, limit_points
from pdpetsc.solvers.record import StepFailed
from pdpetsc.solvers.stepping import Schedule
from pdpetsc.state import State

pytestmark = pytest.mark.mpi


def simulation(document, comm=PETSc.COMM_WORLD, **solver):
    document = document | {"solver": document["solver"] | solver}
    return Simulation(case.Case.from_document(document, "arch", None, "my.toml", False), comm)


def traced(document, comm=PETSc.COMM_WORLD, **solver):
    run = simulation(document, comm, **solver)
    run.solve()
    return run


def of_rows(run, key):
    return np.array([row[key] if key in row else row["probes"][key] for row in run.rows])


def stretched_body():
    """A jittered body with one end pulled and a body force, both functions of t, deformed and out of equilibrium."""
    p = distributed(jittered((5, 4), 0.1), 2.015)
    load = BodyForce(site(p, np.ones(p.owned, bool), "0.01 * t"), type("spec", (), {"component": (1,)}))
    a = assembler(
        p, model("hencky-silling"), held=lambda X: (X[:, :1] < 1) | (X[:, :1] > 4), loads=[load],
        value=["0.1 * t * X", "0.02 * t * X"],
    )  # fmt: skip
    u = 0.05 * np.sin(p.position[: p.owned]) + 0.02
    a.set_time(0.7)
    return a, np.where(a.constrained, a.prescribed, u)


def test_bordered_against_dense(comm, petsc_options):
    """du and dt are those of the whole system [K, r_t; g_u, 0], its r_t from differences of the residual."""
    a, u = stretched_body()
    newton = Newton(a, 0.0, definite=False)
    rng = np.random.default_rng(5)
    ids = a.particles.id[: a.particles.owned]
    g_u, g = rng.normal(size=(a.particles.count, a.dim))[ids], 0.3
    r, h = a.residual_array(u), 1e-4
    changes = []
    for time in (0.7 + h, 0.7 - h):
        a.set_time(time)
        changes.append(a.residual_array(u) / (2 * h))
    a.set_time(0.7)
    with newton.recording():
        du, dt = Path(newton, a, 1.0).correction(u, 0.7, r, g, lambda du: comm.allreduce(float((g_u * du).sum())))
    n = a.particles.count * a.dim
    system = np.zeros((n + 1, n + 1))
    system[:n, :n] = np.concatenate(comm.allgather(rows_of(a.assemble(u))))

    def dense(field):
        return np.concatenate(comm.allgather(field.ravel()))

    system[:n, n], system[n, :n], system[n, n] = dense(changes[0] - changes[1]), dense(g_u), 0.0
    expected = np.linalg.solve(system, -np.append(dense(r), g))
    assert dt == pytest.approx(expected[n], rel=1e-6)
    assert np.abs(dense(du) - expected[:n]).max() < 1e-6 * np.abs(expected[:n]).max()
    newton.destroy()


def test_gradient_of_the_arc_length(comm):
    a, u = stretched_body()
    constraint = ArcLength(a, State(u=np.zeros_like(u)), 0.1)
    g, change = constraint.linearise(u)
    ids = a.particles.id[: a.particles.owned]
    move = np.where(a.constrained, 0.0, np.random.default_rng(3).normal(size=(a.particles.count, a.dim))[ids])
    ahead, back = (constraint.linearise(u + sign * 1e-3 * move)[0] for sign in (1, -1))
    assert (ahead - back) / 2e-3 == pytest.approx(change(move), rel=1e-10)
    assert change(np.where(a.constrained, 1.0, 0.0)) == 0.0
    assert g == pytest.approx((arc(a, u) / 0.1) ** 2 - 1, rel=1e-12)


def test_truss_that_snaps_back(comm):
    """Two bars and a soft spring that is pushed down onto them, four particles: with the drop v of the apex the push is
    d = v + P/k_s, P = 2 k (l0 - l)(H - v)/l, l^2 = B^2 + (H - v)^2. The apex snaps, and d goes back meanwhile."""
    B, H, spring, push = 10.0, 2.0, 6.0, 8.0
    X = np.array([[-B, 0.0], [B, 0.0], [0.0, H], [0.0, H + spring]])
    p = distributed(X, 10.5, volume=np.array([1.0, 1.0, 1.0, 0.008]))
    value = ["0", f"where(Y > {H + 1}, -{push} * t, 0)"]
    a = assembler(p, model("bond-general"), held=lambda X: (abs(X[:, :1]) > 1) | (X[:, 1:] > H + 1), value=value)
    newton = Newton(a, 0.0, definite=False)

    def stiffness(particle, component):
        du = np.where((p.id[: p.owned] == particle)[:, None], np.eye(2)[component], 0.0)
        a.linearise(np.zeros_like(du))
        return comm.allreduce((a.action(du) * du).sum())

    bar, soft = stiffness(2, 0) / 2 * (1 + (H / B) ** 2), stiffness(3, 1)
    assert soft < 0.8 * bar * (H / B) ** 2  # or nothing would snap back
    state, path = State(u=np.zeros((p.owned, 2))), []

    def commit(state, record):
        path.append((state.time, *whole(comm, p, state.u)[2], record.arc_length))

    schedule = Schedule(1.0, 20, True, 1e-6, 0.05)
    follow(Passes(newton, a, None), state, schedule, partial(ArcLength, a), commit, lambda *cut: None)
    t, sideways, drop, lengths = np.array(path).T
    height = H + drop
    length, first = np.hypot(B, height), np.hypot(B, H)
    force = 2 * bar * (first - length) * height / length
    assert np.abs(sideways).max() < 1e-9
    assert push * t == pytest.approx(-drop + force / soft, abs=1e-8)
    assert t[-1] == 1.0 and np.all(np.diff(-drop) > 0)
    v = np.linspace(0, 2 * H, 100001)
    length = np.hypot(B, H - v)
    d = v + 2 * bar * (first - length) * (H - v) / length / soft
    turns = np.flatnonzero(np.diff(np.sign(np.diff(d)))) + 1
    assert [point["time"] * push for point in limit_points(t, lengths)] == pytest.approx(d[turns], rel=2e-3)
    newton.destroy()


@pytest.fixture(scope="module")
def through(comm):
    """The arch, traced through both of its limit points."""
    return traced(ARCH)


def test_arch_snaps_through(comm, through):
    t = of_rows(through, "time")
    assert t[-1] == 1.0
    assert len(limit_points(t, of_rows(through, "arc_length"))) == 2
    assert np.all(np.diff(of_rows(through, "crown")) < 0)
    assert of_rows(through, "relative_residual").max() < 1e-10


def test_displacement_control_gives_the_same_curve(comm, through):
    """Each state of the path, with the drop of the loaded particle prescribed in place of the force."""
    drops = of_rows(through, "crown")
    knots = [f"where(t < {k + 0.5}, {float(drop)!r}, " for k, drop in enumerate(drops, 1)]
    value = "".join(knots) + "0" + ")" * len(knots)
    crown = {"kind": "displacement", "set": "crown", "component": "y", "value": value}
    n = len(drops)
    pushed = ARCH | {"load": [ARCH["load"][0], crown], "solver": {"steps": n, "end_time": float(n), "adaptive": False}}
    forces = of_rows(traced(pushed), "support")
    assert forces == pytest.approx(-200 * of_rows(through, "time"), abs=1e-8 * 200)


def test_same_path_on_one_rank(comm, through):
    alone = traced(ARCH, PETSc.COMM_SELF)
    for key in ("time", "arc_length", "crown"):
        assert of_rows(through, key) == pytest.approx(of_rows(alone, key), rel=1e-10)
    ids = through.particles.id[: through.particles.owned]
    assert np.abs(through.state.u - alone.state.u[ids]).max(initial=0.0) < 1e-10 * np.abs(alone.state.u).max()


def test_same_path_without_a_matrix(comm, through, petsc_options):
    petsc_options(pd_tangent="matrix_free")
    other = traced(ARCH)
    assert other.solver.tangent.kind == "matrix_free"
    for key in ("time", "arc_length", "crown"):
        assert of_rows(other, key) == pytest.approx(of_rows(through, key), rel=1e-6)


def test_restart_in_the_middle(comm, through, shared_tmp_path, capsys):
    """From a checkpoint that one rank has written between the limit points."""
    first, last = limit_points(of_rows(through, "time"), of_rows(through, "arc_length"))
    middle = (first["step"] + last["step"]) // 2
    if comm.rank == 0:
        begun = traced(ARCH, PETSc.COMM_SELF, max_steps=middle)
        assert f"solver.max_steps: the path has ended after {middle} steps, at t = " in capsys.readouterr().err
        assert begun.state.time < begun.rows[-2]["time"]
        write_checkpoint(shared_tmp_path, begun.particles, begun.state, {}, begun.damaged)
    comm.Barrier()
    run = simulation(ARCH)
    run.state = read_state(shared_tmp_path, run.particles)
    run.solve()
    for key in ("time", "crown"):
        assert of_rows(run, key) == pytest.approx(of_rows(through, key)[middle:], rel=1e-10)


@pytest.mark.parametrize("adaptive", [True, False])
def test_a_step_that_fails(comm, monkeypatch, adaptive):
    """It is halved, and nothing of it is kept; without adaptive steps it ends the run."""
    solve, failing = Path.solve, [3]

    def fail_at_first(self, u, t, constraint):
        failing[0] -= 1
        if not failing[0]:
            raise StepFailed("DIVERGED_MAX_IT")
        return solve(self, u, t, constraint)

    monkeypatch.setattr(Path, "solve", fail_at_first)
    run, cuts = simulation(ARCH, adaptive=adaptive, max_steps=4), []
    run.observers = [SimpleNamespace(start=id, step=id, finish=id, failed=lambda run, *cut: cuts.append(cut))]
    if not adaptive:
        failure = r"step 3 along the path, from t = .*: DIVERGED_MAX_IT; more steps or"
        with pytest.raises(ConvergenceError, match=failure):
            run.solve()
        assert run.state.step == len(run.rows) == 2
        return
    run.solve()
    lengths = of_rows(run, "arc_length")
    assert lengths / lengths[0] == pytest.approx([1, 1, 0.5, 1], rel=1e-6)
    ((reached, tried, reason),) = cuts
    assert reached == run.rows[1]["time"] < tried and reason == "DIVERGED_MAX_IT"


def test_loads_that_do_not_move(comm):
    """At t = 0 there is no direction in which to begin."""
    crown = ARCH["load"][1] | {"value": "-200 * t * t * maximum(t - 0.01, 0)"}
    with pytest.raises(ConvergenceError, match="step 1 along the path, from t = 0, did not converge: the loads move"):
        simulation(ARCH | {"load": [ARCH["load"][0], crown]}).solve()
