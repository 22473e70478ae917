"""Shells of shell theory (split folds): derivatives, constants of homogenised meshes, invariance, edges, zero modes."""

import copy
import pickle

import numpy as np
import pytest

from modalshell import (
    Basis,
    DiscreteShell,
    Isotropic,
    LinearModal,
    Material,
    ModalWarping,
    RotationStrain,
    Shell,
    TriangleMesh,
    cylinder_panel,
    flat_beam,
    sheet,
    simulate,
    solve_modes,
    v_beam,
)
from modalshell.core.errors import MaterialError, OptionError
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED, PROJECTED
from modalshell.shell.bending import hinge_operator
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.split_folds import split_folds

FAMILIES = ["union-jack", "equilateral", "lloyd", "delaunay"]
SHEET = Isotropic(young=1e3, poisson=0.3, thickness=0.05, density=1.0)
SMALL = {
    "row": (lambda: sheet(cells=(6, 5), family="delaunay"), lambda along: along < 1e-9),
    "none": (lambda: cylinder_panel(cells=(6, 6), family="equilateral"), lambda _: None),
    "two rows": (lambda: v_beam(cells=(8, 4), fold=100.0), lambda along: along < 0.13),
    "line inside": (lambda: sheet(cells=(6, 6)), lambda along: np.isclose(along, 0.5)),
}
"""By what is clamped: the mesh, and where along x."""


def small_shell(name):
    make, held = SMALL[name]
    mesh = make()
    return Shell(mesh, SHEET, clamped=held(mesh.vertices[:, 0]))


def deformed(shell, noise=0.02, seed=0):
    random = np.random.default_rng(seed)
    x = shell.rest_positions + noise * random.standard_normal(shell.rest_positions.shape)
    step = random.standard_normal(x.shape)
    step[shell.clamped] = 0.0
    return x, step


def orders(errors):
    return np.diff(np.log(np.abs(errors))) / np.log(0.5)


@pytest.mark.parametrize("supports", SMALL)
def test_force_and_stiffness_by_taylor_slopes(supports):
    shell = small_shell(supports)
    x, step = deformed(shell)
    energy, force, stiffness = shell.energy(x), shell.force(x), shell.stiffness(x)
    sizes = 5e-4 * 0.5 ** np.arange(4)
    changes = np.array([shell.energy(x + size * step) - energy for size in sizes])
    first = changes + sizes * np.vdot(force, step)
    second = first - 0.5 * sizes**2 * (step.ravel() @ (stiffness @ step.ravel()))
    np.testing.assert_allclose(orders(first), 2.0, atol=0.1)
    np.testing.assert_allclose(orders(second), 3.0, atol=0.15)
    assert abs(stiffness - stiffness.T).max() == 0.0


@pytest.mark.by_default("two rows", "line inside")
@pytest.mark.parametrize("supports", SMALL)
def test_kinds_of_hessian(supports):
    shell = small_shell(supports)
    x, step = deformed(shell)
    products = {}
    for kind in (GAUSS_NEWTON, EXACT, PROJECTED):
        energy, gradient, data = shell.energy_gradient_hessian(x, kind)
        assert energy == pytest.approx(shell.energy(x), rel=1e-12)
        np.testing.assert_allclose(gradient, -shell.force(x), atol=1e-12 * np.abs(gradient).max())
        products[kind] = shell.pattern.condensed(data)
    # The exact stresses make the mixed Hessian exact, and the rates' energy is half the first part.
    stresses = shell.predicted_stresses(x, np.zeros_like(x))
    mixed = shell.pattern.condensed(shell.energy_gradient_hessian(x, MIXED, stresses)[2])
    later = shell.predicted_stresses(x, step)
    for kind, given in ((GAUSS_NEWTON, None), (EXACT, later), (MIXED, None), (MIXED, later), (PROJECTED, None)):
        np.testing.assert_array_equal(shell.hessian(x, kind, given), shell.energy_gradient_hessian(x, kind, given)[2])
    assert abs(mixed - products[EXACT]).max() < 1e-12 * abs(mixed).max()
    linear = 0.5 * step.ravel() @ (products[GAUSS_NEWTON] @ step.ravel())
    assert shell.elastic_energy.linear_energy(x, step) == pytest.approx(linear, rel=1e-10)
    lowest = np.linalg.eigvalsh(products[PROJECTED].toarray())[0]
    assert lowest > -1e-10 * abs(products[PROJECTED]).max()
    assert np.linalg.eigvalsh(products[EXACT].toarray())[0] < -1e-3 * abs(mixed).max()
    np.testing.assert_allclose(
        shell.pattern.product(shell.energy_gradient_hessian(x, EXACT)[2], step.ravel()),
        products[EXACT] @ step.ravel(),
        atol=1e-10 * abs(mixed).max(),
    )


@pytest.mark.parametrize("supports", SMALL)
def test_rest_shape_is_free_of_stress(supports):
    shell = small_shell(supports)
    assert shell.energy(shell.rest_positions) == 0.0
    assert not shell.force(shell.rest_positions).any()


def rotation(axis, angle):
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


@pytest.mark.parametrize("shape", [sheet, v_beam, cylinder_panel])
def test_rigid_motions_cost_nothing_and_change_nothing(shape):
    shell = Shell(shape(cells=(8, 6), family="delaunay"), SHEET)
    turn = rotation((1, -2, 0.5), 2.0)
    x, _ = deformed(shell)
    moved = x @ turn.T + (3.0, -1.0, 2.0)
    assert shell.energy(moved) == pytest.approx(shell.energy(x), rel=1e-11)
    np.testing.assert_allclose(shell.force(moved), shell.force(x) @ turn.T, atol=1e-10 * np.abs(shell.force(x)).max())
    assert shell.energy(shell.rest_positions @ turn.T) < 1e-20 * shell.energy(x)


@pytest.mark.by_default("union-jack-0.3")
@pytest.mark.parametrize("poisson", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
@pytest.mark.parametrize("family", FAMILIES)
def test_homogenised_bending_constants(family, poisson):
    """D11, D22, D12 and D66 of the middle of a sheet, whose vertices a constant curvature leaves in balance."""
    mesh = sheet(length=1.0, width=1.0, cells=(30, 26) if family == "equilateral" else (30, 30), family=family)
    count = len(mesh.faces)
    none = np.zeros(len(mesh.vertices), dtype=bool)
    folds = split_folds(mesh, np.ones(count), np.full(count, poisson), HeldSlopes.of(none), none, 1.0)
    by_fold, coupling, own = (matrix.toarray() for matrix in folds.matrices())
    x, y, _ = mesh.vertices.T
    fields = np.column_stack([0.5 * x**2, 0.5 * y**2, x * y])
    angles = hinge_operator(mesh) @ fields
    shares = -np.linalg.solve(own, coupling @ angles)
    gamma = np.where(folds.folds[:, :, None] >= 0, angles[folds.folds], 0.0)
    gamma += folds.shares[:, :, None] * np.where(folds.share_index[:, :, None] >= 0, shares[folds.share_index], 0.0)
    areas = np.append(mesh.face_areas, 0.0)[folds.faces].sum(axis=1)
    centres = mesh.vertices[folds.stencils[:, :3]].mean(axis=1)
    middle = np.flatnonzero((np.abs(centres[:, :2] - (0.5, 0.0)) < 0.15).all(axis=1))
    density = np.einsum("tki,tkl,tlj->ij", gamma[middle], folds.moments[middle], gamma[middle])
    density /= areas[middle].sum()
    exact = np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, 2.0 * (1.0 - poisson)]])
    np.testing.assert_allclose(density, exact, atol=1e-3)
    couples = by_fold @ angles + coupling.T @ shares
    inner = (np.abs(mesh.vertices[:, :2] - (0.5, 0.0)) < 0.15).all(axis=1)
    forces = hinge_operator(mesh).T @ couples
    assert np.abs(forces[inner]).max() < 1e-3 * np.abs(forces).max()


@pytest.mark.by_default("0.0-equilateral", "0.3-union-jack", "0.3-lloyd")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_membrane_is_exact_in_homogeneous_strain(family, poisson):
    mesh = sheet(cells=(6, 5), family=family)
    shell = Shell(mesh, Isotropic(young=7.0, poisson=poisson, thickness=0.1, density=1.0))
    strain = np.array([[0.02, 0.01], [0.01, -0.03]])
    # The symmetric square root of I + 2 E stretches the sheet by exactly this Green strain.
    values, vectors = np.linalg.eigh(np.eye(2) + 2.0 * strain)
    x = np.array(mesh.vertices)
    x[:, :2] = x[:, :2] @ ((vectors * np.sqrt(values)) @ vectors.T)
    stress = 0.7 / (1.0 - poisson**2) * ((1.0 - poisson) * strain + poisson * np.trace(strain) * np.eye(2))
    assert shell.energy(x) == pytest.approx(0.5 * np.vdot(stress, strain) * mesh.area, rel=1e-12)


@pytest.mark.by_default("sheet-union-jack", "cylinder_panel-equilateral")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("shape", [sheet, cylinder_panel, v_beam])
def test_free_shells_have_exactly_six_zero_modes(shape, family):
    shell = Shell(shape(cells=(8, 6), family=family), Isotropic(1e6, 0.3, 0.01, 1000.0))
    stiffness = shell.stiffness().toarray()
    root = np.sqrt(np.repeat(shell.mass, 3))
    values = np.linalg.eigvalsh(stiffness / root[:, None] / root)
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-7 * values[-1]
    basis = solve_modes(shell, 9)
    assert basis.rigid_modes == 6
    np.testing.assert_allclose(basis.eigenvalues[6:], values[6:9], rtol=1e-6)


@pytest.mark.by_default("union-jack", "equilateral")
@pytest.mark.parametrize("family", FAMILIES)
def test_one_held_row_clamps(family):
    """A strip's lowest frequency is the clamped beam's, and two rows clamp at the second one."""
    mesh = flat_beam(length=1.0, width=0.2, cells=(30, 6), family=family)
    sheet_material = Isotropic(young=1e9, poisson=0.0, thickness=1e-3, density=1000.0)
    unit = np.sqrt(1e9 * 1e-6 / (12.0 * 1000.0)) / (2.0 * np.pi)
    along = mesh.vertices[:, 0]
    one = solve_modes(Shell(mesh, sheet_material, clamped=along < 1e-9), 1)
    assert one.rigid_modes == 0
    assert one.frequencies[0] == pytest.approx(3.51602 * unit, rel=4e-3)
    if family in ("union-jack", "equilateral"):
        two = solve_modes(Shell(mesh, sheet_material, clamped=along < 1.0 / 30 + 1e-9), 1)
        assert two.frequencies[0] == pytest.approx(3.51602 * unit / (29 / 30) ** 2, rel=4e-3)


def test_a_line_held_inside_gives_each_side_its_own_clamp():
    mesh = flat_beam(length=2.0, width=0.2, cells=(40, 4))
    shell = Shell(mesh, Isotropic(1e9, 0.0, 1e-3, 1000.0), clamped=np.isclose(mesh.vertices[:, 0], 1.0))
    half = flat_beam(length=1.0, width=0.2, cells=(20, 4))
    alone = Shell(half, Isotropic(1e9, 0.0, 1e-3, 1000.0), clamped=half.vertices[:, 0] < 1e-9)
    both = solve_modes(shell, 2).frequencies
    np.testing.assert_allclose(both, solve_modes(alone, 1).frequencies[0], rtol=2e-3)


def test_triangles_that_are_held_wholly_do_not_bend():
    mesh = flat_beam(length=1.0, width=0.2, cells=(10, 2))
    x = np.array(mesh.vertices)
    x[np.argmin(x[:, 0]), 2] += 0.05  # far from the edge between held and free triangles

    def share_of_bending(clamped):
        """Membrane energy grows as the thickness, bending energy as its cube."""
        thick, thin = (Shell(mesh, Isotropic(1e3, 0.3, h, 1.0), clamped=clamped).energy(x) for h in (0.05, 5e-5))
        return 1.0 - 1000.0 * thin / thick

    assert share_of_bending(None) > 0.1
    assert abs(share_of_bending(mesh.vertices[:, 0] < 0.25)) < 1e-12


def test_single_triangle_and_pair():
    triangle = Shell(TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), SHEET)
    assert triangle.stiffness().shape == (9, 9)
    assert triangle.energy(2.0 * triangle.rest_positions) > 0.0
    pair = Shell(TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]]), SHEET)
    x = np.array(pair.rest_positions)
    x[3, 2] = 0.3
    turned = Shell(pair.mesh, SHEET).energy(x @ rotation((0, 1, 1), 1.0).T)
    assert pair.energy(x) == pytest.approx(turned, rel=1e-12)
    assert pair.energy(x) > 0.0


@pytest.mark.by_default("ModalWarping", "RotationStrain")
@pytest.mark.parametrize("model", [LinearModal, ModalWarping, RotationStrain])
def test_modal_models_follow_small_loads(model):
    mesh = cylinder_panel(length=0.3, radius=0.3, angle=40.0, cells=(10, 8))
    shell = Shell(mesh, Isotropic(1e9, 0.3, 1e-3, 1000.0), clamped=mesh.vertices[:, 0] < 1e-9)
    truth = DiscreteShell(shell).equilibrium(gravity=(0, 0, -1e-3))
    assert truth.converged
    assert truth.stable
    answer = model(solve_modes(shell, 60)).equilibrium(gravity=(0, 0, -1e-3))
    sag = np.abs(truth.positions - mesh.vertices).max()
    assert np.abs(answer.positions - truth.positions).max() < 0.01 * sag


@pytest.mark.slow
def test_motion_of_every_integrator():
    mesh = flat_beam(length=0.3, width=0.1, cells=(8, 3), family="delaunay")
    shell = Shell(mesh, Isotropic(1e6, 0.3, 2e-3, 1000.0), clamped=mesh.vertices[:, 0] < 1e-9)
    model = DiscreteShell(shell, integrator="verlet")
    step = 0.9 * model.stable_step()
    duration = 400 * step
    exact = simulate(model, duration=duration, dt=step, gravity=(0, 0, -1.0))
    assert exact.status == "completed"
    implicit = simulate(DiscreteShell(shell), duration=duration, dt=step, gravity=(0, 0, -1.0))
    moved = exact.positions[-1] - mesh.vertices
    assert np.abs(implicit.positions[-1] - exact.positions[-1]).max() < 0.02 * np.abs(moved).max()


@pytest.mark.slow
def test_stiffness_damping_of_implicit_steps_decays_like_its_mode():
    mesh = flat_beam(length=0.3, width=0.1, cells=(8, 3))
    shell = Shell(mesh, Isotropic(1e6, 0.3, 2e-3, 1000.0), clamped=mesh.vertices[:, 0] < 1e-9)
    basis = solve_modes(shell, 1)
    zeta = 0.02 / np.sqrt(basis.eigenvalues[0])
    options = {"duration": 2.0 / basis.frequencies[0], "dt": 0.01 / basis.frequencies[0], "damping": (0.0, zeta)}
    full = simulate(DiscreteShell(shell, step_tolerance=1e-9), gravity=(0, 0, -1e-4), **options)
    modal = simulate(LinearModal(solve_modes(shell, 20)), gravity=(0, 0, -1e-4), **options)
    assert full.unconverged_steps == 0
    moved = np.abs(modal.positions - mesh.vertices).max()
    assert np.abs(full.positions - modal.positions).max() < 0.01 * moved


def test_basis_with_functions_survives_a_file(tmp_path):
    mesh = flat_beam(cells=(8, 2))
    material = Isotropic(1e6, 0.3, lambda centres: 0.01 + 0.01 * centres[:, 0], 1000.0)
    shell = Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-9)
    basis = solve_modes(shell, 3)
    basis.save(tmp_path / "basis.npz")
    again = Basis.load(tmp_path / "basis.npz")
    np.testing.assert_array_equal(again.modes, basis.modes)
    assert again.shell.material.young == 1e6
    x, _ = deformed(shell)
    assert again.shell.energy(x) == shell.energy(x)
    uniform = Shell(mesh, Isotropic(1e6, 0.3, 0.01, 1000.0))
    assert shell.mass.sum() == pytest.approx(1.5 * uniform.mass.sum())


def test_copies_and_pickles_give_the_same_bits():
    shell = small_shell("row")
    x, _ = deformed(shell)
    for other in (copy.deepcopy(shell), pickle.loads(pickle.dumps(shell))):
        assert other.energy(x) == shell.energy(x)
        assert np.array_equal(other.force(x), shell.force(x))


def test_stiffness_in_one_triangle_counts_there_alone():
    mesh = sheet(cells=(5, 5))
    young = np.full(len(mesh.faces), 1e3)
    even = Shell(mesh, Isotropic(young, 0.3, 0.05, 1.0))
    x, _ = deformed(even)
    assert even.energy(x) == pytest.approx(Shell(mesh, SHEET).energy(x), rel=1e-13)
    young[7] *= 2.0
    assert Shell(mesh, Isotropic(young, 0.3, 0.05, 1.0)).energy(x) > even.energy(x)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0, 0.3, 1e-3, 1.0), "young must be positive"),
        ((1e9, 0.6, 1e-3, 1.0), "poisson must be above -1 and at most 0.5"),
        ((1e9, -1.0, 1e-3, 1.0), "poisson must be above -1"),
        ((1e9, 0.3, -1e-3, 1.0), "thickness must be positive"),
        ((1e9, 0.3, 1e-3, float("nan")), "density must be finite"),
        (([[1.0]], 0.3, 1e-3, 1.0), "young must be finite, one number or one per triangle"),
        (("stiff", 0.3, 1e-3, 1.0), "young must be one number"),
    ],
)
def test_refused_materials(values, message):
    with pytest.raises(MaterialError, match=message):
        Isotropic(*values)


def test_refused_uses():
    mesh = flat_beam(cells=(4, 2))
    with pytest.raises(MaterialError, match="young has 3 values, but the mesh has 16 triangles"):
        Shell(mesh, Isotropic(np.ones(3), 0.3, 0.1, 1.0))
    with pytest.raises(MaterialError, match="thickness must be positive"):
        Shell(mesh, Isotropic(1.0, 0.3, lambda centres: -centres[:, 0], 1.0))
    with pytest.raises(OptionError, match="material must be a Material, an Isotropic or another sheet"):
        Shell(mesh, 1.0)
    shell = Shell(mesh, SHEET, clamped=mesh.vertices[:, 0] < 1e-9)
    with pytest.raises(OptionError, match="discrete-shell energies"):
        _ = shell.elements
    assert isinstance(Shell(mesh, Material(1.0, 1.0, 1.0, 1.0)).elements, list)
