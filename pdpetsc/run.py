"""A run that can be asked: its fields as arrays, its numbers, how it ended."""

import numpy as np

from pdpetsc.errors import ConvergenceError, InputError, Stop
from pdpetsc.recover import FIELDS
from pdpetsc.simulation import Simulation
from pdpetsc.summary import summary_of

COLUMNS = ("id", "position", "volume", "spacing", "horizon")
"""What can be asked of the particles, beside the fields of their state."""


class Run(Simulation):
    """A simulation that can be asked for its numbers: before it is solved, by its observers, and afterwards.

    Attributes:
        status: "built"; when it has been solved "converged", "separated" or "stopped" (by an observer), and after an
            exception "not_converged" or "interrupted".
        summary: as summary.json; empty until it has been solved.
    """

    status = "built"
    summary: dict = {}

    def solve(self) -> str:
        """Run to the end, and return the status.

        Raises:
            ConvergenceError: a step was not solved; the steps before it stay, and can be asked for.
            InputError: a load has no value at some time; likewise.
        """
        failure = None
        try:
            self.status = super().solve()
        except Stop:
            self.status = "stopped"
            self._finish()
        except ConvergenceError as error:
            self.status, failure = "not_converged", error
        except InputError as error:
            self.status, failure = "interrupted", error
        self.summary = summary_of(self, self.status)
        if failure:
            raise failure
        return self.status

    def field(self, name: str, gather: bool = False) -> np.ndarray:
        """A field of the last committed state, or a column of the particles (collective).

        Args:
            name: a field as in probes and files ("u", "stress", "von_mises", "damage" ...), or one of COLUMNS.
            gather: whether the values are wanted of all particles, in the order of their ids, on every rank; else those
                of this rank's own particles, in the order of theirs.

        Returns:
            (n,) numbers, (n, dim) vectors or (n, 3, 3) tensors.

        Raises:
            InputError: there is no such field.
        """
        if name in COLUMNS:
            values = getattr(self.particles, name)[: self.particles.owned]
        elif name in FIELDS:
            values = self.recovery.field(name)
        else:
            raise InputError(f"there is no field {name!r}; choices: {', '.join([*COLUMNS, *FIELDS])}")
        return self.particles.directory.gathered(values) if gather else values

    def history(self, name: str) -> np.ndarray:
        """A probe, or a column of history.csv such as "time", at all committed steps: (steps, ...).

        Raises:
            InputError: there is neither.
        """
        columns = [row | row["probes"] for row in self.rows]
        if columns and name not in columns[0]:
            choices = ", ".join(key for key in columns[0] if key != "probes")
            raise InputError(f"there is no probe or column {name!r}; choices: {choices}")
        return np.array([row[name] for row in columns])
