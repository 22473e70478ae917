"""Motions in other programs' formats, read back by those programs' own readers."""

import importlib.util
import json
import os
import signal
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scenes import cantilever

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.export import compress
from modalshell.export.clip import read_clip

ADD_ON = Path(ms.__file__).parent / "export" / "blender_clip.py"


@pytest.fixture(scope="module")
def run():
    """A warped motion whose supports move: no model's own coordinates describe it alone."""
    model = ms.ModalWarping(ms.solve_modes(cantilever((8, 4)), 6))
    path = ms.SupportPath([0.0, 0.5, 1.0], [[0, 0, 0], [0.1, 0, 0.05], [0, 0, 0]], pivot=(0, 0, 0))
    return ms.simulate(model, duration=1.0, dt=1 / 30, gravity=(0, 0.5, -6), damping=(0.5, 0.001), supports=path)


@pytest.fixture(scope="module")
def size(run):
    return np.linalg.norm(np.ptp(run.rest_positions, axis=0))


def farthest(a, b):
    return np.linalg.norm(np.asarray(a) - b, axis=-1).max()


def call(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert not stop.value.code


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_a_compressed_motion_is_as_near_as_it_says(run, size, tolerance):
    motion = compress(run, tolerance)
    error = farthest(motion.positions(), run.positions)
    assert error == pytest.approx(motion.error, rel=1e-3, abs=1e-7)
    assert error <= tolerance * size
    fewer = np.tensordot(motion.amplitudes[:, :-1].astype(float), motion.displacements()[:-1], 1)
    assert farthest(fewer + motion.rest_positions, run.positions) > tolerance * size  # the last shape is needed


def test_a_film_of_ten_seconds_is_a_small_clip(tmp_path):
    model = ms.ModalWarping(ms.solve_modes(cantilever((8, 4)), 8))
    run = ms.simulate(model, duration=10.0, dt=1 / 30, gravity=(0, 0, -4), damping=(0.5, 0.001))
    path = ms.save_trajectory(run, tmp_path / "run.clip")
    motion = read_clip(path)
    shapes = motion.shapes.nbytes + motion.rest_positions.nbytes + motion.faces.nbytes
    assert path.stat().st_size - shapes < 20_000
    assert len(motion.scales) <= 12


def test_a_clip_is_a_trajectory_again(run, size, tmp_path):
    loaded = ms.load_clip(ms.save_trajectory(run, tmp_path / "run.clip"))
    np.testing.assert_array_equal(loaded.times, run.times)
    np.testing.assert_array_equal(loaded.faces, run.faces)
    assert farthest(loaded.positions, run.positions) < 2.1e-4 * size
    assert loaded.outcome.succeeded


@pytest.mark.parametrize("share", [1e-3, 1e-4])
def test_a_small_motion_is_kept_to_a_twentieth(run, share):
    """Those smaller than the tolerance stood still."""
    rest = run.rest_positions
    small = replace(run, positions=rest + share * (run.positions - rest))
    assert farthest(compress(small).positions(), small.positions) < 0.05 * farthest(small.positions, rest)


def test_a_clip_and_a_page_of_no_motion(run, tmp_path):
    still = replace(run, positions=np.repeat(run.rest_positions[None], len(run.times), axis=0))
    loaded = ms.load_clip(ms.save_trajectory(still, tmp_path / "run.clip"))
    assert farthest(loaded.positions, still.positions) < 1e-7
    call("export", tmp_path / "run.clip", "--to", "page")
    assert "Recorded motion" in (tmp_path / "run.html").read_text()


@pytest.mark.parametrize("tolerance", [0.0, 1e-7, np.nan, 1.0])
def test_odd_tolerances_are_refused(run, tolerance):
    with pytest.raises(ms.OptionError, match="tolerance must be"):
        compress(run, tolerance)


def test_damaged_clips_are_refused(run, tmp_path):
    path = ms.save_trajectory(run, tmp_path / "run.clip")
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:200] + b"xx" + whole[202:], b"", b"POINTCACHE2"):
        path.write_bytes(damaged)
        with pytest.raises(ms.FileFormatError, match="cannot read a clip"):
            ms.load_clip(path)
    with pytest.raises(ms.FileFormatError, match="cannot read a clip"):
        ms.load_clip(ms.save_trajectory(run, tmp_path / "run.npz"))


def test_point_caches_hold_every_frame(run, tmp_path):
    shape = run.positions.shape
    data = ms.save_trajectory(run, tmp_path / "run.pc2").read_bytes()
    assert struct.unpack_from("<12siiffi", data) == (b"POINTCACHE2\0", 1, shape[1], 0.0, 1.0, shape[0])
    np.testing.assert_array_equal(np.frombuffer(data, "<f4", offset=32).reshape(shape), run.positions.astype("f4"))
    data = ms.save_trajectory(run, tmp_path / "run.mdd").read_bytes()
    assert struct.unpack_from(">ii", data) == shape[:2]
    np.testing.assert_array_equal(np.frombuffer(data, ">f4", shape[0], 8), run.times.astype("f4"))
    frames = np.frombuffer(data, ">f4", offset=8 + 4 * shape[0]).reshape(shape)
    np.testing.assert_array_equal(frames, run.positions.astype("f4"))


@pytest.mark.by_default(".usda")
@pytest.mark.parametrize("suffix", [".usdc", ".usda"])
def test_usd_holds_every_frame_in_metres_with_z_up(run, tmp_path, suffix):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed (pip install 'modalshell[interchange]')")
    from pxr import UsdGeom

    stage = usd.Stage.Open(str(ms.save_trajectory(run, tmp_path / f"run{suffix}")))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    shell = UsdGeom.Mesh(stage.GetDefaultPrim())
    np.testing.assert_array_equal(np.reshape(shell.GetFaceVertexIndicesAttr().Get(), (-1, 3)), run.faces)
    points = shell.GetPointsAttr()
    codes = np.array(points.GetTimeSamples())
    np.testing.assert_allclose(codes / stage.GetTimeCodesPerSecond(), run.times, atol=1e-12)
    for code, frame in zip(codes, run.positions, strict=True):
        np.testing.assert_array_equal(np.array(points.Get(code)), frame.astype("f4"))


@pytest.mark.parametrize("dt", [0.002, 0.04])
def test_usd_plays_at_real_speed_whatever_the_step(run, tmp_path, dt):
    """Programs play one time code a frame, at 24 frames a second unless they are told otherwise."""
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed (pip install 'modalshell[interchange]')")
    slow = replace(run, times=dt * np.arange(len(run.times)))
    stage = usd.Stage.Open(str(ms.save_trajectory(slow, tmp_path / "run.usdc")))
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 24.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, pytest.approx(24.0 * slow.times[-1]))


def test_usd_with_y_up_is_read_back_as_it_was(run, tmp_path, capsys):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed (pip install 'modalshell[interchange]')")
    from pxr import UsdGeom

    ms.save_trajectory(run, tmp_path / "run.npz")
    with pytest.raises(SystemExit) as ended:
        main(["export", str(tmp_path / "run.npz"), "--to", "usd", "--up", "y", "--out", str(tmp_path / "run.usda")])
    assert ended.value.code == 0, capsys.readouterr().err
    assert (tmp_path / "run.usda").read_text().startswith("#usda 1.0")
    assert UsdGeom.GetStageUpAxis(usd.Stage.Open(str(tmp_path / "run.usda"))) == "Y"
    mesh = ms.load_mesh(tmp_path / "run.usda")
    np.testing.assert_allclose(mesh.vertices, run.positions[0], atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, run.faces)
    with pytest.raises(SystemExit) as ended:
        main(["export", str(tmp_path / "run.npz"), "--to", "gltf", "--up", "y"])
    assert ended.value.code == 2
    assert "--up goes with --to usd" in capsys.readouterr().err


def read_glb(path):
    """Document and binary part of a .glb file."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    (text,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + text]), data[28 + text :]


def accessor(document, binary, index):
    entry = document["accessors"][index]
    view = document["bufferViews"][entry["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3}[entry["type"]]
    values = np.frombuffer(binary, "<f4", entry["count"] * width, view["byteOffset"])
    return values if width == 1 else values.reshape(-1, width)


def test_gltf_bakes_the_motion_into_morph_targets(run, size, tmp_path):
    pytest.importorskip("pygltflib", reason="pygltflib is not installed (pip install 'modalshell[interchange]')")
    path = ms.save_trajectory(run, tmp_path / "run.glb")
    scene = trimesh.load(path, process=False)
    turned = scene.to_geometry().vertices  # y up
    np.testing.assert_allclose(turned[:, [0, 2, 1]] * [1, -1, 1], run.rest_positions, atol=1e-6)
    document, binary = read_glb(path)
    (primitive,) = document["meshes"][0]["primitives"]
    shapes = np.array([accessor(document, binary, target["POSITION"]) for target in primitive["targets"]])
    (sampler,) = document["animations"][0]["samplers"]
    times, weights = (accessor(document, binary, sampler[key]) for key in ("input", "output"))
    weights = weights.reshape(len(times), -1)
    np.testing.assert_allclose(times, run.times, atol=1e-6)
    assert weights.min() == 0.0  # readers clamp
    assert weights.max() == 1.0
    base = accessor(document, binary, primitive["attributes"]["POSITION"])
    assert farthest(base + np.tensordot(weights, shapes, 1), run.positions) < 2.1e-4 * size


def test_gltf_of_a_basis_has_a_target_a_mode(tmp_path, capsys):
    pytest.importorskip("pygltflib", reason="pygltflib is not installed (pip install 'modalshell[interchange]')")
    basis = ms.solve_modes(cantilever((8, 4)), 5)
    basis.save(tmp_path / "basis.npz")
    call("export", tmp_path / "basis.npz", "--to", "gltf")
    assert capsys.readouterr().out.split() == [str(tmp_path / "basis.glb")]
    document, binary = read_glb(tmp_path / "basis.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    assert document["meshes"][0]["extras"]["targetNames"][0] == f"mode 1, {basis.frequencies[0]:.4g} Hz"
    for target, mode in zip(primitive["targets"], basis.modes.T, strict=True):
        shown = accessor(document, binary, target["POSITION"]).ravel()
        assert np.corrcoef(shown, mode)[0, 1] == pytest.approx(1.0, abs=1e-5)
        assert np.linalg.norm(shown.reshape(-1, 3), axis=1).max() == pytest.approx(0.2 * basis.shell.size, rel=1e-5)


@pytest.mark.slow
def test_export_writes_what_is_asked(run, tmp_path, capsys):
    saved = ms.save_trajectory(run, tmp_path / "run.npz")
    for kind, names in (
        ("clip", ["run.clip"]),
        ("pc2", ["run.pc2", "run_rest.obj"]),
        ("mdd", ["run.mdd", "run_rest.obj"]),
        ("page", ["run.html"]),
    ):
        call("export", saved, "--to", kind)
        assert capsys.readouterr().out.split() == [str(tmp_path / name) for name in names]
    rest = ms.load_mesh(tmp_path / "run_rest.obj")
    np.testing.assert_array_equal(rest.vertices, run.rest_positions)
    call("export", tmp_path / "run.clip", "--to", "pc2", "--out", tmp_path / "again.pc2")
    frames = np.frombuffer((tmp_path / "again.pc2").read_bytes(), "<f4", offset=32).reshape(run.positions.shape)
    assert farthest(frames, run.positions) < 1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.npz", "--to", "clip"], "missing.npz"),
        (["run.clip", "--to", "clip"], "would be overwritten"),
        (["run.clip", "--to", "usd", "--out", "run.obj"], "must end in .usdc"),
        (["run.clip", "--to", "alembic"], "alembic"),
        (["basis.npz", "--to", "clip"], "is a basis"),
        (["text.npz", "--to", "clip"], "cannot read a saved trajectory"),
        (["a.toml", "--to", "clip"], "run it with 'modalshell run' first"),
    ],
)
def test_export_refuses_in_one_line(run, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    ms.save_trajectory(run, "run.clip")
    ms.solve_modes(cantilever((8, 4)), 2).save("basis.npz")
    Path("text.npz").write_text("text")
    with pytest.raises(SystemExit) as stop:
        main(["export", *arguments])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_a_stopped_export_leaves_no_file(run, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed (pip install 'modalshell[interchange]')")

    def stop(done, _total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ms.save_trajectory(run, tmp_path / "run.usdc", on_frame=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.by_default(".pc2")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the process that is killed is a fork")
@pytest.mark.parametrize("suffix", [".npz", ".clip", ".usdc", ".glb", ".pc2", ".mdd", ".vtkhdf", ".html"])
def test_a_killed_export_leaves_the_file_as_it_was(run, tmp_path, suffix):
    """Killed at the last moment, when everything is written and only the move into place is missing."""
    needed = {".usdc": "pxr", ".glb": "pygltflib", ".vtkhdf": "vtkmodules"}.get(suffix)
    if needed:
        pytest.importorskip(needed, reason=f"{needed} is not installed (pip install 'modalshell[interchange,vtk]')")
    target = tmp_path / f"run{suffix}"
    target.write_text("of before")
    page = ms.solve_modes(cantilever((4, 2)), 2).page() if suffix == ".html" else None
    child = os.fork()
    if child == 0:
        os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        try:
            ms.save_trajectory(run, target) if page is None else page.save(target)
        finally:
            os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    assert target.read_text() == "of before"
    assert [path for path in tmp_path.iterdir() if not path.name.startswith(".")] == [target]


@pytest.mark.by_default(".usdc", ".vtkhdf")
@pytest.mark.parametrize("suffix", [".usdc", ".usda", ".vtkhdf"])
def test_an_export_without_room_says_so_and_leaves_no_file(run, tmp_path, suffix):
    """USD's own error left it, and HDF5 said nothing of a file without its frames."""
    needed = {".vtkhdf": "vtkmodules"}.get(suffix, "pxr")
    pytest.importorskip(needed, reason=f"{needed} is not installed (pip install 'modalshell[interchange,vtk]')")
    resource = pytest.importorskip("resource", reason="this system has no limits of files")
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.close(2)  # HDF5 prints pages
            resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
            ms.save_trajectory(run, tmp_path / f"run{suffix}")
        except ms.FileFormatError:
            status = 0
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert list(tmp_path.iterdir()) == []


BLENDER = """
import importlib.util, os, sys
import bpy
import numpy as np

folder, add_on = sys.argv[1:]
expected = np.load(folder + "/run.npz")["positions"]
spec = importlib.util.spec_from_file_location("blender_clip", add_on)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)

def fresh():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 30

def compare(first, step=1.0):
    (shell,) = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    for frame in (0, 7, 30):
        place = first + frame * step
        bpy.context.scene.frame_set(int(place + 1e-9), subframe=max(place - int(place + 1e-9), 0.0))
        seen = shell.evaluated_get(bpy.context.evaluated_depsgraph_get())
        points = np.array([seen.matrix_world @ vertex.co for vertex in seen.to_mesh().vertices])
        print(np.abs(points - expected[frame]).max())

module.register()
fresh()
bpy.ops.import_scene.modalshell_clip(filepath=folder + "/run.clip")
compare(bpy.context.scene.frame_start)
module.unregister()
fresh()
bpy.ops.import_scene.gltf(filepath=folder + "/run.glb")
compare(0)
fresh()
bpy.context.scene.render.fps = 24  # as Blender starts, which takes no rate from a file: a time code is a frame
bpy.ops.wm.usd_import(filepath=folder + "/run.usdc")
assert (bpy.context.scene.frame_start, bpy.context.scene.frame_end) == (0, 24), "the motion of 1 s"
compare(0, 24 / 30)
for kind in ("PC2", "MDD"):
    fresh()
    bpy.ops.wm.obj_import(filepath=folder + "/run_rest.obj", forward_axis="Y", up_axis="Z")
    (shell,) = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    cache = shell.modifiers.new("cache", "MESH_CACHE")
    cache.cache_format, cache.filepath, cache.frame_start = kind, folder + "/run." + kind.lower(), 0
    compare(0)
sys.stdout.flush()
os._exit(0)  # the module crashes at its end
"""


@pytest.mark.slow
def test_blender_shows_the_motion(run, size, tmp_path):
    python = os.environ.get("BLENDER_PYTHON", sys.executable if importlib.util.find_spec("bpy") else "")
    if not python:
        pytest.skip("bpy is not installed (pip install bpy, or name a Python that has it in BLENDER_PYTHON)")
    for suffix in (".npz", ".clip", ".glb", ".usdc", ".pc2", ".mdd"):
        ms.save_trajectory(run, tmp_path / f"run{suffix}")
    ms.save_mesh(ms.TriangleMesh(run.rest_positions, run.faces), tmp_path / "run_rest.obj")
    command = [python, "-c", BLENDER, str(tmp_path), str(ADD_ON)]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment, check=False)
    assert ended.returncode == 0, ended.stderr
    lines = ended.stdout.splitlines()
    errors = np.array([float(line) for line in lines if line[:1].isdigit() and set(line) <= set("0123456789.e-+")])
    assert errors.shape == (15,)
    assert errors[:6].max() < 2.1e-4 * size
    assert errors[6:].max() < 1e-6
