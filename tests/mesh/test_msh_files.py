"""Meshes of Gmsh: what Gmsh 4.15 wrote of two rectangles that share an edge, as text and in binary."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import modalshell as ms

DATA = Path(__file__).resolve().parents[1] / "data" / "gmsh"
needs_meshio = pytest.mark.skipif(
    not importlib.util.find_spec("meshio"), reason="meshio is not installed (pip install 'modalshell[msh]')"
)


@needs_meshio
@pytest.mark.parametrize("name", ["text_2", "text_4", "binary_2", "binary_4"])
def test_triangles_and_quadrangles_of_all_groups_are_one_shell(name):
    mesh = ms.load_mesh(DATA / f"{name}.msh", unit="mm")
    assert (len(mesh.vertices), len(mesh.faces), len(mesh.boundary_vertices)) == (15, 16, 12)
    assert mesh.face_areas.sum() == pytest.approx(0.04 * 0.01)
    assert set(mesh.vertices[:, 0].round(9)) == {0.0, 0.01, 0.02, 0.03, 0.04}
    assert mesh.face_normals[:, 2].min() > 0.0


@needs_meshio
def test_numbers_of_nodes_may_have_gaps(tmp_path):
    path = tmp_path / "sparse.msh"
    nodes = "7 0 0 0\n40 1 0 0\n9 0 1 0\n"
    path.write_text(
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n{nodes}$EndNodes\n"
        "$Elements\n2\n1 15 2 0 1 7\n2 2 2 0 1 7 40 9\n$EndElements\n"
    )
    mesh = ms.load_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for wrong, match in (("7 40 8", "a node that the file does not have"), ("7 40 9000", "stopped with IndexError")):
        path.write_text(path.read_text().replace("7 40 9\n", f"{wrong}\n"))
        with pytest.raises(ms.MeshError, match=match):
            ms.load_mesh(path)
        path.write_text(path.read_text().replace(f"{wrong}\n", "7 40 9\n"))
    path.write_text(path.read_text().replace("\n7 0", "\n0 0").replace(" 7", " 0"))
    with pytest.raises(ms.MeshError, match=r"sparse\.msh: nodes must be counted from 1"):
        ms.load_mesh(path)


@needs_meshio
def test_what_is_no_shell_of_triangles_and_quadrangles_is_refused(tmp_path):
    with pytest.raises(ms.MeshError, match=r"solid\.msh: the file holds a solid .*24 triangle, 24 tetra"):
        ms.load_mesh(DATA / "solid.msh")
    with pytest.raises(ms.MeshError, match=r"nodes on their sides .*triangle6.*gmsh -order 1"):
        ms.load_mesh(DATA / "second_order.msh")
    curves = tmp_path / "curves.msh"
    whole = (DATA / "text_2.msh").read_text().split("$Elements")[0]
    curves.write_text(whole + "$Elements\n1\n1 1 2 2 4 4 1\n$EndElements\n")
    with pytest.raises(ms.MeshError, match=r"no triangles or quadrangles; .*physical groups"):
        ms.load_mesh(curves)


@needs_meshio
@pytest.mark.parametrize("name", ["text_4", "binary_4", "text_2", "binary_2"])
def test_files_cut_short_are_refused(name, tmp_path):
    data = (DATA / f"{name}.msh").read_bytes()
    whole = data.index(b"$EndElements")
    for size in np.linspace(1, whole - 6, 12).astype(int):
        cut = tmp_path / "cut.msh"
        cut.write_bytes(data[:size])
        with pytest.raises(ms.MeshError, match=r"cut\.msh: (the file is cut short|no MSH file of Gmsh)"):
            ms.load_mesh(cut)
    middle = (data.index(b"$Nodes") + data.index(b"$EndNodes")) // 2
    cut.write_bytes(data[:middle] + data[middle + 40 :])
    with pytest.raises(ms.MeshError, match=r"cut\.msh: the file is damaged, cut short or not of Gmsh"):
        ms.load_mesh(cut)


def test_without_meshio_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(ms.MeshError, match=r"text_4\.msh: MSH files need meshio.*pip install 'modalshell\[msh\]'"):
        ms.load_mesh(DATA / "text_4.msh")
