"""The discrete problem of a case on its particles: families, materials, loads, bonds that fail, and what solves it."""

import numpy as np
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.body.cracks import Ends, cut_bonds
from pdpetsc.body.sets import Sets
from pdpetsc.bonds import check_not_lonely, find_families
from pdpetsc.building import materials_of
from pdpetsc.case import Case
from pdpetsc.errors import InputError
from pdpetsc.fracture import Fracture
from pdpetsc.grading import warn_thin_zones
from pdpetsc.loads.building import loads_of, tractions_of
from pdpetsc.parallel import collective, warn
from pdpetsc.particles import Particles
from pdpetsc.probes import Probe
from pdpetsc.rules import rules_of
from pdpetsc.solvers.dynamics import TimeSteps
from pdpetsc.solvers.equilibrium import equilibrium_solver
from pdpetsc.solvers.stepping import Schedule
from pdpetsc.support import check_resistance, check_support
from pdpetsc.timings import Timings
from pdpetsc.transient import Transient


class Discretisation:
    """A case on particles; a refinement makes another one.

    Args:
        case, comm: what is run, and PETSc's communicator.
        particles, sets: the distributed particles and their sets.
        cracks: of the case.
        timings: seconds by stage.
        blocks: about how many the assembled tangent has.
        time_steps: those of a motion so far.
        refined: whether the body was another one before; what has been said of it is not said again.

    Attributes:
        particles, sets, families, materials, assembler, solver: the discrete problem; `cut_bonds` by each crack.
        reached: volume in the horizon of each owned particle, cracks or not; `cracked`: whether they cut bonds of it.
        bonds: directed ones, on all ranks.
        fracture: the bonds that may fail; None if none may.
        probes: what is followed.
    """

    def __init__(
        self, case: Case, comm: PETSc.Comm, particles: Particles, sets: Sets, cracks: list, timings: Timings,
        blocks: float, time_steps: list[TimeSteps], refined: bool,
    ):  # fmt: skip
        self.case, self.comm, self.particles, self.sets = case, comm, particles, sets
        p, mpi = particles, comm.tompi4py()
        with timings("families"), collective(mpi):
            families = find_families(p.position, p.horizon, p.id, p.owned, case.body.horizon_tolerance)
            self.reached = families.sums(p.volume[families.neighbours])
            cuts = cut_bonds(families, Ends(p.position, p.horizon, p.id), cracks)
            self.cracked = families.sums(cuts.any(axis=0).astype(float)) > 0
            families = families.without(cuts.any(axis=0))
            check_not_lonely(families, p.position, p.horizon)
            self.families, interior = families.interior_first(p.owned)
        self.bonds = mpi.allreduce(families.bonds)
        self.cut_bonds = [mpi.allreduce(int(cut.sum())) for cut in cuts]
        if not refined:
            self._warn()
        with timings("setup"):
            self.materials = materials_of(case, p, self.families, interior, sets, quiet=refined)
            self.probes = [Probe(spec, p, None if spec.set is None else sets[spec.set]) for spec in case.probe]
            loads, tractions = loads_of(case, p, sets), tractions_of(case, p, self.materials, cracks)
            self.assembler = Assembler(p, self.materials, loads, timings, tractions)
        for k, probe in enumerate(self.probes):
            if not probe.reached:
                raise InputError(
                    f"probe.{k}: {probe.name!r} has a point more than a spacing away from every particle; "
                    "does it lie outside the body or in a hole?"
                )
        if case.solver.in_time:
            self.fracture = self._fracture()
            self.solver = Transient(case, self.assembler, sets, self.fracture, blocks, time_steps, refined)
            self._try_loads(0.0, self.solver.steps.end)
        else:
            schedule = schedule_of(case.solver)
            check_support(p, self.families, self.assembler.constrained)
            check_resistance(p, self.materials, self.assembler.constrained)
            self._try_loads(schedule.target(0.0, schedule.nominal), schedule.end)
            self.fracture = self._fracture()
            self.solver = equilibrium_solver(case.solver, self.assembler, blocks, bool(case.damage))

    def _warn(self) -> None:
        for number, bonds in enumerate(self.cut_bonds):
            if not bonds:
                warn(
                    self.comm,
                    f"body.cracks.{number}: cuts no bond; does it lie in the body, in the same unit of length?",
                )
        warn_thin_zones(self.particles, self.families)

    def _try_loads(self, *times: float) -> None:
        """A load without a value shows here."""
        for time in times:
            self.assembler.set_time(time)

    def _fracture(self) -> Fracture | None:
        case, p, members = self.case, self.particles, np.zeros(self.particles.owned, int)
        if not case.damage:
            return None
        for number, material in enumerate(self.materials):
            members[material.families.center] = number
        rules = rules_of(case, p, self.families, self.materials, self.sets)
        solver = case.solver
        return Fracture(self.assembler, self.families, rules, solver.bonds_per_pass, members, solver.in_time)


def schedule_of(solver) -> Schedule:
    """The load steps of a case's `[solver]`."""
    nominal = solver.end_time / solver.steps
    return Schedule(
        solver.end_time, solver.steps, solver.adaptive, solver.min_step or nominal / 1024,
        solver.max_step or nominal, solver.max_steps,
    )  # fmt: skip
