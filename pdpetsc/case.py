"""Case files: TOML in, a validated and frozen description out.

What a case file may hold is in `schema`. A mistake is an `InputError` of one sentence with file, key path and what
would be right. Nothing here knows MPI or PETSc.
"""

import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pdpetsc.errors import InputError, plain
from pdpetsc.expressions import hint
from pdpetsc.schema.messages import explain, place_expressions
from pdpetsc.schema.tables import Description
from pdpetsc.schema.values import setting_of

BUNDLED = Path(__file__).parent / "cases"

LARGEST, DEEPEST = 2**18, 20
"""Bytes and levels of nesting of a case file."""

ENDLESS = re.compile(r"""(?<![\w"'.-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){40}""")
"""A key of so many parts that tomllib would take minutes."""


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
        _check_plain(document, path)
        try:
            description = Description.model_validate(document, context=setting_of(document))
        except ValidationError as error:
            raise InputError(f"{path}: {explain(error, document)}") from None
        place_expressions(description, (), document, path)
        origin = {"name": name, "variant": variant, "path": path, "overridden": overridden, "document": document}
        return cls.model_construct(**dict(description), **origin)


# From the command line to a case.


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


def load(argument: str, overrides: tuple[str, ...] | list[str] = ()) -> Case:
    """Read a case.

    Args:
        argument: A path that ends in .toml or the name of a bundled case, with :VARIANT for a variant.
        overrides: Texts "key=value" with a dotted key and a TOML value; other text is taken as a string.

    Raises:
        InputError: There is no such case, or something in it or in an override is wrong.
    """
    word, variant = re.fullmatch(r"(.*\.toml|.*?)(?::([^:/]*))?", argument, re.DOTALL).groups()
    path = Path(word) if word.endswith(".toml") else bundled().get(word)
    if path is None:
        names = list(bundled())
        choices = f"bundled cases: {', '.join(names)}; a case of your own is a path that ends in .toml"
        raise InputError(f"there is no case {word!r}{hint(word, names)}; {choices}")
    if not path.stem.strip("."):
        raise InputError(f"{_shown(path)}: results are called like the case, and this is no name; rename the file")
    document = _read(path)
    _check_plain(document, _shown(path))
    document = _with_variant(document, variant, _shown(path))
    for override in overrides:
        _override(document, override)
    _check_plain(document, _shown(path))
    try:
        document = _with_paths(document, path.parent)
    except (OSError, RuntimeError) as error:  # links that go round in a circle
        raise InputError(f"{_shown(path)}: the path of a mesh cannot be followed ({error})") from None
    return Case.from_document(document, path.stem, variant, _shown(path), bool(overrides))


def _shown(path: Path) -> str:
    return plain(path.name if path.parent == BUNDLED else str(path))


def _read(path: Path) -> dict:
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
        text = content.decode("utf-8-sig")
        if len(content) <= LARGEST and not ENDLESS.search(text):
            return tomllib.loads(text)
        reason = f"is no case file: it has more than {LARGEST} bytes, or a key of more than 40 parts"
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


def _check_plain(document: Any, place: str) -> None:
    """Dotted keys nest without end, and whoever follows them in turn would run out of stack; a null character ends
    texts for the system and for PETSc."""
    level = [document]
    for _ in range(DEEPEST):
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if any("\0" in text for text in level if isinstance(text, str)):
            raise InputError(f"{place}: holds a null character")
        if not level:
            return
    raise InputError(f"{place}: is nested too deeply")


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


def _override(document: dict, override: str) -> None:
    """Set one entry; an entry of a list is named by its index, as in load.0.value."""
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set {override}: must be key=value, for example body.spacing=0.01")
    inner: Any = document
    *parents, last = key.strip().split(".")

    def place(part: str) -> str | int:
        entries = inner if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else ()
        if isinstance(inner, dict) or part in map(str, entries):
            return part if isinstance(inner, dict) else int(part)
        raise InputError(f"--set {override}: there is no entry {part!r} to set")

    for part in parents:
        if isinstance(inner, dict):
            inner.setdefault(part, {})
        inner = inner[place(part)]
    inner[place(last)] = _toml_value(text)


def _toml_value(text: str) -> Any:
    try:
        document = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return document["value"] if len(document) == 1 else text
