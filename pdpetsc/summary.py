"""What summary.json says of a run, and the rows of its load steps."""

import resource
import time as clock

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pdpetsc import __version__, expectations, options
from pdpetsc.solvers.passes import StepRecord
from pdpetsc.solvers.path import limit_points


def summary_of(run, status: str) -> dict:
    """The contents of summary.json (collective)."""
    case, mpi, p = run.case, run.comm.tompi4py(), run.particles
    last = run.rows[-1] if run.rows else {"probes": {}}
    recovery = run.recovery
    run.timings.seconds["total"] = clock.perf_counter() - run.started
    stages = ("setup", "families", "first_tangent", "residual", "tangent", "solve", "output", "total")
    summary = {
        "case": case.name,
        "variant": case.variant,
        "title": case.title,
        "version": __version__,
        "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
        "status": status,
        "converged": status in ("converged", "separated"),
        "dim": p.dim,
        "particles": p.count,
        "spacing": case.body.spacing or _smallest_spacing(p),
        "bonds": mpi.allreduce(run.families.bonds),
        "family_size": _family_size(run),
        "ranks": run.comm.size,
        "most_bonds_on_a_rank": mpi.allreduce(run.families.bonds, MPI.MAX),
        "choices": _choices(run),
        "steps": [{k: v for k, v in row.items() if k != "probes"} for row in run.rows],
        "probes": last["probes"],
        "extremes": _extremes(run),
        "energies": _energies(run),
        **({"fracture": _fracture_measures(run)} if run.fracture and run.rows else {}),
        **({"refinements": run.refinements} if case.refinement else {}),
        "balance": recovery.balance(),
        "timings": {s: mpi.allreduce(run.timings.seconds[s], MPI.MAX) for s in stages},
        "peak_memory_mb": mpi.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, MPI.MAX),
        "units": case.units.model_dump(),
    }
    if case.solver.in_time:
        summary["time_step"] = {"size": run.schedule.size, "stable": run.schedule.stable}
    if case.solver.control != "load":
        times, lengths = ([row[key] for row in run.rows] for key in ("time", "arc_length"))
        summary["limit_points"] = limit_points(times, lengths)
    summary["expect"] = expectations.check(summary, case.expect)
    summary["unused_options"] = sorted(set.intersection(*map(set, mpi.allgather(options.unused()))))
    return summary


def _family_size(run) -> dict:
    """The fewest and the most bonds of a family."""
    mpi, sizes = run.comm.tompi4py(), np.diff(run.families.offsets)
    fewest = int(sizes.min(initial=np.iinfo(np.int64).max))  # a rank without particles has no say
    return {"min": mpi.allreduce(fewest, MPI.MIN), "max": mpi.allreduce(int(sizes.max(initial=0)), MPI.MAX)}


def _smallest_spacing(p) -> float:
    """Of a body without a lattice."""
    return p.comm.tompi4py().allreduce(float(p.spacing[: p.owned].min(initial=float("inf"))), MPI.MIN)


def row_of(run, record: StepRecord) -> dict:
    """A row of the history for the load step that was committed last (collective)."""
    state, last = run.state, record.passes[-1]
    iterations, scale = [newton.newton_iterations for newton in record.passes], last.residual_scale
    along = {} if run.case.solver.control == "load" else {"arc_length": record.arc_length}
    energies = {} if not run.fracture else {
        "external_work": state.external_work, "stored_energy": record.stored, "dissipated": state.dissipated,
        "held_particles": record.held, "crack_area": run.fracture.crack_area,
    }  # fmt: skip
    return {
        "step": state.step,
        "time": state.time,
        "load_factor": state.time / run.schedule.end,
        **along,
        "newton_iterations": sum(iterations),
        "linear_iterations": sum(newton.linear_iterations for newton in record.passes),
        "relaxation_steps": sum(newton.relaxation_steps for newton in record.passes),
        "residual_norms": last.residual_norms,
        "residual_scale": scale,
        "relative_residual": last.residual_norms[-1] / scale if scale else 0.0,
        "rounding_floor": last.rounding_floor,
        "broken_bonds": record.broken,
        "passes": len(iterations),
        "most_newton_iterations": max(iterations),
        "abandoned_iterations": record.abandoned,
        "seconds": sum(newton.seconds for newton in record.passes),
        **energies,
    }


def _extremes(run) -> dict:
    """The smallest and the largest value of each probe that is a single number, over all steps."""
    last = run.rows[-1]["probes"] if run.rows else {}
    numbers = [name for name, value in last.items() if isinstance(value, float)]
    values = {name: [row["probes"][name] for row in run.rows] for name in numbers}
    return {name: {"min": min(of), "max": max(of)} for name, of in values.items()}


def _energies(run) -> dict:
    """Stored; and where bonds may fail what was done by loads and supports, what broken bonds have taken, and what
    is missing between them."""
    if run.case.solver.in_time:
        return run.solver.energies(run.state)
    energies = {"stored": run.assembler.stored_energy(run.state.u)}
    if run.fracture:
        done, gone = run.state.external_work, run.state.dissipated
        left = done + run.state.mapped - gone - energies["stored"]
        energies |= {"external_work": done, "dissipated": gone, "mapped": run.state.mapped, "imbalance": left}
    return energies


def _fracture_measures(run) -> dict:
    """What became of the bonds over all steps."""
    last, failing = run.rows[-1], [row for row in run.rows if row["broken_bonds"]]
    first = failing[0]["time"] if failing else None
    if run.case.solver.in_time:
        return {**{key: last[key] for key in ("broken_bonds", "crack_area")}, "first_failure": first}
    return {
        **{key: last[key] for key in ("broken_bonds", "crack_area", "held_particles")},
        "first_failure": first,
        "failure_time": last["time"] if run.separated else None,
        "passes": sum(row["passes"] for row in run.rows),
        "most_newton_iterations": max(row["most_newton_iterations"] for row in run.rows),
        "separated": int(run.fracture.separated),
    }


def _choices(run) -> dict:
    mpi, materials = run.comm.tompi4py(), {}
    for (name, spec), material in zip(run.case.material.items(), run.materials):
        materials[name] = {
            "model": spec.model,
            "influence": spec.influence if isinstance(spec.influence, str) else spec.influence.text,
            "partial_volume": spec.partial_volume,
            "quadrature": "plain",
            "unmatched_families": mpi.allreduce(material.unmatched),
            "surface_correction": "none",
            **material.choices(),
        }
    return {
        "materials": materials,
        "horizon_tolerance": run.case.body.horizon_tolerance,
        "cracks": len(run.case.body.cracks),
        "cut_bonds": run.cut_bonds,
        "mode": run.case.solver.mode,
        "control": run.case.solver.control,
        **run.solver.choices(),
    }
