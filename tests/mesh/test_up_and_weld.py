"""glTF as it is defined: y up, and triangles that may each have their own vertices."""

import numpy as np
import pytest
import trimesh

import modalshell as ms
from modalshell.commands.choices import hold_one_end
from modalshell.commands.cli import main

GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture
def panel():
    return ms.cylinder_panel(length=1.0, radius=0.6, cells=(20, 20))


def flat_shaded(mesh, path, up="y"):
    """Every triangle with its own vertices, as programs write surfaces of flat shading."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    if up == "y":
        corners = corners[:, [0, 2, 1]] * [1, 1, -1]
    made = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    path.write_bytes(made.export(file_type=path.suffix[1:]))
    return path


def same(found, mesh, atol=1e-6):
    assert (len(found.vertices), len(found.edges)) == (len(mesh.vertices), len(mesh.edges))
    np.testing.assert_allclose(found.vertices[found.faces], mesh.vertices[mesh.faces], atol=atol)


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return stop.value.code or 0, captured.out, captured.err


def test_flat_shaded_gltf_is_one_part_with_z_up(panel, tmp_path):
    found = ms.load_mesh(flat_shaded(panel, tmp_path / "panel.glb"))
    same(found, panel)
    assert found.components.max() == 0


def test_what_is_not_flat_shaded_keeps_its_vertices(panel, tmp_path):
    ms.save_mesh(panel, tmp_path / "panel.glb")
    found = ms.load_mesh(tmp_path / "panel.glb")
    np.testing.assert_array_equal(found.vertices, panel.vertices.astype(np.float32).astype(float))
    np.testing.assert_array_equal(found.faces, panel.faces)
    stored = trimesh.load_mesh(tmp_path / "panel.glb", process=False).vertices
    np.testing.assert_allclose(stored[:, 1], panel.vertices[:, 2], atol=1e-6)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_up_is_rotated_to_z(panel, tmp_path, suffix, up):
    turn = {"x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]], "z": np.eye(3)}[up]
    stored = panel.vertices @ np.transpose(turn)
    data = trimesh.Trimesh(stored, panel.faces, process=False).export(file_type=suffix[1:])
    path = tmp_path / f"panel{suffix}"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    found = ms.load_mesh(path, up=up)
    np.testing.assert_allclose(found.vertices[found.faces], panel.vertices[panel.faces], atol=1e-6)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_other_axes_are_refused(panel, tmp_path):
    ms.save_mesh(panel, tmp_path / "panel.obj")
    with pytest.raises(ms.OptionError, match="up must be one of 'x', 'y', 'z'"):
        ms.load_mesh(tmp_path / "panel.obj", up="w")


def test_coordinates_of_a_unit_become_metres(panel, tmp_path):
    ms.save_mesh(ms.TriangleMesh(1e3 * panel.vertices[:, [0, 2, 1]] * [1, 1, -1], panel.faces), tmp_path / "y.obj")
    same(ms.load_mesh(tmp_path / "y.obj", up="y", unit="mm"), panel, 1e-12)
    assert ms.load_mesh(tmp_path / "y.obj").size == pytest.approx(1e3 * panel.size)
    with pytest.raises(ms.OptionError, match="unit must be one of 'm', 'cm', 'mm'"):
        ms.load_mesh(tmp_path / "y.obj", unit="inch")
    with pytest.raises(ms.OptionError, match="unit must be left out for USD files"):
        ms.load_mesh(tmp_path / "y.usda", unit="mm")


@pytest.mark.slow
def test_commands_take_a_unit_and_say_what_they_assume(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    plate = ms.flat_beam(length=200.0, width=100.0, cells=(6, 4))
    ms.save_mesh(plate, tmp_path / "plate.stl")
    status, out, err = run(capsys, "modes", tmp_path / "plate.stl", "--count", "7", "--out", tmp_path)
    assert status == 0, err
    assert "200 m in size (`--unit mm`" in out.replace("\n", " ")
    assert "assumed: --young 1e+09 Pa, --thickness 1 m" in out.replace("\n", " ")
    steel = ("--young", "210e9", "--thickness", "0.002", "--density", "7850")
    status, out, err = run(
        capsys, "modes", tmp_path / "plate.stl", "--count", "7", "--out", tmp_path, "--unit", "mm", *steel
    )
    assert status == 0, err
    assert "in size" not in out
    assert "assumed" not in out
    small = ms.TriangleMesh(1e-3 * plate.vertices, plate.faces)
    sheet = ms.Isotropic(young=210e9, poisson=0.3, thickness=2e-3, density=7850.0)
    expected = ms.solve_modes(ms.Shell(small, sheet), 7).frequencies[6]
    assert ms.Basis.load(tmp_path / "plate_basis.npz").frequencies[6] == pytest.approx(expected, rel=1e-5)
    assert run(capsys, "modes", tmp_path / "plate.stl", "--unit", "inch")[2].count("--unit must be one of") == 1
    mended = tmp_path / "mended.ply"
    assert run(capsys, "repair", tmp_path / "plate.stl", "--unit", "cm", "--join", "0.001", "--out", mended)[0] == 0
    assert ms.load_mesh(mended).size == pytest.approx(2.0, rel=1e-6)


@pytest.mark.slow
def test_scenes_and_commands_take_up_and_tell_it_first(panel, tmp_path, scene_file, capsys, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    ms.save_mesh(ms.TriangleMesh(panel.vertices[:, [0, 2, 1]] * [1, 1, -1], panel.faces), tmp_path / "y.obj")
    ms.save_mesh(panel, tmp_path / "z.glb")
    scene = scene_file(('shape = "v_beam"\ncells = [12, 4]', 'file = "y.obj"\nup = "y"'))
    same(ms.load_scene(scene).build_mesh(), panel, 1e-12)
    for file, more, first in (("y.obj", ["--up", "y"], "y is up in the file"), ("z.glb", ["--up", "z"], "z is up")):
        command = ("simulate", tmp_path / file, "--static", "--model", "lma", "--out", tmp_path)
        status, out, err = run(capsys, *command, *more)
        assert status == 0, err
        assert first in out.splitlines()[0]
    status, out, err = run(capsys, "repair", tmp_path / "y.obj", "--up", "y", "--out", tmp_path / "mended.ply")
    assert status == 0, err
    assert "y is up in the file" in out.splitlines()[0]
    assert ms.load_mesh(tmp_path / "mended.ply").vertices[:, 2].max() == pytest.approx(panel.vertices[:, 2].max())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*boundary vertices coincide")
@pytest.mark.parametrize("repair", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_loose_triangles_of_any_format_are_refused_without_clamp(panel, tmp_path, capsys, repair):
    path = flat_shaded(panel, tmp_path / "panel.ply", up="z")
    status, _, err = run(capsys, "simulate", path, "--out", tmp_path)
    assert status == 2
    assert "--join" in err
    assert "--repair" in err
    option = ["--repair"] if repair else ["--join", "1e-6"]
    status, out, err = run(capsys, "simulate", path, "--static", "--model", "lma", *option, "--out", tmp_path)
    assert status == 0, err
    assert 'holds the end "' in out


def test_many_parts_and_many_held_vertices_are_refused():
    strip = ms.sheet(length=1.0, width=0.2, cells=(10, 2))

    def copies(count, mesh):
        moved = [mesh.vertices + np.array([0.0, 0.0, 2.0 * k]) for k in range(count)]
        faces = [mesh.faces + k * len(mesh.vertices) for k in range(count)]
        return ms.TriangleMesh(np.vstack(moved), np.vstack(faces))

    assert "20 parts" in hold_one_end(copies(20, strip), GRAVITY)[1]
    with pytest.raises(ms.SupportError, match=r"21 parts.*--join.*--repair"):
        hold_one_end(copies(21, strip), GRAVITY)
    coarse = ms.sheet(length=1.0, width=0.8, cells=(2, 2))
    with pytest.raises(ms.SupportError, match=r"20 parts, \d\d % .*--join.*--repair"):
        hold_one_end(copies(20, coarse), GRAVITY)
    assert hold_one_end(copies(2, coarse), GRAVITY)[0].any()
