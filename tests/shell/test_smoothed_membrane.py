"""The membrane's parts of areas: bending in its own plane, and its zero modes on slender cells."""

import numpy as np
import pytest
import scipy.sparse.linalg as spla

from modalshell import Isotropic, Shell, TriangleMesh, flat_beam, sheet
from modalshell.shell.kernels.split_folds import add_membrane

FAMILIES = ["union-jack", "equilateral", "delaunay", "right"]
MEAN_DROP = 0.15944
"""Mean deflection of the strip below, of four families with 24 and 48 cells across, extrapolated by their order of 2.

They agree within 2e-5; Timoshenko's beam, which may narrow at its clamp, has 0.1604.
"""


def in_plane(shell):
    """Stiffness in the rest plane of the vertices that are not clamped, and their weight across the strip."""
    free = (3 * np.flatnonzero(~shell.clamped)[:, None] + [0, 1]).ravel()
    return shell.stiffness()[free][:, free], shell.gravity_force((0.0, 1.0, 0.0)).ravel()[free]


@pytest.mark.by_default("union-jack", "equilateral")
@pytest.mark.parametrize("family", FAMILIES)
def test_strips_bend_in_their_plane(family):
    """A clamped strip of five widths with four cells across; parts by thirds of the area leave up to -6.8 %."""
    mesh = flat_beam(length=0.1, width=0.02, cells=(20, 4), family=family)
    shell = Shell(mesh, Isotropic(1.0, 0.3, 1.0, 1.0), clamped=mesh.vertices[:, 0] < 1e-9)
    stiffness, weight = in_plane(shell)
    drop = weight @ spla.spsolve(stiffness.tocsc(), weight) / mesh.area
    assert drop == pytest.approx(MEAN_DROP, rel=0.02)


@pytest.mark.by_default("union-jack-10", "equilateral-5", "delaunay-5", "right-50")
@pytest.mark.parametrize("along", [5, 10, 50])
@pytest.mark.parametrize("family", FAMILIES)
def test_a_single_row_of_slender_cells_resists_bending_in_its_plane(family, along):
    """Long edges average it away; parts of area without a least one leave up to 435 times the deflection."""
    mesh = flat_beam(length=0.1, width=0.02, cells=(along, 1), family=family)
    shell = Shell(mesh, Isotropic(1.0, 0.3, 1.0, 1.0), clamped=mesh.vertices[:, 0] < 1e-9)
    stiffness, weight = in_plane(shell)
    drop = weight @ spla.spsolve(stiffness.tocsc(), weight) / mesh.area
    assert 0.5 * MEAN_DROP < drop < 2.5 * MEAN_DROP


def test_rings_of_long_cells_do_not_swell_by_turns_for_nothing():
    """A tube's rings grow and shrink in turn. Hoop strains linear between them have three times this least energy."""
    around, rows = 48, 4
    level, place = np.divmod(np.arange((rows + 1) * around), around)
    angle = 2.0 * np.pi / around * place
    radial = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(angle.size)])
    own = np.arange(rows * around)
    beside = own // around * around + (own + 1) % around
    faces = np.vstack(
        [np.column_stack([own, beside, beside + around]), np.column_stack([own, beside + around, own + around])]
    )
    mesh = TriangleMesh(radial + 6.0 / rows * level[:, None] * (0.0, 0.0, 1.0), faces)
    shell = Shell(mesh, Isotropic(1.0, 0.0, 1e-3, 1.0))
    step = (radial * ((-1.0) ** level)[:, None]).ravel()
    assert 0.3 < step @ shell.stiffness() @ step / (1e-3 * mesh.area / 3.0) < 1.0


@pytest.mark.by_default("union-jack-1.0", "equilateral-0.01", "delaunay-100.0", "right-100.0")
@pytest.mark.parametrize("ratio", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("family", FAMILIES)
def test_three_zero_modes_in_plane(family, ratio):
    plain = sheet(length=1.0, width=1.0, cells=(8, 6), family=family)
    mesh = TriangleMesh(plain.vertices * (1.0, ratio, 1.0), plain.faces)
    shell = Shell(mesh, Isotropic(1.0, 0.3, 0.01, 1.0))
    root = np.sqrt(np.repeat(shell.mass, 2))
    values = np.linalg.eigvalsh(in_plane(shell)[0].toarray() / root[:, None] / root)
    assert np.abs(values[:3]).max() < 1e-14 * values[-1]
    assert values[3] > 1e-9 * values[-1]


def test_the_membrane_part_of_the_hessian_is_the_sum_of_its_elements():
    mesh = flat_beam(length=1.0, width=0.4, cells=(4, 2))
    shell = Shell(mesh, Isotropic(young=1e6, poisson=0.3, thickness=1e-2, density=100.0))
    energy, count = shell.elastic_energy, len(mesh.vertices)
    x = mesh.vertices + 0.02 * np.random.default_rng(3).standard_normal((count, 3))
    pattern, slots = energy.pattern(shell.unknowns)
    data, expected = np.zeros(pattern.size), np.zeros((3 * count, 3 * count))
    assert {e.stencils.shape[1] for e in energy._membrane} == {3, 4}
    for e, place in zip(energy._membrane, slots[3:5], strict=True):
        add_membrane(x, *e.as_pairs(place), pattern.strides, data)
        for stencil, matrix in zip(e.stencils, e.matrices, strict=True):
            slopes = np.zeros((len(e.pairs), count, 3))
            for row, (a, b) in enumerate(stencil[e.pairs]):
                slopes[row, b] += x[b] - x[a]
                slopes[row, a] -= x[b] - x[a]
            slopes = slopes.reshape(len(e.pairs), -1)
            expected += slopes.T @ matrix @ slopes
    found = pattern.matrix(data).toarray()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize("family", ["union-jack", "right"])
def test_a_pulled_strip_is_in_balance_on_both_sides_of_a_jump_of_its_thickness(family):
    """Strains averaged over the jump made forces next to it 21 to 45 % too small."""
    mesh = flat_beam(length=0.1, width=0.02, cells=(8, 2), family=family)
    thickness = np.where(mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < 0.05, 1e-2, 1e-3)
    x = mesh.vertices.copy()
    x[:, 0] += np.interp(x[:, 0], [0.0, 0.05, 0.1], [0.0, 0.05e-6, 0.05e-6 + 0.05e-5])
    force = Shell(mesh, Isotropic(1.0, 0.0, thickness, 1.0)).force(x)[:, 0]
    inner = (mesh.vertices[:, 0] > 1e-6) & (mesh.vertices[:, 0] < 0.0999)
    assert np.abs(force[inner]).max() < 1e-4 * np.abs(force[~inner]).max()
