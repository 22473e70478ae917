"""Modes: eigenpairs against dense ones, rigid motions, repeatability, saved bases, the factorisation behind them."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sps
from scenes import PLAIN, SHELLS, cantilever

from modalshell import Material, Shell, TriangleMesh, flat_beam, leaf, sheet, solve_modes, v_beam
from modalshell.core.errors import ModalShellWarning, OptionError, SolverError
from modalshell.modes import BACKENDS, Factoriser, TangentStiffness, eigenpairs, lowest_modes
from modalshell.modes.modal_rotation import rotation_matrix
from modalshell.modes.rigid import rigid_motions

DATA = json.loads(
    (Path(__file__).resolve().parents[1] / "data" / "plate_and_beam_frequencies.json").read_text(encoding="utf-8")
)


def dense_pairs(shell):
    """All eigenpairs by scipy.linalg.eigh, modes in all unknowns."""
    free = shell.free_unknowns
    stiffness = shell.stiffness().toarray()[np.ix_(free, free)]
    mass = np.repeat(shell.mass, 3)[free]
    values, vectors = scipy.linalg.eigh(stiffness, np.diag(mass))
    modes = np.zeros((3 * len(shell.mass), free.size))
    modes[free] = vectors
    return values, modes


def subspace_angle(shell, first, second):
    """Largest principal angle in the norm of the mass matrix [rad]."""
    root = np.sqrt(np.repeat(shell.mass, 3))[:, None]
    return scipy.linalg.subspace_angles(root * first, root * second).max()


@pytest.mark.parametrize("name", SHELLS)
def test_eigenpairs_against_dense(name):
    shell = SHELLS[name]
    basis = solve_modes(shell, 14)
    values, modes = dense_pairs(shell)
    rigid = basis.rigid_modes
    np.testing.assert_allclose(basis.eigenvalues[rigid:], values[rigid:14], rtol=1e-8)
    assert np.abs(values[:rigid]).max(initial=0.0) < 1e-12 * values[-1]
    assert subspace_angle(shell, basis.modes, modes[:, :14]) < 1e-6
    for k in range(14):
        same = np.abs(values - values[k]) < 1e-6 * values[-1] if k < rigid else np.isclose(values, values[k], rtol=1e-3)
        assert subspace_angle(shell, basis.modes[:, [k]], modes[:, same]) < 1e-6


@pytest.mark.parametrize("name", SHELLS)
def test_residuals_and_orthonormality(name):
    shell = SHELLS[name]
    basis = solve_modes(shell, 14)
    mass = np.repeat(shell.mass, 3)
    free = shell.free_unknowns
    gram = basis.modes.T @ (mass[:, None] * basis.modes)
    np.testing.assert_allclose(gram, np.eye(14), atol=1e-10)
    left = (shell.stiffness() @ basis.modes)[free]
    right = (mass[:, None] * basis.modes * basis.eigenvalues)[free]
    scale = scipy.sparse.linalg.norm(shell.stiffness(), 2) * np.linalg.norm(basis.modes, axis=0)
    assert (np.linalg.norm(left - right, axis=0) / scale).max() < 1e-10
    assert basis.residual < 1e-10
    rayleigh = np.einsum("im,im->m", basis.modes, shell.stiffness() @ basis.modes)
    rigid = basis.rigid_modes
    np.testing.assert_allclose(rayleigh[rigid:], basis.eigenvalues[rigid:], rtol=1e-8)


@pytest.mark.parametrize("name", SHELLS)
def test_what_a_basis_holds(name):
    shell = SHELLS[name]
    basis = solve_modes(shell, 9)
    assert basis.count == 9
    assert basis.modes.shape == basis.rotations.shape == (3 * len(shell.mass), 9)
    assert not basis.modes[np.repeat(shell.clamped, 3)].any()
    assert (np.diff(basis.eigenvalues) >= 0).all()
    np.testing.assert_allclose(basis.frequencies, np.sqrt(basis.eigenvalues) / (2 * np.pi), rtol=1e-15)
    np.testing.assert_allclose(basis.rotations, rotation_matrix(shell.mesh) @ basis.modes, rtol=1e-13, atol=1e-13)
    assert basis.shell is shell
    assert basis.backend in (*BACKENDS, "dense")


def two_sheets():
    one = sheet(cells=(6, 4))
    moved = one.vertices + np.array([5.0, 0.0, 1.0])
    return TriangleMesh(np.vstack((one.vertices, moved)), np.vstack((one.faces, one.faces + len(one.vertices))))


SUPPORTS = {
    "free": (lambda: v_beam(cells=(10, 4)), None, 6),
    "free flat": (lambda: sheet(cells=(6, 6), family="equilateral"), None, 6),
    "one row": (lambda: flat_beam(cells=(10, 4)), lambda x: x[:, 0] == 0.0, 1),
    "one row of a fold": (lambda: v_beam(cells=(10, 4)), lambda x: x[:, 0] == 0.0, 0),
    "the ridge": (lambda: v_beam(cells=(10, 4)), lambda x: x[:, 1] == 0.0, 1),
    "one vertex": (lambda: v_beam(cells=(10, 4)), lambda x: np.arange(len(x)) == 17, 3),
    "two vertices": (lambda: v_beam(cells=(10, 4)), lambda x: np.isin(np.arange(len(x)), (17, 40)), 1),
    "two rows": (lambda: flat_beam(cells=(10, 4)), lambda x: x[:, 0] < 0.15, 0),
    "two parts": (two_sheets, None, 12),
    "two parts, one clamped": (two_sheets, lambda x: x[:, 0] < 0.3, 6),
    "two parts, one held at a vertex": (two_sheets, lambda x: np.arange(len(x)) == 3, 9),
}


@pytest.mark.parametrize("name", SUPPORTS)
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
def test_rigid_modes_are_counted(name):
    make, held, expected = SUPPORTS[name]
    mesh = make()
    shell = Shell(mesh, PLAIN, None if held is None else held(mesh.vertices), loose_parts=True)
    count = expected + 3
    loose = pytest.warns(ModalShellWarning, match="modes are spent on rigid motion")
    with loose if name.startswith("two parts") else contextlib.nullcontext():
        basis = solve_modes(shell, count + 1)
    assert basis.rigid_modes == expected
    assert (basis.eigenvalues[:expected] == 0.0).all()
    values, modes = dense_pairs(shell)
    assert basis.eigenvalues[expected] > 1e3 * np.finfo(float).eps * values[-1]
    assert np.count_nonzero(values < 1e3 * np.finfo(float).eps * values[-1]) == expected
    if expected:
        assert subspace_angle(shell, basis.modes[:, :expected], modes[:, :expected]) < 1e-5
        motions = basis.modes[:, :expected].reshape(len(mesh.vertices), 3, expected)
        assert not motions[shell.clamped].any()
        moving = np.einsum("nim,njm->ijm", motions, motions)
        assert np.abs(moving).max() > 0
        edges = mesh.vertices[mesh.edges[:, 1]] - mesh.vertices[mesh.edges[:, 0]]
        stretch = np.einsum("ei,eim->em", edges, motions[mesh.edges[:, 1]] - motions[mesh.edges[:, 0]])
        assert np.abs(stretch).max() < 1e-12 * np.abs(motions).max()


def test_rigid_motions_are_mass_orthonormal():
    shell = Shell(leaf(cells=(8, 6)), Material(20.0, 20.0, 0.05, np.linspace(0.1, 2.0, len(leaf(cells=(8, 6)).faces))))
    motions = rigid_motions(shell)
    gram = motions.T @ (np.repeat(shell.mass, 3)[:, None] * motions)
    np.testing.assert_allclose(gram, np.eye(6), atol=1e-13)


@pytest.mark.parametrize("name", SHELLS)
def test_two_solves_are_bitwise_equal(name):
    first, second = solve_modes(SHELLS[name], 10), solve_modes(SHELLS[name], 10)
    np.testing.assert_array_equal(first.eigenvalues, second.eigenvalues)
    np.testing.assert_array_equal(first.modes, second.modes)
    np.testing.assert_array_equal(first.rotations, second.rotations)


@pytest.mark.parametrize("name", SHELLS)
def test_dense_and_lanczos_agree(name, monkeypatch):
    """Also the modes themselves: signs, and the basis of repeated eigenvalues, do not depend on the path."""
    results = {}
    for path, limit in (("dense", 10**6), ("lanczos", 0)):
        monkeypatch.setattr(eigenpairs, "_DENSE_BELOW", limit)
        results[path] = solve_modes(SHELLS[name], 10)
        assert (results[path].backend == "dense") == (path == "dense")
    np.testing.assert_allclose(results["lanczos"].eigenvalues, results["dense"].eigenvalues, rtol=1e-9)
    scale = np.abs(results["dense"].modes).max()
    np.testing.assert_allclose(results["lanczos"].modes, results["dense"].modes, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_gives_the_same_modes(backend, monkeypatch):
    monkeypatch.setattr(eigenpairs, "_DENSE_BELOW", 0)
    for shell in SHELLS.values():
        reference, basis = solve_modes(shell, 10), solve_modes(shell, 10, backend=backend)
        assert basis.backend == backend
        np.testing.assert_allclose(basis.eigenvalues, reference.eigenvalues, rtol=1e-9)


def square():
    """A free square of chessboard diagonals has the symmetries of the square, so some of its modes come in pairs."""
    return Shell(sheet(cells=(8, 8), family="union-jack"), PLAIN)


@pytest.mark.parametrize("limit", [0, 10**6], ids=["lanczos", "dense"])
def test_repeated_eigenvalues_as_subspaces(limit, monkeypatch):
    monkeypatch.setattr(eigenpairs, "_DENSE_BELOW", limit)
    shell = square()
    values, modes = dense_pairs(shell)
    basis = solve_modes(shell, 14)
    pairs = [k for k in range(6, 13) if values[k + 1] - values[k] < 1e-9 * values[k]]
    assert pairs, "no repeated eigenvalue in this test"
    for k in pairs:
        assert basis.eigenvalues[k + 1] == pytest.approx(basis.eigenvalues[k], rel=1e-9)
        assert subspace_angle(shell, basis.modes[:, k : k + 2], modes[:, k : k + 2]) < 1e-6
    gram = basis.modes.T @ (np.repeat(shell.mass, 3)[:, None] * basis.modes)
    np.testing.assert_allclose(gram, np.eye(14), atol=1e-10)


def test_a_count_that_cuts_a_repeated_eigenvalue_warns():
    shell = square()
    values, _ = dense_pairs(shell)
    first = next(k for k in range(6, 20) if values[k + 1] - values[k] < 1e-9 * values[k])
    with pytest.warns(ModalShellWarning, match="repeated"):
        basis = solve_modes(shell, first + 1)
    assert basis.count == first + 1
    solve_modes(shell, first + 2)  # holds the pair: a warning would be an error here
    assert lowest_modes(shell, first + 1)[1] == first
    assert lowest_modes(shell, first + 2)[1] == first + 2
    np.testing.assert_array_equal(lowest_modes(shell, first + 1)[0].modes, basis.modes)


def test_modes_do_not_depend_on_how_many_are_asked_for():
    """Also inside a repeated eigenvalue, whose basis is the solver's choice."""
    few, many = solve_modes(square(), 13), solve_modes(square(), 19)
    np.testing.assert_allclose(few.eigenvalues, many.eigenvalues[:13], rtol=1e-9)
    np.testing.assert_allclose(few.modes, many.modes[:, :13], rtol=0, atol=1e-6 * np.abs(many.modes).max())


@pytest.mark.parametrize("stretch", [1.0 + 3e-5, 1.0 + 3e-7])
def test_nearly_repeated_eigenvalues_keep_their_own_modes(stretch):
    """Distinct eigenvalues belong to distinct modes, however near: each pair has its own residual."""
    mesh = sheet(cells=(8, 8), family="union-jack", length=stretch)
    shell = Shell(mesh, PLAIN)
    basis = solve_modes(shell, 14)
    mass = np.repeat(shell.mass, 3)[:, None]
    elastic = slice(6, None)
    force = shell.stiffness() @ basis.modes[:, elastic]
    left = (force - mass * basis.modes[:, elastic] * basis.eigenvalues[elastic]) / np.sqrt(mass)
    residual = np.linalg.norm(left, axis=0) / basis.eigenvalues[elastic]
    near = np.diff(basis.eigenvalues[elastic]) / basis.eigenvalues[elastic][1:]
    assert 1e-9 < near.min() < 1e-4
    assert residual.max() < 0.05 * near.min()


def clamped_sheet():
    mesh = sheet(cells=(6, 6), family="equilateral")
    return Shell(mesh, Material(1.0, 1.0, 1.0, 1.0), mesh.vertices[:, 0] < 0.3)


@pytest.mark.parametrize(
    "make",
    [lambda: cantilever((6, 2)), clamped_sheet, lambda: Shell(sheet(cells=(5, 5)), PLAIN)],
    ids=["V", "clamped sheet", "free sheet"],
)
def test_all_modes_at_once(make):
    shell = make()
    size = shell.free_unknowns.size
    basis = solve_modes(shell, size)
    values, _ = dense_pairs(shell)
    np.testing.assert_allclose(basis.eigenvalues, values, rtol=1e-7, atol=1e-12 * values[-1])
    gram = basis.modes.T @ (np.repeat(shell.mass, 3)[:, None] * basis.modes)
    np.testing.assert_allclose(gram, np.eye(size), atol=1e-9)


@pytest.mark.parametrize("count", [1, 3, 6])
def test_fewer_modes_than_rigid_ones(count):
    basis = solve_modes(SHELLS["free leaf"], count)
    assert basis.count == basis.rigid_modes == count
    assert not basis.eigenvalues.any()


@pytest.mark.parametrize("count", [0, -1, 2.5, True, "8", None, np.nan, [8]], ids=repr)
def test_bad_counts_are_refused(count):
    with pytest.raises(OptionError, match="count"):
        solve_modes(SHELLS["clamped v_beam"], count)


def test_more_modes_than_unknowns_are_refused():
    shell = SHELLS["clamped v_beam"]
    with pytest.raises(OptionError, match=rf"at most {shell.free_unknowns.size}.*{shell.free_unknowns.size + 1}"):
        solve_modes(shell, shell.free_unknowns.size + 1)


@pytest.mark.parametrize("cells", [(4, 2), (20, 8)])
def test_unknown_backends_are_refused(cells):
    with pytest.raises(OptionError, match="no-such-backend"):
        solve_modes(cantilever(cells), 4, backend="no-such-backend")


def test_numpy_counts_are_taken():
    assert solve_modes(SHELLS["clamped v_beam"], np.int64(3)).count == 3


# ---- physics


@pytest.mark.by_default("equilateral-cells0")
@pytest.mark.parametrize(("family", "cells"), [("equilateral", (28, 24)), ("lloyd", (28, 24))])
def test_free_square_plate_has_the_hinge_spectrum(family, cells):
    """The isotropic hinge plate: D = 2 c k_f with c = 3, and the effective Poisson's ratio -1/3."""
    mesh = sheet(cells=cells, family=family)
    flexure, density = 1e-3, 0.7
    membrane = 1e3 * flexure * 12.0  # stiff against bending: only plate modes are this low
    shear = membrane * mesh.edge_lengths
    basis = solve_modes(Shell(mesh, Material(membrane, shear, flexure, density)), 10)
    rigidity = 2.0 * 3.0 * flexure
    numbers = np.sqrt(basis.eigenvalues[6:9] * density / rigidity)
    np.testing.assert_allclose(numbers, DATA["free_square_plate_hinge"]["lambda"], rtol=0.01)


@pytest.mark.by_default("right-cells2-0.2", "union-jack-cells3-0.2")
@pytest.mark.parametrize(
    ("family", "cells", "width"),
    [("equilateral", (23, 4), 0.2), ("lloyd", (23, 4), 0.2), ("right", (20, 4), 0.2), ("union-jack", (20, 4), 0.2)],
)
def test_calibrated_strips_have_beam_frequencies(family, cells, width):
    mesh = flat_beam(length=1.0, width=width, cells=cells, family=family)
    clamped = mesh.vertices[:, 0] < 1.5 / cells[0]
    material = Material.from_physical(young=1e9, poisson=1 / 3, thickness=1e-3, density=1000.0, mesh=mesh)
    basis = solve_modes(Shell(mesh, material, clamped), 2)
    free_length = 1.0 - mesh.vertices[clamped, 0].max()
    numbers = np.sqrt(basis.eigenvalues * 1000.0 * 1e-3 / (1e9 * 1e-9 / 12.0)) * free_length**2
    np.testing.assert_allclose(numbers, DATA["cantilever_beam"]["lambda"][:2], rtol=0.025)


def test_clamp_correction_mends_the_clamp_bias():
    """A union-jack plate with k_f = D / 6, as it stands and with the hinges on the clamp line doubled."""
    mesh = sheet(cells=(16, 16), family="union-jack")
    clamped = mesh.vertices[:, 0] < 1.5 / 16
    free_length = 1.0 - 1.0 / 16
    for corrected, expected in zip((False, True), DATA["union_jack_clamp"]["lambda"], strict=True):
        membrane = 1e4
        material = Material(membrane, membrane * mesh.edge_lengths, 1.0 / 6.0, 1.0, correct_clamp=corrected)
        basis = solve_modes(Shell(mesh, material, clamped), 1)
        assert np.sqrt(basis.eigenvalues[0]) * free_length**2 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("thickness", [1e-2, 1e-4])
def test_thin_shells_keep_their_digits(thickness):
    """Bending eigenvalues go as h^2 with the same modes, whatever the membrane over bending stiffness."""
    mesh = sheet(cells=(10, 8), family="equilateral")
    reference, thin = (
        solve_modes(Shell(mesh, Material(1.0, 1.0 * mesh.edge_lengths, h**2 / 12.0, 1.0)), 10)
        for h in (1e-3, 1e-3 * thickness)
    )
    assert thin.rigid_modes == 6
    np.testing.assert_allclose(thin.eigenvalues[6:], thickness**2 * reference.eigenvalues[6:], rtol=1e-6)


def needle_strip(aspect):
    """A strip in the middle of which one column of cells is squeezed to needles of this aspect."""
    mesh = flat_beam(cells=(12, 2))
    vertices = np.array(mesh.vertices)
    vertices[np.isclose(vertices[:, 0], 0.5), 0] = (7.0 - 1.0 / aspect) / 12.0
    return Shell(TriangleMesh(vertices, mesh.faces), Material(5.0, 5.0, 0.05, 0.2), vertices[:, 0] < 0.125)


@pytest.mark.parametrize("dense_below", [150, 0])
def test_needles_keep_their_modes_or_are_refused(dense_below, monkeypatch):
    """The lowest eigenvalue is 1e-16 of the largest at an aspect of 1e4; beyond, it is lost, and said to be."""
    monkeypatch.setattr(eigenpairs, "_DENSE_BELOW", dense_below)
    plain = solve_modes(needle_strip(1e2), 3).eigenvalues
    np.testing.assert_allclose(solve_modes(needle_strip(1e4), 3).eigenvalues, plain, rtol=0.01)
    for aspect in (1e5, 1e6):
        with pytest.raises(SolverError):
            solve_modes(needle_strip(aspect), 3)


@pytest.mark.parametrize(("lacking", "named"), [(("shear",), "shear"), (("shear", "flexure"), "shear and flexure")])
def test_materials_without_a_stiffness_are_told_so(lacking, named):
    """They were sent to look for needles in their mesh."""
    given = {"stretch": 20.0, "shear": 20.0, "flexure": 0.05, "density": 0.2} | dict.fromkeys(lacking, 0.0)
    with pytest.raises(SolverError, match=f"of a material without {named} some motions meet no resistance"):
        solve_modes(Shell(flat_beam(cells=(12, 3)), Material(**given), "x < 0.1"), 4)


def test_the_mode_nearest_to_zero_of_an_exactly_singular_matrix():
    shell = cantilever((10, 2))
    matrix = sps.csc_array(shell.stiffness()[shell.free_unknowns][:, shell.free_unknowns])
    matrix.data[matrix.indices == 7] = 0.0
    matrix.data[matrix.indptr[7] : matrix.indptr[8]] = 0.0
    value, direction = TangentStiffness(shell, matrix, Factoriser()).nearest_mode()
    assert abs(value) < 1e-6 * solve_modes(shell, 1).eigenvalues[0]
    assert np.abs(np.delete(direction, 7)).max() < 1e-6 * abs(direction[7])
