"""The plate of the README from a script: how much longer it becomes, and the stress beside its larger hole."""

import matplotlib

import pdpetsc

PLATE = {
    "units": {"length": "mm", "force": "N"},
    "body": {
        "size": [120.0, 60.0], "spacing": 2.0, "thickness": 50.0, "horizon": 2.015, "layers": {"left": "horizon"},
    },
    "sets": {"clamp": "X < 0", "pulled": "X > 120 - spacing"},
    "material": {"steel": {"model": "correspondence", "E": 210e3, "nu": 0.3}},
    "load": [
        {"kind": "displacement", "set": "clamp", "component": "all", "value": 0.0},
        {"kind": "force", "set": "pulled", "component": "x", "value": "300e3 * t"},
    ],
    "solver": {"steps": 1},
    "probe": [
        {"name": "elongation", "field": "u", "component": "x", "set": "pulled", "reduce": "mean"},
        {"name": "reaction", "field": "reaction", "component": "x", "set": "clamp", "reduce": "sum"},
    ],
}  # fmt: skip

radii, elongations, peaks = [4.0, 8.0, 12.0, 16.0], [], []
for radius in radii:
    hole = f"hypot(X - 40, Y - 30) > {radius} and hypot(X - 85, Y - 22) > 8"
    run = pdpetsc.solve(pdpetsc.load(PLATE, {"body.keep": hole}))
    elongations.append(run.history("elongation")[-1])
    peaks.append(run.field("von_mises", gather=True).max())
    assert run.status == "converged" and abs(run.history("reaction")[-1] + 300e3) < 1e-3

assert elongations == sorted(elongations), "a larger hole makes the plate softer"

if run.comm.rank == 0:
    for radius, elongation, peak in zip(radii, elongations, peaks):
        print(f"radius {radius:4.1f}: elongation {elongation:.5f}, stress {peak:.0f}")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots()
    ax.plot(radii, elongations, "o-")
    ax.set(xlabel="radius of the larger hole [mm]", ylabel="elongation [mm]")
    fig.savefig("plate_sweep.png")
