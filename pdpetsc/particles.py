"""Particles and their distribution: DMDA cells choose the owner, a DMSwarm carries the particles there."""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc.body.cells import Mesh
from pdpetsc.bonds import HORIZON_TOLERANCE
from pdpetsc.exchange import Directory, Exchange, swap

BASIC = ("id", "position", "volume", "spacing", "horizon")
"""Columns of every particle."""

MOST_CELLS = 64
"""For each particle, of the grid by which they are shared out."""


@dataclass
class Facets:
    """Pieces of a body's surface, where tractions act: collocation points (seed 003 section 4.1).

    Attributes:
        parent: id of the particle whose cell each belongs to (its local index once distributed).
        face: number of the face of the box (body/box.py) or of a border, with the groups of a mesh (body/surfaces.py).
        position: (n, dim) reference position [length].
        area: (n, dim) outward area vector N A [length^2; the thickness or cross-section is included].
    """

    parent: np.ndarray
    face: np.ndarray
    position: np.ndarray
    area: np.ndarray

    def __len__(self) -> int:
        return len(self.parent)

    def chosen(self, mask: np.ndarray) -> "Facets":
        """Those of a mask or of numbers."""
        return Facets(self.parent[mask], self.face[mask], self.position[mask], self.area[mask])

    @classmethod
    def joined(cls, parts: list["Facets"]) -> "Facets":
        """All of them, one part after the other."""
        fields = ("parent", "face", "position", "area")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))

    @classmethod
    def none(cls, dim: int) -> "Facets":
        """No facets."""
        return cls(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, dim)), np.empty((0, dim)))


@dataclass
class Points:
    """A part of a body, before distribution: any rank holds any particles, the ids are global and dense.

    Attributes:
        id: global number, 0 ... N-1 over all ranks, independent of their number.
        position: (n, dim) reference position X [length].
        volume: (n,) [length^3; in 2D the thickness, in 1D the area is included].
        spacing: (n,) local particle spacing [length].
        horizon: (n,) delta [length].
        facets: of the same rank's particles, where tractions are to act.
        mesh: whose cells or points they are, on the first rank alone, to be drawn.
        carried: further columns, (n,) whole numbers or (n,) and (n, m) floating-point ones, that go with the particles.
    """

    id: np.ndarray
    position: np.ndarray
    volume: np.ndarray
    spacing: np.ndarray
    horizon: np.ndarray
    facets: Facets | None = None
    mesh: Mesh | None = None
    carried: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class Particles:
    """The particles of this rank: `owned` ones, sorted by id, then ghosts, grouped by owner.

    Attributes:
        comm: PETSc communicator; `count`: particles on all ranks; `owned`: on this one.
        id, position, volume, spacing, horizon: as in Points, for owned and ghost particles.
        global_index: PETSc numbering, contiguous over the owned particles of a rank.
        neighbours: ranks that share ghosts with this one.
        mirrors: for each of `neighbours`, the owned particles that are its ghosts, in its order.
        ghost_ranges: for each of `neighbours`, the slice of local indices of the ghosts that it owns.
        facets: of owned particles, by parent, face, place; all particles within the parent's horizon of one are local.
        carried: of owned particles, mesh: as in Points.
    """

    comm: PETSc.Comm
    count: int
    owned: int
    id: np.ndarray
    position: np.ndarray
    volume: np.ndarray
    spacing: np.ndarray
    horizon: np.ndarray
    global_index: np.ndarray
    neighbours: list[int]
    mirrors: list[np.ndarray]
    ghost_ranges: list[slice]
    exchange: Exchange
    facets: Facets
    carried: dict[str, np.ndarray]
    mesh: Mesh | None

    @property
    def dim(self) -> int:
        return self.position.shape[1]

    @property
    def local(self) -> int:
        """Owned particles and ghosts."""
        return len(self.id)

    @cached_property
    def directory(self) -> Directory:
        """The way to and from the order of the ids."""
        return Directory(self.comm, self.id[: self.owned], self.count)


def distribute(comm: PETSc.Comm, points: Points, tolerance: float = HORIZON_TOLERANCE) -> Particles:
    """Bring every particle to its owner and fetch the ghosts that the owned families reach with this tolerance."""
    moved = _migrate(comm, points, _owners(comm, points))
    return _with_ghosts(comm, moved, max(tolerance, 0.0))


def _owners(comm, points: Points) -> np.ndarray:
    """Owner rank of each point: DMDA cells about one (smallest) spacing wide, wider where there would be far more of
    them than points, cut so that the ranks get equal work.

    Work is the expected size of a family. Cells are independent of the horizon; every decomposed direction has at
    least as many cells as ranks (a DMDA with fewer fails), and a rank may own no particle.
    """
    mpi = comm.tompi4py()
    X = points.position
    dim = X.shape[1]
    far = np.finfo(float).max
    low, high, negative_spacing = (np.full(dim, far), np.full(dim, -far), -far)
    if len(X):
        low, high, negative_spacing = X.min(axis=0), X.max(axis=0), -points.spacing.min()
    low = -_maximum(mpi, -low)
    extremes = _maximum(mpi, np.append(high, negative_spacing))
    spacing = -extremes[-1]
    low, high = low - spacing / 2, extremes[:-1] + spacing / 2
    most = MOST_CELLS * max(1, mpi.allreduce(len(X)))
    coarser = (np.prod(np.maximum(1, (high - low) / spacing)) / most) ** (1 / dim)
    cells = np.maximum(1, np.rint((high - low) / spacing / max(1.0, coarser))).astype(np.int64)
    processes = _process_grid(cells, comm.size)
    cells = np.maximum(cells, processes)

    cell = np.clip(((X - low) / (high - low) * cells).astype(np.int64), 0, cells - 1)
    work = points.horizon**dim / points.spacing**dim
    edges = [
        _cut(_sum(mpi, np.bincount(cell[:, k], weights=work, minlength=cells[k])), int(processes[k]))
        for k in range(dim)
    ]
    grid = PETSc.DMDA().create(
        [int(n) for n in cells],
        dof=1,
        stencil_width=0,
        proc_sizes=[int(p) for p in processes],
        ownership_ranges=[np.diff(e).astype(PETSc.IntType) for e in edges],
        comm=comm,
    )
    starts = [np.concatenate([[0], np.cumsum(r)]) for r in grid.getOwnershipRanges()]
    rank = np.zeros(len(X), np.int64)
    for k in reversed(range(dim)):  # DMDA numbers its ranks with x fastest
        rank = rank * processes[k] + np.searchsorted(starts[k], cell[:, k], side="right") - 1
    grid.destroy()
    return rank


def _maximum(mpi, values: np.ndarray) -> np.ndarray:
    result = np.empty_like(values)
    mpi.Allreduce(np.ascontiguousarray(values), result, MPI.MAX)
    return result


def _sum(mpi, values: np.ndarray) -> np.ndarray:
    result = np.empty_like(values)
    mpi.Allreduce(np.ascontiguousarray(values), result)
    return result


def _process_grid(cells: np.ndarray, ranks: int) -> np.ndarray:
    """Ranks in each direction: the factorisation with the least cut surface that leaves every rank a cell."""

    def factorisations(number, directions):
        if directions == 1:
            yield (number,)
            return
        for first in range(1, number + 1):
            if number % first == 0:
                for rest in factorisations(number // first, directions - 1):
                    yield (first, *rest)

    def cost(grid):
        overflow = sum(max(0, p - n) for p, n in zip(grid, cells))
        return overflow, sum((p - 1) / n for p, n in zip(grid, cells)), grid[::-1]

    return np.array(min(factorisations(ranks, len(cells)), key=cost))


def _cut(work: np.ndarray, parts: int) -> np.ndarray:
    """Edges of `parts` non-empty ranges of cells with nearly equal work."""
    total = np.concatenate([[0.0], np.cumsum(work)])
    edges = np.searchsorted(total, total[-1] * np.arange(1, parts) / parts - 1e-9 * total[-1])
    edges = np.concatenate([[0], edges, [len(work)]])
    for k in range(1, parts):  # at least one cell for each range, from the left and from the right
        edges[k] = max(edges[k], edges[k - 1] + 1)
    for k in range(parts - 1, 0, -1):
        edges[k] = min(edges[k], edges[k + 1] - 1)
    return edges


def _migrate(comm, points: Points, owner: np.ndarray) -> Points:
    """The points that this rank owns, sorted by id, with their facets, sorted by parent, face and place."""
    dim = points.position.shape[1]
    vector, number, scalar = (dim, PETSc.ScalarType), (1, PETSc.IntType), (1, PETSc.ScalarType)
    fields = {"id": number, "position": vector, "volume": scalar, "spacing": scalar, "horizon": scalar}
    carried = {name: (values.shape[1:], values.dtype) for name, values in points.carried.items()}
    for name, (shape, kind) in carried.items():
        fields[name] = int(np.prod(shape)), PETSc.IntType if kind.kind == "i" else PETSc.ScalarType
    columns = {name: getattr(points, name) for name in BASIC} | points.carried
    arrived = _carry(comm, dim, columns, fields, owner)
    order = np.argsort(arrived["id"], kind="stable")
    arrived = {name: values[order] for name, values in arrived.items()}
    result = Points(**{name: arrived[name] for name in BASIC})
    result.carried = {name: arrived[name].reshape(-1, *shape) for name, (shape, _) in carried.items()}
    result.mesh, result.facets = points.mesh, Facets.none(dim)
    facets = points.facets
    if facets is not None:
        order = np.argsort(points.id, kind="stable")
        parent = order[np.searchsorted(points.id[order], facets.parent)]
        fields = {"parent": number, "face": number, "position": vector, "area": vector}
        arrived = _carry(comm, dim, vars(facets), fields, owner[parent])
        order = np.lexsort((*arrived["position"].T, arrived["face"], arrived["parent"]))
        arrived["parent"] = np.searchsorted(result.id, arrived["parent"])
        result.facets = Facets(**{name: values[order] for name, values in arrived.items()})
    return result


def _carry(comm, dim: int, columns: dict, fields: dict, owner: np.ndarray) -> dict[str, np.ndarray]:
    """What arrives here when every rank sends these columns to their owners. DMSwarm of type BASIC: it reaches any rank
    and loses nothing."""
    swarm = PETSc.DMSwarm().create(comm)
    swarm.setDimension(dim)
    swarm.setType(PETSc.DMSwarm.Type.BASIC)
    for name, (size, kind) in fields.items():
        swarm.registerField(name, size, dtype=kind)
    swarm.finalizeFieldRegister()
    swarm.setLocalSizes(len(owner), 0)

    def put(name, values):
        swarm.getField(name).reshape(-1)[:] = np.ravel(values)
        swarm.restoreField(name)

    def get(name, size):
        values = swarm.getField(name).reshape(-1, size).copy()
        swarm.restoreField(name)
        return values if size > 1 or name in ("position", "area") else values[:, 0]

    for name in fields:
        put(name, columns[name])
    put("DMSwarm_rank", owner)
    swarm.migrate(remove_sent_points=True)
    arrived = {name: get(name, size) for name, (size, _) in fields.items()}
    swarm.destroy()
    return arrived


def _with_ghosts(comm, points: Points, tolerance: float) -> Particles:
    """Add the ghosts: what lies within the largest horizon of the particles that a rank owns, and of their facets."""
    mpi = comm.tompi4py()
    owned, dim = points.position.shape
    facets = points.facets
    box = np.full(2 * dim + 1, np.nan)
    if owned:
        away = np.linalg.norm(facets.position - points.position[facets.parent], axis=1)
        farthest = max(points.horizon.max(), (away + points.horizon[facets.parent]).max(initial=0.0))
        box = np.concatenate([points.position.min(axis=0), points.position.max(axis=0), [farthest]])
    boxes = np.empty((comm.size, 2 * dim + 1))
    mpi.Allgather(box, boxes)
    low, high, reach = boxes[:, :dim], boxes[:, dim:-1], boxes[:, -1] * (1 + tolerance + 1e-9)

    def distance_squared(rank, a, b):
        """Of points or boxes [a, b] from the box of `rank`."""
        return (np.maximum(0, np.maximum(low[rank] - b, a - high[rank])) ** 2).sum(axis=-1)

    # Two ranks are neighbours when either reaches the other; an empty rank (NaN) is nobody's.
    gap = np.array([distance_squared(rank, low[comm.rank], high[comm.rank]) for rank in range(comm.size)])
    near = gap <= np.fmax(reach, reach[comm.rank]) ** 2
    near[comm.rank] = False
    neighbours = [int(rank) for rank in np.flatnonzero(near)]
    mirrors = [
        np.flatnonzero(distance_squared(rank, points.position, points.position) <= reach[rank] ** 2)
        for rank in neighbours
    ]

    remote = swap(mpi, neighbours, mirrors, np.int64)
    ends = owned + np.cumsum([0, *(len(r) for r in remote)])
    rank = np.repeat(np.array(neighbours, np.int64), [len(r) for r in remote])
    index = np.concatenate([np.empty(0, np.int64), *remote])
    exchange = Exchange(comm, owned, rank, index)

    def local(values):
        extended = np.empty((owned + len(index), *values.shape[1:]), values.dtype)
        extended[:owned] = values
        return exchange.forward(extended)

    offset = int(mpi.scan(owned)) - owned
    numbers = np.arange(offset, offset + owned, dtype=PETSc.IntType)
    return Particles(
        comm=comm,
        count=int(mpi.allreduce(owned)),
        owned=owned,
        global_index=local(numbers),
        neighbours=neighbours,
        mirrors=mirrors,
        ghost_ranges=[slice(int(a), int(b)) for a, b in pairwise(ends)],
        exchange=exchange,
        facets=facets,
        carried=points.carried,
        mesh=points.mesh,
        **{name: local(getattr(points, name)) for name in BASIC},
    )
