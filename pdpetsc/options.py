"""PETSc's options: told from our own on the command line, given to PETSc at its start, checked for use at the end."""

import ctypes
import os
import re
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # of glibc's malloc.h
_OPTION = re.compile(r"-[A-Za-z_]")
# PETSc looks at these only when it ends, after we have asked which options are left.
_USED_AT_THE_END = {"citations", "get_total_flops", "options_left", "options_view", "skip_petscrc"}


def split(arguments: list[str], is_case: Callable[[str], bool]) -> tuple[list[str], list[str]]:
    """Tell our own arguments from PETSc's.

    A PETSc option is ``-name`` with one dash (but not ``-h``), and its value the next word unless that is an option
    itself or a case: `-snes_monitor my.toml` is a flag and a case.

    Args:
        arguments: The command line without the program.
        is_case: Tells whether a word names a case.

    Returns:
        Our arguments and PETSc's, both in order.
    """
    ours, petsc = [], []
    expects_value = False
    for word in arguments:
        if _OPTION.match(word) and word != "-h":
            petsc.append(word)
            expects_value = True
        elif expects_value and not word.startswith("--") and word != "-h" and not is_case(word):
            petsc.append(word)
            expects_value = False
        else:
            ours.append(word)
            expects_value = False
    return ours, petsc


def start(arguments: list[str], defaults: Mapping[str, str | int | float | bool]) -> None:
    """Start PETSc with the options of a case as defaults; PETSC_OPTIONS and the command line win over them.

    The defaults go in front of PETSC_OPTIONS, because some options (`log_view`) are read at the start only. PETSc's
    own report of unused options is switched off unless it is asked for: `unused` makes a better one.

    Args:
        arguments: PETSc's part of the command line.
        defaults: Options without their dash; `True` stands for an option without a value.
    """
    given, own = os.environ.get("PETSC_OPTIONS", ""), Path.home() / ".petscrc"
    first = [f'-options_file "{own}"'] if own.is_file() else []
    words = ["-options_left 0", *first, *(_as_text(name, value) for name, value in defaults.items()), given]
    os.environ["PETSC_OPTIONS"] = " ".join(words).strip()
    import petsc4py

    petsc4py.init(["pdpetsc", "-skip_petscrc", *arguments])  # one in the working directory may be a stranger's
    os.environ["PETSC_OPTIONS"] = given  # for programs that this one starts
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # PETSc's handler would call `pdpetsc | head` a crash
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # and this one, too
    _give_memory_back()


def start_once() -> None:
    """Start PETSc for a script, whose arguments are its own, unless it has been."""
    if "petsc4py.PETSc" not in sys.modules:
        start([], {})


def _give_memory_back() -> None:
    """Let the C library return freed arrays to the system again, where that is glibc: SuperLU_DIST, which comes with
    PETSc, switches that off when it is loaded, and every temporary array would count for good."""
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        mallopt(_M_MMAP_MAX, 65536)
        mallopt(_M_TRIM_THRESHOLD, 2**26)


_defaults: set[str] = set()  # names of the options that `set_defaults` has given


def given() -> dict[str, str]:
    """Return the options that the user has given, by file, environment or command line."""
    from petsc4py import PETSc

    known = PETSc.Options().getAll()  # unlike `hasName` this does not count as use
    return {name: value for name, value in known.items() if name not in _defaults}


def set_defaults(defaults: Mapping[str, str | int | float | bool]) -> None:
    """Give PETSc options, after its start, that the user has not given; defaults of an earlier call are withdrawn."""
    from petsc4py import PETSc

    options = PETSc.Options()
    for name in _defaults:
        options.delValue(name)
    _defaults.clear()
    known = given()
    for name, value in defaults.items():
        if name not in known:
            options.insertString(_as_text(name, value))
            _defaults.add(name)


_of_case: set[str] = set()  # names of the options that `set_case` has given


def set_case(table: Mapping[str, str | int | float | bool]) -> None:
    """Give PETSc the options of a case, after its start, that the user has not given; those of the case before, and the
    defaults of its run, are withdrawn. What PETSc reads at its start only (`log_view`) is too late here."""
    from petsc4py import PETSc

    set_defaults({})
    options = PETSc.Options()
    for name in _of_case:
        options.delValue(name)
    _of_case.clear()
    known = options.getAll()
    for name, value in table.items():
        if name not in known:
            options.insertString(_as_text(name, value))
            _of_case.add(name)


def unused() -> list[str]:
    """Return the options, from wherever they were given, at which nobody has looked on this rank."""
    from petsc4py import PETSc

    library = ctypes.CDLL(PETSc.__file__)
    count = {4: ctypes.c_int32, 8: ctypes.c_int64}[PETSc.IntType().itemsize]()
    names, values = ctypes.POINTER(ctypes.c_char_p)(), ctypes.POINTER(ctypes.c_char_p)()
    left = (None, ctypes.byref(count), ctypes.byref(names), ctypes.byref(values))
    if library.PetscOptionsLeftGet(*left) != 0:
        return []
    found = {names[i].decode() for i in range(count.value)}
    library.PetscOptionsLeftRestore(*left)
    return sorted(found - _USED_AT_THE_END - _defaults)


def _as_text(name: str, value: str | int | float | bool) -> str:
    """Write an option as PETSc reads it from a string; monitors and viewers take no "true"."""
    if value is True or value == "":
        return f"-{name}"
    return f'-{name} "{"false" if value is False else value}"'
