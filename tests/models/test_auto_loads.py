"""The model that switches itself under dead loads that are changed between steps, and motions that go back."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.loads import Loading
from modalshell.models.auto.at_rest import AtRest
from modalshell.models.auto.loads_ahead import LoadsAhead
from modalshell.models.base.buckling_range import BucklingRange
from modalshell.models.reduction.poisson import PoissonFit
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.motion.stepping import Motion

DT = 1.0 / 60.0


@pytest.fixture(scope="module")
def beam():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    return ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")


def swung(beam, model, steps, push):
    """A motion under the beam's weight, and positions after steps under this and a push along the beam as well."""
    weight = beam.mass[:, None] * np.array([0.0, 2.6, -9.7])
    motion = Motion(model, Loading(beam.rest_positions, weight), dt=DT, damping=(2.0, 0.001))
    for _ in range(steps):
        motion.advance()
    snapshot = {name: array.copy() for name, array in motion.snapshot().items()}
    motion.load = weight + beam.mass[:, None] * np.array([-push, 0.0, 0.0])
    return motion, snapshot


def advanced(motion, steps):
    return np.array([(motion.advance(), motion.positions())[1] for _ in range(steps)])


@pytest.mark.slow
def test_a_dead_load_that_turns_is_looked_at(beam):
    """The push alone hardly moves the beam, so that no linear answer grows; but with the weight it buckles.

    What differs grows eightfold in the buckling itself, which steps of a frame do not resolve: DS is a fifth off there.
    """
    runs = [advanced(swung(beam, model, 60, 400.0)[0], 18) for model in (ms.Auto(beam, 6), ms.DiscreteShell(beam))]
    gaps, moves = runs[0] - runs[1], runs[1] - beam.rest_positions
    off, moved = (np.sqrt(np.sum(beam.mass[:, None] * part**2, axis=(1, 2))) for part in (gaps, moves))
    assert moved.max() > 0.3 * np.sqrt(beam.mass.sum())
    assert off.max() < 0.05 * moved.max()


def test_another_dead_load_ends_what_is_known(beam):
    motion, _ = swung(beam, ms.Auto(beam, 6, error=0.1), 60, 0.0)
    assert motion.state.memory["known"].any()
    motion.load = 1.1 * motion.load
    fitted = motion.state.memory.copy()
    motion.stepper._watch.fit(fitted, motion.load)
    assert not fitted["known"].any()
    assert motion.state.memory["known"].any()  # the state that was given stays


def test_a_motion_that_goes_back_to_a_snapshot_goes_on_with_the_same_bits(beam):
    """The load of later steps had been seen to be calm, so that it was not looked at again."""
    motion, snapshot = swung(beam, ms.Auto(beam, 6), 60, 0.0)
    motion.load = 4.5 * motion.load
    first = advanced(motion, 25)
    motion.restore(snapshot)
    assert np.array_equal(advanced(motion, 25), first)


def test_what_the_cheapest_rung_does_not_want_is_not_made(beam, monkeypatch):
    """No fit of RSW, and one factor of the stiffness at rest for the modes and for the linear answers."""
    factors, found = [], RigidFreeSolver.__init__
    monkeypatch.setattr(PoissonFit, "__init__", None)
    monkeypatch.setattr(RigidFreeSolver, "__init__", lambda *given: (factors.append(1), found(*given))[1])
    auto = ms.Auto(beam, 6)
    run = ms.simulate(auto, duration=0.2, dt=DT, gravity=(0.0, 0.26, -0.97))
    assert set(run.levels) == {"MWTS"}
    assert len(factors) == 1
    assert auto.equilibrium(gravity=(0.0, 0.026, -0.097)).message.startswith("MWTS")


def counted(monkeypatch, owner, name):
    """How often a method is called, in a list of one number."""
    calls, found = [0], getattr(owner, name)

    def called(self, *given):
        calls[0] += 1
        return found(self, *given)

    monkeypatch.setattr(owner, name, called)
    return calls


def test_a_load_that_stays_is_compared_with_its_linear_answer_at_once(beam, monkeypatch):
    """Rounding took these for less than is to come, and compared them in each frame.

    Nor does anybody ask whether what is looked at is beyond the buckling load.
    """
    auto, weights = ms.Auto(beam, 6), np.linspace(0.05, 0.5, 8)[2:5]
    compared = counted(monkeypatch, LoadsAhead, "answer")
    monkeypatch.setattr(BucklingRange, "remark", None)
    for weight in weights:
        load = ms.Scaled(ms.SelfWeight((0.0, 0.26, -0.97)), ([0.0, 1.0], [weight, weight]))
        assert set(ms.simulate(auto, duration=0.1, dt=DT, loads=[load]).levels) == {"MWTS"}
    assert compared[0] == 2 * len(weights)


def test_gusts_among_known_states_are_not_looked_at(beam, monkeypatch):
    """Each of two doubles many times as it rises."""
    looked = counted(monkeypatch, AtRest, "of")

    def wind(points, time):
        return np.broadcast_to(np.array([0.3, 0.0, -1.0]) * np.sin(np.pi * time / 0.8) ** 2, points.shape)

    run = ms.simulate(ms.Auto(beam, 6), duration=1.6, dt=DT, loads=[ms.Wind(wind)], damping=(2.0, 0.001))
    assert set(run.levels) == {"MWTS"}
    assert 0 < looked[0] < 9
