"""Advice by error bars alone: which model serves a scene at rest, without an answer of DS."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from modalshell.compare.candidates import MODES, Candidate, candidates, case_factory
from modalshell.compare.case import Case, make_case
from modalshell.compare.tradeoff import LOADS, checked_counts, checked_factors
from modalshell.core.checks import checked_callback, checked_number
from modalshell.core.errors import ModalShellError
from modalshell.core.short_repr import short_repr
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Progress
from modalshell.models.error_bars import error_bar
from modalshell.models.registry import TRUTH, models
from modalshell.scene import Scene
from modalshell.scene.write import write_scene_with
from modalshell.shell import Shell
from modalshell.statics.error_bar import ErrorBar, share_as_text


@short_repr
@dataclass(frozen=True)
class BarRow:
    """One rung and its bars."""

    candidate: Candidate
    bars: list[ErrorBar] = field(repr=False)
    """One for each load; fewer where a bar was void, for the loads beyond are then void as well."""
    seconds: float
    """Time of its modes, answers and bars."""

    @property
    def largest(self) -> float:
        """The largest bar; infinite where one is void."""
        return max((bar.displacement if bar.valid else np.inf for bar in self.bars), default=np.inf)


@short_repr
@dataclass(frozen=True)
class QuickAdvice:
    """Which rung to take at rest, by error bars.

    Attributes
    ----------
    chosen : Candidate
        The simplest rung whose bars all hold and are at most the error; DS if there is none.
    error : float
        The requested error.
    rows : list of BarRow
        The rungs that were tried, simplest first, up to the chosen one.
    snap : float or None
        Share of the load at which the shell is expected to leave its branch; None where nothing predicts one up to
        twice the load.
    explanation : str
        Explanation of the choice, as text.
    """

    chosen: Candidate
    error: float
    rows: list[BarRow] = field(repr=False)
    snap: float | None
    explanation: str

    @property
    def model_table(self) -> dict[str, Any] | None:
        """The ``[model]`` table that runs the chosen rung."""
        return self.chosen.model_table

    def write_scene(self, scene: str | os.PathLike[str], out: str | os.PathLike[str]) -> Path:
        """Write the scene of a file to ``out`` with the chosen model."""
        return write_scene_with(Path(scene), out, self.chosen.model_table or {"name": TRUTH})


_FAR = 2.0
"""Multiples of the load up to which a snap is named."""


def quick_advice(
    scene: Scene | Shell | Case | str | os.PathLike[str],
    *,
    error: float = 0.02,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    modes: Sequence[int] = MODES,
    loads: Sequence[float] = LOADS,
    on_step: Progress | None = None,
) -> QuickAdvice:
    """Find the simplest modal model that meets an error at rest, by error bars instead of answers of DS.

    Seconds where :func:`advise` takes minutes: nothing is trained, no frame is timed, and the search ends at the first
    rung whose bars (:class:`modalshell.ErrorBar`) hold at all loads and are small enough. Where a stability margin has
    failed the shell may snap, which no rung that is quadratic about rest knows: DS is named.

    Parameters
    ----------
    scene : Scene, Case, path or Shell
        As for :func:`modalshell.tradeoff`.
    error : float
        Largest displacement error against DS over the load range, relative to how far DS moves.
    gravity, force, modes, loads, on_step : optional
        As for :func:`modalshell.tradeoff`.

    Returns
    -------
    QuickAdvice
        The advice, with all bars.

    Raises
    ------
    OptionError
        If ``error`` is not above 0 and at most 1, and as :func:`modalshell.tradeoff` does.
    """
    on_step = checked_callback("on_step", on_step)
    wanted = checked_number("error", error, above=0.0, at_most=1.0)
    case = make_case(scene, gravity, force, ())
    factors = checked_factors(loads)
    factory, rows = case_factory(case), list[BarRow]()
    tried = [one for one in candidates(case, checked_counts(modes))[0] if one.spec.needs == "basis"]
    truth = Candidate(models()[TRUTH])
    chosen = truth
    while tried:
        candidate = tried.pop(0)
        row = _bars(candidate, case, factory, factors)
        rows.append(row)
        on_step(len(rows), len(rows) + len(tried))
        if row.largest <= wanted:
            chosen = candidate
            break
        if row.largest == np.inf:  # as the shell's own margin has failed: what the most exact rung says will do
            tried = tried[-1:]
    snap = _snap(case, rows[-1].bars, factors)
    return QuickAdvice(chosen, wanted, rows, snap, _explanation(chosen, rows, snap, wanted, chosen is truth))


def _bars(candidate: Candidate, case: Case, factory: Any, factors: Sequence[float]) -> BarRow:
    """The bars of one rung up to the first that is void."""
    watch, bars = Stopwatch(), list[ErrorBar]()
    try:
        model = candidate.build(factory)[0]
        for factor in factors:
            bar = model.equilibrium(**case.statics(factor), bar=True).bar
            assert bar is not None
            bars.append(bar)
            if not bar.valid:
                break
    except ModalShellError as fault:
        why = case.units.restated(str(fault))
        bars.append(ErrorBar(np.inf, -np.inf, 0.0, False, case.shell.rest_positions, watch(), why))
    return BarRow(candidate, bars, watch())


def _snap(case: Case, bars: Sequence[ErrorBar], factors: Sequence[float]) -> float | None:
    """Share of the load at which the branch ends, where the last rung's bars predict one or are void.

    A bar past the end predicts it by a stress that is of another branch, up to ten times too low: it is walked to.
    """
    found = [factor * bar.critical_load for factor, bar in zip(factors, bars, strict=False) if not bar.message]
    near = found[-1] if found else np.inf
    if near >= 2.0 * _FAR and bars[-1].valid:
        return None
    with contextlib.suppress(ModalShellError):
        walked = error_bar(case.shell, case.shell.rest_positions, walk=True, **case.statics(1.0))
        near = walked.critical_load if walked.walked else near
    return near if near < _FAR else None


def _explanation(chosen: Candidate, rows: Sequence[BarRow], snap: float | None, error: float, none: bool) -> str:
    lines = []
    if none:
        asked = share_as_text(error)
        lines.append(f"Take {chosen.spec.name}: no modal rung is within {asked} of it over the load range.")
    else:
        lines.append(
            f"Take {chosen.label}: at rest it is within {share_as_text(rows[-1].largest)} of DS over the load range "
            f"({share_as_text(error)} asked)."
        )
    if snap is not None:
        lines.append(f"The shell is expected to leave its branch at about {snap:.2g} times the load.")
    for row in rows:
        worst = row.bars[-1] if row.bars and not row.bars[-1].valid else max(row.bars, key=lambda bar: bar.displacement)
        lines.append(f"* {row.candidate.label}: {worst}")
    return "\n".join(lines)
