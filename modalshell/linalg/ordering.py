"""Elimination orders of a symmetric pattern: minimum degree, and nested dissection of the graph."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from modalshell.linalg import analysis
from modalshell.typing import Array, Index

_LEAF = 100
"""Vertices of a part that is not dissected any further: minimum degree orders it."""
_DISSECTED = 1000
"""Vertices of a graph from which dissection is tried."""
_WORTH = 500_000
"""Operations a vertex from which dissection may save its own time in one factorisation."""
_GROUPED = 0.75
"""Groups of indistinguishable vertices, over the vertices, from which a graph is ordered as it is."""
_LANDMARKS, _SMOOTHED = 8, 2
"""Vertices whose distances serve as coordinates, and how often these are averaged over neighbours."""


class Elimination(NamedTuple):
    """An order of elimination (n,), the permuted graph, its elimination tree and the factor's column counts."""

    order: Index
    graph: sps.csr_array
    parent: Index
    counts: Index

    @property
    def products(self) -> float:
        """Multiplications of the factorisation, in blocks."""
        return float(np.sum(self.counts.astype(np.float64) ** 2))


def best_elimination(graph: sps.csr_array, block: int = 1, *, once: bool = False) -> Elimination:
    """The cheaper of minimum degree and nested dissection, in postorder of its elimination tree.

    Dissection takes 0.6 of the products on sheets of 10,000 and 100,000 vertices, minimum degree fewer on small sheets
    and on branching shapes. For a pattern that is factorised once, dissection is tried only where it may pay; where
    points' coordinates are among more single unknowns, as those of split folds, it takes 1.5 to 2.3 times the products.
    """
    group = _indistinguishable(graph)
    _, first, sizes = np.unique(group, return_index=True, return_counts=True)
    whole = first.size == group.size
    smaller = graph if whole else sps.csr_array(graph[first][:, first])
    best = eliminated(graph, _expanded(minimum_degree(smaller), group))
    mixed = not whole and 2 * np.count_nonzero(sizes == 1) > sizes.size
    if not mixed and smaller.shape[0] >= _DISSECTED and (not once or best.products * block**3 > _WORTH * group.size):
        dissected = eliminated(graph, _expanded(nested_dissection(smaller), group))
        best = min(best, dissected, key=lambda found: found.products)
    return best


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


def _expanded(order: Index, group: Index) -> Index:
    """Order (n,) of vertices from that of their groups (n,)."""
    if order.size == group.size:
        return order
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    return np.argsort(place[group], kind="stable")


def eliminated(graph: sps.csr_array, order: Index) -> Elimination:
    """What an order of elimination means, put in postorder."""
    permuted = _permuted(graph, order)
    after = analysis.postorder(analysis.elimination_tree(*row_lists(permuted)))
    permuted = _permuted(permuted, after)
    lists = row_lists(permuted)
    parent = analysis.elimination_tree(*lists)
    return Elimination(order[after], permuted, parent, analysis.column_counts(*lists, parent))


def minimum_degree(graph: sps.csr_array) -> Index:
    """Minimum-degree order (n,) of a graph, by SuperLU."""
    degrees = np.diff(graph.indptr).astype(np.float64)
    ones = sps.csc_matrix((np.ones(graph.nnz), graph.indices, graph.indptr), shape=graph.shape)
    definite = sps.csc_matrix(sps.diags(2.0 * degrees + 1.0, format="csc") - ones)
    options = {"SymmetricMode": True}
    factor = spla.splu(definite, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.argsort(factor.perm_c).astype(np.int64)


def nested_dissection(graph: sps.csr_array) -> Index:
    """Nested dissection order (n,) of a graph [george1973], its small parts by minimum degree.

    Each part is cut in half across one of four axes in the plane of its two longest principal axes, where the fewest
    vertices separate the halves. A vertex's coordinates are its distances in the graph from a few far vertices. All
    parts of a level are cut at once.
    """
    size = graph.shape[0]
    points = _distances(graph)
    entries = graph.tocoo()
    edges = entries.row.astype(np.int64), entries.col.astype(np.int64)
    place, leaf = np.empty(size, np.int64), np.full(size, -1)
    part, begin, active = np.zeros(size, np.int64), np.zeros(1, np.int64), np.arange(size)
    while active.size:
        own = part[active]
        upper, separates, across = _halves(points[active], active, part, edges, begin.size)
        half = 2 * own + upper
        sizes = np.bincount(half[~separates], minlength=2 * begin.size)
        begins = np.repeat(begin, 2)
        begins[1::2] += sizes[::2]
        # Separators come after both halves, from one end to the other.
        of = own[separates]
        order = np.lexsort((across[separates], of))
        place[active[separates][order]] = (begins[1::2] + sizes[1::2])[of[order]] + _numbers(of, begin.size)

        active, half = active[~separates], half[~separates]
        small = (sizes <= _LEAF)[half]
        leaf[active[small]] = begins[half[small]]
        going_on = np.flatnonzero(sizes > _LEAF)
        number = np.zeros(sizes.size, np.int64)
        number[going_on] = np.arange(going_on.size)
        active, begin = active[~small], begins[going_on]
        part[:] = -1
        part[active] = number[half[~small]]
        inside = (part[edges[0]] == part[edges[1]]) & (part[edges[0]] >= 0)
        edges = edges[0][inside], edges[1][inside]

    # All small parts by one minimum degree: they are parts of a graph without the separators.
    inside = (leaf[entries.row] == leaf[entries.col]) & (leaf[entries.row] >= 0)
    vertices = np.flatnonzero(leaf >= 0)
    number = np.full(size, -1)
    number[vertices] = np.arange(vertices.size)
    ends = number[entries.row[inside]], number[entries.col[inside]]
    parts = sps.csr_array((np.ones(ends[0].size, dtype=np.int32), ends), shape=(vertices.size, vertices.size))
    ordered = vertices[minimum_degree(parts)]
    ordered = ordered[np.argsort(leaf[ordered], kind="stable")]
    begins = leaf[ordered]
    place[ordered] = begins + np.arange(ordered.size) - np.searchsorted(begins, begins)
    return np.argsort(place)


def _halves(
    points: Array, active: Index, part: Index, edges: tuple[Index, Index], parts: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Array]:
    """Which of the active vertices (m,) are in the upper half of their part, which separate it, and where along it.

    ``points`` (m, k) are their coordinates, ``part`` (n,) the parts of all, ``edges`` those within the parts.
    """
    own = part[active]
    counts = np.bincount(own, minlength=parts)
    first, second = _principal_axes(points, own, counts)
    fewest, chosen = np.full(parts, part.size + 1), np.zeros((3, active.size))
    total, difference = first + second, first - second
    for along, across in ((first, second), (second, first), (total, difference), (difference, total)):
        order = np.lexsort((along, own))
        rank = np.empty(active.size, np.int64)
        rank[order] = _numbers(own, parts)
        upper = np.zeros(part.size, dtype=bool)
        upper[active] = 2 * rank >= counts[own]
        # Either side's ends of the edges between them separate the two: take the fewer.
        cut = upper[edges[1]] & ~upper[edges[0]]
        ends = np.zeros((2, part.size), dtype=bool)
        ends[0, edges[0][cut]] = ends[1, edges[1][cut]] = True
        lower_ends, upper_ends = (np.bincount(part[side], minlength=parts) for side in ends)
        better = np.minimum(lower_ends, upper_ends) < fewest
        fewest = np.minimum(fewest, np.minimum(lower_ends, upper_ends))
        separates = np.where((lower_ends <= upper_ends)[own], ends[0, active], ends[1, active])
        chosen = np.where(better[own], (upper[active], separates, across), chosen)
    return chosen[0] != 0.0, chosen[1] != 0.0, chosen[2]


def _numbers(parts: Index, count: int) -> Index:
    """Numbers from 0 on within each part, for members (m,) that are sorted by it."""
    sizes = np.bincount(parts, minlength=count)
    return np.arange(parts.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def row_lists(graph: sps.csr_array) -> tuple[Index, Index]:
    """Row starts and neighbours as the compiled analysis takes them."""
    return graph.indptr.astype(np.int64), graph.indices.astype(np.int64)


def _permuted(graph: sps.csr_array, order: Index) -> sps.csr_array:
    permuted = sps.csr_array(graph[order][:, order])
    permuted.sort_indices()
    return permuted


def _distances(graph: sps.csr_array) -> Array:
    """Distances (n, k) in the graph from vertices far from one another, smoothed."""
    lists = row_lists(graph)
    nearest = analysis.distances(*lists, 0)
    points = np.empty((graph.shape[0], _LANDMARKS))
    for k in range(_LANDMARKS):
        points[:, k] = analysis.distances(*lists, int(np.argmax(nearest)))
        nearest = points[:, 0] if k == 0 else np.minimum(nearest, points[:, k])
    mean = sps.csr_array((np.repeat(1.0 / np.diff(graph.indptr), np.diff(graph.indptr)), graph.indices, graph.indptr))
    for _ in range(_SMOOTHED):
        points = np.asarray(mean @ points)
    return points


def _principal_axes(points: Array, part: NDArray[np.int64], counts: Index) -> tuple[Array, Array]:
    """Coordinates (m,) of points (m, k) along the longest principal axis of their part, and along the second."""
    width = points.shape[1]
    means = np.stack([np.bincount(part, axis, counts.size) for axis in points.T], axis=1) / counts[:, None]
    centred = points - means[part]
    spread = np.empty((counts.size, width, width))
    for i in range(width):
        for j in range(i + 1):
            spread[:, i, j] = spread[:, j, i] = np.bincount(part, centred[:, i] * centred[:, j], counts.size)
    axes = np.linalg.eigh(spread)[1]
    first, second = axes[:, :, -1], axes[:, :, -2]
    return np.einsum("mk,mk->m", centred, first[part]), np.einsum("mk,mk->m", centred, second[part])
