"""Errors on one rank: an InputError becomes one on all, any other exception ends the job."""

import os
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import assembler, distributed, families_of
from models import lattice, model

from pdpetsc.body.sets import Sets
from pdpetsc.bonds import check_not_lonely
from pdpetsc.errors import InputError
from pdpetsc.expressions import Expression
from pdpetsc.materials.base import Neighbourhood
from pdpetsc.parallel import collective

EACH = 60  # seconds that an ending job may take here; a hang would take the whole test's limit


@pytest.mark.mpi
def test_an_input_error_on_one_rank_is_raised_on_all(comm):
    for culprit in range(comm.size):
        with pytest.raises(InputError, match=f"from rank {culprit}"), collective(comm):
            if comm.rank == culprit:
                raise InputError(f"from rank {culprit}")


@pytest.mark.mpi
def test_the_lowest_rank_is_heard(comm):
    with pytest.raises(InputError, match="from rank 0"), collective(comm):
        raise InputError(f"from rank {comm.rank}")


@pytest.mark.mpi
def test_nothing_happens_without_an_error(comm):
    with collective(comm):
        pass


@pytest.mark.mpi
def test_another_exception_is_no_input_error(comm):
    """It is not turned into one; alike on all ranks here, since elsewhere it ends the job."""
    with pytest.raises(ZeroDivisionError), collective(comm):
        raise ZeroDivisionError


@pytest.mark.mpi
def test_a_lonely_particle(comm):
    p = distributed(np.vstack([lattice((12, 4)), [[40.0, 1.0]]]), 1.5)
    with pytest.raises(InputError, match=r"\(40, 1\) has no neighbour"), collective(comm):
        check_not_lonely(families_of(p), p.position, p.horizon)


@pytest.mark.mpi
def test_a_flat_family(comm):
    """A tail of one row at the end of a plate, on one rank."""
    tail = np.stack([12.5 + np.arange(6), np.full(6, 0.5)], axis=1)
    p = distributed(np.vstack([lattice((12, 4)), tail]), 1.5)
    with pytest.raises(InputError, match="does not span 2 dimensions"), collective(comm):
        families = families_of(p)
        part = Neighbourhood(families, np.ones(families.bonds), p.position, p.volume, p.horizon, p.spacing)
        model("hencky-none").build(part, 1.0)


@pytest.mark.mpi
def test_a_load_that_is_no_number_somewhere(comm):
    p = distributed(lattice((12, 4)), 1.5)
    with pytest.raises(InputError, match=r"'sqrt\(10 - X\)' is nan at X = 10\.5"):
        assembler(p, model("hencky-silling"), held=lambda X: X[:, 1] > 3, value="sqrt(10 - X)")


@pytest.mark.mpi
def test_sets(comm):
    p = distributed(lattice((12, 4)), 1.5)
    names = ["X", "Y", "spacing"]
    specs = {name: SimpleNamespace(where=Expression(text, names), nearest=None, group=None) for name, text in (
        ("left", "X < 2"), ("none", "X < 0"))}  # fmt: skip
    for name, point in (("tip", (12.0, 2.0)), ("first", (-5.0, -5.0)), ("middle", (6.0, 2.0))):
        specs[name] = SimpleNamespace(where=None, nearest=point, group=None)
    sets = Sets.of(p, specs)
    assert comm.allreduce(int(sets["left"].sum())) == 8
    assert comm.allreduce(int(sets["all"].sum())) == 48
    with pytest.raises(InputError, match=r"sets\.none: no particle lies in this set"):
        sets["none"]

    def members(name):
        return np.concatenate(comm.allgather(p.id[: p.owned][sets[name]])).tolist()

    assert members("first") == [0]
    assert members("tip") == [23], "of two equally near particles the one of the lower id"
    assert members("middle") == [17], "of four"


# Whole jobs


def job(ranks: int, script: str) -> tuple[subprocess.CompletedProcess, float]:
    import conftest

    start = time.monotonic()
    run = subprocess.run(
        [conftest.mpirun(), "-n", str(ranks), sys.executable, "-c", script],
        env=conftest.environment_for_mpirun() | {"PETSC_OPTIONS": ""},
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=EACH,
    )  # fmt: skip
    return run, time.monotonic() - start


BEGIN = """
import sys
from pdpetsc import cli, options
options.start([], {})
"""


@pytest.mark.skipif("OMPI_COMM_WORLD_SIZE" in os.environ, reason="starts mpirun itself")
@pytest.mark.parametrize("culprit", (0, 1))
def test_an_exception_on_one_rank_ends_all_ranks(culprit):
    """Inside `cli.main`, while the others wait in a collective for ever."""
    script = (
        BEGIN
        + f"""
from pdpetsc import case
from mpi4py import MPI
def load(*arguments):
    if MPI.COMM_WORLD.rank == {culprit}:
        raise RuntimeError("a slip of ours")
    MPI.COMM_WORLD.Barrier()
case.load = load
sys.exit(cli.main(["clamped_beam"]))
"""
    )
    run, seconds = job(2, script)
    assert run.returncode == 1
    assert run.stderr.count("RuntimeError: a slip of ours") == 1
    assert seconds < 30  # about one, on a machine that has nothing else to do


@pytest.mark.skipif("OMPI_COMM_WORLD_SIZE" in os.environ, reason="starts mpirun itself")
def test_an_exception_in_a_callback_of_petsc_ends_all_ranks():
    """Errors inside SNES callbacks come through PETSc's C code."""
    script = (
        BEGIN
        + """
from mpi4py import MPI
from pdpetsc.assembly import Assembler
def residual(self, *arguments):
    if MPI.COMM_WORLD.rank == 1:
        raise RuntimeError("a slip of ours")
    return original(self, *arguments)
original, Assembler.residual = Assembler.residual, residual
import tempfile
out = MPI.COMM_WORLD.bcast(tempfile.mkdtemp())
sys.exit(cli.main(["clamped_beam", "--out", out]))
"""
    )
    run, seconds = job(2, script)
    assert run.returncode not in (0, 2, 3, 4)
    assert "RuntimeError: a slip of ours" in run.stderr
    assert seconds < 30
