"""Bodies of one and two dimensions, drawn."""

import numpy as np

from pdpetsc.io.cells import cell_sides, deformed, deformed_tiles, tile_places
from pdpetsc.io.frames import Frame, Range
from pdpetsc.io.tiles import areas, edges

MARGIN = 0.02
"""Of the body's size, that is left round it."""

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
"""Of a cell, which of its sides meet in each."""

EDGES = {(0, 0): (0, 3), (0, 1): (1, 2), (1, 0): (0, 1), (1, 1): (3, 2)}
"""Corners at the ends of the edge across an axis, at its lower and its upper side."""


def draw_line(axes, frame: Frame, common: Range, torn: bool) -> None:
    """The values of a body of one dimension over the places of its particles before deformation.

    Args:
        torn: whether it is shown where cells have come apart.
    """
    order = np.argsort(frame.position[:, 0])
    X, values = frame.position[order, 0], frame.values[order]
    axes.plot(X, values, marker=".", markersize=4 if len(X) < 300 else 0, linewidth=1)
    if torn:
        for crack in (X + frame.spacing[order] / 2)[frame.torn[order, 0, 1]]:
            axes.axvline(crack, color="black", linewidth=0.8)
    low, high = common.values
    border = 0.05 * (high - low) or 1.0
    axes.set_ylim(low - border, high + border)
    axes.grid(alpha=0.3)


def draw_plane(axes, frame: Frame, common: Range, colours: str, torn: bool):
    """Each particle's cell, deformed by its deformation gradient; returns what a colour bar needs.

    Args:
        torn: whether the edges along which cells have come apart are drawn, in black.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    if frame.mesh is None:
        sides = cell_sides(frame.position[:, :2], frame.spacing, frame.volume)
        corners = deformed(frame, common.factor, sides[:, [0, 1], CORNERS], slice(None))
        values = frame.values
    else:
        places = tile_places(frame)
        parts = areas(frame.mesh, places)
        corners, values = deformed_tiles(frame, common.factor, parts), frame.values[parts.owner]
    cells = PolyCollection(
        corners, array=values, cmap=colours, edgecolors="face", linewidths=0.5,
        snap=False,  # no white lines where pixels fall between cells
    )  # fmt: skip
    axes.add_collection(cells)
    if torn:
        if frame.mesh is None:
            cracks = [corners[frame.torn[:, axis, side]][:, ends] for (axis, side), ends in EDGES.items()]
        else:
            cracks = [deformed_tiles(frame, common.factor, edges(frame.mesh, places, frame.apart))]
        axes.add_collection(LineCollection(np.concatenate(cracks), colors="black", linewidths=0.8))
    border = MARGIN * max((common.high - common.low)[:2])
    for axis, low, high in zip("xy", common.low, common.high):
        axes.set(**{f"{axis}lim": (low - border, high + border)})
    axes.set_aspect("equal")
    return cells
