"""Contacts of motions whose frames get error bars: which frames are judged, and the friction in them (theory 14)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.error_bar import ContactEstimator
from modalshell.contact.friction import Friction
from modalshell.contact.touching import INSIDE, checked_contacts
from modalshell.core.touched import PUSHED_OUT, STRUCK, UNSETTLED
from modalshell.core.typing import Array
from modalshell.shell import Shell
from modalshell.statics.error_bar import ErrorBar
from modalshell.supports import SupportPath
from modalshell.supports.constraints import LedVertices

_STRIKE = 0.01
"""Force of a strike, over that in balance, from which a frame is not judged."""


@final
class TouchingFrames:
    """Finds the bars of frames of a motion with contacts, each with the colliders where they are then.

    Friction is a load of the frame: the motion up to then has made it. It acts in parts of steps of a length ``part``
    [s], None without friction. ``supports`` hold the shell and move it: positions, and those of ``led`` vertices,
    which constraints lead, are in their frame. OptionError for what is no contact.

    Attributes
    ----------
    contacts : tuple of Contact
        The contacts.
    estimator : ContactEstimator
        What finds the bars.
    """

    def __init__(
        self,
        shell: Shell,
        contacts: Sequence[Contact],
        supports: SupportPath | None = None,
        part: float | None = None,
        led: LedVertices | None = None,
    ) -> None:
        self.contacts = given = checked_contacts(contacts, supports)
        self.estimator = ContactEstimator(shell, given, led, rubbed=True)
        self._touching, self._origin, self._mass = self.estimator.touching, self.estimator.origin, shell.mass
        self._yields = np.array([contact.push_out > 0.0 for contact in given])
        self._part = part
        rough = np.array([contact.rough for contact in given])
        self._rough = np.flatnonzero(rough[self._touching.contact_of])

    def refuse_inside(self, x: Array) -> None:
        """OptionError where a vertex at x (n, 3) [m] lies inside a collider at time 0."""
        self._touching.refuse_inside(x - self._origin)

    def touches_rough(self, x: Array, time: float) -> bool:
        """Whether a vertex at x (n, 3) [m] touches a collider with friction, restitution or ``push_out``, or nearly."""
        if not self._rough.size:
            return False
        gaps = self._touching.at(time).distances(x - self._origin)
        return bool((gaps[self._rough] <= INSIDE * self._touching.size).any())

    def strike_ahead(self, x: Array, v: Array, time: float, dt: float) -> float:
        """Speed in the norm of the mass [kg^(1/2) m/s] that what comes to touch in the next ``dt`` [s] would lose.

        That is of vertices at x (n, 3) [m] which go on at v (n, 3) [m/s] from ``time`` [s].
        """
        touching, own = self._touching, x - self._origin
        now, after = touching.at(time).distances(own), touching.at(time + dt).distances(own + dt * v)
        struck = (now > INSIDE * touching.size) & (after < 0.0)
        return float(np.sqrt(self._mass[touching.vertices[struck]] @ (now - after)[struck] ** 2)) / dt

    def bar(self, times: Array, frames: Array, load: Array, ahead: Array | None = None) -> tuple[ErrorBar, str]:
        """Bar of the middle one of three frames (3, n, 3) [m] at ``times`` (3,) [s], and why it is not judged, or "".

        ``load`` (n, 3) [N] is that in balance, with d'Alembert's; see :meth:`Estimator.bar` of ``ahead``.
        """
        reason = self._unjudged(times, frames, load)
        if reason:
            return ErrorBar(np.inf, -np.inf, 0.0, False, frames[1].copy(), 0.0, reason), reason
        self.estimator.look(float(times[1]), ahead)
        bar = self.estimator.bar(frames[1], load, time=float(times[1]), ahead=ahead)
        if not self.estimator.unsettled:
            return bar, ""
        return bar, STRUCK if self._strike(times, frames) > 0.0 else UNSETTLED

    def friction(self, times: Array, frames: Array, forces: Array) -> Array:
        """Friction (n, 3) [N] in the middle one of three frames, of contact ``forces`` (3, n, 3) [N] of their steps.

        That of the steps before and after it, by Coulomb's law from normal forces and slips; the mean of the two.
        """
        rubbing = np.zeros_like(frames[1])
        if self._part is not None:
            own = frames - self._origin
            for k in (1, 2):
                share = min(1.0, self._part / float(times[k] - times[k - 1]))
                before, dt = self._touching.at(float(times[k - 1])), share * float(times[k] - times[k - 1])
                law = Friction(before, self._pushes(float(times[k]), own[k], forces[k]), own[k - 1], dt, self._part)
                rubbing -= 0.5 * law.forces(own[k - 1] + share * (own[k] - own[k - 1]))
        return rubbing

    def _pushes(self, time: float, x: Array, force: Array) -> Array:
        """Forces (r,) [N] along the normals of what touches at x (n, 3) [m], of contact forces (n, 3) [N]."""
        touching, least = self._touching.at(time), np.full(len(x), np.inf)
        pushes = np.zeros(touching.vertices.size)
        rows = np.flatnonzero(force[touching.vertices].any(axis=1))
        gaps, normals, _ = touching.gaps(x, rows)
        vertices = touching.vertices[rows]
        np.minimum.at(least, vertices, gaps)
        near = gaps <= np.maximum(least[vertices], INSIDE * touching.size)  # fine vertices of a coarse shell are off
        for vertex in np.unique(vertices[near]):
            own = np.flatnonzero(near & (vertices == vertex))
            pushes[rows[own]] = np.maximum(np.linalg.pinv(normals[own].T) @ force[vertex], 0.0)
        return pushes

    def _unjudged(self, times: Array, frames: Array, load: Array) -> str:
        """Why the middle one of three frames cannot be judged by statics; "" where it can."""
        touching = self._touching.at(float(times[1]))
        deep = touching.distances(frames[1] - self._origin) < -INSIDE * touching.size
        if (deep & self._yields[touching.contact_of]).any():
            return PUSHED_OUT
        return STRUCK if self._strike(times, frames) > _STRIKE * np.linalg.norm(load, axis=1).sum() else ""

    def _strike(self, times: Array, frames: Array) -> float:
        """Force [N] that takes their speeds from vertices which come to touch within three frames, in one's time."""
        touching, steps = self._touching, np.diff(times)
        before, now, after = (
            touching.at(float(time)).distances(frame - self._origin) for time, frame in zip(times, frames, strict=True)
        )
        near = INSIDE * touching.size
        slowed = (after - now) / steps[1] - (now - before) / steps[0]
        struck = (before > near) & (np.minimum(now, after) <= near) & (slowed > 0.0)
        return float(self._mass[touching.vertices[struck]] @ slowed[struck] / steps[1])
