"""Error bars of motions with contacts: against DS at rest under the same load, friction, strikes, supports, files."""

import json

import numpy as np
import pytest
from scenes import sheet_strip, stopped_and_resumed

import modalshell as ms
from modalshell.core.touched import PUSHED_OUT, STRUCK
from modalshell.models.motion_check import MotionCheck, touching_frames

DT, EVERY = 1.0 / 60.0, 4
GRAVITY = (0.0, 0.0, -9.81)
DAMPING = (2.0, 1e-3)


def along(axis, times, ways):
    return ms.SupportPath(times, np.outer(ways, np.eye(3)[axis]))


FLOOR = ms.Plane((0, 0, 1), -0.15)
PUSHER = ms.Box((0.8, 0, 0.2), (0.1, 0.3, 0.1), rounding=0.05)
SCENES = {
    "table": (ms.Contact(FLOOR), GRAVITY),
    "ball": (ms.Contact(ms.Sphere((0.7, 0.0, -0.41), 0.3)), GRAVITY),
    "rising": (ms.Contact(ms.Plane((0, 0, 1), -0.25), motion=along(2, [0, 0.5, 1.5], [0, 0, 0.2])), GRAVITY),
    "dragged": (ms.Contact(FLOOR, friction=0.4, motion=along(1, [0, 0.4, 1.4], [0, 0, 0.3])), GRAVITY),
    "pushed": (ms.Contact(PUSHER, motion=along(2, [0, 0.3, 1.3], [0, 0, -0.3])), (0.0, 0.0, 0.0)),
}


@pytest.fixture(scope="module")
def shell():
    return sheet_strip()


@pytest.fixture(scope="module")
def warping(shell):
    return ms.ModalWarping(ms.solve_modes(shell, 6))


def move(model, contact, gravity=GRAVITY, duration=1.2, **further):
    options = {"dt": DT, "damping": DAMPING, "bars": EVERY} | further
    return ms.simulate(model, duration=duration, gravity=gravity, contacts=[contact], **options)


def norm(shell, displacement):
    return np.sqrt(np.sum(shell.mass[:, None] * displacement**2))


def stopped(contact, time):
    """The contact without friction, its collider where it is at a time."""
    pose = None if contact.motion is None else contact.motion.at(time).to_world(np.zeros((1, 3)))[0]
    still = None if pose is None else ms.SupportPath([0, 1], np.stack([pose, pose]))
    return ms.Contact(contact.collider, contact.sel, motion=still)


def around(k):
    return slice(k - 1, k + 2)


def checking(model, contact, gravity=GRAVITY, path=None):
    """Without damping by the stiffness: what its stresses are ahead of a shape does not rest on the collider."""
    loading, touching = model.shell.loading(gravity), touching_frames(model, [contact], DT, path)
    return MotionCheck(model.shell, loading, ms.Damping(DAMPING[0]), path, touching=touching)


def ratios(shell, run, contact, gravity):
    """Bars of judged frames over the distance to where DS rests under the same load."""
    check = checking(ms.DiscreteShell(shell), contact, gravity)
    found = []
    for place, time in enumerate(run.bars.times):
        if not run.bars.valid[place]:
            continue
        k = round(time / DT)
        near = around(k)
        bar, load, _ = check.bar_under(run.times[near], run.positions[near], forces=run.contact_forces[near])
        truth = ms.DiscreteShell(shell).equilibrium(
            force=load, contacts=[stopped(contact, time)], start=run.positions[k]
        )
        largest = max(norm(shell, x - shell.rest_positions) for x in run.positions[: k + 1])
        off = norm(shell, truth.positions - run.positions[k])
        if truth.converged and off > 1e-4 * largest:  # nothing has moved at first
            found.append(check.off(bar, run.positions[k]) / off)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_they_are_the_distance_from_rest_under_the_load_in_balance(shell, warping, name):
    contact, gravity = SCENES[name]
    run = move(ms.DiscreteShell(shell) if contact.friction else warping, contact, gravity)
    touching = [run.in_contact[round(time / DT)].any() for time in run.bars.times]
    assert np.mean(touching) > 0.3
    assert all(valid or reason == STRUCK for valid, reason in zip(run.bars.valid, run.bars.unjudged, strict=True))
    found = ratios(shell, run, contact, gravity)
    assert found.size >= 6
    assert np.abs(found - 1.0).max() < 0.02
    assert np.median(found) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_friction_is_a_load_of_its_frame(shell):
    """A floor drags the strip along: DS itself is right by its bar, which is off without friction."""
    contact = ms.Contact(FLOOR, friction=0.4, motion=along(1, [0, 0.4, 1.4], [0, 0, 0.3]))
    model = ms.DiscreteShell(shell)
    run, touching = move(model, contact, duration=1.0), touching_frames(model, [contact], DT)
    check, bars = checking(model, contact), []
    for k in range(46, 59, 3):
        near = around(k)
        times, frames, forces = run.times[near], run.positions[near], run.contact_forces[near]
        assert run.in_contact[near].any(axis=1).all()
        bars.append([check.bar(times, frames, given).displacement for given in (forces, None)])
        rubbing, pressed = touching.friction(times, frames, forces).sum(axis=0), forces[1:, :, 2].sum(axis=1).mean()
        # It swings along x, too, by some hundredths of the floor's speed.
        assert rubbing == pytest.approx([0.0, 0.4 * pressed, 0.0], rel=2e-3, abs=2e-2 * pressed)
    with_it, without = np.mean(bars, axis=0)
    assert with_it < 0.8 * without


@pytest.mark.slow
def test_damping_by_the_stiffness_is_no_error_in_contact(shell):
    """The gaps are those of the shape, and not of what its stresses are ahead of it."""
    rising = ms.Contact(ms.Plane((0, 0, 1), -0.02), "x > 0.6", motion=along(2, [0.0, 0.7, 1.4], [0.0, 0.06, 0.0]))
    run = move(ms.DiscreteShell(shell), rising, (0.0, 0.0, -0.3), damping=(0.0, 0.03), bars=4)
    judged = run.bars.displacement[run.bars.valid]
    assert np.mean([run.in_contact[round(time / DT)].any() for time in run.bars.times]) > 0.5
    assert np.mean(run.bars.valid) > 0.8
    assert judged.max() < 0.05


def test_frames_that_are_not_judged_say_why_and_spoil_none(warping, tmp_path):
    run = move(warping, ms.Contact(FLOOR), duration=0.4, bars=1)
    struck = np.array(run.bars.unjudged) == STRUCK
    first = int(np.flatnonzero(run.in_contact.any(axis=1))[0])
    assert struck[first - 2]  # bars begin with frame 1: the frame before that in which something first touches
    assert struck.sum() <= 3
    assert np.array_equal(run.bars.valid, ~struck)
    assert run.bars.void_from is None
    assert str(run.bars).endswith(f"void in {struck.sum()} frames: {STRUCK}")
    assert run.bars.texts()[first - 2] == f"bar void: {STRUCK}"
    again = ms.load_trajectory(run.save(tmp_path / "run.npz"))
    assert again.bars.unjudged == run.bars.unjudged
    assert str(again.bars) == str(run.bars)


@pytest.mark.slow
def test_bars_are_void_from_where_the_margin_fails():
    """A ball pushes an arch through: RSW is right by its bar again beyond, which is void as history is not known."""
    flat = ms.flat_beam(length=1.0, width=0.1, cells=(16, 2))
    x, y, _ = flat.vertices.T
    mesh = ms.TriangleMesh(np.stack([x, y, 0.06 * np.sin(np.pi * x)], axis=1), flat.faces)
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0), "x < 1e-6 or x > 0.999")
    ball = ms.Contact(ms.Sphere((0.5, 0.0, 0.17), 0.1), motion=along(2, [0, 0.2, 1.6], [0, 0, -0.14]))
    # With less damping its halves swing apart, in steps of a sixteenth of these, too.
    run = move(ms.RotationStrain(ms.solve_modes(shell, 6)), ball, (0.0, 0.0, 0.0), duration=1.8, damping=(2.0, 0.01))
    first = run.bars.times.tolist().index(run.bars.void_from)
    unjudged = np.array(run.bars.unjudged) != ""
    assert run.bars.valid[:first][~unjudged[:first]].all()
    assert run.bars.margin[first] <= 0.3
    assert not run.bars.valid[first:].any()
    assert run.bars.margin[-1] > 0.9
    assert f"void from {run.bars.void_from:.4g} s on" in str(run.bars)


def test_what_is_pushed_out_is_not_judged(shell):
    deep = ms.Contact(ms.Plane((0, 0, 1), 0.01), sel="x > 0.5", push_out=0.05)
    run = move(ms.DiscreteShell(shell), deep, (0.0, 0.0, 0.0), duration=0.15, bars=3)
    assert set(run.bars.unjudged) == {PUSHED_OUT}
    assert not run.bars.valid.any()


def test_seen_from_supports_that_move_they_are_the_same(warping):
    """Supports and ball go along together; half way nothing is accelerated."""
    contact, gravity = SCENES["ball"]
    run = move(warping, contact, gravity, duration=0.8)
    path = ms.SupportPath([0.0, 1.0], np.array([(0, 0, 0), (0, 0.3, 0.1)]))
    k, half = 40, np.array([0.5 - DT, 0.5, 0.5 + DT])
    frames = run.positions[around(k)]
    still = checking(warping, contact).bar(half, frames)
    moved = np.stack([path.at(time).to_world(frame) for time, frame in zip(half, frames, strict=True)])
    led = ms.Contact(contact.collider, motion=path)
    bar = checking(warping, led, gravity, path).bar(half, moved)
    assert still.valid
    assert bar.displacement == pytest.approx(still.displacement, rel=1e-6)
    assert bar.margin == pytest.approx(still.margin, rel=1e-6)


@pytest.mark.slow
def test_a_scene_has_them_and_a_resumed_one_the_same(scene_file, tmp_path):
    floor = '[[contacts]]\nkind = "plane"\nnormal = [0, 0, 1]\noffset = -0.1\n'
    scene = scene_file(more=floor)
    scene.write_text(f"bar = true\n{scene.read_text()}")
    first, resumed = stopped_and_resumed(scene, tmp_path, 20)
    whole = first.trajectory
    assert resumed.resumed > 1
    assert whole.in_contact[-1].any()
    assert whole.bars.times.size
    for name in ("displacement", "margin", "valid"):
        assert np.array_equal(getattr(resumed.trajectory.bars, name), getattr(whole.bars, name))
    stored = json.loads((tmp_path / "whole" / f"{scene.stem}.json").read_text())["bars"]
    assert stored["unjudged"] == list(whole.bars.unjudged)


def test_friction_of_explicit_steps_is_refused(shell):
    model = ms.DiscreteShell(shell, integrator="explicit")
    with pytest.raises(ms.OptionError, match="bars of motions with friction take implicit steps"):
        move(model, ms.Contact(FLOOR, friction=0.3), dt=1e-6, duration=2e-6)


def test_friction_of_models_on_modes_is_not_referred_to_a_rule_that_they_lack(warping):
    with pytest.raises(ms.OptionError, match=r"not for models on modes \(got MWTS\): take DS or coarse DS"):
        move(warping, ms.Contact(FLOOR, friction=0.3))


@pytest.mark.parametrize("given", ["motion", "statics"])
def test_contacts_of_any_kind_of_list_are_heeded_with_bars(warping, given):
    """An iterator was read by the bars, and the motion went through the floor; what is no list was no clear error."""

    def answer(contacts):
        if given == "statics":
            return warping.equilibrium(gravity=GRAVITY, contacts=contacts, bar=True)
        return ms.simulate(warping, duration=0.4, dt=DT, gravity=GRAVITY, contacts=contacts, bars=EVERY)

    floor = ms.Contact(FLOOR)
    assert answer(iter([floor])).in_contact.any()
    for wrong, words in (
        (floor, "write contacts="),
        ([3], "each of contacts must be a Contact"),
        (3, "must be a list"),
    ):
        with pytest.raises(ms.OptionError, match=words):
            answer(wrong)
