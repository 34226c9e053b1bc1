"""Bond-based and ordinary materials against their definitions, and the moduli that lattices give them."""

from types import SimpleNamespace

import numpy as np
import pytest
from models import Sample, deformation, force, lattice, rotation, sample, strong_gradient, tangent

from pdpetsc.bonds import find_families
from pdpetsc.influence import INFLUENCE, bond_weights, influence_moment
from pdpetsc.materials.base import Neighbourhood
from pdpetsc.materials.bond_based import BondBased, fixed_poisson
from pdpetsc.materials.elasticity import lame_constants
from pdpetsc.materials.ordinary import ABD, LinearPeridynamicSolid

E = 3.0
PLANES = [(1, "strain"), (1, "stress"), (2, "strain"), (2, "stress"), (3, "strain")]
every_plane = pytest.mark.parametrize(("dim", "plane"), PLANES)


class Bonds:
    """The bonds of a deformed sample, written out: one entry for each in every array."""

    def __init__(self, body: Sample, u):
        families = body.families()
        self.first = families.offsets[:-1]
        self.i, self.j = families.per_bond(np.arange(len(body.X))), families.neighbours
        xi = body.X[self.j] - body.X[self.i]
        y = xi + u[self.j] - u[self.i]
        self.length, stretched = np.linalg.norm(xi, axis=1), np.linalg.norm(y, axis=1)
        self.n, self.direction = y / stretched[:, None], xi / self.length[:, None]
        self.e = stretched - self.length
        self.delta, self.V, self.w = body.horizon[self.i], body.volume[self.j], body.weight
        self.center_volume = body.volume[self.i]

    def sum(self, values):
        return np.add.reduceat(values, self.first)

    def forces(self, t):
        """Of force states t along n: what the pairs of a bond put on their ends, dW/du."""
        f = np.zeros((self.i.max() + 1, self.n.shape[1]))
        pull = (t * self.V * self.center_volume)[:, None] * self.n
        np.add.at(f, self.j, pull)
        np.add.at(f, self.i, -pull)
        return f


def close(a, b, tolerance=1e-13):
    return np.abs(a - b).max() < tolerance * np.abs(b).max()


def part_of(body: Sample) -> Neighbourhood:
    return body.neighbourhood()


@every_plane
def test_linear_peridynamic_solid(dim, plane):
    """Seed 002 Eq. 42: t = (n K' theta/m) w |xi| + (n (n + 2) G/m) w e^d."""
    body = sample(dim)
    u = deformation(body.X)
    material = LinearPeridynamicSolid(part_of(body), E, 0.2, plane, "plain")
    lame, G = lame_constants(E, 0.2, plane, dim)
    K, n, b = lame + 2 * G / dim, dim, Bonds(body, u)
    m = b.sum(b.w * b.length**2 * b.V)[b.i]
    theta = n / m * b.sum(b.w * b.length * b.e * b.V)[b.i]
    deviatoric = b.e - theta * b.length / n
    t = n * K * theta / m * b.w * b.length + n * (n + 2) * G / m * b.w * deviatoric
    assert close(force(material, u), b.forces(t))
    W = K / 2 * theta[b.first] ** 2 + b.sum(n * (n + 2) * G / (2 * m) * b.w * deviatoric**2 * b.V)
    assert close(material.energy(u), body.volume * W)


@pytest.mark.parametrize("microelastic", ("prototype", "general"))
@every_plane
def test_bonds(dim, plane, microelastic):
    """Half of the classical micromodulus, in each direction of a bond."""
    nu = fixed_poisson(dim, plane) or 0.0
    body = sample(dim)
    body.weight = np.ones_like(body.weight)
    body.thickness = 1.0 if dim == 3 else 0.7
    u = deformation(body.X)
    b = Bonds(body, u)
    h = A = body.thickness
    K = {(2, "stress"): E / (2 * (1 - nu)), (2, "strain"): E / (2 * (1 + nu) * (1 - 2 * nu))}.get(
        (dim, plane), E / (3 * (1 - 2 * nu))
    )
    d = b.delta
    c = {
        ("prototype", 3): 18 * K / (np.pi * d**4), ("general", 3): 22.5 * K / (np.pi * d**5),
        ("prototype", 2): 12 * K / (np.pi * h * d**3), ("general", 2): 16 * K / (np.pi * h * d**4),
        ("prototype", 1): 2 * E / (A * d**2), ("general", 1): 3 * E / (A * d**3),
    }[microelastic, dim]  # fmt: skip
    t = c / 2 * (b.e / b.length if microelastic == "prototype" else b.e)
    assert close(force(BondBased(part_of(body), E, nu, plane, "plain", microelastic), u), b.forces(t))
    linear = BondBased(part_of(body), E, nu, plane, "plain", microelastic, "linear")
    b.e = ((u[b.j] - u[b.i]) * b.direction).sum(axis=1)  # seed 003 Eq. 17, 20
    b.n = b.direction
    t = c / 2 * (b.e / b.length if microelastic == "prototype" else b.e)
    assert close(force(linear, u), b.forces(t))


@pytest.mark.parametrize("rotation_weighted", (True, False))
def test_abd(rotation_weighted):
    """Seed 000 Eq. 32-34 as corrected: T = 2 delta (d a theta Lambda/|xi| + b s) n."""
    body = sample(2)
    body.weight = np.ones_like(body.weight)
    body.thickness = h = 0.7
    u = deformation(body.X)
    b = Bonds(body, u)
    G, K = E / 2.6, E / (2 * 0.7)
    alpha, beta, d = (K - 2 * G) / 2, 6 * G / (np.pi * h * b.delta**4), 2 / (np.pi * h * b.delta**3)
    cosine = (b.n * b.direction).sum(axis=1) if rotation_weighted else 1.0
    s = b.e / b.length
    theta = b.sum(d * b.delta * s * cosine * b.V)[b.i]
    t = 2 * b.delta * (d * alpha * theta * cosine / b.length + beta * s)
    material = ABD(part_of(body), E, 0.3, "stress", rotation_weighted=rotation_weighted)
    assert close(force(material, u), b.forces(t))
    W = alpha * theta[b.first] ** 2 + b.sum(beta * b.delta * b.length * s**2 * b.V)
    assert close(material.energy(u), body.volume * W)


# Moduli of lattices


def middle(model, dim: int, m: float, influence: str = "constant", **switches):
    """A material on the family of a particle in the middle of a lattice, spacing 1, and that particle's volume."""
    reach = int(m)
    X = lattice((2 * reach + 1,) * dim)
    n = len(X)
    families = find_families(X, np.full(n, m), np.arange(n), n).subset(np.array([n // 2]))
    w = bond_weights(families, X, np.full(n, m), np.ones(n), INFLUENCE[influence], "none")
    part = Neighbourhood(families, w, X, np.ones(n), np.full(n, m), np.ones(n), influence=INFLUENCE[influence])
    return model(part, **switches), X


def stiffness(material, X) -> np.ndarray:
    """C of the small-strain energy e : C : e/2 by polarisation, (dim,) * 4."""
    dim = X.shape[1]
    small = 1e-4
    strains = [np.outer(a, b) + np.outer(b, a) for a in np.eye(dim) for b in np.eye(dim)]

    def energy(strain):
        return (material.energy(small * X @ strain.T) + material.energy(-small * X @ strain.T))[0] / (2 * small**2)

    C = [[(energy(a + b) - energy(a - b)) / 8 for b in strains] for a in strains]
    return np.array(C).reshape((dim,) * 4)


def isotropic(lame, shear, dim) -> np.ndarray:
    one = np.eye(dim)
    return lame * np.einsum("pq,rs->pqrs", one, one) + shear * (
        np.einsum("pr,qs->pqrs", one, one) + np.einsum("ps,qr->pqrs", one, one)
    )


@pytest.mark.parametrize("nu", (0.0, 0.2, 1 / 3, 0.45))
@every_plane
def test_matched_lattices_have_the_moduli_of_the_solid(dim, plane, nu):
    """G equal in all directions to 1e-10, and every other entry of the stiffness."""
    material, X = middle(
        LinearPeridynamicSolid, dim, 3.015, young=E, poisson=nu, plane=plane, kinematics="linear", quadrature="matched"
    )
    assert material.unmatched == 0
    assert close(stiffness(material, X), isotropic(*lame_constants(E, nu, plane, dim), dim), 1e-10)


@every_plane
def test_matched_bonds_have_the_moduli_of_the_solid(dim, plane):
    nu = fixed_poisson(dim, plane) or 0.3
    for microelastic in ("prototype", "general"):
        material, X = middle(
            BondBased, dim, 3.015, young=E, poisson=nu, plane=plane, kinematics="linear", microelastic=microelastic
        )
        assert close(stiffness(material, X), isotropic(*lame_constants(E, nu, plane, dim), dim), 1e-10)


@pytest.mark.parametrize("nu", (0.0, 0.2, 1 / 3, 0.45))
@pytest.mark.parametrize(
    (
        "dim",
        "plane",
        "influence",
        "along",
        "across",
    ),  # G of shear with its faces along the axes' diagonals and along axes
    [
        (2, "stress", "constant", 0.965, 1.035),
        (2, "strain", "constant", 0.965, 1.035),
        (3, "strain", "constant", 1.110, 0.835),
        (2, "stress", "linear", 1.0356, 0.9644),
        (3, "strain", "linear", 1.0019, 0.9972),
    ],
)
def test_plain_lattices_have_the_known_anisotropy(dim, plane, influence, along, across, nu):
    """G along and across the axes at m = 3.015, from the sums of w |xi|^2 nx^2 ny^2 and w |xi|^2 nx^4 by hand, and the
    exact K'; in plane stress too."""
    material, X = middle(
        LinearPeridynamicSolid, dim, 3.015, influence, young=E, poisson=nu, plane=plane, kinematics="linear",
        quadrature="plain",
    )  # fmt: skip
    C = stiffness(material, X)
    lame, G = lame_constants(E, nu, plane, dim)
    bulk = np.einsum("ppqq->", C) / dim**2
    assert bulk == pytest.approx(lame + 2 * G / dim, rel=1e-12)
    assert C[0, 1, 0, 1] / G == pytest.approx(along, abs=6e-4)
    assert (C[0, 0, 0, 0] - C[0, 0, 1, 1]) / 2 / G == pytest.approx(across, abs=6e-4)
    if plane == "stress":
        assert bulk == pytest.approx(E / (2 * (1 - nu)), rel=1e-12)


@pytest.mark.parametrize("model", (BondBased, ABD))
@every_plane
def test_energy_based_surface_correction(dim, plane, model):
    """Equal strain in all directions stores the energy of the solid in every family, cut ones too."""
    nu = fixed_poisson(dim, plane) or 0.0
    X = lattice((5, 4, 4)[:dim])
    n = len(X)
    body = Sample(X, np.ones(n), np.full(n, 2.2), np.ones(n), np.empty(0), 1.0)
    body.weight = np.ones(body.families().bonds)
    switches = {"quadrature": "plain"} if model is BondBased else {}
    corrected = model(part_of(body), E, nu, plane, kinematics="linear", surface_correction="energy", **switches)
    plain = model(part_of(body), E, nu, plane, kinematics="linear", **switches)
    lame, G = lame_constants(E, nu, plane, dim)
    exact = (lame + 2 * G / dim) / 2 * dim**2 * 1e-6
    assert corrected.energy(1e-3 * X) == pytest.approx(exact, rel=1e-12)
    assert np.abs(plain.energy(1e-3 * X) / exact - 1).max() > 0.1


def test_bar_of_bonds():
    """In 1D any Poisson's ratio: K' = lambda + 2 mu in uniaxial strain."""
    material, X = middle(BondBased, 1, 3.015, young=E, poisson=0.3, kinematics="linear")
    assert stiffness(material, X)[0, 0, 0, 0] == pytest.approx(E * 0.7 / (1.3 * 0.4), rel=1e-12)


def test_influence_moments():
    assert influence_moment(INFLUENCE["constant"], 3) == pytest.approx(1 / 4, rel=1e-14)
    assert influence_moment(INFLUENCE["linear"], 2) == pytest.approx(1 / 12, rel=1e-14)
    assert influence_moment(INFLUENCE["inverse"], 1) == pytest.approx(1, rel=1e-14)


@pytest.mark.parametrize("quadrature", ("plain", "matched"))
def test_bonds_of_any_influence_have_the_right_modulus(quadrature):
    """The micromodulus belongs to the influence function: on a fine lattice K' comes out, whatever it is."""
    for influence in INFLUENCE:
        material, X = middle(
            BondBased, 2, 8.015, influence, young=E, poisson=1 / 3, plane="stress", kinematics="linear",
            quadrature=quadrature,
        )  # fmt: skip
        bulk = np.einsum("ppqq->", stiffness(material, X)) / 4
        assert bulk == pytest.approx(E / (2 * (1 - 1 / 3)), rel=1e-12 if quadrature == "matched" else 0.05)


@pytest.mark.parametrize(("dim", "plane", "fixed"), [(3, "strain", 1 / 4), (2, "strain", 1 / 4), (2, "stress", 1 / 3)])
def test_fixed_poisson_ratio(dim, plane, fixed):
    keys = SimpleNamespace(
        E=E, nu=0.3, plane=plane, allow_any_poisson=False, surface_correction="none", quadrature="matched",
        microelastic="prototype", kinematics="nonlinear",
    )  # fmt: skip
    with pytest.raises(ValueError, match=f"has Poisson's ratio {fixed:.4g} in .*allow_any_poisson = true"):
        BondBased.Keys.check(keys, dim)
    for allowed in ({"nu": round(fixed, 2)}, {"nu": None}, {"allow_any_poisson": True}):
        BondBased.Keys.check(SimpleNamespace(**vars(keys) | allowed), dim)
    BondBased.Keys.check(keys, 1)
    body = sample(dim)  # a rounded ratio means the fixed one
    exact, rounded = (
        BondBased.from_case(SimpleNamespace(**vars(keys) | {"nu": nu}), part_of(body))
        for nu in (fixed, round(fixed, 2))
    )
    assert np.array_equal(force(exact, deformation(body.X)), force(rounded, deformation(body.X)))
    keys.surface_correction, keys.nu = "energy", None
    with pytest.raises(ValueError, match="goes with quadrature"):
        BondBased.Keys.check(keys, dim)
    lame, shear = lame_constants(E, fixed, plane, dim)
    assert lame == pytest.approx(shear)  # Cauchy's relation


@every_plane
def test_stress_of_small_strains_is_hookes(dim, plane):
    """Of matched families, in the directions that the body does not have too."""
    X = lattice((9, 8, 7)[:dim]) + np.random.default_rng(0).uniform(-0.1, 0.1, (np.prod((9, 8, 7)[:dim]), dim))
    n = len(X)
    body = Sample(X, np.ones(n), np.full(n, 2.9), np.ones(n), np.empty(0))
    body.weight = np.ones(body.families().bonds)
    material = LinearPeridynamicSolid(part_of(body), E, 0.2, plane, kinematics="linear")
    A = 1e-3 * strong_gradient(dim)
    strain = np.zeros((3, 3))
    strain[:dim, :dim] = (A + A.T) / 2
    if plane == "stress":
        lateral = -0.2 / 0.8 if dim == 2 else -0.2
        for k in range(dim, 3):
            strain[k, k] = lateral * np.trace(strain[:dim, :dim])
    lame, shear = lame_constants(E, 0.2)
    expected = lame * np.trace(strain) * np.eye(3) + 2 * shear * strain
    sigma = material.cauchy_stress(body.X @ A.T)
    matched = np.abs(sigma - expected).max(axis=(1, 2)) < 1e-12 * np.abs(expected).max()
    assert matched.sum() >= len(body.X) - material.unmatched >= len(body.X) // 3
    H = material.displacement_gradient(body.X @ A.T)
    assert np.abs((H + H.transpose(0, 2, 1)) / 2 - strain).max() < 1e-15


@pytest.mark.parametrize("counts", [(9,), (7, 6), (12, 2), (4, 4, 4), (8, 2, 2)], ids=str)
@pytest.mark.parametrize("model", (BondBased, LinearPeridynamicSolid))
def test_matched_bodies_are_stable(model, counts):
    """Free bodies on lattices and jittered points, corners and edges included: nothing but rigid motions is free."""
    dim = len(counts)
    nu = (fixed_poisson(dim, "strain") or 0.3) if model is BondBased else 0.45
    for jitter in (0.0, 0.2):
        X = lattice(counts)
        n = len(X)
        X = X + jitter * np.random.default_rng(1).uniform(-1, 1, X.shape)
        body = Sample(X, np.ones(n), np.full(n, 3.015), np.ones(n), np.empty(0))
        body.weight = np.ones(body.families().bonds)
        K = tangent(model(part_of(body), E, nu), np.zeros_like(X))
        values = np.linalg.eigvalsh((K + K.T) / 2)
        rigid = dim * (dim + 1) // 2
        assert np.abs(values[:rigid]).max() < 1e-13 * values[-1]
        assert values[rigid] > 1e-4 * values[-1]


def test_printed_abd_loses_its_dilatation_as_it_turns():
    """The cosine of seed 000 Eq. 34 is that of the rotation: at 90 degrees nothing is left of theta."""
    body = sample(2)
    dilation = 1.001 * np.eye(2)
    for rotation_weighted, kept in ((True, False), (False, True)):
        material = ABD(part_of(body), E, 0.45, rotation_weighted=rotation_weighted)
        straight = material.energy(body.X @ (dilation - np.eye(2)).T)
        turned = material.energy(body.X @ (rotation(2, np.pi / 2) @ dilation - np.eye(2)).T)
        assert close(turned, straight, 1e-10) == kept
