"""Bodies distributed over the ranks, from particles wherever a test wants them."""

from types import SimpleNamespace

import numpy as np
from models import lattice
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.body.box import box
from pdpetsc.bonds import find_families
from pdpetsc.expressions import Expression
from pdpetsc.influence import INFLUENCE, bond_weights
from pdpetsc.loads.base import Site
from pdpetsc.loads.displacement import Displacement
from pdpetsc.materials.base import Neighbourhood
from pdpetsc.particles import Particles, Points, distribute
from pdpetsc.timings import Timings

ARCH = {  # four rows of particles; the force acts on one of them
    "body": {
        "size": [30.0, 5.0], "spacing": 0.5, "horizon": 1.515, "layers": {"left": "horizon", "right": "horizon"},
        "keep": "abs(Y - 1 - 2.8 * sin(pi * X / 30)**2) < 1.01",
    },
    "sets": {"clamps": "X < 0 or X > 30", "crown": {"nearest": [14.75, 4.75]}},
    "material": {"strip": {"model": "ordinary", "E": 1e4, "nu": 0.25}},
    "load": [
        {"kind": "displacement", "set": "clamps", "component": "all", "value": 0.0},
        {"kind": "force", "set": "crown", "component": "y", "value": "-200 * t"},
    ],
    "solver": {"control": "arc_length", "steps": 10},
    "probe": [
        {"name": "crown", "field": "u", "component": "y", "set": "crown", "reduce": "mean"},
        {"name": "support", "field": "reaction", "component": "y", "set": "crown", "reduce": "sum"},
    ],
}  # fmt: skip
"""A case: a shallow arch that snaps through."""


def distributed(X: np.ndarray, horizon, volume=None, spacing=1.0, seed: int = 0) -> Particles:
    """Particles from arrays that every rank has; each brings some of them, in any order."""
    comm = PETSc.COMM_WORLD
    n = len(X)
    rng = np.random.default_rng(seed)
    mine = rng.permutation(n)[rng.integers(0, comm.size, n) == comm.rank]
    spacing = np.broadcast_to(np.asarray(spacing, float), n)
    volume = spacing ** X.shape[1] if volume is None else volume
    fields = {"position": X, "volume": volume, "spacing": spacing, "horizon": np.broadcast_to(horizon, n)}
    return distribute(comm, Points(mine.astype(np.int64), **{k: np.array(v[mine], float) for k, v in fields.items()}))


def refined(size, refine, factor: float = 3.015, keep: str | None = None, comm=PETSc.COMM_WORLD) -> Particles:
    """A box with cells of width 1, divided as the expression `refine` says; horizons by the local spacing."""
    names = [*"XYZ"[: len(size)], "spacing"]
    body = SimpleNamespace(
        size=size, spacing=1.0, origin=[0.0] * len(size), thickness=1.0, layers={}, particles="cells", fitted=False,
        refine=Expression(refine, names),
    )  # fmt: skip
    keep = None if keep is None else Expression(keep, names)
    return distribute(comm, box(comm.tompi4py(), body, keep, lambda X, spacing: factor * spacing))


def jittered(counts, amount: float, spacing: float = 1.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng([seed, *counts])
    return lattice(counts, spacing) + amount * spacing * rng.uniform(-1, 1, (np.prod(counts), len(counts)))


def families_of(p: Particles):
    return find_families(p.position, p.horizon, p.id, p.owned)


def whole(comm, p: Particles, field: np.ndarray) -> np.ndarray:
    """An owned field of all ranks, in the order of the ids, on every rank."""
    ids = np.concatenate(comm.allgather(p.id[: p.owned]))
    values = np.concatenate(comm.allgather(field[: p.owned]))
    return values[np.argsort(ids)]


def site(p: Particles, mask: np.ndarray, value) -> Site:
    """Where a load acts, a mask of the owned particles, and its value: a number or an expression of X, Y, Z, t."""
    members, X = np.flatnonzero(mask), p.position[: p.owned]
    expression = Expression(value, [*"XYZ"[: p.dim], "spacing", "t"])
    return Site(p.comm.tompi4py(), members, X[members], p.volume[members], p.spacing[members], expression)


def assembler(
    p: Particles, *rows, held=None, young: float = 1.0, influence: str = "constant", value=0.0, loads=()
) -> Assembler:
    """Models of the table on the particles; with several, the families are dealt out to them by their ids.

    Args:
        held: function of the positions that gives the mask of the particles whose displacement is prescribed,
            (n, dim) for single components.
        value: what is prescribed: a number or an expression of X, Y, Z, t, or one for each component.
        loads: further loads.
    """
    families = families_of(p)
    kind = p.id[: p.owned] % len(rows)
    materials = []
    for number, row in enumerate(rows):
        own = families.subset(np.flatnonzero(kind == number))
        weight = bond_weights(own, p.position, p.horizon, p.spacing, INFLUENCE[influence], "none")
        part = Neighbourhood(
            own, weight, p.position, p.volume, p.horizon, p.spacing, forward=p.exchange.forward
        )  # fmt: skip
        materials.append(row.build(part, young))
    loads = list(loads)
    if held is not None:
        X = p.position[: p.owned]
        mask = np.asarray(held(X))
        mask = np.broadcast_to(mask if mask.ndim == 2 else mask[:, None], (p.owned, p.dim))
        values = value if isinstance(value, list | tuple) else [value] * p.dim
        for k in range(p.dim):
            loads.append(Displacement(site(p, mask[:, k], values[k]), SimpleNamespace(component=(k,))))
    result = Assembler(p, materials, loads, Timings())
    result.set_time(1.0)
    return result


def rows_of(mat: PETSc.Mat) -> np.ndarray:
    """The rows of this rank as a dense array."""
    offsets, columns, values = mat.getValuesCSR()
    rows = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    dense = np.zeros((len(offsets) - 1, mat.getSize()[1]))
    np.add.at(dense, (rows, columns), values)
    return dense


def affine(A) -> list[str]:
    """Expressions of u = A X."""
    return [" + ".join(f"({float(a)!r}) * {x}" for a, x in zip(row, "XYZ")) for row in np.atleast_2d(A)]
