"""Every rung on supports by component: motion, moving supports, reduced rungs, saved bases, and what is refused."""

import dataclasses

import numpy as np
import pytest

from modalshell import (
    Basis,
    Clamp,
    DiscreteShell,
    Fix,
    Isotropic,
    LinearModal,
    Material,
    ModalDerivatives,
    ModalWarping,
    OptionError,
    Outcome,
    Pin,
    PositionConstraint,
    Roller,
    RotationStrain,
    Shell,
    SpringSheet,
    SupportError,
    SupportPath,
    Symmetry,
    Tie,
    TriangleMesh,
    coarse_shell,
    sheet,
    simulate,
    solve_modes,
)

ISOTROPIC = Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0)
HINGES = Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2)
PATH = SupportPath([0.0, 0.2], [[0, 0, 0], [0.05, 0, 0.1]], [[0, 0, 0], [0, 0.3, 0]])
GRAVITY = (0.05, 0.0, -0.2)
RUNGS = {
    "DS": lambda basis: DiscreteShell(basis.shell),
    "DS, explicit": lambda basis: DiscreteShell(basis.shell, integrator="explicit"),
    "DS, Verlet": lambda basis: DiscreteShell(basis.shell, integrator="verlet"),
    "DS, linear": lambda basis: DiscreteShell(basis.shell, integrator="linear_implicit"),
    "LMA": LinearModal,
    "MWTS": ModalWarping,
    "RSW": RotationStrain,
}


def whole_and_half(material):
    """Modes of a clamped sheet that are their own mirror image, and those of its half; the half's vertices."""
    mesh = sheet(cells=(6, 6))
    kept = mesh.vertices[mesh.faces][:, :, 1].mean(axis=1) > 0.0
    numbers = np.unique(mesh.faces[kept])
    half = TriangleMesh(mesh.vertices[numbers], np.searchsorted(numbers, mesh.faces[kept]))
    plane = Symmetry(np.abs(half.vertices[:, 1]) < 1e-9, (0, 1, 0))
    part = solve_modes(Shell(half, material, half.vertices[:, 0] < 0.2, [plane]), 4)
    all_modes = solve_modes(Shell(mesh, material, mesh.vertices[:, 0] < 0.2), 12)
    same = [int(np.abs(all_modes.frequencies - frequency).argmin()) for frequency in part.frequencies]
    fields = ("modes", "rotations")
    picked = {name: np.ascontiguousarray(getattr(all_modes, name)[:, same]) for name in fields}
    return dataclasses.replace(all_modes, eigenvalues=all_modes.eigenvalues[same], **picked), part, numbers


@pytest.mark.by_default("hinges")
@pytest.mark.parametrize("material", [ISOTROPIC, HINGES], ids=["split folds", "hinges"])
def test_half_of_a_symmetric_shell_moves_as_the_whole_on_every_rung(material):
    whole, part, numbers = whole_and_half(material)
    for name, make in RUNGS.items():
        expected, found = make(whole), make(part)
        step = 1.0 / 60.0 if not name.endswith(("explicit", "Verlet")) else 0.5 * expected.stable_step()
        answers = [model.equilibrium(gravity=GRAVITY).positions for model in (expected, found)]
        assert answers[1] == pytest.approx(answers[0][numbers], abs=1e-8), name
        runs = [simulate(model, duration=8 * step, dt=step, gravity=GRAVITY) for model in (expected, found)]
        assert runs[1].positions[-1] == pytest.approx(runs[0].positions[-1][numbers], abs=1e-8), name
        assert np.abs(runs[0].positions[-1] - whole.shell.rest_positions).max() > 1e-5


def test_reduced_energy_of_half_a_shell_is_stress_free_in_its_plane():
    _, part, _ = whole_and_half(HINGES)
    model = ModalDerivatives(part.shell, 3)
    answer = model.equilibrium(gravity=GRAVITY)
    truth = DiscreteShell(part.shell).equilibrium(gravity=GRAVITY)
    moved = np.abs(truth.positions - part.shell.rest_positions).max()
    assert answer.converged
    assert np.abs(answer.positions - truth.positions).max() < 0.02 * moved
    assert np.abs(answer.positions[np.abs(part.shell.rest_positions[:, 1]) < 1e-9][:, 1]).max() < 1e-12


@pytest.mark.slow
def test_moving_supports_carry_planes_and_rollers_with_them():
    """In the frame of the supports, to the second order of the step what held vertices do in the world."""
    whole, part, numbers = whole_and_half(ISOTROPIC)
    errors = []
    for step in (1.0 / 120.0, 1.0 / 240.0):
        expected, found = (
            simulate(DiscreteShell(basis.shell), duration=0.1, dt=step, gravity=GRAVITY, supports=PATH)
            for basis in (whole, part)
        )
        errors.append(np.abs(found.positions[-1] - expected.positions[-1][numbers]).max())
        held = part.shell.clamped
        assert found.positions[-1][held] == pytest.approx(expected.positions[-1][numbers][held], abs=1e-12)
    assert 3.4 < errors[0] / errors[1] < 4.6
    assert errors[0] < 0.1 * np.abs(expected.positions[-1] - whole.shell.rest_positions).max()


@pytest.mark.slow
def test_constraints_and_moving_supports_meet_on_a_sliding_shell():
    mesh = sheet(cells=(5, 5), family="delaunay")
    x, y, _ = mesh.vertices.T
    shell = Shell(mesh, HINGES, supports=[Roller(x < 1e-9, (0, 1, 0)), Fix([int(np.argmin(x + y))], "y")])
    tip = int(np.argmax(x - np.abs(y)))
    target = mesh.vertices[tip] + [0.0, 0.0, 0.1]
    answer = DiscreteShell(shell).equilibrium(constraints=[PositionConstraint(tip, target)])
    assert answer.positions[tip] == pytest.approx(target, abs=1e-12)
    run = simulate(
        DiscreteShell(shell), duration=0.2, dt=0.01, damping=(5.0, 0.0), supports=PATH,
        constraints=[PositionConstraint(tip, target)],
    )  # fmt: skip
    assert run.positions[-1][tip] == pytest.approx(target, abs=1e-9)
    pose = PATH.at(0.2)
    own = pose.to_shell(run.positions[-1])
    assert own[x < 1e-9][:, [0, 2]] == pytest.approx(mesh.vertices[x < 1e-9][:, [0, 2]], abs=1e-9)
    with pytest.raises(SupportError, match="holds already"):
        DiscreteShell(shell).equilibrium(constraints=[PositionConstraint(int(np.argmin(x)), target)])


@pytest.mark.parametrize("integrator", ["implicit", "linear_implicit", "explicit", "verlet"])
def test_tied_vertices_share_their_momentum(integrator):
    mesh = sheet(cells=(4, 4), family="delaunay")
    end = mesh.vertices[:, 0] > 1.0 - 1e-9
    shell = Shell(mesh, HINGES, supports=[Tie(end)])
    model = DiscreteShell(shell, integrator=integrator)
    run = simulate(model, duration=0.02, dt=0.002, gravity=(0.0, 0.0, -1.0))
    moved = (run.positions[-1] - mesh.vertices)[:, 2]
    # Nothing holds it, so it falls as one.
    assert np.ptp(moved) < 1e-9
    assert moved[0] == pytest.approx(-0.5 * 0.02**2, rel=0.2)


def test_supports_are_saved_with_the_basis(tmp_path):
    mesh = sheet(cells=(4, 4))
    supports = [
        Pin("x < 0.01"),
        Symmetry(mesh.vertices[:, 1] < -0.499, (0, 1, 0)),
        Fix([3, 4], "z"),
        Tie("x > 0.99", "x"),
    ]
    basis = solve_modes(Shell(mesh, ISOTROPIC, supports=supports), 3)
    basis.save(tmp_path / "basis.npz")
    again = Basis.load(tmp_path / "basis.npz").shell
    assert [support.plain() for support in again.supports] == [support.plain() for support in basis.shell.supports]
    assert again.unknowns.count == basis.shell.unknowns.count
    assert (again.stiffness() != basis.shell.stiffness()).nnz == 0


@pytest.mark.parametrize("backend", ["cholesky", "superlu"])
def test_rsw_takes_either_factorisation_on_a_slanted_plane(backend):
    mesh = sheet(cells=(6, 6))
    x, y, _ = mesh.vertices.T
    basis = solve_modes(Shell(mesh, HINGES, x < 0.2, [Symmetry(y < y.min() + 1e-9, (0, 1, 1))]), 3)
    coordinates = np.array([1e-3, -2e-3, 1e-3])
    exact = RotationStrain(basis).displacement(coordinates)
    found = RotationStrain(basis, backend=backend).displacement(coordinates)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-13 * np.abs(exact).max())


def test_reactions_of_each_support_add_up():
    mesh = sheet(cells=(5, 5), family="delaunay")
    x, y, _ = mesh.vertices.T
    supports = [
        Pin(x < 1e-9),
        Roller(x > 1 - 1e-9, (1, 0, 0)),
        Symmetry(y < -0.499, (0, 1, 0)),
        Tie((y > 0.499) & (x > 0.1) & (x < 0.9), "y"),
    ]
    shell = Shell(mesh, ISOTROPIC, supports=supports)
    load = {"gravity": (0.3, -0.4, -0.1)}
    answer = DiscreteShell(shell).equilibrium(**load)
    total, each = shell.reactions(answer.positions, **load), shell.support_reactions(answer.positions, **load)
    assert sum(each) == pytest.approx(total, abs=1e-12)
    weight = shell.mass.sum() * np.array(load["gravity"])
    assert total.sum(axis=0) == pytest.approx(-weight, abs=1e-6 * np.abs(weight).max())
    pins, rollers, plane, ties = (force.sum(axis=0) for force in each)
    assert rollers[0] == plane[0] == plane[2] == 0.0
    assert plane[1] != 0.0
    assert np.abs(pins).min() > 0.0
    assert ties == pytest.approx(np.zeros(3), abs=1e-6 * np.abs(weight).max())


@pytest.mark.parametrize(
    ("supports", "told"),
    [
        ([], "all translations and turns"),
        ([Fix([0], "xyz")], r"a turn about \(1, 0, 0\) through \(0.5, -0.5, 0\) and a turn about \(0, 1, 0\)"),
        ([Fix("z < 1", "z")], r"a translation along \(1, 0, 0\) and a translation along \(0, 1, 0\) and a turn about"),
        (
            [Symmetry("x < 0.01", (1, 0, 0)), Fix([0], "z")],
            r"free a translation along \(0, 1, 0\) and a turn about \(1, 0, 0\)",
        ),
    ],
)
def test_rigid_motions_that_are_left_are_named(supports, told):
    shell = Shell(sheet(cells=(4, 4)), ISOTROPIC, supports=supports)
    with pytest.raises(OptionError, match=told):
        ModalDerivatives(shell, 2)
    answer = ModalWarping(solve_modes(shell, 8)).equilibrium(gravity=(0.5, 1.0, 0.0))
    assert answer.outcome is Outcome.NO_EQUILIBRIUM
    assert "free" in answer.message


def test_rungs_that_cannot_take_a_support_say_so():
    mesh = sheet(cells=(4, 4))
    sliding = Shell(mesh, HINGES, supports=[Clamp("x < 0.3"), Roller("x > 0.99", (1, 0, 0))])
    mirrored = Shell(mesh, HINGES, mesh.vertices[:, 0] < 0.3, [Symmetry("y > 0.499", (0, 1, 0))])
    with pytest.raises(SupportError, match="kind 'roller'"):
        coarse_shell(sliding, sheet(cells=(2, 2)))
    with pytest.raises(SupportError, match="plane of symmetry"):
        SpringSheet(mirrored)
    with pytest.raises(SupportError, match="single components"):
        SpringSheet(sliding, integrator="linear_implicit", solver="cg")
    with pytest.raises(SupportError, match="no translation free"):
        RotationStrain(solve_modes(Shell(mesh, HINGES, supports=[Fix("x < 0.3", "xz")]), 8))
    assert SpringSheet(sliding).equilibrium(gravity=(0, 0, -0.01)).positions.shape == mesh.vertices.shape
