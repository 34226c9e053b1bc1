"""Rules of horizons."""

import math
from collections.abc import Iterator
from itertools import product

from pdpetsc.advice.base import Known, horizons, of_lattices, rule
from pdpetsc.case import Case

FEW = 2.0
"""Spacings below which a horizon leaves too few neighbours in 2D and 3D, but for correspondence materials."""
CRACKING, WIDE = 2.9, 6.1
"""Spacings below which cracks follow the lattice, and beyond which a horizon only costs."""
ON_LATTICE = 1e-3
"""Relative distance of a horizon from particles on its edge."""


@rule
def few_neighbours(case: Case, known: Known) -> Iterator[str]:
    for name, m in horizons(case).items() if case.body.dim > 1 else ():
        fails = name in case.damage
        if m < FEW and case.material[name].model != "correspondence":
            yield (
                f"material.{name}: with a horizon of {m:g} spacings the model {case.material[name].model!r} has the "
                "nearest neighbours alone, which hardly resist shear; take 2.015 or 3.015"
            )
        elif fails and m < CRACKING:
            yield f"material.{name}: with a horizon of {m:g} spacings cracks follow the lattice; take 3.015 or more"


@rule
def wide_horizon(case: Case, known: Known) -> Iterator[str]:
    for name, m in horizons(case).items():
        if m > WIDE:
            yield (
                f"material.{name}: a horizon of {m:g} spacings costs {(m / 3) ** case.body.dim:.0f} times the bonds of "
                "one of 3 and is hardly more accurate; take a smaller horizon, or a larger spacing"
            )


@rule
@of_lattices
def horizon_on_the_lattice(case: Case, known: Known) -> Iterator[str]:
    for name, m in horizons(case).items():
        reach = m * (1 + case.body.horizon_tolerance)
        square = round(reach**2)
        steps = range(math.isqrt(square) + 1)
        has_particles = any(sum(i * i for i in place) == square for place in product(steps, repeat=case.body.dim))
        counted_whole = case.material[name].partial_volume == "none"
        if counted_whole and has_particles and abs(reach / math.sqrt(square) - 1) < ON_LATTICE:
            yield (
                f"material.{name}: particles lie exactly on the edge of a horizon of {m:g} spacings, and where cells "
                f"are stretched some are in and some out; take {m + 0.015:g}"
            )


@rule
@of_lattices
def thinner_than_a_horizon(case: Case, known: Known) -> Iterator[str]:
    thinnest = min(case.body.size)
    for name, m in horizons(case).items() if case.body.dim > 1 else ():
        if case.material[name].where == "all" and thinnest < m * case.body.spacing:
            yield (
                f"body.size: {thinnest:g} is less than a horizon ({m * case.body.spacing:.3g}), so that all of the "
                "body is surface; take a smaller spacing, five rows of particles or more"
            )
