"""Checkpoints: one HDF5 file from which a run goes on, on any number of ranks."""

import json
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np

from pdpetsc.body.sets import Sets
from pdpetsc.errors import InputError, OutputError
from pdpetsc.exchange import Directory
from pdpetsc.io import kept as checks
from pdpetsc.io import seal
from pdpetsc.io.blocks import read_field, write_field
from pdpetsc.io.shared_file import open_file
from pdpetsc.parallel import collective
from pdpetsc.particles import Facets, Particles, Points, distribute
from pdpetsc.state import State

CHECKPOINT = "checkpoint.h5"
FORMAT = 4
FIELDS = ("u", "increment", "v")
"""Of the state, beside its numbers."""
LINEAGE = ("parent", "ancestor")
"""Ids of the particle that each was split from, and of the one at the start."""


def write_checkpoint(
    directory: Path, particles: Particles, state: State, description: dict, damaged: dict[str, np.ndarray]
) -> None:
    """Write the state and what is needed to go on; whole or not at all (new file, then rename; collective).

    Args:
        directory: existing result directory.
        description: plain data to keep with it: the case's document and the records of the steps so far.
        damaged: lists (n, 3) of this rank's bonds, by name, with the ids of their ends and what has become of them.

    Raises:
        OutputError: it cannot be written.
    """
    p, mpi = particles, particles.comm.tompi4py()
    facets = _gathered_facets(p) if p.carried else Facets.none(p.dim)
    damaged = {name: gathered_bonds(mpi, bonds) for name, bonds in damaged.items()}
    new = directory / (CHECKPOINT + ".new")
    owned = {name: getattr(state, name) for name in FIELDS if getattr(state, name) is not None}
    owned["position"] = p.position[: p.owned]
    if p.carried:  # a refined body
        owned |= {name: getattr(p, name)[: p.owned] for name in ("volume", "spacing", "horizon")}
        owned |= {name: p.carried[name] for name in LINEAGE}
    try:
        with open_file(p.comm, new, "w", userblock_size=seal.SIZE) as shared:
            for name, values in owned.items():
                write_field(shared, name, p.directory, p.count, values)
            if shared.file is not None:
                kept = {key.name: getattr(state, key.name) for key in fields(state) if key.name not in FIELDS}
                shared.file.attrs["state"] = json.dumps(kept)
                for group, listed in (("facets", vars(facets)), ("damaged", damaged)):
                    for name, values in listed.items():
                        shared.file[f"{group}/{name}"] = values
                shared.file["description"] = np.frombuffer(json.dumps(description).encode(), np.uint8)
        seal.seal(mpi, new, FORMAT)
        seal.rename(mpi, new, directory / CHECKPOINT)
    except OutputError:
        if mpi.rank == 0:
            with suppress(OSError):
                new.unlink(missing_ok=True)  # room for the next attempt
        raise


def check_whole(mpi, directory: Path) -> None:
    """See that a checkpoint is there and as it was written (collective).

    Raises:
        InputError: on all ranks alike, where it is not.
    """
    seal.check_seal(mpi, directory / CHECKPOINT, FORMAT)


def read_description(directory: Path) -> dict:
    """The description kept in a checkpoint.

    Raises:
        InputError: there is no checkpoint of this format, or what it holds is no description.
    """
    path = directory / CHECKPOINT
    seal.read_seal(path, FORMAT)
    try:
        with h5py.File(path, "r") as file:
            kept = checks.parsed(file["description"][...].tobytes())
        checks.check_description(kept)
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: the checkpoint is damaged ({error})") from None
    return kept


def gathered_bonds(mpi, bonds: np.ndarray) -> np.ndarray:
    """The listed bonds of all ranks by step (or stretch) and ids, on every rank: as many as a crack has area."""
    bonds = np.concatenate(mpi.allgather(bonds))
    return bonds[np.lexsort(bonds.T[[1, 0, 2]])]


def _gathered_facets(p: Particles) -> Facets:
    """The facets of all ranks, with ids of their parents, on every rank: as many as there are on loaded surfaces."""
    own = Facets(p.id[p.facets.parent].astype(np.int64), p.facets.face, p.facets.position, p.facets.area)
    return Facets.joined(p.comm.tompi4py().allgather(own))


def read_particles(directory: Path, first: Particles, sets: Sets, tolerance: float) -> tuple[Particles, Sets]:
    """The refined body of a checkpoint and its sets (collective).

    Args:
        first, sets: the body as it was at the start.
        tolerance: of horizons.
    """
    path, comm = directory / CHECKPOINT, first.comm
    with h5py.File(path, "r") as file:
        count = len(file["position"])
        start, stop = (count * rank // comm.size for rank in (comm.rank, comm.rank + 1))
        columns = {name: file[name][start:stop] for name in ("position", "volume", "spacing", "horizon", *LINEAGE)}
        facets = Facets(**{name: file[f"facets/{name}"][...] for name in ("parent", "face", "position", "area")})
    _check_inside(path, columns, first)
    carried = {name: columns.pop(name) for name in LINEAGE}
    own = Directory(comm, carried["ancestor"], first.count)
    carried["sets"] = own.from_blocks(first.directory.to_blocks(sets.columns))
    mine = facets.chosen((facets.parent >= start) & (facets.parent < stop))
    points = Points(np.arange(start, stop), **columns, facets=mine, carried=carried)
    particles = distribute(comm, points, tolerance)
    return particles, sets.inherited(particles, particles.carried.pop("sets"))


FINEST = 1e-4
"""Spacing of a refined body over the least at the start, below which it is not believed."""


def _check_inside(path: Path, columns: dict[str, np.ndarray], first: Particles) -> None:
    """See that particles are of the body that they come from (collective): a search grid for others has no bounds.

    Raises:
        InputError: they are not.
    """
    mpi, n = first.comm.tompi4py(), first.owned
    ends = np.concatenate([-first.position[:n], first.position[:n]], axis=1)
    ends = np.concatenate([ends, -first.spacing[:n, None], first.spacing[:n, None], first.horizon[:n, None]], axis=1)
    ends = np.max(mpi.allgather(ends.max(axis=0, initial=-np.inf)), axis=0)
    low, high, (finest, coarsest, horizon) = -ends[: first.dim], ends[first.dim : -3], ends[-3:]
    with collective(mpi):
        X, spacing = columns["position"], columns["spacing"]
        if len(X) and not (
            np.all((low - coarsest <= X) & (high + coarsest >= X))
            and np.all((-finest * FINEST <= spacing) & (spacing <= coarsest * (1 + 1e-9)))
            and np.all((columns["horizon"] > 0) & (columns["horizon"] <= horizon * (1 + 1e-9)))
            and np.all((columns["ancestor"] >= 0) & (columns["ancestor"] < first.count))
        ):
            raise InputError(f"{path}: the checkpoint belongs to another body than the case that it holds")


def read_damaged(directory: Path) -> dict[str, np.ndarray]:
    """The lists of bonds of a checkpoint, those of all ranks."""
    with h5py.File(directory / CHECKPOINT, "r") as file:
        return {name: data[...] for name, data in file.get("damaged", {}).items()}


def read_state(directory: Path, particles: Particles) -> State:
    """The state of a checkpoint on the particles of the same case (collective).

    Raises:
        InputError: the particles are not those of the checkpoint (on all ranks alike).
    """
    path = directory / CHECKPOINT
    p = particles
    with h5py.File(path, "r") as file:
        kept = _numbers(path, file.attrs["state"])
        same = file["u"].shape == (p.count, p.dim)
        there = [name for name in FIELDS if name in file]
    same = same and np.array_equal(read_field(path, "position", p.directory), p.position[: p.owned])
    if not p.comm.tompi4py().allreduce(int(same)) == p.comm.size:
        raise InputError(f"{path}: the checkpoint belongs to other particles than the case that it holds")
    return State(**{name: read_field(path, name, p.directory) for name in there}, **kept)


def _numbers(path: Path, text: str) -> dict[str, float]:
    """The state's numbers, of their JSON text."""
    try:
        kept = checks.parsed(text)
        checks.check_state(kept, {key.name for key in fields(State)} - {*FIELDS})
    except checks.Wrong as error:
        raise InputError(f"{path}: the checkpoint is damaged ({error})") from None
    return kept
