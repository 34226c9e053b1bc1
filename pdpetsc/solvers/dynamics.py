"""Motion in time, and velocity Verlet as a PETSc TS of type python.

    m a = f_ext(t) - dW/du,      m_i = density V_i        lumped, so each particle moves by itself

Velocity Verlet (seed 004 section 2.3; second order, symplectic), t^n = n dt:

    v^(n+1/2) = v^n + dt/2 a^n,   u^(n+1) = u^n + dt v^(n+1/2),   v^(n+1) = v^(n+1/2) + dt/2 a^(n+1)

Stable for dt < 2/omega_max, and omega_max^2 <= max_a sum_b |K_ab|/m_a (Gershgorin; materials/row_sums.py). Prescribed
displacements are met at each t^n, their velocity is that of the step. Bonds that have reached their critical value in
u^(n+1) are broken before a^(n+1) is found.

Energies of a step, with the mean of both ends' forces: loads and supports do the work W, broken bonds take D, and

    kinetic + stored + D - W = what it was at the start

exactly where forces are linear in u, with the kinetic energy v^(n-1/2).m v^(n+1/2)/2 = (v^n.m v^n - dt^2/4 a^n.m a^n)/2
that leapfrogging keeps (dt = 0 in it for other schemes, which keep it up to their error).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numba import njit
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.errors import ConvergenceError, InputError
from pdpetsc.fracture import Fracture
from pdpetsc.state import State


@dataclass(frozen=True)
class TimeSteps:
    """Equal steps to the end.

    Attributes:
        end: time of the last one.
        count: number of steps.
        stable: largest stable step of velocity Verlet, estimated.
        start, first: time and number of the step from which they go on.
    """

    end: float
    count: int
    stable: float
    start: float = 0.0
    first: int = 0

    @property
    def size(self) -> float:
        return (self.end - self.start) / self.count

    def time(self, step: int) -> float:
        return self.start + (self.end - self.start) * (step - self.first) / self.count

    def finished(self, time: float) -> bool:
        return time >= self.end * (1 - 1e-12)


def stable_step(assembler: Assembler, mass: np.ndarray, u: np.ndarray) -> float:
    """2/omega_max by the row sums of the tangent at owned displacements u (collective).

    Args:
        mass: (owned,) of the particles.
    """
    assembler.linearise(u)
    squares = np.where(assembler.constrained, 0.0, assembler.row_sums() / mass[:, None])
    largest = assembler.mpi.allreduce(float(squares.max(initial=0.0)), MPI.MAX)
    return 2 / largest**0.5 if largest else np.inf


def from_options(ts: PETSc.TS) -> None:
    """Let the user's options have their say, but not on what the TS is.

    Raises:
        InputError: PETSc refuses an option, or it asks for another kind of TS.
    """
    kind, prefix = ts.getType(), ts.getOptionsPrefix() or ""
    try:
        ts.setFromOptions()
    except PETSc.Error as error:
        raise InputError(f"[petsc] or command line: PETSc refuses an option (its error {error.ierr})") from None
    if ts.getType() != kind:
        raise InputError(f"-{prefix}ts_type: cannot be chosen here; [solver] mode says how t is gone through")


def reason_of(ts: PETSc.TS) -> str:
    """PETSc's name of why a TS ended."""
    reason = ts.getConvergedReason()
    return next((name for name, value in vars(PETSc.TS.ConvergedReason).items() if value == reason), str(reason))


@contextmanager
def time_stepper(assembler: Assembler, kind: str, state: State) -> Iterator[PETSc.TS]:
    """A TS that goes on from a state, destroyed afterwards."""
    ts = PETSc.TS().create(assembler.particles.comm)
    try:
        ts.setType(kind)
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setTime(state.time)
        ts.setStepNumber(state.step)
        yield ts
    finally:
        ts.destroy()


class Motion:
    """What both ways through time have in common: forces, energies, what fails.

    Args:
        assembler: of the body.
        mass: (owned,) of the particles.
        fracture: the bonds; None: they do not fail.
        steps: in time.
        commit: called with the state after each of the steps for which `wanted` is true, and after the last one.
        wanted: function of the step's number.
        look: function of the state that tells after each step whether it is to be committed in any case ("commit") or
            to be the last one for now ("pause").
        lag: dt in the kinetic energy (above).
    """

    def __init__(
        self, assembler: Assembler, mass: np.ndarray, fracture: Fracture | None, steps: TimeSteps,
        commit: Callable[[State], None], wanted: Callable[[int], bool], look: Callable[[State], str], lag: float,
    ):  # fmt: skip
        self.assembler, self.mass, self.fracture, self.steps = assembler, mass[:, None], fracture, steps
        self.commit, self.wanted, self.look, self.lag = commit, wanted, look, lag

    def begin(self, state: State) -> None:
        """Take over a state (collective)."""
        a = self.assembler
        a.set_time(state.time)
        self.committed, self.last, self.paused = state.step, self.steps.size, False
        self.state = replace(state, u=np.where(a.constrained, a.prescribed, state.u), v=state.v.copy())
        self.internal = a.internal_force(self.state.u)
        self.external = a.external_force(self.state.u).copy()
        if not state.step:
            self.state.kinetic = self.kinetic()
            self.state.brought = self.state.kinetic + a.stored_energy(self.state.u)

    def kinetic(self) -> float:
        """Kinetic energy of the state (collective)."""
        acceleration = np.where(self.assembler.constrained, 0.0, (self.external - self.internal) / self.mass)
        with np.errstate(over="ignore", invalid="ignore"):  # of a motion that is about to blow up
            square = self.state.v**2 - (self.lag * acceleration) ** 2 / 4
            return self.assembler.mpi.allreduce(float((self.mass * square).sum()) / 2)

    def advance(self, u: np.ndarray, time: float) -> None:
        """Move the state's displacements to u, with loads of a time: bonds that have become critical break, forces are
        found and their work is added; velocities are up to the caller."""
        a, state = self.assembler, self.state
        before, self.last = state.u, time - state.time
        state.u, state.time, state.step = u, time, state.step + 1
        unbroken = self._break() if self.fracture is not None else None
        internal, external = a.internal_force(u), a.external_force(u)
        self._work = _work(a.constrained, before, u, self.internal, internal, self.external, external)
        if unbroken is not None:  # their forces are gone for the second half of the step
            lost = float(((unbroken - internal) * (u - before)).sum()) / 2
            state.dissipated -= a.mpi.allreduce(lost)
        self.internal = internal
        self.external[...] = external

    def settle(self, v: np.ndarray) -> None:
        """Give the state its velocities, add the work of the step, and commit it if it is wanted."""
        a, state, steps = self.assembler, self.state, self.steps
        work = self._work + _work_on_masses(a.constrained, self.mass[:, 0], state.v, v)
        state.v = v
        total = a.mpi.allreduce(work)
        state.external_work += total
        if not np.isfinite(total):
            raise ConvergenceError(
                f"the motion has blown up in step {state.step}, t = {state.time:g}: a time step of {steps.size:.4g} is "
                f"too long; {steps.stable:.4g} was estimated to be stable at the start"
            )
        finished = steps.finished(state.time)
        asked = "" if finished else self.look(state)
        self.paused = asked == "pause"
        if asked or finished or self.wanted(state.step):
            self._commit()

    def _commit(self) -> None:
        self.state.kinetic, self.committed = self.kinetic(), self.state.step
        self.commit(replace(self.state, u=self.state.u.copy(), v=self.state.v.copy()))

    def close(self, reason: str) -> None:
        """After the last step (collective).

        Raises:
            ConvergenceError: it is not the end.
        """
        state = self.state
        if not self.paused and not self.steps.finished(state.time):
            if state.step > self.committed:
                self._commit()
            raise ConvergenceError(f"the motion has ended at t = {state.time:g}, short of end_time: {reason}")

    def _break(self) -> np.ndarray | None:
        """Break what is critical at the state; the internal forces before, if anything has been broken."""
        fracture, state = self.fracture, self.state
        failed = fracture.critical(state.u)
        if failed is None:
            return None
        unbroken = self.assembler.internal_force(state.u)
        state.dissipated += fracture.fail_all(failed, state.u, state.step)
        return unbroken


class Verlet:
    """The TS of type python; options without a prefix, as in -ts_monitor."""

    def __init__(self, motion: Motion):
        self.motion = motion

    def run(self, state: State) -> None:
        """From a state to the end, or to a pause.

        Raises:
            ConvergenceError: the motion has blown up.
        """
        motion, steps = self.motion, self.motion.steps
        motion.begin(state)
        a = motion.assembler
        self.failure: Exception | None = None
        x = a.vector()
        x.getArray()[...] = motion.state.u.ravel()
        with time_stepper(a, PETSc.TS.Type.PYTHON, state) as ts:
            ts.setPythonContext(self)
            ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
            ts.setTimeStep(steps.size)
            ts.setMaxSteps(steps.first + steps.count)
            ts.setMaxTime(2 * steps.end)
            from_options(ts)
            ts.solve(x)
            reason = reason_of(ts)
        if self.failure:
            raise self.failure
        motion.close(reason)

    def step(self, ts: PETSc.TS) -> None:
        """One step of TS."""
        motion, dt = self.motion, self.motion.steps.size
        a, state = motion.assembler, motion.state
        time = motion.steps.time(state.step + 1)
        try:
            a.set_time(time)
            u, v, held, mass = np.empty_like(state.u), np.empty_like(state.v), a.constrained, motion.mass[:, 0]
            _drift(held, a.prescribed, mass, motion.internal, motion.external, dt, state.u, state.v, u, v)
            motion.advance(u, time)
            _kick(held, mass, motion.internal, motion.external, dt / 2, v)
            motion.settle(v)
        except Exception as error:  # through PETSc it would lose its kind
            self.failure = error
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)
            return
        with ts.getSolution() as array:
            array[...] = u.ravel()
        ts.setTime(time)
        if motion.paused:
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)


@njit(cache=True)
def _drift(held, prescribed, mass, internal, external, dt, u, v, new_u, new_v):
    """Fill new_v with v^(n+1/2) and new_u with u^(n+1)."""
    for i in range(len(u)):
        for k in range(u.shape[1]):
            if held[i, k]:
                new_u[i, k] = prescribed[i, k]
                new_v[i, k] = (prescribed[i, k] - u[i, k]) / dt
            else:
                new_v[i, k] = v[i, k] + 0.5 * dt * (external[i, k] - internal[i, k]) / mass[i]
                new_u[i, k] = u[i, k] + dt * new_v[i, k]


@njit(cache=True)
def _kick(held, mass, internal, external, dt, v):
    """Add dt a to the velocities of free entries."""
    for i in range(len(v)):
        for k in range(v.shape[1]):
            if not held[i, k]:
                v[i, k] += dt * (external[i, k] - internal[i, k]) / mass[i]


@njit(cache=True)
def _work(held, u, new_u, internal, new_internal, external, new_external):
    """Of loads and supports over a step, without the inertia of what supports move."""
    work = 0.0
    for i in range(len(u)):
        for k in range(u.shape[1]):
            force = internal[i, k] + new_internal[i, k] if held[i, k] else external[i, k] + new_external[i, k]
            work += 0.5 * force * (new_u[i, k] - u[i, k])
    return work


@njit(cache=True)
def _work_on_masses(held, mass, v, new_v):
    """What supports do on the masses that they move; not finite where a velocity is not."""
    work = 0.0
    for i in range(len(v)):
        for k in range(v.shape[1]):
            if held[i, k]:
                work += 0.5 * mass[i] * (new_v[i, k] ** 2 - v[i, k] ** 2)
            elif not np.isfinite(new_v[i, k]):
                work = np.nan
    return work
