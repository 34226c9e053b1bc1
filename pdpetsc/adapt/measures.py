"""What a refinement must keep: mass and momenta; and energies, whose jumps are said."""

import numpy as np

from pdpetsc.assembly import Assembler
from pdpetsc.particles import Particles
from pdpetsc.state import State


def measures(p: Particles, assembler: Assembler, state: State, mass: np.ndarray | None) -> dict:
    """Volume and stored energy of a body at a state; where it moves mass, kinetic energy, linear and angular momentum
    about the origin, with the sums of absolute values to which their errors are relative (collective).

    Args:
        mass: (owned,) of the particles; None: nothing moves.
    """
    stored = assembler.stored_energy(state.u)
    volume = assembler.mpi.allreduce(float(p.volume[: p.owned].sum()))
    if mass is None:
        return {"volume": volume, "stored": stored}
    x, v = np.zeros((p.owned, 3)), np.zeros((p.owned, 3))
    x[:, : p.dim], v[:, : p.dim] = p.position[: p.owned] + state.u, state.v
    speed = np.linalg.norm(v, axis=1)
    sums = [(mass * q).sum() for q in (1.0, speed**2 / 2, speed, np.linalg.norm(x, axis=1) * speed)]
    total, kinetic, linear, angular = assembler.mpi.allreduce(np.array(sums))
    momentum = assembler.mpi.allreduce(np.array([(mass[:, None] * q).sum(axis=0) for q in (v, np.cross(x, v))]))
    return {
        "volume": volume, "stored": stored, "mass": total, "kinetic": kinetic,
        "momentum": (momentum[0], linear), "angular_momentum": (momentum[1], angular),
    }  # fmt: skip


def changes(before: dict, after: dict) -> dict[str, float]:
    """By how much a refinement has changed these measures: volume, mass and momenta relatively, energies absolutely."""
    result = {}
    for name, value in after.items():
        if isinstance(value, tuple):
            size = before[name][1]
            result[name] = float(np.linalg.norm(value[0] - before[name][0]) / size) if size else 0.0
        elif name in ("stored", "kinetic"):
            result[name] = float(value - before[name])
        else:
            result[name] = float(abs(value / before[name] - 1))
    return result
