"""Zones of small horizons: which of them are too thin for the horizons around them (seed 000 Eq. 100)."""

import numpy as np
import pytest
from bodies import distributed, families_of, refined
from models import lattice
from petsc4py import PETSc

from pdpetsc.expressions import Expression
from pdpetsc.grading import thin_zones, warn_thin_zones

pytestmark = pytest.mark.mpi


# A strip is `width` cells of width 1; the rule wants it wider than half of the horizon of the cells around it.
THIN = {  # size, refine, factor of the horizon, width found
    "line": ([20], "where(abs(X - 10.5) < 0.5, 2, 1)", 3.015, 1.0),
    "line, just too thin": ([20], "where(abs(X - 10) < 1, 2, 1)", 4.0, 2.0),
    "line, ratio 8": ([20], "where(abs(X - 10.5) < 0.5, 8, 1)", 3.015, 1.0),
    "line, horizons of two spacings": ([20], "where(abs(X - 10.5) < 0.5, 2, 1)", 2.015, 1.0),
    "line, other cells on the right": ([24], "where(abs(X - 10.5) < 0.5, 4, where(X > 11, 2, 1))", 3.015, 1.0),
    "two strips beside each other": ([20], "where(abs(abs(X - 10.5) - 1) < 0.5, 2, 1)", 3.015, 1.0),
    "strip": ([14, 9], "where(abs(X - 6.5) < 0.5, 4, 1)", 3.015, 1.0),
    "strip that ends in the body": ([14, 9], "where(abs(X - 6.5) < 0.5 and Y < 5, 4, 1)", 3.015, 1.0),
    "two strips in a plate": ([14, 9], "where(abs(abs(X - 6.5) - 1) < 0.5, 2, 1)", 3.015, 1.0),
    "strip of two rows": ([14, 9], "where(abs(Y - 4) < 1, 3, 1)", 5.015, 2.0),
    "steps": ([20, 20], "where(abs(X - Y) < 0.5, 4, 1)", 4.015, None),
    "spot": ([9, 9], "where(maximum(abs(X - 4.5), abs(Y - 4.5)) < 0.5, 2, 1)", 3.015, 1.0),
    "sheet in a block": ([8, 6, 6], "where(abs(X - 4.5) < 0.5, 2, 1)", 2.015, 1.0),
}
WIDE = {
    "uniform": ([14, 9], "3", 3.015, None),
    "line": ([20], "where(abs(X - 10) < 1, 4, 1)", 3.015, None),
    "line, just wide enough": ([20], "where(abs(X - 10) < 1, 4, 1)", 3.99, None),
    "at the end": ([20], "where(X < 1, 4, 1)", 3.015, None),
    "one side": ([14, 9], "where(X < 6, 4, 1)", 3.015, None),
    "oblique side": ([20, 20], "where(X + 2 * Y < 30, 3, 1)", 3.015, None),
    "strip": ([14, 9], "where(abs(X - 7) < 1, 4, 1)", 3.015, None),
    "strip, ratio 8": ([14, 9], "where(abs(X - 7) < 1, 8, 1)", 3.015, None),
    "corners": ([14, 14], "where(maximum(abs(X - 7), abs(Y - 7)) < 3, 2, 1)", 3.015, None),
    "corners, long horizons": ([18, 18], "where(maximum(abs(X - 9), abs(Y - 9)) < 4, 3, 1)", 5.015, None),
    "corners in a block": ([9, 9, 9], "where(maximum(abs(X - 4.5), maximum(abs(Y - 4.5), abs(Z - 4.5))) < 1.5, 2, 1)",
        2.015, None),
    "edge in a block": ([7, 7, 5], "where(X < 3 and Y < 3, 2, 1)", 3.015, None),
    "disc": ([16, 16], "where(hypot(X - 8, Y - 8) < 4.2, 2, 1)", 3.015, None),
    "disc, off the lattice": ([18, 18], "where(hypot(X - 8.3, Y - 8.1) < 3.7, 4, 1)", 4.015, None),
    "ball": ([9, 9, 9], "where(hypot(hypot(X - 4.5, Y - 4.5), Z - 4.5) < 3, 2, 1)", 2.015, None),
    "hole": ([14, 14], "1", 3.015, "hypot(X - 7, Y - 7) > 3"),
    "hole with a ring round it": ([16, 16], "where(hypot(X - 8, Y - 8) < 5, 3, 1)", 3.015, "hypot(X - 8, Y - 8) > 2.5"),
    "slit in a zone": ([16, 16], "where(abs(Y - 8) < 3, 2, 1)", 3.015, "abs(Y - 8) > 0.3 or X > 9"),
    "halves and quarters": ([18], "where(abs(X - 9) < 1, 4, where(abs(X - 9) < 3, 2, 1))", 3.015, None),
    "coarse spot in a zone": ([12, 12], "where(maximum(abs(X - 6), abs(Y - 6)) < 2, 1, 3)", 3.015, None),
    "channel with a bend": ([18, 18], "where(minimum(abs(X - 6), abs(Y - 6)) < 1 and maximum(X, Y) > 5, 2, 1)", 3.015,
        None),
}  # fmt: skip


@pytest.mark.parametrize("name", THIN)
def test_thin_zones(name):
    size, refine, factor, width = THIN[name]
    p = refined(size, refine, factor)
    zone = thin_zones(p, families_of(p))
    assert zone is not None and zone.count > 0
    assert zone.horizon == pytest.approx(factor)
    assert zone.width <= factor / 2 * (1 + 1e-9)
    if width is not None:
        assert zone.width == pytest.approx(width)
    names = [*"XYZ"[: p.dim], "spacing"]
    at = dict(zip(names, [*zone.position, 1.0]))
    assert Expression(refine, names)(**at) > 1  # the place lies in the zone


@pytest.mark.parametrize("name", WIDE)
def test_wide_zones(name):
    size, refine, factor, keep = WIDE[name]
    p = refined(size, refine, factor, keep)
    assert thin_zones(p, families_of(p)) is None


@pytest.mark.parametrize("growth", (1.05, 1.1, 1.2, 1.25))
@pytest.mark.parametrize("dim", (1, 2))
def test_gradual_gradings(growth, dim):
    """Spacings that grow from one particle to the next, away from the middle of the body."""
    widths = growth ** np.abs(np.arange(-7, 8.0))
    x = np.cumsum(widths) - widths / 2
    if dim == 1:
        X, spacing = x[:, None], widths
    else:
        index = (lattice((15, 15)) - 0.5).astype(int)
        X, spacing = x[index], widths[index].max(axis=1)
    p = distributed(X, 3.015 * spacing, spacing=spacing)
    assert thin_zones(p, families_of(p)) is None


def test_the_same_on_any_number_of_ranks():
    """The first one in the order of the ids, of all that are equally thin."""
    p = refined([14, 9], "where(abs(X - 6.5) < 0.5, 4, 1)")
    zone = thin_zones(p, families_of(p))
    assert zone.position == pytest.approx([6.5, 1.5])
    assert zone.count == 18  # the columns on either side: from farther ones the other side is 2 or more away
    alone = refined([14, 9], "where(abs(X - 6.5) < 0.5, 4, 1)", comm=PETSc.COMM_SELF)
    same = thin_zones(alone, families_of(alone))
    assert (same.count, same.width, same.horizon) == (zone.count, zone.width, zone.horizon)
    assert np.array_equal(same.position, zone.position)


def test_the_warning(comm, capfd):
    p = refined([20], "where(abs(X - 10.5) < 0.5, 2, 1)")
    warn_thin_zones(p, families_of(p))
    p = refined([20], "where(abs(X - 10) < 1, 2, 1)")
    warn_thin_zones(p, families_of(p))
    said = capfd.readouterr().err
    assert said.count("warning") == (comm.rank == 0)
    if comm.rank == 0:
        assert "around (10.5) a zone of smaller horizons is only 1 wide" in said
        assert "the horizon 3.015 beside it" in said and "seed 000 Eq. 100" in said
