"""Tables and pictures, from data made by hand."""

import csv
import json

import h5py
import numpy as np
import pytest
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from PIL import Image

from pdpetsc.errors import InputError
from pdpetsc.io import rendering, tables
from pdpetsc.io.cells import cell_sides, free_faces
from pdpetsc.io.curves import plot_curve
from pdpetsc.io.plot import animate_result, plot_result
from pdpetsc.io.view import View
from pdpetsc.quantities import QUANTITIES, component, components, scalar
from pdpetsc.recover import FIELDS

ROWS = [
    {"step": 1, "time": 0.5, "norms": [1.0, 1e-9], "rounding_floor": False, "probes": {"tip": 0.1, "line": [1, 2]}},
    {"step": 2, "time": 1.0, "norms": [2.0], "rounding_floor": True, "probes": {"tip": 1 / 3, "line": [3, 4]}},
]


@pytest.fixture(autouse=True)
def without_pyvista(monkeypatch):
    """Bodies of three dimensions are drawn by matplotlib; test_pictures.py has the other way."""
    monkeypatch.setattr(rendering, "find_spec", lambda name: None)


def test_history_has_the_numbers_of_each_step(tmp_path):
    tables.write_history(tmp_path / "history.csv", ROWS)
    with (tmp_path / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["step", "time", "rounding_floor", "tip"]
    assert [float(row["tip"]) for row in rows] == [0.1, 1 / 3]  # all digits
    assert tables.read_history(tmp_path) == {"step": [1, 2], "time": [0.5, 1.0], "tip": [0.1, 1 / 3]}


def test_summary_is_written_whole(tmp_path):
    path = tmp_path / "summary.json"
    tables.write_summary(path, {"a": 1})
    with pytest.raises(TypeError):
        tables.write_summary(path, {"a": object()})
    assert json.loads(path.read_text()) == {"a": 1}


def test_a_result_is_known_by_its_case(tmp_path):
    assert not tables.is_result(tmp_path)
    assert not tables.is_result(tmp_path / "nowhere")
    document = {"title": "ü", "body": {"size": [1.0, 2.0], "horizon": {"length": "0.1 + X"}}, "load": [{"value": 0.0}]}
    tables.write_case(tmp_path, document, "0.1.0, my.toml")
    assert tables.is_result(tmp_path)
    (tmp_path / "case.toml").write_bytes(b"\xff\xfe")
    assert not tables.is_result(tmp_path)


def test_colours_of_a_stress_are_von_mises():
    uniaxial, shear, pressure = np.zeros((3, 3, 3))
    uniaxial[0, 0] = -7.0
    shear[0, 1] = shear[1, 0] = 2.0
    pressure += 5 * np.eye(3)
    stress = np.stack([uniaxial, shear, pressure]).reshape(3, 9)
    assert scalar("stress", stress) == pytest.approx([7.0, 2 * np.sqrt(3), 0.0], abs=1e-14)


def test_colours_of_principal_values_are_the_largest():
    assert scalar("principal", np.array([[1.0, -2.0, -5.0]])) == pytest.approx([1.0])


def test_components():
    """Of one state by hand: shear of 2 with a skew part, beside a normal stress of 5."""
    stress = np.array([[[0.0, 3.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 5.0]], np.full((3, 3), np.nan)])
    values = {"xy": 3.0, "yx": 1.0, "1": 5.0, "2": 2.0, "3": -2.0, "magnitude": np.sqrt(35), "von_mises": np.sqrt(37)}
    for name, value in values.items():
        assert component(stress, name)[0] == pytest.approx(value), name
        assert np.isnan(component(stress, name)[1])
        assert name in components("stress", 2) and name in components("peridynamic_stress", 1)
    assert components("strain", 3)[-5:] == ("zz", "magnitude", "1", "2", "3")
    assert components("u", 2) == ("x", "y", "magnitude") and components("von_mises", 2) == ()
    assert component(np.array([[3.0, 2.0, 1.0]]), "2") == pytest.approx([2.0])


def test_colours_of_other_fields_are_magnitudes():
    assert scalar("u", np.array([[3.0, 4.0, 0.0]])) == pytest.approx([5.0])
    assert scalar("energy", np.array([-2.0])) == pytest.approx([-2.0])
    assert scalar("F", np.eye(3).reshape(1, 9) + 1.0) == pytest.approx([3.0])


def test_every_quantity_is_computed():
    assert list(FIELDS) == list(QUANTITIES)


def refined(counts, division, cell=(1.0, 1.0, 1.0)):
    """Particles of a block whose cells are divided, and their spacings."""
    X, spacing = [], []
    for index in np.ndindex(*counts):
        r = division(*index)
        inside = np.stack(np.meshgrid(*[(np.arange(r) + 0.5) / r] * 3), axis=-1).reshape(-1, 3)
        X.append((index + inside) * cell)
        spacing.append(np.full(r**3, np.prod(cell) ** (1 / 3) / r))
    return np.concatenate(X), np.concatenate(spacing)


@pytest.mark.parametrize(
    "division",
    [lambda x, y, z: 1, lambda x, y, z: 3, lambda x, y, z: 1 + 3 * (x < 2), lambda x, y, z: 1 + x,
     lambda x, y, z: 1 + 7 * (x == y == z == 1), lambda x, y, z: 1 + (x + y + z) % 2],
)  # fmt: skip
@pytest.mark.parametrize("cell", [(1.0, 1.0, 1.0), (1.04, 0.98, 0.97)])
def test_free_faces_of_a_block(division, cell):
    """They make its surface, wherever fine cells meet coarse ones."""
    X, spacing = refined((4, 3, 3), division, cell)
    for axis, (n, faces) in enumerate(zip((4, 3, 3), (9, 12, 12))):
        for side in (-1, 1):
            free = free_faces(X, spacing, side * np.eye(3)[axis])
            assert (spacing[free] ** 2).sum() == pytest.approx(faces * np.prod(cell) ** (2 / 3))
            outermost = np.abs(X[:, axis] - (n * cell[axis] if side > 0 else 0)) < 0.6 * spacing
            assert np.array_equal(free, outermost)


def test_free_faces_of_a_hole():
    """Half of the small cells beside a large one are missing: it shows; the large one above hides theirs."""
    X, spacing = refined((2, 1, 2), lambda x, y, z: 1 + (x == 1 and z == 0))
    kept = ~((X[:, 0] > 1) & (X[:, 1] > 0.5) & (X[:, 2] < 1))
    X, spacing = X[kept], spacing[kept]
    right, up = (free_faces(X, spacing, direction) for direction in np.eye(3)[[0, 2]])
    assert right[(X == [0.5, 0.5, 0.5]).all(axis=1)].all()
    assert not right[(X == [0.5, 0.5, 1.5]).all(axis=1)].any()
    assert np.array_equal(up, X[:, 2] > 1)


def test_cells_are_drawn_by_their_volume():
    """Cells that a border cuts are smaller, those of particles on vertices end where the body ends."""
    X = np.array([[x, y] for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)])
    spacing, thickness = np.full(9, 0.5), 0.1
    sides = cell_sides(X, spacing, 0.25 * thickness * np.array([1, 1, 1, 1, 0.36, 1, 1, 1, 1]))
    half = np.full((9, 2, 2), 0.25) * [-1, 1]
    half[4] *= 0.6
    np.testing.assert_allclose(sides, half)
    on_sides = np.array([2, 1, 2, 1, 0, 1, 2, 1, 2])
    sides = cell_sides(X, spacing, 0.25 * thickness / 2.0**on_sides)
    np.testing.assert_allclose(X[..., None] + sides, np.clip(X[..., None] + 0.25 * np.array([-1, 1]), 0, 1))


def test_the_pictures_show_each_spacing(tmp_path):
    X, spacing = refined((3, 2, 2), lambda x, y, z: 1 + (x == 0))
    for dim in (1, 2, 3):
        with h5py.File(tmp_path / "fields.h5", "w") as file:
            file["position"], file["spacing"], file["volume"] = X * (np.arange(3) < dim), spacing, spacing**dim
            group = file.create_group("00001")
            group["u"], group["F"] = 0.01 * X, np.tile(np.eye(3).ravel(), (len(X), 1))
        units = {"length": "mm", "force": "N", "time": "s"}
        summary = {"dim": dim, "units": units, "title": "", "case": "a_case", "steps": [{"step": 1, "time": 1.0}]}
        plot_result(tmp_path, summary, View("u"), "result")
        assert (tmp_path / "result.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(("dim", "field"), [(1, "u"), (3, "u"), *((2, name) for name in sorted(QUANTITIES))])
def test_pictures(tmp_path, dim, field):
    """Every field in every dimension, the undeformed body too, gives an image."""
    n = 12
    X = np.zeros((n, 3))
    X[:, :dim] = np.random.default_rng(0).uniform(0, 1e-3, (n, dim))
    with h5py.File(tmp_path / "fields.h5", "w") as file:
        file["position"], file["spacing"], file["volume"] = X, np.full(n, 1e-4), np.full(n, 1e-4**dim)
        group = file.create_group("00003")
        group["u"] = np.zeros((n, 3)) if dim == 1 else 1e-5 * X
        group["F"] = np.tile(np.eye(3).ravel(), (n, 1))  # the cells are drawn deformed
        if field not in ("u", "F"):
            group[field] = np.ones((n, 3 ** QUANTITIES[field].rank)[: 1 + bool(QUANTITIES[field].rank)])
    summary = {
        "dim": dim, "units": {"length": "mm", "force": "N", "time": "s"}, "title": "", "case": "a_case",
        "steps": [{"step": 3, "time": 1.0}],
    }  # fmt: skip
    plot_result(tmp_path, summary, View(field), "result")
    picture = (tmp_path / "result.png").read_bytes()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n" and len(picture) > 5000


def moving(directory, steps: int) -> dict:
    """A field file of four particles whose last one moves on by 1 in each step, and its summary."""
    X = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    rows = []
    with h5py.File(directory / "fields.h5", "w") as file:
        file["position"], file["spacing"], file["volume"] = X, np.ones(4), np.ones(4)
        for step in (0, *range(99_900, 99_900 + 100 * steps, 100)):  # up to six digits
            group = file.create_group(f"{step:05d}")
            group["u"] = (X == 1) * (0.5 * len(rows))
            rows.append({"step": step, "time": 0.01 * step})
    units = {"length": "mm", "force": "N", "time": "s"}
    return {"dim": 2, "units": units, "title": "", "case": "a_case", "steps": rows}


def test_an_animation_has_all_steps_on_one_scale(tmp_path, monkeypatch):
    titles, limits = [], []
    monkeypatch.setattr(PillowWriter, "grab_frame", lambda self, **style: note(self.fig.axes[0]))

    def note(axes):
        titles.append(axes.get_title())
        limits.append((axes.get_xlim(), axes.get_ylim(), axes.collections[0].get_clim()))

    monkeypatch.setattr(PillowWriter, "finish", lambda self: None)
    animate_result(tmp_path, moving(tmp_path, 3), View("u"), "u")
    assert [title.partition("t = ")[2].split("\n")[0] for title in titles] == ["0", "999", "1000", "1001"]
    assert len(set(limits)) == 1
    (left, right), (bottom, top), colours = limits[0]
    assert left < -0.5 and right > 3.0 and bottom < -0.5 and top > 3.0
    assert colours == (0.0, pytest.approx(1.5 * 2**0.5))


def test_the_file_of_an_animation(tmp_path):
    (tmp_path / "case.toml").write_text(tables.MARK)
    path = animate_result(tmp_path, moving(tmp_path, 2), View("u"), "u")
    with Image.open(path) as image:
        assert image.n_frames == 3 and path.name == "u.gif"
    assert tables.is_result(tmp_path)


def test_a_field_that_was_not_written(tmp_path):
    with pytest.raises(InputError, match=r"--field damage: was not written; there is u, and output.fields asks for"):
        plot_result(tmp_path, moving(tmp_path, 1), View("damage"), "damage")


def test_a_summary_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="holds no result of a run that has ended"):
        tables.read_summary(tmp_path)


def test_a_curve_has_a_marker_for_each_step(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Axes, "plot", lambda axes, *values, **style: drawn.append((axes, values, style)))
    columns = {"a $ opening": [1e-6 * k for k in range(4)], "load": [(3.0 - k) * k for k in range(4)]}
    plot_curve(tmp_path, "A crack at 5 $", columns, "a $ opening", "load", {"load": "load [N]"})
    ((axes, (x, y), style),) = drawn
    assert x == [0.0, 1e-6, 2e-6, 3e-6] and y == [0.0, 2.0, 2.0, 0.0] and style["marker"] == "o"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("a $ opening", "load [N]")


def test_the_picture_of_a_curve(tmp_path):
    (tmp_path / "case.toml").write_text(tables.MARK)
    for count in (3, 1):
        columns = {"opening": list(1e-6 * np.arange(count)), "load": list(np.sin(np.arange(count)))}
        plot_curve(tmp_path, "A crack", columns, "opening", "load")
        picture = (tmp_path / "curve.png").read_bytes()
        assert picture[:8] == b"\x89PNG\r\n\x1a\n" and len(picture) > 5000
    assert tables.is_result(tmp_path)
