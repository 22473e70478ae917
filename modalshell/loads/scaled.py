"""Loads times a factor that depends on time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from typing import final

from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_number, checked_times, checked_vectors
from modalshell.core.errors import LoadError
from modalshell.core.typing import Array
from modalshell.loads.applied import AppliedLoad
from modalshell.loads.base import Load
from modalshell.loads.body import constant_load
from modalshell.mesh import TriangleMesh


@final
class Scaled(Load):
    """Any load times a factor of time. In statics the time is 0.

    Parameters
    ----------
    load : Load
        The load.
    factor : callable, or (times, factors)
        ``factor(time)`` of the time [s]; or a table of increasing times [s] and the factors there, joined by straight
        lines and constant before and after. Where a table bends or jumps within steps, implicit rules, and modal and
        rigid models, take straight lines over these, which keep its impulse and when it comes (rules of order one
        take its means over steps); explicit rules do not.

    Raises
    ------
    OptionError
        If ``load`` is no load, or the times do not increase.
    LoadError
        For factors that are not finite or differ in number from the times.
    """

    def __init__(self, load: Load, factor: Callable[[float], float] | tuple[ArrayLike, ArrayLike]) -> None:
        self.load = checked_kind("load", load, Load)  # type: ignore[type-abstract]
        self._function: Callable[[float], float] | None = None
        if callable(factor):
            self._function = factor
        elif isinstance(factor, tuple) and len(factor) == 2:
            times = checked_times(factor[0])
            self._times: list[float] = times.tolist()
            self._factors: list[float] = checked_vectors("factors", factor[1], (times.size,)).tolist()
        else:
            raise LoadError(f"factor must be a function of time or a pair (times, factors) (got {factor!r})")

    def factor(self, time: float) -> float:
        """Factor at a time [s]; LoadError where a function gives no finite number."""
        if self._function is not None:
            return checked_number(f"the factor at {time:g} s", self._function(time), error=LoadError)
        return _between(time, self._times, self._factors)

    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N] of the shape at rest, at time 0."""
        return self.factor(0.0) * self.load.force(mesh)

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad:
        """The load with its factor."""
        applied = self.load.applied(mesh, mass)
        if applied is None:
            shape = mesh.vertices.shape
            applied = constant_load(
                mesh, checked_vectors(f"the force of {type(self.load).__name__}", self.load.force(mesh), shape)
            )
        if self._function is not None:
            return applied.scaled(self.factor, (0.0,))
        return applied.scaled(self.factor, tuple(self._times), tuple(self._times))


def _between(time: float, times: list[float], values: list[float]) -> float:
    """Value at a time by straight lines, as ``np.interp`` finds it, which takes ten times as long for one number."""
    k = bisect_right(times, time) - 1
    if k < 0:
        return values[0]
    if k == len(times) - 1 or times[k] == time:
        return values[k]
    return (values[k + 1] - values[k]) / (times[k + 1] - times[k]) * (time - times[k]) + values[k]
