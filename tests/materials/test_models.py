"""What every material model must keep, on one process: one table of models (tests/models.py), one test for each law."""

import json

import numpy as np
import pytest
from models import (
    MODELS,
    NAMES,
    POISSON,
    Sample,
    action,
    correspondence,
    deformation,
    dimensions_of_the_model,  # noqa: F401  used by itself
    force,
    model,
    rotation,
    sample,
    strong_gradient,
    tangent,
)

from pdpetsc.errors import InputError

DIMENSIONS = (1, 2, 3)
every_model = pytest.mark.parametrize("row", MODELS, ids=NAMES)
every_dimension = pytest.mark.parametrize("dim", DIMENSIONS)
with_rotations = pytest.mark.parametrize("dim", (2, 3))


def relative(difference, reference) -> float:
    return float(np.abs(difference).max() / np.abs(reference).max())


@every_dimension
@every_model
def test_reference_and_translations_are_free_of_force(row, dim):
    body = sample(dim)
    material = body.material(row)
    assert np.array_equal(force(material, np.zeros_like(body.X)), np.zeros_like(body.X))
    assert np.array_equal(force(material, np.full_like(body.X, 0.7)), np.zeros_like(body.X))
    assert np.array_equal(material.energy(np.full_like(body.X, 0.7)), np.zeros(len(body.X)))


@pytest.mark.parametrize("degrees", (90, 180))
@with_rotations
@every_model
def test_rotations_are_free_of_force(row, dim, degrees):
    body = sample(dim)
    u = body.X @ (rotation(dim, np.deg2rad(degrees)) - np.eye(dim)).T
    f = np.abs(force(body.material(row), u)).max()
    if row.objective or not row.hyperelastic:  # extensions are objective, whatever their weights
        assert f < 1e-13
    else:
        assert f > 1e-2


@with_rotations
@every_model
def test_objectivity(row, dim):
    """f(Q x) = Q f(x), and the energy does not change."""
    body = sample(dim)
    material = body.material(row)
    u, Q = deformation(body.X), rotation(dim, 2.2, seed=5)
    turned = (body.X + u) @ Q.T - body.X
    f = force(material, u)
    difference = relative(force(material, turned) - f @ Q.T, f)
    assert difference < 1e-13 if row.objective else difference > 1e-2
    energies = material.energy(u)
    difference = relative(material.energy(turned) - energies, energies)
    assert difference < 1e-13 if row.objective else difference > 1e-2


@every_dimension
@every_model
def test_momenta(row, dim):
    body = sample(dim)
    u = deformation(body.X)
    f = force(body.material(row), u)
    size = np.abs(f).sum()
    assert np.abs(f.sum(axis=0)).max() < 1e-15 * size
    x, three = np.zeros((len(f), 3)), np.zeros((len(f), 3))
    x[:, :dim], three[:, :dim] = body.X + u, f
    moment = np.abs(np.cross(x, three).sum(axis=0)).max() / (size * np.abs(x).max())
    if row.angular:
        assert moment < 1e-15
    elif dim > 1:
        assert moment > 1e-4


@every_dimension
@every_model
def test_force_is_gradient_of_energy(row, dim):
    body = sample(dim)
    material, u = body.material(row), deformation(body.X)
    v = np.random.default_rng(1).normal(size=u.shape)
    h = 1e-5
    difference = (material.energy(u + h * v).sum() - material.energy(u - h * v).sum()) / (2 * h)
    power = (force(material, u) * v).sum()
    error = abs(difference - power) / np.abs(force(material, u) * v).sum()
    assert error < 1e-8 if row.hyperelastic or dim == 1 else error > 1e-4


@pytest.mark.parametrize("seed", (0, 1))
@every_dimension
@every_model
def test_action_is_derivative_of_force(row, dim, seed):
    """In real units, dx = 1 mm and E = 70 GPa, by central differences of step 1e-6 dx."""
    spacing = 1e-3
    body = sample(dim, seed).scaled(spacing, 70e9)
    material = body.material(row)
    u = deformation(body.X / spacing, seed) * spacing
    v = np.random.default_rng(1).uniform(-1, 1, u.shape)
    h = 1e-6 * spacing
    difference = (force(material, u + h * v) - force(material, u - h * v)) / (2 * h)
    assert relative(action(material, u, v) - difference, difference) < 1e-8  # asked for: 1e-7


@every_dimension
@every_model
def test_rows_are_the_action_and_symmetric(row, dim):
    body = sample(dim)
    material, u = body.material(row), deformation(body.X)
    K = tangent(material, u)
    v = np.random.default_rng(1).normal(size=u.shape)
    Kv = action(material, u, v)
    assert relative(K @ v.ravel() - Kv.ravel(), Kv) < 1e-13
    assert material.symmetric == row.hyperelastic
    assert relative(K - K.T, K) < 1e-14 if row.hyperelastic or dim == 1 else relative(K - K.T, K) > 1e-4


@every_dimension
@every_model
def test_stiffness_at_reference_is_not_negative(row, dim):
    body = sample(dim)
    K = tangent(body.material(row), np.zeros_like(body.X))
    assert relative(K - K.T, K) < 1e-14
    values = np.linalg.eigvalsh(K)
    assert values[0] > -1e-13 * values[-1]
    rigid = dim if row.control == "spring" else dim * (dim + 1) // 2
    zeros = int((values < 1e-10 * values[-1]).sum())
    assert zeros == rigid if row.control != "none" else zeros >= rigid


@every_dimension
@every_model
def test_a_body_is_the_sum_of_its_families(row, dim):
    """A material on a part of the particles evaluates their families alone, and parts add up to the whole."""
    if row.reach > 2:
        pytest.skip("constants depend on which neighbours have the same material")
    body = sample(dim)
    u, v = deformation(body.X), np.random.default_rng(1).normal(size=body.X.shape)
    families = body.families()
    first = np.arange(len(families)) % 3 == 0
    parts = []
    for chosen in (first, ~first):
        bonds = np.repeat(chosen, np.diff(families.offsets))
        own = families.subset(np.flatnonzero(chosen))
        parts.append(row.build(body.neighbourhood(own, body.weight[bonds]), body.young))
    whole = body.material(row)
    for of in (lambda m: force(m, u), lambda m: action(m, u, v), lambda m: tangent(m, u)):
        assert relative(sum(map(of, parts)) - of(whole), of(whole)) < 1e-13
    energy = whole.energy(u)
    assert np.allclose(parts[0].energy(u), energy[first], rtol=1e-13, atol=0)


@every_dimension
@every_model
def test_units_of_length_do_not_matter(row, dim):
    """Metres and pascals, millimetres and megapascals: the same forces in newtons."""
    metres, millimetres = sample(dim), sample(dim).scaled(1e3, 1e-6)
    u, v = deformation(metres.X), np.random.default_rng(1).normal(size=metres.X.shape)
    a, b = metres.material(row), millimetres.material(row)
    assert relative(force(b, 1e3 * u) - force(a, u), force(a, u)) < 1e-13
    assert relative(action(b, 1e3 * u, 1e3 * v) - action(a, u, v), action(a, u, v)) < 1e-13
    assert relative(b.energy(1e3 * u).sum() - 1e3 * a.energy(u).sum(), 1e3 * a.energy(u).sum()) < 1e-13


@every_dimension
@every_model
def test_inverted_flat_and_undefined_states_are_not_numbers(row, dim):
    body = sample(dim)
    material = body.material(row)
    for stretch in (-1.5, -1.0):  # F_xx = -0.5: inverted; 0: flat
        u = np.zeros_like(body.X)
        u[:, 0] = stretch * body.X[:, 0]
        if stretch < -1 and row.inverts:
            assert np.isnan(force(material, u)).all()
    u = deformation(body.X)
    u[0, 0] = np.nan
    f = force(material, u)
    with_the_first = np.unique(np.concatenate([*families_around(body, 0, material.couples_family)]))
    assert np.isnan(f[with_the_first]).any(axis=1).all()


def families_around(body: Sample, particle: int, couples: bool):
    """Members of the families in which a particle takes part; where bonds do not couple, its partners only."""
    families = body.families()
    for i, (a, b) in enumerate(zip(families.offsets[:-1], families.offsets[1:])):
        members = np.append(families.neighbours[a:b], i)
        if particle in members:
            yield members if couples or i == particle else np.array([i, particle])


@every_dimension
@every_model
def test_rounding_scale(row, dim):
    """`add_force_scale` bounds the terms that cancel: at small strains it is no smaller than the force, and machine
    precision times it is about the rounding error."""
    body = sample(dim)
    material = body.material(row)
    u = 1e-3 * np.random.default_rng(2).uniform(-1, 1, body.X.shape)
    scale = np.zeros(len(u))
    material.add_force_scale(u, scale)
    assert np.all(np.abs(force(material, u)).max(axis=1) <= 1.01 * scale)  # strains of 1e-3 are not quite linear
    shifted = np.zeros(len(u))
    material.add_force_scale(u + 3.0, shifted)
    rounding = np.abs(force(material, u + 3.0) - force(material, u))  # u + 3 has lost digits of u
    assert np.all(rounding.max(axis=1) <= np.finfo(float).eps * shifted)
    doubled = np.zeros(len(u))
    material.add_force_scale(2 * u, doubled)
    assert np.allclose(doubled, 2 * scale)


@every_model
def test_choices_can_be_written(row):
    assert json.loads(json.dumps(sample(2).material(row).choices()))["plane"] in ("strain", "stress")


@every_dimension
@every_model
def test_deformation_gradient_of_affine_fields_is_exact(row, dim):
    body = sample(dim)
    A = np.random.default_rng(3).uniform(-0.4, 0.4, (dim, dim))
    H = body.material(row).displacement_gradient(body.X @ A.T + 0.1)
    assert np.abs(H[:, :dim, :dim] - A).max() < 1e-14
    assert not H[:, dim:, :dim].any()
    assert not H[:, :dim, dim:].any()
    if not row.lateral:
        assert not H[:, dim:].any()


# Correspondence models


@every_dimension
@pytest.mark.parametrize("elasticity", ("hencky", "saint_venant_kirchhoff", "neo_hookean"))
def test_silling_leaves_affine_fields_alone(elasticity, dim):
    body = sample(dim)
    plain, controlled = (body.material(correspondence(elasticity, kind)) for kind in ("none", "silling"))
    affine = deformation(body.X, ripple=0.0)
    assert relative(controlled.energy(affine) - plain.energy(affine), plain.energy(affine)) < 1e-13
    assert relative(force(controlled, affine) - force(plain, affine), force(plain, affine)) < 1e-13
    rippled = affine + 0.05 * np.random.default_rng(4).uniform(-1, 1, affine.shape)
    gain = controlled.energy(rippled) - plain.energy(rippled)  # none where a family has no more bonds than dimensions
    assert gain.min() > -1e-15
    assert gain.max() > 1e-5


@every_dimension
def test_zero_energy_control_by_its_definition(dim):
    """silling: V c/2 sum w |z|^2, z = y - F xi (seed 004 Eq. 5.12); spring: V c/2 sum w |eta|^2; with the strength G,
    c = G mu / lambda_max(K), in 1D with the modulus of uniaxial strain."""
    body = sample(dim)
    u = deformation(body.X)
    families = body.families()
    i, j = families.per_bond(np.arange(len(u))), families.neighbours
    xi, eta = body.X[j] - body.X[i], u[j] - u[i]
    w = body.weight * body.volume[j]
    first = families.offsets[:-1]
    K = np.add.reduceat(w[:, None, None] * xi[:, :, None] * xi[:, None, :], first)
    H = np.add.reduceat(w[:, None, None] * eta[:, :, None] * xi[:, None, :], first) @ np.linalg.inv(K)
    z = eta - np.einsum("bpq,bq->bp", H[i], xi)
    plain = body.material(model("hencky-none")).energy(u)
    shear, lame = 1 / (2 * (1 + POISSON)), POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    softest = lame + 2 * shear if dim == 1 else shear
    c = 0.3 * softest / np.linalg.eigvalsh(K)[:, -1]
    for control, part in (("silling", z), ("spring", eta)):
        expected = plain + body.volume * c / 2 * np.add.reduceat(w * (part**2).sum(axis=1), first)
        assert relative(body.material(model(f"hencky-{control}")).energy(u) - expected, expected) < 1e-13


@every_dimension
@every_model
def test_cauchy_stress_of_affine_fields(row, dim):
    """Symmetric, turning with the body, alike everywhere for correspondence models."""
    body = sample(dim)
    material = body.material(row)
    u = deformation(body.X, ripple=0.0)
    sigma = material.cauchy_stress(u)
    size = np.abs(sigma).max()
    assert np.abs(sigma - sigma.transpose(0, 2, 1)).max() < 1e-14 * size
    if row.control:
        assert np.abs(sigma - sigma[0]).max() < 1e-13 * size
    Q = np.eye(3)
    Q[:dim, :dim] = rotation(dim, 1.0)
    turned = material.cauchy_stress((body.X + u) @ Q[:dim, :dim].T - body.X)
    if row.objective or row.control:
        assert np.abs(turned - Q @ sigma @ Q.T).max() < 1e-13 * size


@every_dimension
@every_model
def test_stress_is_conjugate_to_the_gradient(row, dim):
    """Family by family, d(W/V) = P : dF with P = J sigma F^-T; for small strains in linear kinematics P = sigma."""
    if row.control == "spring" or not row.hyperelastic:
        return
    body = sample(dim)
    material = body.material(row)
    A, B = strong_gradient(dim), np.random.default_rng(5).uniform(-1, 1, (dim, dim))
    rate = (material.energy(body.X @ (A + 1e-5 * B).T) - material.energy(body.X @ (A - 1e-5 * B).T)) / 2e-5
    u = body.X @ A.T
    P = material.cauchy_stress(u)
    if not row.linear:
        F = np.eye(3) + material.displacement_gradient(u)
        P = np.linalg.det(F)[:, None, None] * P @ np.linalg.inv(F).transpose(0, 2, 1)
    power = body.volume * (P[:, :dim, :dim] * B).sum(axis=(1, 2))
    assert relative(power - rate, rate) < 1e-8


@pytest.mark.parametrize("dim", DIMENSIONS)
@every_model
def test_smallest_bodies(row, dim):
    """dim + 1 particles span the dimension: two, three, four."""
    X = np.vstack([np.zeros(dim), np.eye(dim)]) + 0.05 * np.arange((dim + 1) * dim).reshape(-1, dim)
    n = len(X)
    body = Sample(X, np.ones(n), np.full(n, 2.0), np.ones(n), np.ones(n * dim))
    material = body.material(row)
    u = X @ (0.2 * np.ones((dim, dim)) + 0.1 * np.eye(dim)) + 0.01 * np.arange(n * dim).reshape(n, dim)
    v = np.random.default_rng(0).normal(size=u.shape)
    f = force(material, u)
    assert np.abs(f.sum(axis=0)).max() < 1e-15 * np.abs(f).sum()
    difference = (force(material, u + 1e-6 * v) - force(material, u - 1e-6 * v)) / 2e-6
    assert relative(action(material, u, v) - difference, difference) < 1e-8
    K = tangent(material, u)
    assert relative(K @ v.ravel() - action(material, u, v).ravel(), difference) < 1e-13


@pytest.mark.parametrize(
    ("X", "place"),
    [
        ([[0.5, 0.0], [1.5, 0.0], [2.5, 0.0]], r"\(0\.5, 0\), 2 bonds, does not span 2 dimensions"),
        ([[0.0, 0.0], [1.0, 1.0]], r"\(0, 0\), 1 bonds, does not span 2 dimensions"),
        ([[0, 0, 2.0], [1, 0, 2], [0, 1, 2], [1, 1, 2]], r"\(0, 0, 2\), 3 bonds, does not span 3 dimensions"),
    ],
)
@pytest.mark.parametrize("size", (1e-6, 1.0, 1e6))
def test_singular_shape_tensor_names_the_place(X, place, size):
    X = size * np.array(X)
    n = len(X)
    body = Sample(X, np.full(n, size**3), np.full(n, 3.0 * size), np.full(n, size), np.ones(n * (n - 1)))
    with pytest.raises(InputError, match=place if size == 1 else "singular shape tensor"):
        body.material(model("hencky-none"))


@every_dimension
@every_model
def test_row_sums_are_bounds(row, dim):
    """Of the absolute entries of the tangent, and not far off: fictitious masses and stable steps follow from them."""
    body = sample(dim)
    material = body.material(row)
    u = deformation(body.X)
    K = tangent(material, u)
    material.linearise(u)
    bound = np.zeros_like(body.X)
    material.add_row_sums(bound)
    sums = np.abs(K).sum(axis=1).reshape(bound.shape)
    assert (bound >= sums * (1 - 1e-12)).all()
    assert bound.sum() < 3 * sums.sum()
