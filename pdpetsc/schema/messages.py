"""From what pydantic says to what a person can use: one sentence with the key path."""

import reprlib
from typing import Any

from pydantic import BaseModel, ValidationError

from pdpetsc.expressions import Expression

reprlib.aRepr.maxstring = 80
LONGEST = 1000
"""Characters of a message, which may quote what is wrong."""
_WANTED = {
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "string_too_long": "must be shorter",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
}


def explain(error: ValidationError, document: dict) -> str:
    errors = error.errors(include_url=False)
    places = [".".join(map(str, _key_path(e, document))) for e in errors]
    more = len(set(places)) - 1
    more_text = f" (and {more} more mistake{'s' if more > 1 else ''})" if more else ""
    sentence = f"{places[0]}: {_sentence(errors[0])}"
    return (sentence if len(sentence) <= LONGEST else f"{sentence[:LONGEST]} ...") + more_text


def _key_path(error: dict, document: dict) -> list:
    """Return the path of an error as keys of the document, without pydantic's own remarks on the way."""
    path = _keys_in(error["loc"], document)
    missing = error["loc"][-1:] if error["type"] == "missing" else ()
    return [*path, *missing, *([error["ctx"]["key"]] if error["type"] == "at_key" else [])]


def _keys_in(path: tuple, document: Any) -> list:
    keys = []
    for part in path:
        inside = (
            (*document,) if isinstance(document, dict) else range(len(document)) if isinstance(document, list) else ()
        )
        if part in inside:
            keys.append(part)
            document = document[part]
    return keys


def _sentence(error: dict) -> str:
    kind, value = error["type"], error["input"]
    if kind == "missing":
        return "is missing"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    if kind == "at_key":
        return error["ctx"]["message"]
    if kind in ("too_short", "too_long"):
        limits = error["ctx"]
        bound = f"at least {limits['min_length']}" if kind == "too_short" else f"at most {limits['max_length']}"
        return f"must have {bound} entries, not {limits['actual_length']}"
    wanted = _WANTED.get(kind, error["msg"].replace("Input should be", "must be"))
    shown = "a table" if isinstance(value, dict) else reprlib.repr(value)
    return f"{wanted}, not {shown}"


def place_expressions(value: Any, path: tuple, document: dict, file: str) -> None:
    """Tell every expression where it stands, for messages at run time."""
    if isinstance(value, Expression):
        value.place = f"{file}: {'.'.join(map(str, _keys_in(path, document)))}"
    elif isinstance(value, BaseModel | dict):
        for key, inner in value if isinstance(value, BaseModel) else value.items():
            place_expressions(inner, (*path, key), document, file)
    elif isinstance(value, tuple):
        for index, inner in enumerate(value):
            place_expressions(inner, (*path, index), document, file)
