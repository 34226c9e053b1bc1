"""The table of a crack, or of where one may grow."""

from typing import Annotated

from pydantic import Field, Strict, ValidationInfo, model_validator

from pdpetsc.schema.table import Table
from pdpetsc.schema.values import Normal, Positive, Vector, formula

SHAPES = {
    1: ("{ at = [x] }", {"at"}),
    2: ("{ from = [x, y], to = [x, y] }", {"start", "to"}),
    3: ("{ polygon = [[x, y, z], [x, y, z], [x, y, z], ...] }", {"polygon"}),
}
DISC = ("{ center = [x, y, z], normal = [x, y, z], radius = r }", {"center", "normal", "radius"})
LEVEL_SET = ('{ level_set = "expression" }', {"level_set"})
MESH = ('{ mesh = "file" }', {"mesh"})
OPTIONAL = {"where": "level_set", "set": "mesh"}
"""What may be given besides something else."""


class Crack(Table):
    """A cut through the bonds: a point in 1D, a line in 2D, a plane polygon or disc in 3D; in any dimension a level set
    or what a mesh has drawn of it."""

    at: Vector | None = None
    start: Vector | None = Field(None, alias="from")
    to: Vector | None = None
    polygon: Annotated[tuple[Vector, ...], Strict(False), Field(min_length=3)] | None = None
    center: Vector | None = None
    normal: Normal | None = None
    radius: Positive | None = None
    level_set: formula(local=False) | None = None
    where: formula(local=False, condition=True) | None = None
    mesh: Annotated[str, Field(min_length=1)] | None = None
    set: Annotated[str, Field(min_length=1)] | None = None

    @property
    def vertices(self) -> tuple[tuple[float, ...], ...]:
        """Of a point, a line or a polygon; else none."""
        return self.polygon or ((self.at,) if self.at else (self.start, self.to) if self.start else ())

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo):
        dim = info.context.dim
        choices = [SHAPES[dim], *([DISC] if dim == 3 else []), LEVEL_SET, *([MESH] if dim > 1 else [])]
        given = {key for key in type(self).model_fields if getattr(self, key) is not None}
        extra = {key for key, of in OPTIONAL.items() if key in given and of in given}
        if given - extra not in [keys for _, keys in choices]:
            texts = [text for text, _ in choices]
            raise ValueError(f"a crack in {dim}D is {', '.join(texts[:-1])} or {texts[-1]}")
        return self
