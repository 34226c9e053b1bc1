"""Local gradients by which fields go over to the parts of particles."""

import numpy as np
from numba import njit

from pdpetsc.bonds import Families
from pdpetsc.fracture import LEAST_SPAN
from pdpetsc.particles import Particles

FLAT = 1e-10
"""Ratio of a shape tensor's eigenvalues at which it does not span the space."""


def gradients(
    p: Particles, families: Families, intact: np.ndarray | None, chosen: np.ndarray, fields: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """grad q = sum_j V_j (q_j - q_i) (x) xi K^-1, K = sum_j V_j xi (x) xi, over the bonds that are left, for chosen
    particles; 0 at others, and where the bonds that are left do not span the space (collective).

    Args:
        intact: (bonds,) mask of the bonds that are left; None: all.
        chosen: (owned,) mask.
        fields: (owned, dim) each.

    Returns:
        (owned, dim, dim) of the same names, d q_i / d X_j.
    """
    dim, result = p.dim, {}
    members = np.flatnonzero(chosen[families.center])
    whole, left = (np.zeros((len(members), dim, dim)) for _ in range(2))
    bonds = families.center, families.offsets, families.neighbours
    mask = np.ones(families.bonds, bool) if intact is None else intact
    _shapes(members, *bonds, mask, p.position, p.volume, whole, left)
    values, vectors = np.linalg.eigh(left)
    sound = (values[:, 0] >= LEAST_SPAN * np.linalg.eigvalsh(whole)[:, 0]) & (values[:, 0] > FLAT * values[:, -1])
    inverse = np.einsum("nik,nk,njk->nij", vectors, 1 / np.where(sound[:, None], values, 1.0), vectors)
    for name, field in fields.items():
        local = np.empty((p.local, dim))
        local[: p.owned] = field
        p.exchange.forward(local)
        moment = np.zeros_like(left)
        _moments(members, *bonds, mask, p.position, p.volume, local, moment)
        gradient = np.zeros((p.owned, dim, dim))
        gradient[families.center[members]] = np.where(sound[:, None, None], moment @ inverse, 0.0)
        result[name] = gradient
    return result


@njit(cache=True)
def _shapes(members, center, offsets, neighbours, intact, X, volume, whole, left):
    """Fill the shape tensors of these families, with all bonds and with those that are left."""
    dim = X.shape[1]
    for n in range(len(members)):
        f = members[n]
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            j = neighbours[b]
            for k in range(dim):
                for m in range(dim):
                    value = volume[j] * (X[j, k] - X[i, k]) * (X[j, m] - X[i, m])
                    whole[n, k, m] += value
                    if intact[b]:
                        left[n, k, m] += value


@njit(cache=True)
def _moments(members, center, offsets, neighbours, intact, X, volume, q, moment):
    """Fill sum_j V_j (q_j - q_i) (x) xi of these families, over the bonds that are left."""
    dim = X.shape[1]
    for n in range(len(members)):
        f = members[n]
        i = center[f]
        for b in range(offsets[f], offsets[f + 1]):
            if intact[b]:
                j = neighbours[b]
                for k in range(dim):
                    for m in range(dim):
                        moment[n, k, m] += volume[j] * (q[j, k] - q[i, k]) * (X[j, m] - X[i, m])
