"""Steps of the model that switches itself: by which level they are, and what touches in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.state import COST, MotionState
from modalshell.models.auto.levels import FullLevel, Level, ModalLevel
from modalshell.models.auto.trusted import SELDOM, KnownStates
from modalshell.models.auto.watching import SWITCH
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import Stepper

TRY_EVERY = 6
"""Steps of a full rung from one attempt to hand back to the next."""
MOST_TOLD = 24
"""Switches that are remembered with their reasons; all are counted."""
_SHORT, _SLACKENED = 0.125, 3
"""Length, in steps, and number of the steps from rest by which DS sheds the stretch of modes: too short to bend."""


class LeveledStepper(Stepper):
    """Steps each of which one of some levels takes.

    Parameters
    ----------
    model : Auto
        The model.
    levels : sequence of Level
        Cheapest first.
    setup : MotionSetup
        What decides the motion.

    Raises
    ------
    OptionError
        For contacts where a level takes none.
    """

    takes_contacts = True

    def __init__(self, model: Any, levels: Sequence[Level], setup: MotionSetup) -> None:
        super().__init__(model, setup)
        held = all(isinstance(level, ModalLevel | FullLevel) and level.still is level.model for level in levels)
        if setup.contacts and not held:
            raise model.no_contacts()
        self._levels = levels
        self._made = {0: levels[0].stepper(setup)}
        self._last: tuple[MotionState, int, MotionState] | None = None
        if setup.contacts:
            rest = model.shell.rest_positions
            self.model = model.of_states([self._stepper(k).state_at(rest, 0.0) for k in range(len(levels))])

    def _stepper(self, level: int) -> Stepper:
        """What takes the steps of a level; those beyond the first are made when they are wanted."""
        if level not in self._made:
            self._made[level] = self._levels[level].stepper(self.setup)
        return self._made[level]

    @staticmethod
    def memory(x: Array, levels: int) -> dict[str, Array]:
        """What the memory holds at the start at x (n, 3) [m] for some levels, but for the state of one."""
        return {
            "level": np.zeros(1),
            "since": np.zeros(1),
            "before": x.copy(),
            "step": np.zeros(1),
            COST: np.zeros(3),
            "frames": np.zeros(1),
            "largest": np.zeros(1),
            "checked": np.zeros(1),
            "looked": np.zeros(1),
            "known": KnownStates.nothing(0),
            "seldom": np.full(1, float(SELDOM)),
            "barred": np.zeros(levels),
            "wait": np.full(1, float(TRY_EVERY)),
            "again": np.full(1, float(TRY_EVERY)),
            "ready": np.zeros(1),
            "steps": np.zeros(levels),
            "pushed": np.zeros_like(x),
            "dead": np.zeros_like(x),
            "answer": np.zeros(2),
            "ahead": np.zeros(1),
            "felt": np.zeros(1),
            "log": np.zeros((MOST_TOLD, 6)),
            "switches": np.zeros(1),
        }

    def _allowed(self, memory: dict[str, Array]) -> float:
        """Displacement [kg^(1/2) m] off by which a level is left."""
        return float(SWITCH * self.model.error * float(memory["largest"][0]))

    def took_part(self, state: MotionState, time: float, dt: float, begin: float) -> None:
        """Let the level that took a part of a step take note of it; see :meth:`Stepper.took_part`."""
        level, inner = self.model.inner(state)
        self._stepper(level).took_part(inner, time, dt, begin)

    def touched(self, state: MotionState, time: float) -> TouchedFrame | None:
        """What touches in a state at ``time`` [s], by the level that took the step to it."""
        if not self.setup.contacts:
            return None
        last = self._last
        level, inner = last[1:] if last is not None and last[0] is state else self.model.inner(state)
        return self._stepper(level).touched(inner, time)

    def loaded_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] on which loads do their work."""
        if not self.setup.contacts:
            return super().loaded_positions(state)
        level, inner = self.model.inner(state)
        stepper = self._stepper(level)
        return stepper.loaded_positions(inner) + stepper.origin

    def further_energy(self, state: MotionState) -> float:
        """Elastic energy [J] of what contacts press in."""
        if not self.setup.contacts:
            return 0.0
        level, inner = self.model.inner(state)
        return self._stepper(level).further_energy(inner)

    def _slack(self, level: int, inner: MotionState, time: float) -> MotionState:
        """A full level's state after short steps from rest, with its rates: without the stretch that modes have.

        No load pushes in these steps.
        """
        stepper = self._levels[level].stepper(replace(self.setup, loading=self.shell.loading()))
        dt = _SHORT * self.setup.dt
        x, still, load = inner.coordinates, np.zeros_like(inner.rates), np.zeros_like(self.shell.rest_positions)
        for _ in range(_SLACKENED):
            x = stepper.advance(time - dt, dt, MotionState(x, still, inner.memory), load)[0].coordinates
        return MotionState(x, inner.rates, inner.memory)
