"""Repeated eigenvalues: identical parts, the square, the closed cylinder; their counts, subspaces and closed forms."""

import warnings

import numpy as np
import pytest
import scipy.linalg
from scenes import PLAIN
from scipy.spatial.transform import Rotation
from spheres import icosphere

from modalshell import Isotropic, Material, Shell, TriangleMesh, flat_beam, sheet, solve_modes
from modalshell.core.errors import ModalShellWarning
from modalshell.modes import BACKENDS, eigenpairs
from modalshell.modes.block_lanczos import BLOCK

every_backend = pytest.mark.parametrize("backend", BACKENDS)


@pytest.fixture(autouse=True)
def lanczos(monkeypatch):
    """Never the dense solver, which misses nothing."""
    monkeypatch.setattr(eigenpairs, "_DENSE_BELOW", 0)


def strips(copies, cells=(6, 3), held=True):
    """Identical strips side by side, apart from each other."""
    one = flat_beam(cells=cells)
    vertices = np.vstack([one.vertices + np.array([0.0, 2.0 * k, 0.0]) for k in range(copies)])
    faces = np.vstack([one.faces + k * len(one.vertices) for k in range(copies)])
    return Shell(
        TriangleMesh(vertices, faces), PLAIN, vertices[:, 0] < 1.5 / cells[0] if held else None, loose_parts=True
    )


def dense(shell):
    """Eigenvalues, and modes in all unknowns, by scipy.linalg.eigh."""
    free = shell.free_unknowns
    stiffness = shell.stiffness().toarray()[np.ix_(free, free)]
    values, vectors = scipy.linalg.eigh(stiffness, np.diag(np.repeat(shell.mass, 3)[free]))
    modes = np.zeros((3 * len(shell.mass), free.size))
    modes[free] = vectors
    return values, modes


def solved(shell, count, **options):
    """The basis; whether it cuts a repeated eigenvalue is not the question here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)
        return solve_modes(shell, count, **options)


def outside(shell, modes, space):
    """Largest part of mass-orthonormal ``modes`` that is not in the span of mass-orthonormal ``space``."""
    root = np.sqrt(np.repeat(shell.mass, 3))[:, None]
    left = root * modes - root * space @ ((root * space).T @ (root * modes))
    return np.linalg.norm(left, axis=0).max(initial=0.0)


def check_copies(copies, held, elastic, backend, cells=(6, 3)):
    shell = strips(copies, cells, held)
    values, modes = dense(strips(1, cells, held))
    rigid = 0 if held else 6
    basis = solved(shell, copies * rigid + elastic, backend=backend)
    assert basis.rigid_modes == copies * rigid
    exact = np.repeat(values[rigid:], copies)[:elastic]
    np.testing.assert_allclose(basis.eigenvalues[basis.rigid_modes :], exact, rtol=1e-8)
    gram = basis.modes.T @ (np.repeat(shell.mass, 3)[:, None] * basis.modes)
    np.testing.assert_allclose(gram, np.eye(basis.count), atol=1e-9)
    # The eigenspace of each eigenvalue is spanned by one strip's mode on every strip.
    for level in range(-(-elastic // copies)):
        space = np.kron(np.eye(copies), modes[:, [rigid + level]])
        first = basis.rigid_modes + level * copies
        assert outside(shell, basis.modes[:, first : first + copies], space) < 1e-6


@pytest.fixture
def by_blocks(monkeypatch):
    """By blocks, as large shells are."""
    monkeypatch.setattr(eigenpairs, "_LARGE", 0)


@pytest.mark.by_default("2-6-clamped", "3-9-clamped", "3-4-free")
@pytest.mark.usefixtures("by_blocks")
@pytest.mark.parametrize("held", [True, False], ids=["clamped", "free"])
@pytest.mark.parametrize(("copies", "elastic"), [(2, 6), (3, 9), (4, 10), (3, 4)])
def test_identical_strips_by_blocks(copies, elastic, held, monkeypatch):
    blocks, found = eigenpairs._lowest_by_blocks, []
    monkeypatch.setattr(eigenpairs, "_lowest_by_blocks", lambda *given: found.append(blocks(*given)) or found[-1])
    check_copies(copies, held, elastic, None, (12, 4))
    assert found
    assert None not in found


@pytest.mark.by_default("blocks-12", "one by one-13")
@pytest.mark.parametrize(("large", "copies"), [(0, 12), (10**9, 13)], ids=["blocks-12", "one by one-13"])
def test_more_copies_than_one_vector_or_a_block_finds(copies, large, monkeypatch):
    """Of twelve free strips one vector after the other found twelve of fourteen: a block of as many finds all."""
    monkeypatch.setattr(eigenpairs, "_LARGE", large)
    check_copies(copies, False, copies + 1, None, (12, 4))


@pytest.mark.by_default("1e-05")
@pytest.mark.usefixtures("by_blocks")
@pytest.mark.parametrize("thin", [1e-5, 3e-5])
def test_solves_that_are_not_symmetric_do_not_make_wrong_modes(thin):
    """The recurrence of Lanczos tells nothing of them: SuperLU's of thicknesses far apart are 1e-5 from symmetry."""
    mesh = sheet(cells=(16, 16))
    thickness = np.where(mesh.vertices[mesh.faces][:, :, 0].mean(axis=1) < 0.15, thin, 0.02)
    material = Isotropic(young=1e9, poisson=0.3, thickness=thickness, density=500.0)
    shell = Shell(mesh, material, mesh.vertices[:, 0] < 1e-9)
    exact = solved(shell, 10, backend="cholesky").eigenvalues
    np.testing.assert_allclose(solved(shell, 10, backend="superlu").eigenvalues, exact, rtol=1e-5)


@pytest.mark.by_default("6-free-superlu", "7-clamped-cholesky")
@every_backend
@pytest.mark.parametrize("held", [True, False], ids=["clamped", "free"])
@pytest.mark.parametrize("elastic", [1, 6, 7, 18])
def test_six_identical_strips(elastic, held, backend):
    check_copies(6, held, elastic, backend)


@pytest.mark.by_default("12-12-cholesky")
@every_backend
@pytest.mark.parametrize(("copies", "elastic"), [(12, 12), (12, 13), (40, 80)])
def test_many_identical_strips(copies, elastic, backend):
    """Twelve kept Lanczos from converging; of forty it missed some at a count of eighty."""
    check_copies(copies, True, elastic, backend)


@pytest.mark.parametrize("missed", [[0], [2], [0, 1, 2], [5, 6]])
def test_modes_that_lanczos_missed_are_found(monkeypatch, missed):
    """The first search gives the lowest pairs without some of them, and those above in their place."""
    lowest, calls = eigenpairs._lowest, []

    def missing(solver, root, known, wanted, *rest):
        calls.append(wanted)
        if len(calls) > 1:
            return lowest(solver, root, known, wanted, *rest)
        values, vectors = lowest(solver, root, known, wanted + len(missed), *rest)
        return np.delete(values, missed), np.delete(vectors, missed, axis=1)

    shell = strips(3)
    complete = solved(shell, 8)
    monkeypatch.setattr(eigenpairs, "_lowest", missing)
    found = solved(shell, 8)
    assert len(calls) >= 2 + 2 * len(missed)
    np.testing.assert_allclose(found.eigenvalues, complete.eigenvalues, rtol=1e-9)
    assert found.residual < 1e-10
    assert outside(shell, found.modes[:, :6], complete.modes[:, :6]) < 1e-6


def test_modes_that_did_not_converge_are_found_beside_the_others(monkeypatch):
    lowest, calls = eigenpairs._lowest, []

    def failing(*arguments):
        calls.append(arguments)
        values, vectors = lowest(*arguments)
        return (values[:4], vectors[:, :4]) if len(calls) == 1 else (values, vectors)

    shell = strips(3)
    complete = solved(shell, 8)
    monkeypatch.setattr(eigenpairs, "_lowest", failing)
    found = solved(shell, 8)
    np.testing.assert_allclose(found.eigenvalues, complete.eigenvalues, rtol=1e-9)
    gram = found.modes.T @ (np.repeat(shell.mass, 3)[:, None] * found.modes)
    np.testing.assert_allclose(gram, np.eye(8), atol=1e-10)


@pytest.mark.by_default("missed0", "missed1")
@pytest.mark.usefixtures("by_blocks")
@pytest.mark.parametrize("missed", [[0], [2], [0, 1, 2], [5, 6]])
def test_copies_that_a_block_cannot_hold_are_found(monkeypatch, missed):
    """Where as many eigenvalues are alike as a block has vectors, what is still lower is looked for."""
    blocks, calls = eigenpairs._lowest_by_blocks, []

    def missing(solver, root, known, wanted, *block):
        if block:
            return blocks(solver, root, known, wanted, *block)
        values, vectors = blocks(solver, root, known, wanted + len(missed))
        calls.append(wanted)
        return np.delete(values, missed), np.delete(vectors, missed, axis=1)

    shell = strips(7)
    complete = solved(shell, 20)
    monkeypatch.setattr(eigenpairs, "_lowest_by_blocks", missing)
    found = solved(shell, 20)
    assert calls
    np.testing.assert_allclose(found.eigenvalues, complete.eigenvalues, rtol=1e-9)
    assert outside(shell, found.modes[:, :14], complete.modes[:, :14]) < 1e-6


@pytest.mark.usefixtures("by_blocks")
def test_fewer_copies_than_a_block_has_vectors_are_found_by_it_alone(monkeypatch):
    shell = strips(BLOCK - 1, (12, 4))
    monkeypatch.setattr(eigenpairs, "_lowest", lambda *_: pytest.fail("no further search is needed"))
    basis = solved(shell, 9)
    np.testing.assert_allclose(basis.eigenvalues, np.repeat(dense(strips(1, (12, 4)))[0][:3], BLOCK - 1), rtol=1e-8)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_count_that_cuts_six_copies_warns_and_gives_vectors_of_their_space(count):
    """As many orthonormal vectors of the eigenspace as were asked for; which ones is the solver's choice."""
    shell = strips(6)
    with pytest.warns(ModalShellWarning, match="repeated"):
        basis = solve_modes(shell, count)
    values, modes = dense(strips(1))
    np.testing.assert_allclose(basis.eigenvalues, values[0], rtol=1e-8)
    assert outside(shell, basis.modes, np.kron(np.eye(6), modes[:, :1])) < 1e-6
    gram = basis.modes.T @ (np.repeat(shell.mass, 3)[:, None] * basis.modes)
    np.testing.assert_allclose(gram, np.eye(count), atol=1e-10)
    solve_modes(shell, 6)  # holds them all: a warning would be an error here


@pytest.mark.parametrize("held", [0, 1, 2])
def test_free_and_clamped_strips_side_by_side(held):
    """Each free part has its own six rigid motions, whatever holds the others."""
    shell = strips(2)
    first = shell.rest_positions[:, 1] < 1.0
    clamped = shell.clamped & (first if held == 1 else held == 2)
    shell = Shell(shell.mesh, PLAIN, clamped if held else None, loose_parts=True)
    basis = solved(shell, 16)
    assert basis.rigid_modes == 6 * (2 - held)
    expected = [dense(strips(1, held=True))[0]] * held + [dense(strips(1, held=False))[0][6:]] * (2 - held)
    elastic = np.sort(np.concatenate(expected))[: 16 - basis.rigid_modes]
    np.testing.assert_allclose(basis.eigenvalues[basis.rigid_modes :], elastic, rtol=1e-8)


# ---- closed forms


def closed_cylinder(around, rows):
    """A tube of radius 1 with open ends, of nearly equilateral triangles; each ring is turned by half a cell."""
    side = 2.0 * np.sin(np.pi / around)
    ring, row = np.meshgrid(np.arange(around), np.arange(rows))
    angle = 2.0 * np.pi * (ring + 0.5 * row) / around
    vertices = np.stack([0.5 * np.sqrt(3.0) * side * row, np.cos(angle), np.sin(angle)], axis=-1).reshape(-1, 3)
    a, b = ((ring + k) % around + around * row for k in (0, 1))
    a, b = a[:-1].ravel(), b[:-1].ravel()
    lower, upper = np.column_stack([a, b, a + around]), np.column_stack([b, b + around, a + around])
    return TriangleMesh(vertices, np.vstack([lower, upper]))


def test_closed_cylinder_has_pairs_at_rayleighs_frequencies():
    """Inextensional modes cos(n phi), sin(n phi): w^2 = D / (rho R^4) n^2 (n^2 - 1)^2 / (n^2 + 1), D = 6 k_f.

    On equilateral triangles the hinges' bending energy under one curvature is 3 k_f kappa^2, which a plate has as
    D kappa^2 / 2. These modes are the same all along the axis, so that no Poisson's ratio enters.
    """
    flexure, density = 1e-3, 0.7
    n = np.array([2, 3])
    exact = 6.0 * flexure / density * n**2 * (n**2 - 1) ** 2 / (n**2 + 1)
    errors = []
    for around, rows in ((24, 5), (48, 9)):
        mesh = closed_cylinder(around, rows)
        shell = Shell(mesh, Material(1e6, 1e6 * mesh.edge_lengths, flexure, density))
        basis = solve_modes(shell, 6 + 6)
        assert basis.rigid_modes == 6
        pairs = basis.eigenvalues[6:].reshape(3, 2)
        np.testing.assert_allclose(pairs[:, 0], pairs[:, 1], rtol=1e-7)
        # Rayleigh's modes do not move along the axis; Love's, the second pair, do.
        along = np.sum(np.repeat(shell.mass, 3)[::3, None] * basis.modes[::3, 6:] ** 2, axis=0).reshape(3, 2)
        assert along[[0, 2]].max() < 1e-3
        assert along[1].min() > 0.2
        motion = np.exp(1j * np.outer(n, np.arctan2(mesh.vertices[:, 2], mesh.vertices[:, 1])))
        for order, pair in ((0, slice(6, 8)), (1, slice(10, 12))):
            radial = np.einsum("nc,ncm->nm", mesh.vertices[:, 1:], basis.modes.reshape(-1, 3, basis.count)[:, 1:, pair])
            waves = np.column_stack([motion[order].real, motion[order].imag])
            fitted, *_ = np.linalg.lstsq(waves, radial)
            assert np.linalg.norm(radial - waves @ fitted) < 0.05 * np.linalg.norm(radial)
        errors.append(1.0 - pairs[[0, 2], 0] / exact)
    # First order: the hinges of the open rims stand for half a cell.
    assert (np.array(errors) > 0.0).all()
    assert (errors[0] < (0.03, 0.06)).all()
    assert (errors[1] < 0.55 * errors[0]).all()


def test_free_square_has_its_lame_mode():
    """In the plane, u = (cos pi x sin pi y, -sin pi x cos pi y) at w^2 = 2 pi^2 G / (rho L^2), whatever nu.

    Equilateral springs are a membrane with nu = 1/3 and k_h = sqrt(3) / 4 E h l, so G = 3 E h / 8 to its edge.
    """
    errors = []
    for cells in ((14, 12), (28, 24)):
        mesh = sheet(cells=cells, family="equilateral")
        bends_late = 1e3
        shell = Shell(mesh, Material(1e-300, np.sqrt(3.0) / 4.0 * mesh.edge_lengths, bends_late, 1.0))
        basis = solved(shell, 12)
        assert basis.rigid_modes == 6
        x, y = np.pi * (mesh.vertices - mesh.vertices.min(axis=0))[:, :2].T
        exact = np.column_stack([np.cos(x) * np.sin(y), -np.sin(x) * np.cos(y), 0.0 * x]).ravel()
        mass = np.repeat(shell.mass, 3)
        overlap = np.abs(basis.modes.T @ (mass * exact)) / np.sqrt(np.sum(mass * exact**2))
        mode = int(overlap.argmax())
        assert overlap[mode] > 0.998
        errors.append(abs(basis.eigenvalues[mode] / (2.0 * np.pi**2 * 3.0 / 8.0) - 1.0))
    assert errors[0] < 0.012
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize("count", [2, 6])  # the first cuts a repeated eigenvalue
def test_modes_turn_with_the_shell(count):
    mesh, turn = sheet(cells=(8, 8)), Rotation.from_rotvec([0.4, 2.1, -0.7]).as_matrix()
    edge = np.isin(np.arange(len(mesh.vertices)), mesh.boundary_vertices)
    still, turned = (
        solved(Shell(TriangleMesh(vertices, mesh.faces), PLAIN, edge), count)
        for vertices in (mesh.vertices, mesh.vertices @ turn.T + [1.0, 2.0, 3.0])
    )
    assert count == 2 or still.eigenvalues[2] == pytest.approx(still.eigenvalues[1], rel=1e-9)
    expected = np.einsum("ij,njk->nik", turn, still.modes.reshape(-1, 3, count)).reshape(-1, count)
    np.testing.assert_allclose(turned.modes, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.slow  # smaller spheres have no such crowd
def test_the_crowded_modes_of_a_sphere_are_found():
    """A band of membrane modes within 0.01 %, threefold to fivefold: Lanczos with a space for six of them gave up."""
    shell = Shell(icosphere(3), Isotropic(young=1e9, poisson=0.3, thickness=0.01, density=1000.0))
    few, many = (solved(shell, count).eigenvalues for count in (12, 16))
    np.testing.assert_allclose(few[6:], many[6:12], rtol=1e-9)
    np.testing.assert_allclose(few[6:11], few[6], rtol=1e-9)  # five of the second order
