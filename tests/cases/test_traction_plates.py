"""Rates of convergence of plates with tractions and holes, and the example of the page on results."""

import json
import re
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest

pytestmark = pytest.mark.mpi

TESTS = Path(__file__).parents[1]
SQUARE = json.loads((TESTS / "verification" / "data" / "kirsch_plate.json").read_text())["squares"]["a/W=0.2"]


def test_tension_is_of_first_order(run):
    """Largest error of u_y on the loaded edge, at its middle, and u over the whole plate: exact q/E Y, -nu q/E X."""
    errors = []
    for spacing in (0.05, 0.025, 0.0125):
        result = run("plate_tension_traction", "--set", f"body.spacing={spacing}", "--set", f"body.thickness={spacing}")
        probes = result.summary["probes"]
        errors.append([abs(probes["uy_middle"][-1] / 2.5e-4 - 1), probes["error_x"], probes["error_y"]])
        assert max(result.summary["balance"].values()) < 1e-12
    edge, *whole = np.log2(np.divide(errors[:-1], errors[1:])).T
    assert np.all(np.abs(edge - 1) < 0.05)  # 1.02, 1.00
    assert np.all(np.array(whole) > 0.9)


def test_stress_concentration(run):
    """Kirsch's c0 + c2/r^2 + c4/r^4, fitted from one horizon to one horizon and a radius off the rim."""
    errors, rim = [], []
    for spacing in (0.2, 0.1, 0.05):
        result = run("circular_hole", "--set", f"body.spacing={spacing}", "--set", "material.sheet.model=ordinary")
        with h5py.File(result.out / "fields.h5", "r") as file:
            X, stress = file["position"][:], file["00001/stress"][:, 4]
        depth = X[:, 0] - 1 - 3.015 * spacing
        on = (np.abs(X[:, 1]) < 1e-9) & (depth > 0) & (depth < 1)
        fit = np.linalg.lstsq(X[on, :1] ** np.array([0, -2, -4]), stress[on], rcond=None)[0].sum()
        errors.append(abs(fit / SQUARE["gross"] - 1))
        rim.append(1 - result.summary["probes"]["concentration"] / SQUARE["gross"])
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 0.9)  # 0.93, 0.95
    assert errors[-1] < 0.035  # 3.3 %
    assert rim[0] > rim[1] > rim[2] > 0  # a family's mean, from below


def test_hole_under_pressure(run):
    """The page says 0.6 %, 0.1 % and 1.4 %."""
    page = (TESTS.parent / "docs" / "results.md").read_text()
    text = re.search(r"```toml\n(title = \"Hole under pressure.*?)```", page, re.DOTALL)[1]
    assert len(text.splitlines()) < 40
    result = run(tomllib.loads(text), petsc={"snes_rtol": 1e-13})  # balance is as good as the solution
    assert result.code == 0
    probes = result.summary["probes"]
    opening = (SQUARE["pressure_ux_rim"][0] + 0.3 * SQUARE["pressure_ux_rim"][1]) * 100 * 10 / 210e3
    assert probes["hoop"] == pytest.approx(100 * SQUARE["pressure_hoop"][0], rel=0.007)
    assert probes["opening"] == pytest.approx(opening, rel=0.002)
    assert probes["ligament"] == pytest.approx(1000.0, rel=0.014)
    assert max(result.summary["balance"].values()) < 1e-12
