"""Material models; importing the package fills the table `Material.models`."""

from pdpetsc.materials import correspondence  # noqa: F401
