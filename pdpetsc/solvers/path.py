"""Paths of equilibrium with t as an unknown: on past limit points, where no load step is small enough."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.errors import ConvergenceError
from pdpetsc.parallel import warn
from pdpetsc.solvers.constraints import Constraint, arc
from pdpetsc.solvers.newton import Newton
from pdpetsc.solvers.passes import Passes, StepRecord
from pdpetsc.solvers.record import SolveRecord, StepFailed
from pdpetsc.solvers.stepping import EASY, Schedule
from pdpetsc.state import State

DIFFERENCE = 1e-5
"""Of the end time: by how much t is changed to see how the loads change. Loads are mostly linear in t; in others the
error, of the same order, makes an iteration a little longer and leaves the solution as it is."""

CLOSED = 1e-8
"""A constraint below this is met."""


class Path:
    """Newton's method for r(u, t) = 0 together with a constraint g(u, t) = 0, bordered: with one tangent

        K du_I = -r,  K du_II = -dr/dt,  dt = -(g + g_u.du_I) / (g_u.du_II),  du = du_I + dt du_II

    (Riks 1979, Ramm 1981, Keller 1977). Prescribed displacements are functions of t like the forces:
    dr_f/dt = K_fc du_c/dt - df_ext/dt, and du_II has du_c/dt on constrained entries.

    Args:
        newton: whose tangent, linear solver and test of convergence serve here.
        assembler: of the body.
        end: time in whose middle loads are sure to have a value.
    """

    def __init__(self, newton: Newton, assembler: Assembler, end: float):
        self._newton, self._assembler, self._end = newton, assembler, end
        self.tried = 0.0
        """Time that the predictor of the last step came to."""

    def rate(self, u: np.ndarray, t: float) -> np.ndarray:
        """du/dt of the path, (owned, dim), at an equilibrium; loads are afterwards those of t (collective)."""
        self._assembler.set_time(t)
        self._newton.tangent.update(u)
        return self._newton.solve_linear(self._load_rate(u, t))

    def _load_rate(self, u: np.ndarray, t: float) -> np.ndarray:
        """-dr/dt with the last tangent, at displacements u; s du_c/dt on constrained entries."""
        a = self._assembler
        h = DIFFERENCE * self._end * (1.0 if t < self._end / 2 else -1.0)
        here = a.prescribed.copy(), a.external_force(u).copy()
        a.set_time(t + h)
        jump, force = ((there - now) / h for there, now in zip((a.prescribed, a.external_force(u)), here))
        a.set_time(t)
        return np.where(a.constrained, a.constraint_scale * jump, force - a.action(jump))

    def solve(self, u: np.ndarray, t: float, constraint: Constraint) -> tuple[np.ndarray, float]:
        """Equilibrium that meets the constraint, from a guess (collective); inside `newton.recording()`.

        Raises:
            StepFailed: it was not found.
        """
        a, newton = self._assembler, self._newton
        record, most = newton.record, newton.snes.getTolerances()[3]
        for _ in range(most + 1):
            a.set_time(t)
            u = np.where(a.constrained, a.prescribed, u)
            with a.timings("residual"):
                r = a.residual_array(u)
            g, change = constraint.linearise(u)
            reason = newton.verdict(newton.norm(r), u)
            record.residual_scale = a.residual_scale()
            if reason < 0:
                raise newton.failure(reason)
            if reason > 0 and abs(g) <= CLOSED:
                return u, t
            record.rounding_floor = False
            record.newton_iterations += 1
            du, dt = self.correction(u, t, r, g, change)
            u, t = u + du, t + dt
        raise newton.failure(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)

    def step(self, state: State, bound: Constraint, schedule: Schedule) -> Callable:
        """What finds the equilibrium of a step for `Passes.solve`: from the state, and where bonds have failed since,
        from where it has come to.

        Args:
            state: where the step begins.
            bound: where it ends.
            schedule: whose end is met exactly, by load control.
        """
        newton = self._newton
        self.tried = state.time

        def equilibrium(new: State, near: bool, quick: bool) -> tuple[np.ndarray, float, SolveRecord]:
            if near and schedule.finished(new.time):
                u, record = newton.advance(new.u, new.time, near)
                return u, new.time, record
            if near:
                with newton.recording() as record:
                    return *self.solve(new.u, new.time, bound), record
            with newton.recording() as record:
                rate = self.rate(state.u, state.time)
                u, dt = self.predict(state, bound, rate)
                self.tried = t = state.time + dt if np.isfinite(dt) else schedule.end
                if np.isfinite(dt):
                    u, t = self.solve(u, t, bound)
                    if bound.turned_back(u - state.u, dt * rate):
                        raise StepFailed("the path turned back")
            if schedule.finished(t):
                return _land(newton, state, u, t, schedule.end, record)
            return u, t, record

        return equilibrium

    def correction(
        self, u: np.ndarray, t: float, r: np.ndarray, g: float, change: Callable[[np.ndarray], float]
    ) -> tuple[np.ndarray, float]:
        """du and dt of one bordered iteration at (u, t), where the loads are those of t (collective)."""
        newton = self._newton
        newton.tangent.update(u)
        du_I = newton.solve_linear(-r)
        du_II = newton.solve_linear(self._load_rate(u, t))
        along = change(du_II)
        if along == 0.0:
            raise StepFailed("the constraint does not bound the step")
        dt = -(g + change(du_I)) / along
        return du_I + dt * du_II, dt

    def predict(self, state: State, bound: Constraint, rate: np.ndarray) -> tuple[np.ndarray, float]:
        """Displacements to begin with, and the change of t: from the state along the rate of the path there, to the end
        where that is inf. Where bonds have failed in that state, its equilibrium without them comes first
        (collective)."""
        a, newton = self._assembler, self._newton
        u = state.u
        if not bound.again:
            u = u + newton.solve_linear(np.where(a.constrained, 0.0, -a.unbalanced_force(u)))
        newton.record.newton_iterations = 1
        dt = bound.predict(u, rate)
        return u + (dt if np.isfinite(dt) else self._end - state.time) * rate, dt


def follow(
    passes: Passes,
    state: State,
    schedule: Schedule,
    constraint: Callable[[State, float], Constraint],
    commit: Callable[[State, StepRecord], bool],
    failed: Callable[[float, float, str], None],
) -> str:
    """Advance along the path of equilibrium to the end of the schedule, or until the body has come apart.

    Step sizes are in time, as of load steps; times the speed |du/dt| with which the path begins they are arc lengths.
    The step that comes to the end of the schedule, or beyond it, ends there by load control. Where bonds fail in a
    step, it is solved again under the same constraint, or the next one begins with them (`Constraint.again`).

    Args:
        passes, state, schedule, commit, failed: as of `march`.
        constraint: makes that of a step from the state where it begins and its arc length.

    Returns:
        As `march`.

    Raises:
        ConvergenceError: a step failed and may not be cut further.
    """
    newton: Newton = passes.solver
    assembler = passes.assembler
    path = Path(newton, assembler, schedule.end)
    while not schedule.finished(state.time):
        if state.step >= schedule.most:
            text = f"solver.max_steps: the path has ended after {state.step} steps, at t = {state.time:g}"
            warn(assembler.mpi, f"{text}, short of end_time = {schedule.end:g}")
            return "converged"
        size = min(state.step_size or schedule.nominal, schedule.largest)
        try:
            with newton.recording():
                speed = state.speed or arc(assembler, path.rate(state.u, state.time))
            if not speed > 0.0:
                raise StepFailed("the loads move nothing there")
            bound = constraint(state, speed * size)
            new, record = passes.solve(state, path.step(state, bound, schedule), again=bound.again)
        except StepFailed as failure:
            size /= 2
            if not schedule.adaptive or size < schedule.smallest:
                remedy = "a smaller min_step" if schedule.adaptive else "more steps or adaptive = true"
                raise ConvergenceError(
                    f"step {state.step + 1} along the path, from t = {state.time:g}, did not converge: {failure}; "
                    f"{remedy} in [solver] may help"
                ) from failure
            failed(state.time, path.tried, str(failure))
            state.step_size = size
            continue
        increment = new.u - state.u
        record.arc_length = arc(assembler, increment)
        easy = schedule.adaptive and max(newton.newton_iterations for newton in record.passes) <= EASY
        state = replace(new, increment=increment, speed=speed, step_size=2 * size if easy else size)
        paused = commit(state, record)
        if record.separated:
            return "separated"
        if paused and not schedule.finished(state.time):
            return "paused"
    return "converged"


def _land(
    newton: Newton, state: State, u: np.ndarray, t: float, end: float, so_far: SolveRecord
) -> tuple[np.ndarray, float, SolveRecord]:
    """The equilibrium at the end, which lies between the state and (u, t), with the record of all."""
    share = (end - state.time) / (t - state.time)
    u, record = newton.advance(state.u + share * (u - state.u), end)
    for name in ("newton_iterations", "linear_iterations", "seconds"):
        setattr(record, name, getattr(record, name) + getattr(so_far, name))
    return u, end, record


def limit_points(times: list[float], lengths: list[float]) -> list[dict]:
    """Where t turns along a path that begins at t = 0, from the parabola through three steps in terms of arc length.

    Args:
        times: t at the end of each step.
        lengths: arc length of each step.

    Returns:
        For each the number of the step next to it, and t there.
    """
    t, s = np.array([0.0, *times]), np.concatenate([[0.0], np.cumsum(lengths)])
    found = []
    for k in range(1, len(t) - 1):
        if (t[k] - t[k - 1]) * (t[k + 1] - t[k]) < 0.0:
            before, after = (t[k] - t[k - 1]) / (s[k] - s[k - 1]), (t[k + 1] - t[k]) / (s[k + 1] - s[k])
            bend = (after - before) / (s[k + 1] - s[k - 1])
            slope = before + bend * (s[k] - s[k - 1])
            found.append({"step": k, "time": float(t[k] - slope**2 / (4 * bend))})
    return found
