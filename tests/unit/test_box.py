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
