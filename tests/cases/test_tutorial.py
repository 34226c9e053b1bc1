"""The tutorial's case file, put together from the blocks of its page, does what the page says."""

import re
from itertools import pairwise
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text()
BLOCKS = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
COARSE = ["--set", "body.spacing=4.0"]

pytestmark = pytest.mark.mpi


@pytest.fixture
def sheet(comm, shared_tmp_path, run):
    """`sheet(variant, *arguments)` runs the file, or a variant of it."""
    if comm.rank == 0:
        (shared_tmp_path / "sheet.toml").write_text("\n".join(BLOCKS))
    return lambda variant, *arguments: run(f"sheet.toml{variant}", *arguments)


@pytest.mark.parametrize("variant, particles", [("", 1360), (":fine", 2806)])
def test_the_elastic_sheet_gives_the_numbers_of_the_page(sheet, variant, particles):
    summary = sheet(variant, "--set", "solver.steps=1").summary
    printed = re.search(rf"\$ pdpetsc sheet.toml{variant}\n.*?load = (\S+)\npull = (\S+)\npeak = (\S+)\n", PAGE, re.S)
    found = [summary["probes"][name] for name in ("load", "pull", "peak")]
    assert found == pytest.approx([float(number) for number in printed.groups()], rel=1e-5)
    assert summary["particles"] == particles and f"\n{particles} particles" in PAGE


def test_another_model_is_one_word_and_bonds_want_their_own_ratio(sheet):
    other = sheet("", *COARSE, "--set", "material.acrylic.model=correspondence")
    assert other.code == 0 and other.summary["converged"]
    wrong = sheet("", *COARSE, "--set", "material.acrylic.model=bond")
    assert wrong.code == 2


def test_bonds_fail_at_the_rim(sheet):
    summary = sheet(":tearing", *COARSE, "--set", "solver.end_time=0.6", "--set", "solver.steps=4").summary
    assert summary["converged"] and summary["fracture"]["broken_bonds"] > 0


def test_events_go_back_and_forth(sheet):
    summary = sheet(":events", *COARSE, "--set", "solver.max_steps=6").summary
    times = [step["time"] for step in summary["steps"]]
    assert summary["fracture"]["broken_bonds"] > 0
    assert min(after - before for before, after in pairwise(times)) < 0
