"""The material: bending and membrane calibration of a mesh, and what is refused."""

import warnings
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modalshell import Material, Shell, TriangleMesh, cylinder_panel, flat_beam, leaf, sheet, v_beam
from modalshell.core.errors import MaterialError, ModalShellError, ModalShellWarning
from modalshell.mesh.triangulate import FAMILIES
from modalshell.shell.bending import bending_constants
from modalshell.shell.membrane import lowest_stable_stretch

ALONG, DIAGONAL, ACROSS = (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)
POISSON = (0.0, 0.2, 1.0 / 3.0, 0.45)
GOOD = {"young": 1e9, "poisson": 0.0, "thickness": 1e-3, "density": 1000.0}
strain = st.floats(-1.0, 1.0)


@cache
def triangular_lattice(rows=5, columns=6, side=0.1):
    """A parallelogram of equilateral triangles alone: no half triangles on its sides, as the shapes have them."""
    i, j = (index.ravel() for index in np.meshgrid(np.arange(columns + 1), np.arange(rows + 1)))
    vertices = side * np.column_stack((i + 0.5 * j, np.sqrt(0.75) * j, np.zeros(i.size)))
    a = np.array([r * (columns + 1) + c for r in range(rows) for c in range(columns)])
    b, d, e = a + 1, a + columns + 1, a + columns + 2
    return TriangleMesh(vertices, np.vstack([np.column_stack((a, b, d)), np.column_stack((b, e, d))]))


def strain_energy(shell, tensor):
    """Energy per area of a small uniform strain (2, 2), to second order: u K u / 2 with u = strain x."""
    u = (shell.mesh.vertices[:, :2] @ np.asarray(tensor, dtype=float)).ravel()
    u = np.column_stack((u.reshape(-1, 2), np.zeros(len(shell.mesh.vertices)))).ravel()
    return 0.5 * u @ (shell.stiffness() @ u) / shell.mesh.area


def plane_stress_energy(tensor, young_thickness, poisson):
    tensor = np.asarray(tensor, dtype=float)
    factor = 0.5 * young_thickness / (1.0 - poisson**2)
    return factor * (poisson * np.trace(tensor) ** 2 + (1.0 - poisson) * np.sum(tensor * tensor))


def physical_shell(mesh, poisson, **options):
    return Shell(mesh, Material.from_physical(**GOOD | {"poisson": poisson}, mesh=mesh, **options))


# ---- bending


@pytest.mark.by_default("right-cells7-direction7-3.0-2.0-0.02")
@pytest.mark.parametrize(
    ("family", "cells", "direction", "wide", "narrow", "tolerance"),
    [
        ("equilateral", (46, 40), ALONG, 3.0, 8.0 / 3.0, 0.02),
        ("equilateral", (46, 40), DIAGONAL, 3.0, 8.0 / 3.0, 0.02),
        ("equilateral", (46, 40), ACROSS, 3.0, 8.0 / 3.0, 0.02),
        ("union-jack", (40, 40), ALONG, 2.5, 2.4, 0.03),
        ("union-jack", (40, 40), DIAGONAL, 4.0, None, 0.03),
        ("right", (40, 40), ALONG, 3.0, 2.4, 0.02),
        ("right", (40, 40), DIAGONAL, 9.0, 6.0, 0.02),
        ("right", (40, 40), (1.0, -1.0, 0.0), 3.0, 2.0, 0.02),
    ],
)
def test_bending_constants_of_the_families(family, cells, direction, wide, narrow, tolerance):
    constants = bending_constants(sheet(cells=cells, family=family), direction)
    assert constants.wide == pytest.approx(wide, rel=tolerance)
    if narrow is not None:
        assert constants.narrow == pytest.approx(narrow, rel=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [DIAGONAL, ACROSS])
def test_lloyd_meshes_bend_alike_in_every_direction(direction):
    constants = bending_constants(sheet(cells=(46, 40), family="lloyd"), direction)
    assert 2.95 <= constants.wide <= 3.2
    assert constants.narrow == pytest.approx(2.72, rel=0.03)


@pytest.mark.slow
def test_bending_constants_do_not_depend_on_size_or_place():
    mesh = sheet(cells=(23, 20), family="equilateral")
    constants = bending_constants(mesh, DIAGONAL)
    turned = np.column_stack((mesh.vertices[:, 2], mesh.vertices[:, 0], mesh.vertices[:, 1]))
    moved = bending_constants(TriangleMesh(1e-3 * turned + 5.0, mesh.faces), (0.0, 1.0, 1.0))
    assert moved.wide == pytest.approx(constants.wide, rel=1e-6)
    assert moved.narrow == pytest.approx(constants.narrow, rel=1e-6)


@pytest.mark.slow
def test_curved_meshes_are_calibrated_as_their_flat_ones():
    panel = cylinder_panel(length=1.0, radius=1.0, angle=np.degrees(1.0), cells=(46, 40), family="equilateral")
    for direction in (ALONG, DIAGONAL, None):
        constants = bending_constants(panel, direction)
        assert constants.wide == pytest.approx(3.0, rel=0.02)
        assert constants.narrow == pytest.approx(8.0 / 3.0, rel=0.02)


@pytest.mark.by_default("right-cells1")
@pytest.mark.parametrize(("family", "cells"), [("equilateral", (28, 24)), ("right", (20, 20))])
def test_wide_calibration_gives_a_plate_its_rigidity(family, cells):
    """Bend the sheet over a cylinder, exactly: its energy is D kappa^2 / 2 per area, less the hinges of the rim."""
    mesh = sheet(cells=cells, family=family)
    for poisson in (0.0, 0.3):
        material = Material.from_physical(**GOOD | {"poisson": poisson}, mesh=mesh, direction=ALONG, narrow=False)
        flexure_alone = Material(stretch=0.0, shear=0.0, flexure=material.flexure, density=1.0)
        kappa = 1e-2
        x, y, _ = mesh.vertices.T
        bent = np.column_stack((np.sin(kappa * x) / kappa, y, (np.cos(kappa * x) - 1.0) / kappa))
        rigidity = 1e9 * 1e-9 / 12.0 / (1.0 - poisson**2)
        energy = Shell(mesh, flexure_alone).energy(bent) / mesh.area
        assert energy == pytest.approx(0.5 * rigidity * kappa**2, rel=2.0 / min(cells))
        assert energy < 0.5 * rigidity * kappa**2


@pytest.mark.slow
def test_narrow_and_wide_differ_by_their_constants():
    mesh = sheet(cells=(28, 24), family="equilateral")
    constants = bending_constants(mesh, ALONG)
    for poisson in (0.0, 0.3):
        options = GOOD | {"poisson": poisson}
        wide, narrow = (Material.from_physical(**options, mesh=mesh, direction=ALONG, narrow=n) for n in (False, True))
        rigidity = 1e9 * 1e-9 / 12.0
        assert wide.flexure == pytest.approx(rigidity / (1 - poisson**2) / (2 * constants.wide), rel=1e-12)
        assert 1.0 <= rigidity / (2 * constants.narrow) / narrow.flexure <= 1.025


def test_from_physical_scales_as_it_must():
    mesh = flat_beam(cells=(20, 4), family="equilateral")
    base = Material.from_physical(**GOOD, mesh=mesh, narrow=False)
    assert base.correct_clamp
    assert base.density == pytest.approx(1.0)
    thick = Material.from_physical(**GOOD | {"thickness": 2e-3}, mesh=mesh, narrow=False)
    np.testing.assert_allclose(thick.shear, 2.0 * np.asarray(base.shear))
    np.testing.assert_allclose(thick.stretch, 2.0 * np.asarray(base.stretch))
    assert thick.flexure == pytest.approx(8.0 * base.flexure)
    stiff = Material.from_physical(**GOOD | {"young": 3e9}, mesh=mesh)
    assert stiff.flexure == pytest.approx(3.0 * Material.from_physical(**GOOD, mesh=mesh).flexure)


def test_material_without_hinges_is_refused():
    with pytest.raises(MaterialError, match="hinges"):
        Material.from_physical(**GOOD, mesh=TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))


# ---- membrane


@pytest.mark.slow
@pytest.mark.parametrize("poisson", POISSON)
@given(xx=strain, yy=strain, xy=strain)
@settings(deadline=None, max_examples=15)
def test_equilateral_springs_are_an_isotropic_sheet(poisson, xx, yy, xy):
    shell = physical_shell(triangular_lattice(), poisson)
    for tensor in ([[1, 0], [0, 0]], [[0, 0.5], [0.5, 0]], [[1, 0], [0, 1]], [[xx, xy], [xy, yy]]):
        exact = plane_stress_energy(tensor, 1e6, poisson)
        assert strain_energy(shell, tensor) == pytest.approx(exact, rel=1e-6, abs=1e-3)


@pytest.mark.by_default(
    "alternating-0.2", "equilateral-0.0", "union-jack-0.3333333333333333", "lloyd-0.0", "delaunay-0.0", "right-0.45"
)
@pytest.mark.parametrize("poisson", POISSON)
@pytest.mark.parametrize("family", FAMILIES)
def test_mean_over_directions_is_exact_on_every_mesh(family, poisson):
    """Whatever the triangles, boundary edges included: the mean over the directions of a strain is the sheet's."""
    if (family, poisson) in (("lloyd", 0.0), ("delaunay", 0.0)):
        pytest.skip(
            "some of its triangles are too obtuse for Poisson's ratio 0: their area term is limited, with a warning"
        )
    shell = physical_shell(sheet(cells=(12, 10), family=family), poisson)
    angles = np.pi * np.arange(5) / 5.0
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in angles]
    for tensor in (np.diag([1.0, 0.0]), np.diag([1.0, -1.0]), np.diag([1.0, 1.0]), np.diag([1.0, -0.3])):
        mean = np.mean([strain_energy(shell, turn @ tensor @ turn.T) for turn in turns])
        assert mean == pytest.approx(plane_stress_energy(tensor, 1e6, poisson), rel=1e-6)


@pytest.mark.by_default("alternating-0.0", "equilateral-0.3333333333333333", "union-jack-0.2")
@pytest.mark.parametrize("poisson", POISSON)
@pytest.mark.parametrize("family", FAMILIES)
def test_pulling_along_a_named_direction_meets_youngs_modulus(family, poisson):
    """Uniform strain, sides free: the least energy over the strains across and in shear is E h / 2."""
    mesh = sheet(cells=(12, 10), family=family)
    for direction in (ALONG, DIAGONAL):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModalShellWarning)  # obtuse Lloyd triangles at Poisson's ratio 0
            shell = physical_shell(mesh, poisson, direction=direction)
        a = np.array(direction[:2]) / np.linalg.norm(direction)
        b = np.array([-a[1], a[0]])
        modes = [np.outer(a, a), np.outer(b, b), np.outer(a, b) + np.outer(b, a)]
        gram = (
            np.array([[strain_energy(shell, p + q) - strain_energy(shell, p - q) for p in modes] for q in modes]) / 4.0
        )
        pulled = 1.0 / np.linalg.inv(gram)[0, 0]
        assert pulled == pytest.approx(0.5 * 1e6, rel=1e-6)


@pytest.mark.parametrize("family", ["right", "alternating"])
def test_boundary_edges_count_half(family):
    """Congruent triangles: the energy per area of a strain does not know how many cells there are."""
    tensor = [[1.0, 0.2], [0.2, -0.4]]
    few, many = (
        strain_energy(physical_shell(sheet(cells=cells, family=family), 0.2), tensor) for cells in ((2, 2), (8, 8))
    )
    assert few == pytest.approx(many, rel=1e-10)


def test_equilateral_sheets_near_the_isotropic_one_as_they_are_refined():
    """Only the half triangles along the sides are not equilateral: their share falls with refinement."""
    errors = []
    for cells in ((14, 12), (28, 24)):
        shell = physical_shell(sheet(cells=cells, length=14 * np.sqrt(0.75) / 12, family="equilateral"), 0.2)
        tensors = ([[1, 0], [0, 0]], [[0, 0.5], [0.5, 0]], [[0, 0], [0, 1]])
        errors.append([abs(strain_energy(shell, t) / plane_stress_energy(t, 1e6, 0.2) - 1.0) for t in tensors])
    np.testing.assert_allclose(np.array(errors[0]) / errors[1], 2.0, rtol=0.05)
    assert np.max(errors) < 0.05


@pytest.mark.slow
@given(seed=st.integers(0, 2**16))
@settings(deadline=None, max_examples=25)
def test_lowest_stable_stretch_is_where_a_triangle_gives_way(seed):
    rng = np.random.default_rng(seed)
    corners = np.column_stack((rng.standard_normal((3, 2)), np.zeros(3)))
    mesh = TriangleMesh(corners, [[0, 1, 2]])
    shear = rng.uniform(0.5, 2.0, 3)
    bound = lowest_stable_stretch(mesh, shear)[0]
    assert bound < 0
    springs, area = (
        Shell(mesh, Material(stretch=k_s, shear=k_h, flexure=0.0, density=1.0)).stiffness().toarray()
        for k_s, k_h in ((0.0, shear), (1.0, 0.0))
    )
    largest = np.linalg.norm(springs, 2)
    assert np.linalg.eigvalsh(springs + (1 - 1e-4) * bound * area)[0] > -1e-12 * largest
    assert np.linalg.eigvalsh(springs + (1 + 1e-2) * bound * area)[0] < -1e-12 * largest
    Shell(mesh, Material(stretch=0.999 * bound, shear=shear, flexure=0.0, density=1.0))
    with pytest.raises(MaterialError, match="unstable"):
        Shell(mesh, Material(stretch=1.001 * bound, shear=shear, flexure=0.0, density=1.0))


def test_unstable_stretch_names_the_first_triangle():
    mesh = sheet(cells=(3, 2))
    stretch = np.ones(len(mesh.faces))
    stretch[[5, 7]] = -1e6
    with pytest.raises(MaterialError, match=r"triangle 5\b.*2 in all"):
        Shell(mesh, Material(stretch=stretch, shear=1.0, flexure=1.0, density=1.0))


@pytest.mark.parametrize("shape", [sheet, v_beam, cylinder_panel, leaf])
def test_physical_shells_are_stable_at_rest(shape):
    mesh = shape(cells=(6, 4), family="equilateral")
    for poisson in (0.3, 0.45):
        material = Material.from_physical(**GOOD | {"thickness": 0.01, "poisson": poisson}, mesh=mesh)
        values = np.linalg.eigvalsh(Shell(mesh, material).stiffness().toarray())
        assert values[0] > -1e-13 * values[-1]
        assert np.count_nonzero(values < 1e-12 * values[-1]) == 6


def test_obtuse_triangles_limit_the_area_term_with_a_warning():
    flat = sheet(cells=(4, 3), family="equilateral")
    mesh = TriangleMesh(flat.vertices * (0.3, 1.0, 1.0), flat.faces)
    with pytest.warns(ModalShellWarning, match=r"20 of 28 triangles .*triangle 0"):
        material = Material.from_physical(**GOOD | {"thickness": 0.01}, mesh=mesh)
    assert np.ptp(material.stretch) > 0
    values = np.linalg.eigvalsh(Shell(mesh, material).stiffness().toarray())
    assert values[0] > -1e-13 * values[-1]
    assert np.count_nonzero(values < 1e-12 * values[-1]) == 6


@pytest.mark.parametrize("cells", [(1, 1), (2, 1), (1, 2), (2, 2), (3, 1)])
@pytest.mark.parametrize("family", ["right", "alternating"])
def test_the_smallest_meshes_are_calibrated_or_refused_by_name(family, cells):
    mesh = sheet(cells=cells, family=family)
    try:
        material = Material.from_physical(**GOOD, mesh=mesh)
    except MaterialError:
        return
    assert 0.0 < material.flexure < 1e9 * 1e-9
    assert np.isfinite(material.flexure)


# ---- what is refused

NOT_NUMBERS = [np.nan, np.inf, -np.inf, None, "1", [1.0], 1j, True]


@pytest.mark.parametrize("value", [*NOT_NUMBERS, 0.0, -1.0], ids=repr)
@pytest.mark.parametrize("name", ["young", "thickness", "density"])
def test_bad_physical_values_are_refused(name, value):
    with pytest.raises(MaterialError, match=name):
        Material.from_physical(**GOOD | {name: value}, mesh=triangular_lattice())


@pytest.mark.parametrize("value", [*NOT_NUMBERS[:-1], -1.0, 0.5001, 1.0], ids=repr)
def test_bad_poisson_is_refused(value):
    with pytest.raises(MaterialError, match="poisson"):
        Material.from_physical(**GOOD | {"poisson": value}, mesh=triangular_lattice())


@pytest.mark.parametrize(
    "direction", [(1.0, 0.0), (0.0, 0.0, 0.0), (np.nan, 0, 0), "x", ("a", "b", "c"), 1.0, (0.0, 0.0, 1.0)], ids=repr
)
def test_bad_direction_is_refused(direction):
    """The last one stands on the flat sheet: it names no direction of bending."""
    with pytest.raises(MaterialError, match="direction"):
        Material.from_physical(**GOOD, mesh=triangular_lattice(), direction=direction)


@pytest.mark.parametrize("value", [np.nan, np.inf, None, "a", [[1.0]], [1.0, np.nan], 1j], ids=repr)
@pytest.mark.parametrize("name", ["stretch", "shear", "flexure", "density"])
def test_bad_stiffnesses_are_refused(name, value):
    with pytest.raises(MaterialError, match=name) as caught:
        Material(**{"stretch": 1.0, "shear": 1.0, "flexure": 1.0, "density": 1.0} | {name: value})
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, ModalShellError)


@pytest.mark.parametrize(
    ("name", "value"), [("shear", -1.0), ("flexure", -1e-9), ("density", 0.0), ("density", [1, -1])]
)
def test_signs_are_checked(name, value):
    with pytest.raises(MaterialError, match=name):
        Material(**{"stretch": 1.0, "shear": 1.0, "flexure": 1.0, "density": 1.0} | {name: value})


def test_material_keeps_its_own_frozen_copy():
    stiffness = np.ones(3)
    material = Material(stretch=1.0, shear=stiffness, flexure=1.0, density=1.0)
    stiffness[:] = 5.0
    assert material.shear.tolist() == [1.0, 1.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        material.shear[0] = 2.0


def test_patches_that_nothing_holds_are_relaxed_as_far_as_they_can(monkeypatch):
    """A vertex that joins two parts may leave a patch's own vertices without a hinge to hold them."""
    mesh = sheet(length=1.0, width=1.0, cells=(8, 8))
    expected = bending_constants(mesh)
    sound = np.linalg.solve

    def singular(matrix, right_sides):
        if matrix.shape[0] > 3:
            raise np.linalg.LinAlgError("Singular matrix")
        return sound(matrix, right_sides)

    monkeypatch.setattr(np.linalg, "solve", singular)
    assert bending_constants(mesh).wide == pytest.approx(expected.wide, rel=1e-6)


def test_a_strip_with_a_loose_part_is_measured_without_warnings():
    strip = flat_beam(length=1.0, width=0.1, cells=(10, 2))
    count = len(strip.vertices)
    both = TriangleMesh(
        np.vstack([strip.vertices, strip.vertices * [0.5, 1.0, 1.0] + [0.0, 0.15, 0.0]]),
        np.vstack([strip.faces, strip.faces + count]),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bending_constants(both).narrow == pytest.approx(bending_constants(strip).narrow, rel=0.3)


def test_a_flat_mesh_that_stands_across_x_is_calibrated_along_y():
    """It was refused for too few hinges."""
    flat = sheet(length=0.3, width=0.2, cells=(6, 4))
    given = {"young": 1e7, "poisson": 0.3, "thickness": 1e-3, "density": 400.0}
    lying = Material.from_physical(**given, mesh=flat)
    standing = Material.from_physical(**given, mesh=TriangleMesh(np.roll(flat.vertices, 1, axis=1), flat.faces))
    for name in ("stretch", "shear", "flexure"):
        assert getattr(standing, name) == pytest.approx(getattr(lying, name), rel=1e-9)
