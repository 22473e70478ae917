"""Every mesh that cannot be a shell is refused with the fault and the first offending indices."""

import numpy as np
import pytest

from modalshell.core.errors import MeshError, ModalShellError, ModalShellWarning
from modalshell.mesh import TriangleMesh

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3]]
NAN = float("nan")

REFUSED = {
    "no vertices": (np.zeros((0, 3)), FACES, "no vertices"),
    "no faces": (SQUARE, np.zeros((0, 3), int), "no faces"),
    "empty list": ([], [], "no vertices"),
    "plane points": (np.array(SQUARE)[:, :2], FACES, r"shape \(n, 3\), got \(4, 2\); add the third coordinate"),
    "quads": (SQUARE, [[0, 1, 2, 3]], r"shape \(T, 3\), got \(1, 4\); split the quads"),
    "flat faces": (SQUARE, [0, 1, 2], r"shape \(T, 3\), got \(3,\)"),
    "ragged": ([[0, 0, 0], [1, 0]], FACES, "rows of unequal length"),
    "complex": (np.array(SQUARE) + 0j, FACES, "got dtype complex128"),
    "text": ([["a", "b", "c"]], FACES, "got dtype <U1"),
    "bool faces": (SQUARE, np.ones((2, 3), bool), "got dtype bool"),
    "nan": ([*SQUARE[:2], [1, NAN, 0], SQUARE[3]], FACES, r"vertex 2 \(counted from 0\) is not finite"),
    "two infinite": (
        [[np.inf, 0, 0], *SQUARE[1:3], [0, -np.inf, 0]],
        FACES,
        r"vertex 0 .* is not finite.*the first of 2",
    ),
    "huge": ([[1e200, 0, 0], *SQUARE[1:]], FACES, "vertex 0 .* overflow"),
    "half index": (SQUARE, [[0, 1, 2], [0, 2, 2.5]], r"face 1 .*whole numbers"),
    "nan index": (SQUARE, [[0, 1, NAN], [0, 2, 3]], r"face 0 .*whole numbers"),
    "out of range": (SQUARE, [[0, 1, 2], [0, 2, 9]], "face 1 names vertex 9, out of range .* 4 vertices, 0 to 3"),
    "negative": (SQUARE, [[0, 1, 2], [0, 2, -1]], "face 1 names vertex -1, out of range"),
    "repeated": (SQUARE, [[0, 1, 2], [0, 2, 2]], r"face 1, vertices \(0, 2, 2\) .*repeats a vertex"),
    "collinear": (
        [*SQUARE, [2, 0, 0]],
        [*FACES, [0, 1, 4]],
        r"face 2, vertices \(0, 1, 4\).*degenerate.*zero area",
    ),
    "coincident corners": ([*SQUARE, [1, 1, 0]], [*FACES, [1, 2, 4]], "face 2.*zero area"),
    "duplicate": (SQUARE, [*FACES, [2, 0, 1]], "face 2 is a duplicate of face 0"),
    "duplicate other side": (SQUARE, [*FACES, [3, 2, 0]], "face 2 is a duplicate of face 1"),
    "unused": ([*SQUARE, [5, 5, 5]], FACES, "vertex 4 .* belongs to no face"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    vertices, faces, message = REFUSED[case]
    with pytest.raises(MeshError, match=message) as caught:
        TriangleMesh(vertices, faces)
    assert isinstance(caught.value, ModalShellError)
    assert isinstance(caught.value, ValueError)


def moebius(count):
    turn = np.arange(count) / count
    half = np.pi * turn
    ring = np.column_stack((np.cos(2 * half), np.sin(2 * half), np.zeros(count)))
    across = 0.3 * np.column_stack((np.cos(half) * ring[:, 0], np.cos(half) * ring[:, 1], np.sin(half)))
    vertices = np.stack((ring - across, ring + across), axis=1).reshape(-1, 3)
    faces = []
    for i in range(count):
        a, b = 2 * i, 2 * i + 1
        c, d = (a + 2, b + 2) if i + 1 < count else (1, 0)
        faces += [(a, c, b), (b, c, d)]
    return vertices, faces


def test_moebius_strip():
    """It stays as it is, with one edge over which its winding turns; more of them are made one by flips."""
    vertices, faces = moebius(20)
    mesh = TriangleMesh(vertices, faces)
    assert len(mesh.seams) == 1
    np.testing.assert_array_equal(mesh.faces, faces)
    mixed = np.array(faces)
    mixed[::3] = mixed[::3, [0, 2, 1]]
    with pytest.warns(ModalShellWarning, match="flipped"):
        assert len(TriangleMesh(vertices, mixed).seams) == 1


def test_junctions():
    """Edges of any number of triangles, each of which is a wing; sheets are wound alike between them alone."""
    turns = 2.0 * np.pi * np.array([0.0, 0.3, 0.55, 0.8])
    vertices = np.vstack([[[0, 0, 0], [0, 0, 1]], np.column_stack([np.cos(turns), np.sin(turns), 0.5 + 0.0 * turns])])
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [1, 0, 5]])
    mesh = TriangleMesh(vertices, faces)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.edges[mesh.junctions], [[0, 1]])
    assert len(mesh.boundary_vertices) == 6
    first, others = mesh.hinge_faces[:, 0], mesh.hinge_faces[:, 1]
    assert sorted([first[0], *others]) == [0, 1, 2, 3]
    assert len(set(first)) == 1
    for hinge, other in zip(mesh.hinges, others, strict=True):
        assert tuple(hinge[[1, 0, 3]]) in {tuple(np.roll(mesh.faces[other], k)) for k in range(3)}
        assert set(hinge[:3]) == set(mesh.faces[first[0]])


def test_sheets_of_a_junction_that_lie_on_each_other_are_refused():
    vertices = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [2, 0, 0.5]]
    with pytest.raises(MeshError, match=r"faces 0 and 2 .* lie on each other at edge \(0, 1\), where 3 faces meet"):
        TriangleMesh(vertices, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])


@pytest.mark.parametrize("aspect", [1e3, 1e6])
@pytest.mark.parametrize("size", [1e-60, 1e-3, 1.0, 1e60])
def test_thin_triangles_are_accepted(aspect, size):
    mesh = TriangleMesh(size * np.array([[0, 0, 0], [1, 0, 0], [0.5, 1 / aspect, 0]]), [[0, 1, 2]])
    assert mesh.area == pytest.approx(0.5 * size**2 / aspect, rel=1e-9)


def test_integral_floats_and_small_dtypes_are_accepted():
    mesh = TriangleMesh(np.array(SQUARE, dtype=np.float32), np.array(FACES, dtype=float))
    assert mesh.faces.tolist() == FACES
    assert TriangleMesh(SQUARE, np.array(FACES, dtype=np.uint8)).faces.tolist() == FACES
