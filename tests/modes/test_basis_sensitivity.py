"""Derivatives of eigenvalues and modes: Taylor slopes, closed forms, what has none."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PLAIN

import modalshell as ms

SHEET = ms.Isotropic(young=1e6, poisson=0.3, thickness=4e-3, density=60.0)


def basis(material, count=8, *, free=False):
    mesh = ms.v_beam(length=1.0, width=0.23, fold=140.0, cells=(12, 4))
    row = 0.01 if isinstance(material, ms.Isotropic) else 0.1
    return ms.solve_modes(ms.Shell(mesh, material, None if free else mesh.vertices[:, 0] < row), count)


@pytest.mark.by_default("material3-density-False")
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize(
    ("material", "name"),
    [(PLAIN, name) for name in ("stretch", "shear", "flexure", "density")]
    + [(SHEET, name) for name in ("poisson", "thickness", "density")],
)
def test_the_derivatives_have_taylor_slope_two(material, name, free):
    count = 12 if free else 8
    here, value = basis(material, count, free=free), getattr(material, name)
    slope, elastic = here.sensitivity(name), slice(here.rigid_modes, None)
    errors = []
    for change in (0.01, 0.005, 0.0025):
        near = basis(replace(material, **{name: value * (1.0 + change)}), count, free=free)
        signs = np.sign(np.sum(near.modes * here.modes, axis=0))
        errors.append(
            [
                np.linalg.norm((left - change * value * rate)[..., elastic] / size)
                for left, rate, size in (
                    (near.eigenvalues - here.eigenvalues, slope.eigenvalues, here.eigenvalues[elastic]),
                    (near.frequencies - here.frequencies, slope.frequencies, here.frequencies[elastic]),
                    (near.modes * signs - here.modes, slope.modes, 1.0),
                )
            ]
        )
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (np.abs(orders - 2.0) < 0.25).all(), orders


def test_young_scales_eigenvalues_and_leaves_modes():
    here = basis(SHEET)
    slope = here.sensitivity("young")
    np.testing.assert_allclose(slope.eigenvalues, here.eigenvalues / SHEET.young, rtol=1e-9)
    np.testing.assert_allclose(slope.frequencies, 0.5 * here.frequencies / SHEET.young, rtol=1e-9)
    assert np.abs(slope.modes).max() * SHEET.young < 1e-6 * np.abs(here.modes).max()


def test_what_has_no_derivative_is_refused():
    square = ms.sheet(length=1.0, width=1.0, cells=(8, 8), family="union-jack")
    edge = (np.abs(square.vertices[:, :2] - (0.5, 0.0)) > 0.499).any(axis=1)
    with pytest.raises(ms.OptionError, match="modes 1 and 2 share an eigenvalue"):
        ms.solve_modes(ms.Shell(square, SHEET, edge), 4).sensitivity("young")
    shell = basis(SHEET).shell
    attached = ms.solve_modes(shell, 4, attachments=[ms.PointForce("x > 0.99", (0.0, 1.0, 0.0))])
    with pytest.raises(ms.OptionError, match="vector 4 of the basis is no mode"):
        attached.sensitivity("poisson")
    with pytest.raises(ms.OptionError, match="wrt must be one of young, poisson, thickness, density"):
        basis(SHEET).sensitivity("gravity")
