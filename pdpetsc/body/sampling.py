"""A sample of the particles that a file gives, and what is around each of them."""

from typing import NamedTuple

import numpy as np

from pdpetsc.body.box import blocks_of
from pdpetsc.body.given import Source, count_of, made, rows_of
from pdpetsc.errors import NoRoom
from pdpetsc.particles import Points

GOLDEN = (5**0.5 - 1) / 2

MOST = 10_000_000
"""Particles around a sample: more of them are no body that could be calculated."""


class Sample(NamedTuple):
    """Attributes:
    count: particles of the whole body.
    middles: (n, dim) places of those in the sample.
    around: all particles within two of the largest horizons of the sample of one of them.
    reach: the largest horizon in the sample [length].
    """

    count: int
    middles: np.ndarray
    around: Points
    reach: float


def sample_of(source: Source, keep, horizon, size: int, tolerance: float) -> Sample:
    """About as many particles as `size`, spread over the rows of a file, which is gone through in blocks.

    Args:
        keep, horizon: as of `given_particles`.
        tolerance: factor of the horizons.

    Raises:
        InputError: something in the file is wrong.
    """
    from scipy.spatial import cKDTree  # slow to import, and not needed for lattices

    rows = count_of(source)
    chosen = (
        np.unique((np.arange(1, size + 1) * GOLDEN % 1 * rows).astype(np.int64)) if rows > size else np.arange(rows)
    )
    parts = [made(rows_of(source, row, row + 1), keep, horizon, row)[0] for row in map(int, chosen)]
    first = _joined(parts)
    reach = float(first.horizon.max(initial=0.0)) * tolerance
    count, found, around = 0, 0, [first]
    tree = cKDTree(first.position) if len(first.id) else None
    for numbers in blocks_of(rows):
        points = made(rows_of(source, int(numbers[0]), int(numbers[-1]) + 1), keep, horizon, int(numbers[0]))[0]
        count += len(points.id)
        if tree:
            near = np.isfinite(tree.query(points.position, distance_upper_bound=2 * reach * (1 + 1e-9))[0])
            around.append(_chosen(points, near & ~np.isin(points.id, first.id)))
            found += len(around[-1].id)
            if found > MOST:
                raise NoRoom(f"{source.path}: more than {MOST:.0e} particles are within two horizons of {len(chosen)} "
                             "of them; are horizons in the unit of the file, and particles apart?")  # fmt: skip
    return Sample(count, first.position, _joined(around), reach)


def _joined(parts: list[Points]) -> Points:
    """All of them, one part after the other."""
    names = ("id", "position", "volume", "spacing", "horizon")
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    return Points(*columns, carried={k: np.concatenate([part.carried[k] for part in parts]) for k in parts[0].carried})


def _chosen(points: Points, some: np.ndarray) -> Points:
    """Those of a mask or of numbers."""
    columns = (getattr(points, name)[some] for name in ("id", "position", "volume", "spacing", "horizon"))
    return Points(*columns, carried={name: values[some] for name, values in points.carried.items()})


def near(sample: Sample, position: np.ndarray, distance: float) -> Points:
    """The particles as near as that to a place, of those around the sample."""
    return _chosen(sample.around, np.linalg.norm(sample.around.position - position, axis=1) <= distance)
