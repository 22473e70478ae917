"""Coarse meshes of any surface: remeshed with an edge where the clamps end, prolonged to the fine mesh."""

import importlib.util

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.models.coarse import coarse_mesh
from modalshell.models.coarse.coarse_mesh import places_on, remeshed_to_supports
from modalshell.models.coarse.profile_step import profile_step
from modalshell.models.coarse.prolongation import Prolongation
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import models
from modalshell.modes.rigid import rigid_motions

MATERIAL = ms.Material(20.0, 20.0, 0.05, 0.2)


@pytest.fixture
def meshlab():
    pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (pip install 'modalshell[remesh]')")


@pytest.fixture(scope="module")
def leaf():
    mesh = ms.load_mesh("meshes/leaf.obj")
    return ms.Shell(mesh, MATERIAL, mesh.vertices[:, 0] < 0.1)


def test_without_meshlab_it_says_how_to_get_it(leaf, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(ms.OptionError, match=r"modalshell\[remesh\]"):
        ms.coarse_shell(leaf, 200)


@pytest.mark.slow
@pytest.mark.usefixtures("meshlab")
def test_a_leaf_of_a_file_is_followed_on_half_of_its_triangles(leaf):
    coarse = ms.CoarseDiscreteShell(leaf, ms.coarse_shell(leaf, 300))
    assert profile_step(coarse.coarse.shell) is not None
    assert len(coarse.coarse.shell.free) < 0.6 * len(leaf.free)
    truth = ms.DiscreteShell(leaf).equilibrium(gravity=(0, 0, -10))
    answer = coarse.equilibrium(gravity=(0, 0, -10))
    assert np.abs(truth.positions - leaf.rest_positions).max() > 0.3
    assert ms.measure.displacement_error(answer.positions, truth.positions, leaf) < 0.03


@pytest.mark.slow
@pytest.mark.usefixtures("meshlab")
def test_the_clamp_ends_where_that_of_the_shell_does():
    mesh = ms.v_beam(cells=(40, 8))
    shell = ms.Shell(mesh, MATERIAL, mesh.vertices[:, 0] < 0.13)
    coarse = ms.coarse_shell(shell, 150)
    held = coarse.clamped
    line = mesh.vertices[shell.clamped, 0].max()
    assert coarse.mesh.vertices[held, 0].max() == pytest.approx(line)
    assert coarse.mesh.vertices[~held, 0].min() > line + 0.01
    assert rigid_motions(coarse).shape[1] == 0
    edges = coarse.mesh.edges[coarse.mesh.hinge_edges]
    clamping = (coarse.mesh.vertices[edges, 0] > line - 1e-9).all(axis=1) & held[edges].all(axis=1)
    lengths = np.linalg.norm(np.diff(coarse.mesh.vertices[edges[clamping]], axis=1), axis=2)
    assert lengths.sum() == pytest.approx(0.2, rel=1e-6)  # the whole width
    assert coarse.mass.sum() == pytest.approx(shell.mass.sum(), rel=0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("meshlab")
def test_hinged_supports_and_single_points_keep_their_vertices():
    mesh = ms.sheet(length=1.0, width=0.7, cells=(20, 14))
    middle = mesh.vertices.mean(axis=0)
    corners = (np.abs(mesh.vertices - middle)[:, :2] > 0.49 * np.ptp(mesh.vertices, axis=0)[:2]).all(axis=1)
    assert corners.sum() == 4
    shell = ms.Shell(mesh, MATERIAL, corners)
    coarse = ms.coarse_shell(shell, 200)
    np.testing.assert_allclose(
        np.unique(coarse.mesh.vertices[coarse.clamped].round(9), axis=0), np.unique(mesh.vertices[corners], axis=0)
    )


def test_clamped_points_and_lines_inside_get_vertices(monkeypatch):
    sizes = {"length": 1.0, "width": 0.8}
    mesh = ms.sheet(**sizes, cells=(20, 16))
    monkeypatch.setattr(coarse_mesh, "remesh", lambda _mesh, count: ms.sheet(**sizes, cells=(count // 16, 4)))
    x = np.array(mesh.vertices)
    line = np.abs(x[:, 0] - 0.55) < 1e-9
    nearest = [np.argmin(np.linalg.norm(x[:, :2] - place, axis=1)) for place in ((0.2, 0.3), (0.8, 0.55))]
    for held in (line, np.isin(np.arange(len(x)), nearest)):
        coarse = ms.coarse_shell(ms.Shell(mesh, MATERIAL, held), 128)
        own = coarse.mesh.vertices[coarse.clamped]
        distance = np.linalg.norm(own[:, None] - x[held], axis=2)
        np.testing.assert_allclose(distance.min(axis=1), 0.0, atol=1e-12)
        assert distance.min(axis=0).max() < 0.15  # no clamped vertex far from a coarse one
    middle = np.linalg.norm(x - x.mean(axis=0), axis=1) < 1e-9
    two = ms.TriangleMesh(
        [[0.0, -0.4, 0.0], [1.0, -0.4, 0.0], [1.0, 0.4, 0.0], [0.1, 0.3, 0.0]], [[0, 1, 2], [0, 2, 3]]
    )
    monkeypatch.setattr(coarse_mesh, "remesh", lambda *_: two)
    with pytest.raises(ms.SupportError, match="no place on a mesh so coarse"):
        ms.coarse_shell(ms.Shell(mesh, MATERIAL, middle), 128)  # it lies on the edge across from the nearest vertex


@pytest.mark.by_default("panel", "leaf")
@pytest.mark.usefixtures("meshlab")
@pytest.mark.parametrize("name", ["flat", "folded", "panel", "leaf"])
def test_prolongation_from_meshes_that_are_not_nested(name, leaf):
    """Exact for affine fields where the rest shape is flat by patches, for rigid motions on any."""
    mesh = {
        "flat": lambda: ms.sheet(cells=(16, 16)),
        "folded": lambda: ms.v_beam(cells=(40, 8), fold=120.0),
        "panel": lambda: ms.cylinder_panel(cells=(16, 16)),
        "leaf": lambda: leaf.mesh,
    }[name]()
    under = ms.remesh(mesh, len(mesh.faces) // 4)
    prolongation = Prolongation(under, mesh)
    np.testing.assert_allclose(prolongation.prolong(np.array(under.vertices)), mesh.vertices, atol=1e-12)
    turn, shift = Rotation.from_rotvec([0.4, 2.0, -1.0]), np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(
        prolongation.prolong(turn.apply(np.array(under.vertices)) + shift),
        turn.apply(np.array(mesh.vertices)) + shift,
        atol=1e-10,
    )
    if name in ("flat", "folded"):
        strain = np.eye(3) + np.random.default_rng(0).uniform(-0.5, 0.5, (3, 3))
        np.testing.assert_allclose(
            prolongation.prolong(under.vertices @ strain + shift), mesh.vertices @ strain + shift, atol=1e-10
        )
    load = np.random.default_rng(1).standard_normal(mesh.vertices.shape)
    np.testing.assert_allclose(prolongation.restrict(load).sum(axis=0), load.sum(axis=0), atol=1e-9)


def test_prolongation_turns_with_the_mesh_where_one_cell_lies_across_a_flange():
    """Two rows of vertices do not tell all quadratic fields apart."""
    fine, under = (ms.v_beam(length=0.6, width=0.2, fold=140.0, cells=cells) for cells in ((8, 4), (4, 2)))
    bent = under.vertices + 0.01 * np.random.default_rng(0).standard_normal(under.vertices.shape)
    turn = Rotation.from_rotvec([0.7, -1.1, 0.4])
    meshes = (ms.TriangleMesh(mesh.vertices @ turn.as_matrix().T, mesh.faces) for mesh in (under, fine))
    found = turn.inv().apply(Prolongation(*meshes).prolong(turn.apply(bent)))
    np.testing.assert_allclose(found, Prolongation(under, fine).prolong(bent), rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("meshlab")
def test_a_hybrid_is_trained_on_a_remeshed_shell(leaf):
    load = leaf.gravity_force((0, 0, -4.0))
    factory = ModelFactory(leaf, lambda: load)
    model = factory.build(models()["hybrid"], {"triangles": 200, "motions": 8, "modes": 16})
    assert len(model.coarse.coarse.shell.mesh.faces) < 300
    answer = model.equilibrium(gravity=(0, 0, -4.0))
    own = model.coarse.equilibrium(gravity=(0, 0, -4.0))
    assert answer.converged
    assert ms.measure.displacement_error(answer.positions, own.positions, leaf) < 0.03


@pytest.mark.slow
@pytest.mark.usefixtures("meshlab")
def test_a_membrane_that_hardly_matters_is_not_scaled_far():
    """Between its straight edges a panel bends in its lowest mode; another membrane would not hold its load as well."""
    mesh = ms.cylinder_panel(cells=(24, 24))
    across = np.abs(mesh.vertices[:, 1])
    shell = ms.Shell(mesh, MATERIAL, across > across.max() - 1e-9)
    coarse = ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, 400))
    exact, answer = (model.equilibrium(gravity=(0, 0, -10)) for model in (ms.DiscreteShell(shell), coarse))
    assert ms.measure.displacement_error(answer.positions, exact.positions, shell) < 0.22  # 0.24 with both scaled
    assert coarse.coarse.shell.material.stretch == MATERIAL.stretch


def test_sizes_that_are_none_are_refused(leaf):
    count = len(leaf.mesh.faces)
    for given in (count, 10 * count, 0, -3, True, 2.5, "400", None):
        with pytest.raises(ms.OptionError):
            ms.coarse_shell(leaf, given)
    with pytest.raises(ms.OptionError, match="number of triangles"):
        ModelFactory(leaf).build(models()["coarse-ds"], {})
    mesh = ms.sheet(cells=(4, 4))
    with pytest.raises(ms.SupportError):
        remeshed_to_supports(ms.Shell(mesh, MATERIAL, np.ones(len(mesh.vertices), dtype=bool)), 10)


def test_a_mesh_without_a_row_where_the_clamp_ends_is_said_to_be_longer():
    """Under its weight a strip of one clamped cell of sixteen hung down by a third more on a mesh of eight."""
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=500.0)
    shell = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(16, 4)), material, clamped="x < 0.07")
    with pytest.warns(ms.ModalShellWarning, match=r"6\.7% more free surface than the fine one: 0 m\^2 are clamped"):
        ms.coarse_shell(shell, ms.flat_beam(length=1.0, width=0.2, cells=(8, 2)))
    row = np.array([0.0, *np.linspace(1.0 / 16.0, 1.0, 9)])
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(9, 2))
    moved = np.array(mesh.vertices)
    moved[:, 0] = np.interp(moved[:, 0], np.linspace(0.0, 1.0, 10), row)
    assert ms.coarse_shell(shell, ms.TriangleMesh(moved, mesh.faces)).clamped.sum() == 2 * len(np.unique(moved[:, 1]))


@pytest.mark.by_default("5-2")
@pytest.mark.parametrize(("fine", "cells"), [(5, 2), (7, 3)])
def test_a_coarse_vertex_as_near_to_held_as_to_free_ones_is_held_whichever_way_the_mesh_is_turned(fine, cells):
    kept = []
    for turn in Rotation.random(8, random_state=0).as_matrix():
        surface, below = (ms.sheet(cells=(k, k)) for k in (fine, cells))
        held = surface.vertices[:, 0] < 2.0 / fine + 1e-6
        turned, coarse = (ms.TriangleMesh(mesh.vertices @ turn.T, mesh.faces) for mesh in (surface, below))
        shell = ms.Shell(turned, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), held)
        kept.append(places_on(shell, coarse)[2])
    assert kept[0].any()
    assert np.all(np.array(kept) == kept[0])


@pytest.mark.usefixtures("meshlab")
@pytest.mark.parametrize("which", ["folded base", "half an edge", "four corners"])
def test_clamped_lines_on_the_boundary_keep_their_ends_and_corners(which):
    """Without the middle of its folded base a leaf's lowest frequency was 0.6 of its own, and 1.12 with it."""
    mesh = ms.leaf() if which == "folded base" else ms.sheet(cells=(16, 16))
    x, y, _ = mesh.vertices.T
    ends = np.isin(x, (x.min(), x.max())) & np.isin(y, (y.min(), y.max()))
    held = {"folded base": x < 1e-9, "half an edge": (x == x.min()) & (y < 0.4), "four corners": ends}[which]
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=500.0), held)
    coarse = ms.coarse_shell(shell, 150)
    last = held & ((y == y[held].min()) | (y == y[held].max()) | (which == "folded base"))
    taken = coarse.rest_positions[coarse.clamped]
    assert cKDTree(taken).query(mesh.vertices[last])[0].max() < 1e-9 * mesh.size
