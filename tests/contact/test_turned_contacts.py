"""Contacts in motion are the same in axes that are turned: no threshold is a share of the box about the shell.

Of colliders that turn it is their own surface that must not move far in a step.
"""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms

SOFT = ms.Isotropic(young=1e6, poisson=0.3, thickness=2e-3, density=400.0)


def turned_sheet(turn, *, clamped=False):
    """A sheet turned about the origin; ``clamped`` holds an end."""
    mesh = ms.sheet(length=0.3, width=0.2, cells=(6, 4))
    held = mesh.vertices[:, 0] < 1e-6 if clamped else None
    return ms.Shell(ms.TriangleMesh(mesh.vertices @ turn.T, mesh.faces), SOFT, clamped=held)


def swinging_onto_a_lifted_floor_and_a_ball(kind, turn):
    """Positions of a clamped sheet, turned back."""
    basis = ms.solve_modes(turned_sheet(turn, clamped=True), count=8)
    times, heights = np.array([0.0, 0.3, 0.6]), np.array([0.0, 0.02, -0.02])
    lift = ms.SupportPath(times, np.outer(heights, turn[:, 2]))
    contacts = [
        ms.Contact(ms.Plane(turn @ (0.1, 0.2, 1.0), -0.02), motion=lift),
        ms.Contact(ms.Sphere(turn @ (0.25, 0.02, -0.05), 0.03)),
    ]
    run = ms.simulate(kind(basis), duration=0.5, dt=1 / 60, gravity=turn @ (0, 0, -9.81), contacts=contacts)
    assert run.in_contact.any()
    return run.positions @ turn


@pytest.mark.by_default("RotationStrain")
@pytest.mark.parametrize("kind", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_modal_models_strike_moving_colliders_alike(kind):
    given = swinging_onto_a_lifted_floor_and_a_ball(kind, np.eye(3))
    for seed in range(1, 4):
        found = swinging_onto_a_lifted_floor_and_a_ball(kind, Rotation.random(random_state=seed).as_matrix())
        assert np.abs(found - given).max() <= 1e-7 * 0.3


@pytest.mark.by_default("modal")
@pytest.mark.parametrize("kind", ["full", "modal"])
def test_what_sticks_creeps_alike(kind):
    runs = []
    for angle in (0.0, 30.0):
        turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        shell = turned_sheet(turn)
        model = ms.DiscreteShell(shell) if kind == "full" else ms.ModalWarping(ms.solve_modes(shell, count=8))
        pull = turn @ Rotation.from_euler("y", 20.0, degrees=True).as_matrix() @ (0.0, 0.0, -9.81)
        floor = ms.Contact(ms.Plane(), friction=0.5)
        run = ms.simulate(model, duration=0.2, dt=1 / 60, gravity=pull, contacts=[floor])
        runs.append((run.positions @ turn, run.message))
    (given, said), (found, again) = runs
    assert np.ptp(given[:, 0, 0]) > 3e-4  # it creeps
    assert np.abs(found - given).max() <= 1e-12
    assert again == said


def struck_by(model, collider, spin, pivot, dt=0.005):
    """The motion of a strip that falls onto a collider, which turns about ``pivot`` by ``spin`` [rad/s]."""
    times = np.linspace(0.0, 1.0, 21)
    path = ms.SupportPath(times, np.zeros((21, 3)), np.outer(times, spin), pivot=pivot)
    ball = ms.Contact(collider, motion=path)
    return ms.simulate(model, duration=0.2, dt=dt, gravity=(0, 0, -9.81), damping=(5.0, 0.0), contacts=[ball])


def test_what_spins_about_its_own_axis_strikes_as_what_does_not():
    """Its surface moves by 6 mm in a step; what is 0.27 m from its axis, as the strip's far corners are, by 54 mm."""
    model = ms.DiscreteShell(turned_sheet(np.eye(3), clamped=True))
    center, half = np.array([0.25, 0.1, -0.04]), np.array([0.0, 0.2, 0.0])
    for collider in (ms.Sphere(center, 0.03), ms.Capsule(center - half, center + half, 0.03)):
        still, spun = (struck_by(model, collider, (0.0, spin, 0.0), center) for spin in (0.0, 40.0))
        assert still.in_contact.any()
        np.testing.assert_allclose(spun.positions, still.positions, atol=1e-11)
        np.testing.assert_allclose(spun.contact_forces, still.contact_forces, atol=1e-9)


def test_what_turns_too_far_is_refused_and_takes_the_step_that_is_named():
    """A bar that turns about one end moves by the other; two digits of the bound are not rounded up."""
    model = ms.DiscreteShell(turned_sheet(np.eye(3), clamped=True))
    end, reach = np.array([0.15, 0.1, -0.4]), np.array([0.25, 0.0, 0.0])
    bar = ms.Capsule(end, end + reach, 0.0086)
    with pytest.raises(ms.OptionError, match="more than its smallest radius") as refused:
        struck_by(model, bar, (0.0, 8.0, 0.0), end)
    named = float(re.search(r"at most (\S+) s$", str(refused.value))[1])
    assert 1e-3 < named < 0.005
    assert struck_by(model, bar, (0.0, 8.0, 0.0), end, named).status == "completed"
