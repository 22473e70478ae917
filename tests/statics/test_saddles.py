"""The stiff V, whose straight branch turns unstable to twisting before it snaps: DS must answer with minima."""

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import modalshell as ms
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.modes import lowest_tangent_eigenvalue

SCENE = Path(__file__).parents[2] / "studies" / "scenes" / "v_beam_stiff.toml"


@pytest.fixture(scope="module")
def shell():
    material = ms.load_scene(SCENE).build_shell().material
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(40, 8))
    return ms.Shell(mesh, material, mesh.vertices[:, 0] < 0.026)


def check_minimum(shell, answer, gravity):
    assert answer.outcome is ms.Outcome.CONVERGED, (gravity, answer.message)
    assert answer.residual <= 1e-7
    assert answer.stable
    assert lowest_tangent_eigenvalue(shell, answer.positions) > 0.0, gravity
    force = shell.force(answer.positions) + shell.gravity_force((0.0, 0.0, -gravity))
    assert np.linalg.norm(force[shell.free]) <= 1e-6 * np.linalg.norm(shell.gravity_force((0.0, 0.0, -gravity)))


def twist(shell, positions):
    tip = np.flatnonzero(shell.rest_positions[:, 0] > 1.0 - 1e-9)
    return abs(positions[tip[0], 2] - positions[tip[-1], 2])


@pytest.mark.by_default("30.0")
@pytest.mark.parametrize("gravity", [30.0, 42.0, pytest.param(44.0, marks=pytest.mark.slow)])
def test_the_stiff_v_has_a_stable_answer(shell, gravity):
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gravity))
    check_minimum(shell, answer, gravity)
    assert ("symmetry was broken" in answer.message) == (gravity > 41.5)
    assert (twist(shell, answer.positions) > 0.01) == (gravity == 42.0)  # below it is straight, above it has snapped


def loads(first):
    """Every other load next to where the branch turns unstable and snaps, every fourth elsewhere."""
    return sorted({*range(first, 71, 4), *range(40 + first % 4 // 2, 50, 2)})


@pytest.mark.slow
@pytest.mark.parametrize("gravity", loads(20)[::2])
def test_the_stiff_v_has_a_stable_answer_at_any_load(shell, gravity):
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gravity))
    check_minimum(shell, answer, gravity)


@pytest.mark.slow
@pytest.mark.parametrize("gravity", loads(22)[:15:3])
def test_the_stiff_v_of_the_scene_has_a_stable_answer_at_any_load(gravity):
    fine = ms.load_scene(SCENE).build_shell()
    check_minimum(fine, ms.DiscreteShell(fine).equilibrium(gravity=(0.0, 0.0, -gravity)), gravity)


@pytest.mark.slow
def test_the_lowest_eigenvalue_is_the_lowest_and_not_the_one_nearest_zero(shell):
    """At the straight saddle one eigenvalue is far below zero, and the one nearest to it is positive."""
    model = ms.DiscreteShell(shell)
    straight = model.equilibrium(gravity=(0.0, 0.0, -40.0)).positions
    rng = np.random.default_rng(0)
    squeezed = straight + 1e-4 * rng.standard_normal(straight.shape) * ~shell.clamped[:, None]
    root = np.sqrt(np.repeat(shell.mass[shell.free], 3))
    for x in (straight, squeezed):
        free = shell.free_unknowns
        dense = shell.stiffness(x).toarray()[np.ix_(free, free)] / root / root[:, None]
        expected = scipy.linalg.eigvalsh(dense, subset_by_index=(0, 0))[0]
        assert lowest_tangent_eigenvalue(shell, x) == pytest.approx(expected, rel=1e-6)
    assert expected < 0.0


@pytest.mark.slow
def test_a_straight_column_leaves_its_saddle_and_says_so():
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2), family="equilateral")
    material = ms.Material.from_physical(young=1e9, poisson=0.0, thickness=1e-2, density=1000.0, mesh=mesh)
    shell = ms.Shell(mesh, material, mesh.vertices[:, 0] < 0.08)
    force = np.zeros_like(mesh.vertices)
    tip = mesh.vertices[:, 0] > 1.0 - 1e-9
    force[tip, 0] = -5.0 * np.pi**2 / 4.0 * 1e9 * 0.1 * 1e-6 / 12.0 / tip.sum()
    answer = ms.DiscreteShell(shell).equilibrium(force=force)
    assert answer.converged
    assert answer.stable
    assert "symmetry was broken" in answer.message
    assert np.abs(answer.positions[tip, 2]).max() > 0.3


@pytest.mark.slow
def test_a_jump_on_the_way_from_rest_is_named():
    """The V-beam whose fold flattens: statics says where its branch ends, as the path of equilibria does."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.075)
    limit = ms.equilibrium_path(shell, gravity=(0, 0, -1), until=70.0).events[0].factor
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -70.0))
    assert answer.converged
    assert f"ends at a limit point at {limit / 70.0:.4g} of the load" in answer.message
    assert not ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -35.0)).message


@pytest.mark.slow
def test_a_thin_fold_that_crumples_at_its_clamp_comes_to_rest():
    """A beam of paper in V shape under fifty times its bending stiffness over its area: it goes downhill twice."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(30, 6), family="alternating")
    paper = ms.Isotropic(young=1e6, poisson=0.3, thickness=1e-3, density=200.0)
    shell = ms.Shell(mesh, paper, clamped=mesh.vertices[:, 0] < 1e-9)
    rigidity = 1e6 * 1e-3**3 / 12.0 / (1.0 - 0.3**2)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -50.0 * rigidity / 0.2))
    assert answer.converged
    assert answer.stable
    assert answer.positions[:, 2].min() < -0.7


@pytest.mark.by_default("0.8-coarse DS")
@pytest.mark.parametrize("kind", ["coarse DS", "MD-ROM"])
@pytest.mark.parametrize("speed", [0.8, 1.2])
def test_reduced_models_tell_a_saddle_of_a_turning_frame(kind, speed):
    """Beyond the first frequency a strip that turns about its axis stands aside; they stayed at it and said nothing."""
    mesh, fewer = (ms.flat_beam(length=1.0, width=0.3, cells=cells) for cells in ((10, 2), (5, 2)))
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 5e-3, 1000.0), "x < 1e-6")
    if kind == "MD-ROM":
        model = ms.ModalDerivatives(shell, count=3)
    else:
        model = ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, fewer))
    turning = ms.FrameInertia(
        angular_velocity=(speed * 2.0 * np.pi * ms.solve_modes(shell, 1).frequencies[0], 0.0, 0.0)
    )
    answer = model.equilibrium(gravity=(0.0, 0.0, -0.05), loads=[turning])
    assert answer.stable is answer.converged is (speed < 1.0)
    if speed > 1.0:
        assert answer.outcome is ms.Outcome.UNSTABLE
        assert "in balance at a saddle" in answer.message
        assert ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -0.05), loads=[turning]).stable


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_coordinates_that_a_follower_couples_to_flutter_are_not_stable(share):
    """Of 2 + i a and 2 - i a the real part is positive: a reduced model called that stable, and DS flutter."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(4, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 5e-3, 1000.0), "x < 1e-6")
    loading = shell.loading(loads=[ms.FollowerForce("x > 1 - 1e-6", (-1.0, 0.0, 0.0))])
    rest = mesh.vertices
    answer = Equilibrium(rest, ms.Outcome.CONVERGED, "", 0, 0.0, None, conservative=False, loading=loading)
    matrix = answer.load_matrix(shell.pattern).toarray()
    row, column = np.unravel_index(np.abs(matrix).argmax(), matrix.shape)
    moved, pushed = np.zeros((2, len(matrix), 2))
    moved[column], pushed[row] = 1.0, (1.0, -1.0)
    coupling = share * matrix[row, column]
    hessian = np.diag([2.0 - coupling, 2.0 + coupling])
    found = answer.lowest_eigenvalue(hessian, shell.pattern, lambda: (moved, share * pushed))
    assert (found > 0.0) is (share == 0.0)


def tube(around, along, radius=0.05):
    """An open tube of length 1 m about the x axis, every corner between two diagonals or none."""
    turns = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    ring = np.stack([np.zeros(around), radius * np.cos(turns), radius * np.sin(turns)], axis=1)
    vertices = np.concatenate([ring + np.array([j / along, 0.0, 0.0]) for j in range(along + 1)])
    faces = []
    for j, i in np.ndindex(along, around):
        p, q = j * around + i, j * around + (i + 1) % around
        r, s = p + around, q + around
        faces += [(p, r, q), (q, r, s)] if (i + j) % 2 else [(p, s, q), (p, r, s)]
    return ms.TriangleMesh(vertices, np.array(faces))


MODAL = {"LMA": ms.LinearModal, "MWTS": ms.ModalWarping, "RSW": ms.RotationStrain}


@pytest.mark.by_default("0.0-DS over a plane", "0.01-MD-ROM", "0.1-LMA", "0.1-RSW")
@pytest.mark.parametrize("kind", ["DS", "DS over a plane", "coarse DS", "MD-ROM", *MODAL])
@pytest.mark.parametrize("torque", [0.0, 0.01, 0.1])
def test_a_torque_that_follows_makes_a_tube_flutter(kind, torque):
    """Its two equal bending frequencies become a pair 152.4 + 0.41i, 152.4 - 0.41i 1/s^2; DS said stable.

    Modal models asked for the real parts alone, and so did contacts. A tenth of the torque makes a pair that little
    damping holds.
    """
    mesh = tube(8, 12)
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 3e-3, 1000.0), "x < 1e-6")
    if kind == "coarse DS":
        model = ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, tube(8, 6)))
    elif kind == "MD-ROM":
        model = ms.ModalDerivatives(shell, count=4)
    elif kind in MODAL:
        model = MODAL[kind](ms.solve_modes(shell, 6))
    else:
        model = ms.DiscreteShell(shell)
    end = np.flatnonzero(mesh.vertices[:, 0] > 1.0 - 1e-6)
    # A pull along the axis has no potential either, and makes nothing flutter.
    forces = [np.array([0.0, -z, y]) * torque / 8 / 0.05**2 for _, y, z in mesh.vertices[end]]
    loads = [ms.FollowerForce([index], tuple(force)) for index, force in zip(end, forces, strict=True)]
    loads.append(ms.FollowerForce(end, (1e-3, 0.0, 0.0)))
    plane = ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.1))
    answer = model.equilibrium(loads=loads, contacts=[plane] if "plane" in kind else None)
    assert answer.stable is answer.converged is (torque < 0.1)
    assert torque < 0.1 or "flutter" in answer.message
    if kind == "DS" and torque < 0.1:
        basis = ms.solve_modes(shell, 2, about=answer)
        assert basis.frequencies == pytest.approx(1.96475, rel=1e-5)
        assert np.linalg.matrix_rank(basis.modes.reshape(-1, 2), tol=0.1) == 2


def test_an_answer_that_follows_its_load_into_no_minimum_has_the_residual_that_is_told():
    """A hinged strip that a follower pushes to its hinge: told was the residual of another shape, 1e-12 for 2."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    material = ms.Material.from_physical(young=1e9, poisson=0.0, thickness=0.02, density=1000.0, mesh=mesh)
    shell = ms.Shell(mesh, material, "x < 1e-6")
    state = ms.DiscreteShell(shell).equilibrium(loads=[ms.FollowerForce("x > 0.99", (-2600.0, 0.0, 0.0))])
    force = state.loading.force(state.positions)
    left = (force + shell.force(state.positions))[shell.free]
    assert state.outcome is ms.Outcome.UNSTABLE
    assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(force)
    assert np.linalg.norm(left) == pytest.approx(state.residual * np.linalg.norm(force), rel=0.2)
