"""Frames of modal shells that rest on colliders are whole frames to rounding, and the same bits once resumed."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.resting import Resting
from modalshell.models.base.modal_contact import REST, ModalContactMotion
from modalshell.motion.stepping import Motion

GRAVITY = (0.0, 0.0, -9.81)
TABLE = ms.Contact(ms.Plane((0, 0, 1), -0.08))
BODIES = TABLE, ms.Contact(ms.Sphere((0.6, 0.03, -0.25), 0.19))
MODELS = {"lma": ms.LinearModal, "mwts": ms.ModalWarping, "rsw": ms.RotationStrain}


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    return ms.Shell(mesh, material, clamped="x < 1e-9")


@pytest.fixture(scope="module")
def models(shell):
    basis = ms.solve_modes(shell, count=8)
    made = {name: model(basis) for name, model in MODELS.items()}
    reduced = ms.ReducedRotationStrain.trained(made["rsw"], [GRAVITY], mixtures=40)
    return made | {"reduced": reduced}


def motion(shell, model, contacts, dt=1 / 60):
    loading = shell.loading(GRAVITY, None, None)
    return Motion(model, loading, dt=dt, damping=(16.0, 0.0), contacts=list(contacts))


def resting(one):
    return bool(np.isfinite(one.state.memory[REST]).all())


@pytest.mark.slow
@pytest.mark.parametrize("contacts", [(TABLE,), BODIES])
@pytest.mark.parametrize("name", ["lma", "mwts", "rsw", "reduced"])
def test_frames_at_rest_are_whole_frames(monkeypatch, shell, models, name, contacts):
    quick, whole, asked = motion(shell, models[name], contacts), motion(shell, models[name], contacts), []
    frame = Resting.frame
    monkeypatch.setattr(Resting, "frame", lambda *given: asked.append(frame(*given)) or asked[-1])
    for count in range(300):
        quick.advance()
        with monkeypatch.context() as patch:
            patch.setattr(ModalContactMotion, "rest", lambda *_: None)
            whole.advance()
        if count == 220:  # it leaves its place within a frame
            for one in (quick, whole):
                one.load = one.load * 0.98
        np.testing.assert_allclose(quick.positions(), whole.positions(), rtol=0.0, atol=2e-10)
    assert np.count_nonzero(asked) > 40
    touched = quick.touched(), whole.touched()
    assert touched[0].touches.any()
    assert np.array_equal(touched[0].touches, touched[1].touches)
    np.testing.assert_allclose(touched[0].forces, touched[1].forces, rtol=0.0, atol=1e-6 * touched[1].forces.max())
    assert touched[0].deepest <= 1e-9


@pytest.mark.by_default("rsw")
@pytest.mark.parametrize("name", ["mwts", "rsw"])
def test_motion_resumed_at_rest_has_the_same_bits(shell, models, name):
    whole, second = motion(shell, models[name], BODIES), motion(shell, models[name], BODIES)
    for _ in range(200):
        whole.advance()
    assert resting(whole)
    second.restore(whole.snapshot())
    for count in range(40):
        for one in (whole, second):
            one.advance()
            if count == 20:
                one.load = one.load * 0.7
    for name, array in whole.snapshot().items():
        assert array.tobytes() == second.snapshot()[name].tobytes(), name


def test_a_shell_at_rest_is_lifted_off(shell, models):
    """Its forces fall to nothing within the kept problem or beyond: it leaves as from any other frame."""
    one = motion(shell, models["mwts"], [TABLE])
    for _ in range(200):
        one.advance()
    assert resting(one)
    one.load = -one.load
    for _ in range(30):
        one.advance()
    assert not one.touched().touches.any()
    assert not resting(one)
    assert one.positions()[:, 2].max() > 0.01


def test_colliders_that_move_or_have_no_form_have_no_frames_at_rest(shell, models):
    ground = ms.Contact(ms.HeightField(np.full((5, 5), -0.08), 0.5, origin=(-0.5, -0.5, 0.0)))
    path = ms.SupportPath([0.0, 1.0], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.01)])
    for contact in (ground, ms.Contact(ms.Plane((0, 0, 1), -0.08), motion=path)):
        one = motion(shell, models["mwts"], [contact])
        for _ in range(150):
            one.advance()
        assert one.touched().touches.any()
        assert not resting(one)


@pytest.mark.by_default("mwts", "reduced", "md-rom")
@pytest.mark.parametrize("name", ["lma", "mwts", "rsw", "reduced", "md-rom"])
def test_a_motion_from_where_the_model_rests_stays_there(shell, models, name):
    """Positions beyond the modes are pressed in anew: without that such a start counted as one inside the body."""
    model = models.get(name) or ms.ModalDerivatives(shell, count=4)
    given = {"gravity": GRAVITY, "contacts": [TABLE] if name == "md-rom" else list(BODIES)}
    rests = model.equilibrium(**given)
    run = ms.simulate(model, duration=0.2, dt=1 / 60, start=rests.positions, **given)
    here = np.broadcast_to(rests.positions, run.positions.shape)
    np.testing.assert_allclose(run.positions, here, atol=3e-5, rtol=0.0)
    assert np.array_equal(run.in_contact[1:], np.broadcast_to(rests.in_contact, run.in_contact[1:].shape))
    np.testing.assert_allclose(run.contact_forces[-1].sum(axis=0), rests.contact_forces.sum(axis=0), rtol=2e-2)
    assert run.deepest.max() <= 1e-9
    inside = rests.positions - 0.01 * np.eye(3)[2]
    with pytest.raises(ms.OptionError, match="inside contact"):
        ms.simulate(
            model, duration=0.2, dt=1 / 60, start=np.where(shell.clamped[:, None], rests.positions, inside), **given
        )


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, 6])
def test_a_reduced_model_begins_where_it_rests_though_its_vectors_hold_what_is_pressed_in(shell, count):
    """On a ball it began 1.1e-5 m off with the vectors of six modes."""
    model, given = ms.ModalDerivatives(shell, count=count), {"gravity": GRAVITY, "contacts": list(BODIES)}
    rests = model.equilibrium(**given)
    run = ms.simulate(model, duration=0.1, dt=1 / 60, start=rests.positions, **given)
    np.testing.assert_allclose(run.positions[0], rests.positions, atol=1e-6, rtol=0.0)
    np.testing.assert_allclose(run.positions[1:], np.broadcast_to(rests.positions, run.positions[1:].shape), atol=1e-5)
