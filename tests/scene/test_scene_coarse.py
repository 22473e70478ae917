"""Coarse meshes that scenes ask for: of shapes by their cells, of mesh files by remeshing."""

import importlib.util

import numpy as np
import pytest

import modalshell as ms
from modalshell.compare.candidates import candidates
from modalshell.compare.case import scene_case
from modalshell.scene.coarse import scene_coarse_meshes

SHAPE = ('shape = "v_beam"\ncells = [12, 4]', 'shape = "v_beam"\ncells = [40, 8]')
FILE = (SHAPE[0], 'file = "meshes/v_beam.obj"')

SHEET = (
    "stretch = 20.0\nshear = 20.0\nflexure = 0.05\ndensity = 0.2",
    "young = 1e6\npoisson = 0.3\nthickness = 0.01\ndensity = 20.0",
)
STIFF = ("stretch = 20.0\nshear = 20.0", "stretch = 2000.0\nshear = 2000.0")


def coarse_faces(scene):
    return len(scene.build().model.coarse.shell.mesh.faces)


@pytest.mark.by_default("-160", "cells = [10, 4]-80")
@pytest.mark.parametrize(("declared", "count"), [("", 160), ("triangles = 90", 120), ("cells = [10, 4]", 80)])
def test_a_generated_shape_needs_no_library(scene_file, monkeypatch, declared, count):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    scene = ms.load_scene(scene_file(SHAPE, ('"mwts"', f'"coarse-ds"\n{declared}')))
    assert coarse_faces(scene) == count


def test_a_mesh_file_says_what_it_needs(scene_file, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for declared in ("", "triangles = 90"):
        scene = ms.load_scene(scene_file(FILE, ('"mwts"', f'"coarse-ds"\n{declared}')))
        with pytest.raises(ms.SceneError, match=r"model: .*modalshell\[remesh\]"):
            scene.build()
    assert scene_coarse_meshes(scene.mesh, scene.material, scene.build_shell()) == []


@pytest.mark.parametrize("name", ["coarse-ds", "hybrid"])
@pytest.mark.parametrize(
    ("mesh", "declared", "said"),
    [
        (FILE, "cells = [10, 4]", "model.cells: .*give triangles"),
        (SHAPE, "cells = [10, 4]\ntriangles = 100", "model.cells: must be left out with triangles"),
        (SHAPE, "triangles = 640", "model.triangles: must be fewer than the 640"),
        (FILE, "triangles = 640", "model.triangles: must be fewer than the 640"),
        (SHAPE, "triangles = 0", "model.triangles"),
        (SHAPE, "cells = [44, 8]", "model.cells: must make at most the 640 triangles of the shell .*704"),
        (SHAPE, "cells = [3000, 3000]", "model.cells: must make at most the 640 triangles of the shell .*make more"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(scene_file, name, mesh, declared, said):
    with pytest.raises(ms.SceneError, match=said):
        ms.load_scene(scene_file(mesh, ('"mwts"', f'"{name}"\n{declared}'))).build()


@pytest.mark.by_default("cells0-4", "cells1-6")
@pytest.mark.parametrize(("cells", "count"), [((2, 1), 4), ((3, 1), 6), ((2, 2), 8), ((10, 3), 60)])
def test_a_coarse_shell_of_few_cells_is_no_finer_than_the_shell(scene_file, cells, count):
    shape = (SHAPE[0], f'shape = "flat_beam"\ncells = [{cells[0]}, {cells[1]}]')
    assert coarse_faces(ms.load_scene(scene_file(shape, SHEET, ('"mwts"', '"coarse-ds"')))) <= count
    more = ms.load_scene(scene_file(shape, SHEET, ('"mwts"', f'"coarse-ds"\ntriangles = {count - 1}')))
    with pytest.raises(
        ms.SceneError, match=r"model\.triangles: must be fewer, or left out: the nearest cells, .* make"
    ):
        more.build()


def test_a_mesh_file_is_remeshed(scene_file):
    pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (pip install 'modalshell[remesh]')")
    for declared, count in (("", 160), ("triangles = 100", 100)):
        scene = ms.load_scene(scene_file(FILE, ('"mwts"', f'"coarse-ds"\n{declared}')))
        assert coarse_faces(scene) == pytest.approx(count, rel=0.3)
    shell = scene.build_shell()
    found = scene_coarse_meshes(scene.mesh, scene.material, shell)
    assert [mesh.options["triangles"] for mesh in found] == [160, 71, 40]
    theory = ms.load_scene(scene_file(FILE, SHEET, ('"mwts"', '"coarse-ds"\ntriangles = 100')))
    assert isinstance(theory.build().model.coarse.shell.material, ms.Isotropic)


@pytest.mark.slow
def test_comparisons_of_a_mesh_file_try_coarse_shells_that_a_scene_can_name(scene_file):
    pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (pip install 'modalshell[remesh]')")
    found, left_out = candidates(scene_case(ms.load_scene(scene_file(FILE))), (4,))
    tables = [one.model_table for one in found if one.spec.on_coarse_mesh]
    assert tables == [
        {"name": "hybrid", "triangles": 160},
        *({"name": "coarse-ds", "triangles": count} for count in (160, 71, 40)),
    ]
    assert not left_out


@pytest.mark.slow
def test_a_hybrid_of_a_mesh_file_is_trained_on_its_remeshed_surface(scene_file):
    pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (pip install 'modalshell[remesh]')")
    text = scene_file(FILE, STIFF, ('"mwts"', '"hybrid"\ntriangles = 100\nmotions = 4\nmodes = 12'), ("-9.81", "-2.0"))
    built = ms.load_scene(text).build()
    assert len(built.model.coarse.coarse.shell.mesh.faces) < 160
    answer = built.model.equilibrium(gravity=(0, 0, -2.0))
    exact = ms.DiscreteShell(built.shell).equilibrium(gravity=(0, 0, -2.0))
    assert ms.measure.displacement_error(answer.positions, exact.positions, built.shell) < 0.05


@pytest.mark.slow
def test_creases_and_fields_of_a_scene_go_to_its_coarse_shell(tmp_path):
    pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (pip install 'modalshell[remesh]')")
    curvatures = ", ".join(["2.0"] * 128)
    text = f"""
    [mesh]
    shape = "flat_beam"
    length = 0.4
    width = 0.1
    cells = [16, 4]
    [material]
    young = 3e9
    poisson = 0.3
    thickness = [{", ".join(["2e-4"] * 64 + ["3e-4"] * 64)}]
    density = 800.0
    [[supports]]
    kind = "clamp"
    sel = "x < 1e-9"
    [rest]
    rest_curvature = [{curvatures}]
    [[creases]]
    sel = "abs(x - 0.2) < 1e-6"
    yield_moment = 1e-3
    hardening = 1e-3
    [model]
    name = "coarse-ds"
    size
    """
    sizes = {"triangles = 60": 60, "cells = [8, 2]": 32}
    for size, count in sizes.items():
        path = tmp_path / "strip.toml"
        path.write_text(text.replace("size\n", f"{size}\n"), encoding="utf-8")
        shell = ms.load_scene(path).build().model.coarse_shell
        assert len(shell.mesh.faces) == pytest.approx(count, rel=0.2)
        assert set(np.unique(shell.material.thickness).round(9)) == {2e-4, 3e-4}
        np.testing.assert_allclose(shell.options["rest_curvature"], 2.0)
        edges = shell.mesh.hinge_edges[shell.creases.hinges]
        assert shell.mesh.edge_lengths[edges].sum() == pytest.approx(0.1)
    path.write_text(text.replace("size\n", "cells = [7, 2]\n"), encoding="utf-8")
    with pytest.raises(ms.SceneError, match=r"edges along creases\[0\]"):
        ms.load_scene(path).build()
