"""Steps in time with contacts that change: those of implicit Euler, whose ends lie outside the colliders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np

from modalshell.contact.active_set import ActiveSet, Rest
from modalshell.contact.contact import Contact
from modalshell.contact.descent import descend
from modalshell.contact.friction import Friction, better_forces, creep_note
from modalshell.contact.layered import LayeredEnergy, Patterns
from modalshell.contact.layers import Layers
from modalshell.contact.rebound import rebounded
from modalshell.contact.touching import EXACT_GAP, Touching, touched_frame
from modalshell.core.errors import OptionError
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Index, Mask
from modalshell.core.units import at_most
from modalshell.shell import Shell
from modalshell.statics.mixed_newton import HIGHER, Rules
from modalshell.statics.newton import rules_of
from modalshell.statics.potential import Potential

_MOST = 40
"""Iterations at most of a step, before the way downhill."""
_AMONG_LAYERS = 20
"""The same with self-contact, whose steps the way downhill finds the sooner."""
_SINGLES, _SINGLES_AMONG = 32, 8
"""Single steps that begin a way downhill, and those among layers: what Newton's method does not solve in a step is
mostly limp."""
_PRESSED = 0.5
"""Residual of where a step among layers begins, over that of a guess, below which it is the better guess."""
_TURNS, _TURNED = 6, 1e-6
"""Solves at most for forces that turn with a curved collider, and their change, over the forces, that is none."""
_SAME = 1e-6
"""Part of a frame's step by which times differ that are the same."""
_ROUND = 1e-3
"""Curvature, times the shell's size, above which slips may be relative to the centre of curvature."""


@final
class TouchingSteps:
    """Contacts of one motion of a shell about its ``origin`` (3,) [m] in the world, and ``layers`` of self-contact.

    For a step of ``dt`` [s] ``stand_ins`` steps of implicit Euler stand in. OptionError for a collider whose surface
    moves farther than its smallest radius in a step.

    Attributes
    ----------
    now : Touching
        The contacts at the end of the last step.
    pushes : ndarray, shape (r,)
        Forces [N] along the normals there.
    rubs : bool
        Whether a contact has friction.
    whole : float
        How long a step of implicit Euler is that is not divided [s].
    """

    def __init__(
        self,
        contacts: Sequence[Contact],
        shell: Shell,
        origin: Array,
        dt: float,
        stand_ins: int,
        layers: Layers | None = None,
    ) -> None:
        self.layers, self._patterns = layers, Patterns(None)
        self.now = Touching(contacts, shell, origin)
        self.pushes = np.zeros(self.now.vertices.size)
        self._stopping: Array | None = None  # forces (n, 3) [N] that changed the rates of explicit steps
        self.whole = dt / stand_ins
        self._dt, self._impulses = dt, dict[float, Array]()  # (n, 3) [N s] of implicit steps, by when these begin
        self._last: tuple[Potential, float] | None = None  # that of implicit steps, and how long it was [s]
        self._constant = False  # whether the last step of implicit Euler kept what touched
        self.rubs = any(contact.friction for contact in self.now.contacts)
        self._creeps = self.rubs or (layers is not None and layers.friction > 0.0)
        self._deep = EXACT_GAP * self.now.size
        refuse_fast(self.now.contacts, shell.rest_positions + origin, dt)

    def begin(self, x: Array) -> None:
        """Refuse a motion that begins at x (n, 3) inside a collider, or crossing itself."""
        self.now.refuse_inside(x)
        if self.layers is not None:
            self.layers.refuse_crossing(x, "at the start")

    @property
    def friction_note(self) -> str:
        """The message about creep under friction; "" without it."""
        return creep_note(self.now.size, self.whole) if self._creeps else ""

    def touches(self, x: Array, time: float) -> bool:
        """Whether a vertex at x (n, 3) touches a collider at ``time`` [s], or layers touch each other."""
        return self._layers_near(x) or bool((self.now.at(time).distances(x) <= self._deep).any())

    def enters(self, x: Array, time: float) -> bool:
        """Whether a vertex at x (n, 3) lies inside a collider at ``time`` [s], or layers touch each other."""
        return self._layers_near(x) or bool((self.now.at(time).distances(x) < -self._deep).any())

    def meet(self, x: Array, y: Array) -> bool:
        """Whether layers meet on the straight way from x to y, both (n, 3)."""
        return self.layers is not None and self.layers.free_part(x, y) < 1.0

    def go_on(self, begin: float) -> None:
        """Forget what was given since ``begin`` [s], where a step begins, and before its frame."""
        within, near = begin / self._dt % 1.0, _SAME * self._dt
        kept = self._impulses if _SAME < within < 1.0 - _SAME else {}
        self._impulses = {time: impulse for time, impulse in kept.items() if time < begin - near}

    def let_in(self, x: Array, time: float, dt: float) -> None:
        """Let vertices that are inside at x (n, 3) at ``time`` [s] come out at no more than their speeds."""
        touching = self.now.at(time).with_bounds(None)
        gap = touching.distances(x)
        bounds = np.zeros(gap.size)
        for index, contact in enumerate(self.now.contacts):
            own = touching.of_contact(index)
            deep = gap[own] < -self._deep
            bounds[own] = np.where(deep, np.minimum(0.0, gap[own] + contact.push_out * dt), 0.0)
        self.now = touching.with_bounds(bounds if bounds.any() else None)

    def solve(
        self, problem: Potential, first: Array, scale: float, goal: float, stresses: list[Array], time: float
    ) -> tuple[Array, bool]:
        """Minimum (n, 3) of a step's potential outside the colliders at ``time`` [s], and whether it was found.

        On a curved collider the normal at the end of a step has a part along the way there, and would drive what slides
        over an edge. That part is taken out: what is left does the work of a discrete gradient of the gap, none for
        what keeps touching [gonzalez1996].
        """
        before, lagged = self.now, self.pushes
        self._last = problem, time - before.time
        self.now = before.at(time, problem.shell.undamped)
        rules = rules_of(problem, goal, _MOST)
        if self.layers is not None:
            layers = self.layers.rubbed(problem.origin, time - before.time, self.whole)
            problem = replace(problem, further=LayeredEnergy(layers, self._patterns))
            first, free, stresses = self._begun(problem, first, stresses)
            if not free:
                return problem.origin, False
            rules = rules._replace(most=_AMONG_LAYERS)
        start = before, lagged, time - before.time
        rest, turned = self._minimum(problem, start, first, scale, rules, stresses), np.zeros_like(first)
        also = np.zeros_like(first)
        for _ in range(_TURNS):
            last, turned = turned, self._turning(before, problem.origin, rest, time - before.time)
            if not rest.converged or np.abs(turned - last).max() <= _TURNED * np.abs(rest.pushes).max(initial=0.0):
                break
            led, still = replace(problem, load=problem.load + turned), np.zeros_like(first)
            near = problem.shell.predicted_stresses(rest.point, still)
            again = self._minimum(led, start, rest.point, scale, rules, near, rest.active)
            if not again.converged:
                break
            rest, also = again, turned
        self.pushes = np.where(rest.active, rest.pushes, 0.0)
        self._constant = rest.converged and np.array_equal(self.pushes > 0.0, lagged > 0.0)
        given = self.now.with_bounds(None).forces(rest.point, self.pushes) + also
        if self.layers is not None:
            given -= self.layers.gradient(rest.point)
        self._impulses[before.time] = (time - before.time) * given
        return rest.point, rest.converged

    def _turning(self, before: Touching, x: Array, rest: Rest, dt: float) -> Array:
        """Forces (n, 3) [N] that take from those along the normals at the end what drives the step from x (n, 3)."""
        forces, rows = np.zeros_like(x), np.flatnonzero(rest.active & (rest.pushes > 0.0))
        vertices = self.now.vertices[rows]
        gap, normals, curvature = self.now.gaps(rest.point, rows)
        if not curvature.any():
            return forces
        way = self._least_slips(before, rest.point[vertices] - x[vertices], x, rows, dt)
        driven = np.sum(normals * way, axis=1) - (gap - before.distances(x)[rows])
        length = np.maximum(np.sum(way**2, axis=1), self._deep**2)  # of less than that only rounding drives
        share = np.where(driven > 0.0, driven / length, 0.0)
        np.subtract.at(forces, vertices, (rest.pushes[rows] * share)[:, None] * way)
        return forces

    def _least_slips(self, before: Touching, moved: Array, x: Array, rows: Index, dt: float) -> Array:
        """How far (k, 3) [m] the rows' vertices slip along their colliders, being ``moved`` (k, 3) [m] from x (n, 3).

        A slip is relative to the collider's material. But a roller that turns about its own axis moves its material and
        not its surface, which drives nothing without friction. So where the surface goes as far with the centre of its
        curvature as with the material, the slip is relative to that centre.
        """
        ways, still, now = before.ways(x, rows, dt), before.with_bounds(None), self.now.with_bounds(None)
        if not ways.any():
            return moved
        gap, normals, curvature = still.gaps(x, rows)
        bend = np.linalg.eigvalsh(curvature)[:, -1]
        vertices, of = before.vertices[rows], before.contact_of[rows]
        for index in np.unique(of):
            own = np.flatnonzero((of == index) & (bend * self.now.size > _ROUND))
            seen = x.copy()
            seen[vertices[own]] -= normals[own] / bend[own, None]
            led = before.ways(seen, rows[own], dt)
            seen[vertices[own]] = x[vertices[own]] + led
            alike = np.abs(now.gaps(seen, rows[own])[0] - gap[own]) <= self._deep
            ways[own] = np.where(alike[:, None], led, ways[own])
        return np.asarray(moved - ways)

    def _minimum(
        self,
        problem: Potential,
        start: tuple[Touching, Array, float],
        first: Array,
        scale: float,
        rules: Rules,
        stresses: list[Array],
        chosen: Mask | None = None,
    ) -> Rest:
        """Minimum from a ``first`` guess (n, 3), with friction by the forces at the ``start`` of the step."""
        (before, lagged, dt), settled, answered = start, False, None
        begin, held = problem.origin.copy(), problem.shell.clamped
        begin[held] = first[held]  # where supports have moved to
        while True:
            friction = Friction(before, lagged, problem.origin, dt, self.whole) if self.rubs else None
            solver = ActiveSet(problem, self.now, scale, friction)
            serves = False
            if answered is not None:  # forces change an answer by little: Newton's method is near the next one there
                near = problem.shell.predicted_stresses(answered.point, np.zeros_like(first))
                rest = solver.iterate(answered.point, answered.active, rules, near)
                serves = self._serves(solver, begin, rest)
            if not serves:
                if friction is not None:
                    first = friction.held_back(first, self.now.shell.mass / dt**2)
                rest = solver.iterate(first, solver.near(first) if chosen is None else chosen, rules, stresses)
                serves = self._serves(solver, begin, rest)
            if not serves:
                among = self.layers is not None
                lower = self._lower(solver, begin, rest.point) if among else begin
                rest = descend(solver, lower, rules, singles=_SINGLES_AMONG if among else _SINGLES)
            pushes = np.where(rest.active, rest.pushes, 0.0)
            better = better_forces(pushes, lagged, settled=False) if self.rubs and rest.converged else None
            if settled or better is None:
                return rest
            lagged, chosen, settled, answered = better, rest.active, True, rest

    def _serves(self, solver: ActiveSet, begin: Array, rest: Rest) -> bool:
        """Whether Newton's method ended at an answer of a step from ``begin`` (n, 3), on this side of the colliders.

        It may find another one far away, folded over and under tension: none to which a step leads lies higher than
        where this begins.
        """
        if not rest.converged or self.now.crossed(solver.problem.origin, rest.point):
            return False
        if solver.problem.unsymmetric or solver.is_inside(begin):
            return True
        least = solver.potential(begin)[0]
        most = least + HIGHER * abs(least) + self._deep * solver.scale(rest.pushes)
        return not solver.potential(rest.point)[0] > most

    @staticmethod
    def _lower(solver: ActiveSet, begin: Array, reached: Array) -> Array:
        """Where steps among layers ended without a minimum, if it lies lower than ``begin``, both (n, 3), else this."""
        if not np.isfinite(reached).all() or solver.is_inside(reached) or solver.touching.crossed(begin, reached):
            return begin
        return reached if solver.potential(reached)[0] < solver.potential(begin)[0] else begin

    def _layers_near(self, x: Array) -> bool:
        return self.layers is not None and self.layers.near(x)

    def _begun(self, problem: Potential, first: Array, stresses: list[Array]) -> tuple[Array, bool, list[Array]]:
        """A guess (n, 3) that the shell reaches without layers that meet, whether so, and the stresses for it.

        Held vertices are in their places. Where the step begins is better than a guess that presses layers together:
        the barrier's forces there tell little of how it goes on.
        """
        layers, begin, held = self.layers, problem.origin, problem.shell.clamped
        assert layers is not None
        guess, still = first, begin.copy()
        still[held] = first[held]
        free = layers.free_part(begin, first)
        self._patterns.expected = layers.near_pairs
        if free < 1.0:
            guess = begin + 0.5 * free * (first - begin)
            guess[held] = first[held]
            free = layers.free_part(begin, guess)
        pressed = _PRESSED * problem.measure(problem.residual(guess))
        if free < 1.0 or problem.measure(problem.residual(still)) < pressed:
            guess, free = still, layers.free_part(begin, still)
            stresses = problem.shell.predicted_stresses(still, np.zeros_like(still))
        return guess, free >= 1.0, stresses

    @property
    def may_stay(self) -> bool:
        """Whether contacts may stay as they are: not among layers, nor of what is being pushed out."""
        return self.layers is None and self.now.bounds is None

    def stays(self, was: Array) -> bool:
        """Whether what pushed with forces ``was`` (r,) [N] has touched in all steps of implicit Euler since."""
        return self.may_stay and self._constant and np.array_equal(self.pushes > 0.0, was > 0.0)

    def gave(self, begin: float, impulse: Array) -> None:
        """Keep an ``impulse`` (n, 3) [N s] of a step from ``begin`` [s], for its frame."""
        self._impulses[begin] = impulse

    def given_since(self, begin: float) -> Array:
        """Impulses (n, 3) [N s] of contacts in steps of implicit Euler since ``begin`` [s]."""
        near = begin - _SAME * self._dt
        return np.asarray(sum(one for time, one in self._impulses.items() if time >= near))

    def energy(self, x: Array) -> float:
        """Energy [J] of the barrier between layers at x (n, 3)."""
        return 0.0 if self.layers is None else self.layers.value(x)

    def frame(self, x: Array, time: float) -> TouchedFrame:
        """What touches at x (n, 3) and ``time`` [s], the end of the last step; forces are the means of that step."""
        given = self._stopping
        if self._impulses:
            given = np.asarray(sum(self._impulses.values()) / self._dt)
        found = touched_frame(self.now.at(time), x, self.pushes, given)
        return found if self.layers is None else found._replace(self_contact=self.layers.least(x))

    def projected(self, x: Array, rates: Array, time: float, dt: float, drag: float = 0.0) -> tuple[Array, Array]:
        """Positions and rates (n, 3) at ``time`` [s] with what entered put onto its collider [bridson2002].

        Its speed inward is turned round by the restitution, or removed, and friction lessens the speed along the
        surface by its coefficient times that change, at most to nothing; the way back is that speed times the time that
        the vertex was inside, so that what sticks does not creep. ``dt`` is the step [s], and ``drag`` what its
        equations let drag by the mass take of a change of speed, which the forces overcome.
        """
        touching = self.now = self.now.at(time)
        self._stopping, given = None, rates
        rows = np.flatnonzero(touching.distances(x) < 0.0)
        rows = touching.binding(x, touching.movable(x, rows))
        if not rows.size:
            return x, rates
        x, rates, back = x.copy(), rates.copy(), np.zeros((rows.size, 3))
        depths = -touching.gaps(x, rows)[0]
        touching.put_on(x, rows, np.zeros(rows.size))
        drift, normals = touching.velocities(x, rows), touching.normals(x, rows)
        for index, (row, normal, carried) in enumerate(zip(rows, normals, drift, strict=True)):
            vertex, contact = touching.vertices[row], touching.contacts[touching.contact_of[row]]
            relative = rates[vertex] - carried
            inward = -float(normal @ relative)
            if inward > 0.0:
                along = relative + inward * normal
                change = (1.0 + contact.restitution) * inward
                slip = float(np.linalg.norm(along))
                kept = max(0.0, 1.0 - contact.friction * change / slip) if slip > 0.0 else 0.0
                rates[vertex] = carried + kept * along + contact.restitution * inward * normal
                back[index] = (kept - 1.0) * min(dt, depths[index] / inward) * along
        if back.any():
            touching.slide(x, rows, back)
            touching.put_on(x, rows, np.zeros(rows.size))
        self._stopping = (1.0 + drag) * touching.shell.mass[:, None] * (rates - given) / dt
        return x, rates

    def struck(self, x: Array, rates: Array, before: tuple[Array, Array, float], loads: Array) -> Array:
        """Rates (n, 3) [m/s] after restitution and its friction, and without those of vertices that were pushed out.

        ``x`` and ``rates`` (n, 3) are those at the end of a step, ``before`` those at its beginning and when that was
        [s], and ``loads`` (n, 3) [N] what the load pushes with.
        """
        touching, rows, (_, _, time) = self.now, np.flatnonzero(self.pushes), before
        if self._last is not None and touching.restitution[rows].any():
            given = self.given_since(time)
            rates, impulses = rebounded(touching, self._last, before, (x, rates, given), loads, rows)
            self._impulses[time] = self._impulses.get(time, 0.0) + impulses
        out = np.zeros(0, np.int64) if touching.bounds is None else rows[touching.bounds[rows] < 0.0]
        if not out.size:
            return rates
        rates, given = rates.copy(), self._impulses.setdefault(time, np.zeros_like(x))
        normals, drift = touching.normals(x, out), touching.velocities(x, out)
        for vertex, normal, carried in zip(touching.vertices[out], normals, drift, strict=True):
            leaves = max(0.0, float(normal @ (rates[vertex] - carried)))
            rates[vertex] -= leaves * normal
            given[vertex] -= touching.shell.mass[vertex] * leaves * normal
        return rates


def refuse_fast(contacts: Sequence[Contact], rest: Array, dt: float) -> None:
    """OptionError for a contact whose collider's surface moves farther than its smallest radius in a step ``dt`` [s].

    ``rest`` (n, 3) [m] are the shell's positions at rest, in the frame in which it is seen.
    """
    grid = np.stack(np.meshgrid(*np.stack([rest.min(axis=0), rest.max(axis=0)]).T), axis=-1).reshape(-1, 3)
    for index, contact in enumerate(contacts):
        radius = contact.collider.smallest_radius
        if contact.motion is None or not np.isfinite(radius):
            continue
        way, time = contact.fastest(grid, dt, radius)
        if way > radius:
            name, fitting, longest = type(contact.collider).__name__, dt, way
            while longest > radius:  # again, as a chord is shorter than its parts
                fitting = float(at_most(fitting * radius / longest))
                longest = contact.fastest(grid, fitting, radius)[0]
            raise OptionError(
                f"contact {index} ({name}) moves {way:.3g} m in the step from {time:.4g} s, more than its smallest "
                f"radius of {radius:.3g} m, and might pass through the shell: take steps of at most "
                f"{fitting:.2g} s"
            )
