"""Pictures and reports: of a run that ends, and of results that are there."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from petsc4py import PETSc

from pdpetsc.case import load
from pdpetsc.errors import InputError
from pdpetsc.io import tables
from pdpetsc.io.curves import plot_convergence, plot_curve
from pdpetsc.io.fields import HDF5
from pdpetsc.io.plot import animate_result, plot_result
from pdpetsc.io.report import write_report
from pdpetsc.io.trust import believed, check_fields, check_no_links
from pdpetsc.io.view import View
from pdpetsc.parallel import collective, say, warn
from pdpetsc.units import labels_of_history


def draw(comm, out: Path, summary: dict, field: str) -> None:
    """The pictures of a run, by one rank; the run is not lost for want of them.

    Args:
        out: result directory.
        field: by which the body is coloured.
    """
    try:
        plot_result(out, summary, View(field), "result")
        if tables.read_case(out).get("output", {}).get("curve"):
            _plot_curve(out, summary["title"] or summary["case"], summary, [])
    except Exception as error:
        warn(comm, f"a picture was not made: {error}")


def plot(
    directory: Path, view: View, animate: bool = False, curve: list[str] | None = None, convergence: bool = False
) -> int:
    """Draw a result: a field of a step or of all of them moving, a curve, or how Newton's method converged; the exit
    code of the command line.

    Args:
        directory: of the result.
        view: what is seen of the body; without a field, that of `output.picture`.
        animate: whether all steps are drawn.
        curve: two columns of history.csv, x and y, one over the other instead of the body; [] as `output.curve` says.
        convergence: whether residuals are drawn instead of the body.

    Raises:
        InputError: there is no such result, field or column.
    """
    comm = PETSc.COMM_WORLD
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            check_no_links(directory)
            with believed(directory), _writable(directory):
                path = _plotted(directory, view, animate, curve, convergence)
            say(comm, f"{path}")
    return 0


def _plotted(directory: Path, view: View, animate: bool, curve: list[str] | None, convergence: bool) -> Path:
    summary = tables.read_summary(directory)
    title = summary["title"] or summary["case"]
    if convergence:
        return plot_convergence(directory, title, summary["steps"])
    if curve is not None:
        return _plot_curve(directory, title, summary, curve)
    check_fields(directory / HDF5)
    view = view._replace(field=view.field or load(str(directory / "case.toml")).output.picture)
    return (animate_result if animate else plot_result)(directory, summary, view, view.name)


def _plot_curve(directory: Path, title: str, summary: dict, axes: list[str]) -> Path:
    """The curve of two columns, or that of the case."""
    document = tables.read_case(directory)
    chosen = document.get("output", {}).get("curve")
    if not axes and not chosen:
        raise InputError("--curve: the case has no output.curve; name two columns of history.csv, x and y")
    x, y = axes or (chosen["x"], chosen["y"])
    labels = labels_of_history(document, summary["units"], tables.in_time(summary))
    return plot_curve(directory, title, tables.read_history(directory), x, y, labels)


def report(directory: Path) -> int:
    """Write the report of a result, one page that stands alone; the exit code of the command line.

    Raises:
        InputError: there is no such result.
    """
    comm = PETSc.COMM_WORLD
    with collective(comm.tompi4py()):
        if comm.rank == 0:
            check_no_links(directory)
            with _writable(directory):
                path = write_report(directory, _why_unreadable(directory / HDF5))
            say(comm, f"{path}")
    return 0


@contextmanager
def _writable(directory: Path) -> Iterator[None]:
    """Where a picture cannot be written, the directory is no good input."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{directory}: cannot be written ({error.strerror or error})") from None


def _why_unreadable(path: Path) -> str:
    """Why a field file is better not opened; "" where it may be, or is not there."""
    try:
        if path.is_file():
            check_fields(path)
    except InputError as error:
        return str(error)
    return ""
