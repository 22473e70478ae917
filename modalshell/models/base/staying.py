"""What contacts push, in steps that leave all of it pushed, at these vertices alone (theory 13, eq. 7 and 8).

A vertex that a part of a step would take inside would be pushed, and no longer would what is pushed stay as it is. So
no other vertex is a candidate, and all are looked at once, at the step's end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.contact import warp_kernels
from modalshell.contact.modal import ModalContacts
from modalshell.contact.modal_kernels import arrive, go_on, implicit_euler
from modalshell.contact.modal_rows import FAR, SETTLED, SMALL
from modalshell.contact.pressed import Pressed
from modalshell.core.cost import count_read
from modalshell.core.typing import Array, Index
from modalshell.integrators.full.second_order import GAMMA
from modalshell.integrators.modal.base import DeadForce
from modalshell.kernels.push import POWERS


class Parts(NamedTuple):
    """Both parts of a step of SDIRK2.

    Attributes
    ----------
    rates : ndarray, shape (m,)
        At its end.
    force : ndarray, shape (m,)
        Modal force of the second part.
    given : float
        Work [J] of moving colliders.
    bent : float
        Square of the change of the rates' derivative in the step.
    after, before : tuple of float
        Kinetic and elastic energies [J] of the modes at its end and its beginning.
    """

    rates: Array
    force: Array
    given: float
    bent: float
    after: tuple[float, float]
    before: tuple[float, float]


class Staying(ABC):
    """Steps of implicit Euler on what stays pushed, one after the other.

    Parameters
    ----------
    pressing : ModalContacts
        The contacts.
    eigenvalues : ndarray, shape (m,)
        Stiffness of the modes [1/s^2].
    """

    def __init__(self, pressing: ModalContacts, eigenvalues: Array) -> None:
        self._pressing, self._eigenvalues = pressing, eigenvalues

    @abstractmethod
    def begin(self, before: Pressed) -> None:
        """Begin where contacts push ``before``."""

    @abstractmethod
    def part(self, begin: tuple[Array, Array], force: Array, dt: float, compliance: Array) -> Array | None:
        """Coordinates (m,) where a step of ``dt`` [s] ends, under a modal ``force`` (m,); None where a vertex opens.

        ``begin`` are coordinates and rates (m,), ``compliance`` is G.
        """

    @abstractmethod
    def now(self) -> tuple[Index, Array, Array]:
        """Rows (k,) that are pushed, forces (k,) [N] on them now, and where (k, 3) [m] their vertices are."""

    def _given(self) -> float:
        """Power [W] that moving colliders give now."""
        touching, (rows, forces, points) = self._pressing.touching, self.now()
        x = np.zeros_like(touching.shell.rest_positions)
        x[touching.vertices[rows]] = points
        along = np.sum(touching.normals(x, rows) * touching.velocities(x, rows), axis=1)
        return float(forces @ along)

    def twice(
        self, begin: tuple[Array, Array], dead: DeadForce, when: tuple[float, float], compliance: Array
    ) -> Parts | None:
        """Both parts of a step of SDIRK2 under a dead load; None where a vertex opens.

        ``when`` it begins, and how long it is [s].
        """
        (q, rates), (time, dt), pressing, given = begin, when, self._pressing, 0.0
        part = GAMMA * dt
        pressing.at(time + part)
        half = self.part(begin, dead.at(q + part * rates), part, compliance)
        if half is None:
            return None
        if pressing.moving:
            given = (dt - part) * self._given()
        pressing.at(time + dt)
        go_on(q, rates, half, dt, GAMMA, begun := np.empty((4, q.size)))
        force = dead.at(begun[3])
        last = self.part((begun[0], begun[1]), force, part, compliance)
        if last is None:
            return None
        if pressing.moving:
            given += part * self._given()
        ends = np.empty((2, q.size))
        ends[0] = last
        return Parts(ends[1], force, given, *arrive(q, rates, half, dt, GAMMA, begun, self._eigenvalues, ends))

    @abstractmethod
    def end(self) -> Pressed | None:
        """Where the last part has led; None where it leads another vertex inside."""


def staying(pressing: ModalContacts, eigenvalues: Array) -> Staying:
    """The steps on some contacts."""
    return (StayingRows if pressing.asks else StayingWarp)(pressing, eigenvalues)


@final
class StayingWarp(Staying):
    """Those of warps in closed form on colliders of known forms, which are compiled."""

    def __init__(self, pressing: ModalContacts, eigenvalues: Array) -> None:
        super().__init__(pressing, eigenvalues)
        size = pressing.touching.size
        self._limits = SETTLED * size, FAR * size, SMALL * size
        self._kept: Any = None
        self._chosen = -1, b""
        self._found: tuple[Array, Array, Array, Array]
        self._energy = 0.0

    def begin(self, before: Pressed) -> None:
        """See :meth:`Staying.begin`."""
        rows = np.flatnonzero(before.pushes)
        shapes, key = self._pressing.shapes, rows.tobytes()
        if self._chosen != (shapes.begun, key):
            self._kept = self._pressing.gathered(rows)
            self._chosen = shapes.begun, key
        local = before.local[self._kept[1]].T.copy()
        self._found = before.q, before.pushes[rows], local, np.empty((rows.size, 3))

    def part(self, begin: tuple[Array, Array], force: Array, dt: float, compliance: Array) -> Array | None:
        """See :meth:`Staying.part`."""
        step = *begin, force, compliance, self._eigenvalues, dt
        found = self._found = np.empty(force.size), *self._found[1:]
        self._energy, stays = warp_kernels.stay(self._kept, self._pressing.bodies, step, found, self._limits)
        return found[0] if stays else None

    def now(self) -> tuple[Index, Array, Array]:
        """See :meth:`Staying.now`."""
        (q, forces, local, _), (rows, vertices) = self._found, self._kept[:2]
        return rows, forces, self._pressing.positions(q)[vertices] + local.T

    def twice(
        self, begin: tuple[Array, Array], dead: DeadForce, when: tuple[float, float], compliance: Array
    ) -> Parts | None:
        """See :meth:`Staying.twice`; in one call on colliders at rest where the force is compiled, too."""
        if dead.push is None or self._pressing.moving:
            return super().twice(begin, dead, when, compliance)
        dt = when[1]
        count_read(2 * dead.push[0].nbytes)
        ends, force, further = np.empty((2, compliance.size)), np.empty(compliance.size), self._found[1:]
        step, push = (*begin, compliance, self._eigenvalues, dt, GAMMA), (*dead.push, POWERS)
        given = self._kept, self._pressing.bodies, push, step, (ends, *further, force), self._limits
        self._energy, stays, ended = warp_kernels.stay_twice(*given)
        self._found = ends[0], *further
        return Parts(ends[1], force, 0.0, *ended) if stays else None

    def end(self) -> Pressed | None:
        """See :meth:`Staying.end`."""
        (q, forces, _, turned), (rows, _, slots) = self._found, self._kept[:3]
        base, local, gaps, least = self._pressing.ended(q, slots, turned)
        if not least >= -self._limits[0]:
            return None
        pushes = self._pressing.no_pushes
        pushes[rows] = forces
        return Pressed(q, local, pushes, True, base, self._energy, None, gaps)


@final
class StayingRows(Staying):
    """Those of models and colliders whose derivatives are asked for."""

    _rows: Index
    _state: Pressed
    _turned: Array

    def begin(self, before: Pressed) -> None:
        """See :meth:`Staying.begin`."""
        self._rows, self._state = np.flatnonzero(before.pushes), before
        if self._pressing.by_rows.alone:
            vertices, base = self._pressing.touching.vertices[self._rows], before.positions
            assert base is not None
            self._state = before._replace(
                local=before.local[vertices], pushes=before.pushes[self._rows], positions=base[vertices]
            )

    def part(self, begin: tuple[Array, Array], force: Array, dt: float, compliance: Array) -> Array | None:
        """See :meth:`Staying.part`."""
        ends = np.empty((3, force.size))
        implicit_euler(*begin, force, compliance, self._eigenvalues, dt, ends)
        found, turned = self._pressing.by_rows.stay(ends[0], compliance, self._state, ends[2], self._rows)
        if found is None or turned is None:
            return None
        self._state, self._turned = found, turned
        return found.q

    def now(self) -> tuple[Index, Array, Array]:
        """See :meth:`Staying.now`."""
        rows, found = self._rows, self._state
        assert found.positions is not None
        points, forces = found.positions + found.local, found.pushes
        if self._pressing.by_rows.alone:
            return rows, forces, points
        return rows, forces[rows], points[self._pressing.touching.vertices[rows]]

    def end(self) -> Pressed | None:
        """See :meth:`Staying.end`."""
        found, pressing = self._state, self._pressing
        if not pressing.by_rows.alone:
            return found
        slots = pressing.shapes.between(pressing.touching.vertices[self._rows])[0]
        base, local, gaps, least = pressing.ended(found.q, slots, self._turned)
        if not least >= -SETTLED * pressing.touching.size:
            return None
        pushes = pressing.no_pushes
        pushes[self._rows] = found.pushes
        return found._replace(local=local, pushes=pushes, positions=base, gaps=gaps)
