"""Adaptive refinement: the same particles as a lattice made by hand, what is kept, cracks that stay open, any number of
ranks, restarts."""

import json
from pathlib import Path

import numpy as np
import pytest
from bodies import whole
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.io.checkpoint import gathered_bonds, write_checkpoint
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

SIZES = {1: [24.0], 2: [16.0, 8.0], 3: [8.0, 6.0, 6.0]}
STEEL = {"model": "ordinary", "E": 1.0, "nu": 0.3, "density": 1.0}


def document(dim: int = 2, refinement=None, **tables) -> dict:
    """A block on a foot that is pulled."""
    steel = STEEL | ({"nu": 0.0} if dim == 1 else {})
    described = {
        "body": {"size": SIZES[dim], "spacing": 1.0, "horizon": 2.015},
        "sets": {"left": "X < 2", "right": f"X > {SIZES[dim][0] - 2}"},
        "material": {"steel": steel},
        "load": [
            {"kind": "displacement", "set": "left", "component": "all", "value": 0.0},
            {"kind": "body_force", "set": "right", "component": "x", "value": "1e-3 * t"},
        ],
        "solver": {"steps": 1},
    }
    return described | ({"refinement": refinement} if refinement else {}) | tables


def moving(dim: int = 2, refinement=None, **tables) -> dict:
    """The block, free, turning, and swinging."""
    turning = (
        [{"component": "x", "velocity": "-3e-3 * Y"}, {"component": "y", "velocity": "3e-3 * X"}] if dim > 1 else []
    )
    swinging = [{"component": "x", "displacement": "2e-2 * sin(X / 3)"}]
    solver = {"mode": "verlet", "end_time": 20.0, "steps": 40}
    return document(dim, refinement, load=[], initial=turning + swinging, solver=solver) | tables


def simulation(described: dict, comm=PETSc.COMM_WORLD, checkpoint: Path | None = None) -> Simulation:
    return Simulation(Case.from_document(described, "block", None, "block.toml", False), comm, checkpoint=checkpoint)


def solved(described: dict, comm=PETSc.COMM_WORLD) -> Simulation:
    built = simulation(described, comm)
    built.solve()
    return built


def columns(built: Simulation, *fields) -> np.ndarray:
    """Position, volume, spacing, horizon and fields of all particles, in the order of the positions."""
    p = built.particles
    parts = [p.position[: p.owned], *(getattr(p, name)[: p.owned, None] for name in ("volume", "spacing", "horizon"))]
    rows = np.concatenate(built.comm.tompi4py().allgather(np.concatenate([*parts, *fields], axis=1)))
    return rows[np.lexsort(np.round(rows[:, : p.dim], 9).T)]


@pytest.mark.parametrize("late", (False, True))
@pytest.mark.parametrize("dim", SIZES)
def test_the_same_as_a_lattice_made_by_hand(dim, late):
    """Particles, and the equilibrium that is found on them: at the start, or again after the first step."""
    middle = SIZES[dim][0] / 2
    by_hand = document(dim)
    by_hand["body"] = by_hand["body"] | {"refine": f"where(X > {middle}, 2, 1)"}
    expected, found = (
        solved(by_hand),
        solved(document(dim, {"where": f"X > {middle} and t > {int(late) - 0.5}", "rings": 0})),
    )
    assert [row["particles"] for row in found.rows][-1] == expected.particles.count
    a, b = (columns(built, built.state.u) for built in (expected, found))
    assert np.allclose(a[:, : dim + 3], b[:, : dim + 3], rtol=1e-13, atol=1e-13)
    # loads of sets: the force density is that of the coarse particles in both
    assert np.abs(a - b).max() < 1e-9 * np.abs(a[:, dim + 3 :]).max()
    assert [row["time"] for row in found.rows] == [1.0] * (1 + late)


@pytest.mark.parametrize(("dim", "levels"), [(1, 1), (2, 1), (2, 3), (3, 1)])
def test_what_is_kept(comm, dim, levels):
    """Mass, momenta, and the volume of every parent, to rounding; energies nearly. Spacings stay in proportion."""
    spot = "abs(X - 8) < 1.1" if dim > 1 else "abs(X - 12) < 1.1"
    built = solved(moving(dim, {"where": f"{spot} and t > 1", "levels": levels, "every": 5}))
    assert len(built.refinements) == levels and built.refinements[-1]["particles"] == built.particles.count
    for row in built.refinements:
        assert max(row[name] for name in ("volume", "mass", "momentum", "angular_momentum")) < 1e-14
        assert 0 < abs(row["stored"]) + abs(row["kinetic"]) < 0.02 * built.state.brought
    energies = built.solver.energies(built.state)
    assert abs(energies["imbalance"]) < 1e-3 * built.state.brought
    p, families = built.particles, built.families
    ratio = p.spacing[families.neighbours] / families.per_bond(p.spacing)
    assert comm.allreduce(float(ratio.max()), op=MPI.MAX) < 2.001
    assert comm.allreduce(float(p.spacing.min()), op=MPI.MIN) == 1 / 2**levels
    assert np.allclose(p.horizon, 2.015 * p.spacing, rtol=1e-14)


def test_ids(comm):
    """Are dense; a particle that is not split keeps its own, and parts know their parent."""
    before = simulation(document())
    start = columns(before, before.particles.id[: before.particles.owned, None])
    after = solved(document(2, {"where": "X > 6 and X < 9", "rings": 0}))
    p = after.particles
    ids, parents, ancestors = (
        np.concatenate(comm.allgather(values)).astype(int)
        for values in (p.id[: p.owned], p.carried["parent"], p.carried["ancestor"])
    )
    assert sorted(ids) == list(range(p.count))
    assert (parents[ids < 128] == ids[ids < 128]).all() and (parents[ids >= 128] < 128).all()
    assert np.array_equal(parents, ancestors)
    assert np.array_equal(np.bincount(parents)[np.unique(parents[ids >= 128])], np.full(24, 4))
    end = columns(after, p.id[: p.owned, None])
    stayed = end[:, 3] == 1.0
    assert np.array_equal(end[stayed], start[(start[:, 0] < 6) | (start[:, 0] > 9)])


@pytest.mark.parametrize("dim", (2, 3))
def test_affine_fields_go_over_exactly(dim):
    described = moving(dim, {"where": "X > 3 and X < 6", "rings": 0})
    affine = ["1e-3 * X + 2e-3 * Y", "-1e-3 * Y", "3e-3 * Z + 1e-3 * X"][:dim]
    described["initial"] = [{"component": axis, "displacement": text} for axis, text in zip("xyz", affine)]
    described["initial"] += [{"component": "x", "velocity": "1e-3 * X"}]  # it does not turn
    built = simulation(described)
    built.state.step = 10
    assert built._mark(built.state) and built._refine()
    X = built.particles.position[: built.particles.owned]
    A = np.array([[1e-3, 2e-3, 0], [0, -1e-3, 0], [1e-3, 0, 3e-3]])[:dim, :dim]
    assert np.allclose(built.state.u, X @ A.T, rtol=0, atol=1e-16)
    v = X * [1e-3, 0, 0][:dim]
    assert np.abs(built.state.v - v).max(initial=0.0) < 2e-5  # but for the spin that the parts have of cells that shear


DAMAGE = {"steel": {"criterion": "critical_stretch", "critical": 0.012}}


def torn(refinement=None) -> dict:
    """A plate with an edge crack that is torn, until it is in two."""
    described = document(2, refinement, damage={"steel": DAMAGE["steel"] | {"exempt": ["top", "bottom"]}})
    described["body"] = {
        "size": [16.0, 10.0], "spacing": 1.0, "horizon": 3.015, "cracks": [{"from": [-1.0, 5.0], "to": [5.0, 5.0]}],
    }  # fmt: skip
    described["sets"] = {"top": "Y > 8", "bottom": "Y < 2"}
    described["load"] = [
        {"kind": "displacement", "set": "top", "component": "y", "value": "0.2 * t"},
        {"kind": "displacement", "set": "bottom", "component": "y", "value": "-0.2 * t"},
        {"kind": "displacement", "set": "bottom", "component": "x", "value": 0.0},
    ]
    described["solver"] = {"steps": 10}
    return described


@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize("where", ("X < 5", "X < 5 and Y > 4", "Y < 2", "X > 100 or Y > 0"))
def test_a_crack_stays_open(comm, dim, where):
    """Bonds that cross a plane are broken: those of the refined body that cross it are, and no others."""
    described = moving(dim, {"where": where, "rings": 0}, damage=DAMAGE)
    described["body"] = described["body"] | {"size": [10.0, 8.0, 3.0][:dim], "horizon": 3.015}
    built = simulation(described)
    step = np.where(crossing(built, 4.0), 3, 0)
    built.fracture.take_over(step, np.empty(0), built.state.u)
    built.state.step = 10
    assert built._mark(built.state) and built._refine()
    assert np.array_equal(~built.fracture.intact, crossing(built, 4.0))
    assert set(built.fracture.step[~built.fracture.intact]) <= {3}


def crossing(built: Simulation, y: float) -> np.ndarray:
    """Mask of the bonds from one side of a plane to the other."""
    p, families = built.particles, built.families
    side = p.position[:, 1] > y
    return families.per_bond(side) != side[families.neighbours]


SLOW = pytest.param("relaxation", marks=pytest.mark.slow)


@pytest.mark.parametrize("mode", ("newton", SLOW, "verlet", "generalised_alpha"))
def test_a_crack_grows_in_a_refined_zone(comm, mode):
    """From a notch, step by step; what breaks balances."""
    described = torn({"where": "damage > 0.1", "every": 5 if mode in ("verlet", "generalised_alpha") else 1})
    described["solver"] |= {"mode": mode}
    if mode in ("verlet", "generalised_alpha"):
        described["solver"] = {"mode": mode, "end_time": 60.0, "steps": 200}
        described["solver"] |= {"adaptive": False} if mode == "generalised_alpha" else {}
        pull = {"kind": "velocity", "component": "y"}
        described["load"] = [pull | {"set": "top", "value": 3e-3}, pull | {"set": "bottom", "value": -3e-3}]
    built = solved(described)
    assert len(built.refinements) > 2 and built.fracture.count > 500
    if mode == "verlet":  # the others take long steps
        energies = built.solver.energies(built.state)
        assert abs(energies["imbalance"]) < 3e-3 * energies["external_work"]
    p = built.particles
    damage = built.recovery.damage > 0.1
    assert comm.allreduce(int((damage & (p.spacing[: p.owned] == 0.5)).sum())) > 100


@pytest.mark.mpi(min_size=2)
@pytest.mark.parametrize("described", [
    torn({"where": "damage > 0.1", "beside": "damage > 0.01"}),
    torn({"where": "energy > 4e-5", "levels": 2}) | {"solver": {"steps": 3, "end_time": 0.3}},
    torn({"where": "damage > 0.1"}) | {
        "solver": {"mode": "verlet", "end_time": 40.0, "steps": 130},
        "load": [{"kind": "velocity", "set": "top", "component": "y", "value": 8e-3}],
    },
])  # fmt: skip
def test_the_same_on_any_number_of_ranks(comm, described):
    built, alone = solved(described), solved(described, PETSc.COMM_SELF)
    assert [r["particles"] for r in built.refinements] == [r["particles"] for r in alone.refinements] != []
    p = built.particles
    u = np.empty((p.count, 2))
    u[alone.particles.id[: alone.particles.owned]] = alone.state.u
    assert np.abs(whole(comm, p, built.state.u) - u).max() < 1e-7 * np.abs(u).max()
    broken = gathered_bonds(comm, built.fracture.broken())
    assert np.array_equal(broken, gathered_bonds(alone.comm.tompi4py(), alone.fracture.broken()))


@pytest.mark.parametrize("mode", ("verlet", "newton"))
def test_restart(comm, shared_tmp_path, mode):
    """From a checkpoint of a refined body, and from the one before the refinement: as if the run had gone on."""
    if mode == "verlet":
        described = torn({"where": "damage > 0.1"})
        described["solver"] = {"mode": "verlet", "end_time": 40.0, "steps": 130}
        described["load"] = [{"kind": "velocity", "set": "top", "component": "y", "value": 8e-3}]
        described["output"] = {"history": 10}
        at = 90
    else:
        described, at = torn({"where": "damage > 0.1"}), 5
    through, begun = solved(described), simulation(described)
    name = "_commit_motion" if mode == "verlet" else "_commit"
    committed = getattr(begun, name)

    def commit(state, *rest):
        result = committed(state, *rest)
        if state.step == at:
            write_checkpoint(shared_tmp_path, begun.particles, begun.state, begun.description, begun.damaged)
        return result

    setattr(begun, name, commit)
    begun.solve()
    kept = comm.bcast(json.loads(json.dumps(begun.description))["refinements"])
    assert kept[0]["step"] < at < kept[-1]["step"] or mode == "newton"
    again = simulation(described, checkpoint=shared_tmp_path)
    assert again.rows[-1]["step"] == at and again.particles.count > 160
    again.solve()
    assert [r["particles"] for r in again.refinements] == [r["particles"] for r in through.refinements]
    if mode == "verlet":
        assert np.array_equal(again.state.u, through.state.u) and np.array_equal(again.state.v, through.state.v)
    else:
        assert np.allclose(again.state.u, through.state.u, rtol=0, atol=1e-10)
    assert np.array_equal(*(gathered_bonds(comm, built.fracture.broken()) for built in (again, through)))
    assert again.state.dissipated == pytest.approx(through.state.dissipated, rel=1e-9)


def test_fitted_bodies(comm):
    """Cells are cut anew; each parent's volume is shared, and surfaces stay closed, with what they carry."""
    described = document(2, {"where": "hypot(X - 8, Y - 4) < 4", "levels": 2, "rings": 0})
    described["body"] = described["body"] | {
        "size": [16.0, 8.0], "keep": "hypot(X - 8, Y - 4) > 2.2", "fitted": True,
    }  # fmt: skip
    described["load"] = [
        {"kind": "pressure", "surface": "border", "value": 1e-3},
        {"kind": "traction", "surface": "right", "component": "x", "value": 1e-3},
        described["load"][0],
    ]
    before, after = simulation(described), solved(described)
    total, first = (comm.allreduce(float(b.particles.volume[: b.particles.owned].sum())) for b in (after, before))
    assert total == pytest.approx(first, rel=1e-14) and len(after.refinements) >= 2
    assert all(row["volume"] < 1e-14 for row in after.refinements)
    facets = after.particles.facets
    area = comm.allreduce(np.array([facets.area[facets.face == face].sum(axis=0) for face in (6, 1)]))
    assert np.abs(area[0]).max() < 1e-12 and area[1] == pytest.approx([8.0, 0.0])
    length = comm.allreduce(float(np.linalg.norm(facets.area[facets.face == 6], axis=1).sum()))
    assert length == pytest.approx(2 * np.pi * 2.2, rel=1.5e-2)  # pieces of cells without a particle stay as they were
    u = after.state.u
    force = comm.allreduce(after.assembler.external_force(u).sum(axis=0))
    assert force == pytest.approx([8e-3, 0.0], abs=2e-6)


def test_softened_bonds_stay_soft(comm):
    """What bonds have lost is not given back."""
    described = torn({"where": "X > 4 and X < 9 and abs(Y - 5) < 2 and t > 0.45"})
    described["damage"]["steel"] |= {"softening": {"s_min": 0.004, "beta": 1.2}}
    described["solver"] = {"steps": 10, "end_time": 0.5}
    built = simulation(described)
    lists = []
    refine = built._refine

    def refined():
        lists.append(gathered_bonds(comm, built.fracture.softened()))
        result = refine()
        lists.append(gathered_bonds(comm, built.fracture.softened()))
        return result

    built._refine = refined
    built.solve()
    assert built.refinements
    before, after = next((a, b) for a, b in zip(lists[::2], lists[1::2]) if len(b) > len(a))
    assert len(before) > 0
    assert after[:, 2].max() == before[:, 2].max() and set(after[:, 2]) <= set(before[:, 2])


def test_hysteresis_and_rings():
    """`beside` adds what is next to marked particles and to split ones; rings add the neighbourhood."""
    line = document(1)
    line["body"] = line["body"] | {"size": [40.0]}

    def count(**keys):
        return solved(line | {"refinement": {"where": "abs(X - 20) < 1", "rings": 0} | keys}).particles.count

    assert count() == 42
    assert count(rings=1) == 46 and count(rings=2) == 50
    assert count(beside="abs(X - 20) < 2") == 44
    assert count(beside="abs(X - 30) < 2") == 42


NEEDLE = "(X < 6.6) or (Y > 3 and Y < 4 and X < 7.15 and abs(Y - 3.5 + 0.3 * (X - 6.5)) < 0.075)"


@pytest.mark.parametrize("mode", ("newton", "verlet"))
def test_what_cannot_be_split_stays(mode):
    """A particle with too little of the body in its cell: the run goes on without it."""
    described = document(2, {"where": "X > 7", "rings": 0, "every": 1})
    described["body"] = described["body"] | {"size": [16.0, 8.0], "keep": NEEDLE, "fitted": True}
    described["sets"] = {"left": "X < 2", "right": "X > 5.5"}
    if mode == "verlet":
        described |= {"solver": {"mode": "verlet", "end_time": 2.0, "steps": 10}}
    built = solved(described)
    assert built.refinements == [] and built.particles.count == simulation(described).particles.count


def test_a_single_row(comm):
    """Has no gradient across: fields go over as they are in that direction."""
    described = moving(2, {"where": "abs(X - 8) < 1 and t > 1", "every": 5})
    described["body"] = described["body"] | {"size": [16.0, 1.0]}
    described["material"]["steel"] = {"model": "bond", "E": 1.0, "plane": "stress", "density": 1.0}
    built = solved(described)
    assert built.refinements and np.isfinite(built.state.u).all()


def test_given_steps_that_are_too_long():
    """For a body that is refined before the first step they are made shorter, too; at the end nothing is refined."""
    described = moving(2, {"where": "X > 8", "levels": 2})
    described["solver"] = {"mode": "verlet", "end_time": 20.0, "steps": 40}
    built = solved(described)
    steps = built.solver.steps
    assert steps.size <= 0.9 * steps.stable < 0.5
    assert not built._mark(built.state)


def test_more_ranks_than_particles():
    """Whatever the condition asks for."""
    line = document(1)
    line["body"] = line["body"] | {"size": [3.0], "horizon": 1.2}
    line["sets"] = {"left": "X < 1", "right": "X > 2"}
    fields = " or ".join(f"{name} > 1e9" for name in ("u", "F", "stress", "strain", "reaction", "principal", "damage"))
    assert solved(line | {"refinement": {"where": f"X > 2 or {fields}"}}).particles.count > 3


def test_loads_at_the_start():
    """Are those of the start."""
    described = moving(2, {"where": "force > 0", "rings": 0, "every": 1000})
    described["load"] = [{"kind": "body_force", "set": "right", "component": "x", "value": "1e-3 * t"}]
    assert solved(described).refinements == []


def test_supports_hold_what_is_split(comm):
    """Parts of held particles are where the support has them; the balance of energies knows."""
    described = moving(2, {"where": "X < 5 and t > 5", "rings": 0})
    described["load"] = [{"kind": "displacement", "set": "left", "component": "all", "value": 0.0}]
    described["initial"] = [{"component": "x", "displacement": "5e-2 * X"}]
    built = solved(described)
    energies = built.solver.energies(built.state)
    assert built.refinements and abs(energies["imbalance"]) < 2e-3 * energies["brought"]


@pytest.mark.parametrize(("change", "message"), [
    ({"body": {"size": [16.0, 8.0], "spacing": 1.0, "horizon": 2.015, "particles": "vertices"}},
     'body.particles = "cells"'),
    ({"solver": {"control": "arc_length"}}, 'not with solver.control = "arc_length"'),
    ({"refinement": {"where": "damge > 0.1"}}, r"refinement.where: .*damge.*did you mean 'damage'"),
    ({"refinement": {"where": "damage"}}, "refinement.where: .* is a number where a condition is needed"),
    ({"refinement": {}}, "refinement.where: is missing"),
    ({"refinement": {"where": "damage > 0", "levels": 0}}, "refinement.levels: must be"),
])  # fmt: skip
def test_what_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        Case.from_document(document(2, {"where": "damage > 0.1"}) | change, "block", None, "block.toml", False)
