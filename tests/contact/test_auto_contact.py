"""``auto`` with contacts: at rest a modal answer where its bar is small; in motion levels that keep its error."""

import warnings

import numpy as np
import pytest
from scenes import sheet_strip, stopped_and_resumed

import modalshell as ms
from modalshell.integrators.state import MotionState
from modalshell.models.auto.account import NO_MARGIN, level_note
from modalshell.models.base.modal_contact import ModalContactMotion
from modalshell.motion import Motion

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))


@pytest.fixture(scope="module")
def shell():
    return sheet_strip((20, 4))


@pytest.mark.parametrize(("error", "name"), [(0.1, "MWTS"), (1e-3, "DS")])
def test_auto_rests_on_a_table_within_its_error(shell, error, name):
    truth = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    model = ms.Auto(shell, error=error)
    state = model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert state.converged
    assert state.message.startswith(name)
    assert ms.measure.displacement_error(state.positions, truth.positions, shell) <= error
    assert state.contact_forces[:, 2].sum() == pytest.approx(truth.contact_forces[:, 2].sum(), rel=0.02)
    assert state.iterations <= 10 < truth.iterations
    live = model.equilibrium(loads=[ms.Pressure(-6.0)], contacts=[FLOOR], bar=True)
    assert live.bar.displacement <= error


@pytest.mark.slow
def test_auto_leaves_what_pushes_out_to_discrete_shells(shell):
    model, wall = ms.Auto(shell), ms.Contact(ms.Plane((0, 0, 1), 0.02), sel="x > 0.5", push_out=1.0)
    state = model.equilibrium(contacts=[wall])
    assert state.converged
    assert state.positions[shell.mesh.vertices[:, 0] > 0.5, 2].min() >= 0.02 - 1e-9


@pytest.mark.slow
def test_auto_leaves_friction_to_discrete_shells(shell):
    """Statics of modes refuse it, which is no reason for a model that has DS to do so."""
    rough = ms.Contact(ms.Plane((0, 0, 1), -0.15), friction=0.3)
    state = ms.Auto(shell).equilibrium(gravity=GRAVITY, contacts=[rough])
    truth = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[rough])
    assert state.converged
    np.testing.assert_array_equal(state.positions, truth.positions)
    tangential = np.hypot(*state.contact_forces.sum(axis=0)[:2])
    assert tangential > 1e-3 * state.contact_forces[:, 2].sum()


DT = 1.0 / 60.0


def along_z(times, ways):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ms.ModalShellWarning)  # some swing beyond their keyframes
        return ms.SupportPath(times, np.outer(ways, [0.0, 0.0, 1.0]))


PUSHER = ms.Box((0.8, 0, 0.2), (0.1, 0.3, 0.1), rounding=0.05)
RISING = ms.Plane((0, 0, 1), -0.25)
SCENES = {
    "dropped on a table": (ms.Contact(ms.Plane((0, 0, 1), -0.1)), GRAVITY),
    "on a rising table": (ms.Contact(RISING, motion=along_z([0, 0.5, 1.5], [0, 0, 0.2])), GRAVITY),
    "pushed by a box": (ms.Contact(PUSHER, motion=along_z([0, 0.3, 1.3], [0, 0, -0.3])), (0.0, 0.0, 0.0)),
    "over a ball": (ms.Contact(ms.Sphere((0.7, 0, -0.41), 0.3)), GRAVITY),
}


@pytest.fixture(scope="module")
def small():
    return sheet_strip()


@pytest.fixture(scope="module")
def auto(small):
    return ms.Auto(small)


def move(model, contact, gravity, duration=1.0, **further):
    options = {"dt": DT, "damping": (2.0, 1e-3)} | further
    return ms.simulate(model, duration=duration, gravity=gravity, contacts=[contact], **options)


def norm(shell, displacement):
    return np.sqrt(np.sum(shell.mass[:, None] * displacement**2, axis=(1, 2)))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_motions_stay_within_the_error(small, auto, name):
    contact, gravity = SCENES[name]
    run, truth = move(auto, contact, gravity), move(ms.DiscreteShell(small), contact, gravity)
    assert run.in_contact[-1].any()
    largest = np.maximum.accumulate(norm(small, truth.positions - small.rest_positions))
    told = largest > 0.05 * largest[-1]  # where a strike has hardly moved the shell, shares mean little
    error = norm(small, run.positions - truth.positions)[told] / largest[told]
    assert error.max() < 0.04
    assert run.levels.count("MWTS") > 0.1 * len(run.levels)
    assert run.deepest.max() < 1e-8
    touching = run.in_contact.any(axis=1) & truth.in_contact.any(axis=1)
    both = [moved.contact_forces[touching].sum(axis=1).mean(axis=0)[2] for moved in (run, truth)]
    assert both[0] == pytest.approx(both[1], rel=0.1)


@pytest.mark.slow
def test_levels_hand_over_outside_colliders_and_without_energy(auto):
    """The table under a strip: from modes to DS and back, with states that touch it."""
    run = move(auto, *SCENES["on a rising table"], duration=1.2)
    levels = np.array(run.levels)
    assert {"MWTS", "DS"} <= set(run.levels)
    switched = np.flatnonzero(levels[1:] != levels[:-1]) + 1
    assert run.in_contact[switched].any()
    assert run.deepest.max() < 1e-8
    kinetic = run.energies[:, 0]
    assert kinetic[switched + 1].max() <= 1.2 * kinetic.max()
    put_in = np.ptp(run.energies[:, 2])
    elastic = run.energies[:, 1]
    assert np.abs(elastic[switched] - elastic[switched - 1]).max() < 0.1 * put_in


@pytest.mark.slow
def test_strikes_are_taken_by_discrete_shells(small, auto):
    """Modes alone are 6 % off after this one; what is about to strike is handed over before, with its energy."""
    contact, gravity = SCENES["dropped on a table"]
    truth = move(ms.DiscreteShell(small), contact, gravity, 0.4)
    run, modal = move(auto, contact, gravity, 0.4), move(auto.levels[0].model, contact, gravity, 0.4)
    first = int(np.argmax(run.in_contact.any(axis=1)))
    assert run.levels[first - 1] != "DS" == run.levels[first]
    assert "to DS at 0.1167 s (it is about to strike a collider" in run.message
    assert np.array_equal(run.positions[: first - 1], modal.positions[: first - 1])
    assert run.energies[first, :2].sum() == pytest.approx(
        truth.energies[first, :2].sum(), rel=0.01
    )  # 5 % with its stretch


def test_a_level_whose_shapes_are_far_off_does_not_take_over(auto, monkeypatch):
    """Where modes that are put outside a collider are nowhere near, the next level takes over."""
    contact, gravity = SCENES["on a rising table"]
    plain = move(auto, contact, gravity, 0.25)
    assert "RSW" in plain.levels

    def lost(self, state, _):
        return self.clear(MotionState(1.5 * state.coordinates, state.rates, state.memory))

    monkeypatch.setattr(ModalContactMotion, "entered", lost)
    run = move(auto, contact, gravity, 0.25)
    assert "RSW" not in run.levels
    assert run.levels[-1] == "DS"


ROUGH = {
    "swept by a rough box": (
        {"friction": 0.4, "motion": along_z([0, 0.3, 0.6, 0.8, 3.0], [0, 0, -0.12, 0.12, 0.12])},
        ms.Box((0.8, 0, 0.2), (0.1, 0.3, 0.1), rounding=0.05),
        (0.0, 0.0, 0.0),
    ),
    "bounces": ({"restitution": 0.7}, ms.Plane((0, 0, 1), -0.2), GRAVITY),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "frames"), [("on a rising table", 60), ("swept by a rough box", 64)])
def test_a_motion_resumes_with_the_same_bits_wherever_it_stopped(small, name, frames):
    if name in ROUGH:
        rough, collider, gravity = ROUGH[name]
        contact = ms.Contact(collider, **rough)
    else:
        contact, gravity = SCENES[name]

    def begun():
        model = ms.Auto(small)
        return Motion(model, small.loading(gravity), dt=DT, damping=(2.0, 1e-3), contacts=[contact])

    whole, kept, seen = begun(), [], []
    for _ in range(frames):
        kept.append({name: array.copy() for name, array in whole.snapshot().items()})
        whole.advance()
        seen.append(
            (whole.positions(), whole.energies(), whole.touched().forces, float(whole.state.memory["level"][0]))
        )
    levels = np.array([level for *_, level in seen])
    switches = (np.flatnonzero(np.diff(levels)) + 1).tolist()
    assert len(switches) >= (2 if name in ROUGH else 3)
    strike = int(np.argmax([force.any() for _, _, force, _ in seen]))
    for stop in sorted({1, strike - 1, strike, strike + 1, *(switch + side for switch in switches for side in (0, 1))}):
        resumed = begun()
        resumed.restore(kept[stop])
        for expected in seen[stop : stop + 8]:
            resumed.advance()
            found = resumed.positions(), resumed.energies(), resumed.touched().forces
            assert all(np.array_equal(a, b) for a, b in zip(found, expected[:3], strict=True)), stop


@pytest.mark.slow
@pytest.mark.parametrize("name", ROUGH)
def test_rough_contacts_are_left_to_discrete_shells_as_long_as_they_touch(small, auto, name):
    """Modes move before and after; steps in which a collider with friction or restitution touches are of DS."""
    rough, collider, gravity = ROUGH[name]
    contact, duration = ms.Contact(collider, **rough), 1.6 if "motion" in rough else 0.6
    run, truth = (move(model, contact, gravity, duration) for model in (auto, ms.DiscreteShell(small)))
    touches, levels = run.in_contact.any(axis=1), np.array(run.levels)
    assert touches.any()
    assert set(levels[touches]) == {"DS"}
    assert (levels != "DS").mean() > 0.2
    assert run.deepest.max() < 1e-8
    largest = np.maximum.accumulate(norm(small, truth.positions - small.rest_positions))
    told = largest > 0.05 * largest[-1]
    assert (norm(small, run.positions - truth.positions)[told] / largest[told]).max() < 0.05
    switched = np.flatnonzero(levels[1:] != levels[:-1]) + 1
    kinetic = run.energies[:, 0]
    assert kinetic[np.minimum(switched + 1, len(kinetic) - 1)].max() <= 1.05 * kinetic.max()
    if "motion" in rough:
        assert "touches a collider with friction" in run.message or "about to strike" in run.message
        assert levels[-1] == "MWTS"


@pytest.mark.slow
def test_modes_lie_on_a_smooth_floor_while_a_rough_box_is_away(small, auto):
    rough, collider, _ = ROUGH["swept by a rough box"]
    given = [ms.Contact(ms.Plane((0, 0, 1), -0.05)), ms.Contact(collider, **rough)]
    pull, options = (0.0, 0.0, -1.0), {"duration": 1.4, "dt": DT, "damping": (4.0, 1e-3), "contacts": given}
    run, truth = (ms.simulate(model, gravity=pull, **options) for model in (auto, ms.DiscreteShell(small)))
    levels, touches = np.array(run.levels), run.in_contact.any(axis=1)
    assert (touches & (levels != "DS")).any()
    largest = np.maximum.accumulate(norm(small, truth.positions - small.rest_positions))
    told = largest > 0.05 * largest[-1]
    assert (norm(small, run.positions - truth.positions)[told] / largest[told]).max() < 0.05
    assert (levels == "MWTS").mean() > 0.7


def test_what_modes_do_not_take_begins_by_discrete_shells(small, auto):
    """A start on a rough table, and one that is pushed out of a wall, which modes refuse."""
    onto = ms.Contact(ms.Plane((0, 0, 1), 0.0), friction=0.5)
    run = move(auto, onto, GRAVITY, 0.1)
    assert set(run.levels[1:]) == {"DS"}
    assert "to DS at 0 s (it touches a collider with friction" in run.message
    wall = ms.Contact(ms.Plane((0, 0, 1), 0.01), sel="x > 0.5", push_out=0.5)
    run, truth = (move(model, wall, (0, 0, 0), 0.2) for model in (auto, ms.DiscreteShell(small)))
    assert run.deepest[0] == pytest.approx(0.01)
    assert run.deepest[-1] < 1e-8
    assert norm(small, run.positions - truth.positions).max() < 1e-9 * small.size


@pytest.mark.slow
def test_a_coarse_shell_is_left_out_with_contacts_and_said_to_be(small, auto):
    coarse = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(8, 1)), small.material, clamped="x < 1e-6")
    floor = ms.Contact(ms.Plane((0, 0, 1), -0.1), friction=0.3)
    run, plain = (move(model, floor, GRAVITY, 0.3) for model in (ms.Auto(small, coarse=coarse), auto))
    assert "coarse DS is left out with contacts" in run.message
    assert "friction is smoothed: what sticks creeps" in plain.message
    assert run.levels == plain.levels
    assert np.array_equal(run.positions, plain.positions)


def test_bars_of_a_motion_with_friction(auto):
    run = move(auto, ms.Contact(ms.Plane((0, 0, 1), -0.15), friction=0.3), GRAVITY, 0.5, bars=6)
    judged = np.array([not why for why in run.bars.unjudged])
    assert judged.sum() >= 2
    assert (run.bars.displacement[judged] < 0.05).all()


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_scene_of_it_resumes(scene_file, tmp_path, friction):
    floor = f'[[contacts]]\nkind = "plane"\nnormal = [0, 0, 1]\noffset = -0.06\nfriction = {friction}\n'
    scene = scene_file(("mwts", "auto"), more=floor)
    scene.write_text(f"bar = true\n{scene.read_text()}")
    whole, resumed = (result.trajectory for result in stopped_and_resumed(scene, tmp_path, 22))
    assert whole.in_contact[-1].any()
    for name in ("positions", "energies", "contact_forces", "in_contact", "levels"):
        assert np.array_equal(getattr(resumed, name), getattr(whole, name)), name
    assert np.array_equal(resumed.bars.displacement, whole.bars.displacement)


def test_a_motion_that_cannot_be_is_refused_by_name(small, auto):
    with pytest.raises(ms.OptionError, match="self-contact is for DS with implicit steps alone"):
        move(auto, ms.SelfContact(gap=1e-3), GRAVITY, duration=0.1)
    with pytest.raises(ms.OptionError, match="inside contact 0"):
        move(auto, ms.Contact(ms.Plane((0, 0, 1), 0.01), sel="x > 0.5"), GRAVITY, duration=0.1)
    with pytest.raises(ms.OptionError, match="inside contact 0"):
        move(auto, FLOOR, GRAVITY, duration=0.1, start=small.rest_positions - [0, 0, 0.2])
    with pytest.raises(ms.OptionError, match="auto in free flight takes no contacts"):
        move(ms.Auto(ms.Shell(small.mesh, small.material)), FLOOR, GRAVITY, duration=0.1)


@pytest.mark.slow
def test_a_start_on_the_table_is_held(small, auto):
    begun = ms.DiscreteShell(small).equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    run = move(auto, FLOOR, GRAVITY, duration=0.3, start=begun.positions)
    assert run.deepest.max() < 1e-8
    assert norm(small, run.positions - begun.positions).max() < 0.05 * norm(
        small, (begun.positions - small.rest_positions)[None]
    )


def test_a_check_that_found_no_bar_is_told_as_that():
    """Not as a margin of -1000000000.00."""
    memory = {"steps": np.array([0.0, 5.0]), "switches": np.array([1.0])}
    memory["log"] = np.array([[0.0, 1.0, 1e9, NO_MARGIN, 0.0, 0.0]])
    state = MotionState(np.zeros((1, 3)), np.zeros((1, 3)), memory)
    assert level_note(state, ("MWTS", "DS")) == "steps by DS 100 %; to DS at 0 s (no error bar was found)"
