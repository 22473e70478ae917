"""What adapters of engines that step in time share; they import it from their own folder, without this package."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

Settled = tuple[Any, int, float]
"""Positions (n, 3) [m], or None where they left the bounds of the case; steps, and seconds on a processor."""


def settled(case: dict[str, Any], step: float, advance: Callable[[], None], places: Callable[[], Any]) -> Settled:
    """What ``places`` are after the case's time or limit, by steps that ``advance`` takes."""
    begin, steps = time.process_time(), 0
    while steps * step < case["duration"] and time.process_time() - begin < case["limit"]:
        advance()
        steps += 1
        if steps % 16 == 0 and not np.abs(places()).max() < case["bound"]:
            return None, steps, time.process_time() - begin
    last = np.array(places())
    return (last if np.abs(last).max() < case["bound"] else None), steps, time.process_time() - begin


def by_longest_step(
    case: dict[str, Any], answer: Callable[[dict[str, Any], dict[str, Any], float], Settled]
) -> dict[str, Any]:
    """Every load's answer, by the longest step that stays within the case's bounds; nothing if none does."""
    for step in case["steps"]:
        answers = []
        for load in case["loads"]:
            answers.append(answer(case, load, step))
            if answers[-1][0] is None:
                break
        else:
            return {
                "positions": [places.tolist() for places, _, _ in answers],
                "seconds": sum(seconds for _, _, seconds in answers),
                "taken": [steps for _, steps, _ in answers],
                "step": step,
            }
    return {}
