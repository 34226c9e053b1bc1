"""The events of --json-lines that tell of breaking bonds, of steps that were cut and of bodies that are refined."""

import json

import pytest

pytestmark = pytest.mark.mpi

BAR = {
    "body": {"size": [20.0], "spacing": 1.0, "horizon": 2.015, "layers": {"left": "horizon", "right": "horizon"}},
    "sets": {"left": "X < 0", "right": "X > 20"},
    "material": {"soft": {"model": "ordinary", "E": 1.0, "nu": 0.25, "density": 1.0}},
    "load": [
        {"kind": "displacement", "set": "left", "component": "x", "value": 0.0},
        {"kind": "displacement", "set": "right", "component": "x", "value": "0.2 * t"},
    ],
    "solver": {"steps": 2},
}


def told(result) -> list[dict]:
    return [json.loads(line) for line in result.said.splitlines()]


def of(events: list[dict], name: str) -> list[dict]:
    return [event for event in events if event["event"] == name]


def test_passes(run, comm):
    """A bar that is torn in its middle: after the bonds have failed the same load is solved again."""
    damage = {"soft": {"criterion": "critical_stretch", "critical": 6e-3, "along": [{"at": [10.0]}]}}
    events = told(result := run(BAR | {"damage": damage}, "--json-lines"))
    if comm.rank:
        assert not events
        return
    assert events[0]["event"] == "start" and events[-1] == {"event": "end", "exit_code": result.code}
    passes, steps = of(events, "pass"), of(events, "step")
    broken = steps[-1]["broken_bonds"]
    assert broken > 0 and passes[-1]["broken_bonds"] == broken and passes[-1]["step"] == steps[-1]["step"]
    assert [event["passes"] for event in passes] == sorted(event["passes"] for event in passes)


def test_failed_steps(run, comm):
    """One iteration is not enough for a large step, and for none of the smaller ones that are tried."""
    petsc = {"snes_max_it": "1", "snes_rtol": "1e-14", "snes_atol": "0", "snes_stol": "0"}
    stiff = BAR["material"]["soft"] | {"model": "correspondence", "elasticity": "hencky"}
    document = BAR | {"material": {"soft": stiff}, "solver": {"steps": 2, "min_step": 0.1}}
    events = told(result := run(document, "--json-lines", petsc=petsc))
    assert result.code == 3
    if comm.rank:
        return
    failed = of(events, "failed_step")
    assert failed and all(event["time"] < event["tried"] <= 1 and event["reason"] for event in failed)
    assert [event["tried"] for event in failed] == sorted((event["tried"] for event in failed), reverse=True)
    assert of(events, "error") and events[-1] == {"event": "end", "exit_code": 3}


def test_refinements(run, comm):
    moving = [BAR["load"][0], {"kind": "velocity", "set": "right", "component": "x", "value": 0.01}]
    motion = {"mode": "verlet", "end_time": 10.0}
    plate = {"size": [12.0, 6.0], "spacing": 1.0, "horizon": 3.015}
    document = BAR | {"body": plate, "sets": {"left": "X < 2", "right": "X > 10"}, "load": moving, "solver": motion}
    glass = {"soft": {"model": "bond", "E": 1.0, "plane": "stress", "density": 1.0}}
    events = told(result := run(document | {"material": glass, "refinement": {"where": "X > 6"}}, "--json-lines"))
    assert result.code == 0
    if comm.rank:
        return
    refined = of(events, "refined")
    assert [{"event": "refined"} | row for row in result.summary["refinements"]] == refined
    assert refined[0]["particles"] == result.summary["particles"] > of(events, "start")[0]["particles"] == 72
