"""Fields of a converged state, on this rank's owned particles."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from pdpetsc.assembly import Assembler
from pdpetsc.quantities import principal, von_mises


class Recovery:
    """Fields at one state, computed when asked for.

    Args:
        assembler: of the body, with the loads of the state's time.
        u, v: (owned, dim) displacement and velocity; None: at rest.
        reached: (owned,) volume within the horizon of each particle, of the whole body as it was without any crack;
            None: of the bonds that there were at first.
    """

    def __init__(
        self, assembler: Assembler, u: np.ndarray, reached: np.ndarray | None = None, v: np.ndarray | None = None
    ):
        self._assembler = assembler
        self.u, self.v = u, np.zeros_like(u) if v is None else v
        self._reached = reached

    def field(self, name: str) -> np.ndarray:
        """(owned, ...) values of a field of FIELDS; collective."""
        return FIELDS[name](self)

    @cached_property
    def local(self) -> np.ndarray:
        """(local, dim) displacements with ghosts."""
        return self._assembler.localise(self.u)

    def _of_families(self, method: str, shape: tuple[int, ...]) -> np.ndarray:
        """A quantity that each material gives for its own families."""
        out = np.zeros((self._assembler.particles.owned, *shape))
        for material in self._assembler.materials:
            out[material.families.center] = getattr(material, method)(self.local)
        return out

    @cached_property
    def displacement_gradient(self) -> np.ndarray:
        """H of each family, (owned, 3, 3)."""
        return self._of_families("displacement_gradient", (3, 3))

    @property
    def deformation_gradient(self) -> np.ndarray:
        """F = I + H, (owned, 3, 3)."""
        return np.eye(3) + self.displacement_gradient

    @cached_property
    def stress(self) -> np.ndarray:
        """Cauchy stress, (owned, 3, 3) [force/area]."""
        return self._of_families("cauchy_stress", (3, 3))

    @cached_property
    def first_piola(self) -> np.ndarray:
        """First Piola-Kirchhoff stress P = J sigma F^-T of each family, with linear kinematics sigma, (owned, 3, 3)
        [force/area]; J F^-T are the cofactors of F, which every F has."""
        F = self.deformation_gradient
        for material in self._assembler.materials:
            if material.linear:
                F[material.families.center] = np.eye(3)
        cofactor = np.stack([np.cross(F[:, k - 2], F[:, k - 1]) for k in range(3)], axis=1)
        return self.stress @ cofactor

    @cached_property
    def dilatation(self) -> np.ndarray:
        """J - 1 = tr H + (tr^2 H - tr H^2)/2 + det H, (owned,); no digits of small strains are lost."""
        H = self.displacement_gradient
        trace = np.trace(H, axis1=1, axis2=2)
        return trace + (trace**2 - np.einsum("npq,nqp->n", H, H)) / 2 + np.linalg.det(H)

    @cached_property
    def peridynamic_stress(self) -> np.ndarray:
        """Mean of the Lehoucq-Silling stress over each particle's cell (materials/flux.py), (owned, 3, 3) [force/area];
        in directions that the body does not have as linear elasticity has it."""
        p = self._assembler.particles
        virial = np.zeros((p.local, p.dim, p.dim))
        for material in self._assembler.materials:
            material.add_virial(self.local, virial)
        stress = np.zeros((p.owned, 3, 3))
        stress[:, : p.dim, : p.dim] = p.exchange.reverse_add(virial)[: p.owned] / p.volume[: p.owned, None, None]
        for material in self._assembler.materials:
            own = stress[material.families.center]
            material.add_normal_stress(own)
            stress[material.families.center] = own
        return stress

    def crossing_forces(self, beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the particles of a mask (local,) exert on the others through each bond of the owned families between
        them: forces (n, dim), where the bonds' neighbours are (n, dim), and the local particles i and j (n, 2)."""
        found, X = [], self._assembler.particles.position
        for material in self._assembler.materials:
            force, bond = material.crossing_forces(self.local, beyond)
            j = bond[:, 1]
            found.append((force, X[j] if material.linear else X[j] + self.local[j], bond))
        return tuple(np.concatenate(parts) for parts in zip(*found))

    @cached_property
    def strain(self) -> np.ndarray:
        """Logarithmic strain 1/2 ln(F F^T), (owned, 3, 3); NaN where F is not finite, as in a shattered family."""
        H = self.displacement_gradient
        T = H.transpose(0, 2, 1)
        square = H + T + H @ T
        finite = np.isfinite(square).all(axis=(1, 2))
        values, vectors = np.linalg.eigh(square[finite])
        strain = np.full_like(H, np.nan)
        strain[finite] = np.einsum("npa,na,nqa->npq", vectors, 0.5 * np.log1p(np.maximum(values, -1.0)), vectors)
        return strain

    @cached_property
    def family_energy(self) -> np.ndarray:
        """Stored energy of each family [energy]."""
        return self._of_families("energy", ())

    @cached_property
    def damage(self) -> np.ndarray:
        """phi = 1 - sum mu V_j / sum V_j of each family, mu = 0 for cut and broken bonds (seed 004 Eq. 2.21)."""
        p = self._assembler.particles
        bonded, reached = np.zeros(p.owned), np.zeros(p.owned)
        for material in self._assembler.materials:
            families = material.families
            volume = p.volume[families.neighbours]
            reached[families.center] = families.sums(volume)
            bonded[families.center] = families.sums(volume if material.intact is None else volume * material.intact)
        return 1 - bonded / (reached if self._reached is None else self._reached)

    @property
    def energy_density(self) -> np.ndarray:
        """Stored energy per reference volume [energy/volume]."""
        return self.family_energy / self._assembler.particles.volume[: len(self.u)]

    @cached_property
    def external(self) -> np.ndarray:
        """External force on each particle, (owned, dim) [force]."""
        return self._assembler.external_force(self.u)

    @cached_property
    def _unbalanced(self) -> np.ndarray:
        return self._assembler.unbalanced_force(self.u)

    @property
    def reaction(self) -> np.ndarray:
        """Force that the support puts on each constrained component, zero elsewhere [force]."""
        return np.where(self._assembler.constrained, self._unbalanced, 0.0)

    def balance(self) -> dict[str, float]:
        """Sums of external forces, reactions and their moments in the deformed state, with linear kinematics in the
        undeformed one, relative to the sums of their absolute values: zero to rounding in equilibrium (collective)."""
        p = self._assembler.particles
        loads = np.zeros((p.owned, 3))
        loads[:, : p.dim] = self.external + self.reaction
        x = np.zeros((p.owned, 3))
        linear = all(material.linear for material in self._assembler.materials)
        x[:, : p.dim] = p.position[: p.owned] + (0.0 if linear else self.u)
        moments = np.cross(x, loads)
        sizes = [np.abs(loads).sum(), (np.linalg.norm(x, axis=1) * np.linalg.norm(loads, axis=1)).sum()]
        mpi = self._assembler.mpi
        sums = mpi.allreduce(np.concatenate([loads.sum(axis=0), moments.sum(axis=0), sizes]))
        force, moment, force_size, moment_size = sums[:3], sums[3:6], sums[6] or 1.0, sums[7] or 1.0
        return {
            "force": float(np.linalg.norm(force) / force_size),
            "moment": float(np.linalg.norm(moment) / moment_size),
        }


FIELDS: dict[str, Callable[[Recovery], np.ndarray]] = {
    "u": lambda r: r.u,
    "v": lambda r: r.v,
    "F": lambda r: r.deformation_gradient,
    "stress": lambda r: r.stress,
    "strain": lambda r: r.strain,
    "energy": lambda r: r.energy_density,
    "reaction": lambda r: r.reaction,
    "force": lambda r: r.external,
    "von_mises": lambda r: von_mises(r.stress),
    "principal": lambda r: principal(r.stress),
    "dilatation": lambda r: r.dilatation,
    "damage": lambda r: r.damage,
    "peridynamic_stress": lambda r: r.peridynamic_stress,
}
"""How the fields of `quantities` are computed."""
