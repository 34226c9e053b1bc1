"""Bonds that cracks cut, against exact orientations and by hand."""

from fractions import Fraction

import numpy as np
import pytest
from bodies import distributed, families_of, jittered
from models import lattice

from pdpetsc.body.cracks import Ends, cut_bonds, level_set_crack, sheets_crack
from pdpetsc.body.sheets import disc, polygons
from pdpetsc.bonds import find_families
from pdpetsc.errors import InputError


def crack(*vertices):
    return sheets_crack(polygons(np.array([vertices], float), "body.cracks.1"))


def cut_pairs(X, horizon, *cracks, ids=None):
    """Families of particles on this process, and the pairs (i, j) of the bonds that are cut."""
    ids = np.arange(len(X)) if ids is None else ids
    families = find_families(X, np.broadcast_to(horizon, len(X)), ids, len(X))
    pairs = np.stack([families.per_bond(np.arange(len(X))), families.neighbours], axis=1)
    return pairs, cut_bonds(families, Ends(X, np.broadcast_to(horizon, len(X)), ids), list(cracks)).any(axis=0)


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
        (2, [[0.3, 0.1], [0.3, 0.1]], "the crack has no length"),
        (2, [[0.3, np.inf], [0.3, 0.1]], "finite"),
        (3, [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.3, 0.3, 0.3]], "the crack has no area"),
        (3, [[1.0, 2.0, 3.0]] * 3, "the crack has no area"),
        (3, [[0, 0, 0], [1, 0, 0], [1, 1, 1e-5], [0, 1, 0]], "is not plane: a corner is 2.5e-06 away"),
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


def test_a_disc():
    """In a tilted plane, against the distance of the crossing from the centre; its edge counts."""
    X = jittered((7, 6, 6), 0.4)
    center, across, radius = np.array([3.1, 2.9, 3.2]), np.array([1.0, -2.0, 2.0]) / 3, 1.7
    pairs, cut = cut_pairs(X, 2.0, sheets_crack(disc(center, across, radius)))
    height = (X - center) @ across
    a, b = height[pairs].T
    with np.errstate(all="ignore"):
        crossing = X[pairs[:, 0]] + (a / (a - b))[:, None] * (X[pairs[:, 1]] - X[pairs[:, 0]])
        expected = (a * b < 0) & (np.linalg.norm(crossing - center, axis=1) < radius)
    assert np.array_equal(cut, expected) and 50 < cut.sum() < len(cut) / 2
    edge = segments(([0, 1, -1], [0, 1, 1]), ([0, 1 + 1e-8, -1], [0, 1 + 1e-8, 1]), ([0.1, 0, 0], [0.2, 0.1, 0]))
    assert edge(sheets_crack(disc((0, 0, 0), (0, 0, 1), 1.0))) == [True, False, False]


def test_a_level_set_is_the_line_that_it_describes():
    X = jittered((9, 7), 0.4)
    level = level_set_crack(lambda X: 3 * X[:, 1] - X[:, 0] - 6, lambda X: (X[:, 0] > 1.5) & (X[:, 0] < 6.3))
    _, cut = cut_pairs(X, 2.5, crack([1.5, 2.5], [6.3, 4.1]))
    pairs, same = cut_pairs(X, 2.5, level)
    assert np.array_equal(cut, same) and cut.any()
    _, everywhere = cut_pairs(X, 2.5, level_set_crack(level_of := lambda X: 3 * X[:, 1] - X[:, 0] - 6, None))
    assert np.array_equal(everywhere, (level_of(X)[pairs] > 0).sum(axis=1) == 1)


@pytest.mark.parametrize("scale", (1e-6, 1.0, 1e6))
def test_a_level_set_through_particles(scale):
    """Particles on it keep the bonds along it, whatever the rounding of their places; the condition holds at them."""
    X = scale * (0.1 * lattice((6, 5)) + 0.1)
    row = X[:, 1] == X[12, 1]

    def level(X):
        return (X[:, 1] / 3 - 0.35 * scale / 3) * (1 + X[:, 0] ** 2 / scale**2)

    pairs, cut = cut_pairs(X, 0.15 * scale, level_set_crack(level, None))
    assert np.array_equal(cut, row[pairs[:, 0]] != row[pairs[:, 1]]) and cut.any()
    pairs, cut = cut_pairs(X, 0.15 * scale, level_set_crack(level, lambda X: X[:, 0] < 0.3 * scale))
    on = np.where(row[pairs[:, 0]], pairs[:, 0], pairs[:, 1])
    assert np.array_equal(cut, (row[pairs[:, 0]] != row[pairs[:, 1]]) & (X[on, 0] < 0.3 * scale))


def test_a_level_set_that_jumps():
    """Between two regions."""
    X = lattice((6, 5))

    def region(X):
        return np.where((X[:, 0] < 2.2) & (X[:, 1] < 3.1), -1.0, 1.0)

    pairs, cut = cut_pairs(X, 2.5, level_set_crack(region, lambda X: X[:, 1] < 2.0))
    differ = region(X)[pairs[:, 0]] != region(X)[pairs[:, 1]]
    assert 0 < cut.sum() < differ.sum() and not (cut & ~differ).any()


def sphere(n: int) -> np.ndarray:
    """Triangles (n, 3, 3) of a sphere of radius 1, between points on it."""
    u, v = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    points = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    lower, upper = np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)
    return np.concatenate([lower[:-1].reshape(-1, 3, 3), upper[1:].reshape(-1, 3, 3)])


@pytest.mark.parametrize("size", (0.3, 3.0))
def test_many_sheets_are_as_good_as_one_after_the_other(size):
    """A sphere of hundreds of triangles, smaller or larger than the bonds, against its triangles by themselves and
    against inside and outside."""
    X = jittered((8, 7, 7), 0.4)
    triangles = size * sphere(9) + [4.03, 3.51, 3.48]
    pairs, cut = cut_pairs(X, 2.1, sheets_crack(polygons(triangles, "")))
    single = [cut_pairs(X, 2.1, sheets_crack(polygons(t[None], "")))[1] for t in triangles]
    assert np.array_equal(cut, np.any(single, axis=0)) and cut.any()
    distance = np.linalg.norm(X - [4.03, 3.51, 3.48], axis=1)[pairs] / size
    through = (distance.min(axis=1) < 0.95) & (distance.max(axis=1) > 1)
    outside = distance.min(axis=1) > 2.2 / size + 1
    within = distance.max(axis=1) < 0.9
    assert cut[through].all() and not cut[outside | within].any()


@pytest.mark.mpi
@pytest.mark.parametrize("dim", (2, 3))
def test_alike_from_both_ends_and_on_all_ranks(comm, dim):
    """Some cracks go through particles and along rows of them, where rounding decides."""
    counts, third = ((14, 9), []) if dim == 2 else ((7, 6, 5), [0.0])
    tilted = ([0.1, 0.1, *third], [9.3, 5.3, *third]), ([0.5, 0.5, *third], [4.5, 4.5, *third])
    ends = 0.1 * np.array(tilted)
    cracks = [crack(*e) if dim == 2 else crack(*e, [*e[1][:2], 0.25], [*e[0][:2], 0.25]) for e in ends]
    cracks.append(level_set_crack(lambda X: X[:, 1] - 0.25 - X[:, 0] ** 2, lambda X: X[:, 0] < 0.4))
    if dim == 3:
        cracks.append(sheets_crack(disc((0.35, 0.3, 0.25), (0.0, 0.0, 1.0), 0.2)))
    X, horizon = 0.1 * lattice(counts), np.random.default_rng(0).uniform(0.16, 0.3, np.prod(counts))
    p = distributed(X, horizon, spacing=0.1)
    families = families_of(p)
    cut = cut_bonds(families, Ends(p.position, p.horizon, p.id), cracks).any(axis=0)
    pairs = np.stack([p.id[families.per_bond(np.arange(p.local))], p.id[families.neighbours]], axis=1)[cut]
    found = {tuple(pair) for part in comm.allgather(pairs.tolist()) for pair in part}
    pairs, cut = cut_pairs(X, horizon, *cracks)
    assert found == {tuple(pair) for pair in pairs[cut].tolist()}
    both = {tuple(pair) for pair in pairs.tolist()}
    assert found and all((j, i) in found for i, j in found if (j, i) in both)
