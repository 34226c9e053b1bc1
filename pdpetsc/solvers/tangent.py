"""The tangent as PETSc operators: assembled, or as an action with a compact matrix for the preconditioner."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.compact import CompactStiffness, multiply_blocks, short_wave_inverse
from pdpetsc.errors import InputError
from pdpetsc.solvers.linear import DIRECT, DIRECT_LIMIT

OPTION = "pd_tangent"
KINDS = ("assembled", "matrix_free")

MATRIX_FREE_GAIN = 3
"""The tangent is not assembled where the compact matrix has this many times fewer entries."""

MANY = 10
"""Where there are many solutions, a direct solver is the default for a tangent this many times smaller: it pays for
being simple with 5 to 10 times the time of iterations (docs/performance.md)."""

COMPACT_BLOCKS = {1: 3, 2: 9, 3: 19}
"""Blocks in a row of the compact matrix, on lattices."""


class AssembledTangent:
    """All entries of the tangent in one AIJ matrix, which preconditions itself."""

    kind = "assembled"

    def __init__(self, assembler: Assembler):
        self._assembler = assembler
        self.operator = self.preconditioner = assembler.matrix()

    def update(self, u: np.ndarray) -> None:
        """Linearise at owned displacements, (owned, dim)."""
        self._assembler.assemble(u)

    def add_diagonal(self, diagonal: np.ndarray) -> None:
        """Add to the diagonal of the last update, (owned, dim)."""
        vector = self._assembler.vector()
        vector.getArray()[...] = diagonal.ravel()
        self.operator.setDiagonal(vector, PETSc.InsertMode.ADD_VALUES)
        self.operator.assemble()

    def renew_preconditioner(self) -> None:
        """At the next update; here that happens anyway."""

    def destroy(self) -> None:
        """The matrix stays with the assembler."""


class MatrixFreeTangent:
    """The analytic action of the tangent, O(bonds) and nothing stored per bond, as a PETSc matrix of type python, and
    the compact stiffness of the state in which the preconditioner was last made."""

    kind = "matrix_free"

    def __init__(self, assembler: Assembler):
        self._assembler = assembler
        with assembler.timings("first_tangent"):
            self._compact = CompactStiffness(assembler)
        self.preconditioner = self._compact.mat
        self._action = (SymmetricAction if assembler.symmetric else Action)(assembler)
        size, comm = self.preconditioner.getSizes(), assembler.particles.comm
        self.operator = PETSc.Mat().createPython(size, context=self._action, comm=comm)
        self.operator.setBlockSize(assembler.dim)
        self.operator.setOption(PETSc.Mat.Option.SYMMETRIC, assembler.symmetric)
        self.operator.setUp()
        self._stale, self._fresh = True, False
        self._filled = False

    def update(self, u: np.ndarray) -> None:
        """Linearise at owned displacements; the preconditioner stays as it is unless it is to be renewed."""
        with self._assembler.timings("tangent" if self._filled else "first_tangent"):
            self._assembler.linearise(u)
            if self._stale:
                self._compact.fill(u)
                self._action.short_waves = short_wave_inverse(self._assembler)
                self._stale, self._fresh = False, True
            self._filled = True
        self.operator.assemble()

    def add_diagonal(self, diagonal: np.ndarray) -> None:
        """Add to the diagonal of the last update, (owned, dim); the preconditioner has that of its own state."""
        self._action.diagonal = diagonal
        if self._fresh:
            vector = self._assembler.vector()
            vector.getArray()[...] = diagonal.ravel()
            self.preconditioner.setDiagonal(vector, PETSc.InsertMode.ADD_VALUES)
            self.preconditioner.assemble()
            self._fresh = False

    def renew_preconditioner(self) -> None:
        """At the next update."""
        self._stale = True

    def destroy(self) -> None:
        """Give back PETSc's memory (collective)."""
        self.operator.destroy()
        self.preconditioner.destroy()


class Action:
    """Context of the matrix: K of the last linearisation. `short_waves` are the inverse diagonal blocks for the
    preconditioner, of the state in which that was made."""

    def __init__(self, assembler: Assembler):
        self._assembler = assembler
        self.short_waves = np.empty((0, assembler.dim, assembler.dim))
        self.diagonal: np.ndarray | None = None
        """Of inertia, where there is any."""

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = K x."""
        dim = self._assembler.dim
        du = x.getArray(readonly=True).reshape(-1, dim)
        result = self._assembler.constrained_action(du)
        if self.diagonal is not None:
            result += self.diagonal * du
        y.getArray()[...] = result.ravel()

    def getDiagonal(self, mat: PETSc.Mat, y: PETSc.Vec) -> None:
        """Diagonal of K."""
        diagonal = np.einsum("npp->np", self._assembler.diagonal())
        y.getArray()[...] = (diagonal if self.diagonal is None else diagonal + self.diagonal).ravel()


class SymmetricAction(Action):
    """One that is its own transpose."""

    def multTranspose(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self.mult(mat, x, y)


class ShortWaves:
    """PCPYTHON: what the compact stiffness leaves out, y = 0.3 diag(K)^-1 x (compact.py)."""

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        blocks = pc.getOperators()[0].getPythonContext().short_waves
        dim = blocks.shape[-1]
        multiply_blocks(blocks, x.getArray(readonly=True).reshape(-1, dim), y.getArray().reshape(-1, dim))

    def applyTranspose(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self.apply(pc, x, y)


class Choice(NamedTuple):
    """Of the tangent and its solver.

    Attributes:
        kind: one of KINDS.
        direct: whether a direct solver is the default.
        why: in words.
    """

    kind: str
    direct: bool
    why: str


def direct_limit(dim: int, many: bool) -> float:
    """Entries of the assembled tangent up to which a direct solver is the default."""
    return DIRECT_LIMIT[dim] / (MANY if many else 1)


def choose(dim: int, particles: int, blocks: float, given: Mapping[str, str], many: bool = False) -> Choice:
    """As -pd_tangent says, or else as suits the problem: assembled for a direct solver and where neighbours are few,
    matrix-free elsewhere.

    Args:
        dim: of the body.
        particles: on all ranks.
        blocks: (dim x dim) that the assembled tangent would have, the same on any number of ranks.
        given: PETSc options of the user.
        many: whether hundreds of solutions are to be expected, as where bonds fail one after the other.

    Raises:
        InputError: the option is neither "assembled" nor "matrix_free", or a preconditioner is to solve without a
            matrix.
    """
    limit = direct_limit(dim, many)
    small = blocks * dim**2 <= limit
    if OPTION in given:
        kind, why = given[OPTION] or "", f"as -{OPTION} says"
        if kind not in KINDS:
            raise InputError(f"-{OPTION}: is {kind!r}; choices: {', '.join(KINDS)}")
    elif given.get("pc_type") in DIRECT:
        kind, why = "assembled", f"as -pc_type {given['pc_type']} needs"
    elif "pc_type" not in given and small:
        kind, why = "assembled", f"for a direct solver, which is the choice up to {limit:.3g} entries"
    elif blocks < MATRIX_FREE_GAIN * COMPACT_BLOCKS[dim] * particles:
        kind, why = "assembled", f"since it has less than {MATRIX_FREE_GAIN} times the entries of the compact matrix"
    else:
        kind, why = "matrix_free", f"since it has more than {MATRIX_FREE_GAIN} times the entries of the compact matrix"
    if kind == "matrix_free" and given.get("ksp_type") == "preonly":
        raise InputError(
            "-ksp_type preonly: what preconditions a matrix-free tangent is another matrix, which does not solve; "
            f"add -{OPTION} assembled, or leave the option out"
        )
    return Choice(kind, kind == "assembled" and small, why)


def tangent(assembler: Assembler, kind: str) -> AssembledTangent | MatrixFreeTangent:
    """The tangent of that kind."""
    PETSc.Options().getString(OPTION, "")  # it has been looked at, whatever came of it
    return AssembledTangent(assembler) if kind == "assembled" else MatrixFreeTangent(assembler)
