"""The fields of a result: what probes, files and pictures may name. `recover.FIELDS` says how each is computed."""

from typing import NamedTuple

PRESSURE = "{force}/{length}^2"


class Quantity(NamedTuple):
    """A field.

    Attributes:
        rank: as a tensor, 0, 1 or 2.
        label, unit: of the number by which a picture is coloured; units by their names in `[units]`.
    """

    rank: int
    label: str
    unit: str = ""


QUANTITIES = {
    "u": Quantity(1, "displacement |u|", "{length}"),
    "F": Quantity(2, "deformation gradient |F - I|"),
    "stress": Quantity(2, "von Mises stress", PRESSURE),
    "strain": Quantity(2, "logarithmic strain |e|"),
    "energy": Quantity(0, "strain energy density", PRESSURE),
    "reaction": Quantity(1, "reaction |r|", "{force}"),
    "force": Quantity(1, "external force |f|", "{force}"),
}
