"""What finds the equilibrium of a load step: Newton's method, relaxation, or one where the other fails."""

from typing import Protocol

import numpy as np

from pdpetsc.assembly import Assembler
from pdpetsc.solvers.newton import Newton
from pdpetsc.solvers.record import SolveRecord, StepFailed
from pdpetsc.solvers.relaxation import Relaxation


class EquilibriumSolver(Protocol):
    """Finds equilibria."""

    @property
    def guess(self) -> np.ndarray | None:
        """(owned, dim) where a predictor came to in a step that failed, or None."""

    @property
    def record(self) -> SolveRecord:
        """Of the last step."""

    def advance(self, u: np.ndarray, time: float, near: bool, quick: bool) -> tuple[np.ndarray, SolveRecord]:
        """The equilibrium at `time` from that at owned displacements u, and how it was found; raises StepFailed.
        `near`: nothing but bonds has changed. `quick`: give up early, there is another way."""

    def forget(self) -> None:
        """Supports have changed."""

    def choices(self) -> dict[str, str]:
        """ "solver", "preconditioner" and "tangent" for summary.json."""


class HandOver:
    """Newton's method, and relaxation for the steps in which it fails; the next one is Newton's again."""

    def __init__(self, newton: Newton, relaxation: Relaxation):
        self._newton, self._relaxation = newton, relaxation

    @property
    def guess(self) -> np.ndarray | None:
        return self._newton.guess

    @property
    def record(self) -> SolveRecord:
        return self._newton.record

    def advance(
        self, u: np.ndarray, time: float, near: bool = False, quick: bool = False
    ) -> tuple[np.ndarray, SolveRecord]:
        """As of both."""
        try:
            return self._newton.advance(u, time, near, quick)
        except StepFailed:
            if quick:
                raise
            return self._relaxation.advance(u, time)

    def forget(self) -> None:
        """Of both."""
        self._newton.forget()

    def choices(self) -> dict[str, str]:
        """Newton's, and that there is relaxation."""
        choices = self._newton.choices()
        return choices | {"solver": f"{choices['solver']}, adaptive dynamic relaxation where it fails"}


def equilibrium_solver(solver, assembler: Assembler, blocks: float, damage: bool) -> EquilibriumSolver:
    """As a case's `[solver]` says.

    Args:
        solver: the table.
        assembler: of the body.
        blocks: about how many the assembled tangent has.
        damage: whether bonds may fail.
    """
    if solver.mode == "relaxation":
        return Relaxation(assembler)
    newton = Newton(assembler, blocks, solver.control == "load", damage)
    return HandOver(newton, Relaxation(assembler)) if solver.hand_over else newton
