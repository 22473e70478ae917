"""The membrane's parts of areas: bending in its own plane, and its zero modes on slender cells."""

import numpy as np
import pytest
import scipy.sparse.linalg as spla

from modalshell import Isotropic, Shell, TriangleMesh, flat_beam, sheet

FAMILIES = ["union-jack", "equilateral", "delaunay", "right"]
MEAN_DROP = 0.15944
"""Mean deflection of the strip below, of four families with 24 and 48 cells across, extrapolated by their order of 2.

They agree within 2e-5; Timoshenko's beam, which may narrow at its clamp, has 0.1604.
"""


def in_plane(shell):
    """Stiffness in the rest plane of the vertices that are not clamped, and their weight across the strip."""
    free = (3 * np.flatnonzero(~shell.clamped)[:, None] + [0, 1]).ravel()
    return shell.stiffness()[free][:, free], shell.gravity_force((0.0, 1.0, 0.0)).ravel()[free]


@pytest.mark.parametrize("family", FAMILIES)
def test_strips_bend_in_their_plane(family):
    """A clamped strip of five widths with four cells across; parts by thirds of the area leave up to -6.8 %."""
    mesh = flat_beam(length=0.1, width=0.02, cells=(20, 4), family=family)
    shell = Shell(mesh, Isotropic(1.0, 0.3, 1.0, 1.0), clamped=mesh.vertices[:, 0] < 1e-9)
    stiffness, weight = in_plane(shell)
    drop = weight @ spla.spsolve(stiffness.tocsc(), weight) / mesh.area
    assert drop == pytest.approx(MEAN_DROP, rel=0.02)


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
