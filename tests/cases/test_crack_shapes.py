"""Cracks of a case file by every description, against one another."""

import meshio
import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc.case import load
from pdpetsc.errors import InputError
from pdpetsc.simulation import Simulation

PETSC = PETSc.COMM_WORLD

PLATE = """
[body]
size = [1.0, 0.6]
spacing = 0.1
horizon = 2.015
cracks = [{CRACK}]
[material.m]
model = "bond"
E = 1.0
plane = "stress"
[[load]]
kind = "displacement"
set = "all"
component = "all"
value = 0.0
"""
BLOCK = PLATE.replace("[1.0, 0.6]", "[1.0, 0.6, 0.5]").replace('plane = "stress"', "")

POINTS = np.array([[0.22, 0.3, -0.1], [0.68, 0.3, -0.1], [0.68, 0.3, 0.35], [0.22, 0.3, 0.35]])
POLYGON = f"polygon = {POINTS.tolist()}"
LINE = "from = [0.22, 0.3], to = [0.68, 0.3]"


def cut(tmp_path, text: str, crack: str) -> np.ndarray:
    """The bonds that are left, (bonds, 2) ids, on all ranks."""
    (tmp_path / "case.toml").write_text(text.replace("CRACK", crack))
    simulation = Simulation(load(str(tmp_path / "case.toml")), PETSC)
    f, p = simulation.families, simulation.particles
    assert sum(simulation.cut_bonds) > 0
    pairs = np.stack([p.id[f.per_bond(np.arange(p.local))], p.id[f.neighbours]], axis=1)
    pairs = np.concatenate(p.comm.tompi4py().allgather(pairs))
    return pairs[np.lexsort(pairs.T)]


def drawn(kind: str) -> meshio.Mesh:
    """The rectangle in a mesh with other things in it."""
    flat = {"line": [("line", [[0, 1]])], "far": [("line", [[0, 1]]), ("line", [[4, 5]])]}
    points = np.concatenate([POINTS, POINTS + [0.0, 0.18, 0.0], [[0.0, 0.0, 0.0]]])
    solid = {
        "quad": [("quad", [[0, 1, 2, 3]])],
        "triangle": [("triangle", [[0, 1, 2], [2, 3, 0]])],
        "far": [("triangle", [[0, 1, 2], [2, 3, 0]]), ("triangle", [[4, 5, 6]]), ("tetra", [[0, 1, 2, 8]])],
    }
    plane, name = kind.split()
    cells = (flat if plane == "2D" else solid)[name]
    if plane == "2D":
        points = points * [1, 1, 0]
    mesh = meshio.Mesh(points, [(k, np.array(c)) for k, c in cells])
    tags = [np.full(len(c), 7 + i) for i, (_, c) in enumerate(cells)]
    mesh.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    dimension = {"line": 1, "tetra": 3}
    mesh.field_data = {f"part{i}": np.array([7 + i, dimension.get(k, 2)]) for i, (k, _) in enumerate(cells)}
    return mesh


@pytest.mark.parametrize(("kind", "extension", "group"), [
    ("2D line", "vtk", ""), ("2D far", "msh", ', set = "part0"'),
    ("3D quad", "vtu", ""), ("3D triangle", "stl", ""), ("3D far", "msh", ', set = "part0"'),
])  # fmt: skip
def test_a_mesh_cuts_what_its_outline_cuts(tmp_path, kind, extension, group):
    drawn(kind).write(tmp_path / f"crack.{extension}", **({"file_format": "gmsh22"} if extension == "msh" else {}))
    text, shape = (PLATE, LINE) if kind.startswith("2D") else (BLOCK, POLYGON)
    mesh = cut(tmp_path, text, f'mesh = "crack.{extension}"{group}')
    assert np.array_equal(mesh, cut(tmp_path, text, shape))


@pytest.mark.mpi
def test_meshes_on_all_ranks(shared_tmp_path, comm):
    """Read by the first one; what is wrong is raised by all."""
    if comm.rank == 0:
        drawn("3D triangle").write(shared_tmp_path / "crack.stl")
        for name, crack in (("mesh", 'mesh = "crack.stl"'), ("polygon", POLYGON), ("missing", 'mesh = "no.stl"')):
            (shared_tmp_path / f"{name}.toml").write_text(BLOCK.replace("CRACK", crack))
    comm.Barrier()
    counts = [Simulation(load(str(shared_tmp_path / f"{name}.toml")), PETSC).cut_bonds for name in ("mesh", "polygon")]
    assert counts[0] == counts[1] != [0]
    with pytest.raises(InputError, match=r"no\.stl: there is no such file"):
        Simulation(load(str(shared_tmp_path / "missing.toml")), PETSC)


def test_a_set_may_be_called_mesh(tmp_path):
    (tmp_path / "case.toml").write_text(PLATE.replace("CRACK", LINE) + '[sets]\nmesh = "X < 0.3"\n')
    assert load(str(tmp_path / "case.toml")).sets["mesh"].where.text == "X < 0.3"


def test_the_mesh_of_along(tmp_path):
    """Relative to the case file, too."""
    drawn("2D line").write(tmp_path / "crack.vtk")
    damage = '[damage.m]\ncriterion = "critical_stretch"\ncritical = 0.1\nalong = [{ mesh = "crack.vtk" }]\n'
    (tmp_path / "case.toml").write_text(PLATE.replace("CRACK", LINE) + damage)
    assert load(str(tmp_path / "case.toml")).damage["m"].along[0].mesh == str((tmp_path / "crack.vtk").resolve())


def test_level_sets_and_discs_in_cases(tmp_path):
    line = cut(tmp_path, PLATE, LINE)
    assert np.array_equal(line, cut(tmp_path, PLATE, 'level_set = "Y - 0.3", where = "0.22 < X and X < 0.68"'))
    disc = cut(tmp_path, BLOCK, 'center = [0.45, 0.3, 0.25], normal = "y", radius = 0.21')
    where = "hypot(X - 0.45, Z - 0.25) < 0.21"
    assert np.array_equal(disc, cut(tmp_path, BLOCK, f'level_set = "Y - 0.3", where = "{where}"'))


def test_a_set_of_cells_by_name(tmp_path):
    mesh = drawn("3D far")
    mesh = meshio.Mesh(mesh.points, mesh.cells, cell_sets={"slit": [np.array([0, 1]), np.array([], int), None]})
    mesh.cell_sets["slit"][2] = np.array([], int)
    mesh.write(tmp_path / "crack.inp")
    assert np.array_equal(cut(tmp_path, BLOCK, 'mesh = "crack.inp", set = "slit"'), cut(tmp_path, BLOCK, POLYGON))


@pytest.mark.parametrize(("text", "crack", "message"), [
    (PLATE, POLYGON.replace(", -0.1]", "]").replace(", 0.35]", "]"), "body.cracks.0: a crack in 2D is { from = "),
    (PLATE, 'at = [0.1, 0.2], where = "X < 1"', r"a crack in 2D is .*, { level_set = \"expression\" } or { mesh"),
    (BLOCK, 'center = [0.0, 0.0, 0.0], normal = "w", radius = 1.0', "body.cracks.0.normal: must be one of x, y, z"),
    (BLOCK, 'center = [0.0, 0.0, 0.0], radius = 1.0', "a crack in 3D is { polygon .*, { center = "),
    (BLOCK, 'center = [0.0, 0.0, 0.0], normal = "x", radius = 0.0', "body.cracks.0.radius: .*greater than 0"),
    (PLATE, 'level_set = "Y < 0.3"', "is a condition where a number is needed"),
    (PLATE, 'level_set = "Y - spacing"', "unknown name 'spacing'"),
    (PLATE, 'level_set = "Y - 0.3", where = "X"', "is a number where a condition is needed"),
    (PLATE, 'level_set = "log(Y - 0.3)"', "body.cracks.0.level_set: 'log.*' is nan at Y = "),
    (PLATE, 'mesh = "missing.msh"', r"body.cracks.0.mesh: .*missing.msh: there is no such file"),
    (PLATE, 'mesh = "case.toml"', r"case.toml: is not a mesh that can be read"),
    (PLATE, 'mesh = "far.vtk"', "body.cracks.0.mesh: .*far.vtk: does not lie in a plane z = constant"),
    (PLATE, 'mesh = "flat.vtk"', "has no lines, which a crack in 2D is made of; there are triangle"),
    (BLOCK, 'mesh = "far.msh", set = "slit"', "has no group 'slit'; choices: part0, part1, part2"),
    (BLOCK, 'mesh = "far.msh", set = "part2"', "has no triangles or quadrilaterals in 'part2'"),
    (BLOCK, 'mesh = "sets.inp", set = "both"', "the set 'both' cannot be read; list the numbers of its cells"),
    (PLATE, 'mesh = "groups.msh", set = "plate"', "has no lines in 'plate'"),
    (BLOCK, 'mesh = "thin.vtk"', "body.cracks.0.mesh: cell 1 of the mesh has no area"),
])  # fmt: skip
def test_what_is_refused(tmp_path, text, crack, message):
    far = drawn("3D far")
    far.write(tmp_path / "far.msh", file_format="gmsh22")
    far.write(tmp_path / "far.vtk")
    meshio.Mesh(POINTS[:, [0, 2, 1]] * [1, 1, 0], [("triangle", np.array([[0, 1, 2]]))]).write(tmp_path / "flat.vtk")
    meshio.Mesh(POINTS, [("triangle", np.array([[0, 1, 2], [0, 1, 1]]))]).write(tmp_path / "thin.vtk")
    groups = meshio.Mesh(POINTS[:, [0, 2, 1]] * [1, 1, 0], [("line", [[0, 1]]), ("triangle", [[0, 1, 2]])])
    groups.cell_data = {"gmsh:physical": [np.array([1]), np.array([2])], "gmsh:geometrical": [np.array([1])] * 2}
    groups.field_data = {"slit": np.array([1, 1]), "plate": np.array([1, 2])}
    groups.write(tmp_path / "groups.msh", file_format="gmsh22")
    far.cell_data = {}
    far.write(tmp_path / "sets.inp")
    with (tmp_path / "sets.inp").open("a") as file:
        file.write("*ELSET, ELSET=one\n1\n*ELSET, ELSET=two\n2\n*ELSET, ELSET=both\none\ntwo\n")
    with pytest.raises(InputError, match=message):
        cut(tmp_path, text, crack)
