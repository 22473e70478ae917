"""Advice: the cheapest model that meets an error and a frame rate, and the loads next to snaps that it misses."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from modalshell.compare.advice_text import NEAR_TIE, RATE_MARGIN, advice_text, missed_text
from modalshell.compare.candidates import MODES
from modalshell.compare.case import Case
from modalshell.compare.path import LoadPath, Snap
from modalshell.compare.report import html_table
from modalshell.compare.runs import Measurement, answer_error
from modalshell.compare.tradeoff import LOADS, Tradeoff, tradeoff
from modalshell.core.checks import checked_number
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Progress
from modalshell.core.units import in_percent
from modalshell.files.atomic_io import write_text
from modalshell.mesh import TriangleMesh
from modalshell.models import DiscreteShell, Equilibrium
from modalshell.render import Picture, html_of
from modalshell.scene import Scene
from modalshell.scene.write import write_scene_with
from modalshell.shell import Shell

_REASONS: dict[str, str] = {Outcome.STOPPED: "its static answers cost several times those of DS"}
"""Outcomes of static answers that a reader of advice would not understand, as reasons."""
_NEAREST = 3e-4
"""Distance from a snap's load within which nothing is said of any rung but DS, relative to it."""
_HALVINGS = 4
"""Times that a distance from a snap is halved: from half a per cent to :data:`_NEAREST`."""

_Check = Callable[[float, Array], Array | None]
"""Of a share of the load, and where DS is nearby (n, 3): where DS is there, if the rung is right there; else None."""


def missed_loads(row: Measurement, case: Case, path: LoadPath, error: float) -> list[tuple[float, float]]:
    """Shares of the load, from one to another next to each snap, between which a rung may be more than ``error`` off.

    It snaps under another load than DS, if only a little. It meets the error at the loads where it was measured. From
    the measured loads next to a snap it is compared with DS nearer and nearer to the snap, by halves of the distance,
    as far as it meets the error.
    """
    if row.is_truth or row.model is None:
        return []
    model, truth = row.model, DiscreteShell(case.shell)

    def check(share: float, start: Array) -> Array | None:
        exact = truth.equilibrium(force=share * case.load, start=start)
        apart = answer_error(model.equilibrium(force=share * case.load), exact, case.shell)
        return exact.positions if apart is not None and apart <= error else None

    return [_around(snap, path, check) for snap in path.snaps]


def _around(snap: Snap, path: LoadPath, check: _Check) -> tuple[float, float]:
    """The loads around one snap; the measured ones where it was not located."""
    answers = zip((*path.factors, *path.near), (*path.answers, *path.near_answers), strict=True)
    known = {share: answer.positions for share, answer in answers if answer.converged}
    low = max((share for share in known if share <= snap.low), default=0.0)
    high = min((share for share in known if share >= snap.high), default=path.factors[-1])
    if snap.stable is None:
        return low, high
    if low in known:
        low = _nearer(low, (1.0 - _NEAREST) * snap.low, known[low], check)
    if high in known:
        high = _nearer(high, (1.0 + _NEAREST) * snap.high, known[high], check)
    return low, high


def _nearer(right: float, nearest: float, start: Array, check: _Check) -> float:
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


@short_repr
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
    missed_loads : list of (float, float)
        Next to each snap the shares of the load between which the chosen rung may miss the error, as it and DS do not
        snap under quite the same load; empty for DS, and without a snap.
    live_error : float or None
        Error of the chosen rung against DS under the whole load where its loads follow the shell, which they do not at
        the other measurements; None without such loads, for DS, and where DS has no answer.
    """

    chosen: Measurement | None
    error: float
    frames_per_second: float
    refused: dict[str, str]
    measured: Tradeoff = field(repr=False)
    explanation: str
    missed_loads: list[tuple[float, float]] = field(default_factory=list)
    live_error: float | None = None

    @property
    def rows(self) -> list[Measurement]:
        """Everything that was measured, cheapest frame first."""
        return self.measured.rows

    @property
    def snap(self) -> Snap | None:
        """Where DS leaves its branch within the load range, if it does."""
        return self.measured.path.snap

    @property
    def bifurcation(self) -> float | None:
        """Share of the load at which DS buckles, if it does before it snaps."""
        return self.measured.bifurcation

    @property
    def model_table(self) -> dict[str, Any] | None:
        """The ``[model]`` table that runs the chosen rung; None where none is chosen or no scene can name it."""
        return None if self.chosen is None else self.chosen.candidate.model_table

    @property
    def margin(self) -> tuple[float, float] | None:
        """Requested error over the chosen model's worst error, and its frame rate over the requested one."""
        if self.chosen is None:
            return None
        error = max(self.chosen.largest_error, self.live_error or 0.0)
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
    and answer with the wrong branch at loads in between. Of the advised one, which may still do so still closer to the
    snap, the loads between which it misses the error are found to 0.03 %, by at most ten answers of its own and of DS,
    and stated.

    All this is under loads as they are at rest. Where those of a scene follow the shell, as pressure and wind do, the
    advised rung must also meet the error under the whole load as it does so, by one answer of its own and of DS.

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
        If ``error`` is not above 0 and at most 1, or ``fps`` not above 0, and as :func:`modalshell.tradeoff` does.
    SolverError
        As :func:`modalshell.tradeoff` does.
    """
    wanted = checked_number("error", error, above=0.0, at_most=1.0)
    rate = checked_number("fps", fps, above=0.0, unit="1/s")
    measured = tradeoff(scene, gravity=gravity, force=force, coarse=coarse, modes=modes, loads=loads, on_step=on_step)
    with measured.case.units.said():
        return choose(measured, wanted, rate)


def choose(measured: Tradeoff, error: float, fps: float) -> Advice:
    """The advice that follows from measurements."""
    refused = refusals(measured)
    allowed = [row for row in measured.rows if row.label not in refused and row.worst_error is not None]
    fitting = [row for row in allowed if row.largest_error <= error and row.frames_per_second >= RATE_MARGIN * fps]
    ties = _ties(fitting)
    live = _LiveErrors(measured.case)
    while ties and (fault := live.fault(ties[0], error)):
        refused[ties[0].label] = fault
        fitting.remove(ties[0])
        ties = _ties(fitting)
    chosen = ties[0] if ties else None
    missed = [] if chosen is None else missed_loads(chosen, measured.case, measured.path, error)
    text = advice_text(measured, refused, ties, (error, fps), [*live.text, *missed_text(missed)])
    return Advice(chosen, error, fps, refused, measured, text, missed, live.error)


def _ties(fitting: Sequence[Measurement]) -> list[Measurement]:
    """Those of nearly the cheapest frame, simplest first; ``fitting`` have the cheapest first."""
    ties = [row for row in fitting if row.cost <= NEAR_TIE * fitting[0].cost]
    return sorted(ties, key=lambda row: (row.candidate.spec.cost, row.cost))


class _LiveErrors:
    """Errors under the whole load of a case as it follows the shell: of the last rung asked, with what to say of it."""

    def __init__(self, case: Case) -> None:
        self.error: float | None = None
        self.text: list[str] = []
        self._case = case
        self._exact: Equilibrium | None = None

    def fault(self, row: Measurement, error: float) -> str:
        """Why a rung that meets the ``error`` under loads as they are at rest does not; empty where it does."""
        self.error, self.text, case = None, [], self._case
        if not case.live or row.is_truth or row.model is None:
            return ""
        if self._exact is None:
            self._exact = DiscreteShell(case.shell).equilibrium(**case.statics(1.0))
        if not self._exact.converged:
            self.text = [
                "DS finds no equilibrium under the whole load as it follows the shell "
                f"({self._exact.status}): what is said here holds for loads as they are at rest alone."
            ]
            return ""
        found = answer_error(row.model.equilibrium(**case.statics(1.0)), self._exact, case.shell)
        if found is None:
            return "without an equilibrium under the whole load as it follows the shell"
        self.error = found
        self.text = [f"Under the whole load as it follows the shell it is {in_percent(found)} off DS."]
        return "" if found <= error else f"{100 * found:.3g} % off DS under the whole load as it follows the shell"


def refusals(measured: Tradeoff) -> dict[str, str]:
    """Models that may not be chosen, with the reasons."""
    refused: dict[str, str] = {}
    for row in measured.rows:
        if row.missed:
            wrong = [status for status in row.statuses if status != "converged"]
            refused[row.label] = _REASONS.get(wrong[0], wrong[0]) if wrong else f"its motion {row.motion}"
        elif row.candidate.spec.quadratic and measured.path.snap is not None:
            refused[row.label] = "the shell snaps, which an elastic energy quadratic in rest modes cannot"
    return refused
