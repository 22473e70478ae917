"""Moving supports: a rigid motion of the clamped vertices, and its inertial loads in the moving frame."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, final, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, RotationSpline

from modalshell.core.checks import checked_choice, checked_count, checked_number, checked_times, checked_vectors
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array
from modalshell.kernels import rotations

Side = Literal["before", "after"]
"""Side of a jump in time."""


@final
@short_repr
@dataclass(frozen=True)
class Pose:
    """Where the supports are at one time, and how they move."""

    rotation: Array
    """From the shell's frame to the world's; shape (3, 3)."""
    translation: Array
    """Of the pivot [m]; shape (3,)."""
    pivot: Array
    """Point of the rest shape about which it rotates [m]; shape (3,)."""
    acceleration: Array
    """Of the pivot, in the shell's frame [m/s^2]; shape (3,)."""
    turn_rate: Array
    turn_acceleration: Array
    """Angular velocity [rad/s] and acceleration [rad/s^2], in the shell's frame; shape (3,)."""
    velocity: Array
    """Of the pivot, in the world [m/s]; shape (3,)."""

    def to_world(self, positions: Array) -> Array:
        """Positions (n, 3) [m] of the shell's frame in the world."""
        return (positions - self.pivot) @ self.rotation.T + self.pivot + self.translation

    def to_shell(self, positions: Array) -> Array:
        """Positions (n, 3) [m] of the world in the shell's frame."""
        return (positions - self.pivot - self.translation) @ self.rotation + self.pivot

    def world_velocities(self, positions: Array, velocities: Array) -> Array:
        """Velocities (n, 3) [m/s] in the world of what has ``positions`` and ``velocities`` (n, 3) in the frame."""
        turned = velocities + np.cross(self.turn_rate, positions - self.pivot)
        return np.asarray(turned @ self.rotation.T + self.velocity)

    def shell_load(self, load: Array, mass: Array, positions: Array, velocities: Array) -> Array:
        """Load (n, 3) [N] in the shell's frame: the world's ``load`` and the inertial ones.

        ``f = R^T f_world - m (a + alpha x r + omega x (omega x r) + 2 omega x v)``: the support's acceleration, Euler,
        centrifugal and Coriolis forces at the deformed positions r (n, 3) and velocities v (n, 3) in the shell's frame.
        """
        arm = positions - self.pivot
        felt = self.acceleration + np.cross(self.turn_acceleration, arm)
        felt = felt + np.cross(self.turn_rate, np.cross(self.turn_rate, arm) + 2.0 * velocities)
        return load @ self.rotation - mass[:, None] * felt


def turn_rates(vector: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Angular velocity and acceleration (3,) in the turning frame, from a rotation vector and its time derivatives.

    ``omega = Rt(-w) w'``, Rt(-w) being the right Jacobian of SO(3), and its derivative along the path.
    """
    rate, along = np.empty((2, 1, 3))
    slope = np.empty((1, 3, 3))
    rotations.warp(-vector[None], first[None], 1.0, rate)
    rotations.warp(-vector[None], second[None], 1.0, along)
    rotations.warp_jacobian(-vector[None], first[None], slope)
    return rate[0], along[0] - slope[0] @ first


def _cubic(times: Array, values: Array) -> Array:
    """Coefficients (4, k - 1, 3), the highest power first, of the spline through values (k, 3) that rests at its ends.

    SciPy's splines are found, and not asked: of one point at a time, most is the time of their calls.
    """
    from scipy.interpolate import CubicSpline  # not before supports move: its import takes long

    return np.asarray(CubicSpline(times, values, bc_type="clamped").c)


def _warn_of_swings(name: str, times: Array, values: Array, spline: Array, unit: str) -> None:
    """Warn where the spline through keyframes (k, 3) swings far beyond them, next to a much shorter interval."""
    lengths = np.diff(times)
    if lengths.max() <= _UNEVEN * lengths.min():
        return
    between = lengths * np.linspace(0.0, 1.0, _LOOKED_AT)[1:-1, None]
    looked = np.polyval(spline[:, None], between[..., None])
    beyond = np.maximum(looked - values.max(axis=0), values.min(axis=0) - looked).max(axis=2)
    worst, span = float(beyond.max()), float(np.ptp(values, axis=0).max())
    if worst > _SWING * span:
        place = int(beyond.max(axis=0).argmax())
        warnings.warn(
            f"the spline through {name} swings {worst:.2g} {unit} beyond its keyframes, which span {span:.2g} {unit}, "
            f"between {times[place]:.6g} and {times[place + 1]:.6g} s: add keyframes there",
            ModalShellWarning,
            stacklevel=3,
        )


def _with_derivatives(times: Array, spline: Array, time: float) -> tuple[Array, Array, Array]:
    """Value (3,) of a :func:`_cubic` at a time within it, and its first and second derivatives: SciPy's own bits."""
    place = min(max(int(times.searchsorted(time, side="right")) - 1, 0), times.size - 2)
    s = time - float(times[place])
    s2 = s * s
    s3 = s2 * s
    axes = spline[:, place].T.tolist()
    return (
        np.array([d + c * s + b * s2 + a * s3 for a, b, c, d in axes]),
        np.array([c + b * s * 2.0 + a * s2 * 3.0 for a, b, c, _ in axes]),
        np.array([b * 2.0 + a * s * 6.0 for a, b, _, _ in axes]),
    )


def _jumps(vectors: Array) -> bool:
    """Whether rotation vectors (k, 3) [rad] change to another one of their rotation: their quaternions change sign."""
    angles = np.linalg.norm(vectors, axis=1)
    half = 0.5 * angles[:, None]
    axes = np.divide(vectors, angles[:, None], out=np.zeros_like(vectors), where=angles[:, None] > 0.0)
    quaternions = np.hstack([np.sin(half) * axes, np.cos(half)])
    return bool((np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0).any())


_NONE, _NO_TURN = read_only(np.zeros(3)), read_only(np.eye(3))
_KEPT = 8
"""Poses that a path keeps: steps ask for those of their ends and middles several times."""
_UNEVEN, _LOOKED_AT = 2.0, 18
"""Longest over shortest interval of keyframes from which a path is looked at between them, and at how many times."""
_SWING = 0.5
"""Way of a spline beyond its keyframes, over what these span, from which a path warns."""
_ROUNDING = 1e-12
"""Share of a path's times by which a time may lie outside and still count as its end, where supports yet brake."""


@final
class SupportPath:
    """A path of the supports through keyframes: a cubic spline of the translation, and of the rotation vector.

    Before the first and after the last keyframe the supports rest there. A spline swings: past an interval much shorter
    than its neighbours it leaves the range of the keyframes, of which a warning tells where it does so by half of it.

    Parameters
    ----------
    times : array_like, shape (k,)
        Times of the keyframes [s], increasing, at least two.
    translations : array_like, shape (k, 3)
        Displacement of the supports [m].
    rotation_vectors : array_like, shape (k, 3), optional
        Rotation of the supports from their rest orientation [rad], may exceed one turn; none by default.
    pivot : array_like, shape (3,)
        Point of the rest shape about which they turn [m].

    Raises
    ------
    OptionError
        If the times do not increase, or an array is of the wrong shape or not finite.
    """

    def __init__(
        self,
        times: ArrayLike,
        translations: ArrayLike,
        rotation_vectors: ArrayLike | None = None,
        *,
        pivot: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.times = checked_times(times).copy()
        shape = (self.times.size, 3)
        self.pivot = checked_vectors("pivot", pivot, (3,), OptionError).copy()
        self._poses: dict[tuple[float, Side | None], Pose] = {}
        # Clamped ends: the supports start and stop at rest.
        moved = checked_vectors("translations", translations, shape, OptionError)
        self._translation = _cubic(self.times, moved)
        self._rotation: Array | RotationSpline | None = None
        _warn_of_swings("translations", self.times, moved, self._translation, "m")
        if rotation_vectors is not None:
            turned = checked_vectors("rotation_vectors", rotation_vectors, shape, OptionError)
            self._rotation = _cubic(self.times, turned)
            _warn_of_swings("rotation_vectors", self.times, turned, self._rotation, "rad")

    @classmethod
    def from_function(
        cls,
        path: Callable[[float], tuple[ArrayLike, ArrayLike]],
        duration: float,
        *,
        step: float = 1.0 / 120.0,
        pivot: ArrayLike = (0.0, 0.0, 0.0),
    ) -> SupportPath:
        """Path through ``path(t) -> (translation, rotation vector)``, sampled every ``step`` [s] up to ``duration``.

        Supports start and stop at rest here too. A function that moves at time 0 or at ``duration`` is started or
        stopped within the samples there, by accelerations that fall off by a factor 2 + sqrt(3) a sample, and the shell
        reacts to them: give a function that rests at its ends, or let ``duration`` reach some ten samples beyond the
        end of the simulation.

        Rotation vectors of most programs jump where the angle passes pi. Such rotations are followed by a spline of
        their own, less than half a turn from sample to sample, which is not brought to rest at the ends.

        OptionError for what is no function of the time, or returns anything but two vectors.
        """
        if not callable(path):
            raise OptionError(f"path must be a function of the time that returns two vectors, got {path!r}")
        duration = checked_number("duration", duration, above=0.0, unit="s")
        step = checked_number("step", step, above=0.0, at_most=duration, unit="s")
        count = checked_count("the number of samples, duration over step,", round(duration / step), at_most=10_000_000)
        times = np.linspace(0.0, duration, count + 1)
        moved, turned = np.empty((2, times.size, 3))
        for k, time in enumerate(times.tolist()):
            pose = path(time)
            if not isinstance(pose, Sequence | np.ndarray) or len(pose) != 2:
                raise OptionError(f"path must return a translation and a rotation vector, (3,) each, got {pose!r}")
            moved[k] = checked_vectors("the translation of path", pose[0], (3,), OptionError)
            turned[k] = checked_vectors("the rotation vector of path", pose[1], (3,), OptionError)
        made = cls(times, moved, turned, pivot=pivot)
        if _jumps(turned):
            made._rotation = RotationSpline(times, Rotation.from_rotvec(turned))
        return made

    @property
    def turns(self) -> bool:
        """Whether the supports turn, too."""
        return self._rotation is not None

    def samples(self, count: int) -> Array:
        """Times [s] from its beginning to its end, at least ``count``: keyframes, and equally many between any two."""
        intervals = self.times.size - 1
        between = np.linspace(0.0, intervals, 1 + intervals * -(-count // intervals))
        return np.interp(between, np.arange(intervals + 1), self.times)

    def about(self, origin: Array) -> SupportPath:
        """The same path in coordinates about ``origin`` (3,) [m]."""
        path = copy.copy(self)
        path.pivot, path._poses = self.pivot - origin, {}
        return path

    def at(self, time: float, side: Side | None = None) -> Pose:
        """Pose of the supports at ``time`` [s].

        Accelerations jump from and to rest where a path begins and ends. A stage of a step that ends there takes those
        on its ``side``. A force at a frame that serves the steps on both sides takes their mean, or steps would be of
        first order; the beginning of a motion has one side.
        """
        time = checked_number("time", time, unit="s")
        if side is not None:
            checked_choice("side", side, get_args(Side))
        if (known := self._poses.get((time, side))) is not None:
            return known
        pose = self._pose(time, side)
        for part in vars(pose).values():
            part.setflags(write=False)  # it is given to all who ask for this time
        if len(self._poses) >= _KEPT:
            self._poses = {}
        self._poses[time, side] = pose
        return pose

    def _pose(self, time: float, side: Side | None) -> Pose:
        first, last = float(self.times[0]), float(self.times[-1])
        inside = min(max(time, first), last)
        rounding = _ROUNDING * max(abs(first), abs(last))  # frames may miss an end by so much
        moving = abs(time - inside) <= rounding
        place, velocity, acceleration = _with_derivatives(self.times, self._translation, inside)
        rotation, rate, turning = self._turned(inside, moving=moving)
        share = self._share_of_jump(inside, rounding, side)
        acceleration, turning = share * (acceleration @ rotation if moving else _NONE), share * turning
        return Pose(rotation, place, self.pivot, acceleration, rate, turning, velocity if moving else _NONE)

    def _turned(self, inside: float, *, moving: bool) -> tuple[Array, Array, Array]:
        """Rotation (3, 3) at a time [s] within the path, and where it is ``moving`` its rate and acceleration (3,)."""
        if self._rotation is None:
            return _NO_TURN, _NONE, _NONE
        if isinstance(self._rotation, RotationSpline):
            rotation = self._rotation(inside).as_matrix()
            return (
                (rotation, self._rotation(inside, 1), self._rotation(inside, 2)) if moving else (rotation, _NONE, _NONE)
            )
        vector, first, second = _with_derivatives(self.times, self._rotation, inside)
        rates = turn_rates(vector, first, second) if moving else (_NONE, _NONE)
        return Rotation.from_rotvec(vector).as_matrix(), *rates

    def _share_of_jump(self, time: float, rounding: float, side: Side | None) -> float:
        """How much of its acceleration a path has on a side of a time [s] within it."""
        first, last = float(self.times[0]), float(self.times[-1])
        if abs(time - last) <= rounding:
            return {"before": 1.0, "after": 0.0, None: 0.5}[side]
        if first > rounding and abs(time - first) <= rounding:
            return {"before": 0.0, "after": 1.0, None: 0.5}[side]
        return 1.0
