"""What contacts push, in steps that leave all of it pushed, at these vertices alone (theory 13, eq. 7 and 8).

A vertex that a part of a step would take inside would be pushed, and no longer would what is pushed stay as it is. So
no other vertex is a candidate, and all are looked at once, at the step's end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, cast, final

import numpy as np

from modalshell.contact.modal import ModalContacts
from modalshell.contact.modal_kernels import arrive, given_back, go_on, implicit_euler
from modalshell.contact.modal_rows import FAR, NEARLY, SETTLED, SMALL, STILL
from modalshell.contact.pressed import Pressed
from modalshell.contact.stay_kernels import OTHERS, STAYS, stay, stay_whole
from modalshell.core.cost import count_products, count_read
from modalshell.core.typing import Array, Index
from modalshell.integrators.full.second_order import GAMMA
from modalshell.integrators.modal.base import DeadForce
from modalshell.kernels.push import DERIVATIVES, POWERS

_NONE = np.empty((0, 3))
"""No load: a step may gain what it gains."""


class Whole(NamedTuple):
    """The end of a step of SDIRK2."""

    pressed: Pressed
    """Where contacts leave the shell."""
    rates: Array
    force: Array
    """Rates, and modal force of the second part; shape (m,)."""
    bent: float
    """Square of the change of the rates' derivative in the step."""


class Parts(NamedTuple):
    """Both parts of a step of SDIRK2."""

    rates: Array
    """At its end; shape (m,)."""
    force: Array
    """Modal force of the second part; shape (m,)."""
    given: float
    """Work [J] of moving colliders."""
    bent: float
    """Square of the change of the rates' derivative in the step."""
    after: tuple[float, float]
    before: tuple[float, float]
    """Kinetic and elastic energies [J] of the modes at its end and its beginning."""


class Staying(ABC):
    """Steps of implicit Euler on what stays pushed, one after the other.

    ``eigenvalues`` (m,) are the stiffness of the modes [1/s^2]. Of a ``conservative`` modal force, one with a
    potential, a step is to gain no more than its load's work.
    """

    def __init__(self, pressing: ModalContacts, eigenvalues: Array, conservative: bool) -> None:
        self._pressing, self._eigenvalues, self._conservative = pressing, eigenvalues, conservative

    @abstractmethod
    def begin(self, before: Pressed) -> None:
        """Begin where contacts push ``before``."""

    @abstractmethod
    def part(self, begin: tuple[Array, Array], near: Array, force: Array, dt: float, compliance: Array) -> Array | None:
        """Coordinates (m,) where a step of ``dt`` [s] ends, under a modal ``force`` (m,); None where a vertex opens.

        ``begin`` are coordinates and rates (m,), ``near`` is where the end is looked for first, ``compliance`` is G.
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

    def whole(
        self, before: Pressed, rates: Array, dead: DeadForce, load: Array, when: tuple[float, float], compliance: Array
    ) -> Whole | None:
        """A step of SDIRK2 under a dead load (n, 3) [N]; None where it does not stay, or gains more than little energy.

        It begins at :meth:`begin`'s ``before`` with ``rates`` (m,); ``when``, and how long it is [s].
        """
        self.begin(before)
        parts = self._twice((before.q, rates), dead, when, compliance)
        end = None if parts is None else self.end()
        return None if parts is None or end is None else self._whole(before, end, parts, dead, load)

    def _whole(self, before: Pressed, end: Pressed, parts: Parts, dead: DeadForce, load: Array) -> Whole | None:
        """A step with an end; None where it gains more than little energy."""
        slower, work = 1.0, dead.work
        if self._conservative:
            if work is None:
                assert end.positions is not None
                assert before.positions is not None
                done = float(np.vdot(load, end.positions - before.positions))
            else:
                done = work(end.q) - work(before.q)
            slower = given_back((*parts.after, end.energy), (*parts.before, before.energy), done + parts.given)
        return Whole(end, slower * parts.rates, parts.force, parts.bent) if slower else None

    def _twice(
        self, begin: tuple[Array, Array], dead: DeadForce, when: tuple[float, float], compliance: Array
    ) -> Parts | None:
        """Both parts of a step; None where a vertex opens."""
        (q, rates), (time, dt), pressing, given = begin, when, self._pressing, 0.0
        part = GAMMA * dt
        pressing.at(time + part)
        near = q + part * rates
        half = self.part(begin, near, dead.at(near), part, compliance)
        if half is None:
            return None
        if pressing.moving:
            given = (dt - part) * self._given()
        pressing.at(time + dt)
        go_on(q, rates, half, dt, GAMMA, begun := np.empty((4, q.size)))
        force = dead.at(begun[3])
        last = self.part((begun[0], begun[1]), begun[3], force, part, compliance)
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


def staying(pressing: ModalContacts, eigenvalues: Array, *, conservative: bool) -> Staying:
    """The steps on some contacts."""
    return (StayingRows if pressing.asks else StayingWarp)(pressing, eigenvalues, conservative)


@final
class StayingWarp(Staying):
    """Those of warps in closed form on colliders of known forms, which are compiled."""

    def __init__(self, pressing: ModalContacts, eigenvalues: Array, conservative: bool) -> None:
        super().__init__(pressing, eigenvalues, conservative)
        size = pressing.touching.size
        self._limits = SETTLED * size, FAR * size, SMALL * size
        self._kept: Any = None
        self._chosen = -1
        self._found: tuple[Array, Array, Array, Array]
        self._energy = 0.0

    def begin(self, before: Pressed) -> None:
        """See :meth:`Staying.begin`."""
        rows = np.flatnonzero(before.pushes)
        self._choose(rows)
        local = before.local[self._kept[1]].T.copy()
        self._found = before.q, before.pushes[rows], local, np.empty((rows.size, 3))

    def _choose(self, rows: Index) -> None:
        """Gather what is read of some rows; of those of the last step it is kept."""
        shapes = self._pressing.shapes
        if self._chosen != shapes.begun or not np.array_equal(rows, self._kept[0]):
            self._kept = self._pressing.gathered(rows)
            self._chosen = shapes.begun

    def part(self, begin: tuple[Array, Array], near: Array, force: Array, dt: float, compliance: Array) -> Array | None:
        """See :meth:`Staying.part`."""
        step = *begin, force, compliance, self._eigenvalues, dt
        found = self._found = near.copy(), *self._found[1:]
        self._energy, stays = stay(self._kept, self._pressing.bodies, step, found, self._limits)
        return found[0] if stays else None

    def now(self) -> tuple[Index, Array, Array]:
        """See :meth:`Staying.now`."""
        (q, forces, local, _), (rows, vertices) = self._found, self._kept[:2]
        return rows, forces, self._pressing.positions(q)[vertices] + local.T

    def whole(
        self, before: Pressed, rates: Array, dead: DeadForce, load: Array, when: tuple[float, float], compliance: Array
    ) -> Whole | None:
        """See :meth:`Staying.whole`; in one call on colliders at rest where the force is compiled, too."""
        pressing, data = self._pressing, dead.push
        if data is None or pressing.moving:
            return super().whole(before, rates, dead, load, when, compliance)
        count_read(2 * data[0].nbytes)
        count_products(2 * DERIVATIVES * data[1].size // 3 if dead.by_work else 0)
        q, local, pushes, _, base, energy = before[:6]
        x, beyond, ends, force = np.empty(local.shape), np.empty(local.shape), np.empty((2, q.size)), np.empty(q.size)
        pushed, gaps = np.empty(pushes.size), np.empty(pushes.size)
        push, out = (*data, POWERS, dead.by_work), (ends, force, x, beyond, gaps, pushed)
        step = q, rates, compliance, self._eigenvalues, when[1], GAMMA
        kept = pushes, local, energy, base, load if self._conservative else _NONE

        def tried() -> tuple[int, float, float]:
            end = stay_whole(self._kept, pressing.bodies, push, step, kept, pressing.surface(), self._limits, out)
            return cast("tuple[int, float, float]", end)

        if self._chosen != pressing.shapes.begun:
            self._choose(np.flatnonzero(pushes))
        found = tried()
        if found[0] == OTHERS:
            self._choose(np.flatnonzero(pushes))
            found = tried()
        if found[0] != STAYS:
            return None
        return Whole(Pressed(ends[0], beyond, pushed, True, x, found[1], None, gaps), ends[1], force, found[2])

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
    _slots: Index
    # How often shapes were dropped; the vertices, what is read of them, and their derivatives.
    _kept: tuple[int, Any, Any, Any] = -1, None, None, None

    def begin(self, before: Pressed) -> None:
        """See :meth:`Staying.begin`."""
        self._rows, self._state = np.flatnonzero(before.pushes), before
        if self._pressing.by_rows.alone:
            vertices, base = self._pressing.touching.vertices[self._rows], before.positions
            assert base is not None
            self._state = before._replace(
                local=before.local[vertices], pushes=before.pushes[self._rows], positions=base[vertices]
            )

    def part(self, begin: tuple[Array, Array], near: Array, force: Array, dt: float, compliance: Array) -> Array | None:
        """See :meth:`Staying.part`."""
        ends = np.empty((3, force.size))
        implicit_euler(*begin, force, compliance, self._eigenvalues, dt, ends)
        found, turned = self._pressing.by_rows.stay(ends[0], compliance, self._state, near, self._rows)
        if found is None or turned is None:
            return None
        self._state, self._turned = found, turned
        return found.q

    def whole(
        self, before: Pressed, rates: Array, dead: DeadForce, load: Array, when: tuple[float, float], compliance: Array
    ) -> Whole | None:
        """See :meth:`Staying.whole`; in one call on colliders at rest where the force has one."""
        pressing, stay = self._pressing, dead.stay
        if stay is None or pressing.moving or not (pressing.by_rows.alone and len(pressing.spins.spin)):
            return super().whole(before, rates, dead, load, when, compliance)
        size, q, at = pressing.touching.size, before.q, before.at
        step = q, rates, compliance, self._eigenvalues, when[1], GAMMA
        limits = *(size * limit for limit in (STILL, SETTLED, FAR, NEARLY)), pressing.reach
        kept = before.pushes, before.local, before.positions

        def tried() -> tuple[int, tuple[Any, ...]]:
            (vertices, rows, derived), near = self._kept[1:], np.full(q.size, np.nan) if at is None else at.copy()
            out = np.empty((2, q.size)), np.empty(q.size), np.empty(vertices.size), np.empty((vertices.size, 3))
            found, energy, arrived = stay(vertices, rows, step, kept, (near, *derived), limits, out)
            return found, (energy, near, arrived, *out)

        found, ended = OTHERS, cast("tuple[Any, ...]", ())
        if self._kept[0] == pressing.shapes.begun:
            found, ended = tried()
        if found == OTHERS:
            self._choose(np.flatnonzero(before.pushes))
            found, ended = tried()
        if found != STAYS:
            return None
        energy, near, arrived, ends, force, forces, turned = ended
        base, local, gaps, least = pressing.ended(end := ends[0], self._slots, turned)
        if not least >= -SETTLED * size:
            return None
        pushes = pressing.no_pushes
        pushes[self._rows] = forces
        pressed = Pressed(end, local, pushes, True, base, energy, near, gaps)
        return self._whole(before, pressed, Parts(ends[1], force, 0.0, *arrived), dead, load)

    def _choose(self, rows: Index) -> None:
        """Look up what is read of some rows (k,) that are pushed, as of :func:`stay_twice`."""
        pressing, directions = self._pressing, self._pressing.directions
        vertices, contact_of = pressing.touching.vertices[rows], pressing.touching.contact_of[rows]
        self._slots, between = pressing.shapes.between(vertices)
        count, size, spins = rows.size, pressing.reach.size, pressing.spins
        derived = np.full(size, np.nan), np.empty((count, len(directions), size))
        place, turning = (np.arange(count), contact_of, between), spins.parts(derived[0], vertices)
        read = (rows, vertices), pressing.bodies, directions, place, turning
        self._rows, self._kept = rows, (pressing.shapes.begun, vertices, read, derived)

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
