"""Reference path of a quick comparison: what DS would answer, from error bars in place of its own solutions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from modalshell.compare.path import LoadPath, follow_loads
from modalshell.core.cost import counted
from modalshell.core.errors import ModalShellError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array
from modalshell.models import Equilibrium, Model
from modalshell.modes import lowest_modes
from modalshell.shell import Shell
from modalshell.statics.error_bar import LARGEST_BAR, ErrorBar, ErrorEstimator, share_as_text


def path_by_bars(
    model: Model, load: Array, factors: Sequence[float], on_load: Callable[[], None]
) -> tuple[LoadPath, str]:
    """Equilibria of DS at growing shares of ``load`` (n, 3) [N], as bars of the answers of ``model`` correct them.

    Two mixed Newton steps and a third with the last factor lead from each answer to DS, wherever the stability margin
    holds and the bar is at most :data:`modalshell.statics.error_bar.LARGEST_BAR`. At the first load where they do not,
    DS itself is followed over the whole range, as :func:`modalshell.compare.path.follow_loads` does.

    Returns
    -------
    path : LoadPath
        The states, with the bars they come from where they come from bars.
    note : str
        What errors are measured against, in sentences.
    """
    shell = model.true_shell
    answers: list[Equilibrium] = []
    estimator, cost = ErrorEstimator(shell), 0.0
    for factor in factors:
        try:
            with counted() as work:
                answer = _corrected(model, estimator, factor * load)
        except ModalShellError as error:
            return _followed(shell, load, factors, len(answers), on_load, f"at {factor:g} of the load: {error}")
        cost += work.cost
        bar = answer.bar
        assert bar is not None
        if not bar.valid or bar.displacement > LARGEST_BAR:
            return _followed(shell, load, factors, len(answers), on_load, f"at {factor:g} of the load: {bar}")
        answers.append(answer)
        on_load()
    lowest = float(lowest_modes(shell, 1)[0].eigenvalues[0])
    path = LoadPath(tuple(float(factor) for factor in factors), answers, [None] * len(answers), lowest, cost=cost)
    return path, _note(answers)


def _corrected(model: Model, estimator: ErrorEstimator, force: Array) -> Equilibrium:
    """The answer of ``model`` under ``force`` (n, 3) [N], corrected to DS, with the bar of what it was."""
    watch = Stopwatch()
    answer = model.equilibrium(force=force)
    bar = estimator.bar(answer.positions, force)
    positions = estimator.refined()[0] if not bar.message else bar.corrected
    return Equilibrium(
        positions,
        Outcome.CONVERGED if np.isfinite(positions).all() else Outcome.NOT_CONVERGED,
        "two Newton steps and a third from an answer on modes",
        iterations=3,
        residual=_residual(estimator.shell, positions - estimator.origin, force),
        stable=bar.valid,
        seconds=watch(),
        mesh=estimator.shell.mesh,
        bar=bar,
    )


def _residual(shell: Shell, positions: Array, force: Array) -> float:
    """What is out of balance at ``positions`` (n, 3) [m] under ``force`` (n, 3) [N], relative to the force."""
    restrict = shell.unknowns.restrict
    push = restrict(force.ravel())
    return float(np.linalg.norm(restrict(shell.force(positions).ravel()) + push) / np.linalg.norm(push))


def _followed(
    shell: Shell, load: Array, factors: Sequence[float], known: int, on_load: Callable[[], None], why: str
) -> tuple[LoadPath, str]:
    """The path of DS; its first loads, ``known`` of them, have been counted."""
    seen = itertools.count()

    def once() -> None:
        if next(seen) >= known:
            on_load()

    return follow_loads(shell, load, factors, once), f"DS was solved, as no error bar serves {why}."


def _note(answers: Sequence[Equilibrium]) -> str:
    bars: list[ErrorBar] = [answer.bar for answer in answers if answer.bar is not None]
    worst = share_as_text(max(bar.displacement for bar in bars))
    margin = min(bar.margin for bar in bars)
    text = (
        "DS was not solved: errors are against the states to which three Newton steps lead from the most exact answer "
        f"on modes, whose largest error bar is {worst}, with a stability margin of at least {margin:.2f}."
    )
    last = bars[-1].critical_load
    return text + (
        f" The shell is expected to leave its branch at about {last:.2g} times the load." if last < 2.0 else ""
    )
