"""Paths of equilibria with contacts: against statics, the path without contacts, and arches that a stop holds back."""

import numpy as np
import pytest

import modalshell as ms

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))
SHEET = {"young": 1e8, "poisson": 0.3, "thickness": 5e-3, "density": 100.0}
LOADS = {"gravity": (0.0, 0.0, -100.0), "steps": 20, "control": "load"}


@pytest.fixture(scope="module")
def strip():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 2))
    return ms.Shell(mesh, ms.Isotropic(**SHEET), clamped="x < 1e-6")


@pytest.fixture(scope="module")
def arch():
    """A shallow arch, clamped at both ends, that buckles to one side under its weight."""
    flat = ms.flat_beam(length=1.0, width=0.1, cells=(16, 2))
    x, y, _ = flat.vertices.T
    mesh = ms.TriangleMesh(np.stack([x, y, 0.06 * np.sin(np.pi * x)], axis=1), flat.faces)
    return ms.Shell(mesh, ms.Isotropic(**SHEET), clamped="x < 1e-6 or x > 1 - 1e-6")


@pytest.fixture(scope="module")
def free_path(arch):
    return ms.equilibrium_path(arch, **LOADS)


def uneven(shell):
    """A small force on a quarter of the arch."""
    force = np.zeros_like(shell.rest_positions)
    force[np.abs(shell.rest_positions[:, 0] - 0.25) < 0.01, 2] = -0.05
    return force


@pytest.mark.slow
def test_a_strip_comes_down_on_a_table(strip):
    path = ms.equilibrium_path(strip, gravity=GRAVITY, control="load", contacts=[FLOOR])
    truth = ms.DiscreteShell(strip).equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert path.converged
    assert path.stable.all()
    assert path.events == []
    assert not path.in_contact[0].any()
    assert np.array_equal(path.in_contact[-1], truth.in_contact)
    np.testing.assert_allclose(path.positions[-1], truth.positions, atol=1e-9)
    np.testing.assert_allclose(path.contact_forces[-1], truth.contact_forces, atol=1e-7)
    assert path.positions[..., 2].min() >= -0.15 - 1e-9
    middle = int(np.argmin(np.abs(path.factors - 0.5)))
    half = ms.DiscreteShell(strip).equilibrium(gravity=(0, 0, -9.81 * path.factors[middle]), contacts=[FLOOR])
    np.testing.assert_allclose(path.positions[middle], half.positions, atol=1e-8)


@pytest.mark.slow
def test_it_is_lifted_off_again(strip):
    down = ms.equilibrium_path(strip, gravity=GRAVITY, control="load", contacts=[FLOOR])
    begin = {"begin": 1.0, "until": 0.1, "start": down.positions[-1]}
    up = ms.equilibrium_path(strip, gravity=GRAVITY, control="load", contacts=[FLOOR], **begin)
    assert up.converged
    assert up.in_contact[0].any()
    assert not up.in_contact[-1].any()
    free = ms.DiscreteShell(strip).equilibrium(gravity=(0, 0, -0.981))
    np.testing.assert_allclose(up.positions[-1], free.positions, atol=1e-8)


def test_contacts_that_are_far_leave_the_path_and_its_bifurcation(arch, free_path):
    free = free_path
    far = ms.equilibrium_path(arch, contacts=[ms.Contact(ms.Plane((0, 0, 1), -9.0))], **LOADS)
    (event,), (wanted,) = far.events, free.events
    assert event.kind == wanted.kind == "bifurcation"
    assert event.factor == pytest.approx(wanted.factor, abs=1e-5)
    assert far.stable[: event.index].all()
    assert not far.stable[event.index + 1 :].any()


FAR = [ms.Contact(ms.Plane((0, 0, -1), -1.0))]


@pytest.mark.slow
@pytest.mark.parametrize(("contacts", "beyond"), [(None, 1e-6), (FAR, 1e-4)], ids=["free", "contacts far"])
def test_little_beyond_its_bifurcation_the_arch_leaves_the_saddle(arch, free_path, contacts, beyond):
    """The potential falls from there by a small part of itself, which rounding must not take for none."""
    gravity = (0.0, 0.0, -100.0 * (1.0 + beyond) * free_path.events[0].factor)
    state = ms.DiscreteShell(arch).equilibrium(gravity=gravity, contacts=contacts)
    assert state.converged
    assert state.stable
    assert state.positions[:, 2].max() < 0.02  # snapped


PUNCHES = {
    "plane": (lambda depth: ms.Plane((0, 0, -1), depth - 0.06), (0.0, 0.0125, 0.02, 0.0225, 0.025)),
    "sphere": (lambda depth: ms.Sphere((0.5, 0.0, 0.16 - depth), 0.1), (0.0, 0.0125, 0.015, 0.0175)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", PUNCHES)
def test_a_pressed_arch_buckles_under_the_punch(kind):
    """On the way the shell lies at saddles next to others, where what nearly touches is in the way."""
    flat = ms.flat_beam(length=1.0, width=0.1, cells=(32, 2))
    x, y, _ = flat.vertices.T
    mesh = ms.TriangleMesh(np.stack([x, y, 0.06 * np.sin(np.pi * x)], axis=1), flat.faces)
    model = ms.DiscreteShell(ms.Shell(mesh, ms.Isotropic(**SHEET), clamped="x < 1e-6 or x > 1 - 1e-6"))
    body, depths = PUNCHES[kind]
    start, presses = None, []
    for depth in depths:
        state = model.equilibrium(contacts=[ms.Contact(body(depth), push_out=1.0)], start=start)
        assert state.converged, (depth, state.message)
        assert state.stable
        start = state.positions
        presses.append(-float(state.contact_forces[:, 2].sum()))
    assert presses[-2] > presses[-1] > 0.0  # it gives way


def test_a_stop_above_a_quarter_holds_an_arch_that_would_snap(arch):
    force = uneven(arch)
    free = ms.equilibrium_path(arch, force=force, **LOADS | {"contacts": [ms.Contact(ms.Plane((0, 0, 1), -9.0))]})
    assert not free.converged
    assert "load steps with contacts end at a load factor of" in free.message
    limit = ms.equilibrium_path(arch, force=force, **LOADS | {"control": "arc"}).events[0]
    assert limit.kind == "limit"
    assert free.factors[-1] == pytest.approx(limit.factor, rel=1e-3)
    rod = ms.Contact(
        ms.Cylinder((0.75, -1, 0.06 * np.sin(np.pi / 4) + 0.051), (0.75, 1, 0.06 * np.sin(np.pi / 4) + 0.051), 0.05)
    )
    held = ms.equilibrium_path(arch, force=force, contacts=[rod], **LOADS)
    assert held.in_contact.any()
    end = held.factors[held.stable].max()
    assert end > 1.02 * free.factors[-1]
    last = int(np.flatnonzero(held.stable)[-1])
    load = {"gravity": (0, 0, -100.0 * held.factors[last]), "force": held.factors[last] * force}
    state = ms.DiscreteShell(arch).equilibrium(contacts=[rod], start=held.positions[last], **load)
    np.testing.assert_allclose(state.positions, held.positions[last], atol=1e-7)


def test_paths_that_cannot_be_are_refused_by_name(strip):
    given = {"gravity": GRAVITY, "contacts": [FLOOR]}
    with pytest.raises(ms.OptionError, match=r'followed by load steps, without branches .* give control="load"'):
        ms.equilibrium_path(strip, **given)
    with pytest.raises(ms.OptionError, match="followed by load steps, without branches"):
        ms.equilibrium_path(strip, control="load", branches=1, **given)
    with pytest.raises(ms.OptionError, match="paths with contacts are followed by models of all vertices alone"):
        ms.equilibrium_path(ms.RotationStrain(ms.solve_modes(strip, 4)), control="load", **given)
    rough = ms.Contact(FLOOR.collider, friction=0.3)
    with pytest.raises(ms.OptionError, match="paths take contacts without friction"):
        ms.equilibrium_path(strip, gravity=GRAVITY, control="load", contacts=[rough])
    held = ms.Contact(FLOOR.collider, sel=np.flatnonzero(strip.clamped)[:1])
    with pytest.raises(ms.OptionError, match="sel must name a vertex that supports do not hold"):
        ms.equilibrium_path(strip, gravity=GRAVITY, control="load", contacts=[held])
    with pytest.raises(ms.OptionError, match="inside contact 0"):
        ms.equilibrium_path(strip, gravity=GRAVITY, control="load", contacts=[ms.Contact(ms.Plane((0, 0, 1), 0.1))])
