"""Lattice bodies: a line, a rectangle or a block of cells, with one particle in the middle of each or several, or of
vertices, with a particle on each."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from petsc4py import PETSc

from pdpetsc.body.border import FEW_SAMPLES, SAMPLES, Cut, cut_cells
from pdpetsc.body.slivers import adopted
from pdpetsc.errors import InputError
from pdpetsc.expressions import coordinates
from pdpetsc.memory import check_room
from pdpetsc.parallel import collective, warn
from pdpetsc.particles import Facets, Points

FACES = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1), "back": (2, 0), "front": (2, 1)}
"""Faces of a box: axis and side (0: towards smaller coordinates); they are numbered in this order, 2 axis + side."""

NOTHING_LEFT = (
    "body.keep: no particle is left; the condition is false everywhere, or where it holds is less than a cell"
)

MOST_ROWS, PARTICLE, ROOM = 1e8, 300, ", with body.refine and body.zones,"
"""Of cells in a layer; bytes that a particle takes while it is made; what says how many there are."""

BLOCK = 1 << 16
"""Cells that are looked at together where not all of them fit."""


def layer_rows(width: float, cell: float) -> int:
    """Rows of cells in a fictitious layer of this width [length], at least one."""
    rows = width / cell + 1e-6
    if rows > MOST_ROWS:
        raise InputError(f"body.layers: a layer of {width:g} has {rows:.3g} rows of cells, too many")
    return max(1, int(rows))


class Parts(NamedTuple):
    """Parts of cells, each for one particle.

    Attributes:
        middle, low, high: (n, dim) middles and corners.
        outermost: (n, dim, 2) which of their sides are sides of the lattice.
        cut: as the border of a fitted body cuts them.
        kept: mask of those that have a particle.
        position, volume, spacing: of the particles.
    """

    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray
    outermost: np.ndarray
    cut: Cut | None
    kept: np.ndarray
    position: np.ndarray
    volume: np.ndarray
    spacing: np.ndarray


@dataclass(frozen=True)
class Lattice:
    """The cells of a box and of its layers, x fastest, before any particle is made.

    With particles on vertices a cell is what is nearest to its vertex: half of one on a side of the box, a quarter or
    an eighth in corners (seed 003 Fig. 2).

    Attributes:
        body: size, spacing, origin, thickness, refine, particles, fitted of the case's `[body]`.
        keep: condition of X, Y, Z, spacing that tells which particles exist, or None.
        cell: (dim,) widths of a cell [length].
        counts: (dim,) cells in each direction, those of layers included.
        first: (dim,) index of the first cell, less than 0 in a layer; the body's own begin with 0.
        zones: in which cells are divided, besides what `refine` says (body/zones.py).
    """

    body: Any
    keep: Any
    cell: np.ndarray
    counts: np.ndarray
    first: np.ndarray
    zones: tuple = ()

    @classmethod
    def of(cls, body, keep, horizon, zones: tuple = ()) -> "Lattice":
        """The lattice of a case's `[body]`, with layers as wide as they say in the largest horizon at their face.

        Raises:
            InputError: the size is no multiple of the spacing, or there are more cells than can be numbered.
        """
        size = np.array(body.size, float)
        _check_number(body, float(np.prod(np.maximum(1, size / body.spacing))))
        inner = np.maximum(1, np.rint(size / body.spacing)).astype(np.int64)
        cell = size / inner
        if np.any(np.abs(cell / body.spacing - 1) > 0.05):
            raise InputError(
                f"body.size: {list(body.size)} is not a multiple of the spacing {body.spacing:g}; "
                f"the nearest lattice has {' x '.join(map(str, inner))} cells of {_widths(cell)}"
            )
        alone = cls(body, keep, cell, inner + (body.particles == "vertices"), np.zeros_like(inner), zones)
        _check_number(body, alone.cells)
        extra = np.zeros((len(size), 2), np.int64)
        for face, width in body.layers.items():
            axis, side = FACES[face]
            reach = alone.largest_horizon(face, horizon) if width.in_horizons else 0.0
            extra[axis, side] = layer_rows(width.length(reach), cell[axis])
        lattice = cls(body, keep, cell, alone.counts + extra.sum(axis=1), -extra[:, 0], zones)
        _check_number(body, lattice.cells)
        return lattice

    @property
    def dim(self) -> int:
        return len(self.cell)

    @property
    def cells(self) -> int:
        return math.prod(map(int, self.counts))

    @property
    def spacing(self) -> float:
        """Of the particles of undivided cells [length]."""
        return float(np.prod(self.cell) ** (1 / self.dim))

    def middles(self, index: np.ndarray) -> np.ndarray:
        """Where the particles (n, dim) of undivided cells are."""
        return np.array(self.body.origin) + (index + (0.5 if self.body.particles == "cells" else 0.0)) * self.cell

    def indices(self, numbers: np.ndarray) -> np.ndarray:
        """Indices (n, dim) of the cells with these numbers."""
        return np.stack(np.unravel_index(numbers, self.counts, order="F"), axis=1) + self.first

    def divisions(self, index: np.ndarray) -> np.ndarray:
        """Particles along an edge of each cell, as floating-point numbers that may be too large for an integer."""
        position, values = self.middles(index), np.ones(len(index))
        if self.body.refine is not None:
            values = self.body.refine(**coordinates(position, np.full(len(position), self.spacing)))
        bad = np.flatnonzero(values < 1 - 1e-6)
        if len(bad):
            raise InputError(
                f"body.refine: is {values[bad[0]]:g} at ({_place(position[bad[0]])}), but a cell has at least 1 "
                "particle along its edges"
            )
        for zone in self.zones:
            values = np.where(zone.reaches(self, position), np.maximum(values, zone.divide), values)
        return np.floor(values + 1e-6)  # 0.3 / 0.1 is 3

    def points(
        self, index: np.ndarray, division: np.ndarray, horizon, facets: bool = False, roughly: bool = False
    ) -> Points:
        """The particles of these cells that are kept, with the row of their cell in `index` as id.

        Args:
            index: (n, dim) the cells.
            division: (n,) particles along an edge of each.
            horizon: function of (position, spacing).
            facets: whether the pieces of the body's surface are wanted as well.
            roughly: whether a first look at fitted borders will do.

        Raises:
            InputError: a horizon is not greater than 0.
        """
        check_room("body.spacing" + ROOM, "particles", float((division**self.dim).sum()), PARTICLE)
        division = division.astype(np.int64)
        middle, cell = _divide(index, division, self)
        parts = self.parts(index[cell], middle, self.spacing / division[cell], roughly)
        place, size = parts.position[parts.kept], parts.spacing[parts.kept]
        horizons = horizon(place, size)
        if np.any(horizons <= 0):
            raise InputError(
                f"body.horizon: is {horizons.min():g} at ({_place(place[np.argmin(horizons)])}); "
                "it must be greater than 0"
            )
        points = Points(cell[parts.kept], place, parts.volume[parts.kept], size, horizons)
        if facets:
            points.facets = self.facets(parts)
        return points

    def parts(self, index: np.ndarray, middle: np.ndarray, spacing: np.ndarray, roughly: bool = False) -> "Parts":
        """Parts of cells, one for a particle each.

        Args:
            index: (n, dim) the cell that each belongs to.
            middle: (n, dim) of the parts.
            spacing: (n,) of their particles.
            roughly: as of `points`.
        """
        divisions = np.rint(self.spacing / spacing)
        half = self.cell / divisions[:, None] / 2
        low, high, outermost = middle - half, middle + half, self._outermost(index, middle, half)
        position, volume = middle, np.prod(self.cell) * self.body.thickness / divisions**self.dim
        if self.body.particles == "vertices":
            low, high = np.where(outermost[..., 0], position, low), np.where(outermost[..., 1], position, high)
            volume = volume / 2.0 ** outermost.sum(axis=(1, 2))
        cut, kept = None, np.ones(len(middle), bool)
        if self.keep is not None and self.body.fitted:
            size = (FEW_SAMPLES if roughly else SAMPLES)[self.dim]
            cut = cut_cells(lambda X, row: self.keep.mask(**coordinates(X, spacing[row])), low, high, outermost, size)
            kept = cut.share > 0
            position = np.where((cut.share < 1)[:, None], cut.middle, position)
            volume = volume * cut.share
        elif self.keep is not None:
            kept = self.keep.mask(**coordinates(position, spacing))
        return Parts(middle, low, high, outermost, cut, kept, position, volume, spacing)

    def _outermost(self, index: np.ndarray, position: np.ndarray, half: np.ndarray) -> np.ndarray:
        """Which sides of the particles' cells are sides of the lattice, (n, dim, 2)."""
        if self.body.particles == "vertices":
            return np.stack([index == self.first, index == self.first + self.counts - 1], axis=-1)
        low = np.array(self.body.origin) + self.first * self.cell
        high = low + self.counts * self.cell
        return np.stack([position - 1.5 * half < low, position + 1.5 * half > high], axis=-1)

    def facets(self, parts: "Parts") -> Facets:
        """The sides of kept parts on the sides of the lattice, and the pieces of surface in cut ones; the parent is
        the number among the kept ones, -1 - row where too little of a part is inside for a particle."""
        dim, thickness = self.dim, self.body.thickness
        low, high, cut = parts.low, parts.high, parts.cut
        number = np.where(parts.kept, np.cumsum(parts.kept) - 1, -1 - np.arange(len(parts.kept)))
        parents, codes, points, areas = [], [], [], []
        for face, (axis, side) in FACES.items():
            if axis >= dim:
                continue
            rows = np.flatnonzero(parts.outermost[:, axis, side] & (cut.share == 1 if cut else parts.kept))
            point = parts.middle[rows]
            point[:, axis] = (high if side else low)[rows, axis]
            area = np.zeros((len(rows), dim))
            area[:, axis] = (2 * side - 1) * np.delete((high - low)[rows], axis, axis=1).prod(axis=1)
            parents.append(number[rows])
            codes.append(np.full(len(rows), list(FACES).index(face)))
            points.append(point)
            areas.append(area)
        if cut:
            parents.append(number[cut.row])
            codes.append(cut.face)
            points.append(cut.point)
            areas.append(cut.area)
        return Facets(  # type: ignore[call-arg]
            *(np.concatenate(values) for values in (parents, codes, points)), np.concatenate(areas) * thickness
        )

    def largest_horizon(self, face: str, horizon) -> float:
        """The largest horizon at a face: of a particle in the middle of each of the cells along it that are kept."""
        axis, side = FACES[face]
        counts = self.counts.copy()
        counts[axis] = 1
        largest = 0.0
        for numbers in blocks_of(math.prod(map(int, counts))):
            index = np.stack(np.unravel_index(numbers, counts, order="F"), axis=1)
            index[:, axis] = side * (self.counts[axis] - 1)
            position = self.middles(index)
            spacing = self.spacing / self.divisions(index)
            if self.keep is not None:
                kept = self.keep.mask(**coordinates(position, spacing))
                position, spacing = position[kept], spacing[kept]
            largest = max(largest, float(horizon(position, spacing).max(initial=0.0)))
        return largest


def blocks_of(count: int) -> Iterator[np.ndarray]:
    """The numbers 0 ... count - 1, some at a time."""
    for first in range(0, count, BLOCK):
        yield np.arange(first, min(count, first + BLOCK))


def box(comm, body, keep, horizon, facets: bool = False, zones: tuple = ()) -> Points:
    """This rank's share of the particles of a box.

    A cell that `body.refine` gives r is cut into r^dim equal ones, r along each edge, with a particle in the middle of
    each; its spacing is the cell's divided by r. The cells are numbered with x fastest and shared out in that order,
    and so are the particles inside a cell: the ids, dense over the particles that are kept, do not depend on the number
    of ranks. A rank's share has as many cells as any other, but not as many particles.

    A layer is as wide as it says in the largest horizon of the particles at its face, in whole cells.

    Args:
        comm: mpi4py communicator.
        body: size, spacing, origin, thickness, layers, refine of the case's `[body]`.
        keep: condition of X, Y, Z, spacing that tells which particles exist, or None.
        horizon: function of (position, spacing) that gives each particle's horizon.
        facets: whether the pieces of the body's surface are wanted as well.
        zones: as of `Lattice`.

    Raises:
        InputError: the body has no particle, its size is no multiple of its spacing, or a cell has no division.
    """
    lattice = Lattice.of(body, keep, horizon, zones)
    if np.any(np.abs(lattice.cell / body.spacing - 1) > 1e-6):
        warn(comm, f"body.size is no multiple of body.spacing: the cells are {_widths(lattice.cell)}")
    first, last = (lattice.cells * rank // comm.size for rank in (comm.rank, comm.rank + 1))
    index = lattice.indices(np.arange(first, last))
    with collective(comm):
        division = lattice.divisions(index)
    _check_number(body, comm.allreduce(float((division**lattice.dim).sum())))
    with collective(comm):
        points = lattice.points(index, division, horizon, facets)
    n = len(points.position)
    begin = comm.scan(n) - n
    if comm.allreduce(n) == 0:
        raise InputError(NOTHING_LEFT)
    points.id = np.arange(begin, begin + n)
    if facets:
        points.facets.parent[points.facets.parent >= 0] += begin
        points.facets = adopted(comm, points)
    return points


def _divide(index: np.ndarray, division: np.ndarray, lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the parts of all cells, and the row of each part's cell.

    Args:
        index: (n, dim) the cells.
        division: (n,) r of each; a cell gives its r^dim parts in a row, x fastest.
    """
    dim = index.shape[1]
    parts = division**dim
    cell = np.repeat(np.arange(len(index)), parts)
    number = np.arange(len(cell)) - np.repeat(np.cumsum(parts) - parts, parts)
    r = division[cell]
    inside = np.stack([number // r**k % r for k in range(dim)], axis=1)
    return lattice.middles(index[cell] + (2 * inside + 1 - r[:, None]) / (2 * r[:, None])), cell


def _check_number(body, particles: float) -> None:
    """Raise where PETSc's integers are too small for the unknowns of so many particles."""
    if particles * len(body.size) > np.iinfo(PETSc.IntType).max:
        cause = f"{body.spacing:g}" + ("" if body.refine is None else " with body.refine")
        raise InputError(
            f"body.spacing: {cause} makes {particles:.3g} particles, more than this PETSc's integers can number; "
            "enlarge the spacing, or use a PETSc configured with 64-bit indices"
        )


def _place(position: np.ndarray) -> str:
    return ", ".join(f"{x:g}" for x in position)


def _widths(cell: np.ndarray) -> str:
    return " x ".join(f"{c:.6g}" for c in cell)
