"""Whole runs against a textbook program: every pair of particles looked at, forces as printed, differences for Newton.

It shares nothing with the package. Where the choices are the same (influence, partial volume, horizon tolerance, no
surface correction), displacement fields must agree to 1e-9 of the largest one, intact and pre-cracked.
"""

import h5py
import numpy as np
import pytest

pytestmark = pytest.mark.mpi

E, FACTOR = 2.0e5, 2.6


def points(counts, spacing=1.0):
    axes = [spacing * (np.arange(n) + 0.5) for n in counts]
    return np.stack([a.ravel(order="F") for a in np.meshgrid(*axes, indexing="ij")], axis=1)


class Textbook:
    """Bond-based (PMB) and linear peridynamic solids with one horizon, all pairs in dense arrays."""

    def __init__(self, X, delta, model, nu, plane, crossed, switches, influence, partial=False):
        self.X, self.dim, self.model = X, X.shape[1], model
        xi = X[None] - X[:, None]
        length = np.sqrt((xi**2).sum(axis=2))
        reach = delta * (1 + switches.get("horizon_tolerance", 0.0))
        bonded = (length > 0) & (length <= reach) & ~crossed(X[:, None], X[None])
        self.xi, self.length = xi, np.where(length > 0, length, 1.0)
        self.w = np.where(bonded, influence(self.length / delta), 0.0)
        if partial:
            self.w *= np.clip(delta + 0.5 - self.length, 0, 1)
        mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
        if plane == "stress":
            lame = 2 * lame * mu / (lame + 2 * mu)
        self.mu, self.K = mu, lame + 2 * mu / self.dim
        self.delta, self.switches = delta, switches
        self.c = {2: 12 * self.K / (np.pi * delta**3), 3: 18 * self.K / (np.pi * delta**4)}[self.dim]
        self.m = (self.w * self.length**2).sum(axis=1)[:, None]

    def force(self, u):
        """On every particle, (n, dim); u may be complex."""
        y = self.xi + u[None] - u[:, None]
        stretched = np.sqrt((y**2).sum(axis=2) + np.eye(len(u)))
        e = stretched - self.length
        n, L, w = self.dim, self.length, self.w
        if self.model == "bond":
            k = 0.5 * self.c * w / L
            if self.switches.get("microelastic") == "general":
                k = {2: 8 * self.K / (np.pi * self.delta**4), 3: 11.25 * self.K / (np.pi * self.delta**5)}[n] * w
            if self.switches.get("surface_correction") == "energy":
                k = k * n**2 * self.K / (k * L**2).sum(axis=1)[:, None]
            states = (k * e / stretched)[..., None] * y
            return (states - np.swapaxes(states, 0, 1)).sum(axis=1)
        if self.model == "abd":  # in 2D
            a, d = (self.K - 2 * self.mu) / 2, 2 / (np.pi * self.delta**3)
            b, s = 6 * self.mu / (np.pi * self.delta**4), e / L
            cosine = (y * self.xi).sum(axis=2) / (stretched * L)
            theta = d * self.delta * (w * s * cosine).sum(axis=1)[:, None]
            states = (2 * self.delta * w * (d * a * theta * cosine / L + b * s) / stretched)[..., None] * y
            return (states - np.swapaxes(states, 0, 1)).sum(axis=1)
        theta = n / self.m * (self.w * self.length * e).sum(axis=1)[:, None]
        t = n * self.K * theta / self.m * self.w * self.length
        t = t + n * (n + 2) * self.mu / self.m * self.w * (e - theta * self.length / n)
        states = (t / stretched)[..., None] * y
        return (states - np.swapaxes(states, 0, 1)).sum(axis=1)

    def solve(self, held, values, load):
        u = np.zeros_like(self.X)
        u[held] = values[held]
        free = np.flatnonzero(~held.ravel())
        for _ in range(12):
            residual = (self.force(u) + load).ravel()[free]
            K = np.empty((len(free), len(free)))
            for column, entry in enumerate(free):
                moved = u.astype(complex)
                moved.ravel()[entry] += 1e-30j
                K[:, column] = self.force(moved).ravel()[free].imag / 1e-30
            step = np.linalg.solve(K, -residual)
            u.ravel()[free] += step
            if np.abs(step).max() < 1e-14 * np.abs(u).max():
                return u
        raise AssertionError("the textbook program does not converge")


def crack_2d(a, b):
    """Whether bonds cross the line from (0, 3) to (4.2, 3)."""
    below, above = a[..., 1] - 3, b[..., 1] - 3
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[..., 0] + below / (below - above) * (b[..., 0] - a[..., 0])
    return (below * above < 0) & (x <= 4.2)


def crack_3d(a, b):
    """Whether bonds cross the rectangle 0 < x, y < 2.2 at z = 2."""
    below, above = a[..., 2] - 2, b[..., 2] - 2
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[..., :2] + (below / (below - above))[..., None] * (b[..., :2] - a[..., :2])
    return (below * above < 0) & np.all(at <= 2.2, axis=-1)


CRACKS = {
    2: ({"from": [-1.0, 3.0], "to": [4.2, 3.0]}, crack_2d),
    3: ({"polygon": [[-1.0, -1.0, 2.0], [2.2, -1.0, 2.0], [2.2, 2.2, 2.0], [-1.0, 2.2, 2.0]]}, crack_3d),
}
CASES = [
    (model, dim, plane, cracked, "constant", "none", {})
    for model in ("bond", "ordinary")
    for dim, plane in ((2, "stress"), (2, "strain"), (3, "strain"))
    for cracked in (False, True)
] + [
    ("ordinary", 2, "stress", True, "linear", "linear", {}),
    ("bond", 3, "strain", True, "constant", "linear", {}),
    ("bond", 2, "stress", True, "constant", "none", {"microelastic": "general"}),
    ("bond", 3, "strain", False, "constant", "none", {"microelastic": "general"}),
    ("bond", 2, "strain", True, "constant", "none", {"surface_correction": "energy"}),
    ("abd", 2, "stress", True, "constant", "none", {}),
    ("abd", 2, "strain", False, "constant", "none", {"horizon_tolerance": -0.09}),
    ("ordinary", 2, "stress", False, "constant", "none", {"horizon_tolerance": 0.09}),
]


@pytest.mark.parametrize(
    ("model", "dim", "plane", "cracked", "influence", "partial", "switches"), CASES, ids=lambda value: str(value)
)
def test_displacements_agree(comm, run, model, dim, plane, cracked, influence, partial, switches):
    """Pulled apart by 3 % at one end with a shear, at strains where the nonlinearity counts."""
    counts = {2: (9, 6), 3: (4, 4, 4)}[dim]
    nu = (1 / 3 if plane == "stress" else 1 / 4) if model == "bond" else 0.3
    X = points(counts)
    axis, end = dim - 1, counts[-1]
    low, high = X[:, axis] < 1, X[:, axis] > end - 1
    held, values = np.zeros(X.shape, bool), np.zeros(X.shape)
    held[low | high] = True
    values[high, axis], values[high, 0] = 0.03 * end, 0.02 * end
    load = np.zeros(X.shape)
    load[:, 0] = 1e-3 * E / len(X)
    crack, crossed = CRACKS[dim] if cracked else (None, lambda a, b: np.zeros(np.broadcast(a, b).shape[:-1], bool))
    book = Textbook(
        X, FACTOR, model, nu, plane, crossed, switches,
        {"constant": np.ones_like, "linear": lambda r: 1 - r}[influence], partial == "linear",
    )  # fmt: skip
    expected = book.solve(held, values, load)

    name = "XYZ"[axis]
    tolerance = {key: value for key, value in switches.items() if key == "horizon_tolerance"}
    document = {
        "body": {"size": [float(n) for n in counts], "spacing": 1.0, "horizon": FACTOR, **tolerance},
        "sets": {"low": f"{name} < 1", "high": f"{name} > {end - 1}"},
        "material": {
            "solid": {
                "model": model, "E": E, "nu": nu, "plane": plane, "influence": influence, "partial_volume": partial,
                "quadrature": "plain", **{k: v for k, v in switches.items() if k != "horizon_tolerance"},
            }
        },
        "load": [
            {"kind": "body_force", "set": "all", "component": "x", "value": f"{1e-3 * E / len(X)!r} * t"},
            {"kind": "displacement", "set": "low", "component": "all", "value": 0.0},
            {"kind": "displacement", "set": "high", "component": "all", "value": 0.0},
            {"kind": "displacement", "set": "high", "component": "x", "value": f"{0.02 * end} * t"},
            {"kind": "displacement", "set": "high", "component": "xyz"[axis], "value": f"{0.03 * end} * t"},
        ],
        "solver": {"steps": 1},
        "petsc": {"snes_rtol": 1e-13},
    }  # fmt: skip
    if cracked:
        document["body"]["cracks"] = [crack]
    result = run(document)
    assert result.code == 0
    bonds = int((book.w > 0).sum()) if influence == "constant" else None
    if comm.rank == 0:
        with h5py.File(result.out / "fields.h5", "r") as file:
            position, u = file["position"][:, :dim], file["00001/u"][:, :dim]
        assert np.array_equal(position, X)
        assert np.abs(u - expected).max() < 1e-9 * np.abs(expected).max()
        choices = result.summary["choices"]
        assert bonds in (None, result.summary["bonds"])
        solid = choices["materials"]["solid"]
        assert (choices["cracks"] == 1) == (sum(choices["cut_bonds"]) > 0) == cracked
        expected_choices = {
            "model": model, "influence": influence, "partial_volume": partial, "quadrature": "plain",
            "surface_correction": switches.get("surface_correction", "none"), "kinematics": "nonlinear",
            "unmatched_families": 0,
        }  # fmt: skip
        assert solid.items() >= expected_choices.items()
        assert solid.get("plane") == (plane if dim == 2 else None)
