"""How a material of any model comes to have bonds that soften (materials/softening.py)."""

from typing import NamedTuple

import numpy as np

from pdpetsc.materials.softened_kernels import PrintedSoftening, PrintedTangent
from pdpetsc.materials.softening import Softening, committed


class Softenable:
    """The part of a `Material` by which its bonds soften: T_s is in the weights with which the model sums over a
    family, so that what is kept by the model with any weights, momenta and objectivity, is kept. The energy is the one
    that can be recovered, at constant T."""

    _softening: Softening | None = None
    _printed = False

    def soften(self, softening: Softening, printed: bool = False) -> None:
        """Let bonds soften from now on; once for a material, before its tangent is laid out.

        Args:
            softening: of the material's bonds.
            printed: as in seed 004 Eq. 6.2, T on the forces of a bond alone: correspondence models then lose angular
                momentum, and the energy is that of the bonds before they soften.
        """
        self._softening, self._printed = softening, printed
        self._hardened = self._tangent, self.symmetric, self.mode_sizes, self.follows_bonds
        self.__dict__.pop("dual", None)  # of a network that had pairs of springs as one
        self._renew()

    def set_softening(self, largest: np.ndarray, live: bool) -> None:
        """Go on with these largest committed stretches (bonds,), and T that follows the stretches (`live`) or not."""
        self._softening = self._softening._replace(largest=largest, live=live)
        self._renew()

    def integrity(self) -> np.ndarray | None:
        """What is left of each bond (bonds,), mu T of the committed stretches; None where all are whole."""
        if self._softening is None:
            return None if self.intact is None else self.intact.astype(float)
        factors = np.empty(self.families.bonds)
        committed(self._softening, self.families.offsets, factors)
        return factors if self.intact is None else factors * self.intact

    def _renew(self) -> None:
        """Data of the bonds that are left: as they are, softening with the state, or with the T that they have, which
        are then weights like others and as quick."""
        softening, printed = self._softening, self._printed
        intact = np.ones(self.families.bonds, bool) if self.intact is None else self.intact
        if softening is None:
            self._keep(intact)
            return
        self._tangent, self.symmetric, self.mode_sizes, self.follows_bonds = self._hardened
        if not (softening.live or printed):
            self._fade(self.integrity())
            return
        self._keep(intact)
        if printed:
            forces = np.empty((self.families.bonds, self._part.dim))
            self._data = PrintedSoftening(self._data, softening, self.linear, self.symmetric)
            self._tangent = PrintedTangent(self._tangent, forces)
        else:
            self._data, self._tangent = self._softened(softening)
        self.symmetric = self.symmetric and not self.couples_family  # a spring's force is a function of its length
        self._mechanics = self._data, self._bonds
        self.follows_bonds = True

    def _softened(self, softening: Softening) -> tuple[NamedTuple, NamedTuple]:
        """Data and tangent of the model whose bonds soften, from those that it has."""
        raise NotImplementedError
