"""What colliders leave a shell of room in a motion, and the most work that they may have done on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, final

import numpy as np

from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Mask
from modalshell.mesh import TriangleMesh

_LOOKED_AT = 8
"""Vertices, the deepest, that are asked for room."""
_NOTHING = 1e-9
"""What is left of a problem of least squares, whose right side is one, that is none."""
_SPEEDS = 2.0
"""Speed of a collider at a strike within a frame, at most, over its mean in that."""
_DEEP = 1e-3
"""Depth of a vertex, as a share of the shell's size, from which it is asked whether there is room."""
_TORN = 1e3
"""Extent in contact, in the shell's size, at which a state beyond its model ends the motion."""


@final
class ColliderAccount:
    """What the stored frames of one motion tell of its colliders.

    Parameters
    ----------
    contacts : sequence of Contact
        The contacts; self-contact has no collider.
    mesh : TriangleMesh
        The shell's.
    add : bool
        Whether the steps may add energy on colliders, so that the work of moving ones is asked for.

    Attributes
    ----------
    contacts : list of (int, Contact)
        Those with colliders, and their places among all.
    moving : bool
        Whether a collider moves.
    crowded : str
        What is said of a vertex that colliders have left no room; "" as long as they have.
    torn : float
        Extent [m] of a state in contact, beyond its model; 0 of none so large that the motion should end.
    worked : float
        The most work [J] that moving colliders may have done, if every step was a frame and it was asked for.
    """

    def __init__(self, contacts: Sequence[Any], mesh: TriangleMesh, *, add: bool) -> None:
        self.contacts = [(index, one) for index, one in enumerate(contacts) if hasattr(one, "collider")]
        self._mesh, self.moving = mesh, any(one.motion is not None for _, one in self.contacts)
        self.crowded, self.torn, self.worked = "", 0.0, 0.0
        self._counts = add and self.moving
        self._before: tuple[float, Array] | None = None

    @cached_property
    def _chosen(self) -> list[Mask]:
        """Vertices (n,) that may touch each collider."""
        return [one.vertices(self._mesh) for _, one in self.contacts]

    def knows_work(self, store_every: int) -> bool:
        """Whether the work of all colliders is known: of those that rest it is none."""
        return not self.moving or (self._counts and store_every == 1)

    def see(self, positions: Callable[[], Array], time: float, touched: TouchedFrame, *, beyond: bool) -> None:
        """Take note of a frame at ``time`` [s], with its ``positions`` (n, 3) [m] where these are asked for.

        ``beyond`` says that they are beyond the model.
        """
        deep = self._is_deep(touched)
        if not (self._counts or beyond or deep):
            return
        x = positions()
        if deep and (found := self._without_room(x, time)) is not None:
            vertex, between = found
            who = " and ".join(str(index) for index in between)
            self.crowded = (
                f"contacts {who} leave vertex {vertex} no room at {time:.6g} s: nothing fits between their colliders, "
                "part them"
            )
        if self._counts:
            if self._before is not None:
                self.worked += self._most_work(*self._before, time, touched)
            self._before = time, x
        extent = float(np.ptp(x, axis=0).max())
        if beyond and extent > _TORN * self._mesh.size:
            self.torn = extent

    def dips(self, x: Array, time: float, touched: TouchedFrame) -> str:
        """What is said of edges of vertices at x (n, 3) [m] that touch at ``time`` [s]; "" where none dips in."""
        deepest, ends = 0.0, self._mesh.edges
        for (_, one), may_touch in zip(self.contacts, self._chosen, strict=True):
            near = ends[(may_touch & touched.touches)[ends].any(axis=1) & may_touch[ends].all(axis=1)]
            deepest = max(deepest, -float(one.distance(x[near].mean(axis=1), time).min(initial=0.0)))
        if not deepest > _DEEP * self._mesh.size:
            return ""
        return f"at the end edges dip up to {deepest:.2g} m into a collider between their vertices: take a finer mesh"

    def _is_deep(self, touched: TouchedFrame) -> bool:
        return not self.crowded and touched.deepest > _DEEP * self._mesh.size and len(self.contacts) > 1

    def _without_room(self, x: Array, time: float) -> tuple[int, list[int]] | None:
        """A vertex at x (n, 3) [m] that colliders leave no room, and their contacts; None if there is none.

        By the gaps and normals where it is: no way d within the shell's size has ``n . d >= -gap`` for all of them.
        The shortest way is what is left of a problem of non-negative least squares, and its shares are those of the
        colliders; where nothing is left there is no way at all.
        """
        import scipy.optimize  # not where nothing is deep inside

        gaps = [one.distance(x, time) for _, one in self.contacts]
        depth = np.min([np.where(chosen, gap, np.inf) for chosen, gap in zip(self._chosen, gaps, strict=True)], axis=0)
        for vertex in np.argsort(depth, kind="stable")[:_LOOKED_AT]:
            if not depth[vertex] < 0.0:
                break
            own = [one for one, chosen in zip(self.contacts, self._chosen, strict=True) if chosen[vertex]]
            near = [(index, one.gap(x[[vertex]], time)) for index, one in own]
            rows = np.array([[*normal[0], gap[0] / self._mesh.size] for _, (gap, normal, _) in near])
            if not np.isfinite(rows).all():
                continue
            shares, left = scipy.optimize.nnls(rows.T, np.array([0.0, 0.0, 0.0, -1.0]))
            way = rows.T @ shares
            if left < _NOTHING or np.linalg.norm(way[:3]) > abs(way[3] + 1.0):
                return int(vertex), [index for (index, _), share in zip(near, shares, strict=True) if share > 0.0]
        return None

    def _most_work(self, begin: float, x: Array, end: float, touched: TouchedFrame) -> float:
        """Most work [J] of moving colliders in a step from x (n, 3) [m], between two times [s], by its mean forces."""
        if not touched.touches.any():
            return 0.0
        pushed, most = np.linalg.norm(touched.forces, axis=1), 0.0
        for (_, one), may_touch in zip(self.contacts, self._chosen, strict=True):
            chosen = may_touch & (pushed > 0.0)
            if chosen.any():
                moved = np.linalg.norm(one.way(x[chosen], begin, end - begin), axis=1)
                most += _SPEEDS * (1.0 + one.friction) * float(pushed[chosen] @ moved)
        return most
