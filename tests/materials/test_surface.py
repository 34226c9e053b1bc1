"""The surface correction by direction: energies of uniaxial strains, inside and at faces."""

from functools import cache

import numpy as np
import pytest
from models import Sample, lattice

from pdpetsc.bonds import find_families
from pdpetsc.influence import INFLUENCE, bond_weights
from pdpetsc.materials.base import Neighbourhood
from pdpetsc.materials.bond_based import BondBased, fixed_poisson
from pdpetsc.materials.elasticity import lame_constants
from pdpetsc.materials.ordinary import ABD

STRAIN = 1e-3
PLANES = [(1, "strain"), (2, "strain"), (2, "stress"), (3, "strain")]
MODELS = [
    (BondBased, {"quadrature": "plain"}),
    (BondBased, {"quadrature": "plain", "microelastic": "general"}),
    (ABD, {}),
]
every_model = pytest.mark.parametrize(("model", "switches"), MODELS, ids=("bond", "bond-general", "abd"))
every_plane = pytest.mark.parametrize(("dim", "plane"), PLANES)


@cache
def block(dim: int) -> Sample:
    """A lattice with a particle in its middle that sees no face, nor does any neighbour: two horizons away."""
    m, counts = {1: (3.015, (15,)), 2: (3.015, (15, 15)), 3: (2.015, (11, 11, 11))}[dim]
    X = lattice(counts)
    n = len(X)
    body = Sample(X, np.ones(n), np.full(n, m), np.ones(n), np.empty(0))
    body.weight = np.ones(body.families().bonds)
    return body


def energies(body, model, plane, correction, direction, **switches) -> np.ndarray:
    """Of each family in a strain along one axis, over that of the solid."""
    dim = body.X.shape[1]
    nu = (fixed_poisson(dim, plane) or 0.0) if model is BondBased else 0.3
    material = model(
        body.neighbourhood(), 1.0, nu, plane, kinematics="linear", surface_correction=correction, **switches
    )
    u = np.zeros_like(body.X)
    u[:, direction] = STRAIN * body.X[:, direction]
    lame, shear = lame_constants(1.0, nu, plane, dim)
    return material.energy(u) / (0.5 * (lame + 2 * shear) * STRAIN**2)


def at(body, place) -> int:
    (found,) = np.flatnonzero(np.linalg.norm(body.X - place, axis=1) < 1e-9)
    return found


@every_model
@every_plane
def test_inner_particles_have_the_energy_of_the_solid(model, switches, dim, plane):
    body = block(dim)
    middle = at(body, np.median(body.X, axis=0))
    for direction in range(dim):
        found = energies(body, model, plane, "directional", direction, **switches)
        assert found[middle] == pytest.approx(1, rel=1e-12)


@every_model
@every_plane
def test_particles_at_faces_are_better(model, switches, dim, plane):
    """In the middle of a face: strained along itself nearly right, along its normal better only, since the bonds in
    that direction take the mean with particles inside, whose factors are smaller (0.67 to 0.81 of what should be)."""
    body = block(dim)
    place = np.median(body.X, axis=0)
    place[0] = body.X[:, 0].min()
    face = at(body, place)
    for direction in range(dim):
        plain = energies(body, model, plane, "none", direction, **switches)[face]
        found = energies(body, model, plane, "directional", direction, **switches)[face]
        assert abs(found - 1) < (0.05 if direction else 0.9 * abs(plain - 1))


def test_a_direction_without_bonds():
    """One row of particles in a plane: nothing is there to be corrected across, and all stays finite."""
    X = lattice((9, 1))
    body = Sample(X, np.ones(9), np.full(9, 3.015), np.ones(9), np.empty(0))
    body.weight = np.ones(body.families().bonds)
    material = ABD(body.neighbourhood(), 1.0, 0.3, surface_correction="directional")
    along = np.zeros_like(X)
    along[:, 0] = 1e-6 * X[:, 0]
    assert np.isfinite(material.energy(along)).all() and (material.energy(along) > 0).all()


def test_neighbours_of_another_material_take_no_part():
    """Half of a body's families: at the interface a bond has the factors of its own end."""
    X = lattice((12, 9))
    n = len(X)
    horizon = np.full(n, 3.015)
    families = find_families(X, horizon, np.arange(n), n)
    half = families.subset(np.flatnonzero(X[:, 0] < 6))
    weight = bond_weights(half, X, horizon, np.ones(n), INFLUENCE["constant"], "none")
    part = Neighbourhood(half, weight, X, np.ones(n), horizon, np.ones(n))
    material = BondBased(part, 1.0, 0.25, quadrature="plain", kinematics="linear", surface_correction="directional")
    u = np.zeros_like(X)
    u[:, 0] = STRAIN * X[:, 0]
    (place,) = np.flatnonzero(np.all(X[half.center] == [5.5, 4.5], axis=1))
    lame, shear = lame_constants(1.0, 0.25, "strain", 2)
    assert material.energy(u)[place] == pytest.approx(0.5 * (lame + 2 * shear) * STRAIN**2, rel=0.1)
