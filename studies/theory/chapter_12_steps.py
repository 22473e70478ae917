"""Numbers of theory 12: the damping ratio that each rule of time stepping gives to one damped oscillator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

from modalshell.core.typing import Array

GAMMA = 1.0 - np.sqrt(0.5)
ASKED, LIGHT = 0.03, 0.02
COUNTS = (10, 20, 50, 100, 200)
"""Steps in a period of the undamped oscillator."""


def flow(step: float, ratio: float) -> Array:
    """Matrix of the exact flow of (q, v), for a frequency of 1 rad/s."""
    return np.asarray(expm(step * np.array([[0.0, 1.0], [-1.0, -2.0 * ratio]])))


def euler(step: float, ratio: float) -> Array:
    """One step of implicit Euler."""
    return np.asarray(np.linalg.inv(np.eye(2) - step * np.array([[0.0, 1.0], [-1.0, -2.0 * ratio]])))


def midpoint(step: float, ratio: float) -> Array:
    """The implicit midpoint rule."""
    half = euler(0.5 * step, ratio)
    return 2.0 * half - np.eye(2)


def bdf2(step: float, ratio: float) -> Array:
    """Theory 12, eq. 7: of a state and the one before, as implicit Euler of two thirds of the step."""
    solved = euler(2.0 * step / 3.0, ratio)
    return np.block([[4.0 / 3.0 * solved, -1.0 / 3.0 * solved], [np.eye(2), np.zeros((2, 2))]])


def sdirk2(step: float, ratio: float) -> Array:
    """Theory 12, eq. 8: two steps of implicit Euler of gamma h."""
    solved = euler(GAMMA * step, ratio)
    rate = (solved - np.eye(2)) / (GAMMA * step)
    return solved @ (np.eye(2) + (1.0 - GAMMA) * step * rate)


RULES: dict[str, Callable[[float, float], Array]] = {
    "implicit Euler": euler, "BDF2": bdf2, "implicit midpoint": midpoint, "SDIRK2": sdirk2, "exponential": flow,
}  # fmt: skip


def damping(rule: str, count: int, ratio: float) -> float:
    """Damping ratio that the dominant eigenvalue of a step shows, over the rule's own frequency."""
    values = np.linalg.eigvals(RULES[rule](2.0 * np.pi / count, ratio))
    rate = np.log(complex(values[np.argmax(np.abs(values))]))
    return float(-rate.real / abs(rate))


def enough(rule: str, ratio: float) -> int:
    """Least number of steps in a period from which on the ratio is within 1 %."""
    wrong = [n for n in range(5, 200) if abs(damping(rule, n, ratio) / ratio - 1.0) > 0.01]
    return max(wrong, default=4) + 1


def statements() -> list[str]:
    """What the chapter states."""
    rows = [f"| {rule} | {' | '.join(f'{damping(rule, n, ASKED):.4f}' for n in COUNTS)} |" for rule in RULES]
    asked = (0.01, 0.03, 0.1)
    bdf, sdirk = (", ".join(str(enough(rule, ratio)) for ratio in asked) for rule in ("BDF2", "SDIRK2"))
    left, true = (np.abs(np.linalg.eigvals(rule(2.0 * np.pi * 20.0 / 30.0, LIGHT))).max() for rule in (euler, flow))
    return [
        *rows,
        f"within 1 % of a ratio of 0.01, 0.03 or 0.1 from {bdf} steps a period by BDF2, from {sdirk} by SDIRK2",
        f"frequency at 20 Hz and the ratio {LIGHT},",
        f"multiplies its amplitude by {left:.2f} in a step, where the truth is {true:.2f}",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
