"""Surfaces that lie almost in one another: of a vertex inside both the deeper one binds, and nothing enters either."""

import numpy as np
import pytest

import modalshell as ms

FLOOR = ms.Plane((0, 0, 1), 0.0)
PAIRS = {
    "floor above": [ms.Plane((0, 0, 1), -1e-4), FLOOR],
    "floor below": [FLOOR, ms.Plane((0, 0, 1), -1e-4)],
    "tilted": [ms.Plane((1e-4, 0, 1), -1e-4), FLOOR],
    "height field": [ms.HeightField(np.full((5, 5), -1e-4), 0.2, (-0.2, -0.4, 0.0)), FLOOR],
    "ball below": [ms.Sphere((0.15, 0.0, -0.1), 0.0999), FLOOR],
    "tangent ball": [FLOOR, ms.Sphere((0.15, 0.0, -0.1), 0.1)],
    "table on a floor": [ms.Plane((0, 0, 1), -1e-3), ms.Box((0.15, 0.0, -0.1), (0.2, 0.2, 0.1))],
}


def sheet(material, *, held):
    mesh = ms.sheet(length=0.3, width=0.3, cells=(6, 6))
    mesh = ms.TriangleMesh(mesh.vertices + np.array([0.0, 0.0, 5e-3]), mesh.faces)
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6 if held else None)


def deepest(bodies, positions):
    points = positions.reshape(-1, 3)
    return -min(float(body.distance(points).min()) for body in bodies)


@pytest.mark.by_default("floor above")
@pytest.mark.parametrize("name", PAIRS)
def test_ds_enters_neither_at_rest_nor_in_motion(name):
    shell = sheet(ms.Isotropic(young=5e7, poisson=0.3, thickness=2e-3, density=1e3), held=True)
    model, contacts = ms.DiscreteShell(shell), [ms.Contact(body) for body in PAIRS[name]]
    state = model.equilibrium(gravity=(0, 0, -9.81), contacts=contacts)
    assert state.stable
    assert state.in_contact.any()
    assert deepest(PAIRS[name], state.positions) < 1e-12
    run = ms.simulate(model, duration=0.2, dt=1 / 60, gravity=(0, 0, -9.81), damping=(1.0, 1e-4), contacts=contacts)
    assert run.outcome is ms.Outcome.COMPLETED
    assert run.in_contact.any()
    assert deepest(PAIRS[name], run.positions) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["explicit", "verlet"])
@pytest.mark.parametrize("name", ["floor above", "floor below", "tangent ball"])
def test_explicit_steps_put_out_what_is_in_both(name, integrator):
    model = ms.DiscreteShell(sheet(ms.Material(50.0, 50.0, 1e-4, 0.2), held=False), integrator=integrator)
    dt = 0.5 * model.stable_step()
    contacts = [ms.Contact(body) for body in PAIRS[name]]
    run = ms.simulate(
        model, duration=0.06, dt=dt, gravity=(0, 0, -9.81), contacts=contacts, store_every=max(1, round(2e-3 / dt))
    )
    assert run.in_contact.any()
    assert deepest(PAIRS[name], run.positions) < 1e-12
