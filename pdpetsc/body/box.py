"""Lattice bodies: a line, a rectangle or a block of cells with one particle in the middle of each."""

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
    """Rows of particles in a fictitious layer of this width [length], at least one."""
    return max(1, int(width / cell + 1e-6))


def box(comm, body, keep, horizon) -> Points:
    """This rank's share of the particles of a box.

    The cells are numbered with x fastest and shared out in that order, so that the ids, dense over the particles that
    are kept, do not depend on the number of ranks.

    Args:
        comm: mpi4py communicator.
        body: size, spacing, origin, thickness, layers of the case's `[body]`.
        keep: condition of X, Y, Z, spacing that tells which particles exist, or None.
        horizon: function of (position, spacing) that gives each particle's horizon.

    Raises:
        InputError: the body has no particle, or its size is no multiple of its spacing.
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
    center = np.array(body.origin) + size / 2
    reach = float(horizon(center[None], np.array([spacing]))[0])
    extra = np.zeros((dim, 2), np.int64)
    for face, width in body.layers.items():
        axis, side = FACES[face]
        extra[axis, side] = layer_rows(width.length(reach), cell[axis])
    counts = inner + extra.sum(axis=1)

    total = math.prod(map(int, counts))
    if total * dim > np.iinfo(PETSc.IntType).max:
        raise InputError(
            f"body.spacing: {body.spacing:g} makes {total:.3g} particles, more than this PETSc's integers can number; "
            "enlarge the spacing, or use a PETSc configured with 64-bit indices"
        )
    first, last = total * comm.rank // comm.size, total * (comm.rank + 1) // comm.size
    index = np.stack(np.unravel_index(np.arange(first, last), counts, order="F"), axis=1)
    position = np.array(body.origin) + (index - extra[:, 0] + 0.5) * cell
    spacings = np.full(len(position), spacing)
    with collective(comm):
        if keep is not None:
            kept = keep.mask(**coordinates(position, spacings))
            position, spacings = position[kept], spacings[kept]
        horizons = horizon(position, spacings)
        if np.any(horizons <= 0):
            where = ", ".join(f"{x:g}" for x in position[np.argmin(horizons)])
            raise InputError(f"body.horizon: is {horizons.min():g} at ({where}); it must be greater than 0")

    n = len(position)
    offset = comm.scan(n) - n
    if comm.allreduce(n) == 0:
        raise InputError("body.keep: no particle is left; the condition is false everywhere")
    return Points(
        id=np.arange(offset, offset + n),
        position=position,
        volume=np.full(n, np.prod(cell) * body.thickness),
        spacing=spacings,
        horizon=horizons,
    )
