"""Numbers of a result over each other: one probe over another, and how Newton's method converged."""

from pathlib import Path

from pdpetsc.errors import InputError
from pdpetsc.expressions import hint

FEW = 12
"""Load steps that a legend names; of more, a colour bar tells."""


def plot_curve(
    directory: Path, title: str, columns: dict[str, list], x: str, y: str, labels: dict[str, str] | None = None
) -> Path:
    """Write curve.png: one column of history.csv over another, with a marker for each committed step where they are
    few.

    Args:
        labels: of the axes, by the names of the columns; those without one are called as they are.

    Raises:
        InputError: there is no such column.
    """
    path = directory / "curve.png"
    curve(title, columns, x, y, labels or {}).savefig(path, dpi=150)
    return path


def curve(title: str, columns: dict[str, list], x: str, y: str, labels: dict[str, str]):
    """The figure of `plot_curve`."""
    from matplotlib.figure import Figure

    for name in (x, y):
        if name not in columns:
            raise InputError(
                f"--curve: there is no column {name!r} in history.csv{hint(name, columns)}; choices: "
                f"{', '.join(columns)}"
            )
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(columns[x], columns[y], marker="o" if len(columns[x]) < 100 else None, markersize=4)
    axes.grid(alpha=0.3)
    axes.set_xlabel(labels.get(x, x), parse_math=False)
    axes.set_ylabel(labels.get(y, y), parse_math=False)
    axes.set_title(title, fontsize="medium", parse_math=False)
    return figure


def plot_convergence(directory: Path, title: str, steps: list[dict]) -> Path:
    """Write convergence.png: the residual after each iteration of Newton's method, of each load step.

    Raises:
        InputError: no step was solved by Newton's method.
    """
    path = directory / "convergence.png"
    convergence(title, steps).savefig(path, dpi=150)
    return path


def convergence(title: str, steps: list[dict]):
    """The figure of `plot_convergence`."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    solved = [row for row in steps if row.get("residual_norms") and row.get("residual_scale")]
    if not solved:
        raise InputError("--convergence: no step of this result has residuals of Newton's method")
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.add_subplot()
    first, last = solved[0]["step"], solved[-1]["step"]
    colours = ScalarMappable(Normalize(first, max(last, first + 1)), colormaps["viridis"])
    for row in solved:
        relative = [norm / row["residual_scale"] or None for norm in row["residual_norms"]]  # no logarithm of zero
        style = dict(color=colours.to_rgba(row["step"]), marker="o", markersize=4, linewidth=1)
        axes.semilogy(range(len(relative)), [float("nan") if r is None else r for r in relative], **style)
    if len(solved) > FEW:
        figure.colorbar(colours, ax=axes, label="load step")
    else:
        axes.legend([f"step {row['step']}" for row in solved], fontsize="small")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.grid(alpha=0.3)
    axes.set_xlabel("iteration after the predictor")
    axes.set_ylabel("residual / (loads and reactions)")
    axes.set_title(title, fontsize="medium", parse_math=False)
    return figure
