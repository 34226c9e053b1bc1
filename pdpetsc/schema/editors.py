"""The JSON Schema of case files, by which editors complete and check them while they are written.

It is made from the tables themselves. What tables must agree on (the dimension, names of sets and probes, what goes
with what) it cannot say; `pdpetsc check` does.
"""

import json
from typing import Any

from pdpetsc import __version__
from pdpetsc.schema.materials import TABLES
from pdpetsc.schema.tables import Description

DIALECT = "http://json-schema.org/draft-07/schema#"
"""The one that most editors know."""
CHANGED = "-changed"
"""What the name of a table ends with where it is that of a variant, in which all may be missing."""


def case_schema() -> dict[str, Any]:
    """The schema of a case file, variants and all."""
    schema = _in_dialect(Description.model_json_schema(ref_template="#/definitions/{model}"))
    tables = schema.pop("$defs")
    _allow_keys_of_other_models(tables)
    changed = {f"{name}{CHANGED}": _loosened(table) for name, table in tables.items()}
    variant = _loosened({key: value for key, value in schema.items() if key != "description"})
    schema["properties"]["variant"] = {
        "type": "object",
        "description": "Changes of all tables under a name, run as FILE.toml:NAME",
        "additionalProperties": variant,
    }
    about = {"title": f"A case of pdpetsc {__version__}", "description": "docs/case-file.md tells all keys"}
    return {"$schema": DIALECT} | schema | about | {"definitions": tables | changed}


def schema_text() -> str:
    """`case_schema` as text."""
    return json.dumps(case_schema(), indent=1)


def _in_dialect(schema: Any) -> Any:
    """Lists of fixed length as the dialect has them, and without null, which TOML does not have."""
    if isinstance(schema, list):
        return [_in_dialect(inner) for inner in schema if inner != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    plain = {key: _in_dialect(value) for key, value in schema.items() if value is not None}
    if "prefixItems" in plain:
        plain["items"] = plain.pop("prefixItems")
    return plain | plain.pop("anyOf")[0] if len(plain.get("anyOf", ())) == 1 else plain


def _allow_keys_of_other_models(tables: dict[str, dict]) -> None:
    """A key that only other models have is left out with a warning, so that `model` alone can be changed."""
    of_models = {table.__name__: tables[table.__name__] for table in TABLES.values()}
    every = {key for table in of_models.values() for key in table["properties"]}
    for table in of_models.values():
        missing = every - table["properties"].keys()
        table["properties"] |= {key: {"description": "of other models; left out"} for key in sorted(missing)}


def _loosened(schema: Any) -> Any:
    """A table in which all may be missing, and which goes by the loosened tables in turn; lists are replaced whole, and
    keep theirs."""
    if isinstance(schema, list):
        return [_loosened(inner) for inner in schema]
    if not isinstance(schema, dict):
        return schema
    loosened = {}
    for key, value in schema.items():
        if key in ("required", "discriminator", "default", "minProperties"):
            continue
        if key == "$ref":
            value = f"{value}{CHANGED}"
        loosened["anyOf" if key == "oneOf" else key] = value if key == "items" else _loosened(value)
    return loosened
