"""Contacts of modal derivatives against discrete shells, in statics and motion."""

import numpy as np
import pytest
from scenes import sheet_strip
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.models.reduction.vertex_turns import VertexTurns
from modalshell.motion.stepping import Motion

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))
GIVEN = {"dt": 1 / 60, "gravity": GRAVITY, "damping": (3.0, 0.0)}
COLLIDERS = {
    "floor": ms.Plane((0, 0, 1), -0.15),
    "ball": ms.Sphere((0.7, 0.0, -0.21), 0.2),
    "roller": ms.Cylinder((0.6, -1, -0.25), (0.6, 1, -0.25), 0.2),
    "box": ms.Box((0.6, 0, -0.25), (0.1, 0.3, 0.15), rounding=0.05),
}


@pytest.fixture(scope="module")
def shell():
    return sheet_strip()


@pytest.fixture(scope="module")
def model(shell):
    return ms.ModalDerivatives(shell, 5)


@pytest.fixture(scope="module")
def truth(shell):
    return ms.DiscreteShell(shell, integrator="bdf2")


@pytest.mark.by_default("roller", "box")
@pytest.mark.parametrize("name", COLLIDERS)
def test_statics_on_a_collider_are_those_of_discrete_shells(shell, model, truth, name):
    contacts = [ms.Contact(COLLIDERS[name])]
    state, wanted = (one.equilibrium(gravity=GRAVITY, contacts=contacts) for one in (model, truth))
    assert state.converged
    assert state.stable
    assert state.residual <= 1e-7
    assert state.iterations <= 80
    assert state.deepest <= 1e-9
    assert ms.measure.displacement_error(state.positions, wanted.positions, shell) < 0.01
    assert state.contact_forces.sum(axis=0) == pytest.approx(wanted.contact_forces.sum(axis=0), rel=0.02, abs=2e-3)
    assert (state.contact_forces[~state.in_contact] == 0.0).all()


@pytest.mark.slow
def test_more_vertices_than_coordinates_may_touch():
    mesh = ms.sheet(length=0.6, width=0.15, cells=(24, 6))
    limp = ms.Shell(mesh, ms.Isotropic(young=5e7, poisson=0.3, thickness=1e-3, density=900.0), clamped="x < 0.001")
    model, contacts = ms.ModalDerivatives(limp, 4), [ms.Contact(ms.Plane((0, 0, 1), -0.02))]
    state = model.equilibrium(gravity=GRAVITY, contacts=contacts)
    wanted = ms.DiscreteShell(limp).equilibrium(gravity=GRAVITY, contacts=contacts)
    assert state.converged
    assert state.in_contact.sum() > model.basis.size
    assert state.deepest <= 1e-9
    assert (
        ms.measure.displacement_error(state.positions, wanted.positions, limp) < 0.07
    )  # its vectors are those of long waves


@pytest.mark.slow
@pytest.mark.parametrize(("count", "y", "z"), [(4, 0.01, -0.11), (6, 0.01, -0.11), (8, 0.1, -0.09)])
def test_a_surface_that_turns_much_under_its_force_is_settled_on(count, y, z):
    """It takes more than the shell's stiffness from motions into it: the gaps forbid them, and Newton must know."""
    mesh = ms.sheet(length=0.5, width=0.2, cells=(10, 4))
    soft = ms.Shell(mesh, ms.Isotropic(young=2e8, poisson=0.3, thickness=1.5e-3, density=1000.0), clamped="x < 0.001")
    model, contacts = ms.ModalDerivatives(soft, count), [ms.Contact(ms.Sphere((0.42, y, z), 0.08))]
    state = model.equilibrium(gravity=GRAVITY, contacts=contacts)
    assert state.converged
    assert state.stable
    assert state.iterations <= 100
    assert state.deepest <= 1e-9
    again = model.equilibrium(gravity=GRAVITY, contacts=contacts, start=state.positions)
    np.testing.assert_allclose(again.positions, state.positions, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_an_answer_that_its_vectors_do_not_hold_says_so(model):
    mesh = ms.sheet(length=0.5, width=0.25, cells=(16, 8))
    limp = ms.Shell(mesh, ms.Isotropic(young=2e7, poisson=0.3, thickness=3e-4, density=500.0), clamped="x < 0.001")
    state = ms.ModalDerivatives(limp, 4).equilibrium(gravity=GRAVITY, contacts=[ms.Contact(ms.Plane((0, 0, 1), -0.1))])
    assert state.converged
    assert "its vectors may not hold the shell's shape under the contacts" in state.message
    assert "its vectors" not in model.equilibrium(gravity=GRAVITY, contacts=[FLOOR]).message


def test_a_load_that_reaches_no_contact_gives_the_free_answer(model):
    free = model.equilibrium(gravity=(0, 0, -0.5))
    state = model.equilibrium(gravity=(0, 0, -0.5), contacts=[FLOOR])
    assert state.converged
    assert not state.in_contact.any()
    np.testing.assert_allclose(state.positions, free.positions, atol=1e-8)


@pytest.mark.slow
def test_loads_that_change_and_starts(shell, model, truth):
    given = {"loads": [ms.Pressure(-6.0)], "contacts": [FLOOR]}
    state, wanted = model.equilibrium(**given), truth.equilibrium(**given)
    assert state.converged
    assert ms.measure.displacement_error(state.positions, wanted.positions, shell) < 0.01
    again = model.equilibrium(start=state.positions, **given)
    np.testing.assert_allclose(again.positions, state.positions, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["bdf2", "composite", "implicit"])
def test_motion_falls_on_the_table_and_rests_there(shell, model, truth, integrator):
    given = GIVEN | {"damping": (8.0, 0.0), "duration": 1.0, "contacts": [FLOOR], "integrator": integrator}
    run, wanted = ms.simulate(model, **given), ms.simulate(truth, **given)
    assert run.unconverged_steps == 0
    assert run.in_contact.any()
    assert run.deepest.max() <= 2e-9  # 1e-9 is none to a solve, of whose end positions are taken again
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-9 * np.ptp(run.energies[:, 2])
    pairs = zip(run.positions[25:], wanted.positions[25:], strict=True)
    assert max(ms.measure.displacement_error(x, y, shell) for x, y in pairs) < 0.02
    rest = model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert ms.measure.displacement_error(run.positions[-1], rest.positions, shell) < 0.01
    assert run.contact_forces[-1].sum(axis=0) == pytest.approx(rest.contact_forces.sum(axis=0), rel=0.1, abs=1e-3)


@pytest.mark.slow
def test_undamped_motion_on_a_ball_never_gains_energy(model):
    ball = ms.Contact(COLLIDERS["ball"])
    run = ms.simulate(model, duration=0.6, dt=1 / 60, gravity=GRAVITY, contacts=[ball])
    assert run.unconverged_steps == 0
    assert run.in_contact.any()
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-8 * np.ptp(run.energies[:, 2])


@pytest.mark.slow
def test_supports_and_a_roller_move(shell, model, truth):
    turned = ms.SupportPath([0.0, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.2, 0.0)], [(0.0, 0.0, 0.0), (0.3, 0.0, 0.6)])
    path = ms.SupportPath([0.0, 0.4], [(0, 0, 0), (0, 0, -0.1)])
    roller = ms.Contact(ms.Cylinder((0.7, -1.0, 0.12), (0.7, 1.0, 0.12), 0.1), motion=path)
    given = {"duration": 0.8, "contacts": [FLOOR, roller], "supports": turned, **GIVEN}
    run, wanted = ms.simulate(model, **given), ms.simulate(truth, **given)
    assert run.unconverged_steps == 0
    assert run.in_contact[-1].any()
    assert run.deepest.max() <= 1e-8
    assert ms.measure.displacement_error(run.positions[-1], wanted.positions[-1], shell) < 0.01


@pytest.mark.slow
def test_few_weighted_elements_bear_contacts_too(shell, truth):
    model = ms.ModalDerivatives(shell, 3, cubature=True)
    state = model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    wanted = truth.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert state.converged
    assert ms.measure.displacement_error(state.positions, wanted.positions, shell) < 0.02


def test_a_resumed_motion_has_the_same_bits(shell, model):
    def motion():
        return Motion(model, shell.loading(GRAVITY, None, None), dt=1 / 60, contacts=[FLOOR])

    whole, first, second = motion(), motion(), motion()
    for _ in range(18):
        whole.advance()
    for _ in range(12):
        first.advance()
    second.restore(first.snapshot())
    for _ in range(6):
        second.advance()
    assert whole.touched().touches.any()
    assert whole.positions().tobytes() == second.positions().tobytes()


def test_turns_of_vertices_are_those_of_the_body(shell):
    rest, turn = shell.rest_positions, Rotation.from_rotvec([0.4, -1.1, 0.7])
    found = VertexTurns(shell.mesh, rest).vectors(turn.apply(rest.copy()) + np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found, np.tile(turn.as_rotvec(), (len(rest), 1)), atol=1e-12)


def test_a_motion_that_is_placed_goes_on_with_its_contacts(shell, model):
    """The placed state did not know that nothing pushes on it, and the next step failed."""
    plain, placed = (Motion(model, shell.loading(GRAVITY, None, None), dt=1 / 60, contacts=[FLOOR]) for _ in range(2))
    plain.advance()
    placed.advance()
    placed.place(shell.rest_positions)
    for _ in range(2):
        placed.advance()
    plain.advance()
    assert np.array_equal(placed.positions(), plain.positions())
    assert placed.touched().deepest == 0.0


def test_what_modal_derivatives_do_not_take_is_refused_by_name(model):
    for option in ({"friction": 0.2}, {"push_out": 1.0}, {"restitution": 0.5}):
        contact = ms.Contact(ms.Plane((0, 0, 1), -1.0), **option)
        with pytest.raises(ms.OptionError, match="contact 0 has friction, push_out or restitution, which MD-ROM"):
            model.equilibrium(contacts=[contact])
    with pytest.raises(ms.OptionError, match="inside contact 0"):
        model.equilibrium(contacts=[ms.Contact(ms.Plane((0, 0, 1), 0.1))])
    with pytest.raises(ms.OptionError, match="inside contact 0"):
        ms.simulate(model, duration=0.1, contacts=[ms.Contact(ms.Plane((0, 0, 1), 0.1))], **GIVEN)


@pytest.mark.slow
def test_steps_that_two_stand_in_for_are_two_on_a_collider_that_moves(model):
    """Both met it where it is at the end of the step, which threw the shell off, and forces were the last one's."""
    lift = ms.SupportPath([0.0, 0.2, 0.4], [(0, 0, 0), (0, 0, 0.03), (0, 0, 0.02)])
    given = {"duration": 0.2, "gravity": GRAVITY, "contacts": [ms.Contact(ms.Plane(), sel="x > 0.8", motion=lift)]}
    whole = ms.simulate(model, dt=1 / 60, integrator="composite", **given)
    halves = ms.simulate(model, dt=1 / 120, integrator="implicit", **given)
    assert whole.in_contact[1:].any(axis=1).all()
    assert np.abs(whole.positions - halves.positions[::2]).max() <= 1e-12
    means = 0.5 * (halves.contact_forces[1::2] + halves.contact_forces[2::2])
    assert whole.contact_forces[1:] == pytest.approx(means, abs=1e-9 * np.abs(means).max())
