"""Field output: one HDF5 file with the values and one XDMF file that tells ParaView, pyvista and meshio about them."""

from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np

from pdpetsc.io.blocks import open_file, write_field
from pdpetsc.particles import Particles
from pdpetsc.quantities import QUANTITIES
from pdpetsc.recover import Recovery

XDMF, HDF5 = "fields.xdmf", "fields.h5"


class FieldWriter:
    """Writes the fields of load steps, one after the other.

    The file holds, in the order of the particles' ids, `position` (N, 3), `volume`, `horizon`, `spacing` and a group
    for each step with vectors as (N, 3) and tensors as (N, 9). It is closed between steps; `steps` has their times.

    Args:
        directory: existing result directory.
        particles: the distributed particles.
        times: times of the steps before this run, when it goes on with an earlier one: their fields are kept.
        fields: names of `quantities` that are written.
    """

    def __init__(self, directory: Path, particles: Particles, times: dict[int, float], fields: tuple[str, ...]):
        self._directory = directory
        self._fields = fields
        self._particles = particles
        self.steps: dict[int, float] = {}
        p = particles
        if times and (directory / HDF5).exists():
            self._keep(times)
            return
        with open_file(p.comm, directory / HDF5, "w") as file:
            for name in ("position", "volume", "horizon", "spacing"):
                self._write(file, name, getattr(p, name)[: p.owned])
            self._write(file, "vertex", p.id[: p.owned].astype(np.int32))

    def _keep(self, times: dict[int, float]) -> None:
        """Keep the steps of an earlier run up to its checkpoint and drop later ones."""
        with open_file(self._particles.comm, self._directory / HDF5, "a") as file:
            written = written_steps(file) if file is not None else []
            for name in written:
                if int(name) not in times:
                    del file[name]
        written = self._particles.comm.tompi4py().bcast(written)
        self.steps = {int(name): times[int(name)] for name in written if int(name) in times}

    def write(self, step: int, time: float, recovery: Recovery) -> None:
        """Append a step (collective)."""
        with open_file(self._particles.comm, self._directory / HDF5, "a") as file:
            for name in self._fields:
                self._write(file, f"{step:05d}/{name}", recovery.field(name))
        self.steps[step] = time
        if self._particles.comm.rank == 0:
            tree = ElementTree.ElementTree(_xdmf(self._particles.count, self.steps, self._fields))
            ElementTree.indent(tree)
            tree.write(self._directory / XDMF, xml_declaration=True)

    def _write(self, file, name: str, values: np.ndarray) -> None:
        p = self._particles
        write_field(p.comm, file, name, p.directory, p.count, _for_visualisation(values))


def written_steps(file: h5py.File) -> list[str]:
    """The groups of steps in a field file, in order."""
    return sorted((name for name in file if name.isdigit()), key=int)


def _for_visualisation(values: np.ndarray) -> np.ndarray:
    """Vectors with three components and tensors with nine."""
    if values.ndim == 3:
        return values.reshape(len(values), 9)
    if values.ndim == 2:
        return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
    return values


_KINDS = {0: ("Scalar", ""), 1: ("Vector", " 3"), 2: ("Tensor", " 9")}


def _xdmf(count: int, steps: dict[int, float], fields: tuple[str, ...]) -> ElementTree.Element:
    """An XDMF 3 temporal collection of point clouds."""
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
        grid = ElementTree.SubElement(collection, "Grid", Name=f"step {step}", GridType="Uniform")
        # Readers want times to ascend, which those along a path need not.
        ElementTree.SubElement(grid, "Time", Value=repr(time if ascending else float(step)))
        topology = ElementTree.SubElement(
            grid, "Topology", TopologyType="Polyvertex", NumberOfElements=str(count), NodesPerElement="1"
        )
        item(topology, "vertex", f"{count} 1", "Int", "4")
        geometry = ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ")
        item(geometry, "position", f"{count} 3")
        for name, path in [
            *((n, n) for n in ("volume", "horizon", "spacing")),
            *((n, f"{step:05d}/{n}") for n in fields),
        ]:
            kind, columns = _KINDS[QUANTITIES[name].rank if name in QUANTITIES else 0]
            attribute = ElementTree.SubElement(grid, "Attribute", Name=name, AttributeType=kind, Center="Node")
            item(attribute, path, f"{count}{columns}")
    return root
