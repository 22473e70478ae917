"""Statics of ``auto`` with contacts: a modal answer where its bar is small, that of DS elsewhere."""

import pytest

import modalshell as ms

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    return ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0), clamped="x < 1e-6")


@pytest.mark.parametrize(("error", "name"), [(0.1, "MWTS"), (1e-3, "DS")])
def test_auto_rests_on_a_table_within_its_error(shell, error, name):
    truth = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    model = ms.Auto(shell, error=error)
    state = model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert state.converged
    assert state.message.startswith(name)
    assert ms.measure.displacement_error(state.positions, truth.positions, shell) <= error
    assert state.contact_forces[:, 2].sum() == pytest.approx(truth.contact_forces[:, 2].sum(), rel=0.02)
    assert state.iterations <= 10 < truth.iterations
    live = model.equilibrium(loads=[ms.Pressure(-6.0)], contacts=[FLOOR], bar=True)
    assert live.bar.displacement <= error


def test_auto_leaves_what_pushes_out_to_discrete_shells_and_moves_without_contacts(shell):
    model, wall = ms.Auto(shell), ms.Contact(ms.Plane((0, 0, 1), 0.02), sel="x > 0.5", push_out=1.0)
    state = model.equilibrium(contacts=[wall])
    assert state.converged
    assert state.positions[shell.mesh.vertices[:, 0] > 0.5, 2].min() >= 0.02 - 1e-9
    with pytest.raises(ms.OptionError, match="auto takes contacts in equilibrium alone"):
        ms.simulate(model, duration=0.1, gravity=GRAVITY, contacts=[FLOOR])
    hold = ms.PositionConstraint([shell.mesh.vertices[:, 0].argmax()], (1.0, 0.0, 0.5))
    with pytest.raises(ms.OptionError, match="takes no position or orientation constraints"):
        model.equilibrium(contacts=[FLOOR], constraints=[hold])
