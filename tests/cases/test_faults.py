"""When things go wrong, inside MPI: signals, files that cannot be written, damaged ones, restarts of every mode."""

import errno
import json
import os
import random
import resource
import shutil
import signal

import h5py
import numpy as np
import pytest

from pdpetsc import cli, driver
from pdpetsc.errors import InputError, OutputError
from pdpetsc.io import shared_file
from pdpetsc.io.checkpoint import CHECKPOINT, FORMAT, check_whole
from pdpetsc.io.seal import seal
from pdpetsc.io.shared_file import open_file
from pdpetsc.io.tables import is_result
from pdpetsc.simulation import Simulation

pytestmark = pytest.mark.mpi

PLATE = {
    "body": {"size": [8.0, 6.0], "spacing": 1.0, "horizon": 2.015, "cracks": [{"from": [0.0, 3.0], "to": [3.0, 3.0]}]},
    "sets": {"bottom": "Y < 1", "top": "Y > 5"},
    "material": {"glass": {"model": "bond", "E": 1.0, "density": 1.0}},
    "load": [
        {"kind": "displacement", "set": "bottom", "component": "all", "value": 0.0},
        {"kind": "displacement", "set": "top", "component": "y", "value": "0.1 * t"},
    ],
    "damage": {"glass": {"criterion": "critical_stretch", "critical": 0.025}},
    "probe": [{"name": "pull", "field": "reaction", "component": "y", "set": "top", "reduce": "sum"}],
    "solver": {"steps": 6},
    "output": {"checkpoint": 100},
}
SLOW = PLATE | {"load": [PLATE["load"][0], PLATE["load"][1] | {"value": "0.15 * t / 15"}]}
SPLIT = {"refinement": {"where": "damage > 0.1"}}
WHOLE = {"damage": {}}
ELASTIC = PLATE | WHOLE
MODES = {  # restarts along other paths, of softening bonds and of refined bodies are tested with those
    "load steps": PLATE,
    "arc length": ELASTIC | {"solver": {"steps": 6, "control": "arc_length"}},
    "relaxation": ELASTIC | {"solver": {"steps": 5, "mode": "relaxation"}},
    "verlet, refinement": SLOW | SPLIT | {"solver": {"mode": "verlet", "end_time": 15.0, "steps": 150}},
    "generalised alpha": SLOW
    | WHOLE
    | {"solver": {"mode": "generalised_alpha", "end_time": 15.0, "steps": 30, "adaptive": False}},
}
SAME = {"verlet, refinement": 0.0, "relaxation": 0.0, "generalised alpha": 1e-3}
"""How far restarts may be from runs that go on, relative to the displacements; elsewhere 1e-10, and on one rank 0. The
generalised-alpha method begins anew, to its order."""


@pytest.fixture(autouse=True)
def without_pictures(monkeypatch):
    monkeypatch.setattr(driver, "draw", lambda *arguments: None)


@pytest.fixture
def ask(comm, monkeypatch):
    """`ask(number, step)`: the last rank alone sends itself a signal at a step."""
    note, due = Simulation._note, {}

    def noted(self, row):
        if row["step"] >= due["step"] and comm.rank == comm.size - 1:
            due["step"] = np.inf
            os.kill(os.getpid(), due["number"])
        note(self, row)

    def give(number, step):
        due.update(number=number, step=step)
        monkeypatch.setattr(Simulation, "_note", noted)

    return give


@pytest.fixture
def restart(comm, capsys):
    """`restart(directory)`: exit code, summary and what this rank said."""

    def go(directory):
        capsys.readouterr()
        code = cli.main(["restart", str(directory)])
        comm.Barrier()
        path = directory / "summary.json"
        return code, json.loads(path.read_text()) if path.exists() else None, capsys.readouterr().err

    return go


def displacements(directory):
    with h5py.File(directory / "checkpoint.h5") as file:
        return file["u"][...]


# Signals and restarts -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_signal_to_one_rank_stops_all_and_the_restart_is_the_run(comm, run, ask, restart, mode):
    through = run(MODES[mode], out="through")
    assert through.code == 0, through.errors
    ask(signal.SIGTERM, 3)
    stopped = run(MODES[mode])
    assert stopped.code == 5, stopped.errors
    assert stopped.summary["status"] == "interrupted" and not stopped.summary["converged"]
    step = stopped.summary["steps"][-1]["step"]
    assert 3 <= step < through.summary["steps"][-1]["step"]
    if comm.rank == 0:
        (line,) = stopped.errors.strip().splitlines()
        assert "the run was stopped after step" in line and "SIGTERM" in line
        assert f"pdpetsc restart {stopped.out} goes on from step {step}, t = " in line
    code, summary, _ = restart(stopped.out)
    assert code == 0 and summary["status"] == through.summary["status"]
    u, expected = displacements(stopped.out), displacements(through.out)
    allowed = SAME.get(mode, 1e-10 if comm.size > 1 else 0.0)
    assert np.abs(u - expected).max() <= allowed * np.abs(expected).max()
    if "fracture" in summary:
        assert summary["fracture"]["broken_bonds"] == through.summary["fracture"]["broken_bonds"] > 0
    assert summary["particles"] == through.summary["particles"]


def test_a_signal_for_a_checkpoint_alone(comm, run, ask, monkeypatch):
    steps = []
    monkeypatch.setattr("pdpetsc.observers.write_checkpoint", lambda *of: steps.append(of[2].step))
    ask(signal.SIGUSR1, 3)
    result = run(ELASTIC)
    assert result.code == 0, result.errors
    assert steps == [3, result.summary["steps"][-1]["step"]]


def test_minutes_between_checkpoints(comm, run, monkeypatch):
    """The clock of the first rank is that of all: where every look finds that they are over, every step has one."""
    steps = []
    monkeypatch.setattr("pdpetsc.observers.write_checkpoint", lambda *of: steps.append(of[2].step))
    assert run(ELASTIC | {"output": {"checkpoint_minutes": 1e-9}}).code == 0
    assert steps == list(range(1, 7))
    steps.clear()
    result = run(ELASTIC | {"output": {"checkpoint_minutes": 1e3}})
    assert steps == [result.summary["steps"][-1]["step"]]


def test_a_signal_among_passes(comm, run, restart, monkeypatch):
    """Bonds that have failed in a step that is not finished are whole again in the checkpoint."""
    passed, counts = Simulation._passed, []

    def signalled(self, record):
        counts.append(record.broken)
        if comm.rank == comm.size - 1:
            os.kill(os.getpid(), signal.SIGTERM)
        passed(self, record)

    monkeypatch.setattr(Simulation, "_passed", signalled)
    stopped = run(PLATE)
    assert stopped.code == 5 and len(counts) == 1 and counts[0] > 0
    assert stopped.summary["fracture"]["broken_bonds"] == 0
    monkeypatch.undo()
    assert restart(stopped.out)[0] == 0


def test_handlers_are_put_back(run, ask):
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)]
    ask(signal.SIGINT, 2)
    assert run(ELASTIC).code == 5
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)] == before


# Files that cannot be written ---------------------------------------------------------------------------------


@pytest.fixture
def full(comm, monkeypatch):
    """`full(name)`: from now on the last rank's disk has no room for what it writes into the open file of that name."""
    write = shared_file._write_at

    def fill(name):
        def fail(descriptor, place, data):
            if comm.rank == comm.size - 1 and name in os.readlink(f"/proc/self/fd/{descriptor}"):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            write(descriptor, place, data)

        monkeypatch.setattr(shared_file, "_write_at", fail)

    return fill


def test_a_file_is_changed_whole_or_not_at_all(comm, shared_tmp_path, full):
    from petsc4py import PETSc

    path = shared_tmp_path / "numbers.h5"

    def write(mode, name):
        with open_file(PETSc.COMM_WORLD, path, mode) as file:
            file.write(name, 4 * comm.size, 4 * comm.rank, np.arange(4.0) + 4 * comm.rank)
            file.write(name + "_vector", 2 * comm.size, 2 * comm.rank, np.full((2, 3), comm.rank))

    write("w", "first")
    write("r+", "group/second")
    before = path.read_bytes()
    comm.Barrier()
    full("numbers.h5")
    with pytest.raises(OutputError, match=r"numbers.h5: cannot be written \(No space left on device\)"):
        write("r+", "third")
    comm.Barrier()
    assert path.read_bytes() == before
    with h5py.File(path) as file:
        for name in ("first", "group/second"):
            assert np.array_equal(file[name], np.arange(4.0 * comm.size))
            assert np.array_equal(file[name + "_vector"][:, 2], np.repeat(np.arange(comm.size), 2))


def test_a_run_goes_on_without_a_checkpoint(comm, run, full, restart, monkeypatch):
    """Those that can be written are, and at the end it is an error; the last whole one goes on."""
    wrote = driver.Checkpoint._write

    def write(self, run):
        if run.state.step == 4:
            full(CHECKPOINT)
        wrote(self, run)

    monkeypatch.setattr(driver.Checkpoint, "_write", write)
    result = run(ELASTIC | {"output": {"checkpoint": 2}})
    assert result.code == 1
    assert result.summary["status"] in ("converged", "separated") and len(result.summary["steps"]) == 6
    check_whole(comm, result.out)
    assert not (result.out / (CHECKPOINT + ".new")).exists()
    if comm.rank == 0:
        *warnings, last = result.errors.strip().splitlines()
        assert all("checkpoint.h5.new: cannot be written" in line and "goes on" in line for line in warnings)
        assert last.startswith("pdpetsc: error: ") and "(No space left on device); pdpetsc restart" in last
        assert "goes on from step 2, t = " in last
    monkeypatch.undo()
    code, summary, _ = restart(result.out)
    assert code == 0 and summary["steps"][-1]["step"] == result.summary["steps"][-1]["step"]


def test_a_limit_of_file_sizes(comm, run):
    """The field file grows beyond it: warnings, at the end an error; it holds the steps that it has had room for."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (80_000, limits[1]))
    try:
        result = run(ELASTIC)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert result.code == 1
    if comm.rank == 0:
        *warnings, last = result.errors.strip().splitlines()
        assert warnings and all("fields.h5: cannot be written (File too large)" in line for line in warnings)
        assert last.startswith("pdpetsc: error: ") and "goes on from step 6" in last
    with h5py.File(result.out / "fields.h5") as file:
        steps = [name for name in file if name.isdigit()]
        assert 0 < len(steps) < 6 and all(np.abs(file[name]["u"][...]).max() > 0 for name in steps)


def test_a_lost_directory(comm, run, monkeypatch):
    tell = driver.History.step

    def step(self, run):
        if run.state.step == 2:
            if comm.rank == 0:
                shutil.rmtree(self._directory)
            comm.Barrier()
        tell(self, run)

    monkeypatch.setattr(driver.History, "step", step)
    result = run(ELASTIC)
    assert result.code == 1
    if comm.rank == 0:
        assert "Traceback" not in result.errors
        assert result.errors.strip().splitlines()[-1].startswith("pdpetsc: error: ")


# Damaged files ------------------------------------------------------------------------------------------------


@pytest.fixture
def stopped(run, ask):
    """A result that waits to be gone on with."""
    ask(signal.SIGTERM, 3)
    result = run(ELASTIC)
    assert result.code == 5
    return result


def test_damaged_checkpoints_are_refused(comm, stopped):
    """Cut short anywhere, or with any byte changed, before HDF5 sees it."""
    chance, path = random.Random(7), stopped.out / CHECKPOINT
    good = path.read_bytes()
    lengths = [0, 1, 511, 512, 513, 600, len(good) - 1, *(chance.randrange(len(good)) for _ in range(20))]
    places = [*range(0, 60, 3), 511, 512, 520, len(good) - 1, *(chance.randrange(len(good)) for _ in range(40))]
    flipped = [good[:n] + bytes([good[n] ^ 1 << chance.randrange(8)]) + good[n + 1 :] for n in places]
    for content in [good[:n] for n in lengths] + [good + b"\0"] + flipped:
        comm.Barrier()
        if comm.rank == 0:
            path.write_bytes(content)
        comm.Barrier()
        with pytest.raises(InputError, match=r"checkpoint\.h5: (the checkpoint is|this is no)"):
            check_whole(comm, stopped.out)


def test_foreign_checkpoints_are_refused(comm, stopped, restart):
    path = stopped.out / CHECKPOINT

    def refused(content):
        comm.Barrier()
        if comm.rank == 0 and content is not None:
            path.write_bytes(content)
        comm.Barrier()
        code, _, errors = restart(stopped.out)
        assert code == 2
        if comm.rank:
            return ""
        (line,) = errors.strip().splitlines()
        assert line.startswith("pdpetsc: error: ") and "checkpoint.h5: " in line
        return line

    good, fields = path.read_bytes(), (stopped.out / "fields.h5").read_bytes()
    for content in (b"not ours", fields):
        line = refused(content)
        assert comm.rank or "this is no pdpetsc checkpoint of format" in line
    comm.Barrier()
    if comm.rank == 0:
        path.write_bytes(good)
    comm.Barrier()
    seal(comm, path, FORMAT + 1)
    line = refused(None)
    assert comm.rank or f"is of format {FORMAT + 1}; this version of pdpetsc reads format {FORMAT}" in line
    if comm.rank == 0:
        path.unlink()
    line = refused(None)
    assert comm.rank or "there is no checkpoint" in line
    if comm.rank == 0:
        path.mkdir()
    line = refused(None)
    assert comm.rank or "cannot be read (Is a directory)" in line


def test_damaged_fields_are_set_aside(comm, stopped, restart):
    """And half a row of the history is dropped, with those after the checkpoint."""
    for number, left in enumerate((0, 100, 0.5, 0.9)):
        out = stopped.out.with_name(f"damaged{number}")
        if comm.rank == 0:
            shutil.copytree(stopped.out, out)
            size = (out / "fields.h5").stat().st_size
            os.truncate(out / "fields.h5", left if left >= 1 else int(left * size))
            with (out / "history.csv").open("a") as file:
                file.write("4,0.5,0.5,1")
        comm.Barrier()
        code, _, errors = restart(out)
        assert code == 0
        assert comm.rank or "fields.h5: is damaged; it is now fields.damaged" in errors
        with h5py.File(out / "fields.h5") as file:
            assert [int(name) for name in file if name.isdigit()] == [3, 4, 5, 6]
        lines = (out / "history.csv").read_text().splitlines()
        assert [int(line.split(",")[0]) for line in lines[1:]] == [1, 2, 3, 4, 5, 6]
        assert is_result(out)
