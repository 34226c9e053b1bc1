"""Which linear solver fits a problem: defaults for PETSc's options database, which never override what is there."""

from petsc4py import PETSc

from pdpetsc import options

DIRECT_LIMIT = {1: 1_000_000, 2: 50_000, 3: 10_000}
"""Unknowns up to which a direct solver is the default, by dimension (docs/performance.md has the measurements)."""


def choose_linear_solver(comm, unknowns: int, dim: int, symmetric: bool) -> None:
    """Add defaults for -ksp_type, -pc_type and what belongs to them.

    Small problems are factorised: MUMPS where this PETSc has it, PETSc's own LU on one rank, a redundant LU on
    several. Larger ones take CG (GMRES where the tangent is unsymmetric) with algebraic multigrid on the rigid-body
    modes. When the user names a preconditioner, the Krylov method follows that choice.
    """
    given = PETSc.Options().getAll()
    if "pc_type" not in given:
        if unknowns > DIRECT_LIMIT[dim]:
            given["pc_type"] = "gamg"
        elif PETSc.Sys.hasExternalPackage("mumps"):
            given |= {"pc_type": "cholesky" if symmetric else "lu", "pc_factor_mat_solver_type": "mumps"}
        else:
            given["pc_type"] = "lu" if comm.size == 1 else "redundant"
    options.add({key: given[key] for key in ("pc_type", "pc_factor_mat_solver_type") if key in given})
    if given["pc_type"] in ("lu", "cholesky", "redundant"):
        options.add({"ksp_type": "preonly"})
        if given.get("pc_factor_mat_solver_type") == "mumps":
            options.add({"mat_mumps_icntl_14": 50})  # room for fill-in by pivoting [%]
    else:
        options.add({
            "ksp_type": "cg" if symmetric else "gmres", "ksp_rtol": 1e-8, "ksp_norm_type": "unpreconditioned",
            "ksp_max_it": 2000,
        })  # fmt: skip


def describe_linear_solver(ksp: PETSc.KSP) -> str:
    """In words, for people: "preonly + cholesky (mumps)"."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky") else None
    return f"{ksp.getType()} + {pc.getType()}" + (f" ({package})" if package else "")
