"""What is committed: nothing here changes while a step is being solved."""

from dataclasses import dataclass

import numpy as np


@dataclass
class State:
    """The state after the last converged load step.

    Attributes:
        u: (owned, dim) displacement [length].
        time: the time it belongs to.
        step: number of committed load steps.
        step_size: size of the next load step that the stepping intends; 0: the nominal one.
        external_work: of loads and supports so far, where bonds may fail [energy].
        dissipated: what failed bonds have taken with them [energy].
        speed: where a path is followed, length of arc for a unit of step size [length/time]; 0 before its first step.
        mapped: kinetic and stored energy that refinements have added [energy].
        v: (owned, dim) velocity, where there is motion in time [length/time].
        brought, kinetic: energy at the start of a motion, and kinetic energy now [energy].
        increment: (owned, dim) change of the displacement over the last step along a path, which says where it goes on.
    """

    u: np.ndarray
    time: float = 0.0
    step: int = 0
    step_size: float = 0.0
    external_work: float = 0.0
    dissipated: float = 0.0
    speed: float = 0.0
    mapped: float = 0.0
    brought: float = 0.0
    kinetic: float = 0.0
    v: np.ndarray | None = None
    increment: np.ndarray | None = None
