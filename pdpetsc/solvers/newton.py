"""Equilibrium by Newton's method (SNES), one load step at a time."""

import atexit
import gc
import itertools
import time as clock
import weakref
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc import options
from pdpetsc.assembly import Assembler
from pdpetsc.errors import InputError
from pdpetsc.solvers.linear import GMRES_RESTART, SMALLEST_RTOL, default_options, describe_linear_solver
from pdpetsc.solvers.record import SolveRecord, StepFailed
from pdpetsc.solvers.tangent import choose, tangent

DEFAULTS = {
    "snes_rtol": 1e-10, "snes_atol": 0.0, "snes_stol": 0.0, "snes_max_it": 30, "snes_linesearch_type": "basic",
}  # fmt: skip
"""SNES options where the user gives none."""

LARGEST_FORCING = 1e-2
"""Reduction of the linear residual that is always asked for. Krylov methods solve a Newton step no better than it is
worth: to 0.9 (|r_k|/|r_k-1|)^2 (Eisenstat and Walker 1996, choice 2), but no further than the step's end."""

SMALLEST_ERROR = 1e-2
"""Of the predictor, in spacings, where displacements are prescribed: whatever the jump, families are not inverted."""

CONTRACTION = 0.1
"""Fall of the residual from which a tangent that is not quite that of the state is kept: a factorisation costs as much
as 20 to 30 solutions."""

WORSE = 1.5
"""A preconditioner with which a linear solution takes this many times the iterations is made anew."""

QUICK_ITERATIONS, QUICK_LINEAR = 8, 300
"""Iterations of Newton's and of the Krylov method after which a quick attempt is given up, unless the user has said."""

NOT_A_NUMBER = -4
"""SNES's reason for a residual that is NaN, by number: its name changed between PETSc 3.18 and 3.26."""


class Newton:
    """SNES on an Assembler.

    Every step begins with a predictor, one linear solve at the last state: with the jump du_c of the prescribed
    displacements and the new forces, K_ff du_f = -r_f(u) - K_fc du_c (a jump of du_c alone would invert F in the first
    layer of particles). SNES then iterates from there. Its tolerance is relative to applied loads and reactions
    together (seed 004 Eq. 4.6, extended to displacement loading): |r| <= snes_rtol sqrt(|f_ext|^2 + |reactions|^2);
    snes_atol and snes_stol hold as usual.

    Args:
        assembler: of the body.
        blocks: about how many the assembled tangent has, by which tangent and solver are chosen.
        definite: whether a symmetric tangent is expected to be positive definite, as before limit points.
        many: whether there will be hundreds of solutions (`choose`).
    """

    def __init__(self, assembler: Assembler, blocks: float, definite: bool = True, many: bool = False):
        self._assembler = assembler
        self._x, self._d, self._rhs = (assembler.vector() for _ in range(3))
        self.snes = snes = PETSc.SNES().create(assembler.particles.comm)
        choice = choose(assembler.dim, assembler.particles.count, blocks, options.given(), many)
        self.tangent = tangent(assembler, choice.kind)
        operator, preconditioner = self.tangent.operator, self.tangent.preconditioner
        compact, ranks = choice.kind == "matrix_free", assembler.mpi.size
        options.set_defaults(DEFAULTS | default_options(compact, choice.direct, assembler.symmetric, ranks, definite))
        self._inexact = "ksp_rtol" not in options.given()
        snes.setFunction(assembler.residual, assembler.vector())
        snes.setJacobian(self._linearise, operator, preconditioner)
        snes.setConvergenceTest(self._converged)
        try:
            snes.setFromOptions()
        except PETSc.Error as error:
            raise InputError(f"[petsc] or command line: PETSc refuses an option (its error {error.ierr})") from None
        self.number = next(_numbers)
        _alive.add(self)
        self.record = SolveRecord()
        self.guess: np.ndarray | None = None
        """Where the predictor of `advance` came to; None along a path."""
        self._cost = np.inf  # least iterations for a decade of the linear residual with the present preconditioner
        self._unbalanced = 0.0  # norm of the forces out of balance at the start of a step
        self._before = 0.0  # norm of the right-hand side of the last linear solution
        self._near = self._quick = False
        self._most_linear = snes.getKSP().getTolerances()[3]

    def choices(self) -> dict[str, str]:
        """What solves, for summary.json."""
        return {
            "solver": f"newton ({self.snes.getType()})",
            "preconditioner": describe_linear_solver(self.snes.getKSP()),
            "tangent": self.tangent.kind,
        }

    def forget(self) -> None:
        """Supports have changed: what depends on them is made anew."""
        self.tangent.renew_preconditioner()

    def destroy(self) -> None:
        """Give back PETSc's memory (collective)."""
        self.snes.getKSP().getPC().setType(PETSc.PC.Type.NONE)  # or its part of type python outlives Python
        self.snes.destroy()
        self.tangent.destroy()

    def advance(
        self, u: np.ndarray, time: float, near: bool = False, quick: bool = False
    ) -> tuple[np.ndarray, SolveRecord]:
        """Equilibrium at `time` from that of the last step.

        Args:
            u: (owned, dim) displacements of the last step.
            time: where the loads are taken.
            near: whether the new equilibrium is so near that the tangent at u serves as long as residuals fall by
                `CONTRACTION` with it.
            quick: whether to give up early, where there is another way to go on.

        Raises:
            StepFailed: with SNES's or KSP's reason.
        """
        with self.recording() as record:
            self._assembler.set_time(time)
            self._near, self._quick = near, quick and "snes_max_it" not in options.given()
            if "ksp_max_it" not in options.given():
                most = min(self._most_linear, QUICK_LINEAR) if quick else self._most_linear
                self.snes.getKSP().setTolerances(max_it=most)
            self._predict(u)
            self.snes.solve(None, self._x)
            reason = self.snes.getConvergedReason()
            record.linear_iterations += self.snes.getLinearSolveIterations()
            record.newton_iterations = 1 + self.snes.getIterationNumber()
            record.residual_scale = self._scale()
            if not record.residual_norms:  # a convergence test of the user's choice, or none
                record.residual_norms.append(self.snes.getFunctionNorm())
            solution = self._x.getArray(readonly=True).reshape(u.shape)
            if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH and self._assembler.at_rounding_floor(
                record.residual_norms[-1], solution
            ):
                record.rounding_floor, reason = True, 1
        if reason <= 0:
            raise self.failure(reason)
        return solution.copy(), record

    @contextmanager
    def recording(self) -> Iterator[SolveRecord]:
        """A new record. The seconds inside are its own; those of neither residual nor tangent count as `solve`."""
        start, seconds = clock.perf_counter(), self._assembler.timings.seconds
        elsewhere = sum(seconds[stage] for stage in ("residual", "tangent", "first_tangent"))
        self.record, self._near, self._quick, self.guess = SolveRecord(), False, False, None
        record = self.record
        try:
            yield record
        finally:
            record.seconds = clock.perf_counter() - start
            elsewhere -= sum(seconds[stage] for stage in ("residual", "tangent", "first_tangent"))
            seconds["solve"] += record.seconds + elsewhere

    def _predict(self, u: np.ndarray) -> None:
        """Set the initial guess of SNES."""
        a = self._assembler
        jump = np.where(a.constrained, a.prescribed - u, 0.0)
        self.tangent.update(u)
        rhs = -(a.unbalanced_force(u) + a.action(jump))
        self._before = self._unbalanced = self.norm(np.where(a.constrained, 0.0, rhs))
        longest = a.mpi.allreduce(float(np.abs(jump).max(initial=0.0)), MPI.MAX)
        reduction = min(LARGEST_FORCING, SMALLEST_ERROR * a.spacing / longest) if longest else LARGEST_FORCING
        self.guess = u
        guess = u + self.solve_linear(np.where(a.constrained, a.constraint_scale * jump, rhs), reduction)
        self.guess = np.where(a.constrained, a.prescribed, guess)
        self._x.getArray()[...] = self.guess.ravel()

    def norm(self, field: np.ndarray) -> float:
        """Euclidean norm of an owned field (collective)."""
        self._rhs.getArray()[...] = field.ravel()
        return self._rhs.norm()

    def solve_linear(self, rhs: np.ndarray, reduction: float = SMALLEST_RTOL) -> np.ndarray:
        """K^-1 rhs with the tangent of its last update, (owned, dim) (collective).

        Args:
            rhs: (owned, dim); s u_c on constrained entries.
            reduction: of the linear residual that is asked of a Krylov method, unless the user has asked.

        Raises:
            StepFailed: with the reason of KSP.
        """
        ksp = self.snes.getKSP()
        ksp.setOperators(self.tangent.operator, self.tangent.preconditioner)
        self._aim(reduction)
        self._rhs.getArray()[...] = rhs.ravel()
        ksp.solve(self._rhs, self._d)
        self.record.linear_iterations += ksp.getIterationNumber()
        if ksp.getConvergedReason() < 0:
            raise self.failure(PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE)
        self._judge_preconditioner()
        return self._d.getArray(readonly=True).reshape(rhs.shape).copy()

    def _linearise(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """SNES Jacobian, and how exactly it is to be solved."""
        a, history = self._assembler, self.record.residual_norms
        u = x.getArray(readonly=True).reshape(-1, a.dim)
        if not self._near or (len(history) > 1 and history[-1] > CONTRACTION * history[-2]):
            self.tangent.update(np.where(a.constrained, a.prescribed, u))
        if J not in (P, self.tangent.operator):
            J.assemble()  # with -snes_mf_operator, differences of the residual
        norm, (rtol, *_) = snes.getFunctionNorm(), snes.getTolerances()
        if norm > 0.0:
            forcing = 0.9 * (norm / self._before) ** 2 if self._before else LARGEST_FORCING
            self._aim(max(forcing, 0.3 * rtol * self._scale() / norm))
        self._before = norm

    def _scale(self) -> float:
        """What residuals are compared with: loads and reactions, and the forces that were out of balance where the new
        equilibrium is near; a body that has just come apart carries nothing."""
        return max(self._assembler.residual_scale(), self._unbalanced if self._near else 0.0)

    def _aim(self, reduction: float) -> None:
        """Ask the Krylov method for this reduction of the linear residual, unless the user has."""
        if self._inexact:
            self.snes.getKSP().setTolerances(rtol=min(max(reduction, SMALLEST_RTOL), LARGEST_FORCING))

    def _judge_preconditioner(self) -> None:
        """Have it made anew when the last linear solution took much longer than one did."""
        ksp = self.snes.getKSP()
        rtol, iterations = ksp.getTolerances()[0], ksp.getIterationNumber()
        if not iterations:
            return
        cost = iterations / max(-np.log10(max(rtol, 1e-16)), 1.0)
        self._cost = min(self._cost, cost)
        if cost > WORSE * self._cost + 1:
            self.tangent.renew_preconditioner()
            self._cost = np.inf

    def _converged(self, snes, iteration, norms):
        """SNES convergence test: relative to loads and reactions, and at the rounding floor."""
        if iteration:
            self._judge_preconditioner()
        size, step, norm = norms
        u = snes.getSolution().getArray(readonly=True).reshape(-1, self._assembler.dim)
        return self.verdict(norm, u, bool(iteration) and step < snes.getTolerances()[2] * size)

    def verdict(self, norm: float, u: np.ndarray, short: bool = False) -> int:
        """SNES's reason for ending at a residual of this norm, which goes to the record; 0 to go on (collective).

        Args:
            norm: of the last residual that the assembler has computed.
            u: (owned, dim) displacements it belongs to.
            short: whether the step that led there is below snes_stol.
        """
        reasons = PETSc.SNES.ConvergedReason
        rtol, atol, *_ = self.snes.getTolerances()
        history = self.record.residual_norms
        history.append(norm)
        if not np.isfinite(norm):
            return NOT_A_NUMBER
        if norm <= atol or norm == 0.0:
            return reasons.CONVERGED_FNORM_ABS
        if norm <= rtol * self._scale():
            return reasons.CONVERGED_FNORM_RELATIVE
        if short:
            return reasons.CONVERGED_SNORM_RELATIVE
        if len(history) > 1 and norm > 0.5 * history[-2] and self._assembler.at_rounding_floor(norm, u):
            self.record.rounding_floor = True
            return reasons.CONVERGED_FNORM_RELATIVE
        if self._quick and len(history) >= QUICK_ITERATIONS:
            return reasons.DIVERGED_MAX_IT
        return reasons.ITERATING

    def failure(self, reason: int) -> StepFailed:
        """What to raise for SNES's reason; the preconditioner is made anew at the next step."""
        self.tangent.renew_preconditioner()
        self._cost = np.inf
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


_numbers = itertools.count()
_alive: weakref.WeakSet[Newton] = weakref.WeakSet()


@atexit.register
def _destroy_all() -> None:
    """Before Python ends: PETSc would destroy what is left at its own end, and the operators of type python cannot be
    destroyed without Python."""
    for newton in sorted(_alive, key=lambda newton: newton.number):
        newton.destroy()
    gc.collect()
    PETSc.garbage_cleanup()


def _name(reasons: type, value: int) -> str:
    """PETSc's name of a converged reason."""
    return next((name for name, number in vars(reasons).items() if number == value), str(value))
