"""Exact stick and slip in statics of DS: Coulomb's threshold, a closed form of partial slip, and the law itself."""

from types import SimpleNamespace

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.friction import SLIP
from modalshell.contact.static_friction import _fallen
from modalshell.contact.touching import Touching
from modalshell.core.outcome import Outcome

MU, WEIGHT = 0.4, 9.81
LENGTH, WIDTH, THICKNESS, YOUNG, DENSITY = 1.0, 0.1, 1e-3, 1e7, 500.0


@pytest.fixture(scope="module")
def loose():
    mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=(20, 2))
    return ms.Shell(mesh, ms.Isotropic(young=YOUNG, poisson=0.0, thickness=THICKNESS, density=DENSITY))


@pytest.fixture(scope="module")
def pulled(loose):
    """A strip on a rough table whose end is pulled by half of what friction bears: contacts, pull, and the answer."""
    ends = np.flatnonzero(loose.mesh.vertices[:, 0] > LENGTH - 1e-9)
    force = np.zeros_like(loose.mesh.vertices)
    share = np.where(np.abs(loose.mesh.vertices[ends, 1]) < 1e-9, 2.0, 1.0)
    force[ends, 0] = 0.5 * MU * WEIGHT * loose.mass.sum() * share / share.sum()
    table = [ms.Contact(ms.Plane(), friction=MU)]
    state = ms.DiscreteShell(loose).equilibrium(gravity=(0, 0, -WEIGHT), force=force, contacts=table)
    return table, force, state, ends


def drawn(state, loose, ends):
    return float((state.positions - loose.mesh.vertices)[ends, 0].mean())


@pytest.mark.slow
@pytest.mark.parametrize("coefficient", [0.1, 0.4, 1.0])
def test_a_block_sticks_up_to_coulombs_angle_and_slides_beyond_it(loose, coefficient):
    model, table = ms.DiscreteShell(loose), [ms.Contact(ms.Plane(), friction=coefficient)]
    for beyond in (-0.1, -1e-6, 1e-6, 0.1):
        angle = np.arctan(coefficient) + beyond
        gravity = WEIGHT * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        state = model.equilibrium(gravity=gravity, contacts=table)
        if beyond < 0.0:
            assert state.converged
            assert state.stable
            np.testing.assert_allclose(state.positions, loose.mesh.vertices, atol=1e-15)
            np.testing.assert_allclose(state.contact_forces.sum(axis=0), -gravity * loose.mass.sum(), rtol=1e-10)
            assert "friction depends on the way" in state.message
        else:
            assert state.outcome is Outcome.NO_EQUILIBRIUM
            assert "it slides" in state.message


@pytest.mark.by_default("2e-06-0.1", "0.05--0.1")
@pytest.mark.parametrize("beyond", [-0.1, 0.1])
@pytest.mark.parametrize("gap", [2e-6, 0.05])
def test_a_free_sheet_above_a_slope_comes_down_on_it_before_it_is_held_or_slides(loose, beyond, gap):
    """Nothing bears it without friction: it took a thousand iterations, and what slides was "not found"."""
    angle = np.arctan(MU) + beyond
    gravity = WEIGHT * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    table = [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -gap), friction=MU)]
    state = ms.DiscreteShell(loose).equilibrium(gravity=gravity, contacts=table)
    assert state.iterations < 50
    if beyond < 0.0:
        assert state.converged
        np.testing.assert_allclose(state.positions, loose.mesh.vertices + gap / gravity[2] * -gravity, atol=1e-9)
    else:
        assert state.outcome is Outcome.NO_EQUILIBRIUM
        assert "it slides" in state.message


@pytest.mark.parametrize("case", ["cliff", "rounding"])
def test_a_free_sheet_falls_neither_into_a_cliff_nor_along_the_rounding_of_a_load_in_balance(loose, case):
    """Above low ground the gap of a height field passes over what is steep beside it."""
    x, forces = loose.mesh.vertices, np.zeros_like(loose.mesh.vertices)
    if case == "rounding":
        forces[:2] = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0 - 1e-15)
    else:
        forces[:] = (1.0, 0.0, -0.1)
    heights = np.where(np.arange(40) < 35, -0.3, 1.0)[:, None] * np.ones((40, 10))
    touching = Touching([ms.Contact(ms.HeightField(heights, 0.1, (-2.0, -0.5, 0.0)), friction=MU)], loose)
    found = _fallen(SimpleNamespace(force=lambda _: forces, shell=loose), touching, x)
    np.testing.assert_array_equal(found, x)


def test_the_end_of_a_pulled_strip_moves_as_in_closed_form_and_half_of_it_stays(loose, pulled):
    table, force, state, ends = pulled
    weight = WEIGHT * loose.mass.sum() / LENGTH
    exact = force.sum() ** 2 / (2.0 * MU * weight * YOUNG * THICKNESS * WIDTH)
    assert state.converged
    assert drawn(state, loose, ends) == pytest.approx(exact, rel=0.005)
    model = ms.DiscreteShell(loose)
    let_go = model.equilibrium(gravity=(0, 0, -WEIGHT), contacts=table, start=state.positions)
    assert let_go.converged
    assert "at once" in let_go.message
    assert drawn(let_go, loose, ends) == pytest.approx(0.5 * exact, rel=0.005)
    too_much = model.equilibrium(gravity=(0, 0, -WEIGHT), force=2.1 * force, contacts=table)
    assert too_much.outcome is Outcome.NO_EQUILIBRIUM


def test_a_motion_from_the_answer_creeps_no_faster_than_smoothed_friction_does(loose, pulled):
    table, force, state, _ = pulled
    model, step = ms.DiscreteShell(loose, integrator="implicit"), 1 / 60
    run = ms.simulate(
        model, duration=6 * step, dt=step, gravity=(0, 0, -WEIGHT), force=force, contacts=table, start=state.positions
    )
    assert run.unconverged_steps == 0
    moves = np.linalg.norm(np.diff(run.positions, axis=0), axis=2)
    assert moves.max() <= SLIP * LENGTH


@pytest.mark.by_default("collider0")
@pytest.mark.parametrize(
    "collider",
    [
        ms.Plane((0.0, 0.3, 1.0), -0.08),
        ms.Cylinder((0.6, -1, -0.25), (0.6, 1, -0.25), 0.2),
        ms.Sphere((0.7, 0.05, -0.3), 0.25),
    ],
)
def test_the_answer_obeys_the_law_and_stays_where_it_is(collider):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 4))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=100.0)
    model = ms.DiscreteShell(ms.Shell(mesh, sheet, clamped="x < 1e-6"))
    smooth, rough = [ms.Contact(collider)], [ms.Contact(collider, friction=0.3)]
    state = model.equilibrium(gravity=(0.5, 0.8, -WEIGHT), contacts=rough)
    assert state.converged
    assert state.deepest <= 1e-9
    vertices = np.flatnonzero(state.in_contact)
    normals = collider.gap(state.positions[vertices])[1]
    forces = state.contact_forces[vertices]
    pushes = np.sum(forces * normals, axis=1)
    along = np.linalg.norm(forces - pushes[:, None] * normals, axis=1)
    assert (along <= 0.3 * pushes * (1.0 + 1e-6)).all()
    assert along.max() > 1e-3 * pushes.max()
    free = model.equilibrium(gravity=(0.5, 0.8, -WEIGHT), contacts=smooth)
    assert ms.measure.displacement_error(free.positions, state.positions, model.shell) > 1e-4
    again = model.equilibrium(gravity=(0.5, 0.8, -WEIGHT), contacts=rough, start=state.positions)
    assert again.converged
    np.testing.assert_allclose(again.positions, state.positions, atol=1e-9)


def test_stick_and_slip_settle_under_a_load_that_rounding_nearly_hides():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 1e-3, 500.0), clamped=mesh.vertices[:, 0] < 1e-9)
    outcomes = []
    for pull, depth in ((1e-2, 0.1), (1e-4, 3e-3)):  # a tenth of it, the first step, does not reach the table
        floor = ms.Contact(ms.Plane(offset=-depth), friction=0.3)
        state = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -pull), contacts=[floor])
        pushed = np.linalg.norm(state.contact_forces[:, :2], axis=1)
        assert 3 <= state.in_contact.sum() <= 8
        assert (pushed <= 0.3 * state.contact_forces[:, 2] * (1.0 + 1e-6)).all()
        assert state.residual < 1e-5
        outcomes.append(state.outcome)
    assert outcomes == [ms.Outcome.CONVERGED, ms.Outcome.ROUNDING_LIMITED]


@pytest.mark.slow
def test_without_a_coefficient_the_way_there_is_not_asked_for(loose):
    shell = ms.Shell(loose.mesh, ms.Isotropic(YOUNG, 0.0, THICKNESS, density=DENSITY), clamped="x < 1e-6")
    state = ms.DiscreteShell(shell).equilibrium(
        gravity=(0, 0, -WEIGHT), contacts=[ms.Contact(ms.Plane((0, 0, 1), -0.02))]
    )
    assert "friction" not in state.message


def test_what_statics_with_friction_do_not_take_is_refused(loose):
    shell = ms.Shell(loose.mesh, ms.Isotropic(YOUNG, 0.0, THICKNESS, density=DENSITY), clamped="x < 1e-6")
    with pytest.raises(ms.OptionError, match="statics on a coarse shell take contacts without friction"):
        ms.CoarseDiscreteShell(shell, shell).equilibrium(contacts=[ms.Contact(ms.Plane((0, 0, 1), -1.0), friction=0.2)])


def test_springs_that_have_no_stiffness_at_rest_come_down_to_what_rubs():
    """Nothing touches at first, and a flat sheet of springs does not bend there: "it slides" was said of it."""
    mesh = ms.flat_beam(length=0.4, width=0.1, cells=(6, 2))
    shell = ms.Shell(mesh, ms.Material(stretch=4e3, shear=12.0, flexure=1.4e-3, density=0.6), "x < 0.07")
    model, far = ms.SpringSheet(shell), ms.Plane((0.0, 0.0, 1.0), -1.0)
    free = model.equilibrium(gravity=(0.0, 0.0, -2.9), contacts=[ms.Contact(far)])
    held = model.equilibrium(gravity=(0.0, 0.0, -2.9), contacts=[ms.Contact(far, friction=0.3)])
    assert held.converged
    assert ms.measure.displacement_error(held.positions, free.positions, shell) < 1e-4
    near = ms.Plane((0.0, 0.0, 1.0), -0.05)
    lying = model.equilibrium(gravity=(0.0, 0.0, -2.9), contacts=[ms.Contact(near, friction=0.3)])
    assert lying.converged
    assert lying.in_contact.any()


@pytest.mark.slow
@pytest.mark.parametrize(("coefficient", "gap"), [(0.1, 0.0), (0.3, 1e-3)])
def test_a_free_roof_stands_on_a_rough_table_and_spreads_against_friction(coefficient, gap):
    """Sets of what sticks let go of all of it at once: "it slides" was said of it, and nothing held it in the air."""
    mesh = ms.v_beam(length=0.4, width=0.2, fold=120.0, cells=(4, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1000.0))
    table = [ms.Contact(ms.Plane((0, 0, 1), mesh.vertices[:, 2].min() - gap), friction=coefficient)]
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -WEIGHT), contacts=table)
    assert state.converged
    assert state.stable
    forces, side = state.contact_forces[state.in_contact], np.sign(mesh.vertices[state.in_contact, 1])
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, WEIGHT * shell.mass.sum()], atol=1e-6)
    limit = coefficient * forces[:, 2]
    assert (np.linalg.norm(forces[:, :2], axis=1) <= limit * (1.0 + 1e-6)).all()
    np.testing.assert_allclose(-side @ forces[:, 1], limit.sum(), rtol=0.01)


@pytest.mark.by_default("near")
@pytest.mark.parametrize("start", ["rest", "near"])
def test_what_touches_first_in_the_last_step_rubs(start):
    """A strip that hangs just above a plane under nine tenths of its weight, or from the start, and aside."""
    mesh = ms.flat_beam(length=0.4, width=0.12, cells=(12, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=2e6, poisson=0.3, thickness=2e-3, density=300.0), "x < 0.001")
    model, gravity = ms.DiscreteShell(shell), np.array([0.0, 0.5, -6.0])
    hanging = [model.equilibrium(gravity=part * gravity).positions for part in (0.9, 1.0)]
    height = np.mean([positions[:, 2].min() for positions in hanging])
    table = [ms.Contact(ms.Plane((0.0, 0.0, 1.0), height), friction=5.0)]
    answer = model.equilibrium(gravity=gravity, contacts=table, start=hanging[0] if start == "near" else None)
    assert answer.converged
    assert np.linalg.norm(answer.contact_forces[:, :2]) > 1e-3 * np.linalg.norm(answer.contact_forces)


@pytest.mark.slow
def test_a_clamped_strip_that_snaps_over_a_rounded_edge_rests_again():
    """Its supports hold it, so that it cannot slide away: "no equilibrium: it slides" was said of it."""
    mesh = ms.flat_beam(length=1.0, width=0.3, cells=(8, 2))
    shell = ms.Shell(mesh, ms.Isotropic(young=5e6, poisson=0.3, thickness=4e-3, density=200.0), "x < 1e-9")
    gravity, box = (3.0, 0.0, -WEIGHT), ms.Box((0.75, 0.0, -0.28), (0.1, 0.1, 0.2), rounding=0.05)
    state = ms.DiscreteShell(shell).equilibrium(gravity=gravity, contacts=[ms.Contact(box, friction=0.3)])
    assert state.converged
    assert state.in_contact.any()
    forces, normals = state.contact_forces, box.gap(state.positions)[1]
    pushes = np.sum(forces * normals, axis=1)
    assert (np.linalg.norm(forces - pushes[:, None] * normals, axis=1) <= 0.3 * pushes + 1e-6 * pushes.max()).all()
    unbalanced = shell.force(state.positions) + forces + shell.mass[:, None] * np.array(gravity)
    assert np.linalg.norm(unbalanced[~shell.clamped]) < 1e-6 * WEIGHT * shell.mass.sum()
