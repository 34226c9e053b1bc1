"""Runs inside MPI, on 1, 2 and 3 ranks: bad input, load stepping, results, units, and one rank against several."""

import copy
import csv
import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import tomli_w
from petsc4py import PETSc

from pdpetsc import case
from pdpetsc.io.tables import is_result
from pdpetsc.simulation import Simulation
from pdpetsc.summary import summary_of

pytestmark = pytest.mark.mpi

CANTILEVER = {  # one row of families clamped, a force at the other end
    "title": "A short cantilever",
    "body": {"size": [12.0, 3.0], "spacing": 1.0, "horizon": 1.515, "layers": {"left": "horizon"}},
    "sets": {"clamp": "X < 0", "end": "X > 11", "tip": {"nearest": [12.0, 1.5]}},
    "material": {"rubber": {"model": "correspondence", "E": 1.0, "nu": 0.25}},
    "load": [
        {"kind": "displacement", "set": "clamp", "component": "all", "value": 0.0},
        {"kind": "force", "set": "end", "component": "y", "value": "-2e-3 * t"},
    ],
    "solver": {"steps": 2},
    "probe": [
        {"name": "tip", "field": "u", "set": "tip", "reduce": "mean"},
        {"name": "pull", "field": "reaction", "component": "y", "set": "clamp", "reduce": "sum"},
        {"name": "axis", "field": "u", "component": "y", "line": [[0.5, 1.5], [11.5, 1.5], 5]},
        {"name": "stress", "field": "stress", "at": [1.0, 1.5]},
    ],
}


def changed(document: dict, *removed: str, **entries) -> dict:
    """A copy with entries set or removed, named as by --set with __ for the dots: body__spacing=1.0."""
    document = copy.deepcopy(document)
    for key, value in [*((name, None) for name in removed), *entries.items()]:
        *parents, last = (int(part) if part.isdigit() else part for part in key.split("__"))
        inner = document
        for part in parents:
            inner = inner[part] if isinstance(inner, list) else inner.setdefault(part, {})
        if key in removed:
            del inner[last]
        else:
            inner[last] = value
    return document


def fields(result, step):
    with h5py.File(result.out / "fields.h5", "r") as file:
        return {name: values[...] for name, values in file[f"{step:05d}"].items()}


# Bad input


BAD = {
    "typo in a key": (changed(CANTILEVER, body__spaceing=1.0), "body.spaceing: unknown key (did you mean 'spacing'?)"),
    "missing set": (changed(CANTILEVER, load__1__set="endd"), "load.1.set: there is no set 'endd'"),
    "wrong type": (changed(CANTILEVER, body__spacing="1.0"), "body.spacing: must be a number"),
    "no expression": (changed(CANTILEVER, load__1__value="2 *"), "load.1.value: '2 *' is not an expression"),
    "horizon of no neighbours": (changed(CANTILEVER, body__horizon=0.9), "body.horizon: must be greater than 1"),
    "short horizon in places": (
        changed(CANTILEVER, body__horizon={"factor": "where(X > 11, 0.9, 1.515)"}),
        "body.horizon: the particle at (11.5, 0.5) has no neighbour within its horizon of 0.9",
    ),
    "negative horizon in places": (
        changed(CANTILEVER, body__horizon={"length": "where(X > 11, -3, 1.515)"}),
        "body.horizon",
    ),
    "horizon of no number": (
        changed(CANTILEVER, body__horizon={"length": "sqrt(10 - X)"}),
        "body.horizon.length: 'sqrt(10 - X)' is nan at X = 10.5",
    ),
    "empty set": (changed(CANTILEVER, sets__end="X > 50"), "sets.end: no particle lies in this set"),
    "empty set of a probe": (changed(CANTILEVER, sets__clamp="X < -50"), "sets.clamp: no particle lies in this set"),
    "isolated particle": (
        changed(CANTILEVER, body__keep="X < 9 or (X > 11 and abs(Y - 1.5) < 0.5)"),
        "body.horizon: the particle at (11.5, 1.5) has no neighbour",
    ),
    "flat family": (
        changed(CANTILEVER, body__keep="X < 6 or abs(Y - 1.5) < 0.5"),
        "material.rubber: the family of the particle at (",
    ),
    "nothing kept": (changed(CANTILEVER, body__keep="X > 99"), "body.keep: no particle is left"),
    "load of no number": (
        changed(CANTILEVER, load__1__value="t * log(11.2 - X)"),
        "load.1.value: 't * log(11.2 - X)' is nan at X = 11.5",
    ),
    "load of no number at the end": (changed(CANTILEVER, load__1__value="1 / (1 - t)"), "load.1.value"),
    "probe outside": (
        changed(CANTILEVER, probe__3__at=[30.0, 1.5]),
        "probe.3: 'stress' has a point more than a spacing away",
    ),
    "line that leaves the body": (
        changed(CANTILEVER, probe__2__line=[[0.5, 1.5], [30.0, 1.5], 7]),
        "probe.2: 'axis' has a point more than a spacing away",
    ),
    "section outside": (
        changed(CANTILEVER, probe=[{"name": "cut", "field": "force", "section": {"at": [12.0, 0.0], "normal": "x"}}]),
        "probe: the section 'cut' has all particles on one side of its plane",
    ),
    "two materials in a place": (
        changed(CANTILEVER, material__steel={"model": "correspondence", "E": 9.0, "nu": 0.2, "where": "end"}),
        "material: 0 particles have no material and 3 have more than one",
    ),
    "no material in places": (
        changed(CANTILEVER, material__rubber__where="end"),
        "particles have no material and 0 have more than one",
    ),
    "horizon of a material on one particle": (
        changed(CANTILEVER, material__rubber__where="tip", material__rubber__horizon=2.0),
        "material.rubber.horizon: needs a set that is given by a condition",
    ),
    "bonds of another Poisson's ratio": (
        changed(CANTILEVER, "material__rubber__nu", material__rubber__model="bond", material__rubber__plane="tension"),
        "material.rubber.plane: must be 'strain' or 'stress'",
    ),
    "springs along the axes": (
        changed(
            CANTILEVER,
            body__horizon=1.2,
            material__rubber={"model": "ordinary", "E": 1.0, "nu": 0.3, "quadrature": "plain"},
        ),
        "material: the bonds around 36 particles, the first at (0.5, 0.5), do not resist every strain",
    ),
    "influence of nothing": (
        changed(CANTILEVER, material__rubber__influence="where(r < 0.1, 1, 0)"),
        "material.rubber: influence: is zero at all neighbours of the particle at (",
    ),
    "influence that turns": (
        changed(CANTILEVER, material__rubber__model="ordinary", material__rubber__influence="0.8 - r"),
        "material.rubber: influence: is -",
    ),
    "influence of no number": (
        changed(CANTILEVER, material__rubber__influence="1 / (1 - r**0)"),
        "material.rubber.influence: '1 / (1 - r**0)' is inf at r = ",
    ),
    "another influence than the constants'": (
        changed(CANTILEVER, material__rubber__model="abd", material__rubber__influence="linear"),
        "material.rubber: influence: the a-b-d form has the constants of a constant influence function",
    ),
    "crack without extent": (
        changed(
            CANTILEVER, body__cracks=[{"from": [6.0, 1.0], "to": [6.0, 9.0]}, {"from": [1.0, 1.0], "to": [1.0, 1.0]}]
        ),
        "body.cracks.1: ",
    ),
    "crack of another dimension": (
        changed(CANTILEVER, body__cracks=[{"at": [1.0, 1.0]}]),
        "body.cracks.0: a crack in 2D is { from = [x, y], to = [x, y] }",
    ),
    "cracks that set a piece free": (
        changed(
            CANTILEVER,
            body__cracks=[{"from": [11.0, -1.0], "to": [11.0, 9.0]}],
            material__rubber={"model": "bond", "E": 1.0},
        ),
        "load: a piece of 3 particles",
    ),
    "refined to nothing": (
        changed(CANTILEVER, body__refine="where(X > 6, 0.5, 1)"),
        "body.refine",
    ),
    "size and spacing": (changed(CANTILEVER, body__size=[12.0, 3.4]), "body.size: [12.0, 3.4] is not a multiple"),
    "unknown variant": ("my.toml:fine", "there is no variant 'fine'"),
    "no such file": ("yours.toml", "yours.toml: there is no such file"),
    "no such case": ("clamped_baem", "unknown word 'clamped_baem' (did you mean 'clamped_beam'?)"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(comm, run, name):
    """Two, on all ranks; one sentence with its place on the first rank; nothing written."""
    document, message = BAD[name]
    if isinstance(document, str) and comm.rank == 0:
        Path("my.toml").write_text(tomli_w.dumps(CANTILEVER))
    result = run(document)
    assert result.code == 2
    assert not result.out.exists()
    if comm.rank == 0:
        (line,) = result.errors.splitlines()
        assert line.startswith("pdpetsc: error: ")
        assert message in line
    else:
        assert result.errors == result.said == ""


def test_bad_input_leaves_an_earlier_result_alone(comm, run):
    assert run(CANTILEVER).code == 0
    before = (run(CANTILEVER).out / "history.csv").read_text()
    result = run(changed(CANTILEVER, sets__end="X > 50"))
    assert result.code == 2
    assert (result.out / "history.csv").read_text() == before


MODELS = ("abd", "bond", "correspondence", "ordinary")


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dim", (1, 2, 3))
def test_only_the_model_changes(comm, run, model, dim):
    """One case, keys of all models in it: it runs under Newton for each, and they agree as far as they should."""
    size = [[12.0], [12.0, 3.0], [6.0, 3.0, 3.0]][dim - 1]
    end = {"kind": "force", "set": "end", "component": "x", "value": "2e-3 * t"}
    rubber = {"nu": 0.25, "stabilisation": {"kind": "silling"}, "quadrature": "matched", "kinematics": "nonlinear"}
    document = changed(
        CANTILEVER, "probe", "sets__tip", body__size=size, body__horizon=2.2, sets__end=f"X > {size[0] - 1}",
        load__1=end, material__rubber={"model": model, "E": 1.0, **rubber},
    )  # fmt: skip
    document["probe"] = [{"name": "end", "field": "u", "component": "x", "set": "end", "reduce": "mean"}]
    result = run(document)
    assert result.code == 0
    if comm.rank == 0:
        assert f"the model {model!r} does not use" in result.errors
        modulus = 1.2 if dim == 1 else 1 / (1 - 0.25**2) if dim == 2 else 1.0  # of uniaxial and plane strain
        # 3 x 3 particles are all surface, where the a-b-d form is too soft
        section = {1: 1.0, 2: 3.0, 3: 9.0}[dim]
        assert result.summary["probes"]["end"] == pytest.approx(
            2e-3 * size[0] / section / modulus, rel=1.0 if model == "abd" else 0.25
        )
        assert result.summary["choices"]["materials"]["rubber"]["model"] == model


def test_materials_with_horizons_of_their_own(comm, run):
    """Two models in one body: each particle has the horizon and the law of its material, and forces balance."""
    document = changed(CANTILEVER, sets__hard="X > 6", sets__soft="X <= 6", material__rubber__where="soft")
    hard = {"model": "ordinary", "E": 2.0, "nu": 0.25, "where": "hard", "horizon": 2.2}
    document["material"]["hard"] = hard | {"influence": "(1 - r)**2"}
    result = run(document)
    assert result.code == 0
    if comm.rank == 0:
        with h5py.File(result.out / "fields.h5", "r") as file:
            horizon, X = file["horizon"][...], file["position"][...]
        assert np.allclose(horizon, np.where(X[:, 0] > 6, 2.2, 1.515))
        assert max(result.summary["balance"].values()) < 1e-10
        assert result.summary["choices"]["materials"]["hard"]["influence"] == "(1 - r)**2"
        assert result.summary["probes"]["pull"] == pytest.approx(2e-3, rel=1e-8)


@pytest.mark.parametrize(("zone", "ratio"), [("abs(Y) < 0.05", 2), ("0 < Y < 0.01", 4)])
def test_plate_with_an_elliptical_hole(comm, run, zone, ratio):
    """Seed 000 Fig. 3.5, Table 4.1 at four times the spacing: a local zone across the width, horizon ratio 2; and one
    that is too thin by Eq. 100, of which a warning tells."""
    document = {
        "body": {
            "size": [0.5, 0.5], "origin": [-0.25, -0.25], "spacing": 0.01, "horizon": 3.015,
            "refine": f"where({zone}, {ratio}, 1)", "keep": "hypot(X / 0.05, Y / 0.006) > 1",
            "cracks": [{"from": [-0.05, 0.0], "to": [0.05, 0.0]}],
        },
        "sets": {"low": "Y < -0.24", "high": "Y > 0.24", "foot": {"nearest": [0.0, -0.245]}},
        "material": {"steel": {"model": "ordinary", "E": 200e9, "nu": 0.3, "plane": "stress"}},
        "load": [
            {"kind": "displacement", "set": "low", "component": "y", "value": 0.0},
            {"kind": "displacement", "set": "foot", "component": "x", "value": 0.0},
            {"kind": "pressure", "set": "high", "normal": "y", "value": "-1e6 * t"},
        ],
        "solver": {"steps": 1},
        "probe": [{"name": "opening", "field": "u", "component": "y", "line": [[0.0, 0.012], [0.0, -0.012], 2]}],
    }  # fmt: skip
    result = run(document)
    assert result.code == 0
    if comm.rank:
        return
    assert ("zone of smaller horizons is only" in result.errors) == (ratio == 4)
    with h5py.File(result.out / "fields.h5", "r") as file:
        X, volume, horizon = file["position"][...], file["volume"][...], file["horizon"][...]
        u = file["00001/u"][...]
    assert set(np.round(horizon / 3.015, 9)) == {0.01, round(0.01 / ratio, 9)}
    assert volume.sum() == pytest.approx(0.25 - np.pi * 0.05 * 0.006, rel=1e-3)
    assert result.summary["balance"]["force"] < 1e-10
    mirror = np.lexsort((np.round(X[:, 1], 9), np.round(-X[:, 0], 9)))
    straight = np.lexsort((np.round(X[:, 1], 9), np.round(X[:, 0], 9)))
    if ratio == 2:
        assert np.abs(u[mirror, 1] - u[straight, 1]).max() < 1e-3 * np.abs(u[:, 1]).max()
        upper, lower = result.summary["probes"]["opening"]
        assert upper - lower == pytest.approx(4 * 0.05 * 1e6 / 200e9, rel=0.25)  # of a slit, 4 a S/E


def test_warnings_of_what_does_nothing_or_too_little(comm, run):
    """A crack beside the body, weights that cannot be matched, springs along the axes in a part of the body."""
    away = {"from": [100.0, 0.0], "to": [100.0, 5.0]}
    through = {"from": [6.0, 1.0], "to": [6.0, 9.0]}
    result = run(changed(CANTILEVER, body__cracks=[through, away], solver__steps=1))
    assert result.code == 0
    if comm.rank == 0:
        assert "warning: body.cracks.1: cuts no bond" in result.errors
        assert "cracks.0" not in result.errors
        assert result.summary["choices"]["cut_bonds"][0] > 0 == result.summary["choices"]["cut_bonds"][1]
    steep = {"model": "bond", "E": 1.0, "influence": "1 / r**9"}
    result = run(changed(CANTILEVER, material__rubber=steep, body__horizon=2.2, solver__steps=1))
    assert result.code == 0
    if comm.rank == 0:
        assert "families could not be matched, so that its moduli are not right" in result.errors
    springs = changed(
        CANTILEVER, material__rubber={"model": "ordinary", "E": 1.0, "nu": 0.3}, solver__adaptive=False,
        body__horizon={"factor": "where(X < 8, 1.2, 2.2)"},
    )  # fmt: skip
    result = run(springs)
    if comm.rank == 0:
        assert "warning: material: the bonds around 1" in result.errors


def test_one_particle_of_springs_in_a_sound_body_is_held(comm, run):
    """Its neighbours' families see it."""
    document = changed(CANTILEVER, sets__core={"nearest": [6.5, 1.5]}, sets__rest="hypot(X - 6.5, Y - 1.5) > 0.1")
    rubber = {"model": "ordinary", "E": 1.0, "nu": 0.25, "where": "rest", "horizon": 2.2}
    document["material"] = {"rubber": rubber, "core": {"model": "bond", "E": 1.0, "where": "core"}}
    document["body"]["horizon"] = 1.2
    result = run(document)
    assert result.code == 0
    if comm.rank == 0:
        assert "mechanism" not in result.errors


def test_load_without_a_value_in_the_middle(comm, run):
    """Found only when its time comes: bad input all the same, said once, on all ranks."""
    result = run(changed(CANTILEVER, load__1__value="-1e-3 * t / where(abs(t - 0.75) < 0.1, 0, 1)", solver__steps=4))
    assert result.code == 2
    if comm.rank == 0:
        assert result.errors.count("load.1.value") == 1


# Results


def test_results(comm, run):
    probes = [*CANTILEVER["probe"], CANTILEVER["probe"][0] | {"name": "sag", "component": "y"}]
    output = {"every": 2, "checkpoint": 3, "picture": "stress", "curve": {"x": "sag", "y": "pull"}}
    result = run(changed(CANTILEVER, solver__steps=5, output=output, probe=probes))
    assert result.code == 0
    s = result.summary
    assert s["converged"] and s["status"] == "converged" and s["dim"] == 2 and s["ranks"] == comm.size
    assert s["particles"] == 13 * 3
    assert [step["step"] for step in s["steps"]] == [1, 2, 3, 4, 5]
    with (result.out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time"]) for row in rows] == [step["time"] for step in s["steps"]]
    assert [int(row["newton_iterations"]) for row in rows] == [step["newton_iterations"] for step in s["steps"]]
    assert float(rows[-1]["pull"]) == s["probes"]["pull"]
    with h5py.File(result.out / "fields.h5", "r") as file:
        assert [name for name in file if name.isdigit()] == ["00002", "00004", "00005"]
    with h5py.File(result.out / "checkpoint.h5", "r") as file:
        assert json.loads(file.attrs["state"])["step"] == 5
    for picture in ("result.png", "curve.png"):
        assert (result.out / picture).read_bytes()[:4] == b"\x89PNG"
    assert is_result(result.out)
    assert s["probes"]["pull"] == pytest.approx(2e-3, rel=1e-9)
    assert s["balance"]["force"] < 1e-13 and s["balance"]["moment"] < 1e-13
    end = fields(result, 5)
    assert end["force"].sum(axis=0) == pytest.approx([0, -2e-3, 0], rel=1e-14, abs=1e-17)
    assert end["reaction"].sum(axis=0) == pytest.approx([0, 2e-3, 0], rel=1e-9, abs=1e-12)
    assert np.abs(end["u"][:, 2]).max() == 0
    tip = s["probes"]["tip"]
    assert tip[1] < -0.3
    assert np.abs(end["u"][:, :2] - tip).max(axis=1).min() == 0  # the probe is one of the particles
    assert len(s["probes"]["axis"]) == 5 and np.shape(s["probes"]["stress"]) == (3, 3)


def test_sections_and_chosen_fields(run):
    """The cantilever's sections carry the load and its moment; what is written is what was asked for."""
    probes = [
        {"name": "N", "field": "force", "section": {"at": [6.0, 1.5], "normal": "x"}},
        {"name": "Q", "field": "force", "component": "y", "section": {"at": [3.2, 1.5], "normal": [1.0, 0.2]}},
        {"name": "M", "field": "moment", "section": {"at": [6.0, 1.5], "normal": "x"}},
        {"name": "upper", "field": "moment", "section": {"at": [6.0, 1.5], "normal": "-x", "where": "Y > 1.4"}},
        {"name": "lower", "field": "moment", "section": {"at": [6.0, 1.5], "normal": "-x", "where": "Y < 1.4"}},
        {"name": "tip", "field": "u", "set": "end", "reduce": "mean"},
        {"name": "peak", "field": "stress", "component": "von_mises", "set": "all", "reduce": "max"},
        {"name": "same", "field": "von_mises", "set": "all", "reduce": "max"},
        {"name": "pulled", "field": "peridynamic_stress", "component": "1", "at": [1.0, 2.5]},
    ]
    output = {"fields": ["principal", "force"], "picture": "peridynamic_stress"}
    result = run(changed(CANTILEVER, probe=probes, output=output), petsc={"snes_rtol": 1e-13})
    assert result.code == 0
    found = result.summary["probes"]
    assert found["N"] == pytest.approx([0.0, -2e-3], abs=1e-12)
    assert found["Q"] == pytest.approx(-2e-3, rel=1e-9)
    arm = 11.5 + found["tip"][0] - 6.0
    assert found["M"] == pytest.approx(-2e-3 * arm, rel=1e-9)
    assert found["upper"] + found["lower"] == pytest.approx(-found["M"], rel=1e-12)
    assert found["peak"] == found["same"] > 0 < found["pulled"]
    assert set(fields(result, 2)) == {"u", "principal", "force", "peridynamic_stress"}
    assert (result.out / "result.png").read_bytes()[:4] == b"\x89PNG"
    xdmf = (result.out / "fields.xdmf").read_text()
    assert "peridynamic_stress" in xdmf and "strain" not in xdmf


def test_sections_beside_a_crack_and_a_hole(run):
    """No bond carries anything across a crack: the ligaments carry all, or each its part."""
    cut = {"at": [6.0, 1.5], "normal": "x"}
    probes = [
        {"name": "whole", "field": "force", "section": cut},
        {"name": "cracked", "field": "force", "section": cut | {"where": "Y > 1.6"}},
        {"name": "moment", "field": "moment", "section": cut},
        {"name": "tip", "field": "u", "set": "end", "reduce": "mean"},
        {"name": "beside", "field": "force", "section": {"at": [2.0, 1.5], "normal": "x"}},
        {"name": "over", "field": "force", "section": {"at": [2.0, 1.5], "normal": "x", "where": "Y > 2.4"}},
        {"name": "under", "field": "force", "section": {"at": [2.0, 1.5], "normal": "x", "where": "Y < 2.4"}},
    ]
    body = {"size": [12.0, 5.0], "cracks": [{"from": [6.0, 1.6], "to": [6.0, 9.0]}]}
    body |= {"keep": "hypot(X - 2, Y - 2.5) > 0.6", "horizon": 2.015}
    result = run(changed(CANTILEVER, probe=probes, body=CANTILEVER["body"] | body), petsc={"snes_rtol": 1e-13})
    assert result.code == 0
    found = result.summary["probes"]
    for name in ("whole", "beside"):
        assert found[name] == pytest.approx([0.0, -2e-3], abs=1e-12)
    assert found["cracked"] == [0.0, 0.0]
    assert found["moment"] == pytest.approx(-2e-3 * (11.5 + found["tip"][0] - 6.0), rel=1e-9)
    parts = np.array([found["over"], found["under"]])
    assert parts.sum(axis=0) == pytest.approx([0.0, -2e-3], abs=1e-12)
    assert parts[0, 0] > 1e-3 > -1e-3 > parts[1, 0]  # bent downwards


def test_energy_is_the_work_of_the_load(run):
    """Stored energy against the trapezoidal sum of force times displacement over many steps."""
    probes = changed(CANTILEVER, "probe", solver__steps=20)
    probes["probe"] = [{"name": "w", "field": "u", "component": "y", "set": "end", "reduce": "mean"}]
    result = run(probes)
    with (result.out / "history.csv").open() as file:
        tip = [0.0, *(float(row["w"]) for row in csv.DictReader(file))]
    force = -2e-3 * np.linspace(0, 1, 21)
    work = np.sum(np.diff(tip) * (force[1:] + force[:-1]) / 2)
    assert result.summary["energies"]["stored"] == pytest.approx(work, rel=2e-3)


def test_an_earlier_result_is_replaced_whole(comm, run):
    first = run(changed(CANTILEVER, solver__steps=3))
    if comm.rank == 0:
        (first.out / "result.png").write_text("of the earlier run")
    comm.Barrier()
    second = run(CANTILEVER)
    assert second.code == 0
    assert len(second.summary["steps"]) == 2
    assert (second.out / "result.png").read_bytes().startswith(b"\x89PNG")


def test_a_result_with_notes_in_it_is_kept(comm, run):
    first = run(CANTILEVER)
    if comm.rank == 0:
        (first.out / "notes.txt").write_text("mine")
    comm.Barrier()
    assert run(CANTILEVER).code == 2
    assert (first.out / "notes.txt").exists()


@pytest.mark.parametrize("kind", ("directory", "file"))
def test_what_is_not_ours_is_not_replaced(comm, run, shared_tmp_path, kind):
    foreign = shared_tmp_path / "out"
    kept = foreign
    if comm.rank == 0:
        if kind == "directory":
            foreign.mkdir()
            kept = foreign / "thesis.tex"
        kept.write_text("Abstract")
    comm.Barrier()
    result = run(CANTILEVER)
    assert result.code == 2
    if comm.rank == 0:
        assert kept.read_text() == "Abstract"
        assert "holds more than a result of pdpetsc" in result.errors


def test_an_empty_directory_is_taken(comm, run, shared_tmp_path):
    if comm.rank == 0:
        (shared_tmp_path / "out").mkdir()
    comm.Barrier()
    assert run(CANTILEVER).code == 0


@pytest.mark.parametrize(("equals", "code"), [(2e-3, 0), (2.1e-3, 4)])
def test_expectations_decide_the_exit_code(comm, run, equals, code):
    expect = [{"value": "probes.pull", "equals": equals, "rtol": 1e-6, "source": "equilibrium"}]
    document = changed(CANTILEVER, expect=expect)
    result = run(document)
    assert result.code == code
    assert result.summary["expect"][0]["met"] == (code == 0)
    if comm.rank == 0:
        assert ("MISSED: probes.pull" in result.said) == (code == 4)
    assert run(document, "--set", "solver.steps=3").code == 0  # reported, but another case


def test_quiet(comm, run):
    result = run(CANTILEVER, "--quiet")
    assert (result.code, result.said, result.errors) == (0, "", "")


# Load steps


BENT = changed(CANTILEVER, load__1__value="-0.1 * t", solver={"steps": 1})  # too much for one step


def test_adaptive_steps_come_to_the_end(comm, run):
    """A step fails, half of it or less goes; the end is that of many small steps."""
    fine = run(changed(BENT, solver={"steps": 32}), out="fine")
    assert fine.code == 0
    assert len(fine.summary["steps"]) == 32
    result = run(BENT)
    assert result.code == 0
    steps = result.summary["steps"]
    assert 1 < len(steps) < 32
    assert steps[-1]["time"] == 1.0
    assert steps[0]["time"] in (0.5, 0.25, 0.125, 0.0625)
    if comm.rank == 0:
        assert result.said.count("cut in half") >= 1
    a, b = fields(result, steps[-1]["step"])["u"], fields(fine, 32)["u"]
    assert np.abs(a - b).max() < 1e-8 * np.abs(b).max()


def test_fixed_steps_fail_with_the_reason(comm, run):
    """Exit code 3 with SNES's reason, and results up to the last step that converged."""
    result = run(changed(BENT, solver={"steps": 1, "adaptive": False}))
    assert result.code == 3
    assert result.summary["status"] == "not_converged"
    assert result.summary["steps"] == []
    if comm.rank == 0:
        (line,) = result.errors.splitlines()
        assert re.search(r"load step 1,? from t = 0 to 1,? did not converge: DIVERGED_\w+", line)
        assert "adaptive = true" in line


def test_smallest_step(comm, run):
    result = run(changed(BENT, solver={"steps": 1, "min_step": 0.6}))
    assert result.code == 3
    if comm.rank == 0:
        assert "min_step" in result.errors


@pytest.mark.parametrize("rtol", (1e-16, 0.0))
def test_rounding_floor(run, rtol):
    """A tolerance that double precision cannot meet: the run ends, and says why."""
    result = run(CANTILEVER, petsc={"snes_rtol": rtol, "snes_max_it": 50})
    assert result.code == 0
    for step in result.summary["steps"]:
        assert step["rounding_floor"]
        assert step["newton_iterations"] < 15
        assert step["relative_residual"] < 1e-12


def test_no_load_at_all(run):
    """Nothing moves, and zero residuals relative to zero loads are no division by zero."""
    result = run(changed(CANTILEVER, load__1__value=0.0))
    assert result.code == 0
    assert result.summary["probes"]["tip"] == [0.0, 0.0]
    assert all(step["relative_residual"] == 0.0 for step in result.summary["steps"])


def test_load_that_comes_late(run):
    result = run(changed(CANTILEVER, load__1__value="where(t > 0.6, -2e-3, 0.0)", solver__steps=4))
    assert result.code == 0


def test_everything_prescribed(run):
    """No unknown is left: the affine field, at once."""
    loads = [
        {"kind": "displacement", "set": "all", "component": "x", "value": "0.1 * t * X + 0.05 * t * Y"},
        {"kind": "displacement", "set": "all", "component": "y", "value": "-0.02 * t * Y"},
    ]
    result = run(changed(CANTILEVER, load=loads))
    assert result.code == 0
    F = fields(result, 2)["F"].reshape(-1, 3, 3)
    assert np.abs(F - [[1.1, 0.05, 0], [0, 0.98, 0], [0, 0, 1]]).max() < 1e-14


def test_floating_body(run):
    """No support at all, and no equilibrium: bad input, never a result."""
    result = run(changed(CANTILEVER, load=[CANTILEVER["load"][1]], solver__steps=1))
    assert result.code == 2


@pytest.mark.parametrize("component, motion", (("x", "a translation along y"), ("y", "a translation along x")))
def test_body_that_can_slide(comm, run, component, motion):
    pin = {"kind": "displacement", "set": "end", "component": component, "value": 0.0}
    result = run(changed(CANTILEVER, load=[pin, CANTILEVER["load"][1]], solver__steps=1))
    assert result.code == 2
    assert comm.rank or f"the body is not held: {motion}" in result.errors


def test_body_that_can_turn(comm, run):
    pin = {"kind": "displacement", "set": "tip", "component": "all", "value": 0.0}
    result = run(changed(CANTILEVER, load=[pin, CANTILEVER["load"][1]]))
    assert result.code == 2
    assert comm.rank or "a rotation in the xy plane" in result.errors


def test_island(comm, run):
    """A piece that a gap cuts off is not held, whatever holds the rest."""
    result = run(changed(CANTILEVER, body__keep="X < 4 or X > 6.9", load=CANTILEVER["load"][:1], probe=[]))
    assert result.code == 2
    assert comm.rank or "a piece of 15 particles around (9.5, 1.5) is not held" in result.errors


def test_far_from_home(run):
    """A rigid motion by many sizes of the body leaves a rounding error that is recognised."""
    loads = [
        {"kind": "displacement", "set": "clamp", "component": "x", "value": "1e3 * t"},
        {"kind": "displacement", "set": "clamp", "component": "y", "value": 0.0},
        {"kind": "displacement", "set": "end", "component": "x", "value": "(1e3 + 1e-4) * t"},
    ]
    result = run(changed(CANTILEVER, load=loads, solver__steps=1))
    assert result.code == 0
    assert result.summary["steps"][-1]["rounding_floor"]


def test_indefinite_tangents_under_an_iterative_solver(run):
    """A straight strip compressed past buckling: GMRES takes over from CG, the answer is the direct one."""
    ends = [
        {"kind": "displacement", "set": name, "component": c, "value": value}
        for name, c, value in (("clamp", "all", 0.0), ("end", "x", "-2.0 * t"), ("end", "y", 0.0))
    ]
    document = changed(CANTILEVER, body__size=[40.0, 3.0], body__horizon=1.015, load=ends, probe=[], solver__steps=4)
    document["body"]["layers"]["right"] = "horizon"
    document["sets"]["end"] = "X > 40"
    document["sets"]["tip"] = {"nearest": [40.0, 1.5]}
    results = [run(changed(document, petsc={"pc_type": name})) for name in ("gamg", "lu")]
    assert [result.code for result in results] == [0, 0]
    stored = [result.summary["energies"]["stored"] for result in results]
    assert stored[0] == pytest.approx(stored[1], rel=1e-8)


def test_later_loads_hold_where_sets_overlap(run):
    loads = [*CANTILEVER["load"], {"kind": "displacement", "set": "clamp", "component": "y", "value": "0.5 * t"}]
    result = run(changed(CANTILEVER, load=loads))
    assert result.code == 0
    end = fields(result, 2)
    assert (end["u"][:, 1] == 0.5).sum() == 3


# Solvers


@pytest.mark.parametrize(
    "petsc",
    [
        {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": 1e-13},
        {"ksp_type": "cg", "pc_type": "jacobi", "ksp_rtol": 1e-13},
        {"snes_linesearch_type": "bt"},
        {"snes_type": "newtontr"},
    ],
    ids=lambda petsc: " ".join(f"{value}" for value in petsc.values()),
)
def test_solvers_agree(run, petsc):
    expected = run(CANTILEVER, out="direct")
    result = run(CANTILEVER, petsc={"snes_rtol": 1e-12} | petsc)
    assert result.code == 0
    a, b = fields(result, 2), fields(expected, 2)
    for name in ("u", "stress", "F"):
        assert np.abs(a[name] - b[name]).max() < 1e-8 * np.abs(b[name]).max()


# Units


def test_units_do_not_matter(run):
    """The same beam in metres and newtons, and in millimetres and newtons (megapascals): equal to 1e-10."""
    steel = changed(CANTILEVER, material__rubber__E=2e9, load__1__value="-4e6 * t", body__thickness=1.0)
    metres = run(steel, out="m")
    sizes = {"size": [12e3, 3e3], "spacing": 1e3, "thickness": 1e3}
    sets = {"clamp": "X < 0", "end": "X > 11e3", "tip": {"nearest": [12e3, 1.5e3]}}
    probes = copy.deepcopy(steel["probe"])
    probes[2]["line"] = [[0.5e3, 1.5e3], [11.5e3, 1.5e3], 5]
    probes[3]["at"] = [1e3, 1.5e3]
    other = changed(steel, material__rubber__E=2e3, sets=sets, probe=probes, body=steel["body"] | sizes)
    millimetres = run(other, out="mm")
    assert metres.code == millimetres.code == 0
    a, b = fields(metres, 2), fields(millimetres, 2)
    factors = {"u": 1e3, "stress": 1e-6, "F": 1, "strain": 1, "energy": 1e-6, "force": 1, "reaction": 1}
    for name, factor in factors.items():
        assert np.abs(b[name] - factor * a[name]).max() < 1e-10 * np.abs(b[name]).max(), name
    one, two = metres.summary, millimetres.summary
    assert [s["newton_iterations"] for s in one["steps"]] == [s["newton_iterations"] for s in two["steps"]]
    assert two["energies"]["stored"] == pytest.approx(1e3 * one["energies"]["stored"], rel=1e-10)
    assert two["probes"]["pull"] == pytest.approx(one["probes"]["pull"], rel=1e-10)


def test_the_bundled_pair_of_units(run):
    """`plate_two_holes` on a coarser lattice, in mm and in m."""
    coarse = "solver.steps=1", "output.fields=['u']"
    sets = [word for entry in coarse for word in ("--set", entry)]
    millimetres = run("plate_two_holes", *sets, "--set", "body.spacing=2.0", out="mm")
    metres = run("plate_two_holes:si", *sets, "--set", "body.spacing=0.002", out="m")
    assert millimetres.code == metres.code == 0
    for probe, factor in {"elongation": 1e3, "peak": 1e-6, "reaction": 1.0}.items():
        assert factor * metres.summary["probes"][probe] == pytest.approx(millimetres.summary["probes"][probe], rel=1e-9)
    assert millimetres.summary["family_size"] == metres.summary["family_size"]
    assert 0 < metres.summary["family_size"]["min"] < metres.summary["family_size"]["max"]


# One rank and several


PRISM = {
    "body": {"size": [6.0, 2.0, 2.0], "spacing": 1.0, "horizon": 1.515, "layers": {"left": "horizon"}},
    "sets": {"clamp": "X < 0", "end": "X > 5", "top": "Z > 1", "right": "X > 3", "left": "X < 3"},
    "material": {
        "rubber": {"model": "correspondence", "E": 1.0, "nu": 0.3, "elasticity": "neo_hookean", "where": "left"},
        "steel": {"model": "correspondence", "E": 5.0, "nu": 0.2, "where": "right", "influence": "linear"},
    },
    "load": [
        {"kind": "displacement", "set": "clamp", "component": "all", "value": 0.0},
        {"kind": "body_force", "set": "all", "component": ["y", "z"], "value": "1e-4 * t * X"},
        {"kind": "pressure", "set": "top", "normal": "z", "value": "1e-3 * t"},
    ],
    "solver": {"steps": 2},
}
ROD = {
    "body": {"size": [20.0], "spacing": 1.0, "horizon": 2.015, "thickness": 0.5},
    "sets": {"clamp": "X < 2", "end": "X > 18"},
    "material": {"rubber": {"model": "correspondence", "E": 1.0, "nu": 0.3}},
    "load": [
        {"kind": "displacement", "set": "clamp", "component": "x", "value": 0.0},
        {"kind": "force", "set": "end", "component": "x", "value": "0.1 * t"},
    ],
    "solver": {"steps": 2},
}
BODIES = {
    "cantilever": CANTILEVER,
    "large horizon": changed(CANTILEVER, body__horizon=3.015),
    "variable horizon": changed(CANTILEVER, body__horizon={"factor": "where(X < 6, 3.015, 1.515)"}),
    "hole": changed(CANTILEVER, body__keep="hypot(X - 6, Y - 4) > 1", body__size=[12.0, 6.0]),
    "spring": changed(CANTILEVER, material__rubber__stabilisation={"kind": "spring", "strength": 0.05}),
    "partial volumes": changed(CANTILEVER, material__rubber__partial_volume="linear", body__horizon=2.5),
    "prism": PRISM,
    "rod": ROD,
}


@pytest.mark.parametrize("name", BODIES)
def test_one_rank_and_several(comm, name):
    """The same case on all ranks together and on each rank alone: u, stress and reactions to 1e-10."""
    document = BODIES[name]
    whole, alone = (
        Simulation(case.Case.from_document(document, name, None, "my.toml", False), c)
        for c in (PETSc.COMM_WORLD, PETSc.COMM_SELF)
    )
    for each in (whole, alone):
        each.solve()
    ids = whole.particles.id[: whole.particles.owned]
    for field in ("u", "F", "stress", "reaction", "energy", "force"):
        expected = alone.recovery.field(field)
        difference = np.abs(whole.recovery.field(field) - expected[ids]).max(initial=0)
        assert difference <= 1e-10 * np.abs(expected).max(), field
    assert summary_of(whole, "converged")["bonds"] == alone.families.bonds
    assert whole.assembler.stored_energy(whole.state.u) == pytest.approx(
        alone.assembler.stored_energy(alone.state.u), rel=1e-10
    )
    for key, value in whole.recovery.balance().items():
        assert value < 1e-12 or (key == "moment" and name == "spring")  # spring loses angular momentum


def test_rod_is_exact(run):
    """1D: the stress inside is force over area, P = sigma in uniaxial strain."""
    result = run(ROD)
    assert result.code == 0
    stress = fields(result, 2)["stress"][:, 0]
    assert stress[6:14] == pytest.approx(0.2, rel=0.03)
