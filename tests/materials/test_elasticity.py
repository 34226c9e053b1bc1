"""The elastic laws alone: P against dW/dF, A against dP/dF, plane stress, exact values, strains of 1e-12."""

import numpy as np
import pytest
from models import rotation
from numba import njit
from scipy.optimize import brentq
from scipy.special import lambertw

from pdpetsc.materials import elasticity
from pdpetsc.materials.elasticity import LAWS, elastic_law, lame_constants

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


@njit(cache=True)
def _lateral(law, H, work):
    return elasticity.lateral_strain(law, H, work)


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


def lateral(law, H):
    return _lateral(law, np.ascontiguousarray(H, float), work())


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
        "apart": np.array([1.4, 0.5, 1.0])[:n],
        "far apart": np.array([6.0, 0.2, 1.0])[:n],
    }
    result = {name: Q @ np.diag(s) @ Q.T - I for name, s in stretches.items()}
    result |= {f"{name}, turned": R @ (H + I) - I for name, H in list(result.items())}
    for k in range(3):
        result[f"random {k}"] = 0.3 * rng.uniform(-1, 1, (n, n))
    return result


BODIES = ((1, "strain"), (1, "stress"), (2, "strain"), (2, "stress"), (3, "strain"))


def flattened(name: str, n: int, plane: str, H) -> bool:
    """Whether S_33 = 0 of Saint Venant-Kirchhoff asks for E_33 <= -1/2: the plate has no thickness left."""
    if name != "saint_venant_kirchhoff" or plane == "strain":
        return False
    E = (H + H.T + H.T @ H) / 2
    return 2 * {1: POISSON, 2: POISSON / (1 - POISSON)}[n] * np.trace(E) >= 1


every_name = pytest.mark.parametrize("name", LAWS)
every_body = pytest.mark.parametrize("n, plane", BODIES, ids=[f"{n}D {plane}" for n, plane in BODIES])
every_state = pytest.mark.parametrize(
    "law, H",
    [
        pytest.param(elastic_law(name, YOUNG, POISSON, plane, n), H, id=f"{name}, {n}D {plane}, {state}")
        for name in LAWS
        for n, plane in BODIES
        for state, H in states(n).items()
        if not flattened(name, n, plane, H)
    ],
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
def test_stress_is_derivative_of_energy(law, H):
    P = piola(law, H)
    assert np.abs(P - differences(lambda H: energy(law, H), H)).max() < 1e-10 * max(1, np.abs(P).max())


@every_state
def test_tensor_is_derivative_of_stress(law, H):
    A = tensor(law, H)
    assert np.abs(A - differences(lambda H: piola(law, H), H)).max() < 2e-10 * max(1, np.abs(A).max())
    assert np.abs(A - A.transpose(2, 3, 0, 1)).max() < 2e-15 * np.abs(A).max() * len(H) ** 2  # major symmetry


@every_state
def test_objective_and_isotropic(law, H):
    n = len(H)
    I, Q = np.eye(n), rotation(n, 1.1, seed=9)
    P = piola(law, H)
    size = max(np.abs(P).max(), 1e-1)
    assert np.abs(piola(law, Q @ (H + I) - I) - Q @ P).max() < 1e-13 * size
    assert np.abs(piola(law, (H + I) @ Q - I) - P @ Q).max() < 1e-13 * size


@every_name
@pytest.mark.parametrize("n", (1, 2))
def test_missing_directions_are_unstretched(name, n):
    """Plane strain and uniaxial strain are the block of the three-dimensional law."""
    law = elastic_law(name, YOUNG, POISSON, "strain", n)
    assert law == elastic_law(name, YOUNG, POISSON)
    for H in states(n).values():
        assert lateral(law, H) == 0.0
        whole = np.zeros((3, 3))
        whole[:n, :n] = H
        assert np.allclose(piola(law, whole)[:n, :n], piola(law, H), rtol=0, atol=1e-14)
        assert np.allclose(tensor(law, whole)[:n, :n, :n, :n], tensor(law, H), rtol=0, atol=1e-13)
        assert np.isclose(energy(law, whole), energy(law, H), rtol=1e-13, atol=1e-30)


# Plane stress and uniaxial stress


def complete(H, lateral_strain: float):
    whole = lateral_strain * np.eye(3)
    whole[: len(H), : len(H)] = H
    return whole


def freed(solid, H):
    """The gradient in three dimensions with P_33 = 0 that is nearest to the unstretched one; None if there is none."""
    stress = lambda h: piola(solid, complete(H, h))[2, 2]
    if stress(0.0) == 0.0:
        return complete(H, 0.0)
    factor = 1.01 if stress(0.0) < 0 else 1 / 1.01
    h = 0.0
    while 1e-3 < 1 + h < 1e3:
        ahead = (1 + h) * factor - 1
        if stress(h) * stress(ahead) <= 0:
            return complete(H, brentq(stress, h, ahead, xtol=1e-300, rtol=1e-15, maxiter=1000))
        h = ahead
    return None


def condensed(A, n: int):
    """A in n dimensions when the stretch of the others, the same in all, keeps their stress at zero."""
    others = range(n, 3)
    across = sum(A[:n, :n, p, p] for p in others)
    along = sum(A[p, p, q, q] for p in others for q in others)
    return A[:n, :n, :n, :n] - np.multiply.outer(across, across) / along


def stretched(*stretches):
    n = len(stretches)
    Q = rotation(n, 0.7)
    return rotation(n, -1.2) @ Q @ np.diag(stretches) @ Q.T - np.eye(n)


STRETCHED = [
    *(stretched(s) for s in (0.3, 0.6, 0.9, 1.1, 1.6, 3.0)),
    *(stretched(*s) for s in ((0.3, 0.3), (0.3, 3.0), (3.0, 3.0), (1.0, 0.3), (1.0, 3.0), (1.2, 0.9), (0.8, 0.7))),
]


@every_name
@pytest.mark.parametrize("poisson", (-0.9, -0.3, 0.0, 0.25, 0.45, 0.499))
def test_plane_stress_is_the_solid_with_free_lateral_stretch(name, poisson):
    solid = elastic_law(name, YOUNG, poisson)
    cases = [*STRETCHED, *(H for n in (1, 2) for H in states(n).values())]
    found = 0
    for H in cases:
        n = len(H)
        law = elastic_law(name, YOUNG, poisson, "stress", n)
        whole = freed(solid, H)
        if whole is None:
            assert np.isnan(piola(law, H)).all() and np.isnan(lateral(law, H))
            continue
        found += 1
        P, A = piola(solid, whole), condensed(tensor(solid, whole), n)
        size = max(np.abs(P).max(), YOUNG)
        assert lateral(law, H) == pytest.approx(whole[2, 2], rel=1e-12, abs=1e-14)
        assert np.abs(piola(law, H) - P[:n, :n]).max() < 1e-12 * size
        assert energy(law, H) == pytest.approx(energy(solid, whole), rel=1e-12, abs=1e-28)
        assert np.abs(tensor(law, H) - A).max() < 1e-11 * np.abs(A).max()
    everywhere = name == "hencky" or (name == "neo_hookean" and poisson >= 0) or poisson == 0.0
    assert found == len(cases) if everywhere else found > len(cases) / 2


@every_name
def test_uniaxial_stress_is_one_of_plane_stress(name):
    """The plate pulled in one direction, its other side free as well, is the bar."""
    bar, plate = (elastic_law(name, YOUNG, POISSON, "stress", n) for n in (1, 2))
    for stretch in (0.3, 0.8, 1.3, 1.9, 3.0):
        H = np.array([[stretch - 1]])
        h = lateral(bar, H)
        if np.isnan(h):
            assert name == "saint_venant_kirchhoff" and 1 - POISSON * (stretch**2 - 1) < 0
            continue
        P = piola(plate, np.diag([stretch - 1, h]))
        assert lateral(plate, np.diag([stretch - 1, h])) == pytest.approx(h, rel=1e-13)
        assert P[0, 0] == pytest.approx(piola(bar, H)[0, 0], rel=1e-13) and abs(P[1, 1]) < 1e-14


@pytest.mark.parametrize("stretch", (0.3, 0.999, 1.5, 2.0))
def test_bar(stretch):
    """Young's modulus on the logarithmic strain, and on Green's; stretch^-nu."""
    H = np.array([[stretch - 1]])
    bar = elastic_law("hencky", YOUNG, POISSON, "stress", 1)
    assert piola(bar, H)[0, 0] == pytest.approx(YOUNG * np.log(stretch) / stretch, rel=1e-13)
    assert lateral(bar, H) == pytest.approx(stretch**-POISSON - 1, rel=1e-13)
    bar = elastic_law("saint_venant_kirchhoff", YOUNG, POISSON, "stress", 1)
    assert piola(bar, H)[0, 0] == pytest.approx(YOUNG * (stretch**2 - 1) / 2 * stretch, rel=1e-13)
    assert lateral(bar, H) == pytest.approx(np.sqrt(1 - POISSON * (stretch**2 - 1)) - 1, rel=1e-13)


@pytest.mark.parametrize("poisson", (-0.9, -0.2, 0.2, 0.25, 0.4, 0.49))
@pytest.mark.parametrize("n", (1, 2))
def test_lateral_stretch_of_neo_hookean_by_lambert(n, poisson):
    """a e^x + (1 - a) x = c is solved by x = c / (1 - a) - W(a / (1 - a) exp(c / (1 - a)))."""
    law = elastic_law("neo_hookean", YOUNG, poisson, "stress", n)
    a = 1 + (3 - n) * law.lateral
    for J in np.geomspace(0.01, 100, 81):
        c = (2 * law.lateral * np.log(J) + a) / (1 - a)
        W = lambertw(a / (1 - a) * np.exp(c), 0 if poisson > 0 else -1)
        h = lateral(law, np.diag([J - 1, 0.0][:n]))
        if poisson < 0 and W.imag != 0:
            assert np.isnan(h)
        else:
            near_fold = abs(1 + W.real) < 0.05  # where both solutions meet, x has half the digits of c
            assert h == pytest.approx(np.expm1((c - W.real) / 2), rel=1e-12, abs=1e-10 if near_fold else 1e-14)


@pytest.mark.parametrize("n, plane", ((1, "stress"), (2, "stress")))
def test_incompressible_neo_hookean(n, plane):
    """nu = 1/2: C33 = J^(-2/k), P = mu (F - C33 F^-T)."""
    law = elastic_law("neo_hookean", YOUNG, 0.5, plane, n)
    for H in (H for H in STRETCHED if len(H) == n):
        F = np.eye(n) + H
        C33 = np.linalg.det(F) ** (-2 / (3 - n))
        assert lateral(law, H) == pytest.approx(np.sqrt(C33) - 1, rel=1e-12)
        assert np.allclose(piola(law, H), law.shear * (F - C33 * np.linalg.inv(F).T), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("n", (1, 2))
def test_neo_hookean_of_negative_ratio_collapses(n):
    """x = ln((a - 1) / a) is the last lateral stretch that can hold against compression; below it P is NaN."""
    law = elastic_law("neo_hookean", YOUNG, -0.3, "stress", n)
    a = 1 + (3 - n) * law.lateral
    x = np.log((a - 1) / a)
    J = np.exp((a * np.expm1(x) + (1 - a) * x) / (2 * law.lateral))
    assert np.isnan(piola(law, np.diag([J * 0.9999 - 1, 0.0][:n]))).all()
    H = np.diag([J * 1.0001 - 1, 0.0][:n])
    assert np.isfinite(piola(law, H)).all() and np.isfinite(tensor(law, H)).all() and np.isfinite(energy(law, H))
    assert lateral(law, H) == pytest.approx(np.exp(x / 2) - 1, abs=0.02)


@pytest.mark.parametrize("n", (1, 2))
def test_no_thickness_left(n):
    """Saint Venant-Kirchhoff: E_33 = -1/2 ends the domain."""
    law = elastic_law("saint_venant_kirchhoff", YOUNG, POISSON, "stress", n)
    last = np.sqrt(1 - 1 / law.lateral)  # stretch in one direction
    for factor, domain in ((1 - 1e-6, True), (1 + 1e-6, False)):
        H = np.diag([last * factor - 1, 0.0][:n])
        assert np.isfinite(piola(law, H)).all() == domain
        assert np.isfinite(lateral(law, H)) == domain


@pytest.mark.parametrize("poisson", (-0.4, 0.0, 0.3, 0.49))
def test_constants_in_fewer_dimensions(poisson):
    E, G = 7.0, 7.0 / 2 / (1 + poisson)
    K = E / 3 / (1 - 2 * poisson)
    bulk = {
        (3, "strain"): K,
        (3, "stress"): K,
        (2, "strain"): K + G / 3,
        (2, "stress"): E / 2 / (1 - poisson),
        (1, "strain"): K + 4 / 3 * G,
        (1, "stress"): E,
    }
    for (n, plane), value in bulk.items():
        lame, shear = lame_constants(E, poisson, plane, n)
        assert shear == pytest.approx(G, rel=1e-15) and lame + 2 * shear / n == pytest.approx(value, rel=1e-14)
        for name in LAWS:
            law = elastic_law(name, E, poisson, plane, n)
            assert (law.lame, law.shear) == (lame, shear)


def test_plane_is_strain_or_stress():
    with pytest.raises(ValueError, match="Stress"):
        lame_constants(YOUNG, POISSON, "Stress", 2)


# Small strains


def exact(name: str, plane: str, H) -> tuple[np.ndarray, float, float]:
    """P, W and H_33 in extended precision: series of the logarithm and of the inverse for small H."""
    n, k = len(H), 3 - len(H)
    H = H.astype(np.longdouble)
    I = np.eye(n, dtype=np.longdouble)
    nu = np.longdouble(POISSON)
    lame, shear = YOUNG * nu / ((1 + nu) * (1 - 2 * nu)), YOUNG / (2 * (1 + nu))
    ratio = -lame / (k * lame + 2 * shear) if plane == "stress" else np.longdouble(0)
    reduced = lame * (1 + k * ratio)

    def series(step, coefficients):
        return sum(c * np.linalg.matrix_power(step, m) for m, c in coefficients)

    def deficit(D):  # tr(D - ln(1 + D)) / 2
        return np.trace(series(D, [(m, (-1) ** m / np.longdouble(m) / 2) for m in range(2, 13)]))

    inverse_transpose = series(H.T, [(m, (-1) ** m) for m in range(12)])
    E = (H + H.T + H.T @ H) / 2
    if name == "saint_venant_kirchhoff":
        c = 2 * ratio * np.trace(E)
        W = reduced * np.trace(E) ** 2 / 2 + shear * np.sum(E * E)
        return (I + H) @ (reduced * np.trace(E) * I + 2 * shear * E), W, c / (1 + np.sqrt(1 + c))
    D = H + H.T + H @ H.T
    e = series(D, [(m, (-1) ** (m + 1) / np.longdouble(m) / 2) for m in range(1, 13)])
    trace = np.trace(e)  # ln J
    if name == "hencky":
        W = reduced * trace**2 / 2 + shear * np.sum(e * e)
        return (reduced * trace * I + 2 * shear * e) @ inverse_transpose, W, np.expm1(ratio * trace)
    x = 2 * ratio * trace
    for _ in range(8 if plane == "stress" else 0):
        pull = shear * np.expm1(x) + lame * (trace + k * x / 2)
        x -= pull / (shear * np.exp(x) + lame * k / 2)
    c, logarithm = np.expm1(x), trace + k * x / 2
    W = shear * (deficit(D) + k * deficit(np.array([[c]]))) + lame * logarithm**2 / 2
    return 2 * shear * inverse_transpose @ E + lame * logarithm * inverse_transpose, W, np.expm1(x / 2)


@pytest.mark.parametrize("size", (1e-12, 1e-9, 1e-6, 1e-3))
@every_body
@every_name
def test_relative_accuracy_at_small_strains(name, n, plane, size):
    """Strains of slender bodies drown in rounding where F is formed; from H they keep all digits."""
    law = elastic_law(name, YOUNG, POISSON, plane, n)
    for seed in range(5):
        H = size * np.random.default_rng(seed).uniform(-1, 1, (n, n))
        P, W, h = exact(name, plane, H)
        assert np.abs(piola(law, H) - P).max() < 5e-15 * np.abs(P).max()
        assert abs(energy(law, H) - W) < 1e-14 * W
        assert abs(lateral(law, H) - h) < 2e-15 * np.abs(H).max()


@pytest.mark.parametrize("poisson", (-0.4, 0.0, 0.25, 0.499))
@every_body
@every_name
def test_small_strains_are_linear_elastic(name, n, plane, poisson):
    """Hooke's law: strain = ((1 + nu) stress - nu tr(stress) I) / E, with the lateral strain or stress zero."""
    young = 210e9
    law = elastic_law(name, young, poisson, plane, n)
    H = 1e-12 * np.random.default_rng(n).uniform(-1, 1, (n, n))
    P, h = piola(law, H), lateral(law, H)
    stress = np.zeros((3, 3))
    stress[:n, :n] = P
    if plane == "strain":
        stress[range(n, 3), range(n, 3)] = poisson / (1 - poisson if n == 1 else 1) * np.trace(P)
    strain = ((1 + poisson) * stress - poisson * np.trace(stress) * np.eye(3)) / young
    assert np.abs(strain - complete((H + H.T) / 2, h)).max() < 1e-9 * np.abs(H).max()  # strains are 1e-12, K/E = 166
    assert energy(law, H) == pytest.approx(np.sum(stress * strain) / 2, rel=1e-9, abs=0)
    if plane == "stress" and n == 2:
        A = young / (1 - poisson**2)
        assert tensor(law, H)[0, 0, 0, 0] == pytest.approx(A, rel=1e-9)
        assert tensor(law, H)[0, 0, 1, 1] == pytest.approx(poisson * A, rel=1e-9, abs=1e-9 * young)
    if plane == "stress" and n == 1:
        assert tensor(law, H)[0, 0, 0, 0] == pytest.approx(young, rel=1e-9)


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


@every_name
@every_body
@pytest.mark.parametrize("stretch", (0.0, -0.5, np.nan, -np.inf))
def test_outside_the_domain_is_not_a_number(name, n, plane, stretch):
    law = elastic_law(name, YOUNG, POISSON, plane, n)
    H = 0.1 * np.ones((n, n))
    H[0] = 0.0
    H[0, 0] = stretch - 1
    assert np.isnan(piola(law, H)).all()
    assert np.isnan(lateral(law, H)) if plane == "stress" else lateral(law, H) == 0.0
