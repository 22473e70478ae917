"""The model that switches itself under constraints: it moves and rests as DS does."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.motion.stepping import Motion

DT = 0.02
SHEET = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=300.0)


@pytest.fixture(scope="module")
def strip():
    return ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(8, 2)), SHEET, "x < 0.001")


def lifted(strip, path=None, height=0.03):
    """The middle of the free end, lifted and let down, on supports that move along a path."""
    tip = int(np.linalg.norm(strip.rest_positions - (1.0, 0.0, 0.0), axis=1).argmin())

    def target(time):
        z = height * np.sin(3.0 * time) ** 2
        point = strip.rest_positions[tip] + (-0.4 * z**2, 0.0, z)
        return point if path is None else path.at(time).to_world(point[None])[0]

    return [ms.PositionConstraint(tip, target)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["resting", "moving", "contact", "free"])
def test_it_moves_as_ds_does_and_resumes_to_the_same_bits(strip, kind):
    """Of a free sheet with contacts these were refused."""
    strip = ms.Shell(strip.mesh, SHEET) if kind == "free" else strip
    places = [(0, 0, 0), (0.02, 0.01, 0.03), (0, 0, 0)]
    path = ms.SupportPath([0.0, 0.5, 1.0], places) if kind == "moving" else None
    floor = [ms.Contact(ms.Plane((0, 0, 1), -0.02), friction=0.2)] if kind in ("contact", "free") else []
    setting = {"dt": DT, "damping": ms.Damping(2.0, 0.0), "supports": path, "constraints": lifted(strip, path)}
    load = strip.loading((0, 0, -5.0), None, None)
    motions = [Motion(model(strip), load, contacts=floor, **setting) for model in (ms.Auto, ms.DiscreteShell, ms.Auto)]
    auto, exact, resumed = motions
    moved, allowed = 0.0, 1e-7 if path is None else 0.02  # which steps in the frame of its supports
    for step in range(40):
        auto.advance(), exact.advance()
        moved = max(moved, np.abs(exact.positions() - strip.rest_positions).max())
        off = np.abs(auto.positions() - exact.positions()).max()
        assert off <= allowed * moved
        if step == 20:
            resumed.restore(auto.snapshot())
    while resumed.count < auto.count:
        resumed.advance()
    found = resumed.snapshot()
    assert all(np.array_equal(found[name], part) for name, part in auto.snapshot().items())
    assert "constraints lead it" in auto.model.account(auto.state)


@pytest.mark.parametrize("touches", [False, True])
def test_it_rests_as_ds_does(strip, touches):
    given = {"gravity": (0, 0, -5.0), "constraints": lifted(strip)}
    contacts = [ms.Contact(ms.Plane((0, 0, 1), -0.02))] if touches else None
    answer, exact = (kind(strip).equilibrium(**given, contacts=contacts) for kind in (ms.Auto, ms.DiscreteShell))
    assert np.array_equal(answer.positions, exact.positions)
    assert np.array_equal(answer.constraint_reactions, exact.constraint_reactions)


def test_it_refuses_self_contact_in_its_own_words(strip):
    """They were those of error bars."""
    with pytest.raises(ms.OptionError, match="self-contact is for DS with implicit steps alone"):
        ms.simulate(ms.Auto(strip), duration=0.1, contacts=[ms.SelfContact(gap=0.01)], constraints=lifted(strip))


@pytest.mark.parametrize("who", ["constraints", "supports"])
def test_it_says_that_vertices_are_led_through_a_collider(strip, who):
    led = {"supports": ms.SupportPath([0.0, 0.06], [(0, 0, 0), (0, 0, -0.05)])}
    if who == "constraints":
        led = {"constraints": [ms.PositionConstraint(26, lambda t: strip.rest_positions[26] - (0.0, 0.0, 0.5 * t))]}
    floor = [ms.Contact(ms.Plane((0, 0, 1), -0.02))]
    run = ms.simulate(ms.Auto(strip), duration=0.08, dt=DT, contacts=floor, **led)
    assert f"{who} lead vertices into contact 0" in run.message
