"""Plates with holes in plane stress, linear elasticity: Inglis' infinite plate in closed form, stored finite elements.

Tension S along y, origin at the centre, SI units.  Theory and figures: docs/theory/references.md, section 7; the files
`data/elliptic_hole.json`, `circular_hole_plate.json`, `kirsch_plate.json` come from `scripts/references`.
"""

import json
from pathlib import Path

import h5py
import numpy as np
from scipy.interpolate import CubicSpline

DATA = Path(__file__).parent / "data"


def elliptic_hole_infinite(x, y, a, b, S=1.0, E=1.0, nu=0.3):
    """Infinite plate with a free elliptic hole under the tension S along y (Inglis 1913; Kirsch for a = b).

    Muskhelishvili's potentials on `z = R (zeta + m/zeta)`, `R = (a + b)/2`, `m = (a - b)/(a + b)`:
    `phi = (S R/4) (zeta - (2 + m)/zeta)`,
    `psi = (S R/2) (zeta - (1 + m + m^2)/zeta - (1 + m^2)(1 + m)/(zeta (zeta^2 - m)))`;
    `sxx + syy = 4 Re phi'(z)`, `syy - sxx + 2 i sxy = 2 (conj(z) phi''(z) + psi'(z))`,
    `E/(1 + nu) (u_x + i u_y) = (3 - nu)/(1 + nu) phi - z conj(phi') - conj(psi)`.

    Args:
        x, y: points off the hole, with x >= 0 and y >= 0 [m].
        a, b: semi-axes along x and y [m], a >= b.
        S, E, nu: tension [Pa], Young's modulus [Pa], Poisson's ratio [-].

    Returns:
        dict of ux, uy [m], sxx, syy, sxy [Pa], shaped like x and y.
    """
    z, R, m = np.asarray(x) + 1j * np.asarray(y), 0.5 * (a + b), (a - b) / (a + b)
    c = np.sqrt(a**2 - b**2)
    w = (z + np.sqrt(z - c) * np.sqrt(z + c)) / (2 * R)
    k1, k2 = 1 + m + m**2, (1 + m**2) * (1 + m)
    cubic, cubic1 = w**3 - m * w, 3 * w**2 - m
    z1, z2 = R * (1 - m / w**2), 2 * R * m / w**3  # derivatives by zeta
    phi, phi1, phi2 = (0.25 * S * R * v for v in (w - (2 + m) / w, 1 + (2 + m) / w**2, -2 * (2 + m) / w**3))
    psi, psi1 = 0.5 * S * R * (w - k1 / w - k2 / cubic), 0.5 * S * R * (1 + k1 / w**2 + k2 * cubic1 / cubic**2)
    first = phi1 / z1
    half_sum, deviator = 2 * first.real, np.conj(z) * (phi2 * z1 - phi1 * z2) / z1**3 + psi1 / z1
    u = ((3 - nu) / (1 + nu) * phi - z * np.conj(first) - np.conj(psi)) * (1 + nu) / E
    stress = {"sxx": half_sum - deviator.real, "syy": half_sum + deviator.real, "sxy": deviator.imag}
    return {"ux": u.real, "uy": u.imag, **stress}


def heywood(a_over_W):
    """Gross stress concentration of a circular hole in a long strip, half width W: `(2 + (1 - r)^3)/(1 - r)`, r = a/W
    (Heywood 1952, an engineering formula)."""
    return (2 + (1 - a_over_W) ** 3) / (1 - a_over_W)


class StoredPlate:
    """Finite-element solution of a square plate with a hole, interpolated.

    Attributes:
        a, b: semi-axes [m]; half_width [m]; E [Pa]; nu; S [Pa].
        error: estimated relative error per line and quantity.
        convergence: a few numbers on three meshes.
    """

    def __init__(self, name, b):
        content = json.loads((DATA / f"{name}.json").read_text())
        holes = content["holes"]
        if f"b={b:g}" not in holes:
            raise ValueError(f"{name}.json has no hole with b = {b:g} m; it has {', '.join(holes)}")
        hole, p = holes[f"b={b:g}"], content["parameters"]
        self.a, self.b = hole["a"], hole["b"]
        self.half_width, self.E, self.nu, self.S = p["half_width"], p["E"], p["nu"], p["S"]
        self.error, self.convergence = hole["error"], hole["convergence"]
        self.lines = {k: {q: np.array(v) for q, v in t.items()} for k, t in hole["lines"].items()}
        self._grid = hole["grid"]

    def along(self, line, quantity, at):
        """A quantity along a line, by cubic splines in the coordinate in which the samples were chosen.

        Args:
            line: "y0" (y = 0: ux, sxx, syy by x), "x0" (x = 0: uy, sxx, syy by y), "right" (x = half width: ux, uy, syy
                by y), "top" (y = half width: ux, uy, sxx by x) or "rim" (ux, uy, hoop by theta, the point
                `(a cos theta, b sin theta)`, 0 to pi/2).
            quantity: one of the above; displacements [m], stresses [Pa].
            at: coordinates along the line [m] (theta: rad); negative ones by symmetry.
        """
        table, at = self.lines[line], np.asarray(at, float)
        axis = next(iter(table))
        low, high = table[axis][[0, -1]]
        if np.any((np.abs(at) < low * (1 - 1e-6)) | (np.abs(at) > high * (1 + 1e-6))):
            raise ValueError(
                f"line {line}: |{axis}| must lie in [{low:g}, {high:g}], outside the hole and in the plate"
            )
        stretch = {"y0": lambda x: self._eta(x, -1), "x0": lambda y: self._eta(y, 1)}.get(line, lambda s: s)
        values = CubicSpline(stretch(table[axis]), table[quantity])(stretch(np.clip(np.abs(at), low, high)))
        return np.where(at < 0, -values, values) if quantity == f"u{axis}" else values

    def _eta(self, s, sign):
        """`ln |zeta|` on the axes: `|zeta| = (s + sqrt(s^2 -+ (a^2 - b^2)))/(a + b)`."""
        return np.log((s + np.sqrt(s**2 + sign * (self.a**2 - self.b**2))) / (self.a + self.b))

    def grid(self):
        """(x, y, {ux, uy [m], syy [Pa]}) on the quarter 0 <= x, y <= half width; tables [y, x], nan in the hole."""
        g = self._grid
        tables = {k: np.array(g[k], float) * unit for k, unit in g["unit"].items()}
        return np.array(g["x"]), np.array(g["y"]), tables


def elliptic_hole(b=0.006):
    """Seed 000: a = 50 mm, b = 6 mm (section 4.1) or 5 mm (4.2), S = 10 MPa."""
    return StoredPlate("elliptic_hole", b)


def circular_hole_plate():
    """Seed 003, section 5.3: radius 50 mm, S = 200 MPa, nu = 1/3."""
    return StoredPlate("circular_hole_plate", 0.05)


def kirsch_plate(a_over_W):
    """Circular hole of radius a in a square plate of half width W: stresses over S (or over the hole's pressure p).

    gross, net: highest syy over S and over the mean ligament stress; lowest: sxx on x = 0 at the rim; x_over_a, sxx_y0,
    syy_y0: along y = 0; theta, pressure_hoop: rim with pressure in the hole.  Displacements times E/(S a) or E/(p a)
    are pairs (c0, c1), exact for every nu as `c0 + c1 nu`: ux_rim at (a, 0), uy_rim at (0, a), ux_edge at (W, 0),
    uy_edge at (0, W), pressure_ux_rim, pressure_ux_rim_45 (ux at 45 degrees), pressure_ux_edge.
    """
    squares = json.loads((DATA / "kirsch_plate.json").read_text())["squares"]
    if f"a/W={a_over_W:g}" not in squares:
        raise ValueError(f"kirsch_plate.json has no square with a/W = {a_over_W:g}; it has {', '.join(squares)}")
    table = squares[f"a/W={a_over_W:g}"]
    return {k: np.array(v) if isinstance(v, list) else v for k, v in table.items()}


def strip_concentration():
    """(a/W, gross stress concentration) of a circular hole in a strip of half width W and half height 4 W."""
    strips = json.loads((DATA / "kirsch_plate.json").read_text())["strips"].values()
    return np.array([(s["a_over_W"], s["gross"]) for s in strips]).T


class HoleLine:
    """u_x and stresses yy on y = 0, from the tip of an elliptical hole to the edge, as means of the particles above and
    below, beside finite elements.

    Args:
        directory: results of the case `elliptic_hole`.
        b: the hole's smaller semi-axis.
    """

    def __init__(self, directory: Path, b: float):
        with h5py.File(directory / "fields.h5") as file:
            last = file[max((name for name in file if name.isdigit()), key=int)]
            refined = file.get("refined", {})  # no import of the package, which starts MPI
            body = f"refined/{max(refined, key=int)}/" if len(refined) else ""
            X, spacing, horizon = (file[body + name][...] for name in ("position", "spacing", "horizon"))
            u, stress, flux = (last[name][...] for name in ("u", "stress", "peridynamic_stress"))
        near = np.flatnonzero((np.abs(X[:, 1]) < 0.75 * spacing) & (X[:, 0] > 0.05))
        _, column = np.unique(np.rint(X[near, 0] / (0.05 * spacing.min())), return_inverse=True)

        def mean(values):
            return np.bincount(column, values[near]) / np.bincount(column)

        self.x, self.delta, self.rho = mean(X[:, 0]), float(horizon[near].min()), b**2 / 0.05
        self.ux, self.stress, self.flux = mean(u[:, 0]), mean(stress[:, 4]), mean(flux[:, 4])
        self.width = mean(spacing)
        self.reference = elliptic_hole(b=b)
        self.ux_exact, self.stress_exact = (self.reference.along("y0", name, self.x) for name in ("ux", "syy"))

    def errors_ux(self) -> list[float]:
        """Total, within and beyond 50 radii of the tip, % (seed 000 Eq. 99: sums of absolute values)."""
        near = self.x - 0.05 < 50 * self.rho
        return [norm_1(self.ux, self.ux_exact, mask) for mask in (np.full(len(near), True), near, ~near)]

    def integrals(self) -> list[float]:
        """Errors of u_x and stress yy with each particle's width along the line, %, which goes for all spacings."""
        pairs = ((self.ux, self.ux_exact), (self.stress, self.stress_exact))
        return [
            float(100 * (self.width * np.abs(q - exact)).sum() / (self.width * np.abs(exact)).sum())
            for q, exact in pairs
        ]

    def errors_stress(self, values: np.ndarray) -> list[float]:
        """Total and within a horizon of the tip, %."""
        near = self.x - 0.05 < self.delta
        return [norm_1(values, self.stress_exact, mask) for mask in (np.full(len(near), True), near)]


def norm_1(values: np.ndarray, exact: np.ndarray, mask: np.ndarray) -> float:
    return float(100 * np.abs(values - exact)[mask].sum() / np.abs(exact)[mask].sum())
