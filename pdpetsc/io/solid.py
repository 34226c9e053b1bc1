"""Bodies of three dimensions, drawn by matplotlib; where pyvista works it does so better (`rendering`)."""

import numpy as np

from pdpetsc.io.cells import Surface
from pdpetsc.io.frames import Range

BRIGHTNESS = np.array([0.9, 0.85, 1.0])
"""Of faces across each axis."""


def draw_solid(axes, seen: Surface, common: Range, colours: str, length: str):
    """The free faces of the cells; returns what a colour bar needs.

    Args:
        axes: in three dimensions.
        length: unit of the axes.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    mapped = ScalarMappable(Normalize(*common.values), colours)
    shaded = mapped.to_rgba(seen.values)
    shaded[:, :3] *= (seen.normal**2 @ BRIGHTNESS)[:, None]
    axes.add_collection3d(Poly3DCollection(seen.corners, facecolors=shaded, edgecolors=shaded, linewidths=0.1))
    axes.set(**{f"{axis}lim": ends for axis, ends in zip("xyz", zip(common.low, common.high), strict=True)})
    axes.set_box_aspect(common.high - common.low)
    size = common.high - common.low
    for axis, side in zip("xyz", size):
        axes.locator_params(axis, nbins=max(1, round(4 * side / size.max())))
    axes.set_zlabel(f"z [{length}]")
    mapped.set_array(seen.values)
    return mapped
