"""The peridynamic stress and the resultants of sections: both carry exactly what is applied, whatever the model."""

from types import SimpleNamespace

import numpy as np
import pytest
from bodies import assembler, distributed, jittered, refined, site, whole
from models import MODELS, NAMES, Sample, deformation, dimensions_of_the_model, lattice, model, strong_gradient  # noqa: F401

from pdpetsc.expressions import Expression
from pdpetsc.loads.force import Force
from pdpetsc.materials import families as kernels
from pdpetsc.recover import Recovery
from pdpetsc.sections import Section
from pdpetsc.solvers.newton import Newton

pytestmark = pytest.mark.mpi

every_model = pytest.mark.parametrize("row", MODELS, ids=NAMES)
every_dimension = pytest.mark.parametrize("dim", (1, 2, 3))

SPACING = 0.5
BAR = {1: (14,), 2: (10, 4), 3: (7, 3, 3)}
FACTOR = {1: 3.015, 2: 2.015, 3: 1.515}
SIZE, INTERFACE = {1: [9.0], 2: [7.0, 3.0], 3: [4.0, 3.0, 2.0]}, {1: 5.0, 2: 4.0, 3: 2.0}
PULL = {1: (0.02,), 2: (0.01, 0.002), 3: (0.02, -0.003, 0.002)}


@pytest.fixture(autouse=True)
def tight(petsc_options):
    petsc_options(snes_rtol=1e-13)


def two_zones(dim: int):
    """A box of cells of width 1, two along each edge beyond INTERFACE, with horizons by the local spacing."""
    return refined(SIZE[dim], f"where(X > {INTERFACE[dim]}, 2, 1)", FACTOR[dim])


def pulled(p, rows, left: float, right: float):
    """Recovery of a bar that is held where X < left and pulled where X > right."""
    X = p.position[: p.owned]
    loads = [
        Force(site(p, X[:, 0] > right, value), SimpleNamespace(component=(axis,)))
        for axis, value in enumerate(PULL[p.dim])
    ]
    a = assembler(p, *rows, held=lambda X: X[:, 0] < left, loads=loads)
    u, _ = Newton(a, 0.0).advance(np.zeros((p.owned, p.dim)), 1.0)
    return Recovery(a, u)


def section(p, at, normal, where=None) -> Section:
    normal = np.array(normal, float) / np.linalg.norm(normal)
    condition = where and Expression(where, [*"XYZ"[: p.dim], "spacing"])
    return Section("a", SimpleNamespace(at=at, normal=tuple(normal), where=condition), p)


def moment(comm, p, r, force, at, linear):
    """Of forces (owned, dim) about a point, in the deformed state or that of the reference."""
    arm, f = np.zeros((2, p.owned, 3))
    arm[:, : p.dim], f[:, : p.dim] = p.position[: p.owned] + (0.0 if linear else r.u) - at, force
    total = comm.allreduce(np.cross(arm, f).sum(axis=0))
    return total[2] if p.dim == 2 else total


def check_sections(comm, p, r, planes, rows):
    """Force and moment of sections against the loads beyond them."""
    size = np.linalg.norm(PULL[p.dim])
    for at, normal in planes:
        s = section(p, at, normal)
        beyond = (p.position[: p.owned] - at) @ np.array(normal) > 0
        load = np.where(beyond[:, None], r.external + r.reaction, 0.0)
        assert s.force(r) == pytest.approx(comm.allreduce(load.sum(axis=0)), abs=1e-9 * size)
        back = section(p, at, -np.array(normal))
        assert back.force(r) == pytest.approx(-s.force(r), abs=1e-12 * size)
        linear = all(row.linear for row in rows)
        if p.dim > 1 and (linear or all(row.angular for row in rows)):
            expected = moment(comm, p, r, load, at, linear)
            assert s.moment(r) == pytest.approx(expected, abs=1e-9 * size * SIZE[p.dim][0])
            assert back.moment(r) == pytest.approx(-expected, abs=1e-9 * size * SIZE[p.dim][0])


@every_dimension
@every_model
def test_a_bar_carries_what_it_is_pulled_by(comm, row, dim):
    """Every slab of cells and every section between the support and the loaded end."""
    counts = BAR[dim]
    p = distributed(lattice(counts, SPACING), FACTOR[dim] * SPACING, spacing=SPACING)
    length = counts[0] * SPACING
    left, right = 2 * SPACING, length - SPACING
    r = pulled(p, [row], left, right)
    sigma = whole(comm, p, r.peridynamic_stress * p.volume[: p.owned, None, None])
    X = whole(comm, p, p.position)
    slab = np.rint(X[:, 0] / SPACING - 0.5).astype(int)
    forces = np.array([sigma[slab == n, :dim, 0].sum(axis=0) for n in range(counts[0])]) / SPACING
    reach = int(FACTOR[dim])  # in the slabs of the supports, reactions act on the middles of the cells
    inside = forces[2 : counts[0] - 1]
    assert len(inside) > reach
    assert inside == pytest.approx(np.tile(PULL[dim], (len(inside), 1)), abs=1e-9 * np.linalg.norm(PULL[dim]))
    middle = np.full(dim, 0.3)
    planes = [([x, *middle[1:]], np.eye(dim)[0]) for x in (left, left + 0.3, length / 2)]
    if dim > 1:
        planes.append(([0.45 * length, *middle[1:]], [2.0, 1.0, 0.5][:dim]))
    check_sections(comm, p, r, planes, [row])


@every_dimension
def test_two_models_in_a_body(comm, dim):
    """Dealt out to the particles at random."""
    rows = [model("hencky-silling"), model("ordinary"), model("bond")]
    p = distributed(jittered(BAR[dim], 0.15, SPACING), 1.1 * FACTOR[dim] * SPACING, spacing=SPACING)
    length = BAR[dim][0] * SPACING
    r = pulled(p, rows, 2 * SPACING, length - SPACING)
    planes = [([x, *np.zeros(dim - 1)], np.eye(dim)[0]) for x in (1.5, 0.5 * length)]
    check_sections(comm, p, r, planes, rows)


@pytest.mark.parametrize("name", ["hencky-silling", "neo_hookean-silling", "ordinary", "bond", "abd-objective"])
@every_dimension
def test_sections_of_two_zones(comm, name, dim):
    """On and beside the border, where coarse particles see fine ones that do not see them."""
    p = two_zones(dim)
    r = pulled(p, [model(name)], 2.0, SIZE[dim][0] - 0.5)
    planes = [([x, *np.zeros(dim - 1)], np.eye(dim)[0]) for x in (INTERFACE[dim], INTERFACE[dim] - 0.6, 2.0)]
    check_sections(comm, p, r, planes, [model(name)])


@every_dimension
@every_model
def test_the_whole_virial_is_shared_out(comm, row, dim):
    """sum V_k sigma_k = sum T (x) xi V_i V_j, of a strong deformation; the same field on any number of ranks."""
    p = two_zones(dim)
    X, volume, horizon, spacing = (whole(comm, p, f) for f in (p.position, p.volume, p.horizon, p.spacing))
    u = deformation(X)
    a = assembler(p, row)
    r = Recovery(a, u[p.id[: p.owned]])
    sigma = whole(comm, p, r.peridynamic_stress)[:, :dim, :dim]
    alone = Sample(X, volume, horizon, spacing, np.empty(0))
    alone.weight = np.ones(alone.families().bonds)
    m = alone.material(row)
    stress, virial = np.zeros((2, len(X), dim, dim))
    kernels.stress_moments(m._D, m._data, X, *m._bonds, u, False, stress)
    m.add_virial(u, virial)
    assert np.abs(np.einsum("n,npq->pq", volume, sigma - stress)).max() < 1e-13 * np.abs(stress).max() * volume.sum()
    assert np.abs(sigma - virial / volume[:, None, None]).max() < 1e-13 * np.abs(sigma).max()


@every_dimension
@pytest.mark.parametrize("row", [row for row in MODELS if row.control != "spring"], ids=lambda row: row.name)
def test_uniform_strain(comm, row, dim):
    """Further from the surface than its reach it is the first Piola-Kirchhoff stress J sigma F^-T of the family."""
    factor, counts = {1: (3.015, (21,)), 2: (2.015, (14, 13)), 3: (1.515, (7, 8, 7))}[dim]
    p = distributed(lattice(counts, SPACING), factor * SPACING, spacing=SPACING)
    gradient = 1e-6 * np.ones((dim, dim)) if row.linear else strong_gradient(dim)
    r = Recovery(assembler(p, row), p.position[: p.owned] @ gradient.T)
    F = r.deformation_gradient
    expected = r.stress
    if not row.linear:
        expected = np.linalg.det(F)[:, None, None] * r.stress @ np.linalg.inv(F).transpose(0, 2, 1)
    edge = np.minimum(p.position[: p.owned], np.array(counts) * SPACING - p.position[: p.owned]).min(axis=1)
    inside = edge > row.reach * int(factor) * SPACING
    assert comm.allreduce(int(inside.sum()))
    difference = (r.peridynamic_stress - expected)[inside, :dim, :dim]
    largest = max(comm.allgather(float(np.abs(expected[inside]).max(initial=0.0))))
    assert max(comm.allgather(float(np.abs(difference).max(initial=0.0)))) < 1e-12 * largest


@pytest.mark.parametrize("name", ["hencky-silling", "ordinary", "bond"])
@every_dimension
def test_the_direction_that_the_body_does_not_have(comm, name, dim):
    """As the family stress has it at small strains in plane strain, nothing in plane stress."""
    plane = {"hencky-silling": "hencky-silling-plane-stress", "ordinary": "ordinary-plain-plane-stress"}
    for row in [model(name), model(plane.get(name, "bond-plane-stress"))]:
        p = distributed(lattice({1: (15,), 2: (11, 10), 3: (5, 5, 5)}[dim]), {3: 1.515}.get(dim, 2.015))
        r = Recovery(assembler(p, row), 1e-7 * p.position[: p.owned])
        X, stress, other = (whole(comm, p, f) for f in (p.position, r.stress, r.peridynamic_stress))
        k = int(np.linalg.norm(X - X.mean(axis=0), axis=1).argmin())
        assert other[k] == pytest.approx(stress[k], abs=1e-6 * np.abs(stress[k]).max())
        if dim < 3:
            assert (other[k, 2, 2] == 0) == row.lateral


def test_part_of_a_section(comm):
    """The parts sum to the whole; of a bar in uniform strain the edges are alike."""
    p = distributed(lattice((10, 6), SPACING), 2.015 * SPACING, spacing=SPACING)
    r = Recovery(assembler(p, model("bond")), 1e-4 * p.position[: p.owned])
    at, x = [2.5, 1.0], [1, 0]
    parts = [section(p, at, x, where) for where in ("Y < 0.9", "Y > 0.9 and Y < 2.1", "Y > 2.1 and spacing > 0.4")]
    forces = [s.force(r) for s in parts]
    total = section(p, at, x).force(r)
    assert sum(forces) == pytest.approx(total, rel=1e-12, abs=1e-12 * total[0])
    assert sum(s.moment(r) for s in parts) == pytest.approx(section(p, at, x).moment(r), rel=1e-12)
    assert forces[0][0] == pytest.approx(forces[2][0], rel=1e-9)
    assert 0.25 * total[0] < forces[0][0] < total[0] / 3


@every_dimension
def test_invariants(comm, dim):
    """Digits of small dilatations, and principal values of a turned state."""
    p = distributed(lattice(BAR[dim]), FACTOR[dim])
    gradient = 1e-12 * np.random.default_rng(dim).uniform(-1, 1, (dim, dim))
    r = Recovery(assembler(p, model("hencky-silling")), p.position[: p.owned] @ gradient.T)
    assert r.field("dilatation") == pytest.approx(np.full(p.owned, np.trace(gradient)), rel=1e-9)
    gradient = strong_gradient(dim)
    r = Recovery(assembler(p, model("hencky-silling")), p.position[: p.owned] @ gradient.T)
    J = np.linalg.det(np.eye(dim) + gradient)
    assert r.field("dilatation") == pytest.approx(np.full(p.owned, J - 1), rel=1e-12)
    s = r.field("principal")
    assert np.all(np.diff(s, axis=1) <= 0)
    assert s.sum(axis=1) == pytest.approx(np.trace(r.stress, axis1=1, axis2=2), rel=1e-12)
    mises = np.sqrt(((s[:, 0] - s[:, 1]) ** 2 + (s[:, 1] - s[:, 2]) ** 2 + (s[:, 2] - s[:, 0]) ** 2) / 2)
    assert r.field("von_mises") == pytest.approx(mises, rel=1e-12)
