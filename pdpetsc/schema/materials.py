"""The tables of materials, made from the keys that the models name (pdpetsc.materials.base.Keys)."""

from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal, get_args, get_type_hints

from pydantic import (
    BeforeValidator,
    Field,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    create_model,
    model_validator,
)

import pdpetsc.materials  # noqa: F401  fills Material.models
from pdpetsc.errors import InputError
from pdpetsc.expressions import Expression, hint
from pdpetsc.influence import INFLUENCE
from pdpetsc.materials.base import Keys, Material
from pdpetsc.partial_volume import PARTIAL_VOLUME
from pdpetsc.schema.table import Table, error_at
from pdpetsc.schema.values import Horizon, Positive, SetName


def _influence(value: Any) -> str | Expression:
    """Keep the name of an influence function; read anything else as an expression of r = |xi|/delta."""
    if isinstance(value, str) and value in INFLUENCE:
        return value
    try:
        expression = Expression(value, ["r"])
    except InputError as error:
        raise ValueError(
            f"must be one of {', '.join(INFLUENCE)}, or an expression of r = |xi|/delta: {error}"
        ) from None
    if expression.is_condition:
        raise ValueError(f"{value!r} is a condition where a number is needed, as in where(r < 0.5, 1, 0)")
    return expression


Influence = Annotated[
    str | Expression,
    PlainValidator(_influence),
    WithJsonSchema(
        {"description": "of r = |xi|/delta", "anyOf": [{"enum": [*INFLUENCE]}, {"type": ["number", "string"]}]}
    ),
]


class AnyMaterial(Table):
    """What every `[material.NAME]` has, whatever its model."""

    model: str
    density: Positive | None = None
    where: SetName = "all"
    horizon: Horizon | None = None
    influence: Influence = "constant"
    partial_volume: Literal["none", *PARTIAL_VOLUME] = "none"
    dual: bool = True


def table_of_keys(keys: type[Keys], name: str, base: type[Table], **more) -> type[Table]:
    """A table of these keys, with their defaults and their check."""

    def check(self, info: ValidationInfo):
        keys.check(self, info.context.dim)
        return self

    fields = {}
    for key, hinted in get_type_hints(keys, include_extras=True).items():
        default = getattr(keys, key, ...)
        tables = [each for each in get_args(hinted) or (hinted,) if isinstance(each, type) and issubclass(each, Keys)]
        if tables:
            optional = hinted is not tables[0]
            hinted = table_of_keys(tables[0], tables[0].__name__, Table)
            hinted, default = (hinted | None, None) if optional else (hinted, Field(default, validate_default=True))
        fields[key] = (hinted, default)
    validators = {"check": model_validator(mode="after")(check)}
    return create_model(
        name, __base__=base, __doc__=keys.__doc__, __validators__=validators, __module__=__name__, **more, **fields
    )


def material_table(model: type[Material]) -> type[AnyMaterial]:
    """The table of a model."""
    return table_of_keys(model.Keys, model.__name__, AnyMaterial, model=(Literal[model.name], ...))


def tables_of(models: dict[str, type[Material]]) -> dict[str, type[AnyMaterial]]:
    """The tables of models by their names."""
    return {name: material_table(model) for name, model in models.items()}


def any_material(tables: dict[str, type[AnyMaterial]]) -> Any:
    """The type of a `[material.NAME]`: one of these tables."""

    def of_known_model(table: Any) -> Any:
        """Find the model, and leave out the keys of others: a case in which only `model` is changed still runs."""
        choices = f"choices: {', '.join(sorted(tables))}"
        if not isinstance(table, dict):
            return table
        if "model" not in table:
            raise error_at("model", f"is missing; {choices}")
        if (name := table["model"]) not in [*tables]:
            near = hint(name, tables) if isinstance(name, str) else ""
            raise error_at("model", f"there is no model {name!r}{near}; {choices}")
        others = {key for other in tables.values() for key in other.model_fields} - {*tables[name].model_fields}
        return {key: value for key, value in table.items() if key not in others}

    return Annotated[reduce(or_, tables.values()), Field(discriminator="model"), BeforeValidator(of_known_model)]


TABLES = tables_of(Material.models)
MaterialTable = any_material(TABLES)
