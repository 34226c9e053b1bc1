"""`pdpetsc new`: every case that it can write is valid, small ones run."""

import json
import tomllib
from itertools import product

import pytest

from pdpetsc import cli
from pdpetsc.case import Case
from pdpetsc.commands import OPTIONS
from pdpetsc.errors import InputError
from pdpetsc.influence import INFLUENCE
from pdpetsc.lists import FORMULAS
from pdpetsc.materials.base import Material
from pdpetsc.newcase.questions import answers
from pdpetsc.newcase.text import case_text, spacing_of

KINDS, DIMS, MODELS, UNITS = (OPTIONS[f"--{name}"].choices for name in ("kind", "dim", "model", "units"))


@pytest.mark.parametrize(("kind", "dim", "model", "units"), product(KINDS, DIMS, MODELS, UNITS))
def test_every_combination_is_valid(kind, dim, model, units):
    text = case_text(answers({"kind": kind, "dim": dim, "model": model, "units": units}, False))
    written = Case.from_document(tomllib.loads(text), "my", None, "my.toml", False)
    assert (written.body.dim, written.material["solid"].model) == (int(dim), model)
    assert written.units.length == units
    assert written.solver.in_time == (kind == "motion") and bool(written.damage) == (kind == "fracture")
    assert max(map(len, text.splitlines())) <= 125 and "$" not in text


def test_models_are_those_of_the_program():
    assert {*MODELS} <= {*Material.models} and {*FORMULAS} == {*INFLUENCE}


@pytest.mark.usefixtures("petsc_options")
@pytest.mark.parametrize("kind", KINDS)
def test_small_ones_run_and_do_as_they_expect(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "my.toml", "--kind", kind, "--dim", "1", "--model", "ordinary"]) == 0
    assert cli.main(["my.toml", "--quiet"]) == 0
    summary = json.loads((tmp_path / "results" / "my" / "summary.json").read_text())
    assert all(e["met"] for e in summary["expect"]) and summary["expect"]
    assert cli.main(["new", "mm.toml", "--units", "mm", "--kind", kind, "--dim", "1", "--model", "ordinary"]) == 0
    assert cli.main(["mm.toml", "--quiet"]) == 0
    in_mm = json.loads((tmp_path / "results" / "mm" / "summary.json").read_text())
    assert in_mm["probes"]["elongation"] == pytest.approx(1e3 * summary["probes"]["elongation"], rel=1e-6)
    assert in_mm["probes"]["reaction"] == pytest.approx(summary["probes"]["reaction"], rel=1e-6, abs=1e-6)


def test_questions_are_asked_again_until_they_are_answered(monkeypatch, capsys):
    words = ["tear", "fracture", "2", "bond", "mm", "100", "200,-100", "200,100", "", "plain", "stress", "x", "70e3"]
    said = iter(words)
    monkeypatch.setattr("builtins.input", lambda prompt: next(said))
    found = answers({}, True)
    assert found == {
        "kind": "fracture", "dim": "2", "model": "bond", "units": "mm", "size": (200, 100), "thickness": 25,
        "plane": "stress", "E": 70e3,
    }  # fmt: skip
    out = capsys.readouterr().out.splitlines()
    assert len(out) == 5 and out[0].startswith("  must be one of tension, fracture, motion, not 'tear'")


def test_enter_takes_the_defaults_and_leaving_writes_nothing(monkeypatch):
    monkeypatch.setattr("builtins.input", lambda prompt: "")
    assert answers({}, True) == answers({}, False)

    def leave(prompt):
        raise EOFError

    monkeypatch.setattr("builtins.input", leave)
    with pytest.raises(InputError, match="nothing was written"):
        answers({}, True)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dim": "4"}, "--dim: must be one of 1, 2, 3, not '4'"),
        ({"model": "bound"}, "(did you mean 'bond'?)"),
        ({"model": "bond", "nu": "0.3"}, "--nu: a bond-based material has a fixed Poisson's ratio"),
        ({"nu": "0.5"}, "--nu: must be above -1 and below 0.5, not 0.5"),
        ({"E": "nan"}, "--E: must be a number, not 'nan'"),
        ({"dim": "2", "size": "1,1,1"}, "--size: must be 2 length"),
        ({"size": "1", "hole": "0.1"}, "--hole: a hole goes with tension and motion in 2D and 3D"),
        ({"hole": "1"}, "--hole: must be between 0 and 0.016"),
    ],
)
def test_wrong_options(given, message):
    with pytest.raises(InputError) as error:
        answers(given, False)
    assert message in str(error.value)


@pytest.mark.parametrize("size", [(0.1, 0.04), (0.12, 0.06, 0.05), (1.0, 0.3), (3.7, 1.9), (1.0, 0.031)])
def test_cells_fill_all_sides(size):
    spacing = spacing_of(size, str(len(size)), "tension")
    assert all(abs(side / spacing / round(side / spacing) - 1) < 0.04 for side in size)


def test_no_file_is_replaced_without_force(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text("mine")
    assert cli.main(["new", "my.toml"]) == 2
    assert (tmp_path / "my.toml").read_text() == "mine"
    assert "my.toml: is there already; choose another name, or add --force" in capsys.readouterr().err
    assert cli.main(["new", "my.toml", "--force", "--schema"]) == 0
    assert (tmp_path / "my.toml").read_text().startswith("#:schema ./pdpetsc.schema.json\n")
    assert json.loads((tmp_path / "pdpetsc.schema.json").read_text())["definitions"]
