"""summary.json, history.csv and the case as run."""

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tomli_w

from pdpetsc.errors import InputError
from pdpetsc.io import kept
from pdpetsc.quantities import AXES, QUANTITIES

MARK = "# pdpetsc "
"""First words of the case as run: what tells a result directory of ours from others."""


def write_case(directory: Path, document: dict, command: str) -> None:
    """Write the case as run, variant and overrides merged."""
    (directory / "case.toml").write_text(f"{MARK}{command}\n{tomli_w.dumps(document)}", encoding="utf-8")


FILES = {
    "case.toml", "summary.json", "summary.new", "history.csv", "fields.h5", "fields.xdmf", "result.png", "curve.png",
    "checkpoint.h5", "checkpoint.h5.new", "broken_bonds.csv", "broken_bonds.new",
    *(f"{field}.{kind}" for field in QUANTITIES for kind in ("png", "gif")),
}  # fmt: skip
"""All that a run leaves in its result directory."""


def is_result(directory: Path) -> bool:
    """Whether a directory was written by pdpetsc and holds nothing else."""
    try:
        ours = (directory / "case.toml").read_text(encoding="utf-8").startswith(MARK)
        return ours and {path.name for path in directory.iterdir()} <= FILES
    except (OSError, UnicodeDecodeError):
        return False


def write_history(path: Path, rows: list[dict], begin: int = 0) -> None:
    """Write history.csv whole, or append the rows from `begin` on; each row is a step with the probes that are single
    numbers."""
    scalar = (int, float, str)
    columns = [name for name, value in rows[0].items() if isinstance(value, scalar)]
    probes = [name for name, value in rows[0]["probes"].items() if isinstance(value, scalar)]
    with path.open("a" if begin else "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if not begin:
            writer.writerow([*columns, *probes])
        for row in rows[begin:]:
            writer.writerow([*(row[c] for c in columns), *(row["probes"][p] for p in probes)])


def write_broken_bonds(path: Path, bonds: np.ndarray, ends: np.ndarray, time_of: Callable[[int], float]) -> None:
    """Write the bonds that have failed, whole or not at all: a row for each direction, by load step and ids.

    Args:
        bonds: (n, 3) ids of both ends and the load step.
        ends: (n, 2 dim) positions of both ends.
        time_of: gives the time of a step.
    """
    axes, new = AXES[: ends.shape[1] // 2], path.with_suffix(".new")
    order = np.lexsort(bonds.T[[1, 0, 2]])
    times = {step: time_of(step) for step in np.unique(bonds[:, 2]).astype(int).tolist()}
    with new.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["step", "time", "i", "j", *(f"{axis.upper()}_{end}" for end in "ij" for axis in axes)])
        for (i, j, step), place in zip(bonds[order].astype(np.int64).tolist(), ends[order].tolist()):
            writer.writerow([step, times[step], i, j, *(f"{x:.9g}" for x in place)])
    os.replace(new, path)


def write_summary(path: Path, summary: dict) -> None:
    """Write summary.json, whole or not at all."""
    new = path.with_suffix(".new")
    new.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    os.replace(new, path)


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
        raise InputError(f"{directory}: holds no result of a run that has ended ({error})") from None
