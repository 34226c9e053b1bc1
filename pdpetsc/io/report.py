"""The report of a result: one page that stands alone, with its numbers and pictures."""

import base64
import io
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from pdpetsc import units as units_of
from pdpetsc.errors import InputError
from pdpetsc.io.curves import convergence, curve
from pdpetsc.io.frames import open_fields
from pdpetsc.io.plot import picture
from pdpetsc.io.tables import in_time, read_case, read_history, read_summary, whole
from pdpetsc.io.trust import believed
from pdpetsc.io.view import View
from pdpetsc.quantities import QUANTITIES, label

FEW = 12
"""Rows of a table that are shown at once; longer ones are opened by the reader."""

DPI = 130
"""Of the pictures."""

BROAD, LONG = 2.5, 3.5
"""Width over height of pictures that have a row of their own, and that are moved about on a narrow screen."""

PICTURES = (View("u"), View("stress"), View("damage"))
"""What is shown of a body, where it was written."""

STEPS = {
    "step": "step", "time": "t", "load_factor": "load factor", "arc_length": "arc length",
    "newton_iterations": "Newton", "linear_iterations": "linear", "passes": "passes",
    "relative_residual": "residual", "rounding_floor": "rounding floor", "broken_bonds": "broken bonds",
    "crack_area": "crack area", "kinetic_energy": "kinetic", "stored_energy": "stored", "external_work": "work",
    "dissipated": "dissipated", "imbalance": "imbalance", "particles": "particles", "seconds": "seconds",
}  # fmt: skip
"""Columns of the table of steps: keys of summary.json, and what they are called."""

REDUCED = {"sum": "sum of the", "mean": "mean", "min": "smallest", "max": "largest", "error": "relative error of the"}
WORDS = {"J": "J-integral", "crack_tip": "position of the crack's tip", "moment": "moment"}

STATUS = {
    "converged": "converged", "separated": "converged: the body came apart", "not_converged": "did not converge",
    "interrupted": "was interrupted", "": "has not ended",
}  # fmt: skip


MODES = {
    "newton": "Newton's method", "relaxation": "dynamic relaxation", "verlet": "velocity Verlet",
    "generalised_alpha": "the generalised-alpha method",
}  # fmt: skip


def write_report(directory: Path, unreadable: str = "") -> Path:
    """Write report.html and return its path. It needs no other file, no network and no script.

    A run that was stopped leaves no summary: then the page has what the case, the history and the fields tell.

    Args:
        unreadable: why the field file is not opened; "": it is.

    Raises:
        InputError: the directory is no result, or it is damaged.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined, TemplateError

    document = read_case(directory)
    page = Environment(loader=PackageLoader("pdpetsc.io", "."), autoescape=True, undefined=StrictUndefined)
    page.filters["number"] = number
    template = page.get_template("report.html")
    with believed(directory, TemplateError):
        text = template.render(contents(directory, document, _summary(directory, document, unreadable), unreadable))
    path = directory / "report.html"
    with whole(path) as file:
        file.write(text)
    return path


def _summary(directory: Path, document: dict, unreadable: str) -> dict:
    """summary.json, or what there is of it before a run has ended."""
    try:
        return read_summary(directory)
    except InputError:
        pass
    try:
        columns = read_history(directory)
    except InputError:
        columns = {}
    whole = ("step", "newton_iterations", "linear_iterations", "broken_bonds", "passes", "particles")
    rows = [dict(zip(columns, row)) for row in zip(*columns.values())]
    names = [probe.get("name") for probe in document.get("probe", ())]
    return {
        "case": directory.resolve().name, "title": document.get("title", ""), "status": "",
        "dim": 3 if unreadable else _dimensions(directory, document),
        "units": {"length": "m", "force": "N", "time": "s"} | document.get("units", {}),
        "choices": {"mode": document.get("solver", {}).get("mode", "newton")},
        "steps": [{key: int(value) if key in whole else value for key, value in row.items()} for row in rows],
        "probes": {name: columns[name][-1] for name in names if columns.get(name)},
    }  # fmt: skip


def _dimensions(directory: Path, document: dict) -> int:
    """Of the body, by its size or by what its particles extend in."""
    if "size" in document.get("body", {}):
        return len(document["body"]["size"])
    try:
        with open_fields(directory) as file:
            return max(1, int((np.ptp(file["position"][...], axis=0) > 0).sum()))
    except (InputError, KeyError):
        return 3


def _lead(document: dict, summary: dict) -> str:
    """What was done, in a sentence."""
    count = f"{summary['particles']} particles" if "particles" in summary else "a body"
    materials = ", ".join(f"{name} ({table.get('model')})" for name, table in document.get("material", {}).items())
    mode = summary.get("choices", {}).get("mode", "newton")
    steps = len(summary["steps"])
    ranks = summary.get("ranks", 1)
    on = f" on {_counted(ranks, 'rank')}" if "ranks" in summary else ""
    return f"{count} in {summary['dim']}D of {materials}; {_counted(steps, 'step')}, {MODES.get(mode, mode)}{on}."


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def contents(directory: Path, document: dict, summary: dict, unreadable: str = "") -> dict:
    """What the page shows: texts, rows of tables, and pictures as data."""
    units = summary["units"]
    motion = in_time(summary)
    columns = units_of.of_history(document, motion)

    def with_unit(name: str, unit: str) -> str:
        return name + units_of.bracketed(unit, units)

    probes = {probe["name"]: probe for probe in document.get("probe", ()) if "name" in probe}
    pictures, reasons = _pictures(directory, document, summary, unreadable)
    return {
        "title": summary["title"] or summary["case"],
        "name": ":".join(filter(None, (summary["case"], summary.get("variant")))),
        "status": STATUS.get(summary["status"], summary["status"]),
        "lead": _lead(document, summary),
        "good": summary.get("converged", False),
        "case": (directory / "case.toml").read_text(encoding="utf-8"),
        "body": _body(document, summary),
        "materials": _materials(document, units),
        "loads": [_load(load, units) for load in document.get("load", ())],
        "choices": _flat(summary.get("choices", {})),
        "steps": _steps(summary["steps"], lambda key: with_unit(STEPS[key], columns.get(key, ""))),
        "few": FEW,
        "probes": [
            (name, _read(probes.get(name, {})), value, units_of.text(units_of.of_probe(probes.get(name, {})), units))
            for name, value in summary.get("probes", {}).items()
        ],
        "energies": [(with_unit(_words(key), units_of.ENERGY), v) for key, v in summary.get("energies", {}).items()],
        "fracture": [
            (with_unit(_words(key), "{length}^2" if key == "crack_area" else ""), value)
            for key, value in summary.get("fracture", {}).items()
            if value is not None
        ],
        "balance": [(_words(key), value) for key, value in summary.get("balance", {}).items()],
        "expect": summary.get("expect", []),
        "timings": [(_words(key), value) for key, value in summary.get("timings", {}).items()],
        "memory": summary.get("peak_memory_mb"),
        "versions": [
            (name, summary[key]) for name, key in (("pdpetsc", "version"), ("PETSc", "petsc_version")) if key in summary
        ],
        "unused": summary.get("unused_options", []),
        "pictures": pictures,
        "reasons": reasons,
    }


def _body(document: dict, summary: dict) -> list[tuple]:
    """Rows of the table of the body."""
    body, units = document.get("body", {}), summary["units"]
    length = units["length"]
    size = " x ".join(number(side) for side in body["size"]) if "size" in body else ""
    rows = [
        ("dimensions", summary["dim"]),
        (f"size [{length}]", size),
        *([(f"thickness [{length}]", body.get("thickness", 1))] if summary["dim"] == 2 else []),
        ("mesh", Path(body.get("mesh") or body.get("points") or "").name),
        ("kept", body.get("keep")),
        (f"spacing [{length}]", body.get("spacing")),
        ("horizon", _horizon(body.get("horizon"), length)),
        ("particles", summary.get("particles")),
        ("bonds, in both directions", summary.get("bonds")),
    ]
    if summary.get("particles") and "bonds" in summary:
        rows.append(("bonds of a family, mean", summary["bonds"] / summary["particles"]))
    if "family_size" in summary:
        rows.append(("bonds of a family, least and most", "{min} and {max}".format(**summary["family_size"])))
    rows.append(("ranks", summary.get("ranks")))
    rows += [("refined", f"{len(summary['refinements'])} times")] if summary.get("refinements") else []
    return [(name, value) for name, value in rows if value not in (None, "")]


def _horizon(horizon, length: str) -> str:
    if isinstance(horizon, dict):
        key, value = next(iter(horizon.items()), ("", ""))
        return f"{value} {length}" if key == "length" else f"{value} times the spacing"
    return f"{number(horizon)} times the spacing" if horizon is not None else ""


def _materials(document: dict, units: dict) -> list[tuple]:
    """(name, rows of key and value) of each material, with its failure."""
    found = []
    for name, table in document.get("material", {}).items():
        rows = list(table.items()) + [(f"failure: {k}", v) for k, v in document.get("damage", {}).get(name, {}).items()]
        labelled = []
        for key, value in rows:
            short = key.removeprefix("failure: ")
            unit = units_of.OF_PROPERTIES.get(short, "") if isinstance(value, (int, float)) else ""
            labelled.append((key + units_of.bracketed(unit, units), _plain(value)))
        found.append((name, labelled))
    return found


def _load(load: dict, units: dict) -> tuple:
    """A row of the table of loads."""
    kind = str(load.get("kind", ""))
    unit = units_of.OF_LOADS.get(kind, "")
    place = load.get("set") or load.get("surface") or ""
    direction = _plain(load.get("component", load.get("normal", "")))
    return (_words(kind), _plain(place), direction, _plain(load.get("value", "")), units_of.text(unit, units))


def _steps(steps: list[dict], called: Callable[[str], str]) -> dict:
    """The table of steps: columns that say something, and rows."""
    keys = [key for key in STEPS if any(key in row for row in steps)]
    keys = [key for key in keys if key not in ("rounding_floor", "load_factor") and not _idle(steps, key)]
    shown = [[_entry(row.get(key)) for key in keys] for row in steps]
    return {"columns": [called(key) for key in keys], "rows": shown}


def _entry(value) -> str:
    """Of the table of steps."""
    return f"{value:.4g}" if isinstance(value, float) else number(value)


def _idle(steps: list[dict], key: str) -> bool:
    """Whether a column is nothing but zeros, or passes of one."""
    return key in ("broken_bonds", "passes", "crack_area") and {row.get(key) for row in steps} <= {0, 1, None}


def _read(probe: dict) -> str:
    """What a probe reads, in words."""
    field, component = probe.get("field", ""), probe.get("component")
    what = WORDS.get(field) or (label(field, component) if field in QUANTITIES and component else field)
    what = " ".join(filter(None, (REDUCED.get(probe.get("reduce"), ""), what)))
    words = {"set": "over the set", "at": "at", "line": "along", "section": "on the section", "tip": "at"}
    for key, word in words.items():
        if key in probe:
            return f"{what} {word} {_plain(probe[key])}"
    return what


def _pictures(
    directory: Path, document: dict, summary: dict, unreadable: str
) -> tuple[list["Picture"], list[str]]:
    """The pictures that can be made, and why others could not: a page is not lost for want of one.

    What was never written is not missed.
    """
    output, title = document.get("output", {}), summary["title"] or summary["case"]
    pictures, reasons = [], [unreadable] if unreadable else []

    def add(caption: str, alternative: str, figure: Callable) -> None:
        try:
            pictures.append(Picture(caption, alternative, figure()))
        except InputError:
            pass
        except Exception as error:  # of a file that was being written when the run was killed
            reasons.append(f"{caption}: {error}")

    views: dict[str, View] = {}  # one of each name: von Mises stress stands for stress
    for view in () if unreadable else (View(output.get("picture", "u")), *PICTURES):
        views.setdefault(label(view.field), view)
    for what, view in views.items():
        add(what, f"The deformed body of {title}, coloured by {what}", partial(picture, directory, summary, view))
    if axes := output.get("curve"):
        x, y = axes["x"], axes["y"]
        labels = units_of.labels_of_history(document, summary["units"], in_time(summary))
        add(f"{y} over {x}", f"Curve of {y} over {x}", lambda: curve(title, read_history(directory), x, y, labels))
    what = "Residual after each iteration, of each load step"
    add("convergence of Newton's method", what, partial(convergence, title, summary["steps"]))
    return pictures, reasons


class Picture:
    """A figure as the page has it.

    Attributes:
        caption, alternative: texts.
        shape: "", "broad" or "broad long".
        data: the address of an image that holds its own data.
    """

    def __init__(self, caption: str, alternative: str, figure):
        self.caption, self.alternative = caption, alternative
        width, height = figure.get_size_inches().tolist()
        self.shape = " ".join(["broad"] * (width > BROAD * height) + ["long"] * (width > LONG * height))
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=DPI, format="png")
        self.data = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def number(value) -> str:
    """A value as it is read: numbers with six digits, lists with their first ones."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        shown = ", ".join(number(entry) for entry in value[:6])
        return f"[{shown}{f', ... ({len(value)} in all)' if len(value) > 6 else ''}]"
    return "" if value is None else str(value)


def _plain(value) -> str:
    """An entry of a case: tables as key = value."""
    if isinstance(value, dict):
        return ", ".join(f"{key} = {_plain(entry)}" for key, entry in value.items())
    return number(value)


def _words(key: str) -> str:
    return key.replace("_", " ")


def _flat(table: dict, above: str = "") -> list[tuple]:
    """Rows of nested tables, keys joined by dots."""
    rows = []
    for key, value in table.items():
        name = f"{above}.{key}" if above else key
        rows += _flat(value, name) if isinstance(value, dict) else [(name, number(value))]
    return rows
