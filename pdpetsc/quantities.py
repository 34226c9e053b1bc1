"""The fields of a result: what probes, files and pictures may name, and the numbers in them.

`recover.FIELDS` says how each field is computed.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

PRESSURE = "{force}/{length}^2"
AXES = ("x", "y", "z")
PRINCIPAL = ("1", "2", "3")


class Quantity(NamedTuple):
    """A field.

    Attributes:
        rank: as a tensor, 0, 1 or 2.
        label, unit: of the number by which a picture is coloured; units by their names in `[units]`.
        components: what its entries are called where they do not go by the axes.
        invariants: further numbers that follow from a tensor: "von_mises", principal values.
        cheap: whether it is written where a case does not say what is.
        noun: what its components are components of, where that is not the label.
    """

    rank: int
    label: str
    unit: str = ""
    components: tuple[str, ...] = ()
    invariants: tuple[str, ...] = ()
    cheap: bool = True
    noun: str = ""


QUANTITIES = {
    "u": Quantity(1, "displacement |u|", "{length}", noun="displacement"),
    "v": Quantity(1, "velocity |v|", "{length}/{time}", cheap=False, noun="velocity"),
    "F": Quantity(2, "deformation gradient |F - I|", noun="deformation gradient"),
    "stress": Quantity(2, "von Mises stress", PRESSURE, invariants=("von_mises", *PRINCIPAL), noun="stress"),
    "strain": Quantity(2, "logarithmic strain |e|", invariants=PRINCIPAL, noun="logarithmic strain"),
    "energy": Quantity(0, "strain energy density", PRESSURE),
    "reaction": Quantity(1, "reaction |r|", "{force}", noun="reaction"),
    "force": Quantity(1, "external force |f|", "{force}", noun="external force"),
    "von_mises": Quantity(0, "von Mises stress", PRESSURE),
    "principal": Quantity(1, "largest principal stress", PRESSURE, components=PRINCIPAL, noun="principal stress"),
    "dilatation": Quantity(0, "dilatation J - 1"),
    "damage": Quantity(0, "damage", cheap=False),
    "peridynamic_stress": Quantity(
        2,
        "von Mises peridynamic stress",
        PRESSURE,
        invariants=("von_mises", *PRINCIPAL),
        cheap=False,
        noun="peridynamic stress",
    ),
}
CHEAP = tuple(name for name, quantity in QUANTITIES.items() if quantity.cheap)


def components(field: str, dim: int) -> tuple[str, ...]:
    """The components that a probe may choose of a field, in a body of `dim` dimensions."""
    rank, names, further = (getattr(QUANTITIES[field], key) for key in ("rank", "components", "invariants"))
    if rank == 0:
        return ()
    axes = AXES if rank == 2 else AXES[:dim]
    return (*(names or map("".join, product(axes, repeat=rank))), "magnitude", *further)


def label(field: str, component: str | None = None) -> str:
    """What a component of a field is called beside a picture; None: the number that `scalar` gives."""
    quantity = QUANTITIES[field]
    if component is None:
        return quantity.label
    if component == "von_mises":
        return f"von Mises {quantity.noun}"
    if component in PRINCIPAL and not quantity.components:
        return f"principal {quantity.noun} {component}"
    return f"{quantity.noun} {component}"


def component(values: np.ndarray, name: str) -> np.ndarray:
    """One component (n,) of a vector ("x") or tensor ("xy") field, its "magnitude" (Frobenius norm), or "von_mises" or
    a principal value ("1") of a tensor."""
    if name == "magnitude":
        return np.sqrt((values**2).sum(axis=tuple(range(1, values.ndim))))
    if name == "von_mises":
        return von_mises(values)
    if name in PRINCIPAL:
        return (values if values.ndim == 2 else principal(values))[:, PRINCIPAL.index(name)]
    return values[(slice(None), *(AXES.index(axis) for axis in name))]


def von_mises(stress: np.ndarray) -> np.ndarray:
    """sqrt(3/2 s:s) of the deviator s of the symmetric part, (n,) of (n, 3, 3)."""
    symmetric = (stress + stress.transpose(0, 2, 1)) / 2
    deviator = symmetric - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))


def principal(tensor: np.ndarray) -> np.ndarray:
    """Principal values of the symmetric part, the largest first, (n, 3) of (n, 3, 3); NaN where it is not finite."""
    finite = np.isfinite(tensor).all(axis=(1, 2))
    values = np.full(tensor.shape[:2], np.nan)
    values[finite] = np.linalg.eigvalsh((tensor + tensor.transpose(0, 2, 1))[finite] / 2)[:, ::-1]
    return values


def scalar(field: str, values: np.ndarray) -> np.ndarray:
    """One number for each particle: von Mises of a stress, the largest of principal values, else the magnitude; tensors
    are (n, 3, 3) or (n, 9)."""
    quantity = QUANTITIES[field]
    if quantity.rank == 2:
        values = values.reshape(-1, 3, 3) - (np.eye(3) if field == "F" else 0.0)
    if "von_mises" in quantity.invariants:
        return von_mises(values)
    if quantity.components:
        return values[:, 0]
    return values if quantity.rank == 0 else component(values, "magnitude")
