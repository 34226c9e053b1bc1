"""Which of PETSc's options a case file may hold: case files may come from strangers, so none that runs code, loads a
library, reads or writes a file, opens a connection or waits for somebody. On the command line all are free."""

import re
from typing import Annotated, Any

from pydantic import PlainValidator, WithJsonSchema

from pdpetsc.schema.table import error_at

LONGEST = 200
"""Characters of a name or a value."""

FORBIDDEN = {
    "runs code of others": r"python|matlab|mathematica|(^|_)dll_|library_preload|dynamic_library|_jit_|(^|_)libs?$",
    "starts a debugger or another program": r"^on_error_|^(start|stop)_.*debugger|debugger|^debug_terminal|^draw_|"
    r"^saws|movie",
    "reads further options": r"^options_(?!left$|view$)|^prefix_|^petscrc",
    "reads or writes files": r"^info(_|$)|^history|^log$|^log_(?!view$|sync$)|^malloc_(dump|view|log)|^memory_view|"
    r"^citations|file|trajectory|tmp|dirname|_vtk$|^viewer_|^(mat|vec|dm)_?load|binary|(^|_)monitor_ratio$|"
    r"mumps_icntl_([123]|22)$|^get_|^mpidump",
    "opens a window or a connection elsewhere": r"^display|^x_|socket|^nox",
    "stops the program": r"^fp_trap|^mpi_linear_solver_server|^petsc_sleep|^version$|^check_pointer|pause$",
}
"""Names, in lower case since PETSc ignores it, by what they do."""

VIEWERS = {
    "binary", "hdf5", "vtk", "socket", "saws", "matlab", "mathematica", "glvis", "adios", "exodusii", "cgns", "pyvista",
    "draw", "string",
}  # fmt: skip
"""That write files or open connections where they are only named."""


def option_value(value: Any) -> str | int | float | bool:
    """A number, true, false or text that stays one value for PETSc."""
    if not isinstance(value, str | int | float) or re.search(r'["\x00-\x1f\x7f]', str(value)[: LONGEST + 1]):
        raise ValueError("must be a number, true, false or text without quotes and line breaks")
    if isinstance(value, int) and abs(value) >= 2**63 or len(str(value)) > LONGEST:
        raise ValueError("is longer than any value of PETSc")
    return value


OptionValue = Annotated[
    Any,
    PlainValidator(option_value),
    WithJsonSchema({"type": ["number", "string", "boolean"], "description": "value of a PETSc option"}),
]


def option_name(value: str) -> str:
    """A name that PETSc can take for one."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", value) or len(value) > LONGEST:
        raise ValueError("a PETSc option is written here without its dash and with letters, digits and _ only")
    return value


def harmless(options: dict) -> dict:
    """Options that do nothing but choose and tune solvers and say things on the screen."""
    for name, value in options.items():
        for what, names in FORBIDDEN.items():
            if re.search(names, name.lower()):
                raise error_at(name, f"{what}, so it is taken from the command line only: -{name}")
        if isinstance(value, str):
            check_text(name, value)
    return options


def check_text(name: str, value: str) -> None:
    """See that the value of an option names no file, no further option and nothing that runs code.

    Viewers are written as type:file:format, several with commas between; without a file they write on the screen.
    """
    if re.match(r"\s*-+\s*[a-z_]", value, re.IGNORECASE):
        raise error_at(name, f"{value!r} is an option itself; give it a line of its own")
    parts = [part.strip().partition(":") for part in value.lower().split(",")]
    viewers = any(kind in VIEWERS or (rest and rest[0] != ":") for kind, _, rest in parts)
    if "python" in value.lower() or viewers or re.search(r"[/\\]", value):
        raise error_at(
            name,
            f"{value!r} may write or read a file or run code, so it is taken from the command line only: "
            f"-{name} {value}",
        )
