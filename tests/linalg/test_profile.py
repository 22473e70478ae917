"""The profile factorisation against dense algebra and SciPy's SuperLU."""

import os
import pickle
import shutil
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from hypothesis import given, settings
from hypothesis import strategies as st
from linalg.test_cholesky import random_definite, shell_stiffness

import modalshell as ms
from modalshell.kernels.compiler import cache_folder
from modalshell.linalg import ProfileAnalysis


def factorised(matrix, points=None):
    return ProfileAnalysis(matrix, points).factorise(matrix)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.floats(0.0, 0.5), st.integers(0, 2**32 - 1), st.sampled_from([1, 3]))
def test_random_matrices_are_solved(size, density, seed, block):
    matrix, rng = random_definite(size, density, seed, block)
    points = rng.standard_normal((size, 2))
    factor = factorised(matrix)
    right_sides = rng.standard_normal((size * block, 4))
    exact = np.linalg.solve(matrix.toarray(), right_sides)
    np.testing.assert_allclose(factor.solve(right_sides), exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    solution = factorised(matrix, points).solve(right_sides[:, 0])
    np.testing.assert_allclose(solution, exact[:, 0], rtol=0, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("shape", "cells"),
    [(ms.v_beam, (20, 4)), (ms.v_beam, (27, 6)), (ms.cylinder_panel, (9, 9))],
    ids=["V", "finer V", "cylinder"],
)
def test_the_stiffness_of_shells_is_solved_as_superlu_does(shape, cells):
    stiffness = shell_stiffness(shape(cells=cells), 1e-5)
    right_side = np.random.default_rng(0).standard_normal(stiffness.shape[0])
    solution = factorised(stiffness).solve(right_side)
    residual = np.abs(stiffness @ solution - right_side).max()
    assert residual < 1e-14 * np.abs(stiffness).max() * np.abs(solution).max()
    step = sps.csc_array(stiffness + 0.36 * sps.eye_array(stiffness.shape[0]))  # inertia: 900 m
    exact = spla.splu(step).solve(right_side)
    assert np.linalg.norm(factorised(step).solve(right_side) - exact) < 1e-12 * np.linalg.norm(exact)


def test_the_order_along_a_strip_is_taken_where_it_is_best():
    mesh = ms.flat_beam(cells=(30, 4))
    matrix = shell_stiffness(mesh)
    points = mesh.vertices[mesh.vertices[:, 0] >= 0.06]
    ordered = ProfileAnalysis(matrix, points)
    assert ordered.entries < ProfileAnalysis(matrix).entries
    assert ordered.profile.strides.max() < 60


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 30), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1), st.sampled_from([1, 3]))
def test_negative_eigenvalues_are_counted(size, share, seed, block):
    matrix, rng = random_definite(size, 0.2, seed, block)
    spectrum = np.linalg.eigvalsh(matrix.toarray())
    count = int(share * (spectrum.size - 1))
    shift = 0.5 * (spectrum[count] + spectrum[count - 1]) if count else 0.9 * spectrum[0]
    if count and spectrum[count] - spectrum[count - 1] < 1e-3:
        return
    shifted = sps.csc_array(matrix - shift * sps.eye_array(matrix.shape[0]))
    factor = factorised(shifted)
    assert factor.negative == count
    right_side = rng.standard_normal(matrix.shape[0])
    np.testing.assert_allclose(shifted @ factor.solve(right_side), right_side, atol=1e-6)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(wrong):
    matrix, _ = random_definite(9, 0.4, 3, 3)
    matrix.data[0] = wrong
    with pytest.raises(ms.SolverError, match="zero or no number"):
        factorised(matrix)


def test_singular_matrices_are_refused():
    with pytest.raises(ms.SolverError, match="zero or no number"):
        factorised(sps.csc_array(np.ones((6, 6))))


def test_a_factor_is_pickled():
    matrix, rng = random_definite(12, 0.3, 1, 3)
    factor = factorised(matrix)
    right_side = rng.standard_normal(36)
    assert np.array_equal(pickle.loads(pickle.dumps(factor)).solve(right_side), factor.solve(right_side))


SOLVED = """
import numpy as np
from linalg.test_cholesky import random_definite
from modalshell.kernels import ahead
from modalshell.linalg import CholeskyAnalysis, ProfileAnalysis
from modalshell.linalg.conjugate_gradients import Stop
ahead.begin = lambda *_: None  # no second process, which would compile what is not used here
matrix = random_definite(60, 0.05, 0, 3)[0]
right_sides = np.sin(np.arange(4.0 * matrix.shape[0])).reshape(-1, 4)
near = matrix * 1.001
factors = [kind(matrix).factorise(matrix) for kind in (ProfileAnalysis, CholeskyAnalysis)]
answers = [factor.solve(right_sides[:, chosen]) for factor in factors for chosen in (0, slice(0, 4))]
answers.append(factors[1].solve_near(near, right_sides[:, 0].copy(), Stop(1e-12, 30, 1e-12, 30))[0])
for answer in answers:
    print(answer.tobytes().hex())
"""


@pytest.mark.slow
def test_bits_do_not_depend_on_which_kernels_the_cache_held(tmp_path):
    """Of the tests' own cache, whatever it holds, and of a copy of it without what solves."""
    folder = cache_folder()
    if folder is None:
        pytest.skip("nothing can be written, so that nothing is cached")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}

    def solved(**variables):
        command = [sys.executable, "-c", SOLVED]
        run = subprocess.run(command, env=environment | variables, capture_output=True, text=True, check=True)
        return run.stdout

    first = solved()
    copy = shutil.copytree(folder, tmp_path / "cache", ignore=shutil.ignore_patterns("*.tmp*"))
    kept = [file for name in ("profile.solve-*", "triangular_solves.*") for file in copy.rglob(name)]
    assert len(kept) > 2
    for file in kept:
        file.unlink()
    assert solved(NUMBA_CACHE_DIR=str(copy)) == first  # what it calls comes from the cache now
    assert sum(file.exists() for file in kept) > 2  # what was missing has been compiled anew
