"""The tables of a case with classes of the user's own among its materials, criteria and loads."""

from functools import lru_cache
from typing import Annotated

from pydantic import AfterValidator, Field, Strict, create_model

from pdpetsc.damage.base import Criterion
from pdpetsc.loads.base import Load
from pdpetsc.materials.base import Material
from pdpetsc.schema import damage, loads, materials
from pdpetsc.schema.tables import Description, of_known_materials
from pdpetsc.schema.values import Name


def _known() -> tuple[tuple, ...]:
    return tuple(tuple(table.items()) for table in (Material.models, Criterion.criteria, Load.kinds))


_OF_THE_PACKAGE = _known()


def description() -> type[Description]:
    """The tables of a case with all classes that are known by now: a script may have defined some since the import."""
    known = _known()
    return Description if known == _OF_THE_PACKAGE else _extended(*known)


@lru_cache(maxsize=1)
def _extended(models: tuple, criteria: tuple, kinds: tuple) -> type[Description]:
    material = materials.any_material(materials.tables_of(dict(models)))
    failing = damage.any_damage(damage.tables_of(dict(criteria)))
    load = loads.any_load(loads.tables_of(dict(kinds)))
    return create_model(
        "Description",
        __base__=Description,
        __module__=__name__,
        material=(Annotated[dict[Name, material], Field(min_length=1)], ...),
        damage=(Annotated[dict[Name, failing], AfterValidator(of_known_materials)], {}),
        load=(Annotated[tuple[load, ...], Strict(False)], ()),
    )
