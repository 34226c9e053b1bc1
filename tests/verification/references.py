"""Reference solutions that owe nothing to peridynamics: closed forms and ordinary differential equations.

All problems are plane strain with thickness 1 m and Hencky hyperelasticity (`tau = lambda tr(e) I + 2 mu e`,
`e = 1/2 ln(F F^T)`), SI units, dead loads.  Theory: `docs/theory/references.md`; finite-element companions:
`scripts/references` and `data/*.json`.  Forces and moments are per metre of thickness.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc, lambertw

STRIP = {"length": 0.254, "depth": 5.08e-3, "E": 68.95e9, "nu": 0.25}  # seed 004 5.2.2 and 5.2.3
CANTILEVER = {"length": 10.0, "depth": 1.0, "E": 12e6, "nu": 0.2}  # seed 004 4.4.2 and 5.2.4
PLATE = {"length": 1.0, "height": 0.5, "E": 200e9, "nu": 0.33, "b": 2e10}  # seed 004 4.3.2


def plane_strain_modulus(E, nu):
    """E' = E / (1 - nu^2) [Pa]: the axial modulus in plane strain with free lateral faces."""
    return E / (1.0 - nu**2)


# ---------------------------------------------------------------- section of a Hencky strip


def hencky_uniaxial(nominal_stress, E, nu):
    """Stretches of a Hencky solid in plane-strain tension with free lateral faces, exact at finite strain.

    `tau_yy = 0` gives `e_y = -nu/(1-nu) e_x`, `tau_xx = E' e_x`, `P_xx = E' ln(l)/l`: `l = exp(-W(-P/E'))` with
    Lambert's W (largest nominal stress E'/e, at l = e), `l_y = l^(-nu/(1-nu))`.

    Returns:
        (l_x, l_y) [-].
    """
    ratio = np.asarray(nominal_stress, float) / plane_strain_modulus(E, nu)
    if np.any(ratio > np.exp(-1.0)):
        raise ValueError("no equilibrium: the nominal stress exceeds E'/e")
    log_stretch = -np.real(lambertw(-ratio))
    return np.exp(log_stretch), np.exp(-nu / (1.0 - nu) * log_stretch)


def hencky_pure_bending(curvature, nu, collocation=16):
    """Exact plane-strain bending of a Hencky strip of unit depth to the curvature kappa, without axial force.

    Sections stay plane: hoop stretch `kappa r(Y)`, radial stretch `r'(Y)`, so `P_r = tau_r/r'`,
    `P_h = tau_h/(kappa r)`, equilibrium `dP_r/dY = kappa P_h`, free faces `P_r(+-1/2) = 0` (which makes the axial
    force vanish).  Solved by Chebyshev collocation and Newton with a complex-step Jacobian.

    Args:
        curvature: kappa d [-]: angle between end sections per undeformed length, times the depth.
        nu: Poisson's ratio.
        collocation: polynomial degree across the depth.

    Returns:
        (moment / (E' d^2), stretch of the mid-height fibre minus one), both [-].
    """
    n = collocation
    i = np.arange(n + 1)
    y = np.cos(np.pi * i / n)  # 1 ... -1, on depth 1: Y = y/2
    c = np.where((i == 0) | (i == n), 2.0, 1.0) * (-1.0) ** i
    gap = y[:, None] - y[None, :] + np.eye(n + 1)
    derivative = np.outer(c, 1.0 / c) / gap
    derivative -= np.diag(derivative.sum(axis=1))
    derivative *= 2.0
    first, second = (1 - nu) ** 2 / (1 - 2 * nu), nu * (1 - nu) / (1 - 2 * nu)  # (lambda + 2 mu)/E', lambda/E'

    def stresses(radius):
        # radius = 1/kappa + v(Y): the unknown is v, so that small curvatures do not cancel
        hoop, radial = 1.0 + curvature * radius, derivative @ radius
        p_r = (first * np.log(radial) + second * np.log(hoop)) / radial
        p_h = (first * np.log(hoop) + second * np.log(radial)) / hoop
        return p_r, p_h

    def residual(radius):
        p_r, p_h = stresses(radius)
        out = derivative @ p_r - curvature * p_h
        out[0], out[-1] = p_r[0], p_r[-1]
        return out

    v = 0.5 * y.astype(float)
    for _ in range(30):
        r = residual(v)
        jacobian = np.array([residual(v + 1e-30j * e).imag for e in np.eye(n + 1)]).T / 1e-30
        step = np.linalg.solve(jacobian, r)
        v = v - step
        if np.abs(step).max() < 1e-13:
            break
    else:
        raise RuntimeError(f"pure bending at kappa d = {curvature} did not converge")
    _, p_h = stresses(v)
    fit = np.polynomial.chebyshev.chebfit(y, np.column_stack((p_h * v, v)), n)
    k = np.arange(0, n + 1, 2)
    moment = float(np.sum(fit[::2, 0] * 2.0 / (1.0 - k**2)) / 2.0)  # int over Y of P_h (r - 1/kappa)
    middle = float(np.polynomial.chebyshev.chebval(0.0, fit[:, 1]))
    return moment, curvature * middle


@lru_cache(maxsize=8)
def hencky_section(nu, largest=0.9):
    """Polynomial section law of a Hencky strip of unit depth from `hencky_pure_bending`, as functions of the moment.

    Returns:
        (kappa, strain, d strain/dm): callables of `m = M/(E' d^2)`; kappa d is odd in m, the mid-height strain even.
    """
    samples = largest * np.linspace(0.05, 1.0, 20)
    table = np.array([hencky_pure_bending(k, nu) for k in samples])
    m, top = table[:, 0], table[-1, 0]
    z = (m / top) ** 2
    odd = np.polynomial.Polynomial.fit(z, samples / m, 7, domain=[0, 1], window=[0, 1])
    even = np.polynomial.Polynomial.fit(z, table[:, 1] / z, 7, domain=[0, 1], window=[0, 1])
    strain = even * np.polynomial.Polynomial([0, 1], domain=[0, 1], window=[0, 1])
    slope = strain.deriv()
    return (
        lambda moment: moment * odd((moment / top) ** 2),
        lambda moment: strain((moment / top) ** 2),
        lambda moment: slope((moment / top) ** 2) * 2.0 * moment / top**2,
    )


def section_law(section, nu):
    """Strains of a plane-strain section from its force and moment, n = N/(E' d), m = M/(E' d^2).

    "linear": `eps = n`, `kappa d = 12 m`.  "hencky": from the complementary energy `psi(m) + n c(m) + phi(n)`,
    `eps = l(n) - 1 + c(m)`, `kappa d = kappa_0(m) + n c'(m)`: l exact in pure tension (`hencky_uniaxial`), kappa_0 and
    c exact in pure bending (`hencky_section`), their interaction to first order in n.

    Returns:
        A function (n, m) -> (eps, kappa d); eps belongs to the mid-height fibre.
    """
    if section == "linear":
        return lambda n, m: (n, 12.0 * m)
    if section != "hencky":
        raise ValueError(f"section law {section!r}: choose linear or hencky")
    bend, strain, slope = hencky_section(nu)
    return lambda n, m: (hencky_uniaxial(n, 1.0, 0.0)[0] - 1.0 + strain(m), bend(m) + n * slope(m))


# ---------------------------------------------------------------- strips between immovable ends (von Karman)


def _slope_series(a, ends, terms=60):
    """Coefficients c_k, exponents n_k of `-2 N w'/(p L) = sum_k c_k (m_k s - s^n_k)`, s = 2x'/L from the middle.

    From `s - sinh(a s)/sinh a` (clamped, m_k = 1) and `s - sinh(a s)/(a cosh a)` (pinned, m_k = n_k): all terms are
    positive for 0 < s < 1, so nothing cancels when a is small.  60 terms serve a up to 40.

    Returns:
        (c_k, m_k, n_k), each of shape (terms, 1).
    """
    n = 2.0 * np.arange(1, terms + 1)[:, None] + 1.0
    odd = np.exp(n * np.log(a) - np.cumsum(np.log(n * (n - 1.0)), axis=0))  # a^n / n!
    if ends == "clamped":
        return odd / np.sinh(a), np.ones_like(n), n
    return odd / (a * np.cosh(a)), n, n


def _hump(a, s, ends):
    """8 N w/(p L^2) at s = 2x'/L: `1 - s^2` less what the ends' bending and the membrane force take away [-]."""
    if a <= 2.0:
        c, m, n = _slope_series(a, ends)
        return (c * (m * (1.0 - s**2) - 2.0 * (1.0 - np.abs(s) ** (n + 1.0)) / (n + 1.0))).sum(axis=0)
    if ends == "clamped":
        return 1.0 - s**2 - 2.0 / a * (np.cosh(a) - np.cosh(a * s)) / np.sinh(a)
    return 1.0 - s**2 - 2.0 / a**2 * (1.0 - np.cosh(a * s) / np.cosh(a))


@dataclass(frozen=True)
class Strip:
    """Solution of a uniformly loaded strip: midpoint deflection [m], w0/d [-], membrane force [N/m], a = beta L/2."""

    w0: float
    w0_over_d: float
    membrane_force: float
    a: float
    length: float
    depth: float
    pressure: float
    ends: str

    def deflection(self, x):
        """Deflection w [m] at distance x [m] from the left end (positive along the pressure)."""
        s = 2.0 * np.asarray(x, float) / self.length - 1.0
        if self.pressure == 0.0:
            return np.zeros_like(s)
        return self.pressure * self.length**2 / (8.0 * self.membrane_force) * _hump(self.a, s, self.ends)


def shortening_integral(a, ends):
    """I(a) = int_0^1 (2 N w' / (p L))^2 ds, the shape factor of the strip's stretching [-].

    clamped: `1/3 + 2/a^2 - 3 coth(a)/(2a) - 1/(2 sinh^2 a)`; pinned: `1/3 - 2/a^2 + 5 tanh(a)/(2 a^3) -
    1/(2 a^2 cosh^2 a)` (used for a > 2, where they do not cancel; Gauss quadrature of the series below that).
    """
    if a > 2.0:
        if ends == "clamped":
            return 1 / 3 + 2 / a**2 - 1.5 / (a * np.tanh(a)) - 0.5 / np.sinh(a) ** 2
        return 1 / 3 - 2 / a**2 + 2.5 * np.tanh(a) / a**3 - 0.5 / (a * np.cosh(a)) ** 2
    s, weight = np.polynomial.legendre.leggauss(24)
    s, (c, m, n) = 0.5 * (s + 1.0), _slope_series(a, ends)
    return 0.5 * np.sum(weight * (c * (m * s - s**n)).sum(axis=0) ** 2)


def von_karman_strip(p, ends, length, depth, E, nu):
    """Plate strip in cylindrical bending between immovable ends, moderate rotations (Timoshenko & Woinowsky-Krieger,
    Theory of Plates and Shells, 2nd ed., ch. 1).

    `D w'''' - N w'' = p`, `N L / (E' d) = 1/2 int w'^2 dx`, with `a = (L/2) sqrt(N/D)` and `q = p L^4/(E' d^4)`:
    `q^2 = 8 a^6 / (27 I(a))`, `w0/d = 3 q/(8 a^2) h(a)`, `h = 1 - (2/a) tanh(a/2)` (clamped) or
    `1 - (2/a^2)(1 - 1/cosh a)` (pinned).

    Args:
        p: pressure [Pa].
        ends: "clamped" or "pinned".
        length, depth: L, d [m].
        E, nu: Young's modulus [Pa], Poisson's ratio [-].

    Returns:
        A `Strip`.
    """
    if p == 0.0:
        return Strip(0.0, 0.0, 0.0, 0.0, length, depth, 0.0, ends)
    modulus = plane_strain_modulus(E, nu)
    q = p * length**4 / (modulus * depth**4)

    def excess(log_a):
        a = np.exp(log_a)
        return np.log(8.0 * a**6 / (27.0 * shortening_integral(a, ends))) - 2.0 * np.log(q)

    a = float(np.exp(brentq(excess, np.log(1e-12), np.log(300.0), xtol=1e-15, rtol=1e-14)))
    ratio = 3.0 * q / (8.0 * a**2) * float(_hump(a, np.zeros(1), ends)[0])
    force = modulus * depth**3 * a**2 / (3.0 * length**2)
    return Strip(ratio * depth, ratio, force, a, length, depth, float(p), ends)


def clamped_strip(p, length=0.254, depth=5.08e-3, E=68.95e9, nu=0.25):
    """w0/d of the clamped strip of seed 004 5.2.2 under the pressure p [Pa]: 0.5861 at 276 kPa (`von_karman_strip`)."""
    return von_karman_strip(p, "clamped", length, depth, E, nu).w0_over_d


def pinned_strip(p, length=0.254, depth=5.08e-3, E=68.95e9, nu=0.25):
    """w0/d of the strip of seed 004 5.2.3 with pinned, immovable ends under p [Pa] (`von_karman_strip`)."""
    return von_karman_strip(p, "pinned", length, depth, E, nu).w0_over_d


def exact_strip(
    p, ends, length=0.254, depth=5.08e-3, E=68.95e9, nu=0.25, section="linear", shear_factor=5 / 6, load_height=0.0
):
    """Midpoint w0/d of the same strip as a geometrically exact, shear-deformable beam (Reissner 1972), by `solve_bvp`.

    Half span, s = S/L in [0, 1/2], unknowns x, y (along the load), theta, M and the constant horizontal force n_x:
    `r' = (1 + eps) t + gamma n`, `theta' = kappa`, `M' = -(r' x f) - p h sin(theta)`, `f = (n_x, p (L/2 - S))`.
    Ends: x = y = 0 and theta = 0 (clamped) or M = 0 (pinned); x = L/2, theta = 0 at midspan.  A dead load that acts at
    the height h above the middle gives the couple `p h sin(theta)` and, by the mean transverse stress `-p h/d`, the
    extension `nu/(1-nu) p h/(E' d)`.  Lengths are scaled by L, forces by D/L^2.

    Args:
        p: pressure per undeformed length [Pa].
        ends: "clamped" or "pinned".
        length, depth, E, nu: as in `von_karman_strip`.
        section: "linear" or "hencky" (`section_law`).
        shear_factor: k [-]; `numpy.inf` leaves out shear.
        load_height: h [m] (depth/2: pressure on the upper face).
    """
    if p == 0.0:
        return 0.0
    modulus = plane_strain_modulus(E, nu)
    ratio = depth / length
    axial = 12.0 / ratio**2  # E' d L^2 / D
    shear = shear_factor * (1.0 - nu) / 2.0 * axial  # k G d L^2 / D
    load = 12.0 * p / (modulus * ratio**3)  # p L^3 / D
    couple, squeeze = load * load_height / length, nu / (1.0 - nu) * p * load_height / (modulus * depth)

    def rates(s, z, parameter, law):
        _, _, theta, moment = z
        c, sn = np.cos(theta), np.sin(theta)
        n_x, n_y = parameter[0], load * (0.5 - s)
        eps, bend = law((n_x * c + n_y * sn) / axial, moment * ratio / 12.0)
        stretch, slide = 1.0 + eps + squeeze, (n_y * c - n_x * sn) / shear
        dx, dy = stretch * c - slide * sn, stretch * sn + slide * c
        return np.vstack((dx, dy, bend / ratio, dy * n_x - dx * n_y - couple * sn))

    def ends_residual(left, right, parameter):
        root = left[2] if ends == "clamped" else left[3]
        return np.array([left[0], left[1], root, right[0] - 0.5, right[2]])

    small = von_karman_strip(p, ends, length, depth, E, nu)
    s = np.linspace(0.0, 0.5, 41)
    w = small.deflection(s * length) / length
    theta = np.gradient(w, s)
    guess, tension = np.vstack((s, w, theta, np.gradient(theta, s))), [4.0 * small.a**2]
    for law in [section_law(name, nu) for name in dict.fromkeys(("linear", section))]:  # the linear law leads the way
        sol = solve_bvp(
            lambda s, z, f, law=law: rates(s, z, f, law), ends_residual, s, guess, p=tension, tol=1e-8, max_nodes=20000
        )
        if not sol.success:
            raise RuntimeError(f"geometrically exact strip at p = {p} Pa: {sol.message}")
        s, guess, tension = sol.x, sol.y, sol.p
    return float(sol.y[1, -1]) / ratio


# ---------------------------------------------------------------- cantilever with a dead end load


def elastica_tip(load, length=10.0, depth=1.0, E=12e6, nu=0.2):
    """Tip displacements (shortening/L, deflection/L) of the inextensible elastica (Bisshopp & Drucker 1945).

    With `alpha = P L^2/D` and tip slope theta_0: `k^2 = (1 + sin theta_0)/2`, `sin phi = 1/(k sqrt 2)`,
    `sqrt(alpha) = K(k) - F(phi, k)`, `deflection/L = 1 - 2 (E(k) - E(phi, k))/sqrt(alpha)`,
    `1 - shortening/L = sqrt(2 sin(theta_0)/alpha)`.
    """
    alpha = load * length**2 / (plane_strain_modulus(E, nu) * depth**3 / 12.0)

    def root_alpha(m):
        phi = np.arcsin(np.sqrt(0.5 / m))
        return ellipk(m) - ellipkinc(phi, m)

    m = brentq(lambda m: root_alpha(m) - np.sqrt(alpha), 0.5 + 1e-14, 1.0 - 1e-14, xtol=1e-16)
    phi = np.arcsin(np.sqrt(0.5 / m))
    deflection = 1.0 - 2.0 * (ellipe(m) - ellipeinc(phi, m)) / np.sqrt(alpha)
    return 1.0 - np.sqrt(2.0 * (2.0 * m - 1.0) / alpha), deflection


@dataclass(frozen=True)
class Beam:
    """Displaced midline of a cantilever: functions of the reference abscissa X [m], and the tip's u/L."""

    length: float
    horizontal: float
    vertical: float
    solution: object

    def displacement(self, X):
        """(u_x, u_y) [m] of the midline at X [m]; u_y along the load."""
        s = np.asarray(X, float) / self.length
        x, y = self.solution(s)[:2]
        return self.length * (x - s), self.length * y


def cantilever_beam(
    load, length=10.0, depth=1.0, E=12e6, nu=0.2, section="linear", stretch=True, shear_factor=5 / 6, loaded_from=None
):
    """Geometrically exact cantilever (Reissner 1972) with a dead end load transverse to it, by `solve_bvp`.

    `r' = (1 + eps) t + gamma n`, `theta' = kappa`, `M' = -(r' x f)`, f the force carried by the section,
    `gamma = Q/(k G d)`; x = y = theta = 0 at the root, M = 0 at the tip.

    Args:
        load: total transverse force P [N/m].
        length, depth, E, nu: L, d [m], Young's modulus [Pa], Poisson's ratio [-].
        section: "linear" or "hencky" (`section_law`).
        stretch: False leaves out axial strain (with shear_factor = inf and the linear law: the inextensible elastica).
        shear_factor: k [-].
        loaded_from: if given, P is spread evenly over [loaded_from, length] instead of acting at the tip.

    Returns:
        A `Beam`; `horizontal` is negative (the tip moves towards the root), `vertical` positive along the load.
    """
    ratio = depth / length
    target = 12.0 * load / (plane_strain_modulus(E, nu) * depth * ratio**2)  # P L^2/D; forces are scaled by D/L^2
    axial = 12.0 / ratio**2 if stretch else np.inf
    shear = shear_factor * (1.0 - nu) / 2.0 * 12.0 / ratio**2  # k G d L^2/D
    law = section_law(section, nu)

    def carried(s):
        if loaded_from is None:
            return np.ones_like(s)
        return np.clip((1.0 - s) / (1.0 - loaded_from / length), 0.0, 1.0)

    def rates(s, z, alpha):
        _, _, theta, moment = z
        c, sn = np.cos(theta), np.sin(theta)
        f = alpha * carried(s)
        eps, bend = law(f * sn / axial, moment * ratio / 12.0)
        slide = f * c / shear
        dx, dy = (1.0 + eps) * c - slide * sn, (1.0 + eps) * sn + slide * c
        return np.vstack((dx, dy, bend / ratio, -dx * f))

    def ends_residual(left, right):
        return np.array([left[0], left[1], left[2], right[3]])

    s = np.unique(np.r_[np.linspace(0.0, 1.0, 41), (loaded_from or 0.0) / length])
    guess = np.vstack((s, np.zeros_like(s), np.zeros_like(s), np.zeros_like(s)))
    for alpha in np.linspace(0.0, target, max(2, int(np.ceil(target)) + 1))[1:]:
        sol = solve_bvp(
            lambda s, z, alpha=alpha: rates(s, z, alpha), ends_residual, s, guess, tol=1e-9, max_nodes=20000
        )
        if not sol.success:
            raise RuntimeError(f"cantilever at {load} N: {sol.message}")
        guess = sol.sol(s)
    return Beam(length, float(sol.y[0, -1]) - 1.0, float(sol.y[1, -1]), sol.sol)


# ---------------------------------------------------------------- arch that snaps through

ARCH = {"span": 60.0, "rise": 3.2, "depth": 2.0, "E": 18e3, "nu": 0.25}  # the bundled case


def clamped_arch(drops, span=60.0, rise=3.2, depth=2.0, E=18e3, nu=0.25, width=1.6, shear_factor=5 / 6):
    """Force at the crown of a clamped arch whose crown has dropped: a geometrically exact beam, symmetric.

    The midline is y = rise sin^2(pi x/span), the depth is vertical, and the force P is spread over `width` about the
    crown; half of the arch, 0 < x < span/2, by `solve_bvp` with P and the thrust as unknowns. `r' = (1 + eps) t +
    gamma n`, `theta' = theta0' + kappa`, `M' = -(r' x f)` along the arc, f the force carried by the section; x = y =
    theta = 0 at the clamp, x = span/2, y = rise - drop, theta = 0 at the crown. A function of the drop, although under
    a growing force the arch would snap.

    Args:
        drops: of the crown, ascending in small steps from near 0 [mm].
        span, rise, depth, width: [mm].
        E, nu: Young's modulus [MPa], Poisson's ratio [-]; plane strain.
        shear_factor: k [-].

    Returns:
        P at each drop [N/mm].
    """
    modulus, shear, half = plane_strain_modulus(E, nu), shear_factor * E / (2 * (1 + nu)), span / 2
    k = np.pi / span
    unit = 10 * modulus * depth**3 * rise / span**3  # of thrust and force

    def angle(x):
        return np.arctan(rise * k * np.sin(2 * k * x))

    def rates(x, z, forces):
        _, _, theta, moment = z
        thrust, force = forces * unit
        across = -force / 2 * np.clip((half - x) / (width / 2), 0.0, 1.0)
        c, s, c0 = np.cos(theta), np.sin(theta), np.cos(angle(x))
        thick = depth * c0
        eps, slide = (thrust * c + across * s) / (modulus * thick), (across * c - thrust * s) / (shear * thick)
        dx, dy = (1 + eps) * c - slide * s, (1 + eps) * s + slide * c
        bend = 2 * rise * k**2 * np.cos(2 * k * x) * c0**3 + 12 * moment / (modulus * thick**3)
        return np.vstack((dx, dy, bend, thrust * dy - across * dx)) / c0

    x = np.unique(np.r_[np.linspace(0.0, half, 61), half - width / 2])
    guess, forces, found = np.vstack((x, rise * np.sin(k * x) ** 2, angle(x), 0 * x)), np.zeros(2), []
    for drop in drops:

        def ends(left, right, _, drop=drop):
            return np.array([*left[:3], right[0] - half, right[1] - rise + drop, right[2]])

        sol = solve_bvp(rates, ends, x, guess, forces, tol=1e-8, max_nodes=20000)
        if not sol.success:
            raise RuntimeError(f"arch at a drop of {drop} mm: {sol.message}")
        guess, forces = sol.sol(x), sol.p
        found.append(forces[1] * unit)
    return np.array(found)


def shallow_arch(parameter, span, rise, depth, E, nu):
    """The same arch in the theory of shallow arches, with a point force, in closed form.

    With u the upward displacement and N = -D k^2 the constant normal force, D u'''' = N (u + y0)'' on each half,
    y0 = rise sin^2(pi x/span): u = a + b x + c cos kx + d sin kx + A cos(beta x), beta = 2 pi/span,
    A = -k^2 rise/2/(beta^2 - k^2); u = u' = 0 at the clamp, u' = 0 and D u''' = P/2 at the crown. Compatibility,
    N span/(E' depth) = int (y0' u' + u'^2/2) dx, is quadratic in P.

    Args:
        parameter: k span/2, neither 0 nor a multiple of pi.

    Returns:
        The pairs (drop of the crown, P), two or none.
    """
    modulus, half = plane_strain_modulus(E, nu), span / 2
    D, k, beta = modulus * depth**3 / 12, parameter / half, 2 * np.pi / span
    A = -(k**2) * rise / 2 / (beta**2 - k**2)
    c, s = np.cos(parameter), np.sin(parameter)
    rows = np.array([[1, 0, 1, 0], [0, 1, 0, k], [0, 1, -k * s, k * c], [0, 0, k**3 * s, -(k**3) * c]])
    own, forced = np.linalg.solve(rows, [-A, 0, 0, 0]), np.linalg.solve(rows, [0, 0, 0, 1 / (2 * D)])
    x, weight = np.polynomial.legendre.leggauss(40)
    x, weight = half * (x + 1) / 2, half * weight / 2

    def slope(z):
        return z[1] - k * z[2] * np.sin(k * x) + k * z[3] * np.cos(k * x)

    first, second = slope(own) - A * beta * np.sin(beta * x), slope(forced)
    initial = rise * beta / 2 * np.sin(beta * x)
    loads = np.roots([
        weight @ second**2 / 2, weight @ (second * (initial + first)),
        weight @ (initial * first + first**2 / 2) + D * k**2 * half / (modulus * depth),
    ])  # fmt: skip
    crown = np.array([1, half, c, s])
    return [(A - crown @ own - P * crown @ forced, P) for P in loads if np.isreal(P)]


# ---------------------------------------------------------------- plate in tension


def tension_small_strain(X, Y, dx, length=1.0, height=0.5, E=200e9, nu=0.33, b=2e10):
    """Small-strain displacement of the plate of seed 004 4.3.2, pulled by a body force b in a layer dx at each end.

    Origin at the centre, A = L/2 - dx: `sigma_xx = b dx` for |X| <= A and `b (L/2 - |X|)` in the layers, so
    `u_x = b dx X/E'` and, in the layers with xi = |X| - A, `sgn(X) (b/E') (dx A + dx xi - xi^2/2)`;
    `u_y = -nu (1 + nu)/E sigma_xx Y`.  Exact between the layers up to the Saint-Venant effect of the layers; inside
    them it is the one-dimensional solution (the jump of d sigma/dX at |X| = A is not compatible in two dimensions).

    Returns:
        (u_x, u_y) [m].
    """
    X, Y = np.broadcast_arrays(np.asarray(X, float), np.asarray(Y, float))
    inner = 0.5 * length - dx
    xi = np.clip(np.abs(X) - inner, 0.0, dx)
    u_x = np.sign(X) * b / plane_strain_modulus(E, nu) * (dx * np.minimum(np.abs(X), inner) + dx * xi - 0.5 * xi**2)
    return u_x, -nu * (1.0 + nu) / E * b * (dx - xi) * Y


def tension_hencky(X, Y, dx, length=1.0, height=0.5, E=200e9, nu=0.33, b=2e10):
    """Finite-strain (Hencky) twin of `tension_small_strain`: dead body force b per reference volume, nominal stress
    `P = b dx` between the layers and `b (L/2 - |X|)` inside.

    In a layer `int l dX = (E'/b) [g(ln l_A) - g(ln l)]` with `g(t) = t - t^2/2`, because `P = E' t exp(-t)`.

    Returns:
        (u_x, u_y) [m].
    """
    X, Y = np.broadcast_arrays(np.asarray(X, float), np.asarray(Y, float))
    inner = 0.5 * length - dx
    xi = np.clip(np.abs(X) - inner, 0.0, dx)
    stretch, lateral = hencky_uniaxial(b * (dx - xi), E, nu)
    t_a, t = np.log(hencky_uniaxial(b * dx, E, nu)[0]), np.log(stretch)
    layer = plane_strain_modulus(E, nu) / b * ((t_a - 0.5 * t_a**2) - (t - 0.5 * t**2)) - xi
    u_x = np.sign(X) * ((np.exp(t_a) - 1.0) * np.minimum(np.abs(X), inner) + layer)
    return u_x, (lateral - 1.0) * Y
