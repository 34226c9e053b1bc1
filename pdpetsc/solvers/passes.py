"""A load step of a body whose bonds may fail: equilibrium, what fails, the same load again, until nothing does."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pdpetsc.assembly import Assembler
from pdpetsc.errors import InputError, Interrupted
from pdpetsc.fracture import STRIDE, Fracture
from pdpetsc.solvers.equilibrium import EquilibriumSolver
from pdpetsc.solvers.record import SolveRecord, StepFailed
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
        arc_length: of a step along a path [length].
        abandoned: Newton iterations of attempts that came to nothing, on the way to it.
    """

    passes: list[SolveRecord] = field(default_factory=list)
    broken: int = 0
    separated: bool = False
    held: int = 0
    stored: float = 0.0
    arc_length: float = 0.0
    abandoned: int = 0


LEAP = 0.1
"""Growth of a stretch, in critical ones, beyond which Newton's method has leapt with softening that follows: the bonds
between may have been past any number of barriers."""

Equilibrium = Callable[[State, bool, bool], tuple[np.ndarray, float, SolveRecord]]
"""Gives displacements, time and record from the state so far, whether that is near because nothing but bonds has
changed, and whether to give up early."""


class Overshoot(StepFailed):
    """Bonds are further beyond their critical value than they may be at the end of a load increment."""


class Passes:
    """Solves steps; where bonds fail in them, again.

    Args:
        solver: finds equilibria.
        assembler: of the body.
        fracture: the bonds; None: they do not fail.
        overshoot: by how much the worst bond may pass its critical value before a load increment is cut.
        passed: called with the record of the step so far after each pass in which bonds failed; may raise Interrupted.
    """

    def __init__(
        self, solver: EquilibriumSolver, assembler: Assembler, fracture: Fracture | None, overshoot: float = np.inf,
        passed: Callable[[StepRecord], None] = lambda record: None,
    ):  # fmt: skip
        self.solver, self.assembler, self._fracture, self._overshoot = solver, assembler, fracture, overshoot
        self._passed = passed
        self._abandoned = 0  # iterations since the last step that was solved

    def advance(self, state: State, time: float, last: bool, coarse: bool = False) -> tuple[State, StepRecord]:
        """The next state, at `time`.

        Args:
            state: the last one; it stays as it is.
            time: where loads are taken.
            last: whether the increment may not be cut further, so that an overshoot is accepted.
            coarse: whether it shall be cut where Newton finds no equilibrium with softening that follows the stretches.

        Raises:
            StepFailed: there is no equilibrium, or an overshoot; what failed on the way is taken back.
        """
        return self.solve(state, self._at(time), overshoot=np.inf if last else self._overshoot, coarse=coarse)

    def _at(self, time: float) -> Equilibrium:
        """What finds the equilibrium at a time."""

        def equilibrium(new: State, near: bool, quick: bool) -> tuple[np.ndarray, float, SolveRecord]:
            try:
                u, record = self.solver.advance(new.u, time, near, quick)
            except StepFailed:
                self._abandoned += self.solver.record.newton_iterations
                raise
            return u, time, record

        return equilibrium

    def solve(
        self, state: State, equilibrium: Equilibrium, again: bool = True, overshoot: float = np.inf,
        coarse: bool = False,
    ) -> tuple[State, StepRecord]:  # fmt: skip
        """The next state, until no more bonds fail in it.

        Args:
            state: the last one; it stays as it is.
            equilibrium: what finds it.
            again: whether bonds that fail in it are broken and it is looked for again; if not, the step begins with
                breaking what is critical.
            overshoot: what is allowed to the first pass.
            coarse: as of `advance`.

        Raises:
            StepFailed: as of `advance`.
        """
        new, record = replace(state, step=state.step + 1), StepRecord()
        if self._fracture is None:
            new.u, new.time, newton = equilibrium(new, False, False)
            record.passes.append(newton)
            record.abandoned, self._abandoned = self._abandoned, 0
            return new, record
        try:
            self._until_nothing_fails(state, new, record, equilibrium, again, overshoot, coarse)
        except (StepFailed, InputError, Interrupted):  # also where a load has no value
            self._fracture.roll_back(state.u)
            raise
        record.abandoned, self._abandoned = self._abandoned, 0
        return new, record

    def _until_nothing_fails(
        self, state: State, new: State, record: StepRecord, equilibrium, again: bool, overshoot: float,
        coarse: bool,
    ) -> None:  # fmt: skip
        fracture, a = self._fracture, self.assembler
        a.set_time(new.time)
        live, near = fracture.softens, False
        if not again and self._fail(new, fracture.ratios(new.u), record) and fracture.separated:
            equilibrium, near = self._at(new.time), True
        while True:
            before = self._forces(new.u)
            if fracture.softens:
                fracture.set_live(live)
            try:
                u, time, newton = equilibrium(new, near or bool(record.passes), live)
                growth = fracture.growth(u)
                if live and fracture.worst(growth) > LEAP:
                    leap = fracture.worst(growth)
                    self._abandoned += newton.newton_iterations
                    raise Overshoot(f"softening leaps by {leap:.3g} critical stretches", 0.8 * LEAP / leap)
            except StepFailed:
                if live and coarse:
                    raise
                if live:
                    live = False
                    a.set_time(new.time)  # loads do their work from there
                elif not (again and record.passes and self._run_on(new, record)):
                    raise
                continue
            record.passes.append(newton)
            self._account(new, before, u)
            if fracture.softens:
                self._soften(new, u, growth, live)
            new.u, new.time = u, time
            if fracture.separated or not again:
                break
            ratio = fracture.ratios(u)
            worst = fracture.worst(ratio)
            if len(record.passes) == 1 and worst > 1 + overshoot:
                last = fracture.worst(fracture.ratios(state.u))
                share = (1 + overshoot / 2 - last) / (worst - last)
                raise Overshoot(f"a bond is at {worst:.3g} of its critical value", share)
            if not self._fail(new, ratio, record) and (live or fracture.worst(growth) <= STRIDE / 2):
                break
        record.stored, record.separated, record.broken = a.stored_energy(new.u), fracture.separated, fracture.count
        record.held = a.mpi.allreduce(int(fracture.held.sum()))

    def _run_on(self, state: State, record: StepRecord) -> bool:
        """Break what is critical where the predictor came to under a load that stands; whether there was any."""
        guess = self.solver.guess
        return guess is not None and self._fail(state, self._fracture.ratios(guess), record)

    def _fail(self, state: State, ratio: np.ndarray, record: StepRecord) -> bool:
        """Break what is critical by these ratios, and add what that dissipates to the state; whether there was any.

        The ratios are those of the state, or of the predictor from there where no equilibrium is near: under a load
        that the body can no longer carry, cracks run on.
        """
        fracture, a = self._fracture, self.assembler
        whole, constrained = a.stored_energy(state.u), a.constrained
        if not fracture.fail(state.u, ratio, state.step):
            return False
        if a.mpi.allreduce(int((a.constrained != constrained).sum())):
            self.solver.forget()
        state.dissipated += whole - a.stored_energy(state.u)
        record.broken = fracture.count
        self._passed(record)
        return True

    def _soften(self, state: State, u: np.ndarray, growth: np.ndarray, live: bool) -> None:
        """Take over the growth of the stretches of softening bonds at displacements u, and add what that has dissipated
        on the way from a state, or where it is, to the state."""
        fracture, a = self._fracture, self.assembler
        places = (state.u, u) if live else (u,)
        fracture.set_live(False)
        whole = sum(a.stored_energy(place) for place in places)
        fracture.soften(growth, live)
        state.dissipated += (whole - sum(a.stored_energy(place) for place in places)) / len(places)

    def _forces(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Internal forces, and external ones with what supports carry on constrained entries."""
        a = self.assembler
        internal = a.internal_force(u)
        return internal, np.where(a.constrained, internal, a.external_force(u))

    def _account(self, state: State, before: tuple[np.ndarray, np.ndarray], u: np.ndarray) -> None:
        """Add to a state the work on the way from its displacements to others, by the trapezoidal rule: what loads and
        supports do, and what is lost as the body goes from the state in which bonds failed to equilibrium."""
        (internal, carried), du = before, u - state.u
        _, after = self._forces(u)
        work = ((carried + after) * du).sum() / 2, ((carried - internal) * du).sum() / 2
        done, lost = self.assembler.mpi.allreduce(np.array(work))
        state.external_work += float(done)
        state.dissipated += float(lost)
