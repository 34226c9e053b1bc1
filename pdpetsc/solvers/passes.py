"""A load step of a body whose bonds may fail: equilibrium, what fails, the same load again, until nothing does."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pdpetsc.assembly import Assembler
from pdpetsc.fracture import Fracture
from pdpetsc.solvers.newton import Newton, NewtonRecord, StepFailed
from pdpetsc.state import State


@dataclass
class StepRecord:
    """How one load step was solved.

    Attributes:
        passes: of Newton's method, one for each time that the load was solved.
        broken: directed bonds that have failed since the start, on all ranks.
        separated: whether the body has come apart.
        held: particles in splinters that nothing else holds, on all ranks.
        stored: recoverable energy.
    """

    passes: list[NewtonRecord] = field(default_factory=list)
    broken: int = 0
    separated: bool = False
    held: int = 0
    stored: float = 0.0


class Overshoot(StepFailed):
    """Bonds are further beyond their critical value than they may be at the end of a load increment."""


class Passes:
    """Solves load steps; where bonds fail, the same load again.

    Args:
        newton: solves one load.
        fracture: the bonds; None: they do not fail.
        overshoot: by how much the worst bond may pass its critical value before the increment is cut.
        passed: called with the record of the step so far after each pass in which bonds failed.
    """

    def __init__(
        self, newton: Newton, assembler: Assembler, fracture: Fracture | None, overshoot: float,
        passed: Callable[[StepRecord], None],
    ):  # fmt: skip
        self._newton, self._assembler, self._fracture, self._overshoot = newton, assembler, fracture, overshoot
        self._passed = passed
        self._worst = 0.0  # ratio at the last committed state

    def advance(self, state: State, time: float, last: bool) -> tuple[State, StepRecord]:
        """The next state, at `time`.

        Args:
            state: the last one; it stays as it is.
            last: whether the increment may not be cut further, so that an overshoot is accepted.

        Raises:
            StepFailed: there is no equilibrium, or an overshoot; what failed on the way is taken back.
        """
        fracture, record = self._fracture, StepRecord()
        if fracture is None:
            u, newton = self._newton.advance(state.u, time)
            record.passes.append(newton)
            return replace(state, u=u, time=time, step=state.step + 1), record
        try:
            return self._until_nothing_fails(state, time, last, record)
        except StepFailed:
            fracture.roll_back(state.u)
            raise

    def _until_nothing_fails(self, state: State, time: float, last: bool, record: StepRecord):
        fracture, new = self._fracture, replace(state, step=state.step + 1)
        while True:
            before = self._forces(new.u, first=not record.passes)
            u, newton = self._newton.advance(new.u, time, near=bool(record.passes))
            record.passes.append(newton)
            self._account(new, before, u)
            new.u, new.time = u, time
            ratio = fracture.ratios(u)
            worst = fracture.worst(ratio)
            if len(record.passes) == 1 and worst > 1 + self._overshoot and not last:
                share = (1 + self._overshoot / 2 - self._worst) / (worst - self._worst)
                raise Overshoot(f"a bond is at {worst:.3g} of its critical value", share)
            stored = self._assembler.stored_energy(u)
            if fracture.separated or not fracture.fail(u, ratio, new.step):
                break
            new.dissipated += stored - self._assembler.stored_energy(u)
            record.broken = fracture.count
            self._passed(record)
        self._worst = worst
        record.stored, record.separated, record.broken = stored, fracture.separated, fracture.count
        record.held = self._assembler.mpi.allreduce(int(fracture.held.sum()))
        return new, record

    def _forces(self, u: np.ndarray, first: bool) -> tuple[np.ndarray, np.ndarray]:
        """Internal forces, and external ones with reactions. Before the first pass they are in equilibrium."""
        a = self._assembler
        internal = a.internal_force(u)
        return internal, internal if first else np.where(a.constrained, internal, a.external_force(u))

    def _account(self, state: State, before: tuple[np.ndarray, np.ndarray], u: np.ndarray) -> None:
        """Add to a state the work on the way from its displacements to others, by the trapezoidal rule: what loads and
        supports do, and what is lost as the body goes from the state in which bonds failed to equilibrium."""
        a, (internal, external), du = self._assembler, before, u - state.u
        _, after = self._forces(u, first=False)
        work = ((external + after) * du).sum() / 2, ((external - internal) * du).sum() / 2
        done, lost = a.mpi.allreduce(np.array(work))
        state.external_work += float(done)
        state.dissipated += float(lost)
