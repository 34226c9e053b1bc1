"""The units of what a result shows, as text: made of those of a case, which are labels and nothing more."""

from collections.abc import Mapping

from pdpetsc.quantities import PRESSURE, QUANTITIES

NAMES: dict[str, dict[tuple[str, ...], str]] = {
    "{force}/{length}^2": {
        ("N", "m"): "Pa", ("kN", "m"): "kPa", ("MN", "m"): "MPa", ("N", "mm"): "MPa", ("kN", "mm"): "GPa",
    },
    "{force} {length}": {
        ("N", "m"): "J", ("kN", "m"): "kJ", ("MN", "m"): "MJ", ("N", "mm"): "mJ", ("kN", "mm"): "J",
    },
    "{force} {time}^2/{length}^4": {("N", "m", "s"): "kg/m³", ("N", "mm", "s"): "t/mm³"},
}  # fmt: skip
"""Units that have a name of their own, by the case's units that stand in them (of force, length and time)."""

ENERGY, DENSITY = "{force} {length}", "{force} {time}^2/{length}^4"
SUPERSCRIPTS = {"^2": "²", "^3": "³", "^4": "⁴"}

OF_LOADS = {
    "displacement": "{length}", "velocity": "{length}/{time}", "force": "{force}", "body_force": "{force}/{length}^3",
    "traction": PRESSURE, "pressure": PRESSURE,
}  # fmt: skip
"""The unit of the value of each kind of load."""

OF_PROPERTIES = {
    "E": PRESSURE, "density": DENSITY, "G_c": "{force}/{length}", "cohesion": PRESSURE, "thickness": "{length}",
    "spacing": "{length}", "size": "{length}", "origin": "{length}",
}  # fmt: skip
"""The units of keys of materials, of damage and of the body, where they have one."""

OF_PROBES = {"J": "{force}/{length}", "crack_tip": "{length}", "moment": "{force} {length}"}
"""The units of what probes read beside fields."""

OF_HISTORY = {
    **dict.fromkeys(("external_work", "stored_energy", "kinetic_energy", "dissipated", "imbalance"), ENERGY),
    "residual_scale": "{force}",
    "crack_area": "{length}^2",
    "arc_length": "{length}",
}
"""The units of columns of history.csv that are the solver's."""


def text(unit: str, units: Mapping[str, str]) -> str:
    """A unit in those of a case.

    Args:
        unit: such as "{force}/{length}^2"; "" has none.
        units: the table [units]: names of `length`, `force` and `time`.
    """
    parts = tuple(units[key] for key in ("force", "length", "time") if f"{{{key}}}" in unit)
    if parts in NAMES.get(unit, {}):
        return NAMES[unit][parts]
    for power, superscript in SUPERSCRIPTS.items():
        unit = unit.replace(power, superscript)
    return unit.format(**units)


def bracketed(unit: str, units: Mapping[str, str]) -> str:
    """A unit in those of a case as it follows a label, " [Pa]"; "" where there is none."""
    return f" [{text(unit, units)}]" if unit else ""


def of_probe(probe: Mapping) -> str:
    """The unit of a probe, from its table in a case: that of its field; errors are relative and have none."""
    field = probe.get("field")
    if probe.get("reduce") == "error":
        return ""
    return OF_PROBES.get(field) or (QUANTITIES[field].unit if field in QUANTITIES else "")


def of_history(document: Mapping, in_time: bool) -> dict[str, str]:
    """The units of the columns of history.csv that have one.

    Args:
        document: the case.
        in_time: whether t is time.
    """
    times = dict.fromkeys(("time", "time_step"), "{time}") if in_time else {}
    found = OF_HISTORY | times | {probe["name"]: of_probe(probe) for probe in document.get("probe", ())}
    return {name: unit for name, unit in found.items() if unit}


def labels_of_history(document: Mapping, units: Mapping[str, str], in_time: bool) -> dict[str, str]:
    """The columns of history.csv that have a unit, with it, by their names; t is called so where it is no time."""
    labels = {name: name + bracketed(unit, units) for name, unit in of_history(document, in_time).items()}
    return labels if in_time else {"time": "t"} | labels
