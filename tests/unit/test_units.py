"""Units as text."""

import pytest

from pdpetsc import units
from pdpetsc.quantities import QUANTITIES

SI = {"length": "m", "force": "N", "time": "s"}
MM = {"length": "mm", "force": "N", "time": "s"}


@pytest.mark.parametrize(
    ("unit", "si", "mm"),
    [
        (QUANTITIES["stress"].unit, "Pa", "MPa"),
        (QUANTITIES["u"].unit, "m", "mm"),
        (QUANTITIES["v"].unit, "m/s", "mm/s"),
        (units.ENERGY, "J", "mJ"),
        (units.DENSITY, "kg/m³", "t/mm³"),
        (units.OF_LOADS["body_force"], "N/m³", "N/mm³"),
        (units.OF_PROPERTIES["G_c"], "N/m", "N/mm"),
        ("", "", ""),
    ],
)
def test_units_of_two_systems(unit, si, mm):
    assert (units.text(unit, SI), units.text(unit, MM)) == (si, mm)


def test_units_without_a_name():
    inches = {"length": "in", "force": "lbf", "time": "s"}
    assert units.text(QUANTITIES["stress"].unit, inches) == "lbf/in²"
    assert units.bracketed(units.ENERGY, inches) == " [lbf in]"
    assert units.bracketed("", inches) == ""


@pytest.mark.parametrize(
    ("probe", "unit"),
    [
        ({"field": "stress", "component": "xx"}, "MPa"),
        ({"field": "u", "reduce": "mean"}, "mm"),
        ({"field": "u", "reduce": "error"}, ""),
        ({"field": "J"}, "N/mm"),
        ({"field": "moment"}, "mJ"),
        ({"field": "damage"}, ""),
        ({}, ""),
    ],
)
def test_units_of_probes(probe, unit):
    assert units.text(units.of_probe(probe), MM) == unit


def test_labels_of_history():
    case = {"probe": [{"name": "pull", "field": "reaction"}, {"name": "torn", "field": "damage"}]}
    labels = units.labels_of_history(case, MM, in_time=False)
    assert labels["pull"] == "pull [N]" and "torn" not in labels and labels["time"] == "t"
    assert units.labels_of_history(case, MM, in_time=True)["time"] == "time [s]"
