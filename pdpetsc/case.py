"""Case files: TOML in, a validated and frozen description out.

The tables of a case file are the models below, one for each; their fields are the keys. A mistake is an `InputError`
of one sentence with file, key path and what would be right. Nothing here knows MPI or PETSc.
"""

import math
import re
import reprlib
import tomllib
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    Strict,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError

from pdpetsc.errors import InputError
from pdpetsc.expressions import Expression, hint

BUNDLED = Path(__file__).parent / "cases"
AXES = ("x", "y", "z")
COORDINATES = ("X", "Y", "Z")
FACES = ("left", "right", "bottom", "top", "back", "front")  # two for each direction, the lower one first
RANKS = {"u": 1, "F": 2, "stress": 2, "strain": 2, "energy": 0, "reaction": 1, "force": 1}  # of the fields, as tensors


# What a value may be. Validators find the dimension and the names of the sets in `info.context`, a Setting.


class Setting(NamedTuple):
    """What all tables of a case must agree on."""

    dim: int
    sets: tuple[str, ...]


def _formula(*more_names: str, condition: bool = False):
    """Return the type of a number or expression in the reference coordinates and further variables."""

    def parse(value: Any, info: ValidationInfo) -> Expression:
        try:
            expression = Expression(value, [*COORDINATES[: info.context.dim], *more_names])
        except InputError as error:
            raise ValueError(str(error)) from None
        if expression.is_condition and not condition:
            raise ValueError(f"{value!r} is a condition where a number is needed, as in where(X < 0, 1, 2)")
        if condition and not expression.is_condition:
            raise ValueError(f"{value!r} is a number where a condition is needed, such as X < 0")
        return expression

    return Annotated[Expression, PlainValidator(parse)]


def _name(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", value):
        raise ValueError("a name begins with a letter and holds letters, digits, _ and - only")
    return value


def _new_set(value: str) -> str:
    if value == "all":
        raise ValueError("the set 'all' is always there and cannot be another")
    return value


def _set_name(value: str, info: ValidationInfo) -> str:
    if value not in info.context.sets:
        choices = info.context.sets
        raise ValueError(f"there is no set {value!r}{hint(value, choices)}; choices: {', '.join(choices)}")
    return value


def _face(value: str, info: ValidationInfo) -> str:
    choices = FACES[: 2 * info.context.dim]
    if value not in choices:
        raise ValueError(
            f"there is no such face in {info.context.dim}D{hint(value, choices)}; choices: {', '.join(choices)}"
        )
    return value


def _as_long_as_dimension(value: tuple, info: ValidationInfo) -> tuple:
    if len(value) != info.context.dim:
        raise ValueError(f"needs {info.context.dim} number(s), one for each entry of body.size, not {len(value)}")
    return value


def _zeros_if_missing(value: Any, info: ValidationInfo) -> Any:
    return (0.0,) * info.context.dim if value is None else value


def _axes(value: Any, info: ValidationInfo) -> tuple[int, ...]:
    """Turn "x", a list of axes or "all" into the indices of the axes."""
    axes = list(AXES[: info.context.dim])
    chosen = axes if value == "all" else [value] if isinstance(value, str) else value
    if not isinstance(chosen, list) or not chosen or any(c not in axes or chosen.count(c) > 1 for c in chosen):
        raise ValueError(f"must be one of {', '.join(axes)}, a list of them, or 'all', not {value!r}")
    return tuple(axes.index(axis) for axis in chosen)


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and -1e300 < value < 1e300  # an int of TOML may be beyond every float


def _normal(value: Any, info: ValidationInfo) -> tuple[float, ...]:
    """Turn "x", "-x" ... or a vector into a unit vector."""
    axes = AXES[: info.context.dim]
    if isinstance(value, str) and value.removeprefix("-") in axes:
        sign = -1.0 if value.startswith("-") else 1.0
        return tuple(sign if axis == value[-1] else 0.0 for axis in axes)
    if not isinstance(value, list) or len(value) != len(axes) or not all(map(_is_finite, value)) or not any(value):
        choices = f"{', '.join(axes)}, one of them with a minus, or {len(axes)} numbers that are not all zero"
        raise ValueError(f"must be one of {choices}, not {value!r}")
    return tuple(v / math.hypot(*value) for v in value)


def _option_value(value: Any) -> str | int | float | bool:
    if not isinstance(value, str | int | float) or re.search(r'["\n]', str(value)):
        raise ValueError("must be a number, true, false or text without quotes and line breaks")
    return value


def _option_name(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z_]\w*", value):
        raise ValueError("a PETSc option is written here without its dash and with letters, digits and _ only")
    return value


class LayerWidth(NamedTuple):
    """Thickness of a layer of fictitious particles."""

    number: float
    in_horizons: bool

    def length(self, horizon: float) -> float:
        """Return the thickness as a length."""
        return self.number * horizon if self.in_horizons else self.number


def _layer_width(value: Any) -> LayerWidth:
    found = re.fullmatch(r"(?:(\d+\.?\d*) )?horizons?", value) if isinstance(value, str) else None
    width = LayerWidth(float(found[1] or 1), True) if found else LayerWidth(value, False)
    if not _is_finite(width.number) or width.number <= 0:
        raise ValueError(f"must be 'horizon', '2 horizon' or a positive length, not {value!r}")
    return width


Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Name = Annotated[str, AfterValidator(_name)]
SetName = Annotated[str, AfterValidator(_set_name)]
Vector = Annotated[tuple[float, ...], Strict(False), AfterValidator(_as_long_as_dimension)]
Axes = Annotated[tuple[int, ...], PlainValidator(_axes)]
FieldName = Literal["u", "F", "stress", "strain", "energy", "reaction", "force"]
Condition = _formula("spacing", condition=True)


# The tables.


def _error_at(key: str, message: str) -> PydanticCustomError:
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
                raise _error_at(key, f"unknown key{hint(key, choices)}; choices: {', '.join(choices)}")
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

    factor: _formula() | None = None
    length: _formula() | None = None

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
    origin: Annotated[Vector, BeforeValidator(_zeros_if_missing)] = Field(None, validate_default=True)
    horizon: Horizon
    keep: Condition | None = None
    layers: dict[Annotated[str, AfterValidator(_face)], Annotated[LayerWidth, PlainValidator(_layer_width)]] = {}

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
    """Control of zero-energy modes; without a strength, the default of its kind."""

    kind: Literal["none", "spring", "silling"]
    strength: Annotated[float, Field(ge=0)] | None = None


class Material(Table):
    """A correspondence material and the set that it fills."""

    model: Literal["correspondence"]
    E: Positive
    nu: Annotated[float, Field(gt=-1, lt=0.5)]
    density: Positive | None = None
    plane: Literal["strain"] = "strain"
    elasticity: Literal["hencky", "saint_venant_kirchhoff", "neo_hookean"] = "hencky"
    influence: Literal["constant", "inverse", "linear", "cubic", "gaussian"] = "constant"
    stabilisation: Stabilisation = Stabilisation(kind="silling")
    partial_volume: Literal["none", "linear"] = "none"
    quadrature: Literal["plain"] = "plain"
    where: SetName = "all"


class _ComponentLoad(Table):
    set: SetName
    component: Axes
    value: _formula("t")


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
    normal: Annotated[tuple[float, ...], PlainValidator(_normal)]
    value: _formula("t")
    width: Positive | None = None


Load = Displacement | BodyForce | Force | Pressure
LOAD_KINDS = [get_args(load.model_fields["kind"].annotation)[0] for load in get_args(Load)]


def _of_known_kind(table: Any) -> Any:
    if isinstance(table, dict) and table.get("kind") not in LOAD_KINDS:
        raise _error_at("kind", f"must be one of {', '.join(LOAD_KINDS)}")
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
    exact: _formula("t") | None = None

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo):
        _exactly_one(self, "at", "line", "set")
        rank = RANKS[self.field]
        names = ["".join(axes) for axes in product(AXES[: info.context.dim], repeat=rank)] + ["magnitude"]
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


def _different_names(probes: tuple[Probe, ...]) -> tuple[Probe, ...]:
    names = [probe.name for probe in probes]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"two probes have the name {twice[0]!r}")
    return probes


def _of_known_probes(expectations: tuple[Expect, ...], info: ValidationInfo) -> tuple[Expect, ...]:
    names = [probe.name for probe in info.data.get("probe", ())]
    for expectation in expectations if "probe" in info.data else ():
        head, _, name = expectation.value.partition(".")
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
    sets: dict[Annotated[Name, AfterValidator(_new_set)], ParticleSet] = {}
    material: Annotated[dict[Name, Material], Field(min_length=1)]
    load: Annotated[tuple[AnyLoad, ...], Strict(False)] = ()
    solver: Solver = Solver()
    output: Output = Output()
    probe: Annotated[tuple[Probe, ...], Strict(False), AfterValidator(_different_names)] = ()
    expect: Annotated[tuple[Expect, ...], Strict(False), AfterValidator(_of_known_probes)] = ()
    petsc: dict[Annotated[str, AfterValidator(_option_name)], Annotated[Any, PlainValidator(_option_value)]] = {}


class Case(Description):
    """A validated case, and where it comes from.

    Attributes:
        name: Stem of the file's name.
        variant: The variant chosen, if any.
        path: The file as messages name it.
        overridden: Whether entries were overridden on the command line; the expectations then do not count.
        document: The merged plain tables, from which `from_document` makes this case again.
    """

    name: str
    variant: str | None
    path: str
    overridden: bool
    document: dict[str, Any]

    @classmethod
    def from_document(cls, document: dict, name: str, variant: str | None, path: str, overridden: bool) -> "Case":
        """Validate merged tables.

        Raises:
            InputError: The first mistake, with file and key path, and how many more there are.
        """
        try:
            description = Description.model_validate(document, context=_setting(document))
        except ValidationError as error:
            raise InputError(f"{path}: {_explain(error, document)}") from None
        _place_expressions(description, (), document, path)
        origin = {"name": name, "variant": variant, "path": path, "overridden": overridden, "document": document}
        return cls.model_construct(**dict(description), **origin)


# From the command line to a case.


def bundled() -> dict[str, Path]:
    """Return the files of the cases that come with the package, by name."""
    return {path.stem: path for path in sorted(BUNDLED.glob("*.toml"))}


def catalogue() -> list[tuple[str, str, list[str]]]:
    """Return name, title and variants of every bundled case."""
    documents = {name: _read(path) for name, path in bundled().items()}
    return [
        (name, document.get("title", ""), list(document.get("variant", {}))) for name, document in documents.items()
    ]


def is_case(word: str) -> bool:
    """Tell whether a word of the command line names a case: FILE.toml, BUNDLED, or one of them with :VARIANT."""
    return re.search(r"\.toml(:[^/]*)?$", word) is not None or word.partition(":")[0] in bundled()


def load(argument: str, overrides: tuple[str, ...] | list[str] = ()) -> Case:
    """Read a case.

    Args:
        argument: A path that ends in .toml or the name of a bundled case, with :VARIANT for a variant.
        overrides: Texts "key=value" with a dotted key and a TOML value; other text is taken as a string.

    Raises:
        InputError: There is no such case, or something in it or in an override is wrong.
    """
    word, variant = re.fullmatch(r"(.*\.toml|.*?)(?::([^:/]*))?", argument, re.DOTALL).groups()
    path = Path(word) if word.endswith(".toml") else bundled().get(word)
    if path is None:
        names = list(bundled())
        choices = f"bundled cases: {', '.join(names)}; a case of your own is a path that ends in .toml"
        raise InputError(f"there is no case {word!r}{hint(word, names)}; {choices}")
    document = _with_variant(_read(path), variant, _shown(path))
    for override in overrides:
        _override(document, override)
    return Case.from_document(document, path.stem, variant, _shown(path), bool(overrides))


def _shown(path: Path) -> str:
    return path.name if path.parent == BUNDLED else str(path)


def _read(path: Path) -> dict:
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError:
        reason = "there is no such file"
    except OSError as error:
        reason = f"cannot be read: {error.strerror.lower()}"
    except UnicodeDecodeError:
        reason = "is not UTF-8 text"
    except RecursionError:
        reason = "is not valid TOML: nested too deeply"
    except ValueError as error:
        reason = f"is not valid TOML: {error}"
    raise InputError(f"{_shown(path)}: {reason}")


def _with_variant(document: dict, variant: str | None, place: str) -> dict:
    """Merge a variant into the other tables; the expectations of the base do not hold for a variant."""
    base = {key: value for key, value in document.items() if key != "variant"}
    variants = document.get("variant", {})
    if not isinstance(variants, dict) or not all(isinstance(table, dict) for table in variants.values()):
        raise InputError(f"{place}: variant: must be tables, [variant.NAME]")
    if variant is None:
        return base
    if variant not in variants:
        choices = f"choices: {', '.join(variants)}" if variants else "it has none"
        raise InputError(f"{place}: there is no variant {variant!r}{hint(variant, variants)}; {choices}")
    base.pop("expect", None)
    return _merged(base, variants[variant])


def _merged(base: dict, changes: dict) -> dict:
    """Return tables with changes merged into them entry by entry; anything but a table is replaced whole."""
    merged = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merged(base[key], value) if both else value
    return merged


def _override(document: dict, override: str) -> None:
    """Set one entry; an entry of a list is named by its index, as in load.0.value."""
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set {override}: must be key=value, for example body.spacing=0.01")
    inner: Any = document
    *parents, last = key.strip().split(".")

    def place(part: str) -> str | int:
        entries = inner if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else ()
        if isinstance(inner, dict) or part in map(str, entries):
            return part if isinstance(inner, dict) else int(part)
        raise InputError(f"--set {override}: there is no entry {part!r} to set")

    for part in parents:
        if isinstance(inner, dict):
            inner.setdefault(part, {})
        inner = inner[place(part)]
    inner[place(last)] = _toml_value(text)


def _toml_value(text: str) -> Any:
    try:
        document = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return document["value"] if len(document) == 1 else text


# From what pydantic says to what a person can use.

reprlib.aRepr.maxstring = 80
_WANTED = {
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
}


def _setting(document: dict) -> Setting:
    """Find dimension and sets in tables that may still be wrong anywhere."""
    body, sets = document.get("body"), document.get("sets")
    size = body.get("size") if isinstance(body, dict) else None
    dim = len(size) if isinstance(size, list) and 1 <= len(size) <= 3 else 3
    return Setting(dim, ("all", *sets) if isinstance(sets, dict) else ("all",))


def _explain(error: ValidationError, document: dict) -> str:
    errors = error.errors(include_url=False)
    places = [".".join(map(str, _key_path(e, document))) for e in errors]
    more = len(set(places)) - 1
    more_text = f" (and {more} more mistake{'s' if more > 1 else ''})" if more else ""
    return f"{places[0]}: {_sentence(errors[0])}{more_text}"


def _key_path(error: dict, document: dict) -> list:
    """Return the path of an error as keys of the document, without pydantic's own remarks on the way."""
    path = _keys_in(error["loc"], document)
    missing = error["loc"][-1:] if error["type"] == "missing" else ()
    return [*path, *missing, *([error["ctx"]["key"]] if error["type"] == "at_key" else [])]


def _keys_in(path: tuple, document: Any) -> list:
    keys = []
    for part in path:
        inside = (
            (*document,) if isinstance(document, dict) else range(len(document)) if isinstance(document, list) else ()
        )
        if part in inside:
            keys.append(part)
            document = document[part]
    return keys


def _sentence(error: dict) -> str:
    kind, value = error["type"], error["input"]
    if kind == "missing":
        return "is missing"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    if kind == "at_key":
        return error["ctx"]["message"]
    if kind in ("too_short", "too_long"):
        limits = error["ctx"]
        bound = f"at least {limits['min_length']}" if kind == "too_short" else f"at most {limits['max_length']}"
        return f"must have {bound} entries, not {limits['actual_length']}"
    wanted = _WANTED.get(kind, error["msg"].replace("Input should be", "must be"))
    shown = "a table" if isinstance(value, dict) else reprlib.repr(value)
    return f"{wanted}, not {shown}"


def _place_expressions(value: Any, path: tuple, document: dict, file: str) -> None:
    """Tell every expression where it stands, for messages at run time."""
    if isinstance(value, Expression):
        value.place = f"{file}: {'.'.join(map(str, _keys_in(path, document)))}"
    elif isinstance(value, BaseModel | dict):
        for key, inner in value if isinstance(value, BaseModel) else value.items():
            _place_expressions(inner, (*path, key), document, file)
    elif isinstance(value, tuple):
        for index, inner in enumerate(value):
            _place_expressions(inner, (*path, index), document, file)
