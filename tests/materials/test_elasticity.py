"""The elastic laws alone: P against dW/dF, A against dP/dF, exact values, and accuracy at strains of 1e-12."""

import numpy as np
import pytest
from models import rotation
from numba import njit

from pdpetsc.materials import elasticity
from pdpetsc.materials.elasticity import LAWS, elastic_law

YOUNG, POISSON = 1.0, 0.3


@njit(cache=True)
def _energy(law, H, work):
    return elasticity.energy_density(law, H, work)


@njit(cache=True)
def _piola(law, H, P, work):
    elasticity.first_piola(law, H, P, work)


@njit(cache=True)
def _tensor(law, H, A, work):
    elasticity.elasticity_tensor(law, H, A, work)


def work():
    return np.full((8, 3, 3), np.nan)  # scratch: nobody may rely on what is in it


def energy(law, H):
    return _energy(law, np.ascontiguousarray(H, float), work())


def piola(law, H):
    P = np.empty(H.shape)
    _piola(law, np.ascontiguousarray(H, float), P, work())
    return P


def tensor(law, H):
    A = np.empty(H.shape * 2)
    _tensor(law, np.ascontiguousarray(H, float), A, work())
    return A


def states(n: int) -> dict[str, np.ndarray]:
    """Displacement gradients: F has repeated, nearly repeated and far apart stretches, turned and not."""
    rng = np.random.default_rng(n)
    Q = rotation(n, 0.8)
    R = rotation(n, -1.9, seed=3)
    I = np.eye(n)
    stretches = {
        "reference": np.ones(n),
        "same stretches": np.full(n, 1.3),
        "two stretches alike": np.array([1.4, 0.8, 0.8])[:n],
        "nearly alike": 1.2 + 1e-9 * np.arange(n),
        "a little apart": 1.2 + 1e-6 * np.arange(n),
        "far apart": np.array([6.0, 0.2, 1.0])[:n],
    }
    result = {name: Q @ np.diag(s) @ Q.T - I for name, s in stretches.items()}
    result |= {f"{name}, turned": R @ (H + I) - I for name, H in list(result.items())}
    for k in range(3):
        result[f"random {k}"] = 0.3 * rng.uniform(-1, 1, (n, n))
    return result


every_law = pytest.mark.parametrize("law", [elastic_law(name, YOUNG, POISSON) for name in LAWS], ids=list(LAWS))
every_state = pytest.mark.parametrize(
    "H", [pytest.param(H, id=f"{n}D, {name}") for n in (1, 2, 3) for name, H in states(n).items()]
)


def differences(f, H, h: float = 1e-5):
    """df/dH by fourth-order central differences, indices of H last."""
    n = len(H)
    result = np.empty((*np.shape(f(H)), n, n))
    for k in range(n):
        for L in range(n):
            d = np.zeros((n, n))
            d[k, L] = h * 20
            result[..., k, L] = (8 * (f(H + d) - f(H - d)) - (f(H + 2 * d) - f(H - 2 * d))) / (12 * h * 20)
    return result


@every_state
@every_law
def test_stress_is_derivative_of_energy(law, H):
    P = piola(law, H)
    assert np.abs(P - differences(lambda H: energy(law, H), H)).max() < 1e-10 * max(1, np.abs(P).max())


@every_state
@every_law
def test_tensor_is_derivative_of_stress(law, H):
    A = tensor(law, H)
    assert np.abs(A - differences(lambda H: piola(law, H), H)).max() < 2e-10 * max(1, np.abs(A).max())
    assert np.abs(A - A.transpose(2, 3, 0, 1)).max() < 2e-15 * np.abs(A).max() * len(H) ** 2  # major symmetry


@every_state
@every_law
def test_objective_and_isotropic(law, H):
    n = len(H)
    I, Q = np.eye(n), rotation(n, 1.1, seed=9)
    P = piola(law, H)
    size = max(np.abs(P).max(), 1e-1)
    assert np.abs(piola(law, Q @ (H + I) - I) - Q @ P).max() < 1e-13 * size
    assert np.abs(piola(law, (H + I) @ Q - I) - P @ Q).max() < 1e-13 * size


@every_law
@pytest.mark.parametrize("n", (1, 2))
def test_missing_directions_are_unstretched(law, n):
    """Plane strain and uniaxial strain are the block of the three-dimensional law."""
    for H in states(n).values():
        whole = np.zeros((3, 3))
        whole[:n, :n] = H
        assert np.allclose(piola(law, whole)[:n, :n], piola(law, H), rtol=0, atol=1e-14)
        assert np.allclose(tensor(law, whole)[:n, :n, :n, :n], tensor(law, H), rtol=0, atol=1e-13)
        assert np.isclose(energy(law, whole), energy(law, H), rtol=1e-13, atol=1e-30)


# Small strains


def exact(name: str, law, H) -> np.ndarray:
    """P in extended precision: series of the logarithm and of the inverse for small H."""
    H = H.astype(np.longdouble)
    I = np.eye(len(H), dtype=np.longdouble)

    def series(step, coefficients):
        return sum(c * np.linalg.matrix_power(step, k) for k, c in coefficients)

    inverse_transpose = series(H.T, [(k, (-1) ** k) for k in range(12)])
    if name == "saint_venant_kirchhoff":
        E = (H + H.T + H.T @ H) / 2
        return (I + H) @ (law.lame * np.trace(E) * I + 2 * law.shear * E)
    D = H + H.T + H @ H.T
    e = series(D, [(k, (-1) ** (k + 1) / np.longdouble(k) / 2) for k in range(1, 12)])
    if name == "hencky":
        return (law.lame * np.trace(e) * I + 2 * law.shear * e) @ inverse_transpose
    E = (H + H.T + H.T @ H) / 2
    return 2 * law.shear * inverse_transpose @ E + law.lame * np.trace(e) * inverse_transpose  # ln J = tr e


@pytest.mark.parametrize("size", (1e-12, 1e-9, 1e-6, 1e-3))
@pytest.mark.parametrize("n", (1, 2, 3))
@pytest.mark.parametrize("name", LAWS)
def test_relative_accuracy_at_small_strains(name, n, size):
    """Strains of slender bodies drown in rounding where F is formed; from H they keep all digits."""
    law = elastic_law(name, YOUNG, POISSON)
    for seed in range(5):
        H = size * np.random.default_rng(seed).uniform(-1, 1, (n, n))
        P = exact(name, law, H)
        assert np.abs(piola(law, H) - P).max() < 5e-15 * np.abs(P).max()


@pytest.mark.parametrize("name", LAWS)
def test_small_strains_are_linear_elastic(name):
    """Hooke's law with the Lame constants of E and nu."""
    law = elastic_law(name, 210e9, 0.25)
    assert law.lame == pytest.approx(84e9) and law.shear == pytest.approx(84e9)
    H = 1e-12 * np.random.default_rng(0).uniform(-1, 1, (3, 3))
    strain = (H + H.T) / 2
    stress = 84e9 * np.trace(strain) * np.eye(3) + 2 * 84e9 * strain
    assert np.abs(piola(law, H) - stress).max() < 1e-11 * np.abs(stress).max()
    assert energy(law, H) == pytest.approx(np.sum(stress * strain) / 2, rel=1e-11)


# Exact values


@pytest.mark.parametrize("n", (2, 3))
@pytest.mark.parametrize("gamma", (1e-9, 0.1, 1.0, 7.38))
def test_simple_shear_hencky(gamma, n):
    """tau_11 = -tau_22 = 2 mu ln(s) cos 2a, tau_12 = 2 mu ln(s) sin 2a with s - 1/s = gamma, tan 2a = 2/gamma."""
    law = elastic_law("hencky", YOUNG, POISSON)
    logarithm = np.arcsinh(gamma / 2)
    tau = np.zeros((n, n))
    tau[0, 0] = 2 * law.shear * logarithm * gamma / np.hypot(2, gamma)
    tau[0, 1] = tau[1, 0] = 2 * law.shear * logarithm * 2 / np.hypot(2, gamma)
    tau[1, 1] = -tau[0, 0]
    H = np.zeros((n, n))
    H[0, 1] = gamma
    P = piola(law, H)
    expected = tau @ (np.eye(n) - H).T  # F^-T
    assert np.abs(P - expected).max() < 1e-14 * np.abs(expected).max()
    assert np.abs(P @ (np.eye(n) + H).T - tau).max() < 2e-14 * max(np.abs(expected).max(), 1e-30) * (1 + gamma)


@pytest.mark.parametrize("stretch", (0.3, 0.999, 1.0, 1.5, 4.0))
@pytest.mark.parametrize("n", (1, 2, 3))
def test_uniaxial_strain(n, stretch):
    modulus = elastic_law("hencky", YOUNG, POISSON).lame + 2 * elastic_law("hencky", YOUNG, POISSON).shear
    shear = elastic_law("hencky", YOUNG, POISSON).shear
    lame = modulus - 2 * shear
    H = np.zeros((n, n))
    H[0, 0] = stretch - 1
    expected = {
        "hencky": modulus * np.log(stretch) / stretch,
        "saint_venant_kirchhoff": modulus * (stretch**2 - 1) / 2 * stretch,
        "neo_hookean": shear * (stretch - 1 / stretch) + lame * np.log(stretch) / stretch,
    }
    for name, value in expected.items():
        assert piola(elastic_law(name, YOUNG, POISSON), H)[0, 0] == pytest.approx(value, rel=1e-13, abs=1e-16)


@every_law
@pytest.mark.parametrize("n", (1, 2, 3))
@pytest.mark.parametrize("stretch", (0.0, -0.5, np.nan, -np.inf))
def test_outside_the_domain_is_not_a_number(law, n, stretch):
    H = 0.1 * np.ones((n, n))
    H[0] = 0.0
    H[0, 0] = stretch - 1
    assert np.isnan(piola(law, H)).all()
