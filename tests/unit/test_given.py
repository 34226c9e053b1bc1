"""Bodies from files: cells and their facets, groups of every format, point clouds, and what is wrong with them."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from meshed import MESHED, block, meshed, tetrahedra
from petsc4py import PETSc

from pdpetsc.body import meshes, meshfile
from pdpetsc.body.cells import KINDS, area_vectors, shares_of_facets, volumes_and_middles
from pdpetsc.body.given import source_of, whole
from pdpetsc.body.sets import Sets
from pdpetsc.building import distributed_particles
from pdpetsc.case import Case, load
from pdpetsc.census import take_census
from pdpetsc.errors import InputError

STEEL = {"steel": {"model": "ordinary", "E": 1.0, "nu": 0.25}}
CORNERS = {
    "triangle": [[0, 0], [1, 0], [0, 1]],
    "quad": [[0, 0], [1, 0], [1, 1], [0, 1]],
    "tetra": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "hexahedron": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
    "wedge": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]],
    "pyramid": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]],
}
VOLUMES = {
    "triangle": 1 / 2, "quad": 1.0, "tetra": 1 / 6, "hexahedron": 1.0, "wedge": 1 / 2, "pyramid": 1 / 3,
}  # fmt: skip


def case_of(body: dict, **tables) -> Case:
    document = {"body": {"horizon": 3.015} | body, "material": STEEL} | tables
    return Case.from_document(document, "part", None, "part.toml", False)


def facets_on(points: np.ndarray, cells: np.ndarray, kind: str, axis: int, value: float) -> np.ndarray:
    """The facets of cells whose points all have a coordinate."""
    found = np.concatenate([cells[:, facet] for facet in KINDS[kind].facets])
    return found[(np.abs(points[found][:, :, axis] - value) < 1e-12).all(axis=1)]


def tagged(counts=(4, 3, 2), warp=0.0) -> meshio.Mesh:
    """Tetrahedra in two halves, and the triangles of two sides, in Gmsh's physical groups."""
    points, cells = block(counts, warp)
    cells = tetrahedra(cells)
    left, right = (facets_on(points, cells, "tetra", 0, x) for x in (0.0, 1.0))
    half = points[cells][:, :, 0].mean(axis=1) < 0.5
    parts = [("triangle", left), ("triangle", right), ("tetra", cells[half]), ("tetra", cells[~half])]
    tags = [np.full(len(part), k + 1) for k, (_, part) in enumerate(parts)]
    names = {"clamp": [1, 2], "loaded": [2, 2], "near": [3, 3], "far": [4, 3]}
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    return meshio.Mesh(points, parts, cell_data=data, field_data={k: np.array(v) for k, v in names.items()})


def written(path: Path, mesh: meshio.Mesh, kind: str | None = None, **options) -> str:
    meshio.write(path, mesh, file_format=kind, **options)
    return str(path)


def given_by(mesh: str, sets=None, surfaces=None, **body):
    """What a body takes from its file, with facets."""
    named = {"sets": {k: {"group": v} for k, v in (sets or {}).items()}}
    named["surfaces"] = {k: {"group": v} for k, v in (surfaces or {}).items()}
    load = {"kind": "traction", "surface": "border", "component": "x", "value": 1.0}
    return whole(source_of(case_of({"mesh": mesh} | body, **named, load=[load])))


def built(body: dict, **tables):
    case = case_of(body, **tables)
    p = distributed_particles(PETSc.COMM_WORLD, case)
    return p, Sets.of(p, case.sets)


# Cells --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_middles_and_facets_of_a_cell(kind):
    """Against the known ones, moved, turned and inverted; area vectors of a closed surface add up to zero."""
    corners = np.array(CORNERS[kind], float)
    dim = corners.shape[1]
    rng = np.random.default_rng(3)
    A = np.linalg.qr(rng.normal(size=(dim, dim)))[0] @ np.diag([1.3, 0.7, 2.0][:dim])
    volume, middle = volumes_and_middles(KINDS[kind], np.array([corners, corners @ A.T + 100.0]))
    assert volume[0] == pytest.approx(VOLUMES[kind], rel=1e-14)
    assert abs(volume[1]) == pytest.approx(VOLUMES[kind] * abs(np.linalg.det(A)), rel=1e-12)
    assert np.sign(volume[1]) == np.sign(np.linalg.det(A))
    assert middle[1] == pytest.approx(A @ middle[0] + 100.0, rel=1e-13)
    if kind == "pyramid":
        assert middle[0] == pytest.approx([3 / 8, 3 / 8, 1 / 4])
    facets = [corners[list(facet)][None] for facet in KINDS[kind].facets]
    areas = np.concatenate([area_vectors(facet) for facet in facets])
    assert np.abs(areas.sum(axis=0)).max() < 1e-15
    outward = [((facet.mean(axis=1) - middle[0]) * area).sum() for facet, area in zip(facets, areas)]
    assert min(outward) > 0


def test_a_cell_with_warped_faces():
    """One corner of a cube moved: the volume by Gauss' rule for the trilinear map (3 points, exact), 1.0 + d/4 for a
    corner moved along an edge; neighbours fill the space between them."""
    corners = np.array(CORNERS["hexahedron"], float)
    corners[6] += [0.3, -0.2, 0.4]
    volume, middle = volumes_and_middles(KINDS["hexahedron"], corners[None])
    place, weight = np.polynomial.legendre.leggauss(3)
    total, moment = 0.0, np.zeros(3)
    for i, r in enumerate(place):
        for j, s in enumerate(place):
            for k, t in enumerate(place):
                sign = 2 * np.array(CORNERS["hexahedron"]) - 1
                local = np.array([r, s, t])
                factors = (1 + sign * local) / 2
                shape = factors.prod(axis=1)
                gradient = np.stack([sign[:, a] / 2 * np.delete(factors, a, 1).prod(axis=1) for a in range(3)])
                det = np.linalg.det(gradient @ corners) * weight[i] * weight[j] * weight[k]
                total, moment = total + det, moment + det * (shape @ corners)
    assert volume[0] == pytest.approx(total, rel=1e-14)
    assert middle[0] == pytest.approx(moment / total, rel=1e-14)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_shares_of_facets(count):
    """They add up to the facet, in area and, where it is flat and no corner is cut, in moment."""
    corners = np.array([[[0, 0], [2, 1]]]) if count == 2 else np.array([[[0, 0, 0], [2, 0, 1], [2, 3, 1], [0, 3, 0]]])
    corners = corners[:, :count].astype(float)
    area, middle = shares_of_facets(corners)
    assert area.sum(axis=1) == pytest.approx(area_vectors(corners))
    size = np.linalg.norm(area, axis=2)
    assert (size[..., None] * middle).sum(axis=1) / size.sum() == pytest.approx(corners.mean(axis=1))


@pytest.mark.parametrize("particles", ["cells", "vertices"])
@pytest.mark.parametrize("kind", MESHED)
def test_a_mesh_fills_its_body(kind, particles, tmp_path):
    """Volumes add up to that of the body, areas of its surface close, and both together give the volume again."""
    mesh = meshed(kind)
    dim = mesh.cells[0].dim
    path = written(tmp_path / "part.vtu", mesh)
    given = given_by(path, dimension=dim, particles=particles, scale=2.0)
    size = 2.0**dim
    assert given.volume.sum() == pytest.approx(size, rel=1e-13)
    facets = given.facets
    assert np.abs(facets.area.sum(axis=0)).max() < 1e-14
    assert np.linalg.norm(facets.area, axis=1).sum() == pytest.approx(2 * dim * size / 2, rel=1e-12)
    assert (facets.position * facets.area).sum() / dim == pytest.approx(size, rel=1e-12)
    centre = (given.volume[:, None] * given.position).sum(axis=0) / size
    if particles == "cells":
        assert centre == pytest.approx(np.ones(dim), abs=0.02)
    assert (given.spacing > 0).all()
    assert np.array_equal(np.sort(given.number), given.number)


def test_the_spacing_of_a_regular_mesh_is_that_of_the_lattice(tmp_path):
    points, cells = block((4, 4, 4))
    path = written(tmp_path / "part.vtu", meshio.Mesh(points, [("hexahedron", cells)]))
    for particles in ("cells", "vertices"):
        assert given_by(path, particles=particles).spacing == pytest.approx(0.25)
    path = written(tmp_path / "tets.vtu", meshio.Mesh(points, [("tetra", tetrahedra(cells))]))
    assert given_by(path).spacing == pytest.approx(0.25 / 6 ** (1 / 3))
    assert given_by(path, particles="vertices").spacing == pytest.approx(0.25)


def test_spacings_vary_slowly(tmp_path):
    """Tetrahedra of Kuhn's kind with a random place for each point: volumes vary ten times as much as spacings^3."""
    points, cells = block((6, 6, 6))
    inside = ((points > 0) & (points < 1)).all(axis=1)
    points[inside] += np.random.default_rng(1).uniform(-0.03, 0.03, (inside.sum(), 3))
    given = given_by(written(tmp_path / "part.vtu", meshio.Mesh(points, [("tetra", tetrahedra(cells))])))
    assert np.std(given.volume) / np.mean(given.volume) > 4 * np.std(given.spacing**3) / np.mean(given.volume)
    assert (given.spacing**3).mean() == pytest.approx(given.volume.mean(), rel=0.02)


def test_points_of_higher_order_are_not_looked_at(tmp_path):
    points, cells = block((2, 2, 2))
    cells = tetrahedra(cells)
    edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    middles = np.concatenate([points[cells[:, e]].mean(axis=1) for e in np.array(edges)])
    pairs = np.sort(np.concatenate([cells[:, e] for e in np.array(edges)]), axis=1)
    _, first, number = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    extra = len(points) + number.ravel().reshape(6, -1).T
    mesh = meshio.Mesh(np.concatenate([points, middles[first]]), [("tetra10", np.c_[cells, extra])])
    given = given_by(written(tmp_path / "part.vtu", mesh), particles="vertices")
    assert len(given.position) == len(points)
    assert given.volume.sum() == pytest.approx(1.0)


# Formats and groups -------------------------------------------------------------------------------------------


INP = """*HEADING
*NODE
{nodes}
*ELEMENT, TYPE=C3D8, ELSET=whole
{cells}
*NSET, NSET=clamp
{nodes_of_clamp}
*ELSET, ELSET=near
{cells_of_near}
"""


def abaqus(path: Path) -> str:
    points, cells = block((4, 2, 2))
    lines = {
        "nodes": [f"{k + 11}, " + ", ".join(map(repr, map(float, x))) for k, x in enumerate(points)],
        "cells": [f"{k + 1}, " + ", ".join(map(str, c + 11)) for k, c in enumerate(cells)],
        "nodes_of_clamp": [f"{k + 11}," for k in np.flatnonzero(points[:, 0] == 0)],
        "cells_of_near": [f"{k + 1}," for k in range(8)],
    }
    path.write_text(INP.format(**{key: "\n".join(of) for key, of in lines.items()}))
    return str(path)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("particles", ["cells", "vertices"])
def test_groups_of_gmsh(binary, particles, tmp_path):
    path = written(tmp_path / "part.msh", tagged(), "gmsh22", binary=binary)
    sets = {"clamp": "clamp", "near": "near", "far": "far", "right": "gmsh:physical=2"}
    given = given_by(path, sets, {"loaded": "loaded", "all_far": "far"}, particles=particles)
    member = dict(zip(sets, given.member.T))
    if particles == "cells":
        assert len(given.position) == 4 * 3 * 2 * 6
        assert np.array_equal(member["near"], ~member["far"])
        assert member["clamp"].sum() == 2 * 6  # a facet of each
        assert given.number[0] == 25  # after 24 triangles
    else:
        assert np.array_equal(member["clamp"], given.position[:, 0] == 0)
        assert np.array_equal(member["right"], given.position[:, 0] == 1)
    face = given.facets.face
    loaded, far = face >> 3 & 1 == 1, face >> 4 & 1 == 1
    assert given.facets.area[loaded].sum(axis=0) == pytest.approx([1, 0, 0])
    assert given.facets.area[far].sum(axis=0) == pytest.approx([1, 0, 0])
    assert far.sum() > loaded.sum()


def test_sets_of_exodus(tmp_path):
    """Sets of nodes; written by a process of its own, since netCDF4 has an HDF5 of its own."""
    if find_spec("netCDF4") is None:
        pytest.skip("no netCDF4 here")
    points, cells = block((3, 2, 2))
    path = tmp_path / "part.e"
    np.savez(tmp_path / "mesh.npz", points=points, cells=tetrahedra(cells), left=np.flatnonzero(points[:, 0] == 0))
    code = (
        "import sys, numpy, meshio; m = numpy.load(sys.argv[1]); "
        "mesh = meshio.Mesh(m['points'], [('tetra', m['cells'])], point_sets={'clamp': m['left']}); "
        "meshio.write(sys.argv[2], mesh)"
    )
    subprocess.run([sys.executable, "-c", code, tmp_path / "mesh.npz", path], check=True)
    given = given_by(str(path), {"clamp": "clamp"}, {"left": "clamp"}, particles="vertices")
    assert given.volume.sum() == pytest.approx(1) and np.array_equal(given.position, points)
    assert np.array_equal(given.member[:, 0], points[:, 0] == 0)
    assert given.facets.area[given.facets.face >> 3 & 1 == 1].sum(axis=0) == pytest.approx([-1, 0, 0])


def test_sets_of_abaqus(tmp_path):
    path = abaqus(tmp_path / "part.inp")
    sets, surfaces = {"clamp": "clamp", "near": "near"}, {"left": "clamp", "half": "near"}
    given = given_by(path, sets, surfaces)
    clamp, near = given.member.T
    assert np.array_equal(clamp, given.position[:, 0] < 0.25)
    assert near.sum() == 8
    left = given.facets.face >> 3 & 1 == 1
    assert given.facets.area[left].sum(axis=0) == pytest.approx([-1, 0, 0])
    vertices = given_by(path, sets, particles="vertices")
    assert np.array_equal(vertices.member[:, 0], vertices.position[:, 0] == 0)


@pytest.mark.filterwarnings("ignore")  # of meshio's writer
def test_families_of_med(tmp_path):
    points, cells = block((3, 3, 3))
    mesh = meshio.Mesh(points, [("hexahedron", cells)], cell_data={"cell_tags": [np.repeat([-6, -7, -7], 9)]})
    mesh.point_data["point_tags"] = np.where(points[:, 0] == 0, 4, 0)
    mesh.cell_tags, mesh.point_tags = {-6: ["core"], -7: ["rest", "all"]}, {4: ["wall"]}
    path = written(tmp_path / "part.med", mesh)
    given = given_by(path, {"core": "core", "rest": "rest", "wall": "wall"})
    assert given.member.sum(axis=0).tolist() == [9, 18, 9]


def test_data_of_vtk(tmp_path):
    points, cells = block((4, 4))
    data = {"material": [np.repeat([1, 2], 8)]}
    mesh = meshio.Mesh(np.c_[points, np.zeros(len(points))], [("quad", cells)], cell_data=data)
    for name in ("part.vtk", "part.vtu"):
        given = given_by(written(tmp_path / name, mesh), {"soft": "material=2"}, dimension=2)
        assert given.member.sum() == 8
        assert np.array_equal(given.member[:, 0], given.position[:, 0] > 0.5)


def test_lattice_and_mesh_are_one_body(tmp_path):
    """Particles, facets and sets of a mesh of squares are those of the lattice."""
    load = [{"kind": "traction", "surface": "side", "component": "x", "value": 1.0}]
    tables = {
        "load": load,
        "surfaces": {"side": "NX > 0.5"},
        "sets": {"low": "Y < 0.5", "one": {"nearest": [0.0, 0.0]}},
    }
    common = {"keep": "X < 2.1 or Y < 1.5", "thickness": 0.5}
    q, others = built({"size": [3.0, 3.0], "spacing": 0.5} | common, **tables)
    points, cells = block((6, 6))
    path = written(tmp_path / "part.vtu", meshio.Mesh(np.c_[points, np.zeros(len(points))], [("quad", cells)]))
    p, sets = built({"mesh": path, "dimension": 2, "scale": 3.0} | common, **tables)
    order, other = np.lexsort(p.position.T), np.lexsort(q.position.T)
    for name in ("position", "volume", "spacing", "horizon"):
        assert getattr(p, name)[order] == pytest.approx(getattr(q, name)[other], abs=1e-14)
    assert p.facets.area.sum(axis=0) == pytest.approx(q.facets.area.sum(axis=0))
    assert p.facets.area.sum(axis=0) == pytest.approx([1.5 * 0.5, 0])  # what `keep` bares is no surface
    for name in ("low", "one"):
        assert np.array_equal(sets[name][order], others[name][other])


# Points -------------------------------------------------------------------------------------------------------


def cloud(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def lattice_points(count: int = 6) -> np.ndarray:
    return np.stack(np.meshgrid(*2 * [np.arange(count) + 0.5], indexing="ij"), axis=-1).reshape(-1, 2)


def write_hdf5(path: Path, **columns) -> str:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values
    return str(path)


@pytest.mark.parametrize("kind", ["csv", "vtu", "h5"])
def test_points(kind, tmp_path):
    X = lattice_points()
    soft = X[:, 0] > 3
    if kind == "csv":
        rows = [f"{'soft' if s else 'hard'}, {y}, 0.5, {x}" for (x, y), s in zip(X.tolist(), soft)]
        path = cloud(tmp_path / "cloud.csv", "\n".join(["set, y,Volume,X", *rows]) + "\n")
    elif kind == "vtu":
        mesh = meshio.Mesh(np.c_[X, np.ones(len(X))], [("vertex", np.arange(len(X))[:, None])])
        mesh.point_data = {"volume": np.full(len(X), 0.5), "set": np.where(soft, 2, 1)}
        path = written(tmp_path / "cloud.vtu", mesh)
    else:
        names = np.where(soft, "soft", "hard").astype("S4")
        path = write_hdf5(tmp_path / "cloud.h5", position=X, volume=np.full(len(X), 0.5), set=names)
    groups = {"soft": {"group": 2 if kind == "vtu" else "soft"}, "corner": {"nearest": [0.0, 0.0]}}
    p, sets = built({"points": path, "dimension": 2, "thickness": 2.0, "scale": 1.0}, sets=groups)
    assert np.array_equal(p.position, X)
    assert p.volume == pytest.approx(0.5)
    assert p.spacing == pytest.approx(0.5)
    assert p.horizon == pytest.approx(3.015 * 0.5)
    assert np.array_equal(sets["soft"], soft)
    assert sets["corner"].argmax() == 0


def test_horizons_and_spacings_of_the_file(tmp_path):
    X = lattice_points()
    columns = {"position": X, "volume": np.ones(36), "horizon": np.full(36, 2.1), "spacing": np.full(36, 1.1)}
    path = write_hdf5(tmp_path / "cloud.h5", **columns)
    body = {"points": path, "dimension": 2, "scale": 10.0}
    case = case_of(body)
    assert distributed_particles(PETSc.COMM_WORLD, case).horizon == pytest.approx(3.015 * 11)
    document = {"body": body, "material": STEEL}
    own = Case.from_document(document, "part", None, "part.toml", False)
    p = distributed_particles(PETSc.COMM_WORLD, own)
    assert p.horizon == pytest.approx(21.0)
    assert p.volume == pytest.approx(1000.0)
    path = cloud(tmp_path / "cloud.csv", "X,Y,volume\n0,0,1\n1,0,1\n")
    document["body"] = {"points": path, "dimension": 2}
    with pytest.raises(InputError, match=r"body.horizon: is missing, and the file of the points has no column horizon"):
        distributed_particles(PETSc.COMM_WORLD, Case.from_document(document, "part", None, "part.toml", False))


# The census ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["mesh", "points"])
def test_census_counts_as_it_is(kind, tmp_path):
    """Particles exactly, bonds within what a sample gives; groups make materials."""
    points, cells = block((12, 12, 6))
    if kind == "mesh":
        mesh = meshio.Mesh(points, [("hexahedron", cells)], cell_data={"part": [np.arange(len(cells)) % 2]})
        body = {"mesh": written(tmp_path / "part.vtu", mesh)}
        sets = {"even": {"group": "part=0"}, "odd": {"group": "part=1"}}
    else:
        X, part = points[cells].mean(axis=1), np.arange(len(cells)) % 2
        body = {"points": write_hdf5(tmp_path / "cloud.h5", position=X, volume=np.full(864, 1 / 864), set=part)}
        sets = {"even": {"group": 0}, "odd": {"group": 1}}
    material = {"a": STEEL["steel"] | {"where": "even"}, "b": STEEL["steel"] | {"where": "odd"}}
    document = {"body": {"horizon": 2.015, "keep": "X < 0.9"} | body, "material": material, "sets": sets}
    case = Case.from_document(document, "part", None, "part.toml", False)
    census = take_census(case)
    p = distributed_particles(PETSc.COMM_WORLD, case)
    assert (census.particles, census.exact) == (p.count, True)
    from scipy.spatial import cKDTree

    pairs = len(cKDTree(p.position).query_pairs(p.horizon[0], output_type="ndarray")) * 2
    assert census.bonds == pytest.approx(pairs, rel=0.05)
    assert set(census.materials) == {"a", "b"}


# Mistakes -----------------------------------------------------------------------------------------------------


UNIT = block((2, 2, 2))
TETRA = np.array([*CORNERS["tetra"], [1, 1, 0]], float), np.array([[0, 1, 2, 3], [0, 1, 4, 2]])


def changed(array: np.ndarray, *place_and_value) -> np.ndarray:
    array = array.copy()
    array[place_and_value[0]] = place_and_value[1]
    return array


@pytest.mark.parametrize(
    ("points", "kind", "cells", "body", "message"),
    [
        (changed(UNIT[0], (4, 1), np.nan), "hexahedron", UNIT[1], {}, "point 5 is at (0, nan, 0.5), which is no place"),
        (changed(UNIT[0], (4, 1), 1e200), "hexahedron", UNIT[1], {}, "point 5 is at (0, 1e+200, 0.5), which is no pl"),
        (changed(UNIT[0], 26, 1e9), "hexahedron", UNIT[1], {}, "cell 8 (hexahedron) has no volume; mend the mesh"),
        (*TETRA[:1], "tetra", TETRA[1], {}, "cell 2 (tetra) has no volume; mend the mesh there"),
        (UNIT[0] * [1, 1, 0], "quad", UNIT[1][:, [0, 0, 1, 1]], {"dimension": 2}, "cell 1 (quad) has no area"),
        (
            np.concatenate([UNIT[0], UNIT[0][:1]]), "hexahedron", np.where(UNIT[1] == 0, 27, UNIT[1])[[0, 0]], {},
            "cell 1 and cell 2 are in one place, (0.25, 0.25, 0.25); leave out the one",
        ),
        (
            np.concatenate([UNIT[0], UNIT[0][9:10]]), "hexahedron", changed(UNIT[1], (4, 0), 27), {},
            "point 10 and point 28 are in one place, (0.5, 0, 0); merge them, or the body has a surface inside",
        ),
        (TETRA[0], "tetra", np.array([[0, 1, 2, 3], [1, 2, 4, 3], [1, 2, 3, 4]]), {}, "cell 2 and cell 3 are in one"),
        (UNIT[0], "hexahedron", changed(UNIT[1], (3, 2), 99), {}, "cell 4 has a point that the mesh does not have"),
        (UNIT[0], "hexahedron", changed(UNIT[1], (3, 2), -1), {}, "cell 4 has a point that the mesh does not have"),
        (UNIT[0], "hexahedron", UNIT[1][:0], {}, "has no cells of 3 dimensions, it is empty"),
        (UNIT[0], "quad", UNIT[1][:, :4], {}, "3 dimensions, its cells are quad; take body.dimension = 2"),
        (UNIT[0], "quad", UNIT[1][:, :4], {"dimension": 2}, "does not lie in a plane z = constant, as a body of two"),
        (UNIT[0], "hexahedron", UNIT[1], {"keep": "X > 2"}, "body.keep: no particle is left"),
    ],
)  # fmt: skip
def test_damaged_meshes(points, kind, cells, body, message, tmp_path, monkeypatch):
    """Each is said with the file, and the cell or point where it has one."""
    monkeypatch.setattr(meshio, "read", lambda path: meshio.Mesh(points, [(kind, cells)]))
    monkeypatch.setattr(meshes, "read_apart", lambda script, path: meshfile.packed(path))
    (tmp_path / "part.vtu").write_text("")
    with pytest.raises(InputError) as error:
        built({"mesh": str(tmp_path / "part.vtu")} | body, surfaces={}, load=[])
    assert message in str(error.value)
    assert "part.vtu: " in str(error.value) or "keep" in body


def test_a_facet_of_three_cells(tmp_path):
    points = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [-1, -1], [2, 2]], float)
    cells = np.array([[1, 2, 0], [1, 3, 2], [1, 2, 5]])
    mesh = meshio.Mesh(np.c_[points, np.zeros(6)], [("triangle", cells)])
    with pytest.raises(InputError, match="cell 1 shares a facet with more than one other cell"):
        given_by(written(tmp_path / "part.vtu", mesh), dimension=2)


def test_inverted_cells_are_no_mistake(tmp_path):
    points, cells = block((3, 3, 3))
    turned = cells.copy()
    turned[::2] = turned[::2][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    right, other = (
        given_by(written(tmp_path / name, meshio.Mesh(points, [("hexahedron", c)])))
        for name, c in (("a.vtu", cells), ("b.vtu", turned))
    )
    assert np.allclose(right.volume, other.volume)
    assert np.abs(other.facets.area.sum(axis=0)).max() < 1e-15
    assert (other.facets.position * other.facets.area).sum() == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("part.msh", None, "part.msh: there is no such file"),
        ("part.msh", "no mesh", "part.msh: is not a mesh that can be read"),
        ("part.exo", "", "Exodus files need the package netCDF4"),
    ],
)
def test_files_that_are_no_meshes(name, text, message, tmp_path, monkeypatch):
    monkeypatch.setattr("pdpetsc.body.meshes.find_spec", lambda package: None)
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        built({"mesh": str(tmp_path / name)})


@pytest.mark.parametrize("kind", ["hexahedron", "wedge", "quad"])
def test_corners_in_another_order_are_refused(kind, tmp_path):
    """Two corners of one face changed places: half of the volume would be there, and another half behind it."""
    corners = np.array(CORNERS[kind], float)
    dim, order = corners.shape[1], np.arange(len(corners))
    order[[0, 1]] = order[[1, 0]]
    mesh = meshio.Mesh(np.pad(corners, ((0, 0), (0, 3 - dim))), [(kind, np.arange(len(corners))[None, order])])
    with pytest.raises(InputError, match=rf"cell 1 \({kind}\) has (facets that cross|no )"):
        given_by(written(tmp_path / "part.vtu", mesh), dimension=dim)


def test_groups_that_are_not_there(tmp_path):
    path = written(tmp_path / "part.msh", tagged(), "gmsh22")
    load = [{"kind": "traction", "surface": "a", "component": "x", "value": 1.0}]
    choices = (
        "has no group 'clam'; choices: clamp, far, loaded, near; or NAME=NUMBER of the data gmsh:geometrical, gmsh"
    )
    with pytest.raises(InputError, match=f"sets.a.group: .*part.msh: {choices}"):
        built({"mesh": path}, sets={"a": {"group": "clam"}})
    with pytest.raises(InputError, match=f"surfaces.a.group: .*part.msh: {choices}"):
        built({"mesh": path}, surfaces={"a": {"group": "clam"}}, load=load)
    with pytest.raises(InputError, match=r"sets.a.group: .*csv: no particle belongs to 'c'"):
        built(
            {"points": cloud(tmp_path / "a.csv", "X,Y,Z,volume,set\n0,0,0,1,b\n1,0,0,1,d")}, sets={"a": {"group": "c"}}
        )
    with pytest.raises(InputError, match=r"sets.a.group: .*csv: has no column 'set'"):
        built({"points": cloud(tmp_path / "b.csv", "X,Y,Z,volume\n0,0,0,1\n1,0,0,1")}, sets={"a": {"group": "c"}})


@pytest.mark.parametrize(
    ("text", "body", "message"),
    [
        ("X,Y,volume\n0,0,1\n1,0,0\n", {"dimension": 2}, "line 3 has the volume 0; it must be greater than 0"),
        ("X,Y,volume\n0,0,1\n1,0,-2\n", {"dimension": 2}, "line 3 has the volume -2"),
        ("X,Y,volume\n0,0,nan\n1,0,1\n", {"dimension": 2}, "line 2 has the volume nan"),
        ("X,Y,volume\n0,0,1\n1,inf,1\n", {"dimension": 2}, "line 3 is at (1, inf), which is no place for a particle"),
        ("X,Y,volume\n0,0,1\n1,0,1\n0,0,1\n", {"dimension": 2}, "line 2 and line 4 are in one place, (0, 0); leave"),
        ("X,Y,volume\n0,0,1\n1,zero,1\n", {"dimension": 2}, "line 3: 'zero' is no number"),
        ("X,Y,volume\n0,0,1\n1,0\n", {"dimension": 2}, "line 3 has too few columns"),
        ("X,Y,volume\n", {"dimension": 2}, "has no rows below its first line"),
        ("", {"dimension": 2}, "the first line names no column X; it must be like X,Y,Z,volume,set"),
        ("X,Y,V\n0,0,1\n", {"dimension": 2}, "the first line names no column volume"),
        ("X,Y,volume\n0,0,1\n1,0,1\n", {}, "has points of 2 coordinates, not of 3; take body.dimension = 2"),
        ("X,Y,Z,volume\n0,0,0,1\n1,0,1,1\n", {"dimension": 2}, "line 3 has another Z than the others; take body.di"),
        ("X,Y,volume,spacing\n0,0,1,1\n1,0,1,0\n", {"dimension": 2}, "line 3 has the spacing 0"),
        ("X,Y,volume,horizon\n0,0,1,1\n1,0,1,-1\n", {"dimension": 2}, "line 3 has the horizon -1"),
        ("X,Y,volume\n0,0,1e-30\n1,0,1\n", {"dimension": 2}, "the body is 1 large, but line 2 has a spacing of 1e-15"),
    ],
)
def test_damaged_tables(text, body, message, tmp_path):
    with pytest.raises(InputError) as error:
        built({"points": cloud(tmp_path / "cloud.csv", text)} | body)
    assert "cloud.csv: " in str(error.value)
    assert message in str(error.value)


def test_damaged_hdf5(tmp_path):
    X, ones = lattice_points(), np.ones(36)

    def refused(match, **columns):
        with pytest.raises(InputError, match=match):
            built({"points": write_hdf5(tmp_path / "cloud.h5", **columns), "dimension": 2})

    refused("cloud.h5: has no dataset 'volume'", position=X)
    refused("cloud.h5: volume is no column of numbers", position=X, volume=np.ones((36, 2)))
    refused("cloud.h5: volume has no rows", position=X[:0], volume=ones[:0])
    refused("cloud.h5: row 4 has the volume 0", position=X, volume=changed(ones, 3, 0.0))
    refused("cloud.h5: row 4 is at .nan, 3.5.", position=changed(X, (3, 0), np.nan), volume=ones)
    refused("cloud.h5: horizon has 35 rows, volume 36", position=X, volume=ones, horizon=ones[:-1])
    refused("cloud.h5: position has the shape .36,.", position=X[:, 0], volume=ones)
    refused(r"row 1 and row 4 are in one place, \(0.5, 0.5\)", position=changed(X, 3, X[0]), volume=ones)
    with h5py.File(tmp_path / "cloud.h5", "r+") as file:
        del file["position"], file["volume"]
        file.create_dataset("position", (10**9, 2), "f8", chunks=(1000, 2), compression="gzip")
        file["volume"] = h5py.ExternalLink("other.h5", "volume")
    for message in ("position is not as large as it says", "volume is not in the file but a link to somewhere else"):
        with pytest.raises(InputError, match=rf"cloud.h5: cannot be read as HDF5 of points: {message}"):
            built({"points": str(tmp_path / "cloud.h5"), "dimension": 2})
        with h5py.File(tmp_path / "cloud.h5", "r+") as file:
            del file["position"]
            file["position"] = X
    (tmp_path / "cloud.h5").write_text("text")
    with pytest.raises(InputError, match=r"cloud.h5: is damaged"):
        built({"points": str(tmp_path / "cloud.h5")})


MESH = {"mesh": "part.msh"}
PRESSURE = {"kind": "pressure", "surface": "a", "value": 1.0}


@pytest.mark.parametrize(
    ("body", "tables", "message"),
    [
        (MESH | {"size": [1.0]}, {}, 'body.size: goes with shape = "box", not with "mesh"'),
        (MESH | {"spacing": 1.0}, {}, 'body.spacing: goes with shape = "box", not with "mesh"'),
        (MESH | {"origin": [0.0, 0.0, 0.0]}, {}, 'body.origin: goes with shape = "box", not with "mesh"'),
        (MESH | {"layers": {"left": 1.0}}, {}, 'body.layers: goes with shape = "box", not with "mesh"'),
        (MESH | {"keep": "X > 0", "fitted": True}, {}, 'body.fitted: goes with shape = "box", not with "mesh"'),
        (MESH | {"refine": 2}, {}, 'body.refine: goes with shape = "box", not with "mesh"'),
        ({"points": "a.csv", "zones": []}, {}, 'body.zones: goes with shape = "box", not with "points"'),
        ({"points": "a.csv", "particles": "cells"}, {}, 'body.particles: goes with shape = "box" or "mesh", not'),
        ({"points": "a.csv", "mesh": "a.msh"}, {}, 'body.points: goes with shape = "points", not with "mesh"'),
        ({"shape": "mesh"}, {}, "body.mesh: is missing"),
        ({"shape": "points"}, {}, "body.points: is missing"),
        ({"shape": "ball"}, {}, "body.shape: must be 'box', 'mesh' or 'points', not 'ball'"),
        ({"size": [1.0], "spacing": 0.1, "scale": 2.0}, {}, 'body.scale: goes with shape = "mesh" or "points", not'),
        ({"size": [1.0], "spacing": 0.1, "mesh": "a.msh", "shape": "box"}, {}, 'body.mesh: goes with shape = "me'),
        (MESH | {"dimension": 1}, {}, "body.dimension: must be 2 or 3 for a mesh, not 1"),
        (MESH | {"thickness": 2.0}, {}, "body: a body of three dimensions has no thickness"),
        (MESH, {"refinement": {"where": "damage > 0.1"}}, 'refinement: splits the cells of lattices'),
        (MESH, {"sets": {"a": {"group": ""}}}, "sets.a.group: must be the name of a group"),
        (MESH, {"sets": {"a": {"group": "b", "where": "X > 0"}}}, "sets.a: needs exactly one of where, nearest, group"),
        (MESH, {"sets": {"a": {"nearest": [0.0]}}}, "one for each dimension of the body (body.dimension), not 1"),
        ({"size": [1.0], "spacing": 0.1}, {"sets": {"a": {"group": "b"}}}, "a lattice has none"),
        ({"size": [1.0], "spacing": 0.1}, {"surfaces": {"left": "X < 0"}}, "the surface 'left' is always there"),
        (
            MESH, {"load": [{"kind": "pressure", "surface": "left", "value": 1.0}]},
            "load.0.surface: there is no surface 'left'; choices: border",
        ),
        (
            {"points": "a.csv"}, {"load": [PRESSURE], "surfaces": {"a": "X < 1"}},
            "load.0.surface: 'a' cannot be, for points have no surface; let the load act on a set",
        ),
    ],
)  # fmt: skip
def test_what_does_not_go_together(body, tables, message):
    with pytest.raises(InputError) as error:
        case_of(body, **tables)
    assert message in str(error.value)


def test_paths_are_those_of_the_case_file(tmp_path, monkeypatch):
    (tmp_path / "part.toml").write_text(
        '[body]\nmesh = "meshes/part.msh"\nhorizon = 2.015\n[material.a]\nmodel = "bond"\nE = 1.0\n'
    )
    monkeypatch.chdir(tmp_path.parent)
    loaded = load(f"{tmp_path.name}/part.toml")
    assert loaded.body.mesh == str(tmp_path / "meshes" / "part.msh")
    assert (loaded.body.shape, loaded.body.dim) == ("mesh", 3)
    assert load(f"{tmp_path.name}/part.toml", ["body.mesh=other.msh"]).body.mesh == str(tmp_path / "other.msh")
