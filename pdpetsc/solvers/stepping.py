"""Load steps: fixed, or halved where Newton fails and grown back where it is easy."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from pdpetsc.errors import ConvergenceError
from pdpetsc.solvers.passes import Passes, StepRecord
from pdpetsc.solvers.record import StepFailed
from pdpetsc.state import State

EASY = 5
"""A step solved in this many Newton iterations or fewer lets the next one be twice as long."""

FINE = 1 / 8
"""Of the nominal step: where softening bonds leave no equilibrium near, longer steps are cut before bonds run on."""


@dataclass(frozen=True)
class Schedule:
    """Times of the load steps.

    Attributes:
        end: time of the last step.
        steps: number of nominal steps.
        adaptive: halve a step that fails, grow back after easy ones.
        smallest, largest: limits of an adaptive step; `largest` above the nominal step lets easy steps grow beyond it.
        most: number of steps after which a path that is followed ends, wherever it is.
    """

    end: float
    steps: int
    adaptive: bool
    smallest: float
    largest: float
    most: int = 1000

    @property
    def nominal(self) -> float:
        return self.end / self.steps

    def finished(self, time: float) -> bool:
        return time >= self.end * (1 - 1e-12)

    def target(self, time: float, size: float) -> float:
        """End of a step of this size: steps up to the nominal size meet the multiples of it exactly."""
        if size > self.nominal * (1 + 1e-9):
            return self._snap(min(time + size, self.end))
        grid = (int(time / self.nominal + 1e-9) + 1) * self.nominal
        return self._snap(min(time + size, grid, self.end))

    def _snap(self, time: float) -> float:
        number = round(time / self.nominal)
        return self.end * number / self.steps if abs(time - number * self.nominal) < 1e-9 * self.nominal else time


def march(
    passes: Passes,
    state: State,
    schedule: Schedule,
    commit: Callable[[State, StepRecord], bool],
    failed: Callable[[float, float, str], None],
    again: bool = False,
) -> str:
    """Advance to the end of the schedule, or until the body has come apart, committing each converged step.

    Args:
        passes: solves one step.
        state: to begin with.
        schedule: the times.
        commit: called with each converged state; tells whether that is to be the last one for now.
        failed: called with (time reached, time tried, reason) when a step is cut.
        again: whether the first step is to the time of the state, on another body.

    Returns:
        "converged", "separated" where the body has come apart, or "paused".

    Raises:
        ConvergenceError: a step failed and may not be cut further.
    """
    while again or not schedule.finished(state.time):
        size = min(state.step_size or schedule.nominal, schedule.largest)
        target = state.time if again else schedule.target(state.time, size)
        tried, again = target - state.time, False
        cut = schedule.adaptive and tried / 2 >= schedule.smallest
        try:
            coarse = cut and tried > FINE * schedule.nominal * (1 + 1e-9)
            new, record = passes.advance(state, target, last=not cut, coarse=coarse)
        except StepFailed as failure:
            if not cut:
                remedy = "a smaller min_step" if schedule.adaptive else "more steps or adaptive = true"
                raise ConvergenceError(
                    f"load step {state.step + 1}, from t = {state.time:g} to {target:g}, did not converge: {failure}; "
                    f"{remedy} in [solver] may help"
                ) from failure
            failed(state.time, target, str(failure))
            state.step_size = max(tried * min(max(failure.share, 0.1), 0.9), schedule.smallest)
            continue
        easy = schedule.adaptive and max(newton.newton_iterations for newton in record.passes) <= EASY
        state = replace(new, step_size=2 * size if easy else size)
        paused = commit(state, record)
        if record.separated:
            return "separated"
        if paused:
            return "paused"
    return "converged"
