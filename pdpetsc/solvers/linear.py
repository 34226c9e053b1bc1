"""Which linear solver fits a problem: defaults for PETSc's options database, which never override what is there."""

from petsc4py import PETSc

DIRECT_LIMIT = {1: 2_000_000, 2: 250_000, 3: 15_000}
"""Unknowns up to which a direct solver is the default, by dimension (docs/performance.md has the measurements)."""


def set_default(name: str, value) -> None:
    """Set an option unless the user has."""
    options = PETSc.Options()
    if not options.hasName(name):
        options.setValue(name, value)


def choose_linear_solver(comm, unknowns: int, dim: int, symmetric: bool) -> None:
    """Set defaults for -ksp_type, -pc_type and what belongs to them.

    Small problems are factorised: MUMPS where this PETSc has it, PETSc's own LU on one rank, a redundant LU on
    several. Larger ones take CG (GMRES where the tangent is unsymmetric) with algebraic multigrid on the rigid-body
    modes. When the user names a preconditioner, the Krylov method follows that choice.
    """
    options = PETSc.Options()
    direct = unknowns <= DIRECT_LIMIT[dim]
    if not options.hasName("pc_type"):
        if not direct:
            set_default("pc_type", "gamg")
        elif PETSc.Sys.hasExternalPackage("mumps"):
            set_default("pc_type", "cholesky" if symmetric else "lu")
            set_default("pc_factor_mat_solver_type", "mumps")
        else:
            set_default("pc_type", "lu" if comm.size == 1 else "redundant")
    if options.getString("pc_type") in ("lu", "cholesky", "redundant"):
        if options.getString("pc_factor_mat_solver_type", "") == "mumps":
            set_default("mat_mumps_icntl_14", 50)  # room for fill-in by pivoting [%]
        set_default("ksp_type", "preonly")
    else:
        set_default("ksp_type", "cg" if symmetric else "gmres")
        set_default("ksp_rtol", 1e-8)
        set_default("ksp_norm_type", "unpreconditioned")
        set_default("ksp_max_it", 2000)


def describe_linear_solver(ksp: PETSc.KSP) -> str:
    """In words, for people: "preonly + cholesky (mumps)"."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky") else None
    return f"{ksp.getType()} + {pc.getType()}" + (f" ({package})" if package else "")
