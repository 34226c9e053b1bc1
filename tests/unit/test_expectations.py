"""[[expect]]: finding a value in summary.json and judging it."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from pdpetsc import expectations

SUMMARY = {
    "status": "converged",
    "probes": {"tip": 1.001e-4, "line": [[0.0, 1.0], [2.0, 3.0]], "zero": 0.0, "nothing": None, "nan": float("nan")},
    "steps": [{"residual_norms": [1.0, 1e-3]}, {"residual_norms": [1.0, 1e-9], "rounding_floor": True}],
}


def expect(value, **keys):
    defaults = dict(equals=None, below=None, above=None, rtol=0.0, atol=0.0, source="here")
    return SimpleNamespace(value=value, **(defaults | keys))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("probes.tip", 1.001e-4),
        ("steps.-1.residual_norms.-1", 1e-9),
        ("steps.0.residual_norms", [1.0, 1e-3]),
        ("probes.line.1.0", 2.0),
        ("status", "converged"),
        ("probes.top", None),
        ("probes.tip.x", None),
        ("steps.2.residual_norms", None),
        ("steps.last.residual_norms", None),
        ("status.0.x", None),
        ("", None),
    ],
)
def test_look_up(path, value):
    assert expectations.look_up(SUMMARY, path) == value


@pytest.mark.parametrize(
    ("entry", "met"),
    [
        (expect("probes.tip", equals=1e-4, rtol=1e-3), True),
        (expect("probes.tip", equals=1e-4, rtol=0.9e-3), False),
        (expect("probes.tip", equals=1e-4, atol=1.1e-7), True),
        (expect("probes.tip", equals=-1e-4, rtol=1e-3), False),
        (expect("probes.tip", below=1.1e-4), True),
        (expect("probes.tip", below=1.001e-4), False),
        (expect("probes.tip", above=1e-4), True),
        (expect("probes.tip", above=1.001e-4), False),
        (expect("probes.zero", equals=0.0), True),
        (expect("probes.line", equals=(0.0, 1.0)), False),  # another shape
        (expect("probes.line.1", equals=(2.0, 3.001), rtol=1e-3), True),
        (expect("probes.line.1", equals=(2.0, 4.0), rtol=1e-3), False),
        (expect("probes.line", below=3.5), True),
        (expect("probes.line", below=2.5), False),
        (expect("probes.top", equals=1.0), False),
        (expect("probes.nothing", below=1.0), False),
        (expect("probes.nan", equals=1.0, rtol=9.0), False),
        (expect("probes.nan", below=1.0), False),
        (expect("probes.nan", above=1.0), False),
        (expect("steps.-1.rounding_floor", equals=1.0), True),
    ],
    ids=str,
)
def test_check(entry, met):
    (result,) = expectations.check(SUMMARY, [entry])
    assert result["met"] is met
    assert set(result) == {"name", "value", "expected", "tolerance", "met", "source"}
    json.dumps(result)


@pytest.mark.parametrize("path", ("status", "probes", "steps", "steps.0"))
@pytest.mark.parametrize("keys", ({"equals": 1.0}, {"below": 1.0}))
def test_values_that_are_no_numbers_miss(path, keys):
    """An expectation about words or tables is missed; it is no reason to lose the results of a run."""
    assert not expectations.check(SUMMARY, [expect(path, **keys)])[0]["met"]


def test_tolerance_is_that_of_the_largest_entry():
    (result,) = expectations.check(SUMMARY, [expect("probes.line.1", equals=(2.0, 3.0), rtol=1e-2, atol=1e-3)])
    assert result["tolerance"] == pytest.approx(1e-3 + 0.03)
    assert np.isfinite(result["tolerance"])
