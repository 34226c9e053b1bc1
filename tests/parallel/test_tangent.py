"""The assembled tangent: pattern and values against the action and against differences of the residual."""

import re
from ctypes import CDLL

import numpy as np
import pytest
from bodies import affine, assembler, distributed, jittered, rows_of, whole
from models import (
    MODELS,
    NAMES,
    Sample,
    deformation,
    dimensions_of_the_model,  # noqa: F401  used by itself
    force,
    lattice,
    model,
    strong_gradient,
)
from petsc4py import PETSc

from pdpetsc.materials.softening import Softening
from pdpetsc.solvers.tangent import AssembledTangent, MatrixFreeTangent

pytestmark = pytest.mark.mpi

every_model = pytest.mark.parametrize("row", MODELS, ids=NAMES)


def body(dim: int, counts=None):
    """Random points, horizons and volumes."""
    X = jittered(counts or {1: (13,), 2: (6, 5), 3: (4, 3, 3)}[dim], 0.15)
    rng = np.random.default_rng(dim)
    return distributed(X, rng.uniform(1.6, 2.6, len(X)), rng.uniform(0.5, 1.5, len(X)))


def deformed(p):
    """The same strong deformation on any number of ranks."""
    X = p.position[: p.owned]
    return X @ strong_gradient(p.dim).T + 0.05 * random_field(p, seed=9)


def random_field(p, seed=3):
    return np.random.default_rng(seed).uniform(-1, 1, (p.count, p.dim))[p.id[: p.owned]]


def held(X):
    """One end entirely, and single components inside, on the ranks' borders too."""
    mask = np.zeros(X.shape, bool)
    mask[X[:, 0] < 1.2] = True
    mask[:, 0] |= np.sin(37 * X).sum(axis=1) > 0.9
    return mask


def product(mat, values):
    x, y = mat.createVecs()
    x.getArray()[...] = values.ravel()
    mat.mult(x, y)
    return y.getArray(readonly=True).reshape(values.shape).copy()


def largest(comm, values):
    return max(comm.allgather(float(np.abs(values).max(initial=0.0))))


@pytest.mark.parametrize("counts", [(13,), (40,), (6, 5), (17, 4), (1, 2), (4, 3, 3), (8, 2, 2)], ids=str)
def test_matrix_is_the_action(comm, counts):
    dim = len(counts)
    p = body(dim, counts) if np.prod(counts) > 2 else distributed(jittered((3, 2), 0.1), 2.5)
    a = assembler(p, model("hencky-silling"))
    u, v = deformed(p), random_field(p)
    mat = a.assemble(u)
    assert mat.getSize() == (p.count * p.dim,) * 2
    assert mat.getBlockSize() == p.dim
    Kv = a.action(v)
    assert largest(comm, product(mat, v) - Kv) < 1e-13 * largest(comm, Kv)
    # A second filling at another state replaces the values.
    a.assemble(0.5 * u)
    Kv = a.action(v)
    assert largest(comm, product(mat, v) - Kv) < 1e-13 * largest(comm, Kv)


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_two_materials(comm, dim):
    """Each particle's family uses its own material; the pattern is the union, the matrix the sum."""
    p = body(dim)
    a = assembler(p, model("hencky-silling"), model("neo_hookean-none"), model("saint_venant_kirchhoff-spring"))
    u, v = deformed(p), random_field(p)
    mat = a.assemble(u)
    Kv = a.action(v)
    assert largest(comm, product(mat, v) - Kv) < 1e-13 * largest(comm, Kv)
    J = np.concatenate(comm.allgather(rows_of(mat)))
    assert np.abs(J - J.T).max() < 1e-14 * np.abs(J).max()


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_constrained_rows_and_columns(comm, dim):
    p = body(dim)
    a = assembler(p, model("hencky-silling"), held=held)
    u, v = deformed(p), random_field(p)
    mat = a.assemble(u)  # the displacement as it is: constrained entries are overwritten by SNES's callback only
    J = rows_of(mat)
    fixed = a.constrained
    every_fixed = np.concatenate(comm.allgather(fixed.ravel()))
    assert 0 < every_fixed.sum() < every_fixed.size
    start = mat.getOwnershipRange()[0]
    unit = np.zeros_like(J)
    rows = np.flatnonzero(fixed.ravel())
    unit[rows, start + rows] = a.constraint_scale
    assert np.array_equal(J[rows], unit[rows])
    assert np.array_equal(J[:, every_fixed], unit[:, every_fixed])
    free = np.where(fixed, 0.0, v)
    Kv = np.where(fixed, 0.0, a.action(free))
    assert largest(comm, product(mat, free) - Kv) < 1e-13 * largest(comm, Kv)
    whole_matrix = np.concatenate(comm.allgather(J))
    assert np.abs(whole_matrix - whole_matrix.T).max() < 1e-14 * np.abs(whole_matrix).max()
    diagonal = np.diag(whole_matrix)[~every_fixed]
    assert diagonal.min() / 30 < a.constraint_scale < 30 * diagonal.max()  # of the size of its neighbours


def test_everything_constrained(comm):
    p = body(2)
    a = assembler(p, model("hencky-none"), held=lambda X: np.ones(X.shape, bool), value=0.1)
    u = random_field(p)
    J, r = a.assemble(u), a.residual_array(u)
    assert np.array_equal(r, a.constraint_scale * (u - 0.1))
    assert largest(comm, product(J, u) - a.constraint_scale * u) < 1e-14


@pytest.mark.parametrize("dim", (2, 3))
@every_model
def test_tangent_is_derivative_of_residual(comm, row, dim):
    """Column by column, by central differences, strongly deformed, spacing 1 and E = 1; asked for: 1e-7."""
    p = body(dim, {2: (5, 4), 3: (3, 3, 2)}[dim])
    a = assembler(p, row, held=lambda X: X < 0.8, value=affine(strong_gradient(dim)))  # single components
    u = np.where(a.constrained, a.prescribed, deformed(p))
    J = rows_of(a.assemble(u))
    differences = np.empty_like(J)
    h = 1e-5
    n = p.count * p.dim
    mine = np.arange(n).reshape(-1, p.dim)[p.global_index[: p.owned]]
    for column in range(n):
        d = h * (mine == column)
        differences[:, column] = ((a.residual_array(u + d) - a.residual_array(u - d)) / (2 * h)).ravel()
    error, size = comm.allreduce(np.array([((J - differences) ** 2).sum(), (J**2).sum()]))
    assert np.sqrt(error / size) < 1e-8


@pytest.mark.parametrize("dim", (2, 3))
@every_model
@pytest.mark.parametrize("kind", (AssembledTangent, MatrixFreeTangent))
def test_snes_test_jacobian(comm, row, dim, kind, capfd):
    """The ratio that PETSc itself prints, for the matrix and for the action."""
    p = body(dim, {2: (5, 4), 3: (3, 3, 2)}[dim])
    a = assembler(p, row, held=lambda X: X < 0.8, value=affine(strong_gradient(dim)))
    snes = PETSc.SNES().create(PETSc.COMM_WORLD)
    snes.setOptionsPrefix("checked_")
    tangent = kind(a)
    snes.setFunction(a.residual, a.vector())
    snes.setJacobian(
        lambda _, x, J, P: tangent.update(x.getArray(readonly=True).reshape(-1, dim)), tangent.operator,
        tangent.preconditioner,
    )  # fmt: skip
    snes.setTolerances(max_it=1)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("none")
    x = a.vector()
    x.getArray()[...] = np.where(a.constrained, a.prescribed, deformed(p)).ravel()
    PETSc.Options()["checked_snes_test_jacobian"] = None
    snes.setFromOptions()
    try:
        snes.solve(None, x)
    finally:
        PETSc.Options().delValue("checked_snes_test_jacobian")
    CDLL(None).fflush(None)
    said = comm.bcast(capfd.readouterr().out)
    snes.destroy()
    tangent.destroy()
    ratio, *of_the_preconditioner = re.findall(r"\|\|J - Jfd\|\|_F/\|\|J\|\|_F = ([-+.\de]+)", said)
    assert float(ratio) < 1e-7
    assert len(of_the_preconditioner) == (kind is MatrixFreeTangent)


@pytest.mark.parametrize("dim", (1, 2, 3))
@every_model
def test_action_is_the_assembled_tangent(comm, row, dim):
    """With constraints, at a strong deformation; so are its diagonal blocks. The assembled tangent of a hyperelastic
    model comes from half of each family's matrix."""
    p = body(dim)
    a = assembler(p, row, held=held, value=affine(strong_gradient(dim)))
    u = np.where(a.constrained, a.prescribed, deformed(p))
    mat = a.assemble(u)
    v = random_field(p)
    Kv = product(mat, v)
    assert largest(comm, a.constrained_action(v) - Kv) < 1e-13 * largest(comm, Kv)
    diagonal = np.einsum("npp->np", a.diagonal())
    expected = mat.getDiagonal().getArray().reshape(-1, dim)
    assert largest(comm, diagonal - expected) < 1e-13 * largest(comm, expected)


@pytest.mark.parametrize("printed", (False, True))
@pytest.mark.parametrize("name", ("hencky-silling", "ordinary", "bond"))
def test_tangent_of_bonds_that_soften(comm, name, printed):
    """Assembled, as an action, and by central differences, with bonds before, in and beyond the range of softening."""
    p = body(2)
    a = assembler(p, model(name), held=held, value=affine(1.2 * strong_gradient(2) + 0.2 * np.eye(2)))
    for material in a.materials:
        n, bonds = len(material.families), material.families.bonds
        given = Softening(np.full(n, 0.1), np.full(n, 0.3), 3.0, True, np.zeros(bonds), np.ones(bonds, bool))
        material.soften(given, printed)
    u = 1.2 * deformed(p) + 0.2 * p.position[: p.owned]
    u, v = np.where(a.constrained, a.prescribed, u), random_field(p)
    mat = a.assemble(u)
    Kv = product(mat, v)
    assert largest(comm, a.constrained_action(v) - Kv) < 1e-13 * largest(comm, Kv)
    v[a.constrained] = 0.0
    h = 1e-6
    difference = (a.residual_array(u + h * v) - a.residual_array(u - h * v)) / (2 * h)
    assert largest(comm, a.constrained_action(v) - difference) < 1e-8 * largest(comm, difference)


@pytest.mark.parametrize("dim", (1, 2, 3))
@every_model
def test_action_of_small_bodies_in_engineering_units(comm, row, dim):
    """J v against central differences with a spacing of 5e-4 and E = 70e9; asked for: 1e-7."""
    p = distributed(5e-4 * jittered((7, 5, 4)[:dim], 0.1), 2.015 * 5e-4, spacing=5e-4)
    a = assembler(p, row, young=70e9, held=lambda X: X[:, :1] < 8e-4)
    u, v = 5e-6 * random_field(p), np.where(a.constrained, 0.0, random_field(p))
    a.linearise(np.where(a.constrained, a.prescribed, u))
    h = 1e-6 * 5e-4
    difference = (a.residual_array(u + h * v) - a.residual_array(u - h * v)) / (2 * h)
    assert largest(comm, a.constrained_action(v) - difference) < 1e-7 * largest(comm, difference)


@pytest.mark.parametrize("dim", (1, 2, 3))
def test_rigid_body_modes(comm, dim):
    """Of an unconstrained body: orthonormal, and its stiffness does not feel them."""
    p = body(dim)
    a = assembler(p, model("hencky-silling"))
    mat = a.assemble(np.zeros((p.owned, dim)))
    modes = mat.getNearNullSpace().getVecs()
    assert len(modes) == dim * (dim + 1) // 2
    inner = np.array([[v.dot(w) for v in modes] for w in modes])
    assert np.allclose(inner, np.eye(len(modes)), atol=1e-14)
    y = a.vector()
    for mode in modes:
        mat.mult(mode, y)
        assert y.norm() < 1e-13 * mat.norm()


def test_modes_vanish_where_entries_are_constrained(comm):
    p = body(2)
    a = assembler(p, model("hencky-silling"), held=held)
    for mode in a.matrix().getNearNullSpace().getVecs():
        assert not mode.getArray(readonly=True).reshape(-1, 2)[a.constrained].any()
        assert mode.norm() == pytest.approx(1)


def test_modes_of_a_body_that_cannot_turn(comm):
    """Where constraints leave fewer motions than rigid ones, no mode is zero or a copy."""
    p = distributed(lattice((6, 2)), 2.015)
    a = assembler(p, model("hencky-silling"), held=lambda X: np.stack([X[:, 0] > 0, X[:, 1] > 0], axis=1))
    assert len(a.rigid_body_modes.getVecs()) == 0
    assert not a.matrix().getNearNullSpace().handle
    a = assembler(p, model("hencky-silling"), held=lambda X: np.stack([X[:, 0] > -1, X[:, 0] > 1], axis=1))
    vectors = a.matrix().getNearNullSpace().getVecs()
    assert [v.norm() for v in vectors] == pytest.approx([1.0] * len(vectors))


def test_residual_is_pure(comm):
    """Line searches call it at trial points: what was asked before does not matter."""
    p = body(2)
    a = assembler(p, model("hencky-silling"), held=held, value=affine(strong_gradient(2)))
    u = deformed(p)
    r = a.residual_array(u)
    a.residual_array(random_field(p))
    a.assemble(0.3 * u)
    assert np.array_equal(a.residual_array(u), r)
    assert np.isfinite(r).all()
    assert not a.external_force(np.zeros((a.particles.owned, a.dim))).any()


@every_model
def test_forces_do_not_depend_on_the_ranks(comm, row):
    """Against the same model on one process, every particle there."""
    X = jittered((8, 7), 0.15)
    rng = np.random.default_rng(5)
    horizon, volume = rng.uniform(1.6, 3.1, len(X)), rng.uniform(0.5, 1.5, len(X))
    p = distributed(X, horizon, volume)
    u = deformation(X)
    alone = Sample(X, volume, horizon, np.ones(len(X)), np.empty(0))
    alone.weight = np.ones(alone.families().bonds)
    expected = force(alone.material(row), u)
    a = assembler(p, row)
    found = whole(comm, p, a.internal_force(u[p.id[: p.owned]]))
    assert np.abs(found - expected).max() < 1e-14 * np.abs(expected).max()
    own, size = u[p.id[: p.owned]], np.linalg.norm(expected)
    a.residual_array(own)
    assert a.at_rounding_floor(1e-16 * size, own) and not a.at_rounding_floor(1e-11 * size, own)


def test_nan_reaches_all_ranks(comm):
    """One inverted family: the norm is not a number on every rank, so that SNES gives up everywhere."""
    p = body(2)
    a = assembler(p, model("hencky-none"))
    center = whole(comm, p, p.position)[14]
    from_center = p.position[: p.owned] - center
    u = np.zeros((p.owned, 2))
    near = np.linalg.norm(from_center, axis=1) < 1.6
    u[near, 0] = -2 * from_center[near, 0]
    assert 0 < comm.allreduce(int(near.sum())) < p.count / 2
    x, r = a.vector(), a.vector()
    x.getArray()[...] = u.ravel()
    a.residual(None, x, r)
    assert np.isnan(r.norm())
