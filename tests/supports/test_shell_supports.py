"""Supports by component: half models, rotated frames, determinate bodies, reactions, and what is refused."""

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from modalshell import (
    Clamp,
    Diaphragm,
    DiscreteShell,
    Fix,
    Isotropic,
    Material,
    OptionError,
    Pin,
    Roller,
    Shell,
    SupportError,
    Symmetry,
    Tie,
    TriangleMesh,
    cylinder_panel,
    sheet,
    solve_modes,
    v_beam,
)
from modalshell.shell import GAUSS_NEWTON, PROJECTED

ISOTROPIC = Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0)
HINGES = Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2)
ENERGIES = pytest.mark.parametrize("material", [ISOTROPIC, HINGES], ids=["split folds", "hinges"])
TURN = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()


def half_of(mesh):
    """The triangles of positive y, and their vertices' numbers in the whole."""
    kept = mesh.vertices[mesh.faces][:, :, 1].mean(axis=1) > 0.0
    numbers = np.unique(mesh.faces[kept])
    return TriangleMesh(mesh.vertices[numbers], np.searchsorted(numbers, mesh.faces[kept])), numbers


def on_plane(mesh):
    return np.abs(mesh.vertices[:, 1]) < 1e-9


@pytest.mark.by_default("sheet-hinges", "v-beam-split folds")
@ENERGIES
@pytest.mark.parametrize(
    ("make", "pull"),
    [
        (lambda: sheet(cells=(6, 6)), -0.4),
        (lambda: v_beam(length=1.0, width=0.4, fold=120.0, cells=(8, 4), family="union-jack"), 0.4),  # before it snaps
    ],
    ids=["sheet", "v-beam"],
)
def test_half_of_a_symmetric_shell_answers_as_the_whole(material, make, pull):
    mesh = make()
    half, numbers = half_of(mesh)
    whole = Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.2)
    part = Shell(
        half, material, clamped=half.vertices[:, 0] < 0.2, supports=[Symmetry(on_plane(half), (0.0, 2.0, 0.0))]
    )
    gravity = (0.05, 0.0, pull)
    expected = DiscreteShell(whole).equilibrium(gravity=gravity)
    found = DiscreteShell(part).equilibrium(gravity=gravity)
    assert expected.converged
    assert found.converged
    assert np.abs(expected.positions - mesh.vertices).max() > 0.005
    assert found.positions == pytest.approx(expected.positions[numbers], abs=1e-8)
    assert 2.0 * part.energy(found.positions) == pytest.approx(whole.energy(expected.positions), rel=1e-9)
    frequencies = solve_modes(whole, 12).frequencies
    for frequency in solve_modes(part, 3).frequencies:
        assert np.abs(frequencies / frequency - 1.0).min() < 1e-9


@ENERGIES
def test_derivatives_of_mirrored_folds(material):
    half, _ = half_of(v_beam(length=0.6, width=0.4, fold=120.0, cells=(3, 4), family="union-jack"))
    shell = Shell(half, material, supports=[Symmetry(on_plane(half), (0, 1, 0))])
    random = np.random.default_rng(0)
    x, step = (
        shell.rest_positions * (1.0 - at) + 0.02 * random.standard_normal((len(half.vertices), 3)) for at in (0, 1)
    )
    slope = -float(np.vdot(shell.force(x), step))
    curvature = float(step.ravel() @ (shell.stiffness(x) @ step.ravel()))
    sizes = 0.5 ** np.arange(3, 7)
    first = [abs(shell.energy(x + h * step) - shell.energy(x) - h * slope) for h in sizes]
    second = [abs(shell.energy(x + h * step) - shell.energy(x) - h * slope - 0.5 * h**2 * curvature) for h in sizes]
    assert np.polyfit(np.log(sizes), np.log(first), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert np.polyfit(np.log(sizes), np.log(second), 1)[0] == pytest.approx(3.0, abs=0.15)
    moved = shell.rest_positions + step
    extended = shell.extended_gradient(step.astype(np.longdouble)).astype(np.float64)
    assert extended == pytest.approx(-shell.force(moved), abs=1e-11 * np.abs(extended).max())
    gauss_newton, projected = (
        shell.pattern.condensed(shell.energy_gradient_hessian(x, kind)[2])
        for kind in (
            GAUSS_NEWTON,
            PROJECTED,
        )
    )
    for matrix in (gauss_newton, projected):
        values = np.linalg.eigvalsh(matrix.toarray())
        assert values.min() > -1e-12 * values.max()
    again = pickle.loads(pickle.dumps(shell))
    assert again.energy(x) == copy.deepcopy(shell).energy(x) == shell.energy(x)


@ENERGIES
def test_rotating_shell_and_supports_rotates_the_answer(material):
    mesh = sheet(cells=(6, 6), family="delaunay")
    x, y, _ = mesh.vertices.T
    rim = mesh.boundary_vertices[:3]
    turned = TriangleMesh(mesh.vertices @ TURN.T, mesh.faces)
    answers = []
    for surface, axes in ((mesh, np.eye(3)), (turned, TURN.T)):
        supports = [Symmetry(x < 1e-9, axes[0]), Diaphragm(y > 0.499, axes[0]), Roller(rim, axes[0] + axes[2])]
        shell = Shell(surface, material, supports=supports)
        answer = DiscreteShell(shell).equilibrium(gravity=np.array([0.0, 0.1, -0.3]) @ axes)
        assert answer.converged
        answers.append((answer.positions, solve_modes(shell, 3).frequencies))
    (expected, frequencies), (found, others) = answers
    assert np.abs(expected - mesh.vertices).max() > 1e-3
    assert found == pytest.approx(expected @ TURN.T, abs=1e-8)
    assert others == pytest.approx(frequencies, rel=1e-9)


@ENERGIES
def test_six_determinate_components_hold_a_body(material):
    mesh = sheet(cells=(6, 6), family="delaunay")
    first, second, third = (
        int(np.argmin(np.linalg.norm(mesh.vertices - place, axis=1)))
        for place in ([0, -0.5, 0], [1, -0.5, 0], [0, 0.5, 0])
    )
    shell = Shell(mesh, material, supports=[Fix([first], "xyz"), Fix([second], "yz"), Fix([third], "z")])
    assert solve_modes(shell, 2).rigid_modes == 0
    gravity = np.array([0.1, 0.2, -0.05])
    answer = DiscreteShell(shell).equilibrium(gravity=gravity)
    assert answer.converged
    reactions = shell.reactions(answer.positions, gravity=gravity)
    weight = float(shell.mass.sum())
    assert reactions.sum(axis=0) == pytest.approx(-weight * gravity, abs=1e-6 * weight)
    assert set(np.flatnonzero(reactions.any(axis=1))) == {first, second, third}
    assert reactions[second, 0] == 0.0
    assert not reactions[third, :2].any()
    moments = np.cross(answer.positions, reactions + shell.mass[:, None] * gravity).sum(axis=0)
    assert moments == pytest.approx(np.zeros(3), abs=1e-6 * weight)


def test_simply_supported_plate_turns_about_pins():
    mesh = sheet(cells=(16, 16), family="delaunay")
    frequency = solve_modes(Shell(mesh, ISOTROPIC, supports=[Pin(mesh.boundary_vertices)]), 1).frequencies[0]
    rigidity = 1e6 * 0.01**3 / (12.0 * (1.0 - 0.3**2))
    assert frequency == pytest.approx(np.pi * np.sqrt(rigidity / 10.0), rel=0.012)


def test_roller_and_diaphragm_leave_one_direction():
    mesh = cylinder_panel(cells=(4, 4), family="union-jack")
    for support in (Roller([0], (1.0, 1.0, 0.0)), Diaphragm([0], (2.0, 2.0, 0.0))):
        unknowns = Shell(mesh, ISOTROPIC, supports=[support]).unknowns
        assert unknowns.count == 3 * len(mesh.vertices) - 2
        moved = unknowns.project(np.ones((len(mesh.vertices), 3)))
        assert moved[0] == pytest.approx([1.0, 1.0, 0.0])
        assert (moved[1:] == 1.0).all()


def test_tied_vertices_move_together():
    mesh = sheet(cells=(5, 5), family="delaunay")
    end = mesh.vertices[:, 0] > 1.0 - 1e-9
    shell = Shell(mesh, HINGES, mesh.vertices[:, 0] < 0.3, [Tie(end, "xz")])
    answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -0.5))
    assert answer.converged
    moved = (answer.positions - mesh.vertices)[end]
    assert np.ptp(moved[:, [0, 2]], axis=0) == pytest.approx(np.zeros(2), abs=1e-12)
    assert moved[0, 2] < -0.01
    assert np.ptp(moved[:, 1]) > 1e-6
    ties = shell.reactions(answer.positions, gravity=(0.0, 0.0, -0.5))[end]
    assert np.abs(ties).max() > 1e-6
    assert ties.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)


def test_clamped_is_short_for_a_clamp():
    mesh = sheet(cells=(4, 4))
    held = mesh.vertices[:, 0] < 0.01
    short, long = Shell(mesh, ISOTROPIC, held), Shell(mesh, ISOTROPIC, supports=[Clamp("x < 0.01")])
    assert (short.stiffness() != long.stiffness()).nnz == 0
    assert (short.free_unknowns == long.free_unknowns).all()


@pytest.mark.parametrize(
    ("supports", "error", "told"),
    [
        ([Pin("x > 5")], OptionError, "selects no vertex"),
        ([Symmetry("x < 0.5", (1, 0, 0))], SupportError, "one plane"),
        ([Pin("x < 2")], SupportError, "nothing can move"),
        ([Tie("x < 0.1", "x"), Tie("y < 0", "xz")], SupportError, "two ties"),
        ([Tie("x < 0.1", "x"), Roller([0], (1, 1, 0))], SupportError, "tied along"),
        ("pins", OptionError, "each of supports"),
        (3, SupportError, "list of supports"),
    ],
)
def test_supports_that_fit_nothing_are_refused(supports, error, told):
    with pytest.raises(error, match=told):
        Shell(sheet(cells=(4, 4)), HINGES, supports=supports)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Fix([0], "xw"),
        lambda: Fix([0], ""),
        lambda: Fix([0], 3),
        lambda: Symmetry([0], (0, 0, 0)),
        lambda: Roller([0], (np.nan, 0, 0)),
        lambda: Diaphragm([0], (1, 0)),
    ],
)
def test_directions_that_are_none_are_refused(make):
    with pytest.raises(SupportError):
        make()


def test_ties_pass_their_force_on_to_what_holds_one_of_their_vertices():
    """The support there got half of the force on its own vertex alone, and the tie held the shell by the rest."""
    mesh = sheet(cells=(4, 4))
    x, y, _ = mesh.vertices.T
    end, corner = x > 1.0 - 1e-9, int(np.argmax(x + y))
    shell = Shell(mesh, ISOTROPIC, supports=[Clamp(x < 1e-9), Tie(end, "xz"), Fix([corner], "x"), Fix([corner], "x")])
    load = {"gravity": (0.3, 0.0, -0.1)}
    answer = DiscreteShell(shell).equilibrium(**load)
    total, each = shell.reactions(answer.positions, **load), shell.support_reactions(answer.positions, **load)
    assert sum(each) == pytest.approx(total, abs=1e-12)
    _, tie, *fixes = (force.sum(axis=0) for force in each)
    assert tie == pytest.approx(np.zeros(3), abs=1e-9)
    for fix in fixes:
        assert fix == pytest.approx([0.5 * total[end, 0].sum(), 0.0, 0.0], abs=1e-9)
    assert abs(fixes[0][0]) > 1e-3
