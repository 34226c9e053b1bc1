"""Case files: what is read, what is refused and in which words."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

from pdpetsc import case, catalogue
from pdpetsc.errors import InputError

PLATE = """
title = "Plate with a hole"
units = { length = "mm" }
[body]
size = [0.15, 0.05]
spacing = 0.001
horizon = 3.015
keep = "hypot(X - 0.075, Y - 0.025) > 0.01"
layers = { left = "horizon", right = "2 horizons", top = 0.01 }
[sets]
left = "X < 0"
middle = { nearest = [0.075, 0.05] }
[material.steel]
model = "correspondence"
E = 210e9
nu = 0.33
[[load]]
kind = "displacement"
set = "left"
component = "all"
value = "-1e-4 * t"
[[load]]
kind = "pressure"
set = "left"
normal = [3, -4]
value = 2
[[probe]]
name = "tip"
field = "u"
component = "x"
at = [0.15, 0.025]
[[probe]]
name = "axis"
field = "stress"
component = "xy"
line = [[0.0, 0.0], [0.15, 0.0], 11]
[[expect]]
value = "probes.tip"
equals = 1e-4
rtol = 1e-3
source = "hand"
[petsc]
ksp_rtol = 1e-10
snes_monitor = true
[variant.coarse]
body.spacing = 0.005
solver.steps = 3
[variant.checked]
body = { layers = { left = 0.02 }, horizon = { length = "0.003 + 0.01 * X" } }
expect = [{ value = "probes.tip", below = 1.0, source = "hand" }]
load = []
"""


@pytest.fixture
def plate(tmp_path, monkeypatch):
    """A function that writes the plate, with texts replaced, and loads it by a relative path."""
    monkeypatch.chdir(tmp_path)

    def load(*replacements, variant="", overrides=()):
        text = PLATE
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "plate.toml").write_text(text)
        return case.load("plate.toml" + variant, overrides)

    return load


def message_of(function, *arguments, **keywords) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments, **keywords)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# What is read.


def test_a_whole_case(plate):
    read = plate()
    assert (read.name, read.variant, read.path, read.overridden) == ("plate", None, "plate.toml", False)
    assert read.units.length == "mm" and read.units.force == "N"
    assert read.body.dim == 2 and read.body.origin == (0.0, 0.0) and read.body.thickness == 1.0
    assert read.body.horizon.factor() == 3.015 and read.body.horizon.length is None
    assert read.body.layers["left"].length(3.0) == 3.0
    assert read.body.layers["right"].length(3.0) == 6.0
    assert read.body.layers["top"].length(3.0) == 0.01
    assert read.sets["left"].where.mask(X=np.array([-1.0, 1.0]), Y=0.0, spacing=0.1).tolist() == [True, False]
    assert read.sets["middle"].nearest == (0.075, 0.05)
    steel = read.material["steel"]
    assert (steel.elasticity, steel.stabilisation.kind, steel.stabilisation.strength) == ("hencky", "silling", None)
    assert read.load[0].component == (0, 1)
    assert read.load[0].value(X=0.0, Y=0.0, t=0.5) == -5e-5
    assert read.load[1].normal == (0.6, -0.8)
    assert read.probe[1].line == ((0.0, 0.0), (0.15, 0.0), 11)
    assert (read.expect[0].equals, read.expect[0].rtol, read.expect[0].atol) == (1e-4, 1e-3, 0.0)
    assert read.petsc == {"ksp_rtol": 1e-10, "snes_monitor": True}
    assert (read.solver.steps, read.output.picture) == (10, "u")


def test_the_smallest_case(tmp_path):
    path = tmp_path / "rod.toml"
    path.write_text(
        'body = { size = [1], spacing = 0.1, horizon = 2 }\nmaterial.m = { model = "correspondence", E = 1, nu = 0 }'
    )
    read = case.load(str(path))
    assert read.body.dim == 1 and read.body.origin == (0.0,)
    assert read.sets == {} and read.load == () and read.expect == ()


@pytest.mark.parametrize(("normal", "expected"), [('"x"', (1.0, 0.0)), ('"-y"', (0.0, -1.0)), ("[0, 2]", (0.0, 1.0))])
def test_normals(plate, normal, expected):
    assert plate(("normal = [3, -4]", f"normal = {normal}")).load[1].normal == expected


@pytest.mark.parametrize(("component", "axes"), [('"y"', (1,)), ('["y", "x"]', (1, 0)), ('"all"', (0, 1))])
def test_components(plate, component, axes):
    assert plate(('component = "all"', f"component = {component}")).load[0].component == axes


def test_output_is_what_is_asked_for_and_what_the_picture_needs(plate):
    assert "peridynamic_stress" not in plate().written and "von_mises" in plate().written
    chosen = plate(overrides=['output.fields=["stress"]', "output.picture=peridynamic_stress"])
    assert chosen.written == ("u", "stress", "peridynamic_stress")


def test_sections(plate):
    probe = plate(
        ('field = "u"', 'field = "force"'),
        ("at = [0.15, 0.025]", 'section = { at = [0.1, 0], normal = [3, -4], where = "Y < 0.01" }'),
    ).probe[0]
    assert probe.section.at == (0.1, 0.0) and probe.section.normal == (0.6, -0.8)
    assert probe.section.where.place == "plate.toml: probe.0.section.where"


CRACK = 'name = "J"\nfield = "J"\ntip = [0.02, 0.02]\ndirection = [3, -4]\nradii = [0.004, 0.01]'
WHOLE_PROBE = 'name = "tip"\nfield = "u"\ncomponent = "x"\nat = [0.15, 0.025]'


def test_j_integrals(plate):
    probe = plate((WHOLE_PROBE, CRACK), ('"probes.tip"', '"probes.J"')).probe[0]
    assert (probe.tip, probe.direction, probe.radii) == ((0.02, 0.02), (0.6, -0.8), (0.004, 0.01))
    assert probe.is_number(2)


@pytest.mark.parametrize(
    ("size", "keys", "reason"),
    [
        ([1], "tip = [0.5]\ndirection = 'x'", "probe.0: a body of one dimension has no J-integral: its cracks have no"),
        ([1, 1, 1], "tip = [0, 0, 0]\ndirection = 'x'", "probe.0.front: is missing: field = 'J' needs tip, direction,"),
        ([1, 1, 1], "tip = [0, 0, 0]\ndirection = 'x'\nfront = [1, 0, 1]", "probe.0.direction: must be at right angle"),
        ([1, 1, 1], "tip = [0, 0, 0]\ndirection = 'x'\nfront = [0, 0, 0]", "probe.0.front: must be one of x, y, z,"),
        ([1, 1, 1], "tip = [0, 0, 0]\ndirection = 'x'\nfront = 'z'", None),
    ],
)
def test_j_integrals_in_all_dimensions(tmp_path, size, keys, reason):
    path = tmp_path / "crack.toml"
    path.write_text(
        f"body = {{ size = {size}, spacing = 0.1, horizon = 2 }}\n"
        'material.m = { model = "correspondence", E = 1, nu = 0 }\n'
        f'[[probe]]\nname = "J"\nfield = "J"\nradii = [0.1, 0.2]\n{keys}'
    )
    if reason is None:
        assert case.load(str(path)).probe[0].front == (0.0, 0.0, 1.0)
    else:
        assert message_of(case.load, str(path)).startswith(f"{path}: {reason}")


def test_a_curve_is_one_of_two_numbers(plate):
    support = '[[probe]]\nname = "load"\nfield = "reaction"\ncomponent = "x"\nset = "left"\nreduce = "sum"\n'
    output = '[output]\ncurve = {{ x = "{}", y = "load" }}\n{}[petsc]'
    curve = plate(("[petsc]", output.format("tip", support))).output.curve
    assert (curve.x, curve.y) == ("tip", "load")
    for name, reason in (
        ("axis", "the probe 'axis' has many values, a curve needs a single number: no line, and a component of"),
        ("tap", "there is no probe 'tap' (did you mean 'tip'?); choices: tip, axis, load"),
    ):
        message = message_of(plate, ("[petsc]", output.format(name, support)))
        assert message.startswith(f"plate.toml: output: curve.x: {reason}"), message
    message = message_of(plate, ("[petsc]", output.format("tip", support)), ('component = "x"\nset', "set"))
    assert "curve.y: the probe 'load' has many values" in message


def test_a_line_has_no_moment(tmp_path):
    path = tmp_path / "rod.toml"
    path.write_text(
        'body = { size = [1], spacing = 0.1, horizon = 2 }\nmaterial.m = { model = "correspondence", E = 1, nu = 0 }\n'
        'probe = [{ name = "m", field = "moment", section = { at = [0.5], normal = "x" } }]'
    )
    assert message_of(case.load, str(path)).endswith("probe.0: a section of a body of one dimension has no moment")


def test_nothing_changes_afterwards(plate):
    with pytest.raises(ValidationError):
        plate().body.spacing = 1.0


def test_expressions_know_their_place(plate):
    read = plate()
    assert read.load[0].value.place == "plate.toml: load.0.value"
    assert read.sets["left"].where.place == "plate.toml: sets.left"
    assert read.body.horizon.factor.place == "plate.toml: body.horizon"
    read = plate(('value = "-1e-4 * t"', 'value = "log(X) * t"'))
    assert message_of(read.load[0].value, X=-1.0, Y=0.0, t=1.0) == (
        "plate.toml: load.0.value: 'log(X) * t' is nan at X = -1, t = 1"
    )


def test_byte_order_mark(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_bytes(b"\xef\xbb\xbf" + PLATE.encode())
    assert case.load(str(path)).title == "Plate with a hole"


# Variants and overrides.


def test_variant_is_merged_and_drops_the_expectations(plate):
    read = plate(variant=":coarse")
    assert (read.variant, read.overridden) == ("coarse", False)
    assert (read.body.spacing, read.body.size, read.solver.steps) == (0.005, (0.15, 0.05), 3)
    assert read.expect == ()


def test_variant_with_expectations_and_lists(plate):
    read = plate(variant=":checked")
    assert read.expect[0].below == 1.0
    assert read.load == ()
    assert set(read.body.layers) == {"left", "right", "top"} and read.body.layers["left"].number == 0.02
    np.testing.assert_allclose(read.body.horizon.length(X=np.array([0.0, 1.0]), Y=0.0), [0.003, 0.013])


def test_overrides(plate):
    read = plate(
        overrides=[
            "body.spacing=0.002", "title=Any text = text", "load.0.value=X * t", "load.1.normal=[0, 1]",
            "petsc.pc_type=lu", "solver.adaptive=false", 'body.layers={ top = "horizon" }',
        ]
    )  # fmt: skip
    assert read.overridden
    assert (read.body.spacing, read.title, read.solver.adaptive) == (0.002, "Any text = text", False)
    assert read.load[0].value.text == "X * t" and read.load[1].normal == (0.0, 1.0)
    assert read.petsc["pc_type"] == "lu" and set(read.body.layers) == {"top"}


@pytest.mark.parametrize(
    ("override", "reason"),
    [
        ("foo", "--set foo: must be key=value"),
        ("=1", "--set =1: must be key=value"),
        ("load.2.value=1", "there is no entry '2' to set"),
        ("load.x=1", "there is no entry 'x' to set"),
        ("title.x=1", "there is no entry 'x' to set"),
        ("bodi.size=[1]", "plate.toml: bodi: unknown key (did you mean 'body'?)"),
        ("body.spacing=1\nfoo=2", "plate.toml: body.spacing: must be a number, not '1\\nfoo=2'"),
        ("body.spacing=", "body.spacing: must be a number, not ''"),
        ("solver.steps=2.5", "solver.steps: must be a whole number, not 2.5"),
    ],
)
def test_bad_overrides(plate, override, reason):
    assert reason in message_of(plate, overrides=[override]).replace("\n", " ")


def test_document_makes_the_same_case(plate):
    read = plate(variant=":coarse", overrides=["solver.steps=4"])
    document = json.loads(json.dumps(read.document))
    again = case.Case.from_document(document, read.name, read.variant, "checkpoint.h5", read.overridden)
    assert again.document == read.document
    assert again.body.spacing == 0.005 and again.solver.steps == 4 and again.overridden
    assert "variant" not in document


# Which file.


def test_bundled_cases(plate, tmp_path, monkeypatch):
    plate()
    monkeypatch.setattr(catalogue, "BUNDLED", tmp_path)
    assert list(catalogue.bundled()) == ["plate"]
    assert list(catalogue.documents()["plate"]["variant"]) == ["coarse", "checked"]
    read = case.load("plate:coarse")
    assert (read.name, read.variant, read.path) == ("plate", "coarse", "plate.toml")
    assert "there is no case 'plates' (did you mean 'plate'?); bundled cases: plate" in message_of(case.load, "plates")
    assert message_of(case.load, "plate:fine") == "plate.toml: there is no variant 'fine'; choices: coarse, checked"
    assert "there is no variant ''" in message_of(case.load, "plate:")


def test_every_bundled_case_and_variant_is_valid():
    for name, document in catalogue.documents().items():
        for argument in (name, *(f"{name}:{variant}" for variant in document.get("variant", {}))):
            assert case.load(argument).title


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("my.toml", True), ("a/b.toml:fine", True), ("plate", True), ("plate:coarse", True), ("gmres", False),
        ("my.tom", False), ("my.toml/x", False),
        ("a:b.toml", True), ("", False), ("ascii:a.toml", True), ("1e-3", False),
    ],
)  # fmt: skip
def test_what_looks_like_a_case(word, expected, plate, tmp_path, monkeypatch):
    plate()
    monkeypatch.setattr(catalogue, "BUNDLED", tmp_path)
    assert catalogue.is_case(word) is expected


def test_files_that_cannot_be_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "latin.toml").write_bytes('title = "Höhe"'.encode("latin-1"))
    (tmp_path / "broken.toml").write_text("title = \n[body\n")
    (tmp_path / "twice.toml").write_text("title = 'a'\ntitle = 'b'\n")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 5000)
    assert message_of(case.load, "nowhere.toml") == "nowhere.toml: there is no such file"
    assert message_of(case.load, "folder.toml") == "folder.toml: cannot be read: is a directory"
    assert message_of(case.load, "latin.toml") == "latin.toml: is not UTF-8 text"
    assert message_of(case.load, "broken.toml") == "broken.toml: is not valid TOML: Invalid value (at line 1, column 9)"
    assert "broken" not in message_of(case.load, "twice.toml") and "line 2" in message_of(case.load, "twice.toml")
    assert "deep.toml: is not valid TOML" in message_of(case.load, "deep.toml")


# What is refused: (old text, new text, message after "plate.toml: ").

MISTAKES = [
    ("spacing = 0.001", "spacng = 0.001", "body.spacng: unknown key (did you mean 'spacing'?); choices: shape, size,"),
    ("E = 210e9", "youngs = 210e9", "material.steel.youngs: unknown key; choices: model, density, where,"),
    ("[petsc]", "[petcs]", "petcs: unknown key (did you mean 'petsc'?); choices: title, units,"),
    ("[variant.coarse]", "[varian.coarse]", "varian: unknown key (did you mean 'variant'?)"),
    ("spacing = 0.001", "", "body.spacing: is missing"),
    ("[material.steel]", "[sets.steel]", "sets.steel.model: unknown key; choices: where, nearest"),
    ("spacing = 0.001", "spacing = 0", "body.spacing: must be greater than 0, not 0"),
    ("spacing = 0.001", "spacing = nan", "body.spacing: must be a finite number, not nan"),
    ("spacing = 0.001", "spacing = inf", "body.spacing: must be a finite number, not inf"),
    ("spacing = 0.001", 'spacing = "fine"', "body.spacing: must be a number, not 'fine'"),
    ("spacing = 0.001", "spacing = true", "body.spacing: must be a number, not True"),
    ("spacing = 0.001", "spacing = 1979-05-27", "body.spacing: must be a number, not datetime.date(1979, 5, 27)"),
    ("size = [0.15, 0.05]", "size = []", "body.size: must have at least 1 entries, not 0"),
    ("size = [0.15, 0.05]", "size = [1, 1, 1, 1]", "body.size: must have at most 3 entries, not 4"),
    ("size = [0.15, 0.05]", "size = 3", "body.size: must be a list, not 3"),
    ("size = [0.15, 0.05]", "size = [0.15, -1]", "body.size.1: must be greater than 0, not -1"),
    ("horizon = 3.015", "horizon = 1", "body.horizon: must be greater than 1: it is a factor of the spacing"),
    ("horizon = 3.015", "horizon = nan", "body.horizon: 'nan' is nan"),
    ("horizon = 3.015", "horizon = { length = -1 }", "body.horizon: must be greater than 0"),
    ("horizon = 3.015", 'horizon = { length = "X +" }', "body.horizon.length: 'X +' is not an expression; allowed"),
    ("horizon = 3.015", "horizon = { length = 1, factor = 2 }", "body.horizon: needs exactly one of factor, length"),
    ("horizon = 3.015", 'horizon = "wide"', "body.horizon: must be a table, not 'wide'"),
    ("horizon = 3.015", "horizon = 3\norigin = [1]", "body.origin: needs 2 number(s), one for each entry of body.size"),
    ("horizon = 3.015", "horizon = 3\norigin = []", "body.origin: needs 2 number(s), one for each entry of body.size"),
    ('left = "horizon"', 'back = "horizon"', "body.layers.back: there is no such face in 2D; choices: left, right,"),
    ('left = "horizon"', 'left = "3 horizonts"', "body.layers.left: must be 'horizon', '2 horizon' or a pos"),
    ('left = "horizon"', "left = -1", "body.layers.left: must be 'horizon'"),
    ('left = "X < 0"', 'left = "X + 0"', "sets.left: 'X + 0' is a number where a condition is needed, such as X < 0"),
    ('left = "X < 0"', 'left = "Z < 0"', "sets.left: 'Z < 0' uses the unknown name 'Z'; allowed names: X, Y, spacing"),
    ('left = "X < 0"', "left = 3", "sets.left: must be a table, not 3"),
    ("nearest = [0.075, 0.05]", "nearest = [0.075]", "sets.middle.nearest: needs 2 number(s)"),
    ('left = "X < 0"', 'left = "X < 0"\nall = "X > 0"', "sets.all: the set 'all' is always there"),
    ('left = "X < 0"', 'left = "X < 0"\n"1 b" = "X > 0"', "sets.1 b: a name begins with a letter"),
    ('model = "correspondence"', 'model = "bonds"', "material.steel.model: there is no model 'bonds' (did you mean 'b"),
    ('model = "correspondence"', "model = [1]", "material.steel.model: there is no model [1]; choices: abd, bond,"),
    ('model = "correspondence"', 'E1 = 1.0', "material.steel.model: is missing; choices: abd, bond, correspondence"),
    ('model = "correspondence"', 'model = "bond"', "material.steel: nu = 0.33, but a bond-based material has"),
    ('model = "correspondence"', 'model = "ordinary"\ninfluence = "r <"', "material.steel.influence: must be one of"),
    ('model = "correspondence"', 'model = "ordinary"\ninfluence = "r < 1"', "material.steel.influence: 'r < 1' is a"),
    ('model = "correspondence"', 'model = "ordinary"\nquadrature = "fit"', "material.steel.quadrature: must be"),
    ('model = "correspondence"', 'model = "abd"\nelastisity = "hencky"', "material.steel.elastisity: unknown key"),
    ("nu = 0.33", "nu = 0.5", "material.steel.nu: must be less than 0.5, not 0.5"),
    ("nu = 0.33", 'nu = 0.3\nwhere = "lft"', "material.steel.where: there is no set 'lft' (did you mean 'left'?)"),
    (
        "nu = 0.33", 'nu = 0.3\nelasticity = "henky"',
        "material.steel.elasticity: must be 'hencky', 'saint_venant_kirchhoff' or 'neo_hookean', not 'henky'",
    ),
    (
        "nu = 0.33", 'nu = 0.3\nstabilisation = { kind = "silling", strength = -1 }',
        "material.steel.stabilisation.strength: must be greater than or equal to 0, not -1",
    ),
    ("nu = 0.33", "nu = 0.3\nstabilisation = 0.1", "material.steel.stabilisation: must be a table, not 0.1"),
    ('kind = "displacement"', 'kind = "speed"', "load.0.kind: must be one of displacement, body_force, force"),
    ('kind = "displacement"', "", "load.0.kind: must be one of displacement, body_force, force"),
    ('set = "left"', 'set = "top"', "load.0.set: there is no set 'top'; choices: all, left, middle"),
    ('set = "left"', 'sets = "left"', "load.0.sets: unknown key (did you mean 'set'?); choices: kind, set, value"),
    ('component = "all"', 'component = "z"', "load.0.component: must be one of x, y, a list of them, or 'all'"),
    ('component = "all"', 'component = ["x", "x"]', "load.0.component: must be one of x, y"),
    ('component = "all"', "component = [[]]", "load.0.component: must be one of x, y"),
    ('"-1e-4 * t"', '"-1e-4 * T"', "load.0.value: '-1e-4 * T' uses the unknown name 'T' (did you mean 't'?); allowed"),
    ('"-1e-4 * t"', '"t < 1"', "load.0.value: 't < 1' is a condition where a number is needed"),
    ("normal = [3, -4]", "normal = [0, 0]", "load.1.normal: must be one of x, y, one of them with a minus, or 2 num"),
    ("normal = [3, -4]", 'normal = "-z"', "load.1.normal: must be one of x, y"),
    ("[petsc]", "[solver]\nmin_step = 1.0\nmax_step = 0.1\n[petsc]", "solver: min_step = 1.0 is greater than max_step"),
    ("[petsc]", "[solver]\nsteps = 0\n[petsc]", "solver.steps: must be greater than or equal to 1, not 0"),
    ("[petsc]", "[solver]\nadaptive = 1\n[petsc]", "solver.adaptive: must be true or false, not 1"),
    ("[petsc]", "[output]\npicture = 'w'\n[petsc]", "output.picture: must be 'u', 'v', 'F', 'stress',"),
    ('name = "tip"', 'name = "axis"', "probe: two probes have the name 'axis'"),
    ('name = "tip"', 'name = "the tip"', "probe.0.name: a name begins with a letter"),
    ('component = "x"', 'component = "z"', "probe.0: field u has no component 'z'; choices: x, y, magnitude"),
    ('component = "xy"', 'component = "xw"', "probe.1: field stress has no component 'xw'; choices: xx, xy, xz, yx,"),
    ("at = [0.15, 0.025]", "", "probe.0: needs exactly one of at, line, set"),
    ("at = [0.15, 0.025]", 'set = "left"', "probe.0: set and reduce go together"),
    ("at = [0.15, 0.025]", 'set = "left"\nreduce = "error"', "probe.0: reduce = 'error' and exact go together"),
    ("at = [0.15, 0.025]", "at = [0.15, 0.025, 0]", "probe.0.at: needs 2 number(s)"),
    ("[0.15, 0.0], 11]", "[0.15, 0.0]]", "probe.1.line.2: is missing"),
    ("at = [0.15, 0.025]", "section = { at = [0.1, 0] }", "probe.0.section.normal: is missing"),
    ("at = [0.15, 0.025]", 'section = { at = [0.1], normal = "x" }', "probe.0.section.at: needs 2 number(s)"),
    ("at = [0.15, 0.025]", 'section = { at = [1, 0], normal = "z" }', "probe.0.section.normal: must be one of x, y"),
    ("at = [0.15, 0.025]", 'section = { at = [1, 0], normal = "x" }', "probe.0: a section has a force and a moment"),
    (
        "at = [0.15, 0.025]", 'section = { at = [1, 0], normal = "x", where = "Y" }',
        "probe.0.section.where: 'Y' is a number where a condition is needed",
    ),
    ('field = "u"', 'field = "moment"', "probe.0: field moment is that of a section: give section = {"),
    (
        'field = "u"\ncomponent = "x"\nat = [0.15, 0.025]',
        'field = "moment"\ncomponent = "x"\nsection = { at = [1, 0], normal = "x" }',
        "probe.0: field moment has no component 'x'; it is a scalar",
    ),
    (
        'field = "u"\ncomponent = "x"\nat = [0.15, 0.025]',
        'field = "force"\nreduce = "sum"\nsection = { at = [1, 0], normal = "x" }',
        "probe.0: set and reduce go together",
    ),
    ('field = "u"', 'field = "principal"', "probe.0: field principal has no component 'x'; choices: 1, 2, 3"),
    ('component = "xy"', 'component = "4"', "probe.1: field stress has no component '4'; choices: xx, xy, xz, yx,"),
    ('field = "u"', 'field = "moments"', "probe.0.field: must be 'u', 'v', 'F', 'stress',"),
    (WHOLE_PROBE, CRACK.replace("0.01]", "0.004]"), "probe.0.radii: the second must be the larger one, not [0.004, 0."),
    (WHOLE_PROBE, CRACK.replace("0.004,", "0,"), "probe.0.radii.0: must be greater than 0, not 0"),
    (WHOLE_PROBE, CRACK.replace("[3, -4]", "[0, 0.0]"), "probe.0.direction: must be one of x, y, one of them with"),
    (WHOLE_PROBE, CRACK.replace("direction = [3, -4]", ""), "probe.0.direction: is missing: field = 'J' needs tip,"),
    (WHOLE_PROBE, CRACK + "\nfront = [0, 1]", "probe.0.front: does not go with field = 'J' in 2D, which takes tip,"),
    (WHOLE_PROBE, CRACK + '\ncomponent = "x"', "probe.0.component: does not go with field = 'J' in 2D, which takes"),
    (WHOLE_PROBE, CRACK.replace("0.02, 0.02]", "0.02]"), "probe.0.tip: needs 2 number(s)"),
    ("at = [0.15, 0.025]", "at = [0, 0]\nradii = [1, 2]", "probe.0.radii: is that of a crack: it goes with"),
    ("[petsc]", "[output]\ncurve = { x = 'tip' }\n[petsc]", "output.curve.y: is missing"),
    ("[petsc]", "[output]\nfields = ['w']\n[petsc]", "output.fields.0: must be 'u', 'v', 'F', 'stress',"),
    ("[petsc]", "[output]\nfields = 'u'\n[petsc]", "output.fields: must be a list, not 'u'"),
    ('field = "u"', 'field = "energy"', "probe.0: field energy has no component 'x'; it is a scalar"),
    ('"probes.tip"', '"probes.tipp.0"', "expect: 'probes.tipp.0' names no probe (did you mean 'tip'?); choices: tip,"),
    ("equals = 1e-4", "equals = 1e-4\nbelow = 1", "expect.0: needs exactly one of equals, below, above"),
    ("equals = 1e-4", 'equals = "1e-4"', "expect.0.equals: must be a number, not '1e-4'"),
    ("ksp_rtol = 1e-10", "-ksp_rtol = 1e-10", "petsc.-ksp_rtol: a PETSc option is written here without its dash"),
    ("ksp_rtol = 1e-10", "ksp_rtol = [1]", "petsc.ksp_rtol: must be a number, true, false or text"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "reason"), MISTAKES)
def test_one_sentence_says_what_is_wrong(plate, old, new, reason):
    message = message_of(plate, (old, new))
    assert message.startswith(f"plate.toml: {reason}"), message
    assert len(message) < 400


def test_further_mistakes_are_counted(plate):
    message = message_of(plate, ("nu = 0.33", "nu = 0.6"), ("spacing = 0.001", "spacing = 0"), ("E = 210e9", "E = -1"))
    assert message == "plate.toml: body.spacing: must be greater than 0, not 0 (and 2 more mistakes)"


def test_three_dimensions_have_no_thickness(tmp_path):
    path = tmp_path / "block.toml"
    path.write_text(
        "body = { size = [1, 1, 1], spacing = 0.1, horizon = 2, thickness = 1 }\n"
        'material.m = { model = "correspondence", E = 1, nu = 0 }'
    )
    assert message_of(case.load, str(path)) == f"{path}: body: a body of three dimensions has no thickness"


def test_variants_must_be_tables(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_text("variant = { coarse = 3 }")
    assert message_of(case.load, str(path)) == f"{path}: variant: must be tables, [variant.NAME]"


def test_an_empty_file_names_the_tables_that_it_needs(tmp_path):
    path = tmp_path / "empty.toml"
    path.write_text("")
    assert message_of(case.load, str(path)) == f"{path}: body: is missing (and 1 more mistake)"


def test_damaged_documents_end_in_input_errors_only(plate):
    """Replace every entry of a document in turn by odd values: nothing but a case or an InputError comes out."""
    document = plate().document
    odd = [None, True, -1, 10**400, float("nan"), "", "all", "X <", "\0", [], [[]], [None], {}, {"a": {}}, [{}]]

    def places(value, path=()):
        yield path
        entries = value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ())
        for key, inner in entries:
            yield from places(inner, (*path, key))

    def damaged(path, value):
        copy = json.loads(json.dumps(document))
        inner = copy
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        return copy

    for path in places(document):
        for value in odd if path else ():
            try:
                case.Case.from_document(damaged(path, value), "plate", None, "plate.toml", False)
            except InputError as error:
                assert "\n" not in str(error) and len(str(error)) < 600
