"""Whole jobs that end before their time: killed ranks, signals, full disks, readers that leave."""

import os
import signal
import subprocess
import sys
import time

import kills
import pytest
from conftest import environment_for_mpirun, mpirun

SHORT = kills.CASES["load steps"].replace("critical = 0.03", "critical = 1.0").replace("steps = 40", "steps = 12")
LONG = SHORT.replace("steps = 12", "steps = 600").replace("checkpoint = 1", "checkpoint = 1000")


@pytest.fixture
def job(tmp_path):
    """`job(ranks, *arguments)` starts a run that would take long, once its first step is done; all that it says comes
    with `end(job)`: exit code and the text of the error stream."""
    jobs = []
    (tmp_path / "case.toml").write_text(LONG)

    def begin(ranks, *arguments, **how):
        launcher = [mpirun(), "-n", str(ranks)] if ranks else []
        command = [*launcher, sys.executable, "-m", "pdpetsc", "case.toml", "--out", "out", *arguments]
        errors = (tmp_path / "errors").open("wb")
        environment = {"stdin": subprocess.DEVNULL, "stderr": errors, "env": environment_for_mpirun()}
        jobs.append(subprocess.Popen(command, cwd=tmp_path, **({"stdout": subprocess.DEVNULL} | environment | how)))
        until(lambda: (tmp_path / "out" / "history.csv").exists() or jobs[-1].poll() is not None)
        return jobs[-1]

    def end(job):
        return job.wait(60), (tmp_path / "errors").read_text()

    yield begin, end
    for one in jobs:
        if one.poll() is None:
            one.kill()
            one.wait()


def until(true, limit=60.0):
    deadline = time.monotonic() + limit
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_rank_that_is_killed(tmp_path):
    """Twice; mpirun ends all, and restarts come to what the run would have come to, bit by bit."""
    span = kills.whole(tmp_path, "motion", 2)
    outcome = kills.killed(tmp_path, 2, 2, span, seed=11, times=2)
    assert not {0, 2, 3, 4, 5} & set(outcome.codes) and outcome.restarted == 0, outcome
    assert max(outcome.seconds) < 30, outcome  # two, on a machine that has nothing else to do
    assert outcome.difference == 0.0, outcome


def test_signals_through_mpirun(tmp_path, job):
    begin, end = job
    run = begin(2)
    assert not (tmp_path / "out" / "checkpoint.h5").exists()
    run.send_signal(signal.SIGUSR1)
    until(lambda: (tmp_path / "out" / "checkpoint.h5").exists())
    assert run.poll() is None
    run.send_signal(signal.SIGUSR2)
    code, errors = end(run)
    assert code == 5 and "Traceback" not in errors
    assert errors.count("pdpetsc: error: ") == 1 and "(SIGUSR2); pdpetsc restart out goes on from step " in errors


def test_control_c_on_one_process(tmp_path, job):
    begin, end = job
    run = begin(None)
    run.send_signal(signal.SIGINT)
    code, errors = end(run)
    said = errors.strip().splitlines()
    assert code == 5 and len(said) == 2, errors
    assert said[0].endswith("pdpetsc: stops after this step with a checkpoint; once more stops at once")
    assert said[1].startswith("pdpetsc: error: the run was stopped after step ")


def test_a_reader_that_leaves(tmp_path, job):
    """As in `pdpetsc | head -n 1`: the run stops like at a signal."""
    begin, end = job
    read, write = os.pipe()
    run = begin(None, stdout=write)
    os.close(write)
    os.close(read)
    code, errors = end(run)
    assert code == 5 and "(nobody reads its output any more); pdpetsc restart out goes on" in errors
    assert "Traceback" not in errors and "Exception" not in errors


@pytest.fixture
def small_disk(tmp_path):
    """A file system that is soon full."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400k", "none", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("no right to mount a file system")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def test_a_full_disk(tmp_path, small_disk, run_pdpetsc):
    """On two ranks; room for a restart comes later."""
    (tmp_path / "case.toml").write_text(SHORT)
    run = run_pdpetsc(2, "case.toml", "--out", small_disk / "out")
    assert run.returncode == 1 and "Traceback" not in run.stderr, run.stderr
    assert "cannot be written (No space left on device); the run goes on without" in run.stderr
    assert run.stderr.count("pdpetsc: error: ") == 1
    subprocess.run(["mount", "-o", "remount,size=20m", small_disk], check=True)
    again = run_pdpetsc(2, "restart", small_disk / "out")
    assert again.returncode == 0, again.stderr
    assert len((small_disk / "out" / "history.csv").read_text().splitlines()) == 13
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    refused = run_pdpetsc(None, "restart", small_disk / "out")
    assert refused.returncode == 1 and "Traceback" not in refused.stderr, refused.stderr
    assert "cannot be written (Read-only file system)" in refused.stderr


def test_a_place_that_cannot_be(tmp_path, run_pdpetsc):
    (tmp_path / "case.toml").write_text(SHORT)
    (tmp_path / "file").write_text("of somebody")
    run = run_pdpetsc(2, "case.toml", "--out", tmp_path / "file" / "out")
    assert run.returncode == 2 and "Traceback" not in run.stderr
    assert run.stderr.count("pdpetsc: error: ") == 1 and "cannot be written (Not a directory)" in run.stderr


def test_a_case_that_one_rank_cannot_read(tmp_path):
    (tmp_path / "case.toml").write_text(SHORT)
    python = [sys.executable, "-m", "pdpetsc"]
    command = [mpirun(), "-n", "1", *python, "case.toml", ":", "-n", "1", *python, "missing/case.toml"]
    run = subprocess.run(
        command, cwd=tmp_path, env=environment_for_mpirun(), capture_output=True, text=True, timeout=60
    )
    assert run.returncode == 2 and "Traceback" not in run.stderr
    assert run.stderr.count("pdpetsc: error: missing/case.toml: there is no such file") == 1
