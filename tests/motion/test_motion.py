import pickle

import numpy as np
import pytest
from scenes import cantilever

import modalshell as ms
from modalshell.motion import Motion


@pytest.fixture(scope="module")
def beam():
    return cantilever()


@pytest.fixture(scope="module")
def basis(beam):
    return ms.solve_modes(beam, 6)


def test_frames_times_and_status(basis):
    run = ms.simulate(ms.ModalWarping(basis), duration=0.5, dt=0.1, gravity=(0, 0, -1))
    assert run.status == "completed"
    assert run.positions.shape == (6, *basis.shell.rest_positions.shape)
    np.testing.assert_allclose(run.times, np.arange(6) * 0.1)
    np.testing.assert_array_equal(run.positions[0], basis.shell.rest_positions)


def test_storing_fewer_frames_keeps_the_motion(basis):
    every = ms.simulate(ms.LinearModal(basis), duration=1.0, dt=0.02, gravity=(0, 0, -1))
    some = ms.simulate(ms.LinearModal(basis), duration=1.0, dt=0.02, gravity=(0, 0, -1), store_every=10)
    np.testing.assert_array_equal(every.positions[::10], some.positions)
    np.testing.assert_array_equal(every.times[::10], some.times)


def test_held_vertices_stay(beam, basis):
    for model in (ms.LinearModal(basis), ms.ModalWarping(basis), ms.DiscreteShell(beam)):
        run = ms.simulate(model, duration=0.2, dt=0.05, gravity=(0, 0, -5))
        np.testing.assert_array_equal(
            run.positions[:, beam.clamped],
            np.broadcast_to(beam.rest_positions[beam.clamped], (5, beam.clamped.sum(), 3)),
        )


@pytest.mark.parametrize("make", [ms.RigidShell, lambda beam: ms.ModalDerivatives(beam, 1), ms.DiscreteShell])
def test_a_start_that_a_model_does_not_come_near_to_is_told(beam, make):
    """A rigid shell rested, and modes with derivatives began elsewhere, without a word."""
    model, bent = make(beam), np.array(beam.rest_positions)
    bent[beam.free, 2] += 0.02 * np.sin(9.0 * bent[beam.free, 0])
    run = ms.simulate(model, duration=0.02, dt=0.01, start=bent)
    off = ms.measure.displacement_error(run.positions[0], bent, beam)
    told = f" % of the start's displacement off it, as near as {model.name} comes"
    assert (told in run.message) == (off > 0.05) == (model.name != "DS")


def test_damped_motion_comes_to_rest_at_the_equilibrium(basis):
    gravity = (0.0, 0.0, -4.0)
    for model in (ms.LinearModal(basis), ms.ModalWarping(basis)):
        run = ms.simulate(model, duration=30.0, dt=1 / 30, gravity=gravity, damping=(3.0, 0.01))
        still = model.equilibrium(gravity=gravity)
        assert still.converged
        np.testing.assert_allclose(run.positions[-1], still.positions, atol=1e-7)


@pytest.mark.slow
def test_damped_discrete_shell_comes_to_rest_at_its_equilibrium(beam):
    model = ms.DiscreteShell(beam)
    run = ms.simulate(model, duration=20.0, dt=0.2, gravity=(0, 0, -4.0), damping=(3.0, 0.01))
    assert run.status == "completed"
    np.testing.assert_allclose(run.positions[-1], model.equilibrium(gravity=(0, 0, -4.0)).positions, atol=1e-6)


def test_start_position_is_taken(beam):
    model = ms.DiscreteShell(beam)
    still = model.equilibrium(gravity=(0, 0, -4.0))
    run = ms.simulate(model, duration=0.3, dt=0.1, gravity=(0, 0, -4.0), start=still.positions)
    np.testing.assert_allclose(run.positions[-1], still.positions, atol=1e-6)


def test_divergence_is_named_and_leaves_no_nan(beam):
    model = ms.DiscreteShell(beam, integrator="explicit", allow_unstable_step=True)
    run = ms.simulate(model, duration=3.0, dt=100 * model.stable_step(), gravity=(0, 0, -4.0))
    assert run.message.startswith("positions left the finite numbers at ")
    assert np.isfinite(run.positions).all()
    assert len(run.times) == len(run.positions)


def test_progress_is_reported(basis):
    calls = []
    ms.simulate(ms.LinearModal(basis), duration=0.3, dt=0.1, on_step=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"duration": 1.0, "dt": 0.0}, "dt"),
        ({"duration": 1.0, "dt": float("nan")}, "dt"),
        ({"duration": 0.01, "dt": 0.1}, "duration"),
        ({"duration": 1.0, "dt": 0.1, "damping": (-1.0, 0.0)}, "damping"),
        ({"duration": 1.0, "dt": 0.1, "damping": 0.1}, "damping"),
        ({"duration": 1.0, "dt": 0.1, "store_every": 0}, "store_every"),
    ],
)
def test_options_out_of_range_are_refused(basis, options, match):
    with pytest.raises(ms.OptionError, match=match):
        ms.simulate(ms.LinearModal(basis), **options)


def test_loads_of_the_wrong_shape_are_refused(basis):
    with pytest.raises(ms.LoadError, match="gravity"):
        ms.simulate(ms.LinearModal(basis), duration=1.0, dt=0.1, gravity=(0, -9.81))
    with pytest.raises(ms.LoadError, match="force"):
        ms.simulate(ms.LinearModal(basis), duration=1.0, dt=0.1, force=np.zeros((3, 3)))


def test_loads_are_replaced_between_steps_as_a_whole(basis):
    """Steppers know a load that they have seen by its array: what is written into one must not pass them by."""
    for model in (ms.LinearModal(basis), ms.ModalWarping(basis), ms.RotationStrain(basis)):
        loading = basis.shell.loading((0.0, 0.0, -1.0))
        changed, begun = (Motion(model, loading, dt=0.01) for _ in range(2))
        for _ in range(3):
            changed.advance()
        with pytest.raises(ValueError, match="read-only"):
            changed.load *= 2.0
        with pytest.raises(ms.LoadError, match=r"load must have shape .* \(got \(3,\)\)"):
            changed.load = np.zeros(3)
        given = 2.0 * loading.dead
        changed.load = given
        given[:] = 0.0
        begun.load = 2.0 * loading.dead
        begun.state = changed.state
        changed.advance()
        begun.advance()
        np.testing.assert_array_equal(changed.positions(), begun.positions())


def test_a_motion_goes_on_alike_where_it_is_pickled(basis):
    for model in (ms.LinearModal(basis), ms.ModalWarping(basis), ms.RotationStrain(basis)):
        motion = Motion(model, basis.shell.loading((0.0, 0.0, -1.0)), dt=0.01)
        motion.advance()
        copied = pickle.loads(pickle.dumps(motion))
        for each in (motion, copied):
            each.advance()
        np.testing.assert_allclose(copied.positions(), motion.positions(), rtol=0, atol=1e-14)
