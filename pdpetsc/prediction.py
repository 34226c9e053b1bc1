"""What a run of a case will take, told before anything of the body's size is made."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from pdpetsc import options
from pdpetsc.case import Case
from pdpetsc.census import FULL, Census, Effort, take_census
from pdpetsc.errors import InputError
from pdpetsc.loads.building import follows
from pdpetsc.memory import GIB
from pdpetsc.solvers.linear import DIRECT, default_options, in_words
from pdpetsc.solvers.tangent import KINDS, OPTION, choose, direct_limit

MARGIN = 1.1
"""A case is refused only when it takes this many times what there is."""

# Memory. Fitted to `peak_memory_mb` of one load step with PETSc 3.18 (32-bit indices), commit 11e8452: cubes of 20^3,
# 30^3, 40^3, 60^3 and a square of 200^2 particles, horizon 3.015 spacings, models ordinary, correspondence and bond,
# on 1 and 2 ranks; docs/solvers.md ("How large may it be?") has the comparison.
PROCESS, BUFFERS = 217 * 2.0**20, 15 * 2.0**20
"""Bytes of a rank before it holds anything: Python, its modules (156 MiB from the start), kernels; and what MPI takes
where there are several ranks."""

IMPORTED = 150 * 2.0**20
"""Part of `PROCESS` that has been taken when a case is checked."""

PARTICLE = 800
"""Bytes of a particle: position, horizon ..., sets, displacements, PETSc's vectors; besides 8 dim^4 for a tensor."""

BOND, FOLDED = 28, 8
"""Bytes of a bond: neighbour (4), weight, the material's constant and a temporary (8 each); besides, where families do
not couple their bonds, those of the network in which two opposite bonds are one."""

ENTRY = 20
"""Bytes of a stored entry of a matrix: value and index in AIJ (12), the value again in the blocks that are added up."""

MULTIGRID = {"assembled": (9, 11), "matrix_free": (8, 35)}
"""More of them for algebraic multigrid, on one rank and on several: the pattern's columns, coarser levels, smoothers,
products of matrices on the way to a coarser level, which PETSc makes in other ways on several ranks."""


@dataclass(frozen=True)
class Prediction:
    """What a run takes.

    Attributes:
        dim: of the body.
        particles, exact: their number, and whether all were counted.
        bonds: directed bonds; `most` of them in the largest family seen.
        blocks: (dim x dim) of the assembled tangent, `compact` those of the compact stiffness.
        ranks: on which the body is distributed.
        kind: of the tangent, "assembled" or "matrix_free", and the `reason`.
        solver: the linear solver in words.
        memory: bytes on each rank, by kind of tangent.
        time_step: estimate of the largest stable step of explicit dynamics [time]; None without densities.
        without_density: the materials that have none.
        forced: whether -pd_tangent names the tangent.
    """

    dim: int
    particles: int
    exact: bool
    bonds: float
    most: int
    blocks: float
    compact: float
    ranks: int
    kind: str
    reason: str
    solver: str
    memory: dict[str, float]
    time_step: float | None
    without_density: tuple[str, ...]
    forced: bool

    @property
    def entries(self) -> dict[str, float]:
        """Stored entries of the matrix that each kind of tangent needs."""
        return {"assembled": self.blocks * self.dim**2, "matrix_free": self.compact * self.dim**2}


def _softens(case: Case, census: Census) -> bool:
    """Whether bonds soften in a family that couples its neighbours, whose tangent is not symmetric then."""
    fading = (name for name, keys in case.damage.items() if getattr(keys, "softening", None))
    return any(census.materials[name].couples_family for name in fading if name in census.materials)


def predict(case: Case, ranks: int, effort: Effort = FULL) -> Prediction:
    """Predict a run on so many ranks.

    Raises:
        InputError: there is no such body, or an option is wrong.
    """
    try:
        census = take_census(case, effort)
        given, dim = options.given(), case.body.dim
        choice = choose(dim, census.particles, census.blocks, given, bool(case.damage))
    except InputError as error:
        raise type(error)(f"{case.path}: {str(error).removeprefix(f'{case.path}: ')}") from None
    materials = census.materials.values()
    follower = any(follows(load, materials) for load in case.load)
    symmetric = all(material.symmetric for material in materials) and not (follower or _softens(case, census))
    small = census.blocks * dim**2 <= direct_limit(dim, bool(case.damage))
    definite = case.solver.control == "load"
    solvers = {k: {**default_options(k == "matrix_free", small, symmetric, ranks, definite), **given} for k in KINDS}
    without = tuple(name for name, spec in case.material.items() if spec.density is None)
    return Prediction(
        dim, census.particles, census.exact, census.bonds, census.most, census.blocks, census.compact, ranks,
        choice.kind, choice.why, _in_words(solvers[choice.kind]),
        {k: _memory(census, dim, ranks, k, solvers[k]) for k in KINDS},
        None if without else stable_time_step(case, census), without, OPTION in given,
    )  # fmt: skip


def _in_words(chosen: Mapping) -> str:
    package = chosen.get("pc_factor_mat_solver_type") if chosen["pc_type"] in ("lu", "cholesky") else None
    return in_words(chosen.get("ksp_type", "gmres"), chosen["pc_type"], package)


def _memory(census: Census, dim: int, ranks: int, kind: str, solver: Mapping) -> float:
    """Bytes on each rank."""
    folded = all(not material.couples_family for material in census.materials.values())
    body = census.bonds * (BOND + FOLDED * folded) + census.particles * (PARTICLE + 8 * dim**4)
    blocks = census.blocks if kind == "assembled" else census.compact
    direct = solver["pc_type"] in DIRECT
    entry = ENTRY - 4 + np.dtype(PETSc.IntType).itemsize
    entry += factor_bytes(dim, census.particles, blocks) if direct else MULTIGRID[kind][ranks > 1]
    copies = ranks if solver["pc_type"] == "redundant" else 1
    return PROCESS + BUFFERS * (ranks > 1) + (body + blocks * dim**2 * entry * copies) / ranks


def factor_bytes(dim: int, particles: int, blocks: float) -> float:
    """Bytes of MUMPS' factors and working space for each stored entry of a matrix.

    Nested dissection fills n/b points of b particles, a row of the matrix having about 2^dim b blocks, with
    log2(n/b) (2D) or (n/b)^(1/3) (3D) times their entries (George 1973); the factors 7 and 13 are measured.
    """
    points = max(2.0, 2**dim * particles**2 / blocks)
    return {1: 40.0, 2: 7 * math.log2(points), 3: 13 * points ** (1 / 3)}[dim]


def stable_time_step(case: Case, census: Census) -> float | None:
    """A safe estimate of the largest stable time step of central differences [time].

    dt = sqrt(2 rho / sum_j C_j), C_j the stiffness of a bond times the neighbour's volume (Silling and Askari 2005,
    Eq. 27, for bond-based materials): there rho omega^2 <= 2 sum C_j. In a bond-based solid of P-wave modulus M that
    is sum C_j |xi_j|^2 = 2 n (n + 2) M/3 in n dimensions, and with C_j ~ w V/|xi| (a constant micromodulus)

        sum C_j = 2/3 n (n + 2) M  sum w V/|xi| / sum w V |xi|,

    in 3D and the continuum 20 M/delta^2. It stands for all models, whose wave speeds are those of M too: the least of
    the sampled families is taken.
    """
    n = case.body.dim
    rates = [
        2 / 3 * n * (n + 2) * material.modulus * census.shortness[name] / case.material[name].density
        for name, material in census.materials.items()
    ]
    return math.sqrt(2 / max(rates)) if rates else None


def check_fits(p: Prediction, available: float | None) -> None:
    """Refuse what cannot be: more entries than PETSc's integers count, or more memory than is there.

    Args:
        p: of the case, on the present ranks.
        available: bytes that each rank can still take; None where that is not known.

    Raises:
        InputError: in one sentence, with the remedy.
    """
    place = f"on each of {p.ranks} ranks" if p.ranks > 1 else "on its one rank"
    name = {"assembled": "assembled tangent", "matrix_free": "compact matrix"}[p.kind]
    remedy = f"-{OPTION} matrix_free{' (or leave that option out)' if p.forced else ''}, "
    entries, integers = p.entries[p.kind] / p.ranks, np.iinfo(PETSc.IntType)
    if entries > MARGIN * integers.max:
        lighter = remedy if p.kind == "assembled" else ""
        raise InputError(
            f"the {name} of this case has about {entries:.2g} entries {place}, more than this PETSc's "
            f"{integers.bits}-bit integers can count; use {lighter}more ranks, or a PETSc configured with 64-bit "
            "indices"
        )
    too_large = {k: available is not None and m - IMPORTED > MARGIN * available for k, m in p.memory.items()}
    if too_large[p.kind]:
        lighter = "" if too_large["matrix_free"] else remedy
        raise InputError(
            f"this case needs about {p.memory[p.kind] / GIB:.2g} GiB {place} with the tangent "
            f"{p.kind.replace('_', '-')}, but only {available / GIB:.2g} GiB are free for each; use {lighter}"
            "more machines, or a larger spacing"
        )


def report(p: Prediction, units, available: float | None) -> str:
    """The prediction for people, in lines of a name and what is known; `available` bytes for all ranks together."""
    about = "" if p.exact else "about "
    entries, memory = p.entries, {kind: bytes / GIB for kind, bytes in p.memory.items()}
    ranks = f"on each of {p.ranks} ranks" if p.ranks > 1 else "on one rank"
    step = f"up to about {p.time_step or 0:.3g} {units.time} in explicit dynamics"
    machine = "unknown" if available is None else f"{available / GIB:.3g} GiB, shared by the ranks on it"
    rows = {
        "dimension": str(p.dim),
        "particles": f"{about}{p.particles}",
        "bonds": f"about {p.bonds:.4g}, directed; {p.bonds / p.particles:.1f} neighbours each, {p.most} at most",
        "entries": f"{entries['assembled']:.3g} of the assembled tangent, {entries['matrix_free']:.3g} of the compact "
        "matrix",
        "tangent": f"{p.kind.replace('_', '-')}, {p.reason}",
        "solver": p.solver,
        "memory": f"{memory['assembled']:.3g} GiB assembled, {memory['matrix_free']:.3g} GiB matrix-free, {ranks}",
        "available": machine,
    } | ({} if p.time_step is None else {"time step": step})  # static cases give no density
    return "\n".join(f"{name:11}{text}" for name, text in rows.items())
