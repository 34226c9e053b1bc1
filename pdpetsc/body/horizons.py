"""The horizons that a case gives its particles."""

from collections.abc import Callable

import numpy as np

from pdpetsc.body.box import coordinates
from pdpetsc.errors import InputError


def horizon_field(body, materials: dict, sets: dict) -> Callable[..., np.ndarray]:
    """The function of (position, spacing) that gives each particle's horizon [length]: the body's, or that of its
    material where `[material.NAME]` has one. What a file gives comes third, and is the body's where it has none.

    Raises:
        InputError: a material with a horizon of its own acts on a set that is not given by a condition.
    """
    own = {name: spec for name, spec in materials.items() if spec.horizon is not None}
    for name, spec in own.items():
        if spec.where != "all" and sets[spec.where].where is None:
            raise InputError(f"material.{name}.horizon: needs a set that is given by a condition")

    def horizon(position, spacing, of_file=None):
        place = coordinates(position, spacing)
        if body.horizon is None and of_file is None:
            raise InputError("body.horizon: is missing, and the file of the points has no column horizon")
        result = of_file if body.horizon is None else body.horizon(place)
        for spec in own.values():
            inside = True if spec.where == "all" else sets[spec.where].where.mask(**place)
            result = np.where(inside, spec.horizon(place), result)
        return result

    return horizon
