"""Steps of the model that switches itself, and when it switches."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, final

import numpy as np

from modalshell.core.touched import STRUCK
from modalshell.core.typing import Array
from modalshell.integrators.state import COST, MotionState
from modalshell.models.auto.account import (
    DRIFTS,
    LACKS_LOAD,
    LACKS_START,
    LED,
    NO_MARGIN,
    STRIKES,
    TOUCHES,
    cost_of,
)
from modalshell.models.auto.leveled import MOST_LOGGED, TRY_EVERY, LeveledStepper
from modalshell.models.auto.levels import Level, ModalLevel
from modalshell.models.auto.loads_ahead import Coming
from modalshell.models.auto.watching import FRAMES, SWITCH, Seen, Step
from modalshell.models.base.setup import MotionSetup
from modalshell.statics.error_bar import LEAST_MARGIN

_EARLY = 1.0
"""Bar over the error allowed from which a rung is left again on the first frames after it has come back."""
_BACK = 0.4
"""Misses over the error allowed within which it may come back."""
_BACK_MARGIN = 0.39
"""Stability margin above which it may."""
_AHEAD = 2.0
"""Factor of the linear answer on that of the last look ahead, from which the next one comes."""
_RARER = 1.2
"""Factor on the steps taken by a full rung from one vain attempt to the next, at least."""
_IN_A_ROW = 2
"""Attempts that must succeed one after the other: in violent motion one moment may look calm."""
_SOON, _PATIENCE = 4, 4.0
"""Checks within which a modal rung that has come back must not fail, and the factor on the steps to the next attempt
where it does."""
_STRIKING = 4.0
"""Swing that a strike takes, over the bar from which a rung is left: modes err by a part of it."""
_LARGE = -NO_MARGIN
Switch = tuple[float, int, float, float, float]
"""Time [s], level, bar, margin and mark of a switch."""


@final
class AutoStepper(LeveledStepper):
    """Takes each step by the present level, and switches levels after it.

    A state's coordinates and rates are the positions and velocities of every vertex. Its memory holds the level
    ("level"), the steps taken on it ("since"), the level's own state ("inner"), the frame before ("before"), the length
    of the step from there ("step") and how many are known, what the last step cost, the largest displacement so far and
    that of the last check of a modal rung ("checked"), the step of the level that was ("looked"), the states that
    checks vouch for ("known") and the steps until one is checked all the same ("seldom"), errors that add up ("drift"),
    levels that are barred, the steps before the modal rung may come back ("wait"), how often in a row it could have
    ("ready"), the last load that was compared with what the modes answer ("pushed", "answer"), the linear answers at
    the last look at a load ("felt") and at the last look ahead ("ahead"), steps by level, and what was switched when
    and why ("log").
    """

    def __init__(self, model: Any, levels: Sequence[Level], setup: MotionSetup) -> None:
        super().__init__(model, levels, setup)
        self._calmed: tuple[Array | None, Array | None, float] = None, None, math.inf
        self._one, self._counts = np.ones(1), list(np.eye(len(levels)))  # a sum of arrays is quicker than of a number

    def start(self, positions: Array | None) -> MotionState:
        """State at rest at ``positions`` (n, 3) [m]: on the first level that holds them, and the account says which.

        A modal level holds a start that its shapes come near to, and that DS would keep under the load under which the
        level rests there. Where that load's stability margin has failed, DS alone does, and under constraints. Of free
        parts the first level is asked alone, and whether it comes near.
        """
        rest = self.shell.rest_positions
        self._check.refuse_inside(rest if positions is None else positions)
        if self.setup.constraints:
            top = len(self._levels) - 1
            inner = self._stepper(top).local_state_at(rest if positions is None else positions, 0.0)
            return self._initial_state(top, inner, (0.0, 1.0, LED))
        if positions is None and not self._check.touches_rough(rest, 0.0):
            return self._watch.fitted(super().start(positions))
        positions = rest if positions is None else positions
        last, missed, margin = len(self._levels) - 1, 0.0, 1.0
        if self._check.touches_rough(positions, 0.0):
            return self._initial_state(last, self._stepper(last).local_state_at(positions, 0.0), (0.0, 1.0, TOUCHES))
        for number in self._watch.first_levels:
            inner = self._levels[number].entered(self._stepper(number), positions, np.zeros_like(positions), 0.0)
            off, stable = self._start_miss(number, inner, positions)
            if number == 0:
                missed, margin = off, stable
            if off <= 1.0:
                return self._initial_state(number, inner, (missed, margin, LACKS_START))
            if not stable > LEAST_MARGIN:
                break
        return self._initial_state(
            last, self._stepper(last).local_state_at(positions, 0.0), (missed, margin, LACKS_START)
        )

    def _initial_state(self, level: int, inner: MotionState, lost: tuple[float, float, float]) -> MotionState:
        """The state of a start on a level, with a note: error of the first level over the allowed one, margin, mark."""
        missed, margin, mark = lost
        state = self._watch.fitted(self.model.on_level(level, inner, self._stepper(level).local_positions(inner)))
        if level > 0:
            self._note(state.memory, (0.0, level, _BACK * self.model.error * missed, margin, mark))
        return state

    def _start_miss(self, number: int, inner: MotionState, start: Array) -> tuple[float, float]:
        """What a level's state lacks of a start (n, 3) [m] over what it may, and the stability margin there."""
        level, stepper = self._levels[number], self._stepper(number)
        x, allowed = stepper.local_positions(inner), _BACK * self.model.error * self._check.moved(start)
        gap, margin = self._length(x - start), 1.0
        if isinstance(level, ModalLevel) and gap <= allowed and not self._check.least:
            bar = self._check.static(x, level.resting_load(stepper, inner))
            gap, margin = max(gap, self._check.off(bar, x)), bar.margin
        return (gap / allowed if allowed > 0.0 else float(gap > 0.0) * _LARGE), margin

    def state_at(self, positions: Array, time: float) -> MotionState:
        """State at rest with every vertex at ``positions`` (n, 3) [m], on the most exact level."""
        top = len(self._levels) - 1
        inner = self._stepper(top).state_at(positions, time)
        return self._watch.fitted(self.model.on_level(top, inner, self._stepper(top).local_positions(inner)))

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the level's own, and a switch where a check asks for one."""
        level, inner = self.model.inner(state)
        memory, time = state.memory.copy(), begin + dt  # its arrays are replaced, never written into
        self._watch.fit(memory, load)
        while self._levels[level].quadratic:
            switch = self._predicted_switch(level, state, memory, (begin, time, load))
            if switch is None:
                break
            level, inner = self._hand_over(inner, (state.coordinates, state.rates), memory, (begin, load), switch)
        stepper = self._stepper(level)
        after, solved = stepper.advance(begin, dt, inner, load)
        rough = self._check.contacts and self._levels[level].quadratic
        if rough and self._check.touches_rough(stepper.local_positions(after), time):
            leaves = begin, self._successor(level, memory, to_full=True), 0.0, 1.0, TOUCHES
            level, inner = self._hand_over(inner, (state.coordinates, state.rates), memory, (begin, load), leaves)
            stepper = self._stepper(level)
            after, solved = stepper.advance(begin, dt, inner, load)
        memory[COST] = cost_of(stepper, inner, after, dt)
        ended = level, after
        x, rates = stepper.local_positions(after), partial(self._levels[level].velocities, stepper, after, dt)
        memory["since"], memory["steps"] = memory["since"] + self._one, memory["steps"] + self._counts[level]
        before = memory["largest"].item()
        moved, largest = self._moved(level, after, x, before)
        if largest != before:
            memory["largest"] = np.array([largest])
        moved_before = memory["frames"].item() >= 1.0
        if moved_before and math.isfinite(largest) and not self.setup.constraints:
            frames = memory["before"], state.coordinates, x
            step = Step(level, inner, after, frames, rates, moved, time, dt, load)
            drifts = self._drift_switch(step, memory)
            if drifts is None:
                level, after = self._switched(step, memory)
            else:
                motion = self._watch.undrifted((x, rates()), memory)
                level, after = self._hand_over(after, motion, memory, (time, load), drifts)
        memory["before"] = state.coordinates
        if memory["step"].item() != dt:
            memory["step"] = np.array([dt])
        if not moved_before:
            memory["frames"] = np.ones(1)
        moving = MotionState.late(x, memory, partial(self._late_parts, rates, level, after))
        self.model.keep(moving, level, after)
        self._last = (moving, *ended) if self.setup.contacts else None
        return moving, solved

    def _late_parts(self, rates: Callable[[], Array], level: int, inner: MotionState) -> tuple[Array, dict[str, Array]]:
        """Velocities (n, 3) [m/s], and a level's own state in the memory."""
        return rates(), {"inner": self.model.packed(level, inner)}

    def _moved(self, level: int, after: MotionState, x: Array, largest: float) -> tuple[float, float]:
        """How far a state at x (n, 3) has moved [kg^(1/2) m], of held modal levels by their modes; and the largest.

        Displacements of MWTS are no longer than those of the modes, which are known without them.
        """
        modal = level == 0 and not (self._check.least or self._check.contacts)
        moved = math.hypot(*after.coordinates.tolist()) if modal else math.inf
        if moved <= largest:
            return moved, largest
        with np.errstate(over="ignore", invalid="ignore"):
            exact = self._check.moved(x)
        return moved if modal else exact, max(largest, exact)

    def _switched(self, step: Step, memory: dict[str, Array]) -> tuple[int, MotionState]:
        """The level and its state to take after a step."""
        level, since = step.level, int(memory["since"].item())
        seen: Seen | None = None
        wanted = level
        if self._levels[level].quadratic:
            # One that has come back is checked as soon as three frames are its own: others differ by what it lacks.
            back = since == FRAMES and level == 0 and memory["switches"][0] > 0.0 and not self._check.least
            if back or self._watch.due(step, memory):
                seen = self._watch.checked(step, memory)
                if seen.unjudged == STRUCK:
                    return level, step.after
                fails = seen.alarm or seen.bar > (_EARLY if back else SWITCH) * self.model.error
                stays = fails and not (seen.alarm or back) and self._moves_alike(step, seen, memory)
                if not stays:
                    self._watch.learn(step, seen, memory)
                if fails and not stays:
                    alike = not seen.alarm and self._errs_alike(level + 1, seen, memory)
                    wanted = self._successor(level, memory, to_full=seen.alarm or back, no_modes=alike)
                elif not fails and level > 0:
                    wanted = self._cheaper_level(step, seen, memory)
        elif since % TRY_EVERY == 0:
            if level + 1 < len(self._levels):
                seen = self._watch.seen(step, memory)
                if seen.alarm:  # a coarse shell snaps under another load
                    wanted = level + 1
                elif seen.bar > SWITCH * self.model.error:
                    memory["barred"] = memory["barred"].copy()
                    memory["barred"][level] = 1.0
                    wanted = level + 1
            if wanted == level and since >= memory["wait"][0]:
                seen = self._return_check(step, seen, memory)
                memory["ready"] = np.zeros(1) if seen is None else memory["ready"] + 1.0
                if seen is None:
                    memory["wait"] = np.maximum(memory["wait"], _RARER * since)
                elif memory["ready"][0] >= _IN_A_ROW:
                    wanted = 0
        if wanted == level or seen is None:
            return level, step.after
        switch = (step.time, wanted, seen.bar, seen.margin, 0.0)
        motion = self._watch.corrected(step, seen, memory, wanted), step.velocities()
        return self._hand_over(step.after, motion, memory, (step.time, step.load), switch)

    def _drift_switch(self, step: Step, memory: dict[str, Array]) -> Switch | None:
        """The switch to DS where errors that add up are as large as those of a check may be."""
        off = self._watch.drifted(step, memory)
        if off == 0.0 or off <= self._allowed(memory) or step.level + 1 == len(self._levels):
            return None
        share = off / float(memory["largest"][0])
        return step.time, self._successor(step.level, memory, to_full=True), share, 1.0, DRIFTS

    def _hand_over(
        self,
        inner: MotionState,
        motion: tuple[Array, Array],
        memory: dict[str, Array],
        now: tuple[float, Array],
        switch: Switch,
    ) -> tuple[int, MotionState]:
        """The level that takes over from the present one, at positions and velocities (n, 3), and its state.

        With contacts a level of modes does not, but the next one, if its shapes outside the colliders are far from x.
        A full one takes over without the stretch of modes, or of a coarse shell between its vertices, which DS would
        throw off.
        """
        (x, v), time, new, far = motion, now[0], switch[1], self._allowed(memory)
        after = self._levels[new].entered(self._stepper(new), x, v, time)
        while self._check.contacts and self._levels[new].quadratic and not self._stands_near(new, after, x, time, far):
            new += 1
            after = self._levels[new].entered(self._stepper(new), x, v, time)
        full = not (self._levels[new].quadratic or self._check.least)
        if full and float(memory["largest"][0]) > 0.0:
            after = self._without_stretch(new, after, time)
        switch = (switch[0], new, *switch[2:])
        self._note(memory, switch, self._energy_gain((int(memory["level"][0]), new), (inner, after), (x, v), now))
        return new, after

    def _note(self, memory: dict[str, Array], switch: Switch, gained: float = 0.0) -> None:
        """Remember a switch: its time, level, bar and margin, the mark of what the modes lack or 0, and what energy."""
        place = int(memory["switches"][0])
        if place < MOST_LOGGED:
            memory["log"] = memory["log"].copy()
            memory["log"][place] = np.clip((*switch, gained), -_LARGE, _LARGE)
        memory["switches"], memory["level"] = memory["switches"] + 1.0, np.array([float(switch[1])])
        memory |= {name: np.zeros(1) for name in ("since", "ready", "ahead", "looked")}
        self._watch.forget(memory)

    def _predicted_switch(
        self, level: int, state: MotionState, memory: dict[str, Array], now: tuple[float, float, Array]
    ) -> Switch | None:
        """The switch of :meth:`_load_switch`, or one to DS if an impact on a collider is predicted."""
        begin, time, _ = now
        if self._check.contacts:
            lost = self._check.strike_ahead(state.coordinates, state.rates, begin, time - begin)
            if lost * float(self.model.periods[0]) > _STRIKING * self._allowed(memory):
                return begin, self._successor(level, memory, to_full=True), 0.0, 1.0, STRIKES
        return self._load_switch(level, state, memory, now)

    def _load_switch(
        self, level: int, state: MotionState, memory: dict[str, Array], now: tuple[float, float, Array]
    ) -> Switch | None:
        """The switch to make before a step of a modal rung, as :meth:`_note` takes it; None without one.

        It is made where the modes lack more of the linear answer to the load than the error allows, over the largest
        displacement, that answer's too. And where the rung's own statics under the load, looked at once and again when
        the linear answer has doubled, has a bar that is void or too large: a load that comes at once leads there
        within a few steps.
        """
        begin, time, dead = now
        calmed = dead is self._calmed[0] and memory["felt"] is self._calmed[1]
        if calmed and memory["ahead"].item() > 0.0 and not self._loads.exceeds(time, self._calmed[2]):
            return None  # no other load comes, and displacements only grow
        if self._loads.dear and self._watch.is_alike(state, memory, time):
            return None
        answer, largest = self._loads.answer(state, memory, time, dead), float(memory["largest"][0])
        if answer is None:
            return None
        memory["felt"] = np.array([answer.whole])
        missed = answer.missing / max(answer.whole, largest, self._check.least)
        if missed > SWITCH * self.model.error:
            return begin, self._successor(level, memory, no_modes=True), missed, 0.0, LACKS_LOAD
        if not (self._loads.change or self._check.least):
            self._calmed = dead, memory["felt"], math.inf
        elif answer.missing <= SWITCH * self.model.error * answer.whole:
            most = self._loads.farthest(dead, float(memory["ahead"][0]))
            if most is not None:
                memory["felt"] = memory["ahead"]
                self._calmed = dead, memory["felt"], most
        if answer.whole <= _AHEAD * memory["ahead"][0]:
            return None
        load = Coming(self._loads.force(state, time, dead), answer.whole, self._loads.factors(time))
        bar = self._watch.first_bar(self._levels[level], dead, load, memory, time)
        if bar is None:
            return None
        return begin, self._successor(level, memory, to_full=not bar.valid), bar.displacement, bar.margin, 0.0

    def _successor(self, level: int, memory: dict[str, Array], *, to_full: bool = False, no_modes: bool = False) -> int:
        """The level that takes over.

        That is DS (``to_full``) where a branch ends, as others snap under another load or not at all; and none of modes
        (``no_modes``) where these do not answer the load.
        """
        last = len(self._levels) - 1
        fitting = (
            k
            for k in range(level + 1, last + 1)
            if k == last or not (to_full or memory["barred"][k] or (no_modes and self._levels[k].quadratic))
        )
        again = memory["switches"][0] > 0.0 and int(memory["since"][0]) <= _SOON * self._watch.every
        wait = _PATIENCE * max(memory["again"][0], TRY_EVERY) if again else float(TRY_EVERY)
        memory["wait"] = memory["again"] = np.array([wait])
        return next(fitting)

    def _cheaper_level(self, step: Step, seen: Seen, memory: dict[str, Array]) -> int:
        """The level after a check of a modal one above the first that has found it right: the first if it serves, too.

        It does where its shape at the same coordinates is near where the check's steps lead to, and it would rest near
        there under d'Alembert's load.
        """
        first, q = self._levels[0], step.inner.coordinates
        allowed = _BACK * self.model.error * float(memory["largest"][0])

        def near(x: Array, found: Array) -> bool:
            return self._length(x - found) <= allowed

        own = self._stepper(0)
        right = seen.margin > _BACK_MARGIN and near(own.model.positions(MotionState(q, q)) + own.origin, seen.corrected)
        memory["ready"] = memory["ready"] + 1.0 if right else np.zeros(1)
        if not (memory["ready"][0] >= _IN_A_ROW and memory["since"][0] >= memory["wait"][0]):
            return step.level
        answer = self._watch.rests.near(first, seen.load, seen.ahead_of(step.frames[1]), seen.time)
        return 0 if answer is not None and answer.converged and near(answer.positions, seen.resting) else step.level

    def _return_check(self, step: Step, seen: Seen | None, memory: dict[str, Array]) -> Seen | None:
        """The check by which the lowest level can take over, or None.

        It comes near, its rates and its energy as well, the margin holds, the level would rest near under d'Alembert's
        load, and would not be left at once: the cheapest first.
        """
        allowed = _BACK * self.model.error * max(memory["largest"][0], self._check.least)
        if self._watch.drift(memory) > allowed or (self._check.contacts and not self._is_clear(step)):
            return None
        lowest, v, (_, middle, x) = self._levels[0], step.velocities(), step.frames
        state = lowest.entered(self._stepper(0), x, v, step.time)
        fitted, rates = lowest.left(self._stepper(0), state, step.dt)
        lost = self._length(rates - v) / self.model.highest  # amplitude at most of vibrations that the modes lack
        if not max(self._length(fitted - x) * self._error_growth(state, x), lost) <= allowed:
            return None
        # Of energy an amplitude takes twice its share: a fold that looks near may have another one.
        gained = self._energy_gain((step.level, 0), (step.after, state), (x, v), (step.time, step.load))
        if not abs(gained) <= 2.0 * _BACK * self.model.error:
            return None
        seen = seen or self._watch.seen(step, memory)
        if not (seen.margin > _BACK_MARGIN and np.isfinite(seen.bar)):
            return None
        held = seen.ahead_of(self._check.local(middle))
        answer = self._watch.rests.near(lowest, seen.load, held, seen.time)
        if answer is None or not answer.converged:
            return None
        near = self._check.apart(answer.positions, held) <= allowed
        now = step.time, step.time + step.dt * bool(self._check.contacts), step.load
        entering = memory | {"since": np.zeros(1), "ahead": np.zeros(1)}
        stays = near and self._predicted_switch(0, MotionState(x, v), entering, now) is None
        return seen if stays else None
