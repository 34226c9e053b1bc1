"""The picture of a result: the deformed body coloured by a field."""

from pathlib import Path

import h5py
import numpy as np

from pdpetsc.io.fields import HDF5

PRESSURE = "{force}/{length}^2"
LABELS = {
    "u": ("displacement |u|", "{length}"),
    "stress": ("von Mises stress", PRESSURE),
    "strain": ("logarithmic strain |e|", ""),
    "energy": ("strain energy density", PRESSURE),
    "reaction": ("reaction |r|", "{force}"),
    "F": ("deformation gradient |F - I|", ""),
    "force": ("external force |f|", "{force}"),
}
"""Label and unit of the number by which each field is coloured."""

VISIBLE = 0.05
"""Displacements below a fifth of this fraction of the body's size are drawn enlarged to this fraction."""


def plot_result(directory: Path, summary: dict, field: str) -> None:
    """Write result.png from the last step in the result's field file."""
    from matplotlib.figure import Figure  # slow to import, and needed on the first rank alone

    with h5py.File(directory / HDF5, "r") as file:
        last = file[max(name for name in file if name.isdigit())]
        position, volume = file["position"][...], file["volume"][...]
        u, values = last["u"][...], colour_values(field, last[field][...])
    dim = summary["dim"]
    size = float(np.ptp(position, axis=0).max())
    largest = float(np.sqrt((u**2).sum(axis=1)).max())
    factor = VISIBLE * size / largest if 0 < largest < VISIBLE * size / 5 else 1.0
    x = position + factor * u

    name, unit = LABELS[field]
    unit = unit.format(**summary["units"])
    figure = Figure(figsize=(9, 5), layout="constrained")
    if dim == 3:
        axes = figure.add_subplot(projection="3d")
        marks = axes.scatter(*x.T, c=values, s=_marker_area(x, volume ** (1 / 3)), depthshade=False)
        axes.set_aspect("equal")
        axes.set_zlabel(f"z [{summary['units']['length']}]")
    else:
        axes = figure.add_subplot()
        marks = _squares(axes, x, summary, values) if dim == 2 else axes.scatter(x[:, 0], 0 * x[:, 0], c=values)
        axes.set_aspect("equal", adjustable="datalim")
    bar = figure.colorbar(marks, ax=axes, shrink=0.8)
    bar.set_label(name + (f" [{unit}]" if unit else ""))
    axes.set_xlabel(f"x [{summary['units']['length']}]")
    axes.set_ylabel(f"y [{summary['units']['length']}]" if dim > 1 else "")
    time = summary["steps"][-1]["time"]
    enlarged = "" if factor == 1.0 else f", displacements x {factor:.3g}"
    axes.set_title(f"{summary['title'] or summary['case']}\nt = {time:g}{enlarged}", fontsize="medium")
    figure.savefig(directory / "result.png", dpi=150)


def colour_values(field: str, values: np.ndarray) -> np.ndarray:
    """One number for each particle: von Mises of a stress, else the magnitude."""
    if field == "stress":
        sigma = values.reshape(-1, 3, 3)
        deviator = sigma - np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        return np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
    if field == "F":
        values = values - np.eye(3).ravel()
    return values if values.ndim == 1 else np.sqrt((values**2).sum(axis=1))


def _squares(axes, x: np.ndarray, summary: dict, values: np.ndarray):
    """Each particle as a square of its cell's width."""
    from matplotlib.collections import PolyCollection

    half = summary["spacing"] / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = PolyCollection(x[:, None, :2] + corners, array=values, edgecolors="face", linewidths=0.2)
    axes.add_collection(squares)
    axes.autoscale_view()
    return squares


def _marker_area(x: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Area in points of markers about as wide as the cells, when the body fills the picture."""
    points = 300 / max(float(np.ptp(x, axis=0).max()), 1e-300)
    return np.maximum(1.0, (points * width) ** 2)
