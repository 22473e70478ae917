"""Partition of particles over ranks: blocks of neighbours, and the halo of each block."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray
from scipy.sparse.csgraph import reverse_cuthill_mckee

from modalshell.core.errors import MeshError, OptionError
from modalshell.core.typing import Index
from modalshell.springs.springs import Springs


class RankBlock(NamedTuple):
    """What one rank holds: particles with the new numbers ``first`` to ``last - 1``, and their springs.

    Local numbers are those of the own particles, then those of the ghosts: the other ranks' particles at the far ends
    of own springs.
    """

    first: int
    last: int
    order: Index
    """Old numbers of all particles by new number, shape (n,)."""
    ghosts: Index
    """New numbers of the ghosts, ascending, shape (g,)."""
    starts: Index
    """Where each own particle's springs start, shape (last - first + 1,)."""
    others: NDArray[np.int32]
    """Local numbers of the springs' far ends, in each row by ascending new number, shape (s,)."""
    springs: Index
    """Numbers of the springs, shape (s,)."""

    @property
    def owned(self) -> int:
        """Count of own particles."""
        return self.last - self.first

    @property
    def particles(self) -> Index:
        """Old numbers by local number, shape (last - first + g,)."""
        return np.concatenate([self.order[self.first : self.last], self.order[self.ghosts]])


def rank_block(springs: Springs, count: int, size: int, rank: int) -> RankBlock:
    """The part of ``rank`` among ``size`` of ``count`` particles; each rank gets the same number, or one more.

    The particles are renumbered by reverse Cuthill-McKee, which keeps neighbours together, and cut into runs: on a
    sheet into strips. A single rank has them all. OptionError for more ranks than particles. MeshError for springs that
    name particles beyond ``count``.
    """
    if size > count:
        raise OptionError(f"there are more ranks than particles (got {size} and {count}); start fewer ranks")
    if springs.pairs.max(initial=-1) >= count:
        raise MeshError(f"springs must join the particles 0 to {count - 1} (got {springs.pairs.max()})")
    ends = np.concatenate([springs.pairs, springs.pairs[:, ::-1]])
    graph = sps.csr_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    place = np.argsort(order)
    first, last = rank * count // size, (rank + 1) * count // size

    rows, columns = place[ends].T
    mine = np.flatnonzero((rows >= first) & (rows < last))
    mine = mine[np.lexsort((columns[mine], rows[mine]))]
    rows, columns = rows[mine], columns[mine]
    outside = (columns < first) | (columns >= last)
    ghosts = np.unique(columns[outside])
    others = np.where(outside, last - first + np.searchsorted(ghosts, columns), columns - first)
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows - first, minlength=last - first))])
    return RankBlock(first, last, order, ghosts, starts, others.astype(np.int32), mine % len(springs))
