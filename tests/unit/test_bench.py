"""scripts/bench comes to results of the right form, with bodies of a few hundred particles; nothing about times."""

import json
import math
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import conftest
import pytest

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "scripts" / "bench"
NAMES = ("explicit_lps", "explicit_bond", "implicit_24k", "correspondence_2d", "kernels", "growth")
OPERATIONS = {
    "forces", "preparing the tangent", "action", "diagonal blocks", "gather alone", "scatter alone", "rows",
}  # fmt: skip
KEYS = "name ranks particles bonds seconds ns_per_bond peak_memory_mb iterations peer peer_ns_per_bond ratio".split()


def bench(*arguments) -> subprocess.CompletedProcess:
    environment = conftest.environment_for_mpirun() | {"PDPETSC_PYTHON": sys.executable, "PETSC_OPTIONS": ""}
    return subprocess.run(
        [BENCH, *map(str, arguments)], env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=400,
    )  # fmt: skip


def numbers(value) -> list[float]:
    """All numbers in a part of the JSON."""
    if isinstance(value, dict | list):
        return [n for part in (value.values() if isinstance(value, dict) else value) for n in numbers(part)]
    return [value] if isinstance(value, int | float) else []


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> tuple[Path, str]:
    """The JSON of a run with bodies of a few hundred particles, and what it printed."""
    file = tmp_path_factory.mktemp("bench") / "small.json"
    run = bench(*NAMES, "--scale", 0.05, "--no-peer", "--json", file)
    assert run.returncode == 0, run.stdout + run.stderr
    return file, run.stdout


@pytest.mark.slow
def test_small_bodies(small):
    file, printed = small
    written = json.loads(file.read_text())
    machine, results = written["machine"], {r["name"]: r for r in written["results"]}
    assert machine["cores"] == os.cpu_count()
    assert min(numbers([machine["bandwidth_gb_per_second"], machine["gflops"]])) > 0
    assert {*NAMES[:-2], "correspondence_2d_assembled"} <= set(results)
    assert sum(name.startswith("growth_") for name in results) > 1
    for name, result in results.items():
        assert set(KEYS) <= set(result)
        assert all(math.isfinite(n) and n >= 0 for n in numbers(result)), name
        assert min(result[key] for key in KEYS[1:7]) > 0, name
        assert (result["iterations"] is None) == name.startswith(("explicit", "kernels")), name
        assert result["peer"] is None and result["ratio"] is None
        assert name in printed


@pytest.mark.slow
def test_kernels_have_a_limit(small):
    results = [r for r in json.loads(small[0].read_text())["results"] if r["name"].startswith("kernels")]
    assert {(r["model"], r["dim"]) for r in results} == {
        (model, dim) for model in ("bond", "ordinary", "correspondence") for dim in (2, 3)
    }
    for result in results:
        assert set(result["operations"]) == OPERATIONS
        for name, operation in result["operations"].items():
            assert operation["ns"] > 0 and operation["bytes"] > 0 and operation["flops"] > 0
            assert operation["slow_flops"] <= operation["flops"]
            limit = max(operation["memory_ns"], operation["flops_ns"])
            assert operation["percent_of_limit"] == pytest.approx(100 * limit / operation["ns"]), name


@pytest.mark.slow
def test_docs_are_filled(small, tmp_path):
    page = tmp_path / "performance.md"
    shutil.copy(ROOT / "docs" / "performance.md", page)
    run = bench("--docs", small[0], "--folder", tmp_path)
    assert run.returncode == 0, run.stdout + run.stderr
    text = page.read_text()
    assert "bench_parallel: left as it is" in run.stdout and "bench_kernels: filled" in run.stdout
    assert "scaled by 0.05" in text and "| % of the limit |" in text
    assert (tmp_path / "pictures" / "growth.png").stat().st_size > 1000
    tables = [line for line in text.splitlines() if line.startswith("| ")]
    assert not any(word in line for line in tables for word in ("nan", "None", "inf |"))
    for above, line in pairwise(text.splitlines()):
        assert above.count("|") == line.count("|") or not (above.startswith("| ") and line.startswith("| ")), line


def test_an_unknown_name_is_an_error():
    run = bench("explicit", "--no-peer")
    assert run.returncode == 2 and "unknown name explicit" in run.stderr
