"""Contact: a collider, the vertices that may touch it, and what happens where they do."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, ClassVar, Self, final

import numpy as np

from modalshell.contact.base import Collider, Gap
from modalshell.core.checks import checked_kind, checked_number
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, selected
from modalshell.supports import Pose, SupportPath

_SAMPLES = 20_000
"""Steps of a path whose lengths are looked at, at most."""


@final
class _RelativePath:
    """The path of a collider in the world, or of one at rest there, as it is seen from a frame that moves."""

    def __init__(self, path: SupportPath | None, frame: SupportPath) -> None:
        self._path, self._frame = path, frame
        self.times = frame.times if path is None else np.union1d(frame.times, path.times)

    def at(self, time: float) -> Pose:
        """Where it is at ``time`` [s]."""
        frame, turn, place, none = self._frame.at(time), np.eye(3), np.zeros((1, 3)), np.zeros(3)
        if self._path is not None:
            pose = self._path.at(time)
            turn, place = pose.rotation, pose.to_world(place)
        return Pose(frame.rotation.T @ turn, frame.to_shell(place)[0], none, none, none, none, none)

    def velocities(self, own: Array, time: float) -> Array:
        """Velocities (n, 3) [m/s] in the frame of what rests in the collider at points (n, 3) [m] of its own axes."""
        frame, place, speed = self._frame.at(time), own, np.zeros_like(own)
        if self._path is not None:
            pose = self._path.at(time)
            place, speed = pose.to_world(own), pose.world_velocities(own, speed)
        return (speed - frame.world_velocities(frame.to_shell(place), np.zeros_like(own))) @ frame.rotation


@final
class _Stopped:
    """The path of a collider that has stopped."""

    times = np.array([0.0, 1.0])

    def __init__(self, pose: Pose) -> None:
        self._pose = replace(pose, turn_rate=np.zeros(3), velocity=np.zeros(3))

    def at(self, time: float) -> Pose:  # noqa: ARG002 (it is always there)
        """Where it is."""
        return self._pose


@final
class Contact(ReadOnlyArrays):
    """Keeps vertices of a shell out of a collider: ``0 <= force _|_ gap >= 0`` at each of them.

    Vertices touch, edges and triangles between them do not: on a convex collider of radius r a triangle of edge l
    dips in by ``l^2 / (8 r)``. Vertices that supports hold wholly take no part; ``sel`` of these alone is refused.

    Parameters
    ----------
    collider : Collider
        What is not entered.
    sel : str, array_like of bool, shape (n,), or of int
        The vertices that may touch it; ``"all"`` are all of them.
    friction : float
        Coulomb's coefficient. Statics of DS solve stick and slip exactly, on a way of ten steps of the load from rest,
        or of one from a start: smaller ones are calls from start to start. In motion it is smoothed.
    restitution : float
        Share of the normal speed that a vertex keeps when it strikes, 0 to 1.
    motion : SupportPath, optional
        Moves the collider as a rigid body. Statics take it as it is at time 0.
    push_out : float
        Speed [m/s] up to which vertices that begin inside are pushed out; 0 refuses such a start. In
        statics any speed above 0 allows it.

    Raises
    ------
    OptionError
        For what is no collider or path, an invalid selection, a negative friction or speed, or a restitution beyond
        [0, 1].
    """

    has_surface: ClassVar = True
    """Whether it has a surface to draw."""

    def __init__(
        self,
        collider: Collider,
        sel: Selection = "all",
        friction: float = 0.0,
        restitution: float = 0.0,
        motion: SupportPath | None = None,
        *,
        push_out: float = 0.0,
    ) -> None:
        self.collider = checked_kind("collider", collider, Collider)  # type: ignore[type-abstract]
        self.sel = sel if isinstance(sel, str) and sel == "all" else checked_selection("sel", sel)
        self.friction = checked_number("friction", friction, at_least=0.0)
        self.restitution = checked_number("restitution", restitution, at_least=0.0, at_most=1.0)
        self.motion: SupportPath | _RelativePath | _Stopped | None = None
        if motion is not None:
            self.motion = checked_kind("motion", motion, SupportPath)
        self.push_out = checked_number("push_out", push_out, at_least=0.0, unit="m/s")

    @property
    def rough(self) -> bool:
        """Whether it has friction, restitution or ``push_out``."""
        return bool(self.friction or self.restitution or self.push_out)

    def __repr__(self) -> str:
        return f"Contact({type(self.collider).__name__}, sel={self.sel!r})"

    def seen_from(self, frame: SupportPath | None) -> Self:
        """The same contact in the moving ``frame`` of a shell's supports; itself without one."""
        if frame is None:
            return self
        seen = copy.copy(self)
        seen.motion = _RelativePath(self.motion if isinstance(self.motion, SupportPath) else None, frame)
        return seen

    def on(self, chosen: Mask) -> Self:
        """The same contact of the vertices ``chosen`` (k,) of another mesh."""
        other = copy.copy(self)
        other.sel = chosen
        return other

    def vertices(self, mesh: TriangleMesh) -> Mask:
        """Mask (n,) of its vertices of a mesh; OptionError where it selects none."""
        if isinstance(self.sel, str) and self.sel == "all":
            return np.ones(len(mesh.vertices), dtype=bool)
        return selected("sel", self.sel, mesh)

    def gap(self, x: Array, t: float = 0.0) -> Gap:
        """Gap of points (n, 3) [m] from the collider where its motion has brought it; see :meth:`Collider.gap`."""
        if self.motion is None:
            return self.collider.gap(x, t)
        pose = self.motion.at(t)
        gap, normal, curvature = self.collider.gap(pose.to_shell(x), t)
        turn = pose.rotation
        return gap, normal @ turn.T, turn @ curvature @ turn.T

    def normal(self, x: Array, t: float = 0.0) -> Array:
        """Normals (n, 3) of the collider at points (n, 3) [m]."""
        if self.motion is None:
            return self.collider.gap(x, t)[1]
        pose = self.motion.at(t)
        return np.asarray(self.collider.gap(pose.to_shell(x), t)[1] @ pose.rotation.T)

    def distance(self, x: Array, t: float = 0.0) -> Array:
        """Gap (n,) [m] of points (n, 3) [m] alone."""
        return self.collider.distance(x if self.motion is None else self.motion.at(t).to_shell(x), t)

    def _nearest(self, x: Array, t: float = 0.0) -> Array:
        """The collider's points (n, 3) [m] that are nearest to points (n, 3) [m]; these themselves inside it."""
        gap, normal, _ = self.gap(x, t)
        return np.asarray(x - np.maximum(gap, 0.0)[:, None] * normal)

    def velocity(self, x: Array, t: float = 0.0) -> Array:
        """Velocity (n, 3) [m/s] of the collider at points (n, 3) [m]."""
        if self.motion is None:
            return self.collider.velocity(x, t)
        pose = self.motion.at(t)
        own = pose.to_shell(x)
        moves, led = self.collider.velocity(own, t), self.motion
        if isinstance(led, _RelativePath):
            return np.asarray(led.velocities(own, t) + moves @ pose.rotation.T)
        return pose.world_velocities(own, moves)

    def way(self, x: Array, t: float, dt: float) -> Array:
        """Way (n, 3) [m] of the collider's material that is at points (n, 3) [m] from ``t`` to ``t + dt`` [s]."""
        if self.motion is None:
            return dt * self.collider.velocity(x, t)
        pose = self.motion.at(t)
        own = pose.to_shell(x)
        return np.asarray(self.motion.at(t + dt).to_world(own + dt * self.collider.velocity(own, t)) - x)

    def largest_move(self, x: Array, t: float, dt: float) -> float:
        """Longest way [m] of the collider's material at points (n, 3) [m] in a step from ``t`` to ``t + dt`` [s]."""
        return float(np.linalg.norm(self.way(x, t, dt), axis=1).max(initial=0.0))

    def fastest(self, x: Array, dt: float, least: float) -> tuple[float, float]:
        """Longest :meth:`largest_move` [m] of all steps of ``dt`` [s], and its start [s]; ``least``, 0 if none longer.

        Material far from a collider that turns about itself moves farther than its surface does: so the points of the
        surface nearest to ``x`` (n, 3) [m] count where they move less than x.
        """
        if self.motion is None:
            return least, 0.0
        times, longest = self.motion.times, (least, 0.0)
        count = min(int(np.ceil((times[-1] - times[0]) / dt)) + 1, _SAMPLES)
        for time in np.linspace(times[0] - dt, times[-1], count + 1).tolist():
            way = self.largest_move(x, time, dt)
            if way > longest[0]:
                way = min(way, self.largest_move(self._nearest(x, time), time, dt))
                longest = max(longest, (way, max(time, 0.0)))
        return longest

    def surfaces(self, corners: Array, times: Array, inset: float = 0.0) -> tuple[Array, Index]:
        """Vertices (F, k, 3) [m] of the collider's surface at some times (F,) [s], and its triangles (T, 3).

        Those ``inset`` [m] below the surface, or half the depth of a thin body, do not hide what lies on it.
        """
        vertices, triangles = self._surface(corners, inset)
        if self.motion is None:
            return vertices[None], triangles
        return np.stack([self.motion.at(float(time)).to_world(vertices) for time in times]), triangles

    def _surface(self, corners: Array, inset: float) -> tuple[Array, Index]:
        vertices, triangles = self.collider.surface(corners)
        inset = min(inset, 0.5 * self.collider.smallest_radius)
        for _ in range(6 if inset else 0):  # corners lie on up to three faces, and may be moved between them first
            gap, normal, _ = self.collider.gap(vertices)
            vertices = vertices - np.maximum(gap + inset, 0.0)[:, None] * normal
        return vertices, triangles

    def body(self, corners: Array, times: Array, inset: float = 0.0) -> tuple[Array, Index, Array, Array]:
        """Vertices (k, 3) [m] and triangles (T, 3) of the collider, its rotations (F, 3, 3) and ways (F, 3) [m]."""
        vertices, triangles = self._surface(corners, inset)
        if self.motion is None:
            return vertices, triangles, np.eye(3)[None], np.zeros((1, 3))
        poses = [self.motion.at(float(time)) for time in times]
        turns = np.array([pose.rotation for pose in poses])
        return vertices, triangles, turns, np.array([pose.to_world(np.zeros((1, 3)))[0] for pose in poses])

    def plain(self) -> dict[str, Any]:
        """Its parameters and those of its collider, as texts and lists."""
        sel = self.sel.tolist() if isinstance(self.sel, np.ndarray) else self.sel
        numbers = {"friction": self.friction, "restitution": self.restitution, "push_out": self.push_out}
        return {"kind": self.collider.key, **self.collider.plain(), "sel": sel, **numbers}


def smooth(contact: Contact) -> Contact:
    """The same contact without friction, restitution and ``push_out``; itself where it has none."""
    if not contact.rough:
        return contact
    other = copy.copy(contact)
    other.friction = other.restitution = other.push_out = 0.0
    return other


def stopped(contact: Contact, time: float) -> Contact:
    """The same contact with its collider at rest where it is at ``time`` [s]."""
    if contact.motion is None:
        return contact
    still = copy.copy(contact)
    still.motion = _Stopped(contact.motion.at(time))
    return still
