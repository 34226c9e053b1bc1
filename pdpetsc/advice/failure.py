"""Rules of bonds that fail."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from pdpetsc.advice.base import LARGE_STRETCH, Known, horizons, of_lattices, rule
from pdpetsc.case import Case
from pdpetsc.damage.base import Criterion
from pdpetsc.errors import InputError

SHORT_CRACK = 3.0
"""Horizons that a crack is long at least, if fields around its tip are to be those of fracture mechanics."""
NOT_STEEP = 0.02
"""Part of the critical stretch over which bonds that soften must fade, not to be brittle."""


def _critical_stretch(case: Case, known: Known, name: str) -> float | None:
    """Of a material whose bonds fail by their stretch; the largest one."""
    keys, material = case.damage[name], known.materials.get(name)
    if keys.criterion != "critical_stretch" or material is None:
        return None
    try:
        criterion: Any = Criterion.criteria[keys.criterion].from_case(keys, material)
        return float(criterion.critical.max())
    except InputError:
        return None  # the run says so


@rule
def breaks_at_large_strain(case: Case, known: Known) -> Iterator[str]:
    for name, keys in case.damage.items():
        stretch, material = _critical_stretch(case, known, name), known.materials.get(name)
        if not stretch or stretch <= LARGE_STRETCH:
            continue
        cause = "it follows from G_c, E and the horizon" if keys.critical is None else "it is given"
        remedy = 'take kinematics = "nonlinear"' if material.linear else "a law for large strains is needed there"
        yield (
            f"damage.{name}: bonds fail at a stretch of {100 * stretch:.3g} % ({cause}); check the units of E and G_c, "
            f"and if that is meant, {remedy}"
        )


@rule
def strength_of_the_lattice(case: Case, known: Known) -> Iterator[str]:
    for name, keys in case.damage.items():
        if getattr(keys, "G_c", None) is None or case.body.cracks or keys.along:
            continue
        stretch = _critical_stretch(case, known, name)
        said = f" (a stretch of {stretch:.3g})" if stretch else ""
        yield (
            f"damage.{name}.G_c: without a crack to grow, failure begins at a strength{said} that depends on the "
            "horizon; give critical from a measured strength, or put a crack into body.cracks"
        )


@rule
@of_lattices
def short_crack(case: Case, known: Known) -> Iterator[str]:
    widest = max(horizons(case).values(), default=0.0) * case.body.spacing
    size, origin = np.array(case.body.size), np.array(case.body.origin)
    for index, crack in enumerate(case.body.cracks if not (case.body.refine or case.body.zones) else ()):
        if not crack.start:
            continue
        ends = np.clip([crack.start, crack.to], origin, origin + size)
        length = math.dist(*ends)
        if length < SHORT_CRACK * widest:
            yield (
                f"body.cracks.{index}: is {length / widest:.2g} horizons long, too short for a field of its own around "
                f"the tip; take a smaller spacing, so that it is {SHORT_CRACK:g} at least"
            )


@rule
def softening_without_effect(case: Case, known: Known) -> Iterator[str]:
    for name, keys in case.damage.items():
        softening = getattr(keys, "softening", None)
        stretch = _critical_stretch(case, known, name) if softening else None
        if stretch and stretch - softening.s_min < NOT_STEEP * stretch:
            yield (
                f"damage.{name}.softening: bonds fade from {softening.s_min:g} to {stretch:.4g} only, which is as "
                "brittle and harder to solve; take a smaller s_min, or leave softening out"
            )
        if softening and softening.printed:
            yield (
                f"damage.{name}.softening.printed: jumps at both ends of the fading and is there for comparison; "
                "leave it out"
            )
