import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modalshell import Material, Shell, TriangleMesh, cylinder_panel, sheet
from modalshell.core.errors import OptionError, SupportError
from modalshell.mesh.selection import select_vertices, selected

POINTS = np.array([[0.0, 0.0, 0.0], [0.5, -1.0, 2.0], [1.0, 1.0, -3.0]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x < 0.1", [True, False, False]),
        ("x <= 0.5 and y < 0", [False, True, False]),
        ("not (x < 0.1) or z > 5", [False, True, True]),
        ("0.2 < x < 0.7", [False, True, False]),
        ("abs(z) >= 2", [False, True, True]),
        ("x + 2*y - z/2 < -2", [False, True, False]),
        ("-x > -0.2", [True, False, False]),
        ("1 < 2", [True, True, True]),
    ],
)
def test_selects_what_the_text_says(text, expected):
    assert select_vertices(text, POINTS).tolist() == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "x <",
        "w < 1",
        "x == 1",
        "__import__('os').system('true')",
        "x.real < 1",
        "x[0] < 1",
        "(lambda: 1)() < x",
        "x < 'a'",
        "x < True",
        "x ** 9 < 1",
        "abs(x, y) < 1",
        "x < 1; y < 2",
        "x < " + "(" * 500 + "1" + ")" * 500,
        "x <" + " 1" * 2000,
    ],
)
def test_refuses_what_is_no_comparison_of_coordinates(text):
    with pytest.raises(OptionError):
        select_vertices(text, POINTS)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="xyz<>=+-*/()0123456789. andort_abs[]'", max_size=40))
def test_any_text_selects_or_is_refused(text):
    try:
        mask = select_vertices(text, POINTS)
    except OptionError:
        return
    assert mask.shape == (3,)
    assert mask.dtype == bool


def test_parts_of_a_mesh_are_selected():
    ring = sheet(cells=(6, 6))
    centres = ring.vertices[ring.faces].mean(axis=1)
    hole = TriangleMesh.from_soup(ring.vertices, ring.faces[np.abs(centres - [0.5, 0, 0]).max(axis=1) > 0.2])
    x, y, _ = hole.vertices.T
    outer = (x < 1e-9) | (x > 1 - 1e-9) | (np.abs(y) > 0.5 - 1e-9)
    assert (select_vertices("boundary(0)", hole) == outer).all()
    assert (select_vertices("boundary(0) or boundary(1)", hole) == select_vertices("boundary", hole)).all()
    assert not (select_vertices("boundary(1)", hole) & outer).any()
    with pytest.raises(OptionError, match="whole number below 2"):
        select_vertices("boundary(2)", hole)
    assert np.flatnonzero(select_vertices("nearest(1, 0.5, 9)", hole)).tolist() == [int(np.argmax(x + y))]
    assert (select_vertices("box(0, -1, -1, 0.4, 0, 1)", hole) == ((x <= 0.4) & (y <= 0))).all()
    faces = np.vstack([hole.faces, hole.faces + x.size])
    two = TriangleMesh(np.vstack([hole.vertices, 0.5 * hole.vertices + 9]), faces)
    assert (select_vertices("component(1)", two) == (np.arange(2 * x.size) >= x.size)).all()
    panel = cylinder_panel(cells=(8, 4), angle=90.0)
    normals = select_vertices("angle(0, 0, 1) < 20 or angle(0, 0, -1) < 20", panel)
    assert 0 < normals.sum() < len(panel.vertices)
    assert select_vertices("angle(0, 0, 1) < 1", ring).all() or select_vertices("angle(0, 0, 1) > 179", ring).all()


@pytest.mark.parametrize("text", ["boundary", "component(0)", "angle(0, 0, 1) < 9"])
def test_points_have_no_parts(text):
    with pytest.raises(OptionError, match="without a mesh"):
        select_vertices(text, np.zeros((3, 3)))


@pytest.mark.parametrize(
    "chosen", [[0, 1, 1, 0], [[True, False], [True, True]], [[0, True]], [True, False], [9], [0.5]], ids=repr
)
def test_entries_that_are_no_vertices_are_refused(chosen):
    square = sheet(cells=(1, 1))
    with pytest.raises(OptionError, match=r"^sel "):
        selected("sel", chosen, square)
    with pytest.raises(SupportError, match=r"^clamped "):
        Shell(square, Material(1.0, 1.0, 1.0, 1.0), chosen)


def test_edges_select_their_ends():
    square = sheet(cells=(2, 2))
    edges = square.edges[:2]
    assert (np.flatnonzero(selected("sel", edges, square)) == np.unique(edges)).all()
    with pytest.raises(SupportError, match=r"^clamped "):
        Shell(square, Material(1.0, 1.0, 1.0, 1.0), edges)
