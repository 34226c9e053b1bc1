"""What a picture of a result shows."""

import re
from typing import NamedTuple

from pdpetsc.errors import InputError
from pdpetsc.expressions import hint
from pdpetsc.quantities import AXES, QUANTITIES, components


class Section(NamedTuple):
    """A plane across an axis that cuts a body of three dimensions open.

    Attributes:
        axis: 0, 1 or 2.
        at: where, before deformation [length].
    """

    axis: int
    at: float

    @property
    def side(self) -> int:
        """Which end of a cell the plane cuts off, 0 or 1: that towards the viewer, who looks from +x, -y and +z."""
        return 0 if AXES[self.axis] == "y" else 1


class View(NamedTuple):
    """What a picture shows.

    Attributes:
        field: of `quantities`; None until it is known.
        component: of the field; None: the number that stands for it, as von Mises stress.
        step: of the field file; None: the last one.
        section: where the body is cut open.
        scale: factor by which displacements are drawn enlarged; None: one by which small ones are seen.
    """

    field: str | None
    component: str | None = None
    step: int | None = None
    section: Section | None = None
    scale: float | None = None

    @property
    def name(self) -> str:
        """Of the picture's file, without the kind."""
        step = "" if self.step is None else f"step{self.step}"
        return "-".join(filter(None, (self.field, self.component, step, "section" if self.section else "")))


def section(text: str) -> Section:
    """The plane that "x=0.05" means.

    Raises:
        InputError: it means none.
    """
    found = re.fullmatch(r"\s*([xyzXYZ])\s*=\s*(\S+)\s*", text)
    try:
        return Section(AXES.index(found[1].lower()), float(found[2]))
    except (TypeError, ValueError):
        raise InputError(f"--section {text}: must be a plane across an axis, as x=0.05") from None


def check(view: View, dim: int) -> None:
    """Check that a body of `dim` dimensions can be seen so.

    Raises:
        InputError: unknown field or component, or a section of a body that has no inside.
    """
    if view.field not in QUANTITIES:
        raise InputError(
            f"--field {view.field}: there is no such field{hint(view.field, QUANTITIES)}; choices: "
            f"{', '.join(QUANTITIES)}"
        )
    names = components(view.field, dim)
    if view.component is not None and view.component not in names:
        choices = f"choices: {', '.join(names)}" if names else "it is a scalar"
        raise InputError(f"--component {view.component}: {view.field} has no such component; {choices}")
    if view.section is not None and dim < 3:
        raise InputError(f"--section: cuts a body of three dimensions, this one has {dim}")
