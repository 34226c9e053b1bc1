"""The tables of what is followed and of what must come out."""

from collections import Counter
from typing import Annotated, Literal

from pydantic import (
    Field,
    Strict,
    ValidationInfo,
    model_validator,
)

from pdpetsc.expressions import hint
from pdpetsc.quantities import QUANTITIES, components
from pdpetsc.schema.table import Table, error_at, exactly_one
from pdpetsc.schema.values import (
    Condition,
    Name,
    Normal,
    Positive,
    SetName,
    Vector,
    formula,
)


class Section(Table):
    """A plane through a point, or the part of it where a condition holds."""

    at: Vector
    normal: Normal
    where: Condition | None = None


MOST_POINTS = 100_000
"""Of a line."""
RESULTANTS = ("force", "moment")
"""What is read on a section."""
OF_A_CRACK = ("tip", "direction", "front", "radii")
"""Keys of a J-integral; the front in 3D only."""
OF_A_TIP = ("direction", "threshold", "set")
"""Keys of the position of a crack's tip."""
SQUARE = 1e-6
"""Cosine of an angle that is a right one."""


class Probe(Table):
    """A number, or a few, that is followed at a point, along a line, over a set or a section, or around a crack."""

    name: Name
    field: Literal[*QUANTITIES, "moment", "J", "crack_tip"]
    component: str | None = None
    at: Vector | None = None
    line: Annotated[tuple[Vector, Vector, Annotated[int, Field(ge=2, le=MOST_POINTS)]], Strict(False)] | None = None
    set: SetName | None = None
    section: Section | None = None
    reduce: Literal["sum", "mean", "min", "max", "error"] | None = None
    exact: formula("t") | None = None
    tip: Vector | None = None
    direction: Normal | None = None
    front: Normal | None = None
    radii: Annotated[tuple[Positive, Positive], Strict(False)] | None = None
    threshold: Annotated[float, Field(gt=0, lt=1)] | None = None

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo):
        if self.field == "J":
            return self._around_a_crack(info.context.dim)
        if self.field == "crack_tip":
            return self._of_a_tip()
        if self.threshold is not None:
            raise error_at("threshold", "goes with field = 'crack_tip'")
        if wrong := [key for key in OF_A_CRACK if getattr(self, key) is not None]:
            raise error_at(wrong[0], "is that of a crack: it goes with field = 'J'")
        exactly_one(self, "at", "line", "set", "section")
        if self.section is None and self.field == "moment":
            raise ValueError("field moment is that of a section: give section = { at = ..., normal = ... }")
        if self.section is not None and self.field not in RESULTANTS:
            raise ValueError(f"a section has a force and a moment, not {self.field}: field = 'force' or 'moment'")
        if self.field == "moment" and info.context.dim == 1:
            raise ValueError("a section of a body of one dimension has no moment")
        names = self._components(info.context.dim)
        if self.component is not None and self.component not in names:
            choices = f"choices: {', '.join(names)}" if names else "it is a scalar"
            raise ValueError(f"field {self.field} has no component {self.component!r}; {choices}")
        if (self.set is None) != (self.reduce is None):
            raise ValueError("set and reduce go together")
        if (self.reduce == "error") != (self.exact is not None):
            raise ValueError("reduce = 'error' and exact go together")
        if self.reduce == "error" and names and self.component is None:
            raise ValueError("reduce = 'error' needs a component")
        return self

    def _of_a_tip(self):
        if self.direction is None:
            raise error_at("direction", "is missing: field = 'crack_tip' needs the direction in which the tip goes")
        if wrong := [key for key in sorted(self.model_fields_set) if key not in ("name", "field", *OF_A_TIP)]:
            raise error_at(wrong[0], f"does not go with field = 'crack_tip', which takes {', '.join(OF_A_TIP)}")
        return self

    def _around_a_crack(self, dim: int):
        if dim == 1:
            raise ValueError("a body of one dimension has no J-integral: its cracks have no tip")
        wanted = OF_A_CRACK if dim == 3 else tuple(key for key in OF_A_CRACK if key != "front")
        if missing := [key for key in wanted if getattr(self, key) is None]:
            raise error_at(missing[0], f"is missing: field = 'J' needs {', '.join(wanted)} in {dim}D")
        if wrong := [key for key in sorted(self.model_fields_set) if key not in ("name", "field", *wanted)]:
            raise error_at(wrong[0], f"does not go with field = 'J' in {dim}D, which takes {', '.join(wanted)}")
        if self.radii[0] >= self.radii[1]:
            raise error_at("radii", f"the second must be the larger one, not {list(self.radii)}")
        if dim == 3 and abs(sum(a * b for a, b in zip(self.direction, self.front))) > SQUARE:
            raise error_at("direction", "must be at right angles to front")
        return self

    def is_number(self, dim: int) -> bool:
        """Whether a single number is read, not a list."""
        if self.field in ("J", "crack_tip"):
            return True
        return self.line is None and (self.component is not None or not self._components(dim))

    def _components(self, dim: int) -> tuple[str, ...]:
        if self.field == "moment":  # a vector in 3D, about the normal of the plane in 2D
            return components("force", dim) if dim == 3 else ()
        return components(self.field, dim)


class Expect(Table):
    """What a value of summary.json must come to, and where the number is from."""

    value: str
    equals: float | Annotated[tuple[float, ...], Strict(False)] | None = None
    below: float | None = None
    above: float | None = None
    rtol: Annotated[float, Field(ge=0)] = 0.0
    atol: Annotated[float, Field(ge=0)] = 0.0
    source: str

    @model_validator(mode="after")
    def _check(self):
        exactly_one(self, "equals", "below", "above")
        return self


SUMMARY = (
    "probes", "steps", "energies", "fracture", "balance", "particles", "bonds", "limit_points", "timings",
    "peak_memory_mb", "extremes", "refinements",
)  # fmt: skip
"""Entries of summary.json that hold numbers."""
HISTORY = (
    "step", "time", "load_factor", "arc_length", "newton_iterations", "linear_iterations", "residual_scale",
    "relative_residual", "rounding_floor", "broken_bonds", "passes", "most_newton_iterations", "seconds",
    "external_work", "stored_energy", "dissipated", "held_particles", "crack_area", "particles",
)  # fmt: skip
"""Columns of history.csv before the probes."""


def different_names(probes: tuple[Probe, ...]) -> tuple[Probe, ...]:
    names = [probe.name for probe in probes]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"two probes have the name {twice[0]!r}")
    taken = [name for name in names if name in HISTORY]
    if taken:
        raise ValueError(f"a probe cannot be called {taken[0]!r}: that is a column of history.csv already")
    return probes


def of_known_probes(expectations: tuple[Expect, ...], info: ValidationInfo) -> tuple[Expect, ...]:
    names = [probe.name for probe in info.data.get("probe", ())]
    for expectation in expectations if "probe" in info.data else ():
        head, _, name = expectation.value.partition(".")
        if head not in SUMMARY:
            choices = f"choices begin with {', '.join(SUMMARY)}"
            raise ValueError(f"{expectation.value!r} names nothing in summary.json{hint(head, SUMMARY)}; {choices}")
        if head in ("probes", "extremes") and name.partition(".")[0] not in names:
            choices = f"choices: {', '.join(names) or 'none'}"
            raise ValueError(f"{expectation.value!r} names no probe{hint(name, names)}; {choices}")
    return expectations
