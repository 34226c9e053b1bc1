"""Pictures of results that are made by hand: that they show what they should, and are not blank."""

import subprocess
import sys
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from handmade import made
from PIL import Image

from pdpetsc.errors import InputError
from pdpetsc.io import plot, rendering, tables
from pdpetsc.io.cells import surface
from pdpetsc.io.curves import convergence, plot_convergence, plot_curve
from pdpetsc.io.frames import common_range, open_fields, read_frame, torn_faces
from pdpetsc.io.plot import picture, plot_result
from pdpetsc.io.view import Section, View, check, section


def colours(path) -> int:
    with Image.open(path) as image:
        return len(image.convert("RGB").getcolors(maxcolors=image.width * image.height))


@pytest.fixture
def without_pyvista(monkeypatch):
    monkeypatch.setattr(rendering, "find_spec", lambda name: None)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("view", [View("stress", "xx"), View("u", "y", 1), View("damage")], ids=lambda view: view.name)
def test_pictures_are_not_blank(tmp_path, dim, view, without_pyvista):
    if dim == 1:
        view = view._replace(component=None)
    path = plot_result(tmp_path, made(tmp_path, dim), view, view.name)
    assert colours(path) > 20
    (tmp_path / "case.toml").write_text(tables.MARK)
    assert tables.is_result(tmp_path)  # it may be replaced by a later run


def shown(tmp_path, summary, view):
    """Title, label of the colours and their range."""
    axes, bar = picture(tmp_path, summary, view).axes
    return axes.get_title(), bar.get_ylabel(), axes.collections[0].get_clim(), axes.collections[0].cmap.name


def test_signed_components_part_at_zero(tmp_path):
    title, label, (low, high), colours = shown(tmp_path, made(tmp_path, 2), View("stress", "xx"))
    assert title == "A $block$\nt = 1\nlargest 5.2 MPa at (0.5, 5.5), smallest -4.8 MPa at (0.5, 0.5)"
    assert label == "stress xx [MPa]"
    assert low == -high and high == pytest.approx(2 * 2.6) and colours == plot.SIGNED


def test_values_of_one_sign_use_all_colours(tmp_path):
    summary = made(tmp_path, 2, mode="verlet")
    title, label, limits, colours = shown(tmp_path, summary, View("u", "y", step=1))
    assert title == "A $block$\nt = 0.5 s\nlargest 0.75 mm at (7.5, 0.5)" and label == "displacement y [mm]"
    assert limits == pytest.approx((0.05, 0.75)) and colours == plot.COLOURS
    assert shown(tmp_path, summary, View("stress", "2"))[1] == "principal stress 2 [MPa]"
    assert shown(tmp_path, summary, View("stress"))[1] == "von Mises stress [MPa]"
    assert shown(tmp_path, summary, View("damage"))[1:3] == ("damage", (0.0, 0.5))


def test_small_displacements_are_enlarged_and_it_is_said(tmp_path):
    summary = made(tmp_path, 2)
    with h5py.File(tmp_path / "fields.h5", "a") as file:
        file["00002/u"][...] *= 1e-4
    assert shown(tmp_path, summary, View("stress"))[0].splitlines()[1] == "t = 1, displacements x 2330"
    for scale in (1.0, 7.0):
        title = shown(tmp_path, summary, View("stress", scale=scale))[0].splitlines()[1]
        assert title == ("t = 1" if scale == 1 else "t = 1, displacements x 7")


def test_a_field_that_is_zero_has_the_colours_of_zero(tmp_path):
    summary = made(tmp_path, 2)
    with h5py.File(tmp_path / "fields.h5", "a") as file:
        file["00002/damage"][...] = 0
    assert shown(tmp_path, summary, View("damage"))[2] == (0.0, 1.0)


@pytest.mark.parametrize(
    ("view", "dim", "message"),
    [
        (View("stres"), 2, "--field stres: there is no such field .did you mean 'stress'"),
        (View("stress", "rr"), 2, "--component rr: stress has no such component; choices: xx, xy"),
        (View("damage", "x"), 2, "--component x: damage has no such component; it is a scalar"),
        (View("u", section=Section(0, 1.0)), 2, "--section: cuts a body of three dimensions, this one has 2"),
        (View("u", step=7), 2, "--step 7: was not written; there is 1, 2, and output.every"),
        (View("energy"), 2, "--field energy: was not written"),
        (View("u", section=Section(2, 9.0)), 3, r"--section z=9: misses the body, which goes from 0 to 5"),
        (View("u", section=Section(1, 4.0)), 3, r"--section y=4: misses the body, which goes from 0 to 4"),
    ],
)
def test_what_cannot_be_drawn(tmp_path, view, dim, message):
    with pytest.raises(InputError, match=message):
        picture(tmp_path, made(tmp_path, dim), view)


def test_a_result_without_fields(tmp_path):
    summary = made(tmp_path, 2)
    (tmp_path / "fields.h5").unlink()
    with pytest.raises(InputError, match="has no fields to draw"):
        picture(tmp_path, summary, View("u"))


@pytest.mark.parametrize("text", ["x", "x=", "w=1", "x=one", "=1"])
def test_sections_that_mean_nothing(text):
    with pytest.raises(InputError, match="must be a plane across an axis"):
        section(text)


def test_sections():
    assert section("x=0.05") == Section(0, 0.05) and section(" Z = -1e-3 ") == Section(2, -1e-3)
    assert View("stress", "xx", 3, Section(0, 1.0)).name == "stress-xx-step3-section"
    check(View("stress", "von_mises", section=Section(0, 1.0)), 3)


@pytest.mark.parametrize(("cut", "size"), [("x=2.5", (2.5, 4, 5)), ("y=1.25", (6, 2.75, 5)), ("z=3", (6, 4, 3))])
def test_a_section_cuts_the_body_and_its_cells(tmp_path, cut, size):
    """What is left is the block behind the plane, closed by the cut, where the values inside are seen."""
    made(tmp_path, 3)
    view = View("stress", "xx", section=section(cut))
    with open_fields(tmp_path) as file:
        frame = read_frame(file, "00001", view)
    seen = surface(frame._replace(u=0 * frame.u), 1.0, view.section)
    corners = seen.corners.reshape(-1, 3)
    assert np.ptp(corners, axis=0) == pytest.approx(size)
    first, second = seen.corners[:, 1] - seen.corners[:, 0], seen.corners[:, 3] - seen.corners[:, 0]
    areas = np.sqrt((np.cross(first, second) ** 2).sum(axis=1))
    a, b, c = size
    assert areas.sum() == pytest.approx(2 * (a * b + b * c + c * a))


def test_cells_come_apart_where_next_bonds_have_failed(tmp_path):
    made(tmp_path, 2)
    X = np.array([[x + 0.5, y + 0.5, 0.0] for y in range(6) for x in range(8)])
    pairs = [[[2.5, 2.5], [3.5, 2.5]], [[3.5, 2.5], [2.5, 2.5]], [[2.5, 2.5], [3.5, 3.5]], [[0.5, 0.5], [0.5, 1.5]]]
    torn = torn_faces(X, np.ones(48), np.array(pairs[:3]))
    assert {tuple(found) for found in np.argwhere(torn).tolist()} == {(18, 0, 1), (19, 0, 0)}
    assert torn_faces(X, np.ones(48), np.array(pairs)).sum() == 3
    assert not torn_faces(X, np.ones(48), None).any()


def test_cracks_are_black(tmp_path):
    summary = made(tmp_path, 2)
    ends = np.array([[[3.5, y + 0.5, 4.5, y + 0.5], [4.5, y + 0.5, 3.5, y + 0.5]] for y in range(6)]).reshape(-1, 4)
    bonds = np.array([[i, i + 1, 1] for i in range(12)])
    tables.write_broken_bonds(tmp_path / "broken_bonds.csv", bonds, ends, lambda step: 0.5)
    for field, cracks in (("u", 12), ("damage", 0)):  # which shows them by itself
        _, *lines = picture(tmp_path, summary, View(field)).axes[0].collections
        assert sum(len(found.get_segments()) for found in lines) == cracks


def test_faces_inside_a_crack_are_seen(tmp_path):
    made(tmp_path, 3)
    with open_fields(tmp_path) as file:
        frame = read_frame(file, "00001", View("u"))
    whole = len(surface(frame, 1.0, None).values)
    frame.torn[10, 0, 1] = frame.torn[11, 0, 0] = True
    assert len(surface(frame, 1.0, None).values) in (whole + 1, whole + 2)


def test_convergence(tmp_path):
    summary = made(tmp_path, 2, steps=range(1, 5))
    axes = convergence("A $block$", summary["steps"]).axes[0]
    assert axes.get_yscale() == "log" and len(axes.lines) == 4
    assert list(axes.lines[0].get_ydata())[:2] == [0.1, 1e-5]  # relative; zero has no place
    assert colours(plot_convergence(tmp_path, "A block", summary["steps"])) > 20
    assert len(convergence("", made(tmp_path, 2, steps=range(1, 30))["steps"]).axes) == 2  # with a bar of colours
    with pytest.raises(InputError, match="no step of this result has residuals"):
        convergence("", [{"step": 1, "time": 0.1}])


def test_a_curve_of_unknown_columns(tmp_path):
    with pytest.raises(InputError, match=r"there is no column 'lod' in history.csv .did you mean 'load'"):
        plot_curve(tmp_path, "", {"load": [1.0], "pull": [2.0]}, "pull", "lod")


class TestRendering:
    """Bodies of three dimensions by pyvista, in a process of its own."""

    def test_it_is_missing(self, tmp_path, without_pyvista):
        figure = picture(tmp_path, made(tmp_path, 3), View("u"))
        assert figure.axes[0].name == "3d"

    @pytest.mark.parametrize("trouble", [subprocess.TimeoutExpired("", 1), OSError("no process")])
    def test_it_does_not_work(self, tmp_path, monkeypatch, trouble):
        def run(*words, **options):
            raise trouble

        monkeypatch.setattr(rendering, "find_spec", lambda name: name)
        monkeypatch.setattr(rendering.subprocess, "run", run)
        assert picture(tmp_path, made(tmp_path, 3), View("u")).axes[0].name == "3d"

    def test_it_dies(self, tmp_path, monkeypatch):
        """As graphics libraries do, without an exception."""
        child = [sys.executable, "-c", "import os; os.abort()"]
        real = subprocess.run
        monkeypatch.setattr(rendering, "find_spec", lambda name: name)
        fake = SimpleNamespace(
            run=lambda words, **options: real(child, **options), SubprocessError=subprocess.SubprocessError
        )
        monkeypatch.setattr(rendering, "subprocess", fake)
        assert picture(tmp_path, made(tmp_path, 3), View("u")).axes[0].name == "3d"

    def test_a_block(self, tmp_path):
        pytest.importorskip("pyvista")
        made(tmp_path, 3)
        with open_fields(tmp_path) as file:
            frame = read_frame(file, "00001", View("u"))
        common = common_range(lambda: [frame], 3)
        images = rendering.render([surface(frame, 1.0, None)] * 2, common, "viridis")
        if images is None:
            pytest.skip("pyvista finds no way to draw without a screen here")
        first, second = images
        assert first.shape == second.shape and max(first.shape) == rendering.PIXELS
        assert (first[0, 0, :3] == 1).all()  # a white border
        assert 0.2 < (first[..., :3] < 1).any(axis=2).mean() < 0.9
        assert len(np.unique(first[::7, ::7].reshape(-1, first.shape[2]), axis=0)) > 20
