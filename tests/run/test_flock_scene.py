"""Scenes of flocks: what they refuse, what a run writes, that a stopped run goes on, that no switch shows too much."""

import json
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.render import look_at

FILE = Path(__file__).resolve().parents[2] / "studies" / "scenes" / "flock.toml"


def small(**changes):
    """The flock of the repository with few birds, near and far, for a short time."""
    scene = ms.load_scene(FILE)
    camera = msgspec.structs.replace(scene.flock.camera, size=(320, 180), position=(0.0, -2.0, 0.5), still=None)
    detail = msgspec.structs.replace(scene.flock.detail, pixels=1.0, strains_within=1.5)
    flock = msgspec.structs.replace(
        scene.flock, count=30, radius=4.0, warm_up=0.2, camera=camera, detail=detail, **changes
    )
    motion = msgspec.structs.replace(scene.motion, duration=0.4)
    output = msgspec.structs.replace(scene.output, formats=[])
    mesh = msgspec.structs.replace(scene.mesh, cells=(6, 6))
    return replace(scene, flock=flock, motion=motion, output=output, mesh=mesh)


def test_levels_show_no_more_than_is_allowed(tmp_path):
    result = ms.run_scene(small(), out=tmp_path)
    found = result.report
    assert 0.0 < found.largest_pixels <= found.allowed_pixels == 1.0
    assert all(part > 0.0 for part in found.shares.values())
    assert sum(found.shares[level] for level in ("rigid", "LMA", "MWTS")) == pytest.approx(1.0)
    assert found.switches > 0
    assert 0.0 < found.largest_error < 0.1
    assert found.strains_jump_pixels > 0.0
    assert [path.name for path in result.files] == ["flock.npz", "flock.json"]
    assert not (tmp_path / "flock.frames").exists()
    with np.load(tmp_path / "flock.npz") as stored:
        assert stored["positions"].shape == (13, 30, 3)
        assert stored["coordinates"].shape == (13, 30, 8)
        np.testing.assert_allclose(stored["time"], np.arange(13) / 30, atol=1e-12)
    with pytest.raises(ms.FileFormatError, match="it is a flight that modalshell saved, not a saved trajectory"):
        ms.load_trajectory(tmp_path / "flock.npz")
    record = json.loads((tmp_path / "flock.json").read_text())
    assert record["report"]["largest_pixels"] == found.largest_pixels
    again = ms.run_scene(small(), out=tmp_path)
    assert (again.resumed, again.report) == (13, found)


def test_a_stopped_flight_goes_on_to_the_same_frames(tmp_path):
    def stop(step, total):
        assert total == 36  # 12 of them to warm up
        if step == 23:
            raise KeyboardInterrupt

    ms.run_scene(small(), out=tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        ms.run_scene(small(), out=tmp_path / "stopped", on_step=stop)
    assert not (tmp_path / "stopped" / "flock.npz").exists()
    with pytest.raises(ms.OptionError, match="frames of another run"):
        ms.run_scene(small(seed=9), out=tmp_path / "stopped")
    result = ms.run_scene(small(), out=tmp_path / "stopped")
    assert result.resumed == 6
    with np.load(tmp_path / "whole" / "flock.npz") as one, np.load(tmp_path / "stopped" / "flock.npz") as other:
        assert set(one) == set(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_a_flight_goes_on_from_its_warm_up(tmp_path):
    """The noise of its speeds began anew at time 0, and the first step of a film threw the birds about."""
    scene = small(speed_variation=0.5)
    flock = msgspec.structs.replace(scene.flock, warm_up=1.0)
    motion = msgspec.structs.replace(scene.motion, duration=0.1, store_every=1)
    result = ms.run_scene(replace(scene, flock=flock, motion=motion), out=tmp_path)
    with np.load(result.files[0]) as stored:
        pushed = np.linalg.norm(stored["accelerations"], axis=2).max(axis=1)
    assert pushed[1] < 1.2 * pushed[[0, 2]].max()


@pytest.mark.slow
def test_threads_fly_the_same(tmp_path):
    one, two = (ms.run_scene(small(threads=count), out=tmp_path / str(count)) for count in (1, 2))
    with np.load(one.files[0]) as first, np.load(two.files[0]) as second:
        for name in first:
            np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_film_and_picture(tmp_path, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    scene = small(flap=ms.load_scene(FILE).flock.flap)
    motion = msgspec.structs.replace(scene.motion, duration=0.1)
    output = msgspec.structs.replace(scene.output, formats=["mp4", "png"])
    result = ms.run_scene(replace(scene, motion=motion, output=output), out=tmp_path)
    assert [path.suffix for path in result.files] == [".npz", ".mp4", ".png", ".json"]
    assert (tmp_path / "flock.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "flock.mp4").read_bytes()[4:8] == b"ftyp"
    from matplotlib.image import imread

    picture = imread(tmp_path / "flock.png")
    assert picture.shape[:2] == (180, 320)
    sky, ground = picture[2, :, :3].mean(axis=0), picture[-3, :, :3].mean(axis=0)
    assert sky[2] - sky[1] > ground[2] - ground[1] + 0.05  # bluer
    assert ground[1] > ground[2] + 0.05
    plain = msgspec.structs.replace(scene.flock, camera=msgspec.structs.replace(scene.flock.camera, ground=None))
    output = msgspec.structs.replace(scene.output, formats=["png"])
    ms.run_scene(replace(scene, motion=motion, output=output, flock=plain), out=tmp_path / "plain")
    white = imread(tmp_path / "plain" / "flock.png")
    assert 0.005 < (white[..., :3].mean(axis=2) < 0.95).mean() < 0.5  # birds alone


@pytest.mark.slow
def test_the_camera_keeps_the_flock_in_view(tmp_path):
    scene = ms.load_scene(FILE)
    output = msgspec.structs.replace(scene.output, formats=[])
    motion = msgspec.structs.replace(scene.motion, duration=5.0)
    result = ms.run_scene(replace(scene, motion=motion, output=output), out=tmp_path)
    table = scene.flock.camera
    camera = look_at(table.position, table.target, np.deg2rad(table.view_angle), table.size[0] / table.size[1])
    with np.load(result.files[0]) as found:
        for birds in found["positions"]:
            seen = camera.project(birds - (birds.mean(axis=0) - table.target))
            assert np.abs(seen[:, :2]).max() < 1.0
    assert table.follow


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "mwts"', 'name = "lma"', "model: a flock is stepped by mwts"),
        ("count = 350", "count = 0", "flock.count: must be"),
        ("amplitude = ", "amplitud = ", "flock.flap.amplitud: unknown key; did you mean 'amplitude'"),
        ("pixels = 0.5", "pixels = -1.0", "flock.detail.pixels: must be"),
        ("[-3.5, -2.5, -1.0], [3.5", "[-3.5, -2.5, -1.0], [-4.5", "flock.bounds: must be a lower"),
        ('formats = ["mp4", "png"]', 'formats = ["pvd"]', "output.formats"),
        ('clamped = "z <= 0"', 'clamped = "z <= 0"\ntimes = [0.0, 1.0]', "supports.times"),
        ('[supports]\nclamped = "z <= 0"', "", "supports: a boid carries its bird by the supports, which do not hold"),
        ("size = [960, 540]", "size = [961, 540]", "flock.camera: the size of a film must be even"),
        ("target = [0.0, 0.0, -0.45]", "target = [0.0, -8.8, 0.6]", "flock.camera: a camera needs a target"),
        ("rate_factor = 29", 'color = "blau"', "flock.camera.color: must be a matplotlib colour"),
        ("store_every = 2", "store_every = 2\ntolerance = 1e-3", "motion.tolerance: a flock takes whole steps"),
        ('positions = "float32"', 'camera = "follow"', "output.camera: a flock takes flock.camera in their place"),
        ("times = [0.0, 2.5", "times = [3.0, 2.5", "times must increase"),
    ],
)
def test_refuses(tmp_path, old, new, message):
    text = FILE.read_text()
    assert old in text
    (tmp_path / "flock.toml").write_text(text.replace(old, new))
    with pytest.raises(ms.SceneError, match=message):
        ms.run_scene(tmp_path / "flock.toml", out=tmp_path)
    assert not (tmp_path / "flock.frames").exists()


def test_a_flock_is_no_single_shell():
    with pytest.raises(ms.SceneError, match="about one shell"):
        ms.load_scene(FILE).require_shell()


def test_the_command_reports(tmp_path, capsys):
    text = FILE.read_text().replace("count = 350", "count = 20").replace("duration = 10.0", "duration = 0.1")
    text = text.replace("warm_up = 10.0", "warm_up = 0.0").replace('formats = ["mp4", "png"]', "formats = []")
    (tmp_path / "birds.toml").write_text(text)
    with pytest.raises(SystemExit) as stop:
        main(["run", str(tmp_path / "birds.toml"), "--out", str(tmp_path)])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith("birds: completed, 4 frames of 20 birds")
    assert "pixels" in out.splitlines()[0]


@pytest.mark.slow
def test_a_flock_in_other_units_flies_the_same(tmp_path):
    """The earth's gravity, which the scene leaves out, the labels, the film's speed and the page are in its units."""
    import imageio_ffmpeg

    flown, films = {}, {}
    for name, (length, mass, second) in {"m": (1.0, 1.0, 1.0), "mm": (1e3, 1e-3, 1e3)}.items():
        units = "" if name == "m" else '[units]\nlength = "mm"\nmass = "t"\ntime = "ms"\n'
        force = mass * length / second**2
        (tmp_path / f"{name}.toml").write_text(f"""{units}
[mesh]
shape = "paper_bird"
length = {0.2 * length}
wing = {0.18 * length}
body = {0.04 * length}
cells = [4, 4]
[material]
stretch = {500.0 * force / length}
shear = {500.0 * force}
flexure = {2e-3 * force * length}
density = {0.08 * mass / length**2}
[supports]
clamped = "z <= 0"
[model]
name = "mwts"
modes = 4
[motion]
duration = {0.3 * second}
dt = {second / 60.0}
store_every = 3
damping = [{2.0 / second}, {1e-3 * second}]
[flock]
count = 3
radius = {length}
speed = {length / second}
noise_frequency = {0.5 / second}
rotation_speed = {1.0 / second}
neighbour_distance = {length}
flap = {{amplitude = {0.05 * length}, frequency = {2.0 / second}}}
camera = {{position = [0.0, {-5.0 * length}, {0.6 * length}], size = [64, 64]}}
target = {{times = [0.0, {second}], points = [[0.0, 0.0, 0.0], [{length}, 0.0, 0.0]]}}
[output]
formats = ["mp4"]
""")
        scene = ms.load_scene(tmp_path / f"{name}.toml")
        ms.run_scene(scene, out=tmp_path)
        with np.load(tmp_path / f"{name}.npz") as stored:
            flown[name] = stored["coordinates"] / (length * np.sqrt(mass)), json.loads(str(stored["units"]))
            assert stored["unit_system"][0] == name
        flight = scene.build_flight(scene.build_shell())
        assert np.linalg.norm(flight.gravity) == pytest.approx(9.81 * length / second**2)
        films[name] = next(imageio_ffmpeg.read_frames(str(tmp_path / f"{name}.mp4")))["fps"]
        text = scene.own_page().text
        data = {key: float(re.search(rf'"{key}": ?([-+.\de]+)', text)[1]) for key in ("dt", "sample", "second")}
        assert data["second"] == pytest.approx(second)
        assert [data["dt"], data["sample"]] == pytest.approx([second / 60.0, second / 30.0])
    assert np.abs(flown["m"][0]).max() > 1e-4
    np.testing.assert_allclose(flown["mm"][0], flown["m"][0], atol=1e-9 * np.abs(flown["m"][0]).max())
    assert flown["m"][1]["coordinates"] == "m sqrt(kg)"
    assert [flown["mm"][1][key] for key in ("time", "positions", "coordinates")] == ["ms", "mm", "mm sqrt(t)"]
    assert flown["mm"][1]["accelerations"] == "mm/ms^2"
    assert films["mm"] == pytest.approx(films["m"]) == 20.0
