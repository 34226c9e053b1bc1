"""The JSON Schema of case files against the cases that there are, and against mistakes."""

import json

import jsonschema
import pytest

from pdpetsc import case, catalogue
from pdpetsc.schema.editors import case_schema, schema_text


@pytest.fixture(scope="module")
def validator():
    schema = json.loads(schema_text())
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


@pytest.mark.parametrize("name", catalogue.bundled())
def test_bundled_cases_are_valid(name, validator):
    """As they are written, variants and all, and each variant merged."""
    written = catalogue.documents()[name]
    validator.validate(written)
    for argument in (name, *(f"{name}:{variant}" for variant in written.get("variant", {}))):
        validator.validate(case.load(argument).document)


PLATE = {
    "body": {"size": [1.0, 0.5], "spacing": 0.1, "horizon": 2.015, "layers": {"left": "2 horizon"}},
    "sets": {"end": "X > 0.9", "tip": {"nearest": [1.0, 0.25]}},
    "material": {"steel": {"model": "bond", "E": 1.0, "stabilisation": {"kind": "none"}}},
    "damage": {"steel": {"criterion": "critical_stretch", "critical": 0.1}},
    "load": [{"kind": "force", "set": "end", "component": ["x", "y"], "value": "2 * t"}],
    "solver": {"bonds_per_pass": "worst"},
    "petsc": {"snes_monitor": True},
    "variant": {"fine": {"body": {"horizon": {"length": "0.3 + X"}}, "material": {"steel": {"E": 2.0}}}},
}


def changed(path, value):
    """PLATE with one entry changed, or without it."""
    document = json.loads(json.dumps(PLATE))
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    inner = document
    for part in parents:
        inner = inner[part]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return document


def test_a_case_of_all_kinds_of_values(validator):
    validator.validate(PLATE)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("body.spcing", 0.1), ("body.spacing", "0.1"), ("body.spacing", -0.1),
        ("body.size", []), ("body.size", [1.0, 1.0, 1.0, 1.0]), ("body.horizon", "wide"), ("body.horizon", [2.0]),
        ("body.horizon", {"radius": 2.0}), ("body.layers.left", "3 metres"), ("body.keep", 1.0),
        ("sets.end", 1.0), ("sets.tip", {"nearest": 1.0}), ("material", {}), ("material.steel.model", "steel"),
        ("material.steel.model", None), ("material.steel.young", 1.0), ("material.steel.E", None),
        ("material.steel.influence", True), ("damage.steel.criterion", "stretch"), ("damage.steel.critical", "0.1"),
        ("load.0.kind", "push"), ("load.0.component", "w"), ("load.0.surface", "left"), ("load.0.value", [1.0]),
        ("solver.bonds_per_pass", "most"), ("solver.steps", 1.5), ("solver.steps", 0), ("petsc.snes_monitor", [1]),
        ("loads", []),
        ("probe", [{"name": "a", "field": "u", "line": [[0.0, 0.0], [1.0, 0.0], 1]}]),
        ("variant.fine.body.spcing", 0.1), ("variant.fine.body.horizon", "wide"),
        ("variant.fine.material.steel.E", "2"), ("variant.fine.expect", [{"value": "particles"}]),
    ],
)  # fmt: skip
def test_mistakes_are_refused(path, value, validator):
    assert not validator.is_valid(changed(path, value))


def test_tables_and_expressions_say_what_they_are():
    schema = case_schema()
    assert schema["definitions"]["Body"]["description"].startswith("A lattice of particles")
    assert schema["definitions"]["Force"]["properties"]["value"]["description"] == (
        "number or expression of X, Y, Z, spacing, t"
    )
    assert not any(word in schema_text() for word in ("null", "$defs", "prefixItems"))  # TOML's, and the dialect's
