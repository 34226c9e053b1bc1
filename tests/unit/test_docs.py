"""The worked examples of the developers' page do what they say."""

import re
from pathlib import Path

import numpy as np
import pytest
from models import action, deformation, force, sample, tangent
from pydantic import ValidationError

from pdpetsc.materials.base import Material
from pdpetsc.schema.materials import material_table
from pdpetsc.schema.values import Setting

PAGE = Path(__file__).parents[2] / "docs" / "developers.md"


@pytest.fixture
def fibre():
    """The model of the page, in the table while a test runs."""
    (code,) = (
        block for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if "FibreSheet(Ord" in block
    )
    assert len(code.splitlines()) < 60
    module: dict = {}
    exec(compile(code, "fibre.py", "exec"), module)
    yield module["FibreSheet"]
    del Material.models["fibre"]


def test_the_new_material_is_a_gradient_with_its_tangent(fibre):
    body = sample(2)
    material = fibre(body.neighbourhood(), 1.0, 10.0, 0.5)
    u = deformation(body.X)
    v = np.random.default_rng(0).normal(size=u.shape)
    power = (material.energy(u + 1e-5 * v).sum() - material.energy(u - 1e-5 * v).sum()) / 2e-5
    assert power == pytest.approx((force(material, u) * v).sum(), rel=1e-7)
    difference = (force(material, u + 1e-6 * v) - force(material, u - 1e-6 * v)) / 2e-6
    assert np.abs(action(material, u, v) - difference).max() < 1e-7 * np.abs(difference).max()
    assert np.allclose(tangent(material, u) @ v.ravel(), action(material, u, v).ravel(), atol=1e-12)


def test_it_is_stiffer_along_its_fibres(fibre):
    body = sample(2)
    along, across = np.outer([1, 0], [1, 0]), np.outer([0, 1], [0, 1])
    material = fibre(body.neighbourhood(), 1.0, 10.0, 0.0)
    energies = [material.energy(1e-3 * body.X @ strain).sum() for strain in (along, across)]
    assert energies[0] > 3 * energies[1]


def test_its_keys_are_those_of_the_case_file(fibre):
    table = material_table(fibre)
    setting = Setting(2, ("all",))
    keys = table.model_validate({"model": "fibre", "E": 1.0, "stiffening": 2.0}, context=setting)
    assert fibre.from_case(keys, sample(2).neighbourhood()).choices()["fibres"]
    for wrong in ({"E": -1.0}, {"stiffening": "much"}, {"nu": 0.3}):
        with pytest.raises(ValidationError):
            table.model_validate({"model": "fibre", "E": 1.0, "stiffening": 2.0} | wrong, context=setting)
    with pytest.raises(ValidationError, match="two dimensions, not 3"):
        table.model_validate({"model": "fibre", "E": 1.0, "stiffening": 2.0}, context=Setting(3, ("all",)))
