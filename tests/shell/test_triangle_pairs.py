"""Pairs of triangles that bend together, and the errors of plates that they leave."""

import numpy as np
import pytest
import scipy.sparse.linalg as spla
from scipy.spatial.transform import Rotation

from modalshell import Clamp, Isotropic, Pin, Shell, TriangleMesh, cylinder_panel, sheet, solve_modes, v_beam
from modalshell.shell import split_folds as split_folds_module
from modalshell.shell.bending import hinge_operator
from modalshell.shell.kernels import split_folds as kernels
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.split_folds import split_folds
from modalshell.shell.triangle_pairs import MEAN_WEIGHT, fold_moments, moments_of_triangles, paired_triangles
from studies.obstacle_course import loaded_plate, middle

FAMILIES = ["union-jack", "equilateral", "delaunay"]


def pairs_of(mesh, rigidity=None, bends=None):
    count = len(mesh.faces)
    inner = mesh.edge_faces[:, 1] >= 0
    every = np.ones(count, dtype=bool) if bends is None else bends
    ones = np.ones(count) if rigidity is None else rigidity
    return paired_triangles(
        mesh, ones, np.full(count, 0.3), every, inner & np.append(every, False)[mesh.edge_faces].all(1)
    )


@pytest.mark.parametrize("family", FAMILIES)
def test_every_triangle_bends_once_and_most_in_pairs(family):
    mesh = sheet(cells=(12, 10), family=family)
    bends = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0.3
    faces, corners = pairs_of(mesh, bends=bends)
    np.testing.assert_array_equal(np.sort(faces[faces >= 0]), np.flatnonzero(bends))
    paired = faces[:, 1] >= 0
    assert paired.sum() > 0.35 * bends.sum()
    # Opposite the two corners lies the same edge.
    ends = [
        np.sort(np.stack([mesh.faces[faces[paired, k], (corners[paired, k] + turn) % 3] for turn in (1, 2)]), axis=0)
        for k in (0, 1)
    ]
    np.testing.assert_array_equal(*ends)


def test_no_pair_across_sharp_folds_jumps_and_slender_triangles():
    sharp = v_beam(cells=(8, 4), fold=100.0)
    faces, _ = pairs_of(sharp)
    both = faces[faces[:, 1] >= 0]
    normals = sharp.face_normals[both]
    assert np.sum(normals[:, 0] * normals[:, 1], axis=1).min() > np.cos(np.radians(20.0))
    flat = sheet(cells=(6, 6))
    stiff = np.where(flat.vertices[flat.faces].mean(axis=1)[:, 0] > 0.4, 8.0, 1.0)
    both = pairs_of(flat, rigidity=stiff)[0]
    both = both[both[:, 1] >= 0]
    np.testing.assert_array_equal(*stiff[both].T)
    thin = TriangleMesh(flat.vertices * (1.0, 0.01, 1.0), flat.faces)
    assert (pairs_of(thin)[0][:, 1] < 0).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_pairs_do_not_depend_on_other_components(family):
    alone = sheet(cells=(10, 8), family=family)
    count = len(alone.vertices)
    both = TriangleMesh(
        np.vstack([alone.vertices, 5e3 * alone.vertices + (0.0, 1e5, 0.0)]),
        np.vstack([alone.faces, alone.faces + count]),
    )
    faces, corners = pairs_of(both)
    own = np.flatnonzero(faces[:, 0] < len(alone.faces))
    for found, expected in zip((faces[own], corners[own]), pairs_of(alone), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.by_default("union-jack-0.5", "equilateral-0.3", "delaunay-0.0")
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("family", FAMILIES)
def test_constant_moments_keep_their_energy(family, poisson):
    mesh = sheet(cells=(6, 5), family=family)
    faces, corners = pairs_of(mesh)
    paired = faces[:, 1] >= 0
    count = len(mesh.faces)
    none = np.zeros((len(faces), 5), dtype=bool)
    moments = fold_moments(mesh, faces, corners, np.full(count, 2.0), np.full(count, poisson), none)
    assert np.linalg.eigvalsh(moments[paired])[:, 0].min() > 0.0
    tensor = np.array([[1.0, 0.3], [0.3, -0.7]])
    edges = mesh.vertices[np.roll(mesh.faces, -2, axis=1)] - mesh.vertices[np.roll(mesh.faces, -1, axis=1)]
    normals = edges[:, :, [1, 0]] * (1.0, -1.0)
    across = np.einsum("tki,ij,tkj->tk", normals, tensor, normals) / np.linalg.norm(edges, axis=2)
    own = faces[:, [0, 0, 0, 1, 1]]
    turned = (corners[:, [0, 0, 0, 1, 1]] + np.array([0, 1, 2, 1, 2])) % 3
    five = np.where(own >= 0, across[own, turned], 0.0)
    folds = np.linalg.solve(moments[paired], five[paired][:, :, None])[:, :, 0]
    curvature = (tensor * (1.0 + poisson) - poisson * np.trace(tensor) * np.eye(2)) / (2.0 * (1.0 - poisson**2))
    areas = mesh.face_areas[faces[paired]].sum(axis=1)
    np.testing.assert_allclose(np.sum(folds * five[paired], axis=1), areas * np.vdot(tensor, curvature), rtol=1e-10)
    np.testing.assert_allclose(moments_of_triangles(mesh, faces, corners, five), across, atol=1e-12)


@pytest.mark.parametrize(("poisson", "softening"), [(0.0, 0.1406), (0.3, 0.2057), (0.5, 0.2977)])
def test_plane_waves_on_equilateral_triangles(poisson, softening, monkeypatch):
    """Force over deflection in the middle of a large sheet, its mean over directions: ``D k^4`` less a k^2 term."""

    def parallel(mesh, rigidity, poisson, bends, inner):
        steps = np.diff(mesh.vertices[mesh.edges], axis=1)[:, 0]
        return paired_triangles(mesh, rigidity, poisson, bends, inner & (np.abs(steps[:, 0]) < 1e-9))

    monkeypatch.setattr(split_folds_module, "paired_triangles", parallel)
    mesh = sheet(length=35.0 / 30.0 * np.sqrt(0.75), width=1.0, cells=(35, 30), family="equilateral")
    count, none = len(mesh.faces), np.zeros(len(mesh.vertices), dtype=bool)
    folds = split_folds(mesh, np.ones(count), np.full(count, poisson), HeldSlopes.of(none), none, 1.0)
    by_fold, coupling, own = folds.matrices()
    hinges = hinge_operator(mesh)
    edge = np.sqrt(4.0 / np.sqrt(3.0) * np.median(mesh.face_areas))
    middle = np.argmin(np.linalg.norm(mesh.vertices[:, :2] - (0.5, 0.0), axis=1))
    x = mesh.vertices[:, :2] - mesh.vertices[middle, :2]
    directions = np.linspace(0.0, np.pi, 12, endpoint=False)
    found = []
    for number in np.array([0.4, 0.2]) / edge:
        waves = np.cos(number * x @ np.stack([np.cos(directions), np.sin(directions)]))
        angles = hinges @ waves
        couples = by_fold @ angles - coupling.T @ spla.spsolve(own.tocsc(), coupling @ angles)
        density = (hinges.T @ couples)[middle] / (2.0 * np.median(mesh.face_areas))
        found.append((1.0 - density.mean() / number**4) / (number * edge) ** 2)
    # Extrapolated to long waves.
    assert (4.0 * found[1] - found[0]) / 3.0 == pytest.approx((1.0 - MEAN_WEIGHT) * softening, abs=2e-3)


def plate_error(family, cells, support, exact):
    """Error of the deflection of a square plate's middle."""
    return middle(loaded_plate(family, (cells, cells), support)) / exact - 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "support", "exact"),
    [(family, Clamp, 1.2653e-3) for family in FAMILIES] + [(FAMILIES[-1], Pin, 4.0624e-3)],
)
def test_plates_of_24_cells_bend_within_one_per_cent(family, support, exact):
    coarse, fine = (plate_error(family, cells, support, exact) for cells in (12, 24))
    assert abs(fine) < 0.01
    assert abs(fine) < 0.5 * abs(coarse) < 0.013


def test_a_plate_twists_at_its_supported_corners():
    """Two corners are triangles with all vertices on pinned edges; flat, they leave the plate 2.4 % off."""
    assert abs(plate_error("right", 12, Pin, 4.0624e-3)) < 0.006


def test_a_corner_triangle_that_is_held_by_itself_clamps():
    """A plate that hangs on it is 1.4 times as soft where the triangle bends."""
    mesh = sheet(cells=(6, 6), family="right")
    (corner, *_) = np.flatnonzero((mesh.edge_faces[:, 1] < 0)[mesh.face_edges].sum(axis=1) == 2)
    grip, material = mesh.faces[corner], Isotropic(1e6, 0.3, 0.01, 1000.0)
    pinned, clamped = (Shell(mesh, material, supports=[kind(grip)]) for kind in (Pin, Clamp))
    x = mesh.vertices + 0.01 * np.random.default_rng(0).standard_normal(mesh.vertices.shape)
    x[grip] = mesh.vertices[grip]
    assert pinned.energy(x) == pytest.approx(clamped.energy(x), rel=1e-12)


def test_ghosts_have_no_rows(monkeypatch):
    """The kernel in Python refuses what the compiled one would read behind the end of an array."""
    mesh = sheet(cells=(2, 2))
    shell = Shell(mesh, Isotropic(1e6, 0.3, 0.01, 1000.0), clamped=mesh.vertices[:, 0] < 1e-9)
    expected = shell.stiffness().toarray()
    monkeypatch.setattr(kernels, "add_bending", kernels.add_bending.py_func)
    np.testing.assert_allclose(shell.stiffness().toarray(), expected, rtol=1e-12, atol=1e-12 * expected.max())


@pytest.mark.parametrize("family", ["union-jack", "equilateral"])
def test_symmetries_of_the_mesh_are_those_of_the_energy(family):
    """Numbers of triangles do not matter, and a deflection and its mirror image have one energy."""
    mesh = sheet(cells=(10, 8), family=family)
    material = Isotropic(1e6, 0.3, 0.01, 1000.0)
    order = np.random.default_rng(0).permutation(len(mesh.faces))
    x, mirrored = np.array(mesh.vertices), np.array(mesh.vertices)
    x[:, 2] = 0.01 * np.sin(4.0 * x[:, 0] + 2.0 * x[:, 1] + 0.3)
    mirrored[:, 2] = 0.01 * np.sin(4.0 * x[:, 0] - 2.0 * x[:, 1] + 0.3)
    shells = [Shell(TriangleMesh(mesh.vertices, faces), material) for faces in (mesh.faces, mesh.faces[order])]
    energies = [shells[0].energy(x), shells[0].energy(mirrored), shells[1].energy(x)]
    np.testing.assert_allclose(energies, energies[0], rtol=1e-11)


@pytest.mark.parametrize(
    "made", [lambda: v_beam(fold=160.0, cells=(6, 4)), lambda: cylinder_panel(cells=(4, 9), angle=180.0)]
)
def test_folds_of_just_the_limit_are_all_alike(made):
    """Folds of 20 degrees were smooth or sharp as they were rounded: frequencies of a turned beam moved by 0.8 %."""
    mesh = made()
    material, clamped = Isotropic(young=2e8, poisson=0.3, thickness=3e-3, density=300.0), mesh.vertices[:, 0] < 1e-6
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    as_made, turned = (
        solve_modes(Shell(TriangleMesh(vertices, mesh.faces), material, clamped=clamped), 4).frequencies
        for vertices in (mesh.vertices, mesh.vertices @ turn.T)
    )
    np.testing.assert_allclose(turned, as_made, rtol=1e-10)
