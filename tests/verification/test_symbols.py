"""Waves on infinite lattices: condition numbers of the preconditioned tangent, as docs/theory/tangent.md has them."""

from itertools import product

import numpy as np
import pytest

SHARE = 0.3
POISSON = 0.25


def lattice_bonds(dim: int, horizon: float) -> np.ndarray:
    reach = range(-int(horizon) - 1, int(horizon) + 2)
    return np.array([v for v in product(reach, repeat=dim) if 0 < np.dot(v, v) <= horizon**2], float)


def springs(xi, k, wave):
    """sum k n n of both directions of each bond, for u = a exp(i k.X)."""
    n = xi / np.linalg.norm(xi, axis=1)[:, None]
    return np.einsum("b,bp,bq->pq", k * 2 * (1 - np.cos(xi @ wave)), n, n)


def compact(dim, lame, shear):
    xi = lattice_bonds(dim, 1.5)
    square = (xi**2).sum(axis=1)
    k = square ** (dim - 3.0)
    k *= dim * (dim + 2) * np.sqrt(shear * (lame + 2 * shear) / 3) / (k * square).sum()
    return lambda wave: springs(xi, k, wave)


def solid(dim, horizon, lame, shear):
    """The LPS: its symbol and its diagonal block."""
    xi = lattice_bonds(dim, horizon)
    length = np.linalg.norm(xi, axis=1)
    m = (length**2).sum()
    k = np.full(len(xi), dim * (dim + 2) * shear / m)
    A = lame + 2 * shear / dim - (dim + 2) * shear / dim
    c = dim * xi / m

    def symbol(wave):
        theta = (c * np.sin(xi @ wave)[:, None]).sum(axis=0)
        return springs(xi, k, wave) + A * np.outer(theta, theta)

    n = xi / length[:, None]
    return symbol, 2 * np.einsum("b,bp,bq->pq", k, n, n) + A * c.T @ c


def correspondence(dim, horizon, lame, shear):
    """Small strains, with the control `silling` of strength 1."""
    xi, one = lattice_bonds(dim, horizon), np.eye(dim)
    K = xi.T @ xi
    g = xi @ np.linalg.inv(K)
    control = shear / np.linalg.eigvalsh(K)[-1]
    tensor = lame * np.einsum("pq,rs->pqrs", one, one)
    tensor += shear * (np.einsum("pr,qs->pqrs", one, one) + np.einsum("ps,qr->pqrs", one, one))

    def symbol(wave):
        kappa = (g * np.sin(xi @ wave)[:, None]).sum(axis=0)
        rest = (2 * (1 - np.cos(xi @ wave))).sum() - kappa @ K @ kappa
        return np.einsum("pqrs,q,s->pr", tensor, kappa, kappa) + control * rest * one

    diagonal = np.einsum("pqrs,bq,bs->pr", tensor, g, g)
    return symbol, diagonal + control * (2 * len(xi) - np.einsum("bq,qs,bs->", g, K, g)) * one


def condition(dim, horizon, model, poisson):
    """Of C^-1 T and of (C^-1 + 0.3 diag(T)^-1) T, over waves along and across the lattice."""
    shear = 1 / (2 * (1 + poisson))
    lame = poisson / ((1 + poisson) * (1 - 2 * poisson))
    symbol, diagonal = model(dim, horizon, lame, shear)
    C, short = compact(dim, lame, shear), SHARE * np.linalg.inv(diagonal)
    steps = np.linspace(0.02, np.pi, 16)
    waves = [*product(steps, repeat=dim), *((step, *[0.0] * (dim - 1)) for step in steps)]
    values = np.array(
        [
            [np.linalg.eigvals(M @ symbol(np.array(k))).real for M in (C_inverse, C_inverse + short)]
            for k in waves
            for C_inverse in [np.linalg.inv(C(np.array(k)))]
        ]
    )
    return values.max(axis=(0, 2)) / values.min(axis=(0, 2))


@pytest.mark.parametrize("model", (solid, correspondence))
@pytest.mark.parametrize("horizon", (2.015, 3.015, 4.015))
@pytest.mark.parametrize("dim", (2, 3))
def test_short_waves(dim, horizon, model):
    """The sum is conditioned alike for every horizon; the compact stiffness alone gets worse."""
    alone, both = condition(dim, horizon, model, POISSON)
    assert both < 3.6
    assert both < alone
    if horizon > 3:
        assert alone > 2.3 * both
    assert condition(dim, horizon, model, 0.45)[1] < 10
