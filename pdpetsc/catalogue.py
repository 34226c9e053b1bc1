"""The cases that come with the package, and case files as they are before anything in them is checked.

Nothing heavy is imported here: it serves the command line before PETSc, MPI or the models are loaded.
"""

import re
from pathlib import Path

from pdpetsc.errors import InputError, plain
from pdpetsc.toml import read_toml

BUNDLED = Path(__file__).parent / "cases"


def bundled() -> dict[str, Path]:
    """Return the files of the cases that come with the package, by name."""
    return {path.stem: path for path in sorted(BUNDLED.glob("*.toml"))}


def documents() -> dict[str, dict]:
    """Return the tables of every bundled case by name, variants and all."""
    return {name: read(path) for name, path in bundled().items()}


def is_case(word: str) -> bool:
    """Tell whether a word of the command line names a case: FILE.toml, BUNDLED, or one of them with :VARIANT."""
    return re.search(r"\.toml(:[^/]*)?$", word) is not None or word.partition(":")[0] in bundled()


def find(argument: str) -> tuple[Path, str | None]:
    """Return the file that a word names, and the variant.

    Args:
        argument: A path that ends in .toml or the name of a bundled case, with :VARIANT for a variant.

    Raises:
        InputError: There is no such case, or results cannot be called like it.
    """
    word, variant = re.fullmatch(r"(.*\.toml|.*?)(?::([^:/]*))?", argument, re.DOTALL).groups()
    path = Path(word) if word.endswith(".toml") else bundled().get(word)
    if path is None:
        from pdpetsc.expressions import hint

        names = list(bundled())
        choices = f"bundled cases: {', '.join(names)}; a case of your own is a path that ends in .toml"
        raise InputError(f"there is no case {word!r}{hint(word, names)}; {choices}")
    if not path.stem.strip("."):
        raise InputError(f"{shown(path)}: results are called like the case, and this is no name; rename the file")
    return path, variant


def shown(path: Path) -> str:
    """Return a file as messages name it."""
    return plain(path.name if path.parent == BUNDLED else str(path))


def read(path: Path) -> dict:
    """Return the tables of a file.

    Raises:
        InputError: It is not there, or no TOML.
    """
    try:
        return read_toml(path)
    except FileNotFoundError:
        reason = "there is no such file"
    except OSError as error:
        reason = f"cannot be read: {error.strerror.lower()}"
    except ValueError as error:
        reason = str(error)
    raise InputError(f"{shown(path)}: {reason}")
