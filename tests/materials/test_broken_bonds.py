"""The laws of every material model where bonds are broken: the tests of whole bodies, on some that have lost bonds."""

import numpy as np
import pytest
from materials.test_models import (  # noqa: F401  collected from here
    test_action_is_derivative_of_force,
    test_force_is_gradient_of_energy,
    test_momenta,
    test_objectivity,
    test_reference_and_translations_are_free_of_force,
    test_rotations_are_free_of_force,
    test_rounding_scale,
    test_rows_are_the_action_and_symmetric,
    test_units_of_length_do_not_matter,
)
from models import (
    MODELS,
    NAMES,
    Sample,
    deformation,
    dimensions_of_the_model,  # noqa: F401  used by itself
    force,
    sample,
)

from pdpetsc.materials.ordinary import LinearPeridynamicSolid


def broken(families, seed: int = 0) -> np.ndarray:
    """A mask of intact bonds: both directions of a third of the pairs are broken, of the first particle all but two
    bonds, of the last one all."""
    i, j = families.per_bond(np.arange(len(families))), families.neighbours
    chance = np.random.default_rng(seed).uniform(size=(len(families),) * 2)
    intact = (chance + chance.T)[i, j] > 2 * np.sqrt(1 / 6)
    first = families.neighbours[:2]
    for a, b in ((i, j), (j, i)):
        intact[a == 0] = np.isin(b[a == 0], first)
        intact[a == len(families) - 1] = False
    return intact


@pytest.fixture(autouse=True)
def bonds_are_broken(monkeypatch):
    whole = Sample.material

    def material(self, row):
        result = whole(self, row)
        result.set_bonds(broken(result.families))
        return result

    monkeypatch.setattr(Sample, "material", material)


@pytest.mark.parametrize("dim", (1, 2, 3))
@pytest.mark.parametrize("row", MODELS, ids=NAMES)
def test_broken_bonds_carry_nothing(row, dim):
    """What is broken makes no difference: forces on a particle without bonds are zero, and bonds may break again."""
    body = sample(dim)
    material, u = body.material(row), deformation(body.X)
    f = force(material, u)
    assert np.array_equal(f[-1], np.zeros(dim)) and np.isfinite(f).all()
    u[-1] += 0.3
    assert np.array_equal(force(material, u), f)
    material.set_bonds(np.ones(material.families.bonds, bool))
    whole = row.build(body.neighbourhood(), body.young)
    assert np.allclose(force(material, u), force(whole, u), rtol=1e-13, atol=1e-15)  # constants found twice: rounding


@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize("row", [row for row in MODELS if row.inverts], ids=lambda row: row.name)
def test_families_go_over_to_rods_smoothly(row, dim):
    """As the weights of most bonds of a family fade, its forces change steadily from those of the law to rods."""
    body = sample(dim)
    material = body.material(row)
    share, rod = material._data.share, material._data.rod
    assert share.min() == 0.0 and rod.max() > 0.0
    assert ((share == 1) == (material.span >= 0.3)).all() and ((share == 0) == (material.span <= 0.1)).all()


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_weighted_volume(dim):
    """`updated`: sum k |xi|^2 is that of the whole family again; `frozen`: k is as it was."""
    body = sample(dim)
    frozen, updated = (
        LinearPeridynamicSolid(body.neighbourhood(), 1.0, 0.3, weighted_volume=choice)
        for choice in ("frozen", "updated")
    )
    k = frozen._data.k.copy()
    intact = broken(frozen.families)
    for material in (frozen, updated):
        material.set_bonds(intact)
    assert np.array_equal(frozen._data.k, k * intact)
    moment = k * frozen.families.lengths(body.X) ** 2
    some = frozen.families.sums(intact.astype(float)) > 0
    left = updated.families.sums(updated._data.k * updated.families.lengths(body.X) ** 2)
    assert np.allclose(left[some], frozen.families.sums(moment)[some], rtol=1e-13)
    assert (updated._data.k[~intact] == 0).all()
