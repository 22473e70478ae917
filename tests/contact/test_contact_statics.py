"""Statics with contacts against the tables of theory: lifted sheet, drape over a cylinder, ring and bend by plates."""

import numpy as np
import pytest

import modalshell as ms

YOUNG, THICKNESS, GRAVITY = 1e9, 1e-3, 9.81
FLEXURE = YOUNG * THICKNESS**3 / 12.0


def heavy(unit=1.0):
    """Material without Poisson effect whose weight bends it over a length (D / w)^(1/3) of ``unit`` [m]."""
    density = FLEXURE / unit**3 / (GRAVITY * THICKNESS)
    return ms.Isotropic(young=YOUNG, poisson=0.0, thickness=THICKNESS, density=density)


def corner(mesh):
    """Selection of one vertex at x = 0, which holds the strip along y."""
    return f"x < 1e-9 and y < {mesh.vertices[:, 1].min() + 1e-9:.12f}"


def lifted(height, cells=40, length=4.0, width=0.4):
    """A sheet on a table, one end ``height`` above it; its force per width, and how far that end is drawn in."""
    mesh = ms.flat_beam(length=length, width=width, cells=(cells, cells // 10))
    x = mesh.vertices[:, 0]
    supports = [ms.Fix(f"x > {length - 1e-9}", "z"), ms.Fix("x < 1e-9", "x"), ms.Fix(corner(mesh), "y")]
    shell = ms.Shell(mesh, heavy(), supports=supports)
    start = mesh.vertices.copy()
    start[:, 2] = height * np.clip((x - length) / 1.5 + 1.0, 0.0, 1.0) ** 2 - height
    state = ms.DiscreteShell(shell).equilibrium(
        gravity=(0, 0, -GRAVITY), start=start, contacts=[ms.Contact(ms.Plane((0, 0, 1), -height))]
    )
    weight = shell.mass.sum() * GRAVITY
    force = (weight - state.contact_forces[:, 2].sum()) / width / FLEXURE
    return state, force, length - state.positions[x > length - 1e-9, 0].mean()


@pytest.mark.by_default("0.05-1.04733-0.524144-0.001775")
@pytest.mark.parametrize(
    ("height", "free", "force", "drawn"), [(0.05, 1.047330, 0.524144, 0.001775), (1.0, 2.362807, 1.286617, 0.347342)]
)
def test_a_lifted_sheet_needs_the_force_of_the_elastica(height, free, force, drawn):
    state, found, found_drawn = lifted(height)
    assert state.converged
    assert state.stable
    assert found == pytest.approx(force, rel=5e-4)
    assert found_drawn == pytest.approx(drawn, rel=4e-3)
    reach = 4.0 - np.linalg.norm(ms.flat_beam(length=4.0, width=0.4, cells=(40, 4)).vertices[state.in_contact, 0].max())
    assert abs(reach - free) <= 0.1  # a cell
    assert state.deepest <= 1e-9 * 4.0
    assert (state.contact_forces[~state.in_contact] == 0.0).all()
    assert (state.contact_forces[:, 2] >= 0.0).all()


def draped(radius, length, cells):
    """Tip of half a strip that hangs over a cylinder, and the state."""
    mesh = ms.flat_beam(length=length, width=0.1 * length, cells=(cells, max(2, cells // 15)))
    shell = ms.Shell(mesh, heavy(), supports=[ms.Symmetry("x < 1e-9", (1, 0, 0)), ms.Fix(corner(mesh), "y")])
    state = ms.DiscreteShell(shell).equilibrium(
        gravity=(0, 0, -GRAVITY), contacts=[ms.Contact(ms.Cylinder((0, -9, -radius), (0, 9, -radius), radius))]
    )
    weight = shell.mass.sum() * GRAVITY
    return state, state.positions[mesh.vertices[:, 0] > length - 1e-9].mean(axis=0), weight


@pytest.mark.by_default("1.0-1.0-30-tip0-5e-05")
@pytest.mark.parametrize(
    ("radius", "length", "cells", "tip", "share"),
    [
        (1.0, 1.0, 30, (0.991246, -0.123471), 5e-5),
        (1.0, 2.0, 60, (1.534389, -1.176128), 5e-5),
        (2.0, 3.0, 60, (2.206587, -1.770580), 5e-5),
    ],
)
def test_a_strip_over_a_cylinder_hangs_as_the_elastica(radius, length, cells, tip, share):
    state, found, weight = draped(radius, length, cells)
    assert state.converged
    assert np.hypot(found[0] - tip[0], found[2] - tip[1]) < share * length
    assert state.contact_forces[:, 2].sum() == pytest.approx(weight, rel=1e-6)
    assert state.deepest <= 1e-9 * length


@pytest.mark.slow
def test_a_long_drape_settles_through_the_thick_fluid():
    state, found, weight = draped(1.0, 3.0, 60)
    assert state.converged
    assert np.hypot(found[0] - 1.450017, found[2] + 2.352916) < 5e-5 * 3.0
    assert state.contact_forces[:, 2].sum() == pytest.approx(weight, rel=1e-6)


def ring(gap, cells):
    """Force per width over D / R^2 on half a ring between plates, by a quarter of it that begins inside."""
    flat = ms.flat_beam(length=np.pi / 2, width=0.3, cells=(cells, cells // 8))
    angle, y = flat.vertices[:, 0], flat.vertices[:, 1]
    mesh = ms.TriangleMesh(np.stack([np.sin(angle), y, np.cos(angle)], axis=1), flat.faces)
    supports = [ms.Symmetry("x < 1e-9", (1, 0, 0)), ms.Symmetry("z < 1e-9", (0, 0, 1)), ms.Fix(corner(mesh), "y")]
    contact = ms.Contact(ms.Plane((0, 0, -1), -0.5 * gap), push_out=1.0)
    state = ms.DiscreteShell(ms.Shell(mesh, heavy(), supports=supports)).equilibrium(contacts=[contact])
    return state, -2.0 * state.contact_forces[:, 2].sum() / 0.3 / FLEXURE


@pytest.mark.by_default("1.4-2.929674")
@pytest.mark.parametrize(("gap", "force"), [(1.6, 2.115300), (1.4, 2.929674)])
def test_a_ring_between_plates_pushes_as_the_elastica(gap, force):
    state, found = ring(gap, 24)
    assert state.converged
    assert state.stable
    assert found == pytest.approx(force, rel=5e-3)
    assert state.deepest <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "force"), [(1.9, 0.625408), (1.0, 5.742160)])
def test_a_ring_pressed_flat_pushes_as_the_elastica(gap, force):
    state, found = ring(gap, 80)
    assert state.converged
    assert found == pytest.approx(force, rel=5e-3)


def bent(cells):
    """Force F d^2 / D per width of a strip bent back between plates d = 1 apart, by half of it."""
    length, width = np.pi / 4 + 2.0, 0.3
    mesh = ms.flat_beam(length=length, width=width, cells=(cells, cells // 10))
    start, arc = mesh.vertices.copy(), mesh.vertices[:, 0]
    turn = np.minimum(2.0 * arc, np.pi / 2)
    start[:, 0], start[:, 2] = 0.5 * np.sin(turn), 0.5 * (1.0 - np.cos(turn)) + np.maximum(arc - np.pi / 4, 0.0)
    shell = ms.Shell(mesh, heavy(), clamped="x < 1e-9")
    contact = ms.Contact(ms.Plane((-1, 0, 0), -0.5))
    state = ms.DiscreteShell(shell).equilibrium(start=start, contacts=[contact])
    return state, -state.contact_forces[:, 0].sum() / width / FLEXURE


@pytest.mark.parametrize("cells", [40, pytest.param(80, marks=pytest.mark.slow)])
def test_a_strip_bent_between_plates_pushes_as_the_elastica(cells):
    state, found = bent(cells)
    assert state.converged
    assert found == pytest.approx(2.8710800, rel=5e-3)
    assert state.deepest <= 1e-9


@pytest.mark.parametrize("own", [True, False])
def test_both_energies_rest_on_a_floor_and_a_wall(own):
    mesh = ms.flat_beam(length=1.0, width=0.3, cells=(10, 3))
    x = mesh.vertices[:, 0]
    sheet = {"young": 1e6, "poisson": 0.0, "thickness": 0.01, "density": 400.0}
    material = ms.Isotropic(**sheet) if own else ms.Material.from_physical(mesh=mesh, **sheet)
    shell = ms.Shell(mesh, material, clamped=x < 0.101)
    # The strip sags onto the floor and its end slides along it against a wall.
    floor, wall = ms.Contact(ms.Plane((0, 0, 1), -0.1)), ms.Contact(ms.Plane((-1, 0, 0), -0.99), push_out=1.0)
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -GRAVITY), contacts=[floor, wall])
    assert state.converged
    assert state.deepest <= 1e-9
    corner = state.in_contact & (x > 1.0 - 1e-9)
    assert corner.sum() >= 3
    assert (state.contact_forces[corner, 0] <= 0.0).all()
    assert (state.contact_forces[corner, 2] >= 0.0).all()
    assert state.contact_forces[:, 2].max() > 0.0


@pytest.mark.slow
def test_the_answer_far_from_the_origin_is_the_same():
    def rest(away):
        mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
        mesh = ms.TriangleMesh(mesh.vertices + away, mesh.faces)
        shell = ms.Shell(mesh, heavy(0.4), clamped=mesh.vertices[:, 0] < away[0] + 1e-9)
        floor = ms.Contact(ms.Plane((0, 0, 1), away[2] - 0.1))
        return ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -GRAVITY), contacts=[floor])

    near, far = rest(np.zeros(3)), rest(np.array([512.0, -256.0, 1024.0]))
    assert near.in_contact.sum() > 3
    np.testing.assert_array_equal(near.in_contact, far.in_contact)
    np.testing.assert_allclose(far.positions - [512.0, -256.0, 1024.0], near.positions, atol=1e-9)


def test_refusals_name_what_is_wrong():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    shell = ms.Shell(mesh, heavy(), clamped="x < 1e-9")
    model, floor = ms.DiscreteShell(shell), ms.Contact(ms.Plane((0, 0, 1), 0.1))
    with pytest.raises(ms.OptionError, match=r"vertex \d+ begins 0\.1 m inside contact 0 \(Plane\)"):
        model.equilibrium(gravity=(0, 0, -GRAVITY), contacts=[floor])
    with pytest.raises(ms.OptionError, match="write contacts=\\[contact\\]"):
        model.equilibrium(contacts=floor)
    with pytest.raises(ms.OptionError, match="each of contacts must be a Contact"):
        model.equilibrium(contacts=[ms.Plane()])
    with pytest.raises(ms.OptionError, match="rigid takes no contacts"):
        ms.RigidShell(shell).equilibrium(contacts=[floor])


def test_no_contacts_are_the_same_bits_as_none():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    sheet = ms.Isotropic(young=1e9, poisson=0.3, thickness=1e-3, density=100.0)
    shell = ms.Shell(mesh, sheet, clamped="x < 1e-9")
    none, empty = (ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -1), contacts=given) for given in (None, []))
    np.testing.assert_array_equal(none.positions, empty.positions)
    for state in (none, empty):
        assert (state.contact_forces.shape, state.in_contact.shape, state.deepest) == ((0, 3), (0,), 0.0)


def test_derivatives_of_answers_with_contacts_are_refused():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    model = ms.DiscreteShell(ms.Shell(mesh, heavy(0.4), clamped="x < 1e-9"))
    floor = ms.Contact(ms.Plane((0, 0, 1), -0.1))
    state = model.equilibrium(gravity=(0, 0, -GRAVITY), contacts=[floor])
    assert state.converged
    with pytest.raises(ms.OptionError, match="without constraints or contacts"):
        model.sensitivity(state, "young")


@pytest.mark.slow
@pytest.mark.parametrize(("young", "touching"), [(3e8, 10), (5e7, 16)])
def test_a_strip_that_could_hang_behind_a_cylinder_rests_on_it_as_under_a_growing_load(young, touching):
    mesh = ms.sheet(length=0.6, width=0.15, cells=(24, 6))
    material = ms.Isotropic(young=young, poisson=0.3, thickness=1e-3, density=900.0)
    model = ms.DiscreteShell(ms.Shell(mesh, material, clamped="x < 0.001"))
    contacts = [ms.Contact(ms.Cylinder((0.35, -1.0, -0.12), (0.35, 1.0, -0.12), 0.08))]
    at_once = model.equilibrium(gravity=(0, 0, -GRAVITY), contacts=contacts)
    grown = None
    for share in np.linspace(0.04, 1.0, 25):
        start = None if grown is None else grown.positions
        grown = model.equilibrium(gravity=(0, 0, -GRAVITY * share), contacts=contacts, start=start)
    assert at_once.converged
    assert at_once.in_contact.sum() == touching
    np.testing.assert_allclose(at_once.positions, grown.positions, atol=1e-6)


@pytest.fixture(scope="module")
def strip_over_a_cylinder():
    """Half a strip over a cylinder: how far its tip hangs from the elastica's, and the shells of some cells."""
    flexure, length, radius = 1e9 * 1e-9 / 12.0, 3.0, 1.0
    sheet = ms.Isotropic(young=1e9, poisson=0.0, thickness=1e-3, density=flexure / (9.81 * 1e-3))

    def shell(cells):
        mesh = ms.flat_beam(length=length, width=0.3, cells=(cells, 3))
        x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
        middle = x < 1e-9
        corner = np.flatnonzero(middle & (y == y.min()))
        return ms.Shell(mesh, sheet, supports=[ms.Symmetry(middle, (1, 0, 0)), ms.Fix(corner, "y")])

    def off(state, shell):
        tip = state.positions[shell.mesh.vertices[:, 0] > length - 1e-9].mean(axis=0)
        return float(np.hypot(tip[0] - 1.450017, tip[2] + 2.352916)) / length

    contacts = [ms.Contact(ms.Cylinder((0, -9, -radius), (0, 9, -radius), radius))]
    return shell, {"gravity": (0, 0, -9.81), "contacts": contacts}, off


@pytest.mark.slow
def test_a_coarse_answer_starts_a_drape_that_then_takes_few_iterations(strip_over_a_cylinder):
    shell, given, off = strip_over_a_cylinder
    fine = shell(45)
    first = ms.CoarseDiscreteShell(fine, shell(15)).equilibrium(**given)
    assert first.converged
    assert first.deepest <= 1e-12
    assert off(first, fine) < 2e-3
    assert first.contact_forces[:, 2].sum() == pytest.approx(fine.mass.sum() * 9.81, rel=1e-6)
    assert (first.contact_forces[~first.in_contact] == 0.0).all()
    state = ms.DiscreteShell(fine).equilibrium(start=first.positions, **given)
    assert state.converged
    assert state.stable
    assert state.iterations <= 15
    assert off(state, fine) < 2e-4


def test_coarse_shells_refuse_what_they_do_not_take_with_contacts(strip_over_a_cylinder):
    shell, given, _ = strip_over_a_cylinder
    fine = shell(24)
    model = ms.CoarseDiscreteShell(fine, shell(12))
    with pytest.raises(ms.OptionError, match=r"vertex \d+ begins .* inside contact 0"):
        model.equilibrium(start=fine.mesh.vertices - [0.0, 0.0, 0.1], **given)
    some = ms.Contact(given["contacts"][0].collider, sel=fine.mesh.vertices[:, 0] < 0.5)
    assert model.equilibrium(gravity=(0, 0, -0.01), contacts=[some]).converged


@pytest.mark.by_default("hinges-ball")
@pytest.mark.parametrize(("kind", "where"), [("theory", "ball"), ("hinges", "ball"), ("theory", "box")])
def test_a_limp_cloth_finds_its_folds_in_few_iterations(kind, where):
    """Its weight is 1,400 times what its flexure bears over its length: symmetric ways down end in saddles."""
    length, thickness, density, radius = 0.3, 4e-4, 300.0, 0.07
    flexure = thickness * density * 9.81 * length**3 / 1400.0
    mesh, constants = ms.sheet(length=length, width=length, cells=(10, 10)), {"poisson": 0.3, "density": density}
    constants |= {"young": 12.0 * flexure * 0.91 / thickness**3, "thickness": thickness}
    theory = kind == "theory"
    sheet = ms.Isotropic(**constants) if theory else ms.Material.from_physical(**constants, mesh=mesh)
    held = [ms.Pin("nearest(0.15, 0, 0)"), ms.Fix("nearest(0.3, 0, 0)", "y")]
    below = (0.15, 0.0, -radius - 1e-4)
    ball, box = ms.Sphere(below, radius), ms.Box(below, (radius, radius, radius), rounding=0.02)
    shell = ms.Shell(mesh, sheet, supports=held)
    state = ms.DiscreteShell(shell).equilibrium(
        gravity=(0.0, 0.0, -9.81), contacts=[ms.Contact(ball if where == "ball" else box)]
    )
    assert state.converged
    assert state.stable
    assert state.iterations <= 300
    assert state.deepest <= 1e-9 * length
    pushed = state.contact_forces.sum(axis=0) + shell.reactions(
        state.positions, gravity=(0.0, 0.0, -9.81), force=state.contact_forces
    ).sum(axis=0)
    np.testing.assert_allclose(pushed, [0.0, 0.0, 9.81 * shell.mass.sum()], atol=1e-6 * 9.81 * shell.mass.sum())


@pytest.mark.by_default("load0")
@pytest.mark.parametrize("load", [ms.Pressure(-0.6), ms.Wind((0.0, 0.0, -2.0), density=1.2)])
def test_loads_without_a_potential_grow_where_all_of_them_at_once_are_too_much(load):
    """A way downhill knows no such load: strips under a pressure or in wind did not settle, in empty space too."""
    mesh = ms.flat_beam(length=0.4, width=0.12, cells=(12, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=2e6, poisson=0.3, thickness=2e-3, density=300.0), "x < 0.001")
    model = ms.DiscreteShell(shell)
    free = model.equilibrium(loads=[load])
    far = model.equilibrium(loads=[load], contacts=[ms.Contact(ms.Plane((0.0, 0.0, 1.0), -5.0))])
    assert far.converged
    assert ms.measure.displacement_error(far.positions, free.positions, shell) < 1e-6
    near = model.equilibrium(loads=[load], contacts=[ms.Contact(ms.Plane((0.1, 0.05, 1.0), -0.06))])
    assert near.converged
    pushes = near.contact_forces.sum(axis=0)
    held = shell.reactions(near.positions, force=near.loading.force(near.positions) + near.contact_forces).sum(axis=0)
    np.testing.assert_allclose(held + pushes + near.loading.force(near.positions).sum(axis=0), 0.0, atol=1e-9)
