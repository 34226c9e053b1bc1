"""A load and a material of one's own: a strip with fibres that spins about its left end."""

import numpy as np

import pdpetsc
from pdpetsc.materials.base import Keys, Positive
from pdpetsc.materials.ordinary import Moduli, Ordinary, scaled_to


class Spin(pdpetsc.Load):
    """Centrifugal force of a body that spins about the z axis: f = density omega^2 X V, times the value."""

    name = "spin"

    class Keys(Keys):
        density: Positive
        omega: Positive

    def __init__(self, site, spec):
        super().__init__(site, spec)
        self._factor = spec.density * spec.omega**2

    def add(self, time, external):
        s = self.site
        external[s.members] += (self._factor * s.values(time) * s.volume)[:, None] * s.position


class FibreSheet(Ordinary):
    """Bonds are stiffer along the fibres, which lie along x (docs/developers.md explains it)."""

    name = "fibre_sheet"

    class Keys(Keys):
        E: Positive
        stiffening: Positive

    def __init__(self, part, young, stiffening):
        families, X = part.families, part.position
        xi, length = X[families.neighbours] - families.per_bond(X), families.lengths(X)
        matrix = Moduli.of(young, 1 / 3, "stress", part.dim)
        k = scaled_to(part, part.weight * part.volume[families.neighbours] / length, 2, 4 * matrix.bulk)
        super().__init__(part, matrix, k * (1 + stiffening * (xi[:, 0] / length) ** 4))

    @classmethod
    def from_case(cls, keys, part):
        return cls(part, keys.E, keys.stiffening)


L, WIDTH, YOUNG, DENSITY, OMEGA = 100.0, 30.0, 1000.0, 1e-3, 0.2
STRIP = {
    "body": {"size": [L, WIDTH], "spacing": 1.0, "origin": [0.0, -WIDTH / 2], "horizon": 3.015},
    "sets": {"hub": "X < spacing"},
    "material": {"sheet": {"model": "fibre_sheet", "E": YOUNG, "stiffening": 1e-12}},
    "load": [
        {"kind": "displacement", "set": "hub", "component": "all", "value": 0.0},
        {"kind": "spin", "set": "all", "value": "t", "density": DENSITY, "omega": OMEGA},
    ],
    "solver": {"steps": 1},
    "probe": [
        {"name": "tip", "field": "u", "component": "x", "at": [L - 0.5, -0.5]},
        {"name": "pull", "field": "reaction", "component": "x", "set": "hub", "reduce": "sum"},
    ],
}

plain = pdpetsc.solve(pdpetsc.load(STRIP))
fibres = pdpetsc.solve(pdpetsc.load(STRIP, {"material.sheet.stiffening": 4.0}))

force = DENSITY * OMEGA**2 * WIDTH * L**2 / 2  # what the hub holds, exact on the lattice too
tip = DENSITY * OMEGA**2 * L**3 / (3 * YOUNG)  # of a slender bar; edges of a coarse lattice are stiffer
if plain.comm.rank == 0:
    print(f"hub: {plain.history('pull')[-1]:.9g}, exact {-force:.9g}")
    print(f"tip: {plain.history('tip')[-1]:.5f}, bar {tip:.5f}; with fibres {fibres.history('tip')[-1]:.5f}")
assert np.isclose(plain.history("pull")[-1], -force, rtol=1e-8)
assert np.isclose(fibres.history("pull")[-1], -force, rtol=1e-8)
assert np.isclose(plain.history("tip")[-1], tip, rtol=0.1)
assert fibres.history("tip")[-1] < 0.5 * plain.history("tip")[-1]
