"""The shell: energies against their formulas, mass, supports, the sparse pattern, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import Made

from modalshell import Isotropic, Material, Shell, TriangleMesh, cylinder_panel, leaf, sheet, v_beam
from modalshell.core.errors import LoadError, MaterialError, ModalShellError, SupportError
from modalshell.shell import EXACT

MESHES = Made(
    {
        "sheet": lambda: sheet(cells=(3, 2)),
        "V": lambda: v_beam(cells=(4, 4), family="lloyd"),
        "cylinder": lambda: cylinder_panel(cells=(4, 5), angle=100.0, family="equilateral"),
        "leaf": lambda: leaf(cells=(6, 4)),
    }
)
PLAIN = Material(stretch=20.0, shear=30.0, flexure=0.05, density=0.2)


def textbook_energy(mesh, x, k_s, k_h, k_f):
    """E of the paper (eq. 1-4), written out with loops: areas, lengths, dihedral angles over h0 = mean height / 3."""

    def area(points, face):
        return 0.5 * np.linalg.norm(np.cross(points[face[1]] - points[face[0]], points[face[2]] - points[face[0]]))

    def fold(points, hinge):
        x0, x1, x2, x3 = points[hinge]
        e = x1 - x0
        n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
        return np.arctan2(np.cross(n1, n2) @ e / np.linalg.norm(e), n1 @ n2)

    rest = mesh.vertices
    total = sum(k_s[t] * (area(x, f) - area(rest, f)) ** 2 / area(rest, f) for t, f in enumerate(mesh.faces))
    for k, (i, j) in enumerate(mesh.edges):
        l0 = np.linalg.norm(rest[j] - rest[i])
        total += k_h[k] * (np.linalg.norm(x[j] - x[i]) - l0) ** 2 / l0
    for k, hinge in enumerate(mesh.hinges):
        i, j, a, b = hinge
        l0 = np.linalg.norm(rest[j] - rest[i])
        heights = [2.0 * area(rest, (i, j, apex)) / l0 for apex in (a, b)]
        h0 = np.mean(heights) / 3.0
        total += k_f[k] * (fold(x, hinge) - fold(rest, hinge)) ** 2 * l0 / h0
    return total


def deformed(mesh, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    return mesh.vertices + noise * mesh.edge_lengths.min() * rng.standard_normal(mesh.vertices.shape)


@pytest.mark.parametrize("name", MESHES)
def test_energy_is_the_textbook_sum(name):
    mesh = MESHES[name]
    rng = np.random.default_rng(1)
    k_s, k_h, k_f = (rng.uniform(1.0, 2.0, len(items)) for items in (mesh.faces, mesh.edges, mesh.hinges))
    shell = Shell(mesh, Material(stretch=k_s, shear=k_h, flexure=k_f, density=1.0))
    x = deformed(mesh)
    assert shell.energy(x) == pytest.approx(textbook_energy(mesh, x, k_s, k_h, k_f), rel=1e-11)


def test_energies_of_a_right_triangle_pair_by_hand():
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    x = np.array(mesh.vertices)
    x[3, 2] = 0.5
    fold = np.arctan(0.5 / np.sqrt(0.5))
    diagonal = np.sqrt(2.0)

    def energy(**stiffness):
        values = {"stretch": 0.0, "shear": 0.0, "flexure": 0.0} | stiffness
        return Shell(mesh, Material(**values, density=1.0)).energy(x)

    # h0 = (1/3) * mean of the heights over the diagonal, sqrt(2)/2 each.
    area = 0.5 * diagonal * np.hypot(np.sqrt(0.5), 0.5)
    assert energy(flexure=2.0) == pytest.approx(2.0 * fold**2 * diagonal / (diagonal / 6.0), rel=1e-13)
    assert energy(stretch=3.0) == pytest.approx(3.0 * (area - 0.5) ** 2 / 0.5, rel=1e-12)
    assert energy(shear=4.0) == pytest.approx(4.0 * 2.0 * (np.hypot(1.0, 0.5) - 1.0) ** 2, rel=1e-12)


@pytest.mark.parametrize("name", MESHES)
def test_rest_shape_is_stress_free(name):
    mesh = MESHES[name]
    shell = Shell(mesh, PLAIN)
    assert 0.0 <= shell.energy(mesh.vertices) < 1e-25
    np.testing.assert_allclose(shell.force(mesh.vertices), 0.0, atol=1e-11)


@pytest.mark.parametrize("name", MESHES)
def test_mass_is_a_third_of_each_triangle(name):
    mesh = MESHES[name]
    densities = np.random.default_rng(2).uniform(0.5, 2.0, len(mesh.faces))
    shell = Shell(mesh, Material(stretch=1.0, shear=1.0, flexure=1.0, density=densities))
    expected = np.zeros(len(mesh.vertices))
    for face, area, density in zip(mesh.faces, mesh.face_areas, densities, strict=True):
        expected[face] += density * area / 3.0
    np.testing.assert_allclose(shell.mass, expected, rtol=1e-14)
    assert shell.mass.sum() == pytest.approx(np.sum(densities * mesh.face_areas), rel=1e-14)
    weight = shell.gravity_force((1.0, -2.0, 3.0))
    np.testing.assert_allclose(weight, expected[:, None] * [1.0, -2.0, 3.0], rtol=1e-14)


@pytest.mark.parametrize("name", MESHES)
def test_force_of_the_contract_is_minus_the_gradient(name):
    """The public functions alone, by central differences in every unknown."""
    mesh = MESHES[name]
    shell = Shell(mesh, PLAIN)
    x, h = deformed(mesh), 1e-6
    numeric = np.zeros_like(x)
    for index in np.ndindex(*x.shape):
        ahead, behind = x.copy(), x.copy()
        ahead[index] += h
        behind[index] -= h
        numeric[index] = -(shell.energy(ahead) - shell.energy(behind)) / (2 * h)
    force = shell.force(x)
    assert force.shape == x.shape
    np.testing.assert_allclose(force, numeric, rtol=0, atol=1e-7 * np.abs(force).max())


def test_stiffness_is_sparse_symmetric_and_complete():
    mesh = MESHES["V"]
    shell = Shell(mesh, PLAIN)
    matrix = shell.stiffness(deformed(mesh))
    assert matrix.shape == (3 * len(mesh.vertices),) * 2
    assert abs(matrix - matrix.T).max() <= 1e-14 * abs(matrix).max()
    neighbours = {
        (int(i), int(j)) for stencil in (mesh.faces, mesh.edges, mesh.hinges) for s in stencil for i in s for j in s
    }
    assert matrix.nnz == 9 * len(neighbours)
    assert abs(shell.stiffness() - shell.stiffness(mesh.vertices)).max() == 0.0


@pytest.mark.parametrize("name", MESHES)
def test_free_part_is_the_submatrix_of_the_free_unknowns(name):
    mesh = MESHES[name]
    clamped = mesh.vertices[:, 0] < np.median(mesh.vertices[:, 0])
    shell = Shell(mesh, PLAIN, clamped)
    data = shell.energy_gradient_hessian(deformed(mesh), EXACT)[2]
    free = np.flatnonzero(np.repeat(~clamped, 3))
    np.testing.assert_array_equal(shell.free_unknowns, free)
    np.testing.assert_array_equal(shell.free, np.flatnonzero(~clamped))
    whole = shell.pattern.matrix(data).toarray()
    np.testing.assert_allclose(shell.pattern.free_matrix(data).toarray(), whole[np.ix_(free, free)], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(data[shell.pattern.diagonal], np.diag(whole))


@pytest.mark.parametrize("name", MESHES)
def test_free_part_of_a_large_shell_is_taken_alike(name, monkeypatch):
    mesh = MESHES[name]
    for material in (PLAIN, Isotropic(young=1e6, poisson=0.3, thickness=1e-2, density=100.0)):
        shell = Shell(mesh, material, mesh.vertices[:, 0] < np.median(mesh.vertices[:, 0]))
        data = shell.energy_gradient_hessian(deformed(mesh), EXACT)[2]
        found = []
        for small in (data.size, 0):
            monkeypatch.setattr("modalshell.shell.free_part._SMALL", small)
            found.append(shell.pattern.free_matrix(data))
        assert found[0].nnz > 0
        np.testing.assert_array_equal(found[0].toarray(), found[1].toarray())
        np.testing.assert_array_equal(found[0].data, found[1].data)


@pytest.mark.slow
@given(seed=st.integers(0, 2**16), data=st.data())
@settings(deadline=None, max_examples=20)
def test_mask_and_indices_say_the_same(seed, data):
    mesh = MESHES["sheet"]
    count = len(mesh.vertices)
    indices = data.draw(st.lists(st.integers(0, count - 1), max_size=count - 1))
    mask = np.zeros(count, dtype=bool)
    mask[indices] = True
    x = deformed(mesh, seed)
    by_index, by_mask = Shell(mesh, PLAIN, np.array(indices, dtype=int)), Shell(mesh, PLAIN, mask)
    np.testing.assert_array_equal(by_index.clamped, mask)
    np.testing.assert_array_equal(by_mask.clamped, mask)
    assert by_index.energy(x) == by_mask.energy(x) == Shell(mesh, PLAIN).energy(x)


def test_no_supports_is_a_free_shell():
    for clamped in (None, [], np.zeros(len(MESHES["sheet"].vertices), dtype=bool)):
        shell = Shell(MESHES["sheet"], PLAIN, clamped)
        assert not shell.clamped.any()
        assert shell.free.size == len(MESHES["sheet"].vertices)


def test_mask_is_copied():
    mask = np.zeros(len(MESHES["sheet"].vertices), dtype=bool)
    mask[0] = True
    shell = Shell(MESHES["sheet"], PLAIN, mask)
    mask[:] = False
    assert shell.clamped.sum() == 1


@pytest.mark.parametrize(
    "clamped",
    [
        np.zeros(3, dtype=bool),
        np.zeros((12, 1), dtype=bool),
        [0, 12],
        [-1],
        [0.0, 1.0],
        [0.5],
        ["a"],
        "left",
        np.ones(12, dtype=bool),
        np.arange(12),
        [[0, 1], [2]],
        [True, False],
    ],
    ids=repr,
)
def test_bad_supports_are_refused(clamped):
    with pytest.raises(SupportError) as caught:
        Shell(MESHES["sheet"], PLAIN, clamped)
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, ModalShellError)


def test_a_text_clamps_what_it_selects():
    mesh = MESHES["V"]
    chosen = mesh.vertices[:, 0] < 0.3
    assert np.array_equal(Shell(mesh, PLAIN, "x < 0.3").clamped, Shell(mesh, PLAIN, chosen).clamped)
    with pytest.raises(SupportError, match="clamped selects no vertex"):
        Shell(mesh, PLAIN, clamped="x > 99")


def test_support_errors_say_what_was_got():
    with pytest.raises(SupportError, match=r"vertex 12\b.*0 to 11"):
        Shell(MESHES["sheet"], PLAIN, [0, 12])
    with pytest.raises(SupportError, match=r"\(12,\).*\(3,\)"):
        Shell(MESHES["sheet"], PLAIN, np.zeros(3, dtype=bool))
    with pytest.raises(SupportError, match="all 12"):
        Shell(MESHES["sheet"], PLAIN, np.ones(12, dtype=bool))


@pytest.mark.parametrize("call", ["energy", "force", "stiffness", "checked_positions"])
@pytest.mark.parametrize("bad", ["shape", "flat", "nan", "inf", "text"])
def test_bad_positions_are_refused(call, bad):
    shell = Shell(MESHES["sheet"], PLAIN)
    x = np.array(MESHES["sheet"].vertices)
    if bad == "shape":
        x = x[:-1]
    elif bad == "flat":
        x = x.ravel()
    elif bad == "text":
        x = "here"
    else:
        x[4, 1] = float(bad)
    with pytest.raises(LoadError):
        getattr(shell, call)(x)


def test_position_errors_name_the_vertex():
    x = np.array(MESHES["sheet"].vertices)
    x[4, 1] = np.nan
    with pytest.raises(LoadError, match=r"\b4\b"):
        Shell(MESHES["sheet"], PLAIN).energy(x)


@pytest.mark.parametrize("gravity", [(0.0, 1.0), 9.81, (0.0, 0.0, np.nan), (0.0, 0.0, np.inf), "down", [[0, 0, 1]]])
def test_bad_gravity_is_refused(gravity):
    with pytest.raises(LoadError):
        Shell(MESHES["sheet"], PLAIN).gravity_force(gravity)


@pytest.mark.parametrize("name", ["stretch", "shear", "flexure", "density"])
def test_arrays_must_fit_the_mesh(name):
    mesh = MESHES["sheet"]
    values = {"stretch": 20.0, "shear": 30.0, "flexure": 0.05, "density": 0.2}
    counts = {
        "stretch": len(mesh.faces),
        "shear": len(mesh.edges),
        "flexure": len(mesh.hinges),
        "density": len(mesh.faces),
    }
    fitting = Shell(mesh, Material(**values | {name: np.full(counts[name], values[name])}))
    x = deformed(mesh)
    assert fitting.energy(x) == Shell(mesh, PLAIN).energy(x)
    np.testing.assert_array_equal(fitting.mass, Shell(mesh, PLAIN).mass)
    for count in (counts[name] - 1, counts[name] + 1, 0):
        with pytest.raises(MaterialError, match=rf"{name}.*{count}"):
            Shell(mesh, Material(**values | {name: np.full(count, 1.0)}))


def test_calls_do_not_change_their_arguments():
    mesh = MESHES["leaf"]
    shell = Shell(mesh, PLAIN)
    x = deformed(mesh)
    before = x.copy()
    first = shell.force(x), shell.stiffness(x)
    second = shell.force(x), shell.stiffness(x)
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(first[0], second[0])
    assert abs(first[1] - second[1]).max() == 0.0
    np.testing.assert_array_equal(shell.force(x.tolist()), first[0])
    np.testing.assert_array_equal(shell.force(np.asfortranarray(x)), first[0])


def test_clamp_correction_doubles_the_hinges_on_the_clamp_line():
    mesh = sheet(cells=(4, 2), family="right")
    clamped = mesh.vertices[:, 0] < 0.26
    plain = Shell(mesh, PLAIN, clamped).elements[2].weight
    corrected_material = Material(stretch=20.0, shear=30.0, flexure=0.05, density=0.2, correct_clamp=True)
    corrected = Shell(mesh, corrected_material, clamped).elements[2].weight
    ends = mesh.vertices[mesh.hinges[:, :2], 0]
    on_line = np.isclose(ends, 0.25).all(axis=1)
    assert on_line.sum() == 2
    np.testing.assert_allclose(corrected, np.where(on_line, 2.0, 1.0) * plain, rtol=1e-15)
    free = Shell(mesh, corrected_material).elements[2].weight
    np.testing.assert_array_equal(free, plain)
