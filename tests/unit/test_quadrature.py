"""Matched weights: fourth moments of whole families, against what isotropy, linear programming and optimality say."""

from itertools import combinations_with_replacement, product

import numpy as np
import pytest
from scipy.optimize import linprog

from pdpetsc.bonds import Families, find_families
from pdpetsc.quadrature import CLOSENESS, HIGHEST, LOWEST, TOLERANCE, matched_weights


def isotropic(dim: int) -> np.ndarray:
    """I4 = (d_pq d_rs + d_pr d_qs + d_ps d_qr) / (d (d + 2))."""
    d = np.eye(dim)
    pairs = np.einsum("pq,rs->pqrs", d, d) + np.einsum("pr,qs->pqrs", d, d) + np.einsum("ps,qr->pqrs", d, d)
    return pairs / (dim * (dim + 2))


class Body:
    """Points with their families and plain weights: constant, or 1 - r, which is zero at the horizon."""

    def __init__(self, points, horizon, influence="constant", seed=0):
        self.X = points
        self.dim = points.shape[1]
        self.horizon = np.broadcast_to(np.asarray(horizon, float), len(points)).copy()
        self.volume = np.random.default_rng(seed).uniform(0.8, 1.2, len(points)) if seed else np.ones(len(points))
        self.families = find_families(points, self.horizon, np.arange(len(points)), len(points))
        self.of = self.families.per_bond(np.arange(len(points)))
        self.xi = points[self.families.neighbours] - points[self.of]
        self.length = np.linalg.norm(self.xi, axis=1)
        r = np.minimum(self.length / self.horizon[self.of], 1)
        self.plain = np.ones_like(r) if influence == "constant" else 1 - r

    def sum(self, per_bond):
        total = np.zeros((len(self.X), *per_bond.shape[1:]))
        np.add.at(total, self.of, per_bond)
        return total

    def share(self, w):
        """w V |xi|^2 of each bond."""
        return w * self.volume[self.families.neighbours] * self.length**2

    def moment(self, w):
        return self.sum(self.share(w))

    def fourth_moment(self, w):
        """sum w V |xi|^2 n n n n of each family over its sum w V |xi|^2."""
        n = self.xi / self.length[:, None]
        moments = np.array(
            [self.moment(w * np.prod(n[:, pqrs], axis=1)) for pqrs in product(range(self.dim), repeat=4)]
        )
        return (moments / self.moment(w)).T.reshape(-1, *4 * [self.dim])

    def matched(self, moment=None):
        return matched_weights(self.families, self.X, self.volume, self.plain, moment)

    def error(self, w):
        """Largest component of the fourth moment's error in each family."""
        return np.abs(self.fourth_moment(w) - isotropic(self.dim)).reshape(len(self.X), -1).max(axis=1)


def lattice(n: int, dim: int, jitter: float = 0.0) -> np.ndarray:
    axes = np.meshgrid(*dim * [np.arange(n) + 0.5], indexing="ij")
    points = np.stack(axes, axis=-1).reshape(-1, dim)
    return points + np.random.default_rng(1).uniform(-jitter, jitter, points.shape)


def size_of(tensors: np.ndarray) -> np.ndarray:
    return np.sqrt((tensors**2).reshape(len(tensors), -1).sum(axis=1))


def one_family(size: int) -> Families:
    """The family of the first of size + 1 particles."""
    return Families(np.zeros(1, np.int32), np.array([0, size]), np.arange(1, size + 1, dtype=np.int32))


BODIES = {
    "2D": lambda: Body(lattice(9, 2), 3.015),
    "3D": lambda: Body(lattice(8, 3), 3.015),
    "2D, m = 2": lambda: Body(lattice(7, 2), 2.015),
    "3D, linear influence": lambda: Body(lattice(8, 3), 3.0, "linear"),
    "2D, jitter": lambda: Body(lattice(12, 2, 0.2), 3.015, seed=2),
    "3D, jitter": lambda: Body(lattice(8, 3, 0.2), 3.015, "linear", seed=2),
    "2D, random": lambda: Body(np.random.default_rng(3).uniform(0, 12, (144, 2)), 3.5, seed=3),
    "3D, random": lambda: Body(np.random.default_rng(4).uniform(0, 7, (343, 3)), 3.2, "linear", seed=3),
}


@pytest.fixture(scope="module", params=BODIES, ids=list(BODIES))
def body(request):
    return BODIES[request.param]()


def test_moments_are_isotropic_and_weights_within_their_bounds(body):
    w, matched = body.matched()
    assert np.mean(matched) > 0.5
    assert body.error(w)[matched].max() <= 1e-12
    assert body.moment(w) == pytest.approx(body.moment(body.plain), rel=1e-12)
    ratio = w[body.plain > 0] / body.plain[body.plain > 0]
    assert np.all((ratio >= LOWEST * (1 - 1e-14)) & (ratio <= HIGHEST * (1 + 1e-14)))
    assert np.all(w[body.plain == 0] == 0)


def test_prescribed_moments_scale_the_weights(body):
    w, matched = body.matched()
    M = np.random.default_rng(0).uniform(1, 9, len(body.X))
    scaled, same = body.matched(M)
    assert np.all(same == matched)
    assert body.moment(scaled) == pytest.approx(M, rel=1e-12)
    assert scaled == pytest.approx(w * (M / body.moment(body.plain))[body.of], rel=1e-13)


def test_unmatched_families_have_the_closest_moment(body):
    """The optimum of a convex problem is where x = clip(1 + Q . (I4 - A x) / closeness + constant)."""
    w, matched = body.matched()
    error = isotropic(body.dim) - body.fourth_moment(w)
    for f in np.flatnonzero(~matched):
        bonds = np.flatnonzero((body.of == f) & (body.plain > 0))
        n = body.xi[bonds] / body.length[bonds, None]
        x = w[bonds] / body.plain[bonds]
        unbounded = 1 + np.einsum("pqrs,bp,bq,br,bs->b", error[f], n, n, n, n) / CLOSENESS
        free = (x > 1.0001 * LOWEST) & (x < 0.9999 * HIGHEST)
        assert free.any()
        unbounded += np.mean((x - unbounded)[free])
        assert x == pytest.approx(np.clip(unbounded, LOWEST, HIGHEST), abs=1e-8)
    assert np.all(size_of(error[~matched]) < size_of(isotropic(body.dim) - body.fourth_moment(body.plain))[~matched])


@pytest.mark.parametrize("dim", (2, 3))
@pytest.mark.parametrize("surface", (False, True))
def test_matched_with_least_change_just_where_linear_programming_finds_a_solution(dim, surface):
    """x has the least sum a (x - 1)^2 / 2 if and only if no feasible y has a smaller sum a (x - 1) y than x itself."""
    rng = np.random.default_rng(7)
    outcomes = []
    for _ in range(30):
        size = int(rng.integers(4, 25 if dim == 2 else 90))
        X = np.vstack([np.zeros(dim), rng.uniform(-1, 1, (size, dim))])
        if surface:
            X[:, 0] = np.abs(X[:, 0])
        volume, plain = rng.uniform(0.5, 1.5, size + 1), rng.uniform(0.1, 2, size)
        w, matched = matched_weights(one_family(size), X, volume, plain)
        square = (X[1:] ** 2).sum(axis=1)
        n = X[1:] / np.sqrt(square)[:, None]
        share = plain * volume[1:] * square
        share /= share.sum()
        A = share * np.array([np.prod(n[:, pqrs], axis=1) for pqrs in combinations_with_replacement(range(dim), 4)])
        target = [isotropic(dim)[pqrs] for pqrs in combinations_with_replacement(range(dim), 4)]
        x = w / plain
        change = share * (x - 1)
        best = linprog(change, A_eq=A, b_eq=target, bounds=(LOWEST, HIGHEST), method="highs")
        assert matched[0] == (best.status == 0)
        if matched[0]:
            assert np.abs(A @ x - target).max() < TOLERANCE
            assert change @ x == pytest.approx(best.fun, abs=1e-6)
        outcomes.append(matched[0])
    assert 0 < np.mean(outcomes) < 1


@pytest.mark.parametrize(("n", "dim"), [(9, 2), (8, 3)])
def test_all_families_of_a_lattice_but_those_of_corners_and_edges_are_matched(n, dim):
    body = Body(lattice(n, dim), 3.015)
    outermost = ((body.X < 1) | (n - 1 < body.X)).sum(axis=1)
    assert np.all(body.matched()[1] == (outermost < 2))


@pytest.mark.parametrize("dim", (2, 3))
def test_moduli_are_those_of_the_isotropic_solid_in_the_bulk_and_at_a_free_surface(dim):
    """LPS: C = (K - (d + 2) G / d) 1 (x) 1 + d (d + 2) G / m sum w V |xi|^2 n n n n; bond-based: the sum, M = d^2 K."""
    n, K, G = 8, 1.7, 0.6
    body = Body(lattice(n, dim), 3.015)
    rng = np.random.default_rng(5)
    M = np.full(len(body.X), dim**2 * K)
    bond_based, matched = body.matched(M)
    centre = np.argmin(np.linalg.norm(body.X - n / 2, axis=1))
    face = np.argmin(np.linalg.norm(body.X - n / 2 * np.array([0, 1, 1])[:dim], axis=1))
    one = np.einsum("pq,rs->pqrs", np.eye(dim), np.eye(dim))
    for f in (centre, face):
        assert matched[f]
        lps = (K - (dim + 2) * G / dim) * one + dim * (dim + 2) * G * body.fourth_moment(body.matched()[0])[f]
        bonds = (body.moment(bond_based)[:, None, None, None, None] * body.fourth_moment(bond_based))[f]
        for _ in range(20):
            a, b = np.linalg.qr(rng.normal(size=(dim, dim)))[0][:2]
            assert np.einsum("pqrs,p,q,r,s", lps, a, b, a, b) == pytest.approx(G, rel=1e-12)
            assert np.einsum("pqrs,p,q,r,s", lps, a, a, a, a) == pytest.approx(K + 2 * (1 - 1 / dim) * G, rel=1e-12)
            assert np.einsum("pqrs,p,q,r,s", bonds, a, b, a, b) == pytest.approx(dim * K / (dim + 2), rel=1e-12)
        assert np.einsum("ppqq", bonds) == pytest.approx(dim**2 * K, rel=1e-12)


@pytest.mark.parametrize("unit", (1e-6, 1e6))
def test_the_unit_of_length_does_not_matter(body, unit):
    w, matched = body.matched()
    scaled, same = matched_weights(body.families, unit * body.X, unit**3 * body.volume, 5 * body.plain)
    assert np.all(same == matched)
    assert scaled == pytest.approx(5 * w, rel=1e-9)


def test_order_and_company_of_the_families_do_not_matter(body):
    """To the last digit with the same neighbours in the same order; else to rounding."""
    w, matched = body.matched()
    chosen = np.arange(1, len(body.X), 3)
    part, part_matched = matched_weights(
        body.families.subset(chosen), body.X, body.volume, body.plain[np.isin(body.of, chosen)]
    )
    assert np.array_equal(part, w[np.isin(body.of, chosen)])
    assert np.array_equal(part_matched, matched[chosen])

    order = np.argsort(np.random.default_rng(1).random(body.families.bonds) + body.of)
    f = body.families
    shuffled = Families(f.center, f.offsets, f.neighbours[order])
    again, again_matched = matched_weights(shuffled, body.X, body.volume, body.plain[order])
    assert np.array_equal(again_matched, matched)
    assert again == pytest.approx(w[order], rel=1e-8)


@pytest.mark.parametrize("jitter", (0.0, 1e-11))
@pytest.mark.parametrize(("n", "dim"), [(11, 2), (8, 3)])
def test_families_that_are_the_same_have_the_same_weights(n, dim, jitter):
    """As each has by itself; those of a lattice are the same but for rounding, those of a slightly shaken one not."""
    body = Body(0.1 * lattice(n, dim, jitter) + 0.3, 0.3015)
    w, matched = body.matched()
    for f in range(len(body.X)):
        one, by_itself = matched_weights(
            body.families.subset(np.array([f])), body.X, body.volume, body.plain[body.of == f]
        )
        assert by_itself[0] == matched[f]
        assert w[body.of == f] == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize("dim", (2, 3))
def test_families_far_from_the_origin(dim):
    """Constraints that symmetry satisfies, such as sin 4 phi = 0 at m = 2, are as exact as the directions are."""
    near, far = Body(0.1 * lattice(7, dim), 0.2015), Body(0.1 * lattice(7, dim) + 1e5, 0.2015)
    w, matched = near.matched()
    distant, same = far.matched()
    assert np.all(matched == same)
    assert distant == pytest.approx(w, rel=1e-6)


def test_bonds_without_weight_or_volume_take_no_part():
    body = Body(lattice(9, 2), 3.015)
    rng = np.random.default_rng(2)
    body.volume[rng.integers(0, 81, 5)] = 0.0
    body.plain[rng.integers(0, body.families.bonds, 100)] = 0.0
    nothing = body.volume[body.families.neighbours] == 0
    w, matched = body.matched()
    assert np.all(w[body.plain == 0] == 0)
    assert np.array_equal(w[nothing], body.plain[nothing])
    assert body.error(w)[matched].max() < 1e-12
    left = (body.plain > 0) & ~nothing
    sizes = np.bincount(body.of[left], minlength=81)
    less = Families(body.families.center, np.concatenate([[0], np.cumsum(sizes)]), body.families.neighbours[left])
    assert np.array_equal(matched_weights(less, body.X, body.volume, body.plain[left])[0], w[left])


def test_one_dimension_has_a_single_moment():
    body = Body(np.random.default_rng(1).uniform(0, 40, (60, 1)), 4.0, "linear", seed=1)
    w, matched = body.matched()
    assert matched.all()
    assert w == pytest.approx(body.plain, rel=1e-14)
    M = np.linspace(1, 2, 60)
    w, matched = body.matched(M)
    assert matched.all()
    assert w == pytest.approx(body.plain * (M / body.moment(body.plain))[body.of], rel=1e-14)


def test_families_without_bonds_or_weights():
    nobody = Families(np.empty(0, np.int32), np.zeros(1, np.int64), np.empty(0, np.int32))
    w, matched = matched_weights(nobody, np.empty((0, 2)), np.empty(0), np.empty(0))
    assert len(w) == len(matched) == 0
    X = np.array([[0.0, 0.0], [1.0, 0.0]])
    families = Families(np.arange(2, dtype=np.int32), np.array([0, 0, 1]), np.zeros(1, np.int32))
    w, matched = matched_weights(families, X, np.ones(2), np.zeros(1))
    assert (w.tolist(), matched.tolist()) == ([0.0], [False, False])
    w, matched = matched_weights(families, X, np.ones(2), np.ones(1), np.array([3.0, 3.0]))
    assert w == pytest.approx([3.0], rel=1e-14)  # one bond cannot be isotropic, but has its moment
    assert not matched.any()
