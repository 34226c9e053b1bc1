"""The pictures of a result: the deformed body coloured by a field, still or moving, and one probe over another."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from rich.console import Console
from rich.progress import track

from pdpetsc.errors import InputError
from pdpetsc.io.fields import HDF5, body_of, written_steps
from pdpetsc.quantities import QUANTITIES, scalar

VISIBLE = 0.05
"""Displacements below a fifth of this fraction of the body's size are drawn enlarged to this fraction."""

HALF = 1e-6
"""Fraction by which numbers that are halves may differ from them."""

ALIKE = 0.01
"""Spacings that differ by less than this fraction are drawn as if of one size."""


MARGIN = 0.02
"""Of the body's size, that is left round it."""

SECONDS = 8.0
"""Length of an animation."""


class Frame(NamedTuple):
    """What a step's picture shows: arrays (n, ...) of particles with three components."""

    position: np.ndarray
    spacing: np.ndarray
    volume: np.ndarray
    u: np.ndarray
    F: np.ndarray
    values: np.ndarray


class Range(NamedTuple):
    """What the pictures of all steps of an animation have in common.

    Attributes:
        factor: by which displacements are drawn enlarged.
        values: the smallest and the largest.
        low, high: corners of the box round the deformed body.
    """

    factor: float
    values: tuple[float, float]
    low: np.ndarray
    high: np.ndarray


def plot_result(directory: Path, summary: dict, field: str, name: str) -> Path:
    """Write a picture, NAME.png, of the last step in the result's field file, and return its path.

    Raises:
        InputError: there is no such field.
    """
    from matplotlib.figure import Figure  # slow to import, and needed on the first rank alone

    with h5py.File(directory / HDF5, "r") as file:
        step = written_steps(file)[-1]
        frame = read_frame(file, step, field)
    figure = Figure()
    _draw(figure, summary, field, frame, _range(lambda: [frame], summary["dim"]), _time(summary, step))
    path = directory / f"{name}.png"
    figure.savefig(path, dpi=150)
    return path


def animate_result(directory: Path, summary: dict, field: str, name: str) -> Path:
    """Write an animation, NAME.gif, of all steps in the result's field file, and return its path: one scale of colours
    and displacements, about SECONDS long.

    Raises:
        InputError: there is no such field.
    """
    from matplotlib.animation import PillowWriter
    from matplotlib.figure import Figure

    with h5py.File(directory / HDF5, "r") as file:
        steps = written_steps(file)
        common = _range(lambda: (read_frame(file, step, field) for step in steps), summary["dim"])
        writer, figure = PillowWriter(fps=min(20.0, max(1.0, len(steps) / SECONDS))), Figure()
        path = directory / f"{name}.gif"
        _draw(figure, summary, field, read_frame(file, steps[-1], field), common, 0.0)  # gives it its size
        with writer.saving(figure, path, 100):
            for step in track(steps, description="drawing", console=Console(stderr=True), transient=True):
                figure.clear()
                _draw(figure, summary, field, read_frame(file, step, field), common, _time(summary, step))
                writer.grab_frame()
    return path


def read_frame(file: h5py.File, step: str, field: str) -> Frame:
    """A step of a field file.

    Raises:
        InputError: the field was not written.
    """
    group = file[step]
    if field not in QUANTITIES or field not in group:
        raise InputError(
            f"--field {field}: was not written; there is {', '.join(sorted(group))}, and output.fields asks for more"
        )
    u, values = group["u"][...], scalar(field, group[field][...])
    F = group["F"][...].reshape(-1, 3, 3) if "F" in group else np.eye(3)[None].repeat(len(u), axis=0)
    body = body_of(file, int(step))
    return Frame(*(file[body + name][...] for name in ("position", "spacing", "volume")), u, F, values)


def _time(summary: dict, step: str) -> float:
    times = [row["time"] for row in summary["steps"] if row["step"] == int(step)]
    if not times:
        raise InputError(f"{HDF5}: holds the step {int(step)}, which summary.json does not know")
    return times[0]


def _range(frames: Callable[[], Iterable[Frame]], dim: int) -> Range:
    """Of frames that are gone through twice."""
    size, largest, values, ends = 0.0, 0.0, [], []
    for frame in frames():
        size = max(size, float(np.ptp(frame.position, axis=0).max()))
        largest = max(largest, float(np.sqrt((frame.u**2).sum(axis=1)).max()))
        values += [float(frame.values.min()), float(frame.values.max())]
    factor = VISIBLE * size / largest if 0 < largest < VISIBLE * size / 5 else 1.0
    for frame in frames():
        half = frame.spacing[:, None] / 2 * (np.arange(3) < dim)
        x = frame.position + factor * frame.u
        ends.append(((x - half).min(axis=0), (x + half).max(axis=0)))
    lows, highs = (np.array(side) for side in zip(*ends, strict=True))
    low, high = min(values), max(values)
    if high - low < 1e-6 * max(abs(low), abs(high)):  # a uniform field: no colours for rounding errors
        low, high = low - 0.01 * abs(low), high + 0.01 * abs(high)
    return Range(factor, (low, high), lows.min(axis=0), highs.max(axis=0))


def _draw(figure, summary: dict, field: str, frame: Frame, common: Range, time: float) -> None:
    """The body at a step, coloured by a field."""
    dim, factor = summary["dim"], common.factor
    x = frame.position + factor * frame.u
    shape = np.eye(3) + factor * (frame.F - np.eye(3))
    sides = cell_sides(frame.position[:, :dim], frame.spacing, frame.volume)
    width, height, _ = common.high - common.low
    if dim == 3:
        figure.set_size_inches(7.5, 6)
        figure.subplots_adjust(left=0.05, right=0.9, bottom=0.1, top=0.9)
        axes = figure.add_subplot(projection="3d")
        marks = _cubes(axes, frame, x, shape, sides, common)
        axes.set_zlabel(f"z [{summary['units']['length']}]")
    else:
        across = 7.0 if dim == 1 or width > height else max(5.5 * width / height, 1.5)  # of the axes, in inches
        upright = 0.8 if dim == 1 else max(across * height / width, 0.8)
        figure.set_size_inches(across + 2, upright + 1.5)
        figure.set_layout_engine("constrained")
        axes = figure.add_subplot()
        if dim == 2:
            marks = _squares(axes, x, shape, sides, frame.values)
            border = MARGIN * max(width, height)
            for axis, low, high in zip("xy", common.low, common.high, strict=False):
                axes.set(**{f"{axis}lim": (low - border, high + border)})
        else:
            marks = axes.scatter(x[:, 0], 0 * x[:, 0], c=frame.values)
            axes.set_yticks([])
        axes.set_aspect("equal")
    marks.set_clim(*common.values)
    quantity, units = QUANTITIES[field], summary["units"]
    unit = quantity.unit.format(**units)
    bar = figure.colorbar(marks, ax=axes, shrink=0.8, pad=0.14 if dim == 3 else 0.05)
    bar.set_label(quantity.label + (f" [{unit}]" if unit else ""), parse_math=False)
    axes.set_xlabel(f"x [{units['length']}]")
    axes.set_ylabel(f"y [{units['length']}]" if dim > 1 else "")
    enlarged = "" if factor == 1.0 else f", displacements x {factor:.3g}"
    title = f"{summary['title'] or summary['case']}\nt = {time:.4g}{enlarged}"
    axes.set_title(title, fontsize="medium", parse_math=False)


def plot_curve(directory: Path, title: str, rows: list[dict], x: str, y: str) -> None:
    """Write curve.png: probe y over probe x or "time", with a marker for each committed step where they are few.

    Args:
        rows: one for each step, with the `probes` by their names.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.add_subplot()
    values = ([row["time"] if name == "time" else row["probes"][name] for row in rows] for name in (x, y))
    axes.plot(*values, marker="o" if len(rows) < 100 else None, markersize=4)
    axes.grid(alpha=0.3)
    axes.set_xlabel(x, parse_math=False)
    axes.set_ylabel(y, parse_math=False)
    axes.set_title(title, fontsize="medium", parse_math=False)
    figure.savefig(directory / "curve.png", dpi=150)


def cell_sides(position: np.ndarray, spacing: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Where the sides of each particle's cell are drawn, from the particle: (n, dim, 2).

    A cube of the particle's volume, smaller than its spacing in cells that a border cuts. Particles on vertices, known
    by halves, quarters and eighths of the volume where the body ends, have whole cells that end there.
    """
    dim = position.shape[1]
    share = volume / spacing**dim
    share = share / share.max()
    low, high = position.min(axis=0), position.max(axis=0)
    outermost = np.stack([np.abs(position - end) < HALF * spacing[:, None] for end in (low, high)], axis=-1)
    part = 2.0 ** outermost.sum(axis=(1, 2)) * share
    on_sides = outermost.any(axis=(1, 2))
    vertices = np.median(share[on_sides]) < 0.75
    halved = outermost & (vertices & (np.abs(part - 1) < HALF))[:, None, None]
    whole = halved.any(axis=(1, 2))
    width = spacing * np.where(whole, 1.0, share) ** (1 / dim)
    return np.where(halved, 0.0, 0.5) * width[:, None, None] * np.array([-1, 1])


def _squares(axes, x: np.ndarray, shape: np.ndarray, sides: np.ndarray, values: np.ndarray):
    """Each particle's cell, deformed by its deformation gradient `shape`."""
    from matplotlib.collections import PolyCollection

    corners = sides[:, [0, 1], [[0, 0], [1, 0], [1, 1], [0, 1]]]
    squares = PolyCollection(
        x[:, None, :2] + corners @ shape[:, :2, :2].transpose(0, 2, 1),
        array=values, edgecolors="face", linewidths=0.5, snap=False,  # no white lines where pixels fall between cells
    )  # fmt: skip
    axes.add_collection(squares)
    return squares


def _cubes(axes, frame: Frame, x, shape, sides, common: Range):
    """The free faces of the particles' deformed cells."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    whole = np.abs(sides).max(axis=(1, 2)) > (1 - ALIKE) / 2 * frame.spacing  # smaller ones hide nothing behind them
    faces, colours, brightness = [], [], []
    for axis in range(3):
        for side in (0, 1):
            corners = np.insert(square, axis, side, axis=1)
            free = ~whole
            direction = (2 * side - 1) * np.eye(3)[axis]
            free[whole] = free_faces(frame.position[whole], frame.spacing[whole], direction)
            cells = sides[free][:, [0, 1, 2], corners]
            faces.append(x[free, None] + cells @ shape[free].transpose(0, 2, 1))
            colours.append(frame.values[free])
            brightness.append(np.full(free.sum(), {0: 0.9, 1: 0.85, 2: 1.0}[axis]))
    quads, colours = np.concatenate(faces), np.concatenate(colours)
    mapped = ScalarMappable(Normalize(*common.values))
    shaded = mapped.to_rgba(colours)
    shaded[:, :3] *= np.concatenate(brightness)[:, None]
    axes.add_collection3d(Poly3DCollection(quads, facecolors=shaded, edgecolors=shaded, linewidths=0.1))
    axes.set(**{f"{axis}lim": ends for axis, ends in zip("xyz", zip(common.low, common.high), strict=True)})
    axes.set_box_aspect(common.high - common.low)
    axes.locator_params(nbins=4)
    mapped.set_array(colours)
    return mapped


def free_faces(position: np.ndarray, spacing: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether each particle's cell, a cube of its spacing, has other cells behind its face in a direction of the axes.

    A face is hidden by a cell of its own size that is where the next one in a lattice would be, within half a spacing.
    Where sizes differ, it is hidden when a point behind each quarter of it, a quarter of its own spacing deep, lies in
    a cell of any size: a large face beside small cells is free as long as one of its quarters is.
    """
    from scipy.spatial import cKDTree

    reach, last = float(spacing.max()) / 2, len(position) - 1
    behind = position + spacing[:, None] * direction
    distance, other = cKDTree(position).query(behind, distance_upper_bound=reach)
    hidden = distance < spacing / 2
    if spacing.min() > (1 - ALIKE) * spacing.max():
        return ~hidden
    hidden &= np.abs(spacing[np.minimum(other, last)] - spacing) <= ALIKE * spacing
    rest = np.flatnonzero(~hidden)
    across = np.flatnonzero(direction == 0)
    quarters = np.tile(0.75 * direction, (4, 1))
    quarters[:, across] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]
    points = (position[rest, None] + spacing[rest, None, None] * quarters).reshape(-1, 3)
    slack = 0.1 * np.repeat(spacing[rest], 4)  # cells of a stretched lattice are no cubes
    covered = np.zeros(len(points), bool)
    size = np.floor(np.log(spacing / spacing.min()) / np.log(1.2) + 0.5)
    for cells in (np.flatnonzero(size == kind) for kind in np.unique(size)):  # of about one size: the nearest will do
        bound = spacing[cells].max() / 2 + slack.max()
        distance, other = cKDTree(position[cells]).query(points, p=np.inf, distance_upper_bound=bound)
        covered |= distance <= spacing[cells[np.minimum(other, len(cells) - 1)]] / 2 + slack
    hidden[rest] = covered.reshape(-1, 4).all(axis=1)
    return ~hidden
