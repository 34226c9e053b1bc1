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
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):  # no number, or nothing at all
        numbers = np.array(np.nan)
    tolerance = 0.0
    if e.equals is not None:
        goal, goals = e.equals, np.asarray(e.equals, float)
        allowed = e.atol + e.rtol * np.abs(goals)
        tolerance = float(allowed.max())
        met = numbers.shape == goals.shape and bool(np.all(np.abs(numbers - goals) <= allowed))
    elif e.below is not None:
        goal, met = f"< {e.below!r}", numbers.size > 0 and bool(np.all(numbers < e.below))
    else:
        goal, met = f"> {e.above!r}", numbers.size > 0 and bool(np.all(numbers > e.above))
    return {
        "name": e.value, "value": value, "expected": goal, "tolerance": tolerance, "met": met, "source": e.source,
    }  # fmt: skip
