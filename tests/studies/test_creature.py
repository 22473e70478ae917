"""The creature in ``meshes/``: its file, and the script that makes it."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from modalshell import TriangleMesh, load_mesh
from modalshell.mesh import validation
from studies import creature as script
from studies.creature import FEET, quality

FILE = Path(__file__).resolve().parents[2] / "meshes" / "creature.ply"


@pytest.fixture(scope="module")
def creature():
    return load_mesh(FILE)


def boundary_loops(mesh):
    """Vertices of each closed loop of boundary edges."""
    rim = mesh.edges[mesh.edge_faces[:, 1] < 0]
    assert set(Counter(rim.ravel().tolist()).values()) == {2}
    label = {vertex: vertex for vertex in rim.ravel().tolist()}
    changed = True
    while changed:
        changed = False
        for a, b in rim.tolist():
            low = min(label[a], label[b])
            changed |= label[a] != low or label[b] != low
            label[a] = label[b] = low
    return [[vertex for vertex in label if label[vertex] == name] for name in set(label.values())]


def check_shell(mesh):
    assert mesh.components.max() == 0
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 2 - len(FEET)
    # The winding given is the consistent one: nothing was flipped while the mesh was built.
    validation.paired_edges(mesh.faces, len(mesh.vertices))
    loops = boundary_loops(mesh)
    assert len(loops) == len(FEET)
    for loop, (_, x, y) in zip(
        sorted(loops, key=lambda loop: mesh.vertices[loop].mean(axis=0)[0]), sorted(FEET, key=lambda foot: foot[1]),
        strict=True,
    ):  # fmt: skip
        assert np.all(mesh.vertices[loop, 2] == 0.0)
        np.testing.assert_allclose(mesh.vertices[loop, :2].mean(axis=0), (x, y), atol=0.03)
    assert np.flatnonzero(mesh.vertices[:, 2] <= 1e-9).tolist() == mesh.boundary_vertices.tolist()


def check_triangles(mesh):
    shapes, smallest = quality(mesh)
    assert shapes.mean() > 0.95
    assert shapes.min() > 0.6
    assert smallest.min() > 25.0
    assert mesh.edge_lengths.max() / mesh.edge_lengths.min() < 4.0


def volume(mesh):
    """The caps of the feet lie in the plane z = 0, through the origin, and add nothing."""
    first, second, third = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->", first, np.cross(second, third)) / 6.0


@pytest.mark.slow
def test_file(creature):
    assert FILE.stat().st_size < 1_000_000
    assert 12_500 <= len(creature.vertices) <= 13_500


def test_shell_open_at_the_feet_only(creature):
    check_shell(creature)


def test_triangles_near_equilateral(creature):
    check_triangles(creature)


def test_size_and_side(creature):
    low, high = creature.vertices.min(axis=0), creature.vertices.max(axis=0)
    np.testing.assert_allclose(high - low, (1.72, 0.44, 1.02), rtol=0.03)
    assert low[2] == 0.0
    assert creature.vertices[np.argmax(creature.vertices[:, 2]), 0] > 0.4  # the head is in front
    assert 0.08 < volume(creature) < 0.2


def test_rings_clamp(creature):
    """``z < something`` takes the rings, and some rows above them, of all four feet."""
    low = creature.vertices[creature.vertices[:, 2] < 0.02]
    assert {(bool(x > 0), bool(y > 0)) for x, y, _ in low} == {(a, b) for a in (False, True) for b in (False, True)}
    assert len(low) > len(creature.boundary_vertices)


@pytest.fixture
def coarser_grid(monkeypatch):
    """Distances are sampled at twice the spacing: as fine as coarse creatures need."""
    monkeypatch.setattr(script, "SPACING", 2.0 * script.SPACING)
    monkeypatch.setattr(script._scatter, "__defaults__", (30,))
    script._surface.cache_clear()
    yield
    script._surface.cache_clear()


@pytest.mark.slow
@pytest.mark.usefixtures("coarser_grid")
def test_script_makes_a_coarse_creature(creature):
    """And refuses to make one of fewer vertices than its shape needs."""
    coarse = script.make_creature(4000)
    assert isinstance(coarse, TriangleMesh)
    assert len(coarse.vertices) == 4000
    check_shell(coarse)
    check_triangles(coarse)
    assert volume(coarse) == pytest.approx(volume(creature), rel=0.02)
    with pytest.raises((RuntimeError, ValueError)):
        script.make_creature(600)
