"""What pictures are drawn from: the particles of a step, and the scales that several steps have in common."""

import csv
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from pdpetsc.body.cells import Mesh
from pdpetsc.errors import InputError
from pdpetsc.io.fields import HDF5, body_of, read_mesh, written_steps
from pdpetsc.io.tiles import reached
from pdpetsc.io.view import Section, View
from pdpetsc.quantities import AXES, QUANTITIES, component, scalar

VISIBLE = 0.05
"""Displacements below a fifth of this fraction of the body's size are drawn enlarged to this fraction."""

NEAREST = 1.2
"""Bonds up to this many spacings long have a face between the cells of their ends."""


class Frame(NamedTuple):
    """What a step's picture shows: arrays (n, ...) of particles with three components.

    Attributes:
        torn: (n, 3, 2) whether the bond to the next particle has failed, in each direction of the axes, - and +.
        mesh: whose cells or points the particles are; None: they are those of a lattice, or a cloud.
        apart: (k, 2) particles of a mesh whose bonds have failed.
    """

    position: np.ndarray
    spacing: np.ndarray
    volume: np.ndarray
    u: np.ndarray
    F: np.ndarray
    values: np.ndarray
    torn: np.ndarray
    mesh: Mesh | None
    apart: np.ndarray


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

    @property
    def signed(self) -> bool:
        """Whether values of both signs are shown, in colours that part at zero."""
        return self.values[0] < 0 < self.values[1]


class Broken(NamedTuple):
    """The bonds of broken_bonds.csv.

    Attributes:
        step: (n,) of each, in which it failed.
        ends: (n, 2, dim) where its ends were before deformation.
    """

    step: np.ndarray
    ends: np.ndarray


def read_broken(directory: Path, dim: int) -> Broken | None:
    """The bonds that have failed in a result, or None where there is no list of them.

    Raises:
        InputError: the list is damaged.
    """
    try:
        with (directory / "broken_bonds.csv").open(newline="", encoding="utf-8") as file:
            rows = [[float(entry) for entry in row] for row in list(csv.reader(file))[1:]]
        table = np.array(rows).reshape(-1, 4 + 2 * dim)
    except OSError:
        return None
    except (ValueError, csv.Error) as error:
        raise InputError(f"{directory / 'broken_bonds.csv'}: is damaged ({error})") from None
    if not np.isfinite(table).all():
        raise InputError(f"{directory / 'broken_bonds.csv'}: is damaged (it holds numbers that are not finite)")
    return Broken(table[:, 0].astype(int), table[:, 4:].reshape(-1, 2, dim))


def open_fields(directory: Path) -> h5py.File:
    """The field file of a result, to be read.

    Raises:
        InputError: there is none.
    """
    try:
        return h5py.File(directory / HDF5, "r")
    except OSError as error:
        raise InputError(f"{directory}: has no fields to draw ({error})") from None


def chosen_step(file: h5py.File, step: int | None) -> str:
    """The group of a step in a field file.

    Args:
        step: None: the last one.

    Raises:
        InputError: there is none.
    """
    steps = written_steps(file)
    if not steps:
        raise InputError("the field file holds no step yet")
    if step is None:
        return steps[-1]
    for name in steps:
        if int(name) == step:
            return name
    numbers = [str(int(name)) for name in steps]
    shown = ", ".join(numbers if len(numbers) <= 20 else [*numbers[:10], "...", *numbers[-5:]])
    raise InputError(f"--step {step}: was not written; there is {shown}, and output.every asks for more")


def read_frame(file: h5py.File, step: str, view: View, broken: Broken | None = None) -> Frame:
    """A step of a field file.

    Raises:
        InputError: the field was not written.
    """
    group = file[step]
    if view.field not in QUANTITIES or view.field not in group:
        raise InputError(
            f"--field {view.field}: was not written; there is {', '.join(sorted(group))}, and output.fields asks for "
            "more"
        )
    u = group["u"][...]
    F = group["F"][...].reshape(-1, 3, 3) if "F" in group else np.eye(3)[None].repeat(len(u), axis=0)
    body = body_of(file, int(step))
    position, spacing, volume = (file[body + name][...] for name in ("position", "spacing", "volume"))
    mesh = None if body else read_mesh(file)
    failed = None if broken is None else broken.ends[broken.step <= int(step)]
    torn = torn_faces(position, spacing, None if mesh else failed)
    apart = failed_pairs(position, spacing, failed if mesh else None)
    frame = Frame(position, spacing, volume, u, F, shown_values(view, group[view.field][...]), torn, mesh, apart)
    return frame if view.section is None else behind(frame, view.section)


def behind(frame: Frame, section: Section) -> Frame:
    """The particles with cells behind a plane, as seen by the viewer; all those of a mesh, of others without values.

    Raises:
        InputError: the plane misses the body.
    """
    towards = 1 if section.side else -1
    depth = towards * (section.at - frame.position[:, section.axis]) / frame.spacing + 0.5
    kept = depth > 1e-6
    if not kept.any() or depth.min() > 1 - 1e-6:
        X, half, axis = frame.position[:, section.axis], frame.spacing / 2, AXES[section.axis]
        low, high = (X - half).min(), (X + half).max()
        raise InputError(f"--section {axis}={section.at:g}: misses the body, which goes from {low:g} to {high:g}")
    if frame.mesh is not None:
        return frame._replace(values=np.where(reached(frame.mesh, len(frame.values), section), frame.values, np.nan))
    particles = {name: values[kept] for name, values in frame._asdict().items() if name not in ("mesh", "apart")}
    return frame._replace(**particles)


def shown_values(view: View, values: np.ndarray) -> np.ndarray:
    """The number of each particle by which it is coloured, (n,)."""
    if view.component is None:
        return scalar(view.field, values)
    return component(values.reshape(-1, 3, 3) if QUANTITIES[view.field].rank == 2 else values, view.component)


def torn_faces(position: np.ndarray, spacing: np.ndarray, failed: np.ndarray | None) -> np.ndarray:
    """Which faces of the particles' cells have come apart: those towards a next particle of the lattice whose bond has
    failed, (n, 3, 2).

    Args:
        failed: (k, 2, dim) ends of bonds.
    """
    torn = np.zeros((len(position), 3, 2), bool)
    if failed is None or not len(failed):
        return torn
    i, near = _nearest(position, spacing, failed[:, 0])
    bond = failed[:, 1] - failed[:, 0]
    length = np.sqrt((bond**2).sum(axis=1))
    known = near & (length < NEAREST * spacing[i])
    i, bond = i[known], bond[known]
    axis = np.abs(bond).argmax(axis=1)
    torn[i, axis, (bond[np.arange(len(bond)), axis] > 0).astype(int)] = True
    return torn


def failed_pairs(position: np.ndarray, spacing: np.ndarray, failed: np.ndarray | None) -> np.ndarray:
    """The particles at the ends (k, 2, dim) of bonds, (k, 2)."""
    if failed is None or not len(failed):
        return np.empty((0, 2), np.int64)
    (i, near), (j, there) = (_nearest(position, spacing, failed[:, end]) for end in (0, 1))
    return np.stack([i, j], axis=1)[near & there]


def _nearest(position: np.ndarray, spacing: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The particle nearest to each place, and whether it is there: those that were split are not."""
    from scipy.spatial import cKDTree

    distance, i = cKDTree(position[:, : place.shape[1]]).query(place)
    i = np.minimum(i, len(position) - 1)  # where none is at a finite distance
    return i, distance < spacing[i] / 4


def common_range(frames: Callable[[], Iterable[Frame]], dim: int) -> Range:
    """Of frames that are gone through twice."""
    size, largest, values, ends = 0.0, 0.0, [], []
    for frame in frames():
        size = max(size, float(np.ptp(frame.position, axis=0).max()))
        largest = max(largest, float(np.sqrt((frame.u**2).sum(axis=1)).max()))
        shown = frame.values[np.isfinite(frame.values)]
        values += [float(shown.min(initial=np.inf)), float(shown.max(initial=-np.inf))]
    factor = VISIBLE * size / largest if 0 < largest < VISIBLE * size / 5 else 1.0
    for frame in frames():
        half = frame.spacing[:, None] / 2 * (np.arange(3) < dim)
        x = frame.position + factor * frame.u
        ends.append(((x - half).min(axis=0), (x + half).max(axis=0)))
    lows, highs = (np.array(side) for side in zip(*ends, strict=True))
    return Range(factor, _limits(min(values), max(values)), lows.min(axis=0), highs.max(axis=0))


def _limits(low: float, high: float) -> tuple[float, float]:
    """Of the colours: equal on both sides of zero where values have both signs."""
    if low > high or low == high == 0:  # no number at all, or nothing yet
        return 0.0, 1.0
    if high - low < 1e-6 * max(abs(low), abs(high)):  # a uniform field: no colours for rounding errors
        return low - 0.01 * abs(low), high + 0.01 * abs(high)
    largest = max(-low, high)
    if low < -1e-6 * largest and high > 1e-6 * largest:
        return -largest, largest
    return low, high
