"""Loads that follow the shell or the time, and fields, in scenes."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

import modalshell as ms

FLAT = ('"v_beam"', '"flat_beam"')
LOADS = """
[[loads.pressure]]
p = 0.01
follower = false

[[loads.wind]]
velocity = [0.0, 1.0, 2.0]
sel = "x > 0.2"

[[loads.moment]]
sel = "x > 0.99"
m = 1e-3
times = [0.0, 0.5]
factors = [0.0, 1.0]

[[loads.weight]]
gravity = [0.0, 0.0, -0.5]

[[loads.frame]]
angular_velocity = [0.0, 0.0, 1.0]

[[loads.follower]]
sel = "x > 0.99"
force = [0.0, 0.0, 1e-4]
"""


def test_scenes_take_the_loads_that_python_does(scene_file):
    built = ms.load_scene(scene_file(FLAT, ("[model]", f"{LOADS}[model]"))).build()
    mesh = built.shell.mesh
    np.testing.assert_array_equal(built.force, ms.Pressure(0.01, follower=False).force(mesh))
    loads = [
        ms.FrameInertia(angular_velocity=(0, 0, 1)),
        ms.FollowerForce("x > 0.99", (0, 0, 1e-4)),
        ms.SelfWeight((0, 0, -0.5)),
        ms.Wind((0.0, 1.0, 2.0), sel="x > 0.2"),
        ms.Scaled(ms.EdgeMoment("x > 0.99", 1e-3), ([0.0, 0.5], [0.0, 1.0])),
    ]
    motion = built.start_motion()
    by_python = built.shell.loading(built.gravity, built.force, loads)
    x = mesh.vertices * 1.01
    for time in (0.0, 0.3, 2.0):
        found, expected = motion.setup.loading.force(x, 0.1 * x, time), by_python.force(x, 0.1 * x, time)
        np.testing.assert_allclose(found, expected, atol=1e-15)
    assert not motion.setup.loading.conservative
    assert not motion.setup.loading.steady


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("p = 0.01", 'p = "x"', "loads.pressure[0].p: must be a number"),
        ("follower = false", "follow = false", "loads.pressure[0].follow: unknown key; did you mean 'follower'"),
        ("[0.0, 1.0, 2.0]", "[0.0, 1.0]", "loads.wind[0].velocity"),
        ('"x > 0.2"', '"x > 9"', "loads.wind[0].sel: selects no vertex"),
        ("factors = [0.0, 1.0]\n", "", "loads.moment[0]: times and factors go together"),
        ("times = [0.0, 0.5]", "times = [0.5, 0.0]", "loads.moment[0].times"),
        ("factors = [0.0, 1.0]", "factors = [0.0, 1.0, 2.0]", "loads.moment[0].factors: must have shape (2,)"),
        ("m = 1e-3", "m = true", "loads.moment[0].m"),
        ("[0.0, 0.0, 1e-4]", "1e-4", "loads.follower[0].force"),
        ("loads.frame", "loads.frames", "loads.frames: unknown key; did you mean 'frame'"),
    ],
)
def test_wrong_keys_are_refused_with_their_path(scene_file, old, new, message):
    assert LOADS.count(old) == 1
    file = scene_file(FLAT, ("[model]", f"{LOADS.replace(old, new)}[model]"))
    with pytest.raises(ms.SceneError) as refused:
        ms.load_scene(file).build()
    assert message in str(refused.value)


def test_statics_knows_no_time(scene_file):
    file = scene_file(FLAT, ("[motion]\nduration = 1\n", ""), ("[model]", f"{LOADS}[model]"))
    with pytest.raises(ms.SceneError, match=r"loads\.moment\[0\]: times and factors need a \[motion\] table"):
        ms.load_scene(file).build()


@pytest.mark.slow
def test_fields_are_stored_and_written(scene_file, tmp_path):
    file = scene_file(
        FLAT, ("duration = 1", "duration = 0.1"), ("[model]", '[output]\nfields = ["curvature"]\n[model]')
    )
    first = ms.run_scene(file, out=tmp_path)
    assert list(first.trajectory.fields) == ["curvature"]
    shell = ms.load_scene(file).build_shell()
    last = first.trajectory.positions[-1]
    np.testing.assert_array_equal(first.trajectory.fields["curvature"][-1], shell.fields(last).curvature)
    # Whole results stay; other fields are found from them.
    scene = ms.load_scene(file)
    other = msgspec.structs.replace(scene.output, fields=["energy_density", "curvature"])

    again = ms.run_scene(replace(scene, output=other), out=tmp_path)
    assert again.resumed == len(first.trajectory.times)
    assert set(again.trajectory.fields) == {"energy_density", "curvature"}
    np.testing.assert_array_equal(again.trajectory.positions, first.trajectory.positions)


def test_fields_that_the_material_lacks_are_refused(scene_file, tmp_path):
    for key in ('fields = ["von_mises"]', 'color = "von_mises"'):
        file = scene_file(FLAT, ("[model]", f"[output]\n{key}\n[model]"))
        with pytest.raises(ms.SceneError, match=r"output.*von_mises needs a sheet with a thickness"):
            ms.run_scene(file, out=tmp_path)
    with pytest.raises(ms.SceneError, match=r"output\.color"):
        ms.load_scene(scene_file(FLAT, ("[model]", '[output]\ncolor = "stress"\n[model]')))


@pytest.mark.slow
def test_films_and_pictures_are_coloured_by_a_field(scene_file, tmp_path):
    file = scene_file(FLAT, ("duration = 1", "duration = 0.2"), ("[model]", '[output]\nformats = ["png"]\n[model]'))
    plain = ms.run_scene(file, out=tmp_path)
    before = (tmp_path / "scene.png").read_bytes()
    coloured = ms.run_scene(file, out=tmp_path, color="curvature")
    assert coloured.resumed == len(plain.trajectory.times)
    assert (tmp_path / "scene.mp4").stat().st_size > 1000
    assert (tmp_path / "scene.png").read_bytes() != before
    ms.run_scene(file, out=tmp_path)
    assert (tmp_path / "scene.png").read_bytes() == before
