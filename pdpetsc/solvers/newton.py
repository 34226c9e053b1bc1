"""Equilibrium by Newton's method (SNES), one load step at a time."""

import time as clock
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from pdpetsc import options
from pdpetsc.assembly import Assembler
from pdpetsc.errors import InputError
from pdpetsc.solvers.linear import GMRES_RESTART, default_options, describe_linear_solver

DEFAULTS = {
    "snes_rtol": 1e-10, "snes_atol": 0.0, "snes_stol": 0.0, "snes_max_it": 30, "snes_linesearch_type": "basic",
}  # fmt: skip
"""SNES options where the user gives none."""

ROUNDING_MARGIN = 10.0
"""A residual that no longer falls counts as converged below this many times its estimated rounding error."""

WORST_FLOOR = 1e-6
"""A residual above this fraction of loads and reactions is no equilibrium, however large the displacements that raise
its rounding error (those of a body that floats away). Where there are none, as in a rigid motion, the fraction is that
of the forces of a strain of as much again."""

NOT_A_NUMBER = -4
"""SNES's reason for a residual that is NaN, by number: its name changed between PETSc 3.18 and 3.26."""


class StepFailed(Exception):
    """A load step was not solved; its message says why. Raised on all ranks alike."""


@dataclass
class NewtonRecord:
    """How one load step was solved.

    Attributes:
        newton_iterations: linearisations solved, the predictor included.
        linear_iterations: iterations of the Krylov method over all of them.
        residual_norms: |r| after each of them [force].
        residual_scale: what they are compared with, sqrt(|f_ext|^2 + |reactions|^2) [force].
        rounding_floor: whether the step ended because rounding left nothing to gain.
        seconds: wall-clock time.
    """

    newton_iterations: int = 0
    linear_iterations: int = 0
    residual_norms: list[float] = field(default_factory=list)
    residual_scale: float = 0.0
    rounding_floor: bool = False
    seconds: float = 0.0


class Newton:
    """SNES on an Assembler.

    Every step begins with a predictor, one linear solve at the last state: with the jump du_c of the prescribed
    displacements and the new forces, K_ff du_f = -r_f(u) - K_fc du_c (a jump of du_c alone would invert F in the first
    layer of particles). SNES then iterates from there. Its tolerance is relative to applied loads and reactions
    together (seed 004 Eq. 4.6, extended to displacement loading): |r| <= snes_rtol sqrt(|f_ext|^2 + |reactions|^2);
    snes_atol and snes_stol hold as usual.
    """

    def __init__(self, assembler: Assembler):
        self._assembler = assembler
        self._x, self._d, self._rhs = (assembler.vector() for _ in range(3))
        self.snes = snes = PETSc.SNES().create(assembler.particles.comm)
        self._matrix = assembler.matrix()
        options.set_defaults(DEFAULTS | default_options(self._matrix, assembler.symmetric))
        snes.setFunction(assembler.residual, assembler.vector())
        snes.setJacobian(assembler.tangent, self._matrix, self._matrix)
        snes.setConvergenceTest(self._converged)
        try:
            snes.setFromOptions()
        except PETSc.Error as error:
            raise InputError(f"[petsc] or command line: PETSc refuses an option (its error {error.ierr})") from None
        self._record = NewtonRecord()

    def advance(self, u: np.ndarray, time: float) -> tuple[np.ndarray, NewtonRecord]:
        """Equilibrium at `time` from that of the last step.

        Args:
            u: (owned, dim) displacements of the last step.
            time: where the loads are taken.

        Raises:
            StepFailed: with SNES's or KSP's reason.
        """
        start, seconds = clock.perf_counter(), self._assembler.timings.seconds
        elsewhere = sum(seconds[stage] for stage in ("residual", "tangent", "first_tangent"))
        self._record = record = NewtonRecord()
        self._assembler.set_time(time)
        self._predict(u)
        self.snes.solve(None, self._x)
        reason = self.snes.getConvergedReason()
        record.linear_iterations += self.snes.getLinearSolveIterations()
        record.newton_iterations = 1 + self.snes.getIterationNumber()
        record.residual_scale = self._assembler.residual_scale()
        if not record.residual_norms:  # a convergence test of the user's choice, or none
            record.residual_norms.append(self.snes.getFunctionNorm())
        if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH and self._at_rounding_floor(self._x):
            record.rounding_floor, reason = True, 1
        record.seconds = clock.perf_counter() - start
        elsewhere -= sum(seconds[stage] for stage in ("residual", "tangent", "first_tangent"))
        seconds["solve"] += record.seconds + elsewhere
        if reason <= 0:
            raise self._failure(reason)
        return self._x.getArray(readonly=True).reshape(u.shape).copy(), record

    def _predict(self, u: np.ndarray) -> None:
        """Set the initial guess of SNES."""
        a = self._assembler
        jump = np.where(a.constrained, a.prescribed - u, 0.0)
        a.assemble(u)
        rhs = -(a.unbalanced_force(u) + a.action(jump))
        self._rhs.getArray()[...] = np.where(a.constrained, a.constraint_scale * jump, rhs).ravel()
        ksp = self.snes.getKSP()
        ksp.setOperators(self._matrix, self._matrix)
        ksp.solve(self._rhs, self._d)
        self._record.linear_iterations += ksp.getIterationNumber()
        if ksp.getConvergedReason() < 0:
            raise self._failure(PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE)
        guess = u + self._d.getArray(readonly=True).reshape(u.shape)
        self._x.getArray()[...] = np.where(a.constrained, a.prescribed, guess).ravel()

    def _converged(self, snes, iteration, norms):
        """SNES convergence test: relative to loads and reactions, and at the rounding floor."""
        reasons = PETSc.SNES.ConvergedReason
        size, step, norm = norms
        rtol, atol, stol, _ = snes.getTolerances()
        history = self._record.residual_norms
        history.append(norm)
        if not np.isfinite(norm):
            return NOT_A_NUMBER
        if norm <= atol or norm == 0.0:
            return reasons.CONVERGED_FNORM_ABS
        if norm <= rtol * self._assembler.residual_scale():
            return reasons.CONVERGED_FNORM_RELATIVE
        if iteration and step < stol * size:
            return reasons.CONVERGED_SNORM_RELATIVE
        if iteration and norm > 0.5 * history[-2] and self._at_rounding_floor(snes.getSolution()):
            self._record.rounding_floor = True
            return reasons.CONVERGED_FNORM_RELATIVE
        return reasons.ITERATING

    def _at_rounding_floor(self, x: PETSc.Vec) -> bool:
        norm, a = self._record.residual_norms[-1], self._assembler
        if norm > WORST_FLOOR * max(a.residual_scale(), WORST_FLOOR * a.unit_force):
            return False
        u = x.getArray(readonly=True).reshape(-1, self._assembler.dim)
        return norm <= ROUNDING_MARGIN * self._assembler.rounding_floor(u)

    def _failure(self, reason: int) -> StepFailed:
        """What to raise for SNES's reason; a preconditioner that failed is made anew at the next step."""
        name = _name(PETSc.SNES.ConvergedReason, reason)
        if reason == NOT_A_NUMBER:
            return StepFailed(f"{name}: the residual is not finite, as when a deformation gradient is inverted")
        if reason != PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            return StepFailed(name)
        ksp = self.snes.getKSP()
        reasons = PETSc.KSP.ConvergedReason
        text = f"{name}: {describe_linear_solver(ksp)} ended with {_name(reasons, ksp.getConvergedReason())}"
        if ksp.getConvergedReason() in (reasons.DIVERGED_INDEFINITE_MAT, reasons.DIVERGED_INDEFINITE_PC):
            ksp.setType(PETSc.KSP.Type.GMRES)
            ksp.setPCSide(PETSc.PC.Side.RIGHT)  # with the unpreconditioned norm that cg had
            ksp.setGMRESRestart(GMRES_RESTART)
            text += "; the tangent is indefinite (buckling?), so gmres takes over"
        ksp.reset()
        return StepFailed(text)


def _name(reasons: type, value: int) -> str:
    """PETSc's name of a converged reason."""
    return next((name for name, number in vars(reasons).items() if number == value), str(value))
