"""Where levels of modes rest under loads that come, and how far from DS that is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, final

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.models.auto.checks import Check
from modalshell.models.auto.levels import Level
from modalshell.models.auto.loads_ahead import LoadsAhead
from modalshell.models.auto.sampled import SampledCheck
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.statics.error_bar import LEAST_MARGIN, ErrorBar

_KEPT = 4
"""Answers that are kept: of two levels to two loads."""
_ALIKE = 1e-9
"""Loads are alike whose linear answers' lengths differ by no larger part."""


def _under(level: Level, force: Array, start: Array | None = None, contacts: Sequence[Any] = ()) -> Equilibrium:
    """A level's own answer to a force (n, 3) [N]; LoadError for one that is not finite, as for such a ``start``."""
    shell = level.still.shell
    begin = None if start is None else shell.checked_positions(start)
    return level.still.solved(shell.loading(force=force), begin, contacts)


class Answer(NamedTuple):
    """Statics of a level under a force (n, 3) [N], and the bar of it."""

    level: Level
    force: Array
    found: Equilibrium
    bar: ErrorBar


@final
class AtRest:
    """Finds statics of modal levels and their bars, those of a large shell on its coarse one where that serves.

    How right that is for statics the first level tells once, under the largest load that is known to come, and not what
    fine checks have found on the way: a motion that resumes does not know which answers were kept. For the motion each
    fine bar of statics tells, which its state remembers.
    """

    def __init__(self, model: Any, check: Check, loads: LoadsAhead) -> None:
        self._model, self._check, self._loads = model, check, loads
        self._kept: list[Answer] = []
        self._largest: tuple[Array, Array, Answer | None] | None = None

    def near(self, level: Level, force: Array, start: Array | None, time: float) -> Equilibrium | None:
        """Where a level rests under a force (n, 3) [N], from ``start`` (n, 3) [m], outside the colliders at a time [s].

        None from a start inside one.
        """
        if not self._check.contacts:
            return _under(level, force, start)
        from modalshell.contact.contact import smooth, stopped  # not without contacts

        try:
            contacts = [smooth(stopped(contact, time)) for contact in self._check.contacts]
            return _under(level, force, start, contacts)
        except OptionError:
            return None

    def touching(self, level: Level, force: Array, time: float) -> tuple[Equilibrium, ErrorBar] | None:
        """The same from rest, and its bar."""
        found = self.near(level, force, None, time)
        return None if found is None else (found, self._check.static(found.positions, force, time))

    def of(self, level: Level, force: Array, dead: Array, allowed: float) -> Answer:
        """Where a level rests under a force (n, 3) [N], one of motions under a dead load (n, 3) [N], and its bar.

        ``allowed`` is the bar that is allowed.
        """
        for kept in self._known(dead, allowed):
            if kept.level is level and kept.force is force:
                return kept
        found = _under(level, force)
        bar = self._sampled(found, force, allowed) or self._check.static(found.positions, force)
        answer = Answer(level, force, found, bar)
        self._kept = [*self._kept[1 - _KEPT :], answer]
        return answer

    def agreed(self, answer: Answer, allowed: float, known: Array) -> Array:
        """What is known of coarse checks after an answer's bar, if that was found on the fine shell."""
        if self._check.sampled is None or answer.bar.on != "shell":
            return known
        return self._compared(self._check.sampled, answer, allowed, known)

    def _compared(self, sampled: SampledCheck, answer: Answer, allowed: float, known: Array) -> Array:
        """What is known after a fine bar of an answer."""
        _, force, found, bar = answer
        x, moved = found.positions, self._check.moved(found.positions)
        coarse = None if found.coordinates is None else sampled.found(x, found.coordinates, force)
        return sampled.compared(coarse, bar, x, moved, allowed * moved, known)

    def _known(self, dead: Array, allowed: float) -> Iterator[Answer]:
        """Answers that are known; that under the largest load is found here, as others ask how right the coarse is."""
        sampled = self._check.sampled
        if sampled is not None and (self._largest is None or self._largest[0] is not dead):
            self._largest = dead, sampled.nothing(), None
            coming = self._loads.coming(dead)
            if coming:
                # Of loads alike both ways the first, and not the one that rounding makes larger.
                most, level = self._loads.most(dead), self._model.levels[0]
                force = next(load.force for load in coming if load.whole >= (1.0 - _ALIKE) * most)
                found = _under(level, force)
                answer = Answer(level, force, found, self._check.static(found.positions, force))
                self._largest = dead, self._compared(sampled, answer, allowed, sampled.nothing()), answer
        if self._largest is not None and self._largest[2] is not None:
            yield self._largest[2]
        yield from self._kept

    def _sampled(self, found: Equilibrium, force: Array, allowed: float) -> ErrorBar | None:
        """The bar on the coarse shell at its worst; None where that is not trusted, or leaves no room."""
        sampled, x = self._check.sampled, found.positions
        if sampled is None or self._largest is None or found.coordinates is None:
            return None
        known, moved = self._largest[1], self._check.moved(x)
        if not sampled.trusts(known, moved):
            return None
        coarse = sampled.found(x, found.coordinates, force)
        if coarse is None:
            return None
        off, margin = sampled.surely(coarse, known)
        if not (off <= allowed * moved and margin > LEAST_MARGIN):
            return None
        return ErrorBar(off / moved, margin, 0.0, True, x + coarse.added, 0.0, on="coarse")
