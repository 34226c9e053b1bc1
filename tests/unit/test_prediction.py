"""What `pdpetsc check` tells, against what runs build; and what `run` refuses."""

from dataclasses import replace

import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc import building, case, cli, driver, memory
from pdpetsc.case import Case
from pdpetsc.census import FEWEST, FULL, QUICK, take_census
from pdpetsc.errors import InputError
from pdpetsc.memory import GIB
from pdpetsc.prediction import check_fits, factor_bytes, predict
from pdpetsc.simulation import Simulation
from pdpetsc.solvers.tangent import choose

MODELS = ("ordinary", "correspondence", "bond")


pytestmark = pytest.mark.usefixtures("petsc_options")


def cube(edge, model="ordinary", horizon=3.015, dim=3, **material):
    body = {"size": [float(edge)] * dim, "spacing": 1.0, "horizon": horizon}
    load = {"kind": "displacement", "set": "all", "component": "all", "value": 0.0}
    table = {"model": model, "E": 1.0, "nu": 0.25} | material
    return {"body": body, "material": {"steel": table}, "load": [load]}


def made(document):
    return Case.from_document(document, "my", None, "my.toml", False)


# Counts -------------------------------------------------------------------------------------------------------

WHOLE = [
    "clamped_beam", "cantilever:d2", "hanging_block", "simple_shear", "large_rotation:bond",
    "bimaterial_strip:horizons", "bimaterial_strip:mixed", "bimaterial_strip:line_bond",
    "two_zone_plate", "two_zone_plate:coarse",
]  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize("name", WHOLE)
def test_counts_and_choice_are_those_of_the_run(name, comm):
    chosen = case.load(name)
    told = predict(chosen, comm.size)
    simulation = Simulation(chosen, PETSc.COMM_WORLD)
    bonds = comm.allreduce(simulation.families.bonds)
    most = comm.allreduce(int(np.diff(simulation.families.offsets).max(initial=0)), max)
    entries = simulation.assembler.matrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    assert (told.dim, told.particles, told.exact) == (simulation.particles.dim, simulation.particles.count, True)
    assert told.bonds == pytest.approx(bonds, rel=0.02)
    assert 0.8 * most <= told.most <= most
    assert told.entries["assembled"] == pytest.approx(entries, rel=0.1)
    assert told.kind == simulation.solver.tangent.kind
    simulation.solver.destroy()


@pytest.mark.mpi
@pytest.mark.parametrize("dim", (1, 2, 3))
@pytest.mark.parametrize("model", MODELS)
def test_entries(model, dim, comm, petsc_options):
    """Of tangent and compact matrix, where the sample is the body (1D) and where it is not."""
    edge = {1: 300, 2: 40, 3: 12}[dim]
    chosen = made(cube(edge, model, dim=dim))
    told = predict(chosen, comm.size)
    petsc_options(pd_tangent="matrix_free")
    simulation = Simulation(chosen, PETSc.COMM_WORLD)
    found = {"assembled": simulation.assembler.matrix(), "matrix_free": simulation.solver.tangent.preconditioner}
    for kind, matrix in found.items():
        entries = matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        assert told.entries[kind] == pytest.approx(entries, rel=0.02)
    simulation.solver.destroy()


@pytest.mark.parametrize(("follower", "solver"), [(True, "gmres + gamg"), (False, "cg + gamg")])
def test_a_follower_makes_the_tangent_unsymmetric(petsc_options, follower, solver):
    petsc_options(pc_type="gamg")
    document = cube(8, "ordinary", dim=2)
    document["load"] += [{"kind": "pressure", "surface": "top", "value": 0.1, "follower": follower}]
    assert predict(made(document), 1).solver.startswith(solver)


@pytest.mark.parametrize(
    "model, more, solver",
    [("ordinary", {"softening": {"s_min": 0.5}}, "gmres + gamg"), ("ordinary", {}, "cg + gamg"),
     ("bond", {"softening": {"s_min": 0.5}}, "cg + gamg")],
)  # fmt: skip
def test_softening_makes_the_tangent_unsymmetric_where_neighbours_are_coupled(petsc_options, model, more, solver):
    petsc_options(pc_type="gamg")
    failing = {"damage": {"steel": {"criterion": "critical_stretch", "critical": 1.0} | more}}
    document = made(cube(8, model, dim=2) | failing)
    simulation = Simulation(document, PETSc.COMM_SELF)
    assert simulation.assembler.symmetric == solver.startswith("cg")
    assert predict(document, 1).solver.startswith(solver)
    simulation.solver.destroy()


def test_where_bonds_fail_a_direct_solver_is_for_smaller_bodies():
    """60 x 60 particles of a horizon of three spacings have a tangent of a million entries."""
    failing = {"damage": {"steel": {"criterion": "critical_stretch", "critical": 1.0}}}
    whole, damaged = predict(made(cube(60, dim=2)), 1), predict(made(cube(60, dim=2) | failing), 1)
    assert "lu" in whole.solver.lower() or "cholesky" in whole.solver.lower() or "mumps" in whole.solver.lower()
    assert damaged.solver != whole.solver


def test_a_body_as_large_as_the_sample_is_counted_whole():
    """8 x 8 x 8 particles; a family of 2.015 spacings has 32 neighbours where it is whole."""
    axis = np.arange(8.0)
    X = np.stack([a.ravel() for a in np.meshgrid(axis, axis, axis)], axis=1)
    near = np.linalg.norm(X[:, None] - X, axis=2) <= 2.015
    census = take_census(made(cube(8, "bond", 2.015)))
    assert census.bonds == pytest.approx(near.sum() - 512, rel=1e-12)
    assert census.blocks == pytest.approx(near.sum(), rel=1e-12)  # central forces: a row is a family
    assert census.most == 32


@pytest.mark.mpi
def test_the_answer_does_not_depend_on_the_ranks_that_ask(comm):
    census = take_census(case.load("two_zone_plate"), QUICK)
    alone = comm.bcast((census.particles, census.bonds, census.blocks, census.compact, census.shortness))
    assert alone == (census.particles, census.bonds, census.blocks, census.compact, census.shortness)
    assert census.particles == predict(case.load("two_zone_plate"), 7).particles == 1408


@pytest.mark.parametrize("keep", (None, "hypot(X - 235, Y - 235) > 100 and Z < 400"))
def test_a_hundred_million_particles(keep, tmp_path, capsys):
    document = cube(470)
    whole = 470**3
    if keep:
        document["body"]["keep"] = keep
        whole = 400 * (470**2 - np.pi * 100**2)
    told = predict(made(document), 1000, FULL._replace(cells=10**5, samples=64))
    assert told.exact == (keep is None)
    assert told.particles == pytest.approx(whole, rel=0.01)
    assert told.bonds == pytest.approx(122 * whole, rel=0.03)
    assert told.kind == "matrix_free"


def test_large_families_are_sampled_less():
    """The rows of a sample are taken from its beginning."""
    chosen = made(cube(30))
    few, many = (take_census(chosen, FULL._replace(pairs=pairs)) for pairs in (1.0, 1e9))
    assert few.bonds == many.bonds
    assert few.blocks == pytest.approx(many.blocks, rel=0.1) and few.blocks != many.blocks and FEWEST < 100


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"keep": "X < 0"}, "body.keep: no particle is left"),
        ({"horizon": {"length": 0.5}}, "body.horizon: the particle at"),
        ({"horizon": {"length": "X - 2"}}, "body.horizon: is -1.5 at (0.5, 0.5)"),
        ({"refine": "0.5"}, "body.refine: is 0.5 at"),
        ({"spacing": 1.7}, "body.size: [4.0, 4.0] is not a multiple of the spacing 1.7"),
        ({"spacing": 1e-5, "size": [4.0, 4.0]}, "body.spacing: 1e-05 makes 1.6e+11 particles"),
    ],
)
def test_impossible_bodies(changes, message):
    document = cube(4, dim=2)
    document["body"] |= changes
    with pytest.raises(InputError) as error:
        predict(made(document), 1)
    assert str(error.value).startswith("my.toml: ") and message in str(error.value)


# The choice ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "given", "kind"),
    [
        ((3, 1000, 1e5), {}, "assembled"),  # 0.9 million entries
        ((3, 10_000, 5e6), {}, "matrix_free"),
        ((3, 10_000, 5e5), {}, "assembled"),  # few neighbours
        ((3, 1000, 1e5), {"pc_type": "gamg"}, "matrix_free"),
        ((3, 10_000, 5e6), {"pc_type": "cholesky"}, "assembled"),
        ((3, 1000, 1e5), {"pd_tangent": "matrix_free", "pc_type": "lu"}, "matrix_free"),
        ((3, 10_000, 5e6), {"pd_tangent": "assembled"}, "assembled"),
    ],
)
def test_choose(arguments, given, kind):
    assert choose(*arguments, given)[0] == kind


@pytest.mark.mpi
def test_a_body_that_a_quick_look_misses_is_not_assembled(monkeypatch):
    def missed(case, effort):
        raise InputError("body.keep: no particle is left")

    monkeypatch.setattr(building, "take_census", missed)
    run = Simulation(made(cube(8)), PETSc.COMM_WORLD)
    assert run.solver.tangent.kind == "matrix_free"
    run.solver.destroy()


@pytest.mark.parametrize("word", ("free", ""))
def test_an_unknown_tangent(petsc_options, word):
    petsc_options(pd_tangent=word)
    with pytest.raises(InputError, match=rf"my.toml: -pd_tangent: is '{word}'; choices: assembled, matrix_free"):
        predict(made(cube(4)), 1)


# Explicit dynamics --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", (1, 2, 3))
@pytest.mark.parametrize("model", MODELS)
def test_the_time_step_is_stable_and_not_much_too_small(model, dim):
    """Against 2/omega of the largest eigenvalue of K/(rho V), from power iteration; the size has no part in it."""
    edge = {1: 40, 2: 16, 3: 9}[dim]
    chosen = made(cube(edge, model, dim=dim, density=4.0))
    told = predict(chosen, 1).time_step
    simulation = Simulation(chosen, PETSc.COMM_SELF)
    assembler = simulation.assembler
    assembler.linearise(np.zeros((edge**dim, dim)))
    v = np.random.default_rng(1).normal(size=(edge**dim, dim))
    for _ in range(100):
        v /= np.linalg.norm(v)
        v = assembler.action(v) / (4.0 * simulation.particles.volume[:, None])
    limit = 2 / np.linalg.norm(v) ** 0.5
    assert 0.4 * limit < told < limit
    simulation.solver.destroy()


def test_no_density():
    told = predict(made(cube(4)), 1)
    assert told.time_step is None and told.without_density == ("steel",)


# Memory -------------------------------------------------------------------------------------------------------


def test_the_memory_of_real_runs():
    """`peak_memory_mb` of runs as in prediction.py: 40^3 particles matrix-free, 20^3 with all entries."""
    assert predict(made(cube(40)), 1).memory["matrix_free"] / 2**20 == pytest.approx(764, rel=0.25)
    assert predict(made(cube(40)), 2).memory["matrix_free"] / 2**20 == pytest.approx(650, rel=0.25)
    assert predict(made(cube(20, "correspondence")), 1).memory["assembled"] / 2**20 == pytest.approx(1398, rel=0.25)
    assert predict(made(cube(20)), 2).memory["assembled"] / 2**20 == pytest.approx(822, rel=0.25)


def test_factors_grow_faster_than_the_body():
    for dim in (2, 3):
        small, large = (factor_bytes(dim, n, 50 * n) for n in (10**4, 10**6))
        assert small < large


def test_too_many_entries():
    told = predict(made(cube(150)), 2)
    check_fits(told, None)
    with pytest.raises(InputError) as error:
        check_fits(replace(told, kind="assembled", forced=True), None)
    assert str(error.value) == (
        "the assembled tangent of this case has about 1.2e+10 entries on each of 2 ranks, more than this PETSc's "
        "32-bit integers can count; use -pd_tangent matrix_free (or leave that option out), more ranks, or a PETSc "
        "configured with 64-bit indices"
    )


def test_only_what_is_far_too_large_is_refused():
    told = replace(predict(made(cube(8)), 1), kind="matrix_free", memory={"assembled": 1.0, "matrix_free": 10 * GIB})
    check_fits(told, 9.5 * GIB)
    check_fits(told, None)
    with pytest.raises(
        InputError, match=r"needs about 10 GiB on its one rank .* but only 8 GiB are free for each; use more"
    ):
        check_fits(told, 8 * GIB)


@pytest.mark.mpi
def test_a_run_that_does_not_fit_is_refused_before_it_builds_anything(comm, shared_tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(driver, "memory_per_rank", lambda _: 1e6)
    monkeypatch.setattr(driver, "Run", None)
    assert cli.main(["clamped_beam", "--out", str(shared_tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert said.out == "" and not (shared_tmp_path / "out").exists()
    if comm.rank == 0:
        assert said.err.startswith("pdpetsc: error: clamped_beam.toml: this case needs about 0.2")
        assert said.err.endswith("are free for each; use more machines, or a larger spacing\n")


@pytest.mark.mpi
def test_check_says_so_too(comm, monkeypatch, capsys):
    monkeypatch.setattr(driver, "available_memory", lambda: 8e6)
    assert cli.main(["check", "clamped_beam", "--ranks", "8"]) == 2
    said = capsys.readouterr().out
    if comm.rank == 0:
        assert "particles  456\n" in said and "on each of 8 ranks" in said
        assert "refused    on 8 ranks of this machine: this case needs about 0.2" in said
    else:
        assert said == ""


@pytest.mark.mpi
def test_all_ranks_have_a_share_of_the_memory(comm):
    share = memory.memory_per_rank(comm)
    assert share is None or 0 < share * comm.size <= 1e15
    assert len(set(comm.allgather(share))) == 1


def test_memory_of_machine_and_control_groups(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "SYSTEM", tmp_path)
    assert memory.available_memory() is None
    files = {
        "proc/meminfo": "MemTotal:  9000 kB\nMemAvailable:  4000 kB\n",
        "proc/self/cgroup": "0::/job/step\n",
    }
    _write(tmp_path, files)
    assert memory.available_memory() == 4000 * 1024
    group = {
        "memory.max": "max\n", "memory.current": "9\n",
        "job/memory.max": "3000000\n", "job/memory.current": "2000000\n",
        "job/memory.stat": "anon 1\ninactive_file 500\n",
        "job/step/memory.max": "max\n", "job/step/memory.current": "2000000\n",
    }  # fmt: skip
    _write(tmp_path / "sys/fs/cgroup", group)
    assert memory.available_memory() == 3000000 - 2000000 + 500
    _write(tmp_path, {"proc/self/cgroup": "4:cpu,memory:/slurm\n3:cpuset:/\n0::/\n"})
    old = {"memory.limit_in_bytes": "5000\n", "memory.usage_in_bytes": "6000\n"}
    _write(tmp_path / "sys/fs/cgroup/memory/slurm", old)
    assert memory.available_memory() == 0.0


def _write(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
