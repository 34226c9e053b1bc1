"""Bonds that fail: the same ones on any number of ranks and after a restart, energies, loose particles, tangents."""

import contextlib

import numpy as np
import pytest
from bodies import assembler, distributed, families_of, jittered, whole
from models import MODELS, NAMES, dimensions_of_the_model, strong_gradient  # noqa: F401  used by itself
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.fracture import STRIDE, TIE
from pdpetsc.io.checkpoint import gathered_bonds, read_damaged, read_state, write_checkpoint
from pdpetsc.opposite import Opposite
from pdpetsc.simulation import Simulation
from pdpetsc.solvers.newton import Newton
from pdpetsc.solvers.passes import Overshoot
from pdpetsc.solvers.record import StepFailed
from pdpetsc.summary import summary_of

pytestmark = pytest.mark.mpi

PLATE = {
    "body": {
        "size": [0.15, 0.05], "spacing": 0.005, "horizon": 3.015, "keep": "hypot(X - 0.075, Y - 0.025) > 0.01",
        "layers": {"left": 0.015, "right": 0.015},
    },
    "sets": {"left": "X < 0", "right": "X > 0.15", "ends": "X < 0.01 or X > 0.14"},
    "material": {"steel": {"model": "correspondence", "E": 210e9, "nu": 0.33, "plane": "stress"}},
    "damage": {"steel": {"criterion": "critical_stretch", "critical": 0.002, "exempt": ["ends"]}},
    "load": [
        {"kind": "displacement", "set": "left", "component": "x", "value": "-1e-4 * t"},
        {"kind": "displacement", "set": "right", "component": "x", "value": "1e-4 * t"},
        {"kind": "displacement", "set": "left", "component": "y", "value": 0.0},
        {"kind": "displacement", "set": "right", "component": "y", "value": 0.0},
    ],
}  # fmt: skip
"""A plate with a hole, pulled apart at its ends."""

KINDS = [(model, control) for model in ("correspondence", "ordinary") for control in ("load", "failure")]
ENERGIES = ("external_work", "stored_energy", "dissipated")
every_kind = pytest.mark.parametrize("model, control", KINDS)
every_model = pytest.mark.parametrize("row", MODELS, ids=NAMES)


def document(model="correspondence", control="load", damage=(), body=(), **solver) -> dict:
    steel = PLATE["material"]["steel"] | {"model": model}
    failing = PLATE["damage"]["steel"] | dict(damage)
    return PLATE | {
        "body": PLATE["body"] | dict(body), "material": {"steel": steel}, "damage": {"steel": failing},
        "solver": {"control": control, **({"max_steps": 30} if control == "failure" else {}), **solver},
    }  # fmt: skip


def simulation(described: dict, comm=PETSc.COMM_WORLD) -> Simulation:
    return Simulation(Case.from_document(described, "plate", None, "plate.toml", False), comm)


class Run:
    """A simulation carried to its end; `broken` are the bonds of all ranks."""

    def __init__(self, built: Simulation):
        self.built = built
        self.status = built.solve()
        self.rows, self.broken = built.rows, all_broken(built)

    def column(self, key: str) -> np.ndarray:
        return np.array([row[key] for row in self.rows])


def all_broken(built: Simulation) -> np.ndarray:
    return gathered_bonds(built.comm.tompi4py(), built.fracture.broken())


@pytest.fixture(scope="module")
def ended(comm):
    """`ended(model, control)`: the plate on all ranks together, solved once."""
    runs = {}

    def give(*kind) -> Run:
        if kind not in runs:
            runs[kind] = Run(simulation(document(*kind)))
        return runs[kind]

    return give


def assert_same(one: Run, other: Run, rel: float = 1e-8) -> None:
    """The same bonds in the same steps, at the same loads and energies."""
    assert one.status == other.status
    assert np.array_equal(one.broken, other.broken)
    assert one.column("broken_bonds").tolist() == other.column("broken_bonds").tolist()
    for key in ("time", *ENERGIES):
        expected = other.column(key)
        assert one.column(key) == pytest.approx(expected, rel=rel, abs=rel * np.abs(expected).max()), key


# Ranks, restarts and energies ---------------------------------------------------------------------------------


@every_kind
def test_same_on_one_rank(ended, model, control):
    found = ended(model, control)
    assert found.status == ("separated" if model == "correspondence" else "converged")
    assert len(found.broken) > 100 and found.rows[-1]["broken_bonds"] == len(found.broken)
    assert_same(found, Run(simulation(document(model, control), PETSc.COMM_SELF)))


@pytest.mark.parametrize("model, control", KINDS[:3])
def test_restart_in_the_middle(comm, ended, shared_tmp_path, model, control):
    """From checkpoints that one rank and all ranks have written while bonds fail, on all and on one."""
    through = ended(model, control)
    steps = through.column("step")[through.column("broken_bonds") > 0]
    middle = int(steps[len(steps) // 2 - 1])
    assert through.rows[middle - 1]["broken_bonds"] < len(through.broken)

    def until_then(where) -> Simulation:
        built = simulation(document(model, control), where)
        committed = built._commit

        def commit(state, record):
            committed(state, record)
            record.separated = state.step == middle  # ends the run

        built._commit = commit
        built.solve()
        return built

    for before, after in ((PETSc.COMM_SELF, PETSc.COMM_WORLD), (PETSc.COMM_WORLD, PETSc.COMM_SELF)):
        directory = shared_tmp_path / f"{before.size}-{after.size}-{before is PETSc.COMM_SELF}"
        if before is PETSc.COMM_WORLD or comm.rank == 0:
            if comm.rank == 0:
                directory.mkdir()
            begun = until_then(before)
            before.tompi4py().Barrier()
            write_checkpoint(directory, begun.particles, begun.state, {}, begun.damaged)
            rows = begun.rows
        rows = comm.bcast(rows if comm.rank == 0 else None)
        built = simulation(document(model, control), after)
        built.go_on_from(read_state(directory, built.particles), list(rows), read_damaged(directory))
        assert_same(Run(built), through)
        comm.Barrier()


def test_nothing_is_left_to_do_where_a_body_has_come_apart(comm, ended, shared_tmp_path):
    through = ended("correspondence", "load")
    write_checkpoint(shared_tmp_path, through.built.particles, through.built.state, {}, through.built.damaged)
    built = simulation(document())
    built.go_on_from(read_state(shared_tmp_path, built.particles), list(through.rows), read_damaged(shared_tmp_path))
    assert built.ended and built.solve() == "separated"
    assert built.rows == through.rows and built.state.time < 1.0


@every_kind
def test_energy_balance(ended, model, control):
    """What loads have done is stored or gone, at every step; bonds of the ordinary model take energy with them."""
    run = ended(model, control)
    done, stored, gone = map(run.column, ENERGIES)
    assert np.abs(done - stored - gone).max() < 1e-3 * done.max()
    assert np.all(np.abs(done - stored - gone) < 0.01 * done)
    if model == "ordinary":
        assert np.diff(gone).min() > -1e-8 * done.max()
    kept = summary_of(run.built, run.status)["energies"]
    assert kept["imbalance"] == pytest.approx(done[-1] - stored[-1] - gone[-1], abs=1e-9 * done.max())


@pytest.mark.parametrize("model", ["correspondence", "ordinary"])
def test_paths_come_to_the_first_failure(ended, model):
    """Where control is by failure, each step but one that comes to the end breaks bonds as one reaches its value."""
    path, loaded = ended(model, "failure"), ended(model, "load")
    assert np.diff(path.column("broken_bonds"))[:-1].min() > 0
    assert np.all(path.column("passes") == 1)
    first = path.rows[0]["time"]
    before = loaded.column("time")[loaded.column("broken_bonds") == 0].max()
    assert before < first <= loaded.column("time")[loaded.column("broken_bonds") > 0].min()
    assert np.diff(path.column("time")).min() < 0  # snaps back


@every_kind
def test_symmetric_plates_break_symmetrically(comm, ended, model, control):
    run = ended(model, control)
    p = run.built.particles
    X = whole(comm, p, p.position)
    place = {tuple(np.round(x, 6)): i for i, x in enumerate(X)}
    found = set(map(tuple, run.broken.tolist()))
    for mirror in (lambda x: (0.15 - x[0], x[1]), lambda x: (x[0], 0.05 - x[1])):
        image = np.array([place[tuple(np.round(mirror(x), 6) + 0.0)] for x in X])
        assert {(int(image[i]), int(image[j]), step) for i, j, step in found} == found


@every_kind
def test_pairs_break_and_exempt_bonds_do_not(comm, ended, model, control):
    run = ended(model, control)
    p = run.built.particles
    X = whole(comm, p, p.position)[:, 0]
    pairs = set(map(tuple, run.broken.tolist()))
    assert {(j, i, step) for i, j, step in pairs} == pairs
    ends = X[run.broken[:, :2]]
    assert ends.min() > 0.01 and ends.max() < 0.14


@pytest.mark.parametrize("model", ["correspondence", "ordinary"])
def test_same_bonds_without_a_matrix(ended, petsc_options, model):
    petsc_options(pd_tangent="matrix_free", ksp_rtol=1e-12)
    other = Run(simulation(document(model)))
    assert other.built.solver.tangent.kind == "matrix_free"
    assert_same(other, ended(model, "load"), rel=1e-7)


# Tangents -----------------------------------------------------------------------------------------------------


def damaged(a, share: float, alone: int) -> None:
    """Break a share of the pairs, and all of one particle, the same on any number of ranks."""
    p = a.particles
    draw = np.random.default_rng(8).uniform(size=(p.count, p.count))
    gone = np.maximum(draw, draw.T) < share**0.5
    gone[alone] = gone[:, alone] = True
    for material in a.materials:
        families = material.families
        material.set_bonds(~gone[p.id[families.per_bond(np.arange(p.local))], p.id[families.neighbours]])


@pytest.mark.parametrize("dim", [2, 3])
@every_model
def test_tangent_with_broken_bonds(comm, row, dim):
    """Matrix, action and central differences of the residual; one particle has no bonds and is held."""
    X = jittered({2: (6, 5), 3: (4, 3, 3)}[dim], 0.15)
    rng = np.random.default_rng(dim)
    p = distributed(X, rng.uniform(1.8, 2.6, len(X)), rng.uniform(0.5, 1.5, len(X)))
    ids = p.id[: p.owned]
    a = assembler(p, row, held=lambda X: X[:, :1] < 0.8)
    whole_matrix = a.assemble(np.zeros((p.owned, dim)))  # the pattern is that of the whole body
    damaged(a, 0.25, alone=14)
    u = 0.3 * p.position[: p.owned] @ strong_gradient(dim).T + 0.02 * rng.uniform(-1, 1, X.shape)[ids]
    a.hold(ids == 14, u)
    u = np.where(a.constrained, a.prescribed, u)
    v = rng.uniform(-1, 1, X.shape)[ids]
    mat = a.assemble(u)
    assert mat is whole_matrix
    x, y = mat.createVecs()
    x.getArray()[...] = v.ravel()
    mat.mult(x, y)
    Kv = a.constrained_action(v)

    def largest(values):
        return max(comm.allgather(float(np.abs(values).max(initial=0.0))))

    assert 0 < largest(Kv) < np.inf
    assert largest(y.getArray(readonly=True).reshape(v.shape) - Kv) < 1e-13 * largest(Kv)
    h = 1e-5
    difference = (a.residual_array(u + h * v) - a.residual_array(u - h * v)) / (2 * h)
    assert largest(Kv - difference) < 1e-8 * largest(Kv)
    diagonal = np.einsum("npp->np", a.diagonal())
    assert largest(mat.getDiagonal().getArray().reshape(v.shape) - diagonal) < 1e-13 * largest(diagonal)
    assert np.all(diagonal[ids == 14] == a.constraint_scale)
    a.hold(np.zeros(p.owned, bool), u)
    assert np.array_equal(a.constrained, a.supported)


# Which bonds fail ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [(40,), (13, 9), (5, 4, 4)], ids=str)
def test_opposite(comm, counts):
    """Of every bond i -> j the value of j -> i, and 0 where the family of j does not have it."""
    X = jittered(counts, 0.3)
    horizon = np.random.default_rng(3).uniform(1.2, 3.2, len(X))
    p = distributed(X, horizon)
    families = families_of(p)
    i, j = p.id[families.per_bond(np.arange(p.local))], p.id[families.neighbours]
    found = Opposite(p, families)(1.0 + i * len(X) + j)
    there = np.linalg.norm(X[i] - X[j], axis=1) < horizon[j]
    assert np.array_equal(found, np.where(there, 1.0 + j * len(X) + i, 0.0))
    assert 0 < comm.allreduce(int(there.sum())) < comm.allreduce(len(there))


GRADED = {"horizon": {"length": "0.0101 + 0.03 * X"}}


@pytest.mark.parametrize("independent", [False, True])
def test_directions_of_pairs(comm, independent):
    """Horizons grow along the plate, and with them G_c lets the longer families fail at less."""
    damage = {"G_c": 5e3, "independent": independent, "exempt": ["ends"], "criterion": "critical_stretch"}
    built = simulation(document("ordinary", body=GRADED) | {"damage": {"steel": damage}})
    p, fracture = built.particles, built.fracture
    u = np.zeros((p.owned, 2))
    u[:, 0] = p.position[: p.owned, 0]
    unit = fracture.worst(fracture.ratios(u))
    fracture.fail(0.8 / 0.6 * u / unit, fracture.ratios(0.8 / 0.6 * u / unit), 1)
    i, j = fracture.families.per_bond(np.arange(p.local)), fracture.families.neighbours
    there = Opposite(p, fracture.families)(np.ones(len(j))) > 0
    single = (Opposite(p, fracture.families)((~fracture.intact).astype(float)) == 0) & there & ~fracture.intact
    assert fracture.count > 0
    assert (comm.allreduce(int(single.sum())) > 0) == independent
    assert not (fracture.intact[single]).any() and len(i) == len(j)


@pytest.mark.parametrize("share, fraction", [("worst", 1.0), ("all", 0.0), (0.9, 0.9)])
def test_how_many_fail_together(comm, share, fraction):
    built = simulation(document("ordinary", bonds_per_pass=share))
    p, fracture = built.particles, built.fracture
    u = np.zeros((p.owned, 2))
    u[:, 0] = 2e-3 * p.position[: p.owned, 0] + 1e-6 * np.sin(100 * p.position[: p.owned, 1])
    u *= 1.5
    ratio = fracture.ratios(u)
    worst = fracture.worst(ratio)
    assert worst > 1.2
    expected = comm.allreduce(int((ratio >= max(1.0, fraction * worst) * (1 - TIE)).sum()))
    assert fracture.fail(u, ratio, 1) >= expected > 0
    kept = fracture.intact & (ratio >= 1)
    assert (comm.allreduce(int(kept.sum())) > 0) == (share != "all")
    assert fracture.fail(np.zeros_like(u), fracture.ratios(np.zeros_like(u)), 2) == 0


def cut(built: Simulation, inside) -> np.ndarray:
    """Ratios that break the bonds between the particles of a set of ids and all others."""
    p, families = built.particles, built.fracture.families
    i, j = p.id[families.per_bond(np.arange(p.local))], p.id[families.neighbours]
    return np.where(np.isin(i, inside) != np.isin(j, inside), 2.0, 0.0)


@pytest.mark.parametrize(
    "model, kind, size",
    [("correspondence", "assembled", 1), ("correspondence", "matrix_free", 9), ("ordinary", "matrix_free", 1),
     ("ordinary", "assembled", 9)],
)  # fmt: skip
def test_splinters_are_held(comm, petsc_options, model, kind, size):
    """What is cut out of the plate stays where it is, and the rest goes on."""
    petsc_options(pd_tangent=kind)
    built = simulation(document(model, damage={"critical": 1.0}, steps=2))
    p = built.particles
    reach = 0.003 if size == 1 else 0.006
    X = whole(comm, p, p.position)
    splinter = np.flatnonzero(np.abs(X - [0.0375, 0.0225]).max(axis=1) < reach)
    assert len(splinter) == size
    zero = np.zeros((p.owned, 2))
    assert built.fracture.fail(zero, cut(built, splinter), 0) > 0
    built.fracture.commit()
    assert comm.allreduce(int(built.fracture.held.sum())) == size and not built.fracture.separated
    assert built.solve() == "converged"
    assert [row["held_particles"] for row in built.rows] == [size, size]
    u = whole(comm, p, built.state.u)
    assert np.abs(u[splinter]).max() < 1e-10 * np.abs(u).max() < np.inf  # that of the solver
    assert np.abs(u).max() == pytest.approx(1e-4, rel=0.1)


def test_particles_on_a_string_come_loose(comm):
    """One bond, or two in line, hold no particle: they break as well."""
    built = simulation(document())
    p, fracture = built.particles, built.fracture
    X = whole(comm, p, p.position)
    one = np.flatnonzero(np.linalg.norm(X - [0.0375, 0.0225], axis=1) < 1e-6)
    ratio = cut(built, one)
    i, j = fracture.families.per_bond(np.arange(p.local)), fracture.families.neighbours
    ratio[np.abs(p.position[i, 1] - p.position[j, 1]) < 1e-6] = 0.0  # those in its row stay
    assert comm.allreduce(int((ratio > 0).sum())) < comm.allreduce(int((cut(built, one) > 0).sum()))
    failed = fracture.fail(np.zeros((p.owned, 2)), ratio, 1)
    assert failed == comm.allreduce(int((cut(built, one) > 0).sum()))
    assert comm.allreduce(int(fracture.held.sum())) == 1


# Steps that fail ----------------------------------------------------------------------------------------------


def test_roll_back(comm, monkeypatch):
    """A pass without equilibrium: bonds, forces and what is held are as before, and the step can be solved again."""
    expected, built = (simulation(document()) for _ in range(2))
    advance, near = Newton.advance, []

    def fail_in_a_later_pass(self, u, time, again=False, quick=False):
        near.append(again)
        if sum(near) == 12:
            self.guess = None  # nothing runs on from there
            raise StepFailed("DIVERGED_MAX_IT")
        return advance(self, u, time, again, quick)

    state, _ = built.passes.advance(built.state, 0.6, last=True)
    built.fracture.commit()
    intact, gone = built.fracture.intact.copy(), built.fracture.count
    probe = np.where(built.assembler.constrained, 0.0, 1e-6 * np.sin(1e3 * built.particles.position[: len(state.u)]))
    force, held = built.assembler.internal_force(state.u + probe), built.fracture.held.copy()
    monkeypatch.setattr(Newton, "advance", fail_in_a_later_pass)
    with pytest.raises(StepFailed, match="MAX_IT"):
        built.passes.advance(state, 0.7, last=True)
    monkeypatch.setattr(Newton, "advance", advance)
    assert np.array_equal(built.fracture.intact, intact) and built.fracture.count == gone > 0
    assert np.array_equal(built.assembler.internal_force(state.u + probe), force)
    assert np.array_equal(built.fracture.held, held) and not built.fracture.separated
    assert np.array_equal(built.assembler.constrained, built.assembler.supported | held[:, None])
    again, record = built.passes.advance(state, 0.7, last=True)
    first, _ = expected.passes.advance(expected.state, 0.6, last=True)
    expected.fracture.commit()
    straight, direct = expected.passes.advance(first, 0.7, last=True)
    assert np.array_equal(all_broken(built), all_broken(expected))
    assert record.broken == direct.broken > gone and record.separated == direct.separated
    assert again.dissipated == pytest.approx(straight.dissipated, rel=1e-8)


FADING = {"critical": 0.002, "softening": {"s_min": 0.0015}}


def test_work_of_a_load_where_softening_stays_as_it_is_at_first(comm, monkeypatch):
    """A force that grows from 0 does half of its last value times its way, however often the step is tried."""
    plate = document("ordinary", damage=FADING, steps=1)
    pull = {"kind": "force", "set": "right", "component": "x", "value": "t"}
    plate["load"] = [plate["load"][0] | {"value": 0.0}, plate["load"][2], pull]
    works = []
    advance = Newton.advance
    for failing in (False, True):
        tries = [failing]

        def fail_at_first(self, u, time, near=False, quick=False, tries=tries):
            if tries[0]:
                self._assembler.set_time(time)
                tries[0] = False
                raise StepFailed("DIVERGED_MAX_IT")
            return advance(self, u, time, near, quick)

        monkeypatch.setattr(Newton, "advance", fail_at_first)
        built = simulation(plate)
        state, record = built.passes.advance(built.state, 1.0, last=True)
        works.append(state.external_work)
        assert state.external_work == pytest.approx(record.stored, rel=1e-3)
        assert abs(state.dissipated) < 1e-8 * record.stored
    assert works[0] == pytest.approx(works[1], rel=1e-8)


def half_fading() -> dict:
    """Bonds soften in the left half of a plate, whose horizon grows to the right; those of the right half are brittle
    and of another model."""
    plate = document("correspondence", damage=FADING, body=GRADED, steps=5, end_time=0.7)
    left, right = plate["material"]["steel"], plate["material"]["steel"] | {"model": "ordinary"}
    brittle = PLATE["damage"]["steel"] | {"critical": 0.0021}
    return plate | {
        "sets": plate["sets"] | {"half": "X < 0.075", "other": "X >= 0.075"},
        "material": {"fading": left | {"where": "half"}, "brittle": right | {"where": "other"}},
        "damage": {"fading": plate["damage"]["steel"], "brittle": brittle},
    }  # fmt: skip


def test_softening_on_any_number_of_ranks(comm):
    """Of one of two materials whose families differ in size: the same bonds fade and fail."""
    together, alone = Run(simulation(half_fading())), Run(simulation(half_fading(), PETSc.COMM_SELF))
    assert_same(together, alone, rel=1e-6)
    lists = [gathered_bonds(run.built.comm.tompi4py(), run.built.fracture.softened()) for run in (together, alone)]
    ordered = [bonds[np.lexsort(bonds.T[:2])] for bonds in lists]
    assert len(ordered[0]) > 50 and ordered[0] == pytest.approx(ordered[1], rel=1e-5)
    failed = whole(comm, together.built.particles, together.built.particles.position)[together.broken[:, :2], 0]
    assert len(failed) > 0 and failed.max() > 0.075 > failed.min()
    total = together.column("external_work")
    missing = total - together.column("stored_energy") - together.column("dissipated")
    assert np.abs(missing).max() < 0.01 * total.max()


def test_restart_of_softening_bonds(comm, shared_tmp_path):
    """From a step in which bonds have faded and others have failed, the others fail as without it."""
    plate = document("correspondence", damage=FADING, steps=15)
    through = Run(simulation(plate))
    middle = int(through.column("step")[through.column("broken_bonds") > 0][0])
    assert 0 < through.rows[middle - 1]["broken_bonds"] < len(through.broken)
    begun = simulation(plate)
    committed = begun._commit

    def commit(state, record):
        committed(state, record)
        record.separated = state.step == middle  # ends the run

    begun._commit = commit
    begun.solve()
    assert comm.allreduce(len(begun.damaged["softened_bonds"])) > begun.rows[-1]["broken_bonds"]
    write_checkpoint(shared_tmp_path, begun.particles, begun.state, {}, begun.damaged)
    again = simulation(plate)
    again.go_on_from(read_state(shared_tmp_path, again.particles), list(begun.rows), read_damaged(shared_tmp_path))
    assert_same(Run(again), through, rel=1e-7)


def test_fading_bonds_go_on_in_teeth(comm):
    """The worst go half a tooth beyond their stretch and then wait for it to come as far again; others go on."""
    built = simulation(document("ordinary", damage=FADING))
    p, fracture = built.particles, built.fracture
    u = np.zeros((p.owned, 2))
    u[:, 0] = 1.5e-3 * (p.position[: p.owned, 0] - 0.075 + 2 * (p.position[: p.owned, 0] - 0.075) ** 2)
    growth = fracture.growth(u)
    assert fracture.worst(growth) > 0.15
    fracture.soften(growth, False)
    first = fracture.largest.copy()
    ratio = fracture.ratios(u)
    worst = comm.allreduce(ratio.max(), MPI.MAX)
    went = first > 0
    assert comm.allreduce(int(went.sum())) > 0 and (ratio[went] > 0.94 * worst).all()
    assert np.allclose(first[went], ratio[went] + STRIDE / 2, rtol=1e-12)
    fracture.soften(fracture.growth((1 + 0.4 * STRIDE) * u), False)
    assert np.array_equal(fracture.largest[went], first[went])
    assert comm.allreduce(int((fracture.largest != first).sum())) > 0
    for _ in range(100):
        fracture.soften(fracture.growth(u), False)
    assert fracture.worst(fracture.growth(u)) <= STRIDE / 2
    fracture.soften(fracture.growth(u), True)
    assert fracture.worst(fracture.growth(u)) == 0.0


@pytest.mark.parametrize("fraction", (0.95, 0.0))
def test_softening_that_leaps(comm, fraction):
    """A coarse step is cut; a fine one goes on in teeth to an equilibrium with the softening that is committed."""
    built = simulation(document("correspondence", damage=FADING, bonds_per_pass=fraction))
    with pytest.raises(StepFailed, match=r"softening leaps by|DIVERGED"):
        built.passes.solve(built.state, built.passes._at(1.0), coarse=True)
    assert not built.fracture.largest.any() and built.fracture.intact.all()
    state, record = built.passes.solve(built.state, built.passes._at(0.75))
    assert record.abandoned > 0 and record.passes[-1].residual_norms[-1] <= 1e-9 * record.passes[-1].residual_scale
    assert built.fracture.worst(built.fracture.growth(state.u)) <= STRIDE / 2
    built.fracture.set_live(False)
    residual = built.assembler.residual_array(state.u)
    assert comm.allreduce((residual**2).sum()) ** 0.5 <= 1e-8 * record.passes[-1].residual_scale
    assert comm.allreduce(int((built.fracture.largest > 0).sum())) > 0


def test_a_bond_at_its_last_tooth_fails_by_its_stretch(comm):
    """Teeth stop short of the critical stretch: a bond that carries nothing has failed."""
    built = simulation(document("ordinary", damage=FADING))
    fracture = built.fracture
    growth = np.where(fracture._exempt, 0.0, 0.995)
    for m, rule in fracture._fading:
        growth[fracture._bonds[m]] -= rule.softening.s_min / fracture._critical(m, rule)
    fracture.soften(np.maximum(growth, 0.0), False)
    assert comm.allreduce(fracture.largest.max(initial=0.0), MPI.MAX) == pytest.approx(0.995)


def test_quick_attempts(comm):
    """Are given up after eight iterations, and the next one has its own limits back."""
    built = simulation(document("correspondence", damage=FADING))
    limit = built.solver.snes.getKSP().getTolerances()[3]
    with pytest.raises(StepFailed):
        built.solver.advance(built.state.u, 1.0, quick=True)
    assert built.solver.record.newton_iterations <= 8
    with contextlib.suppress(StepFailed):
        built.solver.advance(built.state.u, 1.0)
    assert built.solver.record.newton_iterations > 8
    assert built.solver.snes.getKSP().getTolerances()[3] == limit


def test_paths_of_failing_bonds(comm):
    """Along a path cracks do not run on under a standing load; a step without equilibrium is cut."""
    path = simulation(document("ordinary", control="arc_length", max_steps=12))
    cuts = []
    path._failed = lambda *cut: cuts.append(cut)
    assert path.solve() == "converged"
    assert cuts and path.rows[-1]["broken_bonds"] > 0 and len(path.rows) == 12


def test_bonds_that_fail_at_the_end_of_a_path(comm):
    """The last step ends at the end of the schedule, where it is solved again."""
    path = simulation(document("ordinary", control="arc_length", end_time=0.7, steps=7))
    assert path.solve() == "converged"
    assert path.rows[-1]["time"] == 0.7 and path.rows[-1]["passes"] > 1


def test_critical_stretches_that_only_some_ranks_have(comm):
    """Bonds soften from a stretch at which the longest of them are broken: all ranks say so."""
    damage = {"criterion": "critical_stretch", "G_c": 5e3, "softening": {"s_min": 1e-3}}
    graded = document("ordinary", body=GRADED) | {"damage": {"steel": damage}}
    brittle = simulation(graded | {"damage": {"steel": {key: damage[key] for key in ("criterion", "G_c")}}})
    critical = brittle.fracture._rules[0].criterion.critical
    least = comm.allreduce(float(critical.min()), min)
    damage["softening"] = {"s_min": 1.001 * least}
    with pytest.raises(InputError, match=r"damage.steel: softening.s_min: is .*, but bonds of that G_c break at"):
        simulation(graded)


def test_overshoot(comm):
    """An increment that goes too far is cut, by as much as ratios say, and taken where it may not be cut."""
    built = simulation(document())
    with pytest.raises(Overshoot, match=r"a bond is at 1\.\d+ of its critical value") as failure:
        built.passes.advance(built.state, 0.8, last=False)
    assert built.fracture.count == 0
    u, _ = built.solver.advance(built.state.u, 0.8 * failure.value.share)
    assert built.fracture.worst(built.fracture.ratios(u)) == pytest.approx(1.05, rel=5e-3)  # half of what is allowed
    _, record = built.passes.advance(built.state, 0.8, last=True)
    assert record.broken == built.fracture.count > 0

    coarse = Run(simulation(document(steps=1, min_step=0.9)))
    assert coarse.column("time").tolist() == [1.0] and coarse.status == "separated"
    cuts = []
    fine = simulation(document(steps=1))
    fine._failed = lambda reached, tried, reason: cuts.append((tried, reason))
    fine = Run(fine)
    assert cuts[0][0] == 1.0 and "of its critical value" in cuts[0][1]
    assert 0.5 < fine.rows[0]["time"] < 0.65
