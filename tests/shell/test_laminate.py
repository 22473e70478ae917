"""Laminates against classical lamination theory by hand, single plies, a closed form and stresses ply by ply."""

import numpy as np
import pytest
from scenes import jittered

import modalshell as ms

PLY = ms.Orthotropic(young=(140e9, 10e9), shear=5e9, poisson=0.3, thickness=1e-3, density=1600.0)
THICK = 0.125e-3


def stack(*angles):
    return ms.Laminate([ms.Ply(PLY, angle, THICK) for angle in angles])


def plane():
    """Q11, Q22, Q12, Q66 of a ply."""
    first, second = PLY.young
    ratio = 1.0 - PLY.poisson**2 * second / first
    return np.array([first / ratio, second / ratio, PLY.poisson * second / ratio, PLY.shear])


def test_a_cross_ply_has_the_stiffnesses_of_a_hand_calculation():
    """[0, 90]_s: the outer plies count seven times as much in bending as the inner ones."""
    membrane, coupling, bending = stack(0.0, 90.0, 90.0, 0.0).matrices
    q11, q22, q12, q66 = plane()
    height = 4 * THICK
    np.testing.assert_allclose(
        np.diag(membrane), height * np.array([(q11 + q22) / 2, (q11 + q22) / 2, q66]), rtol=1e-12
    )
    cube = height**3 / 12.0
    exact = cube * np.array([(7 * q11 + q22) / 8, (7 * q22 + q11) / 8, q66])
    np.testing.assert_allclose(np.diag(bending), exact, rtol=1e-12)
    assert bending[0, 1] == pytest.approx(cube * q12)
    assert np.abs(coupling).max() < 1e-12 * membrane.max() * height
    assert np.abs(bending[:2, 2]).max() < 1e-12 * bending.max()


def test_a_quasi_isotropic_stack_is_the_same_in_all_directions_in_its_plane():
    membrane = stack(0.0, 45.0, -45.0, 90.0, 90.0, -45.0, 45.0, 0.0).matrices[0]
    assert membrane[0, 0] == pytest.approx(membrane[1, 1], rel=1e-12)
    assert membrane[2, 2] == pytest.approx((membrane[0, 0] - membrane[0, 1]) / 2.0, rel=1e-12)
    q11, q22, q12, q66 = plane()
    assert membrane[0, 0] == pytest.approx(THICK * 8 * (3 * q11 + 3 * q22 + 2 * q12 + 4 * q66) / 8, rel=1e-12)


def test_plies_of_one_angle_are_one_sheet_in_that_direction():
    mesh = jittered()
    one = ms.Orthotropic(
        young=PLY.young, shear=PLY.shear, poisson=PLY.poisson, thickness=4 * THICK, density=1600.0, direction=25.0
    )
    x = mesh.vertices + 1e-3 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    shells = [ms.Shell(mesh, sheet, clamped="x < 1e-6") for sheet in (one, stack(25.0, 25.0, 25.0, 25.0))]
    assert shells[1].energy(x) == pytest.approx(shells[0].energy(x), rel=1e-12)
    np.testing.assert_allclose(shells[1].mass, shells[0].mass, rtol=1e-12)
    fields = [shell.fields(x) for shell in shells]
    np.testing.assert_allclose(fields[1].von_mises, fields[0].von_mises, rtol=1e-9)


def test_a_supported_cross_ply_has_the_frequency_of_the_closed_form():
    sheet = stack(0.0, 90.0, 90.0, 0.0)
    bending = sheet.matrices[2]
    length, width = 0.3, 0.2
    mesh = jittered((24, 16), length, width)
    rim = np.isin(np.arange(len(mesh.vertices)), mesh.boundary_vertices)
    found = ms.solve_modes(ms.Shell(mesh, sheet, supports=[ms.Pin(rim)]), 2).frequencies[0]
    mixed = 2.0 * (bending[0, 1] + 2.0 * bending[2, 2]) / (length * width) ** 2
    squared = bending[0, 0] / length**4 + mixed + bending[1, 1] / width**4
    assert found == pytest.approx(np.pi / 2.0 * np.sqrt(squared / (1600.0 * sheet.thickness)), rel=0.01)


def test_stresses_of_plies_follow_their_own_strains():
    """Pulled by a uniform strain along x each ply has Q times it in its own axes; the faces' are the outer plies'."""
    mesh, strain = jittered(), 1e-4
    sheet = stack(0.0, 90.0, 45.0, 45.0, 90.0, 0.0)
    shell = ms.Shell(mesh, sheet)
    fields = shell.fields(mesh.vertices * [np.sqrt(1.0 + 2.0 * strain), 1.0, 1.0])
    found = sheet.ply_stresses(mesh, fields)
    q11, q22, q12, q66 = plane()
    np.testing.assert_allclose(
        found[:, 0, 0], np.tile([q11 * strain, q12 * strain, 0.0], (len(mesh.faces), 1)), atol=1.0
    )
    np.testing.assert_allclose(
        found[:, 1, 1], np.tile([q12 * strain, q22 * strain, 0.0], (len(mesh.faces), 1)), atol=1.0
    )
    half = 0.5 * strain
    askew = [(q11 + q12) * half, (q22 + q12) * half, -q66 * strain]
    np.testing.assert_allclose(found[:, 2, 0], np.tile(askew, (len(mesh.faces), 1)), atol=1.0)
    first, second = q11 * strain, q12 * strain
    von_mises = np.sqrt(first**2 - first * second + second**2)
    np.testing.assert_allclose(fields.von_mises_faces, von_mises, rtol=1e-6)


def test_it_moves_and_its_basis_is_kept(tmp_path):
    mesh = jittered()
    shell = ms.Shell(mesh, stack(30.0, -30.0, -30.0, 30.0), clamped="x < 1e-6")
    basis = ms.solve_modes(shell, 4)
    basis.save(tmp_path / "laminate.npz")
    again = type(basis).load(tmp_path / "laminate.npz").shell
    x = mesh.vertices + 1e-3 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    assert again.energy(x) == shell.energy(x)
    run = ms.simulate(ms.ModalWarping(basis), duration=0.2, dt=0.01, gravity=(0, 0, -9.81), damping=(1.0, 1e-4))
    assert run.outcome == ms.Outcome.COMPLETED
    truth = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -9.81))
    slope = ms.DiscreteShell(shell).sensitivity(truth, wrt="direction")
    assert np.isfinite(slope).all()


def angle(points):
    return 150.0 * points[:, 0]


def depth(points):
    return THICK * (1.0 + 2.0 * points[:, 0])


def varying():
    """Shells of one sheet whose direction and thickness vary, of plies that do, and of these with values."""
    mesh = ms.v_beam(length=0.4, width=0.1, fold=140.0, cells=(12, 4))
    one = ms.Orthotropic(
        young=PLY.young, shear=PLY.shear, poisson=PLY.poisson, density=1600.0,
        thickness=lambda points: 4.0 * depth(points), direction=lambda points: 10.0 + angle(points),
    )  # fmt: skip
    plies = ms.Laminate([ms.Ply(PLY, angle, depth)] * 4, direction=10.0)
    return [ms.Shell(mesh, sheet, clamped="x < 1e-6") for sheet in (one, plies, plies.on(mesh))]


@pytest.mark.slow
def test_plies_that_turn_and_grow_are_a_sheet_that_does():
    shells = varying()
    mesh = shells[0].mesh
    x = mesh.vertices + 1e-3 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    for shell in shells[1:]:
        assert shell.energy(x) == pytest.approx(shells[0].energy(x), rel=1e-12)
        np.testing.assert_allclose(shell.mass, shells[0].mass, rtol=1e-12)
        np.testing.assert_allclose(shell.fields(x).von_mises, shells[0].fields(x).von_mises, rtol=1e-9)
        assert shell.material.ply_stresses(mesh, shell.fields(x)).shape == (len(mesh.faces), 4, 2, 3)


@pytest.mark.slow
def test_coarse_shells_take_over_the_fields_of_plies():
    coarse = ms.v_beam(length=0.4, width=0.1, fold=140.0, cells=(6, 2))
    moves = []
    for shell in varying():
        model = ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, coarse))
        moves.append(model.equilibrium(gravity=(0, 0, -9.81)).positions - shell.rest_positions)
    np.testing.assert_allclose(moves[1], moves[0], atol=1e-9 * np.abs(moves[0]).max())
    np.testing.assert_allclose(moves[2], moves[0], atol=0.02 * np.abs(moves[0]).max())  # means of the values


def test_a_stack_of_steered_plies_is_laid_up_triangle_by_triangle(tmp_path):
    mesh = jittered()
    angles = 60.0 * mesh.vertices[mesh.faces].mean(axis=1)[:, 0]
    sheet = stack(angles, -angles, -angles, angles)
    for k in (0, 11, len(angles) - 1):
        alone = stack(*angles[k] * np.array([1.0, -1.0, -1.0, 1.0])).matrices
        for found, exact in zip(sheet.matrices, alone, strict=True):
            np.testing.assert_allclose(found[k], exact, atol=1e-12 * np.abs(alone[0]).max())
    shell = ms.Shell(mesh, sheet, clamped="x < 1e-6")
    ms.solve_modes(shell, 2).save(tmp_path / "steered.npz")
    x = mesh.vertices + 1e-3 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    assert ms.Basis.load(tmp_path / "steered.npz").shell.energy(x) == shell.energy(x)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: stack(0.0, 90.0), "no coupling of stretch and bending"),
        (lambda: ms.Laminate([]), "plies must be a list"),
        (lambda: ms.Laminate([PLY]), r"plies\[0\] must be an ms.Ply"),
        (lambda: ms.Ply(ms.card("royal-target"), 0.0, 1e-3), "must be an Orthotropic or an Isotropic"),
        (lambda: ms.Ply(PLY, 0.0, -1.0), "thickness must be"),
        (lambda: ms.Ply(PLY, 0.0, np.array([1.0, -1.0])), "thickness must be"),
        (lambda: ms.Ply(PLY, np.array([1.0, np.nan]), 1.0), "angle must be finite"),
        (lambda: stack(np.zeros(4), np.zeros(5)), "one value per triangle each"),
        (lambda: stack(np.arange(3.0), 0.0), "no coupling of stretch and bending"),
        (lambda: ms.Shell(jittered(), stack(np.zeros(4))), "angle has 4 values"),
        (lambda: ms.Shell(jittered(), stack(lambda at: at[:, 0], 0.0)), "no coupling of stretch and bending"),
        (lambda: stack(lambda at: at[:, 0]).matrices, r"laminate\.on\(mesh\)"),
        (lambda: ms.Ply(ms.Isotropic(np.ones(3), 0.3, 1.0, 1.0), 0.0, 1.0), "single numbers"),
        (lambda: ms.Ply(PLY.with_constants({"direction": 3.0}), 0.0, 1.0), "its angle takes that place"),
        (lambda: ms.Ply(PLY.with_constants({"direction": np.full(4, 30.0)}), 0.0, 1.0), "its angle takes that place"),
        (lambda: ms.Ply(PLY.with_constants({"direction": lambda at: at}), 0.0, 1.0), "its angle takes that place"),
    ],
)
def test_what_is_no_laminate_is_refused(make, match):
    with pytest.raises(ms.MaterialError, match=match):
        make()
