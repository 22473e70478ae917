"""Error bars at some frames of a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from modalshell.core.checks import checked_count
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.models import Model
from modalshell.models.base.bars import check_bar, led_vertices, refuse_on_coarse
from modalshell.models.coarse.profile_step import quick_estimator
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.error_bars import coarse_of
from modalshell.models.motion_check import MotionCheck, damped_basis, touching_frames
from modalshell.motion.bars import Bars
from modalshell.motion.trajectory import Trajectory
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.supports import SupportPath
from modalshell.supports.constraints import Constraint, LedVertices

if TYPE_CHECKING:
    from modalshell.contact import Contact  # motions without contacts do not import it
    from modalshell.contact.motion_bar import TouchingFrames

_FEWEST = 6.0
"""Frames in a period below which accelerations by their differences are a tenth too small, and less sure yet."""
_SLIGHT = 0.05
"""Vibration, over the largest displacement, whose inertia matters little to bars."""


class WantedBars(TypedDict):
    """How often bars are found, on which shell, and with which contacts."""

    every: int
    coarse: CoarseDiscreteShell | None
    touching: TouchingFrames | None
    led: LedVertices | None
    """What constraints lead, where nothing touches."""


def wanted_bars(
    bars: int | tuple[int, str | Shell],
    model: Model,
    contacts: Sequence[Contact],
    dt: float,
    supports: SupportPath | None,
    constraints: Sequence[Constraint],
) -> WantedBars:
    """What ``bars`` of :func:`modalshell.simulate` asks for; OptionError where that cannot be had."""
    every, on = bars if isinstance(bars, tuple) and len(bars) == 2 else (bars, "shell")
    every = checked_count("bars", every)
    shell = model.true_shell
    check_bar(shell, constraints=constraints, contacts=contacts)
    if isinstance(on, str) and on == "shell":
        led = led_vertices(shell, constraints, supports)
        touching = touching_frames(model, contacts, dt, supports, led=led)
        return {"every": every, "coarse": None, "touching": touching, "led": led if touching is None else None}
    refuse_on_coarse(contacts, constraints)
    return {"every": every, "coarse": coarse_of(model, shell, on), "touching": None, "led": None}


def with_bars(
    run: Trajectory,
    model: Model,
    loading: Loading,
    wanted: WantedBars,
    *,
    damping: Damping | None = None,
    supports: SupportPath | None = None,
) -> Trajectory:
    """The motion of a model with the error bars of some frames, those ``wanted``.

    Positions alone enter, and contact forces where there is friction, so that a motion that was stopped and resumed has
    the same bars. Of a motion too short for the first of them the last frame but one has a bar. The message says where
    frames are too far apart for accelerations. The other parameters are those of :class:`MotionCheck`. OptionError for
    a shell that its supports do not hold.
    """
    every, coarse, touching, led = wanted["every"], wanted["coarse"], wanted["touching"], wanted["led"]
    shell, damping = model.true_shell, damping or Damping()
    estimator = None if led is None else quick_estimator(shell, led)
    check = MotionCheck(shell, loading, damping, supports, coarse, estimator=estimator, touching=touching)
    check.basis = damped_basis(model)
    last = len(run.times) - 1
    chosen = list(range(every, last, every)) or list(range(1, last))[-1:]  # frames with one on either side
    rows, unjudged, largest, seen, held = [], list[str](), 0.0, 0, True
    swings = np.zeros((2, len(chosen)))
    for place, k in enumerate(chosen):
        for frame in range(seen, k + 1):
            largest = max(largest, check.moved(check.own(float(run.times[frame]), run.positions[frame])))
        seen = k + 1
        frames = np.asarray(run.positions[k - 1 : k + 2], dtype=np.float64)
        bar = check.bar(run.times[k - 1 : k + 2], frames, run.contact_forces[k - 1 : k + 2] if touching else None)
        own = [check.own(float(time), frame) for time, frame in zip(run.times[k - 1 : k + 2], frames, strict=True)]
        swings[:, place] = check.norm(own[2] - 2.0 * own[1] + own[0]), 0.5 * check.norm(own[2] - own[0])
        off = check.off(bar, own[1])
        holds = bar.valid and (held or model.follows_snaps)
        held = held and (bar.valid or bool(check.unjudged))
        unjudged.append(check.unjudged)
        rows.append((off / largest if largest > 0.0 else float(off > 0.0), bar.margin, holds))
    numbers = np.array(rows, dtype=np.float64).reshape(-1, 3)
    bars = Bars.of(run.times[chosen], numbers[:, 0], numbers[:, 1], numbers[:, 2] > 0.0)
    bars = replace(bars, unjudged=tuple(unjudged)) if touching else bars
    message, far = run.message, too_far_apart(swings, largest)
    if far and far not in message:
        message = "; ".join(filter(None, [message, far]))
    return replace(run, bars=bars if coarse is None else replace(bars, on="coarse"), message=message)


def too_far_apart(swings: Array, largest: float) -> str:
    """What a message says of frames too far apart for bars, from second differences and half of the first (2, B).

    Of a vibration of the angle ``a`` a frame the ratio of their root mean squares is ``2 tan(a / 2)``.
    """
    bent, moved = np.sqrt(np.mean(swings**2, axis=1)) if swings.size else np.zeros(2)
    angle = 2.0 * np.arctan2(0.5 * bent, moved)
    if 2.0 * np.pi >= _FEWEST * angle or bent <= _SLIGHT * largest * 2.0 * (1.0 - np.cos(angle)):
        return ""
    return (
        f"its bars mean little: there are about {2.0 * np.pi / angle:.2g} frames in a period, or fewer, and they take "
        f"accelerations from frames, which needs more than {_FEWEST:g}: store frames more often"
    )
