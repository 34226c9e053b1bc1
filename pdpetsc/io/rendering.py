"""Bodies of three dimensions, rendered by pyvista without a screen, where it is installed and works.

Graphics libraries that do not find what they need end the process that they are in: they get one of their own, and
whatever becomes of it, there are the pictures of `solid`.
"""

import os
import subprocess
import sys
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pdpetsc.apart import OF_MPI
from pdpetsc.io.cells import Surface
from pdpetsc.io.frames import Range

SECONDS = 120.0
"""How long the first picture may take, and again as long as all others together."""

PIXELS = 1300
"""The longer side of a picture."""

VIEWER = np.array([0.9, -1.5, 0.9])
"""From where the body is looked at."""

MARGIN = 0.12
"""Of the body's size in the picture, that is left round it, for the axes' directions too."""


def render(surfaces: Iterable[Surface], common: Range, colours: str) -> list[np.ndarray] | None:
    """Pictures (height, width, 3) of surfaces, or None where pyvista is missing or does not work."""
    if find_spec("pyvista") is None:
        return None
    from matplotlib.image import imread

    with TemporaryDirectory() as folder:
        count = 0
        for count, seen in enumerate(surfaces, 1):
            np.savez(Path(folder) / f"{count:06d}.npz", corners=seen.corners, values=seen.values)
        np.savez(Path(folder) / "common.npz", limits=common.values, low=common.low, high=common.high)
        child = [sys.executable, "-m", "pdpetsc.io.rendering", folder, colours]
        try:
            subprocess.run(child, capture_output=True, timeout=SECONDS + 5 * count, check=True, env=_environment())
            return [imread(Path(folder) / f"{k:06d}.png") for k in range(1, count + 1)]
        except (OSError, subprocess.SubprocessError):
            return None


def _environment() -> dict[str, str]:
    """Without a screen, even where there is one, without MPI's other ranks, and with this very package."""
    package = str(Path(__file__).parents[2])
    kept = {name: value for name, value in os.environ.items() if name != "DISPLAY" and not name.startswith(OF_MPI)}
    return kept | {"PYTHONPATH": os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))}


def _main(folder: str, colours: str) -> None:
    """In the process of its own: draws every surface of a folder, seen alike."""
    import pyvista

    with np.load(Path(folder) / "common.npz") as file:
        limits, low, high = file["limits"], file["low"], file["high"]
    width, height = _seen_size(high - low)
    scale = PIXELS / max(width, height)
    for path in sorted(Path(folder).glob("0*.npz")):
        with np.load(path) as file:
            corners, values = file["corners"], file["values"]
        body = pyvista.PolyData(corners.reshape(-1, 3), _polygons(corners))
        plotter = pyvista.Plotter(off_screen=True, window_size=(round(scale * width), round(scale * height)))
        plotter.set_background("white")
        plotter.add_mesh(
            body, scalars=values, preference="cell", cmap=colours, clim=tuple(limits), show_scalar_bar=False,
            show_edges=len(corners) < 20_000, edge_color="black", line_width=1, edge_opacity=0.15,
            ambient=0.55, diffuse=0.5, specular=0.0,  # colours close to those of the bar
        )  # fmt: skip
        plotter.add_axes(viewport=(0.0, 0.0, 0.25, 0.25 * width / height), line_width=3, color="black")
        plotter.enable_parallel_projection()
        centre = (low + high) / 2
        plotter.camera_position = [tuple(centre + 10 * np.ptp([low, high]) * VIEWER), tuple(centre), (0.0, 0.0, 1.0)]
        plotter.camera.parallel_scale = height / 2
        plotter.camera.clipping_range = (np.ptp([low, high]), 40 * np.ptp([low, high]))
        plotter.enable_anti_aliasing("ssaa")
        plotter.screenshot(path.with_suffix(".png"), return_img=False)
        plotter.close()


def _polygons(corners: np.ndarray) -> np.ndarray:
    """For each of n polygons the number of its corners and which they are, one after the other, without the repeated
    ones at the end."""
    n, most, _ = corners.shape
    new = np.ones((n, most), bool)
    new[:, 1:] = (corners[:, 1:] != corners[:, :-1]).any(axis=2)
    count = most - np.argmax(new[:, ::-1], axis=1)
    rows = np.insert(np.arange(n * most).reshape(n, most), 0, count, axis=1)
    return rows[np.arange(-1, most) < count[:, None]]


def _seen_size(size: np.ndarray) -> tuple[float, float]:
    """Width and height of the picture of a box, neither of them narrow [length]."""
    towards = VIEWER / np.linalg.norm(VIEWER)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    width, height = (float(np.abs(direction) @ size) for direction in (right, np.cross(towards, right)))
    border = 2 * MARGIN * max(width, height)
    width, height = width + border, height + border
    return max(width, 0.6 * height), max(height, 0.4 * width)


if __name__ == "__main__":
    _main(*sys.argv[1:])
