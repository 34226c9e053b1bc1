"""The references of the verification cases against each other and against the stored finite-element numbers.

Tolerances are what was measured, rounded up; docs/theory/references.md says where each difference comes from.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import references as ref
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

DATA = Path(__file__).parent / "data"
FULL_LOAD = 276e3


def stored(name):
    """Content of data/<name>.json."""
    return json.loads((DATA / f"{name}.json").read_text())


# ---------------------------------------------------------------- strips


def test_clamped_strip_value():
    """Seed 004 5.2.2: w0/d = 0.5861 at 276 kPa."""
    assert ref.clamped_strip(FULL_LOAD) == pytest.approx(0.5861, abs=5e-5)


@pytest.mark.parametrize(("ends", "factor"), [("clamped", 1 / 32), ("pinned", 5 / 32)])
def test_strip_linear_limit(ends, factor):
    """Small loads: w0 = p L^4/(384 D) clamped, 5 p L^4/(384 D) pinned."""
    s = ref.STRIP
    q = 1e-3 * s["length"] ** 4 / (ref.plane_strain_modulus(s["E"], s["nu"]) * s["depth"] ** 4)
    assert ref.von_karman_strip(1e-3, ends, **s).w0_over_d == pytest.approx(factor * q, rel=1e-9)


@pytest.mark.parametrize("ends", ["clamped", "pinned"])
@pytest.mark.parametrize("p", [1e3, 27.6e3, FULL_LOAD, 5e6])
def test_strip_satisfies_its_equations(ends, p):
    """Compatibility N L/(E'd) = int w'^2/2 dx, end conditions and D w'''' - N w'' = p, by differentiating w."""
    s = ref.STRIP
    strip = ref.von_karman_strip(p, ends, **s)
    modulus, L = ref.plane_strain_modulus(s["E"], s["nu"]), s["length"]
    x = 0.5 * L * (np.polynomial.chebyshev.chebpts1(32) + 1)
    w = np.polynomial.Chebyshev.fit(x, strip.deflection(x), 31, domain=[0, L])
    stretch = (w.deriv() ** 2).integ()
    assert 0.5 * (stretch(L) - stretch(0)) == pytest.approx(strip.membrane_force * L / (modulus * s["depth"]), rel=1e-8)
    assert abs(w(0)) < 1e-10 * strip.w0
    assert strip.deflection(L / 2) == pytest.approx(strip.w0, rel=1e-12)
    slope_or_curvature = w.deriv()(0) * L if ends == "clamped" else w.deriv(2)(0) * L**2
    assert abs(slope_or_curvature) < 1e-6 * strip.w0
    inner = np.linspace(0.2, 0.8, 7) * L
    balance = modulus * s["depth"] ** 3 / 12 * w.deriv(4)(inner) - strip.membrane_force * w.deriv(2)(inner)
    assert balance == pytest.approx(p, rel=1e-4)


@pytest.mark.parametrize("ends", ["clamped", "pinned"])
def test_shortening_integral_branches_meet(ends):
    """Closed form (a > 2) and quadrature of the series (a <= 2) agree where they meet."""
    ahead, behind = ref.shortening_integral(2 * (1 + 1e-12), ends), ref.shortening_integral(2.0, ends)
    assert ahead == pytest.approx(behind, rel=1e-10)


@pytest.mark.parametrize("ends", ["clamped", "pinned"])
def test_exact_strip_without_shear_is_von_karman(ends):
    """Slopes are below 0.06 here: moderate and finite rotations differ by 6e-4 at most at 276 kPa."""
    for p in (27.6e3, FULL_LOAD):
        exact = ref.exact_strip(p, ends, shear_factor=np.inf)
        assert exact == pytest.approx(ref.von_karman_strip(p, ends, **ref.STRIP).w0_over_d, rel=6e-4)


@pytest.mark.parametrize("ends", ["clamped", "pinned"])
def test_strip_against_finite_elements(ends):
    """Beam with the Hencky section law, pressure on the upper face: 1e-4.  Von Karman: 0.7 % clamped, 0.25 % pinned."""
    fe = stored(f"{ends}_strip")
    closed = {"clamped": (ref.clamped_strip, 7e-3), "pinned": (ref.pinned_strip, 2.5e-3)}[ends]
    for p, w in zip(fe["pressure_Pa"], fe["w0_over_d"], strict=True):
        beam = ref.exact_strip(p, ends, section="hencky", load_height=0.5 * ref.STRIP["depth"])
        assert w == pytest.approx(beam, rel=1e-4)
        assert w == pytest.approx(closed[0](p), rel=closed[1])


# ---------------------------------------------------------------- cantilever


@pytest.mark.parametrize("load", [10e3, 50e3, 100e3])
def test_elastica(load):
    """Elliptic integrals against solve_bvp without stretch and shear."""
    beam = ref.cantilever_beam(load, stretch=False, shear_factor=np.inf)
    assert (-beam.horizontal, beam.vertical) == pytest.approx(ref.elastica_tip(load), abs=1e-8)


@pytest.mark.parametrize("nu", [0.0, 0.2, 0.33])
def test_hencky_pure_bending_small_curvature(nu):
    """`M/D = kappa (1 - (1 + n)(3 - n)/10 (kappa d)^2)`, mid-height strain `(1 + n)(kappa d)^2/8`, n = nu/(1 - nu)."""
    n = nu / (1.0 - nu)
    moment, strain = ref.hencky_pure_bending(1e-2, nu)
    assert moment * 12e2 - 1.0 == pytest.approx(-(1 + n) * (3 - n) / 10 * 1e-4, rel=1e-3)
    assert strain == pytest.approx((1 + n) / 8 * 1e-4, rel=1e-4)


def test_hencky_pure_bending_is_collocation_converged():
    """The polynomial degree across the depth does not matter."""
    assert ref.hencky_pure_bending(0.8, 0.2, 12) == pytest.approx(ref.hencky_pure_bending(0.8, 0.2, 20), rel=1e-5)
    assert ref.hencky_pure_bending(0.4, 0.2, 16) == pytest.approx(ref.hencky_pure_bending(0.4, 0.2, 20), rel=1e-9)


def test_section_law_reproduces_its_table():
    """Fitted polynomials against pure bending between the sampled curvatures."""
    bend, strain, _ = ref.hencky_section(0.2)
    for curvature in (0.02, 0.33, 0.77):
        moment, middle = ref.hencky_pure_bending(curvature, 0.2)
        assert bend(moment) == pytest.approx(curvature, rel=1e-6)
        assert strain(moment) == pytest.approx(middle, rel=1e-6)


def test_cantilever_against_finite_elements():
    """Tip: 1e-4 L with the Hencky section law, 1e-2 L with the linear one, 2.1e-2 L for the elastica."""
    fe = stored("cantilever")
    for load, u_x, u_y in zip(fe["load_N"], fe["tip"]["ux_over_L"], fe["tip"]["uy_over_L"], strict=True):
        hencky = ref.cantilever_beam(load, section="hencky")
        assert (u_x, -u_y) == pytest.approx((hencky.horizontal, hencky.vertical), abs=1e-4)
        linear = ref.cantilever_beam(load)
        assert (u_x, -u_y) == pytest.approx((linear.horizontal, linear.vertical), abs=1e-2)
        elastica = ref.elastica_tip(load)
        assert (-u_x, -u_y) == pytest.approx(elastica, abs=2.1e-2)


@pytest.mark.parametrize("load", ["10kN", "100kN"])
def test_cantilever_midline(load):
    """The whole midline: 3e-4 L, most of it at the root, where u_y is held in the mean and the middle moves."""
    fe = stored("cantilever")["midline"]
    u_x, u_y = ref.cantilever_beam(float(load[:-2]) * 1e3, section="hencky").displacement(fe["x"])
    assert np.abs(fe[load]["ux"] - u_x).max() < 3e-3
    assert np.abs(fe[load]["uy"] + u_y).max() < 3e-3


def test_cantilever_loaded_over_the_last_column():
    """Body force in 9.8 < x < 10: 1.5e-4 L, and 1e-3 to 4e-3 L less than with the load on the end face."""
    fe = stored("cantilever")
    other = fe["alternatives"]["load as body force in 9.8 < x < 10"]["tip"]
    for i, load in enumerate(fe["load_N"]):
        beam = ref.cantilever_beam(load, section="hencky", loaded_from=9.8)
        assert (other["ux_over_L"][i], -other["uy_over_L"][i]) == pytest.approx(
            (beam.horizontal, beam.vertical), abs=1.5e-4
        )


# ---------------------------------------------------------------- stored numbers


@pytest.mark.parametrize("name", ["clamped_strip", "pinned_strip", "cantilever"])
def test_finite_elements_are_mesh_converged(name):
    """The two finest meshes agree to 1e-5."""
    coarse, fine = stored(name)["how"]["convergence"][-2:]
    for key in set(fine) - {"mesh"}:
        assert coarse[key] == pytest.approx(fine[key], rel=1e-5)


# ---------------------------------------------------------------- plate in tension


def test_hencky_uniaxial():
    """P = E' ln(l)/l and, by the full Hencky law, no lateral stress."""
    E, nu, nominal = 200e9, 0.33, np.array([-1e10, 4e8, 5e10])
    stretch, lateral = ref.hencky_uniaxial(nominal, E, nu)
    e_x, e_y = np.log(stretch), np.log(lateral)
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    assert (lam * (e_x + e_y) + 2 * mu * e_x) / stretch == pytest.approx(nominal, rel=1e-12)
    assert lam * (e_x + e_y) + 2 * mu * e_y == pytest.approx(0.0, abs=1e-3)
    with pytest.raises(ValueError, match="no equilibrium"):
        ref.hencky_uniaxial(0.5 * E, E, nu)


@pytest.mark.parametrize("dx", [0.02, 0.01])
def test_tension_integrates_its_strain(dx):
    """u_x by quadrature of the stretch, u_y by the lateral one, at finite and at small strain."""
    b, E, nu = (ref.PLATE[k] for k in ("b", "E", "nu"))
    for X in (0.3, 0.5 - 0.4 * dx, -0.5):

        def nominal(x):
            return b * min(dx, 0.5 - abs(x))

        inner = np.sign(X) * (0.5 - dx)
        exact = quad(lambda x: ref.hencky_uniaxial(nominal(x), E, nu)[0] - 1, 0, X, points=[inner], epsabs=1e-15)[0]
        small = quad(lambda x: nominal(x) * (1 - nu**2) / E, 0, X, points=[inner], epsabs=1e-15)[0]
        assert ref.tension_hencky(X, 0.0, dx)[0] == pytest.approx(exact, rel=1e-9)
        assert ref.tension_small_strain(X, 0.0, dx)[0] == pytest.approx(small, rel=1e-9)
    u_y = ref.tension_hencky(0.1, 0.25, dx)[1], ref.tension_small_strain(0.1, 0.25, dx)[1]
    assert u_y[0] == pytest.approx(0.25 * (ref.hencky_uniaxial(b * dx, E, nu)[1] - 1), rel=1e-12)
    assert u_y[0] == pytest.approx(u_y[1], rel=2e-3)


@pytest.mark.parametrize("dx", [0.02, 0.01])
@pytest.mark.parametrize("theory", ["small_strain", "hencky"])
def test_tension_against_finite_elements(dx, theory):
    """Two-dimensional effects of the layers: 0.32 dx/m of the largest u_x, 0.22 dx/m of u_y (docs, section 4)."""
    fe = stored("tension_plate")
    table = fe["solutions"][f"dx={dx:g}"][theory]
    formula = {"small_strain": ref.tension_small_strain, "hencky": ref.tension_hencky}[theory]
    u_x, u_y = formula(fe["x"], 0.0, dx)[0], formula(0.0, fe["y"], dx)[1]
    assert np.abs(table["ux_y0"] - u_x).max() < 0.32 * dx * u_x.max()
    assert np.abs(table["uy_x0"] - u_y).max() < 0.22 * dx * np.abs(u_y).max()


# Arch


def turning(drops, forces):
    """The largest and the smallest force between the ends of the curve."""
    curve = CubicSpline(drops, forces)
    return curve(curve.derivative().roots(extrapolate=False))


def test_arch_against_the_theory_of_shallow_ones():
    """The beam and the closed form share no equation; with a quarter of the rise and depth they agree to 0.3 %."""
    small = ref.ARCH | {"rise": 0.8, "depth": 0.5}
    drops = np.linspace(0.02, 2.2, 80)
    forces = ref.clamped_arch(drops, width=0.01, **small)
    points = np.array([pair for k in np.linspace(0.05, 9.4, 2000) for pair in ref.shallow_arch(k, **small)])
    points = points[(points[:, 0] > drops[0]) & (points[:, 0] < drops[-1])]
    assert len(points) > 1000
    curve = CubicSpline(drops, forces)
    assert np.abs(curve(points[:, 0]) - points[:, 1]).max() < 1e-3 * forces.max()
    order = points[np.argsort(points[:, 0])]
    theory = order[np.flatnonzero(np.diff(np.sign(np.diff(order[:, 1])))) + 1, 1]
    assert turning(drops, forces) == pytest.approx(theory, rel=3e-3)


def test_arch_of_the_case():
    """Limit loads that the case expects. Shallow theory, without shear, is 3 % and 5 % higher."""
    drops = np.linspace(0.05, 7.2, 120)
    forces = ref.clamped_arch(drops, **ref.ARCH)
    assert turning(drops, forces) == pytest.approx([44.663, 26.682], rel=1e-4)
    assert CubicSpline(drops, forces).solve(100.0, extrapolate=False) == pytest.approx([6.983], rel=1e-4)
    pairs = [(*pair, k) for k in np.linspace(0.05, 9.4, 2000) for pair in ref.shallow_arch(k, **ref.ARCH)]
    points = np.array([point for point in pairs if 0.05 < point[0] < 9.0])
    order = points[np.argsort(points[:, 0])]
    theory = order[np.flatnonzero(np.diff(np.sign(np.diff(order[:, 1])))) + 1, 1]
    assert theory == pytest.approx([45.91, 27.92], rel=1e-3)
    assert points[:, 2].max() < 4.49  # tan k = k: from there on it would buckle sideways


def test_parameters_agree():
    """The finite-element script states its own parameters; they are those of the closed forms."""
    pairs = {
        "clamped_strip": ref.STRIP,
        "pinned_strip": ref.STRIP,
        "cantilever": ref.CANTILEVER,
        "tension_plate": ref.PLATE,
    }
    for name, parameters in pairs.items():
        assert stored(name)["parameters"] == parameters
