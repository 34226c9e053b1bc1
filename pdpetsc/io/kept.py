"""What JSON of results must look like before it is believed: of checkpoints and of summary.json."""

import json
import math
from typing import Any

from pdpetsc.toml import levels

DEEPEST = 50
"""Levels of nesting."""

ORIGIN = {"name": str, "path": str, "variant": (str, type(None)), "overridden": bool, "document": dict}
"""Entries of the case in a checkpoint."""

TIME_STEPS = {"end", "count", "stable", "start", "first"}


class Wrong(ValueError):
    """What is wrong, in a few words."""


def parsed(text: str | bytes) -> Any:
    """The data of a JSON text, of limited depth.

    Raises:
        Wrong: it is none.
    """
    try:
        data = json.loads(text)
    except RecursionError:
        raise Wrong("nested too deeply") from None
    except ValueError as error:
        raise Wrong(str(error)) from None
    if any(depth >= DEEPEST for depth, _ in enumerate(levels(data), 1)):
        raise Wrong("nested too deeply")
    return data


def is_number(value: Any, low: float = -math.inf) -> bool:
    """Whether a value is a finite number that is not too small."""
    return type(value) in (int, float) and -1e300 < value < 1e300 and value >= low


def is_count(value: Any, low: int = 0) -> bool:
    """Whether a value is a whole number that is not too small."""
    return type(value) is int and low <= value < 2**62


def check_state(kept: Any, names: set[str]) -> None:
    """See that numbers of a state are its own and make sense.

    Raises:
        Wrong: they do not.
    """
    if not isinstance(kept, dict) or not {"time", "step"} <= kept.keys() <= names:
        raise Wrong("the state has other entries")
    for name, value in kept.items():
        low = 0.0 if name in ("step_size", "speed") else -math.inf
        if not (is_count(value) if name == "step" else is_number(value, low)):
            raise Wrong(f"{name} of the state is no number that it can be")


def check_description(kept: Any) -> None:
    """See that the description in a checkpoint holds a case and the records of its steps.

    Raises:
        Wrong: it does not.
    """
    if not isinstance(kept, dict):
        raise Wrong("the description is no table")
    case = kept.get("case")
    if not isinstance(case, dict) or case.keys() != ORIGIN.keys():
        raise Wrong("there is no case")
    for name, kind in ORIGIN.items():
        if not isinstance(case[name], kind):
            raise Wrong(f"{name} of the case is of another kind")
    check_steps(kept.get("rows"))
    columns = {(*row, *row["probes"]) if isinstance(row.get("probes"), dict) else () for row in kept["rows"]}
    if len(columns) > 1 or () in columns:
        raise Wrong("its steps have other columns or probes than the first one")
    for name in ("refinements", "time_steps"):
        if not isinstance(kept.get(name, []), list) or not all(isinstance(row, dict) for row in kept.get(name, [])):
            raise Wrong(f"{name} is no list of tables")
    for steps in kept.get("time_steps", []):
        whole = all(is_count(steps.get(name), low) for name, low in (("count", 1), ("first", 0)))
        if not (whole and steps.keys() == TIME_STEPS and all(map(is_number, steps.values()))):
            raise Wrong("time_steps are none")
    if not isinstance(kept.get("unsolved", False), bool):
        raise Wrong("unsolved is neither true nor false")


def check_steps(rows: Any) -> None:
    """See that rows of steps have numbers and times.

    Raises:
        Wrong: they do not.
    """
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise Wrong("there are no steps")
    before = -1
    for row in rows:
        if not is_count(row.get("step"), before + 1) or not is_number(row.get("time")):
            raise Wrong("a step has no number or time")
        before = row["step"]


def check_summary(summary: Any) -> None:
    """See that a summary.json has what pictures are made of.

    Raises:
        Wrong: it does not.
    """
    if not isinstance(summary, dict) or summary.get("dim") not in (1, 2, 3):
        raise Wrong("it has no dimension")
    units = summary.get("units")
    names = [units.get(name) for name in ("length", "force", "time")] if isinstance(units, dict) else [None]
    if not all(isinstance(name, str) and "$" not in name for name in names):
        raise Wrong("it has no units")
    if not all(isinstance(summary.get(name), str) for name in ("title", "case")):
        raise Wrong("it has no title")
    check_steps(summary.get("steps"))
