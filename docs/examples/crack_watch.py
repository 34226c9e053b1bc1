"""An observer: how far a crack has come while it grows, and an end of the run when it has come far enough."""

import numpy as np

import pdpetsc

FAR = 16.0


class CrackWatch(pdpetsc.Observer):
    """Follows the tip from the damage of all particles, and stops the run when it has passed FAR."""

    def __init__(self):
        self.tips = []

    def step(self, run):
        damage = run.field("damage", gather=True)  # whole on every rank, so all ranks decide alike
        X = run.field("position", gather=True)
        self.tips.append(X[damage > 0.3, 0].max())
        if self.tips[-1] > FAR:
            raise pdpetsc.Stop


PLATE = {
    "body": {
        "size": [30.0, 20.0], "spacing": 1.0, "horizon": 2.015, "cracks": [{"from": [-1.0, 10.0], "to": [10.0, 10.0]}],
    },
    "sets": {"lower": "Y < 2 * spacing", "upper": "Y > 20 - 2 * spacing"},
    "material": {"glass": {"model": "correspondence", "E": 1000.0, "nu": 0.25}},
    "damage": {"glass": {"criterion": "critical_stretch", "critical": 0.01, "exempt": ["lower", "upper"]}},
    "load": [
        {"kind": "displacement", "set": "lower", "component": "all", "value": 0.0},
        {"kind": "displacement", "set": "upper", "component": "x", "value": 0.0},
        {"kind": "displacement", "set": "upper", "component": "y", "value": "0.6 * maximum(0, t - X / 30)"},
    ],
    "solver": {"steps": 8},
}  # fmt: skip

watch = CrackWatch()
run = pdpetsc.solve(pdpetsc.load(PLATE), observers=[watch])
time, X, u = run.history("time"), run.field("position", gather=True), run.field("u", gather=True)
if run.comm.rank == 0:
    print(*(f"t = {t:.3f}: crack to {tip:.1f}" for t, tip in zip(time, watch.tips)), sep="\n")
    print(f"{run.status} at t = {time[-1]:.3f}")
assert run.status == "stopped" and time[-1] < 1.0
assert np.all(np.diff(watch.tips) >= 0) and watch.tips[-1] > FAR
assert np.isclose(u[X[:, 1] > 18, 1].max(), 0.6 * (time[-1] - 0.5 / 30))  # the wedge, at its first particle
