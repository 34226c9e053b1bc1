"""Cracks that are there from the start: bonds that cross one do not exist."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numba import njit

from pdpetsc.body.meshes import surface_of_mesh
from pdpetsc.body.sheets import TOUCH, Sheets, disc, meet, polygons
from pdpetsc.bonds import Families
from pdpetsc.errors import at
from pdpetsc.parallel import collective


class Ends(NamedTuple):
    """Particles that bonds may join.

    Attributes:
        position, horizon, ids: of all local particles, (local, dim), (local,), (local,).
    """

    position: np.ndarray
    horizon: np.ndarray
    ids: np.ndarray


Crack = Callable[[Families, Ends], np.ndarray]
"""Gives the mask (bonds,) of the bonds of families that it cuts. A bond is always looked at from its end with the lower
id, so that i -> j and j -> i agree on any rank. A particle on a crack keeps the bonds along it only: let cracks run
between the particles."""


def cut_bonds(families: Families, ends: Ends, cracks: list[Crack]) -> np.ndarray:
    """Which bonds each crack cuts, (cracks, bonds)."""
    return np.array([crack(families, ends) for crack in cracks], bool).reshape(len(cracks), families.bonds)


def cracks_of(mpi, specs: Iterable, dim: int, place: str) -> list[Crack]:
    """The cracks of a case's tables; a mesh is read by the first rank (collective).

    Args:
        specs: entries of `body.cracks` (pdpetsc.schema.crack.Crack).
        dim: of the body.
        place: of the entries in the case, for errors.

    Raises:
        InputError: a crack has no extent or is not plane, or its mesh cannot be read.
    """
    return [_crack_of(mpi, spec, dim, f"{place}.{number}") for number, spec in enumerate(specs)]


def _crack_of(mpi, spec, dim: int, place: str) -> Crack:
    if spec.level_set is not None:
        return level_set_crack(
            lambda X: spec.level_set(**_coordinates(X)),
            spec.where and (lambda X: spec.where.mask(**_coordinates(X))),
        )
    if spec.radius is not None:
        return sheets_crack(disc(spec.center, spec.normal, spec.radius))
    if spec.mesh is None:
        return sheets_crack(polygons(np.array([spec.vertices], float), place))
    vertices = None
    with collective(mpi), at(f"{place}.mesh"):
        if mpi.rank == 0:
            vertices = surface_of_mesh(spec.mesh, dim, spec.set)
    return sheets_crack(polygons(mpi.bcast(vertices), f"{place}.mesh"))


def _coordinates(X: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip("XYZ", X.T, strict=False))


def sheets_crack(sheets: Sheets) -> Crack:
    """Cuts the bonds whose segment X_i X_j meets one of the sheets, but for bonds that lie in its own plane."""
    return lambda families, ends: meet(families, ends.position, ends.ids, sheets)


def level_set_crack(level: Callable, where: Callable | None) -> Crack:
    """Cuts the bonds whose ends lie on different sides of a level set f = 0, by the sign of f, if a condition holds
    where they cross it. A point within `TOUCH` horizons of it along an axis lies on it, and on neither side.

    Args:
        level: f of points (n, dim).
        where: the condition, a mask of points (n, dim), or None: everywhere.
    """

    def cut(families: Families, ends: Ends) -> np.ndarray:
        X = ends.position
        side = np.sign(level(X)).astype(np.int8)
        for axis in np.eye(X.shape[1]):
            step = TOUCH * ends.horizon[:, None] * axis
            side[np.sign(level(X + step)) != np.sign(level(X - step))] = 0
        crosses = _differ(families.center, families.offsets, families.neighbours, side)
        if where is not None:
            bonds = np.flatnonzero(crosses)
            i, j = families.per_bond(np.arange(len(X)))[bonds], families.neighbours[bonds]
            first = ends.ids[i] < ends.ids[j]
            p, q = np.where(first, i, j), np.where(first, j, i)
            crosses[bonds] = where(_crossing(level, side, X, p, q))
        return crosses

    return cut


@njit(cache=True)
def _differ(center, offsets, neighbours, side):
    """Mask of the bonds whose ends are on different sides."""
    differ = np.zeros(len(neighbours), np.bool_)
    for f in range(len(center)):
        for b in range(offsets[f], offsets[f + 1]):
            differ[b] = side[center[f]] != side[neighbours[b]]
    return differ


def _crossing(level, side, X, p, q) -> np.ndarray:
    """Where the bonds from p to q, whose sides differ, cross the level set: one of the ends if it lies on it."""
    low, high = np.zeros(len(p)), np.ones(len(p))
    high[side[p] == 0] = 0.0
    low[side[q] == 0] = 1.0
    for _ in range(50):
        middle = (low + high) / 2
        before = np.sign(level(X[p] + middle[:, None] * (X[q] - X[p]))) == side[p]
        between = low < high
        low = np.where(between & before, middle, low)
        high = np.where(between & ~before, middle, high)
    return X[p] + ((low + high) / 2)[:, None] * (X[q] - X[p])
