"""The pattern of the tangent in blocks, over owned and ghost rows, and the way of ghost rows to their owners.

The families of a rank contribute to rows of its owned particles and of its ghosts, and entries (j, k) with both j and
k ghosts occur. Values are therefore accumulated in local block rows (owned rows first, then ghost rows); the ghost
rows are then added to their owners' rows by one PetscSF between blocks, made once with the pattern.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from petsc4py import PETSc

from pdpetsc.bonds import DualFamilies, Families
from pdpetsc.exchange import reduce, star_forest, swap
from pdpetsc.particles import Particles


@dataclass
class Sparsity:
    """Block pattern of the tangent.

    Attributes:
        owned: number of owned block rows; the ghosts' rows follow in `row_offsets` and `columns`.
        row_offsets: (local + 1,) int64 first block of each row.
        columns: int32 local particle of each block, -1 where it is not on this rank (such blocks come from others).
        global_columns: PETSc block column of each block of the owned rows, ascending in each row.
    """

    owned: int
    row_offsets: np.ndarray
    columns: np.ndarray
    global_columns: np.ndarray
    _forest: PETSc.SF

    def zero_blocks(self, dim: int) -> np.ndarray:
        """Blocks of all local rows, (blocks, dim, dim)."""
        return np.zeros((len(self.columns), dim, dim))

    def reverse_add(self, blocks: np.ndarray) -> np.ndarray:
        """Add the ghost rows' blocks to their owners' and return the blocks of the owned rows."""
        reduce(self._forest, blocks, blocks)
        return blocks[: self.row_offsets[self.owned]]


class Part(NamedTuple):
    """Families that contribute to a tangent: `own` their number for each local particle (-1: none), and whether the
    neighbours of a particle couple through its family."""

    families: Families
    dual: DualFamilies
    own: np.ndarray
    couples: bool


def tangent_sparsity(particles: Particles, parts: list[Part]) -> Sparsity:
    """The pattern of the sum of the parts (collective)."""
    owned = particles.owned
    offsets, columns = _rows(particles.local, parts)
    global_columns = particles.global_index[columns].astype(np.int64)
    _sort_rows(offsets, global_columns, columns)

    # Ghost rows go to their owners, in the order of the owners' mirrors.
    mpi = particles.comm.tompi4py()
    sizes = np.diff(offsets)
    rows = [slice(int(offsets[g.start]), int(offsets[g.stop])) for g in particles.ghost_ranges]
    their_sizes = swap(mpi, particles.neighbours, [sizes[g] for g in particles.ghost_ranges], np.int64)
    their_columns = swap(mpi, particles.neighbours, [global_columns[r] for r in rows], np.int64)
    their_rows = [np.repeat(mirror, size) for mirror, size in zip(particles.mirrors, their_sizes)]
    arrived_rows = np.concatenate([np.empty(0, np.int64), *their_rows]).astype(np.int64)
    arrived_columns = np.concatenate([np.empty(0, np.int64), *their_columns])

    own = int(offsets[owned])
    merged_offsets, merged = _merge(offsets[: owned + 1], global_columns[:own], arrived_rows, arrived_columns)
    slots = _find(merged_offsets, merged, arrived_rows, arrived_columns)
    cuts = np.cumsum([len(c) for c in their_columns])[:-1]
    remote = swap(mpi, particles.neighbours, np.split(slots, cuts) if their_columns else [], np.int64)
    rank = np.repeat(np.array(particles.neighbours, np.int64), [len(r) for r in remote])
    index = np.concatenate([np.empty(0, np.int64), *remote])
    total = len(merged)
    forest = star_forest(particles.comm, total, np.arange(total, total + len(index)), rank, index)

    return Sparsity(
        owned=owned,
        row_offsets=np.concatenate([merged_offsets, offsets[owned + 1 :] - own + total]),
        columns=np.concatenate([_local_columns(particles, merged), columns[own:]]),
        global_columns=merged,
        _forest=forest,
    )


def _local_columns(particles: Particles, global_columns: np.ndarray) -> np.ndarray:
    """Local particles of global block columns, -1 where there is none."""
    owned = particles.owned
    start = int(particles.global_index[0]) if owned else 0
    order = np.argsort(particles.global_index[owned:])
    return _look_up(global_columns, start, owned, particles.global_index[owned:][order], order + owned)


@njit(cache=True)
def _look_up(global_columns, start, owned, known, local):
    """Owned columns are contiguous; the others are looked for among the `known` ghosts."""
    columns = np.empty(len(global_columns), np.int32)
    for k in range(len(global_columns)):
        wanted = global_columns[k]
        if start <= wanted < start + owned:
            columns[k] = wanted - start
        else:
            place = np.searchsorted(known, wanted)
            found = place < len(known) and known[place] == wanted
            columns[k] = local[place] if found else -1
    return columns


def _rows(local: int, parts) -> tuple[np.ndarray, np.ndarray]:
    """Columns of all local rows from this rank's families, unsorted: (offsets, local particles)."""
    merged = None
    for families, dual, own, couples in parts:
        rows = _part_rows(
            own, families.center, families.offsets, families.neighbours, dual.offsets, dual.family, couples
        )
        merged = rows if merged is None else _unite(*merged, *rows)
    return merged


@njit(cache=True)
def symmetrise(row_offsets, columns, global_index, order, blocks):
    """Add to every block (a, b), a != b, the transpose of block (b, a), where both rows are here.

    Rows are sorted by global columns, so that, with rows taken in their global `order`, a pointer into each row b
    finds its columns a as they come up.
    """
    dim = blocks.shape[1]
    pointer = row_offsets[:-1].copy()
    for a in order:
        for k in range(row_offsets[a], row_offsets[a + 1]):
            b = columns[k]
            if b < 0 or global_index[b] <= global_index[a]:
                continue
            m = pointer[b]
            while m < row_offsets[b + 1] and (columns[m] < 0 or global_index[columns[m]] < global_index[a]):
                m += 1
            pointer[b] = m
            if m == row_offsets[b + 1] or columns[m] != a:
                continue
            for p in range(dim):
                for q in range(dim):
                    value = blocks[k, p, q] + blocks[m, q, p]
                    blocks[k, p, q] = value
                    blocks[m, q, p] = value


@njit(cache=True)
def _part_rows(own, center, offsets, neighbours, dual_offsets, dual_family, couples):
    """One pass over the rows; `seen` marks the columns of the current row."""
    local = len(own)
    seen = np.full(local, -1, np.int64)
    row_offsets = np.zeros(local + 1, np.int64)
    columns = np.empty(max(16, 4 * len(neighbours)), np.int32)
    n = 0
    for a in range(local):
        first = -1 if own[a] >= 0 else 0
        for k in range(first, dual_offsets[a + 1] - dual_offsets[a]):
            f = own[a] if k < 0 else dual_family[dual_offsets[a] + k]
            size = offsets[f + 1] - offsets[f]
            if n + size + 2 > len(columns):
                larger = np.empty(2 * len(columns) + size, np.int32)
                larger[:n] = columns[:n]
                columns = larger
            if seen[center[f]] != a:
                seen[center[f]] = a
                columns[n] = center[f]
                n += 1
            if seen[a] != a:
                seen[a] = a
                columns[n] = a
                n += 1
            if couples or k < 0:
                for b in range(offsets[f], offsets[f + 1]):
                    j = neighbours[b]
                    if seen[j] != a:
                        seen[j] = a
                        columns[n] = j
                        n += 1
        row_offsets[a + 1] = n
    return row_offsets, columns[:n].copy()


@njit(cache=True)
def _unite(offsets_a, columns_a, offsets_b, columns_b):
    """Row by row union of two unsorted patterns."""
    rows = len(offsets_a) - 1
    offsets = np.zeros(rows + 1, np.int64)
    columns = np.empty(len(columns_a) + len(columns_b), np.int32)
    n = 0
    for a in range(rows):
        both = np.unique(
            np.concatenate((columns_a[offsets_a[a] : offsets_a[a + 1]], columns_b[offsets_b[a] : offsets_b[a + 1]]))
        )
        columns[n : n + len(both)] = both
        n += len(both)
        offsets[a + 1] = n
    return offsets, columns[:n].copy()


@njit(cache=True)
def _sort_rows(offsets, keys, values):
    """Sort each row by its keys, in place."""
    for a in range(len(offsets) - 1):
        row = slice(offsets[a], offsets[a + 1])
        order = np.argsort(keys[row])
        keys[row] = keys[row][order]
        values[row] = values[row][order]


@njit(cache=True)
def _merge(offsets, columns, rows, arrived):
    """Sorted rows united with arrived (row, column) pairs: (offsets, columns)."""
    n = len(offsets) - 1
    counts = np.zeros(n + 1, np.int64)
    for r in rows:
        counts[r + 1] += 1
    starts = np.cumsum(counts)
    fill = starts[:-1].copy()
    by_row = np.empty(len(arrived), np.int64)
    for k in range(len(arrived)):
        by_row[fill[rows[k]]] = arrived[k]
        fill[rows[k]] += 1
    merged = np.empty(len(columns) + len(arrived), np.int64)
    merged_offsets = np.zeros(n + 1, np.int64)
    m = 0
    for a in range(n):
        own = columns[offsets[a] : offsets[a + 1]]
        others = by_row[starts[a] : starts[a + 1]]
        both = own if len(others) == 0 else np.unique(np.concatenate((own, others)))
        merged[m : m + len(both)] = both
        m += len(both)
        merged_offsets[a + 1] = m
    return merged_offsets, merged[:m].copy()


@njit(cache=True)
def _find(offsets, columns, rows, wanted):
    """Position of each (row, column) pair in sorted rows."""
    slots = np.empty(len(wanted), np.int64)
    for k in range(len(wanted)):
        a = rows[k]
        slots[k] = offsets[a] + np.searchsorted(columns[offsets[a] : offsets[a + 1]], wanted[k])
    return slots
