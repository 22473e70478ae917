"""The multifrontal Cholesky factorisation against dense algebra and SciPy's SuperLU."""

import copy
import pickle

import numpy as np
import pytest
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from hypothesis import given, settings
from hypothesis import strategies as st

import modalshell as ms
from modalshell.kernels.packed import LANES, dot
from modalshell.linalg import CholeskyAnalysis, NotPositiveDefiniteError, multifrontal
from modalshell.linalg.cholesky import without_zeros
from modalshell.modes.factorisation import Factoriser
from modalshell.shell import GAUSS_NEWTON


def random_definite(size, density, seed, block=1):
    """A random symmetric, diagonally dominant matrix of dense blocks."""
    rng = np.random.default_rng(seed)
    graph = sps.random_array((size, size), density=density, rng=rng)
    pattern = sps.csc_array(((graph + graph.T) != 0).astype(float) + sps.eye_array(size))
    whole = sps.csc_array(sps.kron(pattern, np.ones((block, block))))
    values = sps.csc_array((rng.uniform(-1.0, 1.0, whole.nnz), whole.indices, whole.indptr), whole.shape)
    values = sps.csc_array(0.5 * (values + values.T))
    dominant = np.asarray(abs(values).sum(axis=1)).ravel() + 0.1
    return sps.csc_array(values + sps.diags_array(dominant)), rng


def shell_stiffness(mesh, moved=0.0, seed=0):
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.06)
    noise = moved * np.random.default_rng(seed).standard_normal(mesh.vertices.shape)
    noise[shell.clamped] = 0.0
    free = shell.free_unknowns
    matrix = sps.csc_array(sps.csc_array(shell.stiffness(mesh.vertices + noise))[free][:, free])
    matrix.sort_indices()
    return matrix


def residual(matrix, solution, right_side):
    return np.linalg.norm(matrix @ solution - right_side) / np.linalg.norm(right_side)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.floats(0.0, 0.5), st.integers(0, 2**32 - 1), st.sampled_from([1, 3]))
def test_random_matrices_are_solved(size, density, seed, block):
    matrix, rng = random_definite(size, density, seed, block)
    factor = CholeskyAnalysis(matrix).factorise(matrix)
    right_sides = rng.standard_normal((size * block, 4))
    exact = np.linalg.solve(matrix.toarray(), right_sides)
    for chosen in (slice(None), slice(0, 3), 0):  # three at once have a kernel of their own
        found = factor.solve(right_sides[:, chosen])
        np.testing.assert_allclose(found, exact[:, chosen], rtol=0, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize(
    "pattern",
    [
        sps.eye_array(7),
        np.ones((30, 30)),
        sps.block_diag([sps.coo_array(np.ones((size, size))) for size in (4, 1, 5)]),
        sps.diags_array([np.ones(59), np.ones(60), np.ones(59)], offsets=[-1, 0, 1]),
    ],
    ids=["diagonal", "dense", "loose parts", "chain"],
)
def test_special_patterns_are_solved(pattern):
    matrix = sps.csc_array(sps.csc_array(pattern) * 0.5 + sps.diags_array(np.full(pattern.shape[0], 40.0)))
    right_side = np.arange(1.0, pattern.shape[0] + 1.0)
    assert residual(matrix, CholeskyAnalysis(matrix).factorise(matrix).solve(right_side), right_side) < 1e-14


@pytest.mark.parametrize("size", [120, 119, 101, 7])
def test_loose_parts_are_solved_to_the_same_bits_as_each_alone(size):
    """Registers read beyond the last row of a panel, what follows there: another panel, or zeros."""
    count = 12
    part = sps.csc_array(np.ones((size, size)) + 40.0 * np.eye(size))
    whole = sps.csc_array(sps.block_diag([part] * count))
    factor = CholeskyAnalysis(whole).factorise(whole)
    right_sides = np.random.default_rng(3).standard_normal((size, 3))
    alone = CholeskyAnalysis(part).factorise(part)
    for chosen in (0, slice(0, 3)):
        found = factor.solve(np.concatenate([right_sides[:, chosen]] * count))
        np.testing.assert_array_equal(found, np.concatenate([alone.solve(right_sides[:, chosen])] * count))


@pytest.mark.parametrize("reverse", [False, True])
def test_arrow_matrices_do_not_fill(reverse):
    """Minimum degree eliminates the dense row last, wherever it stands."""
    n = 300
    matrix = sps.lil_array((n, n))
    matrix.setdiag(float(n))
    row = n - 1 if reverse else 0
    matrix[row, :] = matrix[:, row] = 1.0
    matrix[row, row] = float(n)
    matrix = sps.csc_array(matrix)
    analysis = CholeskyAnalysis(matrix)
    assert analysis.entries < 10 * n
    right_side = np.ones(n)
    assert residual(matrix, analysis.factorise(matrix).solve(right_side), right_side) < 1e-14


@pytest.mark.parametrize(
    "make",
    [lambda: ms.sheet(cells=(24, 24)), lambda: ms.v_beam(cells=(40, 8)), ms.leaf],
    ids=["sheet", "V", "leaf"],
)
def test_shells_are_solved_as_by_superlu(make):
    matrix = shell_stiffness(make())
    analysis = CholeskyAnalysis(matrix)
    assert analysis.block == 3
    right_side = np.random.default_rng(1).standard_normal(matrix.shape[0])
    reference = spla.splu(sps.csc_matrix(matrix))
    ours = residual(matrix, analysis.factorise(matrix).solve(right_side), right_side)
    assert ours < 10.0 * residual(matrix, reference.solve(right_side), right_side)


def test_one_analysis_serves_every_matrix_of_its_pattern_to_the_same_bits():
    first, second = (shell_stiffness(ms.sheet(cells=(12, 12)), 1e-3, seed) for seed in (0, 1))
    first.data += 0.0
    shift = sps.diags_array(np.full(first.shape[0], 1e3), format="csc")
    first, second = sps.csc_array(first + shift), sps.csc_array(second + shift)
    kept = CholeskyAnalysis(first)
    right_side = np.random.default_rng(2).standard_normal(first.shape[0])
    held = kept.factorise(first)
    again = kept.factorise(second).solve(right_side)
    np.testing.assert_array_equal(again, CholeskyAnalysis(second).factorise(second).solve(right_side))
    assert residual(second, again, right_side) < 1e-12
    # A factor does not change when the next one is made.
    assert residual(first, held.solve(right_side), right_side) < 1e-12


@pytest.mark.parametrize("block", [1, 3])
def test_rows_of_a_column_may_come_in_any_order(block):
    matrix, rng = random_definite(40, 0.1, 0, block)
    mixed = np.lexsort([rng.random(matrix.nnz), np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))])
    given = sps.csc_array((matrix.data[mixed], matrix.indices[mixed], matrix.indptr.copy()), matrix.shape)
    for backend in ("cholesky", "superlu"):
        found = Factoriser(backend).definite(given).solve(matrix @ np.ones(matrix.shape[0]))
        np.testing.assert_allclose(found, 1.0, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(given.toarray(), matrix.toarray())


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_indefinite_matrices_are_refused_with_the_place(size, seed):
    matrix, rng = random_definite(size, 0.2, seed)
    wrong = int(rng.integers(size))
    dense = matrix.toarray()
    dense[wrong, wrong] = -dense[wrong, wrong]
    matrix = sps.csc_array(dense)
    with pytest.raises(NotPositiveDefiniteError, match=r"pivot \d+ is not positive") as caught:
        CholeskyAnalysis(matrix).factorise(matrix)
    assert 0 <= caught.value.unknown < size


def test_singular_matrices_are_refused_or_solved_to_their_condition():
    """A free chain is singular; held by a weak spring it is definite, with a condition number of 1e10."""
    n = 50
    chain = sps.diags_array([np.full(n - 1, -1.0), np.full(n, 2.0), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]).tolil()
    chain[0, 0] = chain[n - 1, n - 1] = 1.0
    held = chain.copy()
    held[0, 0] += 1e-7
    matrix = sps.csc_array(held)
    exact = np.random.default_rng(0).standard_normal(n)
    solution = CholeskyAnalysis(matrix).factorise(matrix).solve(matrix @ exact)
    assert np.linalg.norm(solution - exact) < 1e-4 * np.linalg.norm(exact)
    singular = sps.csc_array(chain)
    singular.data *= 1.0
    below = sps.csc_array(singular - 1e-9 * sps.eye_array(n))
    with pytest.raises(NotPositiveDefiniteError):
        CholeskyAnalysis(below).factorise(below)


def test_a_factor_survives_pickling():
    matrix = shell_stiffness(ms.sheet(cells=(24, 24)))
    factor = CholeskyAnalysis(matrix).factorise(matrix)
    right_side = np.arange(matrix.shape[0], dtype=float)
    for twin in (pickle.loads(pickle.dumps(factor)), copy.deepcopy(factor)):
        np.testing.assert_array_equal(twin.solve(right_side), factor.solve(right_side))


def test_nothing_at_all_is_solved():
    empty = sps.csc_array((0, 0))
    assert CholeskyAnalysis(empty).factorise(empty).solve(np.empty(0)).shape == (0,)


@pytest.mark.by_default("narrow")
@pytest.mark.parametrize("sizes", [(0, 1), (12, 30), (90, 90), (60, 450)], ids=["single", "narrow", "wide", "panels"])
def test_updates_wider_than_their_buffer_are_formed_behind_the_panel(sizes):
    # Two parts touch 400 unknowns each of the 800 that are dense among themselves: updates of 400 x 400 numbers. Each
    # has a child, which does not touch an eighth of them.
    touched, count = 400, 2 * (sizes[0] + sizes[1])
    assert touched**2 > multifrontal._CACHED
    pattern = np.zeros((count + 2 * touched, count + 2 * touched))
    pattern[count:, count:] = 1.0
    for half in range(2):
        begin, end = half * count // 2, (half + 1) * count // 2
        front = slice(count + half * touched, count + (half + 1) * touched)
        leaf = slice(begin, begin + sizes[0])
        pattern[begin:end, begin:end] = 1.0
        pattern[begin:end, front] = pattern[front, begin:end] = 1.0
        skipped = slice(front.start, front.start + touched // 8)  # so that the leaf is a supernode of its own
        pattern[leaf, skipped] = pattern[skipped, leaf] = 0.0
    rng = np.random.default_rng(count)
    values = np.triu(pattern * rng.uniform(-1.0, 1.0, pattern.shape))
    values += values.T
    values += np.diag(np.abs(values).sum(axis=1))
    matrix = sps.csc_array(values)
    right_sides = rng.standard_normal((len(values), 2))
    found = CholeskyAnalysis(matrix).factorise(matrix).solve(right_sides)
    exact = np.linalg.solve(values, right_sides)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-13 * np.abs(exact).max())


@pytest.mark.parametrize("block", [1, 3])
def test_supernodes_wider_than_a_panel_keep_no_rows_above_it(block):
    size = 4 * multifrontal.PANEL // block
    matrix, rng = random_definite(size, 0.2, 0, block)
    analysis = CholeskyAnalysis(matrix)
    assert analysis.entries < 0.52 * (size * block) ** 2
    exact = rng.standard_normal((size * block, 3))
    for chosen in (slice(None), slice(0, 2), 0):
        found = analysis.factorise(matrix).solve((matrix @ exact)[:, chosen])
        np.testing.assert_allclose(found, exact[:, chosen], rtol=0, atol=1e-12)
    many = rng.standard_normal((size * block, 18))  # whole registers of right sides, and two alone
    for single in (False, True):
        factor = analysis.factorise(matrix, single=single)
        assert factor._values.size == analysis.entries + 2 * LANES  # without the room that updates waited in
        np.testing.assert_allclose(factor.solve(matrix @ many), many, rtol=0, atol=1e-3 if single else 1e-12)
    last = int(analysis.order[-5])
    matrix[last, last] *= -1.0
    with pytest.raises(NotPositiveDefiniteError) as caught:
        analysis.factorise(matrix)
    assert caught.value.unknown == last


@pytest.mark.parametrize("negative", [0, 1, 5, 60])
@pytest.mark.parametrize("block", [1, 3])
def test_signed_factors_solve_with_indefinite_matrices(block, negative):
    """Supernodes of several panels among them: the signs are those of the eigenvalues, the solutions those asked."""
    rng = np.random.default_rng(negative)
    clusters, wide = sps.diags_array(np.ones((7, 12)), offsets=range(-3, 4), shape=(12, 12)), np.ones((36, 36))
    matrix = sps.csc_array(sps.kron(clusters, wide))
    values = sps.csc_array((rng.standard_normal(matrix.nnz), matrix.indices, matrix.indptr), matrix.shape)
    matrix = sps.csc_array(values + values.T)
    diagonal = np.asarray(abs(matrix).sum(axis=0)).ravel() + 1.0
    diagonal[rng.choice(diagonal.size, negative, replace=False)] *= -1.0
    matrix.setdiag(diagonal)
    if block == 1:  # the same in another pattern: one unknown has neighbours that the others of its block have not
        matrix = sps.csc_array(sps.block_diag([matrix, np.eye(1)]))
    analysis = CholeskyAnalysis(matrix)
    assert analysis.block == block
    assert np.diff(analysis._supernodes.first_panel).max() > 1
    factor, expected = analysis.factorise(matrix, signed=True), rng.standard_normal((matrix.shape[0], 9))
    assert factor.negative == negative == (np.linalg.eigvalsh(matrix.toarray()) < 0.0).sum()
    for some in (expected, expected[:, 0]):
        np.testing.assert_allclose(factor.solve(matrix @ some), some, rtol=0, atol=1e-10)
    if negative:
        with pytest.raises(NotPositiveDefiniteError):
            analysis.factorise(matrix)
    matrix.data[:] = 0.0
    with pytest.raises(NotPositiveDefiniteError):
        analysis.factorise(matrix, signed=True)


def test_dots_of_any_length_and_place():
    a, b = np.random.default_rng(0).standard_normal((2, 60))
    for count in range(40):
        assert dot(a, 3, b, 7, count) == pytest.approx(a[3 : 3 + count] @ b[7 : 7 + count], abs=1e-13)
    b[7 + 5 :] = np.nan  # nothing beyond is read
    assert np.isfinite(dot(a, 0, b, 7, 5))


@pytest.mark.parametrize("energy", ["hinges", "shell theory"])
def test_stored_zeros_of_a_flat_sheet_are_left_out(energy):
    """Bending meets no force in the plane: a factor of half the size gives the same solution."""
    mesh = ms.sheet(cells=(20, 20))
    theory = ms.Isotropic(young=1e6, poisson=0.3, thickness=1e-2, density=200.0)
    material = theory if energy == "shell theory" else ms.Material(1000.0, 20.0, 0.01, 0.2)
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.1)
    matrix = shell.pattern.free_matrix(shell.hessian(shell.rest_positions, GAUSS_NEWTON))
    less = without_zeros(matrix)
    assert less.nnz < 0.45 * matrix.nnz
    assert (less != matrix).nnz == 0
    whole, part = CholeskyAnalysis(matrix), CholeskyAnalysis(less)
    assert part.entries < 0.6 * whole.entries
    right_side = np.random.default_rng(2).standard_normal(matrix.shape[0])
    found, expected = part.factorise(less).solve(right_side), whole.factorise(matrix).solve(right_side)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_few_zeros_stay_and_so_do_those_of_unsymmetric_patterns():
    full = sps.csc_array(np.ones((9, 9)) + 9.0 * np.eye(9))
    full.data[3] = 0.0
    assert without_zeros(full) is full
    corner = sps.csc_array((np.array([1.0, 0.0, 0.0, 1.0]), np.array([0, 1, 2, 2]), np.array([0, 3, 3, 4])), (3, 3))
    assert without_zeros(corner) is corner
