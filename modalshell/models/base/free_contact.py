"""Steps of modal models whose parts fly freely, and touch colliders.

Contact forces push on the frames of the parts and on their shapes. A step is one of implicit Euler: with forces f along
the normals n at points x about the centre X of a part of mass M and inertia I, momenta change by ``dt sum f n`` and
``dt sum (x - X) x f n``, exactly, and the small problem's matrix has ``n . n / M + (r x n) . I^-1 (r x n)``, with what
the modes and the residual compliance give, all by ``dt^2`` (theory 13, eq. 9). Friction is smoothed as in steps of DS,
and restitution gives rates after a step (eq. 10 and 11).
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
import scipy.linalg

from modalshell.contact import modal_kernels as kernels
from modalshell.contact import row_kernels as rows_by
from modalshell.contact.complementarity import complementary
from modalshell.contact.friction import SECANT, STUCK, TANGENT, Friction, better_forces
from modalshell.contact.rebound import BOUNCE, gaps_and_speeds, striking
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Index
from modalshell.integrators.free_parts import inertia_of, turn_of, vector_of
from modalshell.integrators.state import PUSHES, MotionState
from modalshell.models.base.modal_contact import Felt, ModalPressedMotion
from modalshell.models.base.pressed_motion import BEYOND, LOCAL
from modalshell.models.base.stepper import LEAD
from modalshell.modes.modal_rotation import cross_matrices

_PASSES, _RUBBING = 20, 100
"""Linearisations of a step at most, and by one friction of it."""
_FREELY, _FALLS, _NEARER = 3, 0.5, 1e-2
"""Linearisations by friction's derivatives whose moves need not fall, the most of a later one over the one before, and
of those by quadratic functions over the last one by derivatives, at which derivatives are tried again."""
_CORRECTIONS = 8
"""Corrections of one by the gaps that it leads to, at most."""
_SETTLED = 1e-9
"""Gap, as a share of the shell's size, at which a step is solved."""
_AGAIN, _MOVED, _RUBBED = 1e-10, 1e-3, 1e-7
"""Moves, as shares of the shell's size, from which a problem is linearised again, and up to which it is solved.

The last one is that of a step with friction, which changes within a small slip.
"""


class _End(NamedTuple):
    """Where a step ends under pushes (6 P + m,) on frames and coordinates; its displacements in the frames' axes."""

    state: MotionState
    base: Array
    local: Array
    push: Array
    solved: bool


class _Pace:
    """How friction is taken as linear: from its stiffest on, derivatives lead to its end.

    Where their moves do not fall, ends go round. From the middle of the last move on, quadratic functions that are
    nowhere below friction's work, whose least falls, lead slowly nearer.
    """

    def __init__(self) -> None:
        self.tried, self.rule = 0, STUCK
        self._last, self._slow = np.inf, np.inf

    def goes_round(self, move: float) -> bool:
        """Count a linearisation that moved the end by a length [m]; whether to go on from the middle of its way."""
        self.tried += 1
        around = self.rule == TANGENT and self.tried > _FREELY and move > _FALLS * self._last
        if around:
            self.rule, self._slow = SECANT, 0.0 if self._slow < np.inf else move
        elif self.rule != SECANT or move < _NEARER * self._slow:
            self.rule = TANGENT
        self._last = move
        return around


@final
class FreeContactMotion(ModalPressedMotion):
    """What follows each step of a modal model with free parts and contacts."""

    holds = False
    _struck: tuple[Array | None, Array | float] = None, 0.0  # coordinates of a rebound, and its forces (r,) [N]

    @property
    def note(self) -> str:
        """What a message says of friction, and of loads that fall with the velocities."""
        dragged = "of free parts in contact loads do not fall with the velocities within a step: take short ones, or ds"
        return "; ".join(filter(None, [super().note, dragged if self._setup.loading.by_velocity else ""]))

    def frame(self, state: MotionState, positions: Array, time: float) -> TouchedFrame:
        """See :meth:`PressedMotion.frame`; the impulses of a rebound are of the step that it ends."""
        at, forces = self._struck
        if at is state.coordinates:
            pushes = state.memory[PUSHES] + forces
            state = MotionState(state.coordinates, state.rates, state.memory | {PUSHES: pushes})
        return super().frame(state, positions, time)

    def follow(
        self, before: MotionState, felt: Felt, when: tuple[float, float], gaps: Array | None, base: Array
    ) -> tuple[MotionState, bool, Array | None]:
        """The end of a step; see :meth:`ModalPressedMotion.follow`."""
        pressing, force, (time, dt) = self._pressing, felt[0], when
        size = pressing.touching.size
        if gaps is None:
            pressing.at(time)
            gaps = self._gaps(before, base)
        flight = _Flight(self._model, before, force, self._compliance(dt), (dt, self._setup.damping.mass_factor))
        count = flight.count + before.coordinates.size
        end = alone = flight.end(np.zeros(count), self._turned_back(before))
        reach = float(np.linalg.norm(alone.base - base, axis=1).max())
        gaps = np.minimum(gaps, pressing.gaps(end.base))
        pushes, energy, solved, moved = before.memory[PUSHES], 0.0, False, _RUBBED if pressing.rubs else _MOVED
        begin, most = base + before.memory[LOCAL], _RUBBING if pressing.rubs else _PASSES
        lagged, pace, settled, steps = pushes, _Pace(), False, (*when, self._setup.dt)
        friction = pressing.friction(pushes, begin, steps)
        while pace.tried < most:
            rows = pressing.candidates(gaps, pushes, reach)
            rubbing, at, last = None if friction is None else (friction, pace.rule), end, pushes
            end, pushes, energy, off, move, after = self._passed(flight, at, rows, last, rubbing)
            deepest, around = -float(after.min(initial=0.0)), pace.goes_round(move)
            solved = end.solved and max(off, deepest) <= _SETTLED * size and move <= moved * size
            gaps = np.minimum(gaps, after)
            if not np.isfinite(off + move):
                break
            if not (solved and move <= _AGAIN * size):
                if around and friction is not None and pace.tried < most:
                    end, pushes = flight.between(at, end), 0.5 * (last + pushes)
                continue
            better = better_forces(pushes, lagged, settled=settled) if pressing.rubs else None
            if better is None:
                break
            lagged, settled = better, True
            friction, pace = pressing.friction(lagged, begin, steps), _Pace()
        state, model = self._rebound(flight, (before, begin, end, alone), (pushes, energy), when), self._model
        memory = model.integrator.stood_in_for(before, state, force, dt).memory
        memory |= {LOCAL: flight.in_world(end), PUSHES: pushes, BEYOND: np.array([energy])}
        memory["turn_back"] = np.zeros((len(model.frames.parts), 3))  # frames turn by their spins at the end
        return MotionState(state.coordinates, state.rates, memory), solved, end.base

    def _rebound(
        self,
        flight: _Flight,
        step: tuple[MotionState, Array, _End, _End],
        found: tuple[Array, float],
        when: tuple[float, float],
    ) -> MotionState:
        """A step's end with the rates that restitution gives what strikes, by impulses (theory 13, eq. 11).

        ``step`` are its beginning and positions (n, 3) [m] there, its end, and where it would end without contacts;
        ``found`` forces (r,) [N] and the energy [J] beyond the modes. A step with impulses has no more energy than
        before, and what moving colliders give it, whatever the restitution.
        """
        pushes, energy = found
        (before, begin, end, alone), touching, (time, dt) = step, self._pressing.touching, when
        rows, frames, shape = np.flatnonzero(pushes > 0.0), self._model.frames, self._model.warped_positions
        kept = touching.restitution[rows]
        if not kept.any():
            return end.state
        vertices, place = touching.vertices[rows], end.base + flight.in_world(end)
        normals, lead = touching.normals(place, rows), LEAD * dt
        drift = touching.velocities(place, rows)
        carried = np.sum(normals * drift, axis=1)
        first, last, free = (
            np.sum(normals * frames.velocities(state, lead, shape)[vertices], axis=1)
            for state in (before, end.state, alone.state)
        )
        gaps, faster = gaps_and_speeds(touching, rows, begin, time - dt, (normals, drift))
        strikes = carried - first > BOUNCE * (np.abs(free - first) + faster)
        if not (strikes & (kept > 0.0)).any():
            return end.state
        speeds = striking(carried - first, np.maximum(first - free, 0.0), np.maximum(gaps, 0.0) / dt)
        wanted = carried + np.where(strikes, kept * speeds, 0.0)
        moves = flight.moves(end, vertices)
        along = np.einsum("ki,kim->km", flight.in_frames(end, vertices, normals), moves)
        by_impulse = flight.compliance(end) / dt**2
        columns, impulses = along @ by_impulse @ along.T, np.zeros(rows.size)
        columns += kernels.LOADED * float(np.trace(columns)) / rows.size * np.eye(rows.size)
        complementary(columns, last - wanted, impulses, 1e-12 * touching.size / dt, True)
        change, work = by_impulse @ (impulses @ along), float(impulses @ carried)
        slips = frames.velocities(end.state, lead, shape)[vertices] - drift
        rubbed = self._rubbed(rows, impulses, slips - np.sum(normals * slips, axis=1)[:, None] * normals)
        if rubbed.any():  # at most until what slips stops
            slope = np.einsum("ki,kim->m", flight.in_frames(end, vertices, rubbed), moves)
            slower = by_impulse @ slope
            part = min(1.0, max(0.0, -float(np.sum(rubbed * slips) + slope @ change) / float(slope @ slower)))
            change, work = change + part * slower, work + part * float(np.sum(rubbed * drift))
        lost = flight.lost(end.state) + float(before.memory[BEYOND][0]) - energy + dt * float(pushes[rows] @ carried)
        state, share = flight.struck(end.state, change, lost, work)
        forces = np.zeros_like(pushes)
        forces[rows] = share / dt * impulses
        self._struck = state.coordinates, forces
        return state

    def _rubbed(self, rows: Index, impulses: Array, slips: Array) -> Array:
        """Impulses (k, 3) [N s] of Coulomb's friction against slips (k, 3) [m/s], by those along the normals (k,)."""
        friction = self._pressing.touching.friction[rows]
        speeds = np.linalg.norm(slips, axis=1)
        size = np.where(speeds > 0.0, friction * impulses / np.maximum(speeds, 1e-300), 0.0)
        return np.asarray(-size[:, None] * slips)

    def _turned_back(self, state: MotionState) -> Array:
        """Displacements (n, 3) [m] of a state beyond the modes, in the axes of the frames."""
        local, frames = state.memory[LOCAL].copy(), self._model.frames
        for part, (_, vector) in zip(frames.parts, frames.poses(state.coordinates), strict=True):
            local[part.vertices] = local[part.vertices] @ turn_of(vector)
        return local

    def _passed(
        self, flight: _Flight, at: _End, rows: Index, pushes: Array, rubbing: tuple[Friction, int] | None
    ) -> tuple[_End, Array, float, float, float, Array]:
        """The problem of some rows linearised at an end: its end, forces (r,), energy [J], and how well it is met."""
        pressing, size = self._pressing, self._pressing.touching.size
        vertices, shapes = pressing.touching.vertices[rows], pressing.shapes
        gap, normals, _ = pressing.touching.gaps(at.base + flight.in_world(at), rows)
        moves, compliance = flight.moves(at, vertices), flight.compliance(at)
        normals, (slots, between) = flight.in_frames(at, vertices, normals), shapes.between(vertices)
        along, forces, count = np.einsum("ki,kim->km", normals, moves), pushes[rows], moves.shape[2]
        square = rows.size, rows.size
        problem = tuple(np.empty(shape) for shape in (square, square, (rows.size, count), rows.size, (3, rows.size)))
        slope, stiffness, held = np.zeros(count), None, at.push
        if rubbing is not None:
            slope, stiffness = flight.rubbed(at, *rubbing)
            softer = np.linalg.solve(np.eye(count) + compliance @ stiffness, compliance)
            compliance, held = np.asarray(0.5 * (softer + softer.T), np.float64), held + slope
        frame, given = (gap, normals, vertices, at.local), (-compliance @ held, forces)
        turns = pressing.spins.of(self._model.frames.elastic(at.state.coordinates), vertices)
        rows_by.row_problem(along[:, None], frame, given, turns, between, compliance, problem)
        turned, expected, unused = np.empty(normals.shape), np.empty(rows.size), np.empty(count)
        for _ in range(_CORRECTIONS):
            out = unused, turned, expected
            energy = rows_by.row_end(problem, forces, np.zeros(count), 1e-12 * size, True, out)
            push = forces @ along
            if stiffness is not None:
                push = push - slope - stiffness @ (compliance @ (push - held))
            end, local = flight.end(push, at.local), np.empty_like(at.local)
            own = pressing.spins.vectors(self._model.frames.elastic(end.state.coordinates))
            kernels.local_shape(shapes.store, slots, turned, own, local)
            end = end._replace(local=local)
            gaps = pressing.gaps(end.base + flight.in_world(end))
            off = rows_by.row_off(gaps[rows], forces)
            if not _SETTLED * size < off < np.inf:
                break
            problem[3][:] += gaps[rows] - expected
        after, way = np.zeros_like(pushes), end.base - at.base + flight.in_world(end) - flight.in_world(at)
        after[rows] = forces
        return end, after, energy, off, float(np.linalg.norm(way[vertices], axis=1).max(initial=0.0)), gaps


@final
class _Flight:
    """A step of implicit Euler of coordinates, and of the momenta of frames; ``when`` is its length and their drag."""

    def __init__(
        self, model: Any, before: MotionState, force: Array, compliance: Array, when: tuple[float, float]
    ) -> None:
        self._model, self._frames, self._before = model, model.frames, before
        self._dt, drag = when
        q, rates, frames = before.coordinates, before.rates, model.frames
        self._slower, self._give, self.count = 1.0 + drag * self._dt, compliance, 6 * len(frames.parts)
        self._force, ends = force, np.empty((3, q.size))
        kernels.implicit_euler(q, rates, force, compliance, model.basis.eigenvalues, self._dt, ends)
        self._free = ends[0]
        wrench = (frames.from_poses.T @ force[: frames.count]).reshape(-1, 2, 3)
        self._momenta = frames.momenta(q, rates, model.warped_positions) + self._dt * wrench

    def end(self, push: Array, local: Array) -> _End:
        """The end under pushes (6 P + m,); ``local`` are the displacements that it has."""
        dt, frames, shape, q = self._dt, self._frames, self._model.warped_positions, self._before.coordinates
        own = self._free + self._give * push[self.count :]
        momenta = (self._momenta + dt * push[: self.count].reshape(-1, 2, 3)) / self._slower
        after = MotionState(own, (own - q) / dt, {})
        state, solved = frames.landed(self._before, after, dt * momenta, momenta, dt, shape)
        return _End(state, frames.positions(state.coordinates, shape), local, push, solved)

    def between(self, one: _End, other: _End) -> _End:
        """The end under the mean of the pushes of two."""
        return self.end(0.5 * (one.push + other.push), 0.5 * (one.local + other.local))

    def compliance(self, end: _End) -> Array:
        """Moves [s^2] of the frames and coordinates (6 P + m, 6 P + m) in the step by pushes on them."""
        q, blocks, rigid = end.state.coordinates, [], self._dt**2 / self._slower
        x = self._frames.shaped(q, self._model.warped_positions)
        for part, (_, vector) in zip(self._frames.parts, self._frames.poses(q), strict=True):
            turn, own = turn_of(vector), x[part.vertices]
            blocks.append(rigid / part.total * np.eye(3))
            blocks.append(rigid * turn @ np.linalg.inv(inertia_of(part.moments(own, own))) @ turn.T)
        return np.asarray(scipy.linalg.block_diag(*blocks, np.diag(self._give)))

    def moves(self, end: _End, vertices: Index) -> Array:
        """Derivatives (k, 3, 6 P + m) of some vertices' positions, in the axes of their frames.

        Those by the coordinates are without the mean motion and the momentum of the parts: frames turn these back.
        """
        q, frames, model = end.state.coordinates, self._frames, self._model
        elastic, r, labels = frames.elastic(q), frames.count, frames.labels[vertices]
        x, rows = frames.shaped(q, model.warped_positions), model.contact_rows(elastic, vertices)
        whole = np.zeros((vertices.size, 3, self.count + q.size))
        for number, (part, (_, vector)) in enumerate(zip(frames.parts, frames.poses(q), strict=True)):
            chosen, turn, first = labels == number, turn_of(vector), 6 * number
            if not chosen.any():
                continue
            arms, weights = x[part.vertices], np.zeros((6, *x.shape))
            for axis, unit in enumerate(np.eye(3)):
                weights[axis, part.vertices, axis] = part.mass / part.total
                weights[3 + axis, part.vertices] = part.mass[:, None] * np.cross(unit, arms)
            mean = np.stack([model.warped_gradient(elastic, weight) for weight in weights])
            spin = np.linalg.solve(inertia_of(part.moments(arms, arms)), mean[3:])
            crosses = cross_matrices(x[vertices[chosen]])
            rows[chosen] += crosses @ spin - mean[:3]
            whole[chosen, :, first : first + 3] = turn.T
            whole[chosen, :, first + 3 : first + 6] = -cross_matrices((x + end.local)[vertices[chosen]]) @ turn.T
        rows[:, :, :r] = rows[:, :, :r] @ frames.others
        whole[:, :, self.count :] = rows
        return whole

    def lost(self, after: MotionState) -> float:
        """Energy [J] that the step to an end has cost, counting what the load gave the frames in it."""
        frames, model, states = self._frames, self._model, (self._before, after)
        begin, end = (model.kinetic_energy(state) + model.elastic_energy(state) for state in states)
        q, last = (state.coordinates for state in states)
        work, wrench = 0.0, (frames.from_poses.T @ self._force[: frames.count]).reshape(-1, 2, 3)
        for push, (place, vector), (reached, turned) in zip(wrench, frames.poses(q), frames.poses(last), strict=True):
            work += float(push[0] @ (reached - place) + push[1] @ vector_of(turn_of(turned) @ turn_of(vector).T))
        return float(begin - end) + work

    def struck(self, state: MotionState, change: Array, lost: float, work: float) -> tuple[MotionState, float]:
        """A state whose rates, of frames in the world, and of coordinates, change by (6 P + m,), and by what share.

        By less than the whole where that would give it more than an energy [J] beyond the ``work`` [J] that moving
        colliders do in the change.
        """
        frames, q, shape = self._frames, state.coordinates, self._model.warped_positions

        def changed(share: float) -> MotionState:
            rates = frames.spun(q, state.rates) + share * change[self.count :]
            speeds = frames.poses(rates) + share * change[: self.count].reshape(-1, 2, 3)
            return MotionState(q, frames.unspun(q, frames.with_poses(rates, speeds)), state.memory)

        less, now, more = (frames.kinetic_energy(changed(share), shape) for share in (-1.0, 0.0, 1.0))
        if more - now <= lost + work:
            return changed(1.0), 1.0
        slope, bend = 0.5 * (more - less) - work, 0.5 * (more + less) - now  # of what it gains, by the share
        root = np.sqrt(slope**2 + 4.0 * bend * max(lost, 0.0))
        share = min(1.0, (root - slope) / (2.0 * bend))
        return changed(share), share

    def rubbed(self, end: _End, friction: Friction, rule: int) -> tuple[Array, Array]:
        """Slope (6 P + m,) and stiffness (6 P + m, 6 P + m) of friction's work by moves of the frames and coordinates.

        It pushes on frames and modes alone: what vertices give way beyond these along a collider is left out.
        """
        gradient, blocks = friction.linear(end.base + self.in_world(end), rule)
        moves, labels = self.moves(end, friction.vertices), self._frames.labels[friction.vertices]
        for number, (_, vector) in enumerate(self._frames.poses(end.state.coordinates)):
            moves[labels == number] = turn_of(vector) @ moves[labels == number]
        slope = np.einsum("kim,ki->m", moves, gradient)
        return slope, np.einsum("kim,kij,kjl->ml", moves, blocks, moves, optimize=True)

    def in_world(self, end: _End) -> Array:
        """Displacements (n, 3) [m] beyond the modes in the world."""
        local = end.local.copy()
        for part, (_, vector) in zip(self._frames.parts, self._frames.poses(end.state.coordinates), strict=True):
            local[part.vertices] = local[part.vertices] @ turn_of(vector).T
        return local

    def in_frames(self, end: _End, vertices: Index, vectors: Array) -> Array:
        """Vectors (k, 3) at some vertices in the axes of their frames."""
        found, labels = vectors.copy(), self._frames.labels[vertices]
        for number, (_, vector) in enumerate(self._frames.poses(end.state.coordinates)):
            found[labels == number] = vectors[labels == number] @ turn_of(vector)
        return found
