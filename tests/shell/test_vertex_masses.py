"""Vertex masses as weights of integrals: moments of inertia, orders, symmetry planes, folds, and bounds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import modalshell as ms
from modalshell.shell.vertex_masses import vertex_masses

FAMILIES = ["union-jack", "equilateral", "delaunay", "lloyd", "alternating"]


def masses(mesh):
    return vertex_masses(mesh, np.ones(len(mesh.faces)), np.zeros(len(mesh.vertices), dtype=bool))


def thirds(mesh):
    return mesh.shared_among_corners(mesh.face_areas)


def strip(family, across):
    stretch = 2.0 / np.sqrt(3.0) if family == "equilateral" else 1.0
    return ms.flat_beam(length=1.0, width=0.2, cells=(round(5 * across * stretch), across), family=family)


@pytest.mark.by_default("alternating")
@pytest.mark.parametrize("family", FAMILIES)
def test_the_rotary_inertia_of_a_strip(family):
    """12 I = m w^2; thirds are 1 / 8 too large on squares of four cells across."""
    errors = []
    for across in (4, 8):
        mesh = strip(family, across)
        inertia = masses(mesh) @ mesh.vertices[:, 1] ** 2
        errors.append(abs(inertia / (mesh.area * 0.2**2 / 12.0) - 1.0))
        plain = thirds(mesh) @ mesh.vertices[:, 1] ** 2 / (mesh.area * 0.2**2 / 12.0) - 1.0
        assert errors[-1] < 0.35 * plain
    assert errors[0] < 0.035
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.by_default("180.0-union-jack", "180.0-equilateral", "120.0-lloyd", "120.0-alternating")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("fold", [180.0, 120.0])
def test_linear_functions_are_integrated_exactly(family, fold):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=(20, 8), family=family)
    mass = masses(mesh)
    assert mass.sum() == pytest.approx(mesh.area, rel=1e-13)
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    np.testing.assert_allclose(mass @ mesh.vertices, mesh.face_areas @ centroids, atol=1e-4 * mesh.area * mesh.size)


def test_a_sharp_fold_ends_the_smoothness():
    """Flanges of a V have the masses of strips of their own; a slight bend has those of the flat sheet."""
    halves, whole = (ms.v_beam(length=1.0, width=0.2, fold=fold, cells=(20, 8)) for fold in (120.0, 180.0))
    flange = ms.flat_beam(length=1.0, width=0.1, cells=(20, 4))
    across = np.linalg.norm(halves.vertices[:, 1:], axis=1)
    second = masses(flange) @ (flange.vertices[:, 1] + 0.05) ** 2
    assert masses(halves) @ across**2 == pytest.approx(2.0 * second, rel=1e-9)
    slight = ms.v_beam(length=1.0, width=0.2, fold=170.0, cells=(20, 8))
    np.testing.assert_allclose(masses(slight), masses(whole), atol=0.01 * thirds(whole).max())
    assert np.abs(masses(halves) - masses(whole)).max() > 0.1 * thirds(whole).max()


@pytest.mark.parametrize("fold", [180.0, 170.0, 150.0])
def test_half_of_a_symmetric_sheet_has_half_of_its_masses(fold):
    """With a plane of symmetry along the ridge, smooth or sharp."""
    whole = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=(20, 8), family="union-jack")
    kept = (whole.vertices[whole.faces][:, :, 1] > -1e-12).all(axis=1)
    used = np.unique(whole.faces[kept])
    half = ms.TriangleMesh(whole.vertices[used], np.searchsorted(used, whole.faces[kept]))
    plane = ms.Symmetry(half.vertices[:, 1] < 1e-12, normal=(0, 1, 0))
    found = vertex_masses(half, np.ones(len(half.faces)), np.zeros(len(used), dtype=bool), [plane])
    expected = masses(whole)[used] * np.where(half.vertices[:, 1] < 1e-12, 0.5, 1.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    shell = ms.Shell(half, ms.Isotropic(1e9, 0.3, 1e-3, 1000.0), supports=[plane])
    np.testing.assert_allclose(shell.mass, found, rtol=1e-12)


@pytest.mark.slow
@given(st.integers(0, 10_000), st.floats(0.0, 0.45))
def test_masses_are_positive_and_keep_their_sum(seed, noise):
    mesh = ms.sheet(cells=(5, 4))
    rng = np.random.default_rng(seed)
    density = rng.uniform(0.5, 2.0, len(mesh.faces))
    vertices = mesh.vertices + noise * mesh.edge_lengths.min() * rng.uniform(-1.0, 1.0, mesh.vertices.shape)
    moved = ms.TriangleMesh(vertices, mesh.faces)
    held = rng.random(len(vertices)) < 0.2
    found, plain = vertex_masses(moved, density, held), moved.shared_among_corners(density * moved.face_areas)
    assert (found >= 0.2499 * plain).all()
    assert found.sum() == pytest.approx(plain.sum(), rel=1e-12)
    turned = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turned *= np.linalg.det(turned)
    other = ms.TriangleMesh(vertices @ turned.T + 3.0, mesh.faces)
    np.testing.assert_allclose(vertex_masses(other, density, held), found, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("family", ["union-jack", "equilateral", "delaunay"])
def test_twist_of_a_narrow_strip_on_four_cells(family):
    """The first torsional frequency of a free strip is that of a fine mesh within 2 %; thirds were 5 % too low."""
    frequencies = []
    for across in (4, 16):
        shell = ms.Shell(strip(family, across), ms.Isotropic(1e9, 0.3, 1e-3, 1000.0))
        frequencies.append(ms.solve_modes(shell, 10).frequencies[6:])
    np.testing.assert_allclose(frequencies[0], frequencies[1], rtol=0.02)
