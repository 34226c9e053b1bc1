"""The table of a crack, or of where one may grow."""

from typing import Annotated

from pydantic import Field, Strict, ValidationInfo, model_validator

from pdpetsc.schema.table import Table
from pdpetsc.schema.values import Vector


class Crack(Table):
    """A cut through the bonds: a point in 1D, a line in 2D, a plane polygon in 3D."""

    at: Vector | None = None
    start: Vector | None = Field(None, alias="from")
    to: Vector | None = None
    polygon: Annotated[tuple[Vector, ...], Strict(False), Field(min_length=3)] | None = None

    @property
    def vertices(self) -> tuple[tuple[float, ...], ...]:
        return self.polygon or ((self.at,) if self.at else (self.start, self.to))

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo):
        given = {key for key in ("at", "start", "to", "polygon") if getattr(self, key) is not None}
        wanted = ({"at"}, {"start", "to"}, {"polygon"})[info.context.dim - 1]
        if given != wanted:
            raise ValueError(
                ("a crack in 1D is { at = [x] }", "a crack in 2D is { from = [x, y], to = [x, y] }",
                 "a crack in 3D is { polygon = [[x, y, z], [x, y, z], [x, y, z], ...] }")[info.context.dim - 1]
            )  # fmt: skip
        return self
