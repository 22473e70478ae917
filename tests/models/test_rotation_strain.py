"""RSW: its limits, its force as a gradient, statics at any load, rigid modes, and its accuracy against DS."""

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from scenes import PLAIN, held
from scipy.spatial.transform import Rotation

from modalshell import (
    DiscreteShell,
    LinearModal,
    Material,
    ModalWarping,
    PositionConstraint,
    RotationStrain,
    Shell,
    TriangleMesh,
    cylinder_panel,
    flat_beam,
    leaf,
    measure,
    solve_modes,
)
from modalshell.integrators.state import MotionState
from modalshell.modes import BACKENDS
from modalshell.shell.damping import Damping


@pytest.fixture(scope="module")
def v_model(v_basis):
    return RotationStrain(v_basis)


@pytest.fixture(scope="module")
def strip():
    """A thin flat cantilever of a physical material, and gravity at Gamma = 1."""
    mesh = flat_beam(length=1.0, width=0.2, cells=(40, 8), family="alternating")
    material = Material.from_physical(young=1e9, poisson=0.0, thickness=1e-3, density=1000.0, mesh=mesh)
    clamped = mesh.vertices[:, 0] < 0.0376
    length = 1.0 - mesh.vertices[clamped, 0].max()
    return solve_modes(Shell(mesh, material, clamped), 8), (1e9 * 1e-9 / 12.0) / (1000.0 * 1e-3 * length**3)


@pytest.fixture(scope="module")
def free_basis():
    return solve_modes(held(leaf(cells=(8, 6))), 14)


def random_state(model, turn, seed=0):
    """Coordinates whose largest turn of a triangle is ``turn``."""
    rng = np.random.default_rng(seed)
    q = rng.standard_normal(model.basis.count) / np.sqrt(np.maximum(model.basis.eigenvalues, 1.0))
    return q * turn / model.largest_turn(q)


# ---- the map


def fitted(basis, q):
    """The definition, dense: F_t with SciPy's rotations, positions by least squares over all triangles' gradients."""
    shell, mesh = basis.shell, basis.shell.mesh
    modes = basis.modes.reshape(-1, 3, basis.count)
    matrix = np.zeros((3 * len(mesh.faces), len(mesh.vertices)))
    wanted = np.zeros((3 * len(mesh.faces), 3))
    for t, (face, normal, area) in enumerate(zip(mesh.faces, mesh.face_normals, mesh.face_areas, strict=True)):
        x = mesh.vertices[face]
        hats = np.cross(normal, np.roll(x, -2, axis=0) - np.roll(x, -1, axis=0)) / (2.0 * area)
        gradient = np.einsum("kim,kj->ij", modes[face] * q, hats)  # linear in q, as turn and strain are
        plane = np.eye(3) - np.outer(normal, normal)
        strain = plane @ (0.5 * (gradient + gradient.T)) @ plane
        curl = np.array(
            [gradient[2, 1] - gradient[1, 2], gradient[0, 2] - gradient[2, 0], gradient[1, 0] - gradient[0, 1]]
        )
        turn = np.cross(normal @ gradient, normal) + 0.5 * (curl @ normal) * normal
        deformation = Rotation.from_rotvec(turn).as_matrix() @ (np.eye(3) + strain) @ plane
        matrix[3 * t : 3 * t + 3, face] = np.sqrt(area) * hats.T
        wanted[3 * t : 3 * t + 3] = np.sqrt(area) * deformation.T
    held = shell.clamped
    out = mesh.vertices.copy()
    out[~held] = np.linalg.lstsq(matrix[:, ~held], wanted - matrix[:, held] @ out[held])[0]
    return out


@pytest.mark.by_default("3.0", "8.0")
@pytest.mark.parametrize("turn", [1e-3, 0.5, 3.0, 8.0])
def test_positions_are_those_of_the_definition(turn):
    mesh = cylinder_panel(cells=(7, 5))
    basis = solve_modes(held(mesh, mesh.vertices[:, 0].min() + 0.2), 6)
    model = RotationStrain(basis)
    q = random_state(model, turn)
    x = model.positions(MotionState(q, np.zeros(6)))
    np.testing.assert_allclose(x, fitted(basis, q), rtol=0, atol=1e-11)
    np.testing.assert_array_equal(x, basis.shell.rest_positions + model.displacement(q))


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_back_end_gives_the_same_positions(v_basis, v_model, backend):
    model = RotationStrain(v_basis, backend=backend)
    q = random_state(v_model, 1.0)
    assert model.backend == backend
    np.testing.assert_allclose(model.displacement(q), v_model.displacement(q), rtol=0, atol=1e-12)


def test_rest_is_rest(v_basis, v_model):
    assert not v_model.displacement(np.zeros(8)).any()
    np.testing.assert_array_equal(v_model.positions(v_model.start_motion()), v_basis.shell.rest_positions)


@pytest.mark.parametrize("scene", ["v", "free"])
def test_small_displacements_are_linear_to_second_order(v_basis, free_basis, scene):
    basis = v_basis if scene == "v" else free_basis
    model, linear = RotationStrain(basis), LinearModal(basis)
    q = random_state(model, 1.0)
    sizes = np.logspace(-1.0, -4.0, 4)
    gaps = [np.linalg.norm(model.displacement(s * q) - linear.displacement(s * q)) for s in sizes]
    assert np.polyfit(np.log(sizes), np.log(gaps), 1)[0] == pytest.approx(2.0, abs=0.02)


def test_held_vertices_stay(v_basis, v_model):
    assert not v_model.displacement(random_state(v_model, 2.0))[v_basis.shell.clamped].any()


# ---- the force


@pytest.mark.parametrize("turn", [1e-8, 1e-3, 1.0, 5.0, 8.0])
@pytest.mark.parametrize("scene", ["v", "free"])
def test_force_and_curvature_are_derivatives_of_the_work(v_basis, free_basis, scene, turn):
    """Taylor: the remainders of the work are of third order with them, halving eightfold."""
    basis = v_basis if scene == "v" else free_basis
    model = RotationStrain(basis)
    rng = np.random.default_rng(3)
    load = rng.standard_normal(basis.shell.rest_positions.shape)
    q = random_state(model, turn)
    work, force = model.work(q, load)
    assert work == pytest.approx(float(np.sum(load * model.displacement(q))), rel=1e-10)
    np.testing.assert_array_equal(model.modal_force(q, load), force)
    curvature = model.work_curvature(q, load)
    np.testing.assert_allclose(curvature, curvature.T, rtol=0, atol=1e-12 * np.abs(curvature).max())
    step = random_state(model, 1.0, seed=4)
    remainders = []
    for size in (0.02, 0.01, 0.005):
        d = size * step
        remainders.append(abs(model.work(q + d, load)[0] - work - force @ d - 0.5 * d @ curvature @ d))
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(remainders), 1)[0] == pytest.approx(3.0, abs=0.15)


def test_the_force_follows_a_changing_load(v_model):
    q = random_state(v_model, 1.0)
    loads = np.random.default_rng(5).standard_normal((2, *v_model.shell.rest_positions.shape))
    first = v_model.modal_force(q, loads[0])
    second = v_model.modal_force(q, loads[1])
    both = loads[0].copy()
    np.testing.assert_allclose(v_model.modal_force(q, both), first, rtol=1e-12)
    both += loads[1]  # the array it has just seen, changed in place
    np.testing.assert_allclose(v_model.modal_force(q, both), first + second, rtol=0, atol=1e-10 * np.abs(first).max())


def test_a_patch_and_its_jacobian(v_model):
    q, d = random_state(v_model, 1.0), random_state(v_model, 1e-5, seed=6)
    patch = np.array([300, 310, 320])
    place, jacobian = v_model.patch_position(q, patch)
    x = v_model.shell.rest_positions + v_model.displacement(q)
    np.testing.assert_allclose(place, x[patch].mean(axis=0), rtol=0, atol=1e-13)
    change = v_model.patch_position(q + d, patch)[0] - v_model.patch_position(q - d, patch)[0]
    np.testing.assert_allclose(jacobian @ d, 0.5 * change, rtol=0, atol=1e-8 * np.abs(change).max())


# ---- statics


@pytest.mark.by_default("16.0", "400.0", "1000.0")
@pytest.mark.parametrize("gamma", [0.1, 1.0, 4.0, 16.0, 64.0, 400.0, 1e3, 1e4])
def test_statics_finds_a_minimum_from_rest_at_any_load(strip, gamma):
    basis, unit = strip
    model = RotationStrain(basis)
    load = basis.shell.gravity_force((0.0, 0.0, -gamma * unit))
    answer = model.equilibrium(gravity=(0.0, 0.0, -gamma * unit))
    assert answer.converged
    assert answer.status == "converged"
    assert answer.residual <= 1e-9
    q, root = answer.coordinates, np.sqrt(basis.eigenvalues)
    slope = (basis.eigenvalues * q - model.modal_force(q, load)) / root
    assert np.linalg.norm(slope) <= 2e-9 * np.linalg.norm(model.modal_force(0.0 * q, load) / root)
    hessian = np.eye(8) - model.work_curvature(q, load) / root[:, None] / root
    assert np.linalg.eigvalsh(hessian)[0] > 0.0
    np.testing.assert_allclose(answer.positions, basis.shell.rest_positions + model.displacement(q), rtol=0, atol=1e-12)
    tip = answer.positions[basis.shell.rest_positions[:, 0] > 0.999, 2].mean()
    assert -1.0 < tip < 0.0  # it hangs and has not wound up
    assert model.largest_turn(q) < np.pi


def test_statics_by_scipy_is_the_same_minimum(strip):
    basis, unit = strip
    model = RotationStrain(basis)
    load = basis.shell.gravity_force((0.0, 2.0 * unit, -10.0 * unit))
    answer = model.equilibrium(gravity=(0.0, 2.0 * unit, -10.0 * unit))

    def potential(q):
        work, force = model.work(q, load)
        return 0.5 * basis.eigenvalues @ q**2 - work, basis.eigenvalues * q - force

    root = np.sqrt(basis.eigenvalues)
    found = scipy.optimize.minimize(
        lambda y: (lambda v, g: (v, g / root))(*potential(y / root)), np.zeros(8), jac=True, method="BFGS"
    )
    np.testing.assert_allclose(answer.coordinates, found.x / root, rtol=0, atol=1e-5 * np.abs(found.x / root).max())


def test_statics_from_a_start_finds_the_same_answer(v_model):
    cold = v_model.equilibrium(gravity=(0.0, 0.0, -10.0))
    near = v_model.equilibrium(gravity=(0.0, 0.0, -8.0))
    warm = v_model.equilibrium(gravity=(0.0, 0.0, -10.0), start=near.positions)
    assert warm.converged
    np.testing.assert_allclose(warm.positions, cold.positions, rtol=0, atol=1e-7)


def test_an_upright_strip_buckles(strip):
    """From Gamma = 7.84 on [1] the rest shape is a saddle: the answer must leave it, and not before.

    [1] Greenhill's column under its own weight.
    """
    basis, unit = strip
    model = RotationStrain(basis)
    for gamma, bent in ((7.0, False), (9.0, True), (30.0, True), (300.0, True)):
        answer = model.equilibrium(gravity=(-gamma * unit, 0.0, 0.0))
        assert answer.converged
        assert (np.abs(answer.positions[:, 2]).max() > 0.1) == bent


def test_constraints_are_met(v_model, v_ridge_tip):
    target = v_model.equilibrium(gravity=(0.0, 0.0, -6.0)).positions[v_ridge_tip]
    answer = v_model.equilibrium(constraints=[PositionConstraint(v_ridge_tip, target)])
    assert answer.converged
    np.testing.assert_allclose(answer.positions[v_ridge_tip], target, rtol=0, atol=1e-6)


# ---- accuracy


def errors_against_ds(shell, basis, gravity, start):
    truth = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gravity), start=start)
    assert truth.converged
    answers = [model(basis).equilibrium(gravity=(0.0, 0.0, -gravity)) for model in (ModalWarping, RotationStrain)]
    assert all(answer.converged for answer in answers)
    errors = [measure.displacement_error(a.positions, truth.positions, shell, weighted=False) for a in answers]
    return (*errors, truth.positions)


def test_v_beam_follows_discrete_shells(v_shell, v_basis, v_ridge_tip):
    """Soft membrane, 150 degrees; tip angles of 34, 45 and 60 degrees, the last at a drop of 0.70 L."""
    start = None
    for gravity, bar, times in ((8.0, 0.01, 6.0), (12.0, 0.01, 6.0), (20.0, 0.01, 10.0)):
        warped, strained, start = errors_against_ds(v_shell, v_basis, gravity, start)
        assert strained < bar
        assert times * strained < warped
    assert start[v_ridge_tip, 2] == pytest.approx(-0.70, abs=0.01)


def test_flat_strip_with_a_soft_membrane_follows_discrete_shells():
    mesh = flat_beam(length=1.0, width=0.2, cells=(40, 8), family="alternating")
    shell = held(mesh, 0.0376)
    basis = solve_modes(shell, 8)
    unit = unit_gravity(shell)
    start = None
    for gamma in (4.0, 16.0, 32.0):
        warped, strained, start = errors_against_ds(shell, basis, gamma * unit, start)
        assert strained < 2e-3
        assert 50.0 * strained < warped


def test_thin_strip_is_stiffer_than_its_linear_modes(strip):
    """A sheet that cannot stretch loses its transverse curvature when it bends; modes at rest keep it.

    What is left against DS comes from the quadratic energy: the same map, fitted to DS, is within 0.1 %.
    """
    basis, unit = strip
    shell = basis.shell
    warped, strained, truth = errors_against_ds(shell, basis, 16.0 * unit, None)
    assert strained < 0.015
    assert 8.0 * strained < warped
    model = RotationStrain(basis)
    mass = np.sqrt(shell.mass)[:, None]
    first = model.equilibrium(gravity=(0.0, 0.0, -16.0 * unit)).coordinates
    nearest = scipy.optimize.least_squares(
        lambda q: (mass * (shell.rest_positions + model.displacement(q) - truth)).ravel(),
        first,
        x_scale=1.0 / np.sqrt(basis.eigenvalues),
    )
    fit = shell.rest_positions + model.displacement(nearest.x)
    assert measure.displacement_error(fit, truth, shell, weighted=False) < 1e-3


def unit_gravity(shell):
    """Gravity at Gamma = 1, by the linear drop Gamma / 8 of the free end."""
    free = shell.free_unknowns
    u = np.zeros(shell.rest_positions.size)
    u[free] = spla.spsolve(
        sps.csc_array(shell.stiffness()[free][:, free]), shell.gravity_force((0, 0, -1.0)).ravel()[free]
    )
    x = shell.rest_positions[:, 0]
    return (1.0 - x[shell.clamped].max()) / (8.0 * -u.reshape(-1, 3)[x > 1.0 - 1e-9, 2].mean())


# ---- motion


@pytest.mark.slow
def test_damped_motion_comes_to_rest_in_the_static_answer(v_model):
    load = v_model.shell.gravity_force((0.0, 0.0, -8.0))
    state = v_model.start_motion()
    for _ in range(500):
        state, _ = v_model.step(state, 1.0 / 30.0, load, Damping(2.0, 0.0))
    static = v_model.equilibrium(gravity=(0.0, 0.0, -8.0))
    np.testing.assert_allclose(v_model.positions(state), static.positions, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_energy_of_a_swing_is_kept_to_first_order_in_the_step(v_basis):
    """Kinetic + q.Lambda q/2 - f.u: the force has a potential, so small steps keep the sum."""
    basis = solve_modes(v_basis.shell, 2)
    model = RotationStrain(basis, integrator="implicit_midpoint")
    load = basis.shell.gravity_force((0.0, 0.0, -8.0))
    period = 2.0 * np.pi / np.sqrt(basis.eigenvalues[0])
    drifts = []
    for steps in (400, 1600):
        state, drift = model.start_motion(), 0.0
        for _ in range(steps):
            state, _ = model.step(state, period / steps, load, Damping())
            total = model.elastic_energy(state) + model.kinetic_energy(state) - model.work(state.coordinates, load)[0]
            drift = max(drift, abs(total))
        drifts.append(
            drift / model.elastic_energy(model.start_motion(model.equilibrium(gravity=(0, 0, -8.0)).positions))
        )
    assert drifts[0] < 0.05
    assert drifts[1] < 0.3 * drifts[0]


# ---- what nothing holds


def two_leaves(clamped=None):
    one = leaf(cells=(8, 6))
    count = len(one.vertices)
    vertices = np.vstack([one.vertices, one.vertices + np.array([0.1, 0.2, 1.0])])
    return Shell(TriangleMesh(vertices, np.vstack([one.faces, one.faces + count])), PLAIN, clamped, loose_parts=True)


def shells_with_rigid_modes():
    one = leaf(cells=(8, 6))
    return {
        "free": held(one),
        "two parts": two_leaves(),
        "one part held": two_leaves(np.flatnonzero(one.vertices[:, 0] < 0.2)),
        "hinged": Shell(one, PLAIN, one.edges[0]),
    }


@pytest.mark.by_default("free-2.5")
@pytest.mark.parametrize("turn", [1e-6, 0.7, 2.5])
@pytest.mark.parametrize("case", ["free", "two parts", "one part held", "hinged"])
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
def test_rigid_modes_move_parts_rigidly(case, turn):
    shell = shells_with_rigid_modes()[case]
    basis = solve_modes(shell, 18)
    assert basis.rigid_modes == {"free": 6, "two parts": 12, "one part held": 6, "hinged": 1}[case]
    model = RotationStrain(basis)
    q = np.zeros(18)
    q[: basis.rigid_modes] = np.random.default_rng(7).standard_normal(basis.rigid_modes)
    q *= turn / model.largest_turn(q)
    u, linear = model.displacement(q), (basis.modes @ q).reshape(-1, 3)
    assert not u[shell.clamped].any()
    angles = []
    for part in range(shell.mesh.components.max() + 1):
        inside = shell.mesh.components == part
        rest = shell.rest_positions[inside]
        moved = rest + u[inside]
        arms = rest - rest.mean(axis=0)
        rotation, _ = Rotation.align_vectors(moved - moved.mean(axis=0), arms)
        np.testing.assert_allclose(moved, moved.mean(axis=0) + rotation.apply(arms), rtol=0, atol=1e-12)
        angles.append(rotation.magnitude())
        if not shell.clamped[inside].any():
            mass = shell.mass[inside]
            np.testing.assert_allclose(mass @ u[inside], mass @ linear[inside], rtol=0, atol=1e-12)
    assert max(angles) == pytest.approx(turn, rel=1e-6, abs=1e-9)
