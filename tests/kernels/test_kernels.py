"""The generated kernels and their assembly: derivatives, invariance, the kinds of Hessian."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from scenes import folds, hinge_mesh, noisy
from scipy.spatial.transform import Rotation

from modalshell import Material, Shell, TriangleMesh, cylinder_panel, leaf, sheet, v_beam
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED, PROJECTED
from modalshell.shell.kernels.generated import flexure, shear, stretch

KERNELS = {"stretch": stretch, "shear": shear, "flexure": flexure}
ENERGIES = ("stretch", "shear", "flexure", "all")
EPSILON = np.finfo(float).eps
STEPS = np.logspace(-1.5, -3.0, 7)
"""Step sizes of the Taylor tests, in units of a tenth of the shortest edge."""

coordinate = st.floats(-3.0, 3.0)
vector = st.tuples(coordinate, coordinate, coordinate).map(np.array)
seeds = st.integers(0, 2**16)


def material_of(mesh, energy, seed=7):
    """Stiffness of one energy or of all, another value on every element, so that no two may be mixed up."""
    rng = np.random.default_rng(seed)
    counts = {"stretch": len(mesh.faces), "shear": len(mesh.edges), "flexure": len(mesh.hinges)}
    scales = {"stretch": 5.0, "shear": 3.0, "flexure": 0.02}
    values = {
        name: scales[name] * rng.uniform(0.5, 2.0, count) if energy in (name, "all") else 0.0
        for name, count in counts.items()
    }
    return Material(**values, density=1.0)


def zigzag(mesh, fold):
    """Positions of a flat lattice pleated along its columns, up and down in turn, by ``fold`` [rad] each."""
    x = mesh.vertices.copy()
    columns = np.unique(x[:, 0])
    number = np.searchsorted(columns, x[:, 0])
    x[:, 0] = columns[number] * np.cos(fold / 2)
    x[:, 2] = (number % 2) * (columns[1] - columns[0]) * np.sin(fold / 2)
    return x


def state(scene):
    """A mesh, a deformed state without noise, and the noise to add in shortest edges."""
    if scene == "cylinder":
        mesh = cylinder_panel(cells=(5, 6), angle=100.0)
        return mesh, mesh.vertices, 0.1
    if scene == "leaf":
        mesh = leaf(cells=(6, 4))
        return mesh, mesh.vertices, 0.1
    if scene == "v_beam":
        mesh = v_beam(cells=(6, 4))
        return mesh, mesh.vertices, 0.1
    if scene == "closed v_beam":  # ridge at 160 degrees
        return v_beam(cells=(6, 4)), v_beam(cells=(6, 4), fold=20.0).vertices, 0.02
    if scene == "inverted v_beam":  # ridge at -160 degrees where +30 is rest: theta - theta0 needs its wrap
        return v_beam(cells=(6, 4)), v_beam(cells=(6, 4), fold=20.0).vertices * (1, 1, -1), 0.02
    mesh = sheet(cells=(6, 4), family="right")
    return mesh, zigzag(mesh, np.radians(155.0)), 0.02


SCENES = ("cylinder", "leaf", "v_beam", "closed v_beam", "inverted v_beam", "pleated sheet")


def slope(remainders):
    return np.polyfit(np.log(STEPS), np.log(remainders), 1)[0]


@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize("scene", SCENES)
def test_derivatives_pass_the_taylor_test(scene, energy):
    mesh, x, noise = state(scene)
    shell = Shell(mesh, material_of(mesh, energy))
    x = noisy(mesh, x, noise)
    direction = 0.1 * mesh.edge_lengths.min() * np.random.default_rng(1).standard_normal(x.shape)
    energy_0, gradient = shell.energy(x), -shell.force(x)
    stiffness = shell.stiffness(x)
    along = (stiffness @ direction.ravel()).reshape(-1, 3)
    first, second, force = [], [], []
    for h in STEPS:
        moved = x + h * direction
        remainder = shell.energy(moved) - energy_0 - h * np.vdot(gradient, direction)
        first.append(abs(remainder))
        second.append(abs(remainder - 0.5 * h**2 * np.vdot(direction, along)))
        force.append(np.linalg.norm(-shell.force(moved) - gradient - h * along))
    assert second[-1] > 100 * EPSILON * energy_0, "the smallest step is lost in rounding"
    assert slope(first) == pytest.approx(2.0, abs=0.1)
    assert slope(second) == pytest.approx(3.0, abs=0.1)
    assert slope(force) == pytest.approx(2.0, abs=0.1)


def test_scenes_of_the_taylor_test_are_folded_as_they_say():
    for scene in ("closed v_beam", "inverted v_beam", "pleated sheet"):
        mesh, x, noise = state(scene)
        angles = folds(mesh, noisy(mesh, x, noise))
        rest = folds(mesh, mesh.vertices)
        assert 2.5 < np.abs(angles).max() < math.pi - 0.05
        wrapped = np.abs(angles - rest).max() > math.pi
        assert wrapped == (scene == "inverted v_beam")


@pytest.mark.by_default("all")
@pytest.mark.parametrize("energy", ENERGIES)
@given(turn=vector, shift=vector)
@settings(deadline=None, max_examples=15)
def test_rigid_motions_of_the_rest_shape_are_free(energy, turn, shift):
    for mesh in (cylinder_panel(cells=(4, 5), angle=100.0), v_beam(cells=(6, 4))):
        shell = Shell(mesh, material_of(mesh, energy))
        x = mesh.vertices @ Rotation.from_rotvec(turn).as_matrix().T + shift
        stiffness = abs(shell.stiffness(mesh.vertices)).max()
        rounding = 10.0 * EPSILON * (1.0 + np.linalg.norm(shift)) * stiffness
        assert np.abs(shell.force(x)).max() <= 10.0 * rounding
        assert 0.0 <= shell.energy(x) <= len(mesh.edges) * rounding**2 / stiffness * 100.0


@pytest.mark.parametrize("energy", ENERGIES)
@given(turn=vector, shift=vector, seed=seeds)
@settings(deadline=None, max_examples=15)
def test_energy_is_invariant_and_force_turns_along(energy, turn, shift, seed):
    mesh = v_beam(cells=(6, 4))
    shell = Shell(mesh, material_of(mesh, energy))
    x = noisy(mesh, mesh.vertices, 0.1, seed)
    rotation = Rotation.from_rotvec(turn)
    moved = rotation.apply(x) + shift
    assert shell.energy(moved) == pytest.approx(shell.energy(x), rel=1e-11)
    force = shell.force(x)
    np.testing.assert_allclose(shell.force(moved), rotation.apply(force), rtol=0, atol=1e-11 * np.abs(force).max())
    block = np.kron(np.eye(len(x)), rotation.as_matrix())
    turned = block @ shell.stiffness(x).toarray() @ block.T
    np.testing.assert_allclose(shell.stiffness(moved).toarray(), turned, rtol=0, atol=1e-10 * np.abs(turned).max())


@given(seed=seeds)
@settings(deadline=None, max_examples=10)
def test_internal_forces_carry_no_resultant(seed):
    mesh = leaf(cells=(6, 4))
    shell = Shell(mesh, material_of(mesh, "all"))
    x = noisy(mesh, mesh.vertices, 0.2, seed)
    force = shell.force(x)
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() <= 1e-14 * scale
    assert np.abs(np.cross(x, force).sum(axis=0)).max() <= 1e-14 * scale


@pytest.mark.parametrize("name", KERNELS)
def test_numpy_evaluation_of_the_same_functions(name):
    kernel = KERNELS[name]
    relative = np.random.default_rng(3).standard_normal((200, kernel.UNKNOWNS))
    size = kernel.UNKNOWNS
    gradient, hessian = np.empty((size, 200)), np.empty((size * (size + 1) // 2, 200))
    value = kernel._second(*relative.T, gradient, hessian)
    first_gradient = np.empty_like(gradient)
    np.testing.assert_allclose(kernel._first(*relative.T, first_gradient), value, rtol=1e-14)
    np.testing.assert_allclose(kernel._measure(*relative.T), value, rtol=1e-14)
    np.testing.assert_allclose(first_gradient, gradient, rtol=1e-11, atol=1e-14)
    local, packed = np.empty(size), np.empty(len(hessian))
    for k, row in enumerate(relative):
        assert kernel.second_derivatives(*row, local, packed) == pytest.approx(value[k], rel=1e-12)
        np.testing.assert_allclose(local, gradient[:, k], rtol=0, atol=1e-12 * np.abs(gradient[:, k]).max())
        np.testing.assert_allclose(packed, hessian[:, k], rtol=0, atol=1e-12 * np.abs(hessian[:, k]).max())


@pytest.mark.parametrize("name", KERNELS)
def test_assembled_gradient_and_hessian_are_the_elements_own(name):
    """Scatter by hand, from the NumPy functions, in twelve unknowns."""
    mesh, x, noise = state("leaf")
    x = noisy(mesh, x, noise)
    shell = Shell(mesh, material_of(mesh, name))
    elements = shell.elements[list(KERNELS).index(name)]
    kernel, count = elements.kernel, elements.stencils.shape[1]
    corners = x[elements.stencils]
    relative = (corners[:, 1:] - corners[:, :1]).reshape(len(corners), -1)
    size = kernel.UNKNOWNS
    gradient, packed = np.empty((size, len(corners))), np.empty((size * (size + 1) // 2, len(corners)))
    value = kernel._second(*relative.T, gradient, packed)
    deviation = value - elements.rest
    spread = np.vstack([np.hstack([-np.eye(3)] * (count - 1)).reshape(3, size), np.eye(size)])
    total, force = np.zeros((x.size, x.size)), np.zeros(x.size)
    rows, columns = np.tril_indices(size)
    for k, stencil in enumerate(elements.stencils):
        local = np.zeros((size, size))
        local[rows, columns] = local[columns, rows] = packed[:, k]
        stress = 2 * elements.weight[k] * deviation[k]
        block = 2 * elements.weight[k] * np.outer(gradient[:, k], gradient[:, k]) + stress * local
        unknowns = (3 * stencil[:, None] + np.arange(3)).ravel()
        total[np.ix_(unknowns, unknowns)] += spread @ block @ spread.T
        force[unknowns] -= spread @ (stress * gradient[:, k])
    assert shell.energy(x) == pytest.approx(np.sum(elements.weight * deviation**2), rel=1e-12)
    np.testing.assert_allclose(shell.force(x).ravel(), force, rtol=0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(shell.stiffness(x).toarray(), total, rtol=0, atol=1e-12 * np.abs(total).max())


@pytest.mark.parametrize("scene", SCENES)
def test_mixed_hessian_with_the_true_stresses_is_the_exact_one(scene):
    mesh, x, noise = state(scene)
    x = noisy(mesh, x, noise)
    shell = Shell(mesh, material_of(mesh, "all"))
    stresses = shell.predicted_stresses(x, np.zeros_like(x))
    for e, stress in zip(shell.elements, stresses, strict=True):
        measures = np.empty(e.rest.size)
        e.kernel.measures(x, e.stencils, measures)
        deviation = measures - e.rest
        if e.kernel is flexure:
            deviation = math.pi - (math.pi - deviation) % (2 * math.pi)
        expected = 2 * e.weight * deviation
        np.testing.assert_allclose(stress, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    exact = shell.energy_gradient_hessian(x, EXACT)
    mixed = shell.energy_gradient_hessian(x, MIXED, stresses)
    assert mixed[0] == exact[0]
    np.testing.assert_array_equal(mixed[1], exact[1])
    np.testing.assert_allclose(mixed[2], exact[2], rtol=0, atol=1e-13 * np.abs(exact[2]).max())
    gauss_newton = shell.energy_gradient_hessian(x, GAUSS_NEWTON)[2]
    without = shell.energy_gradient_hessian(x, MIXED, [np.zeros_like(stress) for stress in stresses])[2]
    np.testing.assert_array_equal(without, gauss_newton)
    assert np.abs(gauss_newton - exact[2]).max() > 1e-3 * np.abs(exact[2]).max()


def test_predicted_stress_is_the_linearised_measure():
    mesh, x, noise = state("leaf")
    x = noisy(mesh, x, noise)
    shell = Shell(mesh, material_of(mesh, "all"))
    direction = mesh.edge_lengths.min() * np.random.default_rng(2).standard_normal(x.shape)
    now = shell.predicted_stresses(x, np.zeros_like(x))
    predicted = shell.predicted_stresses(x, direction)
    h = 1e-6
    ahead, behind = (shell.predicted_stresses(x + s * direction, np.zeros_like(x)) for s in (h, -h))
    for k in range(3):
        rate = (ahead[k] - behind[k]) / (2 * h)
        np.testing.assert_allclose(predicted[k] - now[k], rate, rtol=0, atol=1e-7 * np.abs(rate).max())


@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize("scene", SCENES)
def test_projected_hessian_is_positive_semidefinite_and_above_the_exact_one(scene, energy):
    mesh, x, noise = state(scene)
    x = noisy(mesh, x, noise)
    shell = Shell(mesh, material_of(mesh, energy))
    exact, projected = (shell.energy_gradient_hessian(x, kind) for kind in (EXACT, PROJECTED))
    assert projected[0] == exact[0]
    np.testing.assert_array_equal(projected[1], exact[1])
    exact, projected = (shell.pattern.matrix(result[2]).toarray() for result in (exact, projected))
    largest = np.linalg.norm(projected, 2)
    np.testing.assert_allclose(projected, projected.T, rtol=0, atol=1e-14 * largest)
    assert np.linalg.eigvalsh(exact)[0] < -1e-6 * largest, "nothing to project here"
    assert np.linalg.eigvalsh(projected)[0] >= -1e-13 * largest
    assert np.linalg.eigvalsh(projected - exact)[0] >= -1e-13 * largest


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", KERNELS)
def test_convex_rows_bound_the_second_variation(name, sign):
    """Their sum of squares lies above 0 and above sign Hess g, and not above |Hess g| by more than a small factor."""
    kernel = KERNELS[name]
    size, convex_rows = kernel.UNKNOWNS, kernel.convex_rows
    triangle = np.tril_indices(size)

    @njit
    def convex(relative, sign, factors, squares, firsts, seconds, rows):  # only kernels can call it
        convex_rows(*relative, sign, factors, squares, firsts, seconds, rows)

    for relative in np.random.default_rng(11).standard_normal((50, size)):
        gradient, packed = np.empty(size), np.empty(size * (size + 1) // 2)
        kernel.second_derivatives(*relative, gradient, packed)
        hessian = np.zeros((size, size))
        hessian[triangle] = hessian.T[triangle] = sign * packed
        squares, products = kernel.SQUARES, kernel.PRODUCTS
        work = [np.empty(squares), *(np.empty((count, size)) for count in (squares, products, products))]
        rows = np.empty((squares + products, size))
        convex(tuple(relative), sign, *work, rows)
        kept = rows.T @ rows
        values, vectors = np.linalg.eigh(hessian)
        largest = np.abs(values).max()
        assert np.linalg.eigvalsh(kept - hessian)[0] >= -1e-12 * largest
        positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
        assert np.trace(kept) <= 4.0 * np.abs(values).sum()
        if name == "shear":  # |e| is convex: all of it is kept, or none
            np.testing.assert_allclose(kept, positive, rtol=0, atol=1e-12 * largest)


@pytest.mark.parametrize("energy", ENERGIES[:3])
def test_projection_leaves_positive_elements_alone(energy):
    """One element at a time: EXACT where that is positive semi-definite, something else where it is not."""
    kept, changed = 0, 0
    for seed in range(40):
        mesh = TriangleMesh(*hinge_mesh(0.4))
        shell = Shell(mesh, material_of(mesh, energy, seed))
        element = shell.elements[ENERGIES.index(energy)]
        element.weight[1:] = 0.0
        x = noisy(mesh, mesh.vertices, 0.3, seed)
        exact, projected = (
            shell.pattern.matrix(shell.energy_gradient_hessian(x, kind)[2]).toarray() for kind in (EXACT, PROJECTED)
        )
        largest = np.linalg.norm(exact, 2)
        # In the element's own unknowns, relative to its first vertex.
        local = (3 * element.stencils[0, 1:, None] + np.arange(3)).ravel()
        lowest = np.linalg.eigvalsh(exact[np.ix_(local, local)])[0]
        difference = np.abs(projected - exact).max()
        if lowest >= -1e-13 * largest:
            kept += 1
            assert difference <= 1e-12 * largest
        else:
            changed += 1
            assert difference > 1e-14 * largest
    assert changed > 5
    assert kept > 5 or energy != "shear"


@pytest.mark.parametrize(
    "make",
    [lambda: cylinder_panel(cells=(5, 6), angle=100.0), lambda: v_beam(cells=(6, 4)), lambda: leaf(cells=(6, 4))],
    ids=["cylinder", "V", "leaf"],
)
def test_all_hessians_agree_at_rest(make):
    mesh = make()
    shell = Shell(mesh, material_of(mesh, "all"))
    gauss_newton, exact, projected = (
        shell.energy_gradient_hessian(shell.rest_positions, kind)[2] for kind in (GAUSS_NEWTON, EXACT, PROJECTED)
    )
    largest = np.abs(exact).max()
    np.testing.assert_allclose(exact, gauss_newton, rtol=0, atol=1e-13 * largest)
    np.testing.assert_allclose(projected, gauss_newton, rtol=0, atol=1e-13 * largest)
    np.testing.assert_allclose(shell.force(shell.rest_positions), 0.0, atol=1e-13 * largest)


@pytest.mark.parametrize("family", ["alternating", "equilateral", "lloyd", "right"])
@pytest.mark.parametrize("shape", [sheet, v_beam, cylinder_panel, leaf])
def test_free_shells_have_six_zero_modes_at_rest(shape, family):
    mesh = shape(cells=(6, 4), family=family)
    shell = Shell(mesh, Material(stretch=20.0, shear=20.0, flexure=0.05, density=1.0))
    values = np.linalg.eigvalsh(shell.stiffness().toarray())
    rounding = 100.0 * EPSILON * values[-1]
    assert values[0] >= -rounding
    assert np.count_nonzero(values <= rounding) == 6
    assert values[6] > 1e3 * rounding


@pytest.mark.parametrize("energy", ENERGIES)
def test_damping_force_is_the_first_term_of_the_hessian(energy):
    mesh, x, noise = state("v_beam")
    x = noisy(mesh, x, noise)
    shell = Shell(mesh, material_of(mesh, energy))
    velocity = np.random.default_rng(4).standard_normal(x.shape)
    matrix = shell.pattern.matrix(shell.energy_gradient_hessian(x, GAUSS_NEWTON)[2])
    expected = -(matrix @ velocity.ravel()).reshape(-1, 3)
    force = shell.damping_force(x, velocity)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.vdot(force, velocity) < 0
    spin = np.cross((0.3, -1.2, 0.8), x) + np.array([1.0, 2.0, 3.0])
    assert np.abs(shell.damping_force(x, spin)).max() <= 1e-12 * np.abs(matrix.data).max()
