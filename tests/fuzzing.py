"""What strangers may send: readers of files and texts, what is fed to them, and what may come of it.

Shared by tests/unit/test_fuzz_*.py and scripts/fuzz. A reader returns or raises InputError (or, of HDF5 files, Damaged,
in the process of its own): anything else is a failure, and so is taking longer than its limit.
"""

import copy
import io
import itertools
import json
import os
import random
import resource
import shutil
import signal
import tempfile
import tomllib
import traceback
from collections.abc import Callable
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import h5py
import meshio
import numpy as np
import tomli_w
from hypothesis import strategies as st
from mpi4py import MPI

from pdpetsc import case, catalogue, hdf5_check
from pdpetsc.body import clouds, meshes
from pdpetsc.body.cells import Mesh
from pdpetsc.body.given import forget as forget_body
from pdpetsc.body.given import given_particles, source_of
from pdpetsc.body.meshfile import packed
from pdpetsc.body.sheets import polygons
from pdpetsc.census import QUICK
from pdpetsc.errors import InputError
from pdpetsc.expressions import CONSTANTS, FUNCTIONS, Expression
from pdpetsc.io import cells as drawn
from pdpetsc.io import checkpoint, fields, frames, seal, tables, tiles
from pdpetsc.io.view import Section, View

DATA = Path(__file__).parent / "unit" / "data" / "fuzz"
"""Inputs that once made a reader fail: READER/anything."""

LOG = Path(__file__).parent / "unit" / "data" / "fuzz.csv"
"""Of the runs of scripts/fuzz: seeds and counts."""

FOLDER = Path(tempfile.mkdtemp(prefix="pdpetsc-fuzz-"))


class TooLong(BaseException):
    """A reader took longer than its limit; not an Exception, which readers of meshes catch."""


@contextmanager
def limit(seconds: float):
    """End a block that takes longer."""

    def end(*_):
        raise TooLong

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class Reader(NamedTuple):
    """Something that reads what others have written.

    Attributes:
        read: takes bytes; returns or raises `refusals`.
        inputs: strategy of bytes.
        seconds: that an input may take; where a process of its own has limits, what takes longer is ended there.
        apart: whether that is so; it is read in a process of its own here, too, for libraries may crash.
        refusals: exceptions that say in a sentence what is wrong.
    """

    read: Callable[[bytes], object]
    inputs: Callable[[], st.SearchStrategy[bytes]]
    seconds: float = 5.0
    apart: bool = False
    refusals: tuple = (InputError,)

    def outcome(self, content: bytes) -> str:
        """"read", "refused", or "ended" where only the limits of the process of its own bound it.

        Raises:
            Exception: the reader has failed.
        """
        if self.apart:
            return in_a_child(self, content)
        try:
            with limit(self.seconds):
                return self.attempt(content)
        except (TooLong, MemoryError):
            raise AssertionError(f"takes longer than {self.seconds} s or all memory") from None

    def attempt(self, content: bytes) -> str:
        """"read" or "refused"."""
        try:
            self.read(content)
        except self.refusals as refusal:
            assert "\x1b" not in str(refusal) and len(str(refusal)) < 5000, "a message that no terminal should show"
            return "refused"
        return "read"


class Child:
    """A process that reads one input after the other, until one of them ends it.

    Args:
        reader: what reads there.
    """

    def __init__(self, reader: Reader):
        asked, self._ask = os.pipe()
        self._told, tell = os.pipe()
        self._process = os.fork()
        if not self._process:
            for asked_of in (self, *children.values()):  # else others would not see the end of what they are asked
                os.close(asked_of._ask)
            os.close(self._told)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            signal.signal(signal.SIGALRM, signal.SIG_DFL)  # libraries do not come back to see to another one
            with os.fdopen(asked, "rb") as source, os.fdopen(tell, "wb") as answers:
                _serve(reader, source, answers)
            os._exit(0)
        os.close(asked)
        os.close(tell)
        self._answers = os.fdopen(self._told, "rb")

    def outcome(self, content: bytes) -> str:
        """What became of an input; "ended" where it ended the process, which is then of no further use."""
        message = len(content).to_bytes(8, "little") + content
        while message:
            message = message[os.write(self._ask, message) :]
        answer = self._answers.readline().decode().strip()
        if not answer:
            self.end()
            return "ended"
        assert not answer.startswith("failed"), json.loads(answer.removeprefix("failed "))
        return answer

    def end(self) -> None:
        os.close(self._ask)
        self._answers.close()
        os.waitpid(self._process, 0)


def _serve(reader: Reader, source, answers) -> None:
    while size := source.read(8):
        content = source.read(int.from_bytes(size, "little"))
        signal.setitimer(signal.ITIMER_REAL, reader.seconds)
        try:
            answer = reader.attempt(content)
        except MemoryError:
            return
        except BaseException:
            answer = "failed " + json.dumps(traceback.format_exc()[-4000:])
        signal.setitimer(signal.ITIMER_REAL, 0)
        answers.write(answer.encode() + b"\n")
        answers.flush()


children: dict[Reader, Child] = {}
"""Those that are alive."""


def in_a_child(reader: Reader, content: bytes) -> str:
    """The outcome in a process that may end with it, whatever a library does to it."""
    child = children.pop(reader, None) or Child(reader)
    try:
        outcome = child.outcome(content)
    except AssertionError:
        children[reader] = child
        raise
    if outcome != "ended":
        children[reader] = child
    return outcome


MEMORY = 2**33
"""Bytes that a process for one input may take."""


# Bytes ---------------------------------------------------------------------------------------------------------


def mutated(content: bytes, chance: random.Random, text: bool = False) -> bytes:
    """Some bytes changed, put in, taken out or repeated."""
    data = bytearray(content)
    for _ in range(chance.choice((1, 1, 2, 3, 8))):
        place = chance.randrange(len(data) + 1)
        size = chance.choice((1, 1, 2, 4, 8, 30))
        other = chance.randrange(len(data) + 1)
        kind = chance.randrange(7)
        if kind == 0 and place < len(data):
            data[place] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[place : place + size] = chance.randbytes(size)
        elif kind == 2:
            data[place : place + size] = b""
        elif kind == 3:
            data[place:place] = data[other : other + size]
        elif kind == 4:
            data[place : place + size] = bytes([chance.choice((0, 1, 127, 128, 255))]) * size
        elif kind == 5 and text:
            data[place : place + size] = chance.choice(WORDS)
        elif chance.random() < 0.2:
            del data[place:]
    return bytes(data)


WORDS = [
    b"-1", b"0", b"1e999", b"nan", b"99999999999999999999", b"2147483648", b"1000000000000", b"\n", b'"', b"\x1b[31m",
    b"\xff\xfe", b"[[", b"}", b"\\u0000", b"-", b"e", b"1e-310", b"'''", b"#",
]  # fmt: skip


def changed(contents: Callable[[], list[bytes]], text: bool = False) -> Callable[[], st.SearchStrategy[bytes]]:
    """The strategy of some files' mutations."""

    def strategy():
        some = contents()

        def of(pick: tuple[int, int]) -> bytes:
            return mutated(some[pick[0]], random.Random(pick[1]), text)

        return st.tuples(st.integers(0, len(some) - 1), st.integers(0, 2**32)).map(of)

    return strategy


# Case files ----------------------------------------------------------------------------------------------------

NASTY = [
    0, -1, 1, 2, 10**6, 10**12, 10**18, 2**63 - 1, -(2**63), 10**400, 0.0, -1.0, 1e-300, 1e300, 1e-5, 1e5, float("inf"),
    float("nan"), True, False, "", "x", "all", "horizon", "99999999 horizon", "X < 1", "X", "1/0", "10**400", "9**9**9",
    "__import__('os')", "spacing", "t", "../../x", "a\x00b", "\x1b]0;title\x07", "\u202e", "$\\frac", "x" * 3000, [],
    {}, [1], [0.0, 0.0], [1.0, 1.0, 1.0], [[0.0], [1.0], 10**12], [1e60, 1e-60], ["x", "y"], [{}], {"a": 1},
    {"length": 1.0},
    {"factor": 1e9}, "python", "binary:/tmp/x", ":x", "newton", "verlet", "arc_length", "stress", "J", "crack_tip",
]  # fmt: skip


def nasty(chance: random.Random):
    return copy.deepcopy(chance.choice(NASTY))


@cache
def documents() -> list[dict]:
    """Those of the bundled cases, with each of their variants."""
    found = []
    for path in catalogue.bundled().values():
        document = tomllib.loads(path.read_text())
        found += [case._with_variant(document, name, "") for name in (None, *document.get("variant", {}))]
    return found


def texts_of_cases() -> list[bytes]:
    return [path.read_bytes() for path in catalogue.bundled().values()]


def places(value, path=()) -> list[tuple]:
    """Paths of all entries."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for key, inner in inside for place in ((*path, key), *places(inner, (*path, key)))]


def changed_document(chance: random.Random) -> dict:
    """A bundled case with some entries replaced, deleted, added, doubled or moved."""
    document = json.loads(json.dumps(chance.choice(documents())))
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        everywhere = places(document)
        if not everywhere:
            break
        *path, last = chance.choice(everywhere)
        inner = document
        for key in path:
            inner = inner[key]
        kind, old = chance.randrange(8), inner[last]
        if kind in (0, 6, 7) and isinstance(old, int | float) and not isinstance(old, bool):
            inner[last] = type(old)(old * chance.choice((0.1, 0.5, 2, 10, 1e3, 1e6, 1e12, -1)))
        elif kind in (0, 1, 2, 6, 7):
            inner[last] = nasty(chance)
        elif kind == 3:
            del inner[last]
        elif kind == 4:
            if isinstance(inner, dict):
                other = chance.choice([place[-1] for place in everywhere if isinstance(place[-1], str)])
                inner[other] = nasty(chance)
            else:
                inner.append(chance.choice(inner))
        else:
            source = document
            for key in chance.choice(everywhere):
                source = source[key]
            inner[last] = json.loads(json.dumps(source))
    return document


def toml_of(document: dict) -> bytes:
    try:
        return tomli_w.dumps(document).encode("utf-8", "surrogatepass")
    except (TypeError, ValueError):
        return b""


def cases() -> st.SearchStrategy[bytes]:
    """Documents with other entries, and files with other bytes."""
    changed_documents = st.integers(0, 2**32).map(lambda seed: toml_of(changed_document(random.Random(seed))))
    return st.one_of(changed_documents, changed_documents, changed(texts_of_cases, text=True)())


def read_case(content: bytes) -> case.Case:
    path = FOLDER / "case.toml"
    path.write_bytes(content)
    return case.load(str(path))


def read_and_predict(content: bytes) -> None:
    """As `pdpetsc check` and a run do before they build anything."""
    from pdpetsc.prediction import check_fits, predict, report

    read = read_case(content)
    prediction = predict(read, 1, QUICK)
    report(prediction, read.units, None)
    check_fits(prediction, 2**34)


# Expressions ---------------------------------------------------------------------------------------------------


def formulas() -> st.SearchStrategy[bytes]:
    """Formulas and conditions of a grammar, some of them wrong, and any text."""
    number = st.one_of(
        st.sampled_from(["0", "1", "2.5", "1e308", "1e-320", "10", "9" * 400, "0x10", "1_000", "1j", ".5"]),
        st.floats(allow_nan=False, allow_infinity=False).map(repr),
        st.integers().map(str),
    )
    name = st.sampled_from(["X", "Y", "t", "spacing", *CONSTANTS, "z", "__class__", "np", "\uff38"])
    operator = st.sampled_from(["+", "-", "*", "/", "**", "<", "<=", "==", "!=", " and ", " or ", "//", "%", "@", "&"])

    def larger(inner):
        call = st.tuples(st.sampled_from([*FUNCTIONS, "eval", "X.__class__"]), st.lists(inner, max_size=4))
        return st.one_of(
            st.tuples(inner, operator, inner).map(lambda p: f"({p[0]}{p[1]}{p[2]})"),
            st.tuples(inner, operator, inner, operator, inner).map("".join),
            st.tuples(st.sampled_from(["-", "+", "not ", "~"]), inner).map("".join),
            call.map(lambda p: f"{p[0]}({', '.join(p[1])})"),
        )

    grammar = st.recursive(st.one_of(number, name), larger, max_leaves=25)
    deep = st.tuples(st.sampled_from(["(", "-", "not ", "sin(", "[", "X**", "X<", "X if X else "]), st.integers(1, 700))
    nested = deep.map(lambda p: p[0] * p[1] + "X" + ")" * (p[1] * p[0].count("(")))
    anything = st.one_of(grammar, grammar, nested, st.text(max_size=60))
    return anything.map(lambda text: text.encode("utf-8", "surrogatepass"))


def read_expression(content: bytes) -> None:
    """Read it, and evaluate it on arrays and on numbers: values are finite or refused."""
    try:
        text = content.decode("utf-8", "surrogatepass")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    expression = Expression(text, ["X", "Y", "t", "spacing"], "case.toml: load.0.value")
    value = expression.mask if expression.is_condition else expression
    X = np.array([0.0, -1.0, 1e300, 1e-300, 0.5] * 20)
    assert np.isfinite(value(X=X, Y=X[::-1], t=0.5, spacing=1e-3)).all()


# Meshes --------------------------------------------------------------------------------------------------------

FORMATS = {
    "msh2": ("gmsh22", {"binary": False}), "msh2b": ("gmsh22", {"binary": True}), "msh4": ("gmsh", {"binary": False}),
    "msh4b": ("gmsh", {"binary": True}), "inp": ("abaqus", {}), "vtk": ("vtk", {"binary": False}),
    "vtkb": ("vtk", {"binary": True}), "vtk42": ("vtk42", {"binary": True}), "vtu": ("vtu", {"binary": False}),
    "vtub": ("vtu", {"binary": True}), "stl": ("stl", {"binary": False}), "stlb": ("stl", {"binary": True}),
    "ply": ("ply", {"binary": False}), "plyb": ("ply", {"binary": True}), "xdmf": ("xdmf", {"data_format": "XML"}),
    "med": ("med", {}), "h5m": ("h5m", {}), "off": ("off", {}), "obj": ("obj", {}), "mesh": ("medit", {}),
    "meshb": ("medit", {}), "nas": ("nastran", {}), "su2": ("su2", {}), "ugrid": ("ugrid", {}),
    "xml": ("dolfin-xml", {}), "avs": ("avsucd", {}), "vol": ("netgen", {}), "dat": ("tecplot", {}),
    "mdpa": ("mdpa", {}), "f3grid": ("flac3d", {}),
    "ansys": ("ansys", {}), "dato": ("permas", {}), "cgns": ("cgns", {}), "hmf": ("hmf", {}),
}  # fmt: skip
"""Formats that meshio writes here, with what is asked of the writer; the last letter b stands for binary."""

ENDINGS = {"msh2": "msh", "msh2b": "msh", "msh4": "msh", "msh4b": "msh", "ansys": "msh", "vtkb": "vtk", "vtk42": "vtk",
           "vtub": "vtu", "stlb": "stl", "plyb": "ply"}  # fmt: skip


@cache
def small_meshes() -> list[bytes]:
    """A pyramid of triangles, one of tetrahedra and a square in each format that has them, after the name of the format
    and a null byte."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1.0]])
    triangles = "triangle", np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    tetrahedra = "tetra", np.array([[0, 1, 2, 4], [0, 2, 3, 4]])
    square = [("quad", np.array([[0, 1, 2, 3]])), ("line", np.array([[0, 1], [2, 3]]))]
    shapes = (points, [triangles]), (points, [tetrahedra, triangles]), (points * [1, 1, 0], square)
    found = []
    for (name, (kind, options)), (place, cells) in itertools.product(FORMATS.items(), shapes):
        mesh = meshio.Mesh(place, cells)
        if kind.startswith("gmsh"):
            of_cells = [np.ones(len(corners), int) for _, corners in cells]
            mesh.cell_data = {"gmsh:physical": of_cells, "gmsh:geometrical": of_cells}
            mesh.field_data = {"crack": np.array([1, 2])}
        elif kind in ("vtu", "xdmf", "vtk"):
            mesh.point_data = {"volume": np.ones(5)}
        path = FOLDER / f"small.{ENDINGS.get(name, name)}"
        try:
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                meshio.write(path, mesh, file_format=kind, **options)
            content = path.read_bytes()
        except Exception:  # a format that this cannot be written in
            continue
        found.append(name.encode() + b"\0" + content)
    return found


def mesh_files() -> st.SearchStrategy[bytes]:
    some = small_meshes()

    def of(pick: tuple[int, int]) -> bytes:
        name, _, content = some[pick[0]].partition(b"\0")
        return name + b"\0" + mutated(content, random.Random(pick[1]), text=b"\xff" not in content)

    return st.tuples(st.integers(0, len(some) - 1), st.integers(0, 2**32)).map(of)


def mesh_path(content: bytes) -> str:
    """The file of an input, with the ending of its format."""
    name, _, content = content.partition(b"\0")
    name = name.decode("ascii", "replace")
    path = FOLDER / f"mesh.{ENDINGS.get(name, name) if name in FORMATS else 'vtk'}"
    path.write_bytes(content)
    return str(path)


def read_crack(content: bytes) -> None:
    """A crack of a mesh, read in this process and not in one of its own, whose limits end what takes too long."""
    path, refusals = mesh_path(content), []
    with read_here(path):
        for dim, name in ((3, None), (3, "crack"), (2, None)):
            try:
                polygons(meshes.surface_of_mesh(path, dim, name), "body.cracks.0.mesh")
            except InputError as refusal:
                refusals.append(refusal)
    if len(refusals) == 3:
        raise refusals[0]


def read_body(content: bytes) -> None:
    """A body of a mesh or of points, likewise; one that holds no body of a kind may be one of another."""
    path, refusals = mesh_path(content), []
    with read_here(path):
        for document in bodies(path):
            try:
                source = source_of(case.load(document))
                given_particles(MPI.COMM_SELF, source, None, lambda X, spacing, of_file: 2 * spacing)
            except InputError as refusal:
                refusals.append(refusal)
            finally:
                forget_body()
    if len(refusals) == len(bodies(path)):
        raise refusals[0]


def bodies(path: str) -> list[dict]:
    """Cases whose body is a file: cells, vertices with a set and a surface of a group, a plane, and points."""
    material = {"material": {"soft": {"model": "ordinary", "E": 1.0, "nu": 0.25}}}
    load = [{"kind": "pressure", "surface": "border", "value": 1.0}]
    grouped = {"sets": {"some": {"group": "crack"}}, "surfaces": {"side": {"group": "crack"}}, "load": load}
    mesh = {"mesh": path, "horizon": 2.015}
    return [
        material | {"body": mesh, "load": load},
        material | {"body": mesh | {"particles": "vertices"}, **grouped},
        material | {"body": mesh | {"dimension": 2}, "load": load},
        material | {"body": {"points": path, "horizon": 2.015}},
    ]


@contextmanager
def read_here(path: str):
    """A mesh is read in this process, once."""
    try:
        archive = packed(path)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    before, meshes.read_apart = meshes.read_apart, lambda script, path: archive
    try:
        yield
    finally:
        meshes.read_apart = before


# Results -------------------------------------------------------------------------------------------------------


@cache
def result_files() -> dict[str, list[bytes]]:
    """Checkpoints and field files like ours, small ones."""
    path, found = FOLDER / "result.h5", {"checkpoint": [], "fields": [], "points": []}
    for refined in (False, True):
        with h5py.File(path, "w") as file:
            write_checkpoint(file, refined)
        found["checkpoint"].append(path.read_bytes())
        with h5py.File(path, "w") as file:
            write_fields(file, refined)
        found["fields"].append(path.read_bytes())
        with h5py.File(path, "w") as file:
            write_points(file, {"compression": "gzip"} if refined else {})
        found["points"].append(path.read_bytes())
    return found


def write_points(file: h5py.File, stored: dict) -> None:
    file.create_dataset("position", data=np.arange(18.0).reshape(9, 2), **stored)
    for name in ("volume", "horizon", "spacing"):
        file.create_dataset(name, data=np.ones(9), **stored)
    file["set"] = ["left"] * 4 + ["right"] * 5


def write_checkpoint(file: h5py.File, refined: bool) -> None:
    n = 9
    for name in ("u", "position"):
        file[name] = np.arange(2.0 * n).reshape(n, 2)
    if refined:
        for name in ("volume", "spacing", "horizon"):
            file[name] = np.ones(n)
        for name in ("parent", "ancestor"):
            file[name] = np.arange(n)
        file["facets/parent"], file["facets/face"] = [0, 1], [2, 6]
        file["facets/position"], file["facets/area"] = np.ones((2, 2)), np.ones((2, 2))
    file["damaged/broken_bonds"] = np.array([[0, 1, 1], [1, 0, 1]])
    file["damaged/softened_bonds"] = np.empty((0, 3))
    file.attrs["state"] = json.dumps({"time": 0.5, "step": 1})
    file["description"] = np.frombuffer(json.dumps(description()).encode(), np.uint8)


def description() -> dict:
    row = {"step": 1, "time": 0.5, "probes": {"tip": 1.0}}
    about = {"name": "bar_tension", "variant": None, "path": "bar_tension.toml", "overridden": False}
    return {"case": about | {"document": documents()[0]}, "rows": [row], "refinements": [], "unsolved": False}


def write_fields(file: h5py.File, refined: bool) -> None:
    for group, n in (("", 9), ("refined/00002/", 12))[: 1 + refined]:
        file[group + "position"] = np.arange(3.0 * n).reshape(n, 3)
        for name in ("volume", "horizon", "spacing"):
            file[group + name] = np.ones(n)
        file[group + "vertex"] = np.arange(n, dtype=np.int32)
    lattice = np.arange(9).reshape(3, 3)
    corners = np.stack([lattice[:-1, :-1], lattice[1:, :-1], lattice[1:, 1:], lattice[:-1, 1:]], axis=-1).reshape(4, 4)
    places = np.stack(np.meshgrid([0.0, 1, 2], [0.0, 1, 2], indexing="ij"), axis=-1).reshape(9, 2)
    fields.write_mesh(file, Mesh(places, corners, np.arange(9), "points"))
    file["mesh/cracked"] = np.zeros(9, np.int32)
    for step, n in ((1, 9), (2, 12 if refined else 9)):
        file[f"{step:05d}/u"] = np.zeros((n, 3))
        file[f"{step:05d}/damage"] = np.zeros(n)


NAMES = [
    "u", "position", "volume", "ancestor", "facets/parent", "damaged/broken_bonds", "description", "00001", "00002/u",
    "refined", "refined/00002/spacing", "00001/damage", "vertex", "v", "mesh", "mesh/points", "mesh/cells",
    "mesh/particle", "mesh/cracked", "horizon", "spacing", "set",
]  # fmt: skip


def changed_hdf5(content: bytes, chance: random.Random) -> bytes:
    """A file with a dataset taken away, of another shape or type, compressed, elsewhere, or with other values."""
    path = FOLDER / "changed.h5"
    path.write_bytes(content)
    with h5py.File(path, "a") as file, suppress(Exception):  # of links and bombs in it
        for _ in range(chance.choice((1, 1, 2))):
            name, kind = chance.choice(NAMES), chance.randrange(10)
            old = file.get(name)
            old = old[...] if isinstance(old, h5py.Dataset) and old.size and old.size < 10**6 else np.zeros((9, 2))
            if name in file:
                del file[name]
            if kind == 1:
                file.create_dataset(name, (10**12, 2), "f8", chunks=(1000, 2), compression="gzip")
            elif kind == 2:
                file[name] = h5py.ExternalLink("/etc/hostname", "/u")
            elif kind == 3:
                file.create_dataset(name, (9, 2), "f8", external=[("/etc/passwd", 0, 144)])
            elif kind == 4:
                file[name] = chance.choice([np.array([b"x"]), "text", np.zeros(3, complex), [True], h5py.Empty("f8")])
            elif kind == 5:
                file[name] = np.full(old.shape, chance.choice([np.nan, np.inf, -1, 1e300, 2**40]))
            elif kind == 6:
                file[name] = np.zeros(chance.choice([(), (0,), (9,), (9, 3), (3, 3, 3), (1, 2)]))
            elif kind == 7:
                file[name] = h5py.SoftLink(chance.choice(["/u", "/", "/nowhere", f"/{name}"]))
            elif kind == 8:
                text = json.dumps(chance.choice(NASTY[:20] + [None, {"step": -1}, {"step": 1, "time": "x"}]))
                file.attrs["state"] = text
            elif kind == 9:
                file.create_group(name)
    return path.read_bytes()


def hdf5_files(kind: str) -> Callable[[], st.SearchStrategy[bytes]]:
    def strategy():
        some = result_files()[kind]

        def of(pick: tuple[int, int, bool]) -> bytes:
            content, chance = some[pick[0]], random.Random(pick[1])
            return changed_hdf5(content, chance) if pick[2] else mutated(content, chance)

        return st.tuples(st.integers(0, len(some) - 1), st.integers(0, 2**32), st.booleans()).map(of)

    return strategy


def read_hdf5(kind: str) -> Callable[[bytes], None]:
    def read(content: bytes) -> None:
        path = FOLDER / f"{kind}.h5"
        path.write_bytes(content)
        hdf5_check.check(str(path), kind)

    return read


def read_points(content: bytes) -> None:
    """A body of points in HDF5, looked into as by the process of its own, which here is none."""
    read_hdf5("points")(content)
    before, clouds.read_apart = clouds.read_apart, lambda script, path, kind: b""
    try:
        body = {"points": str(FOLDER / "points.h5"), "dimension": 2, "horizon": 2.015}
        material = {"soft": {"model": "ordinary", "E": 1.0, "nu": 0.25}}
        source = source_of(case.load({"body": body, "material": material, "sets": {"some": {"group": "left"}}}))
        given_particles(MPI.COMM_SELF, source, None, lambda X, spacing, of_file: 2 * spacing)
    finally:
        clouds.read_apart = before


def read_and_draw(content: bytes) -> None:
    """A field file, and what pictures of its steps are drawn from."""
    read_hdf5("fields")(content)
    with h5py.File(FOLDER / "fields.h5", "r") as file:
        for step in fields.written_steps(file):
            frame = frames.read_frame(file, step, View("u"), frames.Broken(np.ones(1, int), np.zeros((1, 2, 2))))
            if frame.mesh is None:
                drawn.cell_sides(frame.position, frame.spacing, frame.volume)
            elif frame.mesh.points.shape[1] == 2:
                places = frames.tile_places(frame)
                for parts in (tiles.areas(frame.mesh, places), tiles.edges(frame.mesh, places, frame.apart)):
                    drawn.deformed_tiles(frame, 1.0, parts)
            else:
                drawn.surface(frame, 1.0, Section(0, 1.0))


def changed_json(data, chance: random.Random) -> bytes:
    data = json.loads(json.dumps(data))
    for _ in range(chance.choice((1, 1, 2, 3))):
        everywhere = places(data)
        if not everywhere:
            break
        *path, last = chance.choice(everywhere)
        inner = data
        for key in path:
            inner = inner[key]
        if chance.random() < 0.3:
            del inner[last]
        else:
            inner[last] = nasty(chance)
    text = json.dumps(data).encode()
    return mutated(text, chance, text=True) if chance.random() < 0.3 else text


def descriptions() -> st.SearchStrategy[bytes]:
    return st.integers(0, 2**32).map(lambda seed: changed_json(description(), random.Random(seed)))


def read_kept(content: bytes) -> None:
    """What a checkpoint keeps, up to the case that is run again."""
    path = FOLDER / "kept"
    path.mkdir(exist_ok=True)
    with h5py.File(path / checkpoint.CHECKPOINT, "w", userblock_size=seal.SIZE) as file:
        file["description"] = np.frombuffer(content, np.uint8)
    seal.seal(MPI.COMM_SELF, path / checkpoint.CHECKPOINT, checkpoint.FORMAT)
    case.Case.from_document(**checkpoint.read_description(path)["case"])


SUMMARY = {
    "case": "plate", "title": "A plate", "dim": 2, "units": {"length": "mm", "force": "N", "time": "s"},
    "steps": [{"step": 1, "time": 0.5}, {"step": 2, "time": 1.0}],
}  # fmt: skip


def summaries() -> st.SearchStrategy[bytes]:
    return st.integers(0, 2**32).map(lambda seed: changed_json(SUMMARY, random.Random(seed)))


def read_summary(content: bytes) -> None:
    path = FOLDER / "summary"
    path.mkdir(exist_ok=True)
    (path / "summary.json").write_bytes(content)
    tables.read_summary(path)


READERS = {
    "case": Reader(read_case, cases),
    "prediction": Reader(read_and_predict, cases, seconds=20.0),
    "expression": Reader(read_expression, formulas),
    "mesh": Reader(read_crack, mesh_files, apart=True),
    "body": Reader(read_body, mesh_files, apart=True),
    "checkpoint": Reader(read_hdf5("checkpoint"), hdf5_files("checkpoint"), apart=True, refusals=(hdf5_check.Damaged,)),
    "fields": Reader(
        read_and_draw, hdf5_files("fields"), apart=True, refusals=(hdf5_check.Damaged, InputError)
    ),
    "points": Reader(read_points, hdf5_files("points"), apart=True, refusals=(hdf5_check.Damaged, InputError)),
    "description": Reader(read_kept, descriptions),
    "summary": Reader(read_summary, summaries),
}
"""By name; a further one is a line here."""


def forget() -> None:
    """Remove the files that were written, and end the processes."""
    while children:
        children.popitem()[1].end()
    shutil.rmtree(FOLDER, ignore_errors=True)
