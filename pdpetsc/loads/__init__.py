"""Loads of the case file; importing the package fills the table `Load.kinds`."""

from pdpetsc.loads import displacement, force, velocity  # noqa: F401
