"""Numbers of theory 12: the damping ratio that each rule of time stepping gives, and what its estimates add up to."""

from __future__ import annotations

import numpy as np

from modalshell.integrators.full import Composite
from modalshell.integrators.modal.exponential import VIOLENT
from studies.pages import committed
from studies.theory.oscillator import EARLIER, GAMMA, RULES, euler, flow, weights
from studies.theory.turning_strip import STEP, VISCOSITY, held_back

ASKED, LIGHT = 0.03, 0.02
COUNTS = (10, 20, 50, 100, 200)
"""Steps in a period of the undamped oscillator."""
SHARES = {"implicit Euler": 0.5, "BDF2": 1.0 / 3.0, "SDIRK2": 3.0 * GAMMA**2 - 2.0 * GAMMA**3 - 1.0 / 6.0}
SHARES |= {"composite": Composite.error_constant}
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
    """Sum of eq. 13 over the true error of an undamped oscillation, after two periods of an exact start."""
    step, order = 2.0 * np.pi / count, 1 if rule == "implicit Euler" else 2
    states = [np.array([np.cos(a), -np.sin(a)]) for a in (-step, 0.0)]
    matrix, total = RULES[rule](step, 0.0), 0.0
    kept = np.concatenate([[np.cos(a), -np.sin(a)] for a in (0.0, -step, -0.5 * step)])[: len(matrix)]
    for _ in range(2 * count):
        kept = matrix @ kept
        states.append(kept[:2])
        total += 0.5 * np.pi * share * step * abs(np.diff(states[-1 - order :], order, axis=0)[0, 1])
    return float(total / np.linalg.norm(states[-1] - np.array([1.0, 0.0])))


def statements() -> list[str]:
    """What the chapter states."""
    rows = [f"| {rule} | {' | '.join(f'{damping(rule, n, ASKED):.4f}' for n in COUNTS)} |" for rule in RULES]
    at = {rule: ", ".join(str(enough(rule, ratio)) for ratio in (0.01, 0.03, 0.1)) for rule in SHARES}
    sums = [f"{estimated(rule, share, 80):.2f} ({rule})" for rule, share in SHARES.items()]
    left, true = (np.abs(np.linalg.eigvals(rule(2.0 * np.pi * 20.0 / 30.0, LIGHT))).max() for rule in (euler, flow))
    told = [", ".join(f"{weight:.3f}" for weight in part) for part in weights()]
    swing = committed("motion_truth").findings["swing"]
    lost = {row["rule"]: row["lost"] for row in swing if row["steps"] == 120}
    off = [f"{held_back(rule):.4f}" for rule in ("composite", "bdf2", "sdirk2", "implicit")]
    near = "within 1 % of a ratio of 0.01, 0.03 or 0.1 from"
    return [
        *rows,
        f"with {EARLIER} the weights for equal steps are {' and '.join(told)}",
        f"{near} {at['composite']} steps a period, and its error is that of SDIRK2",
        f"in steps of 1/120 s loses {lost['sdirk2']:.2g} of the energy that its weight puts in by SDIRK2, "
        f"{lost['bdf2']:.2g} by BDF2 and {lost['composite']:.1g} by the composite rule",
        f"and {SHARES['composite']:.3g} for the composite rule",
        f"{near} {at['BDF2']} steps a period by BDF2, from {at['SDIRK2']} by SDIRK2",
        f"over the least stiffness of these modes, is above {VIOLENT} of the shell's size",
        f"frequency at 20 Hz and the ratio {LIGHT},",
        f"over the true one: {', '.join(sums)}",
        f"it is {off[0]} of its length off at most by the composite rule, {off[1]} by BDF2, {off[2]}",
        f"by SDIRK2 and {off[3]} by implicit Euler",
        f"about its clamp in steps of {STEP} s, with $\\zeta = {VISCOSITY}$ s",
        f"multiplies its amplitude by {left:.2f} in a step, where the truth is {true:.2f}",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
