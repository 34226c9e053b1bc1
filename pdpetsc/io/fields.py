"""Field output: one HDF5 file with the values and one XDMF file that tells ParaView, pyvista and meshio about them."""

from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np

from pdpetsc.body.cells import Mesh
from pdpetsc.errors import InputError
from pdpetsc.io.blocks import write_field
from pdpetsc.io.shared_file import SharedFile, open_file
from pdpetsc.io.tables import whole
from pdpetsc.io.trust import check_fields
from pdpetsc.parallel import warn, written
from pdpetsc.particles import Particles
from pdpetsc.quantities import QUANTITIES
from pdpetsc.recover import Recovery

XDMF, HDF5, ASIDE = "fields.xdmf", "fields.h5", "fields.damaged"
BODY = ("position", "volume", "horizon", "spacing")
MESH = "mesh"
"""Group of the cells that particles were made of."""
REFINED = "refined"
"""Group of the bodies after refinements, each by the first step of which there are fields on it."""


class FieldWriter:
    """Writes the fields of load steps, one after the other.

    The file holds, in the order of the particles' ids, `position` (N, 3), `volume`, `horizon`, `spacing` and a group
    for each step with vectors as (N, 3) and tensors as (N, 9); of a body from a mesh, a group `mesh` of its cells. A
    refined body is in a group refined/STEP with the particles of the steps from that one on, and the ids that they were
    split from (`parent`). The file is closed between steps; `steps` has their times. One of an earlier run that cannot
    be read is set aside.

    Args:
        directory: existing result directory.
        particles: the distributed particles.
        times: times of the steps before this run, when it goes on with an earlier one: their fields are kept.
        fields: names of `quantities` that are written.
        cracked: mask of the owned particles that have lost bonds to cracks before the start.
    """

    def __init__(
        self, directory: Path, particles: Particles, times: dict[int, float], fields: tuple[str, ...],
        cracked: np.ndarray,
    ):  # fmt: skip
        self._directory = directory
        self._fields = fields
        self._particles, self._count = particles, particles.count
        self.steps: dict[int, float] = {}
        mpi = particles.comm.tompi4py()
        if times and mpi.bcast((directory / HDF5).exists()):
            earlier = mpi.bcast(self._earlier(times) if mpi.rank == 0 else None)
            if earlier is not None:
                self._keep(times, *earlier)
                return
            with written(mpi, directory / ASIDE):
                if mpi.rank == 0:
                    (directory / HDF5).replace(directory / ASIDE)
            warn(particles.comm, f"{directory / HDF5}: is damaged; it is now {ASIDE}, and a new one is begun")
        with open_file(particles.comm, directory / HDF5, "w") as file:
            self._write_body(file, "")
            if mpi.bcast(particles.mesh is not None):
                if file.file is not None:
                    write_mesh(file.file, particles.mesh)
                self._write(file, f"{MESH}/cracked", cracked.astype(np.int32))

    def _write_body(self, file: SharedFile, group: str) -> None:
        p = self._particles
        for name in BODY:
            self._write(file, group + name, getattr(p, name)[: p.owned])
        self._write(file, group + "vertex", p.id[: p.owned].astype(np.int32))
        if group:
            self._write(file, group + "parent", p.carried["parent"].astype(np.int32))

    def _earlier(self, times: dict[int, float]) -> tuple[list[str], int] | None:
        """The steps in the file of an earlier run and the number of particles of the last one that is kept; None where
        they cannot be read."""
        try:
            check_fields(self._directory / HDF5)
            with h5py.File(self._directory / HDF5, "r") as file:
                steps = written_steps(file)
                for name in steps:
                    for values in file[name].values():
                        values[:1]
                return steps, len(file[body_of(file, max(times)) + "position"])
        except (InputError, OSError, RuntimeError, LookupError):  # of h5py, whatever it trips over
            return None

    def _keep(self, times: dict[int, float], steps: list[str], count: int) -> None:
        """Keep the steps of an earlier run up to its checkpoint and drop later ones."""
        with open_file(self._particles.comm, self._directory / HDF5, "r+") as shared:
            file = shared.file
            if file is not None:
                later = [name for name in steps if int(name) not in times]
                bodies = [f"{REFINED}/{name}" for name in file.get(REFINED, ()) if int(name) > max(times)]
                for name in later + bodies:
                    del file[name]
        self._count = count
        self.steps = {int(name): times[int(name)] for name in steps if int(name) in times}

    def write(self, particles: Particles, step: int, time: float, recovery: Recovery) -> None:
        """Append a step, and its particles if the body has been refined since the last one (collective).

        Raises:
            OutputError: it cannot be written; the file is what it was.
        """
        self._particles = particles
        if step not in self.steps:
            with open_file(particles.comm, self._directory / HDF5, "r+") as file:
                if particles.count != self._count:
                    self._write_body(file, f"{REFINED}/{step:05d}/")
                for name in self._fields:
                    self._write(file, f"{step:05d}/{name}", recovery.field(name))
            self._count, self.steps[step] = particles.count, time
        with written(particles.comm.tompi4py(), self._directory / XDMF):
            if particles.comm.rank == 0:
                self._write_description()

    def _write_description(self) -> None:
        with h5py.File(self._directory / HDF5, "r") as file:
            bodies = {step: body_of(file, step) for step in self.steps}
            counts = {group: len(file[group + "position"]) for group in set(bodies.values())}
        tree = _xdmf(self.steps, bodies, counts, self._fields)
        ElementTree.indent(tree)
        with whole(self._directory / XDMF) as file:
            file.write(ElementTree.tostring(tree, xml_declaration=True).decode())

    def _write(self, file: SharedFile, name: str, values: np.ndarray) -> None:
        p = self._particles
        write_field(file, name, p.directory, p.count, _for_visualisation(values))


def written_steps(file: h5py.File) -> list[str]:
    """The groups of steps in a field file, in order."""
    return sorted((name for name in file if name.isdigit()), key=int)


def body_of(file: h5py.File, step: int) -> str:
    """The group, with a slash, that holds the particles of a step."""
    names = [name for name in file.get(REFINED, ()) if int(name) <= step]
    return f"{REFINED}/{max(names, key=int)}/" if names else ""


def write_mesh(file: h5py.File, mesh: Mesh) -> None:
    """Add a mesh to a field file: `points` (points, dim), `cells` and `particle` as in Mesh, `on` as an attribute."""
    group = file.create_group(MESH)
    group.attrs["on"] = mesh.on
    group["points"] = mesh.points
    group["cells"], group["particle"] = (values.astype(np.int32) for values in (mesh.cells, mesh.particle))


def read_mesh(file: h5py.File) -> Mesh | None:
    """That of a field file; None: its particles are no cells or points of a mesh."""
    if MESH not in file:
        return None
    group = file[MESH]
    return Mesh(*(group[name][...] for name in ("points", "cells", "particle")), group.attrs["on"])


def _for_visualisation(values: np.ndarray) -> np.ndarray:
    """Vectors with three components and tensors with nine."""
    if values.ndim == 3:
        return values.reshape(len(values), 9)
    if values.ndim == 2:
        return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
    return values


_KINDS = {0: ("Scalar", ""), 1: ("Vector", " 3"), 2: ("Tensor", " 9")}


def _xdmf(steps: dict[int, float], bodies: dict, counts: dict, fields: tuple[str, ...]) -> ElementTree.Element:
    """An XDMF 3 temporal collection of point clouds.

    Args:
        steps: their times.
        bodies: group of each step's particles.
        counts: of each group.
    """
    root = ElementTree.Element("Xdmf", Version="3.0")
    domain = ElementTree.SubElement(root, "Domain")
    collection = ElementTree.SubElement(
        domain, "Grid", Name="pdpetsc", GridType="Collection", CollectionType="Temporal"
    )

    def item(parent, name, dimensions, kind="Float", precision="8"):
        data = ElementTree.SubElement(
            parent, "DataItem", Dimensions=dimensions, NumberType=kind, Precision=precision, Format="HDF"
        )
        data.text = f"{HDF5}:/{name}"

    times = list(steps.values())
    ascending = all(before < after for before, after in pairwise(times))
    for step, time in steps.items():
        body, count = bodies[step], counts[bodies[step]]
        grid = ElementTree.SubElement(collection, "Grid", Name=f"step {step}", GridType="Uniform")
        # Readers want times to ascend, which those along a path need not.
        ElementTree.SubElement(grid, "Time", Value=repr(time if ascending else float(step)))
        topology = ElementTree.SubElement(
            grid, "Topology", TopologyType="Polyvertex", NumberOfElements=str(count), NodesPerElement="1"
        )
        item(topology, f"{body}vertex", f"{count} 1", "Int", "4")
        geometry = ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ")
        item(geometry, f"{body}position", f"{count} 3")
        for name, path in [
            *((n, body + n) for n in BODY[1:]),
            *((n, f"{step:05d}/{n}") for n in fields),
        ]:
            kind, columns = _KINDS[QUANTITIES[name].rank if name in QUANTITIES else 0]
            attribute = ElementTree.SubElement(grid, "Attribute", Name=name, AttributeType=kind, Center="Node")
            item(attribute, path, f"{count}{columns}")
    return root
