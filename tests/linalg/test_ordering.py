"""Elimination orders: nested dissection against minimum degree."""

import itertools
import re

import numpy as np
import pytest
import scipy.sparse as sps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import maximum_flow

import modalshell as ms
from modalshell.linalg import CholeskyAnalysis, ProfileAnalysis, block_graph
from modalshell.linalg.cholesky import symmetric_block_graph
from modalshell.linalg.dissection import dissect, minimum_separator
from modalshell.linalg.ordering import best_elimination, eliminated, minimum_degree, nested_dissection, row_lists


def graph_of(edges, size):
    """A graph with its diagonal, as patterns of matrices are."""
    ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
    graph = sps.coo_array((np.ones(len(ends), dtype=np.int32), ends.T), shape=(size, size))
    graph = sps.csr_array(graph + graph.T + sps.eye_array(size, dtype=np.int32))
    graph.sort_indices()
    return graph


def sheet_graph(cells):
    """Vertices of a sheet that share an edge or a hinge."""
    mesh = ms.sheet(cells=(cells, cells))
    return graph_of(np.vstack([mesh.edges, mesh.hinges[:, 2:]]), len(mesh.vertices))


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 600), st.integers(0, 2000), st.integers(0, 2**32 - 1))
def test_dissection_orders_every_vertex_of_any_graph_once(size, edges, seed):
    ends = np.random.default_rng(seed).integers(size, size=(edges, 2))
    order = nested_dissection(graph_of(ends, size))
    np.testing.assert_array_equal(np.sort(order), np.arange(size))


@pytest.mark.parametrize(
    "edges",
    [
        np.empty((0, 2)),
        [(0, k) for k in range(1, 1500)],
        [(k, k + 1) for k in range(1499)],
        [(k, k + 1) for k in range(0, 1499, 2)],
    ],
    ids=["no edges", "star", "chain", "pairs"],
)
def test_graphs_without_good_separators_do_not_fill(edges):
    graph = graph_of(edges, 1500)
    found = best_elimination(graph)
    np.testing.assert_array_equal(np.sort(found.order), np.arange(1500))
    assert found.counts.sum() <= 3 * 1500


def test_dissection_of_a_sheet_saves_products():
    graph = sheet_graph(90)
    dissected = eliminated(graph, nested_dissection(graph)).products
    assert dissected < 0.8 * eliminated(graph, minimum_degree(graph)).products
    assert best_elimination(graph).products == dissected


def test_the_cheaper_order_is_taken():
    """A star of thin strips: cuts across its middle are wide, minimum degree peels it from the tips."""
    arms, length, width = 12, 40, 3
    edges = []
    for arm in range(arms):
        number = 1 + arm * length * width + np.arange(length * width).reshape(length, width)
        edges += [*zip(number[:-1].ravel(), number[1:].ravel(), strict=True)]
        edges += [*zip(number[:, :-1].ravel(), number[:, 1:].ravel(), strict=True)]
        edges += [(0, int(end)) for end in number[0]]
    graph = graph_of(edges, 1 + arms * length * width)
    both = [eliminated(graph, order(graph)).products for order in (minimum_degree, nested_dissection)]
    assert best_elimination(graph).products == min(both)


@pytest.mark.parametrize("analysis", [CholeskyAnalysis, ProfileAnalysis])
@pytest.mark.parametrize("triangle", [sps.tril, sps.triu], ids=["lower", "upper"])
def test_a_matrix_with_one_triangle_is_refused(triangle, analysis):
    matrix = sps.csc_array(triangle(sps.csc_array(np.ones((9, 9)) + 9.0 * np.eye(9))))
    with pytest.raises(ValueError, match="both triangles"):
        analysis(matrix)


@pytest.mark.parametrize("analysis", [CholeskyAnalysis, ProfileAnalysis])
@pytest.mark.parametrize("block", [1, 3])
@pytest.mark.parametrize("size", [40, 2000])
def test_a_matrix_with_an_unsymmetric_pattern_is_refused(size, block, analysis):
    """As many entries above the diagonal as below it, in other places; the larger one would be dissected."""
    pattern = sps.diags_array([np.ones(size), np.ones(size - 1), np.ones(size - 7)], offsets=[0, 1, -7], dtype=float)
    pattern = sps.lil_array(pattern)
    pattern[np.arange(6), np.arange(6) + 9] = 1.0
    with pytest.raises(ValueError, match=r"symmetric pattern.*row \d+ than in column \d+"):
        analysis(sps.csc_array(sps.kron(pattern, np.ones((block, block)))))


@pytest.mark.parametrize("analysis", [CholeskyAnalysis, ProfileAnalysis])
def test_a_matrix_that_is_not_square_is_refused(analysis):
    with pytest.raises(ValueError, match=r"square .got 6 rows and 9 columns"):
        analysis(sps.csc_array(np.ones((6, 9))))


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.integers(1, 12), st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_symmetry_of_a_pattern_is_found(size, edges, seed):
    ends = np.random.default_rng(seed).integers(size, size=(2, edges))
    graph = sps.csr_array(sps.coo_array((np.ones(edges, dtype=np.int32), ends), shape=(size, size)))
    graph.sum_duplicates()
    dense = graph.toarray() != 0
    wrong = np.flatnonzero((dense != dense.T).any(axis=1))
    if not wrong.size:
        symmetric_block_graph(sps.csc_array(graph))
        return
    with pytest.raises(ValueError, match="symmetric pattern") as refusal:
        symmetric_block_graph(sps.csc_array(graph))
    assert int(re.search(r"row (\d+)", str(refusal.value))[1]) in wrong


def test_a_matrix_with_an_entry_twice_is_refused():
    """Two parts of one entry, which SciPy adds, above and below the diagonal."""
    places = np.array([0, 1, 1, 2, 0, 0, 1, 2, 2]), np.array([0, 3, 6, 9])
    matrix = sps.csc_array((np.array([9.0, 1.0, 1.0, 1.0, 1.0, 1.0, 9.0, 1.0, 9.0]), *places), shape=(3, 3))
    with pytest.raises(ValueError, match="every entry once"):
        CholeskyAnalysis(matrix)


def test_a_factor_in_the_order_of_dissection_solves():
    """Large enough for separators of several levels, whose updates wait on the stack."""
    graph = sheet_graph(40)
    matrix = sps.csc_array(sps.kron(graph, np.ones((3, 3))) * -1.0)
    matrix.setdiag(np.asarray(-matrix.sum(axis=1)).ravel() + 3.0)
    analysis = CholeskyAnalysis(matrix)
    assert block_graph(matrix)[0] == analysis.block == 3
    exact = np.random.default_rng(0).standard_normal((matrix.shape[0], 2))
    solution = analysis.factorise(matrix).solve(matrix @ exact)
    np.testing.assert_allclose(solution, exact, rtol=0, atol=1e-12 * np.abs(exact).max())


def test_what_separators_leave_apart_is_dissected_on():
    """A chain with a leaf at each vertex, which is alone once that is in a separator."""
    spine = np.arange(2000)
    graph = graph_of([*itertools.pairwise(spine), *zip(spine, spine + 2000, strict=True)], 4000)
    part = dissect(*row_lists(graph), 100)[1]
    assert np.bincount(part[part >= 0]).max() <= 100


def test_one_factor_has_one_order():
    small, large = sheet_graph(30), sheet_graph(33)
    np.testing.assert_array_equal(
        best_elimination(large, once=True).order, eliminated(large, nested_dissection(large)).order
    )
    np.testing.assert_array_equal(
        best_elimination(small, once=True).order, eliminated(small, minimum_degree(small)).order
    )


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.integers(2, 40), st.integers(1, 120), st.integers(0, 2**32 - 1))
def test_separators_are_as_small_as_the_flow_between_the_sides(size, edges, seed):
    """Menger's theorem, against SciPy's maximum flow through vertices that are edges of capacity one."""
    random = np.random.default_rng(seed)
    graph = graph_of(random.integers(size, size=(edges, 2)), size)
    side, along = random.choice(3, size, p=[0.2, 0.2, 0.6]), random.integers(9, size=size)
    ends = graph.tocoo().coords
    fixed = side != 2
    fixed[ends[0][(side[ends[0]] == 0) & (side[ends[1]] == 1)]] = False
    capacity = np.where(fixed, size, 1)
    source, sink = np.flatnonzero(fixed & (side == 0)), np.flatnonzero(fixed & (side == 1))
    rows = np.concatenate([np.arange(size), size + ends[0], np.full(source.size, 2 * size), size + sink])
    columns = np.concatenate([size + np.arange(size), ends[1], source, np.full(sink.size, 2 * size + 1)])
    numbers = np.concatenate([capacity, np.full(rows.size - size, size)]).astype(np.int32)
    network = sps.csr_array((numbers, (rows, columns)), shape=(2 * size + 2,) * 2)
    most = maximum_flow(sps.csr_matrix(network), 2 * size, 2 * size + 1).flow_value

    cut = side.copy()
    assert minimum_separator(*row_lists(graph), along, cut) == np.count_nonzero(cut == 2) == most
    assert not ((cut[ends[0]] == 0) & (cut[ends[1]] == 1)).any()
    np.testing.assert_array_equal(cut[fixed], side[fixed])


def test_a_tube_is_cut_where_it_is_narrow():
    """Rings of 40 vertices, some beyond the middle of 12: one of these is the separator."""
    rings, wide, narrow = 100, 40, 12
    sizes = np.full(rings, wide)
    sizes[55:62] = narrow
    begins = np.concatenate([[0], np.cumsum(sizes)])
    edges = []
    for ring in range(rings):
        own = begins[ring] + np.arange(sizes[ring])
        edges += [*zip(own, np.roll(own, 1), strict=True)]
        if ring + 1 < rings:
            other = begins[ring + 1] + np.arange(max(sizes[ring], sizes[ring + 1])) % sizes[ring + 1]
            edges += [*zip(np.resize(own, other.size), other, strict=True)]
    _, part = dissect(*row_lists(graph_of(edges, begins[-1])), 2 * begins[-1] // 3)
    assert np.count_nonzero(part < 0) == narrow


def test_coordinates_among_scalars_are_ordered_as_points():
    # A point's three coordinates have the same neighbours, and so they follow one another in the order.
    mesh = ms.flat_beam(cells=(24, 6))
    shell = ms.Shell(mesh, ms.Isotropic(1e6, 0.3, 0.01, 100.0), mesh.vertices[:, 0] < 1e-9)
    matrix = shell.pattern.free_matrix(shell.energy_gradient_hessian(shell.rest_positions, 0)[2])
    graph = block_graph(matrix)[1]
    found = best_elimination(graph)
    place = np.argsort(found.order)[: 3 * len(shell.free)].reshape(-1, 3)
    np.testing.assert_array_equal(np.ptp(np.sort(place, axis=1), axis=1), 2)
    assert found.products <= 1.1 * eliminated(graph, minimum_degree(graph)).products
