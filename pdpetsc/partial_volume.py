"""Partial volumes: the fraction of a neighbour's cell that lies within the horizon.

A cell is the interval, square or cube of width dx around the neighbour, sides along the axes, and its part in the ball
of radius delta about the family's center is exact, in closed form. With the ball about the origin, let G be the part of
the box [0, a] x [0, b] x [0, c] in it, odd in each argument; the part of a cell is the sum of +-G over its corners. At
the height z the ball is a disc of radius rho = (delta^2 - z^2)^(1/2), and the rectangle has in it

    ab  where rho^2 >= a^2 + b^2,  elsewhere  T(a) + T(b) - pi rho^2/4,
    T(a) = (a (rho^2 - a^2)^(1/2) + rho^2 asin(a/rho))/2,  and pi rho^2/4 where rho < a,

the quarter disc less what is beyond x = a and y = b. In two dimensions that is G; in three it is integrated from z = 0
to c, T by parts, with k^2 = delta^2 - a^2 and r = (k^2 - z^2)^(1/2):

    2 int T dz = (delta^2 z - z^3/3) atan(a/r) + a z r (1/2 + 1/6) + a asin(z/k) (k^2/2 - k^2/6 + 2 delta^2/3)
                 - 2 delta^3/3 atan(a z/(delta r)) .

Rounding leaves errors of about 1e-16 (delta/dx)^dim.
"""

import numpy as np
from numba import njit


def linear(xi: np.ndarray, horizon: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """beta = (delta + r - |xi|) / 2r in [0, 1] with r = dx/2 (seed 000 Eq. 81, which prints r = 2 dx).

    Args:
        xi: (bonds, dim) vectors to the neighbours [length].
        horizon: (bonds,) delta of the families' centers [length].
        spacing: (bonds,) dx of the neighbours [length].
    """
    return np.clip((horizon + spacing / 2 - np.sqrt((xi**2).sum(axis=1))) / spacing, 0, 1)


def exact(xi: np.ndarray, horizon: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """The fraction itself; arguments as of `linear`."""
    fraction = np.empty(len(xi))
    _fractions(xi, horizon, spacing, fraction)
    return fraction


PARTIAL_VOLUME = {"linear": linear, "exact": exact}
"""Partial-volume factors beta in [0, 1] by their names in case files."""


@njit(cache=True)
def _fractions(xi, horizon, spacing, fraction):
    dim = xi.shape[1]
    edge = np.empty(3)
    for b in range(len(xi)):
        radius, half = horizon[b], spacing[b] / 2
        nearest, farthest = 0.0, 0.0
        for p in range(dim):
            nearest += max(abs(xi[b, p]) - half, 0.0) ** 2
            farthest += (abs(xi[b, p]) + half) ** 2
        if farthest <= radius**2:
            fraction[b] = 1.0
        elif nearest >= radius**2:
            fraction[b] = 0.0
        else:
            part = 0.0
            for corner in range(2**dim):
                sign = 1.0
                for p in range(dim):
                    side = 1.0 if (corner >> p) % 2 else -1.0
                    x = xi[b, p] + side * half
                    sign *= side if x > 0.0 else -side
                    edge[p] = abs(x)
                if dim == 1:
                    part += sign * min(edge[0], radius)
                elif dim == 2:
                    part += sign * _rectangle(edge[0], edge[1], radius)
                else:
                    part += sign * _box(edge[0], edge[1], edge[2], radius)
            fraction[b] = min(max(part / spacing[b] ** dim, 0.0), 1.0)


@njit(cache=True)
def _rectangle(a, b, radius):
    """Area of [0, a] x [0, b] in a disc."""
    if a * a + b * b <= radius * radius:
        return a * b
    return _beside(a, radius) + _beside(b, radius) - np.pi * radius**2 / 4


@njit(cache=True)
def _beside(a, radius):
    """T(a): area of the quarter disc with x < a."""
    if a >= radius:
        return np.pi * radius**2 / 4
    r = np.sqrt(radius**2 - a * a)
    return (a * r + radius**2 * np.arctan2(a, r)) / 2


@njit(cache=True)
def _box(a, b, c, radius):
    """Volume of [0, a] x [0, b] x [0, c] in a ball."""
    top = min(c, radius)
    whole = min(np.sqrt(max(radius**2 - a * a - b * b, 0.0)), top)  # up to there all of the rectangle is inside
    volume = a * b * whole
    if whole < top:
        volume += _slab(a, top, radius) - _slab(a, whole, radius)
        volume += _slab(b, top, radius) - _slab(b, whole, radius)
        volume -= np.pi / 4 * (_discs(top, radius) - _discs(whole, radius))
    return volume


@njit(cache=True)
def _discs(z, radius):
    """Integral of rho^2 from 0 to z."""
    return radius**2 * z - z**3 / 3


@njit(cache=True)
def _slab(a, z, radius):
    """Integral of T(a) from 0 to z."""
    if a >= radius:
        return np.pi / 4 * _discs(z, radius)
    k = np.sqrt(radius**2 - a * a)
    if z > k:
        return _slab_to(a, k, k, radius) + np.pi / 4 * (_discs(z, radius) - _discs(k, radius))
    return _slab_to(a, z, k, radius)


@njit(cache=True)
def _slab_to(a, z, k, radius):
    """The same for z <= k."""
    r = np.sqrt(max(k * k - z * z, 0.0))
    angle = np.arctan2(z, r)  # asin(z/k)
    return 0.5 * (
        _discs(z, radius) * np.arctan2(a, r)
        + a * z * r * (2 / 3)
        + a * angle * (k * k / 3 + 2 / 3 * radius**2)
        - 2 / 3 * radius**3 * np.arctan2(a * z, radius * r)
    )
