"""How tests meet MPI.

A test marked `mpi` runs inside MPI: on one process under plain pytest, on 1, 2 and 3 ranks under `scripts/test`, which
starts `mpirun -n N python -m pytest -m mpi`. It takes the communicator from the fixture `comm`, and every rank must
reach every collective in it. `@pytest.mark.mpi(min_size=2)` skips it on fewer ranks. The ranks are kept in step: a test
that fails on one rank fails on all, and one that some rank never leaves ends the whole job and shows where it stood.

Every other test runs once, on one process. Those that need ranks start their own, with the fixture `run_pdpetsc`.

With EVERY=1 in the environment all tests run. Without it those marked `slow` do not, of an `mpi` test with three and
more variants 2 ranks take one half and 3 ranks the other (by the sum of the bits of their number, which goes with no
parameter), and models.py leaves out dimensions of most models.
"""

import faulthandler
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import pytest

EVERY = bool(os.environ.get("EVERY"))
UNDER_MPIRUN = any(name in os.environ for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"))
SECONDS_PER_TEST = float(os.environ.get("TEST_SECONDS", 180))  # under mpirun: then the ranks are taken to be deadlocked
SECONDS_TO_FOLLOW = 20.0  # that the other ranks get to come out of a test which has failed on this one

# What mpirun (or MPI_Init) leaves in the environment, and what stops an mpirun started from inside.
OF_MPIRUN = (
    "OMPI_COMM", "OMPI_APP", "OMPI_FILE", "OMPI_MCA_ess", "OMPI_MCA_orte", "OMPI_MCA_pmix", "OMPI_UNIVERSE", "OMPI_NUM",
    "OMPI_FIRST", "OMPI_ARGV", "OMPI_COMMAND", "PMIX", "PMI_", "PRTE_LAUNCHED", "HYDRA",
)  # fmt: skip


# Fixtures -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def comm():
    """The communicator of all ranks (of one, under plain pytest).

    PETSc makes its own copy with the first object and frees it with the last, both collectively. Ranks collect their
    garbage at different times, so between tests one rank could be without any object and make a copy that the others
    do not: one object is kept here for all the time.
    """
    from mpi4py import MPI
    from petsc4py import PETSc

    kept = PETSc.Viewer().createASCII(os.devnull, comm=PETSc.COMM_WORLD)
    yield MPI.COMM_WORLD
    kept.destroy()


@pytest.fixture
def petsc_options(monkeypatch):
    """`petsc_options(name=value, ...)` gives options as a user does; they and the exception hook are put back."""
    from petsc4py import PETSc

    from pdpetsc import options

    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    options.set_defaults({})  # those of an earlier run: what follows is the user's
    database = PETSc.Options()
    before = database.getAll()

    def give(**given):
        options.set_defaults({})
        for name, value in given.items():
            database[name] = value

    yield give
    options.set_defaults({})
    for name in database.getAll():
        if name not in before:
            database.delValue(name)


@pytest.fixture
def shared_tmp_path(comm, tmp_path) -> Path:
    """An empty directory that is the same on every rank (`tmp_path` is one of each rank's own)."""
    return comm.bcast(tmp_path)


@pytest.fixture
def run_pdpetsc(tmp_path):
    """`run_pdpetsc(ranks, *arguments, cwd=tmp_path, limit=120, env={})`: run `python -m pdpetsc` as a user would.

    Starts `mpirun -n ranks`, or python alone when ranks is None, and returns the `subprocess.CompletedProcess` with
    stdout and stderr as text, whatever the exit code. A run longer than `limit` seconds is ended and fails the test.
    """

    def run(ranks: int | None, *arguments, cwd=tmp_path, limit: float = 120, env: dict | None = None):
        launcher = [] if ranks is None else [mpirun(), "-n", str(ranks)]
        command = [*launcher, sys.executable, "-m", "pdpetsc", *map(str, arguments)]
        environment = environment_for_mpirun() | (env or {})
        # Files, not pipes: ranks that outlive a killed mpirun would keep a pipe open, and a reader would wait for them.
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            job = subprocess.Popen(command, cwd=cwd, stdin=subprocess.DEVNULL, stdout=out, stderr=err, env=environment)
            ended = wait(job, limit)
            texts = []
            for stream in (out, err):
                stream.seek(0)
                texts.append(stream.read().decode(errors="replace"))
        if not ended:
            pytest.fail(f"not done after {limit:g} s: {' '.join(command)}\n{texts[0]}\n{texts[1]}", pytrace=False)
        return subprocess.CompletedProcess(command, job.returncode, *texts)

    return run


def mpirun() -> str:
    """Path of the MPI launcher."""
    found = shutil.which("mpirun") or shutil.which("mpiexec")
    if found is None:
        pytest.fail("no mpirun is in the PATH", pytrace=False)
    return found


def environment_for_mpirun() -> dict[str, str]:
    """This process's environment without the traces of its own MPI, with what mpirun needs as root and on few cores."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(OF_MPIRUN)}
    here = str(Path(__file__).parents[1])
    defaults = {
        "OMP_NUM_THREADS": "1",
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "OMPI_MCA_hwloc_base_binding_policy": "none",
        "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    }
    path = os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))  # this tree, installed or not
    return defaults | inherited | {"PYTHONPATH": path, "TERM": "dumb"}  # mpirun gives its first rank a terminal


def wait(job: subprocess.Popen, limit: float) -> bool:
    """Whether the job ends by itself in `limit` seconds; if not, end it (told to, mpirun ends its ranks)."""
    for action in (None, job.terminate, job.kill):
        if action:
            action()
        try:
            job.wait(limit if action is None else 10)
        except subprocess.TimeoutExpired:
            continue
        return action is None
    return False


# Ranks in step ------------------------------------------------------------------------------------------------


def pytest_collection_modifyitems(items):
    """Under mpirun only tests marked `mpi` run, and only on as many ranks as they ask for; see EVERY above."""
    size = number_of_ranks()
    half = {2: 0, 3: 1}.get(size)
    variants = Counter(function_of(item) for item in items)
    seen: Counter = Counter()
    for item in items:
        marker, function = item.get_closest_marker("mpi"), function_of(item)
        seen[function] += 1
        if marker and marker.kwargs.get("min_size", 1) > size:
            item.add_marker(pytest.mark.skip(reason=f"needs {marker.kwargs['min_size']} ranks"))
        elif UNDER_MPIRUN and not marker:
            item.add_marker(pytest.mark.skip(reason="not marked mpi"))
        elif not EVERY and item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.skip(reason="slow: runs with EVERY=1"))
        elif not EVERY and half in (0, 1) and variants[function] > 2 and seen[function].bit_count() % 2 != half:
            item.add_marker(pytest.mark.skip(reason="another number of ranks takes this variant, all do with EVERY=1"))


def function_of(item) -> str:
    """What the variants of a test have in common."""
    return item.nodeid.partition("[")[0]


def number_of_ranks() -> int:
    if not UNDER_MPIRUN:
        return 1
    from mpi4py import MPI

    return MPI.COMM_WORLD.size


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    if UNDER_MPIRUN:
        config.pluginmanager.register(RanksInStep(), "ranks-in-step")
        if not config.option.basetemp:  # each rank its own, or they clear away one another's directories
            config.option.basetemp = tempfile.mkdtemp(prefix="pdpetsc-tests-")
            config.add_cleanup(lambda: shutil.rmtree(config.option.basetemp, ignore_errors=True))


class RanksInStep:
    """Makes the ranks agree on the outcome of every test before any of them begins the next one."""

    def __init__(self):
        from mpi4py import MPI

        self.comm = MPI.COMM_WORLD.Dup()  # so that nothing here can match a call of the tests
        self.terminal = os.fdopen(os.dup(2), "w")  # pytest captures the standard streams during tests
        self.failures: list[str] = []  # of the current test on this rank

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item):
        self.failures.clear()
        self.terminal.flush()
        faulthandler.dump_traceback_later(SECONDS_PER_TEST, exit=True, file=self.terminal)
        try:
            return (yield)
        finally:
            faulthandler.cancel_dump_traceback_later()

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_runtest_makereport(self, item, call):
        report = yield
        if report.failed:
            self.failures.append(f"{report.nodeid} ({report.when})\n{report.longreprtext}")
        if report.when == "teardown":
            elsewhere = [rank for rank in self.failing_ranks(item) if rank != self.comm.rank]
            if elsewhere and not self.failures:
                report.outcome = "failed"
                report.longrepr = f"passed on rank {self.comm.rank}, failed on rank {', '.join(map(str, elsewhere))}"
        return report

    def failing_ranks(self, item) -> list[int]:
        """The ranks on which the test failed. Ends the job when this one did and the others do not come out of it."""
        flags = bytearray(self.comm.size)
        request = self.comm.Iallgather(bytes([bool(self.failures)]), flags)
        deadline = time.monotonic() + (SECONDS_TO_FOLLOW if self.failures else float("inf"))
        while not request.Test():
            if time.monotonic() > deadline:
                print(f"\nFailed on rank {self.comm.rank}, while another rank is still in it:", file=self.terminal)
                print(*self.failures, sep="\n", file=self.terminal, flush=True)
                self.comm.Abort(1)
            time.sleep(0.001)
        return [rank for rank, failed in enumerate(flags) if failed]

    def pytest_sessionfinish(self, session):
        if session.exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:  # mpirun would report it as a crash
            session.exitstatus = pytest.ExitCode.OK
