"""Rules of materials."""

import math
from collections.abc import Iterator

from pdpetsc.advice.base import Known, horizons, rule
from pdpetsc.case import Case
from pdpetsc.materials.bond_based import SAME_RATIO, fixed_poisson

INCOMPRESSIBLE = 0.45
"""Poisson's ratio beyond which a body hardly changes its volume."""
SLOWEST, FASTEST = 10.0, 5e4
"""Speeds of sound [m/s] that no solid has: rubber has some 40, diamond 1.8e4."""
STIFFEST = 2e12
"""Young's modulus [Pa] that no solid has: diamond has 1.2e12."""
NEWTONS = {"N": 1.0, "kN": 1e3, "MN": 1e6}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}


@rule
def nearly_incompressible(case: Case, known: Known) -> Iterator[str]:
    for name, spec in case.material.items():
        nu = getattr(spec, "nu", None)
        free = case.body.dim == 1 or (case.body.dim == 2 and getattr(spec, "plane", "strain") == "stress")
        if nu is None or nu <= INCOMPRESSIBLE or free:
            continue
        ratio = 2 * (1 + nu) / (3 * (1 - 2 * nu))
        yield (
            f"material.{name}.nu = {nu:g}: the bulk modulus is {ratio:.3g} times the shear modulus, which makes "
            f"pressures rough and iterative solvers slow; compare with nu = {INCOMPRESSIBLE}"
        )


@rule
def wrong_shear_modulus(case: Case, known: Known) -> Iterator[str]:
    for name, spec in case.material.items():
        fixed = fixed_poisson(case.body.dim, spec.plane) if spec.model == "bond" else None
        if fixed and spec.nu is not None and abs(spec.nu - fixed) >= SAME_RATIO:
            yield (
                f"material.{name}.nu = {spec.nu:g}: bonds have {fixed:.4g}, so that the bulk modulus is right and the "
                'shear modulus is not; model = "ordinary" has both'
            )


@rule
def zero_energy_modes(case: Case, known: Known) -> Iterator[str]:
    for name, m in horizons(case).items():
        spec = case.material[name]
        if spec.model == "correspondence" and spec.stabilisation.kind == "none" and m > 1.5:
            yield (
                f'material.{name}.stabilisation: with kind = "none" and a horizon of {m:g} spacings displacements may '
                "oscillate from particle to particle; leave the key out, its default needs no tuning"
            )


@rule
def stiffer_than_diamond(case: Case, known: Known) -> Iterator[str]:
    units = case.units
    if units.length not in METRES or units.force not in NEWTONS:
        return
    pascals = NEWTONS[units.force] / METRES[units.length] ** 2
    for name, spec in case.material.items():
        if getattr(spec, "E", 0.0) * pascals > STIFFEST:
            yield (
                f"material.{name}.E = {spec.E:g}: is stiffer than any solid with {units.force} and {units.length}; "
                f"give it in {units.force}/{units.length}^2, or name your units in [units]"
            )


@rule
def mixed_units(case: Case, known: Known) -> Iterator[str]:
    units = case.units
    for name, spec in case.material.items():
        if spec.density is None or not hasattr(spec, "E") or units.length not in METRES or units.time not in SECONDS:
            continue
        speed = math.sqrt(spec.E / spec.density)
        metric = speed * METRES[units.length] / SECONDS[units.time]
        if metric > FASTEST or (metric < SLOWEST and spec.density > 100):
            yield (
                f"material.{name}: E and density give a speed of sound of {speed:.3g} {units.length}/{units.time}, "
                "which no solid has; check their units (Pa and kg/m^3, or MPa and t/mm^3), or name yours in [units]"
            )
