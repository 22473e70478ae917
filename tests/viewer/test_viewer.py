"""The viewer: the session without graphics, and the windows off-screen."""

import os
import sys

import numpy as np
import pytest
from matplotlib.image import imread

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.errors import LoadError, OptionError
from modalshell.models.registry import MODELS
from modalshell.motion import Motion
from modalshell.render.backend import RENDERER_VARIABLE
from modalshell.run import RunFollower
from modalshell.viewer import ViewSession, take_picture
from modalshell.viewer.live_bar import LiveBar
from modalshell.viewer.session import FRAME_SECONDS

BEAM = (
    ("[12, 4]", "[20, 4]"),
    ("x < 0.1", "x < 0.051"),
    ("duration = 1", "duration = 4.0\ndamping = [0.5, 0.001]"),
)
MOVING = ('0.051"', '0.051"\ntimes = [0.0, 0.5, 1.0]\ntranslations = [[0, 0, 0], [0, 0.2, 0], [0, 0, 0]]')
EXPLICIT = ('"mwts"', '"ds"\nintegrator = "explicit"\nallow_unstable_step = true')


@pytest.fixture
def session(scene_file):
    return ViewSession(ms.load_scene(scene_file(*BEAM)))


def play(session, frames):
    session.play()
    for _ in range(frames):
        session.advance(FRAME_SECONDS)


def moved(session):
    return float(np.linalg.norm(session.positions - session.shell.rest_positions, axis=1).max())


@pytest.mark.by_default("whole steps")
@pytest.mark.parametrize("more", ["", "tolerance = 1e-5\n"], ids=["whole steps", "divided steps"])
def test_session_follows_the_scene_frame_by_frame(scene_file, more):
    scene = ms.load_scene(scene_file(*BEAM, ("duration = 4.0", f"duration = 4.0\n{more}")))
    session = ViewSession(scene)
    play(session, 15)
    motion = scene.build().start_motion()
    for _ in range(15):
        motion.advance()
    assert session.time == motion.time
    np.testing.assert_array_equal(session.positions, motion.positions())


FLOOR = '[[contacts]]\nkind = "plane"\nnormal = [0, 0, 1]\noffset = -0.04\nfriction = 0.2\n'


@pytest.mark.by_default("free")
@pytest.mark.parametrize("more", ["", FLOOR], ids=["free", "on a floor"])
def test_bars_of_a_scene_that_asks_for_them_are_those_of_its_run(scene_file, tmp_path, more):
    model = [("mwts", "ds")] if more else []
    file = scene_file(*BEAM, ("duration = 4.0", "duration = 1.6"), *model, more=more)
    file.write_text(f"bar = true\n{file.read_text()}")
    run = ms.run_scene(file, out=tmp_path).trajectory
    session = ViewSession(ms.load_scene(file))
    said = []
    session.play()
    for _ in range(len(run.times) - 1):
        session.advance(FRAME_SECONDS)
        said.append(session.status().split("; ")[2])
    assert len(run.bars.times) == 3
    for time, text in zip(run.bars.times, run.bars.texts(), strict=True):
        k = round(time / FRAME_SECONDS)  # a bar is known one frame later
        assert said[k] == text
    assert "from DS" not in said[5]


@pytest.mark.slow
@pytest.mark.parametrize("far", [0.0, 200.0])
def test_live_bars_of_a_shell_far_away_are_those_of_its_run(far):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    mesh = ms.TriangleMesh(np.add(mesh.vertices, [far, 0.0, 0.0]), mesh.faces)
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), clamped=mesh.vertices[:, 0] < far + 1e-6)
    model, contact = ms.DiscreteShell(shell), ms.Contact(ms.Sphere((far + 0.8, 0.0, -0.23), 0.2))
    options = {"dt": 1 / 60, "damping": (2.0, 1e-3), "contacts": [contact]}
    motion = Motion(model, shell.loading((0.0, 0.0, -2.0)), **options)
    live = LiveBar(motion)
    for _ in range(32):
        motion.advance()
        live.see(motion)
    run = ms.simulate(model, duration=0.6, gravity=(0.0, 0.0, -2.0), bars=15, **options)
    assert run.in_contact[30].any()
    assert run.bars.valid.all()
    assert live.text == run.bars.texts()[1]


def test_nothing_moves_before_play_and_in_pause(session):
    session.advance(1.0)
    assert session.time == 0.0
    assert moved(session) == 0.0
    play(session, 5)
    session.toggle()
    shape = session.positions.copy()
    session.advance(1.0)
    np.testing.assert_array_equal(session.positions, shape)
    assert "paused" in session.status()
    session.toggle()
    session.advance(FRAME_SECONDS)
    assert not np.array_equal(session.positions, shape)
    session.reset()
    assert (session.time, moved(session), session.playing) == (0.0, 0.0, False)


def test_gravity_turns_without_losing_the_motion(session):
    play(session, 10)
    before = session.positions.copy()
    session.set_gravity([0.0, 9.81, 0.0])
    np.testing.assert_array_equal(session.positions, before)
    play(session, 60)
    tip = np.argmax(session.shell.rest_positions[:, 0])
    change = session.positions[tip] - before[tip]
    assert change[1] > 0.01
    assert change[2] > 0.05
    with pytest.raises(LoadError, match="gravity"):
        session.set_gravity([0.0, np.nan, 0.0])
    np.testing.assert_array_equal(session.gravity, [0.0, 9.81, 0.0])


def test_other_forces_stay_when_gravity_changes(scene_file):
    push = '[[loads.forces]]\nwhere = "x > 0.99"\ntotal = [0.0, 0.02, 0.0]\n'
    session = ViewSession(ms.load_scene(scene_file(*BEAM, more=push)))
    session.set_gravity([0.0, 0.0, 0.0])
    play(session, 20)
    tip = np.argmax(session.shell.rest_positions[:, 0])
    assert (session.positions - session.shell.rest_positions)[tip, 1] > 1e-3


@pytest.mark.by_default("ds-1e-12-resting supports", "rsw-0.02-resting supports", "lma-0.2-moving supports")
@pytest.mark.parametrize("supports", [(), (MOVING,)], ids=["resting supports", "moving supports"])
@pytest.mark.parametrize(("name", "error"), [("ds", 1e-12), ("rsw", 0.02), ("lma", 0.2)])
def test_another_model_takes_up_the_shape(scene_file, supports, name, error):
    session = ViewSession(ms.load_scene(scene_file(*BEAM, *supports)))
    play(session, 12)
    shape, now = session.positions.copy(), session.time
    assert moved(session) > 0.1
    session.set_model(name)
    assert session.name == name
    assert session.time == now
    assert session.playing
    assert np.abs(session.positions - shape).max() <= error * moved(session)
    session.advance(FRAME_SECONDS)
    assert session.time > now
    assert session.note == ""


def test_another_model_keeps_the_folds_of_creases(tmp_path):
    """From all vertices to a coarse shell and back: the sheet, at rest without a load, stays as it is folded."""
    (tmp_path / "folded.toml").write_text("""
[mesh]
shape = "flat_beam"
length = 0.5
width = 0.1
cells = [8, 2]
[material]
young = 2e9
poisson = 0.3
thickness = 1e-3
density = 1200.0
[supports]
clamped = "x < 0.001"
[loads]
gravity = [0.0, 0.0, -9.81]
[[creases]]
sel = "abs(x - 0.25) < 0.001"
yield_moment = 0.05
hardening = 0.02
[model]
name = "ds"
[motion]
duration = 1.0
dt = 0.04
damping = [8.0, 4e-3]
""")
    session = ViewSession(ms.load_scene(tmp_path / "folded.toml"))

    def folds():
        kept = session._motion.state.memory
        return session.model.crease_angles(kept["creases"]).mean(), kept["crease_heat"][0]

    session.play()
    session.advance(0.6)
    session.set_gravity((0.0, 0.0, 0.0))
    session.advance(1.6)
    kept, heat = folds()
    shape = session.positions
    assert abs(kept) > 0.3
    for name in ("coarse-ds", "ds"):
        session.set_model(name)
        assert folds() == (pytest.approx(kept, rel=1e-12), heat)
        session.advance(0.2)
        assert folds() == (pytest.approx(kept, rel=1e-3), pytest.approx(heat, rel=1e-3))
    assert np.abs(session.positions - shape).max() < 0.01 * np.abs(shape - session.rest_positions).max()


def test_back_to_modal_warping_within_what_its_modes_can_hold(session):
    session.set_model("ds")
    play(session, 12)
    shape = session.positions.copy()
    session.set_model("mwts", 16)
    assert np.abs(session.positions - shape).max() < 0.01 * moved(session)


def test_mode_count_changes_in_motion(session):
    play(session, 12)
    shape, rates = session.positions.copy(), session._motion.state.rates.copy()
    session.set_model("mwts", 12)
    np.testing.assert_allclose(session.positions, shape, atol=1e-10)
    np.testing.assert_allclose(session._motion.state.rates[:8], rates, rtol=1e-8, atol=1e-10)
    assert "12 modes" in session.status()
    session.set_model("mwts", 4)
    assert session._motion.state.rates.shape == (4,)
    np.testing.assert_allclose(session._motion.state.rates, rates[:4], rtol=1e-8, atol=1e-10)
    basis = session._first_modes.known
    session.set_model("lma", 11)
    assert session._first_modes.known is basis
    assert basis.count == 12


def test_refused_choices_leave_the_session_as_it_was(session):
    play(session, 3)
    shape = session.positions.copy()
    for name, modes, text in (("fem", 8, "choose from"), ("mwts", 0, "positive"), ("mwts", 1000, "at most 64")):
        with pytest.raises(OptionError, match=text):
            session.set_model(name, modes)
        assert session.choose(name, modes)
        assert text in session.refusal
        assert session.status().endswith(session.refusal)
    assert not session.choose("mwts", 8)
    assert (session.name, session.modes, session.playing) == ("mwts", 8, True)
    np.testing.assert_array_equal(session.positions, shape)
    session.toggle()
    assert session.refusal == ""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no basis of up to")
def test_every_model_of_scenes_can_be_chosen(session):
    play(session, 2)
    for name in MODELS:
        session.set_model(name)
        session.advance(FRAME_SECONDS)
        assert session.playing, session.status()


@pytest.mark.filterwarnings("ignore::modalshell.ModalShellWarning")
def test_divergence_pauses_and_says_so(scene_file):
    session = ViewSession(ms.load_scene(scene_file(*BEAM, EXPLICIT)))
    play(session, 400)
    assert session.diverged
    assert not session.playing
    assert "diverged at t =" in session.status()
    assert np.isfinite(session.positions).all()
    session.play()
    assert not session.playing
    session.reset()
    assert not session.diverged
    assert moved(session) == 0.0


def test_a_slow_model_drops_time_and_says_so(session, monkeypatch):
    session.play()
    step, clock = session._motion.advance, [0.0]

    def slow():
        clock[0] += 0.02
        step()

    monkeypatch.setattr(session._motion, "advance", slow)
    monkeypatch.setattr("modalshell.viewer.session.Stopwatch", lambda: lambda: clock[0])
    session.advance(10.0 * FRAME_SECONDS, limit=0.03)
    assert session.time == pytest.approx(2 * FRAME_SECONDS)
    assert "slower than real time" in session.status()
    assert session.frame_milliseconds == pytest.approx(40.0)


def test_a_scene_without_motion_moves_all_the_same(scene_file):
    session = ViewSession(ms.load_scene(scene_file(("[motion]\nduration = 1\n", ""))))
    play(session, 10)
    assert moved(session) > 0.01


def test_a_step_that_is_refused_pauses_with_the_reason(session, monkeypatch):
    def refuse():
        raise OptionError("no such step")

    session.play()
    monkeypatch.setattr(session._motion, "advance", refuse)
    session.advance(FRAME_SECONDS)
    assert not session.playing
    assert session.status().endswith("no such step")


def refused(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(["view", *map(str, arguments)])
    assert stopped.value.code == 2
    message = capsys.readouterr().err
    assert message.startswith("modalshell: ")
    assert message.count("\n") == 1
    return message


@pytest.mark.usefixtures("opengl")
def test_screenshots_show_the_motion(scene_file, tmp_path, capsys):
    pictures = []
    for frames in (1, 12):
        path = tmp_path / f"{frames}.png"
        with pytest.raises(SystemExit, match="0"):
            main(["view", str(scene_file()), "--frames", str(frames), "--screenshot", str(path)])
        assert capsys.readouterr().out.strip() == str(path)
        pictures.append(imread(path)[..., :3])
    assert pictures[0].shape == (800, 1200, 3)
    shell = np.abs(pictures[1] - pictures[0])[100:700, 100:950]  # neither status nor sliders
    assert (shell.max(axis=2) > 0.1).mean() > 0.02


class Stopped(Exception):
    pass


def stopped_run(scene, out, steps, **options):
    """Run, or go on, up to so many steps."""

    def on_step(done, _total):
        if done == steps:
            raise Stopped

    with pytest.raises(Stopped):
        ms.run_scene(scene, out=out, on_step=on_step, **options)


@pytest.mark.usefixtures("opengl")
def test_pictures_of_attached_runs_show_their_newest_frame(scene_file, tmp_path, capsys):
    out, pictures = tmp_path / "out", []
    for steps in (1, 12):
        stopped_run(scene_file(), out, steps)
        path = tmp_path / f"{steps}.png"
        with pytest.raises(SystemExit, match="0"):
            main(["view", "--attach", str(out), "--screenshot", str(path)])
        assert capsys.readouterr().out.strip() == str(path)
        pictures.append(imread(path)[..., :3])
    assert pictures[0].shape == (800, 1200, 3)
    shell = np.abs(pictures[1] - pictures[0])[100:700]  # without the text
    assert (shell.max(axis=2) > 0.1).mean() > 0.02


@pytest.mark.usefixtures("opengl")
def test_attached_windows_take_up_another_shell(scene_file, tmp_path):
    from modalshell.viewer.attached import AttachedWindow

    out, path = tmp_path / "out", tmp_path / "a.png"
    stopped_run(scene_file(), out, 12)
    run = RunFollower(out)
    run.wait(0.0)
    window = AttachedWindow(run, off_screen=True)
    try:
        folded = scene_file(("[12, 4]", "[10, 2]\nfold = 90.0"), ("x < 0.1", "x < 0.11"))
        stopped_run(folded, out, 3, restart=True)
        window._on_timer()
        assert len(run.positions) == len(ms.load_scene(folded).build_shell().mass)
        np.testing.assert_allclose(window._stage._surface.points, run.positions, atol=1e-6)
        fresh = AttachedWindow(run, off_screen=True)
        fresh.save_picture(path)
        expected = imread(path)
    finally:
        window.save_picture(path)
        run.close()
    # The same picture as of a window that has shown nothing before.
    assert (np.abs(imread(path) - expected).max(axis=2) > 0.1).mean() < 1e-3


@pytest.mark.usefixtures("opengl")
def test_window_controls_drive_the_session(scene_file):
    from modalshell.viewer.desktop import DesktopViewer

    session = ViewSession(ms.load_scene(scene_file(*BEAM)))
    viewer = DesktopViewer(session, off_screen=True)
    try:
        assert (session.name, session.modes) == ("mwts", 8)
        np.testing.assert_allclose(session.gravity, [0.0, 0.0, -9.81])
        viewer._pull(0)(5.0)
        np.testing.assert_allclose(session.gravity, [5.0, 0.0, -9.81])
        viewer._modes_slider.GetRepresentation().SetValue(11.0)
        viewer._modes_slider.InvokeEvent("EndInteractionEvent")
        assert session.modes == 11
        viewer._next_model()
        assert session.name != "mwts"
        assert viewer._model_slider.GetRepresentation().GetTitleText() == session.name.upper()
        session.toggle()
        assert session.playing
        viewer._model_slider.GetRepresentation().SetValue(viewer._names.index("reduced-rsw"))
        viewer._model_slider.InvokeEvent("EndInteractionEvent")
        assert session.name == "reduced-rsw"
    finally:
        viewer._stage.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have a display or cannot say")
def test_no_display_is_one_line(scene_file, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    assert "--web" in refused(capsys, scene_file())


def test_no_opengl_is_one_line(scene_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(RENDERER_VARIABLE, "built-in")
    assert "libegl1" in refused(capsys, scene_file(), "--screenshot", tmp_path / "a.png")


def test_missing_extra_is_one_line(scene_file, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "trame.app", None)
    assert "pip install 'modalshell[web]'" in refused(capsys, scene_file(), "--web")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--screenshot", "a.jpg"], "must end in .png"),
        (["--screenshot", "a.png", "--frames", "0"], "positive"),
        (["--screenshot", "a.png", "--web"], "leave out --web"),
        (["--web", "--port", "70000"], "0 to 65535"),
    ],
)
def test_options_that_are_refused(scene_file, capsys, options, text):
    assert text in refused(capsys, scene_file(), *options)


def test_a_still_scene_moves_in_real_time_in_its_own_units(scene_file):
    units = '[units]\nlength = "m"\nmass = "kg"\ntime = "ms"\n'
    session = ViewSession(
        ms.load_scene(scene_file(("[motion]\nduration = 1\n", ""), ("-9.81", "-9.81e-6"), more=units))
    )
    assert session.gravity_limit == pytest.approx(2.0 * 9.81e-6)
    play(session, 3)
    assert session.time == pytest.approx(100.0)
    assert "t = 100.00 ms" in session.status()
    session._stop_diverged()
    assert "diverged at t = 100 ms" in session.note


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_the_arrow_of_gravity_is_as_long_in_all_units(scene_file):
    from modalshell.viewer.desktop import DesktopViewer

    units = '[units]\nlength = "m"\nmass = "kg"\ntime = "ms"\n'
    lengths = []
    for change, more in (((), ""), ((("-9.81", "-9.81e-6"),), units)):
        viewer = DesktopViewer(ViewSession(ms.load_scene(scene_file(*change, more=more))), off_screen=True)
        lengths.append(np.ptp(viewer._stage._arrow.points, axis=0)[2])
        titles = [widget.GetRepresentation().GetTitleText() for widget in viewer._stage.plotter.widgets.slider_widgets]
        assert f"gravity x [{'m/ms^2' if units == more else 'm/s^2'}]" in titles
        viewer._stage.close()
    assert lengths[0] == pytest.approx(0.5 * 0.35, rel=1e-6)
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-6)


@pytest.mark.usefixtures("opengl")
def test_a_window_is_pictured_whole_or_not_at_all(scene_file, tmp_path, monkeypatch):
    path, move = tmp_path / "a.png", os.replace
    path.write_bytes(b"before")

    def full_disk(source, target):
        if str(target) == str(path):
            raise OSError(28, "No space left on device")
        move(source, target)

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(ms.FileFormatError, match="cannot be written"):
        take_picture(ms.load_scene(scene_file()), 1, path)
    assert path.read_bytes() == b"before"
