"""Statics of DS whose shell smooth planes let drift along them: it rests on floors, and slides where it is pushed."""

import numpy as np
import pytest

import modalshell as ms

SHEET = ms.Isotropic(young=5e7, poisson=0.3, thickness=2e-3, density=1000.0)
FLOOR, WALL = ms.Contact(ms.Plane((0, 0, 1), -1e-3)), ms.Contact(ms.Plane((1, 0, 0), -1e-3))


def rest(mesh, gravity, contacts, **given):
    shell = ms.Shell(mesh, SHEET)
    state = ms.DiscreteShell(shell).equilibrium(gravity=gravity, contacts=contacts, **given)
    return shell, state


@pytest.mark.by_default("origin0-floor", "origin1-floor and wall")
@pytest.mark.parametrize("contacts", [[FLOOR], [FLOOR, WALL]], ids=["floor", "floor and wall"])
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.0, 30.0, 0.0)])
def test_a_free_sheet_lies_on_a_floor_below_where_it_began(contacts, origin):
    mesh = ms.sheet(length=0.4, width=0.4, cells=(8, 8))
    mesh = ms.TriangleMesh(mesh.vertices + origin, mesh.faces)
    shell, state = rest(mesh, (0, 0, -9.81), contacts)
    assert state.converged
    assert state.stable
    assert state.in_contact.all()
    np.testing.assert_allclose(state.positions, mesh.vertices - [0, 0, 1e-3], atol=1e-12)
    np.testing.assert_allclose(state.contact_forces.sum(axis=0), [0, 0, 9.81 * shell.mass.sum()], atol=1e-9)


def test_an_arch_on_a_floor_spreads_about_its_middle():
    mesh = ms.cylinder_panel(length=0.4, radius=0.5, angle=60.0, cells=(8, 8))
    low = mesh.vertices[:, 2].min()
    shell, state = rest(mesh, (0, 0, -9.81), [ms.Contact(ms.Plane((0, 0, 1), low - 1e-3))])
    assert state.converged
    assert state.stable
    assert abs(state.contact_forces.sum(axis=0)[2] - 9.81 * shell.mass.sum()) < 1e-9
    moved = shell.mass @ (state.positions - mesh.vertices) / shell.mass.sum()
    assert np.abs(moved[:2]).max() < 1e-12
    assert np.abs(state.positions - mesh.vertices).max() > 2e-3


@pytest.mark.parametrize(("floor", "cells"), [("table", (4, 4)), ("field", (8, 4))])
def test_a_roof_rests_on_smooth_flat_faces_as_on_a_plane(floor, cells):
    """It may drift along them, so that the answer is no strict minimum: "did not settle" was said of it."""
    mesh = ms.v_beam(length=0.4, width=0.2, fold=120.0, cells=cells)
    low = mesh.vertices[:, 2].min()
    table, field = ms.Box((0.0, 0.0, low - 0.1), (1.0, 1.0, 0.1)), ms.HeightField(np.full((4, 4), low), 1, (-1, -1, 0))
    shell, state = rest(mesh, (0, 0, -9.81), [ms.Contact(table if floor == "table" else field)])
    assert state.converged
    assert state.stable
    exact = rest(mesh, (0, 0, -9.81), [ms.Contact(ms.Plane((0, 0, 1), low))])[1].positions
    assert ms.measure.displacement_error(state.positions, exact, shell) < 1e-6


@pytest.mark.by_default("off")
@pytest.mark.parametrize("gravity", [(-1.0, 0.5, -9.81), (0.0, 0.0, 9.81)], ids=["along", "off"])
def test_what_slides_or_flies_off_has_no_equilibrium(gravity):
    state = rest(ms.sheet(length=0.4, width=0.4, cells=(4, 4)), gravity, [FLOOR])[1]
    assert state.outcome is ms.Outcome.NO_EQUILIBRIUM
    assert "smooth planes" in state.message
    pressed = rest(ms.sheet(length=0.4, width=0.4, cells=(4, 4)), (-1.0, 0.0, -9.81), [FLOOR, WALL])[1]
    assert pressed.converged  # where a wall bears it
    assert pressed.contact_forces[:, 0].sum() > 0.0


def test_walls_that_a_spreading_arch_presses_on_are_not_left_out():
    mesh = ms.cylinder_panel(length=0.4, radius=0.5, angle=60.0, cells=(8, 8))
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    walls = [ms.Contact(ms.Plane((0, 1, 0), low[1] - 1e-4)), ms.Contact(ms.Plane((0, -1, 0), -high[1] - 1e-4))]
    state = rest(mesh, (0, 0, -9.81), [ms.Contact(ms.Plane((0, 0, 1), low[2])), *walls])[1]
    assert min(contact.distance(state.positions).min() for contact in walls) > -1e-9
    pressed = state.contact_forces[:, 1]
    assert state.converged
    assert abs(pressed.sum()) < 1e-6
    assert np.abs(pressed).sum() > 5.0
