"""How many of numba's threads a sheet takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numba

from modalshell.checks import checked_count


def threads_for(count: int, each: int, threads: int | None) -> int:
    """Threads for ``count`` masses: one for every ``each``, at least one, at most ``threads`` or all of numba's."""
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if threads is not None:
        most = min(most, checked_count("threads", threads))
    return max(1, min(most, count // each))


@contextmanager
def limited_to(threads: int) -> Iterator[None]:
    """Let numba's parallel loops use so many threads inside."""
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        yield
    finally:
        numba.set_num_threads(before)
