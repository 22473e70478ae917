"""What rounding does to a balance of forces: coordinates far away, stiff membranes, tiny loads."""

from functools import partial

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


@pytest.mark.by_default("offset0-False", "offset1-True")
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


MESHES = [("alternating", (20, 4)), ("equilateral", (20, 2)), ("equilateral", (20, 4))]
MAP = np.array([5e5, 5e6, 0.0])


def narrow_strip(family, cells, thickness=1e-3, offset=(0.0, 0.0, 0.0)):
    """A strip of steel 1 m long and 5 cm wide, its first two rows held; calibrated where it lies."""
    mesh = ms.flat_beam(length=1.0, width=0.05, cells=cells, family=family)
    held = mesh.vertices[:, 0] < 1.01 / cells[0]
    mesh = ms.TriangleMesh(mesh.vertices + np.array(offset), mesh.faces)
    material = ms.Material.from_physical(young=210e9, poisson=0.0, thickness=thickness, density=7850.0, mesh=mesh)
    return ms.Shell(mesh, material, held)


@pytest.mark.parametrize(("family", "cells"), MESHES)
def test_a_steel_strip_that_drops_by_0_389_m_does_so_at_map_coordinates_from_its_own_vertices(family, cells):
    near, far = narrow_strip(family, cells), narrow_strip(family, cells, offset=MAP)
    expected = ms.DiscreteShell(near).equilibrium(gravity=(0.0, 0.0, -9.81))
    answer = ms.DiscreteShell(far).equilibrium(gravity=(0.0, 0.0, -9.81), start=far.rest_positions)
    assert round(-expected.positions[:, 2].min(), 3) == 0.389
    assert expected.outcome is answer.outcome is ms.Outcome.CONVERGED
    assert answer.residual <= 1e-7
    # Positions there are whole multiples of 1e-9 m.
    drops = answer.positions - far.rest_positions
    np.testing.assert_allclose(drops, expected.positions - near.rest_positions, rtol=0, atol=3e-9)


@pytest.mark.by_default("linear_implicit")
@pytest.mark.parametrize("rule", ["implicit", "linear_implicit", "explicit", "verlet"])
@pytest.mark.filterwarnings("ignore:the calibration does not hold")
def test_motion_at_map_coordinates_is_that_at_the_origin(rule):
    """Implicit steps of the thin strip used to be accepted where the shell was: it never moved."""
    shells = [narrow_strip("alternating", (20, 4), 1e-4, offset) for offset in (np.zeros(3), MAP)]
    models = [ms.DiscreteShell(shell, integrator=rule) for shell in shells]
    dt = 1.0 / 60.0 if "implicit" in rule else 0.8 * models[0].stable_step()
    options = {"dt": dt, "duration": min(0.2, 400.0 * dt), "gravity": (0.0, 0.0, -9.81), "damping": (1.0, 0.0)}
    near, far = (ms.simulate(model, **options) for model in models)
    moved = near.positions - shells[0].rest_positions
    assert near.outcome is far.outcome is ms.Outcome.COMPLETED
    size = np.abs(moved).max()
    assert size > (0.1 if "implicit" in rule else 1e-6)
    np.testing.assert_allclose(far.positions - shells[1].rest_positions, moved, rtol=0, atol=1e-9 + 1e-7 * size)
    np.testing.assert_array_equal(far.rest_positions, shells[1].rest_positions)


def led_tip(rest, velocity, time):
    return rest + time * velocity


def test_supports_and_constraints_of_motion_at_map_coordinates():
    runs = []
    for offset in (np.zeros(3), MAP):
        shell = narrow_strip("alternating", (10, 2), 5e-3, offset)
        tip = np.flatnonzero(shell.rest_positions[:, 0] > offset[0] + 1.0 - 1e-6)
        path = ms.SupportPath([0.0, 0.5], [[0.0] * 3, [0.1, 0.0, 0.0]], [[0.0] * 3, [0.0, 0.3, 0.0]], pivot=offset)
        rest, moved = shell.rest_positions[tip].mean(axis=0), np.array([-0.05, 0.0, 0.2])
        constraint = ms.PositionConstraint(tip, partial(led_tip, rest, 2.0 * moved))
        model = ms.DiscreteShell(shell)
        led = ms.simulate(model, duration=0.5, supports=path, constraints=[constraint], damping=(1.0, 0.0))
        start = model.equilibrium(gravity=(0.0, 0.0, -40.0)).positions
        bent = ms.simulate(model, duration=0.1, start=start, gravity=(0.0, 0.0, -9.81))
        runs.append([motion.positions - offset for motion in (led, bent)])
    for near, far in zip(*runs, strict=True):
        np.testing.assert_allclose(far, near, rtol=0, atol=1e-7)


@pytest.mark.by_default("True")
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


@pytest.mark.by_default("0.01-1.0", "0.001-1e-06")
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


@pytest.mark.by_default("False")
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


@pytest.mark.by_default("0.1-1e-06", "4.4-3e-07")
@pytest.mark.parametrize("thickness", [1e-6, 3e-7])
@pytest.mark.parametrize("gamma", [0.1, 4.4])
@pytest.mark.filterwarnings("ignore:the calibration does not hold")
def test_a_foil_never_stays_at_a_start_that_is_out_of_balance(thickness, gamma):
    """Stretch over flexure above 4e12: rounding alone is a force as large as the load."""
    shell = narrow_strip("alternating", (20, 4), thickness)
    assert np.mean(np.abs(shell.material.stretch / shell.material.flexure)) > 4e12

    def gravity(thickness):
        return (0.0, 0.0, -gamma * 210e9 * thickness**2 / 12.0 / 7850.0)

    answer = ms.DiscreteShell(shell).equilibrium(gravity=gravity(thickness), start=shell.rest_positions)
    thicker = ms.DiscreteShell(narrow_strip("alternating", (20, 4), 1e-4)).equilibrium(gravity=gravity(1e-4))
    assert answer.outcome in (ms.Outcome.ROUNDING_LIMITED, ms.Outcome.CONVERGED)
    assert answer.converged == (answer.residual <= 1e-7)
    assert answer.positions[:, 2].min() == pytest.approx(thicker.positions[:, 2].min(), rel=0.01)
    duration = 0.1 / np.sqrt(-gravity(thickness)[2])
    motion = ms.simulate(ms.DiscreteShell(shell), duration=duration, dt=duration / 4, gravity=gravity(thickness))
    assert -motion.positions[-1][:, 2].min() > 1e-3  # about half of 0.1^2


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


def test_an_answer_without_load_is_one_for_those_who_begin_there():
    """Its forces are rounding, which residuals were to be a ten millionth of."""
    mesh = ms.flat_beam(length=0.4, width=0.1, cells=(16, 4))
    curled = ms.Shell(mesh, ms.Isotropic(3e9, 0.3, 2e-4, 800.0), "x < 1e-9", rest_curvature=np.diag([4.0, 0.0, 0.0]))
    model = ms.DiscreteShell(curled)
    loaded = model.equilibrium(gravity=(0.0, 0.0, -1.0))
    first = model.equilibrium(start=loaded.positions)
    shaken = 1e-13 * np.sin(np.arange(3.0 * len(mesh.vertices))).reshape(-1, 3) * (mesh.vertices[:, :1] > 1e-9)
    for start in (first.positions, first.positions + shaken):
        again = model.equilibrium(start=start)
        assert again.outcome == ms.Outcome.CONVERGED
        assert again.iterations <= 2
        assert np.abs(again.positions - first.positions).max() < 1e-9


@pytest.mark.by_default("False-1.0", "True-1e-06")
@pytest.mark.parametrize("size", [1.0, 1e-6])
@pytest.mark.parametrize("touching", [False, True])
def test_without_a_load_shells_come_back_to_rest_in_any_unit_of_length(size, touching):
    """Residuals were over 1 N or 1 J^(1/2): modal models of micrometres rested 10 % of a length away, at once."""
    sheet = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    mesh = ms.TriangleMesh(size * sheet.vertices, sheet.faces)
    shell = ms.Shell(mesh, ms.Isotropic(1.0, 0.3, 0.01 * size, 1e-6), sheet.vertices[:, 0] < 1e-9)
    basis = ms.solve_modes(shell, 4)
    start = sheet.vertices + 0.1 * sheet.vertices[:, :1] ** 2 * [0.0, 0.0, 1.0]
    contacts = [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.5 * size))] if touching else None
    warped = ms.ModalWarping(basis), ms.ModalWarping(basis, consistent_force=True), ms.RotationStrain(basis)
    for model in (*warped, ms.ModalDerivatives(shell, count=3), ms.DiscreteShell(shell)):
        answer = model.equilibrium(start=size * start, contacts=contacts)
        assert answer.converged
        np.testing.assert_allclose(answer.positions / size, sheet.vertices, atol=1e-6, err_msg=model.name)
