"""The Python API: cases are built and solved from scripts and notebooks. Importing it starts PETSc."""

import gc

from mpi4py import MPI

from pdpetsc import options, parallel
from pdpetsc.case import Case

options.start_once()

from petsc4py import PETSc  # noqa: E402

from pdpetsc import driver  # noqa: E402
from pdpetsc.observers import Observer  # noqa: E402, F401
from pdpetsc.run import Run  # noqa: E402


def build(case: Case) -> Run:
    """Build a case without solving it: `run.solve()` does that, and `run.observers` may be given before (collective).

    Raises:
        InputError: on all ranks alike.
    """
    _prepare(case)
    return driver.build(case)


def solve(case: Case, out=None, observers=(), quiet: bool = True) -> Run:
    """Build and solve a case (collective).

    Args:
        case: what `load` gives.
        out: directory of the result files, replaced if it holds an earlier result; None: none are written.
        observers: objects that are told of each step (`Observer`), in this order.
        quiet: print warnings only; else what the command line prints.

    Raises:
        ConvergenceError, InputError: on all ranks alike.
    """
    _prepare(case)
    return driver.solve(case, out, observers, quiet)


def _prepare(case: Case) -> None:
    """What the command line does once: options of the case, and ranks that end together."""
    if MPI.COMM_WORLD.size > 1:
        parallel.abort_on_exception()
    gc.collect()  # an earlier run that nobody holds any more
    PETSc.garbage_cleanup()
    options.set_case(case.petsc)
