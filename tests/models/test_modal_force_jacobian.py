"""The modal force's derivative: exact where a model says so, against the differences that any model has."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.statics.modal_balance import differences


@pytest.fixture(scope="module")
def basis():
    mesh = ms.v_beam(fold=150.0, cells=(12, 4))
    return ms.solve_modes(ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.15), 6)


@pytest.fixture(scope="module")
def free_basis():
    mesh = ms.leaf(cells=(6, 4))
    return ms.solve_modes(ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2)), 9)


def reduced(basis):
    return ms.ReducedRotationStrain.trained(ms.RotationStrain(basis), [(0, 0, -g) for g in (2.0, 4.0, 8.0)], rank=6)


@pytest.mark.by_default("LMA-2.0", "MWTS-0.5", "consistent free-5.0", "reduced RSW-1e-06")
@pytest.mark.parametrize("turn", [1e-6, 0.5, 2.0, 5.0])
@pytest.mark.parametrize(
    ("make", "scene"),
    [
        (ms.LinearModal, "basis"),
        (ms.ModalWarping, "basis"),
        (ms.ModalWarping, "free_basis"),
        (lambda basis: ms.ModalWarping(basis, consistent_force=True), "basis"),
        (lambda basis: ms.ModalWarping(basis, consistent_force=True), "free_basis"),
        (ms.RotationStrain, "basis"),
        (reduced, "basis"),
    ],
    ids=["LMA", "MWTS", "MWTS free", "consistent", "consistent free", "RSW", "reduced RSW"],
)
def test_modal_force_jacobian_is_the_derivative(make, scene, turn, request):
    basis = request.getfixturevalue(scene)
    model = make(basis)
    random = np.random.default_rng(0)
    q = random.standard_normal(basis.count)
    q *= turn / np.linalg.norm((basis.rotations @ q).reshape(-1, 3), axis=1).max()
    load = random.standard_normal(basis.shell.rest_positions.shape)
    exact = model.modal_force_jacobian(q, load)
    near = differences(lambda q: model.modal_force(q, load), q, basis.rotations)
    # Differences over 1e-5 rad are good to about 1e-10 of the force and its third derivative.
    size = np.abs(near).max() + np.abs(model.modal_force(q, load)).max()
    np.testing.assert_allclose(exact, near, rtol=0, atol=3e-8 * size)
    if not isinstance(model, ms.LinearModal):
        assert np.abs(exact).max() > 1e-3 * size
    # A force that is a gradient has a symmetric derivative.
    skew = np.abs(exact - exact.T).max()
    assert (skew <= 1e-9 * size) if model.conservative else (skew > 1e-9 * size)
