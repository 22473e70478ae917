"""Runs of scenes: results whole or not at all, and after any number of kills the same to the last bit."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scenes import beam_text
from stopping import Stopped, stop_after

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.outcome import Outcome
from modalshell.motion import Motion
from modalshell.run.frame_file import FrameFile

_FOLDER = Path(__file__).resolve().parents[2] / "studies" / "scenes"
RUN = ("cloth_on_ball", "flat_beam", "folded_strip")
"""Scenes of the repository that run here; each of the others in full for its page, in test_modal_page.py."""

BEAM = (
    'name = "beam"\n'
    + beam_text("{cells}", "x < 0.17")
    + """{path}
[loads]
gravity = [0.0, 0.0, -4.0]
[model]
name = "{model}"
[motion]
duration = {duration}
dt = 0.01
damping = [0.1, 0.0]
{motion}
[output]
{output}
"""
)
MOVING = """times = [0.0, 0.1, 0.3]
translations = [[0, 0, 0], [0, 0.1, 0.1], [0, 0, 0]]
rotations = [[0, 0, 0], [0.5, 0, 0.2], [0, 0.1, 0]]"""
DRAGGED = """[[constraints]]
kind = "position"
nearest = [1, 0, 0]
relative = true
times = [0.0, 0.3]
targets = [[0, 0, 0], [-0.05, 0.1, 0.1]]
"""
ARRAYS = ("times", "positions", "energies", "constraint_residuals", "faces", "rest_positions")


def write(folder, *, model="mwts", duration=0.3, cells=8, path="", motion="", output="", more=""):
    file = folder / "beam.toml"
    text = BEAM.format(model=model, duration=duration, cells=cells, path=path, motion=motion, output=output)
    file.write_text(text + more)
    return file


def assert_same(found, expected):
    for name in ARRAYS:
        one, other = getattr(found, name), getattr(expected, name)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other, err_msg=name)
    assert (found.message, found.unconverged_steps) == (expected.message, expected.unconverged_steps)


def started(scene, folder, *options):
    """A process of its own that runs the scene."""
    command = [sys.executable, "-m", "modalshell", "run", str(scene), "--out", str(folder), *options]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MODALSHELL_RENDERER": "built-in"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def finish(process):
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0, out
    return out


def kill_at_frames(scene, folder, moments, total, delays):
    """Run on and kill -9, once for each number of frames in ``moments`` that the file passes; returns the kills."""
    frames, kills = folder / "beam.frames", 0
    for moment, delay in zip(moments, delays, strict=True):
        process = started(scene, folder)
        while process.poll() is None:
            if frames.exists() and frames.stat().st_size >= moment * total:
                time.sleep(delay)
                process.send_signal(signal.SIGKILL)
                process.wait()
                kills += process.returncode == -signal.SIGKILL
                break
            time.sleep(5e-4)
        process.stdout.close()
    return kills


def stopped_frames(scene, folder):
    """The whole file of frames that a run leaves which is stopped at its last step."""
    motion = ms.load_scene(scene).motion
    steps = round(motion.duration / motion.dt)
    with pytest.raises(Stopped):
        ms.run_scene(scene, out=folder, on_step=stop_after(steps))
    return (folder / "beam.frames").read_bytes()


@pytest.mark.slow
def test_killed_runs_end_as_uninterrupted_ones(tmp_path):
    """By the model whose steps take longest; kills of a run by modal warping follow."""
    frames, kills = 60, 2
    scene = write(tmp_path, model="ds", duration=frames * 0.01, cells=6, path=MOVING)
    size = len(stopped_frames(scene, tmp_path / "whole"))
    expected = ms.run_scene(scene, out=tmp_path / "whole").trajectory
    chance = np.random.default_rng(kills)
    moments = np.sort(chance.uniform(0.0, 0.95, kills))
    done = kill_at_frames(scene, tmp_path / "killed", moments, size, chance.uniform(0.0, 2e-3, kills))
    assert done == kills
    assert not (tmp_path / "killed" / "beam.npz").exists()
    assert ms.run_scene(scene, out=tmp_path / "killed").resumed > 0
    assert len(expected.times) == frames + 1
    assert_same(ms.load_trajectory(tmp_path / "killed" / "beam.npz"), expected)
    assert sorted(path.name for path in (tmp_path / "killed").iterdir()) == ["beam.json", "beam.npz"]


@pytest.mark.slow
def test_kills_at_random_times_from_start_to_results(tmp_path):
    scene = write(tmp_path, duration=10.0, cells=40)
    begin = time.perf_counter()
    finish(started(scene, tmp_path / "whole"))
    whole = time.perf_counter() - begin
    chance = np.random.default_rng(5)
    for delay in 1.1 * whole * (np.arange(3) + chance.uniform(size=3)) / 3:  # one in each third
        process = started(scene, tmp_path / "killed")
        time.sleep(delay)
        process.kill()
        process.communicate()
        if (tmp_path / "killed" / "beam.npz").exists():  # a whole one, or it would not be there
            assert len(ms.load_trajectory(tmp_path / "killed" / "beam.npz", verify=True).times) == 1001
    ms.run_scene(scene, out=tmp_path / "killed")
    results = [ms.load_trajectory(tmp_path / name / "beam.npz", verify=True) for name in ("killed", "whole")]
    assert_same(*results)


@pytest.mark.by_default("options7")
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"path": MOVING, "output": 'positions = "float32"'},
        {"more": DRAGGED},
        {"model": "ds", "more": DRAGGED, "cells": 6, "duration": 0.1},
        {"model": "ds", "path": MOVING, "cells": 6, "duration": 0.1},
        {"model": "lma", "motion": "store_every = 7"},
        {"model": "rsw", "path": MOVING},
        {"model": "rigid", "path": MOVING},
        {"model": 'md-rom"\ncubature = true\nmodes = 3#', "cells": 6, "path": MOVING},
    ],
)
def test_stopped_runs_go_on_to_the_same_end(tmp_path, options):
    scene = write(tmp_path, **options)
    expected = ms.run_scene(scene, out=tmp_path / "whole").trajectory
    for steps in (1, 4, 9):
        with pytest.raises(Stopped):
            ms.run_scene(scene, out=tmp_path / "stopped", on_step=stop_after(steps))
    result = ms.run_scene(scene, out=tmp_path / "stopped")
    assert result.resumed > 1
    assert_same(result.trajectory, expected)


def test_what_was_seen_before_a_stop_is_in_the_status(tmp_path):
    more = '[[loads.forces]]\nwhere = "x > 0.9"\ntotal = [0, 0, -40]\n'
    scene = write(tmp_path, more=more)
    expected = ms.run_scene(scene, out=tmp_path / "whole").trajectory
    assert expected.message.startswith("a part of the shell turned by more than 2 pi at ")
    with pytest.raises(Stopped):
        ms.run_scene(scene, out=tmp_path / "stopped", on_step=stop_after(29))
    assert ms.run_scene(scene, out=tmp_path / "stopped").trajectory.message == expected.message


@pytest.fixture(scope="module")
def torn(tmp_path_factory):
    """A scene, its whole result, and the frames that a run leaves that is stopped just before its end."""
    folder = tmp_path_factory.mktemp("torn")
    scene = write(folder, duration=0.2, path=MOVING)
    expected = ms.run_scene(scene, out=folder / "whole").trajectory
    return scene, expected, stopped_frames(scene, folder / "stopped")


def header_length(frames):
    """Magic and a line of JSON, then the shell's arrays, filled up to a multiple of 64 bytes."""
    line = re.match(rb"modalshell frames 1\n(.*?)\n", frames, re.DOTALL)
    arrays = json.loads(line[1])["constants"]["arrays"]
    size = sum(np.dtype(kind).itemsize * math.prod(shape) for _, kind, shape in arrays)
    return line.end() + -(-size // 64) * 64


@pytest.mark.slow
def test_frames_cut_off_anywhere_are_taken_up(torn, tmp_path):
    scene, expected, frames = torn
    header = header_length(frames)
    record = (len(frames) - header) // 21
    chance = np.random.default_rng(0)
    cuts = [
        0,
        1,
        header // 2,
        header - 1,
        header,
        header + 1,
        header + record - 1,
        header + record,
        header + 5 * record + 3,
    ]
    cuts += chance.integers(0, len(frames), 12).tolist()
    for cut in cuts:
        (tmp_path / "beam.frames").write_bytes(frames[:cut])
        (tmp_path / "beam.json").unlink(missing_ok=True)
        steps = []

        def stop(done, total, steps=steps):
            steps.append(done)
            if done == total:
                raise Stopped

        with pytest.raises(Stopped):  # what is written behind the cut can be taken up in its turn
            ms.run_scene(scene, out=tmp_path, on_step=stop)
        assert steps[0] == max(1, (cut - header) // record)
        again = ms.run_scene(scene, out=tmp_path)
        assert again.resumed == 21
        assert_same(again.trajectory, expected)


@pytest.mark.slow
def test_damaged_frames_are_computed_again(torn, tmp_path):
    scene, expected, frames = torn
    header = header_length(frames)
    record = (len(frames) - header) // 21
    damaged = bytearray(frames)
    damaged[header + 7 * record + 100] ^= 1
    (tmp_path / "beam.frames").write_bytes(damaged)
    result = ms.run_scene(scene, out=tmp_path)
    assert result.resumed == 7
    assert_same(result.trajectory, expected)
    (tmp_path / "beam.json").unlink()
    (tmp_path / "beam.frames").write_bytes(frames + b"\0" * 2 * record)  # a file system's hole after a power cut
    assert ms.run_scene(scene, out=tmp_path).resumed == 21


@pytest.mark.by_default("magic", "shell")
@pytest.mark.parametrize("place", ["identity", "magic", "shell"])
def test_a_damaged_header_is_refused(torn, tmp_path, place):
    scene, _, frames = torn
    damaged = bytearray(frames)
    damaged[{"identity": 40, "magic": 3, "shell": header_length(frames) - 200}[place]] ^= 1
    (tmp_path / "beam.frames").write_bytes(damaged)
    with pytest.raises(ms.OptionError, match="--restart"):
        ms.run_scene(scene, out=tmp_path)


def test_frames_of_another_scene_are_refused_and_kept(torn, tmp_path):
    _, _, frames = torn
    (tmp_path / "beam.frames").write_bytes(frames)
    scene = write(tmp_path, duration=0.1, path=MOVING)
    with pytest.raises(ms.OptionError, match=r"another run \(it differs in scene\).*--restart"):
        ms.run_scene(scene, out=tmp_path)
    assert (tmp_path / "beam.frames").read_bytes() == frames
    result = ms.run_scene(scene, out=tmp_path, restart=True)
    assert (result.resumed, len(result.trajectory.times)) == (0, 11)
    assert not (tmp_path / "beam.frames").exists()


def test_whole_results_leave_frames_of_others_alone(torn, tmp_path):
    _, _, frames = torn
    scene = write(tmp_path)
    ms.run_scene(scene, out=tmp_path)
    (tmp_path / "beam.frames").write_bytes(frames)
    assert ms.run_scene(scene, out=tmp_path).resumed == 31
    assert (tmp_path / "beam.frames").read_bytes() == frames


def test_equilibria_refuse_frames_of_others(torn, tmp_path):
    _, _, frames = torn
    (tmp_path / "beam.frames").write_bytes(frames)
    scene = write(tmp_path)
    scene.write_text(scene.read_text().partition("[motion]")[0])
    with pytest.raises(ms.OptionError, match="another run"):
        ms.run_scene(scene, out=tmp_path)
    assert (tmp_path / "beam.frames").read_bytes() == frames
    assert ms.run_scene(scene, out=tmp_path, restart=True).trajectory.status == "converged"
    assert not (tmp_path / "beam.frames").exists()


def test_frames_of_another_mesh_are_refused(torn, tmp_path):
    _, _, frames = torn
    (tmp_path / "beam.frames").write_bytes(frames)
    scene = write(tmp_path, duration=0.2, path=MOVING, cells=12)
    with pytest.raises(ms.OptionError, match="it differs in mesh"):
        ms.run_scene(scene, out=tmp_path)


@pytest.mark.parametrize(("model", "frames"), [("mwts", 12), ("ds", 3)])
def test_a_machine_that_rounds_otherwise_is_refused(tmp_path, monkeypatch, model, frames):
    scene = write(tmp_path, model=model, cells=6)
    with pytest.raises(Stopped):
        ms.run_scene(scene, out=tmp_path, on_step=stop_after(frames))
    exact = Motion.advance

    def advance(motion):
        exact(motion)
        motion.state.rates.flat[-1] *= 1.0 + 1e-15

    monkeypatch.setattr(Motion, "advance", advance)
    with pytest.raises(ms.OptionError, match="comes out otherwise"):
        ms.run_scene(scene, out=tmp_path)


def test_two_processes_may_not_share_an_output(torn, tmp_path):
    scene, *_ = torn
    with FrameFile(tmp_path / "beam.frames"), pytest.raises(ms.OptionError, match="in use by another process"):
        ms.run_scene(scene, out=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_whole_results_are_not_computed_again(tmp_path):
    scene = write(tmp_path)
    first = ms.run_scene(scene, out=tmp_path / "out")
    before = first.files[0].stat().st_mtime_ns

    def refuse(done, total):
        raise AssertionError(f"step {done} of {total}")

    again = ms.run_scene(scene, out=tmp_path / "out", on_step=refuse)
    assert again.resumed == len(first.trajectory.times)
    assert first.files[0].stat().st_mtime_ns == before
    more = ms.run_scene(write(tmp_path, output='formats = ["pvd"]'), out=tmp_path / "out", on_step=refuse)
    assert more.files[1].name == "beam.pvd"
    assert first.files[0].stat().st_mtime_ns == before
    # Damaged results, other scenes and --restart are computed.
    first.files[0].write_bytes(first.files[0].read_bytes()[:-100])
    with pytest.raises(AssertionError, match="step 1"):
        ms.run_scene(scene, out=tmp_path / "out", on_step=refuse)
    with pytest.raises(AssertionError, match="step 1"):
        ms.run_scene(scene, out=tmp_path / "out", on_step=refuse, restart=True)


def test_a_damaged_format_is_written_again(tmp_path):
    scene = write(tmp_path, duration=0.05, output='formats = ["pvd", "vtkhdf"]')
    first = ms.run_scene(scene, out=tmp_path / "out")
    whole = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*.v*")}
    assert len(whole) > 2
    for path in (first.files[2], next((tmp_path / "out" / "beam_frames").iterdir())):
        path.write_bytes(whole[path][: len(whole[path]) // 2])
        again = ms.run_scene(scene, out=tmp_path / "out")
        assert again.resumed == len(first.trajectory.times)
        assert path.stat().st_size == len(whole[path])
    mine = tmp_path / "out" / "beam_frames" / "mine.txt"
    mine.write_bytes(b"mine")
    with pytest.raises(ms.FileFormatError, match=r"beam_frames holds 'mine.txt'"):
        ms.run_scene(scene, out=tmp_path / "out", restart=True)
    assert mine.read_bytes() == b"mine"


def test_leftovers_of_killed_writers_are_removed(tmp_path):
    out = tmp_path / "out"
    (out / ".beam.1.part_frames").mkdir(parents=True)
    (out / ".beam.1.part.npz").write_bytes(b"half")
    (out / ".other.1.part.npz").write_bytes(b"half")
    (out / ".beam.notes.partners").mkdir()
    (out / ".beam.notes.partners" / "mine.txt").write_bytes(b"mine")
    ms.run_scene(write(tmp_path), out=out)
    left = [".beam.notes.partners", ".other.1.part.npz", "beam.json", "beam.npz"]
    assert sorted(path.name for path in out.iterdir()) == left
    assert (out / ".beam.notes.partners" / "mine.txt").read_bytes() == b"mine"


def test_a_run_that_diverges_says_so(tmp_path):
    scene = write(tmp_path, model='ds"\nintegrator = "explicit"\nallow_unstable_step = true\nstep_tolerance = 1e-6#')
    result = ms.run_scene(scene, out=tmp_path)
    run = result.trajectory
    assert result.outcome is run.outcome is Outcome.DIVERGED
    assert run.message.startswith("positions left the finite numbers at ")
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(scene), "--out", str(tmp_path)])
    assert exit_.value.code == 1  # also where its results are there already
    assert np.isfinite(run.positions).all()


@pytest.mark.by_default("folded_strip")
@pytest.mark.parametrize("file", [_FOLDER / f"{name}.toml" for name in RUN], ids=RUN)
def test_scenes_of_the_repository_run(tmp_path, file):
    scene = ms.load_scene(file)
    if any(isinstance(contact, ms.SelfContact) for contact in scene.build_contacts()):
        pytest.importorskip("ipctk", reason="ipctk is not installed (pip install 'modalshell[contact]')")
    frames = 1
    if scene.motion is not None:
        scene = replace(scene, motion=msgspec.structs.replace(scene.motion, duration=0.1))
        frames += math.ceil(0.1 / scene.motion.dt - 1e-9)
    scene = replace(scene, output=msgspec.structs.replace(scene.output, formats=[]))
    result = ms.run_scene(scene, out=tmp_path)
    assert result.trajectory.status in ("completed", "converged")
    assert len(result.trajectory.times) == frames
    assert result.trajectory.positions.dtype == scene.output.positions
    assert [path.name for path in result.files] == [f"{file.stem}.npz", f"{file.stem}.json"]


@pytest.mark.slow
def test_the_command_prints_what_it_wrote(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    scene = write(tmp_path, duration=0.05, output='formats = ["png", "vtkhdf"]')
    scene = scene.rename(tmp_path / "of_another_name.toml")  # results were announced under the name of the file
    with pytest.raises(SystemExit) as stop:
        main(["run", str(scene), "--out", str(tmp_path / "out")])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith("beam: completed, 6 frames")
    bar, *files = out.splitlines()[1:]
    assert bar.startswith("beam: at its largest displacement, at 0.0")
    assert bar.endswith("% from DS")
    names = [Path(line).name for line in files]
    assert names == ["beam.npz", "beam.png", "beam.vtkhdf", "beam.json"]
    assert all((tmp_path / "out" / name).stat().st_size > 500 for name in names)


def test_the_command_refuses_in_one_line(tmp_path, capsys):
    scene = write(tmp_path, motion="store_evry = 2")
    with pytest.raises(SystemExit) as stop:
        main(["run", str(scene), "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "motion.store_evry: unknown key; did you mean 'store_every'?" in err
