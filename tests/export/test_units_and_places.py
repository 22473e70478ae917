"""Exports keep the shell's size: in units other than metres, and far from the origin."""

import base64
import importlib.util
import struct
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import trimesh
from scenes import cantilever

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.units import LENGTHS, TIMES, UnitSystem
from modalshell.export import save_modes_gltf
from modalshell.motion.colouring import Colouring

PLACE = np.array([4.5e5, 5.4e6, 300.0])
NEEDS_USD = pytest.mark.skipif(importlib.util.find_spec("pxr") is None, reason="pip install 'modalshell[interchange]'")
NEEDS_GLTF = pytest.mark.skipif(
    importlib.util.find_spec("pygltflib") is None, reason="pip install 'modalshell[interchange]'"
)


@pytest.fixture(scope="module")
def basis():
    return ms.solve_modes(cantilever((8, 4)), 4)


@pytest.fixture(scope="module")
def run(basis):
    return ms.simulate(ms.ModalWarping(basis), duration=0.3, dt=0.1, gravity=(0, 0.5, -6), damping=(0.5, 0.001))


@pytest.fixture(scope="module")
def far(run):
    return replace(run, positions=run.positions + PLACE, rest_positions=run.rest_positions + PLACE)


def read_usd(path):
    """Positions (F, n, 3) [m] and times [s] as a reader of USD finds them."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    shell = UsdGeom.Mesh(stage.GetDefaultPrim())
    points = shell.GetPointsAttr()
    codes = points.GetTimeSamples()
    place = np.array(UsdGeom.Xformable(shell).ComputeLocalToWorldTransform(0))
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    frames = np.array([np.array(points.Get(code), float) for code in codes]) @ place[:3, :3] + place[3, :3]
    return unit * frames, np.array(codes) / stage.GetTimeCodesPerSecond()


def read_gltf(path):
    """Rest positions (n, 3) [m], z up."""
    found = trimesh.load(path, process=False)
    (name,) = found.graph.nodes_geometry
    place, _ = found.graph[name]
    (mesh,) = found.geometry.values()
    turned = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    return turned[:, [0, 2, 1]] * [1, -1, 1]


@pytest.mark.parametrize(("length", "metres"), [("mm", 1e-3), ("km", 1e3), ("in", 0.0254), ("m", 1.0)])
@NEEDS_USD
def test_usd_names_the_unit_of_length(run, tmp_path, length, metres):
    other = replace(run, units=UnitSystem(length, "kg", "ms"))
    frames, times = read_usd(ms.save_trajectory(other, tmp_path / "a.usdc"))
    np.testing.assert_allclose(frames, metres * run.positions, atol=1e-6 * metres)
    np.testing.assert_allclose(times, 1e-3 * run.times, atol=1e-12)


@pytest.mark.parametrize(("length", "metres"), [("mm", 1e-3), ("ft", 0.3048), ("m", 1.0)])
@NEEDS_GLTF
def test_gltf_is_in_metres_and_seconds(run, tmp_path, length, metres):
    from pygltflib import GLTF2

    path = ms.save_trajectory(replace(run, units=UnitSystem(length, "t", "ms")), tmp_path / "a.glb")
    np.testing.assert_allclose(read_gltf(path), metres * run.rest_positions, atol=1e-6 * metres)
    document = GLTF2().load(path)
    assert document.accessors[document.animations[0].samplers[0].input].max[0] == pytest.approx(3e-4)
    plain = GLTF2().load(ms.save_trajectory(run, tmp_path / "b.glb"))
    reach = [
        np.abs([one.accessors[target["POSITION"]].max for target in one.meshes[0].primitives[0].targets]).max()
        for one in (document, plain)
    ]
    assert reach[0] == pytest.approx(metres * reach[1], rel=1e-6)


def test_mdd_is_in_seconds(run, tmp_path):
    data = ms.save_trajectory(replace(run, units=UnitSystem("mm", "t", "ms")), tmp_path / "a.mdd").read_bytes()
    frames, _ = struct.unpack_from(">ii", data)
    np.testing.assert_allclose(np.frombuffer(data, ">f4", frames, 8), 1e-3 * run.times, rtol=1e-6)


@NEEDS_USD
def test_usd_far_from_the_origin_keeps_the_shape(far, tmp_path):
    frames, _ = read_usd(ms.save_trajectory(far, tmp_path / "a.usda"))
    np.testing.assert_allclose(frames, far.positions, rtol=0, atol=1e-6)


@NEEDS_GLTF
def test_gltf_far_from_the_origin_keeps_the_shape_and_the_place(far, basis, tmp_path):
    found = read_gltf(ms.save_trajectory(far, tmp_path / "a.glb"))
    np.testing.assert_allclose(found, far.rest_positions, rtol=0, atol=1e-6)
    mesh = basis.shell.mesh
    shell = ms.Shell(ms.TriangleMesh(mesh.vertices + PLACE, mesh.faces), basis.shell.material, basis.shell.clamped)
    found = read_gltf(save_modes_gltf(ms.solve_modes(shell, 2), tmp_path / "b.glb"))
    np.testing.assert_allclose(found, far.rest_positions, rtol=0, atol=1e-6)


@pytest.mark.parametrize("suffix", ["pc2", "mdd", "clip"])
def test_files_without_a_place_refuse_shells_far_from_the_origin(far, tmp_path, suffix):
    with pytest.raises(ms.OptionError, match="move the mesh near the origin"):
        ms.save_trajectory(far, tmp_path / f"a.{suffix}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [pytest.param("usda", marks=NEEDS_USD), pytest.param("glb", marks=NEEDS_GLTF)])
def test_positions_that_were_stored_without_their_shape_are_refused(far, tmp_path, suffix):
    with pytest.raises(ms.OptionError, match="single precision"):
        ms.save_trajectory(replace(far, positions=far.positions.astype(np.float32)), tmp_path / f"a.{suffix}")


def test_a_run_stores_no_single_precision_far_from_the_origin(scene_file, tmp_path):
    beam = ms.v_beam(cells=(12, 4))
    ms.save_mesh(ms.TriangleMesh(beam.vertices + PLACE, beam.faces), tmp_path / "far.obj")
    scene = scene_file(
        ('shape = "v_beam"\ncells = [12, 4]', 'file = "far.obj"'), more='[output]\npositions = "float32"\n'
    )
    scene.write_text(scene.read_text().replace("x < ", f"x < {PLACE[0]} + "))
    with pytest.raises(ms.SceneError, match=r"float32.* move the mesh near the origin"):
        ms.run_scene(scene, out=tmp_path)


def test_a_page_far_from_the_origin_shows_the_motion(far, tmp_path, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    saved = ms.save_trajectory(far, tmp_path / "a.npz")
    with pytest.raises(SystemExit) as stop:
        main(["export", str(saved), "--to", "page"])
    assert not stop.value.code
    text = (tmp_path / "a.html").read_text()
    stored = np.frombuffer(base64.b64decode(text.split('"rest": "')[1].split('"')[0]), "<f4").reshape(-1, 3)
    middle = 0.5 * (far.rest_positions.min(axis=0) + far.rest_positions.max(axis=0))
    np.testing.assert_allclose(stored, far.rest_positions - middle, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("length", "time"), [("mm", "ms"), ("in", "s"), ("m", "s")])
def test_the_add_on_of_blender_plays_clips_in_metres_and_seconds(run, tmp_path, monkeypatch, length, time):
    """The add-on is one file without this package; Blender's own modules stand in by name."""
    for name in ("bpy", "bpy.app", "bpy.app.handlers", "bpy.props", "bpy_extras", "bpy_extras.io_utils"):
        monkeypatch.setitem(sys.modules, name, mock.MagicMock())
    sys.modules["bpy"].types.Operator = type("Operator", (), {})
    sys.modules["bpy_extras.io_utils"].ImportHelper = type("ImportHelper", (), {})
    place = Path(ms.__file__).parent / "export" / "blender_clip.py"
    spec = importlib.util.spec_from_file_location("blender_clip", place)
    add_on = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(add_on)
    assert (add_on._METRES, add_on._SECONDS) == (LENGTHS, TIMES)
    path = ms.save_trajectory(replace(run, units=UnitSystem(length, "t", time)), tmp_path / "a.clip")
    clip = add_on._clip(str(path))
    np.testing.assert_allclose(clip["times"], TIMES[time] * run.times)
    for k, at in enumerate(run.times):
        expected = LENGTHS[length] * run.positions[k]
        found = add_on.positions(clip, TIMES[time] * at)
        np.testing.assert_allclose(found, expected, atol=2e-4 * LENGTHS[length])


def test_a_coloured_displacement_is_labelled_in_the_units_of_the_run(run):
    other = replace(run, units=UnitSystem("mm", "t", "s"))
    assert Colouring.of(other, "displacement").label == "displacement [mm]"
    assert Colouring.of(run, "displacement").label == "displacement [m]"
    stress = replace(other, fields={"von_mises": np.ones((len(run.times), len(run.faces)))})
    assert Colouring.of(stress, "von_mises").label == "von Mises [MPa]"
