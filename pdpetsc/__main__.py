"""`python -m pdpetsc` and the command `pdpetsc`: start PETSc with the right options, then do what is asked for."""

import sys

INSTALL = "install it with 'apt-get install python3-petsc4py' on Debian or Ubuntu, or 'pip install petsc petsc4py'"


def main() -> int:
    """Run the command line and return its exit code."""
    try:
        import petsc4py  # noqa: F401
    except ImportError:
        print(f"pdpetsc: error: petsc4py is missing; {INSTALL}", file=sys.stderr)
        return 2
    from pdpetsc import case, cli, options

    ours, petsc = options.split(sys.argv[1:], case.is_case)
    try:
        options.start(petsc, cli.petsc_defaults(ours))
    except (ImportError, ValueError) as error:  # another MPI, a wrong PETSC_DIR, or numpy 2 with an old petsc4py
        print(f"pdpetsc: error: petsc4py does not load ({error}); {INSTALL}", file=sys.stderr)
        return 2
    return cli.main(ours)


if __name__ == "__main__":
    sys.exit(main())
