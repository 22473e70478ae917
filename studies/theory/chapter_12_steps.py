"""Numbers of theory 12: the damping ratio that each rule of time stepping gives, and what its estimates add up to."""

from __future__ import annotations

import numpy as np

from modalshell.integrators.modal.exponential import VIOLENT
from studies.theory.oscillator import GAMMA, RULES, euler, flow

ASKED, LIGHT = 0.03, 0.02
COUNTS = (10, 20, 50, 100, 200)
"""Steps in a period of the undamped oscillator."""
SHARES = {"implicit Euler": 0.5, "BDF2": 1.0 / 3.0, "SDIRK2": 3.0 * GAMMA**2 - 2.0 * GAMMA**3 - 1.0 / 6.0}
"""Constants of the estimates."""


def damping(rule: str, count: int, ratio: float) -> float:
    """Damping ratio that the dominant eigenvalue of a step shows, over the rule's own frequency."""
    values = np.linalg.eigvals(RULES[rule](2.0 * np.pi / count, ratio))
    rate = np.log(complex(values[np.argmax(np.abs(values))]))
    return float(-rate.real / abs(rate))


def enough(rule: str, ratio: float) -> int:
    """Least number of steps in a period from which on the ratio is within 1 %."""
    wrong = [n for n in range(5, 200) if abs(damping(rule, n, ratio) / ratio - 1.0) > 0.01]
    return max(wrong, default=4) + 1


def estimated(rule: str, share: float, count: int) -> float:
    """Sum of eq. 10 over the true error of an undamped oscillation, after two periods of an exact start."""
    step, states = 2.0 * np.pi / count, [np.array([np.cos(a), -np.sin(a)]) for a in (-2.0 * np.pi / count, 0.0)]
    matrix, size, total = RULES[rule](step, 0.0), len(RULES[rule](step, 0.0)), 0.0
    for _ in range(2 * count):
        states.append((matrix @ np.concatenate([states[-1], states[-2]])[:size])[:2])
        order = 1 if rule == "implicit Euler" else 2
        total += 0.5 * np.pi * share * step * abs(np.diff(states[-1 - order :], order, axis=0)[0, 1])
    return float(total / np.linalg.norm(states[-1] - np.array([1.0, 0.0])))


def statements() -> list[str]:
    """What the chapter states."""
    rows = [f"| {rule} | {' | '.join(f'{damping(rule, n, ASKED):.4f}' for n in COUNTS)} |" for rule in RULES]
    asked = (0.01, 0.03, 0.1)
    bdf, sdirk = (", ".join(str(enough(rule, ratio)) for ratio in asked) for rule in ("BDF2", "SDIRK2"))
    sums = [f"{estimated(rule, share, 80):.2f} ({rule})" for rule, share in SHARES.items()]
    left, true = (np.abs(np.linalg.eigvals(rule(2.0 * np.pi * 20.0 / 30.0, LIGHT))).max() for rule in (euler, flow))
    return [
        *rows,
        f"within 1 % of a ratio of 0.01, 0.03 or 0.1 from {bdf} steps a period by BDF2, from {sdirk} by SDIRK2",
        f"over the least stiffness of these modes, is above {VIOLENT} of the shell's size",
        f"frequency at 20 Hz and the ratio {LIGHT},",
        f"over the true one: {', '.join(sums)}",
        f"multiplies its amplitude by {left:.2f} in a step, where the truth is {true:.2f}",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
