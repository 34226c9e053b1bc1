"""`python -m pdpetsc` and the command `pdpetsc`: start PETSc with the right options, then do what is asked for."""

import sys

INSTALL = (
    "on Debian or Ubuntu 'scripts/setup' installs it from apt (python3-petsc4py), "
    "elsewhere 'pip install petsc' and then 'pip install petsc4py' (docs/install.md)"
)


def main() -> int:
    """Run the command line and return its exit code."""
    from pdpetsc import catalogue, cli, options

    ours, petsc = options.split(sys.argv[1:], catalogue.is_case)
    if (code := cli.answer(ours)) is not None:
        return code
    try:
        import mpi4py  # noqa: F401
        import petsc4py  # noqa: F401
    except ImportError as error:
        print(f"pdpetsc: error: {error.name} is missing; {INSTALL}", file=sys.stderr)
        return 2
    try:
        options.start(petsc, cli.petsc_defaults(ours))
    except (ImportError, ValueError) as error:  # another MPI, a wrong PETSC_DIR, or numpy 2 with an old petsc4py
        print(f"pdpetsc: error: petsc4py does not load ({error}); {INSTALL}", file=sys.stderr)
        return 2
    except RuntimeError as error:  # of PETSc
        where = "[petsc] in the case, PETSC_OPTIONS and the command line"
        print(f"pdpetsc: error: PETSc does not start with its options ({error}); see {where}", file=sys.stderr)
        return 2
    return cli.main(ours)


if __name__ == "__main__":
    sys.exit(main())
