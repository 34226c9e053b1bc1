"""The table of adaptive refinement."""

from typing import Annotated

from pydantic import Field

from pdpetsc.quantities import QUANTITIES
from pdpetsc.schema.table import Table
from pdpetsc.schema.values import Count, formula

Indicator = formula("horizon", "t", *QUANTITIES, condition=True)
"""A condition of place, spacing, horizon, time, and the fields by the number by which a picture is coloured."""


class Refinement(Table):
    """Which particles are split while the body is loaded, how often, and when that is looked at."""

    where: Indicator
    beside: Indicator | None = None
    rings: Annotated[int, Field(ge=0, le=10)] = 1
    levels: Annotated[int, Field(ge=1, le=20)] = 1
    every: Count | None = None
