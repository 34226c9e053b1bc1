"""Whole runs of bodies from files: bundled ones, constant strain on irregular meshes, restart, motion that breaks."""

import json

import meshio
import numpy as np
import pytest

from pdpetsc.case import load

PATCH = """
[body]
mesh = "patch.vtu"
dimension = 2
horizon = 2.515
[sets]
rim = "X < 0.25 or X > 0.75 or Y < 0.25 or Y > 0.75"
core = "X > 0.25 and X < 0.75 and Y > 0.25 and Y < 0.75"
[material.m]
model = "ordinary"
E = 1.0
nu = 0.3
kinematics = "linear"
[[load]]
kind = "displacement"
set = "rim"
component = "x"
value = "t * (1e-3 * X + 5e-4 * Y)"
[[load]]
kind = "displacement"
set = "rim"
component = "y"
value = "t * (-2e-4 * X - 4e-4 * Y)"
[solver]
steps = 1
[[probe]]
name = "error"
field = "u"
component = "x"
set = "core"
reduce = "error"
exact = "1e-3 * X + 5e-4 * Y"
"""

TORN = """
[body]
mesh = "patch.vtu"
dimension = 2
horizon = 2.515
cracks = [{ from = [-1.0, 0.513], to = [0.4, 0.513] }]
[sets]
low = { group = "side=1" }
high = { group = "side=2" }
[material.m]
model = "bond"
E = 1.0
density = 1.0
[damage.m]
criterion = "critical_stretch"
critical = 0.02
exempt = ["low", "high"]
[[load]]
kind = "velocity"
set = "low"
component = "y"
value = -0.02
[[load]]
kind = "velocity"
set = "high"
component = "y"
value = 0.02
[solver]
mode = "verlet"
end_time = 1.2
[output]
fields = ["u", "damage"]
picture = "damage"
"""


def patch(path, n: int) -> None:
    """Triangles of the unit square whose points are moved by up to a fifth of their distance; data of two sides."""
    x = np.linspace(0, 1, n + 1)
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = ((points > 0) & (points < 1)).all(axis=1)
    points[inside] += np.random.default_rng(n).uniform(-0.2, 0.2, (inside.sum(), 2)) / n
    k = np.arange(len(points)).reshape(n + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    height = points[cells][:, :, 1].mean(axis=1)
    side = np.where(height < 0.12, 1, np.where(height > 0.88, 2, 0))
    mesh = meshio.Mesh(np.c_[points, np.zeros(len(points))], [("triangle", cells)], cell_data={"side": [side]})
    meshio.write(path, mesh)


def summary_of(folder) -> dict:
    return json.loads((folder / "summary.json").read_text())


def test_constant_strain_on_irregular_meshes(run_pdpetsc, tmp_path):
    """It is not exact, as on lattices: the error goes down with the size of the cells (docs/geometry.md)."""
    (tmp_path / "patch.toml").write_text(PATCH)
    errors = []
    for n in (8, 32):
        patch(tmp_path / "patch.vtu", n)
        assert run_pdpetsc(None, "patch.toml", "--out", f"out{n}", "--quiet").returncode == 0
        errors.append(summary_of(tmp_path / f"out{n}")["probes"]["error"])
    assert errors[0] < 0.05
    assert errors[1] < errors[0] / 3


def test_restart_on_other_ranks_of_a_meshed_body_that_breaks(run_pdpetsc, tmp_path):
    """Groups, cracks and broken bonds come again from the mesh and the checkpoint, whatever the ranks."""
    patch(tmp_path / "patch.vtu", 16)
    (tmp_path / "torn.toml").write_text(TORN)
    assert run_pdpetsc(None, "torn.toml", "--out", "one", "--quiet").returncode == 0
    one = summary_of(tmp_path / "one")
    assert one["steps"][-1]["broken_bonds"] > 50
    half = run_pdpetsc(2, "torn.toml", "--out", "two", "--quiet", "--set", "solver.end_time=1.2")
    assert half.returncode == 0
    two = summary_of(tmp_path / "two")
    assert two["steps"][-1]["broken_bonds"] == one["steps"][-1]["broken_bonds"]
    assert two["energies"]["stored"] == pytest.approx(one["energies"]["stored"], rel=1e-6)
    again = run_pdpetsc(3, "restart", "two")
    assert again.returncode == 0, again.stderr
    assert "already come to its end" in again.stderr


@pytest.mark.parametrize("variant", ["", ":vertices"])
def test_sheet_with_a_hole(run_pdpetsc, variant):
    """The stress concentration and the ligament, on triangles and on their vertices."""
    run = run_pdpetsc(2 if variant else None, f"sheet_hole{variant}", "--out", "out")
    assert run.returncode == 0, run.stdout + run.stderr
    assert "MISSED" not in run.stdout


@pytest.mark.slow
def test_bracket(run_pdpetsc, tmp_path):
    """The coarse one in 3D, of Gmsh's format 4.1 with groups of cells and of facets."""
    run = run_pdpetsc(2, "bracket:coarse", "--out", "out", limit=400)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "MISSED" not in run.stdout


def test_the_bundled_meshes_are_checked_in_seconds(run_pdpetsc):
    run = run_pdpetsc(None, "check", "bracket")
    assert run.returncode == 0
    assert "particles  55449\n" in run.stdout
    assert load("bracket").body.shape == "mesh"
