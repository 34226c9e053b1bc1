"""summary.json, history.csv and the case as run."""

import csv
import io
import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np
import tomli_w

from pdpetsc.errors import InputError
from pdpetsc.io import kept
from pdpetsc.quantities import AXES, QUANTITIES, components
from pdpetsc.toml import check_plain, read_toml

MARK = "# pdpetsc "
"""First words of the case as run: what tells a result directory of ours from others."""


def _pictures(field: str) -> list[str]:
    """The names that pictures of a field may have, but for the number of a step."""
    names = [field, *(f"{field}-{name}" for name in components(field, 3))]
    return [f"{name}{cut}.{kind}" for name in names for cut in ("", "-section") for kind in ("png", "gif")]


def write_case(directory: Path, document: dict, command: str) -> None:
    """Write the case as run, variant and overrides merged."""
    (directory / "case.toml").write_text(f"{MARK}{command}\n{tomli_w.dumps(document)}", encoding="utf-8")


FILES = {
    "case.toml", "summary.json", "summary.new", "history.csv", "history.new", "fields.h5", "fields.damaged",
    "fields.xdmf", "fields.new", "result.png", "curve.png", "checkpoint.h5", "checkpoint.h5.new", "broken_bonds.csv",
    "broken_bonds.new", "convergence.png", "report.html", "report.new",
    *(name for field in QUANTITIES for name in _pictures(field)),
}  # fmt: skip
"""All that a run, its pictures and its report leave in its result directory; pictures of a step have its number too."""


def is_ours(name: str) -> bool:
    """Whether a file of a result directory is called like one that pdpetsc writes."""
    return re.sub(r"-step\d+", "", name) in FILES


def is_result(directory: Path) -> bool:
    """Whether a directory was written by pdpetsc and holds nothing else."""
    try:
        with (directory / "case.toml").open(encoding="utf-8") as file:
            ours = file.read(len(MARK)) == MARK
        return ours and all(is_ours(path.name) for path in directory.iterdir())
    except (OSError, UnicodeDecodeError):
        return False


@contextmanager
def whole(path: Path) -> Iterator[TextIO]:
    """A text file that is written whole or stays what it was."""
    new = path.with_suffix(".new")
    try:
        with new.open("w", newline="", encoding="utf-8") as file:
            yield file
        os.replace(new, path)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def write_history(path: Path, rows: list[dict], begin: int = 0) -> None:
    """Write history.csv whole, or append the rows from `begin` on, all of them or none; each row is a step with the
    probes that are single numbers."""
    scalar = (int, float, str)
    columns = [name for name, value in rows[0].items() if isinstance(value, scalar)]
    probes = [name for name, value in rows[0]["probes"].items() if isinstance(value, scalar)]
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    if not begin:
        writer.writerow([*columns, *probes])
    for row in rows[begin:]:
        writer.writerow([*(row[c] for c in columns), *(row["probes"][p] for p in probes)])
    if not begin:
        with whole(path) as file:
            file.write(text.getvalue())
        return
    size = path.stat().st_size
    try:
        with path.open("a", newline="", encoding="utf-8") as file:
            file.write(text.getvalue())
    except OSError:
        os.truncate(path, size)
        raise


def read_history(directory: Path) -> dict[str, list[float]]:
    """The columns of a result's history.csv that are numbers, by name.

    Raises:
        InputError: there is none.
    """
    try:
        with (directory / "history.csv").open(newline="", encoding="utf-8") as file:
            names, *rows = csv.reader(file)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{directory}: holds no history of load steps ({error})") from None
    columns = {}
    for name, entries in zip(names, zip(*rows)):
        try:
            columns[name] = [float(entry) for entry in entries]
        except ValueError:
            continue  # a word, as True
    return columns


def write_broken_bonds(path: Path, bonds: np.ndarray, ends: np.ndarray, time_of: Callable[[int], float]) -> None:
    """Write the bonds that have failed, whole or not at all: a row for each direction, by load step and ids.

    Args:
        bonds: (n, 3) ids of both ends and the load step.
        ends: (n, 2 dim) positions of both ends.
        time_of: gives the time of a step.
    """
    axes = AXES[: ends.shape[1] // 2]
    order = np.lexsort(bonds.T[[1, 0, 2]])
    times = {step: time_of(step) for step in np.unique(bonds[:, 2]).astype(int).tolist()}
    with whole(path) as file:
        writer = csv.writer(file)
        writer.writerow(["step", "time", "i", "j", *(f"{axis.upper()}_{end}" for end in "ij" for axis in axes)])
        for (i, j, step), place in zip(bonds[order].astype(np.int64).tolist(), ends[order].tolist()):
            writer.writerow([step, times[step], i, j, *(f"{x:.9g}" for x in place)])


def write_summary(path: Path, summary: dict) -> None:
    """Write summary.json, whole or not at all."""
    with whole(path) as file:
        file.write(json.dumps(summary, indent=1) + "\n")


def _reason(error: OSError | ValueError) -> str:
    """Which file, where that is known, and why it is not read."""
    if isinstance(error, OSError) and error.filename:
        return f"{Path(error.filename).name}: {error.strerror}"
    return str(error)


def read_summary(directory: Path) -> dict:
    """The summary.json of a result.

    Raises:
        InputError: there is none.
    """
    try:
        summary = kept.parsed((directory / "summary.json").read_text(encoding="utf-8"))
        kept.check_summary(summary)
        return summary
    except (OSError, ValueError) as error:
        raise InputError(f"{directory}: holds no result of a run that has ended ({_reason(error)})") from None


def read_case(directory: Path) -> dict:
    """The case of a result as it was run, not checked again.

    Raises:
        InputError: there is none.
    """
    try:
        document = read_toml(directory / "case.toml")
    except (OSError, ValueError) as error:
        raise InputError(f"{directory}: holds no result of pdpetsc ({_reason(error)})") from None
    check_plain(document, str(directory / "case.toml"))
    return document


def in_time(summary: dict) -> bool:
    """Whether the t of a result is time, in which the body moved."""
    return summary.get("choices", {}).get("mode") in ("verlet", "generalised_alpha")
