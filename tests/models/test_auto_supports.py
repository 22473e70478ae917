"""The model that switches itself on supports that move: in their frame, within the error asked for, checked seldom."""

import re

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.auto.loads_ahead import LedSupports
from modalshell.models.auto.watching import Watch
from modalshell.motion.stepping import Motion

DT = 1.0 / 60.0
SHEET = ms.Isotropic(young=5e8, poisson=0.3, thickness=6e-3, density=300.0)
TIMES = [0.0, 0.3, 0.6, 0.9, 1.2]
MOVED = np.array([(0, 0, 0), (0, 0.02, 0.05), (0.04, 0, -0.04), (0, -0.03, 0.03), (0, 0, 0)])
TURNED = np.array([(0, 0, 0), (0, 0.1, 0), (0.1, 0.05, 0.1), (0, -0.1, 0), (0, 0, 0)])


@pytest.fixture(scope="module")
def strip():
    return ms.Shell(ms.flat_beam(length=1.0, width=0.25, cells=(10, 2)), SHEET, "x < 0.11")


def seen_from(path, run):
    """Positions of a run in the frame of the supports."""
    return np.stack([path.at(float(time)).to_shell(x) for time, x in zip(run.times, run.positions, strict=True)])


def worst(shell, path, run, exact):
    """Largest distance of two runs in the norm of the mass, over the largest displacement in the frame."""
    own, true = seen_from(path, run), seen_from(path, exact)
    off, moved = (
        np.sqrt(np.sum(shell.mass[:, None] * part**2, axis=(1, 2)))
        for part in (own - true, true - shell.rest_positions)
    )
    return off.max() / moved.max()


@pytest.mark.slow
@pytest.mark.parametrize("turned", [None, TURNED], ids=["moved", "turned"])
def test_it_follows_ds_wherever_the_scene_stands(strip, turned):
    setting = {"duration": 1.2, "dt": DT, "gravity": (0.0, 0.0, -3.0), "damping": (1.0, 0.001)}
    near, far = (ms.SupportPath(TIMES, MOVED + shift, turned) for shift in ((0, 0, 0), (30.0, -20.0, 10.0)))
    run, shifted = (ms.simulate(ms.Auto(strip), supports=path, **setting) for path in (near, far))
    assert worst(strip, near, run, ms.simulate(ms.DiscreteShell(strip), supports=near, **setting)) < 0.05
    assert re.search(r"steps by MWTS [4-9]\d %", run.message)
    np.testing.assert_allclose(seen_from(far, shifted), seen_from(near, run), atol=1e-9)


@pytest.mark.slow
def test_it_is_checked_as_seldom_as_under_the_weight_that_is_felt_there(strip, monkeypatch):
    counts, checked = [], Watch.checked

    def counted(self, step, memory):
        counts[-1] += 1
        return checked(self, step, memory)

    monkeypatch.setattr(Watch, "checked", counted)
    times = np.arange(0.0, 8.0, DT)
    path = ms.SupportPath(times, np.outer(0.004 * (1.0 - np.cos(8.0 * times)), (0, 0, 1.0)))
    felt = [-path.at(float(time)).acceleration[2] for time in times]
    weight = ms.Scaled(ms.SelfWeight((0.0, 0.0, 1.0)), (times.tolist(), felt))
    runs = []
    for moving in ({"supports": path}, {"loads": [weight]}):
        counts.append(0)
        runs.append(ms.simulate(ms.Auto(strip), duration=7.8, dt=DT, damping=(1.0, 0.0), **moving))
    assert all("MWTS 100 %" in run.message for run in runs)
    own, exact = seen_from(path, runs[0]) - strip.rest_positions, runs[1].positions - strip.rest_positions
    assert np.abs(own - exact).max() < 2e-3 * np.abs(exact).max()
    assert max(counts) <= 10  # in some 470 steps; the largest weight is known beforehand


@pytest.mark.slow
def test_a_motion_on_moving_supports_resumes_to_the_same_bits(strip):
    path = ms.SupportPath(TIMES, MOVED, TURNED)
    whole, resumed = (
        Motion(ms.Auto(strip), strip.loading((0, 0, -3.0), None, []), dt=DT, supports=path) for _ in range(2)
    )
    for step in range(60):
        whole.advance()
        if step == 25:
            resumed.restore(whole.snapshot())
    while resumed.count < whole.count:
        resumed.advance()
    np.testing.assert_array_equal(whole.state.coordinates, resumed.state.coordinates)
    assert whole.model.account(whole.state) == resumed.model.account(resumed.state)


@pytest.mark.slow
def test_contacts_are_met_from_supports_that_move(strip):
    path = ms.SupportPath(TIMES, 0.5 * np.abs(MOVED), 0.3 * TURNED)
    setting = {"duration": 1.2, "dt": DT, "gravity": (0.0, 0.0, -8.0), "damping": (1.0, 0.001), "supports": path}
    table = [ms.Contact(ms.Plane((0, 0, 1), -0.05), sel="x > 0.2")]
    run, exact = (ms.simulate(make(strip), contacts=table, **setting) for make in (ms.Auto, ms.DiscreteShell))
    assert run.in_contact.any()
    assert run.positions[:, strip.rest_positions[:, 0] > 0.2, 2].min() > -0.05 - 1e-9
    assert worst(strip, path, run, exact) < 0.05


def test_numbers_of_a_path_are_those_of_what_moves():
    moved, turned = (LedSupports(ms.SupportPath(TIMES, MOVED, turns)) for turns in (None, TURNED))
    assert (moved.count, turned.count) == (3, 18)
    looked = np.array([turned.values(time) for time in np.linspace(0.0, 1.2, 200)])
    for part in (slice(3), slice(3, 6), slice(6, 9), slice(9, 18)):
        assert np.linalg.norm(looked[:, part], axis=1).max() == pytest.approx(1.0, abs=0.05)
    assert not np.any(turned.values(2.0)[:9])  # it rests there, back where it was
