"""What rounding does to a balance of forces: coordinates far away, stiff membranes, tiny loads."""

import numpy as np
import pytest
from scenes import cantilever

import modalshell as ms


def strip(thickness, offset=(0.0, 0.0, 0.0), young=1e9, density=1000.0):
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(40, 4), family="equilateral")
    material = ms.Material.from_physical(young=young, poisson=0.0, thickness=thickness, density=density, mesh=mesh)
    moved = ms.TriangleMesh(mesh.vertices + np.array(offset), mesh.faces)
    return ms.Shell(moved, material, mesh.vertices[:, 0] < 0.04)


def gravity_of(thickness, gamma):
    """The acceleration at which a strip of length 1 m has the elastica's load parameter gamma."""
    return (0.0, 0.0, -gamma * 1e9 * thickness**2 / 12.0 / 1000.0)


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("offset", [(5e5, 5e6, 0.0), (-3e8, 0.0, 1e4)])
def test_a_steel_strip_at_map_coordinates_drops_as_at_the_origin(offset, given):
    gravity = (0.0, 0.0, -9.81)
    near = strip(1e-3, young=210e9, density=7850.0)
    far = strip(1e-3, offset, young=210e9, density=7850.0)
    expected = ms.DiscreteShell(near).equilibrium(gravity=gravity)
    start = far.rest_positions if given else None
    answer = ms.DiscreteShell(far).equilibrium(gravity=gravity, start=start)
    assert expected.converged
    assert answer.converged
    assert answer.residual <= 1e-7
    assert answer.stable
    assert 0.38 < -expected.positions[:, 2].min() < 0.43
    drops = answer.positions - far.rest_positions
    np.testing.assert_allclose(drops, expected.positions - near.rest_positions, rtol=0, atol=1e-3)


@pytest.mark.parametrize("given", [False, True])
def test_constraints_at_map_coordinates_are_met(given):
    offset = np.array([5e5, 5e6, 100.0])
    shell = strip(1e-2, offset)
    tip = np.flatnonzero(shell.rest_positions[:, 0] > 5e5 + 1.0 - 1e-6)
    target = shell.rest_positions[tip].mean(axis=0) + np.array([-0.1, 0.0, 0.3])
    answer = ms.DiscreteShell(shell).equilibrium(
        gravity=gravity_of(1e-2, 0.1),
        start=shell.rest_positions if given else None,
        constraints=[ms.PositionConstraint(tip, target)],
    )
    assert answer.converged, answer.message
    np.testing.assert_allclose(answer.positions[tip].mean(axis=0), target, rtol=0, atol=1e-8)


def test_a_mesh_without_digits_for_its_shape_is_refused():
    mesh = ms.flat_beam(cells=(10, 2))
    with pytest.raises(ms.MeshError, match="subtract its mean"):
        ms.TriangleMesh(mesh.vertices + np.array([2e9, 0.0, 0.0]), mesh.faces)


@pytest.mark.parametrize("gamma", [1e-6, 1e-3, 1.0, 5.0])
@pytest.mark.parametrize("thickness", [1e-2, 1e-3, 1e-4])
def test_sheets_up_to_ten_thousand_times_longer_than_thick_are_balanced(thickness, gamma):
    """In double precision alone the residual stays at up to 90 times the load."""
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("this machine's longdouble is double precision")
    shell = strip(thickness)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=gravity_of(thickness, gamma))
    assert answer.outcome is ms.Outcome.CONVERGED
    assert answer.residual <= 1e-7
    if gamma < 0.1:  # the linear answer of a cantilever
        free = 1.0 - shell.rest_positions[shell.clamped, 0].max()
        drop = -answer.positions[shell.rest_positions[:, 0] > 1.0 - 1e-9, 2].mean()
        assert drop == pytest.approx(gamma * free**4 / 8.0, rel=0.05)


@pytest.mark.parametrize("given", [False, True])
def test_a_foil_is_limited_by_rounding_and_says_so(given):
    """Length over thickness of a million: membrane over bending stiffness 1e12 and more."""
    shell = strip(1e-6)
    start = shell.rest_positions if given else None
    answer = ms.DiscreteShell(shell).equilibrium(gravity=gravity_of(1e-6, 1.0), start=start)
    reference = ms.DiscreteShell(strip(1e-4)).equilibrium(gravity=gravity_of(1e-4, 1.0))
    assert answer.outcome in (ms.Outcome.ROUNDING_LIMITED, ms.Outcome.CONVERGED)
    assert answer.converged == (answer.residual <= 1e-7)
    assert answer.converged or "rounding" in answer.message
    assert -answer.positions[:, 2].min() == pytest.approx(-reference.positions[:, 2].min(), rel=0.05)


def test_extended_gradient_agrees_with_the_kernels():
    shell = cantilever((6, 4))
    for size in (1e-1, 1e-3, 1e-6):
        moved = size * np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
        exact = shell.extended_gradient(moved.astype(np.longdouble))
        rounded = shell.energy_gradient(shell.rest_positions + moved)[1]
        np.testing.assert_allclose(rounded, exact.astype(float), rtol=0, atol=1e-13 + 1e-10 * np.abs(rounded).max())


def test_extended_gradient_of_a_tiny_displacement_is_linear():
    shell = cantilever((6, 4))
    moved = 1e-30 * np.random.default_rng(0).standard_normal(shell.rest_positions.shape).astype(np.longdouble)
    exact = shell.extended_gradient(moved).astype(float)
    linear = (shell.stiffness() @ moved.astype(float).ravel()).reshape(-1, 3)
    np.testing.assert_allclose(exact, linear, rtol=0, atol=1e-12 * np.abs(linear).max())
