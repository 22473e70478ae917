"""What the model that switches itself sees of a shell in motion: of a held one as it is, of free parts in frames."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.integrators.free_parts import FittedFrames, FreePart, FreeParts, axial, crossed, inertia_of
from modalshell.loads import Loading
from modalshell.models.auto.sampled import SampledCheck
from modalshell.models.base.bars import check_bar
from modalshell.models.motion_check import BalancedBars, balancing_load, instant_of, strained_ahead
from modalshell.modes.rigid import left_free, rigid_motions
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.supports import Pin, Roller, Support, SupportPath

if TYPE_CHECKING:
    from modalshell.contact.motion_bar import TouchingFrames

_ROUNDING = 1e-12
"""Share of a load that is rounding where the rest of it moves a part as a rigid body."""
_STILL = 1e-7
"""Root of the mean square, in sizes of the shell, of a bend that rounding may make in a fall."""


@final
class HeldCheck(BalancedBars):
    """Bars of a shell that its supports hold, and lengths of its displacements, all in the frame of the supports.

    Attributes
    ----------
    least : float
        Displacement in the norm of the mass [kg^(1/2) m] that errors are shares of at least.
    sampled : SampledCheck or None
        What finds bars of modal states on a coarse shell.
    contacts : tuple of Contact
        Its contacts.
    """

    least = 0.0

    def __init__(
        self,
        shell: Shell,
        loading: Loading,
        damping: Damping,
        estimator: ErrorEstimator | None,
        sampled: SampledCheck | None = None,
        touching: TouchingFrames | None = None,
        supports: SupportPath | None = None,
    ) -> None:
        super().__init__(shell, loading, damping, supports, estimator=estimator, touching=touching)
        self.contacts = () if touching is None else touching.contacts
        self._rest, self._mass = shell.rest_positions, np.repeat(shell.mass, 3)
        self.sampled = sampled

    def refuse_inside(self, x: Array) -> None:
        """OptionError where a vertex begins inside a collider at positions x (n, 3) [m]."""
        if self._touching is not None:
            self._touching.refuse_inside(x)

    def touches_rough(self, x: Array, time: float) -> bool:
        """Whether a vertex at x (n, 3) [m] touches a collider that levels of modes do not take as it is."""
        return self._touching is not None and self._touching.touches_rough(x, time)

    def strike_ahead(self, x: Array, v: Array, time: float, dt: float) -> float:
        """Speed [kg^(1/2) m/s] that colliders take in the next ``dt`` [s] of what goes on from x (n, 3) at v (n, 3)."""
        return 0.0 if self._touching is None else self._touching.strike_ahead(x, v, time, dt)

    def supports_at(self, time: float) -> None:
        """None, as frames are in the frame of the supports; see :meth:`BalancedBars.supports_at`."""

    def local(self, x: Array) -> Array:
        """Positions (n, 3) [m] in the frames."""
        return x

    def apart(self, x: Array, y: Array) -> float:
        """Distance [kg^(1/2) m] of positions (n, 3) in the norm of the mass."""
        gap = (x - y).ravel()
        return math.sqrt(gap.dot(self._mass * gap))

    def moved(self, x: Array) -> float:
        """Displacement [kg^(1/2) m] of positions (n, 3) in the norm of the mass."""
        return self.apart(x, self._rest)

    def standing(self, force: Array, x: Array, v: Array) -> Array:
        """Load (n, 3) [N] in the frames that bends a shell at x, of velocities v, under forces (n, 3) [N]."""
        return force


@final
class FlownCheck:
    """The same of a shell with free parts, by their shapes alone; see :class:`HeldCheck`.

    Shapes are compared after the rigid motion of each part that fits best [kabsch1976]. Loads are balanced by the
    inertia of rigid motions at the shape, so that a part rests in its frame. For a bar it is held at three vertices,
    by as few reactions as hold it: they are zero under such a load.
    """

    sampled = None
    contacts = ()
    unjudged = ""

    def __init__(self, shell: Shell, parts: FreeParts, loading: Loading, damping: Damping) -> None:
        self._shell, self._loading, self._damping = shell, loading, damping
        self._rest, self._mass, self._parts = shell.rest_positions, shell.mass[:, None], parts.parts
        self._frames = FittedFrames(self._rest, parts)
        self._corners = [_corners(self._rest, part) for part in self._parts]
        supports: list[Support] = []
        for corners in self._corners:
            axes = _axes(self._rest[corners])
            supports += [Pin(corners[:1]), Roller(corners[1:2], tuple(axes[0])), _Across(corners[2:], axes[2])]
        self._estimator = ErrorEstimator(shell.also_supported(supports))
        self.least = _STILL * shell.mesh.extent * float(np.sqrt(shell.mass.sum()))

    def refuse_inside(self, x: Array) -> None:
        """See :meth:`HeldCheck.refuse_inside`; there are no contacts."""

    def touches_rough(self, x: Array, time: float) -> bool:
        """See :meth:`HeldCheck.touches_rough`."""
        return False

    def strike_ahead(self, x: Array, v: Array, time: float, dt: float) -> float:
        """See :meth:`HeldCheck.strike_ahead`."""
        return 0.0

    def local(self, x: Array) -> Array:
        """Positions (n, 3) [m] in the frames, which fit the shape at rest best."""
        return self._frames.local(x)

    def apart(self, x: Array, y: Array) -> float:
        """Distance [kg^(1/2) m] of shapes (n, 3) in the norm of the mass."""
        gap = FittedFrames(y, FreeParts(self._parts)).local(x) - y
        return float(np.sqrt(np.sum(self._mass * gap**2)))

    def moved(self, x: Array) -> float:
        """How far positions (n, 3) are bent [kg^(1/2) m] in the norm of the mass."""
        return self.apart(x, self._rest)

    def standing(self, force: Array, x: Array, v: Array) -> Array:
        """Load (n, 3) [N] in the frames that bends a shell at x, of velocities v, under forces (n, 3) [N]."""
        load = force.copy()
        for part in self._parts:
            arms, speed = (a[part.vertices] - part.mean(a[part.vertices]) for a in (x, v))
            spin = np.asarray(np.linalg.solve(inertia_of(part.moments(arms, arms)), axial(part.moments(arms, speed))))
            load[part.vertices] -= part.mass[:, None] * crossed(spin, crossed(spin, arms))
        return self._load_in_frames(x, load)

    def _load_in_frames(self, x: Array, load: Array) -> Array:
        """A load (n, 3) [N] at x (n, 3) [m], balanced by the inertia of parts, in the frames; zero if only rounding."""
        felt = load.copy()
        for part in self._parts:
            given, arms = load[part.vertices], x[part.vertices] - part.mean(x[part.vertices])
            rest = part.balanced(arms, given)
            if np.abs(rest).max() <= _ROUNDING * np.abs(given).max():
                rest[:] = 0.0
            felt[part.vertices] = rest @ self._frames.turn(part, x)
        return felt

    def bar_under(self, times: Array, frames: Array, dead: Array) -> tuple[ErrorBar, Array, Array | None]:
        """See :meth:`BalancedBars.bar_under`; in the frames."""
        now = instant_of(times, frames)
        load = balancing_load(now, self._shell, self._loading, self._damping, None, dead)
        felt = self._load_in_frames(now.positions, load)
        if not self._damping.strains:
            return self._bar(self.local(now.positions), felt), felt, None
        now = instant_of(times, np.stack([self.local(frame) for frame in frames]))  # a turn alone strains nothing
        ahead = strained_ahead(now, self._damping)
        assert ahead is not None
        begin = now.positions + ahead
        bar = self.static(begin, felt)
        corrected = FittedFrames(begin, FreeParts(self._parts)).local(bar.corrected)
        return replace(bar, corrected=corrected - ahead), felt, ahead

    def static(self, x: Array, load: Array, time: float = 0.0) -> ErrorBar:
        """Bar of an answer at x (n, 3) [m] in the frames that rests under a load (n, 3) [N]."""
        return self._bar(self.local(x), self._load_in_frames(x, load))

    def _bar(self, x: Array, load: Array) -> ErrorBar:
        """Bar at x (n, 3) [m] under a balanced load (n, 3) [N], both turned to where the supports are."""
        own, turned = x.copy(), load.copy()
        for part, corners in zip(self._parts, self._corners, strict=True):
            turn = _axes(x[corners]).T @ _axes(self._rest[corners])
            own[part.vertices] = (x[part.vertices] - x[corners[0]]) @ turn + self._rest[corners[0]]
            turned[part.vertices] = load[part.vertices] @ turn
        bar = self._estimator.bar(own, turned)
        if bar.message:
            return bar
        return replace(bar, displacement=self.off(bar, own) / max(self.moved(bar.corrected), self.least))

    def off(self, bar: ErrorBar, x: Array) -> float:
        """Distance [kg^(1/2) m] of a shape from that which a bar corrects it to."""
        return np.inf if bar.message else self.apart(bar.corrected, x)


Check = HeldCheck | FlownCheck


def free_parts_of(shell: Shell) -> FreeParts | None:
    """The parts that no support holds; None without any, OptionError where a part is held in part, or has creases."""
    loose = left_free(shell)
    if not loose:
        check_bar(shell)
        return None
    shell.refuse_creases("an error bar")
    parts = FreeParts.of(shell)
    if parts is None or rigid_motions(shell).shape[1] != 6 * len(parts.parts):
        raise OptionError(
            f"parts of a shell must be held by their supports, or have none, but {loose}: auto has no error bar for "
            "these; hold more vertices, or leave all supports out"
        )
    return parts


@final
class _Across(Support):
    """Holds a vertex along one direction."""

    def __init__(self, sel: Index, direction: Array) -> None:
        super().__init__(sel)
        self._direction = direction

    def directions(self) -> Array:
        """The one."""
        return self._direction[None]


def _corners(rest: Array, part: FreePart) -> Index:
    """Three vertices of a part that are far apart, and far from one line."""
    numbers = np.arange(len(rest))[part.vertices]
    x = rest[numbers]
    first = int(np.sum((x - part.mean(x)) ** 2, axis=1).argmax())
    arms = x - x[first]
    second = int(np.sum(arms**2, axis=1).argmax())
    third = int(np.sum(np.cross(arms, arms[second]) ** 2, axis=1).argmax())
    return np.asarray(numbers[[first, second, third]])


def _axes(corners: Array) -> Array:
    """Rows (3, 3): the direction from the first of three points (3, 3) to the second, across it, and their normal."""
    along = corners[1] - corners[0]
    normal = np.cross(along, corners[2] - corners[0])
    along, normal = along / np.linalg.norm(along), normal / np.linalg.norm(normal)
    return np.stack([along, np.cross(normal, along), normal])
