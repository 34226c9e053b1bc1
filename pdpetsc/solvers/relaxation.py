"""Adaptive dynamic relaxation: equilibrium as the rest of a damped motion, a PETSc TS of type python.

The motion Lambda u'' + c Lambda u' = F(u) with fictitious masses goes to the equilibrium F(u) = f_ext - dW/du = 0
whatever they are (seed 000 section 3.2, seed 003 section 4.2, seed 004 section 3.2; Underwood 1983). With dt = 1,

    lambda_a  = s sum_b |K_ab|/4                       stable: omega^2 <= max(sum_b |K_ab|/lambda_a) = 4/s
    v^(n+1/2) = ((2 - c) v^(n-1/2) + 2 F^n/lambda)/(2 + c),      v^(1/2) = F^0/(2 lambda)
    u^(n+1)   = u^n + v^(n+1/2)

The seeds print the inequality and the inverse the wrong way round. Row sums are bounds from family blocks
(materials/row_sums.py). c = 2 omega damps the slowest motion critically; omega^2 is the Rayleigh quotient of the motion
itself: over one step K v = -(F^n - F^(n-1)), so that

    omega^2 = -v.(F^n - F^(n-1))/(v.Lambda v),    v = v^(n-1/2)

The seeds take the quotient of u with a local stiffness -(F_i^n - F_i^(n-1))/(lambda_i v_i), one of small numbers.

What is left of the way at a residual r is K^-1 r, at most |r|_(1/Lambda)/omega_min^2 in the norm of Lambda: a slender
body is still on its way where its residual has all but gone.
"""

import time as clock

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.errors import InputError
from pdpetsc.solvers.dynamics import from_options
from pdpetsc.solvers.record import SolveRecord, StepFailed

PREFIX = "pd_adr_"
"""Of the options; PETSc's own follow it, as in -pd_adr_ts_max_steps."""

DEFAULTS = {"rtol": 1e-9, "utol": 1e-7, "safety": 1.0, "ts_max_steps": 200_000}

REACH = 0.02
"""Of a spacing, by which prescribed displacements move in a step at most, so that no family is inverted."""

UNSTABLE = 3.8
"""omega^2 of a motion at which it begins anew with other masses; 4 is the limit of stability."""

FORGOTTEN = 1.01
"""Factor by which the least omega^2 of late, that of the slowest motion, is forgotten in a step."""

FLOOR = 100
"""Steps between looks at whether a residual is rounding alone."""

STAGNANT = 20_000
"""Steps in which the least residual must fall by a tenth."""


class Relaxation:
    """Finds equilibria by damped motion.

    A step is solved where |r| <= rtol sqrt(|f_ext|^2 + |reactions|^2), as by Newton's method, and what is left of the
    way is at most utol |u|, or r is rounding alone. Options, with the prefix `pd_adr_`: `rtol`, `utol`, `safety` (s
    above), `ts_max_steps` and all others of a TS.

    Args:
        assembler: of the body.
    """

    guess: np.ndarray | None = None
    record = SolveRecord()
    """Of the last step."""

    def __init__(self, assembler: Assembler):
        self._assembler = assembler
        self._x = assembler.vector()
        options = PETSc.Options(PREFIX)
        try:
            numbers = (options.getReal(name, DEFAULTS[name]) for name in ("rtol", "utol", "safety"))
            self.rtol, self.utol, self.safety = numbers
        except PETSc.Error:
            raise InputError(f"-{PREFIX}rtol, -{PREFIX}utol, -{PREFIX}safety: must be numbers") from None
        self.ts = ts = PETSc.TS().create(assembler.particles.comm)
        ts.setOptionsPrefix(PREFIX)
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setType(PETSc.TS.Type.PYTHON)
        self._motion = _Motion(self)
        ts.setPythonContext(self._motion)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        ts.setMaxSteps(DEFAULTS["ts_max_steps"])
        ts.setMaxTime(1e30)
        from_options(ts)

    def choices(self) -> dict[str, str]:
        """What solves, for summary.json."""
        return {"solver": "adaptive dynamic relaxation", "preconditioner": "none", "tangent": "row sums"}

    def forget(self) -> None:
        """Masses are those of each step anyway."""

    def advance(
        self, u: np.ndarray, time: float, near: bool = False, quick: bool = False
    ) -> tuple[np.ndarray, SolveRecord]:
        """Equilibrium at `time` from that of the last step, as `Newton.advance`.

        Raises:
            StepFailed: the motion does not come to rest.
        """
        a, start, record = self._assembler, clock.perf_counter(), SolveRecord()
        self.record = record
        a.set_time(time)
        self._motion.begin(u, record)
        self._x.getArray()[...] = u.ravel()
        self.ts.setTime(0.0)
        self.ts.setTimeStep(1.0)
        self.ts.setStepNumber(0)
        self.ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_ITERATING)
        try:
            self.ts.solve(self._x)
        finally:
            self._motion.end()
            record.seconds = clock.perf_counter() - start
            a.timings.seconds["solve"] += record.seconds
        record.relaxation_steps = self.ts.getStepNumber()
        if self._motion.failure:
            raise StepFailed(self._motion.failure)
        if self.ts.getConvergedReason() != PETSc.TS.ConvergedReason.CONVERGED_USER:
            left = record.residual_norms[-1] / (record.residual_scale or 1.0)
            raise StepFailed(
                f"relaxation has not come to rest: |r| = {left:.3g} of the loads after "
                f"{record.relaxation_steps} steps; -{PREFIX}ts_max_steps allows more"
            )
        return self._x.getArray(readonly=True).reshape(u.shape).copy(), record


class _Motion:
    """The TS of type python."""

    def __init__(self, relaxation: Relaxation):
        self._of = relaxation

    def begin(self, u: np.ndarray, record: SolveRecord) -> None:
        a = self._of._assembler
        self.failure, self._record, self._force = "", record, None
        self._weigh(u)
        self._target = a.prescribed
        self._start = np.where(a.constrained, u, a.prescribed)
        jump = a.mpi.allreduce(float(np.abs(self._target - self._start).max(initial=0.0)), MPI.MAX)
        self._ramp = max(1, int(np.ceil(jump / (REACH * a.spacing))))
        self._least, self._least_at = np.inf, 0

    def _weigh(self, u: np.ndarray) -> None:
        """Begin from rest at u with masses for its tangent."""
        a = self._of._assembler
        a.linearise(u)
        self._mass = np.maximum(self._of.safety * a.row_sums() / 4, np.finfo(float).tiny)
        self._velocity, self._force, self._slowest = np.zeros_like(u), None, np.inf

    def end(self) -> None:
        self._of._assembler.prescribed = self._target

    def step(self, ts: PETSc.TS) -> None:
        a, n = self._of._assembler, ts.getStepNumber()
        share = min(1.0, (n + 1) / self._ramp)
        a.prescribed = self._target if share == 1.0 else self._start + share * (self._target - self._start)
        x = ts.getSolution()
        u = np.where(a.constrained, a.prescribed, x.getArray(readonly=True).reshape(-1, a.dim))
        force = -a.residual_array(u)
        force[a.constrained] = 0.0
        v, m = self._velocity, self._mass
        change = 0.0 if self._force is None else float((v * (force - self._force)).sum())
        products = ((force, force), (v * m, v), (force / m, force), (u * m, u))
        sums = [a._square_scale, -change, *(float(np.vdot(*pair)) for pair in products)]
        scale, stiff, square, moving, pulled, moved = a.mpi.allreduce(np.array(sums))
        norm, scale = square**0.5, scale**0.5
        if moving > 0 and stiff > 0:
            self._slowest = min(FORGOTTEN * self._slowest, stiff / moving)
        left = pulled**0.5 / self._slowest if np.isfinite(self._slowest) else np.inf
        near = norm == 0.0 or norm <= self._of.rtol * scale and left <= self._of.utol * moved**0.5
        rounding = not near and n % FLOOR == FLOOR - 1 and a.at_rounding_floor(norm, u)
        self._record.rounding_floor = bool(rounding)
        self._judge(ts, n, norm, scale, share == 1.0 and (near or rounding))
        if ts.getConvergedReason() != PETSc.TS.ConvergedReason.CONVERGED_ITERATING:
            with x as array:
                array[...] = u.ravel()
            return
        if stiff > UNSTABLE * moving:  # stiffer than where masses were taken
            self._weigh(u)
            m = self._mass
        if self._force is None:
            self._velocity = force / (2 * m)
        else:
            omega = np.sqrt(stiff / moving) if moving > 0 and stiff > 0 else 0.0
            c = min(2 * omega, 1.9)
            self._velocity = ((2 - c) * v + 2 * force / m) / (2 + c)
        self._force = force
        with x as array:
            array[...] = (u + self._velocity).ravel()
        ts.setTime(ts.getTime() + 1.0)

    def _judge(self, ts, n: int, norm: float, scale: float, rest: bool) -> None:
        """End the motion where it is at rest, has blown up or goes on for ever."""
        history, reasons = self._record.residual_norms, PETSc.TS.ConvergedReason
        if n == 0:
            history[:] = [norm, norm]
        history[-1], self._record.residual_scale = norm, scale
        if not np.isfinite(norm):
            self.failure = "relaxation: the residual is not finite, as when a deformation gradient is inverted"
        elif rest:
            ts.setConvergedReason(reasons.CONVERGED_USER)
            return
        if norm < 0.9 * self._least:
            self._least, self._least_at = norm, n
        if n > self._least_at + STAGNANT + self._ramp:
            self.failure = f"relaxation stagnates at |r| = {norm / (scale or 1.0):.3g} of the loads"
        if self.failure:
            ts.setConvergedReason(reasons.CONVERGED_USER)
