"""Families against a brute-force search, and the weights of bonds against their formulas."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from pdpetsc.bonds import HORIZON_TOLERANCE, Families, check_not_lonely, find_families
from pdpetsc.errors import InputError
from pdpetsc.influence import INFLUENCE, bond_weights


def families_by_tree(X, horizon, owned=None):
    """{i: neighbours} by scipy's KD-tree."""
    found = KDTree(X).query_ball_point(X[:owned], horizon[:owned] * (1 + HORIZON_TOLERANCE))
    return [sorted(set(members) - {i}) for i, members in enumerate(found)]


def as_lists(families: Families):
    return [families.neighbours[a:b].tolist() for a, b in zip(families.offsets[:-1], families.offsets[1:])]


def cloud(kind: str, dim: int, n: int = 300):
    """Points and horizons: alike, widely different, in two far clusters, in a plane or a line of space."""
    rng = np.random.default_rng(dim)
    size = n ** (1 / dim)
    X = rng.uniform(-size / 2, size / 2, (n, dim))
    if kind == "clusters":
        X[n // 2 :] += 1e5
    nearest = KDTree(X).query(X, 2)[0][:, 1]
    horizon = np.maximum(1.8, 1.1 * nearest)
    if kind == "graded":
        horizon *= rng.uniform(1, 4, n)
    if kind == "flat":
        X[:, 1:] = 0.3
        horizon = np.maximum(horizon, 2 * size)
    return X, horizon


@pytest.mark.parametrize("kind", ("alike", "graded", "clusters", "flat"))
@pytest.mark.parametrize("dim", (1, 2, 3))
def test_families_are_those_of_a_tree(dim, kind, monkeypatch):
    monkeypatch.setattr("pdpetsc.bonds.BLOCK", 70)
    X, horizon = cloud(kind, dim)
    families = find_families(X, horizon, np.arange(len(X)), len(X))
    assert as_lists(families) == families_by_tree(X, horizon)
    assert families.center.tolist() == list(range(len(X)))
    assert families.bonds == len(families.neighbours) == families.offsets[-1]
    assert families.neighbours.dtype == np.int32


def test_owned_particles_have_families_of_all_and_neighbours_are_in_the_order_of_their_ids():
    X, horizon = cloud("graded", 2)
    ids = np.random.default_rng(0).permutation(len(X))
    families = find_families(X, horizon, ids, 100)
    assert len(families) == 100
    assert [sorted(row) for row in as_lists(families)] == families_by_tree(X, horizon, 100)
    assert all(np.all(np.diff(ids[row]) > 0) for row in as_lists(families))


def test_large_families_in_the_order_of_their_ids():
    X, _ = cloud("alike", 3, 500)
    ids = np.random.default_rng(0).permutation(500)
    expected = np.argsort(ids)
    for i, row in enumerate(as_lists(find_families(X, np.full(500, 1e2), ids, 30))):
        assert row == expected[expected != i].tolist()


def test_particles_of_no_rank():
    families = find_families(np.empty((0, 2)), np.empty(0), np.empty(0, int), 0)
    assert len(families) == families.bonds == 0
    assert len(families.dual(0).offsets) == 1


@pytest.mark.parametrize("factor", (1.0, 2.0, 3.0))
@pytest.mark.parametrize("shift", (0.0, 1e3))
def test_neighbours_at_exactly_the_horizon(factor, shift):
    """0.1 k is not what 0.1 (k + 3) - 0.3 rounds to; the tolerance takes all of them in, far from the origin too."""
    X = shift + 0.1 * np.arange(50.0)[:, None]
    families = find_families(X, np.full(50, factor * 0.1 * (1 + 1e-11 * shift)), np.arange(50), 50)
    sizes = np.diff(families.offsets)
    assert np.all(sizes[3:-3] == 2 * factor)


def test_tolerance():
    def size(distance):
        X = np.array([[0.0], [distance], [-0.5]])
        return np.diff(find_families(X, np.full(3, 1.0), np.arange(3), 1).offsets)[0]

    assert size(1 + 0.9 * HORIZON_TOLERANCE) == 2
    assert size(1 + 1.1 * HORIZON_TOLERANCE) == 1


def test_horizons_need_not_be_mutual():
    X = np.array([[0.0, 0.0], [1.5, 0.0], [2.5, 0.0]])
    families = find_families(X, np.array([2.0, 1.2, 1.2]), np.arange(3), 3)
    assert as_lists(families) == [[1], [2], [1]]


def test_a_lonely_particle_is_named():
    X = np.array([[0.0, 0.0], [1.0, 0.0], [5.25, 7.5]])
    with pytest.raises(InputError, match=r"body\.horizon: the particle at \(5\.25, 7\.5\) has no neighbour .* of 1\.5"):
        check_not_lonely(find_families(X, np.full(3, 1.5), np.arange(3), 3), X, np.full(3, 1.5))


def test_without_cut_bonds():
    X = np.arange(4.0)[:, None]
    families = find_families(X, np.full(4, 2.1), np.arange(4), 3)
    assert as_lists(families) == [[1, 2], [0, 2, 3], [0, 1, 3]]
    cut = np.array([0, 1, 1, 0, 1, 0, 0, 0], bool)
    assert as_lists(families.without(cut)) == [[1], [2], [0, 1, 3]]
    assert families.without(np.zeros(8, bool)) is families


def test_blocks_lengths_and_sums(monkeypatch):
    X, horizon = cloud("graded", 2)
    families = find_families(X, horizon, np.arange(len(X)), 200)
    i, j = families.per_bond(np.arange(len(X))), families.neighbours
    length = families.lengths(X)
    assert length == pytest.approx(np.linalg.norm(X[j] - X[i], axis=1), rel=1e-14)
    total = families.sums(length)
    assert total == pytest.approx([length[a:b].sum() for a, b in zip(families.offsets[:-1], families.offsets[1:])])
    monkeypatch.setattr("pdpetsc.bonds.BLOCK", 60)
    parts, bonds = zip(*families.blocks())
    assert len(parts) == 4
    assert np.concatenate([part.center for part in parts]).tolist() == families.center.tolist()
    assert [row for part in parts for row in as_lists(part)] == as_lists(families)
    assert np.concatenate([length[b] for b in bonds]).tolist() == length.tolist()
    assert np.concatenate([part.sums(length[b]) for part, b in zip(parts, bonds)]).tolist() == total.tolist()


def test_dual_families_are_the_transpose():
    X, horizon = cloud("graded", 2)
    families = find_families(X, horizon, np.arange(len(X)), 200)
    dual = families.dual(len(X))
    assert len(dual.offsets) == len(X) + 1
    pairs = {(int(families.per_bond(np.arange(len(X)))[b]), int(families.neighbours[b])) for b in range(families.bonds)}
    turned = set()
    for j in range(len(X)):
        for k in range(dual.offsets[j], dual.offsets[j + 1]):
            assert families.neighbours[dual.bond[k]] == j
            f = dual.family[k]
            assert families.offsets[f] <= dual.bond[k] < families.offsets[f + 1]
            turned.add((int(families.center[f]), j))
    assert turned == pairs


def test_subset():
    X, horizon = cloud("graded", 2)
    families = find_families(X, horizon, np.arange(len(X)), len(X))
    chosen = np.array([0, 3, 17, 18, len(X) - 1])
    part = families.subset(chosen)
    assert as_lists(part) == [as_lists(families)[k] for k in chosen]
    assert part.center.tolist() == chosen.tolist()
    sizes = np.diff(part.offsets)
    assert part.per_bond(horizon).tolist() == np.repeat(horizon[chosen], sizes).tolist()
    assert families.subset(np.arange(len(X))) is families
    nothing = families.subset(np.empty(0, int))
    assert len(nothing) == nothing.bonds == 0
    assert nothing.per_bond(X).shape == (0, 2)


@pytest.mark.parametrize(
    ("influence", "values"),  # at r = |xi| / delta = 0.25, 0.5, 1
    [
        ("constant", (1, 1, 1)),
        ("inverse", (4, 2, 1)),
        ("linear", (0.75, 0.5, 0)),
        ("cubic", (1 - 3 / 16 + 2 / 64, 0.5, 0)),
        ("gaussian", (np.exp(-0.25), np.exp(-1), np.exp(-4))),
    ],
)
def test_influence(influence, values):
    X = np.array([[0.0, 0.0], [0.0, 0.5], [1.0, 0.0], [-2.0, 0.0]])
    horizon = np.full(4, 2.0)
    families = find_families(X, horizon, np.arange(4), 1)
    weights = bond_weights(families, X, horizon, np.ones(4), INFLUENCE[influence], "none")
    assert weights == pytest.approx(values, abs=1e-15)
    assert set(INFLUENCE) == {"constant", "inverse", "linear", "cubic", "gaussian"}


def test_partial_volume():
    """Seed 000 Eq. 81 with r = dx/2: whole inside delta - r, half at delta, by the spacing of the neighbour."""
    X = np.array([[0.0], [2.0], [2.75], [-3.0], [3.0]])
    horizon = np.full(5, 3.0)
    spacing = np.array([9.0, 1.0, 1.0, 1.0, 2.0])
    families = find_families(X, horizon, np.arange(5), 1)
    weights = bond_weights(families, X, horizon, spacing, INFLUENCE["constant"], "linear")
    assert weights == pytest.approx([1, 0.75, 0.5, 0.5])
    doubled = bond_weights(families, X, horizon, spacing, INFLUENCE["inverse"], "linear")
    assert doubled == pytest.approx([1.5, 0.75 * 3 / 2.75, 0.5, 0.5])


def test_weights_are_found_block_by_block(monkeypatch):
    X, horizon = cloud("graded", 2)
    families = find_families(X, horizon, np.arange(len(X)), len(X))
    spacing = np.random.default_rng(1).uniform(0.8, 1.2, len(X))
    weights = bond_weights(families, X, horizon, spacing, INFLUENCE["cubic"], "linear")
    monkeypatch.setattr("pdpetsc.bonds.BLOCK", 70)
    assert np.array_equal(bond_weights(families, X, horizon, spacing, INFLUENCE["cubic"], "linear"), weights)
    with pytest.raises(InputError, match=r"influence: is -1 at r = "):
        bond_weights(families, X, horizon, spacing, lambda r: np.where(r == r.min(), -1, 1), "none")
    X = np.append(X, [[40.0, 0.0], [40.0, 1.0]], axis=0)  # see only each other, at their horizons
    horizon = np.append(horizon, [1.0, 1.0])
    families = find_families(X, horizon, np.arange(len(X)), len(X))
    with pytest.raises(InputError, match=r"is zero at all neighbours of the particle at \(40, 0\)"):
        bond_weights(families, X, horizon, np.ones(len(X)), INFLUENCE["linear"], "none")
