"""Ways downhill in steps in time that Newton's method does not solve."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact import steps
from modalshell.contact.descent import _Way, descend
from modalshell.core.outcome import Outcome


def on_a_rising_ball():
    mesh = ms.sheet(length=0.3, width=0.3, cells=(6, 6))
    cloth = ms.Shell(mesh, ms.Material(200.0, 200.0, 1e-5, 0.1), "x < 0.001")
    rise = ms.SupportPath([0.0, 0.5], [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    ball = ms.Contact(ms.Sphere((0.2, 0.0, -0.06), 0.05), motion=rise)
    return ms.simulate(ms.DiscreteShell(cloth), duration=0.25, dt=1 / 60, gravity=(0, 0, -9.81), contacts=[ball])


@pytest.mark.slow
def test_a_way_that_begins_inside_a_moving_ball_takes_solved_steps_alone(monkeypatch):
    """The potential is infinite there: a step that fails is no lower."""
    taken, flow = [], _Way._flow

    def watched(self):
        went = flow(self)
        taken.append((went, self.value))
        return went

    monkeypatch.setattr(_Way, "_flow", watched)
    monkeypatch.setattr(steps, "_SINGLES", 0)
    run = on_a_rising_ball()
    assert run.outcome is Outcome.COMPLETED
    assert taken
    assert all(np.isfinite(value) for went, value in taken if went)


@pytest.mark.slow
def test_steps_of_a_limp_cloth_go_down_by_single_steps_at_once(monkeypatch):
    """They failed in the fluid first, and tried to end where only the ball pushed."""
    counts = []

    def counted(*given, **how):
        rest = descend(*given, **how)
        counts.append((rest.iterations, rest.converged))
        return rest

    monkeypatch.setattr(steps, "descend", counted)
    assert on_a_rising_ball().outcome is Outcome.COMPLETED
    assert all(converged for _, converged in counts)
    assert sum(iterations for iterations, _ in counts) < 150  # 175
