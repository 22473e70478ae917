"""Wall times of computations and of the parts of a solver."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Wall time since construction [s]."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def __call__(self) -> float:
        """Seconds so far."""
        return time.perf_counter() - self._start


class Timings(dict[str, float]):
    """Seconds spent in each part of a solver."""

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time spent inside to ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self[name] = self.get(name, 0.0) + time.perf_counter() - start

    def since(self, before: dict[str, float]) -> dict[str, float]:
        """Times added since the copy ``before`` was made; other threads may add concurrently."""
        return {name: seconds - before.get(name, 0.0) for name, seconds in list(self.items())}
