"""A case built into particles, families, materials, loads and a solver, and carried through its load steps."""

import time as clock
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

from pdpetsc.assembly import Assembler
from pdpetsc.body.cracks import Ends, cracks_of, cut_bonds
from pdpetsc.body.sets import Sets
from pdpetsc.bonds import check_not_lonely, find_families
from pdpetsc.building import distributed_particles, expected_blocks, materials_of
from pdpetsc.case import Case
from pdpetsc.errors import ConvergenceError, InputError
from pdpetsc.fracture import Fracture
from pdpetsc.grading import warn_thin_zones
from pdpetsc.loads.building import loads_of, tractions_of
from pdpetsc.observers import Observer
from pdpetsc.parallel import collective, warn
from pdpetsc.probes import Probe
from pdpetsc.recover import Recovery
from pdpetsc.rules import rules_of
from pdpetsc.solvers.constraints import ArcLength, Constraint, Failure
from pdpetsc.solvers.equilibrium import equilibrium_solver
from pdpetsc.solvers.passes import Passes, StepRecord
from pdpetsc.solvers.path import follow
from pdpetsc.solvers.stepping import Schedule, march
from pdpetsc.state import State
from pdpetsc.support import check_resistance, check_support
from pdpetsc.timings import Timings
from pdpetsc.transient import Transient

_KEEP_COMMUNICATOR = PETSc.Vec().create(PETSc.COMM_WORLD)
"""PETSc frees its copy of a communicator with the last object on it. Ranks collect garbage at different times, so in a
second simulation of one process some would have to copy it again, collectively, and others not."""


class Outputs(NamedTuple):
    """Functions of a step's number: whether its fields and a checkpoint are written."""

    fields: Callable[[int], bool]
    checkpoint: Callable[[int], bool]


class Simulation:
    """A case that has been built and can be solved.

    Args:
        case, comm: what is run, and PETSc's communicator.
        blocks: of the assembled tangent, where they have been counted.

    Attributes:
        case, comm: what is run, and PETSc's communicator.
        particles, families, materials, assembler, solver: the discrete problem; `cut_bonds` by each crack.
        fracture: the bonds that may fail; None if none may.
        state: the last committed state.
        schedule: the load steps.
        probes: what is followed.
        rows: one dictionary for each committed step, as in summary.json, with its probes.
        timings: seconds by stage.
        observers: who is told.
    """

    def __init__(self, case: Case, comm: PETSc.Comm, blocks: float | None = None):
        self.started = clock.perf_counter()
        self.case, self.comm = case, comm
        try:
            self._build(case, comm, expected_blocks(case) if blocks is None else blocks)
        except InputError as error:
            message = str(error)
            raise InputError(message if message.startswith(case.path) else f"{case.path}: {message}") from None
        in_time = case.solver.in_time
        self.state = self.solver.initial if in_time else State(u=np.zeros((self.particles.owned, self.particles.dim)))
        self.rows: list[dict] = []
        self.observers: list[Observer] = []

    def _build(self, case: Case, comm: PETSc.Comm, blocks: float) -> None:
        self.timings = Timings()
        with self.timings("setup"):
            self.particles = distributed_particles(comm, case)
        p = self.particles
        cracks = cracks_of(comm.tompi4py(), case.body.cracks, p.dim, "body.cracks")
        with self.timings("families"), collective(comm.tompi4py()):
            self.families = find_families(p.position, p.horizon, p.id, p.owned, case.body.horizon_tolerance)
            reached = self.families.sums(p.volume[self.families.neighbours])
            cuts = cut_bonds(self.families, Ends(p.position, p.horizon, p.id), cracks)
            self.families = self.families.without(cuts.any(axis=0))
            check_not_lonely(self.families, p.position, p.horizon)
            self.families, interior = self.families.interior_first(p.owned)
        self._reached = reached
        self.cut_bonds = [comm.tompi4py().allreduce(int(cut.sum())) for cut in cuts]
        for number, bonds in enumerate(self.cut_bonds):
            if not bonds:
                warn(comm, f"body.cracks.{number}: cuts no bond; does it lie in the body, in the same unit of length?")
        warn_thin_zones(p, self.families)
        with self.timings("setup"):
            sets = Sets(
                p,
                {name: s.where for name, s in case.sets.items() if s.where},
                {name: s.nearest for name, s in case.sets.items() if s.nearest},
            )
            self.materials = materials_of(case, p, self.families, interior, sets)
            self.probes = [Probe(spec, p, None if spec.set is None else sets[spec.set]) for spec in case.probe]
            loads, tractions = loads_of(case, p, sets), tractions_of(case, p, self.materials, cracks)
            self.assembler = Assembler(p, self.materials, loads, self.timings, tractions)
        for k, probe in enumerate(self.probes):
            if not probe.reached:
                raise InputError(
                    f"probe.{k}: {probe.name!r} has a point more than a spacing away from every particle; "
                    "does it lie outside the body or in a hole?"
                )
        if case.solver.in_time:
            self._build_motion(sets, blocks)
        else:
            self._build_steps(sets, blocks)

    def _build_motion(self, sets: Sets, blocks: float) -> None:
        """What goes through time."""
        self.fracture = self._fracture(sets) if self.case.damage else None
        self.solver = Transient(self.case, self.assembler, sets, self.fracture, blocks)
        self.schedule = self.solver.steps
        for time in (0.0, self.schedule.end):  # a load without a value shows here
            self.assembler.set_time(time)

    def _build_steps(self, sets: Sets, blocks: float) -> None:
        """What goes through load steps."""
        case, p, solver = self.case, self.particles, self.case.solver
        nominal = solver.end_time / solver.steps
        self.schedule = Schedule(
            solver.end_time, solver.steps, solver.adaptive, solver.min_step or nominal / 1024,
            solver.max_step or nominal, solver.max_steps,
        )  # fmt: skip
        check_support(p, self.families, self.assembler.constrained)
        check_resistance(p, self.materials, self.assembler.constrained)
        for time in (self.schedule.target(0.0, nominal), solver.end_time):  # a load without a value shows here
            self.assembler.set_time(time)
        self.fracture = self._fracture(sets) if case.damage else None
        self.solver = equilibrium_solver(solver, self.assembler, blocks, bool(case.damage))
        self.passes = Passes(self.solver, self.assembler, self.fracture, solver.overshoot, self._passed)

    def _constraint(self, state: State, arc_length: float) -> Constraint:
        """What bounds a step along a path."""
        if self.case.solver.control == "failure":
            return Failure(self.assembler, self.fracture)
        return ArcLength(self.assembler, state, arc_length)

    def _fracture(self, sets: Sets) -> Fracture:
        p, members = self.particles, np.zeros(self.particles.owned, int)
        for number, material in enumerate(self.materials):
            members[material.families.center] = number
        rules = rules_of(self.case, p, self.families, self.materials, sets)
        solver = self.case.solver
        return Fracture(self.assembler, self.families, rules, solver.bonds_per_pass, members, solver.in_time)

    @cached_property
    def output(self) -> Outputs:
        """When fields and checkpoints are written."""
        if self.case.solver.in_time:
            return Outputs(self.solver.writes_fields, lambda step: step % self.solver.checkpoint == 0)
        every, checkpoint = self.case.output.every or 1, self.case.output.checkpoint or 1
        return Outputs(lambda step: step % every == 0, lambda step: step % checkpoint == 0)

    @cached_property
    def recovery(self) -> Recovery:
        """Fields of the committed state."""
        return Recovery(self.assembler, self.state.u, self._reached, self.state.v)

    @property
    def damaged(self) -> dict[str, np.ndarray]:
        """Lists (n, 3) of this rank's bonds that have failed and softened (`Fracture.broken`, `Fracture.softened`)."""
        if not self.fracture:
            return {}
        return {"broken_bonds": self.fracture.broken(), "softened_bonds": self.fracture.softened()}

    def time_of(self, step: int) -> float:
        """The time of a step; of one between committed ones, that of the next one where steps are not equal."""
        if self.case.solver.mode == "verlet":
            return self.schedule.time(step)
        return next(row["time"] for row in self.rows if row["step"] >= step)

    @property
    def ended(self) -> bool:
        """Whether nothing is left to be done: the end is reached, or the body has come apart."""
        return self.separated or self.schedule.finished(self.state.time)

    @property
    def separated(self) -> bool:
        """Whether the body has come apart."""
        return self.fracture is not None and self.fracture.separated

    def go_on_from(self, state: State, rows: list[dict], damaged: dict[str, np.ndarray]) -> None:
        """Continue an earlier run at its last state (collective)."""
        self.state, self.rows = state, rows
        self.assembler.set_time(state.time)
        if self.fracture:
            self.fracture.restore(damaged["broken_bonds"], damaged["softened_bonds"], state.u)

    @property
    def description(self) -> dict:
        """What a checkpoint keeps beside the state."""
        c = self.case
        origin = {"name": c.name, "variant": c.variant, "path": c.path, "overridden": c.overridden}
        return {"document": c.document, **origin, "rows": self.rows}

    def solve(self) -> str:
        """Run to the end of the schedule, "converged", or until the body has come apart, "separated".

        Raises:
            ConvergenceError: a step was not solved; the steps before it stay committed.
            InputError: a load has no value at some time; likewise.
        """
        for observer in self.observers:
            observer.start(self)
        status, failure = "not_converged", None
        try:
            if self.separated:  # in an earlier run
                status = "separated"
            elif self.case.solver.in_time:
                self.solver.run(self.state, self._commit_motion)
                status = "converged"
            elif self.case.solver.control == "load":
                status = march(self.passes, self.state, self.schedule, self._commit, self._failed)
            else:
                status = follow(self.passes, self.state, self.schedule, self._constraint, self._commit, self._failed)
        except (ConvergenceError, InputError) as error:  # met by all ranks alike, so they can finish together
            failure = error
            if self.fracture and self.case.solver.in_time:  # what has broken since the last committed step
                self.fracture.roll_back(self.state.u)
            if self.rows:
                self.assembler.set_time(self.state.time)  # the loads of the last committed state again
            else:
                self.assembler.unload()
        for observer in self.observers:
            observer.finish(self)
        if failure:
            raise failure
        return status

    def _commit(self, state: State, record: StepRecord) -> None:
        self.__dict__.pop("recovery", None)
        self.state = state
        last, iterations = record.passes[-1], [newton.newton_iterations for newton in record.passes]
        scale = last.residual_scale
        along = {} if self.case.solver.control == "load" else {"arc_length": record.arc_length}
        energies = {}
        if self.fracture:
            self.fracture.commit()
            energies = {
                "external_work": state.external_work, "stored_energy": record.stored, "dissipated": state.dissipated,
                "held_particles": record.held, "crack_area": self.fracture.crack_area,
            }  # fmt: skip
        self.rows.append(
            {
                "step": state.step,
                "time": state.time,
                "load_factor": state.time / self.schedule.end,
                **along,
                "newton_iterations": sum(iterations),
                "linear_iterations": sum(newton.linear_iterations for newton in record.passes),
                "relaxation_steps": sum(newton.relaxation_steps for newton in record.passes),
                "residual_norms": last.residual_norms,
                "residual_scale": scale,
                "relative_residual": last.residual_norms[-1] / scale if scale else 0.0,
                "rounding_floor": last.rounding_floor,
                "broken_bonds": record.broken,
                "passes": len(iterations),
                "most_newton_iterations": max(iterations),
                "abandoned_iterations": record.abandoned,
                "seconds": sum(newton.seconds for newton in record.passes),
                **energies,
                "probes": {probe.name: probe.read(self.recovery, state.time) for probe in self.probes},
            }
        )
        for observer in self.observers:
            observer.step(self)

    def _commit_motion(self, state: State) -> None:
        self.__dict__.pop("recovery", None)
        self.state = state
        if self.fracture:
            self.fracture.commit()
        probes = {probe.name: probe.read(self.recovery, state.time) for probe in self.probes}
        self.rows.append(self.solver.row(state) | {"probes": probes})
        for observer in self.observers:
            observer.step(self)

    def _passed(self, record: StepRecord) -> None:
        for observer in self.observers:
            observer.passed(self, record)

    def _failed(self, reached: float, tried: float, reason: str) -> None:
        for observer in self.observers:
            observer.failed(self, reached, tried, reason)
