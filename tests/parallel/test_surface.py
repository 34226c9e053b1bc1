"""The surface correction by direction on several ranks: factors of ghosts, ranks without a material, errors on some."""

import numpy as np
import pytest
from bodies import assembler, distributed, jittered, whole
from models import Sample, model
from petsc4py import PETSc

from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.simulation import Simulation
from pdpetsc.summary import summary_of

pytestmark = [pytest.mark.mpi, pytest.mark.usefixtures("petsc_options")]


@pytest.mark.parametrize("name", ("bond-directional", "abd-directional", "abd-directional-linear"))
@pytest.mark.parametrize("dim", (2, 3))
def test_energies_are_those_of_one_process(comm, dim, name):
    """Of every family, in a body with horizons of several sizes."""
    X = jittered((12, 7, 4)[:dim], 0.15)
    horizon = 1.6 + 0.1 * (np.arange(len(X)) % 7)
    p = distributed(X, horizon)
    (material,) = assembler(p, model(name)).materials
    u = 1e-2 * np.sin(X)
    energy = np.zeros(p.owned)
    energy[material.families.center] = material.energy(1e-2 * np.sin(p.position))
    found = whole(comm, p, energy)
    body = Sample(X, np.ones(len(X)), horizon, np.ones(len(X)), np.empty(0))
    body.weight = np.ones(body.families().bonds)
    expected = body.material(model(name)).energy(u)
    assert np.abs(found - expected).max() < 1e-13 * expected.max()


def strip(**changes):
    material = {"model": "bond", "E": 1.0, "quadrature": "plain", "surface_correction": "directional"}
    document = {
        "body": {"size": [12.0, 1.0], "spacing": 1.0, "horizon": 2.015},
        "sets": {"tip": {"where": "X < 2"}, "rest": {"where": "X >= 2"}},
        "material": {"a": material | {"where": "tip"}, "b": material | {"model": "abd", "nu": 0.3, "where": "rest"}},
        "load": [{"kind": "displacement", "set": "all", "component": "all", "value": "1e-3 * X"}],
    }
    del document["material"]["b"]["quadrature"]
    document["body"] |= changes.pop("body", {})
    return Case.from_document(document | changes, "my", None, "my.toml", False)


def test_a_material_that_some_ranks_do_not_have(comm):
    simulation = Simulation(strip(), PETSc.COMM_WORLD)
    counts = comm.allgather([len(material.families) for material in simulation.materials])
    assert np.sum(counts, axis=0).tolist() == [2, 10]
    assert comm.size == 1 or [0] in [count[:1] for count in counts]
    total = sum(
        material.energy(simulation.assembler.localise(simulation.state.u)).sum() for material in simulation.materials
    )
    assert comm.allreduce(total) == 0
    assert summary_of(simulation, "converged")["choices"]["materials"]["b"]["surface_correction"] == "directional"
    simulation.solver.destroy()


def test_an_error_that_only_one_rank_meets(comm):
    """The particle behind the gap has no neighbour with a weight; ranks without it do not wait for its factors."""
    material = {"model": "bond", "E": 1.0, "quadrature": "plain", "surface_correction": "directional"}
    case = strip(body={"keep": "abs(X - 10.5) > 0.1"}, material={"a": material | {"influence": "where(r < 0.6, 1, 0)"}})
    with pytest.raises(InputError, match=r"my.toml: material.a: influence: is zero at all neighbours of the particle"):
        Simulation(case, PETSc.COMM_WORLD)
