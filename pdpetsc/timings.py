"""Wall-clock seconds of the stages of a run, which show in PETSc's -log_view too."""

import time
from collections import defaultdict
from contextlib import contextmanager

from petsc4py import PETSc


class Timings:
    """Seconds by stage on this rank: `with timings("residual"): ...`."""

    def __init__(self):
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, stage: str):
        start = time.perf_counter()
        try:
            with PETSc.Log.Event(f"pd:{stage}"):
                yield
        finally:
            self.seconds[stage] += time.perf_counter() - start
