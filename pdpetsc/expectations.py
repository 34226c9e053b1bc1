"""Expectations of a case: what values of summary.json must come to."""

import numpy as np


def look_up(summary: dict, path: str):
    """The value at a dotted path; list entries by number, negative from the end. None where there is none."""
    value = summary
    for key in path.split("."):
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return value


def check(summary: dict, expected: list) -> list[dict]:
    """The `expect` entries of summary.json for the case's `[[expect]]` tables.

    `equals` is met when |value - equals| <= atol + rtol |equals| for every entry, `below` and `above` strictly.
    """
    return [_check(look_up(summary, e.value), e) for e in expected]


def _check(value, e) -> dict:
    if e.equals is not None:
        goal, tolerance = e.equals, e.atol + e.rtol * float(np.abs(e.equals).max())
    else:
        goal, tolerance = f"< {e.below!r}" if e.below is not None else f"> {e.above!r}", 0.0
    met = False
    if value is not None:
        numbers = np.asarray(value, float)
        if e.equals is not None:
            goals = np.asarray(e.equals, float)
            allowed = e.atol + e.rtol * np.abs(goals)
            met = numbers.shape == goals.shape and bool(np.all(np.abs(numbers - goals) <= allowed))
        elif e.below is not None:
            met = bool(np.all(numbers < e.below))
        else:
            met = bool(np.all(numbers > e.above))
    return {
        "name": e.value, "value": value, "expected": goal, "tolerance": tolerance, "met": met, "source": e.source,
    }  # fmt: skip
