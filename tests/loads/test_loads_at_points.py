"""Loads that follow the shell, summed at a few points on modal models."""

import numpy as np
import pytest
from scenes import leaf

import modalshell as ms
from modalshell.models.reduced_rotation_strain import ReducedRotationStrain
from modalshell.models.reduction.load_points import LoadPoints
from modalshell.models.reduction.patched_work import PatchedWork
from modalshell.motion.stepping import Motion


@pytest.fixture(scope="module")
def fine():
    """A blade of 565 vertices, and its rungs."""
    mesh = ms.leaf(cells=(32, 24))
    x = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 1e-3, 100.0), x < x.min() + 0.05 * mesh.size)
    basis = ms.solve_modes(shell, 8)
    full = ms.RotationStrain(basis)
    trained = {"mixtures": 16, "aside": 0.1}
    return {
        "LMA": ms.LinearModal(basis),
        "MWTS": ms.ModalWarping(basis),
        "consistent MWTS": ms.ModalWarping(basis, consistent_force=True),
        "RSW": full,
        "reduced RSW": ReducedRotationStrain.trained(full, gravities=[(0, 0, -1), (0, 1, 1)], **trained),
    }


SPREAD = {
    "pressure": (ms.Pressure(0.05), 1e-3),
    "wind": (ms.Wind((0.0, 0.3, 0.8)), 0.01),
    "gust": (ms.Scaled(ms.Wind(lambda points, _: np.array([0.0, 0.0, 0.5]) * (1.0 + points[:, :1])), np.cos), 0.01),
    "moment": (ms.EdgeMoment("x > 0.9", 0.01), 0.01),
    "follower force": (ms.FollowerForce("x > 0.5", (0.0, 2e-5, 1e-4)), 2e-3),
    "frame": (ms.FrameInertia((0.0, 0.0, 0.3), (0.0, 1.0, 0.5)), 0.01),
    "twist": (ms.FrameInertia(angular_acceleration=(2.0, 0.0, 0.0)), 1e-3),
    "weight": (ms.Scaled(ms.SelfWeight((0.0, 0.0, -0.3)), np.cos), 1e-12),
}


@pytest.mark.by_default("MWTS-twist", "reduced RSW-follower force")
@pytest.mark.parametrize("name", SPREAD)
@pytest.mark.parametrize("rung", ["LMA", "MWTS", "consistent MWTS", "RSW", "reduced RSW"])
def test_patches_stand_for_all_triangles_of_a_fine_mesh(rung, name, fine):
    (load, bound), model = SPREAD[name], fine[rung]
    shell, mesh = model.shell, model.shell.mesh
    motions = [Motion(model, shell.loading(loads=[load]), dt=0.02, damping=(5.0, 0.0)) for _ in range(2)]
    assert motions[0].stepper._quadrature is not None
    motions[1].stepper._quadrature = None
    for motion in motions:
        for _ in range(25):
            motion.advance()
    found, exact = (motion.positions() for motion in motions)
    assert np.abs(exact - mesh.vertices).max() > 1e-2 * mesh.size
    assert ms.measure.displacement_error(found, exact, shell) < bound


@pytest.mark.parametrize("rung", [ms.LinearModal, ms.ModalWarping])
def test_inertia_of_a_frame_acts_on_every_vertex_of_a_coarse_mesh(rung):
    """By triangles' midpoints a strip in a turning frame was 2 % off the same one on supports that turn."""
    mesh = ms.flat_beam(cells=(10, 3))
    model = rung(ms.solve_modes(ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 500.0), "x < 1e-6"), 6))
    loading = model.shell.loading(loads=[ms.FrameInertia((0.0, 1.0, 0.5), (1.0, 3.0, 2.0), (0.5, 0.2, 0.1))])
    q, rates = np.linspace(0.02, -0.03, 6), np.linspace(-0.1, 0.2, 6)
    x = mesh.vertices + model.displacement(q)
    before = x - (model.basis.modes @ rates).reshape(-1, 3)
    quadrature = model.load_quadrature(loading)
    found = model.modal_force(q, quadrature.dead(np.zeros_like(x), 0.0)) + quadrature.push(q, x, before, 1.0, 0.0)[0]
    np.testing.assert_allclose(found, model.modal_force(q, loading.live_force(x, x - before)), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_loads_cost_rsw_two_further_solves(fine, monkeypatch):
    """A frame of it solves once for its positions, and for loads at where it is expected, and shortly before that."""
    model, solved = fine["RSW"], []
    monkeypatch.setattr(model._fit, "factor", Counted(model._fit.factor, solved))
    for loads, solves in ((set(SPREAD) - {"gust"}, 15), (SPREAD, 20)):  # one more for what a field does at rest
        loading = model.shell.loading(loads=[SPREAD[name][0] for name in sorted(loads)])
        motion = Motion(model, loading, dt=0.01, damping=(5.0, 0.0))
        motion.advance()
        motion.positions()
        solved.clear()
        for _ in range(5):
            motion.advance()
            motion.positions()
        assert len(solved) == solves


def across(points, _):
    return np.array([0.0, 0.0, 30.0]) * points[:, 1:2]


@pytest.mark.by_default("LinearModal")
@pytest.mark.parametrize("rung", [ms.LinearModal, ms.RotationStrain])
def test_wind_that_cancels_over_the_shell_twists_it_alone(rung):
    """A strip bends far more easily than it twists: what points err by must not pass for a force that bends it."""
    mesh = ms.sheet(length=0.5, width=0.2, cells=(30, 12))
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 2e-3, 500.0), clamped="x < 0.02")
    model, middle = rung(ms.solve_modes(shell, 8)), np.abs(mesh.vertices[:, 1]) < 1e-9
    motion = Motion(model, shell.loading(loads=[ms.Wind(across)]), dt=0.01, damping=(5.0, 0.0))
    largest = np.zeros(2)
    for _ in range(30):
        motion.advance()
        risen = np.abs(motion.positions()[:, 2])
        largest = np.maximum(largest, [risen.max(), risen[middle].max()])
    assert largest[0] > 1e-4
    assert largest[1] < 0.05 * largest[0]


class Counted:
    """A factor whose solves are counted."""

    def __init__(self, factor, solved):
        self.factor, self.solved = factor, solved

    def solve(self, right_side):
        self.solved.append(right_side.shape)
        return self.factor.solve(right_side)


@pytest.mark.by_default("supports0", "supports1")
@pytest.mark.parametrize(
    "supports", [[ms.Clamp("x < 0.02")], [ms.Clamp("x < 0.02"), ms.Roller("x > 0.99", (0, 1, 1))], []]
)
def test_forces_at_points_push_a_fitted_surface_by_their_work(supports):
    """Also where supports couple the axes, and where nothing holds the shell."""
    mesh = ms.flat_beam(length=1.0, width=0.4, cells=(24, 10))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 1e-3, 100.0), supports=supports)
    basis = ms.solve_modes(shell, 12)
    model = ms.RotationStrain(basis)
    points = LoadPoints(basis, shell.loading(loads=[ms.Pressure(1.0)]).live, 128)
    work = PatchedWork(mesh, model._fit, model.turns_and_strains(np.arange(len(mesh.faces))), points)
    places = points.mean(mesh.vertices.reshape(-1, 1))[:, :, 0]
    rng = np.random.default_rng(0)
    for turn, bound in ((1e-6, 1e-5), (1.0, 0.035)):
        errors = []
        for _ in range(5):
            forces = np.cos(3.0 * places + rng.uniform(0.0, 6.0, 3))
            q = rng.standard_normal(12)
            q *= turn / np.abs(basis.rotations @ q).max()
            exact = model.modal_force(q, (points.means.T @ forces).reshape(-1, 3))
            errors.append(np.linalg.norm(work.at_points(q, forces) - exact) / np.linalg.norm(exact))
        assert np.mean(errors) < bound


@pytest.mark.parametrize("load", [ms.Pressure(2.0), ms.Wind((1.0, 2.0, 3.0), tangential=0.5)])
def test_kernels_make_the_forces_that_the_definition_does(load):
    shell, rng = leaf(clamped=[0, 1]), np.random.default_rng(0)
    loading = shell.loading(loads=[load])
    x = shell.rest_positions + 0.002 * rng.standard_normal(shell.rest_positions.shape)
    velocity, dead = rng.standard_normal(x.shape), np.ones_like(x)
    found = loading.moving_force(dead, x, x - 0.01 * velocity, 100.0, 0.0)
    np.testing.assert_allclose(found - dead, loading.live_force(x, velocity), atol=1e-13)


def test_drag_is_the_fall_of_the_modal_force_with_the_rates():
    mesh = ms.leaf(cells=(32, 24))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 1e-3, 100.0), [0, 1, 2])
    basis = ms.solve_modes(shell, 4)
    loading = shell.loading(loads=[ms.Wind((0.0, 1.0, 5.0), tangential=0.5)])
    quadrature = ms.LinearModal(basis).load_quadrature(loading)
    x, rates, q = mesh.vertices.copy(), np.full(4, 1e-4), np.zeros(4)

    def pushed(rates):
        return quadrature.push(q, x, x - (basis.modes @ rates).reshape(-1, 3), 1.0, 0.0)

    drag = pushed(rates)[1]
    ahead, behind = (pushed(rates + side * 1e-6 * np.eye(4)[0])[0] for side in (1.0, -1.0))
    # The drag is summed over a quarter of the patches.
    assert (behind - ahead)[0] / 2e-6 == pytest.approx(drag[0, 0], rel=0.3)
    assert (np.linalg.eigvalsh(0.5 * (drag + drag.T)) >= 0.0).all()
