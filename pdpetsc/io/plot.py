"""The pictures of a result: the deformed body coloured by a field, still or moving."""

import textwrap
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from pdpetsc.io.cells import surface
from pdpetsc.io.fields import written_steps
from pdpetsc.io.flat import draw_line, draw_plane
from pdpetsc.io.frames import Frame, Range, chosen_step, common_range, extent, open_fields, read_broken, read_frame
from pdpetsc.io.rendering import render
from pdpetsc.io.solid import draw_solid
from pdpetsc.io.tables import in_time
from pdpetsc.io.view import View, check
from pdpetsc.quantities import AXES, QUANTITIES, label
from pdpetsc.units import bracketed, text

SECONDS = 8.0
"""Length of an animation."""

LONG = 4
"""Width over height of bodies under which the colour bar lies."""

COLOURS, SIGNED = "viridis", "coolwarm"
"""Colour maps whose brightness follows the values: of one sign, and of both with grey at zero."""


def plot_result(directory: Path, summary: dict, view: View, name: str) -> Path:
    """Write a picture, NAME.png, of a step in the result's field file, and return its path.

    Raises:
        InputError: there is no such field, component or step, or the section misses the body.
    """
    path = directory / f"{name}.png"
    picture(directory, summary, view).savefig(path, dpi=150)
    return path


def picture(directory: Path, summary: dict, view: View):
    """The figure of `plot_result`."""
    from matplotlib.figure import Figure  # slow to import, and needed on the first rank alone

    check(view, summary["dim"])
    with open_fields(directory) as file:
        step = chosen_step(file, view.step)
        frame = read_frame(file, step, view, read_broken(directory, summary["dim"]))
    common = common_range(lambda: [frame], summary["dim"], view.scale)
    figure = Figure()
    images = _rendered([frame], common, summary, view)
    _draw(figure, summary, view, frame, common, step, images and images[0])
    return figure


def animate_result(directory: Path, summary: dict, view: View, name: str) -> Path:
    """Write an animation, NAME.gif, of all steps in the result's field file, and return its path: one scale of colours
    and displacements, about SECONDS long.

    Raises:
        InputError: there is no such field or component, or the section misses the body.
    """
    from matplotlib.animation import PillowWriter
    from matplotlib.figure import Figure

    check(view, summary["dim"])
    broken = read_broken(directory, summary["dim"])
    with open_fields(directory) as file:
        steps = [chosen_step(file, None)] and written_steps(file)

        def frames() -> Iterable[Frame]:
            return (read_frame(file, step, view, broken) for step in steps)

        common = common_range(frames, summary["dim"], view.scale)
        images = _rendered(frames(), common, summary, view) or [None] * len(steps)
        writer, figure = PillowWriter(fps=min(20.0, max(1.0, len(steps) / SECONDS))), Figure()
        path = directory / f"{name}.gif"
        last = read_frame(file, steps[-1], view, broken)
        _draw(figure, summary, view, last, common, steps[-1], images[-1])  # gives it its size
        with writer.saving(figure, path, 100):
            drawing = track(steps, description="drawing", console=Console(stderr=True), transient=True)
            for step, image in zip(drawing, images):
                figure.clear()
                _draw(figure, summary, view, read_frame(file, step, view, broken), common, step, image)
                writer.grab_frame()
    return path


def _rendered(frames: Iterable[Frame], common: Range, summary: dict, view: View) -> list | None:
    """Images of a body of three dimensions by pyvista, if it works."""
    if summary["dim"] < 3:
        return None
    seen = (surface(frame, common.factor, view.section) for frame in frames)
    return render(seen, common, _colours(common))


def _colours(common: Range) -> str:
    return SIGNED if common.signed else COLOURS


def _draw(figure, summary: dict, view: View, frame: Frame, common: Range, step: str, image) -> None:
    """The body at a step, coloured by a field.

    Args:
        image: of a body of three dimensions, if it has been rendered.
    """
    dim, units = summary["dim"], summary["units"]
    what = label(view.field, view.component) + bracketed(QUANTITIES[view.field].unit, units)
    title = dict(label=_title(summary, view, frame, common, step), fontsize="medium", parse_math=False)
    if dim < 3 or image is not None:  # else it would cut off what is written at the axes
        figure.set_layout_engine("constrained")
    torn = view.field != "damage"  # which shows cracks by itself
    if dim == 1:
        figure.set_size_inches(7, 4)
        axes = figure.add_subplot()
        draw_line(axes, frame, common, torn)
        axes.set_xlabel(f"x [{units['length']}]", parse_math=False)
        axes.set_ylabel(what, parse_math=False)
        axes.set_title(**title)
        return
    if dim == 2:
        axes, marks, place = _plane(figure, frame, common, torn)
    else:
        axes, marks, place = _solid(figure, frame, common, summary, view, image)
    marks.set_clim(*common.values)
    bar = figure.colorbar(marks, ax=axes, **place)
    bar.set_label(what, parse_math=False)
    bar.outline.set_visible(False)
    if image is None:
        axes.set_xlabel(f"x [{units['length']}]", parse_math=False)
        axes.set_ylabel(f"y [{units['length']}]", parse_math=False)
    axes.set_title(**title)


def _plane(figure, frame: Frame, common: Range, torn: bool):
    """Axes with a body of two dimensions, what its colour bar needs, and where that stands: below a long body."""
    width, height, _ = common.high - common.low
    across = 7.0 if width > height else max(5.5 * width / height, 1.5)  # of the axes, in inches
    upright = max(across * height / width, 0.8)
    below = width > LONG * height
    figure.set_size_inches((across + 1, upright + 2.1) if below else (across + 2, upright + 1.5))
    axes = figure.add_subplot()
    marks = draw_plane(axes, frame, common, _colours(common), torn)
    place = dict(location="bottom", shrink=0.6, aspect=40, pad=0.02) if below else dict(shrink=0.8, pad=0.03)
    return axes, marks, place


def _solid(figure, frame: Frame, common: Range, summary: dict, view: View, image):
    """Axes with a body of three dimensions, what its colour bar needs, and where that stands."""
    from matplotlib.cm import ScalarMappable

    if image is None:
        figure.set_size_inches(7.5, 6)
        figure.subplots_adjust(left=0.05, right=0.9, bottom=0.1, top=0.9)
        axes = figure.add_subplot(projection="3d")
        seen = surface(frame, common.factor, view.section)
        marks = draw_solid(axes, seen, common, _colours(common), summary["units"]["length"])
        return axes, marks, dict(shrink=0.8, pad=0.14)
    height, width = image.shape[:2]
    figure.set_size_inches(5.5 * min(1.4, width / height) + 1.6, 5.5 * min(1.0, 1.4 * height / width) + 0.8)
    axes = figure.add_subplot()
    axes.imshow(image)
    axes.set(xticks=[], yticks=[], frame_on=False)
    low, high = extent(frame, 3)
    if (cut := view.section) is not None:
        end = high if cut.side else low
        end[cut.axis] = cut.at
    sizes = high - low
    axes.set_xlabel(f"{' x '.join(f'{size:.3g}' for size in sizes)} {summary['units']['length']}", parse_math=False)
    return axes, ScalarMappable(cmap=_colours(common)), dict(shrink=0.8, pad=0.03)


def _title(summary: dict, view: View, frame: Frame, common: Range, step: str) -> str:
    """What is seen, at which t, how, and where it is largest: three lines, or four of a long title."""
    time = next((row["time"] for row in summary["steps"] if row["step"] == int(step)), None)
    length = summary["units"]["length"]
    parts = [f"step {int(step)}" if time is None else f"t = {time:.4g}"]
    if time is not None and in_time(summary):
        parts[0] += f" {summary['units']['time']}"
    if common.factor != 1.0 and summary["dim"] > 1:
        parts.append(f"displacements x {float(f'{common.factor:.3g}'):g}")
    if view.section is not None:
        parts.append(f"cut at {AXES[view.section.axis]} = {view.section.at:g} {length}")
    title = textwrap.wrap(summary["title"] or summary["case"], 70, max_lines=2, placeholder=" ...")
    return "\n".join([*title, ", ".join(parts), *_peaks(summary, view, frame)])


def _peaks(summary: dict, view: View, frame: Frame) -> list[str]:
    """A line with the largest value and its place before deformation, and of values of both signs the smallest."""
    known = np.flatnonzero(np.isfinite(frame.values))
    if not len(known) or view.field == "damage" or np.ptp(frame.values[known]) == 0:
        return []
    found, units, dim = [], summary["units"], summary["dim"]
    for word, i in (("largest", frame.values[known].argmax()), ("smallest", frame.values[known].argmin())):
        value = frame.values[known[i]]
        if word == "largest" or frame.values[known].max() * value < 0:
            place = ", ".join(f"{x:.4g}" for x in frame.position[known[i], :dim])
            unit = text(QUANTITIES[view.field].unit, units)
            found.append(f"{word} {value:.4g} {unit}".rstrip() + f" at ({place})")
    return [", ".join(found)]
