"""Named parts of a body's surface: the faces of the box, and what conditions choose of them and of fitted borders."""

import numpy as np

from pdpetsc.body.border import BORDER
from pdpetsc.body.box import FACES, coordinates
from pdpetsc.expressions import NAMES
from pdpetsc.particles import Facets


def on_surface(facets: Facets, spacing: np.ndarray, name: str, surfaces: dict) -> np.ndarray:
    """Mask of the facets that belong to a surface.

    Args:
        facets: any.
        spacing: of the particle that each belongs to.
        name: a face of the box, "border" of `keep` where particles are fitted to it, or one of the surfaces.
        surfaces: `[surfaces]` of the case, with conditions of X, Y, Z, the normal's NX, NY, NZ and spacing.
    """
    if name == "border":
        return facets.face == BORDER
    if name in FACES:
        return facets.face == list(FACES).index(name)
    return surfaces[name].where.mask(**facet_coordinates(facets, spacing))


def facet_coordinates(facets: Facets, spacing: np.ndarray) -> dict[str, np.ndarray]:
    """The variables of expressions on a surface: X, Y, Z, the outward normal NX, NY, NZ, and the spacing."""
    normal = facets.area / np.linalg.norm(facets.area, axis=1, keepdims=True)
    return coordinates(facets.position, spacing) | {f"N{name}": n for name, n in zip(NAMES, normal.T)}
