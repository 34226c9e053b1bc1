"""The tables of a body, of its sets of particles and of its surfaces."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, ValidationInfo, model_validator

from pdpetsc.bonds import HORIZON_TOLERANCE
from pdpetsc.schema.crack import Crack
from pdpetsc.schema.table import Table, error_at, exactly_one
from pdpetsc.schema.values import (
    Condition,
    Group,
    Horizon,
    LayerThickness,
    Positive,
    SetName,
    Vector,
    formula,
    known_face,
    zeros_if_missing,
)

SHAPES_OF = dict.fromkeys(("size", "spacing", "origin", "fitted", "refine", "zones", "layers"), ("box",)) | {
    "mesh": ("mesh",), "points": ("points",), "particles": ("box", "mesh"), "dimension": ("mesh", "points"),
    "scale": ("mesh", "points"),
}  # fmt: skip
"""The shapes that a key goes with, where it does not go with all."""


class Zone(Table):
    """Cells near a set are divided."""

    near: SetName
    within: Positive
    divide: Annotated[int, Field(ge=2)]


class Body(Table):
    """A lattice of particles and what is cut out of it or added around it, the cells of a mesh or given points."""

    shape: Literal["box", "mesh", "points"] = "box"
    size: Annotated[tuple[Positive, ...], Strict(False), Field(min_length=1, max_length=3)] | None = None
    spacing: Positive | None = None
    mesh: Annotated[str, Field(min_length=1)] | None = None
    points: Annotated[str, Field(min_length=1)] | None = None
    dimension: Annotated[int, Field(ge=1, le=3)] = 3
    scale: Positive = 1.0  # of lengths in the file
    thickness: Positive = 1.0  # out of plane in 2D, the cross-section in 1D
    origin: Annotated[Vector, BeforeValidator(zeros_if_missing)] = Field(None, validate_default=True)
    horizon: Horizon | None = None
    horizon_tolerance: Annotated[float, Field(gt=-0.1, lt=0.1)] = HORIZON_TOLERANCE
    particles: Literal["cells", "vertices"] = "cells"
    keep: Condition | None = None
    fitted: bool = False
    refine: formula() | None = None
    zones: Annotated[tuple[Zone, ...], Strict(False)] = ()
    cracks: Annotated[tuple[Crack, ...], Strict(False)] = ()
    layers: dict[Annotated[str, AfterValidator(known_face)], LayerThickness] = {}

    @property
    def dim(self) -> int:
        return self.dimension if self.size is None else len(self.size)

    @model_validator(mode="before")
    @classmethod
    def _of_one_shape(cls, table: Any, info: ValidationInfo) -> Any:
        """Name the shape that a file stands for, and report the keys of other shapes and the missing ones of this."""
        if not isinstance(table, dict):
            return table
        shape = info.context.shape
        if table.get("shape", shape) not in ("box", "mesh", "points"):
            return table
        for key in SHAPES_OF:
            if key in table and shape not in SHAPES_OF[key]:
                of = " or ".join(f'"{name}"' for name in SHAPES_OF[key])
                raise error_at(key, f'goes with shape = {of}, not with "{shape}"')
        return table | {"shape": shape}

    @model_validator(mode="after")
    def _check(self):
        needed = {"box": ("size", "spacing"), "mesh": ("mesh",), "points": ("points",)}[self.shape]
        for key in (*needed, *(() if self.shape == "points" else ("horizon",))):
            if getattr(self, key) is None:
                raise error_at(key, "is missing")
        if self.shape == "mesh" and self.dim == 1:
            raise error_at("dimension", "must be 2 or 3 for a mesh, not 1")
        if self.dim == 3 and "thickness" in self.model_fields_set:
            raise ValueError("a body of three dimensions has no thickness")
        if self.fitted and self.keep is None:
            raise ValueError("fitted = true fits particles to the border of keep, which is not given")
        for key in ("refine", "zones") if self.particles == "vertices" else ():
            if getattr(self, key):
                raise ValueError(f'{key} divides cells, so it goes with particles = "cells"')
        return self


class Chosen(Table):
    """What a condition chooses; a plain text is one."""

    plain = "string"

    @model_validator(mode="before")
    @classmethod
    def _plain_text(cls, value: Any) -> Any:
        return {"where": value} if isinstance(value, str) else value


class ParticleSet(Chosen):
    """The particles that meet a condition or belong to a group of the body's file, or the one nearest to a point. A
    plain text is a condition."""

    where: Condition | None = None
    nearest: Vector | None = None
    group: Group | None = None

    @model_validator(mode="after")
    def _check(self):
        exactly_one(self, "where", "nearest", "group")
        return self


class Surface(Chosen):
    """The pieces of the body's surface that meet a condition, or that a group of its mesh holds. A plain text is a
    condition."""

    where: formula(condition=True, of_surface=True) | None = None
    group: Group | None = None

    @model_validator(mode="after")
    def _check(self):
        exactly_one(self, "where", "group")
        return self
