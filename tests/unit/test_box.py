"""Lattice bodies and sets of particles, alike on any number of ranks."""

import numpy as np
import pytest

from pdpetsc.body.box import box
from pdpetsc.case import Case
from pdpetsc.errors import InputError

pytestmark = pytest.mark.mpi


def body(**keys):
    sizes = {"size": [1.0, 0.5], "spacing": 0.125, "horizon": 2.015} | keys
    material = {"steel": {"model": "correspondence", "E": 1.0, "nu": 0.25}}
    return Case.from_document({"body": sizes, "material": material}, "case", None, "case.toml", False).body


def points(comm, body):
    """The whole body on every rank, in the order of the ids, and this rank's part."""
    factor = body.horizon.factor
    part = box(comm, body, body.keep, lambda X, spacing: np.full(len(X), factor() * spacing))
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
