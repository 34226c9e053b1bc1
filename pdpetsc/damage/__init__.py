"""Criteria by which bonds fail, found by name: importing this package fills `Criterion.criteria`."""

from pdpetsc.damage import stretch  # noqa: F401
