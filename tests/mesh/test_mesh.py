"""TriangleMesh: topology, hinges, measures, welding."""

import warnings

import numpy as np
import pytest
from counting import lines_run
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from modalshell.core.errors import MeshError, ModalShellWarning
from modalshell.mesh import TriangleMesh, flat_beam, sheet, v_beam
from modalshell.mesh.triangulate import FAMILIES

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def fold_angles(mesh):
    x0, x1, x2, x3 = (mesh.vertices[mesh.hinges[:, k]] for k in range(4))
    e = x1 - x0
    n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    along = np.einsum("ij,ij->i", np.cross(n1, n2), e) / np.linalg.norm(e, axis=1)
    return np.arctan2(along, np.einsum("ij,ij->i", n1, n2))


def test_two_triangles_by_hand():
    mesh = TriangleMesh([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert mesh.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    assert mesh.face_edges.tolist() == [[0, 3, 1], [1, 4, 2]]
    assert mesh.edge_faces.tolist() == [[0, -1], [1, 0], [1, -1], [0, -1], [1, -1]]
    assert mesh.hinges.tolist() == [[0, 2, 3, 1]]
    assert mesh.hinge_edges.tolist() == [1]
    np.testing.assert_allclose(mesh.edge_lengths, [2, np.sqrt(5), 1, 1, 2])
    np.testing.assert_allclose(mesh.face_areas, [1, 1])
    assert mesh.area == 2.0
    np.testing.assert_array_equal(mesh.face_normals, [[0, 0, 1], [0, 0, 1]])
    assert mesh.boundary_vertices.tolist() == [0, 1, 2, 3]
    assert repr(mesh) == "TriangleMesh(4 vertices, 2 faces, 5 edges, 4 boundary vertices)"


def test_closed_surface():
    mesh = TriangleMesh(TETRAHEDRON, OUTWARD)
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 2
    assert len(mesh.hinges) == len(mesh.edges) == 6
    assert len(mesh.boundary_vertices) == 0
    # Convex with outward normals: every fold has one sign.
    assert (np.sign(fold_angles(mesh)) == np.sign(fold_angles(mesh)[0])).all()
    centre = mesh.vertices[mesh.faces].mean(axis=1) - 0.25
    assert (np.einsum("ij,ij->i", centre, mesh.face_normals) > 0).all()


def test_components():
    vertices = np.vstack((TETRAHEDRON, TETRAHEDRON + 5.0))
    mesh = TriangleMesh(vertices, np.vstack((OUTWARD + 4, OUTWARD)))
    assert mesh.components.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("family", FAMILIES)
def test_hinges_agree_with_faces_and_are_flat(family):
    mesh = flat_beam(cells=(8, 4), family=family)
    np.testing.assert_allclose(fold_angles(mesh), 0.0, atol=1e-12)
    np.testing.assert_array_equal(mesh.edges[mesh.hinge_edges], mesh.hinges[:, :2])
    faces = {tuple(np.roll(f, -k)) for f in mesh.faces.tolist() for k in range(3)}
    for (x0, x1, x2, x3), edge in zip(mesh.hinges.tolist(), mesh.hinge_edges.tolist(), strict=True):
        assert (x0, x1, x2) in faces
        assert (x1, x0, x3) in faces
        first, second = mesh.edge_faces[edge]
        assert {x0, x1, x2} == set(mesh.faces[first].tolist())
        assert {x0, x1, x3} == set(mesh.faces[second].tolist())
        corners = mesh.edge_corners[edge]
        assert np.roll(mesh.faces[first], -corners[0]).tolist() == [x0, x1, x2]
        assert np.roll(mesh.faces[second], -corners[1]).tolist() == [x1, x0, x3]


def test_corners_of_boundary_edges():
    mesh = flat_beam(cells=(8, 4), family="union-jack")
    rim = np.flatnonzero(mesh.edge_faces[:, 1] < 0)
    assert (mesh.edge_corners[rim, 1] == -1).all()
    np.testing.assert_array_equal(mesh.face_edges[mesh.edge_faces[rim, 0], mesh.edge_corners[rim, 0]], rim)


def test_fold_angle_of_a_v():
    mesh = v_beam(fold=150.0, cells=(6, 2))
    ridge = (mesh.vertices[mesh.hinges[:, :2], 1] == 0).all(axis=1)
    np.testing.assert_allclose(np.abs(fold_angles(mesh)[ridge]), np.radians(30.0), rtol=1e-12)
    np.testing.assert_allclose(fold_angles(mesh)[~ridge], 0.0, atol=1e-12)


def test_arrays_are_read_only_copies():
    vertices, faces = TETRAHEDRON.copy(), OUTWARD.copy()
    mesh = TriangleMesh(vertices, faces)
    vertices[0], faces[0] = 9.0, 0
    assert mesh.vertices[0, 0] == 0.0
    assert mesh.faces[0].tolist() == [0, 2, 1]
    for name in (
        "vertices",
        "faces",
        "edges",
        "hinges",
        "edge_faces",
        "edge_corners",
        "face_areas",
        "face_normals",
        "components",
    ):
        assert not getattr(mesh, name).flags.writeable, name
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    with pytest.raises(AttributeError):
        mesh.vertices = vertices


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.randoms(use_true_random=False), st.sampled_from(FAMILIES))
def test_face_order_does_not_matter(random, family):
    mesh = v_beam(cells=(5, 4), family=family)
    order = list(range(len(mesh.faces)))
    random.shuffle(order)
    roll = [random.randrange(3) for _ in order]
    other = TriangleMesh(mesh.vertices, [np.roll(mesh.faces[t], r) for t, r in zip(order, roll, strict=True)])
    np.testing.assert_array_equal(other.edges, mesh.edges)
    np.testing.assert_array_equal(other.hinges, mesh.hinges)
    np.testing.assert_array_equal(other.hinge_edges, mesh.hinge_edges)
    np.testing.assert_array_equal(other.boundary_vertices, mesh.boundary_vertices)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.sets(st.integers(0, 39), min_size=1, max_size=19))
def test_flipped_faces_are_mended(flips):
    mesh = flat_beam(cells=(5, 4), family="alternating")
    faces = mesh.faces.copy()
    rows = sorted(flips)
    faces[rows] = faces[rows][:, [0, 2, 1]]
    with pytest.warns(ModalShellWarning, match=rf"flipped {len(rows)} of 40 faces \(first: face {rows[0]}, "):
        mended = TriangleMesh(mesh.vertices, faces)
    np.testing.assert_array_equal(mended.faces, mesh.faces)


def test_mending_keeps_the_majority_of_each_component():
    shifted = TETRAHEDRON + 5.0
    faces = np.vstack((OUTWARD, OUTWARD + 4))
    faces[[0, 5, 6, 7]] = faces[[0, 5, 6, 7]][:, [0, 2, 1]]  # one of four, and three of four
    with pytest.warns(ModalShellWarning, match="flipped 2 of 8"):
        mesh = TriangleMesh(np.vstack((TETRAHEDRON, shifted)), faces)
    np.testing.assert_array_equal(mesh.faces[:4], OUTWARD)
    np.testing.assert_array_equal(mesh.faces[4:], OUTWARD[:, [0, 2, 1]] + 4)


def test_seam_warns_and_weld_joins():
    left = flat_beam(length=0.5, cells=(4, 4))
    vertices = np.vstack((left.vertices, left.vertices + np.array([0.5, 0.0, 0.0])))
    faces = np.vstack((left.faces, left.faces + len(left.vertices)))
    with pytest.warns(ModalShellWarning, match=r"10 boundary vertices .* first vertices 20 and 25 .*mesh\.weld\(\)"):
        open_mesh = TriangleMesh(vertices, faces)
    mesh = open_mesh.weld()
    assert len(mesh.vertices) == 45
    assert mesh.components.max() == 0
    assert mesh.area == pytest.approx(0.2, rel=1e-14)
    np.testing.assert_array_equal(mesh.vertices[:25], left.vertices)


def test_weld_drops_collapsed_faces_and_their_vertices():
    mesh = flat_beam(length=1.0, width=1.0, cells=(2, 2))
    vertices = np.vstack((mesh.vertices, [[1.001, -0.5, 0.0]]))
    corner = int(np.flatnonzero((mesh.vertices[:, 0] == 1.0) & (mesh.vertices[:, 1] == -0.5))[0])
    edge = next(e for e in mesh.edges.tolist() if corner in e and mesh.vertices[e, 0].min() == 1.0)
    faces = np.vstack((mesh.faces, [*sorted(edge, key=lambda i: i != corner), len(mesh.vertices)]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)
        sliver = TriangleMesh(vertices, faces)
    welded = sliver.weld(0.01)
    np.testing.assert_array_equal(welded.faces, mesh.faces)
    np.testing.assert_array_equal(welded.vertices, mesh.vertices)
    with pytest.raises(MeshError, match="tolerance must be"):
        mesh.weld(-1.0)
    with pytest.raises(MeshError, match="all 8 faces collapse"):
        mesh.weld(10.0)


@pytest.mark.parametrize("middles", [[0.5], [0.25, 0.75], [0.2, 0.4, 0.6, 0.8]])
def test_from_soup_mends_flat_faces_without_a_crack(middles):
    """Two triangles over one edge, with faces without area between points of that edge: the edge is split there."""
    line = [(0.0, 0.0, 0.0), *((at, 0.0, 0.0) for at in middles), (1.0, 0.0, 0.0)]
    end, above, below = len(line) - 1, len(line), len(line) + 1
    vertices = np.array([*line, (0.5, 1.0, 0.0), (0.5, -1.0, 0.0)])
    upper = [(i, i + 1, above) for i in range(end)]
    flat = [(0, i + 1, i) for i in range(1, end)]  # a fan along the line, from its first point
    faces = np.array([*upper, *flat, (0, below, end)])
    with pytest.raises(MeshError, match=r"degenerate.*ms\.repair"):
        TriangleMesh(vertices, faces)
    mesh = TriangleMesh.from_soup(vertices, faces)
    assert mesh.area == pytest.approx(1.0, rel=1e-14)
    assert len(mesh.faces) == 2 * end
    assert len(mesh.boundary_vertices) == 4
    assert (mesh.face_normals[:, 2] == 1.0).all()


def test_from_soup_drops_flat_faces_on_the_rim():
    vertices = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.5, 0.0, 0.0), (2.0, 0.0, 0.0)])
    mesh = TriangleMesh.from_soup(vertices, [(0, 1, 2), (1, 3, 4)])
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert len(mesh.vertices) == 3


def test_from_soup():
    mesh = v_beam(cells=(6, 4))
    soup = mesh.vertices[mesh.faces].reshape(-1, 3)
    joined = TriangleMesh.from_soup(soup, np.arange(len(soup)).reshape(-1, 3))
    assert (len(joined.vertices), len(joined.edges)) == (len(mesh.vertices), len(mesh.edges))
    np.testing.assert_array_equal(joined.vertices[joined.faces], mesh.vertices[mesh.faces])


def test_no_line_of_python_runs_for_each_triangle():
    counts = []
    for cells in (8, 48):
        mesh = sheet(cells=(cells, cells))
        counts.append(lines_run(lambda mesh=mesh: TriangleMesh(mesh.vertices, mesh.faces).hinges))
    assert counts[0] > 10
    assert counts[1] < counts[0] + 50  # of 36 times as many triangles, 4,480 more


@pytest.mark.parametrize(
    "make", [sheet, v_beam, lambda: TriangleMesh(TETRAHEDRON, OUTWARD)], ids=["flat", "v", "closed"]
)
def test_axes_turn_with_the_mesh(make):
    mesh, turn = make(), Rotation.from_rotvec([0.4, 2.1, -0.7]).as_matrix()
    turned = TriangleMesh(mesh.vertices @ turn.T + [1.0, 2.0, 3.0], mesh.faces)
    assert mesh.axes @ mesh.axes.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(mesh.axes) == pytest.approx(1.0)
    assert turned.axes == pytest.approx(mesh.axes @ turn.T, abs=1e-12)


def test_vertices_in_one_place_show_no_axis():
    """The second vertex is where the first one is, of another sheet."""
    vertices = np.vstack([TETRAHEDRON[:3], TETRAHEDRON[:3]])[[0, 3, 1, 2, 4, 5]]
    with pytest.warns(ModalShellWarning):
        mesh = TriangleMesh(vertices, [[0, 2, 3], [1, 4, 5]])
    np.testing.assert_array_equal(mesh.axes, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_axes_of_a_flat_sheet_are_those_of_the_world():
    np.testing.assert_array_equal(sheet().axes, np.eye(3))
