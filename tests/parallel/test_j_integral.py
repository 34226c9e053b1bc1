"""The J-integral of displacements in closed form: Williams' field around the tip of a crack."""

import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

YOUNG, POISSON = 2.0, 0.3
KAPPA, SHEAR = 3 - 4 * POISSON, YOUNG / (2 * (1 + POISSON))  # plane strain
TIP = np.array([10.0, 10.0])


def cracked(dim: int, angle: float = 0.0, radii=(5.0, 8.0), **probe) -> dict:
    """A square of cells of width 1, or a plate of three layers of them, with a crack from outside to its middle."""
    along = np.array([np.cos(angle), np.sin(angle)])
    start, tip, up = TIP - 20 * along, TIP, [0.0, 0.0, 9.0][:dim]
    crack = {"from": start.tolist(), "to": tip.tolist()}
    if dim == 3:
        corners = [[*point, z] for point, z in ((start, -3.0), (tip, -3.0), (tip, 9.0), (start, 9.0))]
        crack = {"polygon": [[float(x) for x in corner] for corner in corners]}
        probe = {"front": up} | probe
    size = [20.0, 20.0, 3.0][:dim]
    around = {"tip": [*TIP.tolist(), 1.0][:dim], "direction": [*along.tolist(), 0.0][:dim], "radii": list(radii)}
    return {
        "body": {"size": size, "spacing": 1.0, "horizon": 2.015, "cracks": [crack]},
        "sets": {"edge": "X < 1"},
        "material": {"m": {"model": "ordinary", "E": YOUNG, "nu": POISSON}},
        "load": [{"kind": "displacement", "set": "edge", "component": "all", "value": 0.0}],
        "probe": [{"name": "J", "field": "J"} | around | probe],
    }


def built(document: dict, comm=PETSc.COMM_WORLD) -> Simulation:
    return Simulation(Case.from_document(document, "crack", None, "crack.toml", False), comm)


def williams(X: np.ndarray, angle: float, opening: float, sliding: float) -> np.ndarray:
    """Displacements of the square root singularity with K_I, K_II (Tada, Paris and Irwin, part I)."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    x, y = turn @ (X[:, :2] - TIP).T
    r, half = np.hypot(x, y), np.arctan2(y, x) / 2
    c, s = np.cos(half), np.sin(half)
    first = np.array([c * (KAPPA - 1 + 2 * s**2), s * (KAPPA + 1 - 2 * c**2)])
    second = np.array([s * (KAPPA + 1 + 2 * c**2), -c * (KAPPA - 1 - 2 * s**2)])
    u = np.zeros_like(X)
    u[:, :2] = (np.sqrt(r / (2 * np.pi)) / (2 * SHEAR) * (opening * first + sliding * second)).T @ turn
    return u


def value(simulation: Simulation, u: np.ndarray) -> float:
    simulation.state.u = u
    simulation.__dict__.pop("recovery", None)
    return simulation.probes[0].read(simulation.recovery, 1.0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 0.5])
@pytest.mark.parametrize(("opening", "sliding"), [(1e-4, 0.0), (0.0, 1e-4), (1e-4, -2e-4)])
def test_of_a_known_field(comm, dim, angle, opening, sliding):
    """J = (1 - nu^2)/E (K_I^2 + K_II^2) per length of the front, the same on one rank and several, and of the body
    turned round."""
    document = cracked(dim, angle)
    many, alone = built(document), built(document, PETSc.COMM_SELF)
    found = []
    for simulation in (many, alone):
        X = simulation.particles.position[: simulation.particles.owned]
        u = williams(X, angle, opening, sliding)
        found.append(value(simulation, u))
    expected = (1 - POISSON**2) / YOUNG * (opening**2 + sliding**2)
    assert found[0] == pytest.approx(found[1], rel=1e-10)
    assert found[0] == pytest.approx(expected, rel=0.02)
    Q = np.eye(dim)
    Q[:2, :2] = [[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]]
    assert value(alone, (X + u) @ Q.T - X) == pytest.approx(found[0], rel=1e-6)


def test_sound_body_has_none():
    """Uniform strain, finite: W and P are constants, which the ring does not see."""
    document = cracked(2)
    del document["body"]["cracks"]
    simulation = built(document)
    X = simulation.particles.position[: simulation.particles.owned]
    found = value(simulation, X @ np.array([[0.1, 0.05], [0.0, -0.2]]))
    assert abs(found) < 1e-3 * YOUNG * 0.2**2 * 8.0


@pytest.mark.parametrize(
    "material",
    [{"model": "correspondence", "elasticity": "neo_hookean"}, {"model": "ordinary"}, {"kinematics": "linear"}],
)
def test_first_piola_is_the_slope_of_the_energy(material):
    """P = dW/dF of a uniform strain, large for linear kinematics too."""
    document = cracked(2)
    document["material"]["m"] |= material
    simulation = built(document)
    X = simulation.particles.position[: simulation.particles.owned]
    F, h = np.array([[1.1, 0.3], [-0.2, 0.8]]), 1e-6

    def at(F):
        simulation.state.u = X @ (F - np.eye(2)).T
        simulation.__dict__.pop("recovery", None)
        return simulation.recovery

    P = at(F).first_piola
    for i, k in np.ndindex(2, 2):
        step = h * np.outer(np.eye(2)[i], np.eye(2)[k])
        slope = (at(F + step).energy_density - at(F - step).energy_density) / (2 * h)
        assert P[:, i, k] == pytest.approx(slope, abs=1e-7)


@pytest.mark.parametrize("radii", [(5.0, 11.0), (12.0, 20.0)])
def test_the_ring_must_be_in_the_body(radii):
    with pytest.raises(InputError, match=r"crack.toml: probe: the ring of the J-integral 'J', .* is not in the body"):
        built(cracked(2, radii=radii))


def test_a_ring_too_near_to_the_tip_is_warned_of(comm, capfd):
    built(cracked(2, radii=(2.5, 8.0)))
    said = comm.bcast(capfd.readouterr().err)
    assert "the ring of the J-integral 'J' begins 2.5 from the tip, too near" in said
    built(cracked(2))
    assert comm.bcast(capfd.readouterr().err) == ""
