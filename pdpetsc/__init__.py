"""pdpetsc: implicit peridynamics in parallel, on PETSc."""

__version__ = "0.1.0"
