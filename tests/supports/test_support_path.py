import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import modalshell as ms


def strip(flexure=0.05):
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2))
    return ms.Shell(mesh, ms.Material(200.0, 20.0, flexure, 0.2), clamped=mesh.vertices[:, 0] < 0.08)


def smooth(t, end):
    """From 0 to 1 with three derivatives that vanish at both ends."""
    s = np.clip(t / end, 0.0, 1.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def test_spline_meets_its_keyframes_and_rests_outside():
    times = [0.0, 0.5, 1.0]
    moved = np.array([[0, 0, 0], [0.1, 0, 0.2], [0, 0.3, 0]])
    turned = np.array([[0, 0, 0], [0, 0, 0.5], [0.2, 0, 0]])
    path = ms.SupportPath(times, moved, turned)
    for time, shift in zip(times, moved, strict=True):
        np.testing.assert_allclose(path.at(time).translation, shift, atol=1e-14)
    after = path.at(3.0)
    np.testing.assert_allclose(after.translation, moved[-1], atol=1e-14)
    for rate in (after.acceleration, after.turn_rate, after.turn_acceleration):
        np.testing.assert_array_equal(rate, 0.0)


@pytest.mark.filterwarnings("ignore:the spline through translations swings")
def test_poses_are_those_of_scipy_to_the_bit_and_kept_for_those_who_ask_again():
    random = np.random.default_rng(5)
    times, moved = np.sort(random.uniform(0.0, 2.0, 9)), random.standard_normal((9, 3))
    path, spline = ms.SupportPath(times, moved), CubicSpline(times, moved, bc_type="clamped")
    inside = np.linspace(times[0], times[-1], 77)[1:-1]
    for time in [*inside.tolist(), *times[1:-1].tolist()]:
        pose = path.at(time)
        assert path.at(time) is pose
        np.testing.assert_array_equal(pose.translation, spline(time))
        np.testing.assert_array_equal(pose.velocity, spline(time, 1))
        np.testing.assert_array_equal(pose.acceleration, spline(time, 2))
    with pytest.raises(ValueError, match="read-only"):
        pose.translation[0] = 1.0
    assert path.about(np.ones(3)).at(time).pivot[0] == -1.0


def test_a_spline_that_swings_far_beyond_its_keyframes_says_so():
    """A hold, a quick move and a hold make it swing by seven times the move, over seconds."""
    held, moved = [0.0, 0.0, 0.0], [0.0, 0.0, 0.1]
    with pytest.warns(ms.ModalShellWarning, match=r"swings 0\.73 m beyond .* which span 0\.1 m, between 0 and 1 s"):
        path = ms.SupportPath([0.0, 1.0, 1.02, 2.0], [held, held, moved, moved])
    assert path.at(1.5).translation[2] > 0.7
    with pytest.warns(ms.ModalShellWarning, match=r"rotation_vectors swings .* rad"):
        ms.SupportPath([0.0, 1.0, 1.02, 2.0], np.zeros((4, 3)), [held, held, moved, moved])
    times = [0.0, 0.9, 0.94, 0.96, 0.98, 1.0, 1.02, 1.04, 1.06, 1.08, 1.12, 2.0]
    kept = ms.SupportPath(times, [held] * 6 + [moved] * 6)  # and does not warn
    assert max(kept.at(t).translation[2] for t in np.linspace(0.0, 2.0, 400)) < 0.12


def test_rates_are_the_derivatives_of_the_pose():
    path = ms.SupportPath(
        np.linspace(0, 1, 6),
        np.random.default_rng(0).standard_normal((6, 3)),
        np.random.default_rng(1).standard_normal((6, 3)),
    )
    time, h = 0.43, 1e-5
    here, before, after = path.at(time), path.at(time - h), path.at(time + h)
    spin = (after.rotation - before.rotation) / (2 * h) @ here.rotation.T
    world_rate = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    np.testing.assert_allclose(here.rotation @ here.turn_rate, world_rate, rtol=1e-5)
    rates = [pose.rotation @ pose.turn_rate for pose in (before, after)]
    np.testing.assert_allclose(here.rotation @ here.turn_acceleration, (rates[1] - rates[0]) / (2 * h), rtol=1e-4)
    bend = (before.translation - 2 * here.translation + after.translation) / h**2
    np.testing.assert_allclose(here.rotation @ here.acceleration, bend, rtol=1e-3)


def test_inertial_loads_keep_a_free_particle_straight():
    """A particle at rest in the world: its motion in the shell's frame obeys the inertial load, to the last term."""
    path = ms.SupportPath(
        np.linspace(0, 1, 6),
        0.3 * np.random.default_rng(2).standard_normal((6, 3)),
        0.5 * np.random.default_rng(3).standard_normal((6, 3)),
        pivot=(0.1, 0.2, 0.3),
    )
    point = np.array([0.7, -0.4, 0.9])

    def seen(time):
        pose = path.at(time)
        return (point - pose.pivot - pose.translation) @ pose.rotation + pose.pivot

    time, h = 0.37, 1e-4
    velocity = (seen(time + h) - seen(time - h)) / (2 * h)
    acceleration = (seen(time + h) - 2 * seen(time) + seen(time - h)) / h**2
    load = path.at(time).shell_load(np.zeros((1, 3)), np.ones(1), seen(time)[None], velocity[None])
    np.testing.assert_allclose(load[0], acceleration, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["translation", "rotation"])
def test_modal_models_and_discrete_shells_agree_for_small_motion(kind):
    shell = strip()
    basis = ms.solve_modes(shell, 12)
    size = 1e-3

    def path(time):
        value = size * smooth(time, 0.6)
        return ([0, 0, value], [0, 0, 0]) if kind == "translation" else ([0, 0, 0], [0, 0.5 * value, value])

    supports = ms.SupportPath.from_function(path, 0.6, step=0.01, pivot=(0.0, 0.0, 0.0))
    options = {"duration": 0.9, "dt": 1 / 300, "supports": supports, "damping": (0.0, 1e-3)}
    truth = ms.simulate(ms.DiscreteShell(shell), **options)
    assert truth.status == "completed"
    scale = np.abs(truth.positions - shell.rest_positions).max()
    for model in (ms.LinearModal(basis), ms.ModalWarping(basis)):
        run = ms.simulate(model, **options)
        np.testing.assert_allclose(run.positions, truth.positions, rtol=0, atol=0.02 * scale)


@pytest.mark.slow
def test_damping_by_the_mass_is_relative_to_the_supports_on_every_rung():
    """A shell under heavy damping that moves and turns with its supports is bent by their acceleration alone."""
    shell = strip()
    path = ms.SupportPath([0, 0.5, 1.0], [[0, 0, 0], [0, 0, 1e-3], [0, 0, 3e-3]], [[0, 0, 0], [0, 1e-3, 0], [0, 0, 0]])
    options = {"duration": 1.0, "dt": 1 / 300, "supports": path, "damping": (8.0, 0.0)}
    runs = [
        ms.simulate(model, **options) for model in (ms.DiscreteShell(shell), ms.LinearModal(ms.solve_modes(shell, 12)))
    ]
    pose = path.at(0.7)
    carried = pose.to_world(shell.rest_positions)
    bent = [run.positions[210] - carried for run in runs]
    assert np.abs(bent[0]).max() > 1e-5
    np.testing.assert_allclose(bent[0], bent[1], rtol=0, atol=0.02 * np.abs(bent[1]).max())


def test_held_vertices_follow_the_path():
    shell = strip()
    supports = ms.SupportPath([0, 0.2, 0.4], [[0, 0, 0], [0.1, 0, 0.1], [0, 0.2, 0]], [[0, 0, 0], [0, 0, 1], [1, 0, 0]])
    for model in (ms.DiscreteShell(shell), ms.ModalWarping(ms.solve_modes(shell, 6))):
        run = ms.simulate(model, duration=0.4, dt=0.02, supports=supports)
        for time, frame in zip(run.times, run.positions, strict=True):
            expected = supports.at(time).to_world(shell.rest_positions[shell.clamped])
            np.testing.assert_allclose(frame[shell.clamped], expected, atol=1e-12)


@pytest.mark.slow
def test_loads_of_time_keep_their_direction_where_supports_of_single_components_turn():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))
    x = mesh.vertices[:, 0]
    supports = [ms.Clamp(x < 0.13), ms.Fix(x > 0.99, axes="y")]
    model = ms.DiscreteShell(ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), supports=supports))
    path = ms.SupportPath([0.0, 0.3, 1.0], np.zeros((3, 3)), [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [1.5, 0.0, 0.0]])
    force = ms.PointForce(x > 0.8, (0.0, 0.0, -0.003))
    nearly_constant = ms.Scaled(force, ([0.0, 10.0], [1.0, 1.0001]))
    dead, live = (
        ms.simulate(model, duration=0.4, dt=0.02, damping=(2.0, 0.0), supports=path, loads=[load]).positions
        for load in (force, nearly_constant)
    )
    assert np.abs(dead[-1] - dead[0]).max() > 0.05
    np.testing.assert_allclose(live, dead, rtol=0.0, atol=1e-5)


@pytest.mark.slow
def test_explicit_steps_follow_the_path_too():
    shell = strip()
    supports = ms.SupportPath.from_function(lambda t: ([0, 0, 0.05 * smooth(t, 0.1)], [0, 0, 0]), 0.1, step=0.005)
    model = ms.DiscreteShell(shell, integrator="explicit")
    dt = 0.5 * model.stable_step()
    explicit = ms.simulate(model, duration=0.1, dt=dt, supports=supports, store_every=10**6)
    implicit = ms.simulate(ms.DiscreteShell(shell), duration=0.1, dt=1e-3, supports=supports, store_every=10**6)
    np.testing.assert_allclose(explicit.positions[-1], implicit.positions[-1], atol=2e-3)


def test_a_function_cut_off_in_motion_is_stopped_within_a_few_samples():
    path = ms.SupportPath.from_function(lambda t: ([t, 0, 0], [0, 0, 0]), 1.0, step=0.01)
    felt = np.array([path.at(1.0 - 0.01 * k, "before").acceleration[0] for k in range(11)])
    assert felt[0] < -100.0
    np.testing.assert_allclose(felt[:10] / felt[1:], -(2.0 + np.sqrt(3.0)), rtol=1e-4)
    np.testing.assert_allclose([path.at(t).translation[0] for t in (0.3, 0.515, 0.9)], [0.3, 0.515, 0.9], atol=1e-6)


def test_refusals():
    shell = strip()
    with pytest.raises(ms.OptionError, match="times must increase"):
        ms.SupportPath([0.0, 0.0], np.zeros((2, 3)))
    with pytest.raises(ms.OptionError, match="translations"):
        ms.SupportPath([0.0, 1.0], np.zeros((3, 3)))
    with pytest.raises(ms.OptionError, match="finite"):
        ms.SupportPath([0.0, 1.0], np.full((2, 3), np.nan))
    for pose in ((None, (0, 0, 1)), ((0, 0, 1), "abc"), ((0, 0), (0, 0, 1))):
        with pytest.raises(ms.OptionError, match="of path must"):
            ms.SupportPath.from_function(lambda _, pose=pose: pose, 1.0)
    free = ms.Shell(shell.mesh, shell.material)
    path = ms.SupportPath([0.0, 1.0], np.zeros((2, 3)))
    with pytest.raises(ms.SupportError, match="holds none"):
        ms.simulate(ms.DiscreteShell(free), duration=0.1, supports=path)


def test_a_function_may_return_one_buffer_each_time():
    """Its last values stood for those of all times."""
    buffer, none = np.zeros(3), np.zeros(3)

    def path(time):
        buffer[0] = np.sin(np.pi * time) ** 4
        return buffer, none

    assert ms.SupportPath.from_function(path, 1.0).at(0.5).translation[0] == pytest.approx(1.0, rel=1e-6)


def test_turns_start_and_stop_at_rest_and_rates_are_the_rotations_own():
    path = ms.SupportPath([0.0, 1.0, 2.0], np.zeros((3, 3)), [[0, 0, 0], [1.0, 0.5, -0.3], [0.2, 2.0, 7.0]])
    np.testing.assert_allclose(path.at(0.0).turn_rate, 0.0, atol=1e-12)
    np.testing.assert_allclose(path.at(2.0).turn_rate, 0.0, atol=1e-12)
    step = 1e-5
    for time in (0.2, 0.9, 1.7):
        before, now, after = (path.at(time + shift) for shift in (-step, 0.0, step))
        spin = now.rotation.T @ (after.rotation - before.rotation) / (2 * step)
        np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], now.turn_rate, rtol=1e-7, atol=1e-8)
        change = (after.turn_rate - before.turn_rate) / (2 * step)
        np.testing.assert_allclose(change, now.turn_acceleration, rtol=1e-7, atol=1e-6)


def test_rotation_vectors_that_jump_at_half_a_turn_are_followed_through_more_than_a_turn():
    """A spin of 1.5 turns under a tilt, as SciPy gives it: angles up to pi. Rates are those of finite differences."""

    def turn(time):
        return Rotation.from_rotvec([0.0, 0.0, 9.0 * smooth(time, 1.0)]) * Rotation.from_rotvec([0.3 * time, 0.1, 0.0])

    path = ms.SupportPath.from_function(lambda t: ([0, 0, 0], turn(t).as_rotvec()), 1.0)
    h = 1e-4
    for time in np.linspace(0.05, 0.95, 40):
        pose = path.at(time)
        np.testing.assert_allclose(pose.rotation, turn(time).as_matrix(), atol=1e-6)
        before, after = turn(time - h), turn(time + h)
        rate = (before.inv() * after).as_rotvec() / (2.0 * h)
        np.testing.assert_allclose(pose.turn_rate, rate, atol=2e-3)
        numbers = [path.at(time + sign * h).turn_rate for sign in (-1.0, 1.0)]
        np.testing.assert_allclose(pose.turn_acceleration, (numbers[1] - numbers[0]) / (2.0 * h), atol=0.05)


def test_an_end_missed_by_rounding_is_the_end():
    """Whether supports still brake in the frame at their end must not hang on the last bit of its time."""
    path = ms.SupportPath([0.0, 0.15, 0.3], [[0, 0, 0], [0, 0, 0.02], [0, 0, 0]], [[0, 0, 0], [0.1, 0, 0], [0, 0, 0]])
    braking = path.at(0.3)
    assert abs(braking.acceleration[2]) > 1.0
    for time in (3 * 0.1, np.nextafter(0.3, 0.0), np.nextafter(0.3, 1.0)):
        pose = path.at(time)
        np.testing.assert_allclose(pose.acceleration, braking.acceleration, rtol=1e-12)
        np.testing.assert_allclose(pose.turn_acceleration, braking.turn_acceleration, rtol=1e-12)
    assert not path.at(0.3 + 1e-9).acceleration.any()


def errors_led_by(path, model):
    """Errors [m] of steps of 1/60 and 1/120 s against 1/960 s, and those that the runs state."""
    runs = {
        n: ms.simulate(model, duration=0.5, dt=1.0 / n, store_every=n // 60, supports=path, damping=(2.0, 0.0))
        for n in (60, 120, 960)
    }
    errors = [np.abs(runs[n].positions - runs[960].positions).max() for n in (60, 120)]
    return errors, [runs[n].step_error for n in (60, 120)]


@pytest.mark.slow
@pytest.mark.parametrize("rung", [ms.LinearModal, ms.RotationStrain])
def test_supports_that_set_off_and_stop_in_a_frame_keep_steps_of_second_order(rung):
    """Accelerations jump there: steps on one side that felt all of it were of first order, and did not say so."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=140.0, cells=(8, 2))
    model = rung(ms.solve_modes(ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 4e-3, 200.0), "x < 1e-6"), 4))
    still, moved, turned = [0.0, 0.0, 0.0], [0.0, 0.05, 0.1], [0.3, 0.0, 0.0]
    path = ms.SupportPath([0.1, 0.2, 0.3], [still, moved, [0.0, 0.0, 0.1]], [still, turned, [0.0, 0.3, 0.0]])
    errors, stated = errors_led_by(path, model)
    assert errors[0] > 3.0 * errors[1]
    assert errors[0] < stated[0]
    assert errors[1] < stated[1]


def test_accelerations_have_two_sides_where_a_path_begins_and_ends():
    path = ms.SupportPath([0.1, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.2, 0.0)], [(0.0, 0.0, 0.0), (0.3, 0.0, 0.6)])
    for time, inside in ((0.1, "after"), (0.5, "before")):
        whole, mean = path.at(time, inside), path.at(time)
        outside = path.at(time, "before" if inside == "after" else "after")
        for name in ("acceleration", "turn_acceleration"):
            assert np.abs(getattr(whole, name)).max() > 0.1
            np.testing.assert_allclose(getattr(mean, name), 0.5 * getattr(whole, name), rtol=1e-12)
            assert not getattr(outside, name).any()
    begun = ms.SupportPath([0.0, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.2, 0.0)])
    np.testing.assert_array_equal(begun.at(0.0).acceleration, begun.at(0.0, "after").acceleration)
    with pytest.raises(ms.OptionError, match="side must be"):
        begun.at(0.2, "left")


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["bdf2", "composite"])
def test_implicit_steps_in_the_frame_feel_the_side_of_a_jump_that_is_theirs(integrator):
    """Of first order, and 8 and 30 times as far off, with all of the acceleration at both ends of a path."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 200.0), "x < 1e-6")
    model = ms.CoarseDiscreteShell(shell, shell, integrator=integrator)
    path = ms.SupportPath([0.1, 0.3], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.1)], [(0.0, 0.0, 0.0), (0.0, 0.4, 0.0)])
    errors, stated = errors_led_by(path, model)
    assert errors[0] < 0.6 * stated[0]
    assert errors[0] > 2.5 * errors[1]
