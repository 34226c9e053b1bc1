"""Rules by which the bonds of a case's materials fail."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdpetsc.body.cracks import Ends, cracks_of, cut_bonds
from pdpetsc.body.sets import Sets
from pdpetsc.bonds import Families
from pdpetsc.damage.base import Criterion
from pdpetsc.errors import InputError, at
from pdpetsc.parallel import collective
from pdpetsc.particles import Particles


@dataclass
class Rule:
    """How the bonds of one material fail.

    Attributes:
        criterion: d/d_c of each bond.
        exempt: mask of the owned and ghost particles whose bonds never fail.
        independent: whether the two directions of a pair fail each by itself.
        softening: keys of bonds that fade before they fail, or None.
        along: mask of the body's bonds that may fail if they are the material's; None: all.
    """

    criterion: Criterion
    exempt: np.ndarray
    independent: bool = False
    softening: Any = None
    along: np.ndarray | None = None


def rules_of(case, particles: Particles, families: Families, materials: list, sets: Sets) -> list[Rule | None]:
    """The rules of a case's `[damage.NAME]` tables, one for each material (collective).

    Raises:
        InputError: a criterion is not defined for its material, an exempt set is empty, or nothing may fail.
    """
    rules = []
    for name, material in zip(case.material, materials):
        keys = case.damage.get(name)
        if keys is None:
            rules.append(None)
            continue
        with collective(particles.comm.tompi4py()), at(f"damage.{name}"):  # horizons of some ranks may be wrong
            criterion = Criterion.criteria[keys.criterion].from_case(keys, material)
        exempt = np.zeros(particles.local)
        with at(f"damage.{name}"):
            for set_name in keys.exempt:
                exempt[: particles.owned] += sets[set_name]
        along = _along(keys.along, particles, families, f"damage.{name}.along") if keys.along else None
        softening, exempt = getattr(keys, "softening", None), particles.exchange.forward(exempt) > 0
        rules.append(Rule(criterion, exempt, keys.independent, softening, along))
    return rules


def _along(specs: tuple, particles: Particles, families: Families, place: str) -> np.ndarray:
    """Which bonds would be cut by one of these cracks (collective)."""
    p, mpi = particles, particles.comm.tompi4py()
    cracks = cracks_of(mpi, specs, p.dim, place)
    with collective(mpi):
        met = cut_bonds(families, Ends(p.position, p.horizon, p.id), cracks).any(axis=0)
    if not mpi.allreduce(int(met.sum())):
        raise InputError(f"{place}: meets no bond; does it lie in the body, in the same unit of length?")
    return met
