"""Sheets that touch without sharing vertices are named; those that share them, and cuts that are meant, are not."""

import warnings

import numpy as np
import pytest

from modalshell.core.errors import ModalShellWarning
from modalshell.mesh import TriangleMesh, load_mesh, repair, save_mesh
from modalshell.mesh.shapes import sheet
from modalshell.mesh.unjoined import _distances, unjoined


def ribbed(cells, rib_cells, shift=0.0):
    """A plate [0, 1]^2 with a rib along y = 0.5, as programs export parts: joined where edges meet."""
    plate, rib = sheet(length=1.0, width=1.0, cells=(cells, cells)), sheet(length=1.0, width=0.1, cells=(rib_cells, 1))
    upright = rib.vertices[:, [0, 2, 1]] + (0.0, 0.5 + shift, -rib.vertices[:, 1].min())
    vertices = np.vstack([plate.vertices - plate.vertices.min(axis=0), upright])
    faces = np.vstack([plate.faces, rib.faces + len(plate.vertices)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)
        return repair(vertices, faces, tolerance=1e-9)[0]


def turned(mesh):
    """The mesh in another place and direction, so that nothing lies on the axes."""
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)  # where the ends of a rib coincide with the plate
        return TriangleMesh(mesh.vertices @ turn.T + (3.0, -2.0, 5.0), mesh.faces)


@pytest.mark.parametrize(("cells", "rib_cells"), [(10, 13), (10, 5), (10, 20)])
def test_a_rib_whose_vertices_are_not_the_plates_is_found(cells, rib_cells):
    mesh = turned(ribbed(cells, rib_cells))
    vertices, faces = unjoined(mesh)
    # Where neither is a multiple of the other both rows of vertices lie on the other sheet, but for the shared ends.
    assert len(vertices) == {13: (13 - 1) + (10 - 1), 5: 5, 20: 10}[rib_cells]
    assert not (mesh.faces[faces] == vertices[:, None]).any()


def test_distances_from_triangles_are_those_of_their_sides_and_of_their_planes():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(200, 3, 3))
    corners[::2, 2] = corners[::2, :2].mean(axis=1) + 1e-6 * rng.normal(size=(100, 3))  # thin ones
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inside = np.einsum("kc,kcx->kx", rng.dirichlet(np.ones(3), 200), corners)
    middles, beyond = corners[:, :2].mean(axis=1), 2.0 * corners[:, 0] - inside
    np.testing.assert_allclose(_distances(corners, inside), 0.0, atol=1e-8)
    np.testing.assert_allclose(_distances(corners, inside + 0.3 * normals), 0.3, rtol=1e-8)
    np.testing.assert_allclose(_distances(corners, middles + 0.3 * normals), 0.3, rtol=1e-8)
    assert (_distances(corners, beyond) <= np.linalg.norm(beyond - corners[:, 0], axis=1) * (1.0 + 1e-12)).all()


def test_joined_parts_and_parts_apart_are_left_alone():
    for mesh in (ribbed(10, 10), ribbed(10, 13, shift=5.0), sheet(length=1.0, width=1.0, cells=(6, 6))):
        assert not len(unjoined(mesh)[0])


def test_files_warn(tmp_path):
    save_mesh(ribbed(10, 13), tmp_path / "rib.ply")
    with pytest.warns(ModalShellWarning) as given:
        load_mesh(tmp_path / "rib.ply")
    assert any("rib.ply: 21 vertices lie on triangles without being their corners" in str(one.message) for one in given)
