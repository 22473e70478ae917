"""Advice as text: the chosen rung, why the others were not taken, and what was measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from modalshell.compare.bifurcation import bifurcation_text
from modalshell.compare.runs import Measurement
from modalshell.compare.tradeoff import Tradeoff
from modalshell.core.outcome import Outcome
from modalshell.core.units import in_percent
from modalshell.scene.write import toml_table
from modalshell.statics.error_bar import ErrorEstimator

NEAR_TIE = 1.25
"""Counted costs of frames within this factor of the cheapest are ties, which go to the simplest rung."""
RATE_MARGIN = 1.2
"""Least measured frame rate over the requested one for a model to count as fast enough: times scatter by this much."""


def advice_text(
    measured: Tradeoff,
    refused: Mapping[str, str],
    ties: Sequence[Measurement],
    asked: tuple[float, float],
    further: Sequence[str],
) -> str:
    """Explanation of a choice: the first of the ``ties`` at nearly the cheapest frame, if there are any.

    ``asked`` are the error and the frame rate, ``further`` sentences about the choice.
    """
    error, fps = asked
    if ties:
        text = [*_chosen_text(ties[0], error, fps), *further, *_bar_text(measured, ties[0])]
        if (table := ties[0].candidate.model_table) is not None:
            text += ["", "In a scene:", "", "```toml", toml_table("model", table), "```", ""]
    else:
        text = _none_text([row for row in measured.rows if row.label not in refused], error, fps)
    cheaper = measured.rows[: measured.rows.index(ties[0])] if ties else measured.rows
    text += _faults([row for row in cheaper if row not in ties], refused, error)
    if also := [row.label for row in measured.rows if row in ties[1:]]:
        text.append(f"- Within {100 * (NEAR_TIE - 1):.0f} % of the same work, but less simple: {'; '.join(also)}.")
    return "\n".join([*text, "", *_measured_text(measured)])


def _chosen_text(row: Measurement, error: float, fps: float) -> list[str]:
    worst = row.largest_error
    accuracy = "is the truth here" if row.is_truth else f"is at most {in_percent(worst)} off DS"
    margin = "" if worst == 0.0 else f" (asked {100 * error:.3g} %: {error / worst:.2g} times better)"
    rate = row.frames_per_second
    return [
        f"Take {row.label}: it {accuracy}{margin} and makes {_plain(rate, 3)} frames a second (asked {fps:g}: "
        f"{_plain(rate / fps, 2)} times faster), after {row.preprocessing:.2g} s of preprocessing.",
        *([f"Its motion: {row.motion}."] if row.motion != Outcome.COMPLETED else []),
    ]


def _plain(value: float, digits: int) -> str:
    """A number to some digits, by powers of ten only below a thousandth."""
    rounded = float(f"{value:.{digits}g}")
    if not 1e-3 <= rounded < math.inf:
        return f"{rounded:.{digits}g}"
    return f"{rounded:,.{max(0, digits - 1 - math.floor(math.log10(rounded)))}f}"


def missed_text(missed: Sequence[tuple[float, float]]) -> list[str]:
    """Between which loads it is not known to hold."""
    between = " or ".join(f"between {low:.4g} and {high:.4g}" for low, high in missed)
    return [
        f"Not {between} of the load: next to a snap it may be on another branch than DS, as it does not snap under "
        "quite the same load. Take DS for loads there."
    ] * bool(missed)


def _bar_text(measured: Tradeoff, row: Measurement) -> list[str]:
    """What the error bar of the row's answer under the whole load says, and what a trained model knows."""
    case, text = measured.case, []
    if row.candidate.spec.needs == "coarse training":
        text.append(
            "It was trained on this load, which the preprocessing holds; frames under loads unlike it go to its "
            f"coarse shell of {row.candidate.size} by themselves, and cost more."
        )
    elif row.candidate.spec.needs == "training":
        text.append("It was trained on this load; loads unlike it need a training of their own.")
    if not row.is_truth and row.converged and not case.live:  # a bar would be that of loads as they are at rest
        bar = ErrorEstimator(case.shell).bar(row.positions, case.load)
        text.append(f"Its error bar under the whole load, which needs no answer of DS (bar = true in a scene): {bar}.")
    return text


def _none_text(allowed: list[Measurement], error: float, fps: float) -> list[str]:
    text = [
        f"No rung meets both an error of {100 * error:.3g} % and {fps:g} frames a second on this machine, "
        f"with a margin of {100 * (RATE_MARGIN - 1):.0f} % in the rate."
    ]
    accurate = [row for row in allowed if row.largest_error <= error]
    if accurate:
        rate = _plain(accurate[0].frames_per_second, 3)
        text.append(f"As accurate, the cheapest is {accurate[0].label}: {rate} a second.")
    fast = sorted(
        (row for row in allowed if row.frames_per_second >= RATE_MARGIN * fps), key=lambda row: row.largest_error
    )
    if fast:
        text.append(f"As fast, the most accurate is {fast[0].label}: {100 * fast[0].largest_error:.3g} % off DS.")
    return text


def _faults(rows: list[Measurement], refused: Mapping[str, str], error: float) -> list[str]:
    """Why ``rows`` were not taken, those with one reason on one line."""
    text = []
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.label in refused:
            reasons.setdefault(refused[row.label], []).append(row.label)
    text += [f"- Refused, since {reason}: {'; '.join(labels)}." for reason, labels in reasons.items()]
    allowed = [row for row in rows if row.label not in refused]
    away = [row for row in allowed if row.worst_error is not None and row.worst_error <= error < row.largest_error]
    wrong = [row for row in allowed if row.largest_error > error and row not in away]
    if off := [f"{row.label} ({100 * row.largest_error:.3g} %)" for row in wrong]:
        text.append(f"- Not accurate enough: {'; '.join(off)}.")
    if near := [f"{row.label} ({_near_text(row)})" for row in away]:
        text.append(f"- Accurate enough at the other loads, but not next to the snap: {'; '.join(near)}.")
    late = [row for row in allowed if row.largest_error <= error]
    if slow := [f"{row.label} ({_plain(row.frames_per_second, 3)} a second)" for row in late]:
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
        f"({len(case.shell.rest_positions)} vertices), and frames of {1000 * case.units.seconds * case.dt:.3g} ms in "
        "motion: their counted work, the same on every machine, ranks the rungs; their median time is compared with "
        "the frame rate."
    ]
    text += [case.notes] if case.notes else []
    if unknown := [f"{path.factors[k]:g}" for k in range(len(path.factors)) if k not in path.known]:
        text.append(f"DS found no equilibrium at {', '.join(unknown)} of the load, which are left out of the errors.")
        if len(path.factors) - 1 not in path.known:
            text.append(f"Under the whole load the rungs' own answers differ by up to {_spread(measured):.2g} lengths.")
    text += bifurcation_text(measured.bifurcation)
    if path.snap is not None:
        text.append(f"The shell {path.snap}.")
    if path.near:
        near = " and ".join(f"{factor:.4g}" for factor in path.near)
        text.append(f"Rungs that may snap were also compared next to it, at {near} of the load.")
    return text
