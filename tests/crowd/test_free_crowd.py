"""Crowds of shells without supports: every instance falls, turns and springs as a single run of the model."""

from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.crowd.device import DeviceCrowd
from modalshell.integrators.modal import Exponential
from modalshell.integrators.state import MotionState
from modalshell.kernels.device import devices
from modalshell.motion.stepping import Motion

GRAVITY, STEP, STEPS, DAMPING = np.array([1.0, 0.0, -9.81]), 1.0 / 60.0, 30, (0.1, 1e-4)
PLATE = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1000.0)
DEVICES = devices() if find_spec("warp") else []  # none without the extra gpu
MODELS = {1: ms.LinearModal, 2: ms.ModalWarping}
pytestmark = pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")


def sheets(kind):
    """A free sheet, two of them, or a held one beside a free one."""
    one, parts = ms.flat_beam(length=1.0, width=0.5, cells=(8, 4)), 1 if kind == "one" else 2
    vertices = np.vstack([one.vertices + np.array([0.1, 0.0, 0.4 * k]) for k in range(parts)])
    mesh = ms.TriangleMesh(vertices, np.vstack([one.faces + k * len(one.vertices) for k in range(parts)]))
    held = np.flatnonzero((vertices[:, 0] < 0.11) & (vertices[:, 2] > 0.2)) if kind == "held beside" else []
    return ms.Shell(mesh, PLATE, held, loose_parts=parts > 1)


@pytest.fixture(scope="module", params=["one", "two", "held beside"])
def basis(request):
    shell = sheets(request.param)
    return ms.solve_modes(shell, {"one": 6, "two": 12, "held beside": 6}[request.param] + 8)


def started(basis, count, seed=0):
    """Coordinates and rates (B, m) of bent sheets that turn, fly and swing."""
    random, shell = np.random.default_rng(seed), basis.shell
    q = random.standard_normal((count, basis.count)) / np.sqrt(basis.eigenvalues + 100.0) * 0.05
    speeds = [
        np.cross(random.uniform(-3.0, 3.0, 3), shell.rest_positions - shell.rest_positions.mean(axis=0))
        + random.standard_normal(3)
        for _ in range(count)
    ]
    v = np.array([basis.modes.T @ (shell.mass[:, None] * speed).ravel() for speed in speeds])
    return q, v


def single(basis, model, q, v, gravity):
    """The last positions, and what the frames turned back, of a run from coordinates and rates."""
    model = model(basis, integrator=Exponential(turning=True))
    motion = Motion(model, basis.shell.loading(gravity, None, None), dt=STEP, damping=ms.Damping(*DAMPING))
    motion.state = MotionState(q, v, motion.state.memory)
    for _ in range(STEPS):
        motion.advance()
    return motion.positions(), motion.state.memory["turn_back"]


def flown(crowd, q, v, gravity):
    crowd.coordinates, crowd.rates = q.copy(), v.copy()
    for _ in range(STEPS):
        crowd.step(STEP, felt=gravity)
    return crowd.positions()


@pytest.mark.by_default("held beside-2")
@pytest.mark.parametrize("level", MODELS)
def test_a_batch_is_its_single_runs(basis, level):
    q, v = started(basis, 3)
    felt = GRAVITY + np.random.default_rng(1).standard_normal((3, 3))
    crowd = ms.Crowd(basis, 3, damping=DAMPING)
    crowd.levels[:] = level
    positions = flown(crowd, q, v, felt)
    for b in range(3):
        expected, back = single(basis, MODELS[level], q[b], v[b], felt[b])
        assert np.abs(expected - basis.shell.rest_positions).max() > 0.5
        np.testing.assert_allclose(positions[b], expected, rtol=0, atol=1e-10)
        np.testing.assert_allclose(crowd.turn_back[b], back, rtol=0, atol=1e-9)


@pytest.mark.by_default("one", "held beside")
def test_a_simulated_sheet_falls_and_springs_as_the_crowd_does(basis):
    shell = basis.shell
    x, y, _ = shell.rest_positions.T
    start = shell.rest_positions + np.column_stack([0.0 * x, 0.0 * x, 0.2 * (x - 0.5) ** 2 + 0.1 * x * y])
    model = ms.ModalWarping(basis)
    run = ms.simulate(model, duration=0.5, dt=STEP, gravity=GRAVITY, damping=DAMPING, start=start)
    crowd = ms.Crowd(basis, 1, damping=DAMPING)
    positions = flown(crowd, model.coordinates_of(start)[None], np.zeros((1, basis.count)), GRAVITY)
    np.testing.assert_allclose(positions[0], run.positions[-1], rtol=0, atol=1e-10)


@pytest.mark.by_default("two", "held beside")
def test_a_rigid_instance_flies_as_one_of_lma(basis):
    q, v = started(basis, 2)
    crowd, linear = (ms.Crowd(basis, 2, damping=DAMPING) for _ in range(2))
    crowd.levels[:], linear.levels[:] = 0, 1
    positions = flown(crowd, q, v, GRAVITY)
    flown(linear, q, v, GRAVITY)
    np.testing.assert_array_equal(crowd.coordinates, linear.coordinates)
    part = basis.shell.mesh.components == 0
    rest = basis.shell.rest_positions[part]
    turn, off = Rotation.align_vectors(positions[0][part] - positions[0][part].mean(axis=0), rest - rest.mean(axis=0))
    assert turn.magnitude() > 0.1
    assert off < 1e-7


def test_forcing_of_rigid_modes_is_force_and_torque():
    basis = ms.solve_modes(sheets("one"), 14)
    shell, crowd = basis.shell, ms.Crowd(basis, 1)
    force = np.zeros((1, basis.count))
    force[0, :6] = crowd.free.frames.to_poses.T @ np.array([0.0, 0.0, 2.0, 0.0, 0.1, 0.0])
    for _ in range(STEPS):
        crowd.step(STEP, forcing=force)
    x, total = crowd.positions()[0], shell.mass.sum()
    time = STEP * STEPS
    moved = shell.mass @ (x - shell.rest_positions) / total
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.5 * 2.0 / total * time**2], rtol=0, atol=1e-12)
    arms = shell.rest_positions - shell.mass @ shell.rest_positions / total
    inertia = shell.mass @ (arms[:, 0] ** 2 + arms[:, 2] ** 2)
    turn, _ = Rotation.align_vectors(x - shell.mass @ x / total, arms)
    np.testing.assert_allclose(turn.as_rotvec(), [0.0, 0.5 * 0.1 / inertia * time**2, 0.0], rtol=0, atol=1e-2)


@pytest.mark.slow
def test_threads_poses_and_precisions(basis):
    q, v = started(basis, 70)
    levels = np.arange(70) % 3
    turns, moves = Rotation.random(70, rng=3).as_matrix(), np.random.default_rng(4).standard_normal((70, 3))
    found = {}
    for threads, dtype in ((1, np.float64), (3, np.float64), (1, np.float32)):
        crowd = ms.Crowd(basis, 70, damping=DAMPING, threads=threads, dtype=dtype)
        crowd.levels[:] = levels
        found[threads, dtype] = flown(crowd, q, v, GRAVITY), crowd.positions(turns, moves), crowd.coordinates
    first = found[1, np.float64]
    np.testing.assert_allclose(first[1], first[0] @ turns.transpose(0, 2, 1) + moves[:, None], rtol=0, atol=1e-12)
    for part, other in zip(first, found[3, np.float64], strict=True):
        np.testing.assert_array_equal(other, part)
    np.testing.assert_array_equal(found[1, np.float32][2], first[2])
    np.testing.assert_allclose(found[1, np.float32][1], first[1], rtol=0, atol=2e-5)


def test_no_switch_shows_more_than_is_allowed(basis):
    crowd = ms.Crowd(basis, 60)
    q, _ = started(basis, 60)
    crowd.coordinates = 0.1 * q
    distances, angle = np.geomspace(0.01, 1e3, 60), 1e-3
    crowd.choose_levels(distances, angle)
    np.testing.assert_array_equal(np.unique(crowd.levels), [0, 1, 2])
    errors, shown = crowd.level_errors(), crowd.positions()
    crowd.levels[:] = 2
    seen = np.linalg.norm(crowd.positions() - shown, axis=2).max(axis=1)
    np.testing.assert_allclose(errors, seen, atol=1e-14)
    assert errors.max() > 0.0
    assert (errors <= angle * distances).all()


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_device_flies_them_as_the_kernels_do(basis, device, dtype):
    q, v = started(basis, 9)
    turns, moves = Rotation.random(9, rng=3).as_matrix(), np.random.default_rng(4).standard_normal((9, 3))
    seen = []
    for crowd in (ms.Crowd(basis, 9, dtype=dtype), DeviceCrowd(basis, 9, dtype=dtype, device=device)):
        crowd.levels[:] = np.arange(9) % 3
        seen.append((flown(crowd, q, v, GRAVITY), crowd.positions(turns, moves), crowd.coordinates, crowd))
    np.testing.assert_allclose(seen[1][2], seen[0][2], rtol=0, atol=1e-10)
    for at in (0, 1):
        np.testing.assert_allclose(seen[1][at], seen[0][at], rtol=0, atol=1e-10 if dtype == np.float64 else 2e-5)
    left = seen[1][3].device_positions(turns, moves)
    assert str(left.device) == device
    np.testing.assert_array_equal(left.numpy(), seen[1][1])
