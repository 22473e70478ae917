"""Remeshed surfaces: as many triangles as asked, nearly equilateral, on the same surface with the same boundary."""

import importlib.util

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main


def quality(mesh):
    """4 sqrt(3) times the area over the squared edges, of each triangle: 1 where equilateral."""
    lengths = mesh.edge_lengths[mesh.face_edges]
    return 4.0 * np.sqrt(3.0) * mesh.face_areas / (lengths**2).sum(axis=1)


def test_remeshing_says_what_it_needs(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(ms.OptionError, match=r"modalshell\[remesh\]"):
        ms.remesh(ms.sheet(cells=(4, 4)), 20)


@pytest.fixture
def meshlab():
    pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (pip install 'modalshell[remesh]')")


@pytest.mark.usefixtures("meshlab")
@pytest.mark.parametrize("asked", [300, 4000])
def test_a_folded_strip_keeps_its_boundary_and_its_ridge(asked):
    mesh = ms.v_beam(cells=(40, 8))
    made = ms.remesh(mesh, asked)
    assert abs(len(made.faces) / asked - 1.0) < 0.1
    assert np.median(quality(made)) > 0.9
    assert quality(made).min() > 0.3
    assert made.area == pytest.approx(mesh.area, rel=1e-6)
    np.testing.assert_allclose(np.ptp(made.vertices, axis=0), np.ptp(mesh.vertices, axis=0), rtol=1e-6)
    ridge = np.abs(made.vertices[:, [1, 2]]).max(axis=1) < 1e-9
    assert np.ptp(made.vertices[ridge, 0]) == pytest.approx(1.0)
    again = ms.remesh(mesh, asked)
    np.testing.assert_array_equal(made.vertices, again.vertices)


@pytest.mark.usefixtures("meshlab")
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_does_not_matter(unit):
    mesh = ms.cylinder_panel(cells=(20, 20))
    made = ms.remesh(ms.TriangleMesh(unit * mesh.vertices, mesh.faces), 300)
    assert abs(len(made.faces) / 300 - 1.0) < 0.1
    assert made.area / unit**2 == pytest.approx(mesh.area, rel=0.01)


@pytest.mark.usefixtures("meshlab")
def test_a_count_out_of_reach_is_told():
    with pytest.warns(ms.ModalShellWarning, match="triangles, not 4"):
        ms.remesh(ms.cylinder_panel(cells=(20, 20)), 4)
    with pytest.raises(ms.OptionError, match="memory"):
        ms.remesh(ms.sheet(cells=(4, 4)), 2**31 - 1)


@pytest.mark.usefixtures("meshlab")
def test_the_command_line_meshes_anew(tmp_path, capsys):
    source, out = tmp_path / "beam.ply", tmp_path / "coarse.ply"
    ms.save_mesh(ms.v_beam(cells=(40, 8)), source)
    with pytest.raises(SystemExit) as stop:
        main(["repair", str(source), "--out", str(out), "--triangles", "200"])
    assert not stop.value.code
    assert "remeshed" in capsys.readouterr().out
    assert len(ms.load_mesh(out).faces) < 260
