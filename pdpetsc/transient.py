"""A case in time: masses, initial values, time steps, and what is said of each of them."""

import math
import time as clock
from collections.abc import Callable
from functools import cached_property

import numpy as np

from pdpetsc import options
from pdpetsc.assembly import Assembler
from pdpetsc.body.box import coordinates
from pdpetsc.body.sets import Sets
from pdpetsc.errors import InputError
from pdpetsc.fracture import Fracture
from pdpetsc.loads.velocity import Velocity
from pdpetsc.parallel import collective, warn
from pdpetsc.solvers.dynamics import Motion, TimeSteps, Verlet, stable_step
from pdpetsc.solvers.generalised_alpha import GeneralisedAlpha
from pdpetsc.solvers.linear import default_options
from pdpetsc.solvers.tangent import choose, tangent
from pdpetsc.state import State

SAFETY = 0.9
"""Of the stable step, where the case gives none."""

ALPHA = {
    "ts_alpha_radius": 0.9, "ts_rtol": 1e-4, "ts_atol": 1e-4, "snes_rtol": 1e-8, "snes_linesearch_type": "basic",
}  # fmt: skip
"""PETSc's options of the generalised-alpha method where the user gives none."""

ROWS, FIELDS, CHECKPOINTS = 1000, 20, 5
"""About how many rows of the history, outputs of fields and checkpoints a run has where the case does not say."""


class Transient:
    """A motion of the body of a case.

    Args:
        case: with `[solver] mode` "verlet" or "generalised_alpha".
        assembler: of the body.
        sets: of particles.
        fracture: the bonds; None: they do not fail.
        blocks: about how many the assembled tangent has.
        earlier: the time steps so far, where the body has been refined or is that of a checkpoint.
        refined: whether the body was a coarser one before, so that a given step may be too long.

    Attributes:
        mass: (owned,) of the particles.
        initial: the state at the start.
        time_steps: equal ones from the start on, between refinements.
    """

    def __init__(
        self, case, assembler: Assembler, sets: Sets, fracture: Fracture | None, blocks: float,
        earlier: list[TimeSteps], refined: bool = False,
    ):  # fmt: skip
        self._case, self._assembler, self._fracture, self._refined = case, assembler, fracture, refined
        p = assembler.particles
        self.mass = np.zeros(p.owned)
        for table, material in zip(case.material.values(), assembler.materials):
            own = material.families.center
            self.mass[own] = table.density * p.volume[own]
        self._choice = None
        if case.solver.mode == "generalised_alpha":
            self._choice = choose(assembler.dim, p.count, blocks, options.given(), many=True)
            if case.output.times and case.solver.adaptive:
                raise InputError("output.times: goes with equal steps; take solver.adaptive = false")
        self.initial = self._initial_state(sets)
        self.time_steps = earlier or [self._steps(self.initial)]
        count, output = self.time_steps[0].count, case.output
        self.every = output.every or max(1, count // FIELDS)
        self._checkpoint = output.checkpoint
        if not output.checkpoint and not output.checkpoint_minutes:
            self._checkpoint = max(1, count // CHECKPOINTS)
        self.history = output.history or max(1, count // ROWS)

    @property
    def steps(self) -> TimeSteps:
        """Those to the end."""
        return self.time_steps[-1]

    @cached_property
    def at(self) -> set[int]:
        """Steps nearest to given times."""
        steps = self.steps
        numbers = {
            max(1, round((time - steps.start) / steps.size)) for time in self._case.output.times if time > steps.start
        }
        return {steps.first + min(steps.count, number) for number in numbers}

    def go_on_from(self, state: State) -> None:
        """Choose the time steps from a state on (collective)."""
        self.time_steps = [*self.time_steps, self._steps(state)]
        self.__dict__.pop("at", None)

    def time_of(self, step: int) -> float:
        """The time of a step of velocity Verlet."""
        return next(steps for steps in reversed(self.time_steps) if step >= steps.first).time(step)

    def _initial_state(self, sets: Sets) -> State:
        p, a = self._assembler.particles, self._assembler
        u, v = np.zeros((p.owned, p.dim)), np.zeros((p.owned, p.dim))
        sites = [np.flatnonzero(sets[table.set]) for table in self._case.initial]
        with collective(a.mpi):
            for table, members in zip(self._case.initial, sites):
                place = coordinates(p.position[members], p.spacing[members])
                field, value = (u, table.displacement) if table.displacement else (v, table.velocity)
                field[np.ix_(members, table.component)] = value(**place)[:, None]
            for load in a.constraints:  # a velocity may have no value on one rank alone
                if isinstance(load, Velocity):
                    load.start = u[load.entries]
                    v[load.entries] = load.rates(0.0)
        return State(u=u, v=v)

    def _steps(self, state: State) -> TimeSteps:
        """Equal time steps from a state to the end (collective)."""
        solver, a = self._case.solver, self._assembler
        stable = stable_step(a, self.mass, state.u)
        explicit = self._explicit
        given = solver.time_step or not explicit or "steps" in solver.model_fields_set
        size = SAFETY * stable
        if given:
            size = solver.time_step or solver.end_time / solver.steps
            size = min(size, SAFETY * stable) if explicit and self._refined else size
        if not math.isfinite(size):
            raise InputError("solver.time_step: nothing in the body moves freely, so that no step can be estimated")
        left = solver.end_time - state.time
        count = max(1, math.ceil(left / size * (1 - 1e-12)))
        steps = TimeSteps(solver.end_time, count, stable, state.time, state.step)
        if explicit and steps.size > stable:
            text = f"solver.time_step: {steps.size:.4g} is above the stable step of {stable:.4g} that is estimated"
            warn(a.mpi, f"{text} (a safe bound); watch the energies")
        return steps

    def wanted(self, step: int) -> bool:
        """Whether a step is committed: for the history, the fields, a checkpoint or a given time."""
        regular = any(step % n == 0 for n in (self.history, self.every))
        return regular or self.writes_checkpoint(step) or step in self.at

    def writes_fields(self, step: int) -> bool:
        """Whether the fields of a step are written."""
        return step % self.every == 0 or step in self.at

    def writes_checkpoint(self, step: int) -> bool:
        """Whether a checkpoint of a step is written by its number."""
        return bool(self._checkpoint) and step % self._checkpoint == 0

    def run(self, state: State, commit: Callable[[State], None], look: Callable[[State], str]) -> bool:
        """From a state to the end, or to the first one at which `look` says so (`Motion`); whether there was one.

        Raises:
            ConvergenceError: the motion has blown up, or a step was not solved.
        """
        self._began = clock.perf_counter()
        self.motion = self._motion(commit, look)
        with self._assembler.timings("solve"):
            (Verlet(self.motion) if self._explicit else self._implicit()).run(state)
        return self.motion.paused

    def kinetic(self, state: State) -> float:
        """Kinetic energy of a state, as it goes into the balance (collective)."""
        motion = self._motion(lambda state: None, lambda state: "")
        motion.begin(state)
        return motion.kinetic()

    @property
    def _explicit(self) -> bool:
        return self._case.solver.mode == "verlet"

    def _motion(self, commit, look) -> Motion:
        lag = self.steps.size if self._explicit else 0.0
        return Motion(self._assembler, self.mass, self._fracture, self.steps, commit, self.wanted, look, lag)

    def _implicit(self) -> GeneralisedAlpha:
        """The generalised-alpha method with the linear solver that equilibria have, too."""
        a, adaptive = self._assembler, self._case.solver.adaptive
        choice, solver = self._choice, self._case.solver
        compact = choice.kind == "matrix_free"
        linear = default_options(compact, choice.direct, a.symmetric, a.mpi.size)
        adapt = {"ts_adapt_type": "basic" if adaptive else "none"}
        if adaptive:
            smallest, largest = solver.min_step or self.steps.size / 1024, solver.max_step or solver.end_time
            adapt |= {"ts_max_snes_failures": -1, "ts_adapt_dt_min": smallest, "ts_adapt_dt_max": largest}
        options.set_defaults(ALPHA | adapt | linear)
        return GeneralisedAlpha(self.motion, tangent(a, choice.kind))

    def energies(self, state: State) -> dict[str, float]:
        """What loads have done, what there is and what is gone, and what is missing between them (collective)."""
        kinetic, stored = state.kinetic, self._assembler.stored_energy(state.u)
        imbalance = state.brought + state.mapped + state.external_work - kinetic - stored - state.dissipated
        return {
            "brought": state.brought, "external_work": state.external_work, "kinetic": kinetic, "stored": stored,
            "dissipated": state.dissipated, "mapped": state.mapped, "imbalance": imbalance,
        }  # fmt: skip

    def row(self, state: State) -> dict:
        """A row of the history (collective)."""
        broken = {} if self._fracture is None else {
            "broken_bonds": self._fracture.count, "crack_area": self._fracture.crack_area,
        }  # fmt: skip
        names = {"kinetic": "kinetic_energy", "stored": "stored_energy"}
        energies = {
            names.get(key, key): value
            for key, value in self.energies(state).items()
            if key not in ("brought", "mapped")
        }
        return {"step": state.step, "time": state.time, "time_step": self.motion.last, **energies, **broken,
                "seconds": clock.perf_counter() - self._began}  # fmt: skip

    def choices(self) -> dict[str, str]:
        """What carries the case through time, for summary.json."""
        if self._choice is None:
            return {"solver": "velocity Verlet", "preconditioner": "none", "tangent": "row sums"}
        linear = "direct" if self._choice.direct else "iterative"
        return {"solver": "generalised alpha (alpha2)", "preconditioner": linear, "tangent": self._choice.kind}
