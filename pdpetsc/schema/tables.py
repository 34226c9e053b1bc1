"""The tables of a case file, one model for each; their fields are the keys."""

from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    Field,
    Strict,
    ValidationInfo,
    model_validator,
)

from pdpetsc.expressions import hint
from pdpetsc.quantities import CHEAP, QUANTITIES
from pdpetsc.schema.body import Body, ParticleSet, Surface
from pdpetsc.schema.damage import DamageTable, Fraction
from pdpetsc.schema.loads import LoadTable
from pdpetsc.schema.materials import MaterialTable
from pdpetsc.schema.options import OptionValue, harmless, option_name
from pdpetsc.schema.probes import Expect, Probe, different_names, of_known_probes
from pdpetsc.schema.refinement import Refinement
from pdpetsc.schema.table import Table, error_at, exactly_one
from pdpetsc.schema.values import (
    Axes,
    Count,
    FieldName,
    Label,
    Name,
    Positive,
    SetName,
    Title,
    formula,
    new_set,
    new_surface,
)


class Units(Table):
    """Labels for pictures; all numbers of a case are in one consistent set of units."""

    length: Label = "m"
    force: Label = "N"
    time: Label = "s"


class Solver(Table):
    """How the load is stepped; t runs from 0 to end_time."""

    mode: Literal["newton", "relaxation", "verlet", "generalised_alpha"] = "newton"
    hand_over: bool = False
    control: Literal["load", "arc_length", "failure"] = "load"
    steps: Count = 10
    end_time: Positive = 1.0
    adaptive: bool = True
    time_step: Positive | None = None
    min_step: Positive | None = None
    max_step: Positive | None = None
    max_steps: Count = 1000
    bonds_per_pass: Fraction = 0.95
    overshoot: Positive = 0.1

    @property
    def in_time(self) -> bool:
        """Whether t is time, and the body moves."""
        return self.mode in ("verlet", "generalised_alpha")

    @model_validator(mode="after")
    def _check(self):
        if self.min_step and self.max_step and self.min_step > self.max_step:
            raise ValueError(f"min_step = {self.min_step} is greater than max_step = {self.max_step}")
        if self.time_step and not self.in_time:
            raise error_at("time_step", f'goes with mode = "verlet" and "generalised_alpha", not with "{self.mode}"')
        if self.time_step and "steps" in self.model_fields_set:
            raise error_at("time_step", "goes without steps: each says how long they are")
        idle = ("overshoot", "bonds_per_pass", *(("adaptive", "min_step", "max_step") if self.mode == "verlet" else ()))
        for key in idle if self.in_time else ():
            if key in self.model_fields_set:
                raise error_at(key, f'does not go with mode = "{self.mode}"')
        if self.control != "load" and (self.mode != "newton" or self.hand_over):
            raise error_at("control", f'is "{self.control}", which goes with mode = "newton" without hand_over')
        if self.hand_over and self.mode != "newton":
            raise error_at("hand_over", 'goes with mode = "newton"')
        if self.control == "load" and "max_steps" in self.model_fields_set:
            raise error_at("max_steps", 'goes with control = "arc_length" and "failure"')
        if self.control != "load" and "overshoot" in self.model_fields_set:
            raise error_at("overshoot", 'goes with control = "load"')
        return self


class Initial(Table):
    """Displacement or velocity of a set at the start of a motion."""

    set: SetName = "all"
    component: Axes
    displacement: formula() | None = None
    velocity: formula() | None = None

    @model_validator(mode="after")
    def _check(self):
        exactly_one(self, "displacement", "velocity")
        return self


class Curve(Table):
    """A picture of one probe over another."""

    x: Name
    y: Name


class Output(Table):
    """What is written, each so many load steps."""

    every: Count | None = None
    checkpoint: Count | None = None
    checkpoint_minutes: Positive | None = None
    history: Count | None = None
    times: Annotated[tuple[Positive, ...], Strict(False)] = ()
    fields: Annotated[tuple[FieldName, ...], Strict(False)] = CHEAP
    picture: FieldName = "u"
    curve: Curve | None = None


def of_known_materials(damage: dict, info: ValidationInfo) -> dict:
    """Tables of damage are called like the materials that they are for."""
    materials = info.data.get("material", {})
    for name in damage if materials else ():
        if name not in materials:
            raise error_at(
                name, f"there is no material {name!r}{hint(name, materials)}; choices: {', '.join(materials)}"
            )
        if getattr(materials[name], "weighted_volume", None) == "updated" and getattr(damage[name], "softening", None):
            raise error_at(
                name, 'softening does not go with weighted_volume = "updated" of the material; take "frozen"'
            )
    return damage


def of_failing_bonds(solver: Solver, info: ValidationInfo) -> Solver:
    """What goes with bonds that fail needs some, and paths are followed where bonds that fail are whole before."""
    damage = info.data.get("damage")
    if damage == {}:
        if solver.control == "failure":
            raise error_at("control", 'is "failure", but no bond can fail; add a table [damage.NAME] for a material')
        for key in ("bonds_per_pass", "overshoot"):
            if key in solver.model_fields_set:
                raise error_at(key, "is given, but no bond can fail; add a table [damage.NAME] for a material")
    for name, table in (damage or {}).items():
        if solver.control != "load" and getattr(table, "softening", None):
            raise error_at(
                "control", f'"{solver.control}" does not go with damage.{name}.softening; take control = "load"'
            )
    return solver


def of_motion(solver: Solver, info: ValidationInfo) -> Solver:
    """What moves in time has mass, and velocities are of motion."""
    for name, table in info.data.get("material", {}).items() if solver.in_time else ():
        if getattr(table, "density", 1.0) is None:
            raise error_at("mode", f'"{solver.mode}" needs material.{name}.density')
    for name, table in info.data.get("material", {}).items():
        if getattr(table, "dual", True) is False and solver.mode != "verlet":
            raise error_at("mode", f'"{solver.mode}" needs a tangent, which material.{name}.dual = false does not have')
    for name, table in (info.data.get("damage") or {}).items() if solver.in_time else ():
        if getattr(table, "softening", None):
            raise error_at("mode", f'"{solver.mode}" does not go with damage.{name}.softening')
    for load in info.data.get("load", ()) if not solver.in_time else ():
        if load.kind == "velocity":
            raise error_at("mode", f'"{solver.mode}" knows no velocity; take mode = "verlet" or "generalised_alpha"')
    return solver


def of_time(initial: tuple, info: ValidationInfo) -> tuple:
    """Initial values are of motion in time."""
    solver = info.data.get("solver")
    if initial and solver and not solver.in_time:
        raise ValueError(f'goes with mode = "verlet" and "generalised_alpha", not with "{solver.mode}"')
    return initial


def of_numbers(output: Output, info: ValidationInfo) -> Output:
    """Check that the curve is one of probes that are single numbers, and that what is of motion goes with motion."""
    solver = info.data.get("solver")
    for key in ("history", "times") if solver and not solver.in_time else ():
        if key in output.model_fields_set:
            raise error_at(key, f'is of motion; it does not go with mode = "{solver.mode}"')
    if output.curve is None or not {"body", "probe"} <= info.data.keys():
        return output
    probes = {probe.name: probe for probe in info.data["probe"]}
    for axis in ("x", "y"):
        name = getattr(output.curve, axis)
        if (axis, name) == ("x", "time"):
            continue
        if name not in probes:
            choices = f"choices: {', '.join(probes) or 'none'}"
            raise ValueError(f"curve.{axis}: there is no probe {name!r}{hint(name, probes)}; {choices}")
        if not probes[name].is_number(info.data["body"].dim):
            raise ValueError(
                f"curve.{axis}: the probe {name!r} has many values, a curve needs a single number: no line, and a "
                "component of vectors and tensors"
            )
    return output


def of_cells(refinement: Refinement | None, info: ValidationInfo) -> Refinement | None:
    """Particles in cells can be split, between load steps and in motion."""
    body, solver = info.data.get("body"), info.data.get("solver")
    if refinement and body and body.shape != "box":
        raise ValueError(f'splits the cells of lattices, so it goes with body.shape = "box", not with "{body.shape}"')
    if refinement and body and body.particles == "vertices":
        raise ValueError('divides cells, so it goes with body.particles = "cells"')
    if refinement and solver and solver.control != "load":
        raise ValueError(f'goes with load steps and motion, not with solver.control = "{solver.control}"')
    return refinement


class Description(Table):
    """A whole case file, after a variant and overrides have been merged into it."""

    used_before = ("variant",)

    title: Title = ""
    units: Units = Units()
    body: Body
    sets: dict[Annotated[Name, AfterValidator(new_set)], ParticleSet] = {}
    surfaces: dict[Annotated[Name, AfterValidator(new_surface)], Surface] = {}
    material: Annotated[dict[Name, MaterialTable], Field(min_length=1)]
    damage: Annotated[dict[Name, DamageTable], AfterValidator(of_known_materials)] = {}
    load: Annotated[tuple[LoadTable, ...], Strict(False)] = ()
    solver: Annotated[Solver, AfterValidator(of_failing_bonds), AfterValidator(of_motion)] = Solver()
    refinement: Annotated[Refinement | None, AfterValidator(of_cells)] = None
    initial: Annotated[tuple[Initial, ...], Strict(False), AfterValidator(of_time)] = ()
    probe: Annotated[tuple[Probe, ...], Strict(False), AfterValidator(different_names)] = ()
    output: Annotated[Output, AfterValidator(of_numbers)] = Output()
    expect: Annotated[tuple[Expect, ...], Strict(False), AfterValidator(of_known_probes)] = ()
    petsc: Annotated[dict[Annotated[str, AfterValidator(option_name)], OptionValue], AfterValidator(harmless)] = {}

    @property
    def written(self) -> tuple[str, ...]:
        """The fields that are written: those that are asked for, and what the picture and failing bonds need."""
        chosen = {*self.output.fields, "u", self.output.picture, *(["damage"] if self.damage else [])}
        return tuple(name for name in QUANTITIES if name in chosen)
