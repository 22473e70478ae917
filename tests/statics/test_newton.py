"""The solver of discrete shells: the potential that it minimises, its steps, and what it takes for a minimum."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import cantilever
from scipy.linalg import eigh

from modalshell import DiscreteShell, Material, Shell, TriangleMesh, flat_beam, v_beam
from modalshell.core.timings import Timings
from modalshell.kernels import rotations
from modalshell.modes import Factoriser
from modalshell.shell import EXACT, GAUSS_NEWTON
from modalshell.statics.newton import is_minimum, mixed_newton
from modalshell.statics.potential import Potential, solve
from modalshell.statics.warped import turned_axes, warped_step

STEPS = np.logspace(-1.5, -3.0, 6)


def stiff_strip(thickness=1e-3):
    mesh = flat_beam(length=1.0, width=0.2, cells=(20, 4), family="equilateral")
    material = Material.from_physical(young=1e9, poisson=0.0, thickness=thickness, density=1000.0, mesh=mesh)
    return Shell(mesh, material, mesh.vertices[:, 0] < 0.075)


def potential_of(shell, load, quadratic=None, origin=None):
    origin = shell.rest_positions if origin is None else origin
    return Potential(load, origin, shell, Factoriser(), Timings(), quadratic=quadratic)


def inertia(shell, dt):
    """Entries of M / dt^2 and of a damping matrix on the pattern, as an implicit step has them."""
    _, _, quadratic = shell.energy_gradient_hessian(shell.rest_positions, GAUSS_NEWTON)
    quadratic = 0.01 / dt * quadratic
    quadratic[shell.pattern.diagonal] += np.repeat(shell.mass, 3) / dt**2
    return quadratic


def noise(shell, size, seed=0):
    step = (
        size * shell.mesh.edge_lengths.min() * np.random.default_rng(seed).standard_normal(shell.rest_positions.shape)
    )
    step[shell.clamped] = 0.0
    return step


def lowest(shell, x, problem=None):
    hessian = (problem or potential_of(shell, np.zeros_like(x))).linearise(x, EXACT)[1]
    return np.linalg.eigvalsh(hessian.toarray())[0]


@pytest.mark.parametrize("dynamic", [False, True])
def test_potential_passes_the_taylor_test(dynamic):
    shell = cantilever()
    load = np.random.default_rng(3).standard_normal(shell.rest_positions.shape)
    origin = shell.rest_positions + noise(shell, 0.05, 5)
    problem = potential_of(shell, load, inertia(shell, 0.05) if dynamic else None, origin)
    x, direction = shell.rest_positions + noise(shell, 0.1), noise(shell, 0.1, 1)
    flat = direction.ravel()[shell.free_unknowns]
    gradient, hessian = problem.linearise(x, EXACT)
    np.testing.assert_allclose(problem.residual(x), gradient, rtol=0, atol=1e-12 * np.abs(gradient).max())
    first, second = [], []
    for h in STEPS:
        remainder = problem.potential(x + h * direction)[0] - problem.potential(x)[0] - h * gradient @ flat
        first.append(abs(remainder))
        second.append(abs(remainder - 0.5 * h**2 * flat @ (hessian @ flat)))
    assert np.polyfit(np.log(STEPS), np.log(first), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert np.polyfit(np.log(STEPS), np.log(second), 1)[0] == pytest.approx(3.0, abs=0.1)


def test_potential_scale_is_the_load_on_free_vertices():
    shell = cantilever()
    load = np.ones_like(shell.rest_positions)
    assert potential_of(shell, load).scale_at(None) == pytest.approx(np.sqrt(3 * shell.free.size))


@pytest.mark.parametrize("turn", [0.05, 0.4, 0.8, 10.0])
def test_warped_steps_keep_their_bounds(turn):
    shell = cantilever()
    x = shell.rest_positions + noise(shell, 0.05)
    axis = np.array([0.3, 1.0, -0.4])
    direction = np.cross(axis, x).ravel()[shell.free_unknowns]
    moved, step, _ = warped_step(shell, x, direction, turn)
    np.testing.assert_array_equal(moved[shell.clamped], x[shell.clamped])
    share = np.abs(step).max() / np.abs(direction).max()
    np.testing.assert_allclose(step.ravel()[shell.free_unknowns], share * direction, rtol=1e-12, atol=1e-14)
    far = np.linalg.norm(shell.rest_positions - shell.rest_positions[shell.clamped].max(axis=0), axis=1) > 0.5
    # Far from the supports the step is a rotation by share * axis, and the warp carries it out in full.
    angle = share * np.linalg.norm(axis)
    assert angle <= turn * (1.0 + 1e-9)
    if turn > 5.0:
        assert share == 1.0
    edges = shell.mesh.edges[far[shell.mesh.edges].all(axis=1)]

    def lengths(y):
        return np.linalg.norm(y[edges[:, 1]] - y[edges[:, 0]], axis=1)

    assert edges.size > 0
    warped = np.abs(lengths(moved) / lengths(x) - 1.0).max()
    straight = np.abs(lengths(x + step) / lengths(x) - 1.0).max()
    assert warped < straight


def test_a_warped_rotation_does_not_stretch(monkeypatch):
    """Of a shell without supports every vertex turns alike: edges keep their lengths to rounding where w x w = 0.

    Positions at rest are read-only, and kernels are compiled once more for such ones: they are not given them.
    """
    kernel, writeable = rotations.vertex_rotations, set()

    def seen(x, *others):
        writeable.add(x.flags.writeable)
        kernel(x, *others)

    monkeypatch.setattr(rotations, "vertex_rotations", seen)
    mesh = flat_beam(length=1.0, width=0.2, cells=(10, 2))
    shell = Shell(mesh, Material(stretch=1.0, shear=1.0, flexure=1.0, density=1.0))
    x = shell.rest_positions
    for axis in (np.array([0.0, 0.0, 0.9]), np.array([0.2, -0.5, 0.3])):
        moved, _, _ = warped_step(shell, x, np.cross(axis, x).ravel(), np.inf)
        edges = moved[mesh.edges[:, 1]] - moved[mesh.edges[:, 0]]
        np.testing.assert_allclose(np.linalg.norm(edges, axis=1), mesh.edge_lengths, rtol=1e-12)
        assert turned_axes(shell, x, moved) is not None
    assert writeable == {True}


@pytest.mark.parametrize("method", [Potential.descend, solve, mixed_newton])
def test_every_method_finds_the_same_minimum(method):
    shell = cantilever()
    load = shell.gravity_force((0.0, 0.0, -2.0))
    problem = potential_of(shell, load)
    result = method(problem, shell.rest_positions.copy(), problem.scale_at(None))
    assert result.converged
    assert result.residual < 1e-7
    assert np.linalg.norm((shell.force(result.point) + load)[shell.free]) < 1e-7 * problem.scale_at(None)
    assert lowest(shell, result.point) > 0
    reference = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -2.0)).positions
    np.testing.assert_allclose(result.point, reference, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("thickness", "gamma", "drop"), [(1e-2, 5.0, 0.4), (1e-3, 5.0, 0.4), (1e-4, 2.0, 0.18)])
def test_mixed_steps_do_not_feel_the_membrane(thickness, gamma, drop):
    """Membrane over bending stiffness 1e4 to 1e8, in a few full steps from rest."""
    shell = stiff_strip(thickness)
    unit = (1e9 * thickness**2 / 12.0) / 1000.0
    problem = potential_of(shell, shell.gravity_force((0.0, 0.0, -gamma * unit)))
    result = mixed_newton(problem, shell.rest_positions.copy(), problem.scale_at(None))
    assert result.converged
    assert result.iterations < 15
    assert result.point[:, 2].min() < -drop


def test_descent_goes_downhill_only(monkeypatch):
    """From a crumpled start, where the Hessian is indefinite, the potential falls in every step."""
    shell = cantilever()
    problem = potential_of(shell, shell.gravity_force((0.0, 0.0, -2.0)))
    start = shell.rest_positions + noise(shell, 0.4, 7)
    assert lowest(shell, start) < 0
    values = []
    dragged = Potential.dragged

    def watched(self, x, drag):
        values.append(self.potential(x)[0])
        return dragged(self, x, drag)

    monkeypatch.setattr(Potential, "dragged", watched)
    result = problem.descend(start, problem.scale_at(None))
    assert result.converged
    values = np.array([*values, problem.potential(result.point)[0]])
    assert (np.diff(values) <= 1e-9 * np.abs(values[:-1])).all()
    assert values[-1] < values[0]


def test_a_dragged_potential_adds_the_drag_and_a_constant():
    shell = cantilever()
    load = np.random.default_rng(3).standard_normal(shell.rest_positions.shape)
    problem = potential_of(shell, load, inertia(shell, 0.05), shell.rest_positions + noise(shell, 0.05, 5))
    x = shell.rest_positions + noise(shell, 0.1)
    dragged = problem.dragged(x, 7.0)
    differences = []
    for seed in (1, 2, 3):
        y = shell.rest_positions + noise(shell, 0.1, seed)
        drag = 3.5 * np.sum(shell.mass[:, None] * (y - x) ** 2)
        differences.append(dragged.potential(y)[0] - problem.potential(y)[0] - drag)
        pulled = problem.residual(y) + 7.0 * (shell.mass[:, None] * (y - x)).ravel()[shell.free_unknowns]
        np.testing.assert_allclose(dragged.residual(y), pulled, rtol=0, atol=1e-11 * np.abs(pulled).max())
    np.testing.assert_allclose(differences, differences[0], rtol=1e-10)


def test_solvers_leave_their_arguments_alone():
    shell = cantilever()
    problem = potential_of(shell, shell.gravity_force((0.0, 0.0, -2.0)))
    start = shell.rest_positions + noise(shell, 0.05)
    before = start.copy()
    for method in (mixed_newton, Potential.descend, solve):
        method(problem, start, problem.scale_at(None))
        np.testing.assert_array_equal(start, before)


def test_a_limit_that_is_too_low_is_owned_up_to():
    shell = stiff_strip()
    problem = potential_of(shell, shell.gravity_force((0.0, 0.0, -0.5)))
    result = mixed_newton(problem, shell.rest_positions.copy(), problem.scale_at(None), limit=1)
    assert not result.converged
    assert result.residual > 1e-7
    measured = np.linalg.norm(problem.residual(result.point)) / problem.scale_at(None)
    assert result.residual == pytest.approx(measured, rel=1e-9)


# ---- minima and saddles


def strut(share):
    """A thick strip pushed on its end by a multiple of Euler's load, and its straight, squeezed equilibrium."""
    shell = stiff_strip(1e-2)
    tip = np.flatnonzero(shell.rest_positions[:, 0] > 1.0 - 1e-9)
    length = 1.0 - shell.rest_positions[shell.clamped, 0].max()
    load = np.zeros_like(shell.rest_positions)
    load[tip, 0] = -share * np.pi**2 * (1e9 * 1e-6 / 12.0) * 0.2 / (4.0 * length**2) / tip.size
    problem = potential_of(shell, load)
    straight = mixed_newton(problem, shell.rest_positions.copy(), problem.scale_at(None))
    assert straight.converged
    assert np.abs(straight.point[:, 2]).max() < 1e-9
    return shell, problem, straight


@pytest.mark.parametrize("share", [0.8, 0.95])
def test_a_straight_strut_is_a_minimum_below_the_critical_load(share):
    shell, problem, straight = strut(share)
    assert lowest(shell, straight.point, problem) > 0
    assert is_minimum(problem, straight)


@pytest.mark.parametrize("share", [1.05, 1.5, 4.0, 20.0])
def test_a_straight_strut_is_a_saddle_above_it(share):
    shell, problem, straight = strut(share)
    assert lowest(shell, straight.point, problem) < 0
    assert not is_minimum(problem, straight)


@pytest.mark.by_default("descend-20.0", "solve-1.5")
@pytest.mark.parametrize("share", [1.05, 1.5, 4.0, 20.0])
@pytest.mark.parametrize("method", [Potential.descend, solve])
def test_descent_does_not_stop_at_a_saddle(method, share):
    """From the straight strut itself, to rounding: the gradient vanishes there, and the minimum is elsewhere."""
    shell, problem, straight = strut(share)
    result = method(problem, straight.point, problem.scale_at(None))
    assert result.converged
    assert result.left_saddle
    assert lowest(shell, result.point, problem) > 0
    assert problem.potential(result.point)[0] < problem.potential(straight.point)[0]


@pytest.mark.parametrize(("share", "excess", "most"), [(1.5, 1e-3, 120), (4.0, 1e-4, 120), (20.0, 1e-6, 120)])
def test_a_step_does_not_creep_along_a_flat_valley(share, excess, most):
    """Inertia all but steadies the straight strut: its way down to the minimum is within the step's tolerance."""
    shell, problem, straight = strut(share)
    mass = np.repeat(shell.mass, 3)[shell.free_unknowns]
    curvature = eigh(problem.linearise(straight.point, EXACT)[1].toarray(), np.diag(mass), subset_by_index=(0, 0))[0][0]
    step = replace(problem, inertia=(excess - 1.0) * curvature * shell.mass, origin=straight.point, kept_within=np.inf)
    result = solve(step, straight.point, step.scale_at(None), 1e-6)
    assert result.converged
    assert result.left_saddle
    assert result.residual <= 1e-6
    assert lowest(shell, result.point, step) > 0
    assert result.iterations <= most


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.5, 4.0])
def test_equilibrium_from_a_start_near_a_saddle_is_a_minimum(share):
    """One Gauss-Newton step from beside the saddle lands on it: its own Hessian says nothing of the true one."""
    shell, problem, straight = strut(share)
    for size in (0.0, 1e-6, 1e-4):
        start = straight.point + noise(shell, size)
        answer = DiscreteShell(shell).equilibrium(force=problem.load, start=start)
        assert answer.converged
        assert lowest(shell, answer.positions, problem) > 0


@pytest.mark.by_default("0.01", "0.2")
@pytest.mark.parametrize("push", [0.01, 0.2, 1.0])
def test_a_single_free_vertex_buckles_too(push):
    """The smallest shell there is, three unknowns: the tip of a kite, pushed in its plane towards the held side."""
    mesh = TriangleMesh([[0, -0.5, 0], [0, 0.5, 0], [-1, 0, 0], [1, 0, 0]], [[0, 1, 2], [1, 0, 3]])
    shell = Shell(mesh, Material(stretch=10.0, shear=10.0, flexure=0.01, density=1.0), [0, 1, 2])
    force = np.zeros((4, 3))
    force[3, 0] = -push
    answer = DiscreteShell(shell).equilibrium(force=force)
    assert answer.converged
    assert lowest(shell, answer.positions) > 0
    assert (abs(answer.positions[3, 2]) > 0.1) == (push > 0.1)


@pytest.mark.slow
def test_the_snap_of_a_fold_ends_in_a_minimum():
    """A V-beam whose fold flattens: no branch leads there, and the answer still balances and is stable."""
    mesh = v_beam(length=1.0, width=0.3, fold=120.0, cells=(16, 6))
    clamped = mesh.vertices[:, 0] < 0.07
    shell = Shell(mesh, Material(stretch=200.0, shear=20.0, flexure=0.003, density=0.2), clamped)
    drops = []
    for gravity in (1.0, 4.0, 8.0):
        answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gravity))
        load = shell.gravity_force((0.0, 0.0, -gravity))
        drops.append(-answer.positions[:, 2].min())
        assert answer.converged
        assert np.linalg.norm((shell.force(answer.positions) + load)[shell.free]) < 1e-6 * np.linalg.norm(load)
        assert lowest(shell, answer.positions) > 0
    assert drops[0] < drops[1] < drops[2]
    assert drops[2] > 0.5
