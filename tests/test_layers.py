"""The order of the rooms: what may import what (docs and DESIGN: "a room imports only from rooms to its left")."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "pdpetsc"
LONGEST = 350  # lines of a room

# From left to right; a room may import from its own layer and from those before it.
LAYERS = (
    (
        "errors", "apart", "hdf5_check", "toml", "expressions", "quantities", "units", "timings", "terminal", "events",
        "signals", "parallel", "options", "memory",
    ),
    (
        "body",
        "particles",
        "bonds",
        "partial_volume",
        "influence",
        "quadrature",
        "exchange",
        "opposite",
        "support",
        "grading",
        "state",
    ),
    ("materials", "damage", "loads"),
    ("sparsity", "matrix"),
    ("assembly",),
    ("compact", "rules", "fracture"),
    ("solvers", "recover", "adapt"),
    ("probes", "sections", "j_integral", "expectations", "observers", "io"),
    (
        "catalogue",
        "commands",
        "schema",
        "case",
        "census",
        "prediction",
        "advice",
        "building",
        "transient",
        "discretisation",
        "compiling",
        "simulation",
        "summary",
        "run",
        "pictures",
        "driver",
        "api",
        "lists",
        "newcase",
        "completion",
        "cli",
        "__main__",
    ),
)
LEVEL = {room: level for level, layer in enumerate(LAYERS) for room in layer}

# Laws that are sharper than the order: all that these rooms may import of the package.
ONLY = {
    "materials": {"materials", "damage", "bonds", "influence", "quadrature", "errors"},
    "damage": {"materials", "damage", "bonds", "influence", "errors"},
    "solvers": {
        "solvers",
        "assembly",
        "compact",
        "fracture",
        "state",
        "loads",
        "errors",
        "options",
        "parallel",
        "timings",
    },
    "schema": {
        "schema",
        "materials",
        "damage",
        "loads",
        "bonds",
        "influence",
        "partial_volume",
        "quantities",
        "errors",
        "expressions",
    },  # no MPI, no PETSc
    "case": {"catalogue", "schema", "errors", "expressions", "toml"},
}
# And of everything else: models are testable with two particles and nothing but numpy and numba.
OUTSIDE = {
    room: {"numpy", "numba", "annotated_types"} | set(sys.stdlib_module_names)
    for room in ("materials", "damage", "bonds", "partial_volume", "influence", "quadrature")
}

MODULES = sorted(PACKAGE.rglob("*.py"))


def name_of(path: Path) -> str:
    """pdpetsc/io/fields.py -> io.fields; a package's own file has the name of the package."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


KNOWN = {name_of(path) for path in MODULES} - {""}


@cache
def imports(path: Path) -> frozenset[str]:
    """Full names of the modules that a file imports, wherever in the file it does; `import a.b` and `from a import b`
    where b is a module both give a.b."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the room that they name"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner.removeprefix("pdpetsc.") in KNOWN else node.module)
    return frozenset(found)


def imported_rooms(path: Path) -> set[str]:
    names = (name.split(".") for name in imports(path))
    return {parts[1] for parts in names if parts[0] == "pdpetsc" and len(parts) > 1}


def room_of(path: Path) -> str:
    return name_of(path).partition(".")[0]


paths = pytest.mark.parametrize("path", [p for p in MODULES if name_of(p)], ids=name_of)


def test_every_room_has_its_place():
    assert {room_of(path) for path in MODULES if name_of(path)} <= set(LEVEL)


@paths
def test_room_imports_from_its_left_only(path):
    level = LEVEL[room_of(path)]
    assert {room for room in imported_rooms(path) if LEVEL[room] > level} == set()


@paths
def test_sharper_laws(path):
    room = room_of(path)
    assert imported_rooms(path) <= ONLY.get(room, set(LEVEL))
    outside = {name.partition(".")[0] for name in imports(path)} - {"pdpetsc"}
    assert outside <= OUTSIDE.get(room, outside)


def test_modules_do_not_import_in_circles():
    waiting = {
        name_of(p): {name.removeprefix("pdpetsc.") for name in imports(p)} & KNOWN - {name_of(p)}
        for p in MODULES
        if name_of(p)
    }
    while waiting:
        ready = {module for module, needs in waiting.items() if not needs & set(waiting)}
        assert ready, f"in a circle, or behind one: {sorted(waiting)}"
        waiting = {module: needs for module, needs in waiting.items() if module not in ready}


@pytest.mark.parametrize("module", ["materials", "case"])
def test_rooms_without_petsc_and_mpi(module):
    code = f"import sys, pdpetsc.{module}; print(*{{'petsc4py', 'mpi4py'}} & set(sys.modules))"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, timeout=60, check=True
    )
    assert run.stdout.split() == []


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_rooms_are_small(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST, f"{path.name}: split it by a noun"
