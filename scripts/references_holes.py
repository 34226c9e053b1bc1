"""Linear-elastic plates with an elliptic hole by high-order finite elements (numpy, scipy); see `scripts/references`.

Plane stress, small strains, a quarter of the plate by symmetry.  Isoparametric quadrilaterals of degree p (tensor
product of Gauss-Lobatto nodes, (p + 2)^2 Gauss points) whose nodes lie on the conformal coordinates of the ellipse,
`z = R (zeta + m/zeta)`, `zeta = exp(eta + i theta)`, `R = (a + b)/2`, `m = (a - b)/(a + b)`: the hole is eta = 0, the
outer edge eta = eta_out(theta).  The mesh is graded towards the tip (docs/theory/references.md, section 7).
"""

from functools import cached_property
from time import perf_counter

import numpy as np
from numpy.polynomial import legendre
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

DEGREE = 8
CORNER = 0.05  # size of the elements at the plate's corner, where the stress goes like r^1.74, before division
ELLIPTIC = {"half_width": 0.25, "a": 0.05, "b": [0.006, 0.005], "E": 200e9, "nu": 0.3, "S": 10e6}
CIRCULAR = {"half_width": 0.25, "a": 0.05, "E": 200e9, "nu": 1 / 3, "S": 200e6}
PULLED = {"half_width": 0.075, "half_height": 0.025, "a": 0.01, "E": 210e9, "nu": 0.33, "pull": 1e-4}
KIRSCH = {"a_over_W": [0.02, 0.05, 0.1, 0.2], "strip_a_over_W": [0.1, 0.2, 0.3, 0.4, 0.5], "strip_height": 4.0}
STRESSES = ("sxx", "syy", "sxy")


def basis_at(degree, points):
    """Lagrange polynomials of the Gauss-Lobatto nodes and their derivatives: two arrays (points, degree + 1)."""
    nodes = lobatto(degree)
    inverse = np.linalg.inv(legendre.legvander(nodes, degree))
    derivative = legendre.legder(np.eye(degree + 1))  # of each Legendre polynomial, by columns
    return legendre.legvander(points, degree) @ inverse, legendre.legvander(points, degree - 1) @ derivative @ inverse


def lobatto(degree):
    """Gauss-Lobatto nodes of [-1, 1]: the ends and the extrema of the Legendre polynomial."""
    inner = legendre.Legendre.basis(degree).deriv().roots()
    return np.r_[-1.0, np.sort(inner.real), 1.0]


def graded(length, scale, elements, end_scale=np.inf):
    """Breakpoints of [0, length] whose density is `1/(x + scale) + 1/(length - x + end_scale)`: fine at the ends."""
    x = length * np.sin(0.5 * np.pi * np.linspace(0, 1, 20001)) ** 2  # the table is dense at the ends too
    count = np.log1p(x / scale) - np.log1p(-x / (length + end_scale))
    return np.interp(np.linspace(0, count[-1], elements + 1), count, x)


class Plate:
    """Quarter of the plate |x| <= width, |y| <= height with the hole x^2/a^2 + y^2/b^2 < 1, u_x = 0 on x = 0, u_y = 0
    on y = 0; `elements` across, `elements` around up to the plate's corner and as many after it.

    Args:
        a, b: semi-axes along x and y [m], a >= b.
        width, height: half width and half height [m].
        E, nu: Young's modulus [Pa], Poisson's ratio [-].
    """

    def __init__(self, a, b, width, height, E, nu, elements, degree=DEGREE):
        self.a, self.b, self.width, self.height, self.degree = a, b, width, height, degree
        self.R, self.m = 0.5 * (a + b), (a - b) / (a + b)
        # plane stress: sigma = C (eps_xx, eps_yy, 2 eps_xy)
        self.C = E / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, 0.5 * (1 - nu)]])
        self.corner = float(self.conformal(width, height)[1])
        # the mapping is singular at zeta = sqrt(m), this far behind the tip in eta and theta
        self.near = min(1.0, -0.5 * np.log(max(self.m, 1e-9)))
        self.s = graded(1.0, self.near / np.log(width / self.R), elements, CORNER)
        after = self.corner + graded(0.5 * np.pi - self.corner, CORNER, elements)
        self.theta = np.r_[graded(self.corner, self.near, elements, CORNER), after[1:]]
        s, theta = self._nodes(self.s), self._nodes(self.theta)
        eta = s[:, None] * self.eta_out(theta)
        self.xy = np.stack(self.position(eta, theta))  # (2, nodes across, nodes around)
        self.shape = eta.shape
        n, p = np.arange(eta.size).reshape(self.shape), degree
        rows, columns = (p * np.arange(k)[:, None] + np.arange(p + 1) for k in (self.s.size - 1, self.theta.size - 1))
        self.nodes = n[rows[:, None, :, None], columns[None, :, None, :]]  # (across, around, p + 1, p + 1)

    def _nodes(self, breaks):
        local = 0.5 * (1 + lobatto(self.degree))[:-1]
        return np.r_[(breaks[:-1, None] + np.diff(breaks)[:, None] * local).ravel(), breaks[-1]]

    def position(self, eta, theta):
        """(x, y) [m] of the conformal coordinates."""
        grow, decay = self.R * np.exp(eta), self.R * self.m * np.exp(-eta)
        x, y = (grow + decay) * np.cos(theta), (grow - decay) * np.sin(theta)
        # exactly on the axis
        return np.where(theta > 0.5 * np.pi - 1e-14, 0.0, x), y

    def conformal(self, x, y):
        """(eta, theta) of points outside the hole in the first quadrant."""
        z, c = np.asarray(x) + 1j * np.asarray(y), np.sqrt(max(self.a**2 - self.b**2, 0.0))
        zeta = (z + np.sqrt(z - c) * np.sqrt(z + c)) / (2 * self.R)
        return np.log(np.abs(zeta)), np.angle(zeta)

    def eta_out(self, theta):
        """eta of the outer edge: x = width up to the corner, y = height after it."""
        right = np.asarray(theta) <= self.corner
        k = np.where(right, self.width / np.cos(np.where(right, theta, 0.0)), 0.0)
        k += np.where(right, 0.0, self.height / np.sin(np.where(right, 1.0, theta)))
        k /= self.R
        return np.log(0.5 * (k + np.sqrt(k**2 - 4 * self.m * np.where(right, 1.0, -1.0))))

    @cached_property
    def stiffness(self):
        """Of all degrees of freedom, node by node, u_x then u_y."""
        p = self.degree
        point, weight = legendre.leggauss(p + 2)
        value, slope = basis_at(p, point)
        nodes = self.nodes.reshape(-1, (p + 1) ** 2)
        # gradients (2 local directions, points, nodes), then Jacobians (element, point, local, global)
        local = np.stack((np.kron(slope, value), np.kron(value, slope)))
        jacobian = np.einsum("lqn,cen->eqlc", local, self.xy.reshape(2, -1)[:, nodes])
        w = np.linalg.det(jacobian) * np.kron(weight, weight)
        assert np.all(w * w[0, 0] > 0), "an element is inverted"
        gx, gy = np.einsum("eqcl,lqn->ceqn", np.linalg.inv(jacobian), local)
        w = np.abs(w)[..., None]
        xx, xy, yy = (np.swapaxes(left, 1, 2) @ (w * right) for left, right in ((gx, gx), (gx, gy), (gy, gy)))
        c11, c12, c33 = self.C[0, 0], self.C[0, 1], self.C[2, 2]
        K = np.empty((len(nodes), nodes.shape[1], 2, nodes.shape[1], 2))
        K[:, :, 0, :, 0], K[:, :, 1, :, 1] = c11 * xx + c33 * yy, c11 * yy + c33 * xx
        K[:, :, 0, :, 1] = c12 * xy + c33 * np.swapaxes(xy, 1, 2)
        K[:, :, 1, :, 0] = np.swapaxes(K[:, :, 0, :, 1], 1, 2)
        dofs = (2 * nodes[..., None] + np.arange(2)).reshape(len(nodes), -1).astype(np.int32)
        size = dofs.shape[1]
        where = (np.repeat(dofs, size, axis=1).ravel(), np.tile(dofs, (1, size)).ravel())
        size = 2 * self.xy[0].size
        return csc_matrix((K.ravel(), where), shape=(size, size))

    @cached_property
    def on_axes(self):
        """Mask (nodes across, nodes around, 2) of what symmetry holds."""
        held = np.zeros((*self.shape, 2), bool)
        held[:, 0, 1] = held[:, -1, 0] = True
        return held

    @cached_property
    def factor(self):
        """Factorised stiffness of the degrees of freedom that are free under tractions, and these."""
        free = np.flatnonzero(~self.on_axes)
        return factorised(self.stiffness[free][:, free]), free

    def pull(self, displacement):
        """Displacement where the edge x = width is moved along x by `displacement` and held along y."""
        held, u = self.on_axes.copy(), np.zeros((*self.shape, 2))
        edge = self._nodes(self.theta) <= self.corner * (1 + 1e-12)
        held[-1, edge] = True
        u[-1, edge, 0] = displacement
        free, u = np.flatnonzero(~held), u.ravel()
        u[free] = factorised(self.stiffness[free][:, free]).solve(-(self.stiffness @ u)[free])
        return u.reshape(*self.shape, 2)

    def solve(self, outer=None, hole=None):
        """Displacement (nodes across, nodes around, 2) under the tractions of a stress on the outer edge or the hole.

        Args:
            outer, hole: functions (x, y) -> (sxx, syy, sxy); the traction is that stress times the outward normal.
        """
        p = self.degree
        point, weight = legendre.leggauss(p + 4)
        value, slope = basis_at(p, point)
        force = np.zeros((self.nodes.max() + 1, 2))
        for stress, nodes, sign in ((outer, self.nodes[-1, :, -1], 1.0), (hole, self.nodes[0, :, 0], -1.0)):
            if stress is None:
                continue
            ends = self.xy.reshape(2, -1)[:, nodes]
            (x, y), (dx, dy) = ends @ value.T, ends @ slope.T
            sxx, syy, sxy = (np.broadcast_to(c, x.shape) for c in stress(x, y))
            traction = sign * np.stack((sxx * dy - sxy * dx, sxy * dy - syy * dx), axis=-1)
            np.add.at(force, nodes, np.einsum("eqc,q,qn->enc", traction, weight, value))
        lu, free = self.factor
        u = np.zeros(force.size)
        u[free] = lu.solve(force.ravel()[free])
        return u.reshape(*self.shape, 2)

    def at(self, u, x, y):
        """ux, uy [m] and sxx, syy, sxy [Pa] by differentiating the element's polynomial, at points off the hole."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        eta, theta = self.conformal(x.ravel(), y.ravel())
        theta = np.clip(theta, 0.0, 0.5 * np.pi)
        return {k: v.reshape(x.shape) for k, v in self._at(u, eta / self.eta_out(theta), theta).items()}

    def _at(self, u, s, theta):
        inside, local = [], []
        for breaks, v in ((self.s, np.clip(s, 0.0, 1.0)), (self.theta, theta)):
            i = np.clip(np.searchsorted(breaks, v, side="right") - 1, 0, breaks.size - 2)
            inside.append(i)
            local.append(basis_at(self.degree, 2 * (v - breaks[i]) / np.diff(breaks)[i] - 1))
        nodes = self.nodes[inside[0], inside[1]]
        fields = np.concatenate((self.xy.reshape(2, -1), u.reshape(-1, 2).T))[:, nodes]  # (4, point, p + 1, p + 1)
        (f, f1), (g, g1) = local
        ux, uy = np.einsum("cpij,pi,pj->cp", fields[2:], f, g)
        along, around = np.einsum("cpij,pi,pj->cp", fields, f1, g), np.einsum("cpij,pi,pj->cp", fields, f, g1)
        det = along[0] * around[1] - along[1] * around[0]
        h_x = (along[2:] * around[1] - around[2:] * along[1]) / det
        h_y = (around[2:] * along[0] - along[2:] * around[0]) / det
        stress = self.C @ np.stack((h_x[0], h_y[1], h_x[1] + h_y[0]))
        return {"ux": ux, "uy": uy, **dict(zip(STRESSES, stress, strict=True))}

    def ligament(self, u):
        """int syy dx over the ligament y = 0 [N/m], 12 Gauss points in each element."""
        point, weight = legendre.leggauss(12)
        size = np.diff(self.s)[:, None]
        s, out = (self.s[:-1, None] + 0.5 * size * (1 + point)).ravel(), self.eta_out(0.0)
        dx = self.R * (np.exp(s * out) - self.m * np.exp(-s * out)) * out
        return float(((0.5 * size * weight).ravel() * dx * self._at(u, s, np.zeros_like(s))["syy"]).sum())

    def samples(self, u, points=201, edge=51, rim=91):
        """Solution on both axes (fine at the hole), the edges and the unloaded rim (hoop stress `sxx + syy`)."""
        w, h = self.width, self.height
        x = self.position(graded(float(self.eta_out(0.0)), self.near, points - 1), 0.0)[0]
        y = self.position(graded(float(self.eta_out(0.5 * np.pi)), self.near, points - 1), 0.5 * np.pi)[1]
        x, y = (np.array([float(f"{v:.7g}") for v in line]) for line in (x, y))  # as they are stored
        along, across = np.linspace(0, h, edge), np.linspace(0, w, edge)
        theta = graded(0.5 * np.pi, self.near, rim - 1) if self.m > 0 else np.linspace(0, 0.5 * np.pi, rim)
        on_rim = self._at(u, np.zeros_like(theta), theta)
        on_rim["hoop"] = on_rim["sxx"] + on_rim["syy"]
        lines = {
            "y0": ({"x": x}, self.at(u, x, 0.0), ("ux", "sxx", "syy")),
            "x0": ({"y": y}, self.at(u, 0.0, y), ("uy", "sxx", "syy")),
            "right": ({"y": along}, self.at(u, w, along), ("ux", "uy", "syy")),
            "top": ({"x": across}, self.at(u, across, h), ("ux", "uy", "sxx")),
            "rim": ({"theta": theta}, on_rim, ("ux", "uy", "hoop")),
        }
        return {line: axis | {k: values[k] for k in names} for line, (axis, values, names) in lines.items()}

    def grid(self, u, n=51):
        """ux, uy, syy on n x n points of the quarter as multiples of a unit, null in the hole; rows of equal y."""
        x, y = np.linspace(0, self.width, n), np.linspace(0, self.height, n)
        X, Y = np.meshgrid(x, y)
        out = (X / self.a) ** 2 + (Y / self.b) ** 2 >= 1 - 1e-12
        values, content = self.at(u, X[out], Y[out]), {"x": x, "y": y, "unit": {}}
        for k in ("ux", "uy", "syy"):
            unit = float(f"{np.abs(values[k]).max() / 1e5:.2g}")
            table = np.full(X.shape, None, object)
            table[out] = [int(v) for v in np.rint(values[k] / unit)]
            content["unit"][k], content[k] = unit, table.tolist()
        return content


def factorised(K):
    """A symmetric sparse matrix, for `solve`."""
    return splu(K.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def relative(coarse, fine):
    """Largest difference over largest value, two digits."""
    return float(f"{np.abs(np.subtract(coarse, fine)).max() / np.abs(fine).max():.1e}")


def difference(coarse, fine):
    """Largest difference of two tables of samples, relative to the largest value of the quantity."""
    keys = {k: [q for q in v if q not in ("x", "y", "theta")] for k, v in fine.items()}
    return {line: {q: relative(coarse[line][q], fine[line][q]) for q in names} for line, names in keys.items()}


def uniform(S):
    """Stress function of a uniform tension S along y."""
    return lambda x, y: (0.0, S, 0.0)


def converge(a, b, width, height, E, nu, S, meshes):
    """Samples on the finest of `meshes`, their error, and the convergence of a few numbers; prints a line per mesh."""
    table, previous, samples = [], None, None
    for elements in meshes:
        start = perf_counter()
        plate = Plate(a, b, width, height, E, nu, elements)
        u = plate.solve(outer=uniform(S))
        previous, samples = samples, plate.samples(u)
        table.append({
            "mesh": [elements, 2 * elements],
            "unknowns": u.size,
            "peak_syy_over_S": float(samples["y0"]["syy"][0] / S),
            "lowest_sxx_over_S": float(samples["x0"]["sxx"][0] / S),
            "uy_top_middle": float(samples["x0"]["uy"][-1]),
            "ux_tip": float(samples["y0"]["ux"][0]),
            "ligament_force_error": plate.ligament(u) / (S * width) - 1,
        })  # fmt: skip
        print(f"hole {a:g} x {b:g} in {width:g} x {height:g}, {table[-1]}, {perf_counter() - start:.1f} s", flush=True)
    return plate, u, samples, {"error": difference(previous, samples), "convergence": table}


def elliptic(meshes):
    """Seed 000, sections 4.1 (b = 6 mm) and 4.2 (b = 5 mm)."""
    p, holes = ELLIPTIC, {}
    for b in p["b"]:
        plate, u, samples, quality = converge(
            p["a"], b, p["half_width"], p["half_width"], p["E"], p["nu"], p["S"], meshes
        )
        holes[f"b={b:g}"] = {"a": p["a"], "b": b, **quality, "lines": samples, "grid": plate.grid(u)}
    return {"problem": "square plate with an elliptic hole, seed 000 4.1 and 4.2", "parameters": p, "holes": holes}


def circular(meshes):
    """Seed 003, section 5.3."""
    p = CIRCULAR
    plate, u, samples, quality = converge(
        p["a"], p["a"], p["half_width"], p["half_width"], p["E"], p["nu"], p["S"], meshes
    )
    hole = {"a": p["a"], "b": p["a"], **quality, "lines": samples, "grid": plate.grid(u)}
    return {"problem": "square plate with a circular hole, seed 003 5.3", "parameters": p, "holes": {"b=0.05": hole}}


def pulled(meshes):
    """Seed 004, section 6.3.1: plane strain, the ends moved along x and held along y; u_x beside the hole on the long
    axis and on the long edge."""
    p = PULLED
    E, nu = p["E"] / (1 - p["nu"] ** 2), p["nu"] / (1 - p["nu"])  # plane stress with these is plane strain
    x, edge, lines = np.linspace(p["a"], p["half_width"], 14), np.linspace(0, p["half_width"], 6), []
    for elements in meshes:
        plate = Plate(p["a"], p["a"], p["half_width"], p["half_height"], E, nu, elements)
        u = plate.pull(p["pull"])
        lines.append({"axis": plate.at(u, x, 0.0)["ux"], "edge": plate.at(u, edge, p["half_height"])["ux"]})
        print(f"pulled, {elements}: {lines[-1]['axis'][0]:.6g}", flush=True)
    error = {name: relative(lines[-2][name], lines[-1][name]) for name in lines[-1]}
    problem = "plate with a circular hole whose ends are pulled, seed 004 6.3.1"
    return {"problem": problem, "parameters": p, "x_axis": x, "x_edge": edge, "ux": lines[-1], "error": error}


def kirsch(meshes):
    """Circular hole of radius 1 in a square of half width W: tension S = 1 along y, and pressure 1 in the hole; E = 1.

    The stress does not depend on nu (the loads on each edge are in equilibrium), so displacements are linear in nu:
    solved at nu = 0 and 1/3.
    """
    squares, strips = {}, {}
    for ratio in KIRSCH["a_over_W"]:
        coarse, fine = (kirsch_square(1 / ratio, elements) for elements in meshes[-2:])
        error = {
            k: relative(coarse[k], v) for k, v in fine.items() if k not in ("x_over_a", "theta", "ligament_force_error")
        }
        squares[f"a/W={ratio:g}"] = {"a_over_W": ratio, **fine, "error": error}
        print(f"a/W = {ratio}: gross {fine['gross']:.7f}, pressure {fine['pressure_hoop'][[0, 45]]}", flush=True)
    for ratio in KIRSCH["strip_a_over_W"]:
        width, gross = 1 / ratio, []
        for elements in meshes[-2:]:
            plate = Plate(1.0, 1.0, width, KIRSCH["strip_height"] * width, 1.0, 0.0, elements)
            gross.append(float(plate.at(plate.solve(outer=uniform(1.0)), 1.0, 0.0)["syy"]))
        error = relative(*gross)
        strips[f"a/W={ratio:g}"] = {"a_over_W": ratio, "gross": gross[1], "net": gross[1] * (1 - ratio), "error": error}
        print(f"strip a/W = {ratio}: gross {gross[1]:.7f} ({error})", flush=True)
    problem = "circular hole (radius a) in a square plate (half width W) and in a strip (half height 4 W)"
    return {"problem": problem, "parameters": KIRSCH, "squares": squares, "strips": strips}


def kirsch_square(width, elements):
    """Numbers of one square plate; displacements times E/(S a) or E/(p a) as [c0, c1] in `c0 + c1 nu`."""
    tension, pressure = [], []
    for nu in (0.0, 1 / 3):
        plate = Plate(1.0, 1.0, width, width, 1.0, nu, elements)
        u = plate.solve(outer=uniform(1.0))
        tension.append(plate.samples(u))
        pressure.append(plate.samples(plate.solve(hole=lambda x, y: (-1.0, -1.0, 0.0))))

    def linear(pair, line, quantity, i):
        low, high = (float(table[line][quantity][i]) for table in pair)
        return [low, 3 * (high - low)]

    y0, gross = tension[1]["y0"], float(tension[1]["y0"]["syy"][0])
    return {
        "gross": gross,
        "net": gross * (1 - 1 / width),
        "lowest": float(tension[1]["x0"]["sxx"][0]),
        "ligament_force_error": plate.ligament(u) / width - 1,
        "ux_rim": linear(tension, "y0", "ux", 0),
        "uy_rim": linear(tension, "x0", "uy", 0),
        "ux_edge": linear(tension, "y0", "ux", -1),
        "uy_edge": linear(tension, "x0", "uy", -1),
        "x_over_a": y0["x"],
        "sxx_y0": y0["sxx"],
        "syy_y0": y0["syy"],
        "theta": pressure[1]["rim"]["theta"],
        "pressure_hoop": pressure[1]["rim"]["hoop"] + 1.0,  # sxx + syy = hoop - p
        "pressure_ux_rim": linear(pressure, "y0", "ux", 0),
        "pressure_ux_rim_45": linear(pressure, "rim", "ux", 45),
        "pressure_ux_edge": linear(pressure, "y0", "ux", -1),
    }
