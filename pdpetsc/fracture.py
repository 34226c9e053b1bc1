"""Bonds that fail: which ones, in what order, and what is left of the body.

Bonds break between converged solves only, and then the same load is solved again (solvers/passes.py). Both directions
of a pair break when the first one reaches its critical value, unless a material's are `independent` (seed 002 section
3.1). Of those beyond it, the worst go first: what they carried changes the state of all others.
"""

import numpy as np
from mpi4py import MPI

from pdpetsc.assembly import Assembler
from pdpetsc.bonds import Families
from pdpetsc.damage.stretch import pairs_across
from pdpetsc.errors import InputError
from pdpetsc.opposite import Opposite
from pdpetsc.parallel import collective
from pdpetsc.rules import Rule
from pdpetsc.support import loose_pieces, pieces

TIE = 1e-6
"""Ratios that differ by less, relative to the worst, are the same: rounding and the solver's tolerance, which depend on
the number of ranks, do not decide which of two symmetric bonds goes."""

LEAST_SPAN = 0.1
"""A particle whose intact bonds span the space less (`Material.span`) comes loose: its last bonds break."""

STRIDE = 0.02
"""Height of the teeth, in critical stretches, in which bonds soften where softening runs on by itself."""

OVERLOAD = 2.0
"""A bond at so many times its critical value fails in the pass, whatever the others do: the load does not wait. So the
last ligament under a dead load goes at once, before the body is a mechanism."""

WHOLE = 0.01
"""Share of the body's volume from which a piece that is held or loaded is no splinter."""


class Fracture:
    """The bonds of a body and their failure.

    Args:
        assembler: of the body; its materials are told which bonds are left.
        families: of the whole body, of which the materials have theirs.
        rules: one for each material, None where bonds do not fail.
        fraction: of the worst ratio; bonds beyond it fail in the same pass. 1: the worst alone, 0: all critical ones.
        material_of: (owned,) number of each particle's material.
        moving: whether the body moves in time, so that pieces that come off need not be held.
    """

    def __init__(
        self, assembler: Assembler, families: Families, rules: list[Rule | None], fraction: float,
        material_of: np.ndarray, moving: bool = False,
    ):  # fmt: skip
        p = assembler.particles
        self._moving = moving
        self._assembler, self.families, self._rules, self.fraction = assembler, families, rules, fraction
        self._opposite = Opposite(p, families)
        self.intact = np.ones(families.bonds, bool)
        self.step = np.zeros(families.bonds, np.int32)
        """In which each bond failed."""
        self._bonds = [slice(None)]  # of each material; of the only one, all
        if len(rules) > 1:
            of_bond = families.per_bond(material_of)
            self._bonds = [np.flatnonzero(of_bond == m) for m in range(len(rules))]
        self._exempt = np.zeros(families.bonds, bool)
        for rule, bonds in zip(rules, self._bonds):
            if rule is not None:
                self._exempt |= rule.exempt[families.neighbours] | families.per_bond(rule.exempt)
                if rule.along is not None:
                    self._exempt[bonds] |= ~rule.along[bonds]
        self._exempt |= self._opposite(self._exempt.astype(float)) > 0  # where two materials meet
        self._fading = [(m, rule) for m, rule in enumerate(rules) if rule is not None and rule.softening]
        self.largest = np.zeros(families.bonds if self._fading else 0)
        """Largest stretch of each bond where some soften, in critical stretches of its direction, by the last pass."""
        for m, rule in self._fading:
            softens = ~self._exempt[self._bonds[m]]
            assembler.materials[m].soften(rule.criterion.softening(rule.softening, softens), rule.softening.printed)
        self._kept = self.intact.copy(), self.largest.copy()  # as they were committed
        self._total = self._mpi.allreduce(float(p.volume[: p.owned].sum()))
        self._bodies: int | None = None
        self.separated = False
        self.held = np.zeros(p.owned, bool)
        """Splinters that nothing else holds."""

    @property
    def _mpi(self):
        return self._assembler.mpi

    @property
    def count(self) -> int:
        """Directed bonds that have failed, on all ranks."""
        return self._mpi.allreduce(int((~self.intact).sum()))

    # What the solver does -----------------------------------------------------------------------------------------

    def ratios(self, u: np.ndarray) -> np.ndarray:
        """d/d_c of each bond at owned displacements, the larger of both directions; 0 where it cannot fail."""
        ratio, shared = self._own_ratios(u)
        ratio = np.maximum(ratio, self._opposite(ratio if shared is None else np.where(shared, ratio, 0.0)))
        ratio[self._exempt | ~self.intact] = 0.0
        return ratio

    def critical(self, u: np.ndarray) -> np.ndarray | None:
        """Mask of the bonds that are critical at owned displacements, both directions; None where none is on any
        rank (collective)."""
        ratio, shared = self._own_ratios(u)
        failed = (ratio >= 1.0) & self.intact & ~self._exempt
        if not self._mpi.allreduce(int(failed.any())):
            return None
        return (failed | self._opposite.of_mask(failed if shared is None else failed & shared)) & self.intact

    def _own_ratios(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """d/d_c of each bond in its own direction, and which share it with the other one; None: all."""
        local = self._assembler.localise(u)
        tensors = {}
        for rule in self._rules:
            if rule is not None and rule.criterion.field not in (None, *tensors):
                tensors[rule.criterion.field] = self._tensor(rule.criterion.field, local)
        ratio, shared = np.zeros(self.families.bonds), np.ones(self.families.bonds, bool)
        for rule, bonds in zip(self._rules, self._bonds):
            if rule is None:
                continue

            def both(of_material, bonds=bonds):
                own = np.zeros(self.families.bonds)
                for material, of in zip(self._assembler.materials, self._bonds):
                    own[of] = of_material(material, local)
                return (own + self._opposite(own))[bonds]

            ratio[bonds] = rule.criterion.ratio(local, tensors.get(rule.criterion.field), both)
            shared[bonds] = not rule.independent
        return ratio, None if shared.all() else shared

    def _tensor(self, method: str, local: np.ndarray) -> np.ndarray:
        """What each material gives for its families, at all local particles."""
        tensor = np.zeros((len(local), 3, 3))
        for material in self._assembler.materials:
            tensor[material.families.center] = getattr(material, method)(local)
        return self._assembler.particles.exchange.forward(tensor)

    def worst(self, ratio: np.ndarray) -> float:
        """The largest of all ranks."""
        return self._mpi.allreduce(float(ratio.max(initial=0.0)), MPI.MAX)

    def fail(self, u: np.ndarray, ratio: np.ndarray, step: int) -> int:
        """Break what is critical at owned displacements, the worst first, and what comes loose with it; the number of
        directed bonds on all ranks.

        Args:
            ratio: of each bond, by `ratios`.
            step: the load step that is being solved.
        """
        worst = self.worst(ratio)
        if worst < 1 - TIE:
            return 0
        failed = ratio >= max(1.0, self.fraction * min(worst, OVERLOAD)) * (1 - TIE)
        before = self.count
        self._break(failed, step)
        self._drop_loose_particles(step)
        self._look_at_pieces(u)
        return self.count - before

    def fail_all(self, failed: np.ndarray, u: np.ndarray, step: int) -> float:
        """Break the bonds of a mask, and nothing else: pieces in motion need no support; the energy that they take with
        them at owned displacements u (collective)."""
        local, materials = self._assembler.localise(u), self._assembler.materials
        touched = [np.flatnonzero(m.families.sums(failed[bonds])) for m, bonds in zip(materials, self._bonds)]

        def energy():
            return sum(material.energy(local, members).sum() for material, members in zip(materials, touched))

        before = energy()
        self._break(failed, step)
        return self._mpi.allreduce(float(before - energy()))

    def _break(self, failed: np.ndarray, step: int) -> None:
        self.step[failed & self.intact] = step
        self.intact = self.intact & ~failed
        self._tell()

    def _tell(self) -> None:
        """The materials which bonds are left."""
        for material, bonds in zip(self._assembler.materials, self._bonds):
            material.set_bonds(self.intact[bonds])

    def _drop_loose_particles(self, step: int) -> None:
        """Break the bonds of particles that too few of them hold, until there are none."""
        p = self._assembler.particles
        while True:
            loose = np.zeros(p.local)
            for material in self._assembler.materials:
                loose[material.families.center] = material.span < LEAST_SPAN
            loose = p.exchange.forward(loose) > 0
            failed = (loose[self.families.neighbours] | self.families.per_bond(loose)) & self.intact & ~self._exempt
            if not self._mpi.allreduce(int(failed.sum())):
                return
            self._break(failed, step)

    def _look_at_pieces(self, u: np.ndarray) -> None:
        """Hold what nothing holds any more, and see whether the body has come apart: whether there are more pieces than
        at first that carry loads or supports and are no splinters."""
        if self._moving:
            return
        a, p = self._assembler, self._assembler.particles
        piece = pieces(p, self.families.without(~self.intact))[: p.owned]
        if self._bodies is None:
            self._bodies = self._carriers(pieces(p, self.families)[: p.owned], u)
        self.separated = self._carriers(piece, u) > self._bodies
        self.held = loose_pieces(p, piece, a.supported)
        a.hold(self.held, u)

    def _carriers(self, piece: np.ndarray, u: np.ndarray) -> int:
        a, p = self._assembler, self._assembler.particles
        carries = a.supported.any(axis=1) | (a.external_force(u) != 0).any(axis=1)
        heads = np.unique(np.concatenate(self._mpi.allgather(np.unique(piece[carries]))))
        number = np.searchsorted(heads, piece)
        inside = (number < len(heads)) & (heads[np.minimum(number, len(heads) - 1)] == piece) if len(heads) else carries
        volume = np.bincount(number[inside], p.volume[: p.owned][inside], len(heads))
        return int((self._mpi.allreduce(volume) >= WHOLE * self._total).sum())

    @property
    def crack_area(self) -> float:
        """Of the cracks that have grown, by the number of their bonds; length times thickness in 2D (collective)."""
        p, families, bonds = self._assembler.particles, self.families, np.flatnonzero(~self.intact)
        i, j = families.per_bond(np.arange(p.local))[bonds], families.neighbours[bonds]
        crossing = pairs_across(p.horizon[i], p.dim, self._assembler.materials[0].thickness)
        return self._mpi.allreduce(float((p.volume[i] * p.volume[j] / crossing).sum() / 2))

    # Softening ----------------------------------------------------------------------------------------------------

    @property
    def softens(self) -> bool:
        """Whether any bonds do."""
        return bool(self._fading)

    def set_live(self, live: bool) -> None:
        """Whether softening follows the stretches, or stays as it is."""
        for m, rule in self._fading:
            largest = self.largest[self._bonds[m]] * self._critical(m, rule)
            self._assembler.materials[m].set_softening(largest, live)

    def _critical(self, m: int, rule: Rule) -> np.ndarray:
        """s_c of each bond of a material."""
        return np.repeat(rule.criterion.critical, np.diff(self._assembler.materials[m].families.offsets))

    def growth(self, u: np.ndarray) -> np.ndarray:
        """By how much the stretch of each bond at owned displacements u is beyond that to which it has softened, in
        critical stretches; 0 where it is not or does not soften."""
        growth = np.zeros(self.families.bonds)
        local = self._assembler.localise(u) if self._fading else None
        for m, rule in self._fading:
            bonds = self._bonds[m]
            start = np.maximum(self.largest[bonds], rule.softening.s_min / self._critical(m, rule))
            beyond = rule.criterion.ratio(local, None, None) - start
            growth[bonds] = np.where(self.intact[bonds] & ~self._exempt[bonds], np.maximum(beyond, 0.0), 0.0)
        return growth

    def soften(self, growth: np.ndarray, live: bool) -> None:
        """Take over the stretches of bonds that have come beyond those to which they have softened; softening stays as
        it then is (collective).

        Args:
            growth: by `growth`.
            live: whether softening has followed the stretches. If not, bonds soften in teeth, the worst first
                (sequentially linear analysis): one that has come `STRIDE`/2 beyond the stretch to which it has softened
                goes on to `STRIDE`/2 beyond the present one, short of the critical one, at which it fails.
        """
        fraction, tooth = (0.0, 0.0) if live else (self.fraction, STRIDE / 2)
        start = self.largest.copy()
        for m, rule in self._fading:
            bonds = self._bonds[m]
            start[bonds] = np.maximum(start[bonds], rule.softening.s_min / self._critical(m, rule))
        stretch = np.where(growth > tooth, start + growth, 0.0)
        taken = (stretch > 0.0) & (stretch >= fraction * self.worst(stretch) * (1 - TIE))
        ahead = np.maximum(stretch, np.minimum(stretch + tooth, 1 - tooth))
        self.largest = np.where(taken, ahead, self.largest)
        self.set_live(False)

    def commit(self) -> None:
        """Keep what has failed."""
        self._kept = self.intact.copy(), self.largest.copy()

    def roll_back(self, u: np.ndarray) -> None:
        """Take back what has failed since the last commit; `u` is the state of that time."""
        intact, largest = self._kept
        changed = int((intact != self.intact).sum())
        self.largest = largest.copy()
        self.set_live(True)
        if self._mpi.allreduce(changed):
            self.intact = intact.copy()
            self._tell()
            self._look_at_pieces(u)

    # What is kept and shown ---------------------------------------------------------------------------------------

    def broken(self) -> np.ndarray:
        """(n, 3) ids of i and j and the load step of each directed bond i -> j of this rank that has failed."""
        return self._listed(~self.intact, self.step)

    def broken_ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions of i and of j, (n, dim) each, of the bonds of `broken`."""
        p, bonds = self._assembler.particles, np.flatnonzero(~self.intact)
        i = self.families.per_bond(np.arange(p.local))[bonds]
        return p.position[i], p.position[self.families.neighbours[bonds]]

    def softened(self) -> np.ndarray:
        """(n, 3) ids of i and j and the largest stretch, in critical ones, of this rank's bonds that have softened."""
        return self._listed(self.largest > 0.0, self.largest)

    def _listed(self, chosen: np.ndarray, values: np.ndarray) -> np.ndarray:
        p, bonds = self._assembler.particles, np.flatnonzero(chosen)
        i = p.id[self.families.per_bond(np.arange(p.local))[bonds]]
        return np.stack([i, p.id[self.families.neighbours[bonds]], values[bonds]], axis=1)  # ids are 64-bit integers

    def restore(self, broken: np.ndarray, softened: np.ndarray, u: np.ndarray) -> None:
        """Break and soften the bonds of lists (n, 3) that have those of all ranks, as `broken` and `softened` give them
        (collective)."""
        p = self._assembler.particles
        center = self.families.per_bond(np.arange(p.local))
        pairs = p.id[center].astype(np.int64) * p.count + p.id[self.families.neighbours]
        order = np.argsort(pairs)
        for listed, values in ((broken, self.step), (softened, self.largest)):
            mine = listed[np.isin(listed[:, 0], p.id[: p.owned])]
            wanted = mine[:, 0].astype(np.int64) * p.count + mine[:, 1].astype(np.int64)
            place = np.searchsorted(pairs, wanted, sorter=order)
            place = order[np.minimum(place, len(order) - 1)] if len(wanted) else place
            with collective(self._mpi):
                if not np.array_equal(pairs[place], wanted):
                    raise InputError(
                        "the bonds that have failed are not all there: the body is not that of the checkpoint; "
                        "has the mesh of a crack been changed?"
                    )
            values[place] = mine[:, 2]
        self.take_over(self.step, self.largest, u)

    def take_over(self, step: np.ndarray, largest: np.ndarray, u: np.ndarray) -> None:
        """Go on with bonds that have failed and softened before (collective).

        Args:
            step: (bonds,) in which each has failed, 0 where it has not.
            largest: (bonds,) largest stretch of each, in critical ones; not used where none soften.
            u: displacements of the state.
        """
        self.step, self.intact = step.astype(np.int32), step == 0
        if self._fading:
            self.largest = largest
        self.set_live(True)
        self._tell()
        self._look_at_pieces(u)
        self.commit()
