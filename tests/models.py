"""The table of material models that drives every test of them, and the small bodies that the tests deform.

A new model is a row of `MODELS`: its name, how to build it, and what sets it apart from the others.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from conftest import EVERY

from pdpetsc.bonds import find_families
from pdpetsc.materials.base import Material, Neighbourhood
from pdpetsc.materials.bond_based import BondBased
from pdpetsc.materials.correspondence import Correspondence
from pdpetsc.materials.ordinary import ABD, LinearPeridynamicSolid, Ordinary
from pdpetsc.materials.stabilisation import Stabilisation

POISSON = 0.3


@dataclass(frozen=True)
class Model:
    """A row of the table.

    Attributes:
        name: shown in the names of the tests.
        build: material from neighbourhood and Young's modulus.
        objective: whether rigid rotations are free of forces, and forces turn with the body.
        angular: whether angular momentum is kept.
        hyperelastic: whether forces are the gradient of the energy, and the tangent symmetric.
        control: zero-energy control of a correspondence model, "" for other models.
        linear: whether kinematics are linear: forces are linear in u.
        inverts: whether it knows inverted families.
        lateral: whether the directions that a body does not have may be strained (plane stress).
        dims: dimensions in which it is defined.
        reach: horizons from a particle to the furthest one that changes the constants of the forces on it, or the
            forces themselves.
    """

    name: str
    build: Callable[[Neighbourhood, float], Material]
    objective: bool = True
    angular: bool = True
    hyperelastic: bool = True
    control: str = ""
    linear: bool = False
    inverts: bool = False
    lateral: bool = False
    dims: tuple[int, ...] = (1, 2, 3)
    reach: int = 2


def correspondence(elasticity: str, control: str, plane: str = "strain") -> Model:
    stabilisation = Stabilisation(control, 0.0 if control == "none" else 0.3)
    spring = control == "spring"  # seed 004 Eq. 3.41 sees rotations as strains
    return Model(
        f"{elasticity}-{control}" + ("-plane-stress" if plane == "stress" else ""),
        lambda part, young: Correspondence(part, elasticity, young, POISSON, stabilisation, plane),
        objective=not spring, angular=not spring, control=control, inverts=True, lateral=plane == "stress",
    )  # fmt: skip


def ordinary(name: str, model: type[Ordinary], poisson: float = POISSON, **switches) -> Model:
    linear = switches.get("kinematics") == "linear"
    turning = name == "abd"  # the cosine of a bond's rotation is in its forces
    return Model(
        name, lambda part, young: model(part, young, poisson, **switches),
        objective=not linear and not turning, angular=not linear, hyperelastic=not turning, linear=linear,
        lateral=switches.get("plane") == "stress", reach=2 + (switches.get("surface_correction") == "directional"),
    )  # fmt: skip


ELASTICITY = ("hencky", "saint_venant_kirchhoff", "neo_hookean")
MODELS = [
    *(correspondence(*row) for row in product(ELASTICITY, ("none", "spring", "silling"))),
    *(correspondence(elasticity, "silling", "stress") for elasticity in ELASTICITY),
    ordinary("bond", BondBased, 0.25),
    ordinary("bond-general", BondBased, 0.25, microelastic="general", quadrature="plain"),
    ordinary("bond-linear", BondBased, 0.25, kinematics="linear"),
    ordinary("bond-plane-stress", BondBased, 1 / 3, plane="stress"),
    ordinary("bond-directional", BondBased, 0.25, quadrature="plain", surface_correction="directional"),
    ordinary("ordinary", LinearPeridynamicSolid),
    ordinary("ordinary-plain-plane-stress", LinearPeridynamicSolid, plane="stress", quadrature="plain"),
    ordinary("ordinary-linear", LinearPeridynamicSolid, kinematics="linear"),
    ordinary("abd", ABD),
    ordinary("abd-objective", ABD, rotation_weighted=False, plane="stress"),
    ordinary("abd-linear", ABD, kinematics="linear"),
    ordinary("abd-directional", ABD, rotation_weighted=False, surface_correction="directional"),
    ordinary("abd-directional-linear", ABD, kinematics="linear", plane="stress", surface_correction="directional"),
]
NAMES = [model.name for model in MODELS]


ALWAYS = ("hencky-silling", "bond", "ordinary", "abd")
"""Models that are tested in all dimensions; of others, whose kernels take long to compile, each run takes one."""


@pytest.fixture(autouse=True)
def dimensions_of_the_model(request):
    """Skip a model in dimensions in which it is not defined, and without EVERY=1 in most; acts on the modules that
    import it."""
    given = getattr(request.node, "callspec", None)
    if given and "row" in given.params and "dim" in given.params:
        row, dim = given.params["row"], given.params["dim"]
        if dim not in row.dims:
            pytest.skip("the model is not defined in this dimension")
        if not EVERY and row.name not in ALWAYS and dim != row.dims[NAMES.index(row.name) % len(row.dims)]:
            pytest.skip("another dimension is enough; all run with EVERY=1")


def model(name: str) -> Model:
    return MODELS[NAMES.index(name)]


def lattice(counts, spacing: float = 1.0) -> np.ndarray:
    """Cell centers of a box, x fastest."""
    axes = [spacing * (np.arange(n) + 0.5) for n in counts]
    return np.stack([a.ravel(order="F") for a in np.meshgrid(*axes, indexing="ij")], axis=1)


@dataclass
class Sample:
    """A small body on one process, with particles where they fall, volumes and horizons of any size."""

    X: np.ndarray
    volume: np.ndarray
    horizon: np.ndarray
    spacing: np.ndarray
    weight: np.ndarray
    thickness: float = 1.0
    young: float = 1.0

    def families(self):
        return find_families(self.X, self.horizon, np.arange(len(self.X)), len(self.X))

    def neighbourhood(self, families=None, weight=None) -> Neighbourhood:
        families, weight = families or self.families(), self.weight if weight is None else weight
        return Neighbourhood(families, weight, self.X, self.volume, self.horizon, self.spacing, self.thickness)

    def material(self, row: Model) -> Material:
        return row.build(self.neighbourhood(), self.young)

    def scaled(self, length: float, stress: float) -> "Sample":
        """The same body in other units: numbers grow by `length` and `stress`."""
        dim = self.X.shape[1]
        return Sample(
            self.X * length, self.volume * length**3, self.horizon * length, self.spacing * length, self.weight,
            self.thickness * length ** (3 - dim), self.young * stress,
        )  # fmt: skip


COUNTS = {1: (7,), 2: (5, 4), 3: (4, 3, 3)}


def sample(dim: int, seed: int = 0) -> Sample:
    """A jittered lattice of spacing 1 with horizons from 1.6 to 2.4, E = 1."""
    rng = np.random.default_rng([seed, dim])
    X = lattice(COUNTS[dim]) + rng.uniform(-0.15, 0.15, (np.prod(COUNTS[dim]), dim))
    n = len(X)
    body = Sample(X, rng.uniform(0.5, 1.5, n), rng.uniform(1.6, 2.4, n), np.ones(n), np.empty(0))
    body.weight = rng.uniform(0.5, 1.5, body.families().bonds)
    return body


def strong_gradient(dim: int, seed: int = 0, strain: float = 0.25) -> np.ndarray:
    """A displacement gradient: turned by 40 degrees and stretched by up to a quarter."""
    rng = np.random.default_rng([seed, dim, 7])
    return rotation(dim, np.deg2rad(40)) @ (np.eye(dim) + strain * rng.uniform(-1, 1, (dim, dim))) - np.eye(dim)


def deformation(X: np.ndarray, seed: int = 0, ripple: float = 0.05) -> np.ndarray:
    """A strong displacement: `strong_gradient`, rippled at random; all F are valid."""
    rng = np.random.default_rng([seed, X.shape[1], 8])
    return X @ strong_gradient(X.shape[1], seed).T + ripple * rng.uniform(-1, 1, X.shape)


def rotation(dim: int, angle: float, seed: int = 0) -> np.ndarray:
    """A rotation; in 3D about an axis that lies anywhere."""
    if dim == 1:
        return np.eye(1)
    c, s = np.cos(angle), np.sin(angle)
    if dim == 2:
        return np.array([[c, -s], [s, c]])
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    W = np.cross(np.eye(3), axis)
    return np.eye(3) - s * W + (1 - c) * W @ W


def force(material: Material, u: np.ndarray) -> np.ndarray:
    result = np.zeros_like(u)
    material.add_force(u, result)
    return result


def action(material: Material, u: np.ndarray, du: np.ndarray) -> np.ndarray:
    result = np.zeros_like(u)
    material.linearise(u)
    material.add_action(du, result)
    return result


def tangent(material: Material, u: np.ndarray) -> np.ndarray:
    """The assembled tangent as a dense matrix."""
    n, dim = u.shape
    columns = np.tile(np.arange(n, dtype=np.int32), n)
    blocks = np.zeros((n * n, dim, dim))
    material.linearise(u)
    material.add_rows(np.arange(n + 1) * n, columns, blocks)
    return blocks.reshape(n, n, dim, dim).transpose(0, 2, 1, 3).reshape(n * dim, n * dim)
