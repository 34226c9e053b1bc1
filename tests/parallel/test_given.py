"""Bodies from files on 1, 2 and 3 ranks: who holds what, and the same answer from all."""

import json

import h5py
import meshio
import numpy as np
import pytest
from bodies import whole
from petsc4py import PETSc

from pdpetsc import driver
from pdpetsc.body import given
from pdpetsc.body.sets import Sets
from pdpetsc.building import distributed_particles
from pdpetsc.case import Case
from pdpetsc.catalogue import BUNDLED
from pdpetsc.errors import InputError
from pdpetsc.io.fields import HDF5, FieldWriter, read_mesh

ONE = {
    "middle": 0.005842472689375483,
    "place": [-0.0005997435448137832, 0.001669910594794332, 0.0],
    "line": [[-0.02484300876454454, 0.010084366809481726], [-0.02986181915986526, 0.01675836117561861]],
}
"""Of the run below on one rank: stresses yx, yy, yz, and displacements at two of the places."""

SHEET = {
    "body": {"mesh": str(BUNDLED / "sheet_triangles.msh"), "dimension": 2, "horizon": 2.015, "thickness": 2.0},
    "sets": {"low": {"group": "bottom"}, "middle": "hypot(X, Y) < 2", "rim": {"group": "hole"}},
    "surfaces": {"high": {"group": "top"}, "right": "NX > 0.9 and X > 4"},
    "material": {"sheet": {"model": "ordinary", "E": 1.0, "nu": 0.25, "kinematics": "linear", "density": 1.0}},
    "load": [
        {"kind": "displacement", "set": "low", "component": "all", "value": 0.0},
        {"kind": "traction", "surface": "high", "component": "y", "value": "1e-3 * t"},
        {"kind": "pressure", "surface": "right", "value": "1e-3 * t"},
    ],
    "solver": {"steps": 2},
    "probe": [
        {"name": "middle", "field": "u", "component": "y", "set": "middle", "reduce": "mean"},
        {"name": "place", "field": "stress", "at": [2.0, 0.5]},
        {"name": "line", "field": "u", "line": [[-4.0, 2.0], [4.0, 2.0], 5]},
        {"name": "cut", "field": "force", "section": {"at": [0.0, 3.0], "normal": "y"}},
        {"name": "support", "field": "reaction", "set": "low", "reduce": "sum"},
    ],
    "output": {"fields": ["u"]},
}  # fmt: skip


def case_of(**tables) -> Case:
    return Case.from_document(SHEET | tables, "part", None, "part.toml", False)


@pytest.mark.mpi
def test_particles_do_not_depend_on_the_ranks(comm, monkeypatch):
    """Ids in the order of the file, columns, groups and facets. Only the first reads."""
    read = []
    monkeypatch.setattr(
        given, "particles_of_mesh", lambda source, of=given.particles_of_mesh: read.append(1) or of(source)
    )
    case = case_of()
    p = distributed_particles(PETSc.COMM_WORLD, case)
    assert sum(comm.allgather(len(read))) == 1
    assert comm.allreduce(p.owned) == p.count == 3009
    assert np.array_equal(p.id[: p.owned], np.sort(p.id[: p.owned]))
    area = comm.allreduce(p.facets.area.sum(axis=0))
    assert area == pytest.approx([2 * 10.0, 2 * 10.0])  # what is loaded: the upper and the right side
    sets = Sets.of(p, case.sets)
    assert not p.carried
    mesh = meshio.read(SHEET["body"]["mesh"])
    triangles = np.concatenate([block.data for block in mesh.cells if block.type == "triangle"])
    assert whole(comm, p, p.position[: p.owned]) == pytest.approx(mesh.points[triangles, :2].mean(axis=1))
    low = whole(comm, p, sets["low"])
    lines = [
        block.data[tags == mesh.field_data["bottom"][0]]
        for block, tags in zip(mesh.cells, mesh.cell_data["gmsh:physical"])
        if block.type == "line"
    ]
    on_edge = np.isin(triangles, np.concatenate(lines)).sum(axis=1) == 2
    assert np.array_equal(low, on_edge)


@pytest.mark.mpi
def test_hdf5_is_read_by_all_ranks(comm, shared_tmp_path):
    X = np.stack(np.meshgrid(np.arange(9) + 0.5, np.arange(7) + 0.5, indexing="ij"), axis=-1).reshape(-1, 2)
    path = shared_tmp_path / "cloud.h5"
    if comm.rank == 0:
        with h5py.File(path, "w") as file:
            file["position"], file["volume"], file["set"] = X, np.ones(63), np.arange(63) % 3
    comm.Barrier()
    body = {"points": str(path), "dimension": 2, "horizon": 2.015, "keep": "X < 8"}
    case = case_of(body=body, load=[], surfaces={}, probe=[], sets={"third": {"group": 2}})
    p = distributed_particles(PETSc.COMM_WORLD, case)
    kept = X[:, 0] < 8
    assert np.array_equal(whole(comm, p, p.position[: p.owned]), X[kept])
    third = Sets.of(p, case.sets)["third"]
    assert np.array_equal(whole(comm, p, third), (np.arange(63) % 3 == 2)[kept])
    if comm.rank == comm.size - 1:
        with h5py.File(path, "a") as file:
            file["volume"][60] = 0.0
    comm.Barrier()
    with pytest.raises(InputError, match=r"cloud.h5: row 61 has the volume 0"):
        distributed_particles(PETSc.COMM_WORLD, case)


@pytest.mark.mpi
def test_what_lies_in_no_plane_is_seen_by_all(comm, shared_tmp_path):
    """Where a rank's own rows do, too."""
    path, n = shared_tmp_path / "layers.h5", 4 * comm.size
    if comm.rank == 0:
        x = np.arange(n) + 0.5
        X = np.stack([x, 0 * x, x > n / 2], axis=1)
        with h5py.File(path, "w") as file:
            file["position"], file["volume"] = X, np.ones(n)
    comm.Barrier()
    body = {"points": str(path), "dimension": 2, "horizon": 2.015}
    case = case_of(body=body, load=[], surfaces={}, probe=[], sets={})
    with pytest.raises(InputError, match=f"row {n // 2 + 1} has another Z than the others"):
        distributed_particles(PETSc.COMM_WORLD, case)


@pytest.mark.mpi
def test_mistakes_are_everybodys(comm, shared_tmp_path):
    """What the first rank finds in a file, and what a set lacks."""
    with pytest.raises(InputError, match=r"none.msh: there is no such file"):
        distributed_particles(
            PETSc.COMM_WORLD, case_of(body=SHEET["body"] | {"mesh": str(shared_tmp_path / "none.msh")})
        )
    with pytest.raises(InputError, match=r"sets.low.group: .*: has no group 'botom'"):
        distributed_particles(PETSc.COMM_WORLD, case_of(sets=SHEET["sets"] | {"low": {"group": "botom"}}))


@pytest.mark.mpi
def test_a_run(comm, shared_tmp_path, monkeypatch):
    """One reading for the look before the run and for the run; the sections carry the load; the answer of one rank."""
    read = []
    monkeypatch.setattr(
        given, "particles_of_mesh", lambda source, of=given.particles_of_mesh: read.append(1) or of(source)
    )
    case = case_of()
    out = shared_tmp_path / "result"
    assert driver.run(case, out, quiet=True) == 0
    assert sum(comm.allgather(len(read))) == 1
    summary = json.loads((out / "summary.json").read_text())
    probes = summary["probes"]
    assert probes["support"] == pytest.approx([0.02, -0.02], rel=1e-6)
    assert probes["cut"][1] == pytest.approx(0.02, rel=0.02)  # the pressure beside it pulls at both sides of the cut
    assert summary["spacing"] == pytest.approx(0.157127, rel=1e-5)
    probes = {"middle": probes["middle"], "place": probes["place"][1], "line": probes["line"][2::2]}
    for name, value in ONE.items():
        assert np.array(probes[name]) == pytest.approx(np.array(value), rel=1e-7, abs=1e-12)
    assert (out / "result.png").exists()


@pytest.mark.mpi
@pytest.mark.parametrize("particles", ["cells", "vertices"])
def test_pictures_have_the_mesh(comm, shared_tmp_path, particles):
    """The fields of a body from a mesh hold its cells, each with the particle in it or those on its corners."""
    body = SHEET["body"] | {"particles": particles, "keep": "X > -2"}
    p = distributed_particles(PETSc.COMM_WORLD, case_of(body=body))
    place = whole(comm, p, p.position[: p.owned])
    assert (p.mesh is None) == (comm.rank > 0)
    FieldWriter(shared_tmp_path, p, {}, ("u",), p.position[: p.owned, 1] > 0)
    with h5py.File(shared_tmp_path / HDF5, "r") as file:
        mesh = read_mesh(file)
        position, cracked = file["position"][:, :2], file["mesh/cracked"][...]
    comm.Barrier()
    assert np.array_equal(position, place) and np.array_equal(cracked, place[:, 1] > 0)
    middle = mesh.points[mesh.cells].mean(axis=1) if particles == "cells" else mesh.points
    there = mesh.particle >= 0
    assert np.array_equal(mesh.particle[there], np.arange(p.count)) and p.count < 3009
    assert place == pytest.approx(middle[there])
    assert np.array_equal(there, middle[:, 0] > -2)
    assert there.all() == (particles == "cells") and middle[:, 0].min() > -3  # other cells are left out
