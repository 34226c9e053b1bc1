"""A case built into a discrete problem, carried through its load steps or through time, and refined on the way."""

import time as clock
from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

from pdpetsc.adapt.inheritance import inherited
from pdpetsc.adapt.measures import changes, measures
from pdpetsc.adapt.refinement import EVERY, before
from pdpetsc.body.cracks import cracks_of
from pdpetsc.body.sets import Sets
from pdpetsc.building import distributed_particles, expected_blocks, refinement_of
from pdpetsc.case import Case
from pdpetsc.discretisation import Discretisation, schedule_of
from pdpetsc.errors import ConvergenceError, InputError, Interrupted, OutputError
from pdpetsc.io.checkpoint import gathered_bonds, read_damaged, read_description, read_particles, read_state
from pdpetsc.observers import Observer
from pdpetsc.particles import Particles
from pdpetsc.recover import Recovery
from pdpetsc.signals import Requests
from pdpetsc.solvers.constraints import ArcLength, Constraint, Failure
from pdpetsc.solvers.dynamics import TimeSteps
from pdpetsc.solvers.passes import Passes, StepRecord
from pdpetsc.solvers.path import follow
from pdpetsc.solvers.stepping import Schedule, march
from pdpetsc.state import State
from pdpetsc.summary import row_of
from pdpetsc.timings import Timings

_KEEP_COMMUNICATOR = PETSc.Vec().create(PETSc.COMM_WORLD)
"""PETSc frees its copy of a communicator with the last object on it. Ranks collect garbage at different times, so in a
second simulation of one process some would have to copy it again, collectively, and others not."""

MINUTES = 30.0  # between checkpoints of a motion at most, where the case says nothing


class Outputs(NamedTuple):
    """Functions of a step's number: whether its fields and a checkpoint are written."""

    fields: Callable[[int], bool]
    checkpoint: Callable[[int], bool]


class Simulation:
    """A case that has been built and can be solved.

    Args:
        case, comm: what is run, and PETSc's communicator.
        blocks: of the assembled tangent, where they have been counted.
        checkpoint: result directory of an earlier run that is continued.

    Attributes:
        case, comm: what is run, and PETSc's communicator.
        particles, families, materials, assembler, solver: the discrete problem; `cut_bonds`, `cracked`: likewise.
        fracture: the bonds that may fail; None if none may.
        state: the last committed state.
        schedule: the load steps.
        probes: what is followed.
        rows: one dictionary for each committed step, as in summary.json, with its probes.
        timings: seconds by stage.
        refinements: one dictionary for each, as in summary.json.
        observers: who is told.
        requests: what signals and the clock ask for.
        unwritten: what has kept results of the end from being written; None: nothing.
    """

    def __init__(self, case: Case, comm: PETSc.Comm, blocks: float | None = None, checkpoint: Path | None = None):
        self.started = clock.perf_counter()
        self.case, self.comm = case, comm
        self.rows: list[dict] = []
        self.refinements: list[dict] = []
        self.observers: list[Observer] = []
        minutes = case.output.checkpoint_minutes or (MINUTES if case.solver.in_time else None)
        self.requests = Requests(comm.tompi4py(), minutes, case.solver.in_time)
        self.unwritten: OutputError | None = None
        try:
            self._build(case, expected_blocks(comm, case) if blocks is None else blocks, checkpoint)
        except InputError as error:
            message = str(error)
            raise InputError(message if message.startswith(case.path) else f"{case.path}: {message}") from None

    def _build(self, case: Case, blocks: float, checkpoint: Path | None) -> None:
        comm, self.timings, self._blocks = self.comm, Timings(), blocks
        kept = read_description(checkpoint) if checkpoint else {}
        with self.timings("setup"):
            particles = distributed_particles(comm, case)
            self._cracks = cracks_of(comm.tompi4py(), case.body.cracks, particles.dim, "body.cracks")
            sets = Sets.of(particles, case.sets)
            self._refinement = refinement_of(case)
            self.refinements = kept.get("refinements", [])
            if self.refinements:
                first = particles.count
                particles, sets = read_particles(checkpoint, particles, sets, case.body.horizon_tolerance)
                self._blocks = blocks = blocks * particles.count / first
        self._unsolved = kept.get("unsolved", False)
        time_steps = [TimeSteps(**steps) for steps in kept.get("time_steps", [])]
        self._discretise(particles, sets, blocks, time_steps, refined=False)
        in_time = case.solver.in_time
        self.state = self.solver.initial if in_time else State(u=np.zeros((particles.owned, particles.dim)))
        if checkpoint:
            self.go_on_from(read_state(checkpoint, particles), kept["rows"], read_damaged(checkpoint))

    def _discretise(self, p: Particles, sets: Sets, blocks: float, time_steps: list[TimeSteps], refined: bool) -> None:
        """Build everything on particles."""
        d = Discretisation(self.case, self.comm, p, sets, self._cracks, self.timings, blocks, time_steps, refined)
        self._problem = d
        self.particles, self.families, self.materials, self.assembler = p, d.families, d.materials, d.assembler
        self.fracture, self.solver, self.probes = d.fracture, d.solver, d.probes
        self.cut_bonds, self.cracked = d.cut_bonds, d.cracked
        if not self.case.solver.in_time:
            self.passes = Passes(d.solver, d.assembler, d.fracture, self.case.solver.overshoot, self._passed)

    @property
    def schedule(self) -> Schedule | TimeSteps:
        """The load steps, or the time steps to the end."""
        return self.solver.steps if self.case.solver.in_time else schedule_of(self.case.solver)

    def _constraint(self, state: State, arc_length: float) -> Constraint:
        """What bounds a step along a path."""
        if self.case.solver.control == "failure":
            return Failure(self.assembler, self.fracture)
        return ArcLength(self.assembler, state, arc_length)

    @property
    def output(self) -> Outputs:
        """When fields and checkpoints are written."""
        if self.case.solver.in_time:
            return Outputs(lambda n: self.solver.writes_fields(n), lambda n: self.solver.writes_checkpoint(n))
        output = self.case.output
        every, checkpoint = output.every or 1, output.checkpoint or (0 if output.checkpoint_minutes else 1)
        return Outputs(lambda step: step % every == 0, lambda step: bool(checkpoint) and step % checkpoint == 0)

    @cached_property
    def recovery(self) -> Recovery:
        """Fields of the committed state."""
        return Recovery(self.assembler, self.state.u, self._problem.reached, self.state.v)

    @property
    def damaged(self) -> dict[str, np.ndarray]:
        """Lists (n, 3) of this rank's bonds that have failed and softened (`Fracture.broken`, `Fracture.softened`)."""
        if not self.fracture:
            return {}
        return {"broken_bonds": self.fracture.broken(), "softened_bonds": self.fracture.softened()}

    def time_of(self, step: int) -> float:
        """The time of a step; of one between committed ones, that of the next one where steps are not equal."""
        if self.case.solver.mode == "verlet":
            return self.solver.time_of(step)
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
        kept = {"case": {"document": c.document} | origin, "rows": self.rows, "refinements": self.refinements}
        kept |= {"unsolved": self._unsolved}
        return kept | ({"time_steps": [asdict(s) for s in self.solver.time_steps]} if c.solver.in_time else {})

    def solve(self) -> str:
        """Run to the end of the schedule, "converged", until the body has come apart, "separated", or to where a signal
        stops it, "interrupted".

        Raises:
            ConvergenceError: a step was not solved; the steps before it stay committed.
            InputError: a load has no value at some time; likewise.
        """
        for observer in self.observers:
            observer.start(self)
        failure = None
        try:
            status = "separated" if self.separated else self._solve()  # separated: in an earlier run
        except (ConvergenceError, InputError, Interrupted) as error:  # met by all ranks alike, so they finish together
            status, failure = "interrupted", None if isinstance(error, Interrupted) else error
            if self.fracture and self.case.solver.in_time:  # what has broken since the last committed step
                self.fracture.roll_back(self.state.u)
            if self.rows:
                self.assembler.set_time(self.state.time)  # the loads of the last committed state again
            else:
                self.assembler.unload()
        self._finish()
        if failure:
            raise failure
        return status

    def _finish(self) -> None:
        for observer in self.observers:
            try:
                observer.finish(self)
            except OutputError as error:  # the others may have more luck
                self.unwritten = self.unwritten or error.with_traceback(None)

    def _solve(self) -> str:
        """March to the end, and refine the body on the way."""
        solver = self.case.solver
        while self._mark(self.state) and self._refine() and not self.rows:
            pass  # at the start; a checkpoint was written before that, and goes on with one refinement
        self.requests.look()
        if self.requests.stop and not self.ended:
            return "interrupted"
        while True:
            if solver.in_time:
                paused = self.solver.run(self.state, self._commit_motion, self._look)
                status = "paused" if paused else "converged"
            elif solver.control == "load":
                status = march(self.passes, self.state, self.schedule, self._commit, self._failed, self._unsolved)
            else:
                status = follow(self.passes, self.state, self.schedule, self._constraint, self._commit, self._failed)
            if status != "paused":
                return status
            if self.requests.stop:
                return "interrupted"
            self._refine()

    def _mark(self, state: State) -> bool:
        """Mark the particles that are to be split at the state; whether there are any (collective)."""
        every = self._refinement and (self.case.refinement.every or (EVERY if self.case.solver.in_time else 1))
        in_time = self.case.solver.in_time
        if not every or state.step % every or self.separated or (in_time and self.schedule.finished(state.time)):
            return False
        if not self.rows and in_time:
            self.assembler.set_time(0.0)
        elif not self.rows:
            self.assembler.unload()
        recovery = Recovery(self.assembler, state.u, self._problem.reached, state.v)
        self._marked = self._refinement.marked(self.particles, self.families, recovery, state.time)
        return self.comm.tompi4py().allreduce(int(self._marked.sum())) > 0

    def _refine(self) -> bool:
        """Split the marked particles at the committed state; whether any could be (collective)."""
        mpi, in_time = self.comm.tompi4py(), self.case.solver.in_time
        mass = self.solver.mass if in_time else None
        time_steps = self.solver.time_steps if in_time and self.rows else []
        was = measures(self.particles, self.assembler, self.state, mass)
        damaged = {name: gathered_bonds(mpi, bonds) for name, bonds in self.damaged.items()}
        split = mpi.allreduce(int(self._marked.sum()))
        intact = self.fracture.intact if self.fracture else None
        refined = self._refinement.refined(
            self.particles, self._problem.sets, self.families, intact, self._marked, self.state, mass
        )
        if refined is None:
            return False
        p, sets, state = refined
        former = before(p)
        growth = p.count / self.particles.count
        self._discretise(p, sets, self._blocks * growth, time_steps, refined=True)
        self._blocks *= growth
        self.__dict__.pop("recovery", None)
        if in_time and not self.rows:
            state = self.solver.initial  # rather than what was mapped
        self.state = state
        if in_time or self.rows:
            self.assembler.set_time(state.time)
        if in_time:
            state.u = np.where(self.assembler.constrained, self.assembler.prescribed, state.u)
        self._unsolved = bool(self.rows) and not in_time
        if self.fracture:
            bonds = p, self.families, former
            values = (inherited(*bonds, listed, self.case.body.horizon_tolerance) for listed in damaged.values())
            self.fracture.take_over(*values, state.u)  # type: ignore[call-arg]
        now = measures(p, self.assembler, state, self.solver.mass if in_time else None)
        if self.rows:
            state.mapped += now["stored"] - was["stored"]
        if in_time and self.rows:
            self.solver.go_on_from(state)
            kinetic = self.solver.kinetic(state)
            state.mapped, state.kinetic = state.mapped + kinetic - state.kinetic, kinetic
        row = {"step": state.step, "time": state.time, "split": split, "particles": p.count}
        self.refinements.append(row | changes(was, now))
        PETSc.garbage_cleanup(self.comm)
        for observer in self.observers:
            observer.refined(self)
        return True

    def _commit(self, state: State, record: StepRecord) -> bool:
        """Take a state over; whether the run is to pause at it."""
        self.__dict__.pop("recovery", None)
        self.state, self._unsolved = state, False
        if self.fracture:
            self.fracture.commit()
        self._note(row_of(self, record))
        return self.requests.stop > 0 and not self.schedule.finished(state.time) or self._mark(state)

    def _commit_motion(self, state: State) -> None:
        self.__dict__.pop("recovery", None)
        self.state = state
        if self.fracture:
            self.fracture.commit()
        self._note(self.solver.row(state))

    def _note(self, row: dict) -> None:
        """Add a row, and tell the observers of the step."""
        if not self.case.solver.in_time:
            self.requests.look()
        probes = {probe.name: probe.read(self.recovery, self.state.time) for probe in self.probes}
        self.rows.append(row | self._count | {"probes": probes})
        for observer in self.observers:
            observer.step(self)
        if self.requests.save:  # nobody writes checkpoints
            self.requests.saved()

    def _look(self, state: State) -> str:
        """What is to become of a step of a motion: `Motion`'s "commit" or "pause"."""
        self.requests.look()
        if self.requests.stop or self._mark(state):
            return "pause"
        return "commit" if self.requests.save else ""

    def _look_within_step(self) -> None:
        self.requests.look()
        if self.requests.stop:
            raise Interrupted

    @property
    def _count(self) -> dict[str, int]:
        """Of particles, where that changes."""
        return {"particles": self.particles.count} if self._refinement else {}

    def _passed(self, record: StepRecord) -> None:
        self._look_within_step()
        for observer in self.observers:
            observer.passed(self, record)

    def _failed(self, reached: float, tried: float, reason: str) -> None:
        for observer in self.observers:
            observer.failed(self, reached, tried, reason)
        self._look_within_step()
