"""Thread count of a sheet: as requested, or measured during its own steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import final

import numba

from modalshell.core.checks import checked_count

_TRIALS = 6
"""Number of first steps, alternately on one thread and on all; the very first may load compiled code."""
_FIRST_WAIT, _LONGEST_WAIT = 16, 4096
"""Steps until the slower number of threads is tried again, which doubles as long as it stays the slower."""


@final
class ThreadChoice:
    """One thread or all of them, whichever took less time of late.

    Small sheets do not pay for threads, and on a machine whose processors are busy a step on all threads may take many
    times as long as on one: threads that wait for one that does not run cannot do better. The results of a sheet do
    not depend on its threads, so it may change them at will.

    Parameters
    ----------
    count, each : int
        Number of masses, and least number per thread.
    threads : int, optional
        Fixed number of threads; by default chosen, up to all of numba's.

    Attributes
    ----------
    most : int
        Threads at most.
    """

    def __init__(self, count: int, each: int, threads: int | None = None) -> None:
        present = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        if threads is None:
            self.most = max(1, min(present, count // each))
        else:
            self.most = min(present, checked_count("threads", threads))
        self._free = threads is None and self.most > 1
        self._seconds: dict[int, float] = {}
        self._trials, self._wait, self._left = _TRIALS, _FIRST_WAIT, _FIRST_WAIT

    @property
    def steps_left(self) -> int:
        """Steps until the next trial, at least one."""
        if not self._free:
            return _LONGEST_WAIT
        return 1 if self._trials > 0 else max(1, self._left)

    @contextmanager
    def steps(self, count: int = 1) -> Iterator[int]:
        """Context of ``count`` steps on the number of threads that it yields."""
        threads = self._next()
        begin = perf_counter()
        with limited_to(threads):
            yield threads
        if self._free:
            self._note(threads, (perf_counter() - begin) / count, count)

    def _best(self) -> int:
        return min(self._seconds, key=self._seconds.__getitem__)

    def _next(self) -> int:
        if not self._free:
            return self.most
        if self._trials > 0:
            return 1 if self._trials % 2 else self.most
        best = self._best()
        return best if self._left > 0 else 1 + self.most - best

    def _note(self, threads: int, seconds: float, count: int) -> None:
        if self._trials > 0:
            self._trials -= 1
            self._seconds[threads] = min(seconds, self._seconds.get(threads, seconds))
            return
        tried, best = self._left <= 0, self._best()
        self._seconds[threads] = seconds
        self._left -= count
        if tried:
            self._wait = _FIRST_WAIT if self._best() != best else min(2 * self._wait, _LONGEST_WAIT)
            self._left = self._wait


@contextmanager
def limited_to(threads: int) -> Iterator[None]:
    """Set the number of numba's threads inside the block."""
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        yield
    finally:
        numba.set_num_threads(before)
