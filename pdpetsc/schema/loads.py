"""The tables of loads; those on sets are made from the keys that the loads name (pdpetsc.loads.base.Load.Keys)."""

from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

import pdpetsc.loads  # noqa: F401  fills Load.kinds
from pdpetsc.loads.base import Load
from pdpetsc.schema.materials import table_of_keys
from pdpetsc.schema.table import Table, error_at, exactly_one
from pdpetsc.schema.values import Axes, Normal, Positive, SetName, SurfaceName, formula


class AnyLoad(Table):
    """What every load on a set of particles has, whatever its kind."""

    kind: str
    set: SetName
    value: formula("t")


class LoadAlongAxes(AnyLoad):
    """What those have that act along axes."""

    component: Axes


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


ON_SURFACES = {"traction": Traction, "pressure": Pressure}


def load_table(load: type[Load]) -> type[AnyLoad]:
    """The table of a load on a set."""
    base = LoadAlongAxes if load.along_axes else AnyLoad
    return table_of_keys(load.Keys, load.__name__, base, kind=(Literal[load.name], ...))


def tables_of(kinds: dict[str, type[Load]]) -> dict[str, type[Table]]:
    """The table of each kind, and of loads on surfaces."""
    return {name: load_table(load) for name, load in kinds.items() if name not in ON_SURFACES} | ON_SURFACES


def any_load(tables: dict[str, type[Table]]) -> Any:
    """The type of a `[[load]]`: the table of one of the kinds."""

    def of_known_kind(table: Any) -> Any:
        if isinstance(table, dict) and table.get("kind") not in [*tables]:
            raise error_at("kind", f"must be one of {', '.join(tables)}")
        return table

    return Annotated[reduce(or_, tables.values()), Field(discriminator="kind"), BeforeValidator(of_known_kind)]


TABLES = tables_of(Load.kinds)
LoadTable = any_load(TABLES)
