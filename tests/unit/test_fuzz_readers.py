"""Readers of what strangers may send: whatever they are fed, they read it or say in a sentence why not.

The same inputs in every run; scripts/fuzz looks for new ones.
"""

import pytest
from fuzzing import DATA, READERS, forget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

EXAMPLES = {"prediction": 30, "mesh": 150, "checkpoint": 100, "fields": 100}
"""Where fewer than 200 will do, for the time that they take."""


@pytest.fixture(scope="module", autouse=True)
def no_files_are_left():
    yield
    forget()


@pytest.mark.parametrize("name", READERS)
def test_it_is_read_or_refused(name):
    @settings(
        max_examples=EXAMPLES.get(name, 200), derandomize=True, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(READERS[name].inputs())
    def run(content):
        assert READERS[name].outcome(content) in ("read", "refused", "ended")

    run()


@pytest.mark.parametrize("name", READERS)
def test_any_bytes_are_refused_or_read(name):
    @settings(max_examples=25, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.binary(max_size=200))
    def run(content):
        assert READERS[name].outcome(content) in ("read", "refused", "ended")

    run()


FOUND = sorted(path for path in DATA.glob("*/*") if path.is_file())


@pytest.mark.parametrize("path", FOUND, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_once_failed_does_no_more(path):
    READERS[path.parent.name].outcome(path.read_bytes())
