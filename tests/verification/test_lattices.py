"""What plain lattices give: expectations of plain variants of `strip_tension` and `bar_tension`, by another program.

Small strains, all bonds in one sparse matrix, solved at once; it shares nothing with the package. (The package works
with large displacements, and a strain of 1e-4 shows in the fourth digit.)
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

CASES = Path(__file__).parents[2] / "pdpetsc" / "cases"
E, DELTA, STRESS = 200e3, 3.015, 20.0
HELD = {  # components and places
    "strip_tension": [(0, (0, -0.5)), (0, (0, 0.5)), (1, (0, -3.5))],
    "bar_tension": [
        (0, (0, -0.5, -0.5)), (0, (0, 0.5, -0.5)), (0, (0, -0.5, 0.5)), (1, (0, -1.5, -0.5)), (1, (0, -1.5, 0.5)),
        (2, (0, -0.5, -1.5)),
    ],
}  # fmt: skip
SIZES = {"strip_tension": (81, 20), "bar_tension": (41, 10, 10)}
GAUGES = {"strip_tension": {"contraction": (1, (0, 3.5))}, "bar_tension": {"contraction_y": (1, (0, 1.5, -0.5))}}


def pulled(case: str, model: str, nu: float, plane: str) -> dict[str, float]:
    """Probes of the pulled lattice, spacing 1 mm: elongation of 10 mm, and contraction across the middle."""
    size = SIZES[case]
    n = len(size)
    axes = [np.arange(count) - (count - 1) / 2 for count in size]
    X = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    pairs = cKDTree(X).query_pairs(DELTA, output_type="ndarray")
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    length = np.linalg.norm(X[j] - X[i], axis=1)
    direction = (X[j] - X[i]) / length[:, None]
    bond = np.arange(len(i))
    columns = np.concatenate([*(n * j + k for k in range(n)), *(n * i + k for k in range(n))])
    values = np.concatenate([*direction.T, *-direction.T])
    extension = csr_matrix((values, (np.tile(bond, 2 * n), columns)), (len(i), n * len(X)))
    G = E / 2 / (1 + nu)
    K = E / 2 / (1 - nu) if plane == "stress" else E / 3 / (1 - 2 * nu) + (G / 3 if n == 2 else 0)
    if model == "bond":
        c = 12 * K / np.pi / DELTA**3 if n == 2 else 18 * K / np.pi / DELTA**4
        k, share, A = c / 2 / length, 0 * length, 0.0
    elif model == "ordinary":
        m = np.bincount(i, length**2)[i]
        k, share, A = n * (n + 2) * G / m, n * length / m, K - (n + 2) * G / n
    else:
        a, b, d = (K - 2 * G) / 2, 6 * G / np.pi / DELTA**4, 2 / np.pi / DELTA**3
        k, share, A = 2 * b * DELTA / length, d * DELTA / length, 2 * a
    dilatation = csr_matrix((share, (i, bond))) @ extension
    force = np.zeros(X.shape)
    for side in (-1, 1):
        end = side * X[:, 0] > size[0] / 2 - DELTA
        force[:, 0] += side * STRESS * np.prod(size[1:]) * end / end.sum()

    def at(component, place):
        return n * int(np.argmin(np.linalg.norm(X - place, axis=1))) + component

    free = np.setdiff1d(np.arange(X.size), [at(*held) for held in HELD[case]])
    B, T = extension[:, free], dilatation[:, free]
    K = (B.T @ diags(k) @ B + A * T.T @ T).tocsr()
    u, f = np.zeros(X.size), force.ravel()[free]
    for _ in range(4):  # each to 1e-5 of what is left
        u[free] += cg(K, f - K @ u[free], M=diags(1 / K.diagonal()))[0]
    assert np.linalg.norm(f - K @ u[free]) < 1e-9 * np.linalg.norm(f)
    section = np.abs(X[:, 0] - 10) < 0.1
    return {"elongation": u[::n][section].mean()} | {name: u[at(*gauge)] for name, gauge in GAUGES[case].items()}


@pytest.mark.parametrize(
    ("case", "variant"),
    [
        ("strip_tension", "plain"),
        ("strip_tension", "plain_plane_strain"),
        ("strip_tension", "bond_plain"),
        ("strip_tension", "abd"),
        ("bar_tension", "plain"),
        ("bar_tension", "bond_plain"),
    ],
)
def test_expectations_of_plain_lattices(case, variant):
    document = tomllib.loads((CASES / f"{case}.toml").read_text())
    (name,) = document["material"]
    material = document["material"][name] | document["variant"][variant]["material"][name]
    expected = {e["value"]: e for e in document["variant"][variant]["expect"]}
    found = pulled(case, material["model"], material["nu"], material.get("plane", "strain"))
    for probe, value in found.items():
        expectation = expected[f"probes.{probe}"]
        assert value == pytest.approx(expectation["equals"], rel=max(1e-4, expectation["rtol"]))
