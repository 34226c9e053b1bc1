"""Bonds that cracks cut, against exact orientations and by hand."""

from fractions import Fraction

import numpy as np
import pytest
from bodies import distributed, families_of, jittered
from models import lattice

from pdpetsc.body.cracks import cut_bonds
from pdpetsc.bonds import find_families
from pdpetsc.errors import InputError


def crack(*vertices):
    return [list(vertex) for vertex in vertices]


def cut_pairs(X, horizon, *cracks, ids=None):
    """Families of particles on this process, and the pairs (i, j) of the bonds that are cut."""
    ids = np.arange(len(X)) if ids is None else ids
    families = find_families(X, np.broadcast_to(horizon, len(X)), ids, len(X))
    pairs = np.stack([families.per_bond(np.arange(len(X))), families.neighbours], axis=1)
    return pairs, cut_bonds(families, X, ids, list(cracks)).any(axis=0)


def segments(*bonds):
    """Bonds given by their ends, as families of one: whether each is cut, looked at from either end."""

    def cut(*cracks):
        answers = []
        for a, b in bonds:
            X = np.array([a, b], float)
            for ids in ([0, 1], [1, 0]):
                _, mask = cut_pairs(X, 1e9, *cracks, ids=np.array(ids))
                answers.append(mask.tolist())
            assert answers[-1] == answers[-2] and len(set(answers[-1])) == 1
        return [a[0] for a in answers[::2]]

    return cut


def volume(*points):
    """Sign of the determinant of p1 - p0, p2 - p0, ... in exact arithmetic."""
    rows = [[Fraction(x) - Fraction(o) for x, o in zip(p, points[0])] for p in points[1:]]
    if len(rows) == 2:
        value = rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]
    else:
        (a, b, c), (d, e, f), (g, h, i) = rows
        value = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return (value > 0) - (value < 0)


def test_in_1d():
    X = lattice((6,))  # 0.5 ... 5.5
    pairs, cut = cut_pairs(X, 2.5, crack([2.2]))
    assert np.array_equal(cut, (pairs.min(axis=1) <= 1) & (pairs.max(axis=1) >= 2))
    pairs, cut = cut_pairs(X, 2.5, crack([2.5]), crack([5.2]))  # on a particle: nothing holds it any more
    one = (pairs.min(axis=1) <= 2) & (pairs.max(axis=1) >= 2)
    assert np.array_equal(cut, one | (pairs.max(axis=1) == 5))


def test_in_2d_against_exact_orientations():
    X = jittered((9, 7), 0.4)
    ends = np.random.default_rng(0).uniform(0, 7, (5, 2, 2))
    for a, b in ends:
        pairs, cut = cut_pairs(X, 2.5, crack(a, b))
        expected = [
            volume(a, b, X[i]) != volume(a, b, X[j]) and volume(X[i], X[j], a) != volume(X[i], X[j], b)
            for i, j in pairs
        ]
        assert cut.tolist() == expected and any(expected)
    _, together = cut_pairs(X, 2.5, *(crack(*e) for e in ends))
    assert np.array_equal(together, np.any([cut_pairs(X, 2.5, crack(*e))[1] for e in ends], axis=0))


def test_in_3d_against_exact_orientations():
    X = jittered((5, 4, 4), 0.4)
    rng = np.random.default_rng(2)
    for a, b, c in rng.uniform(0, 5, (4, 3, 3)):
        pairs, cut = cut_pairs(X, 2.0, crack(a, b, c))
        expected = []
        for i, j in pairs:
            sides = {volume(X[i], X[j], p, q) for p, q in ((a, b), (b, c), (c, a))}
            expected.append(volume(a, b, c, X[i]) != volume(a, b, c, X[j]) and len(sides) == 1)
        assert cut.tolist() == expected and any(expected)


def test_a_polygon_that_is_not_convex():
    """An L, rolled through all its corners and turned round, in a tilted plane."""
    outline = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], float)
    e1, e2, e3 = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    base = np.array([1.0, -2.0, 0.5])
    x, y = np.meshgrid(np.linspace(-0.55, 3.45, 21), np.linspace(-0.55, 3.45, 21))
    spots = np.stack([x.ravel(), y.ravel()], axis=1)
    inside = (spots > 0).all(axis=1) & (spots < 3).all(axis=1) & (spots < 1).any(axis=1)
    bonds = [(base + s @ [e1, e2] + 0.3 * e3, base + s @ [e1, e2] - 0.1 * e3) for s in spots]
    for order in (outline, outline[::-1], np.roll(outline, 2, axis=0)):
        assert segments(*bonds)(crack(*(base + order @ [e1, e2]))) == inside.tolist()


def test_touching_counts_in_2d():
    cut = segments(
        ([-1, 1], [1, 1]),  # meets the tip
        ([-1, 1 + 1e-8], [1, 1 + 1e-8]),  # passes it
        ([-1, 0.5], [0, 0.5]),  # ends on it
        ([-1, 0.5], [-1e-8, 0.5]),  # ends before it
        ([0, 0.2], [0, 0.8]),  # lies in it
        ([0, 0.5], [0, 2]),
        ([0, 1], [0, 2]),  # goes on from its tip
        ([0.1, 0], [0.1, 1]),  # beside it
        ([-1, 2], [1, 0]),  # meets the tip at an angle
    )
    expected = [True, False, True, False, False, False, False, False, True]
    assert cut(crack([0, 0], [0, 1])) == expected
    assert cut(crack([0, 1], [0, 0])) == expected


def test_touching_counts_in_3d():
    cut = segments(
        ([1, 1, -1], [1, 1, 1]),  # through a corner
        ([0.5, 0, -1], [0.5, 0, 1]),  # through an edge
        ([0.5, -1e-8, -1], [0.5, -1e-8, 1]),
        ([0.5, 0.5, 0], [0.5, 0.5, 1]),  # from a point of it
        ([0.2, 0.5, 0], [0.8, 0.5, 0]),  # in it
        ([-1, 0.5, 0], [2, 0.5, 0]),
        ([-1, 0.5, 0.1], [2, 0.5, 0.1]),  # beside it
    )
    assert cut(crack([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0])) == [True, True, False, True, False, False, False]


def test_a_lattice_with_a_crack_through_its_particles():
    """Particles on the crack keep the bonds along it."""
    X = lattice((6, 5))
    pairs, cut = cut_pairs(X, 1.5, crack([0.0, 2.5], [6.0, 2.5]))
    on = X[:, 1] == 2.5
    assert np.array_equal(cut, on[pairs[:, 0]] != on[pairs[:, 1]])


@pytest.mark.parametrize("scale", (1e-6, 1e6))
def test_the_unit_of_length_does_not_matter(scale):
    X = lattice((6, 5))
    _, cut = cut_pairs(X, 1.5, crack([0.0, 2.0], [3.5, 2.5]))
    _, scaled = cut_pairs(scale * X, scale * 1.5, crack([0.0, scale * 2.0], [scale * 3.5, scale * 2.5]))
    assert np.array_equal(cut, scaled) and cut.any()


@pytest.mark.parametrize(
    ("dim", "vertices", "message"),
    [
        (1, [[0.0], [1.0]], "a crack in 1D needs one position"),
        (2, [[0.0, 0.0]], "a crack in 2D needs two points"),
        (3, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "a crack in 3D needs three points or more"),
        (2, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "a crack in 2D needs two points of 2 coordinate"),
        (2, [[0.3, 0.1], [0.3, 0.1]], "the crack has no length"),
        (2, [[0.3, np.inf], [0.3, 0.1]], "finite"),
        (3, [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.3, 0.3, 0.3]], "the crack has no area"),
        (3, [[1.0, 2.0, 3.0]] * 3, "the crack has no area"),
        (3, [[0, 0, 0], [1, 0, 0], [1, 1, 1e-5], [0, 1, 0]], "do not lie in a plane: one is 2.5e-06 away"),
    ],
)
def test_what_is_no_crack(dim, vertices, message):
    X = lattice((3,) * dim)
    sound = crack(*{1: [[0.2]], 2: [[0, 0], [1, 1]], 3: [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}[dim])
    with pytest.raises(InputError, match=rf"body\.cracks\.1: .*{message}"):
        cut_pairs(X, 1.5, sound, crack(*vertices))


def test_a_nearly_plane_polygon():
    _, cut = cut_pairs(lattice((3, 3, 3)), 1.5, crack([0, 0, 1], [3, 0, 1], [3, 3, 1 + 1e-7], [0, 3, 1]))
    assert cut.any()


@pytest.mark.mpi
@pytest.mark.parametrize("dim", (2, 3))
def test_alike_from_both_ends_and_on_all_ranks(comm, dim):
    """Some cracks go through particles and along rows of them, where rounding decides."""
    counts, third = ((14, 9), []) if dim == 2 else ((7, 6, 5), [0.0])
    tilted = ([0.1, 0.1, *third], [9.3, 5.3, *third]), ([0.5, 0.5, *third], [4.5, 4.5, *third])
    cracks = [crack(*ends) if dim == 2 else crack(*ends, [*ends[1][:2], 2.5], [*ends[0][:2], 2.5]) for ends in tilted]
    X, horizon = 0.1 * lattice(counts), np.random.default_rng(0).uniform(0.16, 0.3, np.prod(counts))
    cracks = [[[0.1 * x for x in vertex] for vertex in c] for c in cracks]
    p = distributed(X, horizon, spacing=0.1)
    families = families_of(p)
    cut = cut_bonds(families, p.position, p.id, cracks).any(axis=0)
    pairs = np.stack([p.id[families.per_bond(np.arange(p.local))], p.id[families.neighbours]], axis=1)[cut]
    found = {tuple(pair) for part in comm.allgather(pairs.tolist()) for pair in part}
    pairs, cut = cut_pairs(X, horizon, *cracks)
    assert found == {tuple(pair) for pair in pairs[cut].tolist()}
    both = {tuple(pair) for pair in pairs.tolist()}
    assert found and all((j, i) in found for i, j in found if (j, i) in both)
