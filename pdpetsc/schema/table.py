"""What all tables of a case file have in common."""

from typing import Any, ClassVar

from pydantic import (
    BaseModel,
    ConfigDict,
    model_validator,
)
from pydantic_core import PydanticCustomError

from pdpetsc.expressions import hint


def error_at(key: str, message: str) -> PydanticCustomError:
    """Return an error of one entry, found by a validator of the whole table."""
    return PydanticCustomError("at_key", "{message}", {"message": message, "key": key})


class Table(BaseModel):
    """What all tables have in common: unknown keys and wrong types are errors, and nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    used_before: ClassVar[tuple[str, ...]] = ()  # keys that are gone when the table is validated
    plain: ClassVar[str | None] = None  # type of JSON of what may stand for the whole table

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema, handler) -> dict:
        """The schema for editors (editors.py), with what may stand for the whole table."""
        whole = super().__get_pydantic_json_schema__(core_schema, handler)
        return {"anyOf": [{"type": cls.plain}, handler.resolve_ref_schema(whole)]} if cls.plain else whole

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, table: Any) -> Any:
        """Report an unknown key before the keys that are then missing, and name the choices."""
        choices = [*(field.alias or name for name, field in cls.model_fields.items()), *cls.used_before]
        for key in table if isinstance(table, dict) else ():
            if key not in choices:
                raise error_at(key, f"unknown key{hint(key, choices)}; choices: {', '.join(choices)}")
        return table


def exactly_one(table: Table, *keys: str) -> None:
    if sum(getattr(table, key) is not None for key in keys) != 1:
        raise ValueError(f"needs exactly one of {', '.join(keys)}")
