"""Loads next to a snap between which a rung misses an error: it snaps under another load than DS, if only a little."""

from __future__ import annotations

from collections.abc import Callable

from modalshell.compare.case import Case
from modalshell.compare.path import LoadPath, Snap
from modalshell.compare.runs import Measurement, answer_error
from modalshell.core.typing import Array
from modalshell.models import DiscreteShell

NEAREST = 3e-4
"""Distance from a snap's load within which nothing is said of any rung but DS, relative to it."""
_HALVINGS = 4
"""Times that a distance from a snap is halved: from half a per cent to :data:`NEAREST`."""

Check = Callable[[float, Array], Array | None]
"""Of a share of the load, and where DS is nearby (n, 3): where DS is there, if the rung is right there; else None."""


def missed_loads(row: Measurement, case: Case, path: LoadPath, error: float) -> list[tuple[float, float]]:
    """Shares of the load, from one to another next to each snap, between which a rung may be more than ``error`` off.

    The rung meets the error at the loads where it was measured. From those next to a snap the loads at which it is
    compared with DS are brought nearer to the snap, by halves of the distance, as far as it meets the error.
    """
    if row.is_truth or row.model is None:
        return []
    model, truth = row.model, DiscreteShell(case.shell)

    def check(share: float, start: Array) -> Array | None:
        exact = truth.equilibrium(force=share * case.load, start=start)
        apart = answer_error(model.equilibrium(force=share * case.load), exact, case.shell)
        return exact.positions if apart is not None and apart <= error else None

    return [_around(snap, path, check) for snap in path.snaps]


def _around(snap: Snap, path: LoadPath, check: Check) -> tuple[float, float]:
    """The loads around one snap; the measured ones where it was not located."""
    answers = zip((*path.factors, *path.near), (*path.answers, *path.near_answers), strict=True)
    known = {share: answer.positions for share, answer in answers if answer.converged}
    low = max((share for share in known if share <= snap.low), default=0.0)
    high = min((share for share in known if share >= snap.high), default=path.factors[-1])
    if snap.stable is None:
        return low, high
    if low in known:
        low = _nearer(low, (1.0 - NEAREST) * snap.low, known[low], check)
    if high in known:
        high = _nearer(high, (1.0 + NEAREST) * snap.high, known[high], check)
    return low, high


def _nearer(right: float, nearest: float, start: Array, check: Check) -> float:
    """The share nearest to ``nearest`` at which a rung is right, from one where it is; DS is at ``start`` there."""
    wrong, tried = None, nearest
    for _ in range(1 + _HALVINGS):
        found = check(tried, start)
        if found is None:
            wrong = tried
        else:
            right, start = tried, found
        if wrong is None:
            break
        tried = 0.5 * (right + wrong)
    return right
