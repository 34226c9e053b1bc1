"""pdpetsc: implicit peridynamics in parallel, on PETSc."""

import hashlib
import os
from importlib import import_module
from pathlib import Path

__version__ = "0.1.0"

_ROOMS = {
    "load": "case", "Case": "case", "build": "api", "solve": "api", "Run": "api", "Observer": "api",
    "Load": "loads.base", "Material": "materials.base", "Criterion": "damage.base",
    "InputError": "errors", "ConvergenceError": "errors", "Stop": "errors",
}  # fmt: skip
"""Where the names of the Python API are (docs/python.md)."""


def __getattr__(name: str):
    """Import a name of the API when it is first asked for: `import pdpetsc` alone needs neither PETSc nor MPI."""
    if name not in _ROOMS:
        raise AttributeError(f"module 'pdpetsc' has no attribute {name!r}")
    return getattr(import_module(f"pdpetsc.{_ROOMS[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_ROOMS})


def _use_cache_of_these_sources() -> None:
    """Let numba keep compiled kernels under a name that depends on their sources.

    numba looks at the file of a compiled function only, not at those of the functions that it calls: after an edit or
    an update it would go on with stale code. Where the user has set NUMBA_CACHE_DIR, that holds.
    """
    sources = [path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py"))]
    kernels = hashlib.sha256(b"".join(text for text in sources if b"numba" in text)).hexdigest()[:16]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("NUMBA_CACHE_DIR", str(home / "pdpetsc" / kernels))


_use_cache_of_these_sources()
