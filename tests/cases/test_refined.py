"""Bodies that are refined on the way, through the command line: files, pictures, restarts."""

import csv
import json
import shutil

import h5py
import meshio
import numpy as np
import pytest
from PIL import Image

from pdpetsc import cli
from pdpetsc.io.checkpoint import CHECKPOINT, FORMAT
from pdpetsc.io.seal import seal
from pdpetsc.io.tables import is_result

pytestmark = pytest.mark.mpi

PLATE = {
    "body": {
        "size": [16.0, 10.0], "spacing": 1.0, "horizon": 3.015, "cracks": [{"from": [-1.0, 5.0], "to": [5.0, 5.0]}],
    },
    "sets": {"top": "Y > 8", "bottom": "Y < 2"},
    "material": {"glass": {"model": "bond", "E": 1.0, "plane": "stress", "density": 1.0}},
    "damage": {"glass": {"criterion": "critical_stretch", "critical": 0.02, "exempt": ["top", "bottom"]}},
    "load": [
        {"kind": "velocity", "set": "top", "component": "y", "value": 0.01},
        {"kind": "displacement", "set": "bottom", "component": "y", "value": 0.0},
    ],
    "probe": [{"name": "tip", "field": "crack_tip", "direction": "x"}],
    "solver": {"mode": "verlet", "end_time": 40.0, "steps": 120},
    "refinement": {"where": "X > 3.5 and damage > 0.1"},
    "output": {"every": 30, "history": 10, "checkpoint": 60, "picture": "damage"},
}  # fmt: skip
"""A plate with an edge crack that is torn in two."""


def test_what_is_written(run, comm):
    result = run(PLATE)
    assert result.code == 0, result.errors
    summary = result.summary
    made = summary["refinements"]
    assert made[0]["step"] == 0 and len(made) > 2 and summary["particles"] == made[-1]["particles"]
    with (result.out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    counts = [int(row["particles"]) for row in rows]
    assert counts == sorted(counts) and counts[0] >= made[0]["particles"] and counts[-1] == summary["particles"]
    times = [float(row["time"]) for row in rows]
    assert times == sorted(times) and times[-1] == 40.0
    with h5py.File(result.out / "fields.h5") as file:
        bodies = {int(name): group for name, group in file["refined"].items()}
        assert all(len(group["position"]) == len(group["parent"]) for group in bodies.values())
        for name in (n for n in file if n.isdigit()):
            first = max(step for step in bodies if step <= int(name))
            assert len(file[name]["u"]) == len(bodies[first]["position"])
        ids = np.arange(len(bodies[max(bodies)]["parent"]))
        assert (bodies[max(bodies)]["parent"][...] <= ids).all()
    with meshio.xdmf.TimeSeriesReader(result.out / "fields.xdmf") as reader:
        last = reader.num_steps - 1
        assert last >= 3
    with (result.out / "broken_bonds.csv").open() as file:
        bonds = list(csv.DictReader(file))
    assert len(bonds) == summary["fracture"]["broken_bonds"] > 0
    assert max(float(bond["time"]) for bond in bonds) <= 40.0


def test_pictures(run, comm):
    result = run(PLATE)
    assert cli.main(["plot", str(result.out), "--field", "damage", "--animate"]) == 0
    comm.Barrier()
    with Image.open(result.out / "damage.gif") as image:
        assert image.n_frames >= 4
    assert (result.out / "result.png").exists()
    assert cli.main(["report", str(result.out)]) == 0
    comm.Barrier()
    page = (result.out / "report.html").read_text()
    assert "damage" in page and page.count("<img") >= 2 and "could not be made" not in page
    assert is_result(result.out)


def test_restart_goes_on(run, comm, shared_tmp_path):
    """A run that has been stopped ends as one that has not, fields of both bodies included."""
    through = run(PLATE, out="through")
    begun = run(PLATE, "--set", "solver.end_time=20.0", "--set", "solver.steps=60", out="begun")
    assert begun.code == 0, begun.errors
    if comm.rank == 0:  # the checkpoint of the same steps, in a run that was to go on
        shutil.copytree(begun.out, shared_tmp_path / "again")
        with h5py.File(shared_tmp_path / "again" / "checkpoint.h5", "a") as file:
            kept = json.loads(file["description"][...].tobytes())
            kept["case"]["document"]["solver"] = PLATE["solver"]
            for steps in kept["time_steps"]:
                whole = steps["end"] - steps["start"]
                steps["count"] = round(steps["count"] * (40.0 - steps["start"]) / whole)
                steps["end"] = 40.0
            del file["description"]
            file["description"] = np.frombuffer(json.dumps(kept).encode(), np.uint8)
    comm.Barrier()
    seal(comm, shared_tmp_path / "again" / CHECKPOINT, FORMAT)
    assert cli.main(["restart", str(shared_tmp_path / "again"), "--quiet"]) == 0
    comm.Barrier()
    after = json.loads((shared_tmp_path / "again" / "summary.json").read_text())
    assert after["particles"] == through.summary["particles"]
    assert after["probes"] == through.summary["probes"]
    assert after["energies"]["dissipated"] == pytest.approx(through.summary["energies"]["dissipated"], rel=1e-6)
    with h5py.File(shared_tmp_path / "again" / "fields.h5") as a, h5py.File(through.out / "fields.h5") as b:
        assert sorted(a["refined"]) == sorted(b["refined"])
        last = max((n for n in a if n.isdigit()), key=int)
        assert np.abs(a[last]["u"][...] - b[last]["u"][...]).max() < 1e-9
