"""Parametric shapes and mesh families: areas, geometry, topology, quality."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from modalshell.core.errors import OptionError
from modalshell.mesh import cylinder_panel, flat_beam, leaf, sheet, v_beam
from modalshell.mesh.leaf_shape import half_outline
from modalshell.mesh.lloyd import signed_areas
from modalshell.mesh.triangulate import FAMILIES, rectangle

LATTICES = ("alternating", "union-jack", "right")
SHAPES = (flat_beam, v_beam, sheet, cylinder_panel, leaf)


def quality(mesh):
    """1 for equilateral triangles, 0 for degenerate ones."""
    corners = mesh.vertices[mesh.faces]
    sides = ((corners[:, [1, 2, 0]] - corners) ** 2).sum(axis=(1, 2))
    return 4 * np.sqrt(3) * mesh.face_areas / sides


@pytest.mark.by_default("cells0-alternating", "cells1-delaunay", "cells3-equilateral", "cells4-union-jack")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("cells", [(1, 1), (1, 4), (3, 1), (4, 2), (7, 5), (12, 6)])
def test_rectangle_is_filled_exactly(family, cells):
    points, faces = rectangle(1.3, 0.7, cells, family)
    areas = signed_areas(points, faces)
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(1.3 * 0.7, rel=1e-13)
    assert points.min(axis=0).tolist() == [0.0, 0.0]
    assert points.max(axis=0).tolist() == [1.3, 0.7]


@pytest.mark.parametrize("family", LATTICES)
def test_lattice_numbering(family):
    points, faces = rectangle(4.0, 3.0, (4, 3), family)
    for i in range(5):
        for j in range(4):
            np.testing.assert_allclose(points[i * 4 + j], (i, j))
    assert len(faces) == 24


def test_diagonals_alternate():
    _, faces = rectangle(2.0, 2.0, (2, 2), "alternating")
    assert (np.bincount(faces.ravel())[4], len(faces)) == (8, 8)  # every diagonal meets in the centre
    _, faces = rectangle(2.0, 2.0, (2, 2), "right")
    assert np.bincount(faces.ravel())[4] == 6
    np.testing.assert_array_equal(
        rectangle(3.0, 1.0, (6, 3), "union-jack")[1], rectangle(3.0, 1.0, (6, 3), "alternating")[1]
    )


def test_equilateral_columns():
    points, _ = rectangle(3.0 * np.sqrt(3) / 2, 4.0, (3, 4), "equilateral")
    columns = [points[np.isclose(points[:, 0], i * np.sqrt(3) / 2), 1].tolist() for i in range(4)]
    assert columns[0] == columns[2] == [0, 1, 2, 3, 4]
    assert columns[1] == columns[3] == [0, 0.5, 1.5, 2.5, 3.5, 4]
    mesh = flat_beam(length=6 * np.sqrt(3) / 2, width=6.0, cells=(6, 6), family="equilateral")
    assert np.isclose(quality(mesh), 1.0).sum() == len(mesh.faces) - 12  # all but the half triangles on the sides


@pytest.mark.slow
def test_lloyd_is_isotropic_and_repeatable():
    mesh = sheet(cells=(20, 17), family="lloyd")
    assert quality(mesh).min() > 0.7
    assert quality(mesh).mean() > 0.95
    np.testing.assert_array_equal(mesh.vertices, sheet(cells=(20, 17), family="lloyd").vertices)
    side = np.unique(mesh.vertices[mesh.vertices[:, 1] == -0.5, 0])
    np.testing.assert_allclose(side, np.linspace(0, 1, 21))


@pytest.mark.slow
def test_delaunay_is_unstructured_and_repeatable():
    mesh = sheet(cells=(24, 24), family="delaunay")
    assert quality(mesh).min() > 0.6
    assert quality(mesh).mean() > 0.93
    np.testing.assert_array_equal(mesh.vertices, sheet(cells=(24, 24), family="delaunay").vertices)
    inside = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.boundary_vertices)
    neighbours = np.bincount(mesh.edges.ravel(), minlength=len(mesh.vertices))[inside]
    assert neighbours.min() >= 4
    assert neighbours.max() <= 8
    assert np.mean((neighbours >= 5) & (neighbours <= 7)) > 0.97
    assert np.mean(neighbours == 6) < 0.7
    lloyd = sheet(cells=(24, 24), family="lloyd")
    assert len(mesh.vertices) == len(lloyd.vertices)


@pytest.mark.by_default("flat_beam-alternating", "v_beam-right", "sheet-union-jack", "cylinder_panel-equilateral")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_is_a_disc_facing_up(shape, family):
    mesh = shape(cells=(10, 6), family=family)
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 1
    assert mesh.components.max() == 0
    assert mesh.face_normals[:, 2].min() > 0.3
    assert quality(mesh).min() > 0.15


@pytest.mark.by_default("alternating", "union-jack", "right")
@pytest.mark.parametrize("family", FAMILIES)
def test_flat_beam_and_sheet(family):
    mesh = flat_beam(length=2.0, width=0.5, cells=(16, 5), family=family)
    assert mesh.area == pytest.approx(1.0, rel=1e-13)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), (0, -0.25, 0))
    np.testing.assert_allclose(mesh.vertices.max(axis=0), (2, 0.25, 0))
    np.testing.assert_array_equal(mesh.face_normals[:, 2], 1.0)
    assert sheet(family=family).area == pytest.approx(1.0, rel=1e-13)


@pytest.mark.by_default("60.0-right", "150.0-equilateral", "150.0-union-jack", "180.0-alternating")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("fold", [60.0, 150.0, 180.0])
def test_v_beam_geometry(family, fold):
    mesh = v_beam(length=1.0, width=0.2, fold=fold, cells=(20, 6), family=family)
    half = np.radians(fold / 2)
    assert mesh.area == pytest.approx(0.2, rel=1e-12)  # the developed area
    t = np.abs(mesh.vertices[:, 1]) / np.sin(half)
    np.testing.assert_allclose(mesh.vertices[:, 2], -t * np.cos(half), atol=1e-15)
    assert t.max() == pytest.approx(0.1)
    ridge = mesh.vertices[:, 1] == 0
    np.testing.assert_allclose(np.sort(mesh.vertices[ridge, 0]), np.linspace(0, 1, 21), atol=1e-15)
    on_ridge = ridge[mesh.edges].all(axis=1)
    assert mesh.edge_lengths[on_ridge].sum() == pytest.approx(1.0)
    # Mirror symmetry of the vertices, to the bit.
    mirror = mesh.vertices * (1, -1, 1)
    assert {tuple(v) for v in (mirror + 0.0).tolist()} == {tuple(v) for v in (mesh.vertices + 0.0).tolist()}


@pytest.mark.parametrize("family", LATTICES)
@pytest.mark.parametrize("across", [2, 4, 6])
def test_v_beam_is_the_lattice_of_the_developed_sheet(family, across):
    mesh, flat = (shape(cells=(5, across), family=family) for shape in (v_beam, flat_beam))
    np.testing.assert_array_equal(mesh.faces, flat.faces)
    unfolded = v_beam(fold=180.0, cells=(5, across), family=family)
    np.testing.assert_allclose(unfolded.vertices, flat.vertices, atol=1e-15)
    assert (np.diff(mesh.vertices[: across + 1, 1]) > 0).all()


def test_cylinder_panel():
    mesh = cylinder_panel(length=2.0, radius=0.6, angle=90.0, cells=(20, 40))
    np.testing.assert_allclose(np.hypot(mesh.vertices[:, 1], mesh.vertices[:, 2]), 0.6)
    assert mesh.vertices[:, 2].max() == pytest.approx(0.6)
    assert mesh.area == pytest.approx(2.0 * 0.6 * np.pi / 2, rel=2e-4)
    outward = mesh.vertices[mesh.faces].mean(axis=1) * (0, 1, 1)
    assert (np.einsum("ij,ij->i", outward, mesh.face_normals) > 0).all()
    assert len(cylinder_panel(angle=300.0).boundary_vertices) == 80


@pytest.mark.parametrize("family", FAMILIES)
def test_leaf(family):
    mesh = leaf(fold=180.0, camber=0.0, curl=0.0, cells=(32, 12), family=family)
    np.testing.assert_array_equal(mesh.vertices[:, 2], 0.0)
    s = np.linspace(0, 1, 33)
    assert mesh.area == pytest.approx(0.4 * (half_outline(s)[1:] + half_outline(s)[:-1]).sum() / 64, rel=1e-12)
    assert (mesh.vertices[:, 0] == 1.0).sum() == 1  # a pointed tip
    assert quality(mesh).min() > 0.4
    stalk = mesh.vertices[mesh.vertices[:, 0] == 0.0, 1]
    assert np.ptp(stalk) == pytest.approx(0.08)
    assert len(stalk) >= 3
    curled = leaf(family=family)
    assert curled.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-12)
    assert curled.vertices[np.argmax(curled.vertices[:, 0]), 2] < -0.1
    np.testing.assert_allclose(curled.edge_lengths.min(), mesh.edge_lengths.min(), rtol=0.2)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(
    length=st.floats(0.1, 10),
    width=st.floats(0.1, 10),
    columns=st.integers(1, 9),
    rows=st.integers(1, 4),
    family=st.sampled_from(FAMILIES),
)
def test_any_rectangle(length, width, columns, rows, family):
    try:
        mesh = v_beam(length=length, width=width, fold=120.0, cells=(columns, 2 * rows), family=family)
    except OptionError:
        assume(family not in ("lloyd", "delaunay"))  # may refuse cells far from square
        raise
    assert mesh.area == pytest.approx(length * width, rel=1e-9)
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 1


@pytest.mark.parametrize(
    ("shape", "options", "message"),
    [
        (flat_beam, {"length": 0.0}, r"length must be a finite number above 0 .*got 0\.0"),
        (flat_beam, {"width": float("nan")}, "width must be"),
        (flat_beam, {"length": "1"}, "length must be"),
        (flat_beam, {"cells": (0, 3)}, r"cells\[0\] must be a positive integer"),
        (flat_beam, {"cells": (2.5, 3)}, r"cells\[0\] must be"),
        (flat_beam, {"cells": 4}, "cells must be"),
        (flat_beam, {"cells": (True, 2)}, r"cells\[0\] must be"),
        (flat_beam, {"family": "hexagon"}, "family must be one of 'alternating', .*got 'hexagon'"),
        (flat_beam, {"family": None}, "family must be .*got None"),
        (v_beam, {"cells": (4, 3)}, r"cells\[1\] must be even .* got 3; use 4"),
        (v_beam, {"fold": 0.0}, "fold must be a finite number above 0 and at most 180"),
        (v_beam, {"fold": 181.0}, "fold must be"),
        (v_beam, {"fold": float("nan")}, "fold must be"),
        (cylinder_panel, {"angle": 360.0}, "below 360"),
        (cylinder_panel, {"angle": -1.0}, "angle must be"),
        (cylinder_panel, {"radius": -1.0}, "radius must be"),
        (leaf, {"cells": (3, 4)}, "at least 4 cells along"),
        (leaf, {"cells": (8, 5)}, "even number across"),
        (leaf, {"camber": -0.1}, "camber must be .*at least 0 and at most 1"),
        (leaf, {"curl": 200.0}, "curl must be .*at least 0 and at most 180"),
    ],
)
def test_bad_options(shape, options, message):
    with pytest.raises(OptionError, match=message):
        shape(**options)


def test_a_leaf_takes_fractions():
    """Found by fuzzing: numbers that NumPy does not know."""
    halves = leaf(curl=Fraction(41, 2), camber=Fraction(1, 8))
    np.testing.assert_array_equal(halves.vertices, leaf(curl=20.5, camber=0.125).vertices)
