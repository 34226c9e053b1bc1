"""The finite elements of the bracket against what is known without them, and the bundled case against them."""

import json
from pathlib import Path

import numpy as np
import pytest

from pdpetsc.body.given import source_of, whole
from pdpetsc.case import load

TABLE = json.loads((Path(__file__).parent / "data" / "bracket.json").read_text())
CASES = {"bracket": "bracket", "bracket:coarse": "bracket_coarse", "bracket:vertices": "bracket"}


@pytest.mark.parametrize(("name", "mesh"), CASES.items())
def test_the_case_expects_the_table(name, mesh):
    """Its load is traction times the area of the bore's facets, about 2 pi r t."""
    case, table = load(name), TABLE["meshes"][mesh]
    expected = {e.value.removeprefix("probes."): e.equals for e in case.expect}
    assert expected["top"] == pytest.approx(table["top"][0], rel=1e-5)
    assert expected["bore"] == pytest.approx(table["bore"][2], rel=1e-5)
    facets = whole(source_of(case)).facets
    area = np.linalg.norm(facets.area[facets.face >> 3 & 1 == 1], axis=1).sum()
    assert expected["support"] == pytest.approx(-TABLE["parameters"]["traction"] * area, rel=1e-7)
    assert table["load"] == pytest.approx(TABLE["parameters"]["traction"] * area, rel=1e-6)
    assert area == pytest.approx(2 * np.pi * 10 * 10, rel=4e-3)


def test_the_finite_elements_have_converged_and_are_symmetric():
    coarse, fine = TABLE["meshes"]["bracket_coarse"], TABLE["meshes"]["bracket"]
    assert coarse["top"][0] == pytest.approx(fine["top"][0], rel=2e-3)
    assert coarse["bore"][2] == pytest.approx(fine["bore"][2], rel=2e-3)
    assert abs(fine["top"][1]) < 1e-4 * abs(fine["top"][0])
    assert fine["energy"] == pytest.approx(0.5 * fine["load"] * fine["bore"][2], rel=0.01)
