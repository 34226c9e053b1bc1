"""Criteria by which bonds fail, found by name: importing this package fills `Criterion.criteria`."""

from pdpetsc.damage import bond_strain, energy, principal_stress, strain, stretch  # noqa: F401
