"""What bonds carry through the body: the Lehoucq-Silling stress in the particles' cells, and forces across a section.

The peridynamic stress tensor (Lehoucq and Silling 2008; seed 000 Eq. 57-66) is the flux of forces along bonds. Its mean
over the Voronoi cell of particle k, of volume V_k, is

    sigma_k = 1/V_k sum_i sum_{j in H_i} l_ij,k T_i<xi> (x) xi V_i V_j

with l_ij,k the fraction of the reference segment from X_i to X_j = X_i + xi that lies in the cell. Rows are directions
of forces, columns those of reference bonds (a first Piola-Kirchhoff stress).

At X_i + s xi the nearest particle has the smallest d_k(s) = (|x_k|^2 - 2 s xi.x_k)/|xi|^2, x_k = X_k - X_i: a line in
s, and the cells that the bond crosses are the lower envelope of these lines from i (d = 0) to j (d = 1 - 2 s). The
envelope of i and j alone is concave with its kink at s = 1/2, no d_k is below it at the ends, so one that is below it
anywhere is so at s = 1/2: |x_k|^2 < xi.x_k, X_k lies inside the sphere around the bond. That is in H_i with j.
"""

import numpy as np
from numba import njit

from pdpetsc.materials.families import FAST, force_state, gather_two, largest_family, scratch

SAME = 1e-9
"""Lines d_k(s) that differ by less are one: the particles are equally near all along the bond and share it evenly."""


@njit(cache=True)
def candidates(dots, squares, b, size, slope, start, member):
    """Members of the family inside the sphere around bond b, as lines d = start - slope s; j, the last one, is with
    them. Gives their number.

    Args:
        dots: x_k . xi of all members.
        squares: |x_k|^2 of all members.
    """
    count = 0
    square = squares[b]
    limit = 1e-12 * square
    for k in range(size):
        member[count] = k  # the next one overwrites it unless it counts
        count += squares[k] + limit < dots[k]
    for c in range(count):
        slope[c] = 2 * dots[member[c]] / square
        start[c] = squares[member[c]] / square
    slope[count], start[count], member[count] = 2.0, 1.0, b
    return count + 1


@njit(cache=True, error_model="numpy")
def next_cell(slope, start, count, now, s):
    """The line that the envelope follows after line `now` (-1: that of i), and the s where it begins, from s to 1."""
    own_slope, own_start = (0.0, 0.0) if now < 0 else (slope[now], start[now])
    winner = count - 1
    crossing = (1.0 - own_start) / (2.0 - own_slope)
    for c in range(count - 1):
        if slope[c] > own_slope + SAME:
            at = (start[c] - own_start) / (slope[c] - own_slope)
            if at < crossing:
                crossing, winner = at, c
    return winner, min(max(crossing, s), 1.0)


@njit(cache=True, error_model="numpy")
def share_among(slope, start, count, now, length, fraction):
    """Add `length` to the fractions of the candidates whose line is `now`'s, evenly."""
    equal = 0
    for c in range(count):
        equal += abs(slope[c] - slope[now]) < SAME and abs(start[c] - start[now]) < SAME
    for c in range(count):
        if abs(slope[c] - slope[now]) < SAME and abs(start[c] - start[now]) < SAME:
            fraction[c] += length / equal


@njit(cache=True, error_model="numpy")
def walk(slope, start, count, fraction):
    """Fill the fractions of a bond in the candidates' cells; give the one in the cell of i."""
    fraction[:count] = 0.0
    now, s = next_cell(slope, start, count, -1, 0.0)
    own = s
    while now < count - 1:
        following, end = next_cell(slope, start, count, now, s)
        share_among(slope, start, count, now, end - s, fraction)
        now, s = following, end
    fraction[now] += 1.0 - s
    return own


@njit(cache=True, **FAST)
def add_virials(D, data, X, center, offsets, neighbours, volume, u, virial):
    """Add l T<xi> (x) xi V_i V_j of each bond to `virial` (local, dim, dim) of the particles whose cells it crosses."""
    dim = len(D)
    space = scratch(D, offsets)
    xi, t = space.xi, space.t
    largest = largest_family(offsets)
    squares, dots = np.empty(largest), np.empty(largest)
    slope, start, fraction = np.empty(largest + 1), np.empty(largest + 1), np.empty(largest + 1)
    member = np.empty(largest + 1, np.int32)
    for f in range(len(center)):
        i, first, size = center[f], offsets[f], offsets[f + 1] - offsets[f]
        gather_two(D, X, u, i, first, first + size, neighbours, xi, space.eta)
        force_state(D, data, f, first, size, space)
        family = neighbours[first : first + size]
        for k in range(size):
            squares[k] = 0.0
            for p in range(dim):
                squares[k] += xi[p, k] ** 2
        for b in range(size):
            for k in range(size):
                dots[k] = 0.0
            for p in range(dim):
                along = xi[p, b]
                for k in range(size):
                    dots[k] += along * xi[p, k]
            count = candidates(dots, squares, b, size, slope, start, member)
            own = walk(slope, start, count, fraction)
            for p in range(dim):
                for q in range(dim):
                    whole = volume[i] * t[p, b] * xi[q, b]
                    virial[i, p, q] += own * whole
                    for c in range(count):
                        virial[family[member[c]], p, q] += fraction[c] * whole


@njit(cache=True)
def crossing_bonds(center, offsets, neighbours, beyond):
    """Offsets of the bonds of each family whose ends lie on different sides."""
    result = np.zeros(len(center) + 1, np.int64)
    for f in range(len(center)):
        count = 0
        for b in range(offsets[f], offsets[f + 1]):
            count += beyond[center[f]] != beyond[neighbours[b]]
        result[f + 1] = result[f] + count
    return result


@njit(cache=True, **FAST)
def crossing_forces(D, data, X, center, offsets, neighbours, volume, u, beyond, rows, force, bond):
    """Fill `force` (n, dim) with what the particles `beyond` exert on the others through each bond that crosses, and
    `bond` (n, 2) with the bond's center and neighbour; `rows` are the offsets that `crossing_bonds` gives."""
    space = scratch(D, offsets)
    for f in range(len(center)):
        if rows[f + 1] == rows[f]:
            continue
        i, first, last = center[f], offsets[f], offsets[f + 1]
        gather_two(D, X, u, i, first, last, neighbours, space.xi, space.eta)
        force_state(D, data, f, first, last - first, space)
        sign = -volume[i] if beyond[i] else volume[i]
        n = rows[f]
        for b in range(first, last):
            if beyond[i] != beyond[neighbours[b]]:
                bond[n, 0], bond[n, 1] = i, neighbours[b]
                for p in range(len(D)):
                    force[n, p] = sign * space.t[p, b - first]
                n += 1
