"""Named parts of a body's surface: the faces of the box, and what conditions choose of them and of fitted borders; the
border of a mesh, and what conditions and groups of the mesh choose of it."""

import numpy as np

from pdpetsc.body.border import BORDER, GROUP_BIT
from pdpetsc.body.box import FACES, coordinates
from pdpetsc.expressions import NAMES
from pdpetsc.particles import Facets


def on_surface(facets: Facets, spacing: np.ndarray, name: str, surfaces: dict) -> np.ndarray:
    """Mask of the facets that belong to a surface.

    Args:
        facets: any.
        spacing: of the particle that each belongs to.
        name: a face of the box, "border" of `keep` where particles are fitted to it, or of a mesh; or one of the
            surfaces.
        surfaces: `[surfaces]` of the case, with conditions of X, Y, Z, the normal's NX, NY, NZ and spacing, or groups.
    """
    if name in surfaces and surfaces[name].group is not None:
        groups = [other for other, surface in surfaces.items() if surface.group is not None]
        return facets.face >> (GROUP_BIT + groups.index(name)) & 1 == 1
    if name in surfaces:
        return surfaces[name].where.mask(**facet_coordinates(facets, spacing))
    face = facets.face & (1 << GROUP_BIT) - 1
    return face == (BORDER if name == "border" else list(FACES).index(name))


def facet_coordinates(facets: Facets, spacing: np.ndarray) -> dict[str, np.ndarray]:
    """The variables of expressions on a surface: X, Y, Z, the outward normal NX, NY, NZ, and the spacing."""
    normal = facets.area / np.linalg.norm(facets.area, axis=1, keepdims=True)
    return coordinates(facets.position, spacing) | {f"N{name}": n for name, n in zip(NAMES, normal.T)}
