"""From a case to its particles and materials."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from petsc4py import PETSc

from pdpetsc.adapt.refinement import Refinement
from pdpetsc.body.box import Lattice, box
from pdpetsc.body.columns import checked_apart
from pdpetsc.body.given import given_particles, source_of
from pdpetsc.body.horizons import horizon_field
from pdpetsc.body.sets import Sets
from pdpetsc.body.surfaces import on_surface
from pdpetsc.body.zones import zones_of
from pdpetsc.bonds import Families
from pdpetsc.case import Case
from pdpetsc.census import QUICK, take_census
from pdpetsc.errors import InputError, at
from pdpetsc.influence import bond_weights, influence_function
from pdpetsc.loads.building import check_surfaces, loaded_surfaces
from pdpetsc.materials.base import Material, Neighbourhood
from pdpetsc.materials.one_way import one_way_bonds
from pdpetsc.parallel import collective, warn
from pdpetsc.particles import Facets, Particles, distribute


def distributed_particles(comm: PETSc.Comm, case: Case) -> Particles:
    """The distributed particles, with those facets on which a traction acts."""
    body, mpi = case.body, comm.tompi4py()
    horizon = horizon_field(body, case.material, case.sets)
    loaded = _loaded(case)
    source = None if body.shape == "box" else source_of(case)
    if source is None:
        points = box(mpi, body, body.keep, horizon, loaded is not None, zones_of(case))
    else:
        points = given_particles(mpi, source, body.keep, horizon)
    if loaded:
        facets = points.facets
        with collective(mpi):
            points.facets = facets.chosen(loaded(facets, points.spacing[np.searchsorted(points.id, facets.parent)]))
    p = distribute(comm, points, body.horizon_tolerance)
    if source and source.in_slices:  # of other files one rank has seen all particles
        noun = source.noun if body.keep is None else "particle"
        with collective(mpi):
            checked_apart(p.position, p.spacing, source.path, noun, p.id + 1, "leave one of them out")
    return p


def check_places(comm: PETSc.Comm, case: Case) -> None:
    """See that the sets and surfaces that loads, probes and materials name hold something; the body is made for it
    (collective).

    Raises:
        InputError: one of them holds nothing.
    """
    p = distributed_particles(comm, case)
    sets = Sets.of(p, case.sets)
    specs = [*case.load, *case.probe]
    for name in dict.fromkeys(getattr(spec, "set", None) for spec in specs):
        if name is not None:
            sets[name]
    for name in dict.fromkeys(spec.where for spec in case.material.values()):
        sets[name]
    check_surfaces(case, p)


def _loaded(case: Case) -> Callable[[Facets, np.ndarray], np.ndarray] | None:
    """The function of facets and the spacings of their particles that tells on which something acts; None: on none."""
    names = loaded_surfaces(case)
    if not names:
        return None
    return lambda facets, spacing: np.any([on_surface(facets, spacing, name, case.surfaces) for name in names], axis=0)


def refinement_of(case: Case) -> Refinement | None:
    """How the body of a case is refined; None: it is not."""
    if case.refinement is None:
        return None
    horizon = horizon_field(case.body, case.material, case.sets)
    lattice = Lattice.of(case.body, case.body.keep, horizon, zones_of(case))
    return Refinement(case.refinement, lattice, _loaded(case), case.body.horizon_tolerance)


def expected_blocks(comm: PETSc.Comm, case: Case) -> float:
    """Of the assembled tangent, counted by the first rank without looking at the others (collective); where a quick
    look finds no particle, too many to be assembled."""
    blocks = float("inf")
    if comm.rank == 0:
        with suppress(InputError):
            blocks = take_census(case, QUICK).blocks
    return comm.tompi4py().bcast(blocks)


def materials_of(
    case: Case, p: Particles, families: Families, interior: int, sets: Sets, quiet: bool = False
) -> list[Material]:
    """The materials of the case on their particles; every particle has exactly one. The first `interior` families
    contain no ghost. `quiet`: nothing is warned of."""
    count = np.zeros(p.owned, int)
    materials = []
    for name, spec in case.material.items():
        if not quiet and (
            unused := [key for key in case.document["material"][name] if key not in type(spec).model_fields]
        ):
            warn(p.comm.tompi4py(), f"material.{name}: the model {spec.model!r} does not use {', '.join(unused)}")
        members = sets[spec.where]
        count += members
        chosen = np.flatnonzero(members[families.center])
        own = families.subset(chosen)
        influence = influence_function(spec.influence)
        with collective(p.comm.tompi4py()), at(f"material.{name}"):
            weight = bond_weights(own, p.position, p.horizon, p.spacing, influence, spec.partial_volume)
        part = Neighbourhood(
            own, weight, p.position, p.volume, p.horizon, p.spacing, case.body.thickness, influence,
            int(np.searchsorted(chosen, interior)), p.exchange.forward,
        )  # fmt: skip
        with collective(p.comm.tompi4py()), at(f"material.{name}"):
            # Those that communicate raise on all ranks alike (`Neighbourhood.forward`).
            materials.append(Material.models[spec.model].from_case(spec, part))
        if not spec.dual:
            materials[-1].one_way = one_way_bonds(own, p.position, p.horizon, case.body.horizon_tolerance)
    mpi = p.comm.tompi4py()
    for name, material in zip(case.material, materials):
        unmatched, total = mpi.allreduce(np.array([material.unmatched, len(material.families)]))
        if unmatched > total / 2 and not quiet:
            counts = f"weights of {unmatched} of {total} families could not be matched"
            remedy = "take a larger horizon or another influence function"
            warn(mpi, f"material.{name}: {counts}, so that its moduli are not right; {remedy}")
    wrong = mpi.allreduce(np.array([(count == 0).sum(), (count > 1).sum()]))
    if wrong.any():
        raise InputError(
            f"material: {wrong[0]} particles have no material and {wrong[1]} have more than one; "
            "the sets in `where` must cover the body once"
        )
    return materials
