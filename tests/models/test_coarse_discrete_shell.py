import numpy as np
import pytest
from scenes import held
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell, closest_points, coarse_shell

CLAMP = 0.0501


def beam(cells, fold):
    """V-beam whose second row of vertices stands at x = 0.05 whatever the cells."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=cells)
    cell = 1.0 / cells[0]
    vertices = np.array(mesh.vertices)
    x = vertices[:, 0]
    vertices[:, 0] = np.where(x < cell + 1e-9, x * 0.05 / cell, 0.05 + (x - cell) * 0.95 / (1 - cell))
    return ms.TriangleMesh(vertices, mesh.faces)


def shell(cells, fold, membrane=20.0):
    mesh = beam(cells, fold)
    return ms.Shell(mesh, ms.Material(membrane, membrane, 0.05, 0.2), mesh.vertices[:, 0] < CLAMP)


@pytest.mark.parametrize("fold", [150.0, 180.0])
def test_calibrated_it_follows_the_fine_shell_through_large_bends(fold):
    fine = shell((40, 8), fold)
    coarse = CoarseDiscreteShell(fine, coarse_shell(fine, beam((14, 4), fold)))
    assert ms.solve_modes(coarse.coarse.shell, 1).eigenvalues[0] == pytest.approx(
        ms.solve_modes(fine, 1).eigenvalues[0], rel=2e-3
    )
    truth, start = ms.DiscreteShell(fine), None
    for gravity in (2.0, 8.0) if fold == 180 else (4.0, 16.0):
        exact = truth.equilibrium(gravity=(0, 0, -gravity), start=start)
        answer = coarse.equilibrium(gravity=(0, 0, -gravity))
        assert exact.converged
        assert answer.converged
        assert ms.measure.displacement_error(answer.positions, exact.positions, fine) < 0.025
        start = exact.positions
    assert exact.positions[:, 2].min() < -0.5


@pytest.mark.slow
def test_it_follows_the_stiff_beam_through_its_snap():
    fine = shell((60, 12), 150.0, 2000.0)
    coarse = CoarseDiscreteShell(fine, coarse_shell(fine, beam((20, 4), 150.0)))
    exact = ms.DiscreteShell(fine).equilibrium(gravity=(0, 0, -70))
    answer = coarse.equilibrium(gravity=(0, 0, -70))
    assert exact.positions[:, 2].min() < -0.6
    assert ms.measure.displacement_error(answer.positions, exact.positions, fine) < 0.1


def test_rigid_turns_and_rest_are_carried_exactly():
    mesh, under = ms.cylinder_panel(cells=(16, 16)), ms.cylinder_panel(cells=(6, 6))
    coarse = CoarseDiscreteShell(held(mesh), held(under))
    np.testing.assert_allclose(coarse.carried_up(under.vertices), mesh.vertices, atol=1e-13)
    turn, shift = Rotation.from_rotvec([0.4, 2.0, -1.0]), np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(
        coarse.carried_up(turn.apply(np.array(under.vertices)) + shift),
        turn.apply(np.array(mesh.vertices)) + shift,
        atol=1e-10,
    )


def test_loads_go_down_with_their_sum_and_torque():
    fine = shell((20, 4), 180.0)
    coarse = CoarseDiscreteShell(fine, coarse_shell(fine, beam((8, 2), 180.0)))
    load = np.random.default_rng(0).standard_normal(fine.rest_positions.shape)
    down = coarse.handed_down(load)
    np.testing.assert_allclose(down.sum(axis=0), load.sum(axis=0), atol=1e-12)
    torque = np.cross(fine.rest_positions, load).sum(axis=0)
    np.testing.assert_allclose(np.cross(coarse.coarse.shell.rest_positions, down).sum(axis=0), torque, atol=1e-12)


def test_it_moves_and_settles_at_its_equilibrium():
    fine = shell((20, 4), 180.0)
    coarse = CoarseDiscreteShell(fine, coarse_shell(fine, beam((10, 2), 180.0)))
    answer = coarse.equilibrium(gravity=(0, 0, -2))
    run = ms.simulate(coarse, duration=10.0, dt=0.1, gravity=(0, 0, -2), damping=(3.0, 0.01), store_every=50)
    assert run.status == "completed"
    assert ms.measure.displacement_error(run.positions[-1], answer.positions, fine) < 1e-4


def test_closest_points_are_found_over_each_triangle():
    mesh = ms.cylinder_panel(cells=(8, 8))
    rng = np.random.default_rng(1)
    given = rng.dirichlet([2.0, 2.0, 2.0], len(mesh.faces))
    points = np.einsum("tk,tkx->tx", given, mesh.vertices[mesh.faces]) + 0.002 * mesh.face_normals
    triangles, shares, distance = closest_points(mesh, points)
    np.testing.assert_array_equal(triangles, np.arange(len(mesh.faces)))
    np.testing.assert_allclose(shares, given, atol=1e-12)
    np.testing.assert_allclose(distance, 0.002, atol=1e-12)
    # Beyond the rim the nearest point is on it.
    outside = np.array([[-0.1, *mesh.vertices[0, 1:]]])
    _, shares, distance = closest_points(mesh, outside)
    assert (shares >= 0).all()
    assert distance[0] == pytest.approx(0.1)


def test_wrong_pairs_are_refused():
    fine = shell((20, 4), 180.0)
    far = ms.TriangleMesh(beam((8, 2), 180.0).vertices + np.array([0, 0, 3.0]), beam((8, 2), 180.0).faces)
    with pytest.raises(ms.MeshError, match="another surface"):
        CoarseDiscreteShell(fine, ms.Shell(far, fine.material))
    varied = ms.Shell(fine.mesh, ms.Material(20.0, 20.0, 0.05, np.full(len(fine.mesh.faces), 0.2)))
    with pytest.raises(ms.OptionError, match="pass the material"):
        coarse_shell(varied, beam((8, 2), 180.0))
