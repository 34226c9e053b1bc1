"""What pictures are drawn from: the particles of a step, and the scales that several steps have in common."""

import csv
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from pdpetsc.body.cells import Mesh
from pdpetsc.errors import InputError
from pdpetsc.io import tiles
from pdpetsc.io.fields import HDF5, body_of, read_mesh, written_steps
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
        mesh: the cells that are seen, whose particles are in them or on their points; None: of a lattice, or a cloud.
        apart: (k, 2) particles of a mesh whose bonds have failed.
        alone: mask of those of them that have lost bonds, before the start too: cracks open there.
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
    alone: np.ndarray


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
    alone = file["mesh/cracked"][...] > 0 if mesh else np.zeros(len(u), bool)
    alone[apart] = True
    frame = Frame(position, spacing, volume, u, F, shown_values(view, group[view.field][...]), torn, mesh, apart, alone)
    return frame if view.section is None else behind(frame, view.section)


def behind(frame: Frame, section: Section) -> Frame:
    """The particles with cells behind a plane, as seen by the viewer; of a mesh the cells, and all particles, those
    before the plane without values.

    Raises:
        InputError: the plane misses the body.
    """
    if frame.mesh is not None:
        X = frame.mesh.points[:, section.axis]
        if not X.min() < section.at < X.max():
            raise _missed(section, X.min(), X.max())
        mesh = tiles.behind(frame.mesh, section)
        hidden = np.ones(len(frame.values), bool)
        hidden[mesh.particle[mesh.particle >= 0]] = False
        return frame._replace(mesh=mesh, values=np.where(hidden, np.nan, frame.values))
    towards = 1 if section.side else -1
    depth = towards * (section.at - frame.position[:, section.axis]) / frame.spacing + 0.5
    kept = depth > 1e-6
    if not kept.any() or depth.min() > 1 - 1e-6:
        X, half = frame.position[:, section.axis], frame.spacing / 2
        raise _missed(section, (X - half).min(), (X + half).max())
    particles = {
        name: values[kept] for name, values in frame._asdict().items() if name not in ("mesh", "apart", "alone")
    }
    return frame._replace(**particles)


def _missed(section: Section, low: float, high: float) -> InputError:
    axis = AXES[section.axis]
    return InputError(f"--section {axis}={section.at:g}: misses the body, which goes from {low:g} to {high:g}")


def extent(frame: Frame, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """The corners of the box round the body before deformation."""
    if frame.mesh is not None:
        X = np.pad(frame.mesh.points, ((0, 0), (0, 3 - dim)))
        return X.min(axis=0), X.max(axis=0)
    half = frame.spacing[:, None] / 2 * (np.arange(3) < dim)
    return (frame.position - half).min(axis=0), (frame.position + half).max(axis=0)


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
    i, near = _nearest(position, spacing, failed.reshape(-1, failed.shape[2]))
    return i.reshape(-1, 2)[near.reshape(-1, 2).all(axis=1)]


def _nearest(position: np.ndarray, spacing: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The particle nearest to each place, and whether it is there: those that were split are not."""
    from scipy.spatial import cKDTree

    distance, i = cKDTree(position[:, : place.shape[1]]).query(place)
    i = np.minimum(i, len(position) - 1)  # where none is at a finite distance
    return i, distance < spacing[i] / 4


def tile_places(frame: Frame) -> np.ndarray:
    """The points of a frame's mesh and their displacements, (points, 2 dim).

    The displacements are those of the particles on them, or the mean of what those of the cells around would give them,
    u + (F - 1) (X - X_i), without those whose bonds have failed if there are others.
    """
    mesh, dim = frame.mesh, frame.mesh.points.shape[1]
    if mesh.on == "points" and (mesh.particle >= 0).all():
        return np.hstack([mesh.points, frame.u[mesh.particle, :dim]])
    there = mesh.cells >= 0
    of = mesh.particle[:, None] if mesh.on == "cells" else mesh.corners_of(mesh.particle, -1)
    total, weight = np.zeros_like(mesh.points), np.zeros(len(mesh.points))
    share = np.where(frame.alone, 1e-9, 1.0)
    for corner in range(mesh.cells.shape[1]):
        for particle in of.T:
            known = there[:, corner] & (particle >= 0)
            point, i = mesh.cells[known, corner], particle[known]
            arm = mesh.points[point] - frame.position[i, :dim]
            u = frame.u[i, :dim] + np.einsum("nij,nj->ni", frame.F[i, :dim, :dim], arm) - arm
            weight += np.bincount(point, share[i], len(weight))
            total += np.stack([np.bincount(point, share[i] * u[:, k], len(weight)) for k in range(dim)], axis=1)
    u = total / np.maximum(weight, np.finfo(float).tiny)[:, None]
    if mesh.on == "points":
        own = mesh.particle >= 0
        u[own] = frame.u[mesh.particle[own], :dim]
    return np.hstack([mesh.points, u])


def common_range(frames: Callable[[], Iterable[Frame]], dim: int, scale: float | None = None) -> Range:
    """Of frames that are gone through twice; `scale`: as of a View.

    Raises:
        InputError: a mesh has not the dimensions of the body.
    """
    size, largest, values, ends = 0.0, 0.0, [], []
    for frame in frames():
        if frame.mesh is not None and frame.mesh.points.shape[1] != dim:
            raise InputError(f"{HDF5}: is damaged: the dimensions of its mesh are not the {dim} of the body")
        size = max(size, float(np.ptp(frame.position, axis=0).max()))
        largest = max(largest, float(np.sqrt((frame.u**2).sum(axis=1)).max()))
        shown = frame.values[np.isfinite(frame.values)]
        values += [float(shown.min(initial=np.inf)), float(shown.max(initial=-np.inf))]
    factor = VISIBLE * size / largest if 0 < largest < VISIBLE * size / 5 else 1.0
    factor = factor if scale is None else scale
    for frame in frames():
        some = slice(None) if frame.mesh is None else frame.alone
        half = frame.spacing[some, None] / 2 * (np.arange(3) < dim)
        x = (frame.position + factor * frame.u)[some]
        points = [x - half, x + half]
        if frame.mesh is not None:
            places = tile_places(frame)
            points.append(np.pad(places[:, :dim] + factor * places[:, dim:], ((0, 0), (0, 3 - dim))))
        points = np.concatenate(points)
        ends.append((points.min(axis=0), points.max(axis=0)))
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
