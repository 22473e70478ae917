"""Equilibria next to known ones: the same answers and derivatives, for less work."""

from dataclasses import replace

import numpy as np
import pytest

import modalshell as ms
from modalshell.analysis.fit_measurements import KnownEquilibrium
from modalshell.core import cost as work

SHEET = ms.Isotropic(young=1e6, poisson=0.3, thickness=4e-3, density=60.0)
GRAVITY = np.array([0.0, 0.3, -2.0])


def body_of(material, offset=0.0):
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(24, 2))
    moved = ms.TriangleMesh(mesh.vertices + np.array([0.0, offset, 0.0]), mesh.faces)
    return ms.DiscreteShell(ms.Shell(moved, material, moved.vertices[:, 0] < 0.01))


LOADS = {
    "weight": [],
    "follower pressure without a potential": [ms.Pressure(0.1)],
    "wind": [ms.Wind((0.0, 0.0, -1.0))],
}


@pytest.mark.by_default("0.0-follower pressure without a potential")
@pytest.mark.parametrize("loads", LOADS.values(), ids=LOADS)
@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_an_equilibrium_near_a_known_one_is_that_of_the_model(loads, offset):
    body, stiffer = body_of(SHEET, offset), body_of(replace(SHEET, young=1.2e6), offset)
    known = KnownEquilibrium.of(body, body.equilibrium(gravity=GRAVITY, loads=loads), ["young"])
    loading = stiffer.shell.loading(GRAVITY, None, loads)
    found = known.near(stiffer, loading, GRAVITY, 0.2e6 * known.rates[..., 0], ["young", "density"])
    wanted = stiffer.equilibrium(gravity=GRAVITY, loads=loads)
    size = np.abs(wanted.positions - stiffer.shell.rest_positions).max()
    np.testing.assert_allclose(found.state.positions, wanted.positions, atol=1e-6 * size)
    assert found.state.converged
    assert found.state.message == wanted.message
    slope = stiffer.sensitivity(found.state, wrt=["young", "density"])
    for rate, exact in zip(found.rates.T, slope.T, strict=True):
        np.testing.assert_allclose(rate, exact, atol=1e-7 * np.abs(exact).max())


def test_what_is_not_near_is_not_found():
    """An arch that is pushed through its snap."""
    mesh = ms.cylinder_panel(radius=1.0, length=0.2, angle=35.0, cells=(3, 12))
    ends = np.abs(mesh.vertices[:, 1]) > np.abs(mesh.vertices[:, 1]).max() - 1e-6
    body = ms.DiscreteShell(ms.Shell(mesh, SHEET, ends))
    middle = np.flatnonzero(np.abs(mesh.vertices[:, 1]) < 1e-6)
    force = np.zeros_like(mesh.vertices)
    force[middle, 2] = -1e-5
    known = KnownEquilibrium.of(body, body.equilibrium(force=force), ["load"])
    assert known.near(body, body.shell.loading(None, 1e8 * force), None, 1e8 * known.rates[..., 0], ["load"]) is None


def test_a_known_state_costs_one_factorisation_and_one_without_change_no_step():
    body = body_of(SHEET)
    state = body.equilibrium(gravity=GRAVITY)
    with work.counted() as counts:
        known = KnownEquilibrium.of(body, state, ["young", "poisson", "load"])
    assert counts.factorisations == 1
    with work.counted() as counts:
        again = known.near(body, state.loading, GRAVITY, np.zeros_like(state.positions), ["young"], goal=1e-7)
    assert counts.factorisations == 1
    np.testing.assert_array_equal(again.state.positions, state.positions)
