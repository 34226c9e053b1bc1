"""`[damage.NAME]` in case files: mistakes are one sentence with place, cause and choices."""

import pytest

from pdpetsc.case import Case
from pdpetsc.errors import InputError

STRETCH = {"criterion": "critical_stretch", "critical": 0.01}
SOFTENING = STRETCH | {"softening": {"s_min": 0.005}}


def case(damage: dict, **tables) -> Case:
    document = {
        "body": {"size": [4.0, 4.0], "spacing": 1.0, "horizon": 2.015},
        "sets": {"ends": "X < 1"},
        "material": {"steel": {"model": "ordinary", "E": 1.0, "nu": 0.25}},
        "damage": damage,
        **tables,
    }
    return Case.from_document(document, "my", None, "my.toml", False)


def test_what_is_left_out():
    spec = case({"steel": STRETCH | {"exempt": ["ends"]}}).damage["steel"]
    assert (spec.critical, spec.G_c, spec.exempt, spec.independent) == (0.01, None, ("ends",), False)
    solver = case({"steel": STRETCH}).solver
    assert (solver.bonds_per_pass, solver.overshoot) == (0.95, 0.1)
    assert "damage" in case({"steel": STRETCH}, output={"fields": ["u"]}).written
    assert "damage" not in case({}, output={"fields": ["u"]}).written


@pytest.mark.parametrize("value, fraction", [("worst", 1.0), ("all", 0.0), (0.7, 0.7), (0, 0.0), (1, 1.0)])
def test_bonds_per_pass(value, fraction):
    assert case({"steel": STRETCH}, solver={"bonds_per_pass": value}).solver.bonds_per_pass == fraction


WRONG = {
    "no material": ({"stele": STRETCH}, {}, "damage.stele: there is no material 'stele' (did you mean 'steel'?)"),
    "criterion": (
        {"steel": STRETCH | {"criterion": "critical_strech"}}, {},
        "damage.steel.criterion: there is no criterion 'critical_strech' (did you mean 'critical_stretch'?); choices:",
    ),
    "criterion of no name": (
        {"steel": STRETCH | {"criterion": 3}}, {}, "damage.steel.criterion: there is no criterion 3; choices:"
    ),
    "no criterion": ({"steel": {"critical": 1.0}}, {}, "damage.steel.criterion: is missing; choices: bond_energy, "),
    "no critical value": (
        {"steel": {"criterion": "critical_stretch"}}, {}, "damage.steel: exactly one of critical and G_c is needed"
    ),
    "both": ({"steel": STRETCH | {"G_c": 1.0}}, {}, "damage.steel: exactly one of critical and G_c is needed"),
    "negative": ({"steel": STRETCH | {"critical": -1.0}}, {}, "damage.steel.critical: must be greater than 0"),
    "unknown key": ({"steel": STRETCH | {"exemt": []}}, {}, "damage.steel.exemt: unknown key (did you mean 'exempt'?)"),
    "exempt set": (
        {"steel": STRETCH | {"exempt": ["end"]}}, {},
        "damage.steel.exempt.0: there is no set 'end' (did you mean 'ends'?)",
    ),
    "fraction": ({"steel": STRETCH}, {"solver": {"bonds_per_pass": 1.5}}, "solver.bonds_per_pass: must be "),
    "word for a fraction": (
        {"steel": STRETCH}, {"solver": {"bonds_per_pass": "most"}}, 'solver.bonds_per_pass: must be "worst", "all" or a'
    ),
    "no overshoot": ({"steel": STRETCH}, {"solver": {"overshoot": 0.0}}, "solver.overshoot: must be greater than 0"),
    "path of no failure": (
        {}, {"solver": {"control": "failure"}},
        'solver.control: is "failure", but no bond can fail; add a table [damage.NAME] for a material',
    ),
    "softening of an updated volume": (
        {"steel": SOFTENING},
        {"material": {"steel": {"model": "ordinary", "E": 1.0, "nu": 0.25, "weighted_volume": "updated"}}},
        'damage.steel: softening does not go with weighted_volume = "updated" of the material; take "frozen"',
    ),
    "arc length of softening bonds": (
        {"steel": SOFTENING}, {"solver": {"control": "arc_length"}},
        'solver.control: "arc_length" does not go with damage.steel.softening; take control = "load"',
    ),
    "failure of softening bonds": (
        {"steel": SOFTENING}, {"solver": {"control": "failure"}},
        'solver.control: "failure" does not go with damage.steel.softening; take control = "load"',
    ),
    "fraction of nothing": (
        {}, {"solver": {"bonds_per_pass": 0.5}}, "solver.bonds_per_pass: is given, but no bond can fail; add a table"
    ),
    "overshoot of nothing": (
        {}, {"solver": {"overshoot": 0.5}}, "solver.overshoot: is given, but no bond can fail; add a table"
    ),
    "overshoot along a path": (
        {"steel": STRETCH}, {"solver": {"control": "failure", "overshoot": 0.5}},
        'solver.overshoot: goes with control = "load"',
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_mistakes(name):
    damage, tables, said = WRONG[name]
    with pytest.raises(InputError) as error:
        case(damage, **tables)
    message = str(error.value)
    assert message.startswith(f"my.toml: {said}") and "\n" not in message


def test_paths_with_failing_bonds():
    assert case({"steel": STRETCH}, solver={"control": "failure", "max_steps": 7}).solver.max_steps == 7
