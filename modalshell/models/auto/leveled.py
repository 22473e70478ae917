"""Steps of the model that switches itself: by which level they are, and what touches in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.state import COST, MotionState
from modalshell.models.auto.account import energy_change
from modalshell.models.auto.checks import Check
from modalshell.models.auto.levels import Level, ModalLevel
from modalshell.models.auto.loads_ahead import LoadsAhead
from modalshell.models.auto.trusted import SELDOM, KnownStates
from modalshell.models.auto.watching import SWITCH, Seen, Step, Watch
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import Stepper

TRY_EVERY = 6
"""Steps of a full rung from one attempt to hand back to the next."""
MOST_LOGGED = 24
"""Switches that are remembered with their reasons; all are counted."""
_SHORT, _SLACKENED, _MOST_SLACKENED, _SLACK = 0.125, 3, 8, 0.05
"""Length, in steps, and least and largest number of the steps from rest by which DS sheds the stretch of modes, too
short to bend; and the share of the elastic energy that one must still shed for another to follow."""

_STRAIGHT = 0.2
"""Share of the bar from which a rung is left that displacements by MWTS may differ from those of linear modes where all
rungs of modes move alike."""
_INSIDE = 1e-8
"""Depth in a collider, as a share of the shell's size, to which a level's state may be."""


class LeveledStepper(Stepper):
    """Steps, each of which is taken by one of the ``levels``, which are given cheapest first.

    OptionError for contacts of free parts without constraints, and for self-contact.
    """

    takes_constraints = takes_contacts = True

    def __init__(self, model: Any, levels: Sequence[Level], setup: MotionSetup) -> None:
        super().__init__(model, setup, in_frame=True)
        if setup.contacts and not setup.constraints and any(level.still is not level.model for level in levels):
            raise model.no_contacts()
        if setup.contacts:
            from modalshell.contact.touching import checked_contacts  # not without contacts

            checked_contacts(setup.contacts)  # levels of modes refuse self-contact, and under constraints none is made
        self._levels, self._mass = levels, model.shell.mass[:, None]
        self._smooth = _smoothed(setup)
        self._made = {} if setup.constraints else {0: levels[0].stepper(self._smooth)}  # DS takes constraints
        self._check: Check = model.check(setup)
        self._loads = LoadsAhead(model, setup, self._check)
        self._watch = Watch(model, setup, self._check, self._loads)
        self._last: tuple[MotionState, int, MotionState] | None = None
        if setup.contacts:
            self.model = model.of_states([self._first_state(k) for k in range(len(levels))])

    def _first_state(self, level: int) -> MotionState:
        """A state of a level at rest, with what it remembers of contacts; coarse ones are never in contact.

        Nor are levels of modes under constraints.
        """
        if level in self.model.coarse_levels or (self.setup.constraints and self._levels[level].quadratic):
            state: MotionState = self._levels[level].model.start_motion()
            return state
        return self._stepper(level).local_state_at(self.shell.rest_positions, 0.0)

    @property
    def note(self) -> str:
        """What a message says of the contacts: of friction, as DS does, and that there is no coarse level."""
        if not self.setup.contacts:
            return ""
        note = self._stepper(len(self._levels) - 1).note
        names = [self._levels[k].model.name for k in self.model.coarse_levels]
        return "; ".join(filter(None, [note, *(f"{name} is left out with contacts" for name in names)]))

    def _stepper(self, level: int) -> Stepper:
        """What takes the steps of a level; those beyond the first are made when they are wanted."""
        if level not in self._made:
            smooth = self._levels[level].quadratic
            self._made[level] = self._levels[level].stepper(self._smooth if smooth else self.setup)
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
            "drift": np.zeros((5, 0)),
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
            "log": np.zeros((MOST_LOGGED, 6)),
            "switches": np.zeros(1),
        }

    def _allowed(self, memory: dict[str, Array]) -> float:
        """Displacement [kg^(1/2) m] off by which a level is left."""
        return float(SWITCH * self.model.error * memory["largest"].item())

    def took_part(self, state: MotionState, time: float, dt: float, begin: float) -> None:
        """Let the level that took a part of a step take note of it; see :meth:`Stepper.took_part`."""
        level, inner = self._taken_by(state)
        self._stepper(level).took_part(inner, time, dt, begin)

    def touched(self, state: MotionState, time: float) -> TouchedFrame | None:
        """What touches in a state at ``time`` [s], by the level that took the step to it."""
        if not self.setup.contacts:
            return None
        level, inner = self._taken_by(state)
        return self._stepper(level).touched(inner, time)

    def _taken_by(self, state: MotionState) -> tuple[int, MotionState]:
        """The level that took the step to a state, and its own state there."""
        last = self._last
        return last[1:] if last is not None and last[0] is state else self.model.inner(state)

    def own_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the frame of the supports: the coordinates themselves, not to be written into."""
        return state.coordinates

    def positions(self, state: MotionState, time: float) -> Array:
        """Positions (n, 3) [m] in the world, of the caller's own."""
        own = state.coordinates
        return own.copy() if self._frame is None and not self._off_centre else self.in_world(own, time)

    def loaded_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] on which loads do their work."""
        if not self.setup.contacts:
            return super().loaded_positions(state)
        level, inner = self.model.inner(state)
        stepper = self._stepper(level)
        return stepper.loaded_positions(inner) + stepper.origin

    def remark(self, state: MotionState, time: float) -> str:
        """That constraints or supports lead vertices through a collider, as DS says it; "" otherwise."""
        if not self.setup.contacts:
            return ""
        full = self._stepper(len(self._levels) - 1)
        return full.remark(MotionState(state.coordinates - full.origin, state.rates, {}), time)

    def further_energy(self, state: MotionState) -> float:
        """Elastic energy [J] of what contacts press in."""
        if not self.setup.contacts:
            return 0.0
        level, inner = self.model.inner(state)
        return self._stepper(level).further_energy(inner)

    def _stands_near(self, level: int, inner: MotionState, x: Array, time: float, allowed: float) -> bool:
        """Whether a level's state on contacts is outside the colliders, and within what is allowed of x (n, 3) [m]."""
        stepper = self._stepper(level)
        found, off = stepper.touched(inner, time), self._length(stepper.local_positions(inner) - x)
        return off <= allowed and (found is None or found.deepest <= _INSIDE * self.shell.size)

    def _is_clear(self, step: Step) -> bool:
        """Whether no collider that modes do not take has touched in three frames, or will where vertices go on so."""
        (x, v), times = (step.frames[2], step.velocities()), (step.time - step.dt, step.time, step.time + step.dt)
        frames = step.frames[1], x, x + step.dt * v
        return not any(self._check.touches_rough(x, time) for x, time in zip(frames, times, strict=True))

    def _energy_gain(
        self,
        levels: tuple[int, int],
        states: tuple[MotionState, MotionState],
        motion: tuple[Array, Array],
        now: tuple[float, Array],
    ) -> float:
        """Change of the energy where the second level's state takes the place of the first one's."""
        force = self._loads.at(*motion, *now)
        return energy_change((self._stepper(levels[0]), self._stepper(levels[1])), states, force)

    def _errs_alike(self, number: int, seen: Seen, memory: dict[str, Array]) -> bool:
        """Whether a level of modes would rest as far as it must not from where a check's steps lead to."""
        level = self._levels[number]
        if not level.quadratic or self._check.least:
            return False
        answer = self._watch.rests.near(level, seen.load, seen.resting, seen.time)
        allowed = self._allowed(memory)
        return answer is None or not (answer.converged and self._length(answer.positions - seen.resting) <= allowed)

    def _moves_alike(self, step: Step, seen: Seen, memory: dict[str, Array]) -> bool:
        """Whether the next level would move as the first does, which would rest near where a check's steps lead to.

        So it is where displacements are nearly those of linear modes: the error then is of the time step's, or what
        modes lack of a load that has hardly moved the shell yet.
        """
        first, q = self._levels[0], step.inner.coordinates
        if step.level > 0 or not isinstance(first, ModalLevel) or self._check.least:
            return False
        bent = first.still.warped(q) - (first.still.basis.modes @ q).reshape(-1, 3)
        alike = self._length(bent) <= _STRAIGHT * self._allowed(memory)
        return alike and not self._errs_alike(0, seen, memory)

    def _error_growth(self, state: MotionState, x: Array) -> float:
        """How much more the modes will lack than at x (n, 3) [m], to which a state of the lowest level is fitted.

        That grows with the square of the displacement: a swing that is wrong at its ends looks right in its middle.
        """
        if self._check.least:
            return 1.0
        amplitude, moved = math.hypot(*state.coordinates, *(state.rates * self.model.periods)), self._check.moved(x)
        return max(1.0, amplitude / moved) ** 2 if moved > 0.0 else 1.0

    def _length(self, displacement: Array) -> float:
        return float(np.sqrt(np.sum(self._mass * displacement**2)))

    def _without_stretch(self, level: int, inner: MotionState, time: float) -> MotionState:
        """A full level's state after short steps from rest, with its rates: without the stretch that others have.

        No load pushes in these steps.
        """
        stepper = self._levels[level].stepper(replace(self.setup, loading=self.shell.loading(), supports=None))
        dt = _SHORT * self.setup.dt
        x, still, load = inner.coordinates, np.zeros_like(inner.rates), np.zeros_like(self.shell.rest_positions)
        last = math.inf
        for taken in range(1, _MOST_SLACKENED + 1):
            after = stepper.advance(time - dt, dt, MotionState(x, still, inner.memory), load)[0]
            x, energy = after.coordinates, stepper.model.elastic_energy(after)
            if taken >= _SLACKENED and not energy < (1.0 - _SLACK) * last:
                break
            last = energy
        return MotionState(x, inner.rates, inner.memory)


def _smoothed(setup: MotionSetup) -> MotionSetup:
    """The same motion for levels of modes, whose contacts are without friction, restitution and ``push_out``."""
    if not any(getattr(contact, "rough", False) for contact in setup.contacts):
        return setup
    from modalshell.contact.contact import Contact, smooth  # not without contacts

    given = [smooth(contact) if isinstance(contact, Contact) else contact for contact in setup.contacts]
    return replace(setup, contacts=given)
