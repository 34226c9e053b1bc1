"""The tables of a case file, one model for each; their fields are the keys."""

from itertools import product
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    Strict,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError

from pdpetsc.expressions import hint
from pdpetsc.schema.values import (
    AXES,
    RANKS,
    Axes,
    Condition,
    Count,
    FieldName,
    LayerWidth,
    Name,
    Positive,
    SetName,
    Vector,
    formula,
    known_face,
    layer_width,
    new_set,
    option_name,
    option_value,
    unit_normal,
    zeros_if_missing,
)


def error_at(key: str, message: str) -> PydanticCustomError:
    """Return an error of one entry, found by a validator of the whole table."""
    return PydanticCustomError("at_key", "{message}", {"message": message, "key": key})


class Table(BaseModel):
    """What all tables have in common: unknown keys and wrong types are errors, and nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    used_before: ClassVar[tuple[str, ...]] = ()  # keys that are gone when the table is validated

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, table: Any) -> Any:
        """Report an unknown key before the keys that are then missing, and name the choices."""
        for key in table if isinstance(table, dict) else ():
            if key not in cls.model_fields:
                choices = [*cls.model_fields, *cls.used_before]
                raise error_at(key, f"unknown key{hint(key, choices)}; choices: {', '.join(choices)}")
        return table


def _exactly_one(table: Table, *keys: str) -> None:
    if sum(getattr(table, key) is not None for key in keys) != 1:
        raise ValueError(f"needs exactly one of {', '.join(keys)}")


class Units(Table):
    """Labels for pictures; all numbers of a case are in one consistent set of units."""

    length: str = "m"
    force: str = "N"
    time: str = "s"


class Horizon(Table):
    """Radius of the families: a factor of the local spacing, or a length. A plain number is a factor."""

    factor: formula() | None = None
    length: formula() | None = None

    @model_validator(mode="before")
    @classmethod
    def _plain_number(cls, value: Any) -> Any:
        return {"factor": value} if type(value) in (int, float) else value

    @model_validator(mode="after")
    def _check(self):
        _exactly_one(self, "factor", "length")
        if self.factor and not self.factor.names and self.factor() <= 1:
            raise ValueError("must be greater than 1: it is a factor of the spacing")
        if self.length and not self.length.names and self.length() <= 0:
            raise ValueError("must be greater than 0")
        return self


class Body(Table):
    """A lattice of particles and what is cut out of it or added around it."""

    shape: Literal["box"] = "box"
    size: Annotated[tuple[Positive, ...], Strict(False), Field(min_length=1, max_length=3)]
    spacing: Positive
    thickness: Positive = 1.0  # out of plane in 2D, the cross-section in 1D
    origin: Annotated[Vector, BeforeValidator(zeros_if_missing)] = Field(None, validate_default=True)
    horizon: Horizon
    keep: Condition | None = None
    layers: dict[Annotated[str, AfterValidator(known_face)], Annotated[LayerWidth, PlainValidator(layer_width)]] = {}

    @property
    def dim(self) -> int:
        return len(self.size)

    @model_validator(mode="after")
    def _check(self):
        if self.dim == 3 and "thickness" in self.model_fields_set:
            raise ValueError("a body of three dimensions has no thickness")
        return self


class ParticleSet(Table):
    """The particles that meet a condition, or the one nearest to a point. A plain text is a condition."""

    where: Condition | None = None
    nearest: Vector | None = None

    @model_validator(mode="before")
    @classmethod
    def _plain_text(cls, value: Any) -> Any:
        return {"where": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _check(self):
        _exactly_one(self, "where", "nearest")
        return self


class Stabilisation(Table):
    """Control of zero-energy modes; without a strength, the one that needs no tuning."""

    kind: Literal["none", "spring", "silling"]
    strength: Annotated[float, Field(ge=0)] | None = None
    scale: Literal["horizon", "family"] | None = None

    @model_validator(mode="after")
    def _check(self):
        if self.scale and self.strength is None:
            raise ValueError("scale goes with strength")
        return self


def _plane(value: Any) -> Any:
    if value == "stress":
        raise ValueError("plane stress is not available for correspondence materials yet; only 'strain' is")
    return value


class Material(Table):
    """A correspondence material and the set that it fills."""

    model: Literal["correspondence"]
    E: Positive
    nu: Annotated[float, Field(gt=-1, lt=0.5)]
    density: Positive | None = None
    plane: Annotated[Literal["strain"], BeforeValidator(_plane)] = "strain"
    elasticity: Literal["hencky", "saint_venant_kirchhoff", "neo_hookean"] = "hencky"
    influence: Literal["constant", "inverse", "linear", "cubic", "gaussian"] = "constant"
    stabilisation: Stabilisation = Stabilisation(kind="silling")
    partial_volume: Literal["none", "linear"] = "none"
    quadrature: Literal["plain"] = "plain"
    where: SetName = "all"


class _ComponentLoad(Table):
    set: SetName
    component: Axes
    value: formula("t")


class Displacement(_ComponentLoad):
    """Prescribed components of the displacement."""

    kind: Literal["displacement"]


class BodyForce(_ComponentLoad):
    """Force per volume."""

    kind: Literal["body_force"]


class Force(_ComponentLoad):
    """Total force on a set, shared by volume."""

    kind: Literal["force"]


class Pressure(Table):
    """Pressure on a layer of particles, against the outward normal."""

    kind: Literal["pressure"]
    set: SetName
    normal: Annotated[tuple[float, ...], PlainValidator(unit_normal)]
    value: formula("t")
    width: Positive | None = None


Load = Displacement | BodyForce | Force | Pressure
LOAD_KINDS = [get_args(load.model_fields["kind"].annotation)[0] for load in get_args(Load)]


def _of_known_kind(table: Any) -> Any:
    if isinstance(table, dict) and table.get("kind") not in LOAD_KINDS:
        raise error_at("kind", f"must be one of {', '.join(LOAD_KINDS)}")
    return table


AnyLoad = Annotated[Load, Field(discriminator="kind"), BeforeValidator(_of_known_kind)]


class Solver(Table):
    """How the load is stepped; t runs from 0 to end_time."""

    mode: Literal["newton"] = "newton"
    steps: Count = 10
    end_time: Positive = 1.0
    adaptive: bool = True
    min_step: Positive | None = None
    max_step: Positive | None = None

    @model_validator(mode="after")
    def _check(self):
        if self.min_step and self.max_step and self.min_step > self.max_step:
            raise ValueError(f"min_step = {self.min_step} is greater than max_step = {self.max_step}")
        return self


class Output(Table):
    """What is written, each so many load steps."""

    every: Count = 1
    checkpoint: Count = 1
    picture: FieldName = "u"


class Probe(Table):
    """A number, or a few, that is followed at a point, along a line or over a set."""

    name: Name
    field: FieldName
    component: str | None = None
    at: Vector | None = None
    line: Annotated[tuple[Vector, Vector, Annotated[int, Field(ge=2)]], Strict(False)] | None = None
    set: SetName | None = None
    reduce: Literal["sum", "mean", "min", "max", "error"] | None = None
    exact: formula("t") | None = None

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo):
        _exactly_one(self, "at", "line", "set")
        rank = RANKS[self.field]
        names = ["".join(axes) for axes in product(AXES if rank == 2 else AXES[: info.context.dim], repeat=rank)] + [
            "magnitude"
        ]
        if self.component is not None and (rank == 0 or self.component not in names):
            choices = f"choices: {', '.join(names)}" if rank else "it is a scalar"
            raise ValueError(f"field {self.field} has no component {self.component!r}; {choices}")
        if (self.set is None) != (self.reduce is None):
            raise ValueError("set and reduce go together")
        if (self.reduce == "error") != (self.exact is not None):
            raise ValueError("reduce = 'error' and exact go together")
        if self.reduce == "error" and rank > 0 and self.component is None:
            raise ValueError("reduce = 'error' needs a component")
        return self


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
        _exactly_one(self, "equals", "below", "above")
        return self


SUMMARY = ("probes", "steps", "energies", "balance", "particles", "bonds", "timings", "peak_memory_mb")
"""Entries of summary.json that hold numbers."""
HISTORY = (
    "step", "time", "load_factor", "newton_iterations", "linear_iterations", "residual_scale", "relative_residual",
    "rounding_floor", "broken_bonds", "passes", "seconds",
)  # fmt: skip
"""Columns of history.csv before the probes."""


def _different_names(probes: tuple[Probe, ...]) -> tuple[Probe, ...]:
    names = [probe.name for probe in probes]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"two probes have the name {twice[0]!r}")
    taken = [name for name in names if name in HISTORY]
    if taken:
        raise ValueError(f"a probe cannot be called {taken[0]!r}: that is a column of history.csv already")
    return probes


def _of_known_probes(expectations: tuple[Expect, ...], info: ValidationInfo) -> tuple[Expect, ...]:
    names = [probe.name for probe in info.data.get("probe", ())]
    for expectation in expectations if "probe" in info.data else ():
        head, _, name = expectation.value.partition(".")
        if head not in SUMMARY:
            choices = f"choices begin with {', '.join(SUMMARY)}"
            raise ValueError(f"{expectation.value!r} names nothing in summary.json{hint(head, SUMMARY)}; {choices}")
        if head == "probes" and name.partition(".")[0] not in names:
            choices = f"choices: {', '.join(names) or 'none'}"
            raise ValueError(f"{expectation.value!r} names no probe{hint(name, names)}; {choices}")
    return expectations


class Description(Table):
    """A whole case file, after a variant and overrides have been merged into it."""

    used_before = ("variant",)

    title: str = ""
    units: Units = Units()
    body: Body
    sets: dict[Annotated[Name, AfterValidator(new_set)], ParticleSet] = {}
    material: Annotated[dict[Name, Material], Field(min_length=1)]
    load: Annotated[tuple[AnyLoad, ...], Strict(False)] = ()
    solver: Solver = Solver()
    output: Output = Output()
    probe: Annotated[tuple[Probe, ...], Strict(False), AfterValidator(_different_names)] = ()
    expect: Annotated[tuple[Expect, ...], Strict(False), AfterValidator(_of_known_probes)] = ()
    petsc: dict[Annotated[str, AfterValidator(option_name)], Annotated[Any, PlainValidator(option_value)]] = {}
