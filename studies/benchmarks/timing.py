"""Times of several functions that share one machine with others: taken in turn, so that all see the same weather."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from modalshell.core.errors import OptionError


def one_blas_thread() -> AbstractContextManager[object]:
    """BLAS on one thread within the context; OptionError where threadpoolctl is not installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError as error:
        raise OptionError(
            f"BLAS is timed on one thread by threadpoolctl: pip install threadpoolctl ({error})"
        ) from error
    limited: AbstractContextManager[object] = threadpool_limits(1)
    return limited


def interleaved(
    functions: dict[Any, Callable[[], object]],
    repeats: int = 15,
    sample_seconds: float = 1e-3,
    statistic: Callable[[list[float]], Any] = np.median,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[Any, float]:
    """Median seconds of one call of each function, or another ``statistic`` of the samples, by a ``clock``.

    The functions take turns ``repeats`` times. At its turn each is called once untimed, which brings the caches back to
    what its own calls leave there, and then as often as fills ``sample_seconds``, at least once: less than a time
    slice, so that on a machine with little else to do most samples are undisturbed. On a busy machine functions of one
    thread are better compared by the processor's time (``clock=time.process_time``): it stands still while others run.
    """
    calls = {}
    for name, function in functions.items():
        function()
        start = clock()
        function()
        calls[name] = max(1, round(sample_seconds / max(clock() - start, 1e-7)))
    samples: dict[Any, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            function()
            start = clock()
            for _ in range(calls[name]):
                function()
            samples[name].append((clock() - start) / calls[name])
    return {name: float(statistic(times)) for name, times in samples.items()}
