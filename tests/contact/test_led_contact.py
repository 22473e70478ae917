"""Equilibria with contacts and constraints: sheets on a table, led by a patch."""

import numpy as np
import pytest

import modalshell as ms

GRAVITY = (0.0, 0.0, -9.81)
TABLE = ms.Contact(ms.Plane((0, 0, 1), 0.0))


def sheet(cells=(24, 4), **held):
    """A limp sheet on the table, and the vertices of its far end."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    material = ms.Isotropic(young=2e7, poisson=0.3, thickness=2e-3, density=300.0)
    return ms.Shell(mesh, material, **held), mesh.vertices[:, 0] > 1.0 - 1e-9


def led(model, end, move, contacts=(TABLE,), turn=None, **options):
    """The answer with the end's mean moved, and turned."""
    constraints = [ms.PositionConstraint(end, model.shell.rest_positions[end].mean(axis=0) + move)]
    if turn is not None:
        constraints.append(ms.OrientationConstraint(end, turn))
    return model.equilibrium(gravity=GRAVITY, contacts=contacts, constraints=constraints, **options)


@pytest.mark.by_default("move0", "move2")
@pytest.mark.parametrize("move", [(0.2, 0.0, 0.2), (0.1, 0.3, 0.05), (0.5, 0.2, 0.0)])
def test_a_free_sheet_is_dragged_over_a_table(move):
    shell, end = sheet()
    found = led(ms.DiscreteShell(shell), end, move)
    assert found.converged
    assert found.stable
    assert found.deepest <= 1e-9
    np.testing.assert_allclose(found.positions[end], shell.rest_positions[end] + move, rtol=0, atol=1e-12)
    assert found.in_contact.sum() >= 50
    assert not found.in_contact[end].any()
    assert (found.contact_forces[:, 2] >= 0.0).all()
    weight = 9.81 * shell.mass.sum()
    balance = found.contact_forces.sum(axis=0) + found.constraint_reactions[0] - (0.0, 0.0, weight)
    np.testing.assert_allclose(balance, 0.0, rtol=0, atol=1e-7 * weight)
    assert np.abs(found.constraint_reactions[0, :2]).max() <= 1e-7 * weight  # a smooth table bears no drag


@pytest.mark.slow
def test_it_is_where_damped_motion_comes_to_rest():
    shell, end = sheet(clamped="x < 1e-9")
    found = led(ms.DiscreteShell(shell), end, (-0.02, 0.0, 0.15))
    assert found.stable
    center = shell.rest_positions[end].mean(axis=0)

    def target(time):
        return center + min(1.0, time) * np.array([-0.02, 0.0, 0.15])

    run = ms.simulate(
        ms.DiscreteShell(shell, integrator="implicit"), duration=4.0, dt=1 / 30, gravity=GRAVITY, damping=(4.0, 0.0),
        contacts=[TABLE], constraints=[ms.PositionConstraint(end, target)],
    )  # fmt: skip
    assert run.unconverged_steps == 0
    np.testing.assert_allclose(run.positions[-1], found.positions, rtol=0, atol=2e-5)
    np.testing.assert_array_equal(run.in_contact[-1], found.in_contact)


@pytest.mark.slow
def test_a_sheet_that_buckles_on_the_way_reaches_a_minimum():
    shell, end = sheet(clamped="x < 1e-9")
    found = led(ms.DiscreteShell(shell), end, (-0.05, 0.0, 0.15))
    assert found.stable
    assert found.deepest <= 1e-9
    # The same energy from another way there: up first, then in.
    up = led(ms.DiscreteShell(shell), end, (-0.02, 0.0, 0.15))
    other = led(ms.DiscreteShell(shell), end, (-0.05, 0.0, 0.15), start=up.positions)
    assert other.stable
    np.testing.assert_allclose(other.positions, found.positions, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_table_out_of_reach_changes_nothing():
    shell, end = sheet(clamped="x < 1e-9")
    model = ms.DiscreteShell(shell)
    move, turn = (-0.1, 0.02, 0.0), (0.0, -0.2, 0.0)
    below = ms.Contact(ms.Plane((0, 0, 1), -1.0))
    found, free = led(model, end, move, [below], turn), led(model, end, move, (), turn)
    assert not found.in_contact.any()
    np.testing.assert_allclose(found.positions, free.positions, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.constraint_reactions, free.constraint_reactions, rtol=1e-5, atol=1e-6)


@pytest.mark.by_default("SpringSheet")
@pytest.mark.parametrize("kind", [ms.DiscreteShell, ms.SpringSheet])
def test_a_turned_end_is_led_over_a_cylinder_far_from_the_origin(kind):
    away = np.array([64.0, -32.0, 16.0])
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(24, 4))
    mesh = ms.TriangleMesh(mesh.vertices + away, mesh.faces)
    x = mesh.vertices[:, 0] - away[0]
    material = ms.Isotropic(young=2e7, poisson=0.3, thickness=2e-3, density=300.0)
    if kind is ms.SpringSheet:
        material = ms.Material.from_physical(mesh=mesh, young=2e7, poisson=0.3, thickness=2e-3, density=300.0)
    middle, side = np.array([0.5, 0.0, -0.1]), np.array([0.0, 1.0, 0.0])
    roller = ms.Contact(ms.Cylinder(away + middle - side, away + middle + side, 0.1))
    model = kind(ms.Shell(mesh, material, clamped=x < 1e-9))
    found = led(model, x > 1.0 - 1e-9, (-0.05, 0.0, -0.15), [roller], (0.0, 0.5, 0.0))
    assert found.converged
    assert found.in_contact.any()
    assert found.deepest <= 1e-9
    assert found.constraint_reactions.shape == (2, 3)
    assert found.constraint_residuals[0] == 0.0
    assert found.constraint_residuals[1] <= 1e-12  # rad, of coordinates rounded 74 m from the origin


@pytest.mark.by_default("move0")
@pytest.mark.parametrize("move", [(0.1, 0.0, 0.0), (0.05, 0.2, 0.05)])
def test_a_rough_table_drags_by_coulombs_law(move):
    shell, end = sheet()
    rough = ms.Contact(ms.Plane((0, 0, 1), 0.0), friction=0.4)
    found = led(ms.DiscreteShell(shell), end, move, [rough])
    assert found.stable
    assert "the constraints moved on straight ways" in found.message
    np.testing.assert_allclose(found.positions[end], shell.rest_positions[end] + move, rtol=0, atol=1e-12)
    along = np.linalg.norm(found.contact_forces[:, :2], axis=1)
    np.testing.assert_allclose(along, 0.4 * found.contact_forces[:, 2], rtol=1e-6, atol=1e-9)  # all of it slides
    weight = 9.81 * shell.mass.sum()
    balance = found.contact_forces.sum(axis=0) + found.constraint_reactions[0] - (0.0, 0.0, weight)
    np.testing.assert_allclose(balance, 0.0, rtol=0, atol=1e-7 * weight)
    if move[2] == 0.0:  # pulled straight: the table bears what the patch does not
        borne = weight - found.constraint_reactions[0, 2]
        np.testing.assert_allclose(found.constraint_reactions[0, 0], 0.4 * borne, rtol=1e-6)


@pytest.mark.slow  # pulled by a load, half of a strip stays in test_static_friction, too
def test_of_a_short_pull_a_part_slips_as_in_a_bar_with_friction():
    """A bar of stiffness EA under friction q a length, pulled by d, slips as far as ``sqrt(2 EA d / q)``."""
    shell, end = sheet()
    rough = ms.Contact(ms.Plane((0, 0, 1), 0.0), friction=0.4)
    found = led(ms.DiscreteShell(shell), end, (1e-5, 0.0, 0.0), [rough])
    assert found.stable
    along, limit = np.linalg.norm(found.contact_forces[:, :2], axis=1), 0.4 * found.contact_forces[:, 2]
    assert (along <= limit * (1.0 + 1e-6) + 1e-9).all()
    stiffness, friction = 2e7 * 2e-3 * 0.2, 0.4 * 9.81 * shell.mass.sum()
    slipped = np.sqrt(2.0 * stiffness * 1e-5 / friction)
    moved, x = found.positions[:, 0] - shell.rest_positions[:, 0], shell.rest_positions[:, 0]
    assert moved[x < 0.9 - slipped].max() <= 1e-12
    assert moved[x > 1.05 - slipped].min() > 1e-9
    np.testing.assert_allclose(found.constraint_reactions[0, 0], friction * slipped, rtol=0.05)


@pytest.mark.slow
def test_a_sheet_pushed_against_its_friction_until_it_snaps_has_no_answer():
    shell, end = sheet(cells=(16, 4))
    rough = ms.Contact(ms.Plane((0, 0, 1), 0.0), friction=0.4)
    found = led(ms.DiscreteShell(shell), end, (-0.05, 0.0, 0.1), [rough])
    assert not found.converged
    assert "of the way of the constraints: simulate the damped motion" in found.message
    target = shell.rest_positions[end].mean(axis=0) + np.array([-0.05, 0.0, 0.1])
    missed = np.linalg.norm(found.positions[end].mean(axis=0) - target)
    assert missed > 1e-3
    assert found.constraint_residuals == pytest.approx([missed])


@pytest.mark.slow
def test_what_does_not_go_together_is_refused():
    shell, end = sheet(clamped="x < 1e-9")
    model = ms.DiscreteShell(shell)
    with pytest.raises(ms.OptionError, match=r"leads vertex \d+ to 0\.1 m inside contact 0 \(Plane\): move its target"):
        led(model, end, (0.0, 0.0, -0.1))
    with pytest.raises(ms.OptionError, match="constraints or self-contact, not both: simulate the damped motion"):
        led(model, end, (0.0, 0.0, 0.1), [ms.SelfContact(gap=0.01)])
    with pytest.raises(ms.OptionError, match="coarse DS takes no position or orientation constraints"):
        led(ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, sheet((12, 2))[0].mesh)), end, (0.0, 0.0, 0.1))
    # A vertex that the contact leaves out may go there.
    others = ms.Contact(ms.Plane((0, 0, 1), 0.0), sel=~end)
    assert led(model, end, (-0.05, 0.0, -0.02), [others]).deepest <= 1e-9


@pytest.mark.slow
def test_supports_along_one_axis_and_two_colliders():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(24, 4))
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    material = ms.Isotropic(young=2e7, poisson=0.3, thickness=2e-3, density=300.0)
    side = ms.Symmetry(y < -0.1 + 1e-9, (0, 1, 0))
    corner = (x > 1.0 - 1e-9) & (y > 0.1 - 1e-9)
    ball = ms.Contact(ms.Sphere((0.5, 0.0, -0.3), 0.3))
    model = ms.DiscreteShell(ms.Shell(mesh, material, supports=[side]))
    found = led(model, corner, (0.02, 0.0, 0.1), [ball, TABLE])
    assert found.stable
    assert found.deepest <= 1e-9
    weight = 9.81 * model.shell.mass.sum()
    borne = found.contact_forces[:, 2].sum() + found.constraint_reactions[0, 2]
    np.testing.assert_allclose(borne, weight, rtol=1e-7)
    again = led(model, corner, (0.02, 0.0, 0.1), [ball, TABLE])
    np.testing.assert_array_equal(again.positions, found.positions)


@pytest.mark.by_default("False-0.02")
@pytest.mark.parametrize("height", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("corner", [False, True])
def test_a_free_sheet_is_lifted_by_one_vertex(height, corner):
    """Its turn about the vertical changes nothing, and is held by what bears nothing."""
    shell, end = sheet()
    rest = shell.rest_positions
    one = np.array([np.argmax(rest[:, 0] + rest[:, 1])]) if corner else np.flatnonzero(end)[[2]]
    found = led(ms.DiscreteShell(shell), one, (0.01, 0.02, height))
    assert found.converged
    assert found.stable
    assert found.iterations <= 150
    assert found.deepest <= 1e-9
    weight = 9.81 * shell.mass.sum()
    whole = found.constraint_reactions[0] + found.contact_forces.sum(axis=0)
    np.testing.assert_allclose(whole, (0.0, 0.0, weight), rtol=0, atol=1e-6 * weight)
    # Moments about the vertical: nothing else pushes aside.
    arms = found.positions - found.positions[one]
    assert np.abs(np.cross(arms, found.contact_forces).sum(axis=0)[2]) <= 1e-9 * weight


@pytest.mark.slow
def test_a_turn_that_a_start_has_made_is_kept():
    """The vertex that keeps its plane is the farthest where the shell is, not where it was at rest."""
    shell, end = sheet()
    one, angle = np.flatnonzero(end)[[2]], 2.0
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    pivot = shell.rest_positions[one]
    start = pivot + (shell.rest_positions - pivot) @ turn.T
    plain = led(ms.DiscreteShell(shell), one, (0.0, 0.0, 0.1))
    found = led(ms.DiscreteShell(shell), one, (0.0, 0.0, 0.1), start=start)
    assert found.stable
    turned = pivot + (0.0, 0.0, 0.1) + (plain.positions - pivot - (0.0, 0.0, 0.1)) @ turn.T
    np.testing.assert_allclose(found.positions, turned, rtol=0, atol=1e-6)


@pytest.mark.by_default("move1-False")
@pytest.mark.parametrize("hinged", [False, True])
@pytest.mark.parametrize("move", [(0.0, 0.0, 0.1), (0.2, 0.3, 0.1)])
def test_a_free_sheet_without_load_goes_along_without_stress(move, hinged):
    """There is no force to which its balance relates; one row of vertices is a hinge, about which it may turn."""
    shell, end = sheet()
    end = end if hinged else shell.rest_positions[:, 0] > 0.9
    place = shell.rest_positions[end].mean(axis=0) + move
    constraints = [ms.PositionConstraint(end, place)]
    found = ms.DiscreteShell(shell).equilibrium(contacts=[TABLE], constraints=constraints)
    assert found.converged, found.message
    assert found.deepest <= 1e-9
    np.testing.assert_allclose(found.positions[end], shell.rest_positions[end] + move, rtol=0, atol=1e-9)
    if not hinged:
        np.testing.assert_allclose(found.positions, shell.rest_positions + move, rtol=0, atol=1e-9)
    edges = [np.linalg.norm(x[shell.mesh.edges[:, 0]] - x[shell.mesh.edges[:, 1]], axis=1) for x in
             (found.positions, shell.rest_positions)]  # fmt: skip
    np.testing.assert_allclose(*edges, rtol=1e-9)
    assert np.linalg.norm(found.constraint_reactions) <= 1e-9


@pytest.mark.parametrize("contacts", [(), (TABLE,)])
def test_a_patch_of_all_vertices_is_refused_in_its_own_words(contacts):
    shell, _ = sheet()
    every = np.ones(len(shell.rest_positions), dtype=bool)
    with pytest.raises(ms.OptionError, match="constraints move all 125 vertices"):
        led(ms.DiscreteShell(shell), every, (0.0, 0.0, 0.1), contacts)
