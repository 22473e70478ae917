"""Advice: the cheapest model that meets an error and a frame rate, from measurements."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from modalshell.compare.candidates import MODES
from modalshell.compare.case import Case
from modalshell.compare.path import Snap
from modalshell.compare.report import html_table
from modalshell.compare.runs import Measurement
from modalshell.compare.tradeoff import LOADS, Tradeoff, tradeoff
from modalshell.core.checks import checked_number
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import brief
from modalshell.core.typing import Progress
from modalshell.files.atomic_io import write_text
from modalshell.mesh import TriangleMesh
from modalshell.render import Picture, html_of
from modalshell.scene import Scene
from modalshell.scene.write import toml_table, write_scene_with
from modalshell.shell import Shell

NEAR_TIE = 1.25
"""Counted costs of frames within this factor of the cheapest are ties, which go to the simplest rung."""
RATE_MARGIN = 1.2
"""Least measured frame rate over the requested one for a model to count as fast enough: times scatter by this much."""

_WORDS: dict[str, str] = {Outcome.STOPPED: "its static answers cost many times those of DS"}
"""Outcomes of static answers that a reader of advice would not understand."""


@brief
@dataclass(frozen=True)
class Advice:
    """Which rung to take.

    Attributes
    ----------
    chosen : Measurement or None
        The simplest rung among those that meet both demands at nearly the cheapest frame; None if none does.
    error, frames_per_second : float
        The requested error and frame rate.
    refused : dict
        Measured models that may not be chosen, with the reasons.
    measured : Tradeoff
        All that was measured.
    explanation : str
        Explanation of the choice, as text.
    """

    chosen: Measurement | None
    error: float
    frames_per_second: float
    refused: dict[str, str]
    measured: Tradeoff = field(repr=False)
    explanation: str

    @property
    def rows(self) -> list[Measurement]:
        """Everything that was measured, cheapest frame first."""
        return self.measured.rows

    @property
    def snap(self) -> Snap | None:
        """Where DS leaves its branch within the load range, if it does."""
        return self.measured.path.snap

    @property
    def model_table(self) -> dict[str, Any] | None:
        """The ``[model]`` table that runs the chosen rung; None where none is chosen or no scene can name it."""
        return None if self.chosen is None else self.chosen.candidate.model_table

    @property
    def margin(self) -> tuple[float, float] | None:
        """Requested error over the chosen model's worst error, and its frame rate over the requested one."""
        if self.chosen is None:
            return None
        error = _error(self.chosen)
        return (self.error / error if error else float("inf"), self.chosen.frames_per_second / self.frames_per_second)

    def plot(self) -> Picture:
        """Draw the measurements: error over milliseconds per frame."""
        return self.measured.plot()

    def _repr_html_(self) -> str:
        picture = html_of(f"Advice for {self.measured.case.name}", {}, self.plot(), text=self.explanation)
        return picture + html_table(self.measured.table())

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the measurements and ``NAME_advice.md`` into ``folder``; return the paths."""
        name = self.measured.case.name
        page = f"# {name}\n\n{self.explanation}\n\n{self.measured.table()}\n"
        return [*self.measured.save(folder), write_text(Path(folder) / f"{name}_advice.md", page)]

    def write_scene(self, scene: str | os.PathLike[str], out: str | os.PathLike[str]) -> Path:
        """Write the scene of a file to ``out`` with the chosen model; OptionError if none was chosen."""
        if self.model_table is None:
            raise OptionError(f"no scene to write: {self.explanation.splitlines()[0]}")
        return write_scene_with(Path(scene), out, self.model_table)


def advise(
    scene: Scene | Shell | Case | str | os.PathLike[str],
    *,
    error: float = 0.02,
    fps: float = 60.0,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    coarse: Sequence[TriangleMesh] = (),
    modes: Sequence[int] = MODES,
    loads: Sequence[float] = LOADS,
    on_step: Progress | None = None,
) -> Advice:
    """Find the cheapest model and mode count that meet an error and a frame rate on a scene.

    Every rung that the scene allows is run: static answers over the load range against DS, and frames of motion. Rungs
    are ranked by the counted work of a frame, the same on every machine; of those within :data:`NEAR_TIE` of the
    cheapest the simplest is taken. Time counts only against ``fps``, by the margin :data:`RATE_MARGIN`. Where DS snaps,
    rungs whose elastic energy is quadratic in modes are refused whatever they measure, and the others must also meet
    the error just below and just above the load of the snap (by half a per cent): most snap too early or too late,
    and answer with the wrong branch at loads in between.

    Parameters
    ----------
    scene : Scene, path or Shell
        As for :func:`modalshell.tradeoff`.
    error : float
        Largest displacement error against DS over the load range, next to a snap too, relative to how far DS moves.
    fps : float
        Frame rate [1/s] on this machine; a model must reach :data:`RATE_MARGIN` times as much.
    gravity, force, coarse, modes, loads, on_step : optional
        As for :func:`modalshell.tradeoff`.

    Returns
    -------
    Advice
        The advice, with all measurements.

    Raises
    ------
    OptionError
        If ``error`` or ``fps`` is not above 0, and as :func:`modalshell.tradeoff` does.
    SolverError
        As :func:`modalshell.tradeoff` does.
    """
    wanted = checked_number("error", error, above=0.0)
    rate = checked_number("fps", fps, above=0.0, unit="1/s")
    measured = tradeoff(scene, gravity=gravity, force=force, coarse=coarse, modes=modes, loads=loads, on_step=on_step)
    return choose(measured, wanted, rate)


def choose(measured: Tradeoff, error: float, fps: float) -> Advice:
    """The advice that follows from measurements."""
    refused = refusals(measured)
    allowed = [row for row in measured.rows if row.label not in refused and row.worst_error is not None]
    fitting = [row for row in allowed if _error(row) <= error and row.frames_per_second >= RATE_MARGIN * fps]
    ties = [row for row in fitting if row.cost <= NEAR_TIE * fitting[0].cost]
    chosen = min(ties, key=lambda row: (row.candidate.spec.cost, row.cost), default=None)
    text = _chosen_text(chosen, error, fps) if chosen else _none_text(allowed, error, fps)
    cheaper = measured.rows[: measured.rows.index(chosen)] if chosen else measured.rows
    if chosen is not None and (table := chosen.candidate.model_table) is not None:
        text += ["", "In a scene:", "", "```toml", toml_table("model", table), "```", ""]
    text += _faults([row for row in cheaper if row not in ties], refused, error)
    if also := [row.label for row in ties if row is not chosen]:
        text.append(f"- Within {100 * (NEAR_TIE - 1):.0f} % of the same work, but less simple: {'; '.join(also)}.")
    return Advice(chosen, error, fps, refused, measured, "\n".join([*text, "", *_measured_text(measured)]))


def refusals(measured: Tradeoff) -> dict[str, str]:
    """Models that may not be chosen, with the reasons."""
    refused: dict[str, str] = {}
    for row in measured.rows:
        if row.missed:
            wrong = [status for status in row.statuses if status != "converged"]
            refused[row.label] = _WORDS.get(wrong[0], wrong[0]) if wrong else f"its motion {row.motion}"
        elif row.candidate.spec.quadratic and measured.path.snap is not None:
            refused[row.label] = "the shell snaps, which an elastic energy quadratic in rest modes cannot"
    return refused


def _error(row: Measurement) -> float:
    """Largest error at all loads, those next to a snap included."""
    return float("inf") if row.worst_error is None else max(row.worst_error, row.near_error or 0.0)


def _chosen_text(row: Measurement, error: float, fps: float) -> list[str]:
    worst = _error(row)
    accuracy = "is the truth here" if row.is_truth else f"is at most {100 * worst:.2g} % off DS"
    margin = "" if worst == 0.0 else f" (asked {100 * error:.3g} %: {error / worst:.2g} times better)"
    rate = row.frames_per_second
    return [
        f"Take {row.label}: it {accuracy}{margin} and makes {rate:.3g} frames a second (asked {fps:g}: "
        f"{rate / fps:.2g} times faster), after {row.preprocessing:.2g} s of preprocessing.",
        *([f"Its motion: {row.motion}."] if row.motion != Outcome.COMPLETED else []),
    ]


def _none_text(allowed: list[Measurement], error: float, fps: float) -> list[str]:
    text = [
        f"No rung meets both an error of {100 * error:.3g} % and {fps:g} frames a second on this machine, "
        f"with a margin of {100 * (RATE_MARGIN - 1):.0f} % in the rate."
    ]
    accurate = [row for row in allowed if _error(row) <= error]
    if accurate:
        text.append(f"As accurate, the cheapest is {accurate[0].label}: {accurate[0].frames_per_second:.3g} a second.")
    fast = sorted((row for row in allowed if row.frames_per_second >= RATE_MARGIN * fps), key=_error)
    if fast:
        text.append(f"As fast, the most accurate is {fast[0].label}: {100 * _error(fast[0]):.3g} % off DS.")
    return text


def _faults(rows: list[Measurement], refused: dict[str, str], error: float) -> list[str]:
    """Why ``rows`` were not taken, those with one reason on one line."""
    text = []
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.label in refused:
            reasons.setdefault(refused[row.label], []).append(row.label)
    text += [f"- Refused, since {reason}: {'; '.join(labels)}." for reason, labels in reasons.items()]
    allowed = [row for row in rows if row.label not in refused]
    away = [row for row in allowed if row.worst_error is not None and row.worst_error <= error < _error(row)]
    wrong = [row for row in allowed if _error(row) > error and row not in away]
    if off := [f"{row.label} ({100 * _error(row):.3g} %)" for row in wrong]:
        text.append(f"- Not accurate enough: {'; '.join(off)}.")
    if near := [f"{row.label} ({_near_text(row)})" for row in away]:
        text.append(f"- Accurate enough at the other loads, but not next to the snap: {'; '.join(near)}.")
    if slow := [f"{row.label} ({row.frames_per_second:.3g} a second)" for row in allowed if _error(row) <= error]:
        text.append(f"- Accurate, but too slow: {'; '.join(slow)}.")
    return text


def _near_text(row: Measurement) -> str:
    error, near = row.worst_error or 0.0, row.near_error or 0.0
    there = f"{100 * near:.3g} % there" if np.isfinite(near) else "without an answer there"
    return f"{100 * error:.3g} %, {there}"


def _spread(measured: Tradeoff) -> float:
    """Largest distance between two models' solutions under the whole load, over the length."""
    answers = [row.positions for row in measured.rows if row.converged and row.candidate.spec.pictured]
    size = measured.case.shell.size
    pairs = combinations(answers, 2)
    return max((float(np.linalg.norm(a - b, axis=1).max()) / size for a, b in pairs), default=0.0)


def _measured_text(measured: Tradeoff) -> list[str]:
    path, case = measured.path, measured.case
    shares = ", ".join(f"{path.factors[k]:g}" for k in path.known)
    text = [
        f"Measured: static answers of {len(measured.rows)} rungs at {shares} of the load against DS on the same mesh "
        f"({len(case.shell.rest_positions)} vertices), and frames of {1000 * case.dt:.3g} ms in motion: their "
        "counted work, the same on every machine, ranks the rungs; their median time is compared with the frame rate."
    ]
    text += [f"{case.told[0].upper()}{case.told[1:]}."] if case.told else []
    if unknown := [f"{path.factors[k]:g}" for k in range(len(path.factors)) if k not in path.known]:
        text.append(f"DS found no equilibrium at {', '.join(unknown)} of the load, which are left out of the errors.")
        if len(path.factors) - 1 not in path.known:
            text.append(f"Under the whole load the rungs' own answers differ by up to {_spread(measured):.2g} lengths.")
    if path.snap is not None:
        text.append(f"The shell {path.snap}.")
    if path.near:
        near = " and ".join(f"{factor:.4g}" for factor in path.near)
        text.append(f"Rungs that may snap were also compared next to it, at {near} of the load.")
    return text
