"""The composite rule by itself: stability, its error, and steps of changing lengths, on one oscillator."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modalshell.integrators.full import SDIRK2, Composite
from modalshell.integrators.full.implicit_rule import EulerSteps

RULE = Composite()


class OscillatorSteps(EulerSteps):
    """Steps of implicit Euler of ``x'' = push - c x' - k x``."""

    def __init__(self, stiffness, damp=0.0, push=0.0):
        self.stiffness, self.damp, self.push = stiffness, damp, push

    def solve(self, start):
        h = start.dt
        given = start.origin / h**2 + start.rates / h + self.damp * start.origin / h + self.push
        return start.after(given / (1.0 / h**2 + self.damp / h + self.stiffness)), True

    def turn(self, coordinates, move):  # noqa: ARG002
        return 0.0


def marched(steps, lengths, x=0.0, v=0.0):
    state = RULE.at_rest(np.array([x]))
    state.rates = np.array([v])
    for dt in lengths:
        state, solved = RULE.march(steps, state, dt)
        assert solved
    return state


@given(st.floats(-3.0, 3.0), st.floats(0.0, 1.0))
def test_it_is_stable_in_the_left_half_plane(decades, share):
    size, angle = 10.0**decades, 0.5 * np.pi * (1.0 + share)
    assert abs(RULE.growth(size * np.exp(1j * angle))) <= 1.0 + 1e-9
    assert abs(RULE.growth(-1e9)) < 1e-4


def test_its_error_is_that_of_its_constant():
    for turn in (0.02, 0.01):
        error = (RULE.growth(1j * turn) - np.exp(1j * turn)) / (1j * turn) ** 3
        assert abs(error) == pytest.approx(RULE.error_constant, rel=turn)
    assert RULE.error_constant < SDIRK2.error_constant


@settings(max_examples=40)
@given(st.lists(st.sampled_from([0.1, 0.5, 0.9, 1.0, 1.5, 2.0, 5.0]), min_size=1, max_size=8))
def test_motions_of_second_degree_are_exact_in_steps_of_any_lengths(ratios):
    lengths = np.cumprod([0.1, *ratios])
    state, time = marched(OscillatorSteps(0.0, push=2.0), lengths, 1.0, -3.0), lengths.sum()
    assert state.coordinates[0] == pytest.approx(1.0 - 3.0 * time + time**2, rel=1e-9, abs=1e-9 * time**2)
    assert state.rates[0] == pytest.approx(2.0 * time - 3.0, rel=1e-9, abs=1e-9 * time)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.floats(-2.0, 5.0))
def test_steps_of_changing_lengths_do_not_feed_an_oscillation(seed, decades):
    ratios, lengths = np.random.default_rng(seed).choice([0.5, 1.0, 1.0, 2.0], 150), [1.0]
    for ratio in ratios:
        lengths.append(lengths[-1] * (ratio if 2.0**-5 <= lengths[-1] * ratio <= 1.0 else 1.0))
    stiffness = (10.0**decades) ** 2
    state = marched(OscillatorSteps(stiffness), lengths, 1.0)
    energy = state.rates[0] ** 2 + stiffness * state.coordinates[0] ** 2
    assert energy <= 3.0 * stiffness


def test_steps_of_changing_lengths_are_of_order_two():
    errors = []
    for count in (40, 80, 160):
        lengths = np.resize([1.0, 1.0, 0.5, 0.25, 0.5, 1.0], 6 * count)
        lengths *= 10.0 / lengths.sum()
        state = marched(OscillatorSteps(1.0, 0.1), lengths, 1.0)
        fast = np.sqrt(1.0 - 0.05**2)
        exact = np.exp(-0.5) * (np.cos(10.0 * fast) + 0.05 / fast * np.sin(10.0 * fast))
        errors.append(abs(state.coordinates[0] - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.15)
