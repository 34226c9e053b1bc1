"""Linear elasticity of the bracket by quadratic tetrahedra on the meshes of the bundled case (numpy, scipy, meshio,
scikit-fem); see `scripts/references`.

The bolts do not move, the traction on the bore is uniform. Means are taken over the cells that the case's sets hold, so
that they are those of its probes."""

from pathlib import Path

import meshio
import numpy as np
import skfem
from scipy.sparse import diags
from scipy.sparse.linalg import cg
from skfem.models.elasticity import lame_parameters, linear_elasticity

CASES = Path(__file__).resolve().parent.parent / "pdpetsc" / "cases"
BRACKET = {"E": 210e3, "nu": 0.3, "traction": -8.0, "top": 68.0}
"""[MPa], traction along z on the bore [MPa], above which height [mm] the top is."""


def bracket(name: str) -> dict:
    """Mean displacements, strain energy and load on one of the meshes."""
    mesh, groups = _read(CASES / f"{name}.msh")
    element = skfem.ElementVector(skfem.ElementTetP2())
    basis = skfem.Basis(mesh, element)
    K = linear_elasticity(*lame_parameters(BRACKET["E"], BRACKET["nu"])).assemble(basis)
    rim = skfem.FacetBasis(mesh, element, facets=groups["bore"])
    f = BRACKET["traction"] * skfem.LinearForm(lambda v, w: v[2]).assemble(rim)
    u = np.zeros(basis.N)
    free = basis.complement_dofs(basis.get_dofs(elements=groups["bolts"]))
    inner = K[free][:, free].tocsr()
    u[free], failed = cg(inner, f[free], rtol=1e-8, maxiter=20000, M=diags(1 / inner.diagonal()))
    assert not failed

    def mean(cells, component):
        part = skfem.Basis(mesh, element, elements=cells)
        value = skfem.Functional(lambda w: w.u[component]).assemble(part, u=part.interpolate(u))
        return value / skfem.Functional(lambda w: 1.0 + 0 * w.x[0]).assemble(part)

    top = np.flatnonzero(mesh.p[2, mesh.t].mean(axis=0) > BRACKET["top"])
    bore = np.unique(mesh.f2t[0, groups["bore"]])
    return {
        "unknowns": int(basis.N),
        "top": [float(mean(top, k)) for k in range(3)],
        "bore": [float(mean(bore, k)) for k in range(3)],
        "energy": float(0.5 * u @ f),
        "load": float(f.sum()),
    }


def _read(path: Path) -> tuple[skfem.MeshTet, dict]:
    """Tetrahedra, the cells of the bolts and the facets of the bore."""
    file = meshio.read(path)
    tags = zip(file.cells, file.cell_data["gmsh:physical"])
    blocks = [(block.type, block.data, values) for block, values in tags]
    tetrahedra, of = (np.concatenate([b[k] for b in blocks if b[0] == "tetra"]) for k in (1, 2))
    triangles = np.concatenate([b[1] for b in blocks if b[0] == "triangle"])
    used, cells = np.unique(tetrahedra, return_inverse=True)
    mesh = skfem.MeshTet(file.points[used].T.copy(), cells.reshape(tetrahedra.shape).T.copy())
    numbers = {tuple(facet): k for k, facet in enumerate(np.sort(mesh.facets.T, axis=1))}
    bore = [numbers[tuple(facet)] for facet in np.sort(np.searchsorted(used, triangles), axis=1)]
    bolts = np.flatnonzero(of == file.field_data["bolts"][0])
    return mesh, {"bolts": bolts, "bore": np.array(bore)}
