"""The tables of failing bonds, made from the keys that the criteria name (pdpetsc.damage.base.Criterion.Keys)."""

from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainValidator, Strict, WithJsonSchema

import pdpetsc.damage  # noqa: F401  fills Criterion.criteria
from pdpetsc.damage.base import Criterion
from pdpetsc.expressions import hint
from pdpetsc.schema.crack import Crack
from pdpetsc.schema.materials import table_of_keys
from pdpetsc.schema.table import Table, error_at
from pdpetsc.schema.values import SetName


class AnyDamage(Table):
    """What every `[damage.NAME]` has, whatever its criterion."""

    criterion: str
    exempt: Annotated[tuple[SetName, ...], Strict(False)] = ()
    independent: bool = False
    along: Annotated[tuple[Crack, ...], Strict(False), Field(min_length=1)] | None = None


def tables_of(criteria: dict[str, type[Criterion]]) -> dict[str, type[AnyDamage]]:
    """The table of each criterion."""
    return {
        name: table_of_keys(criterion.Keys, criterion.__name__, AnyDamage, criterion=(Literal[name], ...))
        for name, criterion in criteria.items()
    }


def any_damage(tables: dict[str, type[AnyDamage]]) -> Any:
    """The type of a `[damage.NAME]`: the table of one of the criteria."""

    def of_known_criterion(table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        choices = f"choices: {', '.join(sorted(tables))}"
        if "criterion" not in table:
            raise error_at("criterion", f"is missing; {choices}")
        if (name := table["criterion"]) not in [*tables]:
            near = hint(name, tables) if isinstance(name, str) else ""
            raise error_at("criterion", f"there is no criterion {name!r}{near}; {choices}")
        return table

    either = reduce(or_, tables.values())
    return Annotated[either, Field(discriminator="criterion"), BeforeValidator(of_known_criterion)]


TABLES = tables_of(Criterion.criteria)
DamageTable = any_damage(TABLES)


def _fraction(value: Any) -> float:
    """Keep a fraction; "worst" is 1 and "all" 0."""
    named = {"worst": 1.0, "all": 0.0}
    if isinstance(value, str) and value in named:
        return named[value]
    if isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= 1:
        return float(value)
    raise ValueError('must be "worst", "all" or a fraction of the worst ratio between 0 and 1')


Fraction = Annotated[
    float,
    PlainValidator(_fraction),
    WithJsonSchema({"anyOf": [{"enum": ["worst", "all"]}, {"type": "number", "minimum": 0, "maximum": 1}]}),
]
"""Which of the bonds beyond their critical value fail together: those beyond this fraction of the worst."""
