"""The sparsity pattern of the stiffness matrix against dense assembly of element blocks."""

import numpy as np
import pytest
import scipy.sparse as sps

import modalshell as ms
from modalshell.shell.pattern import InternalUnknowns, build_pattern

STENCILS = [np.array([[0, 1, 2], [2, 1, 4]]), np.array([[4, 5]]), np.array([[0, 1, 2, 6], [-1, 3, 4, 7]])]
"""Elements of six vertices and two, 6 and 7, that are not of the mesh."""


@pytest.fixture(params=[[], [0], [1, 3, 5]], ids=["free", "one held", "three held"])
def shell(request):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [1, 1, 0], [2, 1, 0]], dtype=float)
    mesh = ms.TriangleMesh(vertices, [[0, 1, 2], [2, 1, 4], [1, 3, 4], [4, 3, 5]])
    return ms.Shell(mesh, ms.Material(1.0, 1.0, 1.0, 1.0), clamped=request.param)


def test_blocks_stand_where_their_vertices_meet(shell):
    pattern, slots = build_pattern(6, STENCILS, shell.unknowns)
    data, dense = np.zeros(pattern.size), np.zeros((18, 18))
    rng = np.random.default_rng(0)
    for stencil, places in zip(STENCILS, slots, strict=True):
        for element, own in zip(stencil, places, strict=True):
            for i, row in enumerate(element):
                for j, column in enumerate(element):
                    if not (0 <= row < 6 and 0 <= column < 6):
                        assert own[i, j] == -1
                        continue
                    block = rng.standard_normal((3, 3))
                    dense[3 * row : 3 * row + 3, 3 * column : 3 * column + 3] += block
                    for d in range(3):
                        begin = own[i, j] + d * pattern.strides[row]
                        data[begin : begin + 3] += block[d]
    np.testing.assert_array_equal(pattern.matrix(data).toarray(), dense)
    np.testing.assert_array_equal(data[pattern.diagonal], dense.diagonal())
    free = shell.free_unknowns
    # Its arrays are those of rows, handed out as columns: matrices are symmetric.
    np.testing.assert_array_equal(pattern.free_matrix(data).toarray().T, dense[np.ix_(free, free)])


def test_every_diagonal_block_is_there(shell):
    pattern, _ = build_pattern(6, [], shell.unknowns)
    assert pattern.size == 54
    data = np.arange(54.0)
    assert pattern.matrix(data).nnz == 54
    assert pattern.free_matrix(data).shape == (shell.unknowns.count,) * 2


def test_internal_unknowns_come_after_the_free_ones(shell):
    vertices = sps.csr_array(np.array([[1, 0, 1, 0, 1, 0], [0, 1, 0, 0, 1, 1]], dtype=bool))
    internal = InternalUnknowns(vertices, sps.csr_array([[2.0, 0.5], [0.5, 3.0]]), solve=None)
    pattern, _ = build_pattern(6, STENCILS, shell.unknowns, internal)
    data = np.random.default_rng(0).standard_normal(pattern.size)
    data[-4:] = internal.stiffness.data
    coupling = pattern.coupling(data).toarray()
    np.testing.assert_array_equal(coupling != 0.0, np.repeat(vertices.toarray(), 3, axis=1))
    dense = np.block([[pattern.matrix(data).toarray(), coupling.T], [coupling, internal.stiffness.toarray()]])
    free = np.concatenate([shell.free_unknowns, [18, 19]])
    np.testing.assert_array_equal(pattern.free_matrix(data).toarray().T, dense[np.ix_(free, free)])
