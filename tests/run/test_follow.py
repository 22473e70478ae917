"""Following runs from another process: whole frames only, the newest one, and neither side minds the other's death."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.outcome import Outcome
from modalshell.files.atomic_io import read_record, write_record
from modalshell.run import RunFollower
from modalshell.run.frame_file import MAGIC, FrameFile

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux tells who holds a file")

RUN = """
import os, sys, time
import modalshell as ms
scene, out, gate, pause = sys.argv[1:]
def on_step(done, total):
    time.sleep(float(pause))
    while done == 200 and not os.path.exists(gate):
        time.sleep(0.01)
ms.run_scene(scene, out=out, on_step=on_step)
"""
FOLLOWERS = """
import os, sys, time
from modalshell.commands.cli import main
from modalshell.core.outcome import Outcome
from modalshell.run import RunFollower
from modalshell.run.frame_file import MAGIC, FrameFile
frames, count = sys.argv[1], int(sys.argv[2])
for _ in range(count):
    child = os.fork()
    run = RunFollower(frames) if child == 0 else None
    while child == 0:
        run.poll()
        time.sleep(1e-3)
    print(child, flush=True)
try:
    main(["view", "--attach", frames, "--follow"])
finally:
    print([os.waitpid(-1, os.WNOHANG)[1] for _ in range(count)])
"""
ENVIRONMENT = os.environ | {"OPENBLAS_NUM_THREADS": "1"}


class Stopped(Exception):
    pass


def python(*arguments):
    command = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)


def finish(process):
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    return out


def stop_at(steps):
    def on_step(done, _total):
        if done == steps:
            raise Stopped

    return on_step


def stopped_run(scene, out, steps, **options):
    with pytest.raises(Stopped):
        ms.run_scene(scene, out=out, on_step=stop_at(steps), **options)


def wait_for(condition, seconds=60.0, pause=1e-3):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(pause)


def assert_shows(follower, expected):
    np.testing.assert_array_equal(follower.positions, expected.positions[follower.index])
    assert follower.time == expected.times[follower.index]


@pytest.fixture(scope="session")
def write(scene_text):
    """Writes a scene of so many frames, 0.01 s apart, after the one at rest."""

    def write(folder, cells=12, frames=40, name="beam"):
        path = folder / f"{name}.toml"
        motion = f"duration = {0.01 * frames}\ndt = 0.01\ndamping = [0.1, 0.0]"
        path.write_text(scene_text(("12", str(cells)), ("duration = 1", motion)), encoding="utf-8")
        return path

    return write


@pytest.fixture
def follower(request):
    """Makes followers that are closed at the end."""

    def make(run):
        made = RunFollower(run)
        request.addfinalizer(made.close)
        return made

    return make


@pytest.fixture(scope="module")
def finished(write, tmp_path_factory):
    """A scene of 41 frames, and its trajectory."""
    folder = tmp_path_factory.mktemp("finished")
    scene = write(folder)
    return scene, ms.run_scene(scene, out=folder / "out").trajectory


@pytest.mark.slow
def test_a_slow_follower_skips_and_a_fast_one_waits(finished, follower, tmp_path):
    scene, expected = finished
    out = tmp_path / "not" / "there yet"
    slow, fast = follower(out), follower(out)
    assert not fast.poll()
    assert (fast.state, fast.index) == ("waiting", -1)
    seen, shown = [], []

    def on_step(done, _total):
        assert fast.poll()
        assert not fast.poll()
        shown.append(fast.index)
        assert_shows(fast, expected)
        if done % 7 == 0:
            assert slow.poll()
            seen.append(slow.index)
            assert slow.state == "running"
            assert_shows(slow, expected)

    ms.run_scene(scene, out=out, on_step=on_step)
    assert shown == list(range(1, 41))
    assert seen == [7, 14, 21, 28, 35]
    for one in (slow, fast):
        assert one.poll()
        assert (one.state, one.outcome, one.index, one.restarts) == ("finished", "completed", 40, 0)
        assert_shows(one, expected)
        assert not one.poll()
    np.testing.assert_array_equal(slow.faces, expected.faces)
    np.testing.assert_array_equal(slow.rest_positions, expected.rest_positions)
    assert slow.held.sum() == (expected.rest_positions[:, 0] < 0.1).sum()
    assert slow.gravity.tolist() == [0.0, 0.0, -9.81]


@pytest.mark.slow
def test_killed_followers_do_not_disturb_the_run(write, tmp_path):
    scene = write(tmp_path, frames=300)
    frames, gate = tmp_path / "out" / "beam.frames", tmp_path / "gate"
    followers = python("-c", FOLLOWERS, frames, 8)  # before there is a folder
    process = python("-c", RUN, scene, tmp_path / "out", gate, 0.003)
    expected = ms.run_scene(scene, out=tmp_path / "whole").trajectory
    victims = [int(followers.stdout.readline()) for _ in range(8)]
    wait_for(frames.exists)
    chance = np.random.default_rng(3)
    for victim in victims:
        time.sleep(chance.uniform(0.0, 0.1))
        os.kill(victim, signal.SIGKILL)
    lines = [followers.stdout.readline().strip()]  # of the one that lives
    assert process.poll() is None
    gate.touch()
    finish(process)
    found = ms.load_trajectory(tmp_path / "out" / "beam.npz", verify=True)
    np.testing.assert_array_equal(found.positions, expected.positions)
    np.testing.assert_array_equal(found.energies, expected.energies)
    *rest, deaths = finish(followers).splitlines()
    assert deaths == str([int(signal.SIGKILL)] * 8)  # none had died of itself before
    lines += rest
    assert lines[-1] == "beam; frame 300; t = 3 s; finished: completed"
    assert all(line.endswith("; running") for line in lines[:-1])
    shown = [int(line.split()[2].rstrip(";")) for line in lines]
    assert shown == sorted(shown)
    assert len(shown) > 2


@pytest.mark.slow
def test_a_killed_run_is_stopped_and_followed_when_it_goes_on(write, follower, tmp_path):
    scene = write(tmp_path, cells=40, frames=900)
    expected = ms.run_scene(scene, out=tmp_path / "whole").trajectory
    one, shown = follower(tmp_path / "out"), []

    def reached(index):
        if one.poll() and one.index >= 0:
            assert_shows(one, expected)
            shown.append(one.index)
        return one.index >= index

    process = python("-c", RUN, scene, tmp_path / "out", tmp_path / "never", 0.0)  # as fast as it can, as this reads
    wait_for(lambda: reached(0))  # not by spinning while a process starts
    wait_for(lambda: reached(100), pause=0.0)
    assert one.state == "running"
    process.kill()
    process.communicate()
    one.poll()
    assert (one.state, one.outcome) == ("stopped", Outcome.STOPPED)
    assert_shows(one, expected)
    last = one.index
    assert 100 <= last <= 800
    result = ms.run_scene(scene, out=tmp_path / "out", on_step=lambda done, _: reached(done))
    assert result.resumed == last + 1
    one.poll()
    assert (one.state, one.index, one.restarts) == ("finished", 900, 0)
    assert shown == sorted(shown)
    assert shown[-100:] == list(range(801, 901))


@pytest.fixture(scope="module")
def frames(finished, tmp_path_factory):
    """What a run leaves that was stopped after 20 steps."""
    out = tmp_path_factory.mktemp("frames")
    stopped_run(finished[0], out, 20)
    return (out / "beam.frames").read_bytes()


def record_size(frames, finished, folder):
    stopped_run(finished[0], folder, 21)
    return (folder / "beam.frames").stat().st_size - len(frames)


def test_cut_and_damaged_frames_are_never_shown(finished, frames, follower, tmp_path):
    _, expected = finished
    size = record_size(frames, finished, tmp_path / "more")
    header = len(frames) - 21 * size
    chance = np.random.default_rng(1)
    cuts = [0, 1, header // 2, header, header + size - 1, header + size, len(frames) - 1, len(frames)]
    path = tmp_path / "beam.frames"
    for cut in [*cuts, *chance.integers(0, len(frames), 20).tolist()]:
        path.write_bytes(frames[:cut])
        one = follower(path)
        one.poll()
        whole = max(0, (cut - header) // size)
        assert (one.index, one.state) == (whole - 1, "stopped" if whole else "waiting")
        if whole:
            assert_shows(one, expected)
    for place in chance.integers(1, 2 * size, 20).tolist():  # in one of the last two records
        damaged = bytearray(frames)
        damaged[-place] ^= 1 << int(chance.integers(8))
        path.write_bytes(damaged)
        one = follower(path)
        one.poll()
        assert one.index == (19 if place <= size else 20)
        assert_shows(one, expected)
    for place in [3, 40, header // 2]:
        damaged = bytearray(frames)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        one = follower(path)
        assert not one.poll()
        assert one.index == -1
    path.write_bytes(frames + b"\0" * 3 * size)  # a file system's hole after a power cut
    one = follower(path)
    one.poll()
    assert one.index == 20


def test_a_record_is_shown_when_its_last_byte_is_there(finished, frames, follower, tmp_path):
    _, expected = finished
    size = record_size(frames, finished, tmp_path / "more")
    path = tmp_path / "beam.frames"
    path.write_bytes(frames[:-size])
    one = follower(path)
    assert one.poll()
    with open(path, "ab", buffering=0) as file:
        for part in np.array_split(np.frombuffer(frames[-size:], np.uint8), 5):
            assert not one.poll()
            assert one.index == 19
            file.write(part.tobytes())
    assert one.poll()
    assert one.index == 20
    assert_shows(one, expected)


@pytest.mark.by_default("another file")
@pytest.mark.parametrize("replaced", [False, True], ids=["cut", "another file"])
def test_runs_begun_anew_are_followed(finished, write, follower, tmp_path, replaced):
    scene, expected = finished
    out = tmp_path / "out"
    stopped_run(scene, out, 20)
    one = follower(out)
    assert one.poll()
    rest = one.rest_positions
    if replaced:
        (out / "beam.frames").rename(tmp_path / "kept")
    stopped_run(scene, out, 5, restart=True)
    assert one.poll()
    assert (one.index, one.restarts, one.state) == (5, 1, "stopped")
    assert "restarted" in one.status()
    assert one.rest_positions is rest  # a viewer has nothing to build anew
    assert_shows(one, expected)
    other = write(tmp_path, cells=11)
    stopped_run(other, out, 5, restart=True)
    assert one.poll()
    assert (one.index, one.restarts) == (5, 2)
    assert one.positions.shape == one.rest_positions.shape == (len(ms.load_scene(other).build_shell().mass), 3)
    assert one.faces.max() == len(one.positions) - 1


def test_results_of_earlier_times_are_shown(finished, follower, tmp_path):
    scene, expected = finished
    one = follower(scene.parent / "out")
    one.wait(0.0)
    assert (one.state, one.outcome, one.index) == ("finished", "completed", 40)
    assert_shows(one, expected)
    (scene.parent / "out" / "beam.frames").touch()  # as the run has it that finds its results whole
    one.poll()
    assert one.state == "waiting"
    assert ms.run_scene(scene, out=scene.parent / "out").resumed == 41
    one.poll()
    assert (one.state, one.restarts) == ("finished", 0)
    still = tmp_path / "still.toml"
    still.write_text(scene.read_text().partition("[motion]")[0])
    one = follower(tmp_path / "out" / "still.frames")
    answer = ms.run_scene(still, out=tmp_path / "out").trajectory
    assert one.poll()
    assert (one.state, one.outcome, one.index) == ("finished", "converged", 0)
    assert_shows(one, answer)


def test_the_time_of_a_frame_is_in_the_units_of_the_run(write, follower, tmp_path):
    scene, told = write(tmp_path, frames=2), []
    scene.write_text(scene.read_text() + '[units]\nlength = "m"\nmass = "kg"\ntime = "ms"\n')
    live = follower(tmp_path / "out" / "beam.frames")

    def on_step(*_):
        live.poll()
        told.append(live.status())

    ms.run_scene(scene, out=tmp_path / "out", on_step=on_step)
    assert "t = 0.02 ms; running" in told[-1]
    done = follower(tmp_path / "out")
    done.wait(0.0)
    assert "t = 0.02 ms; finished" in done.status()


def test_a_record_of_an_unknown_status_is_no_run(finished, tmp_path):
    shutil.copytree(finished[0].parent / "out", tmp_path / "out")
    path = tmp_path / "out" / "beam.json"
    write_record(path, read_record(path) | {"status": "never heard of"})
    with pytest.raises(ms.OptionError, match="holds no run"):
        RunFollower(tmp_path / "out")


def test_deleted_frames_leave_a_stopped_run(finished, follower, tmp_path):
    scene, expected = finished
    stopped_run(scene, tmp_path, 20)
    one = follower(tmp_path)
    one.poll()
    (tmp_path / "beam.frames").unlink()
    assert not one.poll()
    assert (one.state, one.outcome) == ("stopped", Outcome.STOPPED)
    assert_shows(one, expected)


def test_scene_files_name_their_own_folder(finished, follower, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one = follower(finished[0])
    assert (one.name, one.poll()) == ("beam", False)
    stopped_run(finished[0], None, 3)
    assert one.poll()
    assert (one.index, one.state) == (3, "stopped")


def test_what_is_no_run_is_refused(write, tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(ms.OptionError, match="holds no run"):
        RunFollower(tmp_path)
    with pytest.raises(ms.OptionError, match=r"must be its output folder.*notes\.txt"):
        RunFollower(tmp_path / "notes.txt")
    with pytest.raises(ms.SceneError):
        RunFollower(tmp_path / "missing.toml")
    for name in ("one", "two"):
        stopped_run(write(tmp_path, name=name), tmp_path / "out", 2)
    with pytest.raises(ms.OptionError, match=r"several runs.*one\.frames.*two\.frames"):
        RunFollower(tmp_path / "out")
    with pytest.raises(ms.OptionError, match=r"no frame within 0\.1 s"):
        RunFollower(tmp_path / "never").wait(0.1)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["beam.toml", "--attach", "out"], "leave out SCENE"),
        (["--attach", "out", "--frames", "3"], "leave out SCENE and --frames"),
        (["--attach", "out", "--web", "--follow"], "choose one"),
        (["--attach", "out", "--screenshot", "a.jpg"], "must end in .png"),
        (["--attach", "out", "--follow", "--wait", "-1"], "at least 0"),
        (["--attach", "out", "--follow", "--wait", "0.1"], "no frame within 0.1 s"),
        (["--follow"], "--attach RUN"),
        ([], "--attach RUN"),
    ],
)
def test_options_that_are_refused(tmp_path, monkeypatch, capsys, options, text):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(["view", *options])
    assert stopped.value.code == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert text in message


def test_a_header_is_not_evaluated(tmp_path):
    """Frames with sound checksums and the contents of another: refused, or waited for, and never run as code."""
    file = FrameFile(tmp_path / "forged.frames")
    with file:
        file.begin({"scene": "x"}, [("time", "<f8"), ("positions", "<f8", (3, 3))], constants={"faces": np.eye(3)})
        file.append({"time": 0.0, "positions": np.eye(3)})
        with pytest.raises(ms.FileFormatError, match="no frames of a shell's run"):
            RunFollower(file.path).poll()
    data = file.path.read_bytes()
    assert b"eval" not in data
    assert json.loads(json.loads(data[len(MAGIC) : data.index(b"\n", len(MAGIC))])["record"])[0] == ["time", "<f8"]
