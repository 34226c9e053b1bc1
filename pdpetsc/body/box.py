"""Lattice bodies: a line, a rectangle or a block of cells, with one particle in the middle of each or several."""

import math

import numpy as np
from petsc4py import PETSc

from pdpetsc.errors import InputError
from pdpetsc.parallel import collective, warn
from pdpetsc.particles import Points

FACES = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1), "back": (2, 0), "front": (2, 1)}
"""Faces of a box: axis and side (0: towards smaller coordinates)."""

NAMES = ("X", "Y", "Z")


def coordinates(position: np.ndarray, spacing: np.ndarray) -> dict[str, np.ndarray]:
    """The variables of expressions: X, Y, Z as far as the dimension goes, and the local spacing."""
    return dict(zip(NAMES, position.T)) | {"spacing": spacing}


def layer_rows(width: float, cell: float) -> int:
    """Rows of cells in a fictitious layer of this width [length], at least one."""
    return max(1, int(width / cell + 1e-6))


def box(comm, body, keep, horizon) -> Points:
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

    Raises:
        InputError: the body has no particle, its size is no multiple of its spacing, or a cell has no division.
    """
    size = np.array(body.size, float)
    dim = len(size)
    inner = np.maximum(1, np.rint(size / body.spacing)).astype(np.int64)
    cell = size / inner
    if np.any(np.abs(cell / body.spacing - 1) > 0.05):
        raise InputError(
            f"body.size: {list(body.size)} is not a multiple of the spacing {body.spacing:g}; "
            f"the nearest lattice has {' x '.join(map(str, inner))} cells of {' x '.join(f'{c:.6g}' for c in cell)}"
        )
    if np.any(np.abs(cell / body.spacing - 1) > 1e-6):
        warn(comm, f"body.size is no multiple of body.spacing: the cells are {' x '.join(f'{c:.6g}' for c in cell)}")
    spacing = float(np.prod(cell) ** (1 / dim))
    origin = np.array(body.origin)
    extra = np.zeros((dim, 2), np.int64)
    for face, width in body.layers.items():
        axis, side = FACES[face]
        reach = _largest_horizon(body, face, inner, cell, keep, horizon) if width.in_horizons else 0.0
        extra[axis, side] = layer_rows(width.length(reach), cell[axis])
    counts = inner + extra.sum(axis=1)

    total = math.prod(map(int, counts))
    _check_number(body, total)
    first, last = total * comm.rank // comm.size, total * (comm.rank + 1) // comm.size
    index = np.stack(np.unravel_index(np.arange(first, last), counts, order="F"), axis=1) - extra[:, 0]
    with collective(comm):
        division = _divisions(body, origin + (index + 0.5) * cell, spacing)
    _check_number(body, comm.allreduce(float((division**dim).sum())))
    with collective(comm):
        offset, division = _divide(index, division.astype(np.int64))
        position, spacings = origin + offset * cell, spacing / division
        if keep is not None:
            kept = keep.mask(**coordinates(position, spacings))
            position, spacings, division = position[kept], spacings[kept], division[kept]
        horizons = horizon(position, spacings)
        if np.any(horizons <= 0):
            raise InputError(
                f"body.horizon: is {horizons.min():g} at ({_place(position[np.argmin(horizons)])}); "
                "it must be greater than 0"
            )

    n = len(position)
    begin = comm.scan(n) - n
    if comm.allreduce(n) == 0:
        raise InputError("body.keep: no particle is left; the condition is false everywhere")
    return Points(
        id=np.arange(begin, begin + n),
        position=position,
        volume=np.prod(cell) * body.thickness / division**dim,
        spacing=spacings,
        horizon=horizons,
    )


def _divisions(body, position: np.ndarray, spacing: float) -> np.ndarray:
    """Particles along an edge of each cell, as floating-point numbers that may be too large for an integer."""
    if body.refine is None:
        return np.ones(len(position))
    values = body.refine(**coordinates(position, np.full(len(position), spacing)))
    bad = np.flatnonzero(values < 1 - 1e-6)
    if len(bad):
        raise InputError(
            f"body.refine: is {values[bad[0]]:g} at ({_place(position[bad[0]])}), but a cell has at least 1 particle "
            "along its edges"
        )
    return np.floor(values + 1e-6)  # 0.3 / 0.1 is 3


def _divide(index: np.ndarray, division: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the parts of all cells, in cell widths from the body's origin, and the division of each part's cell.

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
    return index[cell] + (inside + 0.5) / r[:, None], r


def _largest_horizon(body, face: str, inner: np.ndarray, cell: np.ndarray, keep, horizon) -> float:
    """The largest horizon at a face: of a particle in the middle of each of the body's cells along it that are kept."""
    axis, side = FACES[face]
    ranges = [np.arange(n) for n in inner]
    ranges[axis] = ranges[axis][[-side]]
    index = np.stack([a.ravel() for a in np.meshgrid(*ranges, indexing="ij")], axis=1)
    position = np.array(body.origin) + (index + 0.5) * cell
    spacing = float(np.prod(cell) ** (1 / len(cell)))
    spacings = spacing / _divisions(body, position, spacing)
    if keep is not None:
        kept = keep.mask(**coordinates(position, spacings))
        position, spacings = position[kept], spacings[kept]
    return float(horizon(position, spacings).max(initial=0.0))


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
