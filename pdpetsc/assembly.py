"""The assembler: residual and tangent of the whole body, assembled or as its action; where kernels meet PETSc."""

from functools import cached_property

import numpy as np
from numba import njit
from petsc4py import PETSc

from pdpetsc.loads.base import Constraint, Load
from pdpetsc.loads.traction import Traction
from pdpetsc.materials.base import Material
from pdpetsc.matrix import TangentMatrix
from pdpetsc.parallel import collective
from pdpetsc.particles import Particles
from pdpetsc.sparsity import Part, Sparsity, symmetrise, tangent_sparsity
from pdpetsc.support import rigid_motions
from pdpetsc.timings import Timings

ROUNDING_MARGIN = 10.0
"""A residual that no longer falls counts as converged below this many times its estimated rounding error."""

WORST_FLOOR = 1e-6
"""A residual above this fraction of loads and reactions is no equilibrium, however large the displacements that raise
its rounding error (those of a body that floats away). Where there are none, as in a rigid motion, the fraction is that
of the forces of a strain of as much again."""


class Assembler:
    """Equilibrium r(u) = dW/du - f_ext = 0 of materials and loads on distributed particles.

    Constrained entries are overwritten by their prescribed value before forces are evaluated, and their rows read
    r_c = s (u_c - prescribed), s a typical diagonal of the tangent: their columns are then exactly zero elsewhere and
    the tangent stays symmetric. Everything here is pure in u; `set_time` alone changes the loads.

    Args:
        particles: the distributed particles.
        materials: models, each on its own families.
        loads: constraints and forces on particles.
        tractions: on surfaces.
        timings: where the seconds of residuals and tangents are counted.
    """

    def __init__(
        self, particles: Particles, materials: list[Material], loads: list[Load], timings: Timings,
        tractions: list[Traction] = (),
    ):  # fmt: skip
        self.timings = timings
        self.particles = particles
        self.materials = materials
        self.tractions = tractions
        self._followers = [traction for traction in tractions if traction.follower]
        self.constraints = [load for load in loads if isinstance(load, Constraint)]
        self._forces = [load for load in loads if not isinstance(load, Constraint)]
        shape = (particles.owned, particles.dim)
        self.constrained = np.zeros(shape, bool)
        for constraint in self.constraints:
            self.constrained[constraint.entries] = True
        self.supported = self.constrained.copy()
        """Where displacements are prescribed by loads."""
        self._free = np.ones((particles.local, particles.dim))
        self._set_free()
        self.prescribed = np.zeros(shape)
        self._external = np.zeros(shape)
        self.constraint_scale = self._typical_diagonal()
        self.spacing = self.mpi.allreduce(float(particles.spacing[: particles.owned].sum())) / particles.count
        """Mean of the particles'."""
        self.unit_force = self.constraint_scale * self.spacing * particles.count**0.5
        """Norm of the forces of a strain of 1, in order of magnitude."""
        self._matrix: TangentMatrix | None = None
        self._sparsity: Sparsity | None = None
        self._filled = False
        self._square_scale = 0.0
        self._steady: np.ndarray | None = None

    @property
    def dim(self) -> int:
        return self.particles.dim

    @property
    def mpi(self):
        """The mpi4py communicator."""
        return self.particles.comm.tompi4py()

    @property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric."""
        return not self._followers and all(material.symmetric for material in self.materials)

    def _typical_diagonal(self) -> float:
        p = self.particles
        total = sum(
            (m.modulus * p.volume[m.families.center] / p.spacing[m.families.center] ** 2).sum() for m in self.materials
        )
        return self.mpi.allreduce(float(total)) / p.count

    def _set_free(self) -> None:
        self._free[: self.particles.owned] = ~self.constrained
        self.particles.exchange.forward(self._free)

    def hold(self, particles: np.ndarray, u: np.ndarray) -> None:
        """Keep the owned particles of a mask at displacements u, besides what loads prescribe, and no others
        (collective)."""
        self.constrained = self.supported | particles[:, None]
        self.prescribed[particles] = np.where(self.supported, self.prescribed, u)[particles]
        self._set_free()

    def set_time(self, time: float) -> None:
        """Prescribed values and external forces at a time (collective)."""
        fixed = [traction for traction in self.tractions if not traction.follower]
        with collective(self.mpi):
            for constraint in self.constraints:
                self.prescribed[constraint.entries] = constraint.values(time)
            for traction in self.tractions:
                traction.set_time(time)
        if self._steady is None:  # what does not depend on the time, once for all
            self._steady = self._forces_at(time, fixed, True)
        self._external[:] = self._steady + self._forces_at(time, fixed, False)

    def _forces_at(self, time: float, fixed: list[Traction], steady: bool) -> np.ndarray:
        """Forces on the owned particles of loads that do not depend on u, steady ones or the others (collective)."""
        force = np.zeros_like(self._external)
        with collective(self.mpi):
            for load in self._forces:
                if load.steady == steady:
                    load.add(time, force)
        chosen = [traction for traction in fixed if traction.steady == steady]
        return force + self._forces_of(chosen, np.zeros((self.particles.local, self.dim))) if chosen else force

    def _forces_of(self, tractions: list[Traction], u: np.ndarray) -> np.ndarray:
        """What tractions give the owned particles, (owned, dim), at local displacements (collective)."""
        force = np.zeros_like(u)
        for traction in tractions:
            traction.add_external(u, force)
        return self.particles.exchange.reverse_add(force)[: self.particles.owned]

    def unload(self) -> None:
        """No external forces, until the next `set_time`."""
        self._external[:] = 0
        for traction in self.tractions:
            traction.unload()

    def external_force(self, u: np.ndarray) -> np.ndarray:
        """External forces on the owned particles, (owned, dim), at owned displacements (collective)."""
        if not self._followers:
            return self._external
        return self._external + self._forces_of(self._followers, self.localise(u))

    def vector(self) -> PETSc.Vec:
        """A global vector with one entry for each displacement component."""
        n = self.dim
        return PETSc.Vec().createMPI(
            (self.particles.owned * n, self.particles.count * n), bsize=n, comm=self.particles.comm
        )

    def localise(self, owned: np.ndarray) -> np.ndarray:
        """(local, dim) array with the ghosts of an owned field."""
        field = np.empty((self.particles.local, *owned.shape[1:]))
        field[: self.particles.owned] = owned
        return self.particles.exchange.forward(field)

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        """dW/du on the owned particles, (owned, dim), of owned displacements."""
        return self._sum_of_families(u, "add_force")

    def _sum_of_families(self, owned: np.ndarray, method: str) -> np.ndarray:
        """What a method of the materials, given an owned field, adds up to on owned particles.

        Families without ghosts are evaluated while the exchanges are under way: one half before the others, while
        ghosts arrive, one after them, while what was added to ghosts travels to their owners.
        """
        p = self.particles
        field = np.empty((p.local, self.dim))
        field[: p.owned] = owned
        result = np.zeros_like(field)
        with p.exchange.forwarding(field):
            for material in self.materials:
                getattr(material, method)(field, result, 0, material.interior // 2)
        for material in self.materials:
            getattr(material, method)(field, result, material.interior)
        if method == "add_action":
            for follower in self._followers:
                follower.add_action(field, result)
        with p.exchange.adding(result):
            for material in self.materials:
                getattr(material, method)(field, result, material.interior // 2, material.interior)
        return result[: p.owned]

    def stored_energy(self, u: np.ndarray) -> float:
        """Of the body at owned displacements (collective)."""
        local = self.localise(u)
        return self.mpi.allreduce(float(sum(material.energy(local).sum() for material in self.materials)))

    def unbalanced_force(self, u: np.ndarray) -> np.ndarray:
        """dW/du - f_ext before the constraints; on constrained entries this is the reaction of the support."""
        return self._balance(u)[0]

    def _balance(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """dW/du - f_ext, and f_ext."""
        external = self.external_force(u)
        return self.internal_force(u) - external, external

    def residual_array(self, u: np.ndarray) -> np.ndarray:
        """r(u) on the owned particles, (owned, dim)."""
        r, external = self._balance(np.where(self.constrained, self.prescribed, u))
        self._square_scale = float((external**2).sum() + (r[self.constrained] ** 2).sum())
        r[self.constrained] = self.constraint_scale * (u - self.prescribed)[self.constrained]
        return r

    def residual_scale(self) -> float:
        """sqrt(|f_ext|^2 + |reactions|^2) at the last residual: what a residual is compared with (collective)."""
        return self.mpi.allreduce(self._square_scale) ** 0.5

    def residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """SNES function."""
        with self.timings("residual"):
            r = self.residual_array(x.getArray(readonly=True).reshape(-1, self.dim))
            f.getArray()[...] = r.ravel()

    def at_rounding_floor(self, norm: float, u: np.ndarray) -> bool:
        """Whether a residual of this norm, the last one, is rounding alone and cannot be reduced (collective).

        It is compared with machine precision times the terms that cancel in it.
        """
        if norm > WORST_FLOOR * max(self.residual_scale(), WORST_FLOOR * self.unit_force):
            return False
        local = self.localise(u)
        scale = np.zeros(self.particles.local)
        for material in self.materials:
            material.add_force_scale(local, scale)
        scale = self.particles.exchange.reverse_add(scale)[: self.particles.owned]
        rounding = np.finfo(float).eps * self.mpi.allreduce(float((scale**2).sum())) ** 0.5
        return norm <= ROUNDING_MARGIN * rounding

    def linearise(self, u: np.ndarray) -> None:
        """Prepare `action`, `diagonal` and the assembled tangent at owned displacements."""
        local = self.localise(u)
        for element in (*self.materials, *self._followers):
            element.linearise(local)

    def action(self, du: np.ndarray) -> np.ndarray:
        """K du of the last `linearise` on owned particles, without constraints (columns and rows complete)."""
        return self._sum_of_families(du, "add_action")

    def constrained_action(self, du: np.ndarray) -> np.ndarray:
        """The same as the assembled tangent has it: constrained entries move nothing and have rows s du_c."""
        result = self.action(np.where(self.constrained, 0.0, du))
        result[self.constrained] = self.constraint_scale * du[self.constrained]
        return result

    def diagonal(self) -> np.ndarray:
        """Diagonal blocks of the constrained tangent of the last `linearise`, (owned, dim, dim)."""
        p, dim = self.particles, self.dim
        blocks = np.zeros((p.local, dim, dim))
        for element in (*self.materials, *self._followers):
            element.add_diagonal(blocks)
        blocks = p.exchange.reverse_add(blocks)[: p.owned]
        free = self._free[: p.owned]
        blocks *= free[:, :, None] * free[:, None, :]
        blocks[:, range(dim), range(dim)] += (1 - free) * self.constraint_scale
        return blocks

    def row_sums(self) -> np.ndarray:
        """Bounds of the sums of the absolute entries of the unconstrained tangent's rows at the last `linearise`,
        (owned, dim), followers left out (collective). With masses m, omega^2 <= max(row_sums/m) (Gershgorin)."""
        p = self.particles
        sums = np.zeros((p.local, self.dim))
        for material in self.materials:
            material.add_row_sums(sums)
        return p.exchange.reverse_add(sums)[: p.owned]

    def matrix(self) -> PETSc.Mat:
        """The PETSc matrix of the tangent, its pattern made on first use."""
        if self._matrix is None:
            with self.timings("first_tangent"):
                alone = np.full(self.particles.local, -1, np.int32)  # points of surfaces are no particles
                self._sparsity, self._matrix = self.new_matrix(
                    [Part(m.network, m.dual, m.own, m.couples_family) for m in self.materials]
                    + [Part(f.surface.families, f.surface.dual, alone, True) for f in self._followers]
                )
        return self._matrix.mat

    def new_matrix(self, parts: list[Part]) -> tuple[Sparsity, TangentMatrix]:
        """A matrix on all displacements with the pattern of these parts, for `fill`."""
        sparsity = tangent_sparsity(self.particles, parts)
        matrix = TangentMatrix(self.particles, sparsity)
        if self.rigid_body_modes.getVecs():  # multigrid does not take none
            matrix.mat.setNearNullSpace(self.rigid_body_modes)
        return sparsity, matrix

    def fill(self, sparsity: Sparsity, matrix: TangentMatrix, contributions: list, symmetric: bool) -> None:
        """Replace a matrix by the sum of contributions(row_offsets, columns, blocks, upper), constrained."""
        blocks = sparsity.zero_blocks(self.dim)
        for add_rows in contributions:
            add_rows(sparsity.row_offsets, sparsity.columns, blocks, symmetric)
        if symmetric:
            index = self.particles.global_index
            symmetrise(sparsity.row_offsets, sparsity.columns, index, np.argsort(index), blocks)
        _constrain(
            sparsity.row_offsets, sparsity.columns, self._free, self.particles.owned, self.constraint_scale, blocks
        )
        matrix.fill(sparsity.reverse_add(blocks))
        matrix.mat.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)

    def assemble(self, u: np.ndarray) -> PETSc.Mat:
        """Fill the matrix at owned displacements."""
        mat = self.matrix()
        with self.timings("tangent" if self._filled else "first_tangent"):
            self.linearise(u)
            self.fill(
                self._sparsity, self._matrix, [e.add_rows for e in (*self.materials, *self._followers)], self.symmetric
            )
            self._filled = True
        return mat

    @cached_property
    def rigid_body_modes(self) -> PETSc.NullSpace:
        """Translations and rotations, zero on constrained entries, orthonormal: the near-nullspace for multigrid."""
        p = self.particles
        X = p.position[: p.owned]
        modes, _ = rigid_motions(X)
        vectors = []
        for mode in np.moveaxis(modes, -1, 0):
            vector = self.vector()
            vector.getArray()[...] = np.where(self.constrained, 0.0, mode).ravel()
            before = vector.norm()
            for _ in range(2):  # Gram-Schmidt twice is enough
                for other in vectors:
                    vector.axpy(-vector.dot(other), other)
            if vector.norm() > 1e-8 * before:
                vector.normalize()
                vectors.append(vector)
        return PETSc.NullSpace().create(vectors=vectors, comm=p.comm)


@njit(cache=True)
def _constrain(row_offsets, columns, free, owned, scale, blocks):
    """Zero the rows and columns of constrained entries and put `scale` on their diagonal."""
    dim = free.shape[1]
    for a in range(len(row_offsets) - 1):
        for k in range(row_offsets[a], row_offsets[a + 1]):
            b = columns[k]
            if b < 0:
                continue
            for p in range(dim):
                for q in range(dim):
                    blocks[k, p, q] *= free[a, p] * free[b, q]
                if a == b and a < owned and free[a, p] == 0.0:
                    blocks[k, p, p] = scale
