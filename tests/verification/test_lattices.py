"""What plain lattices give: the expectations of plain variants of `strip_tension`, from a program of its own.

Small strains, all bonds in one sparse matrix, solved at once; it shares nothing with the package. (The package works
with large displacements, and a strain of 1e-4 shows in the fourth digit.)
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

CASE = Path(__file__).parents[2] / "pdpetsc" / "cases" / "strip_tension.toml"
E, DELTA, LENGTH, WIDTH, FORCE = 200e3, 3.015, 81, 20, 400.0


def strip(model: str, nu: float, plane: str) -> tuple[float, float]:
    """Elongation of 10 mm and contraction of 7 mm in the middle of the strip, spacing 1 mm."""
    axes = [np.arange(n) - (n - 1) / 2 for n in (LENGTH, WIDTH)]
    X = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    pairs = cKDTree(X).query_pairs(DELTA, output_type="ndarray")
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    length = np.linalg.norm(X[j] - X[i], axis=1)
    n = (X[j] - X[i]) / length[:, None]
    bond = np.arange(len(i))
    columns = np.concatenate([2 * j, 2 * j + 1, 2 * i, 2 * i + 1])
    extension = csr_matrix((np.concatenate([*n.T, *-n.T]), (np.tile(bond, 4), columns)), (len(i), 2 * len(X)))
    G, K = E / 2 / (1 + nu), E / 2 / (1 - nu) if plane == "stress" else E / 2 / (1 + nu) / (1 - 2 * nu)
    if model == "bond":
        k, c, A = 6 * K / np.pi / DELTA**3 / length, 0 * length, 0.0
    elif model == "ordinary":
        m = np.bincount(i, length**2)[i]
        k, c, A = 8 * G / m, 2 * length / m, K - 2 * G
    else:
        a, b, d = (K - 2 * G) / 2, 6 * G / np.pi / DELTA**4, 2 / np.pi / DELTA**3
        k, c, A = 2 * b * DELTA / length, d * DELTA / length, 2 * a
    dilatation = csr_matrix((c, (i, bond))) @ extension
    stiffness = (extension.T @ diags(k) @ extension + A * dilatation.T @ dilatation).tocsc()
    force = np.zeros(2 * len(X))
    for side in (-1, 1):
        end = side * X[:, 0] > LENGTH / 2 - DELTA
        force[::2] += side * FORCE * end / end.sum()

    def at(x, y):
        return int(np.argmin(np.hypot(X[:, 0] - x, X[:, 1] - y)))

    free = np.setdiff1d(np.arange(2 * len(X)), [2 * at(0, -0.5), 2 * at(0, 0.5), 2 * at(0, -3.5) + 1])
    u = np.zeros(2 * len(X))
    u[free] = spsolve(stiffness[free][:, free], force[free])
    return u[::2][np.abs(X[:, 0] - 10) < 0.1].mean(), u[2 * at(0, 3.5) + 1]


@pytest.mark.parametrize("variant", ("plain", "plain_plane_strain", "bond_plain", "abd"))
def test_expectations_of_plain_strips(variant):
    case = tomllib.loads(CASE.read_text())
    sheet = case["material"]["sheet"] | case["variant"][variant]["material"]["sheet"]
    expected = {e["value"]: e for e in case["variant"][variant]["expect"]}
    for found, name in zip(strip(sheet["model"], sheet["nu"], sheet["plane"]), ("elongation", "contraction")):
        expectation = expected[f"probes.{name}"]
        assert found == pytest.approx(expectation["equals"], rel=max(1e-4, expectation["rtol"]))
