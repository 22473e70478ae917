"""Checks of a motion at some of its frames: static bars under d'Alembert's inertial loads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.state import Damping
from modalshell.loads import Loading
from modalshell.models import CoarseDiscreteShell, HybridStress, Model
from modalshell.models.base.bars import check_bar
from modalshell.models.base.full import FullModel
from modalshell.motion.bars import Bars
from modalshell.motion.trajectory import Trajectory
from modalshell.shell import Shell
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.supports import SupportPath


class Instant(NamedTuple):
    """A frame of a motion with its derivatives, in the frame of the supports.

    Attributes
    ----------
    positions, velocities, accelerations : ndarray, shape (n, 3)
        [m], [m/s], [m/s^2].
    time : float
        [s].
    """

    positions: Array
    velocities: Array
    accelerations: Array
    time: float


def instant_of(times: Array, frames: Array) -> Instant:
    """The middle one of three ``frames`` (3, n, 3) [m] at ``times`` (3,) [s], by their differences."""
    first, second = np.diff(times)
    before, after = (frames[1] - frames[0]) / first, (frames[2] - frames[1]) / second
    velocity = (second * before + first * after) / (first + second)
    return Instant(frames[1], velocity, 2.0 * (after - before) / (first + second), float(times[1]))


def balancing_load(
    now: Instant, shell: Shell, loading: Loading, damping: Damping, supports: SupportPath | None = None
) -> Array:
    """Load (n, 3) [N] in the frame of the supports under which a moving shell is in balance as if it rested.

    All loads as they act on it, less its inertia and the damping by the mass: ``f - M (a + xi v)``. Damping by the
    stiffness is left out: the velocities of cheap models stretch the membrane, which would drown all else.
    """
    x, v, mass = now.positions, now.velocities, shell.mass[:, None]
    load = loading.dead
    pose = None if supports is None else supports.at(now.time)
    if loading.live:
        if pose is None:
            load = loading.force(x, v, now.time)
        else:
            turned = (v + np.cross(pose.turn_rate, x - pose.pivot)) @ pose.rotation.T
            load = loading.force(pose.to_world(x), turned + _speed(supports, now.time), now.time)
    if pose is not None:
        load = pose.shell_load(load, shell.mass, x, v)
    return np.asarray(load - mass * (now.accelerations + damping.mass_factor * v))


def _speed(supports: SupportPath | None, time: float, lead: float = 1e-5) -> Array:
    """Velocity (3,) [m/s] of the supports' pivot."""
    assert supports is not None
    return np.asarray((supports.at(time + lead).translation - supports.at(time - lead).translation) / (2.0 * lead))


@final
class MotionCheck:
    """Finds the bars of a motion, one checked frame after the other.

    Parameters
    ----------
    shell : Shell
        What moves.
    loading : Loading
        Its loads.
    damping : Damping
        Its damping.
    supports : SupportPath, optional
        How its supports move.

    Raises
    ------
    OptionError
        For a shell that its supports do not hold.
    """

    def __init__(self, shell: Shell, loading: Loading, damping: Damping, supports: SupportPath | None = None) -> None:
        check_bar(shell)
        self._shell, self._loading, self._damping, self._supports = shell, loading, damping, supports
        self._estimator = ErrorEstimator(shell)

    def own(self, time: float, positions: Array) -> Array:
        """Positions (n, 3) [m] of the world in the frame of the supports."""
        x = np.asarray(positions, dtype=np.float64)
        return x if self._supports is None else self._supports.at(time).to_shell(x)

    def bar(self, times: Array, frames: Array) -> ErrorBar:
        """Bar of the middle one of three frames (3, n, 3) [m] of the world at ``times`` (3,) [s]."""
        own = np.stack([self.own(float(time), frame) for time, frame in zip(times, frames, strict=True)])
        now = instant_of(times, own)
        load = balancing_load(now, self._shell, self._loading, self._damping, self._supports)
        return self._estimator.bar(now.positions, load)

    def moved(self, positions: Array) -> float:
        """Displacement in the norm of the mass [kg^(1/2) m] of positions in the frame of the supports."""
        return float(np.sqrt(np.sum(self._shell.mass[:, None] * (positions - self._shell.rest_positions) ** 2)))

    def off(self, bar: ErrorBar, positions: Array) -> float:
        """Distance of positions in the frame of the supports from those that a bar corrects them to."""
        if bar.message:
            return np.inf
        return float(np.sqrt(np.sum(self._shell.mass[:, None] * (bar.corrected - positions) ** 2)))


def checked_frames(count: int, every: int) -> Iterator[int]:
    """Every ``every``-th of ``count`` frames that has one on either side."""
    return iter(range(every, count - 1, every))


def with_bars(
    run: Trajectory,
    model: Model,
    loading: Loading,
    *,
    every: int,
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
    damping : Damping, optional
        Its damping.
    supports : SupportPath, optional
        How its supports moved.

    Raises
    ------
    OptionError
        For a shell that its supports do not hold.
    """
    check = MotionCheck(model.shell, loading, damping or Damping(), supports)
    chosen = list(checked_frames(len(run.times), every))
    rows, largest, seen, held = [], 0.0, 0, True
    for k in chosen:
        for frame in range(seen, k + 1):
            largest = max(largest, check.moved(check.own(float(run.times[frame]), run.positions[frame])))
        seen = k + 1
        bar = check.bar(run.times[k - 1 : k + 2], np.asarray(run.positions[k - 1 : k + 2], dtype=np.float64))
        off = check.off(bar, check.own(float(run.times[k]), run.positions[k]))
        holds = bar.valid and (held or knows_its_branch(model))
        held = held and bar.valid
        rows.append((off / largest if largest > 0.0 else float(off > 0.0), bar.margin, holds))
    numbers = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return replace(run, bars=Bars.of(run.times[chosen], numbers[:, 0], numbers[:, 1], numbers[:, 2] > 0.0))


def bar_at_largest(run: Trajectory, shell: Shell, loading: Loading, damping: Damping) -> tuple[float, ErrorBar] | None:
    """Time [s] and bar of the frame of largest displacement, supports at rest; None of motions of under three frames.

    OptionError for a shell that its supports do not hold.
    """
    if len(run.times) < 3:
        return None
    check = MotionCheck(shell, loading, damping)
    moved = [check.moved(check.own(0.0, frame)) for frame in run.positions[1:-1]]
    k = 1 + int(np.argmax(moved))
    around = slice(k - 1, k + 2)
    return float(run.times[k]), check.bar(run.times[around], np.asarray(run.positions[around], dtype=np.float64))


def knows_its_branch(model: Model) -> bool:
    """Whether a model leaves a branch where DS does, and so stays on the one that DS is on."""
    return isinstance(model, FullModel | CoarseDiscreteShell | HybridStress)
