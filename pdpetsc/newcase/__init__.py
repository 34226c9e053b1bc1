"""`pdpetsc new`: a commented case file that runs as it is."""

import sys
import tomllib
from pathlib import Path

from pdpetsc.errors import InputError
from pdpetsc.newcase.questions import QUESTIONS, answers
from pdpetsc.newcase.text import case_text

DEFAULT_NAME = "my_case.toml"
SCHEMA = "pdpetsc.schema.json"
"""File beside the case, by which editors check it."""


def write(request) -> str:
    """Write a case file by the options of a request of the command line, or by answers where a person sits at a
    terminal and has given none.

    Returns:
        What was done, and what to do next.

    Raises:
        InputError: an option is wrong, or a file is there that may not be replaced.
    """
    path = Path(request.operand or DEFAULT_NAME)
    _check_free(path, request.force)
    given = {name: value for name in QUESTIONS if (value := getattr(request, name)) is not None}
    asking = not given and sys.stdin.isatty() and sys.stdout.isatty()
    text = case_text(answers(given, asking), f"#:schema ./{SCHEMA}\n" if request.schema else "")
    from pdpetsc.case import Case

    Case.from_document(tomllib.loads(text), path.stem, None, str(path), False)
    written = {path: text}
    if request.schema:
        from pdpetsc.schema.editors import schema_text

        written[path.parent / SCHEMA] = f"{schema_text()}\n"
        if not _holds(path.parent / SCHEMA, written[path.parent / SCHEMA]):
            _check_free(path.parent / SCHEMA, request.force)
    for file, content in written.items():
        try:
            file.write_text(content, encoding="utf-8")
        except OSError as error:
            raise InputError(f"{file}: cannot be written ({error.strerror})") from None
    return f"wrote {' and '.join(map(str, written))}\nlook at it, then: pdpetsc {path}"


def _check_free(path: Path, force: bool) -> None:
    if path.exists() and not (force and path.is_file()):
        raise InputError(f"{path}: is there already; choose another name{'' if path.is_dir() else ', or add --force'}")


def _holds(path: Path, text: str) -> bool:
    """Whether a file is there with this text."""
    return path.is_file() and path.read_bytes() == text.encode("utf-8")
