"""Which linear solver fits a problem: defaults for PETSc's options database, where what the user gives wins."""

from petsc4py import PETSc

from pdpetsc import options

DIRECT_LIMIT = {1: 50e6, 2: 4e6, 3: 1.5e6}
"""Stored entries of the tangent up to which a direct solver is the default, by dimension. It takes about a second
there; iterative ones are faster long before (docs/performance.md), but it is exact and does not mind the state."""

SMALLEST_RTOL = 1e-8
"""Reduction of a linear residual that is asked for at most."""

GMRES_RESTART = 100
"""PETSc's own 30 stagnate on slender bodies; each direction costs the memory of a vector."""


DIRECT = ("lu", "cholesky", "redundant")
"""Preconditioners that solve."""

ADDITIVE = {
    "pc_type": "composite", "pc_composite_type": "additive", "pc_composite_pcs": "gamg,python",
    "sub_1_pc_python_type": "pdpetsc.solvers.tangent.ShortWaves", "sub_0_pc_gamg_reuse_interpolation": "true",
    "sub_0_pc_use_amat": "false",
}  # fmt: skip
"""The preconditioner of a matrix-free tangent (compact.py); its smoothers take the compact matrix, too."""


def default_options(
    compact: bool, direct: bool, symmetric: bool, ranks: int, definite: bool = True
) -> dict[str, str | float]:
    """Return defaults for -ksp_type, -pc_type and what belongs to them.

    A direct solver is MUMPS where this PETSc has it, PETSc's own LU on one rank, a redundant LU on several. Others are
    CG (GMRES where the tangent is unsymmetric or indefinite) with algebraic multigrid on the rigid-body modes, of the
    tangent itself or of the compact stiffness. When the user names a preconditioner, the Krylov method follows that
    choice.

    Args:
        compact: whether the preconditioner's matrix is the compact stiffness.
        direct: whether a direct solver suits the problem.
        symmetric: whether the tangent is.
        ranks: how many.
        definite: whether a symmetric tangent is positive definite; MUMPS's Cholesky, L D L^T, does not need that.
    """
    given = options.given()
    defaults: dict[str, str | float] = {}
    if "pc_type" not in given:
        if compact:
            defaults |= ADDITIVE
        elif not direct:
            defaults["pc_type"] = "gamg"
        elif PETSc.Sys.hasExternalPackage("mumps"):
            defaults |= {"pc_type": "cholesky" if symmetric else "lu", "pc_factor_mat_solver_type": "mumps"}
        else:
            defaults["pc_type"] = "lu" if ranks == 1 else "redundant"
    chosen = defaults | given
    if chosen["pc_type"] in DIRECT and chosen.get("pc_factor_mat_solver_type") == "mumps":
        defaults["mat_mumps_icntl_14"] = 50  # room for fill-in by pivoting [%]
    if chosen["pc_type"] in DIRECT and not compact:
        defaults["ksp_type"] = "preonly"
    else:
        defaults |= {"ksp_rtol": SMALLEST_RTOL, "ksp_max_it": 2000}
        krylov = given.get("ksp_type", "cg" if symmetric and definite else "gmres")
        if krylov in ("cg", "gmres"):
            defaults |= {"ksp_type": krylov, "ksp_norm_type": "unpreconditioned"}
        if krylov == "gmres":
            defaults |= {"ksp_pc_side": "right", "ksp_gmres_restart": GMRES_RESTART}
        if chosen["pc_type"] == "gamg":
            defaults["pc_gamg_reuse_interpolation"] = "true"  # the tangent changes little between iterations
    return defaults


def describe_linear_solver(ksp: PETSc.KSP) -> str:
    """In words, for people: "preonly + cholesky (mumps)"."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky") else None
    return in_words(ksp.getType(), pc.getType(), package)


def in_words(krylov: str, preconditioner: str, package: str | None = None) -> str:
    """The names of PETSc's methods for people; `composite` is taken for our own."""
    if preconditioner == "composite":
        preconditioner = "gamg of nearest springs"
    return f"{krylov} + {preconditioner}" + (f" ({package})" if package else "")
