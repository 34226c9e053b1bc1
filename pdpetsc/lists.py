"""What `pdpetsc list` shows: bundled cases, one case, and what a case file may choose from."""

import inspect
import re
import shutil
import textwrap
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pdpetsc import catalogue
from pdpetsc.commands import LISTS

Row = tuple[str, str]
FORMULAS = {
    "constant": "1",
    "inverse": "1 / r",
    "linear": "1 - r",
    "cubic": "1 - 3 * r**2 + 2 * r**3",
    "gaussian": "exp(-4 * r**2)",
}
"""Influence functions as expressions of r = |xi|/delta."""


def show(operand: str | None) -> str:
    """Return a list of `commands.LISTS`, or what is known of a case; None: the bundled cases.

    Raises:
        InputError: there is no such case.
    """
    if operand in (None, "cases"):
        return cases()
    return table(*globals()[operand]()) if operand in LISTS else one_case(operand)


def table(*rows: Row) -> str:
    """Return names and meanings in two columns; rows without a name go on under the one before."""
    indent = max((len(name) for name, _ in rows), default=0) + 2
    width = max(40, shutil.get_terminal_size().columns)
    lines = []
    for name, text in rows:
        inner = " " * (indent + 4 if not name else indent)
        lines += textwrap.wrap(f"{name:{indent}}{text}", width, subsequent_indent=inner) or [""]
    return "\n".join(lines)


# Cases.


def cases() -> str:
    """Return the bundled cases, with titles, variants and the sources of what they must come to."""
    rows: list[Row] = []
    for name, document in catalogue.documents().items():
        rows.append((name, document.get("title", "")))
        variants = document.get("variant", {})
        if variants:
            rows.append(("", f"variants: {', '.join(variants)}"))
        expected = [e for part in (document, *variants.values()) for e in part.get("expect", [])]
        if expected:
            rows.append(("", f"{len(expected)} expectation{'s' * (len(expected) > 1)}: {_few(_sources(expected))}"))
    return table(*rows)


def _sources(expected: list[dict]) -> list[str]:
    """Where numbers are from, each once."""
    return list(dict.fromkeys(" ".join(e["source"].split()) for e in expected if "source" in e))


def _few(texts: list[str], count: int = 2) -> str:
    more = len(texts) - count
    return "; ".join([*texts[:count], *([f"and {more} more source{'s' * (more > 1)}"] if more > 0 else [])])


def one_case(argument: str) -> str:
    """Return title, introduction, variants and expectations of a case.

    Raises:
        InputError: there is no such case, or something in it is wrong.
    """
    from pdpetsc import case

    path, chosen = catalogue.find(argument)
    case.load(argument)  # what is wrong in the file is said before anything in it is looked at
    variants = catalogue.read(path).get("variant", {})
    word = argument.removesuffix(f":{chosen}")
    loaded = {name: case.load(f"{word}:{name}" if name else word) for name in (None, *variants)}
    rows = [("title", loaded[None].title), ("file", str(path)), ("variants", ", ".join(variants) or "none")]
    text = [table(*rows), "", *_introduction(path.read_text(encoding="utf-8-sig"))]
    for name in loaded if chosen is None else [chosen]:
        text += ["", f"{path.stem}:{name}" if name else path.stem, *map(_goal, loaded[name].expect)]
    return "\n".join(text)


def _introduction(text: str) -> list[str]:
    """The comment at the head of a file."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    return lines


def _goal(expected) -> str:
    """One expectation in a line."""
    goals = {"=": expected.equals, "<": expected.below, ">": expected.above}
    goal = next(f"{sign} {number}" for sign, number in goals.items() if number is not None)
    slack = [f" +- {expected.atol:g}"] * bool(expected.atol) + [f" +- {100 * expected.rtol:g} %"] * bool(expected.rtol)
    return f"  {expected.value} {goal}{''.join(slack)}  ({' '.join(expected.source.split())})"


# What there is, from the tables in which the program itself finds it.


def models() -> Iterator[Row]:
    """Materials."""
    from pdpetsc.schema.materials import TABLES, AnyMaterial, Material

    yield from _kinds(TABLES, AnyMaterial, {name: summary(model) for name, model in Material.models.items()})


def criteria() -> Iterator[Row]:
    """Criteria of failing bonds."""
    from pdpetsc.damage.base import Criterion
    from pdpetsc.schema.damage import TABLES, AnyDamage

    yield from _kinds(TABLES, AnyDamage, {name: summary(each) for name, each in Criterion.criteria.items()})


def loads() -> Iterator[Row]:
    """Loads."""
    from pdpetsc.loads.base import Load
    from pdpetsc.schema.loads import TABLES

    for name, table in sorted(TABLES.items()):
        yield name, summary(Load.kinds[name] if name in Load.kinds and not table.__doc__ else table)
        yield "", f"keys: {_keys(table, {'kind'})}"


def fields() -> Iterator[Row]:
    """Fields of results."""
    from pdpetsc.quantities import QUANTITIES, components

    for name, quantity in QUANTITIES.items():
        unit = f" [{quantity.unit.format(length='length', force='force', time='time')}]" if quantity.unit else ""
        written = "" if quantity.cheap else "; written if asked for"
        yield name, f"{quantity.label}{unit}{written}"
        if names := components(name, 3):
            yield "", f"components: {', '.join(names)}"


def elasticity() -> Iterator[Row]:
    """Laws of correspondence materials."""
    from pdpetsc.materials.elasticity import LAWS

    for name, law in LAWS.items():
        yield name, summary(law)


def influence() -> Iterator[Row]:
    """Influence functions."""
    from pdpetsc.influence import INFLUENCE

    for name in INFLUENCE:
        yield name, f"w(r) = {FORMULAS[name]}, r = |xi|/delta"
    yield "EXPRESSION", 'any expression of r that is not negative, as "(1 - r)**2"'


def _kinds(tables: dict[str, Any], base: Any, meanings: dict[str, str]) -> Iterator[Row]:
    """Rows of tables of one kind, with the keys of their own; those that all have come last."""
    common = {*base.model_fields}
    for name, kind in sorted(tables.items()):
        yield name, meanings[name]
        yield "", f"keys: {_keys(kind, common) or 'none of its own'}"
    yield "all", f"keys: {_keys(base, {'model', 'criterion'})}"


def _keys(kind: Any, without: set[str]) -> str:
    """The keys of a table with their defaults and choices; those without a default are required."""
    fields = kind.model_fields.items()
    return ", ".join(_key(name, field) for name, field in fields if name not in without)


def _key(name: str, field: Any) -> str:
    kind = field.annotation
    choices = get_args(kind) if get_origin(kind) is Literal else ()
    inner = next((k for k in (kind, *get_args(kind)) if hasattr(k, "check") and hasattr(k, "model_fields")), None)
    if inner:  # a table of keys in the table
        return f"{name} = {{ {_keys(inner, set())} }}"
    if field.is_required():
        return f"{name} (required)"
    if choices:
        return f"{name} = {' | '.join(sorted(map(str, choices), key=lambda c: c != field.default))}"
    plain = isinstance(field.default, (bool, int, float, str))
    return f"{name} = {str(field.default).lower()}" if plain else name


def summary(thing: type) -> str:
    """The first paragraph of a docstring, in one line, without what leads over to the next one."""
    first, _, _ = (inspect.getdoc(thing) or "").partition("\n\n")
    return re.sub(r",?( with)?:?$", "", " ".join(first.split()))
