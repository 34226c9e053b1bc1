"""Counts a body that is not built: its particles, and from a sample of them bonds and rows of the tangents.

A low-discrepancy sequence spreads the sample over the lattice. Around each particle of it the lattice is made, with
holes, layers, finer cells and the horizons of materials, as far as two horizons; cracks are left out. Of a body from a
file all particles are counted and a sample of them likewise. Nothing is communicated: one rank counts for all.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.body.box import BLOCK, NOTHING_LEFT, Lattice, blocks_of, coordinates
from pdpetsc.body.columns import GROUPS
from pdpetsc.body.given import source_of
from pdpetsc.body.horizons import horizon_field
from pdpetsc.body.sampling import near, sample_of
from pdpetsc.body.zones import zones_of
from pdpetsc.bonds import Families, check_not_lonely, find_families
from pdpetsc.case import Case
from pdpetsc.compact import REACH
from pdpetsc.errors import InputError, at
from pdpetsc.influence import bond_weights, influence_function
from pdpetsc.materials.base import Material, Neighbourhood
from pdpetsc.memory import check_room
from pdpetsc.particles import Points


class Effort(NamedTuple):
    """How much is counted: every cell of a body of up to `cells` cells, as many of a larger one; neighbours of up to
    `samples` particles, and the rows of fewer where families are so large that it takes more than `pairs` looks. Cells
    at fitted borders are counted `roughly` or not."""

    cells: int
    samples: int
    pairs: float
    roughly: bool


FULL = Effort(10**7, 512, 1e9, False)
QUICK = Effort(10**5, 64, 1e8, True)
"""For a look before every run, in some hundredths of a second; with a fitted border in 3D within one."""

FEWEST = 24
"""Rows that are always counted."""

VIEWED = 400
"""Bytes of a particle that is looked at."""

MOST_PAIRS = 1e9
"""Above which the families round a particle are not found but taken to reach as far as they can."""

GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Census:
    """What a body holds.

    Attributes:
        particles: their number, `exact` or estimated.
        bonds: directed bonds, about.
        most: bonds of the largest family in the sample.
        blocks: blocks (dim x dim) of the assembled tangent, about.
        compact: blocks of the compact stiffness (compact.py), about.
        materials: by name, each on the largest of its families in the sample; one of which the sample has no particle
            is missing.
        shortness: largest sum w V/|xi| / sum w V |xi| of a family in the sample, by material [1/length^2].
    """

    particles: int
    exact: bool
    bonds: float
    most: int
    blocks: float
    compact: float
    materials: dict[str, Material]
    shortness: dict[str, float]


def take_census(case: Case, effort: Effort = FULL) -> Census:
    """Count a case's body.

    Raises:
        InputError: there is no such body, or a material cannot be made on it.
    """
    survey = _LatticeSurvey(case) if case.body.shape == "box" else _FileSurvey(case, effort)
    particles, exact = survey.count(effort)
    places, weight = survey.sample(effort)
    if not places:
        raise InputError(NOTHING_LEFT)
    views = [survey.view(place) for place in places]
    materials, shortness = survey.materials(views)
    coupling = [name for name, material in materials.items() if material.couples_family]
    rows = survey.rows(places, views, coupling, effort.pairs)

    def total(values):
        return particles * float(np.average(values, weights=weight[: len(values)]))

    sizes = [view.size for view in views]
    nearest = [view.nearest for view in views]
    return Census(particles, exact, total(sizes), max(sizes), total(rows), total(nearest), materials, shortness)


class _View(NamedTuple):
    """What is around a particle of the sample, which comes first.

    Attributes:
        points: the particles around it, itself included.
        names: their materials.
        distance: from the first [length].
        family: whether they are in its family.
        dual: whether it is in theirs.
    """

    points: Points
    names: np.ndarray
    distance: np.ndarray
    family: np.ndarray
    dual: np.ndarray

    @property
    def size(self) -> int:
        return int(self.family.sum())

    @property
    def nearest(self) -> int:
        """Blocks in its row of the compact stiffness."""
        p, d = self.points, self.distance
        own, others = self.family & (d <= REACH * p.spacing[0]), self.dual & (d <= REACH * p.spacing)
        return 1 + int((own | others).sum())

    def row(self, coupling: list[str], tolerance: float) -> int:
        """Blocks in its row of the tangent: its own family, the particles in whose families it is, and the members of
        those whose material couples them. Reaches two horizons."""
        p, seen = self.points, self.family | self.dual
        if (1.0 + self.size) * len(seen) > MOST_PAIRS:  # as many as there can be
            return int((self.distance <= 2 * p.horizon.max() * (1 + tolerance)).sum())
        couples = np.isin(self.names, coupling) & self.dual
        order = np.argsort(~couples, kind="stable")
        families = find_families(p.position[order], p.horizon[order], order, int(couples.sum()), tolerance)
        seen[order[families.neighbours]] = True
        seen[0] = True
        return int(seen.sum())


class _Survey:
    """A body that is looked at in places: `count`, `sample` and `around` say what is there."""

    around: Callable[..., Points]

    def __init__(self, case: Case):
        self._case = case
        self._horizon = horizon_field(case.body, case.material, case.sets)
        self._tolerance = 1 + case.body.horizon_tolerance
        self._reach = 0.0  # largest horizon in the sample, with tolerance

    def view(self, place: tuple[np.ndarray, np.ndarray], horizons: int = 1) -> _View:
        """The particles as far as so many of the largest horizons from a place, and more of them."""
        p = self.around(place, horizons)
        distance = np.linalg.norm(p.position - place[1], axis=1)
        order = np.argsort(distance, kind="stable")
        columns = (getattr(p, name)[order] for name in ("id", "position", "volume", "spacing", "horizon"))
        p = Points(*columns, carried={name: values[order] for name, values in p.carried.items()})
        distance, limit = distance[order], p.horizon * self._tolerance
        family, dual = distance <= limit[0], distance <= limit
        family[0] = dual[0] = False
        return _View(p, self._names(p), distance, family, dual)

    def _names(self, p: Points) -> np.ndarray:
        """The material of each particle."""
        names = np.full(len(p.position), "", object)
        for name, spec in self._case.material.items():
            where = None if spec.where == "all" else self._case.sets[spec.where]
            if where is None:
                names[:] = name
            elif where.where is not None:
                names[where.where.mask(**coordinates(p.position, p.spacing))] = name
            elif where.group is not None:
                groups = [name for name, spec in self._case.sets.items() if spec.group is not None]
                names[p.carried[GROUPS][:, groups.index(spec.where)] > 0] = name
        return names

    def materials(self, views: list[_View]) -> tuple[dict[str, Material], dict[str, float]]:
        """`materials` and `shortness` of a Census."""
        largest, shortness = {}, {}
        for view in sorted(views, key=lambda view: view.size):
            if view.names[0] not in self._case.material:
                continue
            spec = self._case.material[view.names[0]]
            with at(f"material.{view.names[0]}"):
                part = self._neighbourhood(view, spec)
            wV, xi = part.weight * part.volume[part.families.neighbours], view.distance[view.family]
            ratio = float((wV / xi).sum() / (wV * xi).sum())
            shortness[view.names[0]] = max(ratio, shortness.get(view.names[0], 0.0))
            largest[view.names[0]] = spec, part
        made = {}
        for name, (spec, part) in largest.items():
            with at(f"material.{name}"):
                made[name] = Material.models[spec.model].from_case(spec, part)
        return made, shortness

    def _neighbourhood(self, view: _View, spec) -> Neighbourhood:
        """The family of the first particle of a view, as its material takes it."""
        p, members = view.points, np.flatnonzero(view.family).astype(np.int32)
        families = Families(np.zeros(1, np.int32), np.array([0, len(members)]), members)
        check_not_lonely(families, p.position, p.horizon)
        influence = influence_function(spec.influence)
        weight = bond_weights(families, p.position, p.horizon, p.spacing, influence, spec.partial_volume)
        thickness = self._case.body.thickness
        return Neighbourhood(families, weight, p.position, p.volume, p.horizon, p.spacing, thickness, influence)

    def rows(self, places: list, views: list[_View], coupling: list[str], pairs: float) -> list[int]:
        """Blocks in the rows of the tangent of the first particles of the sample, as many as `pairs` allow."""
        rows = []
        for place, view in zip(places, views):
            pairs -= (1 + view.size) ** 2
            if pairs < 0 and len(rows) >= FEWEST:
                break
            wide = self.view(place, 2) if coupling else view
            rows.append(wide.row(coupling, self._tolerance - 1))
        return rows


class _LatticeSurvey(_Survey):
    """The lattice of a case."""

    def __init__(self, case: Case):
        super().__init__(case)
        self._lattice = Lattice.of(case.body, case.body.keep, self._horizon, zones_of(case))

    def _points(self, index: np.ndarray, roughly: bool = True) -> Points:
        return self._lattice.points(index, self._lattice.divisions(index), self._horizon, roughly=roughly)

    def count(self, effort: Effort) -> tuple[int, bool]:
        """The number of particles, and whether it is exact because all cells were looked at."""
        cells, body, most = self._lattice.cells, self._case.body, effort.cells
        if body.keep is None and body.refine is None and not body.zones:
            return cells, True

        def found(index):
            return len(self._points(index, effort.roughly).id)

        if cells <= most:
            exact = not (body.fitted and effort.roughly)
            return sum(found(self._lattice.indices(numbers)) for numbers in blocks_of(cells)), exact
        sampled = sum(found(spread(self._lattice, numbers)) for numbers in blocks_of(most))
        return round(sampled / most * cells), False

    def sample(self, effort: Effort) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
        """Cell and position of each particle of the sample, one of a cell, and how many the cell has."""
        lattice, places, weight = self._lattice, [], []
        few = lattice.cells <= effort.samples
        for numbers in [np.arange(lattice.cells)] if few else _growing(effort):
            index = lattice.indices(numbers) if few else spread(lattice, numbers)
            points = self._points(index)
            self._reach = max(self._reach, float(points.horizon.max(initial=0.0)) * self._tolerance)
            for cell, first, count in zip(*np.unique(points.id, return_index=True, return_counts=True)):
                one = first + int(count * (len(places) * GOLDEN % 1))
                places.append((index[cell], points.position[one]))
                weight.append(count)
            if len(places) >= effort.samples:
                break
        return places[: effort.samples], np.array(weight[: effort.samples], float)

    def around(self, place: tuple[np.ndarray, np.ndarray], horizons: int) -> Points:
        """The particles in all cells as far as so many of the largest horizons from a place."""
        lattice, (cell, _) = self._lattice, place
        reach = np.minimum(np.ceil(horizons * self._reach / lattice.cell + 1), lattice.counts).astype(np.int64)
        low = np.maximum(cell - reach, lattice.first)
        high = np.minimum(cell + reach, lattice.first + lattice.counts - 1)
        check_room("body.horizon", "particles round one", float(np.prod(high - low + 1.0)), VIEWED)
        axes = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high)), indexing="ij")
        return self._points(np.stack([axis.ravel() for axis in axes], axis=1))


class _FileSurvey(_Survey):
    """The particles that a file gives."""

    def __init__(self, case: Case, effort: Effort):
        super().__init__(case)
        keep, source = case.body.keep, source_of(case)
        self._sample = sample_of(source, keep, self._horizon, effort.samples, self._tolerance)
        self._reach = self._sample.reach

    def count(self, effort: Effort) -> tuple[int, bool]:
        """All of them have been looked at."""
        return self._sample.count, True

    def sample(self, effort: Effort) -> tuple[list[tuple[None, np.ndarray]], np.ndarray]:
        """The place of each particle of the sample, which stands for as many as any other."""
        middles = self._sample.middles
        return [(None, middle) for middle in middles], np.ones(len(middles))

    def around(self, place: tuple[None, np.ndarray], horizons: int) -> Points:
        """The particles as far as so many of the largest horizons from a place."""
        return near(self._sample, place[1], horizons * self._reach)


def _growing(effort: Effort) -> Iterator[np.ndarray]:
    """The numbers of cells in the sequence to look at, until the sample is full."""
    first, size = 0, effort.samples
    while first < effort.cells:
        yield np.arange(first, first + size)
        first, size = first + size, BLOCK


def spread(lattice: Lattice, numbers: np.ndarray) -> np.ndarray:
    """Cells with these numbers in a sequence that fills the lattice evenly: frac(1/2 + k g^-d) of its length in
    direction d, g^(dim + 1) = g + 1 (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences")."""
    g = 1.5
    for _ in range(60):
        g = (1 + g) ** (1 / (lattice.dim + 1))
    place = (0.5 + (numbers[:, None] + 1) * g ** -np.arange(1.0, lattice.dim + 1)) % 1
    return (place * lattice.counts).astype(np.int64) + lattice.first
