"""Implicit motion in time: the generalised-alpha method of PETSc's TS."""

import numpy as np
from petsc4py import PETSc

from pdpetsc.errors import InputError
from pdpetsc.solvers.dynamics import Motion, from_options, reason_of, time_stepper
from pdpetsc.state import State


class GeneralisedAlpha:
    """TSALPHA2 (Chung and Hulbert 1993) on the residual and the tangent of equilibrium,

        F(t, u, v, a) = m a + dW/du - f_ext(t) = 0,      dF/du + s_a dF/da = K + s_a m

    with r_c = s (u_c - prescribed) in the rows of supports. Options without a prefix, as in -ts_alpha_radius (0.9),
    -ts_adapt_type (basic, or none with adaptive = false), -ts_rtol (1e-4) and -ts_atol; SNES, KSP and PC as for
    equilibria.

    Args:
        motion: what moves.
        tangent: of the body.
    """

    def __init__(self, motion: Motion, tangent):
        self.motion, self._tangent = motion, tangent

    def run(self, state: State) -> None:
        """From a state to the end, or to a pause.

        Raises:
            ConvergenceError: a step was not solved.
        """
        motion, steps = self.motion, self.motion.steps
        motion.begin(state)
        a = motion.assembler
        u, v = a.vector(), a.vector()
        u.getArray()[...], v.getArray()[...] = motion.state.u.ravel(), motion.state.v.ravel()
        self.failure: Exception | None = None
        try:
            with time_stepper(a, PETSc.TS.Type.ALPHA2, state) as ts:
                ts.setI2Function(self._function, a.vector())
                ts.setI2Jacobian(self._jacobian, self._tangent.operator, self._tangent.preconditioner)
                ts.setSolution2(u, v)
                ts.setTimeStep(steps.size if not state.step_size else state.step_size)
                ts.setMaxSteps(10**9)
                ts.setMaxTime(steps.end)
                ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
                ts.setPostStep(self._committed)
                ts.setErrorIfStepFails(False)
                from_options(ts)
                ts.solve(u)
                reason = reason_of(ts)
        except PETSc.Error:
            if self.failure is None:
                raise
        if self.failure:
            raise self.failure
        motion.close(f"{reason}; a smaller time_step in [solver] may help")

    def _set_time(self, time: float) -> None:
        try:
            self.motion.assembler.set_time(time)
        except InputError as error:  # a load without a value; through PETSc it would lose its kind
            self.failure = error
            raise

    def _function(self, ts, t, u, v, acceleration, f) -> None:
        a, mass = self.motion.assembler, self.motion.mass
        self._set_time(t)
        r = a.residual_array(u.getArray(readonly=True).reshape(-1, a.dim))
        inertia = mass * acceleration.getArray(readonly=True).reshape(-1, a.dim)
        with f as array:
            array[...] = (r + np.where(a.constrained, 0.0, inertia)).ravel()

    def _jacobian(self, ts, t, u, v, acceleration, shift_v, shift_a, J, P) -> None:
        a = self.motion.assembler
        self._set_time(t)
        displacement = u.getArray(readonly=True).reshape(-1, a.dim)
        self._tangent.update(np.where(a.constrained, a.prescribed, displacement))
        self._tangent.add_diagonal(np.where(a.constrained, 0.0, shift_a * self.motion.mass))

    def _committed(self, ts) -> None:
        motion, a = self.motion, self.motion.assembler
        try:
            time = ts.getTime()
            solution, velocity = ts.getSolution2()
            a.set_time(time)
            u = solution.getArray(readonly=True).reshape(-1, a.dim).copy()
            broken = motion.fracture.count if motion.fracture else 0
            motion.state.step_size = ts.getTimeStep()
            motion.advance(u, time)
            motion.settle(velocity.getArray(readonly=True).reshape(-1, a.dim).copy())
            if motion.fracture and motion.fracture.count > broken:
                ts.restartStep()  # forces have jumped
            if motion.paused:
                ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)
        except Exception as error:  # through PETSc it would lose its kind
            self.failure = error
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)
