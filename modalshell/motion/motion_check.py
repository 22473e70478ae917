"""Error bars at some frames of a motion."""

from __future__ import annotations

from dataclasses import replace
from typing import TypedDict

import numpy as np

from modalshell.core.checks import checked_count
from modalshell.loads import Loading
from modalshell.models import Model
from modalshell.models.base.bars import check_bar
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.error_bars import coarse_of
from modalshell.models.motion_check import MotionCheck
from modalshell.motion.bars import Bars
from modalshell.motion.trajectory import Trajectory
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.supports import SupportPath


class WantedBars(TypedDict):
    """How often bars are found, and on which shell."""

    every: int
    coarse: CoarseDiscreteShell | None


def wanted_bars(bars: int | tuple[int, str | Shell], model: Model, *, constrained: bool, touching: bool) -> WantedBars:
    """What ``bars`` of :func:`modalshell.simulate` asks for; OptionError where that cannot be had."""
    every, on = bars if isinstance(bars, tuple) and len(bars) == 2 else (bars, "shell")
    every = checked_count("bars", every)
    check_bar(model.true_shell, constrained=constrained, touching=touching)
    coarse = None if isinstance(on, str) and on == "shell" else coarse_of(model, model.true_shell, on)
    return {"every": every, "coarse": coarse}


def with_bars(
    run: Trajectory,
    model: Model,
    loading: Loading,
    *,
    every: int,
    coarse: CoarseDiscreteShell | None = None,
    damping: Damping | None = None,
    supports: SupportPath | None = None,
) -> Trajectory:
    """The motion with the error bars of some frames.

    Positions alone enter, so that a motion that was stopped and resumed has the same bars.

    Parameters
    ----------
    run : Trajectory
        A motion of the model.
    model : Model
        The model.
    loading : Loading
        Its loads.
    every : int
        Frames from one check to the next.
    coarse : CoarseDiscreteShell, optional
        The coarse shell on which bars are found, in place of the model's own.
    damping : Damping, optional
        Its damping.
    supports : SupportPath, optional
        How its supports moved.

    Raises
    ------
    OptionError
        For a shell that its supports do not hold.
    """
    check = MotionCheck(model.true_shell, loading, damping or Damping(), supports, coarse)
    chosen = list(range(every, len(run.times) - 1, every))  # frames with one on either side
    rows, largest, seen, held = [], 0.0, 0, True
    for k in chosen:
        for frame in range(seen, k + 1):
            largest = max(largest, check.moved(check.own(float(run.times[frame]), run.positions[frame])))
        seen = k + 1
        bar = check.bar(run.times[k - 1 : k + 2], np.asarray(run.positions[k - 1 : k + 2], dtype=np.float64))
        off = check.off(bar, check.own(float(run.times[k]), run.positions[k]))
        holds = bar.valid and (held or model.follows_snaps)
        held = held and bar.valid
        rows.append((off / largest if largest > 0.0 else float(off > 0.0), bar.margin, holds))
    numbers = np.array(rows, dtype=np.float64).reshape(-1, 3)
    bars = Bars.of(run.times[chosen], numbers[:, 0], numbers[:, 1], numbers[:, 2] > 0.0)
    return replace(run, bars=bars if coarse is None else replace(bars, on="coarse"))
