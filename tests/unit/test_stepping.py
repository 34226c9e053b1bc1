"""Load steps: where they end, how they are halved and how they grow back."""

from dataclasses import replace

import numpy as np
import pytest

from pdpetsc.errors import ConvergenceError
from pdpetsc.solvers.passes import StepRecord
from pdpetsc.solvers.record import SolveRecord, StepFailed
from pdpetsc.solvers.stepping import EASY, Schedule, march
from pdpetsc.state import State


def schedule(steps=10, end=1.0, adaptive=True, smallest=None, largest=None):
    nominal = end / steps
    return Schedule(end, steps, adaptive, smallest or nominal / 1024, largest or nominal)


class Passes:
    """Solves steps that end at or below the times that `limit` gives for their start; notes what it was asked."""

    def __init__(self, limit=lambda start: np.inf, iterations=EASY):
        self.limit, self.iterations = limit, iterations
        self.asked = []

    def advance(self, state, time, last, coarse):
        self.asked.append(time)
        if time > self.limit(state.time):
            raise StepFailed("DIVERGED_MAX_IT")
        record = StepRecord(passes=[SolveRecord(newton_iterations=self.iterations)])
        return replace(state, u=state.u + 1, time=time, step=state.step + 1), record


def times(passes, plan, state=None):
    """Times of the committed steps, and the cuts."""
    state = state or State(u=np.zeros((1, 1)))
    states, cuts = [], []
    march(passes, state, plan, lambda s, _: states.append(s), lambda *cut: cuts.append(cut))
    assert [s.u[0, 0] for s in states] == list(range(1, len(states) + 1))
    return [s.time for s in states], cuts


@pytest.mark.parametrize("steps", (1, 3, 7, 10, 49))
@pytest.mark.parametrize("end", (1.0, 0.3, 7e5, 1e-9))
def test_fixed_steps_are_exact_multiples(steps, end):
    for adaptive in (True, False):
        committed, cuts = times(Passes(), schedule(steps, end, adaptive))
        assert committed == [end * k / steps for k in range(1, steps + 1)]
        assert not cuts


def test_steps_are_coarse_down_to_an_eighth_of_the_nominal_one():
    class Noting(Passes):
        def advance(self, state, time, last, coarse):
            self.sizes.append((time - state.time, coarse))
            return super().advance(state, time, last, coarse)

    passes = Noting(lambda start: start + 0.03)
    passes.sizes = []
    times(passes, schedule(2))
    assert {coarse for size, coarse in passes.sizes if size > 0.0626} == {True}
    assert {coarse for size, coarse in passes.sizes if size < 0.0624} == {False}
    fixed = Noting()
    fixed.sizes = []
    times(fixed, schedule(2, adaptive=False))
    assert [coarse for _, coarse in fixed.sizes] == [False, False]


def test_a_failed_step_is_halved_until_it_is_solved():
    passes = Passes(lambda start: start + 0.03)
    committed, cuts = times(passes, schedule(2))
    assert cuts[0] == (0.0, 0.5, "DIVERGED_MAX_IT")
    assert committed[-1] == 1.0
    assert np.all(np.diff([0.0, *committed]) <= 0.03 + 1e-12)
    assert passes.asked[:6] == [0.5, 0.25, 0.125, 0.0625, 0.03125, 0.015625]
    assert 0.5 in committed, "the nominal times are met"


def test_steps_grow_back_to_the_nominal_size():
    passes = Passes(lambda start: start + (0.03 if start < 0.1 else 1))
    committed, _ = times(passes, schedule(4))
    assert committed[-1] == 1.0
    assert np.diff(committed).max() == pytest.approx(0.25)
    assert {0.25, 0.5, 0.75} <= set(committed)


def test_hard_steps_do_not_grow():
    passes = Passes(lambda start: start + (0.03 if start < 0.01 else 1), iterations=EASY + 1)
    committed, _ = times(passes, schedule(1))
    assert np.diff([0.0, *committed]) == pytest.approx(1 / 64)


def test_easy_steps_grow_beyond_the_nominal_size_where_that_is_allowed():
    committed, _ = times(Passes(), schedule(10, largest=0.4))
    assert committed == pytest.approx([0.1, 0.3, 0.7, 1.0])
    assert committed[-1] == 1.0


def test_no_step_is_smaller_than_the_smallest():
    passes = Passes(lambda start: start)
    reason = r"load step 1,? from t = 0 to 0\.25,? did not converge: DIVERGED_MAX_IT.*min_step"
    with pytest.raises(ConvergenceError, match=reason):
        times(passes, schedule(1, smallest=0.2))
    assert passes.asked == [1.0, 0.5, 0.25]


def test_without_adaptivity_the_first_failure_ends_the_run():
    state, passes, kept = State(u=np.zeros((1, 1))), Passes(lambda start: 0.55), []
    with pytest.raises(ConvergenceError, match=r"load step 6.* to 0\.6,? .*DIVERGED_MAX_IT.*adaptive = true"):
        march(passes, state, schedule(10, adaptive=False), lambda s, _: kept.append(s), lambda *cut: None)
    assert (kept[-1].step, kept[-1].time, kept[-1].u[0, 0]) == (5, 0.5, 5.0)


def test_going_on_from_a_state():
    """With the step size that was intended, a run goes on as if it had not been interrupted."""
    whole = times(Passes(lambda start: start + 0.03), schedule(2))[0]
    for stop in (1, 7, len(whole) - 1):
        states, committed = [State(u=np.zeros((1, 1)))], []
        passes = Passes(lambda start: start + 0.03)

        class Stop(Exception):
            pass

        def commit(state, _, states=states, committed=committed, stop=stop, Stop=Stop):
            states.append(state)
            committed.append(state.time)
            if len(committed) == stop:
                raise Stop

        with pytest.raises(Stop):
            march(passes, states[-1], schedule(2), commit, lambda *cut: None)
        march(passes, states[-1], schedule(2), commit, lambda *cut: None)
        assert committed == whole
