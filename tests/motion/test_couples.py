"""Free panels that a couple turns: their angular momentum is what the steps' own moments add up to."""

import numpy as np
import pytest

from modalshell.integrators.full.implicit_rule import Flight
from modalshell.motion import Motion
from studies import motion_limits
from studies.theory.oscillator import weights

GRAVITY = np.array([0.0, 0.0, -9.81])
SHARE = 1.0 - np.sqrt(0.5)
"""Length of the parts of SDIRK2 and of the composite rule over that of a step."""


def spin_of(shell, x, v):
    """Angular momentum (3,) about the centre."""
    centre, drift = (shell.mass @ part / shell.mass.sum() for part in (x, v))
    return np.cross(x - centre, v - drift).T @ shell.mass


def impulses(rule, stages, dt):
    """Impulses (k, 3) that moments (3,) of the stages of k steps add up to, by the rule's own recursion."""
    found, middle = [np.zeros(3)], None
    usual, last = weights()
    second = np.linalg.solve(np.vander([-1.0, 0.0, 0.5], increasing=True).T, [1.0, 1.0 - SHARE, 1.0 - 2.0 * SHARE])
    for taken in stages:
        length, moment = taken[-1]
        if rule == "bdf2" and len(taken) == 1:
            assert np.isclose(length, 2.0 / 3.0 * dt)
            found.append((4.0 * found[-1] - found[-2]) / 3.0 + length * moment)
        elif len(found) == 1 or rule == "bdf2":  # by SDIRK2, after the two half steps of a start
            assert np.isclose(length, SHARE * dt)
            found.append(found[-1] + dt * ((1.0 - SHARE) * taken[-2][1] + SHARE * moment))
        else:
            assert len(taken) == 2
            assert np.isclose(taken[0][0], (0.375 if middle is None else SHARE) * dt)
            assert np.isclose(length, SHARE * dt)
            known = np.array(found[-2:] if middle is None else [found[-2], middle, found[-1]])
            first, end = ([-0.125, 1.125], second) if middle is None else (usual, last)
            middle = first @ known + taken[0][0] * taken[0][1]
            found.append(end @ [*known, middle] + length * moment)
    return np.array(found[1:])


@pytest.mark.by_default("coarse DS-bdf2")
@pytest.mark.parametrize(
    ("rung", "rule"),
    [
        ("DS", "composite"),
        ("coarse DS", "bdf2"),
        ("MD-ROM", "bdf2"),
        pytest.param("hybrid", "bdf2", marks=pytest.mark.slow),
    ],
)
@pytest.mark.filterwarnings("ignore::modalshell.ModalShellWarning")
def test_angular_momentum_is_the_impulse_of_the_steps_own_moments(rung, rule, monkeypatch):
    shell = motion_limits.panel()
    force, dt, stages = motion_limits.couple(shell), 0.01, []
    model = motion_limits.free_rungs(shell)[rung]()
    solve = Flight.solve

    def watched(self, start):
        after, solved = solve(self, start)
        moment = self._free.wrenches(after.coordinates, self._euler.load_on(after.coordinates))[0, 1]
        stages[-1].append((start.dt, moment))
        return after, solved

    monkeypatch.setattr(Flight, "solve", watched)
    run, spins = Motion(model, shell.loading(GRAVITY, force), dt=dt), []
    for _ in range(50):
        stages.append([])
        run.advance()
        x = run.positions()
        spins.append(spin_of(shell, x, run.model.velocities(run.state, x, 1e-6 * dt)))
    given, spins = impulses(rule, stages, dt), np.array(spins)
    assert np.linalg.norm(spins[-1]) > 0.5
    np.testing.assert_allclose(spins, given, rtol=0, atol=1e-6 * np.linalg.norm(spins[-1]))


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["LMA", "MWTS", "RSW", "DS", "coarse DS", "MD-ROM"])
def test_the_steps_quadrature_of_a_couple_is_of_second_order(rung):
    """Against the moments at the frames, whose trapezoidal sum is of second order itself."""
    shell = motion_limits.panel()
    force, off = motion_limits.couple(shell), []
    for dt in (0.01, 0.005):
        run = Motion(motion_limits.free_rungs(shell)[rung](), shell.loading(GRAVITY, force), dt=dt)
        moments, spin = [], np.zeros(3)
        for count in range(round(0.5 / dt) + 1):
            if count:
                run.advance()
            x = run.positions()
            moments.append(np.cross(x - shell.mass @ x / shell.mass.sum(), force).sum(axis=0))
            spin = spin_of(shell, x, run.model.velocities(run.state, x, 1e-6 * dt))
        off.append(np.linalg.norm(spin - np.trapezoid(moments, dx=dt, axis=0)) / np.linalg.norm(spin))
    assert off[0] < 5e-4
    assert off[1] < 0.4 * off[0]
