"""What a value of a case file may be: types with validators, which find what they must agree on in a `Setting`."""

import math
import re
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field, PlainValidator, Strict, ValidationInfo, WithJsonSchema, model_validator

from pdpetsc.errors import InputError, plain
from pdpetsc.expressions import Expression, hint
from pdpetsc.quantities import AXES, QUANTITIES
from pdpetsc.schema.table import Table, exactly_one

COORDINATES = ("X", "Y", "Z")
NORMALS = ("NX", "NY", "NZ")
SMALLEST, LARGEST = 1e-60, 1e60
"""Of numbers, whose squares and cubes, and ratios of those, stay floating-point numbers."""
FACES = ("left", "right", "bottom", "top", "back", "front")  # two for each direction, the lower one first


class Setting(NamedTuple):
    """What all tables of a case must agree on."""

    dim: int
    sets: tuple[str, ...]
    surfaces: tuple[str, ...]
    shape: str = "box"


def setting_of(document: dict) -> Setting:
    """Find shape, dimension and sets in tables that may still be wrong anywhere."""
    body, sets, surfaces = (document.get(key) for key in ("body", "sets", "surfaces"))
    body = body if isinstance(body, dict) else {}
    names = [tuple(named) if isinstance(named, dict) else () for named in (sets, surfaces)]
    shape = next((key for key in ("mesh", "points") if key in body), "box")
    shape = body["shape"] if body.get("shape") in ("box", "mesh", "points") else shape
    size, dimension = body.get("size"), body.get("dimension")
    if shape == "box":
        dim = len(size) if isinstance(size, list) and 1 <= len(size) <= 3 else 3
    else:
        dim = dimension if type(dimension) is int and 1 <= dimension <= 3 else 3
    border = ("border",) if shape == "mesh" or (shape == "box" and body.get("fitted") is True) else ()
    faces = FACES[: 2 * dim] if shape == "box" else ()
    return Setting(dim, ("all", *names[0]), (*faces, *border, *names[1]), shape)


def formula(*more_names: str, condition: bool = False, of_surface: bool = False, local: bool = True):
    """Return the type of a number or expression in the reference coordinates, the spacing where it is `local` to a
    particle, the normal where it is one `of_surface`, and further variables."""

    def parse(value: Any, info: ValidationInfo) -> Expression:
        dim = info.context.dim
        normal = NORMALS[:dim] if of_surface else ()
        try:
            names = [*COORDINATES[:dim], *normal, *(["spacing"] if local else []), *more_names]
            expression = Expression(value, names)
        except InputError as error:
            raise ValueError(str(error)) from None
        if expression.is_condition and not condition:
            raise ValueError(f"{value!r} is a condition where a number is needed, as in where(X < 0, 1, 2)")
        if condition and not expression.is_condition:
            raise ValueError(f"{value!r} is a number where a condition is needed, such as X < 0")
        return expression

    names = ["X", "Y", "Z", *(NORMALS if of_surface else ()), *(["spacing"] if local else []), *more_names]
    text = {"description": f"{'condition' if condition else 'number or expression'} of {', '.join(names)}"}
    json = {"type": "string" if condition else ["number", "string"]} | text
    return Annotated[Expression, PlainValidator(parse), WithJsonSchema(json)]


def valid_name(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", value):
        raise ValueError("a name begins with a letter and holds letters, digits, _ and - only")
    return value


def label(value: str) -> str:
    """A text that is drawn beside numbers."""
    if len(value) > 40 or "$" in value:
        raise ValueError("a unit is a short text without $")
    return plain(value)


def new_set(value: str) -> str:
    if value == "all":
        raise ValueError("the set 'all' is always there and cannot be another")
    return value


def new_surface(value: str, info: ValidationInfo) -> str:
    if value in (*(FACES if info.context.shape == "box" else ()), "border"):
        raise ValueError(f"the surface {value!r} is always there and cannot be another")
    return value


def known_surface(value: str, info: ValidationInfo) -> str:
    if info.context.shape == "points":
        raise ValueError(f"{value!r} cannot be, for points have no surface; let the load act on a set")
    if value not in info.context.surfaces:
        choices = info.context.surfaces
        fitted = "; the border of body.keep is one with body.fitted = true" if "border" not in choices else ""
        raise ValueError(f"there is no surface {value!r}{hint(value, choices)}; choices: {', '.join(choices)}{fitted}")
    return value


def known_set(value: str, info: ValidationInfo) -> str:
    if value not in info.context.sets:
        choices = info.context.sets
        raise ValueError(f"there is no set {value!r}{hint(value, choices)}; choices: {', '.join(choices)}")
    return value


def known_face(value: str, info: ValidationInfo) -> str:
    choices = FACES[: 2 * info.context.dim]
    if value not in choices:
        raise ValueError(
            f"there is no such face in {info.context.dim}D{hint(value, choices)}; choices: {', '.join(choices)}"
        )
    return value


def _as_long_as_dimension(value: tuple, info: ValidationInfo) -> tuple:
    if len(value) != info.context.dim:
        of = "entry of body.size" if info.context.shape == "box" else "dimension of the body (body.dimension)"
        raise ValueError(f"needs {info.context.dim} number(s), one for each {of}, not {len(value)}")
    return value


def zeros_if_missing(value: Any, info: ValidationInfo) -> Any:
    return (0.0,) * info.context.dim if value is None else value


def _axes(value: Any, info: ValidationInfo) -> tuple[int, ...]:
    """Turn "x", a list of axes or "all" into the indices of the axes."""
    axes = list(AXES[: info.context.dim])
    chosen = axes if value == "all" else [value] if isinstance(value, str) else value
    if not isinstance(chosen, list) or not chosen or any(c not in axes or chosen.count(c) > 1 for c in chosen):
        raise ValueError(f"must be one of {', '.join(axes)}, a list of them, or 'all', not {value!r}")
    return tuple(axes.index(axis) for axis in chosen)


def group_name(value: Any, info: ValidationInfo) -> str:
    """Turn the name of a group, or the number that stands for one, into text."""
    if info.context.shape == "box":
        raise ValueError('is one of the file of a body of shape "mesh" or "points"; a lattice has none')
    if type(value) not in (str, int) or value == "":
        raise ValueError(f"must be the name of a group in quotes, or its number, not {value!r}")
    return str(value)


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and -LARGEST <= value <= LARGEST  # an int of TOML may be beyond every float


def unit_normal(value: Any, info: ValidationInfo) -> tuple[float, ...]:
    """Turn "x", "-x" ... or a vector into a unit vector."""
    axes = AXES[: info.context.dim]
    if isinstance(value, str) and value.removeprefix("-") in axes:
        sign = -1.0 if value.startswith("-") else 1.0
        return tuple(sign if axis == value[-1] else 0.0 for axis in axes)
    if not isinstance(value, list) or len(value) != len(axes) or not all(map(_is_finite, value)) or not any(value):
        choices = f"{', '.join(axes)}, one of them with a minus, or {len(axes)} numbers that are not all zero"
        raise ValueError(f"must be one of {choices}, not {value!r}")
    return tuple(v / math.hypot(*value) for v in value)


class LayerWidth(NamedTuple):
    """Thickness of a layer of fictitious particles."""

    number: float
    in_horizons: bool

    def length(self, horizon: float) -> float:
        """Return the thickness as a length."""
        return self.number * horizon if self.in_horizons else self.number


def layer_width(value: Any) -> LayerWidth:
    found = re.fullmatch(r"(?:(\d+\.?\d*) )?horizons?", value) if isinstance(value, str) else None
    width = LayerWidth(float(found[1] or 1), True) if found else LayerWidth(value, False)
    if not _is_finite(width.number) or width.number <= 0:
        raise ValueError(f"must be 'horizon', '2 horizon' or a positive length, not {value!r}")
    return width


def _not_tiny(value: float) -> float:
    if value < SMALLEST:
        raise ValueError(f"must be at least {SMALLEST:g}, not {value!r}; take other units")
    return value


def _not_vast(value: float) -> float:
    if abs(value) > LARGEST:
        raise ValueError(f"must be at most {LARGEST:g}, not {value!r}; take other units")
    return value


Positive = Annotated[float, Field(gt=0), AfterValidator(_not_tiny), AfterValidator(_not_vast)]
Count = Annotated[int, Field(ge=1)]
Name = Annotated[str, AfterValidator(valid_name)]
Title = Annotated[str, Field(max_length=500), AfterValidator(plain)]
Label = Annotated[str, AfterValidator(label)]
SetName = Annotated[str, AfterValidator(known_set)]
SurfaceName = Annotated[str, AfterValidator(known_surface)]
Coordinate = Annotated[float, AfterValidator(_not_vast)]
Vector = Annotated[tuple[Coordinate, ...], Strict(False), AfterValidator(_as_long_as_dimension)]
Group = Annotated[str, PlainValidator(group_name), WithJsonSchema({"type": ["string", "integer"]})]
Axes = Annotated[
    tuple[int, ...],
    PlainValidator(_axes),
    WithJsonSchema({"anyOf": [{"enum": [*AXES, "all"]}, {"type": "array", "minItems": 1, "items": {"enum": [*AXES]}}]}),
]
Normal = Annotated[
    tuple[float, ...],
    PlainValidator(unit_normal),
    WithJsonSchema(
        {
            "description": "an axis or a vector",
            "anyOf": [
                {"enum": [*AXES, *(f"-{axis}" for axis in AXES)]},
                {"type": "array", "items": {"type": "number"}, "maxItems": 3},
            ],
        }
    ),
]
LayerThickness = Annotated[
    LayerWidth,
    PlainValidator(layer_width),
    WithJsonSchema(
        {
            "description": "'horizon', '2 horizon' or a length",
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0},
                {"type": "string", "pattern": r"^(\d+\.?\d* )?horizons?$"},
            ],
        }
    ),
]
FieldName = Literal[*QUANTITIES]
Condition = formula(condition=True)


class Horizon(Table):
    """Radius of the families: a factor of the local spacing, or a length. A plain number is a factor."""

    plain = "number"

    factor: formula() | None = None
    length: formula() | None = None

    @model_validator(mode="before")
    @classmethod
    def _plain_number(cls, value: Any) -> Any:
        return {"factor": value} if type(value) in (int, float) else value

    @model_validator(mode="after")
    def _check(self):
        exactly_one(self, "factor", "length")
        if self.factor and not self.factor.names and self.factor() <= 1:
            raise ValueError("must be greater than 1: it is a factor of the spacing")
        if self.length and not self.length.names and self.length() <= 0:
            raise ValueError("must be greater than 0")
        return self

    def __call__(self, place: dict) -> np.ndarray:
        """Return the radius [length] at `place`: X, Y, Z and spacing by name."""
        return self.factor(**place) * place["spacing"] if self.factor else self.length(**place)
