"""Surface correction by direction (seed 000 Eq. 83-91; Madenci and Oterkus 2014, Peridynamic Theory, chapter 4).

A family that a surface cuts has too few bonds, and not equally so in all directions. A strain e_p = 1 in one coordinate
direction p, with none across, extends a bond by e = xi_p^2/|xi|, and should give

    sum c e = theta_CM = 1,    sum k e^2 = 2 W_CM - A,

where W_CM = (lambda + 2 mu)/2 is the energy of the solid and A/2 the part of it that a dilatation of 1 has: with A of
K' - (n + 2) mu/n, 3 mu is left for the bonds. Without a dilatation it is 3 n K'/(n + 2), that of the full horizon.
(Seed 000 Eq. 88 takes the part of the dilatation from the numerator W_CM, but not from the denominator W_PD; W_CM/W_PD
as a whole would let bonds pay for a dilatation that G_d has put right.) A particle has as factors what should be over
what is,

    G_d,p = theta_CM/theta_PD,    G_b,p = (2 W_CM - A)/(sum k e^2);

a bond takes in each direction the mean of those of its two ends, and along its own direction n the radius of the
ellipsoid with these half axes, G(n) = [sum_p (n_p/G_p)^2]^(-1/2): c is multiplied by G_d(n), k by G_b(n).
"""

import numpy as np

from pdpetsc.materials import sums
from pdpetsc.materials.base import Neighbourhood
from pdpetsc.materials.families import dimension

SMALLEST_SUM = 1e-6
"""Share of what should be below which a family has no bonds in a direction: there is nothing to be corrected then."""


def direction_factors(part: Neighbourhood, values: np.ndarray, power: int, target: float) -> np.ndarray:
    """The factor G(n) of each bond that brings the sums over its family nearer to `target` (all ranks together).

    A neighbour in another material has no factor; the bond takes those of its own end.

    Args:
        part: the particles and families; its `forward` brings the factors of ghosts.
        values: c or k of each bond.
        power: of e in the sum, 1 for c and 2 for k.
        target: what sum values e^power should be.

    Returns:
        (bonds,) factors [-].
    """
    D, bonds = dimension(part.dim), part.bonds()
    found = np.zeros((len(part.families), part.dim))
    sums.stretch_moments(D, part.position, *bonds, values, power, found)
    own = np.ones_like(found)
    np.divide(target, found, out=own, where=found > SMALLEST_SUM * target)
    factors = np.full(part.position.shape, np.nan)
    factors[part.families.center] = own
    result = np.empty(len(values))
    sums.between_ends(D, part.position, *bonds, part.forward(factors), result)
    return result
