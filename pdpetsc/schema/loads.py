"""The tables of loads."""

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, model_validator

from pdpetsc.schema.table import Table, error_at, exactly_one
from pdpetsc.schema.values import Axes, Normal, Positive, SetName, SurfaceName, formula


class _ComponentLoad(Table):
    set: SetName
    component: Axes
    value: formula("t")


class Displacement(_ComponentLoad):
    """Prescribed components of the displacement."""

    kind: Literal["displacement"]


class Velocity(_ComponentLoad):
    """Prescribed components of the velocity."""

    kind: Literal["velocity"]


class BodyForce(_ComponentLoad):
    """Force per volume."""

    kind: Literal["body_force"]


class Force(_ComponentLoad):
    """Total force on a set, shared by volume."""

    kind: Literal["force"]


Transfer = Literal["cut_bonds", "linear", "quadratic"]


class Traction(Table):
    """Force per area on a surface."""

    kind: Literal["traction"]
    surface: SurfaceName
    component: Axes
    value: formula("t", of_surface=True)
    follower: bool | None = None
    transfer: Transfer = "cut_bonds"


class Pressure(Table):
    """Pressure on a surface, or on a layer of particles against the outward normal."""

    kind: Literal["pressure"]
    surface: SurfaceName | None = None
    set: SetName | None = None
    normal: Normal | None = None
    value: formula("t")
    width: Positive | None = None
    follower: bool | None = None
    transfer: Transfer = "cut_bonds"

    @model_validator(mode="after")
    def _check(self):
        exactly_one(self, "surface", "set")
        if self.surface is None and self.normal is None:
            raise error_at("normal", "a pressure on a set needs its outward normal, one on a surface does not")
        of_other = ("follower", "transfer") if self.surface is None else ("normal", "width")
        if wrong := [key for key in of_other if key in self.model_fields_set]:
            raise error_at(
                wrong[0],
                "goes with surface, not with set" if self.surface is None else "goes with set, not with surface",
            )
        return self


Load = Displacement | Velocity | BodyForce | Force | Traction | Pressure
LOAD_KINDS = [get_args(load.model_fields["kind"].annotation)[0] for load in get_args(Load)]


def _of_known_kind(table: Any) -> Any:
    if isinstance(table, dict) and table.get("kind") not in LOAD_KINDS:
        raise error_at("kind", f"must be one of {', '.join(LOAD_KINDS)}")
    return table


AnyLoad = Annotated[Load, Field(discriminator="kind"), BeforeValidator(_of_known_kind)]
