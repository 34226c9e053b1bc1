"""Bonds that soften: the factor itself, and the laws of every material model with bonds in all states."""

import numpy as np
import pytest
from conftest import EVERY
from materials.test_broken_bonds import broken
from materials.test_models import (  # noqa: F401  collected from here
    every_dimension,
    every_model,
    relative,
    test_action_is_derivative_of_force,
    test_momenta,
    test_reference_and_translations_are_free_of_force,
    test_rotations_are_free_of_force,
    test_rounding_scale,
    test_units_of_length_do_not_matter,
    with_rotations,
)
from models import (
    MODELS,
    Sample,
    action,
    deformation,
    dimensions_of_the_model,  # noqa: F401  used by itself
    force,
    model,
    rotation,
    sample,
    tangent,
)

from pdpetsc.materials.softening import Softening, softened

START, END = 0.1, 0.35
PRINTED = [model(name) for name in ("hencky-silling", "bond", "ordinary", "ordinary-linear", "abd")]


def softening(material, rescaled: bool = True) -> Softening:
    """Bonds in all states: a fifth is exempt, a fourth has been stretched before, and families differ."""
    rng = np.random.default_rng(11)
    n, bonds = len(material.families), material.families.bonds
    start, end = (0.05, 0.16) if material.linear else (START, END)  # turned bonds are shorter
    largest = np.where(rng.uniform(size=bonds) < 0.25, rng.uniform(0.0, 1.2 * end, bonds), 0.0)
    factor = rng.uniform(0.8, 1.2, n)
    return Softening(start * factor, end * factor, 3.0, rescaled, largest, rng.uniform(size=bonds) > 0.2)


def stretched(X, seed: int = 0) -> np.ndarray:
    """A strong deformation that stretches most bonds."""
    return 1.2 * deformation(X, seed) + 0.2 * X


def stretches(material, X, u) -> np.ndarray:
    """(|y| - |xi|)/|xi| of each bond, or xi.eta/|xi|^2."""
    families = material.families
    i, j = families.per_bond(families.center), families.neighbours
    xi, eta = X[j] - X[i], u[j] - u[i]
    if material.linear:
        return (xi * eta).sum(axis=1) / (xi**2).sum(axis=1)
    return np.linalg.norm(xi + eta, axis=1) / np.linalg.norm(xi, axis=1) - 1


KINDS = {2: ("hencky-silling", "bond", "ordinary", "ordinary-linear", "abd"), 3: ("hencky-silling", "ordinary")}
if not EVERY:
    KINDS = {2: ("hencky-silling", "ordinary-linear"), 3: ("ordinary",)}


@pytest.fixture(autouse=True)
def one_row_of_each_kind(request):
    """Other rows have the same kernels of softening, and compiling all takes a quarter of an hour."""
    given = getattr(request.node, "callspec", None)
    if given and "row" in given.params:
        name, dim = given.params["row"].name, given.params.get("dim", 2)
        if name not in KINDS.get(dim, ()):
            pytest.skip("another row has the same kernels")


@pytest.fixture(autouse=True)
def bonds_soften(monkeypatch):
    """Bonds of every body soften, and some are broken."""
    whole = Sample.material

    def material(self, row, broken_too=True, printed=False):
        result = whole(self, row)
        result.soften(softening(result, rescaled=not printed), printed)
        if broken_too:
            result.set_bonds(broken(result.families))
        return result

    monkeypatch.setattr(Sample, "material", material)
    monkeypatch.setattr("materials.test_models.deformation", stretched)


def factor(stretch: float, rescaled: bool = True, largest: float = 0.0, live: bool = True, softens: bool = True):
    one = np.array([START]), np.array([END]), 3.0, rescaled, np.array([largest]), np.array([softens]), live
    return softened(Softening(*one), 0, 0, stretch)


def test_the_factor():
    """Continuous at both ends, a half between them; printed, it jumps there by (1 - tanh 3)/2."""
    near = 1e-12
    jump = (1 - np.tanh(3.0)) / 2
    assert jump == pytest.approx(0.0025, abs=3e-5)
    for rescaled, step in ((True, 0.0), (False, jump)):
        assert factor(START - near, rescaled) == (1.0, 0.0)
        assert factor(START, rescaled)[0] == pytest.approx(1 - step, abs=1e-15)
        assert factor((START + END) / 2, rescaled)[0] == pytest.approx(0.5)
        assert factor(END - near, rescaled)[0] == pytest.approx(step, abs=1e-11)
        assert factor(END, rescaled) == (0.0, 0.0)
    assert factor(0.2, softens=False) == (1.0, 0.0)


@pytest.mark.parametrize("rescaled", (True, False))
def test_derivative_of_the_factor(rescaled):
    h = 1e-6
    for stretch in np.linspace(START + 2 * h, END - 2 * h, 21):
        difference = (factor(stretch + h, rescaled)[0] - factor(stretch - h, rescaled)[0]) / (2 * h)
        assert factor(stretch, rescaled)[1] == pytest.approx(difference, rel=1e-7)


def test_bonds_do_not_heal():
    """Below the largest stretch T is what it was; at it, the derivative is that of loading."""
    T, slope = factor(0.2)
    assert slope < 0
    assert factor(0.15, largest=0.2) == factor(-0.3, largest=0.2) == (T, 0.0)
    assert factor(0.2, largest=0.2) == (T, slope)
    assert factor(0.3, largest=0.2, live=False) == (T, 0.0)
    assert factor(0.1, largest=END) == (0.0, 0.0)


@every_dimension
@every_model
def test_bonds_are_in_all_states(row, dim):
    """Of what the laws below are tested with; in one dimension there are few bonds."""
    body = sample(dim)
    material = body.material(row)
    s, given = stretches(material, body.X, stretched(body.X)), material._softening
    start, end = (np.repeat(x, np.diff(material.families.offsets)) for x in (given.start, given.end))
    softens = given.softens & material.intact
    states = softens & (s > start) & (s < end) & (s > given.largest), softens & (s > end), softens & (s < given.largest)
    fewest = [int(state.sum()) for state in states]
    if dim > 1:
        assert min(fewest) > 0, fewest
    assert (~given.softens & material.intact).any()


@with_rotations
@pytest.mark.parametrize("row", [row for row in MODELS if row.objective], ids=lambda row: row.name)
def test_objectivity(row, dim):
    """f(Q x) = Q f(x): T is a function of lengths."""
    body = sample(dim)
    material, u = body.material(row), stretched(body.X)
    Q = rotation(dim, 2.2, seed=5)
    turned = (body.X + u) @ Q.T - body.X
    f, energies = force(material, u), material.energy(u)
    assert relative(force(material, turned) - f @ Q.T, f) < 1e-13
    assert relative(material.energy(turned) - energies, energies) < 1e-13


@every_dimension
@every_model
def test_rows_are_the_action(row, dim):
    body = sample(dim)
    rows_are_the_action(body.material(row), stretched(body.X))


def rows_are_the_action(material, u):
    """The assembled tangent, its diagonal blocks and the action; dense."""
    dim = u.shape[1]
    K = tangent(material, u)
    v = np.random.default_rng(1).normal(size=u.shape)
    Kv = action(material, u, v)
    assert relative(K @ v.ravel() - Kv.ravel(), Kv) < 1e-13
    diagonal = np.zeros((len(u), dim, dim))
    material.add_diagonal(diagonal)
    blocks = np.einsum("npnq->npq", K.reshape(len(u), dim, len(u), dim))
    assert np.abs(diagonal - blocks).max() < 1e-13 * np.abs(blocks).max()
    if dim > 1:
        difference = relative(K - K.T, K)
        assert difference < 1e-14 if material.symmetric else difference > 1e-4
    assert material.symmetric == (not material.couples_family)


@pytest.mark.parametrize("live", (True, False))
@every_dimension
@every_model
def test_frozen_softening(row, dim, live):
    """Forces are the gradient of the energy at the T of a state, and the tangent is symmetric; with T that follows the
    bonds they are not, but for the tangent of models in which bonds are alone."""
    if not row.hyperelastic or dim == 1:
        return
    body = sample(dim)
    material, u = body.material(row), stretched(body.X)
    f = force(material, u)
    material.set_softening(np.maximum(material._softening.largest, stretches(material, body.X, u)), live)
    assert relative(force(material, u) - f, f) < 1e-14  # committing changes no force
    K = tangent(material, u)
    error = relative(K - K.T, K)
    assert error > 1e-4 if live and material.couples_family else error < 1e-14
    v = np.random.default_rng(1).normal(size=u.shape)
    Kv = action(material, u, v)
    assert relative(K @ v.ravel() - Kv.ravel(), Kv) < 1e-13
    h = 1e-5
    difference = (material.energy(u + h * v).sum() - material.energy(u - h * v).sum()) / (2 * h)
    power = (f * v).sum()
    error = abs(difference - power) / np.abs(f * v).sum()
    assert error > 1e-4 if live else error < 1e-8


@every_dimension
@pytest.mark.parametrize("row", PRINTED, ids=lambda row: row.name)
def test_printed_softening(row, dim):
    """T on the forces alone: linear momentum holds, angular momentum is lost by correspondence models, and the tangent
    is exact."""
    body = sample(dim)
    material, u = body.material(row, broken_too=False, printed=True), stretched(body.X)
    f = force(material, u)
    size = np.abs(f).sum()
    assert np.abs(f.sum(axis=0)).max() < 1e-15 * size
    x, three = np.zeros((len(f), 3)), np.zeros((len(f), 3))
    x[:, :dim], three[:, :dim] = body.X + u, f
    moment = np.abs(np.cross(x, three).sum(axis=0)).max() / (size * np.abs(x).max())
    if row.control and dim > 1:
        assert moment > 1e-4
    elif row.angular:
        assert moment < 1e-15
    v = np.random.default_rng(1).uniform(-1, 1, u.shape)
    h = 1e-6
    difference = (force(material, u + h * v) - force(material, u - h * v)) / (2 * h)
    assert relative(action(material, u, v) - difference, difference) < 1e-8
    rows_are_the_action(material, u)


@every_dimension
@every_model
def test_without_any_stretch_nothing_changes(row, dim):
    """Whole bonds: forces, tangent and stress are those of the unsoftened model."""
    body = sample(dim)
    u = 0.5 * (rotation(dim, 0.3) @ body.X.T).T - 0.5 * body.X  # turned, and shorter
    u = u - 0.3 * body.X + 0.01 * np.random.default_rng(2).uniform(-1, 1, u.shape)
    plain = row.build(body.neighbourhood(), body.young)
    material = row.build(body.neighbourhood(), body.young)
    given = softening(material)
    material.soften(given._replace(largest=np.zeros_like(given.largest)))
    v = np.random.default_rng(1).normal(size=u.shape)
    assert stretches(material, body.X, u).max() < given.start.min()
    for of in (
        lambda m: force(m, u), lambda m: action(m, u, v), lambda m: tangent(m, u), lambda m: m.energy(u),
        lambda m: m.cauchy_stress(u), lambda m: m.displacement_gradient(u),
    ):  # fmt: skip
        assert relative(of(material) - of(plain), of(plain)) < 1e-12
    assert (material.integrity() == 1).all() and plain.integrity() is None


@every_dimension
@every_model
def test_bonds_that_have_softened_away_are_broken_ones(row, dim):
    """Removing bonds with T = 0 changes neither forces nor energies, families that go over to rods included; and what
    is left of a bond is mu T."""
    body = sample(dim)
    material, u = row.build(body.neighbourhood(), body.young), stretched(body.X)
    intact = broken(material.families)
    given = softening(material)._replace(softens=np.ones(len(intact), bool), live=False)
    material.soften(given._replace(largest=np.where(intact, given.largest / 2, 1.0)))
    f, energy = force(material, u), material.energy(u)
    T = material.integrity()
    assert (T[~intact] == 0).all() and T[intact].min() > 0 and T.max() == 1
    material.set_bonds(intact)
    assert relative(force(material, u) - f, f) < 1e-12
    assert relative(material.energy(u) - energy, energy) < 1e-12
    assert np.array_equal(material.integrity(), T)
    plain = row.build(body.neighbourhood(), body.young)
    plain.set_bonds(intact)
    material.set_softening(np.zeros(len(intact)), False)
    assert relative(force(material, u) - force(plain, u), force(plain, u)) < 1e-12
    assert relative(tangent(material, u) - tangent(plain, u), tangent(plain, u)) < 1e-12


@pytest.mark.parametrize("dim", (1, 2, 3))
@pytest.mark.parametrize("name", ("hencky-silling", "ordinary", "bond"))
def test_a_body_pulled_apart_carries_nothing(name, dim):
    """Forces fade steadily with the stretch, to zero where all bonds have reached s_cr; with families that go over to
    rods as K shrinks, the correspondence model too."""
    body = sample(dim)
    material = model(name).build(body.neighbourhood(), body.young)
    n, bonds = len(material.families), material.families.bonds
    material.soften(Softening(np.full(n, START), np.full(n, END), 3.0, True, np.zeros(bonds), np.ones(bonds, bool)))
    sizes = np.array([np.abs(force(material, stretch * body.X)).max() for stretch in np.linspace(0, 0.36, 361)])
    assert sizes.argmax() > 100
    assert (sizes[352:] == 0).all()
    assert np.abs(np.diff(sizes)).max() < 0.1 * sizes.max()
