"""Case files: TOML in, a validated and frozen description out.

What a case file may hold is in `schema`. A mistake is an `InputError` of one sentence with file, key path and what
would be right. Nothing here knows MPI or PETSc.
"""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pdpetsc.catalogue import find, read, shown
from pdpetsc.errors import InputError
from pdpetsc.expressions import hint
from pdpetsc.schema.extended import description
from pdpetsc.schema.messages import explain, place_expressions
from pdpetsc.schema.tables import Description
from pdpetsc.schema.values import setting_of
from pdpetsc.toml import check_plain

IN_MEMORY = "case"
"""What a case that comes from no file is called."""


class Case(Description):
    """A validated case, and where it comes from.

    Attributes:
        name: Stem of the file's name.
        variant: The variant chosen, if any.
        path: The file as messages name it.
        overridden: Whether entries were overridden on the command line; the expectations then do not count.
        document: The merged plain tables, from which `from_document` makes this case again.
    """

    name: str
    variant: str | None
    path: str
    overridden: bool
    document: dict[str, Any]

    @classmethod
    def from_document(cls, document: dict, name: str, variant: str | None, path: str, overridden: bool) -> "Case":
        """Validate merged tables.

        Raises:
            InputError: The first mistake, with file and key path, and how many more there are.
        """
        check_plain(document, path)
        try:
            case = description().model_validate(document, context=setting_of(document))
        except ValidationError as error:
            raise InputError(f"{path}: {explain(error, document)}") from None
        place_expressions(case, (), document, path)
        origin = {"name": name, "variant": variant, "path": path, "overridden": overridden, "document": document}
        return cls.model_construct(**dict(case), **origin)


# From the command line or a script to a case.


def load(argument: str | Path | Mapping, overrides: Sequence[str] | Mapping[str, Any] = ()) -> Case:
    """Read a case.

    Args:
        argument: A path that ends in .toml or the name of a bundled case, with :VARIANT for a variant; or the tables of
            a case as dictionaries, with the keys of the file.
        overrides: Values by dotted keys, as in {"body.spacing": 0.5, "load.0.value": "t"}; or texts "key=value" with a
            TOML value, where other text is taken as a string.

    Raises:
        InputError: There is no such case, or something in it or in an override is wrong.
    """
    if isinstance(argument, Mapping):
        path, document = Path(IN_MEMORY), _plain(argument)
        variant = None
    else:
        path, variant = find(str(argument))
        document = read(path)
    check_plain(document, shown(path))
    document = _with_variant(document, variant, shown(path))
    for override in overrides:
        if isinstance(overrides, Mapping):
            _override(document, override, _plain(overrides[override]), f"override {override}")
        else:
            key, equals, text = override.partition("=")
            if not equals or not key.strip():
                raise InputError(f"--set {override}: must be key=value, for example body.spacing=0.01")
            _override(document, key, _toml_value(text), f"--set {override}")
    check_plain(document, shown(path))
    try:
        document = _with_paths(document, path.parent)
    except (OSError, RuntimeError) as error:  # links that go round in a circle
        raise InputError(f"{shown(path)}: the path of a file cannot be followed ({error})") from None
    return Case.from_document(document, path.stem, variant, shown(path), bool(overrides))


def _plain(value: Any) -> Any:
    """A copy of what a script gives, in the types of TOML; an entry that is None is none."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items() if inner is not None}
    if hasattr(value, "tolist"):  # of numpy
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return str(value) if isinstance(value, Path) else value


def _with_variant(document: dict, variant: str | None, place: str) -> dict:
    """Merge a variant into the other tables; the expectations of the base do not hold for a variant."""
    base = {key: value for key, value in document.items() if key != "variant"}
    variants = document.get("variant", {})
    if not isinstance(variants, dict) or not all(isinstance(table, dict) for table in variants.values()):
        raise InputError(f"{place}: variant: must be tables, [variant.NAME]")
    if variant is None:
        return base
    if variant not in variants:
        choices = f"choices: {', '.join(variants)}" if variants else "it has none"
        raise InputError(f"{place}: there is no variant {variant!r}{hint(variant, variants)}; {choices}")
    base.pop("expect", None)
    return _merged(base, variants[variant])


def _merged(base: dict, changes: dict) -> dict:
    """Return tables with changes merged into them entry by entry; anything but a table is replaced whole."""
    merged = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merged(base[key], value) if both else value
    return merged


def _with_paths(document: dict, folder: Path) -> dict:
    """Return tables whose files can be found from anywhere; in the case file their paths are relative to it."""

    def found(cracks: Any) -> Any:
        if not isinstance(cracks, list):
            return cracks
        return [
            crack | {"mesh": str((folder / crack["mesh"]).resolve())}
            if isinstance(crack, dict) and isinstance(crack.get("mesh"), str) and crack["mesh"]
            else crack
            for crack in cracks
        ]

    document = dict(document)
    if isinstance(document.get("body"), dict):
        body = dict(document["body"])
        if "cracks" in body:
            body["cracks"] = found(body["cracks"])
        document["body"] = body | {
            key: str((folder / body[key]).resolve())
            for key in ("mesh", "points")
            if body.get(key) and isinstance(body[key], str)
        }
    if isinstance(document.get("damage"), dict):
        document["damage"] = {
            name: table | {"along": found(table["along"])} if isinstance(table, dict) and "along" in table else table
            for name, table in document["damage"].items()
        }
    return document


def _override(document: dict, key: str, value: Any, shown: str) -> None:
    """Set one entry; an entry of a list is named by its index, as in load.0.value."""
    inner: Any = document
    *parents, last = key.strip().split(".")

    def place(part: str) -> str | int:
        entries = inner if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else ()
        if isinstance(inner, dict) or part in map(str, entries):
            return part if isinstance(inner, dict) else int(part)
        raise InputError(f"{shown}: there is no entry {part!r} to set")

    for part in parents:
        if isinstance(inner, dict):
            inner.setdefault(part, {})
        inner = inner[place(part)]
    inner[place(last)] = value


def _toml_value(text: str) -> Any:
    try:
        document = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return document["value"] if len(document) == 1 else text
