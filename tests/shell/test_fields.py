"""Fields of deformed shells against shapes whose strains and curvatures are known."""

import numpy as np
import pytest

import modalshell as ms

SHEET = ms.Isotropic(young=2e9, poisson=0.3, thickness=2e-3, density=1000.0)
MEMBRANE = 2e9 * 2e-3 / (1.0 - 0.09)
RIGIDITY = MEMBRANE * 2e-3**2 / 12.0


def in_axes(mesh, tensor):
    """Components 11, 22, 12 of a plane tensor (2, 2) of the sheet in each triangle's axes."""
    edge = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
    first = edge[:, :2] / np.linalg.norm(edge[:, :2], axis=1)[:, None]
    second = np.column_stack([-first[:, 1], first[:, 0]])
    parts = [np.einsum("ti,ij,tj->t", a, tensor, b) for a, b in ((first, first), (second, second), (first, second))]
    return np.column_stack(parts)


@pytest.fixture(scope="module", params=["union-jack", "equilateral", "delaunay"])
def sheet(request):
    cells = (12, 14) if request.param == "equilateral" else (12, 12)
    mesh = ms.sheet(length=1.0, width=1.0, cells=cells, family=request.param)
    return ms.Shell(mesh, SHEET)


def bent(shell, curvature, direction):
    """The sheet rolled without strain on a cylinder about ``direction`` (degrees), normals spreading."""
    x, angle = shell.rest_positions, np.radians(direction)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    s = x @ along
    out = x + np.outer(np.sin(curvature * s) / curvature - s, along)
    out[:, 2] -= (1.0 - np.cos(curvature * s)) / curvature
    return out, np.outer(along[:2], along[:2])


@pytest.mark.by_default("union-jack-90.0", "equilateral-0.0", "delaunay-30.0")
@pytest.mark.parametrize("direction", [0.0, 30.0, 90.0])
def test_rolling_gives_one_curvature(sheet, direction):
    positions, dyad = bent(sheet, 0.02, direction)
    fields = sheet.fields(positions)
    inside = ~np.isin(sheet.mesh.faces, sheet.mesh.edges[sheet.mesh.edge_faces[:, 1] < 0]).any(axis=1)
    expected = in_axes(sheet.mesh, 0.02 * dyad)
    # Free edges are free of moment, which a cylinder is not: only inside is the curvature that of the cylinder.
    error = np.sqrt(np.mean((fields.curvature - expected)[inside] ** 2))
    assert error < 0.05 * 0.02
    np.testing.assert_allclose(fields.curvature[inside].mean(axis=0), expected[inside].mean(axis=0), atol=0.02 * 0.02)
    assert np.abs(fields.membrane_strain).max() < 1e-4


def test_stretching_gives_strain_force_and_stress(sheet):
    gradient = np.array([[1.002, 0.001], [-0.0005, 0.999]])
    positions = sheet.rest_positions.copy()
    positions[:, :2] = positions[:, :2] @ gradient.T
    strain = 0.5 * (gradient.T @ gradient - np.eye(2))
    fields = sheet.fields(positions)
    np.testing.assert_allclose(fields.membrane_strain, in_axes(sheet.mesh, strain), rtol=0, atol=1e-12)
    force = MEMBRANE * ((1.0 - 0.3) * strain + 0.3 * np.trace(strain) * np.eye(2))
    np.testing.assert_allclose(
        fields.membrane_force, in_axes(sheet.mesh, force), rtol=0, atol=1e-6 * np.abs(force).max()
    )
    stress = force / 2e-3
    mises = np.sqrt(stress[0, 0] ** 2 - stress[0, 0] * stress[1, 1] + stress[1, 1] ** 2 + 3.0 * stress[0, 1] ** 2)
    np.testing.assert_allclose(fields.von_mises, mises, rtol=1e-6)
    np.testing.assert_allclose(fields.moment, 0.0, atol=1e-9 * np.abs(force).max())
    np.testing.assert_allclose(fields.energy_density, 0.5 * np.sum(force * strain), rtol=1e-6)


def test_moments_and_curvatures_follow_the_plate(sheet):
    positions = bent(sheet, 0.05, 20.0)[0]
    fields = sheet.fields(positions)
    trace = fields.curvature[:, 0] + fields.curvature[:, 1]
    expected = RIGIDITY * (0.7 * fields.curvature + 0.3 * trace[:, None] * np.array([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(fields.moment, expected, rtol=0, atol=1e-10 * np.abs(fields.moment).max())
    force, moment = fields.membrane_force, fields.moment
    mises = [
        np.sqrt(s[:, 0] ** 2 - s[:, 0] * s[:, 1] + s[:, 1] ** 2 + 3.0 * s[:, 2] ** 2)
        for s in (force / 2e-3 + side * 6.0 * moment / 2e-3**2 for side in (1.0, -1.0))
    ]
    np.testing.assert_allclose(fields.von_mises, np.max(mises, axis=0), rtol=1e-12)


@pytest.mark.parametrize("material", [SHEET, ms.Material(20.0, 20.0, 0.05, 0.2)], ids=["isotropic", "hinges"])
def test_energy_densities_add_up_to_the_energy(material):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=140.0, cells=(20, 4))
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.06)
    rng = np.random.default_rng(3)
    positions = mesh.vertices + 1e-3 * rng.standard_normal(mesh.vertices.shape)
    fields = shell.fields(positions)
    assert np.sum(fields.energy_density * mesh.face_areas) == pytest.approx(shell.energy(positions), rel=1e-10)
    assert (fields.energy_density >= 0.0).all()
    assert (fields.membrane_force is None) == (material is not SHEET)


def test_hinges_have_strains_and_curvatures_too():
    mesh = ms.sheet(cells=(16, 16))
    hinged = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2))
    theory = ms.Shell(mesh, ms.Isotropic(1.0, 0.0, 1e-3, 1.0))
    positions = bent(theory, 0.05, 35.0)[0]
    for name in ("curvature", "membrane_strain"):
        found, expected = (getattr(shell.fields(positions), name) for shell in (hinged, theory))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_curvatures_of_hinges_follow_a_clamp_that_is_shifted():
    mesh, origin = ms.flat_beam(cells=(10, 3)), np.array([8.0, 0.0, 4.0])
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.01)
    x = mesh.vertices + np.outer(0.2 * mesh.vertices[:, 0] ** 2, [0.0, 0.0, 1.0])
    fresh, known = (shell.shifted(origin).fields(x - origin).curvature, shell.fields(x).curvature)
    np.testing.assert_allclose(fresh, known, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(shell.shifted(origin).fields(x - origin).curvature, known, rtol=0.0, atol=1e-12)


def test_collapsed_triangles_and_wrong_positions_are_refused(sheet):
    with pytest.raises(ms.LoadError, match="flattest triangle"):
        sheet.fields(np.zeros_like(sheet.rest_positions))
    with pytest.raises(ms.LoadError):
        sheet.fields(np.zeros((3, 3)))


def test_fields_turn_with_the_shell():
    mesh = ms.cylinder_panel(cells=(8, 8))
    shell = ms.Shell(mesh, SHEET, clamped=mesh.vertices[:, 0] < 1e-9)
    rng = np.random.default_rng(4)
    positions = mesh.vertices + 1e-3 * rng.standard_normal(mesh.vertices.shape)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    free = ms.Shell(mesh, SHEET)
    before, after = free.fields(positions), free.fields(positions @ turn.T + 0.3)
    for name in ("membrane_strain", "curvature", "energy_density", "membrane_force", "moment", "von_mises"):
        value = getattr(before, name)
        np.testing.assert_allclose(getattr(after, name), value, rtol=0, atol=1e-9 * np.abs(value).max())
    assert np.abs(shell.fields(mesh.vertices).curvature).max() < 1e-12


@pytest.mark.parametrize("material", [SHEET, ms.Material(2e3, 2e3, 0.05, 2.0)], ids=["isotropic", "hinges"])
def test_reactions_balance_the_load(material):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.06)
    force = np.zeros_like(mesh.vertices)
    force[int(np.argmax(mesh.vertices[:, 0]))] = (0.1, 0.3, -0.2)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -2.0), force=force)
    assert answer.converged
    reactions = shell.reactions(answer.positions, gravity=(0.0, 0.0, -2.0), force=force)
    assert not reactions[~shell.clamped].any()
    load = shell.total_load((0.0, 0.0, -2.0), force)
    np.testing.assert_allclose(reactions.sum(axis=0), -load.sum(axis=0), atol=2e-7 * np.abs(load).sum())


def test_reactions_of_a_shell_clamped_by_one_row():
    mesh = ms.sheet(cells=(10, 10))
    shell = ms.Shell(mesh, SHEET, clamped=mesh.vertices[:, 0] < 1e-9)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -1.0))
    reactions = shell.reactions(answer.positions, gravity=(0.0, 0.0, -1.0))
    weight = float(shell.mass.sum())
    np.testing.assert_allclose(reactions.sum(axis=0), (0.0, 0.0, weight), atol=1e-6 * weight)


@pytest.mark.by_default(
    "union-jack-moment",
    "equilateral-membrane_force",
    "equilateral-curvature",
    "delaunay-membrane_strain",
)
@pytest.mark.parametrize("name", ["membrane_strain", "membrane_force", "curvature", "moment"])
def test_principal_values_and_directions_make_the_tensor(sheet, name):
    x = bent(sheet, 0.3, 30.0)[0] * [1.01, 0.99, 1.0]
    fields = sheet.fields(x)
    values, directions = fields.principal(name)
    assert (values[:, 0] >= values[:, 1]).all()
    tensor = np.einsum("tp,tpi,tpj->tij", values, directions, directions)
    first, second = fields.axes.transpose(1, 0, 2)
    for k, (a, b) in enumerate(((first, first), (second, second), (first, second))):
        found = np.einsum("ti,tij,tj->t", a, tensor, b)
        np.testing.assert_allclose(found, fields.values(name)[:, k], atol=1e-12 * np.abs(values).max())
    # The axes lie in the triangles: the first along the first edge, the second to its left.
    corners = x[sheet.mesh.faces]
    np.testing.assert_allclose(np.cross(corners[:, 1] - corners[:, 0], first), 0.0, atol=1e-12)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.sum(np.cross(first, second) * normal, axis=1) > 0.0).all()
    largest = values[np.arange(len(values)), np.abs(values).argmax(axis=1)]
    np.testing.assert_allclose(ms.measure.field(sheet, x, name), largest, rtol=1e-12)


def test_faces_of_a_stretched_and_bent_sheet():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.0, 0.01, 1000.0), mesh.vertices[:, 0] < 1e-6)
    end = mesh.vertices[:, 0] > 0.999
    # Rolled downwards the normals spread.
    state = ms.DiscreteShell(shell).equilibrium(loads=[ms.EdgeMoment(end, -0.5)])
    fields = shell.fields(state.positions)
    middle = np.abs(mesh.vertices[mesh.faces].mean(axis=1)[:, 0] - 0.5) < 0.2
    np.testing.assert_allclose(fields.von_mises_faces[middle], 6.0 * 0.5 / 0.01**2, rtol=0.02)
    np.testing.assert_array_equal(fields.von_mises, fields.von_mises_faces.max(axis=1))
    assert fields.scalar("moment")[middle] == pytest.approx(0.5, rel=0.02)


def test_names_of_fields_are_checked():
    mesh = ms.flat_beam(cells=(4, 2))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2))
    for name in ("membrane_strain", "curvature", "energy_density"):
        assert ms.measure.field(shell, mesh.vertices, name).shape == (len(mesh.faces),)
    with pytest.raises(ms.OptionError, match="von_mises needs a sheet with a thickness"):
        ms.measure.field(shell, mesh.vertices, "von_mises")
    with pytest.raises(ms.OptionError, match="field must be one of 'membrane_strain'"):
        ms.measure.field(shell, mesh.vertices, "stress")
    with pytest.raises(ms.OptionError, match="tensor must be one of"):
        shell.fields(mesh.vertices).principal("energy_density")


@pytest.mark.parametrize("material", [ms.Isotropic(1e7, 0.3, 0.01, 1000.0), ms.Material(20.0, 20.0, 0.05, 0.2)])
def test_each_support_has_its_reaction(material):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    x = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, material, supports=[ms.Clamp(x < 0.2), ms.Fix(x > 0.9, axes="z")])
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -1e-3))
    assert state.converged
    found = ms.measure.support_reactions(shell, state.positions, gravity=(0.0, 0.0, -1e-3))
    weight = 1e-3 * shell.mass.sum()
    np.testing.assert_allclose(found.sum(axis=0), [0.0, 0.0, weight], atol=1e-8 * weight)
    assert (found[:, 2] > 0.1 * weight).all()


@pytest.mark.parametrize("material", [ms.Isotropic(1e7, 0.3, 0.02, 500.0), ms.Material(1e4, 1e3, 5.0, 10.0)])
def test_reactions_in_a_plane_of_symmetry_turn_the_shell_about_its_edge_alone(material):
    """They acted at one end of each edge, which end being a matter of the triangles' winding."""
    mesh = ms.sheet(length=1.0, width=0.5, cells=(4, 2))
    x, y, _ = mesh.vertices.T
    edge = y < y.min() + 1e-9
    supports = [ms.Symmetry(edge, (0, 1, 0)), ms.Fix(edge, "z"), ms.Fix(y > y.max() - 1e-9, "z"), ms.Fix([0], "x")]
    vertices = mesh.vertices + np.outer(np.where(edge, 0.0, 0.05 * np.sin(7.0 * y + 9.0 * x)), (1.0, 0.0, 0.0))
    force, found = np.random.default_rng(0).normal(size=vertices.shape), []
    for faces in (mesh.faces, mesh.faces[:, ::-1]):
        shell = ms.Shell(ms.TriangleMesh(vertices, faces), material, supports=supports)
        answer = ms.DiscreteShell(shell).equilibrium(force=force)
        found.append(shell.reactions(answer.positions, force=force))
        moments = np.cross(answer.positions, found[-1] + force).sum(axis=0)
        assert np.abs(moments[1:]).max() < 1e-7 < 1e-3 < abs(moments[0])
    np.testing.assert_allclose(found[1], found[0], atol=1e-7)


def test_supports_that_share_a_vertex_or_a_plane_have_one_answer():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    y = mesh.vertices[:, 1]
    supports = [ms.Clamp("x < 0.01"), ms.Symmetry(y < y.min() + 1e-9, (0, 1, 0)), ms.Pin("boundary(0) and x < 0.2")]
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 0.01, 1000.0), supports=supports)
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 1e-3, -1e-3))
    found = ms.measure.support_reactions(shell, state.positions, gravity=(0.0, 1e-3, -1e-3))
    each = shell.support_reactions(state.positions, gravity=(0.0, 1e-3, -1e-3))
    np.testing.assert_array_equal(found, [share.sum(axis=0) for share in each])
    weight = 1e-3 * shell.mass.sum()
    np.testing.assert_allclose(found.sum(axis=0), [0.0, -weight, weight], atol=1e-8 * weight)
    assert np.abs(found).sum(axis=1).min() > 0.0
    assert np.abs(found[1, [0, 2]]).max() < 1e-12 * weight  # a plane pushes along its normal alone
