"""TOML that may come from strangers, read within limits."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pdpetsc.errors import InputError

LARGEST, DEEPEST = 2**18, 20
"""Bytes and levels of nesting of a case file."""

ENDLESS = re.compile(r"""(?<![\w"'.-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){40}""")
"""A key of so many parts that tomllib would take minutes."""


def read_toml(path: Path) -> dict:
    """The tables of a file.

    Raises:
        ValueError: it is no TOML, or has more than a case file has.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    try:
        text = content.decode("utf-8-sig")
        if len(content) > LARGEST or ENDLESS.search(text):
            raise ValueError(f"is no case file: it has more than {LARGEST} bytes, or a key of more than 40 parts")
        return tomllib.loads(text)
    except UnicodeDecodeError:
        raise ValueError("is not UTF-8 text") from None
    except RecursionError:
        raise ValueError("is not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"is not valid TOML: {error}") from None


def check_plain(document: Any, place: str) -> None:
    """See that tables are flat and their texts whole: dotted keys nest without end, and whoever follows them in turn
    would run out of stack; a null character ends texts for the system and for PETSc.

    Raises:
        InputError: they are not.
    """
    for depth, level in enumerate(levels(document), 1):
        if depth >= DEEPEST:
            raise InputError(f"{place}: is nested too deeply")
        if any("\0" in text for text in level if isinstance(text, str)):
            raise InputError(f"{place}: holds a null character")


def levels(data: Any) -> Iterator[list]:
    """What tables and lists hold, then what is held in that, and so on to the deepest."""
    level = [data]
    while level := [
        inner
        for outer in level
        if isinstance(outer, dict | list)
        for inner in (outer.values() if isinstance(outer, dict) else outer)
    ]:
        yield level
