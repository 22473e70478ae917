"""When the states of a level are checked, and what checks have found."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.state import MotionState
from modalshell.models.auto.at_rest import AtRest
from modalshell.models.auto.checks import Check, HeldCheck
from modalshell.models.auto.drift import Drift
from modalshell.models.auto.levels import Level
from modalshell.models.auto.loads_ahead import Coming, LoadsAhead
from modalshell.models.auto.trusted import EVERY, RARER, ROOMY, SELDOM, SPACIOUS, TIGHT, KnownStates, room
from modalshell.models.base.setup import MotionSetup
from modalshell.statics.error_bar import LARGEST_BAR, LEAST_MARGIN, ErrorBar

SWITCH = 0.5
"""Bar over the error allowed from which a rung is left."""
FRAMES = 3
"""Frames of a check."""
_GROWN, _CALM = 1.5, 0.02
"""Factor of a displacement on that of the last check from which a modal rung is checked at once, and the root of its
mean square, in sizes of the shell, up to which it may wait."""
_ROUNDING = 1e-9
"""Relative difference of factors of loads that is rounding."""
_ANSWERED = 0.9
"""Least length of the modes' answer to a load that they answer, over that of the whole linear answer."""
_ALIKE = 1.2
"""Factor of the modal answer to a load on the linear one at the last look, up to which it is alike."""


class Step(NamedTuple):
    """A step of a level.

    The level, its own states before and after, the last three frames (n, 3) [m], what finds the velocities at the last
    one, how far that has moved [kg^(1/2) m], its time [s], the step [s] and the dead load (n, 3) [N].
    """

    level: int
    inner: MotionState
    after: MotionState
    frames: tuple[Array, Array, Array]
    velocities: Callable[[], Array]
    moved: float
    time: float
    dt: float
    load: Array


class Seen(NamedTuple):
    """What a check found.

    The bar over the largest displacement, the margin, the load (n, 3) [N] in balance, the positions (n, 3) [m] that
    the bar's steps lead to, the time [s], by what (n, 3) [m] the shape that rests under the load is ahead of those, and
    why contacts keep it from being found, if they do.
    """

    bar: float
    margin: float
    load: Array
    corrected: Array
    time: float
    ahead: Array | None = None
    unjudged: str = ""

    @property
    def resting(self) -> Array:
        """Positions (n, 3) [m] at which the shell would rest under the load, by the bar's steps."""
        return self.ahead_of(self.corrected)

    def ahead_of(self, x: Array) -> Array:
        """Positions (n, 3) [m] with the stresses that the motion has at x (n, 3) [m]."""
        return x if self.ahead is None else x + self.ahead

    @property
    def alarm(self) -> bool:
        """Whether the stability margin has failed."""
        return not self.margin > LEAST_MARGIN


@final
class Watch:
    """Checks the states of one motion of the model that switches itself: where they are new, after ``every`` steps.

    ``rests`` finds where levels rest.
    """

    def __init__(self, model: Any, setup: MotionSetup, check: Check, loads: LoadsAhead) -> None:
        self._model, self._check, self._loads = model, check, loads
        # Another shape flies elsewhere: a free one is checked as soon as three frames are its own, and so on.
        every = EVERY if model.check_every is None else model.check_every
        self.every = min(every, FRAMES) if check.least else every
        self._touches = bool(check.contacts)  # what touches decides of the bar, too: no state vouches for others
        self._fixed = bool(check.least or model.check_every is not None or self._touches)
        self._states, self._damping = KnownStates(loads.count), setup.damping
        self._size = 2 * model.count + loads.count
        # Free parts turn, and what touches acts on the errors, too: of neither is known how they add up.
        self._drift = None if check.least or self._touches else Drift(model.basis, setup.damping)
        self.rests = AtRest(model, check, loads)
        self._calm = _CALM * model.shell.mesh.extent * float(np.sqrt(model.shell.mass.sum()))

    @property
    def _allowed(self) -> float:
        return float(SWITCH * self._model.error)

    def fitted(self, state: MotionState) -> MotionState:
        """The state of a start, with room for what is known of states under these loads."""
        state.memory["known"] = self._states.nothing(self._size)
        if self._check.sampled is not None:
            state.memory["agreed"] = self._check.sampled.nothing()
        state.memory["barred"][list(self._unfit)] = 1.0
        if self._drift is not None:
            state.memory["drift"] = self._drift.none
        return state

    @property
    def _unfit(self) -> tuple[int, ...]:
        """Levels that are never taken: coarse ones that are wrong from the beginning, with contacts all coarse ones."""
        found: tuple[int, ...] = self._model.coarse_levels if self._touches else self._model.unfit
        return found

    @property
    def first_levels(self) -> list[int]:
        """Levels below the last on which a motion may begin."""
        last = 1 if self._check.least else len(self._model.levels) - 1
        return [level for level in range(last) if level not in self._unfit]

    def fit(self, memory: dict[str, Array], dead: Array) -> None:
        """Make room for what is known of states, and forget it where it is of other loads than these."""
        if memory["dead"] is dead:  # as it was in the step before
            return
        if memory["known"].shape[1] != self._size:
            memory["known"] = self._states.nothing(self._size)
        if self._drift is not None and (memory["drift"].shape[1] != self._model.count or not memory["drift"].any()):
            memory["drift"] = self._drift.none
        if not np.array_equal(memory["dead"], dead):
            self.forget(memory, sampled=True)
        memory["dead"] = dead

    def forget(self, memory: dict[str, Array], *, sampled: bool = False) -> None:
        """Forget what is known of states, of full levels and if asked also how right the coarse shell is."""
        memory["known"], memory["seldom"] = np.zeros_like(memory["known"]), np.full(1, float(SELDOM))
        if self._drift is not None:
            memory["drift"] = self._drift.forgotten(memory["drift"])
        full = not self._model.levels[int(memory["level"][0])].quadratic
        if self._check.sampled is not None and (sampled or full):
            memory["agreed"] = self._check.sampled.nothing()

    def due(self, step: Step, memory: dict[str, Array]) -> bool:
        """Whether a modal rung is to be checked: when its turn comes, or it has moved on; in known states seldom."""
        since = memory["since"].item()
        if since < FRAMES and memory["switches"].item() > 0.0:
            return False  # frames of two levels differ by what a fit lacks, which would count as an acceleration
        if self._touches and since - memory["looked"].item() >= self.every:
            return True
        if not (since % self.every == 0.0 or step.moved > _GROWN * max(memory["checked"].item(), self._calm)):
            sudden = self._loads.change and not self._fixed
            return sudden and self._states.is_sudden(memory["known"], self._loads.values(step.time))
        if self._fixed:
            return True
        late = since - memory["looked"].item() >= memory["seldom"].item()
        return late or not self._states.holds(memory["known"], self._state(step.after, step.time))

    def drifted(self, step: Step, memory: dict[str, Array]) -> float:
        """How far the motion is off [kg^(1/2) m] after a step by what has added up; see :mod:`.drift`."""
        drift, rows = self._drift, memory["drift"]
        if drift is None or rows is drift.none:
            return 0.0
        power = self._power(step)
        known = power == 3 or rows[3].any()
        q = self._coordinates(step.level, step.after, step.frames[2]) if known else rows[4]
        memory["drift"], off = drift.advanced(rows, q, step.dt, power)
        return off

    def drift(self, memory: dict[str, Array]) -> float:
        """The same without a step."""
        return 0.0 if self._drift is None else self._drift.size(memory["drift"])

    def corrected(self, step: Step, seen: Seen, memory: dict[str, Array], wanted: int) -> Array:
        """Positions (n, 3) [m] after a step for the level that is to take over.

        For one of DS those of modes are corrected by the check, as far as errors have followed what it finds: those of
        a motion that the level has just begun have not.
        """
        x, levels = step.frames[2], self._model.levels
        full = levels[step.level].quadratic and not levels[wanted].quadratic
        if self._drift is None or not full or seen.alarm or not seen.bar <= LARGEST_BAR:
            return x
        return np.asarray(x + self._drift.share(memory["drift"]) * (seen.corrected - step.frames[1]))

    def undrifted(self, motion: tuple[Array, Array], memory: dict[str, Array]) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and velocities (n, 3) [m/s] without what has added up.

        It is still remembered: it is no more than a scale.
        """
        (x, v), rows, modes = motion, memory["drift"], self._model.basis.modes
        return x + (modes @ rows[0]).reshape(-1, 3), v + (modes @ rows[1]).reshape(-1, 3)

    def _coordinates(self, level: int, inner: MotionState, x: Array) -> Array:
        """Coordinates (m,) of a level's state at x (n, 3) [m]: of modes their own, as these need no projection."""
        assert self._drift is not None
        return inner.coordinates if self._model.levels[level].quadratic else self._drift.coordinates(x)

    def _power(self, step: Step) -> int:
        """Of the displacement, by which a level's errors grow."""
        return 3 if self._model.levels[step.level].quadratic else 1

    def seen(self, step: Step, memory: dict[str, Array]) -> Seen:
        """The check of the middle one of a step's three frames, the last of them at the present time."""
        seen = self._seen(step, memory)
        even = memory["step"][0] == step.dt
        if self._drift is not None and even and step.level + 1 < len(self._model.levels):
            rows, found = memory["drift"], (step.frames, seen.corrected)
            first = memory["switches"][0] > 0.0 and not rows[3:].any()
            at = (
                self._coordinates(step.level, step.inner, step.frames[1]),
                self._coordinates(step.level, step.after, step.frames[2]),
            )
            memory["drift"] = self._drift.checked(rows, found, at, step.dt, self._power(step), first=first)
        return seen

    def _seen(self, step: Step, memory: dict[str, Array]) -> Seen:
        middle = step.time - step.dt
        times = np.array([middle - memory["step"][0], middle, step.time])
        largest = float(max(memory["largest"][0], self._check.least))
        if self._check.sampled is not None and largest > 0.0 and self._model.levels[step.level].quadratic:
            return self._sampled(self._check, step, times, memory, largest)
        bar, load, ahead = self._check.bar_under(times, np.stack(step.frames), step.load)
        off = self._check.off(bar, step.frames[1])
        share = off / largest if largest > 0.0 else float(off > 0.0)
        return Seen(share, bar.margin, load, bar.corrected, middle, ahead, self._check.unjudged)

    def _sampled(self, check: HeldCheck, step: Step, times: Array, memory: dict[str, Array], largest: float) -> Seen:
        """The same of a modal level, on the coarse shell where that serves: where its bar leaves room at its worst."""
        sampled, x, known = check.sampled, step.frames[1], memory["agreed"]
        assert sampled is not None
        load, ahead = check.load_under(times, np.stack(step.frames), step.load)
        allowed, inner = self._allowed * largest, step.inner
        strained = inner.coordinates + self._damping.stiffness_factor * inner.rates
        found = sampled.found(x, strained, load, ahead)
        if found is not None and sampled.trusts(known, step.moved):
            off, margin = sampled.surely(found, known)
            if off <= allowed and margin > LEAST_MARGIN:
                memory["agreed"] = known + np.array([0.0, 0.0, 1.0])
                return Seen(off / largest, margin, load, x + found.added, times[1], ahead)
        bar = check.static(x, load, ahead=ahead)
        memory["agreed"] = sampled.compared(found, bar, x, step.moved, allowed, known)
        return Seen(check.off(bar, x) / largest, bar.margin, load, bar.corrected, times[1], ahead)

    def checked(self, step: Step, memory: dict[str, Array]) -> Seen:
        """The check of a modal level; :meth:`learn` says what it tells of states."""
        seen = self.seen(step, memory)
        if not seen.unjudged:  # else it is looked at again in the next step
            memory["checked"], memory["looked"] = np.array([step.moved]), memory["since"]
        return seen

    def learn(self, step: Step, seen: Seen, memory: dict[str, Array]) -> None:
        """Know the state of a modal level's check from then on if it has room; else know none as large."""
        if self._fixed:
            return
        z, largest = self._state(step.inner, step.time - step.dt), float(memory["largest"][0])
        moved = min(1.0, math.hypot(*step.inner.coordinates.tolist()) / largest) if largest > 0.0 else 1.0
        wider = room(seen.bar, seen.margin, self._allowed, moved)
        if not wider >= TIGHT:
            memory["known"], memory["seldom"] = (
                self._states.shrunk(memory["known"], z, wider),
                np.full(1, float(SELDOM)),
            )
            return
        rarer = RARER if wider < SPACIOUS else RARER**2
        wider = wider if wider >= ROOMY else 1.0
        if self._states.holds(memory["known"], z):
            memory["seldom"] = rarer * memory["seldom"]
        memory["known"] = self._states.grown(memory["known"], z, wider, largest)

    def first_bar(
        self, level: Level, dead: Array, load: Coming, memory: dict[str, Array], time: float
    ) -> ErrorBar | None:
        """The bar of a modal level's statics under a load, where that is void or too large; None where it holds.

        The first time the largest loads that are known to come are taken, if their statics hold with some room. A bar
        beyond 30 % is too large; before the level's first check can look, which takes three frames, one beyond what a
        check allows: a load that acts at once has then left energy that the next level would keep. None is looked for
        where checks vouch for the linear answer to the load.
        """
        if not self._fixed and self._is_vouched_for(load, memory):
            memory["ahead"] = np.array([load.whole])
            return None
        if memory["ahead"][0] == 0.0 and not self._fixed:
            coming = self._loads.coming(dead)
            most = self._loads.most(dead)
            if len(coming) == 1 and np.allclose(load.factors, coming[0].factors, rtol=_ROUNDING, atol=0.0):
                load = coming[0]  # so that rounding does not leave a larger one to come
            if load.whole < most < math.inf and all(self._bar(level, one, memory, ROOMY) is None for one in coming):
                memory["ahead"] = np.array([most])
                return None
        return self._bar(level, load, memory, 1.0 if memory["since"][0] < FRAMES else 0.0, time)

    def _is_vouched_for(self, load: Coming, memory: dict[str, Array]) -> bool:
        """Whether the state of rest of the modes' linear answer to a load is known, if modes answer that load.

        One along a sheet may buckle it, and moves no mode.
        """
        q = self._model.answered_by_modes(load.force)
        if not math.sqrt(q @ q) >= _ANSWERED * load.whole:
            return False
        return self._states.holds(memory["known"], np.concatenate([q, np.zeros_like(q), load.factors]))

    def _bar(
        self, level: Level, load: Coming, memory: dict[str, Array], least: float = 0.0, time: float = 0.0
    ) -> ErrorBar | None:
        """The same of one load, whose statics must leave ``least`` room; if that is some, its state is known.

        With contacts it rests outside the colliders as they are at ``time`` [s], unless they are where the shell was.
        """
        memory["ahead"] = np.array([load.whole])
        if self._touches:
            answer = self.rests.touching(level, load.force, time)
            if answer is None:
                return None
            found, bar = answer
        else:
            rests = self.rests.of(level, load.force, memory["dead"], self._allowed)
            found, bar = rests.found, rests.bar
            if "agreed" in memory:
                memory["agreed"] = self.rests.agreed(rests, self._allowed, memory["agreed"])
        wider = room(bar.displacement, bar.margin, self._allowed)
        if not (found.converged and bar.valid and not bar.beyond and wider >= least):
            return bar
        if self._fixed or found.coordinates is None:
            return None
        z = np.concatenate([found.coordinates, np.zeros_like(found.coordinates), load.factors])
        if not wider >= (ROOMY if self._loads.change else TIGHT):  # a load that grows has more to come
            memory["known"] = self._states.shrunk(memory["known"], z, wider)
        else:
            largest = max(float(memory["largest"][0]), self._check.moved(found.positions))
            wider = wider if wider >= ROOMY else 1.0
            memory["known"] = self._states.swinging(memory["known"], z, wider, largest)
        return None

    def is_alike(self, state: MotionState, memory: dict[str, Array], time: float) -> bool:
        """Whether the load need not be looked at in a modal level's state: it is about that looked at last."""
        if self._fixed or memory["ahead"][0] == 0.0 or memory["since"][0] % self.every == 0.0:
            return False
        pushed = self._model.inner(state)[1].memory["force"] * self._model.periods**2
        alike = math.sqrt(pushed @ pushed) <= _ALIKE * memory["felt"][0]
        return bool(alike and not self._states.is_sudden(memory["known"], self._loads.values(time)))

    def _state(self, inner: MotionState, time: float) -> Array:
        """What the bar of a held modal level is a function of: coordinates, rates over frequencies, loads' factors."""
        return np.concatenate([inner.coordinates, inner.rates * self._model.periods, self._loads.values(time)])
