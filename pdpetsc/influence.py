"""Influence functions, and with partial volumes the weight of each bond."""

from collections.abc import Callable

import numpy as np

from pdpetsc.bonds import Families
from pdpetsc.errors import InputError
from pdpetsc.partial_volume import PARTIAL_VOLUME

Influence = Callable[[np.ndarray], np.ndarray]

INFLUENCE: dict[str, Influence] = {
    "constant": lambda r: np.ones_like(r),
    "inverse": lambda r: 1 / r,
    "linear": lambda r: 1 - r,
    "cubic": lambda r: 1 - 3 * r**2 + 2 * r**3,
    "gaussian": lambda r: np.exp(-((2 * r) ** 2)),
}
"""Influence functions w(r), r = |xi| / delta: 1, 1/r, 1 - r, the cubic spline 1 - 3r^2 + 2r^3 and exp(-(2r)^2)."""


def influence_function(chosen) -> Influence:
    """That of a case's `influence`: a name in INFLUENCE, or an expression of r."""
    return INFLUENCE[chosen] if isinstance(chosen, str) else lambda r: chosen(r=r)


def bond_weights(
    families: Families, position: np.ndarray, horizon: np.ndarray, spacing: np.ndarray, influence: Influence,
    partial: str,
) -> np.ndarray:  # fmt: skip
    """Influence times partial-volume factor w beta of each bond [-]; bonds up to the tolerance have w(1) at most.

    `partial` is a name in PARTIAL_VOLUME, or "none".

    Raises:
        InputError: a weight is negative or no number, or all weights of a family are zero.
    """
    if influence is INFLUENCE["constant"] and partial == "none":
        return np.ones(families.bonds)
    weight = np.empty(families.bonds)
    for part, bonds in families.blocks():
        length = part.lengths(position)
        delta = part.per_bond(horizon)
        r = np.minimum(length / delta, 1.0)
        w = influence(r)
        if partial != "none":
            xi = position[part.neighbours] - part.per_bond(position)
            w = w * PARTIAL_VOLUME[partial](xi, delta, spacing[part.neighbours])
        wrong = np.flatnonzero(~((w >= 0) & (w < np.inf)))
        if len(wrong):
            raise InputError(
                f"influence: is {w[wrong[0]]:g} at r = {r[wrong[0]]:g}; it must be finite and not negative"
            )
        without = part.center[np.flatnonzero(part.sums(w) == 0)]
        if len(without):
            where = ", ".join(f"{x:g}" for x in position[without[0]])
            raise InputError(
                f"influence: is zero at all neighbours of the particle at ({where}), so that no bond holds it; choose "
                "another function or a larger horizon"
            )
        weight[bonds] = w
    return weight


def influence_moment(influence: Influence, power: int) -> float:
    """Integral of w(r) r^power from 0 to 1, by Gauss's rule on 64 intervals."""
    x, w = np.polynomial.legendre.leggauss(8)
    edges = np.arange(64) / 64
    r = (edges[:, None] + (x + 1) / 128).ravel()
    return float(np.sum(influence(r) * r**power * np.tile(w / 128, 64)))
