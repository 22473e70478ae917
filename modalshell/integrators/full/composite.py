"""A composite rule of order two, of two solves a step, which goes on from the step before (theory 12, eq. 9)."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart, EulerSteps
from modalshell.integrators.full.second_order import GAMMA, VIOLENT, SecondOrderRule, two_parts
from modalshell.integrators.state import MotionState

EARLIER: Final = -0.035
"""Weight in a step's end of where the step before began: from -0.03 down the rule is A-stable, and the nearer to that,
the less it damps."""
_GROWS: Final = 2.0
"""Most that a step may be longer than the one before, to go on from it."""


@lru_cache(maxsize=64)
def _weights(ratio: float, *, middle: bool = True) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    """Length of the first part over the step, and weights of the states that both parts begin at a combination of.

    These are where the step before began, its ``middle`` if that is known, its end, and of the second part the new
    middle; ``ratio`` is the step over the one before. Each part is exact for motions of second degree. Where the middle
    is not known, the first part is a step of BDF2.
    """
    begin, before = -1.0 / ratio, -0.5 / ratio
    if middle:
        first = _exact([begin, before, 0.0], 0.5, GAMMA)
        given = EARLIER * min(1.0, ratio**2)  # far from where a much longer step began
        return GAMMA, first, (given, *_exact([before, 0.0, 0.5], 1.0, GAMMA, (given, begin)))
    earlier, length = 0.25 * ratio**2 / (1.0 + ratio), 0.25 * (2.0 + ratio) / (1.0 + ratio)
    return length, (-earlier, 1.0 + earlier), _exact([begin, 0.0, 0.5], 1.0, GAMMA)


def _exact(times: list[float], end: float, length: float, given: tuple[float, float] = (0.0, 0.0)) -> tuple[float, ...]:
    """Weights of states at three ``times``, with a ``given`` weight and its time, for a part that ends at ``end``."""
    weight, time = given
    moments = np.array([1.0, end - length, end**2 - 2.0 * length * end]) - weight * time ** np.arange(3.0)
    return tuple(np.linalg.solve(np.vander(times, increasing=True).T, moments).tolist())


def _error_constant() -> float:
    """Error of a step over ``h^3 v''``, of a motion whose third derivative stays."""
    _, first, second = _weights(1.0)
    third = [-1.0, -0.125, 0.0, 0.125]
    left = [
        (float(np.dot(weights, third[: len(weights)])) + 3.0 * GAMMA * end**2 - end**3) / 6.0
        for end, weights in ((0.5, first), (1.0, second))
    ]
    # Errors of the step and of its middle that go on unchanged from step to step: both parts for the two of them.
    middle, step = first[1], first[0] + first[1]
    system = [[1.0 - middle, step], [-second[1] - second[3], 1.0 + second[0] + second[1]]]
    return float(np.linalg.solve(system, left)[1])


@final
class Composite(SecondOrderRule, key="composite"):
    r"""Two steps of implicit Euler of :math:`\gamma h`, :math:`\gamma = 1 - 1 / \sqrt 2`, from combinations of states.

    The first ends in the middle of the step, and begins at the combination of the last three states (where the step
    before began, its middle, its end) that makes it exact for motions of second degree. The second ends with the step,
    and begins at a combination of these and of the new middle. So both ends are of order two, where the first part of
    :class:`SDIRK2` is of order one: a sheet much stiffer than steps resolve keeps its speed as it swings about a line
    of supports.

    Order two, at two solves a step. L-stable: stiff motion dies at once. A damping ratio from 0.01 to 0.1 is within
    1 % from 20 steps a period on. It begins with a step of SDIRK2, or with two half steps of implicit Euler where the
    motion is violent, which stand in for it there later, too; a step of SDIRK2 follows them.
    """

    name = "composite"
    stand_ins = 2
    error_constant = _error_constant()

    def growth(self, rate: complex) -> complex:
        """The root of largest modulus of the rule's three."""
        first, second = map(np.array, _weights(1.0)[1:])
        solved = 1.0 / (1.0 - GAMMA * rate)
        middle = first * solved
        end = (second[:3] + second[3] * middle) * solved
        roots = np.linalg.eigvals(np.array([[0.0, 0.0, 1.0], middle, end]))
        return complex(roots[np.argmax(np.abs(roots))])

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest, with room for what is kept of a step and its middle."""
        state = super().at_rest(coordinates)
        return MotionState(state.coordinates, state.rates, state.memory | no_middle(coordinates))

    def further(self, end: MotionState, after: MotionState) -> dict[str, Array]:
        """Changes of coordinates and rates since the middle of the step, where that is known."""
        if "middle_at" not in end.memory:
            return no_middle(after.coordinates)
        move, gain = after.coordinates - end.memory["middle_at"], after.rates - end.memory["middle_rates"]
        return {"middle_move": move, "middle_gain": gain, "middle": np.ones(1)}

    def go_on(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """Two solves, those of SDIRK2 after a much shorter step, and after implicit Euler, which has no middle."""
        ratio = dt / state.memory["step"][0]
        if ratio > _GROWS or state.memory["order"][0] == 1.0:
            return two_parts(euler, state, dt, ratio * state.memory["gain"])
        return _both_parts(euler, state, dt, ratio)


def _both_parts(euler: EulerSteps, state: MotionState, dt: float, ratio: float) -> tuple[MotionState, bool]:
    """Both parts of a step of ``dt`` [s], ``ratio`` times the one before; not solved where the motion is violent."""
    x, v, memory = state.coordinates, state.rates, state.memory
    gain = ratio * memory["gain"]
    if euler.turn(x, dt * gain) > VIOLENT:
        return state, False
    known = "middle" in memory and bool(memory["middle"][0])
    length, first, second = _weights(ratio, middle=known)
    states = [MotionState(x - memory["move"], v - memory["gain"]), state]
    times = [-1.0 / ratio, 0.0]
    if known:
        states.insert(1, MotionState(x - memory["middle_move"], v - memory["middle_gain"]))
        times.insert(1, -0.5 / ratio)
    # A reduced shell's viscous matrix of bending is that of where a part ends, else its turning is resisted.
    ahead = x + 0.5 * dt * (v + 0.25 * gain)
    made_of = tuple(zip(first, states, times, strict=True))
    begin, expected = _combined(made_of), v + 0.5 * gain
    start = EulerStart(*begin, length * dt, 0.5, expected, x, 0.0, ahead, made_of, viscous_ahead=True)
    middle, solved = euler.solve(start)
    if not solved:
        return middle, False
    middle = euler.landed(state, middle, 0.5 * dt)
    made_of = tuple(zip(second, [*states, middle], [*times, 0.5], strict=True))
    # Loads at the end stand for both sides of it: ends feel half of a jump there, which middles alone would lack.
    near, last = middle.coordinates, 2.0 * middle.rates - v
    ahead = x + 0.5 * dt * (v + last)
    start = EulerStart(*_combined(made_of), GAMMA * dt, 1.0, last, near, 0.5, ahead, made_of, viscous_ahead=True)
    after, solved = euler.solve(start)
    after.memory = {"middle_at": near, "middle_rates": middle.rates}  # of itself, whose momenta are known by it
    return after, solved


def _combined(made_of: tuple[tuple[float, MotionState, float], ...]) -> tuple[Array, Array]:
    """Coordinates and rates of weighted states, whose weights add up to one: from the first, to keep digits."""
    first = made_of[0][1]
    x, v = first.coordinates, first.rates
    for weight, state, _ in made_of[1:]:
        x, v = x + weight * (state.coordinates - first.coordinates), v + weight * (state.rates - first.rates)
    return x, v


def no_middle(coordinates: Array) -> dict[str, Array]:
    """What the memory of a state keeps of a step's middle that is not known."""
    none = np.zeros_like(coordinates)
    return {"middle_move": none, "middle_gain": none.copy(), "middle": np.zeros(1)}
