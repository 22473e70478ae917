"""Prestrain, rest curvature and temperature: circles, free growth, thermal buckling, energies of the same shape."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import frame
from scenes import jittered

import modalshell as ms

SHEET = ms.Isotropic(young=1e9, poisson=0.3, thickness=2e-3, density=1000.0)


@pytest.mark.parametrize("curvature", [1.5, -3.0])
def test_a_strip_curls_to_the_circle_of_its_rest_curvature(curvature):
    """Bent along x alone it comes to rest without stress, on an arc of the curvature, upwards where it is positive."""
    mesh = jittered((24, 3), 0.5, 0.06)
    tensor = curvature * np.diag([1.0, 0.0, 0.0])
    sheet = ms.Isotropic(young=1e9, poisson=0.0, thickness=2e-3, density=1000.0)
    shell = ms.Shell(mesh, sheet, clamped="x < 1e-9", rest_curvature=tensor)
    state = ms.DiscreteShell(shell).equilibrium()
    assert state.converged
    tip = state.positions[mesh.vertices[:, 0] > 0.5 - 1e-9].mean(axis=0)
    angle = 0.5 * curvature
    # Normals that spread point away from the centre of the circle.
    exact = np.array([np.sin(angle) / curvature, (np.cos(angle) - 1.0) / curvature])
    np.testing.assert_allclose(tip[[0, 2]], exact, atol=1e-3 * np.abs(exact).max())
    assert shell.energy(state.positions) < 1e-3 * shell.energy(mesh.vertices)


def test_a_bimetal_bends_by_its_temperature():
    """Warmer at the face to which the normals point by dT: curvature alpha dT / h in both directions."""
    mesh = jittered((16, 2), 0.3, 0.02)
    warm = ms.Temperature(change=0.0, expansion=2e-5, through=100.0)
    shell = ms.Shell(mesh, SHEET, clamped="x < 1e-9", temperature=warm)
    state = ms.DiscreteShell(shell).equilibrium()
    tip = state.positions[mesh.vertices[:, 0] > 0.3 - 1e-9].mean(axis=0)
    curvature = 2e-5 * 100.0 / 2e-3
    assert tip[2] == pytest.approx((np.cos(0.3 * curvature) - 1.0) / curvature, rel=0.01)


def test_a_free_plate_that_warms_grows_without_stress():
    mesh = jittered((8, 6), 0.4, 0.3)
    shell = ms.Shell(mesh, SHEET, temperature=ms.Temperature(50.0, 1e-5), supports=[ms.Fix([0], axes="xyz")])
    grown = mesh.vertices * np.sqrt(1.0 + 2.0 * 50.0 * 1e-5)
    fields = shell.fields(grown)
    assert shell.energy(grown) < 1e-20
    assert np.abs(fields.membrane_force).max() < 1e-6
    assert np.abs(shell.force(grown)).max() < 1e-9
    stressed = shell.fields(mesh.vertices)
    np.testing.assert_allclose(stressed.membrane_force[:, 0], -1e9 * 2e-3 / 0.7 * 5e-4, rtol=1e-6)


def test_a_clamped_plate_buckles_by_its_temperature():
    """The flat square's least eigenvalue vanishes at sigma = 5.30 pi^2 D / (b^2 h), the same in all directions."""
    side, alpha = 0.2, 1e-5
    mesh = ms.sheet(length=side, width=side, cells=(16, 16), family="union-jack")
    rim = np.isin(np.arange(len(mesh.vertices)), mesh.boundary_vertices)
    cold = ms.Shell(mesh, SHEET, clamped=rim)
    warm = ms.Shell(mesh, SHEET, clamped=rim, temperature=ms.Temperature(1.0, alpha))
    normal = 3 * np.flatnonzero(~rim) + 2
    first, second = (shell.stiffness()[normal][:, normal].toarray() for shell in (cold, warm))
    inverse = np.linalg.inv(np.linalg.cholesky(first))
    critical = -1.0 / np.linalg.eigvalsh(inverse @ (second - first) @ inverse.T)[0]
    bending = SHEET.young * SHEET.thickness**3 / (12.0 * (1.0 - SHEET.poisson**2))
    stress = SHEET.young * alpha * critical / (1.0 - SHEET.poisson)
    assert stress * SHEET.thickness == pytest.approx(5.304 * np.pi**2 * bending / side**2, rel=0.01)


SUPPORTS = {
    "free": {},
    "clamped row": {"clamped": "x < 1e-9"},
    "held triangles": {"clamped": "x < 0.15"},
    "symmetry": {"supports": [ms.Symmetry("y > 0.1499", normal=(0, 1, 0))]},
}


@pytest.mark.parametrize("supports", SUPPORTS)
def test_the_gradient_is_that_of_the_energy_and_either_way_to_part_folds_agrees(supports):
    mesh = jittered((6, 4), 0.4, 0.3)
    random = np.random.default_rng(1)
    shell = ms.Shell(
        mesh,
        SHEET,
        prestrain=lambda centroids: 1e-3 * centroids[:, 0],
        rest_curvature=lambda centroids: 2.0 + centroids[:, 1],
        **SUPPORTS[supports],
    )
    x = mesh.vertices + 1e-3 * random.normal(size=mesh.vertices.shape) * (mesh.vertices[:, 1:2] < 0.1499)
    step = random.normal(size=x.shape) * ~shell.clamped[:, None]
    slope = (shell.energy(x + 1e-7 * step) - shell.energy(x - 1e-7 * step)) / 2e-7
    assert slope == pytest.approx(-np.sum(shell.force(x) * step), rel=1e-6)
    assert shell._energy.halved().energy(x) == pytest.approx(shell.energy(x), rel=1e-10)
    same = shell._energy.holding(shell.clamped)
    assert same.energy(x) == pytest.approx(shell.energy(x), rel=1e-12)


def test_wings_of_a_joint_curl_each_by_itself():
    """Bent about y each wing of a frame has the moment of its own curvature alone at rest, whichever the first wing."""
    mesh = frame([(-1, 0), (1, 0.3), (0, 1), (0.2, -1)], cells=(5, 2), family="jittered")
    faces = np.random.default_rng(0).permutation(mesh.faces)
    energies = []
    for surface in (mesh, ms.TriangleMesh(mesh.vertices, faces)):
        shell = ms.Shell(surface, SHEET, rest_curvature=0.7)
        energies.append(shell.energy(surface.vertices))
    rigidity = 1e9 * 8e-9 / (12.0 * (1.0 - 0.3**2))
    assert energies[1] == pytest.approx(energies[0], rel=1e-10)
    # At free edges the moment vanishes, as it may: less than D (1 + nu) kappa^2 per area, and most of it.
    assert 0.3 < energies[0] / (mesh.area * rigidity * 1.3 * 0.7**2) < 1.0


@pytest.mark.slow
def test_what_needs_a_shape_without_stress_refuses_and_motion_goes_on():
    mesh = jittered((8, 2), 0.3, 0.04)
    shell = ms.Shell(mesh, SHEET, clamped="x < 1e-9", rest_curvature=3.0)
    with pytest.raises(ms.OptionError, match=r"solve_modes\(shell, about=state\)"):
        ms.solve_modes(shell, 3)
    model = ms.DiscreteShell(shell)
    rest = model.equilibrium()
    about = ms.solve_modes(shell, 3, about=rest)
    assert (about.eigenvalues[:3] > 0.0).all()
    run = ms.simulate(model, duration=3.0, dt=0.02, damping=(20.0, 1e-3))
    assert run.outcome == ms.Outcome.COMPLETED, run.message
    np.testing.assert_allclose(run.positions[-1], rest.positions, atol=1e-4)
    with_other = shell.with_material(ms.Isotropic(2e9, 0.3, 2e-3, 1000.0))
    assert with_other.energy(mesh.vertices) == pytest.approx(2.0 * shell.energy(mesh.vertices), rel=1e-12)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"prestrain": np.ones(3)}, "prestrain must be a number, a symmetric tensor"),
        ({"rest_curvature": np.arange(9.0).reshape(3, 3)}, "rest_curvature must be a symmetric tensor"),
        ({"rest_curvature": np.nan}, "rest_curvature must be"),
        ({"temperature": 20.0}, "temperature must be an ms.Temperature"),
    ],
)
def test_what_is_no_rest_shape_is_refused(given, match):
    with pytest.raises(ms.MaterialError, match=match):
        ms.Shell(jittered((3, 2), 0.3, 0.2), SHEET, **given)
    with pytest.raises(ms.MaterialError, match="need a sheet such as ms"):
        ms.Shell(jittered((3, 2), 0.3, 0.2), ms.Material(1.0, 1.0, 1.0, 1.0), **given)


@pytest.mark.parametrize("degrees", [45.0, 90.0, 120.0])
def test_a_tensor_turned_with_its_sheet_is_as_symmetric(degrees):
    """Rounding makes the zeros of a turned tensor unlike, and no other entry to speak of."""
    angle, mesh = np.radians(degrees), jittered((3, 2), 0.3, 0.2)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    strain = np.diag([1e-3, 1e-3, 0.0])
    energies = [
        ms.Shell(surface, SHEET, prestrain=tensor).energy(surface.vertices)
        for surface, tensor in (
            (mesh, strain),
            (ms.TriangleMesh(mesh.vertices @ turn.T, mesh.faces), turn @ strain @ turn.T),
        )
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-12)


@pytest.mark.by_default("sheet1-supports0")
@pytest.mark.parametrize(
    "supports", [[ms.Clamp("x < 1e-9")], [ms.Clamp("x < 1e-9"), ms.Symmetry("y < 1e-9", (0, 1, 0))]]
)
@pytest.mark.parametrize(
    "sheet",
    [SHEET, ms.Orthotropic(young=(1e9, 3e8), shear=2e8, poisson=0.2, thickness=2e-3, density=1000.0, direction=30.0)],
)
def test_a_thicker_sheet_is_bent_less_by_its_temperature(sheet, supports):
    """The derivative of the answer by the thickness has that of the rest curvature, alpha dT / h."""
    mesh, warm = ms.sheet(length=0.3, width=0.2, cells=(6, 4)), ms.Temperature(5.0, 2e-5, through=200.0)
    mesh = ms.TriangleMesh(mesh.vertices - [0.0, mesh.vertices[:, 1].min(), 0.0], mesh.faces)

    def answer(thickness, start=None):
        shell = ms.Shell(mesh, replace(sheet, thickness=thickness), supports=supports, temperature=warm)
        model = ms.DiscreteShell(shell)
        return model, model.equilibrium(gravity=(0.0, 0.0, -3.0), start=start)

    model, state = answer(sheet.thickness)
    found, step = model.sensitivity(state, wrt="thickness")[:, :, 0], 1e-4 * sheet.thickness
    moved = [answer(sheet.thickness + side * step, state.positions)[1].positions for side in (1.0, -1.0)]
    expected = (moved[0] - moved[1]) / (2.0 * step)
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def bent(mesh, curvature):
    """A flat mesh bent along x to a circle, without strain along it."""
    x, y, _ = mesh.vertices.T
    return np.column_stack([np.sin(curvature * x) / curvature, y, (np.cos(curvature * x) - 1.0) / curvature])


@pytest.mark.parametrize("material", [SHEET, ms.Material(stretch=1e5, shear=1e3, flexure=0.05, density=1.0)])
def test_a_strip_pressed_flat_goes_back_to_its_other_mesh(material):
    mesh = ms.flat_beam(length=0.5, width=0.06, cells=(20, 3))
    held = mesh.vertices[:, 0] < 0.03
    shell = ms.Shell(mesh, material, clamped=held, rest=bent(mesh, 3.0))
    state = ms.DiscreteShell(shell).equilibrium()
    assert state.converged
    assert shell.energy(state.positions) < 2e-2 * shell.energy(mesh.vertices)
    lengths = np.linalg.norm(np.diff(state.positions[mesh.edges], axis=1), axis=2)[:, 0]
    free = ~held[mesh.edges].all(axis=1)
    np.testing.assert_allclose(lengths[free], shell.rest_mesh.edge_lengths[free], rtol=3e-3)
    # The clamp keeps the mesh's slope, so that the rest of the strip is the arc, turned to it.
    own, whole = state.positions[~held], shell.rest_mesh.vertices[~held]
    u, _, v = np.linalg.svd((own - own.mean(axis=0)).T @ (whole - whole.mean(axis=0)))
    assert np.abs((own - own.mean(axis=0)) @ (u @ v) - (whole - whole.mean(axis=0))).max() < 2e-3


def test_a_free_strip_takes_its_other_shape_exactly():
    mesh = ms.flat_beam(length=0.5, width=0.06, cells=(12, 2))
    shell = ms.Shell(mesh, SHEET, rest=ms.TriangleMesh(bent(mesh, 4.0), mesh.faces))
    other = shell.rest_mesh
    assert shell.energy(other.vertices) < 1e-20
    fields = shell.fields(other.vertices)
    assert np.abs(fields.membrane_strain).max() < 1e-12
    assert np.abs(fields.curvature).max() < 1e-9
    assert shell.mass.sum() == pytest.approx(SHEET.density * SHEET.thickness * other.area)
    same = ms.Shell(other, SHEET)
    x = other.vertices + 1e-3 * np.random.default_rng(0).normal(size=other.vertices.shape)
    assert shell.energy(x) == same.energy(x)
    assert np.array_equal(shell.force(x), same.force(x))
    held = shell.holding([0, 1, 2])
    assert held.energy(other.vertices) < 1e-20
    assert np.array_equal(ms.Shell(mesh, SHEET, rest=mesh).force(x), ms.Shell(mesh, SHEET).force(x))


@pytest.mark.slow
def test_a_moving_strip_with_another_rest_shape_keeps_its_energy():
    mesh = ms.flat_beam(length=0.5, width=0.06, cells=(8, 2))
    shell = ms.Shell(mesh, SHEET, clamped="x < 1e-9", rest=bent(mesh, 2.0))
    model = ms.DiscreteShell(shell, integrator="verlet")
    step = 0.5 * model.stable_step()
    run = ms.simulate(model, duration=800 * step, dt=step, store_every=20)
    total = run.energies.sum(axis=1)
    assert run.energies[:, 0].max() > 0.2 * total[0]
    assert np.abs(total / total[0] - 1.0).max() < 5e-3


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        (np.zeros((3, 3)), "rest must have the 45 vertices of the mesh"),
        ("arc.obj", "rest must be"),
        ((4, 1), "rest must have the triangles of the mesh"),
    ],
)
def test_other_meshes_that_are_refused(rest, words):
    mesh = ms.flat_beam(length=0.5, width=0.06, cells=(14, 2))
    rest = ms.flat_beam(length=0.5, width=0.06, cells=rest) if isinstance(rest, tuple) else rest
    with pytest.raises(ms.MeshError, match=words):
        ms.Shell(mesh, SHEET, rest=rest)


def test_rungs_name_another_rest_shape():
    mesh = ms.flat_beam(length=0.5, width=0.06, cells=(8, 1))
    shell = ms.Shell(mesh, SHEET, clamped="x < 1e-9", rest=bent(mesh, 1.0))
    with pytest.raises(
        ms.OptionError, match="modes about the mesh need a shell without stress there, or in equilibrium"
    ):
        ms.solve_modes(shell, 3)
    state = ms.DiscreteShell(shell).equilibrium()
    assert ms.solve_modes(shell, 3, about=state).frequencies.min() > 0.0
    with pytest.raises(ms.SupportError, match="rest does not go with planes of symmetry"):
        ms.Shell(mesh, SHEET, supports=[ms.Symmetry("x < 1e-9", (1, 0, 0))], rest=bent(mesh, 1.0))


def test_creases_have_the_folds_and_lengths_of_the_shape_without_stress():
    """A pleated strip pressed flat has its creases at the pleats, and a flat one that is bent has none."""
    flat = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    x, y, _ = flat.vertices.T
    pleated = np.stack([0.9 * x, 1.5 * y, 0.05 * np.where(np.round(8 * x) % 4 < 3, 0.0, 1.0)], axis=1)
    crease = ms.Crease("x > -1", 0.1, 0.2, angle=5.0)
    sheet = ms.Isotropic(1e9, 0.3, 1e-3, 1000.0)
    shell = ms.Shell(flat, sheet, "x < 1e-6", rest=pleated, creases=[crease])
    same = ms.Shell(ms.TriangleMesh(pleated, flat.faces), sheet, "x < 1e-6", creases=[crease])
    np.testing.assert_array_equal(shell.creases.hinges, same.creases.hinges)
    np.testing.assert_allclose(shell.creases.limits, same.creases.limits, rtol=1e-12)
    np.testing.assert_allclose(shell.creases.hardening, same.creases.hardening, rtol=1e-12)
    with pytest.raises(ms.OptionError, match="folded by more than 5 degrees at rest"):
        ms.Shell(same.mesh, sheet, "x < 1e-6", rest=flat, creases=[crease])
