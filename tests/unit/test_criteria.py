"""Failure criteria: what they give in known states, that both ends of a bond and turned bodies agree, critical values.

A new criterion is a row of `ROWS`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from models import POISSON, deformation, model, rotation, sample, strong_gradient

import pdpetsc.damage  # noqa: F401
from pdpetsc.case import Case
from pdpetsc.damage.base import Criterion
from pdpetsc.damage.energy import bond_energies
from pdpetsc.errors import InputError

A, GAMMA = 0.1, 0.2  # stretch along x, shear of y along x
SHEAR = 1 / (2 * (1 + POISSON))
LAME = POISSON / ((1 + POISSON) * (1 - 2 * POISSON))


@dataclass(frozen=True)
class Row:
    """A criterion with the quantity of each bond in two states, of bonds of the direction n (bonds, 3).

    Attributes:
        stretched: F = diag(1 + A, 1, 1), saint_venant_kirchhoff in plane strain, E = 1.
        sheared: F = I + GAMMA e_x (x) e_y.
    """

    name: str
    stretched: Callable[[np.ndarray], np.ndarray]
    sheared: Callable[[np.ndarray], np.ndarray]
    critical: float
    keys: dict = field(default_factory=dict)


def constant(value: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda n: np.full(len(n), value)


def stretch_stress() -> tuple[float, float]:
    """sigma_11 and sigma_22 = sigma_33 of the stretched state: F S F^T/J with S_11 = (lambda + 2 mu) E_11."""
    E = A + A**2 / 2
    return (1 + A) * (LAME + 2 * SHEAR) * E, LAME * E / (1 + A)


def shear_stress() -> np.ndarray:
    """Principal values, the smallest first, of F (lambda tr E + 2 mu E) F^T, J = 1."""
    F = np.eye(3)
    F[0, 1] = GAMMA
    E = (F.T @ F - np.eye(3)) / 2
    return np.linalg.eigvalsh(F @ (LAME * np.trace(E) * np.eye(3) + 2 * SHEAR * E) @ F.T)


def shear_bond_strain(n: np.ndarray) -> np.ndarray:
    """|dev(U) n|; tr U = 1 + sqrt(4 + gamma^2) and U = (C + I)/sqrt(tr C + 2) in the plane."""
    F = np.array([[1, GAMMA], [0, 1]])
    U = np.eye(3)
    U[:2, :2] = (F.T @ F + np.eye(2)) / np.sqrt(4 + GAMMA**2)
    return np.linalg.norm(n @ (U - np.trace(U) / 3 * np.eye(3)), axis=1)


def coulomb(largest: float, smallest: float, cohesion: float, angle: float) -> float:
    """tau/tau_c of the circle that is larger in the same proportion until it touches |tau| = c - sigma tan(phi)."""
    phi = np.deg2rad(angle)
    normal = np.array([np.cos(np.pi / 4 + phi / 2), np.sin(np.pi / 4 + phi / 2)])  # to the plane that slips
    turned = np.array([-normal[1], normal[0]])
    # compression negative: the plane's normal leans to the smallest stress by 45 degrees + phi/2
    stress = np.diag([smallest, largest])
    slip = abs(turned @ stress @ normal) + (normal @ stress @ normal) * np.tan(phi)
    return slip / cohesion


S1, S2 = stretch_stress()
T3, _, T1 = shear_stress()
WEAK = {"cohesion": 0.01, "friction_angle": 30.0}
ROWS = [
    Row("critical_stretch", lambda n: np.sqrt((1 + A) ** 2 * n[:, 0] ** 2 + n[:, 1] ** 2 + n[:, 2] ** 2) - 1,
        lambda n: np.sqrt(1 + 2 * GAMMA * n[:, 0] * n[:, 1] + GAMMA**2 * n[:, 1] ** 2) - 1, 0.01),
    Row("equivalent_strain", constant(2 / 3 * (A + A**2 / 2)),
        constant(np.sqrt(4 / 9 * (GAMMA**2 / 2) ** 2 + GAMMA**2 / 3)), 0.02),
    Row("volumetric_strain", constant(A + A**2 / 2), constant(GAMMA**2 / 4), 0.02),
    Row("principal_stress", constant(S1), constant(T1), 0.3),
    Row("principal_stress", constant(coulomb(S1, S2, 0.01, 30.0)), constant(coulomb(T1, T3, 0.01, 30.0)), 1.0, WEAK),
    Row("bond_strain", lambda n: A / 3 * np.sqrt(4 * n[:, 0] ** 2 + n[:, 1] ** 2 + n[:, 2] ** 2),
        shear_bond_strain, 0.02),
]  # fmt: skip
NAMES = [row.name + "-shear" * bool(row.keys) for row in ROWS]
ALL = [*zip(NAMES, [(r.name, r.keys) for r in ROWS]), ("bond_energy", ("bond_energy", {}))]
MODELS = ("hencky-silling", "neo_hookean-silling-plane-stress", "bond", "bond-linear", "ordinary",
          "ordinary-linear", "abd-objective")  # fmt: skip


def made(name: str, material, critical: float | None = None, G_c: float | None = None, **keys) -> Criterion:
    table = {"cohesion": None, "friction_angle": None} | keys
    return Criterion.criteria[name].from_case(SimpleNamespace(critical=critical, G_c=G_c, **table), material)


def opposites(material) -> np.ndarray:
    """Numbers of the other directions, -1 where there is none."""
    families = material.families
    center = families.per_bond(np.arange(len(material._X)))
    number = {pair: k for k, pair in enumerate(zip(center.tolist(), families.neighbours.tolist()))}
    return np.array([number.get((j, i), -1) for i, j in number])


def ratios(criterion: Criterion, material, u: np.ndarray) -> np.ndarray:
    """As `Fracture.ratios` asks for them."""
    other = opposites(material)

    def both(of_material):
        own = of_material(material, u)
        return own + np.append(own, 0.0)[other]

    tensor = getattr(material, criterion.field)(u) if criterion.field else None
    return criterion.ratio(u, tensor, both)


def directions(material) -> np.ndarray:
    X, families = material._X, material.families
    n = np.zeros((families.bonds, 3))
    n[:, : X.shape[1]] = X[families.neighbours] - families.per_bond(X)
    return n / np.linalg.norm(n, axis=1)[:, None]


def test_every_criterion_is_tested():
    assert {name for _, (name, _) in ALL} == set(Criterion.criteria)


# Known states -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_stretched_body(row, dim):
    material = sample(dim).material(model("saint_venant_kirchhoff-none"))
    u = material._X * np.array([A, 0, 0])[:dim]
    ratio = ratios(made(row.name, material, row.critical, **row.keys), material, u)
    assert ratio == pytest.approx(row.stretched(directions(material)) / row.critical, rel=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_sheared_body(row, dim):
    material = sample(dim).material(model("saint_venant_kirchhoff-none"))
    u = np.zeros_like(material._X)
    u[:, 0] = GAMMA * material._X[:, 1]
    ratio = ratios(made(row.name, material, row.critical, **row.keys), material, u)
    assert ratio == pytest.approx(row.sheared(directions(material)) / row.critical, rel=1e-10, abs=1e-12)


def test_bond_strain_does_not_see_shrinking_bodies():
    material = sample(2).material(model("saint_venant_kirchhoff-none"))
    assert np.all(ratios(made("bond_strain", material, 0.01), material, -A * material._X * [1, 0]) == 0)


def test_bond_strain_does_not_see_equal_stretch():
    material = sample(3).material(model("saint_venant_kirchhoff-none"))
    assert ratios(made("bond_strain", material, 1.0), material, A * material._X) == pytest.approx(0, abs=1e-14)


def test_shear_criterion_goes_through_the_apex():
    """In equal tension of all directions tau = 0 and tau_c = c cos(phi) - sigma sin(phi) turns negative."""
    material = sample(3).material(model("saint_venant_kirchhoff-none"))
    below, beyond = (
        ratios(made("principal_stress", material, 1e9, **WEAK), material, a * material._X)[0] for a in (1e-3, 0.1)
    )
    stress = material.cauchy_stress(1e-3 * material._X)[0, 0, 0]
    assert below == pytest.approx(stress * np.tan(np.pi / 6) / 0.01, rel=1e-9)
    assert 1 < beyond < np.inf


def test_shear_criterion_is_stronger_in_compression():
    """Uniaxial stress: f_c/f_t = (1 + sin phi)/(1 - sin phi) of Mohr and Coulomb, 3 at 30 degrees."""
    material = sample(1).material(model("saint_venant_kirchhoff-none"))
    criterion, strength = made("principal_stress", material, 1e9, **WEAK), []
    for sign in (1, -1):
        tensor = np.zeros((len(material._X), 3, 3))
        tensor[:, 0, 0] = sign
        strength.append(1 / criterion.ratio(np.zeros_like(material._X), tensor, None)[0])
    assert strength[1] / strength[0] == pytest.approx(3, rel=1e-12)
    assert strength[0] == pytest.approx(2 * 0.01 * np.cos(np.pi / 6) / 1.5, rel=1e-12)


# The energy of bonds ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["bond", "bond-linear"])
def test_energy_of_springs_is_exact(name, dim):
    """k e^2/2 in each direction; k holds the neighbour's volume."""
    material = sample(dim).material(model(name))
    X, families = material._X, material.families
    u = deformation(X) if name == "bond" else 1e-3 * deformation(X)
    center, other = families.per_bond(np.arange(len(X))), opposites(material)
    xi, eta = X[families.neighbours] - X[center], u[families.neighbours] - u[center]
    length = np.linalg.norm(xi, axis=1)
    e = np.linalg.norm(xi + eta, axis=1) - length if name == "bond" else (xi * eta).sum(axis=1) / length
    own = material._data.k * e**2 / 2 / material._volume[families.neighbours]
    expected = own + np.append(own, 0)[other]
    assert ratios(made("bond_energy", material, 0.5), material, u) == pytest.approx(expected / 0.5, rel=1e-9)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["saint_venant_kirchhoff-none", "hencky-silling"])
def test_energy_of_a_family(name, dim):
    """In homogeneous states the bonds of a family share P : (F - R)/2, F = R U."""
    material = sample(dim).material(model(name))
    H, X, families = strong_gradient(dim), material._X, material.families
    F = np.eye(dim) + H
    left, _, right = np.linalg.svd(F)
    P = np.linalg.det(F) * material.cauchy_stress(X @ H.T)[0][:dim, :dim] @ np.linalg.inv(F).T
    shared = families.sums(bond_energies(material, X @ H.T) * material._volume[families.neighbours])
    assert shared == pytest.approx(np.sum(P * (F - left @ right)) / 2, rel=1e-9)


def test_energy_of_ordinary_bonds_is_that_of_the_family():
    material = sample(2).material(model("ordinary"))
    u, families = deformation(material._X), material.families
    shared = families.sums(bond_energies(material, u) * material._volume[families.neighbours])
    assert shared * material._volume == pytest.approx(material.energy(u), rel=1e-9)


# All criteria and models --------------------------------------------------------------------------------------

everything = [
    pytest.mark.parametrize("model_name", MODELS),
    pytest.mark.parametrize("name, keys", [row for _, row in ALL], ids=[name for name, _ in ALL]),
]


def with_everything(test):
    for mark in everything:
        test = mark(test)
    return test


@with_everything
def test_both_directions_come_to_the_same_number(name, keys, model_name):
    row = model(model_name)
    for dim in (2, 3) if model_name in ("hencky-silling", "ordinary") else (2,):
        material = sample(dim).material(row)
        X = material._X
        u = deformation(X) if not row.linear else 1e-3 * (deformation(X) + X)  # that shrinks nowhere
        ratio, other = ratios(made(name, material, 0.1, **keys), material, u), opposites(material)
        both = other >= 0
        assert np.array_equal(ratio[both], ratio[other[both]])
        assert np.count_nonzero(ratio) > len(ratio) / 4 and np.isfinite(ratio).all()


@with_everything
def test_turned_bodies_are_as_near_to_failure(name, keys, model_name):
    row = model(model_name)
    material = sample(2).material(row)
    X, criterion = material._X, made(name, material, 0.1, **keys)
    if row.linear:  # rotations that are small
        turned = X @ np.array([[0, -0.3], [0.3, 0]])
        assert ratios(criterion, material, turned) == pytest.approx(0, abs=1e-12)
        return
    R = rotation(2, 2.0)
    assert ratios(criterion, material, X @ R.T - X) == pytest.approx(0, abs=1e-11)
    u = deformation(X)
    turned = (X + u) @ R.T - X
    assert ratios(criterion, material, turned) == pytest.approx(ratios(criterion, material, u), rel=1e-9, abs=1e-9)


@with_everything
def test_states_that_are_no_numbers_do_not_fail(name, keys, model_name):
    material = sample(2).material(model(model_name))
    criterion, u = made(name, material, 0.1, **keys), np.zeros_like(material._X)
    tensor = getattr(material, criterion.field)(u) if criterion.field else None
    for values in (u, tensor):
        if values is not None:
            values[3] = np.nan
    assert np.all(criterion.ratio(u, tensor, lambda of_material: of_material(material, u)) == 0)


# Critical values of G_c ---------------------------------------------------------------------------------------


def crossing(dim: int, density: Callable[[np.ndarray], np.ndarray], n: int = 128) -> float:
    """Sum of a density (energy/volume^2) over the pairs that cross a unit of area, horizon 1, thickness 1: of those
    with the component z across it, the points up to z before it; by cells of the half ball."""
    axes = [(np.arange(n) + 0.5) / n] * dim
    xi = np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], axis=1)
    r = np.linalg.norm(xi, axis=1)
    inside = r <= 1
    return 2 ** (dim - 1) * np.sum((density(r) * xi[:, 0])[inside]) / n**dim


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_bond_energy_of_release_rate(dim):
    material = sample(dim).material(model("bond"))
    criterion = made("bond_energy", material, G_c=0.7)
    w = criterion._critical * criterion.horizon ** (dim + 1)  # of horizon 1
    assert w * crossing(dim, np.ones_like) == pytest.approx(0.7, rel=3e-3)
    assert w == pytest.approx(0.7 * {1: 2, 2: 3 / 2, 3: 4 / np.pi}[dim], rel=1e-12)


def test_bond_strain_of_release_rate():
    material = sample(3).material(model("ordinary"))
    criterion = made("bond_strain", material, G_c=0.7)
    strain = criterion._data.critical * np.sqrt(criterion.horizon)
    m = 4 * np.pi / 3  # of w = |xi|^-2
    for value in strain[:3]:
        both = 2 * 3 * material.shear / m * value**2
        assert crossing(3, lambda r, both=both: both * np.ones_like(r)) == pytest.approx(0.7, rel=3e-3)


# Errors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [1, 2])
def test_bond_strain_has_no_release_rate_in_the_plane(dim):
    with pytest.raises(InputError, match=f"G_c of bond_strain is not defined in {dim}D; give critical"):
        made("bond_strain", sample(dim).material(model("ordinary")), G_c=1.0)


@pytest.mark.parametrize(
    "table, said",
    [
        ({"criterion": "equivalent_strain", "G_c": 1.0}, "G_c"),
        ({"criterion": "volumetric_strain"}, "critical"),
        ({"criterion": "bond_energy", "G_c": 1.0, "critical": 1.0}, "exactly one of critical and G_c"),
        ({"criterion": "principal_stress", "critical": 1.0, "cohesion": 1.0}, "go together"),
        (
            {"criterion": "principal_stress", "critical": 1.0, "cohesion": 1.0, "friction_angle": 90.0},
            "friction_angle",
        ),
        ({"criterion": "bond_strian", "critical": 1.0}, "bond_strain"),
    ],
)
def test_mistakes_are_named(table, said):
    document = {
        "body": {"size": [1.0], "spacing": 0.1, "horizon": 2.015},
        "material": {"m": {"model": "bond", "E": 1.0}},
        "damage": {"m": table},
    }
    with pytest.raises(InputError, match=f"damage.m.*{said}"):
        Case.from_document(document, "bar", None, "bar.toml", False)
