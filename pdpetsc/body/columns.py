"""What a file gives of particles, row by row, and what is wrong with it."""

from typing import NamedTuple

import numpy as np

from pdpetsc.body.cells import Mesh
from pdpetsc.errors import InputError
from pdpetsc.particles import Facets

GROUPS = "groups"
"""Column in which particles carry to which groups they belong, in the order of the sets."""

LARGEST = 1e100
"""Of a coordinate, so that volumes stay finite."""

COINCIDENT = 1e-6
"""Particles are in one place when they are nearer to each other than this part of their spacing."""


class Given(NamedTuple):
    """Particles as a file gives them.

    Attributes:
        number: (n,) of the cell, the vertex, the line or the row in the file, counted from 1.
        position: (n, dim) [length].
        volume: (n,) [length^3; in 2D the thickness, in 1D the area is included].
        spacing: (n,) [length].
        horizon: (n,) [length], if it is given.
        member: (n, sets) mask of the groups that sets are made of.
        facets: of the surface, by parent, which is a row, if they are wanted.
        mesh: whose cells they are, whose particles are rows.
    """

    number: np.ndarray
    position: np.ndarray
    volume: np.ndarray
    spacing: np.ndarray
    horizon: np.ndarray | None
    member: np.ndarray
    facets: Facets | None = None
    mesh: Mesh | None = None

    def rows(self, start: int, stop: int) -> "Given":
        """Some consecutive ones, without facets and mesh."""
        columns = (None if values is None else values[start:stop] for values in self[:-2])
        return Given(*columns)


def checked_positions(position: np.ndarray, path: str, noun: str, number: np.ndarray) -> None:
    """Refuse places that are nowhere, or too far away to calculate with.

    Raises:
        InputError: naming the first such row.
    """
    bad = np.flatnonzero(~(np.abs(position) < LARGEST).all(axis=1))
    if len(bad):
        place = ", ".join(f"{x:g}" for x in position[bad[0]])
        raise InputError(f"{path}: {noun} {number[bad[0]]} is at ({place}), which is no place for a particle")


def checked_positive(values: np.ndarray, name: str, path: str, noun: str, number: np.ndarray) -> None:
    """Refuse volumes, spacings or horizons that are not greater than 0 and finite.

    Raises:
        InputError: naming the first such row.
    """
    bad = np.flatnonzero(~((values > 0) & (values < np.inf)))
    if len(bad):
        raise InputError(
            f"{path}: {noun} {number[bad[0]]} has the {name} {values[bad[0]]:g}; it must be greater than 0"
        )


def checked_apart(
    position: np.ndarray, spacing: np.ndarray, path: str, noun: str, number: np.ndarray, remedy: str
) -> None:
    """Refuse two particles in one place.

    Raises:
        InputError: naming both.
    """
    from scipy.spatial import cKDTree  # slow to import, and rarely needed

    if len(position) < 2:
        return
    near, other = cKDTree(position).query(position, 2, distance_upper_bound=COINCIDENT * spacing.max() * 1.01)
    twice = np.flatnonzero(near[:, 1] < COINCIDENT * spacing)
    if len(twice):
        first, second = sorted(number[other[twice[0]]])
        place = ", ".join(f"{x:g}" for x in position[twice[0]])
        raise InputError(f"{path}: {noun} {first} and {noun} {second} are in one place, ({place}); {remedy}")
