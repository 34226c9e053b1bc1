"""Plates with holes: closed form, the finite elements against it, the stored numbers against both and among themselves.

Tolerances are what was measured, rounded up (docs/theory/references.md, section 7).
"""

import importlib.util
from pathlib import Path

import holes
import numpy as np
import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "references_holes.py"
PLATES = {
    "b = 6 mm": lambda: holes.elliptic_hole(0.006),
    "b = 5 mm": lambda: holes.elliptic_hole(0.005),
    "circle": holes.circular_hole_plate,
}
RATIOS = [0.02, 0.05, 0.1, 0.2]


@pytest.fixture(scope="module")
def elements():
    """The finite elements of scripts/references."""
    spec = importlib.util.spec_from_file_location("references_holes", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(params=PLATES)
def plate(request):
    return PLATES[request.param]()


# ---------------------------------------------------------------- infinite plate


@pytest.mark.parametrize("b", [1.0, 0.5, 0.1])
def test_infinite_plate(b):
    """Free rim, Inglis' 1 + 2 a/b at the tip and -1 on top, the tension far away, Hooke's law by differences of u."""
    t = np.linspace(0, np.pi / 2, 41)
    x, y, normal = np.cos(t), b * np.sin(t), (b * np.cos(t), np.sin(t))
    rim = holes.elliptic_hole_infinite(x, y, 1.0, b)
    assert rim["sxx"] * normal[0] + rim["sxy"] * normal[1] == pytest.approx(0, abs=1e-10)
    assert rim["sxy"] * normal[0] + rim["syy"] * normal[1] == pytest.approx(0, abs=1e-10)
    assert (rim["syy"][0], rim["sxx"][-1]) == pytest.approx((1 + 2 / b, -1), rel=1e-10)
    far = holes.elliptic_hole_infinite(800.0, 600.0, 1.0, b)
    assert (far["sxx"], far["syy"], far["sxy"]) == pytest.approx((0, 1, 0), abs=1e-5)
    x, y, h, nu = 1.1, 0.3, 1e-5, 0.3
    s = holes.elliptic_hole_infinite(x, y, 1.0, b)
    ends = [holes.elliptic_hole_infinite(x + p * h, y + q * h, 1.0, b) for p, q in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    h_xx, h_yx = ((ends[0][k] - ends[1][k]) / (2 * h) for k in ("ux", "uy"))
    h_xy, h_yy = ((ends[2][k] - ends[3][k]) / (2 * h) for k in ("ux", "uy"))
    assert (h_xx, h_yy) == pytest.approx((s["sxx"] - nu * s["syy"], s["syy"] - nu * s["sxx"]), rel=1e-7)
    assert h_xy + h_yx == pytest.approx(2 * (1 + nu) * s["sxy"], rel=1e-7)


@pytest.mark.parametrize("b", [0.05, 0.006, 0.005])
def test_finite_elements_reproduce_the_infinite_plate(elements, b):
    """The plate of seed 000 with Inglis' tractions on its edges (no corner singularity): u 1e-9, stress 2e-6."""
    a, W, E, nu = 0.05, 0.25, 200e9, 0.3
    plate = elements.Plate(a, b, W, W, E, nu, 12)

    def exact(x, y):
        return holes.elliptic_hole_infinite(x, y, a, b, 1e7, E, nu)

    u = plate.solve(outer=lambda x, y: [exact(x, y)[k] for k in ("sxx", "syy", "sxy")])
    x, y = np.r_[np.geomspace(0.05, 0.25, 50), np.linspace(0, 0.25, 20)], np.r_[np.zeros(50), np.full(20, 0.2)]
    found, wanted = plate.at(u, x, y), exact(x, y)
    for k in ("ux", "uy"):
        assert np.abs(found[k] - wanted[k]).max() < 1e-9 * np.abs(wanted[k]).max()
    for k in ("sxx", "syy", "sxy"):
        assert np.abs(found[k] - wanted[k]).max() < 2e-6 * wanted["syy"].max()


# ---------------------------------------------------------------- stored plates


def test_error_estimates(plate):
    """Last two meshes: displacements 1e-7, stresses 1e-5 of their largest value; force through the ligament 1e-9."""
    for line, table in plate.error.items():
        for quantity, error in table.items():
            assert error < (1e-7 if quantity.startswith("u") else 1e-5), (line, quantity)
    assert abs(plate.convergence[-1]["ligament_force_error"]) < 1e-9


def test_equilibrium_of_the_stored_lines(plate):
    """int syy dx over y = 0 is S W, int sxx dy over x = 0 is 0, by quadrature of the interpolated samples: 1e-6."""
    W, S = plate.half_width, plate.S
    s, weight = np.polynomial.legendre.leggauss(12)
    for line, quantity, start, force in (("y0", "syy", plate.a, S * W), ("x0", "sxx", plate.b, 0.0)):
        breaks = start + np.r_[0, np.geomspace(1e-5, W - start, 40)]
        at = breaks[:-1, None] + 0.5 * np.diff(breaks)[:, None] * (1 + s)
        total = (plate.along(line, quantity, at) * weight * 0.5 * np.diff(breaks)[:, None]).sum()
        assert total == pytest.approx(force, abs=1e-6 * S * W)


def test_stored_lines_meet(plate):
    """Boundary conditions, and the lines agree where they cross, to the seven digits stored and the error."""
    S, W, a, b = plate.S, plate.half_width, plate.a, plate.b
    peak = plate.along("y0", "syy", a)
    free = [plate.along("y0", "sxx", v) for v in (a, W)] + [plate.along("x0", "syy", b)]
    assert np.abs(free).max() < 1e-5 * peak
    assert plate.along("x0", "syy", W) == pytest.approx(S, rel=1e-6)
    assert plate.along("rim", "hoop", 0) == pytest.approx(peak, rel=1e-5)
    assert plate.along("rim", "hoop", np.pi / 2) == pytest.approx(plate.along("x0", "sxx", b), rel=1e-5)
    largest = plate.along("top", "uy", 0.0)
    pairs = [
        (plate.along("y0", "ux", a), plate.along("rim", "ux", 0)),
        (plate.along("x0", "uy", b), plate.along("rim", "uy", np.pi / 2)),
        (plate.along("y0", "ux", W), plate.along("right", "ux", 0)),
        (plate.along("x0", "uy", W), largest),
        (plate.along("right", "ux", W), plate.along("top", "ux", W)),
        (plate.along("right", "uy", W), plate.along("top", "uy", W)),
        (plate.along("top", "ux", 0), 0.0),
        (plate.along("right", "uy", 0), 0.0),
    ]
    for one, other in pairs:
        assert one == pytest.approx(other, abs=1e-6 * largest)


def test_symmetry_and_range(plate):
    """Displacements along the line are odd, everything else is even; points in the hole are refused."""
    assert plate.along("y0", "ux", -0.1) == -plate.along("y0", "ux", 0.1)
    assert plate.along("y0", "syy", -0.1) == plate.along("y0", "syy", 0.1)
    assert plate.along("top", "uy", -0.1) == plate.along("top", "uy", 0.1)
    with pytest.raises(ValueError, match="outside the hole"):
        plate.along("y0", "ux", 0.049)


def test_interpolation_between_the_samples(plate, elements):
    """A coarser mesh evaluated between the stored points: u 3e-6 of its largest value, stress 1e-5 of |value| + S."""
    own = elements.Plate(plate.a, plate.b, plate.half_width, plate.half_width, plate.E, plate.nu, 12)
    u = own.solve(outer=elements.uniform(plate.S))
    for line, axis in (("y0", 0), ("x0", 1)):
        at = plate.lines[line]["xy"[axis]]
        at = 0.5 * (at[1:] + at[:-1])
        found = own.at(u, *((at, 0 * at) if axis == 0 else (0 * at, at)))
        for quantity in list(plate.lines[line])[1:]:
            stored = plate.along(line, quantity, at)
            if quantity.startswith("u"):
                assert np.abs(stored - found[quantity]).max() < 3e-6 * np.abs(stored).max()
            else:
                assert np.all(np.abs(stored - found[quantity]) < 1e-5 * (np.abs(stored) + plate.S)), (line, quantity)


def test_grid_agrees_with_the_lines(plate):
    """The coarse grid is rounded to 1e-5 of the largest value and empty in the hole."""
    x, y, tables = plate.grid()
    for quantity, line in (("ux", "y0"), ("syy", "y0"), ("uy", "x0"), ("syy", "x0")):
        s, start, values = (x, plate.a, tables[quantity][0]) if line == "y0" else (y, plate.b, tables[quantity][:, 0])
        out = s >= start
        assert np.isnan(values[~out]).all()
        assert values[out] == pytest.approx(
            plate.along(line, quantity, s[out]), abs=1e-5 * np.nanmax(np.abs(tables[quantity]))
        )


# ---------------------------------------------------------------- stress concentrations


@pytest.mark.parametrize(("b", "peak"), [(0.006, 18.75279), (0.005, 22.26896)])
def test_elliptic_peak(b, peak):
    """1 + 2 a/b of the infinite plate, times a finite-plate factor that falls with b: between that of a crack in a long
    strip, sqrt(sec(pi a/(2 W))) = 1.0254 (Feddersen), and that of the circle in the same square, 1.12."""
    plate = holes.elliptic_hole(b)
    assert plate.along("y0", "syy", 0.05) / plate.S == pytest.approx(peak, rel=1e-6)
    factor = peak / (1 + 2 * 0.05 / b)
    assert np.cos(0.1 * np.pi) ** -0.5 < factor < holes.kirsch_plate(0.2)["gross"] / 3


def test_kirsch_limit():
    """gross = 3 + c (a/W)^2 + ...: extrapolated from a/W = 0.02 and 0.05 it is 3 to 2e-5, the lowest stress -1."""
    small, large = holes.kirsch_plate(0.02), holes.kirsch_plate(0.05)
    for key, value in (("gross", 3.0), ("lowest", -1.0)):
        slope = (large[key] - small[key]) / (0.05**2 - 0.02**2)
        assert small[key] - slope * 0.02**2 == pytest.approx(value, abs=2e-5)


def test_kirsch_field_at_a_small_hole():
    """a/W = 0.02 against the infinite plate within three radii: stress 4e-3 S, displacement of the rim 0.3 %."""
    small = holes.kirsch_plate(0.02)
    near = small["x_over_a"] < 3
    exact = holes.elliptic_hole_infinite(small["x_over_a"][near], 0.0, 1.0, 1.0)
    assert small["syy_y0"][near] == pytest.approx(exact["syy"], abs=4e-3)
    assert small["sxx_y0"][near] == pytest.approx(exact["sxx"], abs=4e-3)
    assert small["ux_rim"] @ (1, 0.3) == pytest.approx(-1.0, rel=3e-3)
    assert small["uy_rim"] @ (1, 0.3) == pytest.approx(3.0, rel=3e-3)


@pytest.mark.parametrize("ratio", RATIOS)
def test_kirsch_numbers_are_converged(ratio):
    table = holes.kirsch_plate(ratio)
    assert max(table["error"].values()) < 1e-7
    assert abs(table["ligament_force_error"]) < 1e-9
    assert table["net"] == pytest.approx(table["gross"] * (1 - ratio), rel=1e-6)


@pytest.mark.parametrize("ratio", RATIOS)
def test_pressurised_hole_lies_between_two_rings(ratio):
    """Lame's rings in the square's inscribed and circumscribed circle: hoop stress at the rim, its displacement."""
    table, nu = holes.kirsch_plate(ratio), 0.3

    def ring(r):  # r: (inner/outer radius)^2
        return (1 + r) / (1 - r), ((1 - nu) * r + 1 + nu) / (1 - r)

    (hoop, u), (hoop_out, u_out) = ring(ratio**2), ring(0.5 * ratio**2)
    assert np.all((table["pressure_hoop"] < hoop) & (table["pressure_hoop"] > hoop_out))
    for value in (table["pressure_ux_rim"] @ (1, nu), np.sqrt(2) * table["pressure_ux_rim_45"] @ (1, nu)):
        assert u_out < value < u


def test_circular_plate_is_the_square_of_the_same_ratio():
    """Other units and another Poisson's ratio than the Kirsch table's: 1e-6."""
    plate, table = holes.circular_hole_plate(), holes.kirsch_plate(0.2)
    assert plate.along("y0", "syy", 0.05) / plate.S == pytest.approx(table["gross"], rel=1e-6)
    scale = plate.S * plate.a / plate.E
    for key, line, quantity, at in (
        ("ux_rim", "y0", "ux", 0.05),
        ("uy_rim", "x0", "uy", 0.05),
        ("ux_edge", "y0", "ux", 0.25),
        ("uy_edge", "x0", "uy", 0.25),
    ):
        assert plate.along(line, quantity, at) == pytest.approx(scale * table[key] @ (1, plate.nu), rel=1e-6)


def test_strip_against_the_literature():
    """Howland (1930): 3.03, 3.14, 3.36, 3.74, 4.32 within 0.7 %; Heywood's formula within 2.5 %."""
    ratio, gross = holes.strip_concentration()
    assert ratio == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert gross == pytest.approx([3.03, 3.14, 3.36, 3.74, 4.32], rel=7e-3)
    assert gross == pytest.approx(holes.heywood(ratio), rel=2.5e-2)
