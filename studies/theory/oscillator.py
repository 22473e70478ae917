"""Rules of time stepping on one damped oscillator, as matrices of a step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

from modalshell.core.typing import Array

GAMMA = 1.0 - np.sqrt(0.5)
"""Share of the step in each part of SDIRK2 and of the composite rule."""
EARLIER = -0.035
"""Weight in the end of a step of the composite rule of where the step before began."""


def flow(step: float, ratio: float) -> Array:
    """Matrix of the exact flow of (q, v), for a frequency of 1 rad/s."""
    return np.asarray(expm(step * np.array([[0.0, 1.0], [-1.0, -2.0 * ratio]])))


def euler(step: float, ratio: float) -> Array:
    """One step of implicit Euler."""
    return np.asarray(np.linalg.inv(np.eye(2) - step * np.array([[0.0, 1.0], [-1.0, -2.0 * ratio]])))


def bdf2(step: float, ratio: float) -> Array:
    """Theory 12, eq. 7: of a state and the one before, as implicit Euler of two thirds of the step."""
    solved = euler(2.0 * step / 3.0, ratio)
    return np.block([[4.0 / 3.0 * solved, -1.0 / 3.0 * solved], [np.eye(2), np.zeros((2, 2))]])


def sdirk2(step: float, ratio: float) -> Array:
    """Theory 12, eq. 8: two steps of implicit Euler of gamma h."""
    solved = euler(GAMMA * step, ratio)
    rate = (solved - np.eye(2)) / (GAMMA * step)
    return solved @ (np.eye(2) + (1.0 - GAMMA) * step * rate)


def weights() -> tuple[Array, Array]:
    """Theory 12, eq. 9, for equal steps: of z_(n-1), y_(n-1), z_n and y_n."""

    def moments(length: float) -> Array:
        return np.array([1.0, length - GAMMA, length**2 - 2.0 * GAMMA * length])

    first = np.linalg.solve(np.vander([-1.0, -0.5, 0.0], increasing=True).T, moments(0.5))
    given = EARLIER * np.array([1.0, -1.0, 1.0])
    last = np.linalg.solve(np.vander([-0.5, 0.0, 0.5], increasing=True).T, moments(1.0) - given)
    return np.asarray(first), np.asarray(np.append(EARLIER, last))


def composite(step: float, ratio: float) -> Array:
    """Theory 12, eq. 9: of z_n, z_(n-1) and y_(n-1)."""
    first, second = weights()
    solved = euler(GAMMA * step, ratio)
    middle = np.kron(first[[2, 0, 1]], solved)
    end = np.kron(second[[2, 0, 1]], solved) + second[3] * solved @ middle
    return np.vstack([end, np.eye(2, 6), middle])


RULES: dict[str, Callable[[float, float], Array]] = {
    "implicit Euler": euler, "BDF2": bdf2, "SDIRK2": sdirk2, "composite": composite, "exponential": flow,
    "implicit midpoint": lambda step, ratio: 2.0 * euler(0.5 * step, ratio) - np.eye(2),
}  # fmt: skip
