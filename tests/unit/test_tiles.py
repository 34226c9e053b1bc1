"""Pictures of bodies from meshes: tiles fill them, close their surface and open where bonds have failed."""

from itertools import combinations

import h5py
import meshio
import numpy as np
import pytest
from meshed import MESHED, meshed

from pdpetsc.body.cells import KINDS, Mesh, volumes_and_middles
from pdpetsc.body.given import source_of, whole
from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.io.cells import deformed_tiles, surface
from pdpetsc.io.fields import read_mesh, write_mesh
from pdpetsc.io.frames import Frame, behind, common_range, extent, tile_places
from pdpetsc.io.rendering import _polygons
from pdpetsc.io.tiles import areas, edges, faces
from pdpetsc.io.trust import check_fields
from pdpetsc.io.view import Section

NONE = np.empty((0, 2), np.int64)


def given(kind, particles, tmp_path, warp=0.05):
    """The particles of a mesh of the unit square or cube."""
    mesh = meshed(kind, warp)
    meshio.write(tmp_path / "part.vtu", mesh)
    body = {"mesh": str(tmp_path / "part.vtu"), "dimension": mesh.cells[0].dim, "particles": particles, "horizon": 3.0}
    document = {"body": body, "material": {"any": {"model": "ordinary", "E": 1.0, "nu": 0.25}}}
    return whole(source_of(Case.from_document(document, "part", None, "part.toml", False)))


def frame_of(part, u=None, F=None, apart=NONE, cracked=()) -> Frame:
    n, dim = part.position.shape
    position = np.pad(part.position, ((0, 0), (0, 3 - dim)))
    gradient = np.tile(np.eye(3), (n, 1, 1)) if F is None else np.tile(F, (n, 1, 1))
    u = np.zeros((n, 3)) if u is None else u
    torn, alone = np.zeros((n, 3, 2), bool), np.zeros(n, bool)
    alone[apart] = alone[list(cracked)] = True
    return Frame(position, part.spacing, part.volume, u, gradient, np.arange(n) * 1.0, torn, part.mesh, apart, alone)


def normals(corners: np.ndarray) -> np.ndarray:
    """Area vectors of polygons (n, corners, 3)."""
    arms = corners - corners[:, :1]
    return np.cross(arms, np.roll(arms, -1, axis=1)).sum(axis=1) / 2


def flat_areas(corners: np.ndarray) -> np.ndarray:
    return normals(np.pad(corners, ((0, 0), (0, 0), (0, 1))))[:, 2]


@pytest.mark.parametrize("particles", ["cells", "vertices"])
@pytest.mark.parametrize("kind", MESHED)
def test_tiles_are_the_particles(kind, particles, tmp_path):
    """In two dimensions each particle has its volume; in three the surface closes round that of the body, and behind a
    section each particle has what it had before, and the body what is there of it."""
    part = given(kind, particles, tmp_path)
    mesh, n = part.mesh, len(part.volume)
    if kind in ("triangle", "quad"):
        tiles = areas(mesh, mesh.points)
        own = np.bincount(tiles.owner, flat_areas(tiles.corners), n)
        assert own.sum() == pytest.approx(1) and len(edges(mesh, mesh.points, NONE).owner) == 0
        if particles == "cells" or kind == "triangle":  # of a vertex of other quadrilaterals it is but an equal share
            assert own == pytest.approx(part.volume)
        return
    seen = surface(frame_of(part), 1.0, None)
    assert np.linalg.norm(normals(seen.corners), axis=1).sum() == pytest.approx(6)


@pytest.mark.parametrize("particles", ["cells", "vertices"])
@pytest.mark.parametrize("kind", ["tetra", "hexahedron", "mixed"])
@pytest.mark.parametrize(("axis", "at", "rest"), [(0, 0.37, 0.37), (1, 0.37, 0.63), (1, 0.5, 0.5), (2, 2 / 3, 2 / 3)])
def test_sections(kind, particles, axis, at, rest, tmp_path):
    """The body's part behind a plane is closed by it, with the values of what is behind, where cells end there too."""
    part, cut = given(kind, particles, tmp_path, warp=0.0), Section(axis, at)
    frame = behind(frame_of(part), cut)
    seen = surface(frame, 1.0, cut)
    assert np.linalg.norm(normals(seen.corners), axis=1).sum() == pytest.approx(2 + 4 * rest)
    assert np.isfinite(seen.values).all() and seen.corners.min() > -1e-12 and seen.corners.max() < 1 + 1e-12
    plane = np.abs(seen.corners[:, :, axis] - at).max(axis=1) < 1e-12
    assert np.linalg.norm(normals(seen.corners[plane]), axis=1).sum() == pytest.approx(1)
    inner = np.unique(seen.values[plane]).astype(int)
    towards = (1 if cut.side else -1) * (at - part.position[inner, axis])
    assert (towards > -0.5).all() and (towards.max() > 0 or particles == "vertices")
    with pytest.raises(InputError, match=r"misses the body, which goes from 0 to 1"):
        behind(frame_of(part), Section(axis, 1.0))


def test_long_cells_are_seen_whole(tmp_path):
    """Cells ten times as long as high: sections reach to their ends, and so does the picture."""
    points = np.stack(np.meshgrid([0, 10, 20, 30.0], [0, 1, 2.0], indexing="ij"), axis=-1).reshape(-1, 2)
    n = np.arange(12).reshape(4, 3)
    cells = np.stack([n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]], axis=-1).reshape(-1, 4)
    meshio.write(tmp_path / "part.vtu", meshio.Mesh(np.c_[points, np.zeros(12)], [("quad", cells)]))
    body = {"mesh": str(tmp_path / "part.vtu"), "dimension": 2, "horizon": 3.0}
    document = {"body": body, "material": {"any": {"model": "ordinary", "E": 1.0, "nu": 0.25}}}
    frame = frame_of(whole(source_of(Case.from_document(document, "part", None, "part.toml", False))))
    low, high = extent(frame, 2)
    shown = common_range(lambda: [frame], 2)
    assert low.tolist() == shown.low.tolist() == [0, 0, 0] and high.tolist() == shown.high.tolist() == [30, 2, 0]
    with pytest.raises(InputError, match="is damaged: the dimensions of its mesh are not the 3 of the body"):
        common_range(lambda: [frame], 3)


@pytest.mark.parametrize("particles", ["cells", "vertices"])
@pytest.mark.parametrize("kind", ["tetra", "hexahedron", "triangle", "quad"])
def test_all_bonds_gone_leaves_particles_alone(kind, particles, tmp_path):
    """Every particle is then closed by its own tiles: area vectors add up to zero, or ends of lines meet."""
    part = given(kind, particles, tmp_path, warp=0.0)
    apart = np.array(list(combinations(range(len(part.volume)), 2)))
    if part.mesh.points.shape[1] == 2:
        ends = np.sort(np.round(edges(part.mesh, part.mesh.points, apart).corners, 12), axis=1)
        assert len(ends) and (np.unique(ends, axis=0, return_counts=True)[1] == 2).all()
        return
    tiles = faces(part.mesh, part.mesh.points, apart, None)
    count = np.bincount(tiles.owner)
    inside = np.stack([np.bincount(tiles.owner, tiles.corners.mean(axis=1)[:, k]) for k in range(3)], axis=1)
    arms = tiles.corners.mean(axis=1) - (inside / count[:, None])[tiles.owner]
    area = normals(tiles.corners)
    area *= np.sign((area * arms).sum(axis=1))[:, None]
    for k in range(3):
        assert np.abs(np.bincount(tiles.owner, area[:, k])).max() < 1e-12
    volume = np.bincount(tiles.owner, (area * arms).sum(axis=1) / 3)
    assert volume.sum() == pytest.approx(1)
    if kind == "tetra" or particles == "cells":
        assert volume == pytest.approx(part.volume)


@pytest.mark.parametrize("particles", ["cells", "vertices"])
@pytest.mark.parametrize("kind", ["tetra", "quad"])
def test_left_out_particles_leave_a_gap(kind, particles, tmp_path):
    part = given(kind, particles, tmp_path)
    left = part.position[:, 0] < 0.5
    mesh = part.mesh._replace(particle=np.where(left, np.cumsum(left) - 1, -1))
    mesh = mesh.part(mesh.peopled())
    assert mesh.points[:, 0].max() < 0.76 and (mesh.particle[mesh.particle >= 0] == np.arange(left.sum())).all()
    if kind == "quad":
        tiles = areas(mesh, mesh.points)
        assert flat_areas(tiles.corners).sum() == pytest.approx(part.volume[left].sum(), rel=0.05)
        assert set(tiles.owner.tolist()) == set(range(left.sum()))
        return
    tiles = faces(mesh, mesh.points, NONE, None)
    assert set(tiles.owner.tolist()) <= set(range(left.sum())) and tiles.corners[:, :, 0].max() < 0.75


@pytest.mark.parametrize("particles", ["cells", "vertices"])
@pytest.mark.parametrize("kind", MESHED)
def test_tiles_move_with_the_body(kind, particles, tmp_path):
    """An affine motion moves all of them alike, with the mesh or alone."""
    part = given(kind, particles, tmp_path)
    n, dim = part.position.shape
    F = np.eye(3)
    F[:dim, :dim] += 0.1 * np.arange(dim * dim).reshape(dim, dim)
    u = np.zeros((n, 3))
    u[:, :dim] = part.position @ (F - np.eye(3))[:dim, :dim].T
    for apart in (NONE, np.array([[0, 1], [3, 4]])):
        frame = frame_of(part, u, F, apart)
        tiles = areas(part.mesh, tile_places(frame)) if dim == 2 else faces(part.mesh, tile_places(frame), apart, None)
        X = tiles.corners[:, :, :dim]
        assert deformed_tiles(frame, 2.0, tiles) == pytest.approx(X + 2 * X @ (F - np.eye(3))[:dim, :dim].T)


@pytest.mark.parametrize("cut", [False, True])
def test_cracks_open(cut, tmp_path):
    """What is on both sides of a cut moves away from it, as far as its particles do."""
    part = given("triangle", "cells", tmp_path)
    right = part.position[:, 0] > 0.5
    near = np.abs(part.position[:, 0] - 0.5) < 0.25
    i, j = np.meshgrid(np.flatnonzero(right & near), np.flatnonzero(~right & near))
    u = np.where(right, 0.5, 0.0)[:, None] * [1, 0, 0]
    if cut:  # by a crack that is there from the start
        frame = frame_of(part, u, cracked=np.flatnonzero(near))
    else:
        frame = frame_of(part, u, apart=np.stack([i.ravel(), j.ravel()], axis=1))
    tiles = areas(part.mesh, tile_places(frame))
    corners = deformed_tiles(frame, 1.0, tiles)
    assert flat_areas(corners).sum() == pytest.approx(1)
    ends = corners.reshape(len(corners), -1, 2)[..., 0]
    gap = (ends[right[tiles.owner]].min(), ends[~right[tiles.owner]].max())
    assert gap[0] - gap[1] > 0.2


def test_polygons_without_repeated_corners():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 0.0]])
    triangle = square[[0, 1, 2, 2, 2]]
    found = _polygons(np.array([square, triangle]))
    assert found.tolist() == [4, 0, 1, 2, 3, 3, 5, 6, 7]


def body_file(path, mesh: Mesh | None, count: int):
    with h5py.File(path, "w") as file:
        file["position"] = np.zeros((count, 3))
        for name in ("volume", "horizon", "spacing"):
            file[name] = np.ones(count)
        if mesh is not None:
            write_mesh(file, mesh)
            file["mesh/cracked"] = np.zeros(count, np.int32)
    return path


def test_meshes_come_back(tmp_path):
    part = given("mixed", "vertices", tmp_path)
    mesh = part.mesh
    with h5py.File(body_file(tmp_path / "fields.h5", mesh, len(part.volume)), "r") as file:
        again = read_mesh(file)
    check_fields(tmp_path / "fields.h5")
    assert again.on == "points" and all(np.array_equal(a, b) for a, b in zip(mesh, again))
    volume = sum(volumes_and_middles(kind, again.points[again.cells[rows, : kind.corners]])[0].sum()
                 for kind, rows in again.kinds())  # fmt: skip
    assert volume == pytest.approx(1) and {kind.corners for kind, _ in again.kinds()} == {
        KINDS[name].corners for name in ("hexahedron", "wedge", "pyramid")
    }
    with h5py.File(body_file(tmp_path / "fields.h5", None, 3), "r") as file:
        assert read_mesh(file) is None


@pytest.mark.parametrize(
    "change",
    [
        {"points": np.zeros((2, 2))}, {"points": np.zeros((4, 1))}, {"points": np.full((4, 2), np.nan)},
        {"cells": np.array([[0, 1, -1, 2]])}, {"cells": np.array([[0, 1, 2, 9]])}, {"cells": np.array([[0, -1, -1]])},
        {"cells": np.zeros((1, 9), int)}, {"particle": np.array([3])}, {"particle": np.array([0, 1])}, {"on": "edges"},
        {"particle": np.array([-1])}, {"cells": np.empty((0, 4), int), "particle": np.empty(0, int)},
    ],
    ids=str,
)  # fmt: skip
def test_meshes_that_are_none(change, tmp_path):
    mesh = Mesh(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2, 3]]), np.array([0]), "cells")
    check_fields(body_file(tmp_path / "fields.h5", mesh, 1))
    with pytest.raises(InputError, match=r"mesh/|particle has the shape"):
        check_fields(body_file(tmp_path / "fields.h5", mesh._replace(**change), 1))
