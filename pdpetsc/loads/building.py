"""The loads of a case on its particles and surfaces."""

from collections.abc import Iterable

import numpy as np

from pdpetsc.body.cracks import Crack
from pdpetsc.body.sets import Sets
from pdpetsc.body.surfaces import on_surface
from pdpetsc.errors import InputError, at
from pdpetsc.loads.base import Load, Site
from pdpetsc.loads.traction import TRANSFER, Surface, Traction
from pdpetsc.materials.base import Material
from pdpetsc.parallel import collective
from pdpetsc.particles import Facets, Particles


def loaded_surfaces(case) -> list[str]:
    """Names of the surfaces on which something acts."""
    return sorted({load.surface for load in case.load if _is_traction(load)})


def _is_traction(load) -> bool:
    return getattr(load, "surface", None) is not None


def follows(load, materials: Iterable[Material]) -> bool:
    """Whether a load follows the deformation: on a surface, as it says, or else unless all kinematics are linear."""
    if not _is_traction(load):
        return False
    return not all(m.linear for m in materials) if load.follower is None else load.follower


def loads_of(case, p: Particles, sets: Sets) -> list[Load]:
    """What acts on sets of particles (collective)."""
    loads = []
    for spec in case.load:
        if not _is_traction(spec):
            members = np.flatnonzero(sets[spec.set])
            place = p.position[members], p.volume[members], p.spacing[members]
            loads.append(Load.kinds[spec.kind](Site(p.comm.tompi4py(), members, *place, spec.value), spec))
    return loads


def tractions_of(case, p: Particles, materials: list[Material], cracks: list[Crack]) -> list[Traction]:
    """What acts on surfaces (collective). Several loads on one surface share its points; they see across no crack.

    Raises:
        InputError: there is nothing on a surface, or its points see too few particles.
    """
    mpi, surfaces, tractions = p.comm.tompi4py(), {}, []
    for number, spec in enumerate(case.load):
        if not _is_traction(spec):
            continue
        key, place = (spec.surface, spec.transfer), f"load.{number}.surface"
        if key not in surfaces:
            facets = _facets_on(case, p, spec.surface, place)
            with collective(mpi), at(place):
                surfaces[key] = _surface(p, facets, materials, spec.transfer, cracks)
        axes = getattr(spec, "component", ())
        tractions.append(Traction(surfaces[key], axes, spec.value, follows(spec, materials)))
    return tractions


def check_surfaces(case, p: Particles) -> None:
    """See that something lies on every surface that is loaded (collective).

    Raises:
        InputError: it does not.
    """
    for number, spec in enumerate(case.load):
        if _is_traction(spec):
            _facets_on(case, p, spec.surface, f"load.{number}.surface")


def _facets_on(case, p: Particles, surface: str, place: str) -> Facets:
    """The facets of a surface."""
    mpi = p.comm.tompi4py()
    with collective(mpi):
        facets = p.facets.chosen(on_surface(p.facets, p.spacing[p.facets.parent], surface, case.surfaces))
    if not mpi.allreduce(len(facets)):
        unfitted = case.body.keep is not None and not case.body.fitted
        remedy = "; the border of body.keep is a surface with body.fitted = true" if unfitted else ""
        raise InputError(f"{place}: nothing of the body lies on {surface!r}{remedy}")
    return facets


def _surface(p: Particles, facets: Facets, materials: list[Material], transfer: str, cracks: list[Crack]) -> Surface:
    def of_materials(parent, r):
        alpha = np.empty(len(r))
        for material in materials:
            own = material.own[parent] >= 0
            alpha[own] = material.transfer(r[own])
        return alpha

    alpha = of_materials if transfer == "cut_bonds" else lambda parent, r: TRANSFER[transfer](r)
    return Surface(facets, p.position, p.volume, p.horizon, p.spacing, alpha, p.id, cracks)
