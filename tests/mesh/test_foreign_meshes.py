"""Meshes as other programs write them: read as the sheet that they are, and a film with one command."""

import contextlib
import importlib.util
import warnings

import numpy as np
import pytest
from foreign_meshes import MESHES, curved_sheet, write
from scipy.spatial import cKDTree

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.mesh.files import up_axis
from modalshell.sweep import load_sweep
from modalshell.sweep.plan import Plan

NEEDS_USD = pytest.mark.skipif(
    not importlib.util.find_spec("pxr"), reason="usd-core is not installed (pip install 'modalshell[interchange]')"
)
LAST = {name.split(".")[1][:3]: name for name in MESHES}
"""Format, all of USD being one -> the last file of it."""
ALL, FILMED = (
    [pytest.param(name, marks=NEEDS_USD if ".usd" in name else ()) for name in names]
    for names in (MESHES, LAST.values())
)


@pytest.mark.parametrize("name", ALL)
def test_every_file_is_the_sheet_in_metres_with_z_up(name, tmp_path):
    path, options = write(name, tmp_path)
    mesh = ms.load_mesh(path, **options)
    points, faces = curved_sheet()
    assert mesh.vertices.shape == points.shape
    assert len(mesh.faces) == len(faces)
    distance, own = cKDTree(points).query(mesh.vertices)
    assert distance.max() < 1e-6
    assert len(set(own.tolist())) == len(points)
    normals = np.cross(*np.moveaxis(mesh.vertices[mesh.faces[:, 1:]] - mesh.vertices[mesh.faces[:, :1]], 1, 0))
    up = np.cross(*np.moveaxis(points[faces[:, 1:]] - points[faces[:, :1]], 1, 0))[:, 2].mean()
    assert np.sign(normals[:, 2]).min() == np.sign(normals[:, 2]).max() == np.sign(up)


def test_there_are_twenty_of_every_format():
    assert len(MESHES) == 20
    assert {name.split(".")[1] for name in MESHES} == {"obj", "ply", "stl", "off", "glb", "usd", "usda", "usdc", "usdz"}


@pytest.mark.slow
@pytest.mark.parametrize("name", FILMED)
def test_every_format_gives_a_film_with_one_command(name, tmp_path, capsys):
    path, options = write(name, tmp_path)
    given = [part for key, value in options.items() for part in (f"--{key}", value)]
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(path), *given, "--duration", "0.1", "--out", str(tmp_path / "out")])
    said = capsys.readouterr()
    assert ended.value.code == 0, said.err
    assert f"{path.stem}_mwts.mp4" in {file.name for file in (tmp_path / "out").iterdir()}
    run = ms.load_trajectory(tmp_path / "out" / f"{path.stem}_mwts.npz")
    moved = np.linalg.norm(run.positions[-1] - run.rest_positions, axis=1).max()
    assert 1e-3 < moved < 1.0
    assert run.positions[-1, :, 2].mean() < run.rest_positions[:, 2].mean()  # it falls


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:192 boundary vertices", "ignore:modes")
def test_unshared_vertices_are_refused_by_a_name_that_helps(tmp_path, capsys):
    """OBJ, PLY and OFF keep their vertices apart, as parts may touch there: the option that joins them is named."""
    points, faces = curved_sheet()
    soup = "\n".join(
        ["OFF", f"{3 * len(faces)} {len(faces)} 0"]
        + [" ".join(map(str, point)) for point in points[faces].reshape(-1, 3)]
        + [f"3 {3 * k} {3 * k + 1} {3 * k + 2}" for k in range(len(faces))]
    )
    (tmp_path / "soup.off").write_text(soup)
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(tmp_path / "soup.off"), "--static", "--out", str(tmp_path)])
    assert ended.value.code == 2
    assert "--join" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(tmp_path / "soup.off"), "--join", "1e-6", "--static", "--out", str(tmp_path)])
    assert ended.value.code == 0


@NEEDS_USD
class TestUsd:
    def stage(self, tmp_path, text):
        (tmp_path / "a.usda").write_text("#usda 1.0\n" + text)
        return tmp_path / "a.usda"

    def test_a_stage_without_unit_or_axis_is_in_centimetres_with_y_up(self, tmp_path):
        """The definition of metersPerUnit and upAxis."""
        path = self.stage(
            tmp_path,
            'def Mesh "a" {\n int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 1, 2, 3]\n'
            " point3f[] points = [(0, 0, 0), (100, 0, 0), (100, 100, 0), (0, 100, 0)]\n}\n",
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            mesh = ms.load_mesh(path)
        assert up_axis(path) == "y"
        np.testing.assert_allclose(mesh.vertices.max(axis=0), [1, 0, 1])

    def test_scenes_in_millimetres_take_the_unit_of_the_file(self, tmp_path):
        write("plain.usda", tmp_path)
        scene = tmp_path / "a.toml"
        scene.write_text(
            '[units]\nlength = "mm"\n[mesh]\nfile = "plain.usda"\n[material]\nyoung = 1e6\npoisson = 0.3\n'
            'thickness = 1.0\ndensity = 1e-6\n[supports]\nclamped = "x < 1"\n[model]\nname = "ds"\n'
        )
        assert ms.load_scene(scene).build_mesh().vertices.max() == pytest.approx(600.0)
        joined = scene.read_text().replace("\n[material]", "\njoin = 0.1\n[material]")  # they were 0.1 m
        scene.write_text(joined + '[rest]\nfile = "plain.usda"\n')  # and this a sheet of 0.6 mm
        shell = ms.load_scene(scene).build_shell()
        assert shell.size == pytest.approx(600.0)
        assert shell.energy(shell.rest_positions) == pytest.approx(0.0, abs=1e-9)

    def test_sweeps_over_units_convert_each_mesh(self, tmp_path):
        """All had that of the first unit."""
        write("plain.usda", tmp_path)
        (tmp_path / "a.toml").write_text(
            '[mesh]\nfile = "plain.usda"\n[material]\nstretch = 20.0\nshear = 20.0\nflexure = 0.05\ndensity = 0.2\n'
            '[model]\nname = "rigid"\n'
        )
        (tmp_path / "s.toml").write_text('scene = "a.toml"\n[axes]\n"units.length" = ["m", "mm"]\n')
        sizes = [case.mesh.size for case in Plan(load_sweep(tmp_path / "s.toml")).cases]
        assert sizes == pytest.approx([0.6, 600.0])

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('def Sphere "a" {}\n', "no visible mesh with faces; its 1 other shapes"),
            ('def Mesh "a" {\n int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 5]\n'
             " point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]\n}\n", "mesh /a: faceVertexIndices must be from 0"),
            ('def Mesh "a" {\n int[] faceVertexCounts = [3, 2]\n int[] faceVertexIndices = [0, 1, 2]\n'
             " point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]\n}\n", "faceVertexCounts must be 3 or more"),
            ("def Mesh {", "damaged, cut short or not USD"),
            ("(\n metersPerUnit = -1\n)\n", "metersPerUnit must be above 0"),
        ],
    )  # fmt: skip
    def test_faults_are_named(self, tmp_path, text, message):
        with pytest.raises(ms.MeshError, match=message):
            ms.load_mesh(self.stage(tmp_path, text), up="z")

    def test_what_is_hidden_is_left_out_and_instances_are_in(self, tmp_path):
        triangle = (
            "int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n"
            ' point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]\n uniform token subdivisionScheme = "none"\n'
        )
        path = self.stage(
            tmp_path,
            '(\n metersPerUnit = 1\n upAxis = "Z"\n)\n'
            f'class Xform "Master" {{\n def Mesh "a" {{\n {triangle}}}\n}}\n'
            'def Xform "one" (\n instanceable = true\n inherits = </Master>\n) {\n}\n'
            'def Xform "two" (\n instanceable = true\n inherits = </Master>\n) {\n'
            ' double3 xformOp:translate = (5, 0, 0)\n uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
            f'def Mesh "hidden" {{\n {triangle}token visibility = "invisible"\n}}\n'
            f'def Mesh "guide" {{\n {triangle}uniform token purpose = "guide"\n}}\n',
        )
        mesh = ms.load_mesh(path)
        assert len(mesh.faces) == 2
        assert mesh.vertices[:, 0].max() == pytest.approx(6.0)

    def test_a_subdivision_surface_is_its_control_mesh_with_a_warning(self, tmp_path):
        path = self.stage(
            tmp_path,
            'def Mesh "a" {\n int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n'
            ' point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]\n uniform token subdivisionScheme = "loop"\n}\n',
        )
        with pytest.warns(ms.core.errors.ModalShellWarning, match="1 of 1 meshes are subdivision surfaces"):
            assert len(ms.load_mesh(path).faces) == 1

    @pytest.mark.parametrize("suffix", [".usdc", ".usda"])
    def test_what_is_cut_short_is_refused(self, tmp_path, suffix):
        path, _ = write("plain.usda" if suffix == ".usda" else "left_handed.usdc", tmp_path)
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])
        with pytest.raises(ms.MeshError, match="damaged, cut short or not USD"):
            ms.load_mesh(path)

    @pytest.mark.slow
    @pytest.mark.filterwarnings("ignore")
    @pytest.mark.parametrize("name", ["left_handed.usdc", "plain.usda", "packed_y.usdz"])
    def test_damaged_bytes_give_a_mesh_or_an_error_that_says_so(self, name, tmp_path):
        path, _ = write(name, tmp_path)
        data, random = path.read_bytes(), np.random.default_rng(0)
        for number in range(100):
            damaged = bytearray(data)
            for place in random.integers(len(data), size=random.integers(1, 9)):
                damaged[place] = random.integers(256)
            file = tmp_path / f"{number}_{name}"  # another name each: the library keeps what it has read
            file.write_bytes(damaged)
            with contextlib.suppress(ms.MeshError):  # any other error fails
                assert np.isfinite(ms.load_mesh(file).vertices).all()
