"""What a modal shell gives way beyond its modes, and how its vertices turn: what is kept is what is found anew."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.complementarity import complementary
from modalshell.contact.local_shapes import LocalShapes
from modalshell.contact.modal_kernels import local_at, local_shape
from modalshell.contact.modal_rows import Turning


@pytest.fixture(scope="module")
def basis():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    return ms.solve_modes(ms.Shell(mesh, material, clamped="x < 1e-6"), count=4)


def test_shapes_between_vertices_are_the_same_after_all_were_dropped(basis):
    shapes, chosen, others = LocalShapes(basis, 4), np.array([5, 9, 20]), np.array([7, 11])
    shapes.most = 4
    slots, between = shapes.between(chosen)
    first = between.copy()
    kept = shapes.store.reshape(len(shapes.store), 3, -1, 3)[slots][:, :, chosen]
    assert np.array_equal(between, kept.transpose(1, 3, 0, 2))
    shapes.between(others)
    assert shapes.begun == 1
    assert np.array_equal(shapes.between(chosen)[1], first)
    assert shapes.begun == 2


@pytest.mark.parametrize("count", [1, 3, 4, 6, 9])
def test_what_forces_press_in_at_candidates_is_that_of_whole_shapes(basis, count):
    """However many rows are added at a time."""
    shapes, vertices = LocalShapes(basis, 12), np.arange(6, 6 + count)
    slots, between = shapes.between(vertices)
    pushes = np.random.default_rng(count).standard_normal((count, 3))
    pushes[0, 1] = 0.0
    whole, at = np.empty((len(basis.shell.rest_positions), 3)), np.empty((3, count))
    local_shape(shapes.store, slots, pushes, np.empty((0, 3)), whole)
    local_at(between, pushes, at)
    exact = np.einsum("ki,kij->j", pushes, shapes.store[slots].astype(np.float64)).reshape(-1, 3)
    assert np.allclose(whole, exact, rtol=0.0, atol=1e-14 * np.abs(exact).max())
    assert np.allclose(at.T, exact[vertices], rtol=0.0, atol=1e-14 * np.abs(exact).max())


def test_turns_of_some_vertices_are_those_of_all(basis):
    q, vertices = np.array([0.3, -0.1, 0.02, 0.05]), np.array([4, 17, 4])
    turning = Turning(True, basis.rotations)
    exact = basis.rotations @ q
    close = {"rtol": 0.0, "atol": 1e-15 * np.abs(exact).max()}
    assert np.allclose(turning.of(q, vertices), exact.reshape(-1, 3)[vertices], **close)
    assert np.allclose(turning.vectors(q).ravel(), exact, **close)
    asked = Turning(lambda q: np.outer(np.arange(27.0), q[:3]), basis.rotations)
    assert np.array_equal(asked.of(q, vertices), asked.vectors(q)[vertices])
    assert Turning(False, basis.rotations).of(q, vertices).shape == (0, 3)


@pytest.mark.parametrize("count", [2, 5, 8, 11])
def test_forces_that_close_all_gaps_solve_the_whole_matrix(count):
    """By a factor that takes four rows at a time, and what is left of them."""
    rng = np.random.default_rng(count)
    root, forces = rng.standard_normal((count, count)), rng.uniform(1.0, 2.0, count)
    matrix = root @ root.T + np.eye(count)
    found = np.ones(count)
    assert complementary(matrix, -matrix @ forces, found, 1e-12, True)
    assert np.allclose(found, forces, rtol=1e-10, atol=0.0)
