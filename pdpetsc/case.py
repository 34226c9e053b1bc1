"""Case files: TOML in, a validated and frozen description out.

What a case file may hold is in `schema`. A mistake is an `InputError` of one sentence with file, key path and what
would be right. Nothing here knows MPI or PETSc.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pdpetsc.errors import InputError
from pdpetsc.expressions import hint
from pdpetsc.schema.extended import description
from pdpetsc.schema.messages import explain, place_expressions
from pdpetsc.schema.tables import Description
from pdpetsc.schema.values import setting_of

BUNDLED = Path(__file__).parent / "cases"
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
        try:
            case = description().model_validate(document, context=setting_of(document))
        except ValidationError as error:
            raise InputError(f"{path}: {explain(error, document)}") from None
        place_expressions(case, (), document, path)
        origin = {"name": name, "variant": variant, "path": path, "overridden": overridden, "document": document}
        return cls.model_construct(**dict(case), **origin)


# From the command line or a script to a case.


def bundled() -> dict[str, Path]:
    """Return the files of the cases that come with the package, by name."""
    return {path.stem: path for path in sorted(BUNDLED.glob("*.toml"))}


def catalogue() -> list[tuple[str, str, list[str]]]:
    """Return name, title and variants of every bundled case."""
    documents = {name: _read(path) for name, path in bundled().items()}
    return [
        (name, document.get("title", ""), list(document.get("variant", {}))) for name, document in documents.items()
    ]


def is_case(word: str) -> bool:
    """Tell whether a word of the command line names a case: FILE.toml, BUNDLED, or one of them with :VARIANT."""
    return re.search(r"\.toml(:[^/]*)?$", word) is not None or word.partition(":")[0] in bundled()


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
        path, variant, document = Path(IN_MEMORY), None, _with_variant(_plain(argument), None, IN_MEMORY)
    else:
        path, variant, document = _from_file(str(argument))
    for override in overrides:
        if isinstance(overrides, Mapping):
            _override(document, override, _plain(overrides[override]), f"override {override}")
        else:
            key, equals, text = override.partition("=")
            if not equals or not key.strip():
                raise InputError(f"--set {override}: must be key=value, for example body.spacing=0.01")
            _override(document, key, _toml_value(text), f"--set {override}")
    document = _with_paths(document, path.parent)
    return Case.from_document(document, path.stem, variant, _shown(path), bool(overrides))


def _from_file(argument: str) -> tuple[Path, str | None, dict]:
    """The file of a case, the variant that is asked for, and the tables."""
    word, variant = re.fullmatch(r"(.*\.toml|.*?)(?::([^:/]*))?", argument, re.DOTALL).groups()
    path = Path(word) if word.endswith(".toml") else bundled().get(word)
    if path is None:
        names = list(bundled())
        choices = f"bundled cases: {', '.join(names)}; a case of your own is a path that ends in .toml"
        raise InputError(f"there is no case {word!r}{hint(word, names)}; {choices}")
    return path, variant, _with_variant(_read(path), variant, _shown(path))


def _plain(value: Any) -> Any:
    """A copy of what a script gives, in the types of TOML; an entry that is None is none."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items() if inner is not None}
    if hasattr(value, "tolist"):  # of numpy
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return str(value) if isinstance(value, Path) else value


def _shown(path: Path) -> str:
    return path.name if path.parent == BUNDLED else str(path)


def _read(path: Path) -> dict:
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError:
        reason = "there is no such file"
    except OSError as error:
        reason = f"cannot be read: {error.strerror.lower()}"
    except UnicodeDecodeError:
        reason = "is not UTF-8 text"
    except RecursionError:
        reason = "is not valid TOML: nested too deeply"
    except ValueError as error:
        reason = f"is not valid TOML: {error}"
    raise InputError(f"{_shown(path)}: {reason}")


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
    """Return tables whose meshes can be found from anywhere; in the case file their paths are relative to it."""

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
    if isinstance(document.get("body"), dict) and "cracks" in document["body"]:
        document["body"] = document["body"] | {"cracks": found(document["body"]["cracks"])}
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
