"""A body refined at a state: marked, split, distributed anew, with what it carries (seed 002 section 5.3)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from petsc4py import PETSc

from pdpetsc.adapt.gradients import gradients
from pdpetsc.adapt.marking import neighbourhood, with_coarser
from pdpetsc.adapt.splitting import split
from pdpetsc.body.box import Lattice, coordinates
from pdpetsc.body.sets import Sets
from pdpetsc.bonds import Families
from pdpetsc.errors import InputError
from pdpetsc.particles import Particles, Points, distribute
from pdpetsc.quantities import scalar
from pdpetsc.recover import Recovery
from pdpetsc.state import State

FIELDS = ("u", "v")
"""Of the state, that go over by their gradients."""

BEFORE = ("id", "position", "horizon")
"""What a particle's bonds are known by, carried from before a refinement."""


EVERY = 10
"""Steps of a motion between looks at what is to be refined, where the case says nothing: a wave crosses a horizon in
about as many."""

FINER = 0.99
"""A spacing is smaller than another where it is below this fraction of it."""


@dataclass
class Refinement:
    """How the body of a case is refined.

    Attributes:
        spec: the case's `[refinement]`.
        lattice: of the body.
        chosen: function of (facets, spacings) that gives the mask of those on which something acts, or None.
        tolerance: of horizons.
    """

    spec: Any
    lattice: Lattice
    chosen: Any
    tolerance: float

    def marked(self, p: Particles, families: Families, recovery: Recovery, time: float) -> np.ndarray:
        """Mask (owned,) of the particles to be split at a state (collective)."""
        spec, spacing = self.spec, p.spacing[: p.owned]
        place = coordinates(p.position[: p.owned], spacing) | {"horizon": p.horizon[: p.owned], "t": time}
        conditions = [condition for condition in (spec.where, spec.beside) if condition is not None]
        for name in sorted(set().union(*(condition.names for condition in conditions)) - set(place)):
            place[name] = scalar(name, recovery.field(name))

        hot = spec.where.mask(**place)
        if spec.beside is not None:
            begun = hot | (spacing < self.lattice.spacing * FINER)
            hot = hot | (neighbourhood(p, families, begun) & spec.beside.mask(**place))
        for _ in range(spec.rings):
            hot = hot | neighbourhood(p, families, hot)
        finest = self.lattice.spacing / 2**spec.levels
        return with_coarser(p, families, hot & (spacing / 2 > finest * FINER))

    def refined(
        self,
        p: Particles,
        sets: Sets,
        families: Families,
        intact: np.ndarray | None,
        marked: np.ndarray,
        state: State,
        mass: np.ndarray | None,
    ) -> tuple[Particles, Sets, State] | None:
        """The body with the marked particles split, its sets and its state; None where no particle can be split, too
        little of a fitted body being in its cell (collective).

        Its particles carry what their bonds were known by, as `was_id`, `was_position` and `was_horizon`.

        Args:
            families: of the body; intact: mask of the bonds that have not failed, None: all.
            marked: mask (owned,).
            mass: (owned,) of each particle; None: nothing moves.

        Raises:
            InputError: PETSc's integers are too small for as many unknowns.
        """
        fields = {name: getattr(state, name) for name in FIELDS if getattr(state, name) is not None}
        slopes = gradients(p, families, intact, marked, fields)
        carried = {f"was_{name}": getattr(p, name)[: p.owned] for name in BEFORE}
        carried |= {"sets": sets.columns} | {
            name: p.carried.get(name, p.id[: p.owned]) for name in ("parent", "ancestor")
        }
        if mass is not None:
            carried["density"] = mass / p.volume[: p.owned]
        points = split(self.lattice, p, marked, fields, slopes, carried, self.chosen)
        count = p.comm.tompi4py().allreduce(len(points.id))
        if count == p.count:
            return None
        if count * p.dim > np.iinfo(PETSc.IntType).max:
            raise InputError(f"refinement: makes {count:.3g} particles, more than this PETSc's integers can number")
        new = points.id != points.carried["was_id"]
        points.carried["parent"] = np.where(new, points.carried["was_id"], points.carried["parent"])
        if mass is not None:
            _keep_spin(p, state, mass, points)
        body = distribute(p.comm, points, self.tolerance)
        state = replace(state, **{name: body.carried.pop(name) for name in fields})
        body.carried.pop("density", None)
        return body, sets.inherited(body, body.carried.pop("sets")), state


def before(p: Particles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids, positions and horizons before the last refinement of the local particles (collective)."""
    columns = []
    for name in BEFORE:
        own = p.carried.pop(f"was_{name}")
        column = np.empty((p.local, *own.shape[1:]))
        column[: p.owned] = own
        columns.append(p.exchange.forward(column))
    return columns[0].astype(np.int64), columns[1], columns[2]


def _keep_spin(p: Particles, state: State, mass: np.ndarray, points: Points) -> None:
    """Take the angular momentum that the parts have over their parents' out of their velocities, as the spin of all of
    them about their centre of mass (collective). It is that of cells about their own middles, which particles do not
    have: of second order in the spacing over the size of the refined zone."""
    mpi, dim, own = p.comm.tompi4py(), p.dim, np.searchsorted(p.id[: p.owned], points.carried["was_id"])
    parts = np.flatnonzero(points.spacing < p.spacing[own] * FINER)
    split_ones = np.unique(own[parts])
    m = (points.carried["density"] * points.volume)[parts]
    x, v = _in_space((points.position + points.carried["u"])[parts]), _in_space(points.carried["v"][parts])
    X, V = _in_space((p.position[: p.owned] + state.u)[split_ones]), _in_space(state.v[split_ones])
    weight = mpi.allreduce(np.array([m.sum(), *(m @ x)]))
    middle = weight[1:] / weight[0]
    x, X = x - middle, X - middle
    inertia = (m * (x**2).sum(axis=1)).sum() * np.eye(3) - np.einsum("n,ni,nj->ij", m, x, x)
    gained = m @ np.cross(x, v) - mass[split_ones] @ np.cross(X, V)
    gained, inertia = mpi.allreduce(gained), mpi.allreduce(inertia)
    spin = np.linalg.pinv(inertia, rcond=1e-12, hermitian=True) @ gained
    points.carried["v"][parts] -= np.cross(spin, x)[:, :dim]


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """With three components."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
