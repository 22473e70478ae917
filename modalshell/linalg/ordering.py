"""Elimination orders of a symmetric pattern: minimum degree, and nested dissection of the graph."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

from modalshell.core.typing import Index
from modalshell.linalg import analysis
from modalshell.linalg.dissection import dissect

_LEAF = 100
"""Vertices of a part that is not dissected any further: minimum degree orders it."""
_DISSECTED = 1000
"""Vertices of a graph from which dissection is tried."""
_GROUPED = 0.75
"""Groups of indistinguishable vertices, over the vertices, from which a graph is ordered as it is."""


class Elimination(NamedTuple):
    """An order of elimination (n,), the permuted graph, its elimination tree and the factor's column counts.

    And ``products``, the multiplications of the factorisation, in blocks.
    """

    order: Index
    graph: sps.csr_array
    parent: Index
    counts: Index
    products: float


def best_elimination(graph: sps.csr_array, *, once: bool = False) -> Elimination:
    """The cheaper of minimum degree and nested dissection, in postorder of its elimination tree.

    Dissection takes 0.3 to 0.7 of the products on sheets of 10,000 and 100,000 vertices and 0.64 on a creature of as
    many; minimum degree takes fewer on small and on narrow shapes, where they are few. So for a pattern that is
    factorised once, only dissection is tried, from as many vertices on as it takes.
    """
    group = _indistinguishable(graph)
    _, first, sizes = np.unique(group, return_index=True, return_counts=True)
    smaller = graph if first.size == group.size else sps.csr_array(graph[first][:, first])
    found = []
    if smaller.shape[0] >= _DISSECTED:
        found.append(eliminated(smaller, nested_dissection(smaller), sizes))
    if not (once and found):
        found.append(eliminated(smaller, minimum_degree(smaller), sizes))
    best = min(found, key=lambda each: each.products)
    return best if first.size == group.size else _expanded(best, graph, group, sizes)


def _indistinguishable(graph: sps.csr_array) -> Index:
    """Group (n,) of each vertex: those with the same neighbours and each other, or its own where few have any like it.

    They stay together in good orders [george1981, 5.3], as the coordinates of a point do. Groups are found by sums of
    random numbers, of which two different ones agree with a probability of 1e-19; the order is then worse.
    """
    size = graph.shape[0]
    numbers = np.random.default_rng(0).integers(2**63, size=size, dtype=np.uint64)
    sums = analysis.neighbour_sums(graph.indptr, graph.indices, numbers)
    _, first, group = np.unique(sums, return_index=True, return_inverse=True)
    if first.size > _GROUPED * size:
        return np.arange(size)
    rank = np.empty(first.size, np.int64)
    rank[np.argsort(first)] = np.arange(first.size)  # numbered by their first vertices
    return np.asarray(rank[group])


def _expanded(found: Elimination, graph: sps.csr_array, group: Index, sizes: Index) -> Elimination:
    """The elimination of a ``graph`` from that of its groups (n,), which have ``sizes``: their vertices in turn."""
    place = np.empty_like(found.order)
    place[found.order] = np.arange(found.order.size)
    order = np.argsort(place[group], kind="stable")
    begins = np.concatenate([[0], np.cumsum(sizes[found.order])])
    members = np.arange(order.size) - np.repeat(begins[:-1], np.diff(begins))
    parent = np.arange(1, order.size + 1)
    parent[begins[1:] - 1] = np.where(found.parent >= 0, begins[found.parent], -1)
    counts = np.repeat(found.counts, np.diff(begins)) - members
    return Elimination(order, _permuted(graph, order), parent, counts, found.products)


def eliminated(graph: sps.csr_array, order: Index, sizes: Index | None = None) -> Elimination:
    """What an order of elimination means, put in postorder.

    With ``sizes`` (n,) every vertex is as many, which follow each other: the counts are those of its first.
    """
    permuted = _permuted(graph, order)
    after = analysis.postorder(analysis.elimination_tree(*row_lists(permuted)))
    permuted, order = _permuted(permuted, after), order[after]
    lists = row_lists(permuted)
    parent = analysis.elimination_tree(*lists)
    own = np.ones(order.size, np.int64) if sizes is None else sizes[order]
    counts = analysis.column_counts(*lists, parent, own)
    high, width = counts.astype(np.float64), own.astype(np.float64)
    # Squares of the counts of as many columns, each one less.
    squares = width * high**2 - (width - 1.0) * width * high + (width - 1.0) * width * (2.0 * width - 1.0) / 6.0
    return Elimination(order, permuted, parent, counts, float(np.sum(squares)))


def minimum_degree(graph: sps.csr_array) -> Index:
    """Minimum-degree order (n,) of a graph, by SuperLU.

    SuperLU tells its order with a factor alone. An incomplete factor that drops all it may takes a fifth of the time.
    """
    degrees = np.diff(graph.indptr).astype(np.float64)
    ones = sps.csc_matrix((np.ones(graph.nnz), graph.indices, graph.indptr), shape=graph.shape)
    definite = sps.csc_matrix(sps.diags(2.0 * degrees + 1.0, format="csc") - ones)
    factor = spla.spilu(
        definite,
        drop_tol=1.0,
        fill_factor=1.0,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return np.argsort(factor.perm_c).astype(np.int64)


def nested_dissection(graph: sps.csr_array) -> Index:
    """Nested dissection order (n,) of a graph [george1973], its small parts by minimum degree."""
    size = graph.shape[0]
    order, part = dissect(*row_lists(graph), _LEAF)
    place = np.argsort(order)
    # All small parts by one minimum degree: they are parts of a graph without the separators.
    entries, part = graph.tocoo(), part[place]
    inside = (part[entries.row] == part[entries.col]) & (part[entries.row] >= 0)
    vertices = np.flatnonzero(part >= 0)
    number = np.full(size, -1)
    number[vertices] = np.arange(vertices.size)
    ends = number[entries.row[inside]], number[entries.col[inside]]
    parts = sps.csr_array((np.ones(ends[0].size, dtype=np.int32), ends), shape=(vertices.size, vertices.size))
    ordered = vertices[minimum_degree(parts)]
    ordered = ordered[np.argsort(part[ordered], kind="stable")]
    begins = part[ordered]
    place[ordered] = begins + np.arange(ordered.size) - np.searchsorted(begins, begins)
    return np.argsort(place)


def row_lists(graph: sps.csr_array) -> tuple[Index, Index]:
    """Row starts and neighbours as the compiled analysis takes them."""
    return graph.indptr.astype(np.int64), graph.indices.astype(np.int64)


def _permuted(graph: sps.csr_array, order: Index) -> sps.csr_array:
    """The graph on its vertices' places in an order; neighbours are not sorted."""
    place = np.empty(order.size, dtype=graph.indices.dtype)
    place[order] = np.arange(order.size)
    rows = graph[order]
    return sps.csr_array((rows.data, place[rows.indices], rows.indptr), shape=graph.shape)
