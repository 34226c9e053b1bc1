"""The table of rules, and what they know of a case."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from pdpetsc.case import Case
from pdpetsc.materials.base import Material

LARGE_STRETCH = 0.1
"""Strain from which small-strain laws and constants do not hold."""


class Known(NamedTuple):
    """What has been found out about a case: the stable step of explicit dynamics (None: no density), and the materials
    by name, each on one of its families."""

    stable: float | None
    materials: dict[str, Material]


Rule = Callable[[Case, Known], Iterator[str]]
RULES: list[Rule] = []


def rule(function: Rule) -> Rule:
    """Add to the rules that `advise` goes through."""
    RULES.append(function)
    return function


def of_lattices(function: Rule) -> Rule:
    """A rule that looks at size and spacing of a lattice: it has nothing to say of bodies from files."""

    def silent_on_others(case: Case, known: Known) -> Iterator[str]:
        if case.body.shape == "box":
            yield from function(case, known)

    return silent_on_others


def horizons(case: Case) -> dict[str, float]:
    """Of each material in spacings, where that is one number."""
    found, body = {}, case.body
    for name, spec in case.material.items():
        horizon = spec.horizon or body.horizon
        if horizon is None:  # in the file of points
            continue
        if horizon.factor and not horizon.factor.names:
            found[name] = float(horizon.factor())
        elif body.spacing and horizon.length and not horizon.length.names and not (body.refine or body.zones):
            found[name] = float(horizon.length()) / body.spacing
    return found
