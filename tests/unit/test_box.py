"""Lattice bodies and sets of particles, alike on any number of ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc.body.border import BORDER
from pdpetsc.body.box import FACES, box
from pdpetsc.building import distributed_particles
from pdpetsc.case import Case
from pdpetsc.census import take_census
from pdpetsc.errors import InputError
from pdpetsc.particles import distribute

pytestmark = pytest.mark.mpi


def case(**keys):
    sizes = {"size": [1.0, 0.5], "spacing": 0.125, "horizon": 2.015} | keys
    material = {"steel": {"model": "correspondence", "E": 1.0, "nu": 0.25}}
    sets = {"rim": "X > 0", "tip": "X > 0"} if "zones" in keys else {}
    return Case.from_document({"body": sizes, "material": material, "sets": sets}, "case", None, "case.toml", False)


def body(**keys):
    return case(**keys).body


def share_of(comm, body, facets=False):
    """This rank's share of the body."""
    factor = body.horizon.factor
    return box(comm, body, body.keep, lambda X, spacing: np.full(len(X), factor() * spacing), facets)


def points(comm, body):
    """The whole body on every rank, in the order of the ids."""
    part = share_of(comm, body)
    whole = {
        name: np.concatenate(comm.allgather(getattr(part, name)))
        for name in ("id", "position", "volume", "spacing", "horizon")
    }
    assert np.array_equal(np.sort(whole["id"]), np.arange(len(whole["id"])))
    order = np.argsort(whole["id"])
    return {name: values[order] for name, values in whole.items()}


def centers(*axes):
    """x fastest."""
    return np.stack([a.ravel(order="F") for a in np.meshgrid(*axes, indexing="ij")], axis=1)


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_a_box(comm, dim):
    thickness = {} if dim == 3 else {"thickness": 2.0}
    found = points(comm, body(size=[1.0, 0.5, 0.25][:dim], origin=[1.0, 2.0, -3.0][:dim], **thickness))
    axes = [o + 0.125 * (np.arange(n) + 0.5) for o, n in zip((1.0, 2.0, -3.0), (8, 4, 2))][:dim]
    assert np.allclose(found["position"], centers(*axes), rtol=0, atol=1e-15)
    volume = 0.125**dim * (1 if dim == 3 else 2)
    assert np.allclose(found["volume"], volume, rtol=1e-14)
    assert np.allclose(found["spacing"], 0.125, rtol=1e-14)
    assert np.allclose(found["horizon"], 2.015 * 0.125, rtol=1e-14)


def test_holes_leave_dense_ids(comm):
    found = points(comm, body(keep="hypot(X - 0.5, Y - 0.25) > 2 * spacing"))
    X = centers(0.125 * (np.arange(8) + 0.5), 0.125 * (np.arange(4) + 0.5))
    X = X[np.hypot(X[:, 0] - 0.5, X[:, 1] - 0.25) > 0.25]
    assert np.allclose(found["position"], X, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("width", "rows"),
    [("horizon", 2), ("2 horizon", 4), ("1.5 horizon", 3), (0.125, 1), (0.01, 1), (0.3749999999, 3), (0.374, 2)],
)
def test_layers(comm, width, rows):
    found = points(comm, body(layers={"left": width, "top": 0.125}))
    x, y = found["position"].T
    assert np.unique(np.round(x, 9)) == pytest.approx(0.125 * (np.arange(-rows, 8) + 0.5))
    assert np.unique(np.round(y, 9)) == pytest.approx(0.125 * (np.arange(5) + 0.5))


def by_hand(cells, division, origin, cell):
    """A refined lattice by loops: positions and divisions, the cells in their order, x fastest everywhere."""
    positions, divisions = [], []
    for index in np.ndindex(*reversed(cells)):
        low = origin + np.array(index[::-1]) * cell
        r = division(low + cell / 2)
        for inside in np.ndindex(*(r,) * len(cells)):
            positions.append(low + (np.array(inside[::-1]) + 0.5) * cell / r)
            divisions.append(r)
    return np.array(positions), np.array(divisions)


@pytest.mark.parametrize("near", ("rim", "tip"))
def test_zones_round_sets(comm, near):
    """Cells near the rim of a hole, or a point, are divided; the finest zone counts, and the same on any ranks."""
    described = case(
        size=[4.0, 4.0], spacing=0.25, keep="hypot(X - 2, Y - 2) > 0.9",
        zones=[{"near": near, "within": 0.8, "divide": 2}, {"near": near, "within": 0.3, "divide": 4}],
        refine="where(X < 0.5, 3, 1)",
    ).document  # fmt: skip
    described["sets"] = {"rim": "hypot(X - 2, Y - 2) < 0.9 + spacing", "tip": {"nearest": [3.0, 2.0]}}
    built = distributed_particles(PETSc.COMM_WORLD, Case.from_document(described, "case", None, "case.toml", False))
    X, spacing = built.position[: built.owned], built.spacing[: built.owned]
    middle = (np.floor(X / 0.25) + 0.5) * 0.25
    cells = (np.stack(np.meshgrid(*2 * [np.arange(16)]), axis=-1).reshape(-1, 2) + 0.5) * 0.25
    r = np.linalg.norm(cells - 2, axis=1)
    members = cells[(r > 0.9) & (r < 1.15)] if near == "rim" else np.array([[3.0, 2.0]])
    distance = np.linalg.norm(middle[:, None] - members, axis=2).min(axis=1)
    wanted = np.where(distance <= 0.3, 4, np.where(distance <= 0.8, 2, 1))
    wanted = np.maximum(wanted, np.where(middle[:, 0] < 0.5, 3, 1))
    assert np.array_equal(np.rint(0.25 / spacing), wanted)


def test_a_zone_round_nothing():
    described = case(size=[4.0, 4.0], zones=[{"near": "rim", "within": 0.8, "divide": 2}]).document
    described["sets"] = {"rim": "X > 5"}
    with pytest.raises(InputError, match=r"body\.zones: no undivided cell lies in the set 'rim'"):
        distributed_particles(PETSc.COMM_WORLD, Case.from_document(described, "case", None, "case.toml", False))


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_refined_cells(comm, dim):
    """A cell with r has r^dim particles that share its volume exactly, in an order that no number of ranks changes."""
    thickness = {} if dim == 3 else {"thickness": 2.0}
    refine = "1.5 + where(X > 1.25, 2, 0) + where(X > 1.5, 1, 0)"  # 1, 3, 4: floored
    found = points(comm, body(size=[1.0, 0.5, 0.25][:dim], origin=[1.0, 2.0, -3.0][:dim], refine=refine, **thickness))
    X, r = by_hand(
        (8, 4, 2)[:dim], lambda c: 1 + 2 * (c[0] > 1.25) + (c[0] > 1.5), np.array([1.0, 2.0, -3.0])[:dim], 0.125
    )
    assert np.allclose(found["position"], X, rtol=0, atol=1e-14)
    assert np.array_equal(found["volume"], 0.125**dim * (1 if dim == 3 else 2) / r**dim)
    assert found["volume"].sum() == pytest.approx(np.prod([1.0, 0.5, 0.25][:dim]) * (1 if dim == 3 else 2), rel=1e-13)
    assert np.allclose(found["spacing"], 0.125 / r, rtol=1e-15)
    assert np.allclose(found["horizon"], 2.015 * 0.125 / r, rtol=1e-15)


def test_a_division_of_one_changes_nothing(comm):
    plain, refined = points(comm, body(keep="X > 0.2")), points(comm, body(keep="X > 0.2", refine=1))
    assert all(np.array_equal(plain[name], refined[name]) for name in plain)


def test_holes_follow_the_refined_particles(comm):
    """The condition sees each particle with its own spacing."""
    found = points(comm, body(refine="where(X < 0.5, 2, 1)", keep="Y > 0.75 * spacing"))
    X, r = by_hand((8, 4), lambda c: 1 + (c[0] < 0.5), np.zeros(2), 0.125)
    kept = X[:, 1] > 0.75 * 0.125 / r
    assert 0 < kept.sum() < len(X)
    assert np.allclose(found["position"], X[kept], rtol=0, atol=1e-15)


def test_divisions_by_the_place_and_the_spacing(comm):
    """A quotient that rounding leaves below a whole number is that number."""
    found = points(comm, body(refine="(0.1 + 0.7) * 10 - 5 + 0 * X"))  # 3 - 4e-16
    assert len(found["id"]) == 32 * 9
    assert len(points(comm, body(refine="0.25 / spacing"))["id"]) == 32 * 4


def test_refined_layers(comm):
    """The width is in horizons of the face's particles; the layer's own cells are divided as the formula says."""
    layers = {"left": "2 horizon", "right": "horizon"}
    found = points(comm, body(layers=layers, refine="where(X < 0.5, 4, 1)"))
    x = found["position"][:, 0]
    assert x.min() == pytest.approx(-0.125 + 0.125 / 8)  # 2 x 2.015 / 4 of a cell: one cell
    assert x.max() == pytest.approx(1.25 - 0.125 / 2)  # 2.015 cells: two
    assert np.count_nonzero(x < 0) == 4 * 16


def test_a_layer_is_as_wide_as_the_largest_horizon_of_its_face(comm):
    """... of the particles that exist there."""
    keys = {"layers": {"left": "horizon"}, "refine": "where(Y < 0.25, 1, 4)"}
    assert points(comm, body(**keys))["position"][:, 0].min() == pytest.approx(-0.25 + 0.125 / 8)
    assert points(comm, body(**keys, keep="Y > 0.25"))["position"][:, 0].min() == pytest.approx(-0.125 + 0.125 / 8)


@pytest.mark.parametrize(
    ("refine", "message"),
    [
        ("where(X > 0.5, 0.5, 2)", r"body\.refine: is 0\.5 at \(0\.5625, 0\.0625\), but a cell has at least 1"),
        (-1, r"body\.refine: is -1 at \(0\.0625, 0\.0625\)"),
        ("1 / (X - 0.0625)", r"body\.refine: .* is inf at X = 0\.0625"),
        (1e30, "more than this PETSc's integers can number"),
        ("where(X > 0.9, 20000, 1)", "spacing: 0.125 with body.refine makes 1.6e.09 particles"),
    ],
)
def test_impossible_divisions(comm, refine, message):
    """On all ranks, whichever of them has the cell."""
    with pytest.raises(InputError, match=message):
        points(comm, body(refine=refine))


def test_cells_fit_the_size(comm):
    """Within 5 %, cells are stretched until a whole number of them fills the body; the spacing is their mean width."""
    found = points(comm, body(size=[1.02, 0.49]))
    assert len(found["id"]) == 32
    assert found["volume"].sum() == pytest.approx(1.02 * 0.49)
    assert found["spacing"] == pytest.approx(np.sqrt(1.02 / 8 * 0.49 / 4))


def test_a_size_that_is_no_multiple_of_the_spacing(comm):
    nearest = r"body\.size: \[1\.0, 0\.19\] .* the nearest lattice has 8 x 2 cells of 0\.125 x 0\.095"
    with pytest.raises(InputError, match=nearest):
        points(comm, body(size=[1.0, 0.19]))


def test_a_body_smaller_than_its_spacing(comm):
    with pytest.raises(InputError, match="is not a multiple of the spacing"):
        points(comm, body(size=[1.0, 0.01]))


def test_nothing_left(comm):
    with pytest.raises(InputError, match=r"body\.keep: no particle is left"):
        points(comm, body(keep="X < 0"))


# Vertices, fitted borders and surfaces -------------------------------------------------------------------------

HOLE = "hypot(X - 0.503, Y - 0.247) > 0.15"
NOTCH = "hypot(X - 0.503, Y - 0.05) > 0.15"
BODIES = {
    "line": {"size": [1.0]},
    "rectangle": {},
    "block": {"size": [1.0, 0.5, 0.25]},
    "vertex line": {"size": [1.0], "particles": "vertices"},
    "vertices": {"particles": "vertices", "layers": {"left": "horizon"}},
    "vertex block": {"size": [1.0, 0.5, 0.25], "particles": "vertices"},
    "hole": {"keep": HOLE, "fitted": True, "spacing": 0.0625},
    "notch": {"keep": NOTCH, "fitted": True, "layers": {"right": "horizon"}},
    "refined hole": {"keep": HOLE, "fitted": True, "refine": "where(X < 0.5, 2, 1)"},
    "vertex notch": {"keep": NOTCH, "fitted": True, "particles": "vertices", "spacing": 0.0625},
    "staircase": {"keep": NOTCH, "particles": "vertices"},
    "slivers": {"keep": "Y < 0.3752", "fitted": True},
    "ball": {"size": [1.0, 0.5, 0.5], "keep": "hypot(hypot(X - 0.503, Y - 0.247), Z - 0.26) > 0.2", "fitted": True},
}


def surface(comm, part):
    """All facets on every rank, by parent, face and place."""
    f = part.facets
    ids = getattr(part, "global_index", None)
    parents = f.parent if ids is None else part.id[f.parent]
    parent, face, position, area = (np.concatenate(comm.allgather(v)) for v in (parents, f.face, f.position, f.area))
    order = np.lexsort((*position.T, face, parent))
    return parent[order], face[order], position[order], area[order]


@pytest.mark.parametrize("name", BODIES)
def test_alike_on_any_number_of_ranks(comm, name):
    """Particles and facets are those of one rank, to the last bit; every rank makes them for itself to compare."""
    shape = body(**BODIES[name])
    found, pieces = points(comm, shape), surface(comm, share_of(comm, shape, True))
    alone = MPI.COMM_SELF
    wanted, wanted_pieces = points(alone, shape), surface(alone, share_of(alone, shape, True))
    for key in wanted:
        assert np.array_equal(found[key], wanted[key])
    for a, b in zip(pieces, wanted_pieces):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("name", BODIES)
def test_facets_are_distributed_with_their_particles(comm, name):
    """The same facets arrive; all particles within its parent's horizon of each are on its rank."""
    shape = body(**BODIES[name])
    part = share_of(comm, shape, True)
    whole, before = points(comm, shape), surface(comm, part)
    p = distribute(PETSc.COMM_WORLD, part)
    for a, b in zip(surface(comm, p), before):
        assert np.array_equal(a, b)
    f = p.facets
    assert np.all(f.parent < p.owned)
    for k in range(len(f)):
        away = np.linalg.norm(whole["position"] - f.position[k], axis=1)
        assert set(np.flatnonzero(away <= p.horizon[f.parent[k]])) <= set(p.id)


@pytest.mark.parametrize("name", BODIES)
def test_surfaces_are_closed(comm, name):
    """The area vectors of sides and border add up to zero, wherever the border runs; with particles left out of a
    lattice there are no facets at the gap."""
    _, _, _, area = surface(comm, share_of(comm, body(**BODIES[name]), True))
    if name == "staircase":
        assert abs(area[:, 1].sum()) > 0.1
        return
    # samples of cells of two sizes do not meet: where the border runs across, an error of a sample's width
    of_two_sizes = name in ("refined hole", "vertex notch")
    assert np.abs(area.sum(axis=0)).max() < (1.01 * 0.125 / 64 if of_two_sizes else 2e-15)


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_particles_on_vertices(comm, dim):
    """Half cells on sides, quarters and eighths in corners; each side's facets add up to it, corners lie on several."""
    size = np.array([1.0, 0.5, 0.25])[:dim]
    thickness = {} if dim == 3 else {"thickness": 2.0}
    shape = body(size=list(size), particles="vertices", **thickness)
    found = points(comm, shape)
    axes = [0.125 * np.arange(n + 1) for n in (8, 4, 2)][:dim]
    X = centers(*axes)
    assert np.allclose(found["position"], X, rtol=0, atol=1e-15)
    sides = (np.abs(X / size - 0.5) > 0.5 - 1e-9).sum(axis=1)
    deep = 1 if dim == 3 else 2
    assert np.allclose(found["volume"], 0.125**dim * deep / 2.0**sides, rtol=1e-14)
    assert found["volume"].sum() == pytest.approx(np.prod(size) * deep, rel=1e-14)
    assert np.allclose(found["spacing"], 0.125, rtol=1e-14)
    parent, face, position, area = surface(comm, share_of(comm, shape, True))
    for number, (axis, side) in enumerate(list(FACES.values())[: 2 * dim]):
        own = face == number
        wanted = np.zeros(dim)
        wanted[axis] = (2 * side - 1) * np.prod(np.delete(size, axis)) * deep
        assert np.allclose(area[own].sum(axis=0), wanted, rtol=1e-14)
        assert np.array_equal(parent[own], np.flatnonzero(np.abs(X[:, axis] - side * size[axis]) < 1e-9))
        assert np.all(position[own, axis] == side * size[axis])
    assert np.array_equal(np.unique(parent, return_counts=True)[1], sides[sides > 0])


def test_vertices_with_layers(comm):
    """A layer moves the side out: half cells and facets are there, the body's own first column is whole."""
    shape = body(particles="vertices", layers={"left": 0.25})
    found = points(comm, shape)
    assert np.unique(found["position"][:, 0]) == pytest.approx(0.125 * np.arange(-2, 9))
    assert found["volume"].sum() == pytest.approx(1.25 * 0.5, rel=1e-14)
    _, face, position, _ = surface(comm, share_of(comm, shape, True))
    assert np.all(position[face == 0, 0] == -0.25)


def test_vertices_are_kept_or_not(comm):
    found = points(comm, body(particles="vertices", keep=NOTCH))
    X = centers(0.125 * np.arange(9), 0.125 * np.arange(5))
    assert np.allclose(found["position"], X[np.hypot(X[:, 0] - 0.503, X[:, 1] - 0.05) > 0.15], rtol=0, atol=1e-15)


@pytest.mark.parametrize("particles", ("cells", "vertices"))
def test_volumes_of_fitted_bodies(comm, particles):
    """They come to that of the body as far as slivers of less than a fiftieth of a cell are left out."""
    for spacing in (0.125, 0.0625, 0.03125):
        found = points(comm, body(keep=HOLE, fitted=True, particles=particles, spacing=spacing, thickness=3.0))
        cells = 2 * np.pi * 0.15 / spacing  # about so many are cut
        error = found["volume"].sum() / 3 - (0.5 - np.pi * 0.15**2)
        assert abs(error) < 0.02 / 2 * cells * spacing**2
        inside = np.hypot(*(found["position"] - (0.503, 0.247)).T) > 0.15
        assert np.all(inside)  # middles of the cells' parts, here outside a convex hole


@pytest.mark.parametrize("layers", ({}, {"right": 0.25, "top": "horizon"}))
@pytest.mark.parametrize("dim", (1, 2, 3))
def test_a_border_along_cells(comm, dim, layers):
    """keep = "X > 0.5" on the cells' sides: as without fitting, with a facet of a full side in each cell along it."""
    keys = {"size": [1.0, 0.5, 0.25][:dim], "keep": "X > 0.5", "layers": dict(list(layers.items())[:dim])}
    plain, shape = points(comm, body(**keys)), body(**keys, fitted=True)
    found = points(comm, shape)
    for name in plain:
        assert np.allclose(found[name], plain[name], rtol=1e-14, atol=1e-15)
    parent, face, position, area = surface(comm, share_of(comm, shape, True))
    own = face == BORDER
    along = np.flatnonzero(np.abs(found["position"][:, 0] - 0.5625) < 1e-9)
    assert np.array_equal(parent[own], along)
    wanted = found["position"][along] - np.eye(dim)[0] * 0.0625
    assert np.allclose(position[own], wanted, rtol=0, atol=1e-12)
    assert np.allclose(area[own], -np.eye(dim)[0] * 0.125 ** (dim - 1), rtol=1e-14)


def test_slivers_give_their_surface_to_the_nearest_particle(comm):
    """0.2 % of a row of cells are inside: no particles, but the border is there, on the row before."""
    shape = body(keep="Y < 0.37525", fitted=True)
    found, (parent, face, position, area) = points(comm, shape), surface(comm, share_of(comm, shape, True))
    assert len(found["id"]) == 24 and np.all(found["volume"] == 0.125**2)
    own = face == BORDER
    assert np.array_equal(found["position"][parent[own], 0], position[own, 0]) and np.all(parent[own] >= 16)
    assert np.allclose(position[own, 1], 0.37525, rtol=0, atol=1e-12)
    assert np.allclose(area[own], [0, 0.125], rtol=0, atol=1e-15)
    assert np.abs(area.sum(axis=0)).max() < 1e-15


def test_small_bodies_and_holes(comm):
    """What the first look does not see is not there; a body of less than a fiftieth of a cell is none."""
    assert len(points(comm, body(keep="hypot(X - 0.52, Y - 0.22) > 0.01", fitted=True))["id"]) == 32
    with pytest.raises(InputError, match=r"body\.keep: no particle is left; .*less than a cell"):
        points(comm, body(keep="hypot(X - 0.5625, Y - 0.3125) < 0.005", fitted=True))
    one = points(comm, body(keep="hypot(X - 0.5625, Y - 0.3125) < 0.03", fitted=True))
    assert one["volume"] == pytest.approx([np.pi * 0.03**2], rel=0.02)
    assert np.allclose(one["position"], [[0.5625, 0.3125]], rtol=0, atol=1e-12)
    with pytest.raises(InputError, match=r"body\.keep: no particle is left; the condition is false everywhere"):
        points(comm, body(keep="X < 0", fitted=True))


@pytest.mark.parametrize("name", BODIES)
def test_counted_without_being_made(comm, name):
    """The census of a check has the number of particles exactly."""
    census = take_census(case(**BODIES[name]))
    assert census.exact and census.particles == len(points(comm, body(**BODIES[name]))["id"])
