"""Rules of loads and steps."""

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from pdpetsc.advice.base import LARGE_STRETCH, Known, of_lattices, rule
from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.quantities import AXES

STRIDE = 0.1
"""Part of the body's largest side that a load step may move what it prescribes."""


def _values(case: Case, load, times: np.ndarray) -> np.ndarray:
    """Of a load (times, places) at the corners and the middle of the body; none where they are no numbers."""
    corners = np.array(list(product(*[(0.0, 0.5, 1.0)] * case.body.dim)))
    X = np.array(case.body.origin) + corners * np.array(case.body.size)
    place = dict(zip(("X", "Y", "Z"), X.T)) | {"spacing": np.full(len(X), case.body.spacing)}
    if load.kind == "traction":
        place |= {name: np.ones(len(X)) for name in ("NX", "NY", "NZ")[: case.body.dim]}
    try:
        return np.array([load.value(**place, t=np.full(len(X), t)) for t in times])
    except InputError:
        return np.zeros((0, len(X)))


def _times(case: Case) -> np.ndarray:
    """Of the load steps, a thousand of them at most."""
    return np.linspace(0.0, case.solver.end_time, min(case.solver.steps, 1000) + 1)


@rule
@of_lattices
def nothing_happens(case: Case, known: Known) -> Iterator[str]:
    values = [_values(case, load, _times(case)) for load in case.load]
    if not any(np.any(value != 0) or not len(value) for value in values) and not case.initial:
        yield 'load: nothing pulls, pushes or moves the body; give a [[load]] a value that is not zero, as "1e-3 * t"'


@rule
@of_lattices
def all_at_once(case: Case, known: Known) -> Iterator[str]:
    quasi_static = not case.solver.in_time and case.solver.control == "load" and case.solver.steps > 1
    acts = any(np.any(_values(case, load, np.array([0.0, 1.0])) != 0) for load in case.load)
    if quasi_static and acts and not any("t" in load.value.names for load in case.load):
        yield (
            f"load: no value depends on t, so that the first of {case.solver.steps} steps takes all and the others "
            'nothing; write "value * t", or steps = 1'
        )


@rule
@of_lattices
def long_strides(case: Case, known: Known) -> Iterator[str]:
    if case.solver.in_time or case.solver.control != "load" or all(m.linear for m in known.materials.values()):
        return
    side, strides = max(case.body.size), {}
    for index, load in enumerate(case.load):
        if load.kind == "displacement":
            values = _values(case, load, _times(case))
            stride = float(np.abs(np.diff(values, axis=0)).max(initial=0.0))
            strides[index] = stride * min(1.0, 1000 / case.solver.steps)
    index = max(strides, key=strides.get, default=None)
    if index is not None and strides[index] > 1.001 * STRIDE * side:
        steps = math.ceil(case.solver.steps * strides[index] / (STRIDE * side))
        yield (
            f"load.{index}: a step prescribes {strides[index]:.3g}, {100 * strides[index] / side:.3g} % of the body's "
            f"largest side, and may have to be cut; take solver.steps = {steps}"
        )


@rule
def free_to_move(case: Case, known: Known) -> Iterator[str]:
    if case.solver.in_time or not case.load:
        return
    held = {axis for load in case.load if load.kind == "displacement" for axis in load.component}
    free = [AXES[axis] for axis in range(case.body.dim) if axis not in held]
    if free:
        yield (
            f"load: nothing prescribes the displacement in {' and '.join(free)}, so that there is no single "
            "equilibrium; hold a set, or one particle of it ({ nearest = ... }), in that direction"
        )


@rule
@of_lattices
def enormous_loads(case: Case, known: Known) -> Iterator[str]:
    stiffest = max(getattr(spec, "E", math.inf) for spec in case.material.values())
    *smaller, _ = sorted(case.body.size)
    area = math.prod(smaller) * (case.body.thickness if case.body.dim < 3 else 1.0)
    for index, load in enumerate(case.load):
        per_area = {"pressure": 1.0, "traction": 1.0, "force": 1 / area}.get(load.kind)
        stress = float(np.abs(_values(case, load, _times(case))).max(initial=0.0)) * (per_area or 0.0)
        if stress > LARGE_STRETCH * stiffest:
            yield (
                f"load.{index}: is a stress of about {stress / stiffest:.3g} E; check the units of value, E"
                f"{', size and thickness' if load.kind == 'force' else ''}"
            )


@rule
@of_lattices
def thickness_left_out(case: Case, known: Known) -> Iterator[str]:
    body = case.body
    forces = [index for index, load in enumerate(case.load) if load.kind == "force"]
    if body.dim < 3 and forces and "thickness" not in body.model_fields_set:
        what = "thickness" if body.dim == 2 else "cross-section"
        yield (
            f"load.{forces[0]}: a total force acts on a body whose {what} is left at 1, over which it is shared; give "
            "body.thickness, be it 1"
        )


@rule
def unstable_step(case: Case, known: Known) -> Iterator[str]:
    solver = case.solver
    if solver.mode != "verlet" or known.stable is None:
        return
    given = solver.time_step or (solver.end_time / solver.steps if "steps" in solver.model_fields_set else 0.0)
    if given > known.stable:
        place = "time_step" if solver.time_step else "steps"
        yield (
            f"solver.{place}: a step of {given:.3g} is above the safe one of about {known.stable:.3g}; leave {place} "
            "out, and 0.9 of the stable step is taken"
        )
