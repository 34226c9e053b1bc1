"""Small tensor algebra for one particle, compiled: determinants, inverses and spectra from the displacement gradient.

Everything is written in H = F - I, expanded so that small strains keep their full relative accuracy.
Arrays are `dim x dim` with dim = 1, 2 or 3.
"""

import numpy as np
from numba import njit

EXACT = {"error_model": "numpy", "fastmath": False, "_nrt": False}
"""How the algebra is compiled: nothing is reordered, even where a caller's sums may be; x/0 gives inf or NaN."""


@njit(cache=True, **EXACT)
def jacobian_excess(H):
    """J - 1 = det(I + H) - 1, expanded so that it keeps its accuracy for small H."""
    n = H.shape[0]
    if n == 1:
        return H[0, 0]
    if n == 2:
        return H[0, 0] + H[1, 1] + (H[0, 0] * H[1, 1] - H[0, 1] * H[1, 0])
    second = (
        H[0, 0] * H[1, 1] - H[0, 1] * H[1, 0]
        + H[0, 0] * H[2, 2] - H[0, 2] * H[2, 0]
        + H[1, 1] * H[2, 2] - H[1, 2] * H[2, 1]
    )  # fmt: skip
    third = (
        H[0, 0] * (H[1, 1] * H[2, 2] - H[1, 2] * H[2, 1])
        - H[0, 1] * (H[1, 0] * H[2, 2] - H[1, 2] * H[2, 0])
        + H[0, 2] * (H[1, 0] * H[2, 1] - H[1, 1] * H[2, 0])
    )
    return H[0, 0] + H[1, 1] + H[2, 2] + second + third


@njit(cache=True, **EXACT)
def inverse_transpose(H, J, out):
    """F^-T for F = I + H with determinant J."""
    n = H.shape[0]
    if n == 1:
        out[0, 0] = 1.0 / J
    elif n == 2:
        out[0, 0] = (1.0 + H[1, 1]) / J
        out[1, 1] = (1.0 + H[0, 0]) / J
        out[0, 1] = -H[1, 0] / J
        out[1, 0] = -H[0, 1] / J
    else:
        for i in range(3):
            i1, i2 = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                j1, j2 = (j + 1) % 3, (j + 2) % 3
                a = H[i1, j1] + (1.0 if i1 == j1 else 0.0)
                b = H[i2, j2] + (1.0 if i2 == j2 else 0.0)
                c = H[i1, j2] + (1.0 if i1 == j2 else 0.0)
                d = H[i2, j1] + (1.0 if i2 == j1 else 0.0)
                out[i, j] = (a * b - c * d) / J


@njit(cache=True, **EXACT)
def eigen_symmetric(S, Q, n):
    """Jacobi rotations: on return S is diagonal (the eigenvalues) and the columns of Q are its eigenvectors."""
    for i in range(n):
        for j in range(n):
            Q[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        off = 0.0
        size = 0.0
        for p in range(n):
            size += S[p, p] * S[p, p]
            for q in range(p + 1, n):
                off += S[p, q] * S[p, q]
        if off <= 1e-34 * size:
            break
        for p in range(n):
            for q in range(p + 1, n):
                if S[p, q] == 0.0:
                    continue
                theta = 0.5 * (S[q, q] - S[p, p]) / S[p, q]
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(n):
                    a, b = S[k, p], S[k, q]
                    S[k, p], S[k, q] = c * a - s * b, s * a + c * b
                for k in range(n):
                    a, b = S[p, k], S[q, k]
                    S[p, k], S[q, k] = c * a - s * b, s * a + c * b
                S[p, q] = 0.0
                S[q, p] = 0.0
                for k in range(n):
                    a, b = Q[k, p], Q[k, q]
                    Q[k, p], Q[k, q] = c * a - s * b, s * a + c * b


@njit(cache=True, **EXACT)
def spectral_stretch(H, D, Q):
    """Spectral form of D = F F^T - I = H + H^T + H H^T, in place; its eigenvalues are squared stretches minus one."""
    n = H.shape[0]
    for i in range(n):
        for j in range(i, n):
            value = H[i, j] + H[j, i]
            for k in range(n):
                value += H[i, k] * H[j, k]
            D[i, j] = value
            D[j, i] = value
    eigen_symmetric(D, Q, n)


@njit(cache=True, **EXACT)
def green_strain(H, E):
    """E = 1/2 (H + H^T + H^T H)."""
    n = H.shape[0]
    for i in range(n):
        for j in range(n):
            value = H[i, j] + H[j, i]
            for k in range(n):
                value += H[k, i] * H[k, j]
            E[i, j] = 0.5 * value


@njit(cache=True, **EXACT)
def mean_logarithmic_slope(a, b):
    """(ln(1 + a) - ln(1 + b)) / (a - b) with its limit 1/(1 + b) at a = b."""
    x = (a - b) / (1.0 + b)
    return (np.log1p(x) / x if x != 0.0 else 1.0) / (1.0 + b)


@njit(cache=True, **EXACT)
def logarithm_deficit(x):
    """x - ln(1 + x), with full relative accuracy where it is x^2/2."""
    if abs(x) > 0.2:
        return x - np.log1p(x)
    r = x / (2.0 + x)  # ln(1 + x) = 2 (r + r^3/3 + r^5/5 + ...) and x - 2 r = r x
    series = 0.0
    for k in range(21, 1, -2):
        series = (series + 2.0 / k) * r * r
    return r * (x - series)


@njit(cache=True, **EXACT)
def invalid(H):
    """Whether F = I + H is inverted, singular or not a number."""
    return not jacobian_excess(H) > -1.0
