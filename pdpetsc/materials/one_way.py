"""State-based peridynamics as it was before dual horizons, for comparison (seed 002 section 2).

There a particle i feels sum over j in H_i of (T_i<xi> - T_j<-xi>) V_j with T_j<-xi> = 0 where i is not in H_j. So where
j is in H_i and i is not in H_j, j feels nothing of the force on i: a ghost force, and momentum is lost.
"""

import numpy as np
from numba import njit

from pdpetsc.materials.families import FAST, force_state, gather_two, scratch


def one_way_bonds(families, position: np.ndarray, horizon: np.ndarray, tolerance: float) -> np.ndarray:
    """Mask (bonds,) of the bonds i -> j for which i is not in the horizon of j.

    Args:
        families: of any particles.
        position, horizon: of all local particles.
        tolerance: of the horizon, as in the search of the families.
    """
    j = families.neighbours
    length = np.linalg.norm(position[j] - position[families.per_bond(np.arange(len(position)))], axis=1)
    return length > horizon[j] * (1 + tolerance)


@njit(cache=True, **FAST)
def remove_reactions(D, data, X, center, offsets, neighbours, volume, u, one_way, force, begin, end):
    """Take back what `add_force` gave the far ends of one-way bonds of the families begin ... end - 1."""
    space = scratch(D, offsets)
    for f in range(begin, end):
        i, first, last = center[f], offsets[f], offsets[f + 1]
        any_bond = False
        for b in range(first, last):
            any_bond = any_bond or one_way[b]
        if not any_bond:
            continue
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        force_state(D, data, f, first, last - first, space)
        for b in range(first, last):
            if one_way[b]:
                for p in range(len(D)):
                    force[neighbours[b], p] -= volume[i] * space.t[p, b - first]
