"""scripts/bench comes to results of the right form, with bodies of a few hundred particles; nothing about times."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import conftest
import pytest

BENCH = Path(__file__).parents[2] / "scripts" / "bench"
NAMES = ("explicit_lps", "explicit_bond", "implicit_24k", "correspondence_2d", "growth")
KEYS = "name ranks particles bonds seconds ns_per_bond peak_memory_mb iterations peer peer_ns_per_bond ratio".split()


def bench(*arguments) -> subprocess.CompletedProcess:
    environment = conftest.environment_for_mpirun() | {"PDPETSC_PYTHON": sys.executable, "PETSC_OPTIONS": ""}
    return subprocess.run(
        [BENCH, *map(str, arguments)], env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=150,
    )  # fmt: skip


def numbers(value) -> list[float]:
    """All numbers in a part of the JSON."""
    if isinstance(value, dict | list):
        return [n for part in (value.values() if isinstance(value, dict) else value) for n in numbers(part)]
    return [value] if isinstance(value, int | float) else []


@pytest.mark.slow
def test_small_bodies(tmp_path):
    file = tmp_path / "small.json"
    run = bench(*NAMES, "--scale", 0.05, "--no-peer", "--json", file)
    assert run.returncode == 0, run.stdout + run.stderr
    written = json.loads(file.read_text())
    machine, results = written["machine"], {r["name"]: r for r in written["results"]}
    assert machine["cores"] == os.cpu_count()
    assert min(machine["bandwidth_gb_per_second"].values()) > 0
    assert {*NAMES[:-1], "correspondence_2d_assembled"} <= set(results)
    assert sum(name.startswith("growth_") for name in results) > 1
    for name, result in results.items():
        assert set(KEYS) <= set(result)
        assert all(math.isfinite(n) and n >= 0 for n in numbers(result)), name
        assert min(result[key] for key in KEYS[1:7]) > 0, name
        assert (result["iterations"] is None) == name.startswith("explicit"), name
        assert result["peer"] is None and result["ratio"] is None
        assert name in run.stdout


def test_an_unknown_name_is_an_error():
    run = bench("explicit", "--no-peer")
    assert run.returncode == 2 and "unknown name explicit" in run.stderr
