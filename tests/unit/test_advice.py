"""What `pdpetsc check` warns of: each rule with a case of which it speaks, and one of which it does not."""

import copy
import tomllib
from itertools import product

import pytest

from pdpetsc import case
from pdpetsc.advice import RULES, advise
from pdpetsc.case import Case
from pdpetsc.census import QUICK
from pdpetsc.commands import OPTIONS
from pdpetsc.errors import InputError
from pdpetsc.newcase.questions import answers
from pdpetsc.newcase.text import case_text
from pdpetsc.prediction import predict

pytestmark = pytest.mark.usefixtures("petsc_options")
SOUND = {
    "body": {"size": [0.2, 0.1], "spacing": 0.01, "horizon": 3.015, "thickness": 0.01},
    "sets": {"left": "X < 0.03", "right": "X > 0.17"},
    "material": {"steel": {"model": "ordinary", "E": 210e9, "nu": 0.3, "density": 7850.0}},
    "load": [
        {"kind": "displacement", "set": "left", "component": "all", "value": 0.0},
        {"kind": "force", "set": "right", "component": "x", "value": "1e4 * t"},
    ],
}
NOTCH = [{"from": [0.1, 0.0], "to": [0.1, 0.1]}]
STRETCH = {"criterion": "critical_stretch", "critical": 0.01}
BREAKING = {"damage.steel": STRETCH}


def said(changes):
    """What is said of SOUND with these changes by dotted key."""
    document = copy.deepcopy(SOUND)
    for path, value in changes.items():
        *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
        inner = document
        for part in parents:
            inner = inner[part] if isinstance(part, int) else inner.setdefault(part, {})
        inner[last] = value
    chosen = Case.from_document(document, "my", None, "my.toml", False)
    return advise(chosen, predict(chosen, 1, QUICK))


def test_nothing_is_said_of_a_sound_case():
    assert said({}) == []


SPEAKS = [
    ({"body.horizon": 1.515}, "hardly resist shear"),
    ({"body.horizon": 2.015} | BREAKING, "cracks follow the lattice"),
    ({"body.horizon": 7.015}, "costs 5 times the bonds"),
    ({"body.horizon": 3.0}, "take 3.015"),
    ({"body.horizon": {"length": 0.0223607}}, "particles lie exactly on the edge"),
    ({"body.size": [0.2, 0.02]}, "is less than a horizon"),
    ({"units": {"length": "mm"}, "material.steel.density": None}, "stiffer than any solid with N and mm"),
    ({"material.steel.nu": 0.49}, "material.steel.nu = 0.49: the bulk modulus is 49.7 times"),
    ({"material.steel.model": "bond", "material.steel.allow_any_poisson": True}, "bonds have 0.25"),
    (
        {"material.steel.model": "correspondence", "material.steel.stabilisation": {"kind": "none"}},
        "may oscillate from particle to particle",
    ),
    ({"material.steel.E": 210e3}, "a speed of sound of 5.17 m/s"),
    ({"damage.steel": STRETCH | {"critical": 0.2}}, "bonds fail at a stretch of 20 % (it is given)"),
    ({"damage.steel": {"criterion": "critical_stretch", "G_c": 1e4}}, "without a crack to grow"),
    ({"body.cracks": [{"from": [0.1, -0.1], "to": [0.1, 0.06]}]}, "body.cracks.0: is 2 horizons long"),
    ({"damage.steel": STRETCH | {"softening": {"s_min": 0.0099}}}, "as brittle and harder to solve"),
    ({"load.1.value": 0.0}, "nothing pulls, pushes or moves"),
    ({"load.1.value": 1e4}, "the first of 10 steps takes all"),
    (
        {"load.1": {"kind": "displacement", "set": "right", "component": "x", "value": "0.05 * t"}, "solver.steps": 2},
        "load.1: a step prescribes 0.025, 12.5 % of the body's largest side, and may have to be cut; "
        "take solver.steps = 3",
    ),
    ({"load.0.component": "x"}, "nothing prescribes the displacement in y"),
    ({"load.1.value": "1e9 * t"}, "load.1: is a stress of about 4.76 E"),
    ({"body.thickness": None}, "body.thickness"),
    ({"solver": {"mode": "verlet", "end_time": 1.0, "time_step": 1e-3}}, "is above the safe one of about"),
]  # fmt: skip
SILENT = [
    {"body.horizon": 2.015},
    {"body.horizon": 3.0, "material.steel.partial_volume": "linear"},
    {"body.horizon": 3.0, "body.horizon_tolerance": -0.01},
    {"material.steel.nu": 0.49, "material.steel.plane": "stress"},
    {"damage.steel": {"criterion": "critical_stretch", "G_c": 1e4}, "body.cracks": NOTCH},
    {"material.steel.E": 210e3, "material.steel.density": 7.85e-9, "units.length": "mm", "load.1.value": "1 * t"},
    {"material.steel.E": 1e6, "material.steel.density": 1000.0, "load.1.value": "1 * t"},
    {"damage.steel": STRETCH | {"softening": {"s_min": 0.005}}},
    {"solver": {"mode": "verlet", "end_time": 1.0}},
]


@pytest.mark.parametrize(("changes", "text"), SPEAKS, ids=lambda value: value[:30] if isinstance(value, str) else "")
def test_rules_speak(changes, text):
    if changes == {"body.thickness": None}:
        changes = {"body": {key: value for key, value in SOUND["body"].items() if key != "thickness"}}
    spoken = said(changes)
    assert len([line for line in spoken if text in line]) == 1, spoken
    assert all(": " in line and not line.endswith(".") for line in spoken)


@pytest.mark.parametrize("changes", SILENT)
def test_rules_are_silent(changes):
    assert said(changes) == []


def test_each_rule_has_a_case_of_which_it_speaks():
    assert len(SPEAKS) >= len(RULES)


@pytest.mark.parametrize(
    ("name", "texts"),
    [
        ("clamped_beam", []), ("clamped_beam:rows3_d2", ["may oscillate"]), ("wave_dual_horizon", ["take 3.015"]),
        ("edge_crack_plate", []), ("bar_wave", []), ("cracked_cantilever", ["0.25 horizons long"]),
    ],
)  # fmt: skip
def test_of_bundled_cases_only_what_they_do_on_purpose_is_said(name, texts):
    chosen = case.load(name)
    spoken = advise(chosen, predict(chosen, 1, QUICK))
    assert len(spoken) == len(texts) and all(text in line for text, line in zip(texts, spoken))


@pytest.mark.parametrize("name", ["sheet_hole", "sheet_hole:vertices"])
def test_bodies_from_files_are_looked_at(name):
    chosen = case.load(name)
    assert advise(chosen, predict(chosen, 1, QUICK)) == []


@pytest.mark.parametrize(("kind", "dim"), product(OPTIONS["--kind"].choices, ("1", "2")))
def test_nothing_is_said_of_new_cases(kind, dim):
    text = case_text(answers({"kind": kind, "dim": dim, "model": "ordinary"}, False))
    chosen = Case.from_document(tomllib.loads(text), "my", None, "my.toml", False)
    assert advise(chosen, predict(chosen, 1, QUICK)) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sets": {"clamp": "X < 0", "pulled": "X > 12"}}, "sets.pulled: no particle lies in this set; .* X from -"),
        ({"load": {"kind": "traction", "surface": "up", "component": "x", "value": 1.0}}, "load.1.surface: nothing of"),
    ],
)
def test_what_holds_nothing_is_refused_by_check_too(change, message):
    """As by the run, for bodies that are quickly made."""
    from petsc4py import PETSc

    from pdpetsc.building import check_places

    clamp = {"kind": "displacement", "set": "clamp", "component": "all", "value": 0.0}
    force = {"kind": "force", "set": "pulled", "component": "x", "value": 1.0}
    document = {
        "body": {"size": [10.0, 4.0], "spacing": 1.0, "horizon": 2.015, "layers": {"left": "horizon"}},
        "sets": change.get("sets", {"clamp": "X < 0", "pulled": "X > 9"}), "surfaces": {"up": "NX > 2"},
        "material": {"any": {"model": "ordinary", "E": 1.0, "nu": 0.25}}, "load": [clamp, change.get("load", force)],
    }  # fmt: skip
    with pytest.raises(InputError, match=message):
        check_places(PETSc.COMM_WORLD, Case.from_document(document, "part", None, "part.toml", False))
