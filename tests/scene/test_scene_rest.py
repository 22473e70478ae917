"""``[rest]`` and ``[[creases]]`` from scene files: the same shells as in Python, their results, and refusals."""

import json
import pickle

import numpy as np
import pytest
from scenes import stopped_and_resumed

import modalshell as ms
from modalshell.scene import load_scene

SCENE = """
[mesh]
file = "flat.obj"

[material]
young = 1e9
poisson = 0.3
thickness = 1e-3
density = 1000.0

[supports]
clamped = "x < 0.13"

[loads]
gravity = [0.0, 0.0, -1.0]

[model]
name = "ds"
"""
CREASES = """
[[creases]]
sel = "x > 0.49 and x < 0.51"
yield_moment = 0.02
hardening = 0.05
"""
MOTION = """
[motion]
duration = 0.5
dt = 0.05
"""


def files(tmp_path, text):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 1))
    ms.save_mesh(mesh, tmp_path / "flat.obj")
    x, y, _ = mesh.vertices.T
    ms.save_mesh(ms.TriangleMesh(np.column_stack([np.sin(x), y, np.cos(x) - 1.0]), mesh.faces), tmp_path / "bent.obj")
    np.save(tmp_path / "warm.npy", np.linspace(0.0, 10.0, len(mesh.faces)))
    file = tmp_path / "scene.toml"
    file.write_text(SCENE + text)
    return file


def scene(tmp_path, text):
    return load_scene(files(tmp_path, text))


@pytest.mark.parametrize(
    ("table", "given"),
    [
        ("prestrain = 1e-3", {"prestrain": 1e-3}),
        ("rest_curvature = [[1.0, 0, 0], [0, 0, 0], [0, 0, 0]]", {"rest_curvature": np.diag([1.0, 0.0, 0.0])}),
        ("change = 10.0\nthrough = 5.0\nexpansion = 1e-5", {"temperature": ms.Temperature(10.0, 1e-5, 5.0)}),
        (
            'change = "warm.npy"\nexpansion = 1e-5',
            {"temperature": ms.Temperature(np.linspace(0.0, 10.0, 16), 1e-5)},
        ),
        ('file = "bent.obj"', {"rest": "bent.obj"}),
    ],
)
def test_a_rest_shape_is_that_in_python(tmp_path, table, given):
    declared = scene(tmp_path, f"[rest]\n{table}\n")
    shell = declared.build_shell()
    if "rest" in given:
        given = {"rest": ms.load_mesh(tmp_path / given["rest"])}
    same = ms.Shell(shell.mesh, shell.material, clamped="x < 0.13", **given)
    assert shell.stressed
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).normal(size=shell.rest_positions.shape)
    assert shell.energy(x) == same.energy(x)
    assert declared.digests(shell.mesh)["scene"] != scene(tmp_path, "").digests(shell.mesh)["scene"]
    assert pickle.loads(pickle.dumps(declared)).content() == declared.content()


def test_the_digest_follows_the_file_at_rest(tmp_path):
    declared = scene(tmp_path, '[rest]\nfile = "bent.obj"\n')
    before = declared.content()
    mesh = ms.load_mesh(tmp_path / "bent.obj")
    ms.save_mesh(ms.TriangleMesh(1.01 * mesh.vertices, mesh.faces), tmp_path / "bent.obj")
    assert declared.content() != before


@pytest.mark.slow
def test_the_digest_follows_what_the_file_at_rest_reads_from_others(tmp_path):
    """A glTF file may keep its numbers in another one: results of what that held before were taken as its own."""
    declared = scene(tmp_path, '[rest]\nfile = "bent.gltf"\n')
    mesh = ms.load_mesh(tmp_path / "bent.obj")
    faces = mesh.faces.astype("<u4").tobytes()
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 12 * len(mesh.vertices)}]
    views.append({"buffer": 0, "byteOffset": 12 * len(mesh.vertices), "byteLength": len(faces)})
    points = {"bufferView": 0, "componentType": 5126, "count": len(mesh.vertices), "type": "VEC3"}
    corners = {"bufferView": 1, "componentType": 5125, "count": mesh.faces.size, "type": "SCALAR"}
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": "bent.bin", "byteLength": 12 * len(mesh.vertices) + len(faces)}],
        "bufferViews": views,
        "accessors": [points, corners],
    }
    (tmp_path / "bent.gltf").write_text(json.dumps(document))
    found = []
    for share in (1.0, 1.01, 1.0):
        (tmp_path / "bent.bin").write_bytes((share * mesh.vertices).astype("<f4").tobytes() + faces)
        found.append(declared.content())
    assert found[0] == found[2] != found[1]


@pytest.mark.slow
def test_creases_of_a_scene_are_those_in_python_and_its_results_keep_them(tmp_path):
    declared = scene(tmp_path, CREASES)
    shell = declared.build_shell()
    assert shell.creases.hinges.size == 1
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -1.0))
    result = ms.run_scene(declared, out=tmp_path / "still")
    assert np.array_equal(result.trajectory.crease_angles[0], answer.creases.angles)
    assert result.trajectory.crease_heat[0] == answer.creases.dissipated > 0.0
    assert pickle.loads(pickle.dumps(declared)).content() == declared.content()


def test_a_stopped_motion_with_creases_ends_as_one_that_was_not(tmp_path):
    declared = scene(tmp_path, CREASES + MOTION)
    whole, parts = (result.trajectory for result in stopped_and_resumed(declared, tmp_path, 6))
    assert whole.crease_heat[-1] > 0.0
    for name in ("positions", "energies", "crease_angles", "crease_heat"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name))


REFUSED = [
    ("[rest]\n", r"rest: the table must have file"),
    ('[rest]\nfile = "none.obj"\n', r"rest\.file: .*none\.obj: no such file"),
    ("[rest]\nchange = 10.0\n", r"rest\.expansion: must be given"),
    ("[rest]\nprestrain = [1.0, 2.0]\n", r"rest\.prestrain: must be a number, a symmetric tensor"),
    ('[rest]\nprestrain = "none.npy"\n', r"rest\.prestrain: must be a number"),
    ("[rest]\ncurvature = 1.0\n", r"rest\.curvature: unknown key; did you mean 'rest_curvature'"),
    ('[[creases]]\nsel = "x > 5"\nyield_moment = 1.0\n', r"creases\[0\]\.sel: selects no vertex"),
    ('[[creases]]\nsel = "x > 0.4"\n', r"creases\[0\]\.yield_moment: missing"),
    ('[[creases]]\nsel = "x > 0.4"\nyield_moment = -1.0\n', r"creases\[0\]\.yield_moment: must be"),
    ("[[creases]]\nsel = [[0, 99]]\nyield_moment = 1.0\n", r"creases\[0\]\.sel: names the pair \(0, 99\)"),
    ("[creases]\nyield_moment = 1.0\n", r"creases: must be a list of tables, \[\[creases\]\]"),
    (
        CREASES.replace('name = "ds"', "") + '[output]\nfolder = "x"\n' + CREASES,
        r"creases\[1\] has edge",
    ),
]


@pytest.mark.parametrize(("text", "words"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_refused_names_the_file_and_the_key(tmp_path, text, words):
    file = files(tmp_path, text)
    with pytest.raises(ms.ModalShellError, match=words):
        load_scene(file).build_shell()


def test_a_digest_of_numbers_that_are_not_there_names_the_key(tmp_path):
    """A sweep ended with what the system says."""
    with pytest.raises(ms.SceneError, match=r"rest\.prestrain: must be a number"):
        scene(tmp_path, '[rest]\nprestrain = "none.npy"\n').content()


def test_a_modal_model_refuses_a_scene_with_creases(tmp_path):
    file = files(tmp_path, CREASES)
    file.write_text(file.read_text().replace('name = "ds"', 'name = "mwts"\nmodes = 4'))
    with pytest.raises(ms.ModalShellError, match="a modal model knows no creases"):
        load_scene(file).build()
