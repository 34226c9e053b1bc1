"""The compact stiffness: springs between nearest particles that stand in for the tangent in a preconditioner.

A peridynamic tangent couples a particle with all others within two horizons, several hundred in 3D. For multigrid, a
body of springs to the nearest particles is as good where waves are long: it has the same rigid motions, cracks and
holes, and about the same stiffness. Every family gets springs k along its bonds of up to 1.5 spacings, with

    sum k |xi|^2 = n (n + 2) mu_c,    mu_c = sqrt(mu (lambda + 2 mu)/3),    k ~ |xi|^(2 (n - 3)),

which on a square or cubic lattice is the isotropic solid with lambda = mu = mu_c (every other bond-network has that
Poisson's ratio): mu_c is the geometric mean of those that are right for shear and for pressure waves. Springs lie
along the current bonds, and stretched or not they only resist stretching, so that the matrix is positive definite
whatever the state. Where no bonds of a family resist every strain (a horizon of one spacing on a lattice) its springs
resist being turned, too, with a third of their stiffness.

Short waves are another thing. The tangent T of a horizon delta does not grow beyond wave numbers of 1/delta, while the
compact stiffness C goes on as k^2: 1/T = 1/C + 1/D, with D about three times the tangent's diagonal blocks, follows
both ends. That sum is the preconditioner (`solvers.tangent`): 19 to 23 iterations of CG where 1/C alone takes 29 (LPS)
or 46 (correspondence), in 2D and 3D.
"""

import numpy as np
from numba import njit

from pdpetsc.assembly import Assembler
from pdpetsc.bonds import Families
from pdpetsc.materials import families as kernels
from pdpetsc.materials import rows, sums
from pdpetsc.materials.ordinary_kernels import Extensions, ExtensionTangent, resist_strain
from pdpetsc.sparsity import Part

REACH = 1.5
"""Length of the longest springs, in spacings: 8 neighbours in 2D and 18 in 3D."""

SHARE = 0.3
"""Part of the inverse diagonal blocks in the preconditioner, 1/D = 0.3 diag(T)^-1; 0.2 to 0.5 are as good."""

SIDEWAYS = 0.3
"""Part of their stiffness that the springs of a mechanism have across their direction."""

WEAK = 1e-3
"""Part of its stiffness that the spring of a broken bond keeps."""

SMALLEST_STIFFNESS = 1e-3
"""Least eigenvalue of a diagonal block that is believed, relative to its largest."""


class CompactStiffness:
    """The compact stiffness of a body as a matrix with a pattern of its own, `mat`.

    Args:
        assembler: of the body.
    """

    def __init__(self, assembler: Assembler):
        self._assembler = assembler
        p = assembler.particles
        self._D = kernels.dimension(p.dim)
        self._springs = [self._network(material) for material in assembler.materials]
        parts = []
        for material, (families, *_) in zip(assembler.materials, self._springs):
            parts.append(Part(families, families.dual(p.local), material.own, False))
        self._duals = [part.dual for part in parts]
        self._sparsity, self._matrix = assembler.new_matrix(parts)
        self.mat = self._matrix.mat

    def _network(self, material) -> tuple[Families, np.ndarray, np.ndarray, np.ndarray]:
        """Short bonds of a material's families and their numbers among all, stiffness of the springs along their
        directions and across."""
        p, D = self._assembler.particles, self._D
        bonds = material.families.center, material.families.offsets, material.families.neighbours
        reach = REACH * p.spacing[material.families.center]
        resists = np.empty(len(reach), bool)
        for _ in range(2):
            offsets, neighbours, short = _short_bonds(*bonds, p.position, reach)
            families = Families(bonds[0], offsets, neighbours)
            network = bonds[0], families.offsets, families.neighbours
            k = families.lengths(p.position) ** (2 * (p.dim - 3))
            resist_strain(D, *network, p.position, k, resists)
            if resists.all():
                break
            reach[~resists] = np.inf  # too few: all bonds of the family
        total = p.dim * (p.dim + 2) * (material.shear * material.modulus / 3) ** 0.5 if p.dim > 1 else material.modulus
        sums.scale_to(D, p.position, *network, k, 2, np.full(len(families), total))
        return families, short, k, k * np.repeat(np.where(resists, 0.0, SIDEWAYS), np.diff(families.offsets))

    def _present(self, material, families: Families, short: np.ndarray, k: np.ndarray, sideways: np.ndarray) -> tuple:
        """The springs with the bonds that are left: what is broken is weak but there, so that nothing is ever loose,
        and where bonds are missing the others resist being turned, too."""
        if material.intact is None:
            return k, sideways
        intact = material.intact[short]
        hurt = np.repeat(families.sums((~intact).astype(float)) > 0, np.diff(families.offsets))
        present = np.where(intact, k, WEAK * k)
        return present, np.where(hurt, SIDEWAYS * present, sideways)

    def fill(self, u: np.ndarray) -> None:
        """Springs along the bonds at owned displacements (collective)."""
        a = self._assembler
        local = a.localise(u)
        x = a.particles.position + local
        contributions = [
            lambda *target, material=material, springs=springs, dual=dual: self._add_rows(
                x, springs[0], material.own, *self._present(material, *springs), dual, *target
            )
            for material, springs, dual in zip(a.materials, self._springs, self._duals)
        ]
        a.fill(self._sparsity, self._matrix, contributions, True)

    def _add_rows(self, x, families, own, k, sideways, dual, row_offsets, columns, blocks, upper) -> None:
        """Springs in linear kinematics from the positions x: k n n + sideways (I - n n)."""
        dim, none = len(self._D), np.empty(0)
        data, tangent = Extensions(k - sideways, none, None, False, True), ExtensionTangent(none)
        bonds = families.center, families.offsets, families.neighbours
        empty = np.empty((0, dim))
        element = np.empty((families.bonds, dim, dim)), empty, empty, empty, empty
        rows.elements(self._D, data, tangent, x, *bonds, x, False, *element)
        element[0][:, range(dim), range(dim)] += sideways[:, None]
        rows.add_rows(
            self._D, data, tangent, *bonds, self._assembler.particles.volume, own, dual.offsets, dual.family, dual.bond,
            *element, False, upper, row_offsets, columns, blocks,
        )  # fmt: skip


def short_wave_inverse(assembler: Assembler) -> np.ndarray:
    """1/D: a share of the inverse diagonal blocks (symmetric part) of the tangent of the last `linearise`, without
    constrained entries, (owned, dim, dim)."""
    blocks = assembler.diagonal()
    blocks[~np.isfinite(blocks).all(axis=(1, 2))] = np.eye(assembler.dim)  # the residual there is not finite either
    values, vectors = np.linalg.eigh((blocks + blocks.transpose(0, 2, 1)) / 2)
    floor = SMALLEST_STIFFNESS * np.abs(values).max(axis=1, initial=0.0, keepdims=True)
    values = SHARE / np.maximum(np.abs(values), floor)
    inverse = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
    inverse[assembler.constrained] = 0.0  # the compact matrix has their rows as they are
    return inverse


@njit(cache=True)
def multiply_blocks(blocks, x, y):
    """y = blocks x, particle by particle."""
    for i in range(len(blocks)):
        for p in range(blocks.shape[1]):
            total = 0.0
            for q in range(blocks.shape[1]):
                total += blocks[i, p, q] * x[i, q]
            y[i, p] = total


@njit(cache=True)
def _short_bonds(center, offsets, neighbours, X, reach):
    """Offsets, neighbours and numbers of the bonds that are no longer than each family's reach."""
    kept_offsets = np.zeros(len(offsets), np.int64)
    kept, number = np.empty(0, np.int32), np.empty(0, np.int64)
    for filling in range(2):
        n = 0
        for f in range(len(center)):
            for b in range(offsets[f], offsets[f + 1]):
                square = 0.0
                for p in range(X.shape[1]):
                    square += (X[neighbours[b], p] - X[center[f], p]) ** 2
                if square <= reach[f] * reach[f]:
                    if filling:
                        kept[n] = neighbours[b]
                        number[n] = b
                    n += 1
            kept_offsets[f + 1] = n
        if not filling:
            kept, number = np.empty(n, np.int32), np.empty(n, np.int64)
    return kept_offsets, kept, number
