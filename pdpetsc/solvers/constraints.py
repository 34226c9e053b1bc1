"""What says where a step along a path of equilibrium ends."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from mpi4py import MPI

from pdpetsc.assembly import Assembler
from pdpetsc.fracture import Fracture
from pdpetsc.state import State

DIFFERENCE = 1e-5
"""Of a spacing: how far displacements are changed to see how ratios of failure change."""


class Constraint(Protocol):
    """One equation g(u) = 0 that says where on the path a step ends.

    g is a pure number: 0 where the step ends, and of the order of 1 in size where it begins.

    Attributes:
        again: whether a step in which bonds fail is solved again under the same constraint; if not, the next one begins
            with breaking them.
    """

    again: bool

    def linearise(self, u: np.ndarray) -> tuple[float, Callable[[np.ndarray], float]]:
        """g at owned displacements, and its change by owned changes of them; the same on every rank (collective)."""

    def predict(self, u: np.ndarray, rate: np.ndarray) -> float:
        """The change of t that the predictor makes, inf where nothing ends the step (collective).

        Args:
            u: (owned, dim) displacements of the equilibrium where the step begins.
            rate: (owned, dim) du/dt of the path there.
        """

    def turned_back(self, move: np.ndarray, direction: np.ndarray) -> bool:
        """Whether a step went the way from which it came (collective).

        Args:
            move: (owned, dim) of the step.
            direction: (owned, dim) in which the predictor went.
        """


class ArcLength:
    """Cylindrical arc length: g = |u - u0|^2/s^2 - 1, the mean square over particles of their free components
    (Crisfield 1981; linearised as by Riks 1979, so that no root is to be chosen).

    Args:
        assembler: of the body.
        state: where the step begins; the path goes on along its increment, and at first as t ascends.
        length: s of the step [length].
    """

    again = True

    def __init__(self, assembler: Assembler, state: State, length: float):
        self._assembler, self._u0, self._along, self._length = assembler, state.u, state.increment, length

    def linearise(self, u: np.ndarray) -> tuple[float, Callable[[np.ndarray], float]]:
        """As in `Constraint`."""
        a, move = self._assembler, u - self._u0
        scale = a.particles.count * self._length**2
        return total(a, move, move) / scale - 1.0, lambda du: 2.0 / scale * total(a, move, du)

    def predict(self, u: np.ndarray, rate: np.ndarray) -> float:
        """As in `Constraint`."""
        back = self._along is not None and total(self._assembler, rate, self._along) < 0.0
        return (-1.0 if back else 1.0) * self._length / arc(self._assembler, rate)

    def turned_back(self, move: np.ndarray, direction: np.ndarray) -> bool:
        """As in `Constraint`."""
        return total(self._assembler, move, direction) <= 0.0


class Failure:
    """The load at which the next bond fails: g is the largest ratio d/d_c of the bonds that are left, less 1. The step
    ends there, and the next one begins with breaking it; t goes back where it must, so that a snap-back is traced event
    by event.

    Args:
        assembler: of the body.
        fracture: its bonds.
    """

    again = False

    def __init__(self, assembler: Assembler, fracture: Fracture):
        self._assembler, self._fracture = assembler, fracture

    def linearise(self, u: np.ndarray) -> tuple[float, Callable[[np.ndarray], float]]:
        """As in `Constraint`; the change is that of the worst bond, by a difference."""
        fracture = self._fracture
        ratio, mpi = fracture.ratios(u), self._assembler.mpi
        worst = fracture.worst(ratio)
        bond = np.flatnonzero(ratio == worst)[:1]  # of a rank that has it

        def change(du: np.ndarray) -> float:
            h = self._difference(du)
            there = fracture.ratios(u + h * du)[bond]
            return (next(value[0] for value in mpi.allgather(there) if len(value)) - worst) / h

        return worst - 1.0, change

    def predict(self, u: np.ndarray, rate: np.ndarray) -> float:
        """As in `Constraint`: where the first bond fails, all ratios taken as linear."""
        ratio, h = self._fracture.ratios(u), self._difference(rate)
        slope = (self._fracture.ratios(u + h * rate) - ratio) / h
        rising = slope > 0.0
        first = float(((1.0 - ratio[rising]) / slope[rising]).min(initial=np.inf))
        return self._assembler.mpi.allreduce(first, MPI.MIN)

    def turned_back(self, move: np.ndarray, direction: np.ndarray) -> bool:
        """As in `Constraint`: bonds fail whichever way t goes."""
        return False

    def _difference(self, du: np.ndarray) -> float:
        a = self._assembler
        largest = a.mpi.allreduce(float(np.abs(du).max(initial=0.0)), MPI.MAX)
        return DIFFERENCE * a.spacing / largest if largest else 1.0


def total(a: Assembler, one: np.ndarray, other: np.ndarray) -> float:
    """Scalar product of two owned fields over the free entries of all ranks (collective)."""
    return a.mpi.allreduce(float((one * other)[~a.constrained].sum()))


def arc(a: Assembler, move: np.ndarray) -> float:
    """Root of the mean square over particles of the free components of an owned field (collective)."""
    return (total(a, move, move) / a.particles.count) ** 0.5
