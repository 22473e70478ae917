"""Films of runs: the ground and the shadow below the shell, and the text in the corner."""

import imageio_ffmpeg
import numpy as np
import pytest

import modalshell as ms
from modalshell.motion import Trajectory
from modalshell.motion.bars import Bars
from modalshell.motion.pace import slowing
from modalshell.render import ShadedSurface, write_film
from modalshell.render.stage import Stage, down_of
from modalshell.run import Look, write_result
from modalshell.run.results import _texts


@pytest.fixture(autouse=True)
def _built_in(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


def flat():
    """Vertices and faces of a flat strip."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 3))
    return np.array(mesh.vertices), np.array(mesh.faces)


def test_a_stage_lies_below_the_motion_and_its_shadows_fall_on_it():
    vertices, faces = flat()
    frames = np.stack([vertices, vertices + np.array([0.0, 0.0, 0.3])])
    stage = Stage(frames, faces)
    *shadows, ground = stage.surfaces
    level = np.asarray(ground.vertices)[:, 2]
    assert np.ptp(level) == 0.0
    assert level[0] < frames[..., 2].min()
    assert stage.motions[-1] is None
    for surface, shadow in zip(shadows, stage.motions[:-1], strict=True):
        assert surface.opacity == 1.0  # a transparent one would take a layer of its own
        assert np.ptp(shadow[..., 2]) == 0.0
        assert 0.0 < shadow[0, 0, 2] - level[0] < 0.01
        assert np.abs(shadow[1] - shadow[0])[:, :2].max() > 0.0  # a slanting lamp: it moves as the shell rises
        radius = np.linalg.norm(np.asarray(ground.vertices)[:, :2] - frames.mean(axis=(0, 1))[:2], axis=1).max()
        assert np.linalg.norm(shadow[..., :2] - frames.mean(axis=(0, 1))[:2], axis=-1).max() < radius


@pytest.mark.parametrize(
    ("gravity", "down"),
    [
        (None, (0, 0, -1)),
        ((0, 0, 9.81), (0, 0, -1)),
        ((5, 5, -5), (0, 0, -1)),
        ((0, -9.81, 0), (0, -1, 0)),
        ((0.0, 9.81, -3), (0, 1, 0)),
        ((-9.81, 0, 0), (-1, 0, 0)),
        ((4, 0, 0), (1, 0, 0)),
    ],
)
def test_the_ground_is_across_the_axis_of_gravity(gravity, down):
    assert down_of(gravity) == down
    vertices, faces = flat()
    frames = np.stack([vertices, vertices - 0.5 * np.array(down)])
    *shadows, ground = Stage(frames, faces, down).surfaces
    fallen, level = frames @ down, np.asarray(ground.vertices) @ down
    assert np.ptp(level) < 1e-12
    assert fallen.max() < level[0] < fallen.max() + 0.1
    for shadow in shadows:
        assert np.ptp(np.asarray(shadow.vertices) @ down) < 1e-12
        assert level[0] - 0.01 < (np.asarray(shadow.vertices) @ down)[0] < level[0]
    around = [axis for axis in range(3) if not down[axis]]
    middle = np.asarray(ground.vertices)[:, around].mean(axis=0)
    np.testing.assert_allclose(middle, 0.5 * (frames.min(axis=(0, 1)) + frames.max(axis=(0, 1)))[around], atol=1e-12)


@pytest.mark.slow
def test_a_scene_says_which_way_its_film_is_up(scene_file, tmp_path, monkeypatch):
    seen = []

    def drawn(path, surfaces, *_, **__):
        seen.append([surface.color for surface in surfaces])
        path.touch()
        return path

    monkeypatch.setattr("modalshell.run.results.write_film", drawn)
    output = f'[output]\nfolder = "{tmp_path}"\nformats = ["mp4"]\n'
    pull = "gravity = [0, 0, -9.81]", "gravity = [0, -9.81, 0]"
    for more in ("", "camera = [-0.7, 1.6, 0.95]\n"):  # from below, and from above
        ms.run_scene(scene_file(("duration = 1", "duration = 0.1"), pull, more=output + more), restart=True)
    assert [len(colors) for colors in seen] == [1, 6]


def test_a_film_has_a_text_in_the_corner_of_every_frame(tmp_path):
    vertices, faces = flat()
    frames = np.stack([vertices, vertices + np.array([0.0, 0.0, 0.01]), vertices])
    read = []
    for texts in ((), ["MWTS, 0.00 s", "MWTS, 0.03 s", "MWTS, 0.07 s"]):
        path = tmp_path / f"{len(texts)}.mp4"
        write_film(path, [ShadedSurface(vertices, faces)], [frames], size=(320, 240), texts=texts)
        reader = imageio_ffmpeg.read_frames(str(path))
        next(reader)
        read.append([np.frombuffer(frame, np.uint8).reshape(240, 320, 3).astype(int) for frame in reader])
    for plain, written in zip(*read, strict=True):
        differing = np.argwhere(np.abs(plain - written).max(axis=2) > 100)
        assert len(differing) > 20
        assert differing[:, 0].min() > 200
        assert differing[:, 1].max() < 160
    with pytest.raises(ms.OptionError, match=r"one text a frame, 3 \(got 1\)"):
        write_film(tmp_path / "x.mp4", [ShadedSurface(vertices, faces)], [frames], texts=["one"])


def test_films_of_runs_stand_on_a_stage_unless_plain(tmp_path, monkeypatch):
    vertices, faces = flat()
    frames = np.stack([vertices, vertices + np.array([0.0, 0.0, 0.1])])
    run = Trajectory(
        times=np.array([0.0, 0.5]), positions=frames, outcome=ms.Outcome.COMPLETED, message="", unconverged_steps=0,
        seconds=0.0, energies=np.zeros((2, 3)), constraint_residuals=np.empty((2, 0)), faces=faces,
        rest_positions=vertices,
    )  # fmt: skip
    seen = []
    monkeypatch.setattr(
        "modalshell.run.results.write_film", lambda _, surfaces, __, **options: seen.append((surfaces, options))
    )
    looks = [Look(model="MWTS"), Look(style="plain"), Look(camera=(1.0, 0.0, -0.5)), Look(color="displacement")]
    for look in looks:
        write_result(run, tmp_path / "f.mp4", look)
    assert [len(surfaces) for surfaces, _ in seen] == [6, 1, 1, 6]
    assert seen[0][1]["texts"] == ["MWTS, 0.00 s", "MWTS, 0.50 s"]
    assert "texts" not in seen[1][1]
    assert [scalars is None for scalars in seen[3][1]["scalars"]] == [False, True, True, True, True, True]
    assert all(options["framed"] == 1 for _, options in seen)


def test_films_and_pictures_of_other_units_of_time(tmp_path, monkeypatch):
    """Films play at real speed, whatever the unit of the times is, and titles name it."""
    vertices, faces = flat()
    run = Trajectory(
        times=np.array([0.0, 500.0]), positions=np.stack([vertices, vertices]), outcome=ms.Outcome.COMPLETED,
        message="", unconverged_steps=0, seconds=0.0, faces=faces, rest_positions=vertices,
        units=ms.UnitSystem(time="ms"),
    )  # fmt: skip
    rates, titles = [], []
    monkeypatch.setattr("modalshell.run.results.write_film", lambda *_, fps, **__: rates.append(fps))
    monkeypatch.setattr("modalshell.run.results.draw_views", lambda views, *_, **__: titles.append(views[0].title))
    write_result(run, tmp_path / "f.mp4", Look())
    write_result(run, tmp_path / "f.png", Look(still=500.0))
    assert rates == pytest.approx([2.0])
    assert titles == ["f, 500 ms"]


def test_the_corner_has_the_last_error_bar_found():
    vertices, faces = flat()
    frames = np.stack([vertices] * 4)
    bars = Bars(
        times=np.array([0.2, 0.4]), displacement=np.array([0.012, 0.5]), margin=np.array([0.9, 0.1]),
        valid=np.array([True, False]),
    )  # fmt: skip
    run = Trajectory(
        times=np.array([0.0, 0.2, 0.3, 0.4]), positions=frames, outcome=ms.Outcome.COMPLETED, message="",
        unconverged_steps=0, seconds=0.0, energies=np.zeros((4, 3)), constraint_residuals=np.empty((4, 0)), faces=faces,
        rest_positions=vertices, bars=bars,
    )  # fmt: skip
    expected = ["MWTS, 0.00 s", "MWTS, 0.20 s, 1.2 % from DS", "MWTS, 0.30 s, 1.2 % from DS", "MWTS, 0.40 s, bar void"]
    assert _texts(run, "MWTS", run.times) == expected


@pytest.mark.slow
def test_a_following_camera_sees_a_falling_shell_at_its_size(tmp_path):
    vertices, faces = flat()
    fallen = np.linspace(0.0, 1.0, 3)[:, None, None] * np.array([3.0, 0.0, -20.0])
    bent = np.linspace(0.0, 0.2, 3)[:, None, None] * vertices[:, [0]] * np.array([0.0, 0.0, 1.0])
    run = Trajectory(
        times=np.arange(3.0), positions=vertices + fallen + bent, outcome=ms.Outcome.COMPLETED, message="",
        unconverged_steps=0, seconds=0.0, energies=np.zeros((3, 3)), constraint_residuals=np.empty((3, 0)), faces=faces,
        rest_positions=vertices,
    )  # fmt: skip
    painted = {}
    for follow in (False, True):
        path = write_result(run, tmp_path / f"{follow}.mp4", Look(style="plain", follow=follow))
        reader = imageio_ffmpeg.read_frames(str(path))
        width, height = next(reader)["size"]
        frames = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
        painted[follow] = [np.argwhere(frame.min(axis=2) < 200) for frame in frames]
    assert max(len(places) for places in painted[False]) < 0.05 * min(len(places) for places in painted[True])
    middles = [places.mean(axis=0) for places in painted[True]]
    assert np.ptp(middles, axis=0).max() < 60  # pixels: it stays where it is, and bends
    assert len({len(places) for places in painted[True]}) == 3


def test_the_ground_moves_away_below_a_following_camera(tmp_path, monkeypatch):
    vertices, faces = flat()
    frames = np.stack([vertices + np.array([0.0, 0.0, 2.0]), vertices])
    run = Trajectory(
        times=np.arange(2.0), positions=frames, outcome=ms.Outcome.COMPLETED, message="", unconverged_steps=0,
        seconds=0.0, energies=np.zeros((2, 3)), constraint_residuals=np.empty((2, 0)), faces=faces,
        rest_positions=vertices,
    )  # fmt: skip
    seen = []
    monkeypatch.setattr("modalshell.run.results.write_film", lambda _, __, motions, **___: seen.append(motions))
    for follow in (False, True):
        write_result(run, tmp_path / "f.mp4", Look(follow=follow))
    still, moved = seen
    np.testing.assert_allclose(moved[0][1], moved[0][0], atol=1e-12)
    assert still[-1] is None
    np.testing.assert_allclose((moved[-1][1] - moved[-1][0])[:, 2], 2.0)
    assert "follow" not in Look().plain()
    assert Look(follow=True).plain()["follow"]


def test_a_scene_says_that_the_camera_follows(scene_file, tmp_path, monkeypatch):
    seen = []

    def drawn(path, _, motions, **__):
        seen.append(np.asarray(motions[0]).mean(axis=1))
        path.touch()
        return path

    monkeypatch.setattr("modalshell.run.results.write_film", drawn)
    output = f'[output]\nfolder = "{tmp_path}"\nformats = ["mp4"]\ncamera = '
    for camera in ("follow", "still"):
        ms.run_scene(scene_file(("duration = 1", "duration = 0.1"), more=f'{output}"{camera}"\n'), restart=True)
    assert [bool(np.ptp(middle, axis=0).max() < 1e-12) for middle in seen] == [True, False]
    with pytest.raises(ms.SceneError, match="camera"):
        ms.load_scene(scene_file(more=f'{output}"behind"\n'))


def test_a_film_of_an_equilibrium_is_said_to_be_one_picture(scene_file, tmp_path, monkeypatch):
    monkeypatch.setattr("modalshell.run.results.write_film", lambda path, *_, **__: path.touch() or path)
    output = f'[output]\nfolder = "{tmp_path}"\nformats = ["mp4"]\n'
    with pytest.warns(ms.ModalShellWarning, match=r"output\.formats: the film \(mp4\) of an equilibrium is one"):
        ms.run_scene(scene_file(("[motion]\nduration = 1\n", ""), more=output))


def test_a_scene_says_from_where_it_is_seen(scene_file, tmp_path, monkeypatch):
    seen = []

    def drawn(path, *_, camera, **__):
        seen.append(camera)
        path.touch()
        return path

    monkeypatch.setattr("modalshell.run.results.write_film", drawn)
    output = f'[output]\nfolder = "{tmp_path}"\nformats = ["mp4"]\ncamera = '
    for camera in ("[0, 0, 2]", '"still"'):
        ms.run_scene(scene_file(("duration = 1", "duration = 0.1"), more=f"{output}{camera}\n"), restart=True)
    assert seen == [(0.0, 0.0, 2.0), Look().camera]
    with pytest.raises(ms.SceneError, match=r"output\.camera: must be three finite numbers, not all zero"):
        ms.run_scene(scene_file(more=f"{output}[0, 0, 0]\n"))
    with pytest.raises(ms.SceneError, match=r"output\.camera: must be a list of length 3 \(got \[1\]\)"):
        ms.load_scene(scene_file(more=f"{output}[1]\n"))


@pytest.mark.parametrize(
    ("dt", "frames", "second", "expected"),
    [
        (1 / 30, 61, 1.0, 1),  # two seconds
        (0.5, 2, 1.0, 1),
        (5e-4, 41, 1.0, 100),  # 20 ms would be two pictures of a film
        (0.02, 21, 1.0, 5),  # of 4, 5 and 10 pictures a second, 10
        (1 / 30, 4, 1.0, 2),
        (0.5, 41, 1e-3, 100),  # the same 20 ms, in ms
        (1e-9, 1001, 1.0, 2_000_000),
        (0.1, 1, 1.0, 1),
    ],
)
def test_brief_motions_are_slowed_until_they_can_be_seen(dt, frames, second, expected):
    times = dt * np.arange(frames)
    slowed = slowing(times, second)
    assert slowed == expected
    if slowed > 1:
        assert slowed * second * times[-1] <= 2.0 + 1e-9
        assert (frames - 1) / (slowed * second * times[-1]) >= 10.0 - 1e-9


def test_a_film_of_a_brief_motion_is_slowed_and_says_so(tmp_path, monkeypatch):
    """A film of 20 ms at real speed was two pictures, whose corners said 0.00 s and 0.02 s."""
    vertices, faces = flat()
    run = Trajectory(
        times=5e-4 * np.arange(41), positions=np.stack([vertices] * 41), outcome=ms.Outcome.COMPLETED, message="",
        unconverged_steps=0, seconds=0.0, faces=faces, rest_positions=vertices,
    )  # fmt: skip
    seen = []
    monkeypatch.setattr("modalshell.run.results.write_film", lambda *args, **options: seen.append((args, options)))
    write_result(run, tmp_path / "f.mp4", Look())
    write_result(run, tmp_path / "f.mp4", Look(rate=2000.0))
    (args, options), (_, asked) = seen
    assert len(args[2][0]) == 41
    assert options["fps"] == pytest.approx(20.0)
    assert options["texts"][1] == "0.0005 s, slowed 100 times"
    assert (len(asked["texts"]), asked["texts"][-1]) == (2, "0.02 s")


def test_the_summary_of_a_run_says_how_slow_its_film_is(tmp_path):
    file = tmp_path / "brief.toml"
    file.write_text(
        '[mesh]\nshape = "sheet"\ncells = [4, 4]\n[material]\nyoung = 1e6\npoisson = 0.3\nthickness = 0.01\n'
        'density = 1000.0\n[supports]\nclamped = "x <= 0"\n[loads]\ngravity = [0, 0, -1]\n[model]\nname = "lma"\n'
        'modes = 1\n[motion]\nduration = 0.02\ndt = 0.001\n[output]\nformats = ["mp4"]\nlook = "plain"\n'
    )
    assert "the film slowed 100 times" in ms.run_scene(file, out=tmp_path / "a").summary
    file.write_text(file.read_text().replace('["mp4"]', '["csv"]'))
    assert "slowed" not in ms.run_scene(file, out=tmp_path / "b").summary
