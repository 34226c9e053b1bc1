"""Particles into 2^n smaller ones, each in the middle of its part of the parent's cell (seed 002 section 5.3, Fig. 16).

The parts share the parent's volume, exactly. Displacements, velocities and other fields q of the particles go over by
their local gradient,

    q_c = q + grad q (X_c - sum_c V_c X_c / V)

so that sum_c m_c q_c = m q: mass, centre of mass and momentum stay to rounding. Horizons go with spacings. The first
part has the parent's id, the others have new ones, in the order of the parents' ids: ids stay dense, the same on any
number of ranks, and a particle that is not split keeps its own.
"""

import numpy as np

from pdpetsc.body.box import Lattice
from pdpetsc.particles import Facets, Particles, Points

OWN = 1e-6
"""Fraction of a cell by which a piece of surface in it may lie outside."""


def split(
    lattice: Lattice, particles: Particles, marked: np.ndarray, fields: dict[str, np.ndarray],
    gradients: dict[str, np.ndarray], carried: dict[str, np.ndarray], chosen,
) -> Points:  # fmt: skip
    """The particles of this rank with the marked ones split (collective).

    One whose cell holds too little of a fitted body for any part to be a particle stays whole.

    Args:
        lattice: of the body.
        particles: the distributed particles.
        marked: (owned,) mask.
        fields: (owned, dim) columns that go over by their gradients.
        gradients: (owned, dim, dim) of the same names, d q_i / d X_j.
        carried: (owned, ...) columns that go over as they are.
        chosen: function of (facets, spacing of their parents) that gives the mask of those on which something acts;
            None: nothing acts on surfaces.

    Returns:
        with fields and other columns as `carried`; the facets' parents are ids.
    """
    p, dim = particles, particles.dim
    X, spacing, volume = (column[: p.owned] for column in (p.position, p.spacing, p.volume))
    width = lattice.cell / np.rint(lattice.spacing / spacing)[:, None]
    start = np.array(lattice.body.origin)
    middle = start + (np.floor((X - start) / width) + 0.5) * width
    rows = np.flatnonzero(marked)
    place = np.arange(2**dim)[:, None] // 2 ** np.arange(dim) % 2 - 0.5  # x fastest
    parent = np.repeat(rows, len(place))
    parts = lattice.parts(
        np.zeros((len(parent), dim), np.int64),
        middle[parent] + np.tile(place, (len(rows), 1)) * width[parent] / 2, spacing[parent] / 2,
    )  # fmt: skip
    if not lattice.body.fitted:  # staircases stay as they are
        parts = parts._replace(kept=np.ones(len(parent), bool))
    count = np.bincount(parent[parts.kept], minlength=p.owned)
    divided = count > 0
    if not divided[rows].all():
        return split(lattice, p, marked & divided, fields, gradients, carried, chosen)

    stay, child = np.flatnonzero(~divided), parent[parts.kept]
    share = parts.volume[parts.kept]
    share = share / np.bincount(child, share, p.owned)[child]
    position = parts.position[parts.kept]
    mean = np.stack([np.bincount(child, share * x, p.owned)[child] for x in position.T], axis=1)
    origin = np.concatenate([stay, child])
    moved = {
        name: np.concatenate([q[stay], q[child] + np.einsum("nij,nj->ni", gradients[name][child], position - mean)])
        for name, q in fields.items()
    }
    points = Points(
        np.concatenate([p.id[stay], _ids(p, count, child)]),
        np.concatenate([X[stay], position]),
        np.concatenate([volume[stay], share * volume[child]]),
        np.concatenate([spacing[stay], spacing[child] / 2]),
        np.concatenate([p.horizon[stay], p.horizon[child] / 2]),
        carried=moved | {name: values[origin] for name, values in carried.items()},
    )
    if chosen is not None:
        points.facets = _facets(lattice, p, points, parts, parent, child, divided, middle, width, chosen)
    return points


def _ids(p: Particles, count: np.ndarray, child: np.ndarray) -> np.ndarray:
    """Ids of the parts, which come one parent after the other (collective).

    Args:
        count: (owned,) parts of each particle, 0 where it is not split.
        child: parent of each part.
    """
    new = p.directory.to_blocks(np.maximum(count - 1, 0).astype(float))
    before = p.comm.tompi4py().exscan(float(new.sum())) or 0.0
    first = p.directory.from_blocks(p.count + before + np.cumsum(new) - new).astype(np.int64)
    number = np.arange(len(child)) - np.repeat(np.cumsum(count) - count, count)
    return np.where(number == 0, p.id[child], first[child] + number - 1)


def _facets(lattice, p: Particles, points: Points, parts, parent, child, divided, middle, width, chosen) -> Facets:
    """Pieces of surface: those of particles that stay, those of the parts, and those that split particles had adopted,
    which go to the nearest part; their parents are ids.

    Args:
        parent: the particle that each of the parts was made from, child: of those that are kept.
    """
    old, stay = p.facets, len(points.id) - len(child)
    inside = np.abs(old.position - middle[old.parent]) <= (0.5 + OWN) * width[old.parent]
    whole = ~divided[old.parent]
    kept = old.chosen(whole)
    kept.parent = p.id[kept.parent]
    new, homeless = lattice.facets(parts), old.chosen(~whole & ~inside.all(axis=1))
    orphan = new.parent < 0
    new.parent[orphan] = _nearest(new.position[orphan], parent[-1 - new.parent[orphan]], points.position[stay:], child)
    homeless.parent = _nearest(homeless.position, homeless.parent, points.position[stay:], child)
    new = new.chosen(chosen(new, points.spacing[stay:][new.parent]))
    new, homeless = (
        Facets(points.id[stay:][facets.parent], facets.face, facets.position, facets.area) for facets in (new, homeless)
    )
    return Facets.joined([kept, new, homeless])


def _nearest(position: np.ndarray, family: np.ndarray, others: np.ndarray, families: np.ndarray) -> np.ndarray:
    """The nearest of other positions (m, dim) to each of these (n, dim) that is of the same family (m,), (n,)."""
    if not len(position):
        return np.empty(0, np.int64)
    from scipy.spatial import cKDTree  # slow to import, and rarely needed

    apart = 4 * np.ptp(np.concatenate([position, others]), axis=0).sum()
    return cKDTree(np.column_stack([others, apart * families])).query(np.column_stack([position, apart * family]))[1]
