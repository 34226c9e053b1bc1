"""Moment-matched weights: bonds that integrate the fourth moment of their directions as an isotropic family would.

A family on a lattice does not, and its shear modulus depends on the direction; a family at a free surface has bonds on
one side only. Both are cured by the least change of each family's weights (FORMULATION, Corrections; ours, in the
spirit of the reproducing quadrature of Trask, You, Yu and Parks, 2018). With xi = |xi| n, dimension d and the isotropic
tensor I4_pqrs = (d_pq d_rs + d_pr d_qs + d_ps d_qr) / (d (d + 2)), a family gets weights w = x w_ref such that

    sum w V |xi|^2 n n n n = M I4,    lowest <= x <= highest,    sum a (x - 1)^2 least.

w_ref are the plain weights scaled to the moment M, and a = w_ref V |xi|^2 / M is the share of a bond in it, so that M
and the units drop out. Let Q be n n n n as a vector of the 1, 5 or 15 components of a symmetric tensor, each times the
root of its number, so that |Q| = 1. Then

    A x = sum a x Q = I4,    x = clip(1 + Q . l, lowest, highest),

where the multipliers l maximise a concave function whose gradient is I4 - A x: Newton's method for the dual. A bond's
factor x depends on its direction alone. A matched family has the energy of the isotropic solid in every affine field,
at a free surface too; all weights stay positive, so no energy is negative.

In corners, along edges of three-dimensional bodies and in small families no x within the bounds will do: where all
bonds point into one quadrant of a plane, their n_1 n_2 are of one sign. Such a family gets the closest moment instead,

    |A x - I4|^2 + closeness sum a (x - 1)^2 least, within the bounds and with M, the trace of A x, kept exactly,

by the same dual less closeness |l'|^2 / 2, where l' is l without its part along I4. Left with their plain weights,
those families would make thin bodies too stiff (LPS) or too soft (bond-based models).
"""

import math
from collections import Counter
from itertools import combinations_with_replacement

import numpy as np
from numba import njit

from pdpetsc.bonds import Families

LOWEST, HIGHEST = 0.05, 5.0
"""Bounds of w / w_ref: weights stay positive, so every family's energy does, and none dominates."""

CLOSENESS = 1e-3
"""Price of the change of weights beside that of the moment's error, in families that cannot be matched."""

TOLERANCE = 1e-12
"""Largest |A x - I4| of a matched family; Newton goes on to rounding."""

ROUNDING = 4e-15
ITERATIONS = 60

SAME = 2e-13
"""Families are the same but for rounding if no bond differs by more of the shortest one and of the mean share."""

REMEMBERED = 16
"""Solved families to compare the next one with: more than the kinds of them in a row of a lattice, 7 at m = 3."""


def matched_weights(
    families: Families, position: np.ndarray, volume: np.ndarray, weight: np.ndarray, moment: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Weights w with sum w V |xi|^2 n n n n = M I4 in every family where 0.05 <= w / w_ref <= 5 allows it.

    A family takes the factors x of one of the last ones that is the same but for rounding, as most are in a lattice, or
    is solved by itself, in a few microseconds: order and distribution of particles change weights by rounding alone.

    Args:
        families: families of the owned particles.
        position: (local, dim) reference positions [m].
        volume: (local,) volumes V [m^3].
        weight: (bonds,) plain weights w_0 >= 0; a bond without weight or volume keeps its w_0 and takes no part.
        moment: (families,) prescribed M = sum w V |xi|^2; by default that of the plain weights.

    Returns:
        w, (bonds,), and matched, (families,) bool. A family that is not matched has the closest moment within the
        bounds instead, and M exactly; a family without any weight keeps none and is not matched.
    """
    components, root, target = _isotropic_moment(position.shape[1])
    result = np.array(weight, dtype=np.float64)
    matched = np.zeros(len(families), np.bool_)
    prescribed = np.empty(0) if moment is None else np.ascontiguousarray(moment, dtype=np.float64)
    X, V = (np.ascontiguousarray(values, dtype=np.float64) for values in (position, volume))
    bonds = families.center, families.offsets, families.neighbours
    _match(*bonds, X, V, prescribed, components, root, target, result, matched)
    return result, matched


def _isotropic_moment(dim: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Components pqrs (p <= q <= r <= s) of a symmetric tensor, the root of the number of each, and I4 in them."""
    components = list(combinations_with_replacement(range(dim), 4))
    number = [24 / math.prod(math.factorial(k) for k in Counter(pqrs).values()) for pqrs in components]
    d = np.eye(dim)
    isotropic = [d[p, q] * d[r, s] + d[p, r] * d[q, s] + d[p, s] * d[q, r] for p, q, r, s in components]
    root = np.sqrt(number)
    return np.array(components), root, root * np.array(isotropic) / (dim * (dim + 2))


@njit(cache=True)
def _match(center, offsets, neighbours, X, volume, moment, components, root, target, weight, matched):
    """Match `weight` in place, family by family."""
    terms, dim = len(target), X.shape[1]
    most = 0
    for f in range(len(center)):
        most = max(most, offsets[f + 1] - offsets[f])
    bond = np.empty(most, np.int64)
    part = np.empty((dim + 1, most))
    Q = np.empty((terms, most))
    work = np.empty((2, most))
    sizes = np.zeros(REMEMBERED, np.int64)
    known = np.empty((REMEMBERED, dim + 1, most))
    x = np.empty((REMEMBERED, most))
    success = np.empty(REMEMBERED, np.bool_)
    same, oldest = 0, 0
    for f in range(len(center)):
        size, total, shortest, farthest = _take_part(f, center, offsets, neighbours, X, volume, weight, bond, part)
        if size == 0:
            continue
        same = _recall(size, SAME * shortest, SAME * total / size, part, sizes, known, same)
        if same < 0:
            same, oldest = oldest, (oldest + 1) % REMEMBERED
            sizes[same] = size
            known[same] = part
            _normalise(size, total, part, components, root, Q)
            precision = 8 * np.finfo(np.float64).eps * farthest / shortest
            success[same] = _solve((size, Q, part[dim], target, x[same], work[0], work[1]), max(TOLERANCE, precision))
        matched[f] = success[same]
        scale = moment[f] / total if len(moment) else 1.0
        for b in range(size):
            weight[bond[b]] *= scale * x[same, b]


@njit(cache=True)
def _take_part(f, center, offsets, neighbours, X, volume, weight, bond, part):
    """Bonds of family f that take part: their numbers, and in the columns of `part` xi and w V |xi|^2.

    Returns:
        Their number, the sum of w V |xi|^2, the shortest |xi|, and the largest coordinate, whose rounding is in xi.
    """
    dim = X.shape[1]
    i = center[f]
    size = 0
    total = 0.0
    shortest = np.inf
    farthest = 0.0
    for b in range(offsets[f], offsets[f + 1]):
        j = neighbours[b]
        if not weight[b] * volume[j] > 0:
            continue
        square = 0.0
        for p in range(dim):
            part[p, size] = X[j, p] - X[i, p]
            square += part[p, size] ** 2
            farthest = max(farthest, abs(X[j, p]))
        shortest = min(shortest, square)
        part[dim, size] = weight[b] * volume[j] * square
        total += part[dim, size]
        bond[size] = b
        size += 1
    return size, total, np.sqrt(shortest), farthest


@njit(cache=True)
def _recall(size, step, share, part, sizes, known, latest):
    """Which known family has the same bonds within `step` and the same w V |xi|^2 within `share`; -1 if none has."""
    last = len(part) - 1
    for shift in range(REMEMBERED):
        k = (latest + shift) % REMEMBERED
        same = sizes[k] == size
        for p in range(last + 1):
            allowed = step if p < last else share
            for b in range(size):
                if not same:
                    break
                same = abs(part[p, b] - known[k, p, b]) <= allowed
        if same:
            return k
    return -1


@njit(cache=True)
def _normalise(size, total, part, components, root, Q):
    """Make directions and shares of xi and w V |xi|^2, and Q of the directions."""
    dim = len(part) - 1
    for b in range(size):
        square = 0.0
        for p in range(dim):
            square += part[p, b] ** 2
        length = np.sqrt(square)
        for p in range(dim):
            part[p, b] /= length
        part[dim, b] /= total
    for c in range(len(Q)):
        p, q, r, s = components[c]
        for b in range(size):
            Q[c, b] = root[c] * part[p, b] * part[q, b] * part[r, b] * part[s, b]


@njit(cache=True)
def _solve(family, tolerance):
    """Find the factors x of a family: whether they match it.

    Directions are as precise as positions give them: a constraint that holds by symmetry, such as sin 4 phi on a square
    lattice of horizon 2, holds no better and cannot be improved; the tolerance is not below that.
    """
    size, _, _, target, x, _, _ = family
    l = np.empty(len(target))
    if _maximise(family, 0.0, l, tolerance):
        return True
    if not _maximise(family, CLOSENESS, l, tolerance):
        x[:size] = 1.0
    return False


@njit(cache=True)
def _maximise(family, price, l, tolerance):
    """Damped Newton for the dual function from l = 0: whether its gradient vanishes. Leaves x(l) in the family."""
    terms = len(l)
    gradient = np.empty(terms)
    factor = np.empty((terms, terms))
    family[-1][:] = -1.0
    l[:] = 0.0
    value, _ = _dual(family, price, l, gradient)
    error = _norm(gradient)
    for _ in range(ITERATIONS):
        if error <= ROUNDING:
            return True
        if _is_new(family):
            _factorise(family, price, factor)
        step = gradient.copy()
        _substitute(factor, step)
        slope = 0.0
        for c in range(terms):
            slope += gradient[c] * step[c]
        length = 1.0
        while True:
            trial = l + length * step
            trial_value, largest = _dual(family, price, trial, gradient)
            if price == 0 and largest < -tolerance * _norm(trial):
                return False
            if trial_value >= value + 1e-4 * length * slope - 1e-15 * (1 + abs(value)):
                break
            length /= 2
            if length < 1e-9:
                return False
        l[:] = trial
        value = trial_value
        before = error
        error = _norm(gradient)
        if before <= tolerance and error > 0.5 * before:  # as good as rounding allows
            break
    return error <= tolerance


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dual(family, price, l, gradient):
    """Value and gradient of the dual function at l, and the largest l . (A y - I4) of all y within the bounds.

    Less than zero, the latter proves that there is no solution: |A y - I4| >= -largest / |l| for all y.
    """
    size, Q, share, target, x, t, _ = family
    terms = len(target)
    value = 0.0
    square = 0.0
    t[:size] = 0.0
    for c in range(terms):
        value += l[c] * target[c]
        square += target[c] ** 2
        for b in range(size):
            t[b] += l[c] * Q[c, b]
    largest = -value
    along = value / square
    for b in range(size):
        x[b] = min(max(1 + t[b], LOWEST), HIGHEST)
        value += share[b] * ((x[b] - 1) ** 2 / 2 - t[b] * x[b])
        largest += share[b] * t[b] * (HIGHEST if t[b] > 0 else LOWEST)
        t[b] = share[b] * x[b]
    for c in range(terms):
        moment = 0.0
        for b in range(size):
            moment += t[b] * Q[c, b]
        other = l[c] - along * target[c]
        value -= price * other**2 / 2
        gradient[c] = target[c] - moment - price * other
    return value, largest


@njit(cache=True)
def _is_new(family):
    """Note which bonds are between the bounds, 1 or 0: whether others were at the last call."""
    size, _, _, _, x, _, free = family
    new = False
    for b in range(size):
        now = 1.0 if LOWEST < x[b] < HIGHEST else 0.0
        new |= now != free[b]
        free[b] = now
    return new


@njit(cache=True, fastmath={"reassoc", "contract"})
def _factorise(family, price, factor):
    """Cholesky factor of the dual's negative Hessian: sum a Q Q over bonds between the bounds, and that of the price.

    A little of the identity stands in for constraints that hold by symmetry, where gradient and Hessian vanish.
    """
    size, Q, share, target, _, part, free = family
    terms = len(target)
    square = 0.0
    for c in range(terms):
        square += target[c] ** 2
    for c in range(terms):
        for b in range(size):
            part[b] = free[b] * share[b] * Q[c, b]
        for e in range(c + 1):
            value = -price * target[c] * target[e] / square
            for b in range(size):
                value += part[b] * Q[e, b]
            factor[c, e] = value
        factor[c, c] += price + 1e-12
    for c in range(terms):
        for e in range(c + 1):
            value = factor[c, e]
            for k in range(e):
                value -= factor[c, k] * factor[e, k]
            factor[c, e] = value / factor[e, e] if e < c else np.sqrt(max(value, 1e-13))


@njit(cache=True)
def _substitute(factor, step):
    """Solve with a Cholesky factor, in place."""
    terms = len(step)
    for c in range(terms):
        for e in range(c):
            step[c] -= factor[c, e] * step[e]
        step[c] /= factor[c, c]
    for c in range(terms - 1, -1, -1):
        for e in range(c + 1, terms):
            step[c] -= factor[e, c] * step[e]
        step[c] /= factor[c, c]


@njit(cache=True)
def _norm(vector):
    square = 0.0
    for value in vector:
        square += value**2
    return np.sqrt(square)
