"""Where statics of DS with contacts begins: at rest, at the answer of RSW where that fails, at last in a fluid."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.statics import _from_guess
from modalshell.contact.touching import Touching

GRAVITY = (0.0, 0.0, -9.81)
BODIES = {
    "table": ms.Plane((0, 0, 1), -0.1),
    "low table": ms.Plane((0, 0, 1), -0.03),
    "cylinder": ms.Cylinder((0.6, -1, -0.25), (0.6, 1, -0.25), 0.2),
    "sphere": ms.Sphere((0.6, 0.0, -0.25), 0.2),
}


def strip(cells, young=1e8, origin=(0.0, 0.0, 0.0)):
    """A strip held at an end, whose other end comes to lie on what is below."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(cells, cells // 10))
    mesh = ms.TriangleMesh(mesh.vertices + origin, mesh.faces)
    sheet = ms.Isotropic(young=young, poisson=0.3, thickness=3e-3, density=100.0)
    return ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < origin[0] + 1e-6)


def rest(shell, body, **given):
    contacts = [ms.Contact(body)]
    return ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=contacts, **given)


def begin_at(monkeypatch, guess):
    """Statics of DS with contacts has another guess, or None."""
    monkeypatch.setattr(ms.DiscreteShell, "_near_contacts", lambda *_: guess)


def refuse_guesses(monkeypatch):
    def refused(*_):
        raise AssertionError("a guess was asked for")

    monkeypatch.setattr(ms.DiscreteShell, "_near_contacts", refused)


LONG = [pytest.param(body, 80, marks=pytest.mark.slow) for body in BODIES]
LONG += [pytest.param(body, 120, marks=pytest.mark.slow) for body in ("low table", "sphere")]


@pytest.mark.by_default("cylinder-40")
@pytest.mark.parametrize(("body", "cells"), [*((body, 40) for body in BODIES), ("table", 80), *LONG[1:]])
def test_statics_takes_few_iterations_on_any_mesh(body, cells):
    shell = strip(cells, 3e7 if body == "low table" else 1e8)
    state = rest(shell, BODIES[body])
    assert state.converged
    assert state.stable
    assert state.iterations <= 15
    assert state.deepest <= 1e-9
    assert state.in_contact.any()
    assert (state.contact_forces[~state.in_contact] == 0.0).all()
    gap, normal, _ = BODIES[body].gap(state.positions)
    assert np.abs(gap[state.in_contact]).max() <= 1e-9
    assert (np.sum(state.contact_forces * normal, axis=1) >= 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("body", BODIES)
def test_the_answer_is_that_of_the_thick_fluid(body, monkeypatch):
    shell = strip(40, 3e7 if body == "low table" else 1e8)
    found = rest(shell, BODIES[body])
    begin_at(monkeypatch, None)
    slow = rest(shell, BODIES[body])
    assert found.iterations <= 15 < slow.iterations
    np.testing.assert_array_equal(found.in_contact, slow.in_contact)
    np.testing.assert_allclose(found.positions, slow.positions, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.contact_forces, slow.contact_forces, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_far_from_the_origin_the_guess_is_found_too():
    away = np.array([64.0, -32.0, 16.0])
    near, far = rest(strip(40), BODIES["table"]), rest(strip(40, origin=away), ms.Plane((0, 0, 1), 16.0 - 0.1))
    assert far.iterations <= 15
    np.testing.assert_allclose(far.positions - away, near.positions, rtol=0.0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["not finite", "far from any", "behind the cylinder"])
def test_a_guess_that_does_not_help_leaves_the_answer_of_the_thick_fluid(kind, monkeypatch):
    mesh = ms.sheet(length=0.6, width=0.15, cells=(24, 6))
    shell = ms.Shell(mesh, ms.Isotropic(young=5e7, poisson=0.3, thickness=1e-3, density=900.0), clamped="x < 0.001")
    body = ms.Cylinder((0.35, -1.0, -0.12), (0.35, 1.0, -0.12), 0.08)
    begin_at(monkeypatch, None)
    slow = rest(shell, body)
    guess = mesh.vertices.copy()
    if kind == "not finite":
        guess[-1] = np.nan
    elif kind == "far from any":
        angle = 40.0 * guess[:, 0]
        guess[:, 0], guess[:, 2] = np.sin(angle) / 40.0, (1.0 - np.cos(angle)) / 40.0 + 0.05 * guess[:, 1]
    else:
        guess = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY).positions
        hangs = rest(shell, body, start=guess)
        assert hangs.stable
        assert not hangs.in_contact.any()
    begin_at(monkeypatch, guess)
    state = rest(shell, body)
    assert state.in_contact.any()
    assert state.iterations >= slow.iterations > 15
    np.testing.assert_array_equal(state.positions, slow.positions)


def test_a_guess_is_refused_that_the_start_would_have_to_climb_to():
    flat = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2))
    x = flat.vertices[:, 0]
    risen = flat.vertices + np.outer(0.04 * (1.0 - np.cos(np.pi * x)), [0.0, 0.0, 1.0])
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=100.0)
    middle = ms.Symmetry(x > 1.0 - 1e-9, (1, 0, 0))
    shell = ms.Shell(ms.TriangleMesh(risen, flat.faces), material, clamped=x < 0.06, supports=[middle])
    problem = ms.DiscreteShell(shell).problem(shell.loading((0.0, 0.0, -0.01), None, None))[0]
    touching = Touching([ms.Contact(ms.Plane((0, 0, 1), -0.1))], shell)
    over = shell.rest_positions * [1.0, 1.0, -1.0]  # half of an arch, snapped through: stable as well
    higher = shell.rest_positions + [0.0, 0.0, 10.0] * (x > 0.1)[:, None]
    begin = {"rest": shell.rest_positions, "higher": higher}
    found = {name: _from_guess(problem, touching, start, over) for name, start in begin.items()}
    assert not found["rest"].stable
    assert found["higher"].stable
    assert found["higher"].point[:, 2].min() < -0.05


@pytest.mark.slow
def test_no_guess_is_asked_for_where_none_is_needed(monkeypatch):
    shell, floor = strip(20), ms.Contact(BODIES["table"])
    start = rest(shell, BODIES["table"]).positions
    refuse_guesses(monkeypatch)
    model = ms.DiscreteShell(shell)
    assert model.equilibrium(gravity=(0, 0, -0.01), contacts=[floor]).converged  # found at once
    assert model.equilibrium(gravity=GRAVITY, contacts=[floor], start=start).iterations <= 5
    limp = ms.DiscreteShell(strip(40))
    assert limp.equilibrium(gravity=GRAVITY, contacts=[floor], start=limp.shell.mesh.vertices).iterations > 15
    rough = ms.Contact(BODIES["table"], friction=0.3)
    assert model.equilibrium(gravity=GRAVITY, contacts=[rough], start=start).converged


def test_what_no_modal_model_answers_has_no_guess():
    loading = ms.DiscreteShell(strip(20)).shell.loading(GRAVITY, None, None)
    pushing = ms.Contact(BODIES["table"], push_out=1.0)
    assert ms.DiscreteShell(strip(20))._near_contacts(loading, [pushing]) is None
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2))
    free = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=100.0))
    assert ms.DiscreteShell(free)._near_contacts(loading, [ms.Contact(BODIES["table"])]) is None


@pytest.mark.slow
def test_motions_of_supports_over_a_table_ask_for_no_guess(monkeypatch):
    refuse_guesses(monkeypatch)
    shell = strip(20)
    path = ms.SupportPath([0.0, 0.2], [(0.0, 0.0, 0.0), (0.0, 0.0, -0.05)])
    contacts = [ms.Contact(ms.Plane((0, 0, 1), -0.06))]
    model = ms.DiscreteShell(shell, integrator="bdf2")
    run = ms.simulate(model, duration=0.2, dt=1 / 60, gravity=GRAVITY, contacts=contacts, supports=path)
    assert run.unconverged_steps == 0
    assert run.positions[-1, :, 2].min() <= -0.06 + 1e-9


def test_starts_near_the_middle_of_a_body_say_on_which_side_they_come_out():
    """A punch that was deeper in than its radius held the strip up on its other side, without a word."""
    shell = strip(40)
    for deep, told in ((0.004, False), (0.025, True), (0.05, True)):
        punch = ms.Contact(ms.Cylinder((0.8, -1.0, 0.03 - deep), (0.8, 1.0, 0.03 - deep), 0.03), push_out=1.0)
        state = ms.DiscreteShell(shell).equilibrium(contacts=[punch])
        assert state.converged
        assert (state.positions[:, 2].max() > 1e-3) == (deep > 0.03)
        assert ("was pushed out on the nearer side" in state.message) == told
