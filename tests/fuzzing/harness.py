"""What every input must give in ten seconds of work: a finite answer, or a ModalShellError whose message is of use."""

from __future__ import annotations

import dataclasses
import faulthandler
import math
import re
import signal
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.strategies import SearchStrategy
from numba.core import event

from modalshell.core.errors import ModalShellError

LIMIT = 10.0
"""Seconds of processor time that one input may take."""
PATIENCE = 6.0
"""Wall time over the limit of processor time, for inputs that wait: a busy machine must not look like a hang."""
FEW = 300
"""Steps, and vertices of a mesh, beyond which an accepted scene counts as long work."""
_SHORTEST, _LONGEST = 20, 1500
_NAMES_SOMETHING = re.compile(r"['\"\d/]|\(got |, got |\S: | -")
"""A value, a path, an option, or the place of a fault before a colon."""
_EXPOSES_INNARDS = re.compile(r"Traceback|<[\w. ]+ object at 0x|\n\s+File ")


class FuzzFinding(AssertionError):
    """An input that gave neither a valid answer nor a refusal of use."""


class UncaughtException(FuzzFinding):
    """An exception that is no ModalShellError."""


class Hang(FuzzFinding):
    """An input that took longer than the limit."""


class SilentNonFinite(FuzzFinding):
    """An answer with a NaN or an infinity in it, given without a word."""


class UselessMessage(FuzzFinding):
    """A refusal that does not say what was got."""


class HalfRead(FuzzFinding):
    """A damaged file that was read as something else than what was written."""


class Escape(FuzzFinding):
    """A file written outside the folder that the user chose."""


class Destroyed(FuzzFinding):
    """A file of the user's that a command wrote over."""


class DirtyExit(FuzzFinding):
    """A command that ended otherwise than with status 0 or 1, or with status 2 and one line."""


class Contradiction(FuzzFinding):
    """Two answers that must be equal and are not."""


class Unsaid(FuzzFinding):
    """Something that must be said, and was not."""


class LongWork(Exception):
    """Raised out of accepted input that asks for much work, as it may: an answer, in bits that a suite has time for."""


class _Compilation(event.Listener):
    """Seconds of processor time and of wall time that numba has compiled in this process.

    An input that is the first to run a kernel compiles it, which says nothing of the input.
    """

    def __init__(self) -> None:
        self.worked = self.waited = 0.0
        self._begun: list[tuple[float, float]] = []

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002 - the signature of a listener
        self._begun.append((time.process_time(), time.perf_counter()))

    def on_end(self, event: event.Event) -> None:  # noqa: ARG002 - the signature of a listener
        worked, waited = self._begun.pop()
        if not self._begun:  # kernels that a kernel calls are compiled within it
            self.worked += time.process_time() - worked
            self.waited += time.perf_counter() - waited

    def seconds(self) -> tuple[float, float]:
        """So far, with the compilation that is under way."""
        worked, waited = self.worked, self.waited
        if self._begun:
            worked += time.process_time() - self._begun[0][0]
            waited += time.perf_counter() - self._begun[0][1]
        return worked, waited


_COMPILATION = _Compilation()
event.register("numba:compile", _COMPILATION)


class _Clock:
    """Processor time and wall time since it was made, without those of compilation."""

    def __init__(self) -> None:
        self._start = self._now()

    @staticmethod
    def _now() -> tuple[float, float]:
        worked, waited = _COMPILATION.seconds()
        return time.process_time() - worked, time.perf_counter() - waited

    def read(self) -> tuple[float, float]:
        return tuple(now - start for now, start in zip(self._now(), self._start, strict=True))  # type: ignore[return-value]


class _TimeUp(BaseException):
    """Raised by the timer; no Exception, so that ``except Exception`` does not take it for a damaged file."""


@dataclasses.dataclass
class Input:
    """One input: how to show it, and what to do with it."""

    text: str
    call: Callable[[], Any]

    def __repr__(self) -> str:
        return self.text if len(self.text) < 2000 else f"{self.text[:2000]}..."


def outcome(call: Callable[[], Any], limit: float = LIMIT) -> str:
    """``"answer"`` or ``"refused"``; a FuzzFinding for anything else."""
    clock = _Clock()
    answer, found = None, "answer"
    try:
        with warnings.catch_warnings(), _time_limit(limit):
            warnings.simplefilter("ignore")
            try:
                answer = call()
            except ModalShellError as error:
                check_message(str(error))
                found = "refused"
            except LongWork:
                pass
    except FuzzFinding:
        raise
    except _TimeUp:
        raise Hang(f"no answer within {limit:g} s of work and {PATIENCE * limit:g} s in all") from None
    except Exception as error:
        raise UncaughtException(f"{type(error).__name__}: {error}"[:500]) from error
    worked, waited = clock.read()
    if worked > limit or waited > PATIENCE * limit:  # native code, or something that swallowed the timer's exception
        raise Hang(f"{found} after {worked:.1f} s of work and {waited:.1f} s in all, above {limit:g} s of work")
    place = next(not_finite(answer), None)
    if place is not None:
        raise SilentNonFinite(f"the answer{place} is not finite")
    return found


def check_message(message: str) -> None:
    """UselessMessage for a message that is short, endless, names nothing, or shows the inside of the program."""
    if not _SHORTEST <= len(message) <= _LONGEST:
        raise UselessMessage(f"{len(message)} characters: {message[:200]!r}")
    if _EXPOSES_INNARDS.search(message) or not _NAMES_SOMETHING.search(message):
        raise UselessMessage(message)


def not_finite(value: Any, place: str = "", seen: set[int] | None = None) -> Iterator[str]:
    """Places in an answer, whatever it is made of, where a number is not finite."""
    seen = set() if seen is None else seen
    if isinstance(value, float | complex | np.inexact):
        if not np.isfinite(value):
            yield place or " itself"
        return
    if value is None or isinstance(value, str | bytes | int | np.generic | type) or id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "fc" and not np.isfinite(value).all():
            yield place or " itself"
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from not_finite(inner, f"{place}[{key!r}]", seen)
    elif isinstance(value, list | tuple | set | frozenset):
        for index, inner in enumerate(value):
            yield from not_finite(inner, f"{place}[{index}]", seen)
    elif type(value).__module__.split(".")[0] in ("modalshell", "scipy") and hasattr(value, "__dict__"):
        for name, inner in vars(value).items():
            if name == "residual" and getattr(value, "converged", True) is False:
                continue  # an answer that says of itself that it is none may be infinitely far off
            yield from not_finite(inner, f"{place}.{name}", seen)


class _time_limit:
    """Raises _TimeUp after ``seconds`` of work, or ``PATIENCE`` times as many in all.

    Where native code does not come back at all, it ends the process with a trace.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._timers = (
            (signal.ITIMER_PROF, signal.SIGPROF, seconds),
            (signal.ITIMER_REAL, signal.SIGALRM, PATIENCE * seconds),
        )

    def __enter__(self) -> None:
        self._clock = _Clock()
        self._before = [signal.signal(number, self._stop) for _, number, _ in self._timers]
        # Again and again: the first may fall into a callback that swallows every exception.
        for timer, _, seconds in self._timers:
            signal.setitimer(timer, seconds, 1.0)
        faulthandler.dump_traceback_later(math.ceil(6 * PATIENCE * self._seconds), exit=True)

    def __exit__(self, *_: object) -> None:
        for timer, _, _ in self._timers:
            signal.setitimer(timer, 0.0)
        faulthandler.cancel_dump_traceback_later()
        for (_, number, _), before in zip(self._timers, self._before, strict=True):
            signal.signal(number, before)

    def _stop(self, *_: object) -> None:
        worked, waited = self._clock.read()
        if worked > 0.99 * self._seconds or waited > 0.99 * PATIENCE * self._seconds:  # else it compiled kernels
            raise _TimeUp


def few_steps(done: int, _total: int) -> None:
    """A callback of steps that ends long runs: 1e9 steps are allowed, and no hang."""
    if done >= FEW:
        raise LongWork


def fuzz(
    inputs: SearchStrategy[Input],
    count: int,
    *,
    limit: float = LIMIT,
    random_seed: int | None = None,
    shrink: bool = True,
) -> Counter[str]:
    """Try ``count`` inputs; the first finding is shrunk and raised. Returns how many were answered and refused."""
    counts: Counter[str] = Counter()

    @settings(
        max_examples=count,
        derandomize=random_seed is None,
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink) if shrink else (Phase.generate,),
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )
    @given(inputs)
    def attempt(case: Input) -> None:
        counts[outcome(case.call, limit)] += 1

    (attempt if random_seed is None else seed(random_seed)(attempt))()
    return counts
