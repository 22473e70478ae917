"""States of the hybrid in its coordinates and in positions of its coarse shell, of parts that fly, too."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from modalshell.core.cost import count_read
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.integrators.free_parts import (
    FittedFrames,
    axial,
    crossed,
    inertia_of,
    left_jacobian,
    turn_keeping,
    turn_of,
    vector_of,
)
from modalshell.integrators.full.composite import no_middle
from modalshell.integrators.state import MotionState
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.coarse.free_parts import ProlongedParts
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.reduction.free_flight import Anchored, ReducedFlight, frames_of
from modalshell.modes.rigid import left_free, rigid_motions
from modalshell.shell import Shell

_LEFT = 0.01
"""Distance of a coarse state from the basis, over its displacement, from which the coarse shell goes on alone."""


@final
class CoarseShape:
    """Fine shapes of a coarse shell's vectors V (3k, m): those at ``X + V z``, prolonged."""

    def __init__(self, coarse: CoarseDiscreteShell, basis: Array, weighted: Array) -> None:
        self.coarse, self.basis, self.weighted = coarse, basis, weighted

    @property
    def shell(self) -> Shell:
        """The fine shell."""
        return self.coarse.shell

    @property
    def rest(self) -> Array:
        """Positions (k, 3) [m] of the coarse shell at rest."""
        return np.asarray(self.coarse.coarse.shell.rest_positions)

    def under(self, z: Array) -> Array:
        """Positions (k, 3) [m] of the coarse vertices."""
        count_read(self.basis.nbytes)
        return self.rest + self.moved(z)

    def moved(self, change: Array) -> Array:
        """Displacements (k, 3) of the coarse vertices by a change (m,)."""
        return np.asarray(self.basis @ change).reshape(-1, 3)

    def fine(self, x: Array) -> Array:
        """Positions (n, 3) [m] of coarse ones (k, 3) [m]."""
        return self.coarse.positions(MotionState(x, x))

    def at(self, z: Array) -> Array:
        """Positions (n, 3) [m]."""
        return self.fine(self.under(z))

    def flow(self, z: Array, rates: Array) -> Array:
        """Velocities (n, 3) [m/s]."""
        return self.coarse.flow(self.under(z), self.moved(rates))

    def of_moved(self, moved: Array) -> Array:
        """Coordinates (m,) of displacements (k, 3) of the coarse vertices."""
        return np.asarray(self.weighted @ moved.ravel())

    def nearest(self, x: Array) -> tuple[Array, bool]:
        """Coordinates (m,) nearest to coarse positions (k, 3) in the frames, and whether they are near."""
        z = self.of_moved(x - self.rest)
        return z, _near(x - self.under(z), x - self.rest, self.coarse.coarse.shell)

    def near(self, positions: Array, q: Array, flight: Anchored | ReducedFlight) -> bool:
        """Whether coordinates (r + m,) of a flight are near the positions (n, 3) [m] that they were made of."""
        unbent = np.concatenate([q[: flight.count], np.zeros_like(q[flight.count :])])
        found = flight.positions(q)
        return _near(found - positions, found - flight.positions(unbent), self.shell)

    def project(self, moved: Array) -> Array:
        """Coordinates (m,) of displacements (n, 3) [m]."""
        return self.of_moved(self.coarse.sampled_from(moved) - self.rest)


def _near(off: Array, displacement: Array, shell: Shell) -> bool:
    """Whether distances are small against displacements, in the norm of the mass."""
    mass = shell.mass[:, None]
    return not np.sum(mass * off**2) > _LEFT**2 * np.sum(mass * displacement**2)


@final
class HeldStates:
    """States of a shell that its supports hold."""

    def __init__(self, shape: CoarseShape) -> None:
        self.flight = Anchored(shape)
        self._shape = shape

    def as_coarse(self, state: MotionState) -> MotionState:
        """A state of coordinates (m,) in positions (k, 3) [m] of the coarse vertices."""
        return state.mapped(self._shape.under, self._shape.moved)

    def reduced(self, state: MotionState) -> MotionState:
        """The nearest state of coordinates (m,) to one of coarse positions (k, 3) [m]."""
        shape = self._shape
        return state.mapped(lambda x: shape.of_moved(x - shape.rest), shape.of_moved)

    def local(self, x: Array) -> Array:
        """Coarse positions (k, 3) [m] in the frames."""
        return x

    def landed(self, state: MotionState, reduced: MotionState, after: MotionState) -> MotionState:
        """``after`` a step from a coarse state that was taken for ``reduced``."""
        return after

    def moved(self, change: Array) -> Array:
        """Displacements (k, 3) of the coarse vertices by a small change of coordinates."""
        return self._shape.moved(change)


@final
class FlownStates:
    """States of a shell with free parts: coordinates (r + m,) of their frames, and of V in these.

    Both kinds of states have the same momenta, those of the fine surface.
    """

    def __init__(self, shape: CoarseShape, flight: ReducedFlight, momenta: ProlongedParts) -> None:
        self.flight = flight
        self._shape, self._under, self._momenta = shape, momenta.under, momenta
        self._fitted = FittedFrames(shape.rest, momenta.under)

    def as_coarse(self, state: MotionState) -> MotionState:
        """A state of coordinates (r + m,) in positions (k, 3) [m] of the coarse vertices."""
        return _with_memory(state, self._at_coarse_vertices)

    def reduced(self, state: MotionState) -> MotionState:
        """The nearest state of coordinates (r + m,) to one of coarse positions (k, 3) [m]."""
        return _with_memory(state, self._nearest_coordinates)

    def local(self, x: Array) -> Array:
        """Coarse positions (k, 3) [m] in the frames, those of free parts as they fit the shape at rest best."""
        return self._fitted.local(x)

    def moved(self, change: Array) -> Array:
        """Displacements (k, 3) of the coarse vertices by a small change of coordinates (r + m,)."""
        found, rest = self._shape.moved(change[self.flight.count :]), self._shape.rest
        for part, (moved, turned) in zip(self._under.parts, self.flight.frames.poses(change), strict=True):
            own = rest[part.vertices]
            found[part.vertices] += moved + crossed(turned, own - part.mean(own))
        return found

    def landed(self, state: MotionState, reduced: MotionState, after: MotionState) -> MotionState:
        """``after`` a step from a ``state``, turned so that parts have swept what they would from ``reduced`` itself.

        The shape of a coarse state is not quite that of the coordinates it is taken for: its parts keep the discrete
        momentum ``sum m x_n x x_{n+1}`` from where they were.
        """
        if state is reduced:
            return after
        frames, flight = self.flight.frames, self.flight
        q, rates, momenta = after.coordinates, after.rates, flight.momenta(after.coordinates, after.rates)
        found = (self._shape.fine(state.coordinates), *map(flight.positions, (reduced.coordinates, q)))
        poses, speeds = frames.poses(q), frames.poses(rates)
        for part, pose, speed, momentum in zip(frames.parts, poses, speeds, momenta, strict=True):
            first, taken, last = (x[part.vertices] - part.mean(x[part.vertices]) for x in found)
            swept = axial(part.moments(taken, last))
            turn, kept = turn_keeping(part.moments(first, last), swept, np.zeros(3))
            if kept:
                last = last @ turn.T
                pose[1] = vector_of(turn @ turn_of(pose[1]))
                spin = np.linalg.solve(inertia_of(part.moments(last, last)), momentum[1])
                speed[1] = np.linalg.solve(left_jacobian(pose[1]), spin)
        x, v = frames.with_poses(q, poses), frames.with_poses(rates, speeds)
        memory = dict(after.memory)
        if "move" in memory:
            memory |= {"move": memory["move"] + (x - q), "gain": memory["gain"] + (v - rates)}
        if "middle" in memory:
            memory |= no_middle(x)
        return MotionState(x, v, memory)

    def _at_coarse_vertices(self, q: Array, rates: Array) -> tuple[Array, Array]:
        """Positions and velocities (k, 3) of coordinates and rates (r + m,)."""
        shape, frames, r = self._shape, self.flight.frames, self.flight.count
        z, flow = q[r:], rates[r:]
        x, v, fine, moving = shape.under(z), shape.moved(flow), shape.at(z), shape.flow(z, flow)
        poses, speeds, spins = frames.poses(q), frames.poses(rates), frames.spins(q, rates)
        for number, (above, under) in enumerate(zip(frames.parts, self._under.parts, strict=True)):
            shaped, own, at = fine[above.vertices], moving[above.vertices], under.vertices
            mean, drift, turn = above.mean(shaped), above.mean(own), turn_of(poses[number, 1])
            out = shaped - mean
            itself = np.linalg.solve(inertia_of(above.moments(out, out)), axial(above.moments(out, own - drift)))
            spin = spins[number] - itself
            arms = x[at] - mean
            v[at] = (v[at] - drift + crossed(spin, arms)) @ turn.T + speeds[number, 0]
            x[at] = arms @ turn.T + frames.centres[number] + poses[number, 0]
        return x, v

    def _nearest_coordinates(self, x: Array, v: Array) -> tuple[Array, Array]:
        """Coordinates and rates (r + m,) nearest to positions and velocities (k, 3)."""
        shape, frames, rest = self._shape, self.flight.frames, self._shape.rest
        local, own = x.copy(), v.copy()
        momenta, fine = self._momenta.momenta(x, v), shape.fine(x)
        poses, speeds = np.empty((2, len(frames.parts), 2, 3))
        turns = []
        for number, (above, part) in enumerate(zip(frames.parts, self._under.parts, strict=True)):
            at = part.vertices
            arms, first = x[at] - part.mean(x[at]), rest[at] - part.mean(rest[at])
            turn = self._fitted.turn(part, x)
            arms, speed = arms @ turn, (v[at] - part.mean(v[at])) @ turn
            moments = part.moments(first, arms)  # the frame turns so that displacements stay without a turn
            spin = np.linalg.solve(np.trace(moments) * np.eye(3) - moments, axial(part.moments(first, speed)))
            local[at], own[at] = arms + part.mean(rest[at]), speed - crossed(spin, arms)
            poses[number, 0] = above.mean(fine[above.vertices]) - frames.centres[number]
            poses[number, 1] = vector_of(turn)
            speeds[number, 0] = momenta[number, 0] / above.total
            turns.append(turn)
        z = shape.of_moved(local - rest)
        shaped = shape.at(z)
        for number, (above, turn) in enumerate(zip(frames.parts, turns, strict=True)):
            arms = shaped[above.vertices] - above.mean(shaped[above.vertices])
            spin = np.linalg.solve(inertia_of(above.moments(arms, arms)), turn.T @ momenta[number, 1])
            speeds[number, 1] = np.linalg.solve(left_jacobian(-poses[number, 1]), spin)
        whole = self.flight.whole
        return frames.with_poses(whole(z), poses), frames.with_poses(whole(shape.of_moved(own)), speeds)


def _with_memory(state: MotionState, place: Callable[[Array, Array], tuple[Array, Array]]) -> MotionState:
    """A state in other unknowns, and what a rule keeps of its last step by where that began."""
    x, v, memory = state.coordinates, state.rates, dict(state.memory)
    here = place(x, v)
    if "move" in memory:
        before = place(x - memory["move"], v - memory["gain"])
        changes = {"move": here[0] - before[0], "gain": here[1] - before[1]}
        memory |= changes | {"curvature": np.zeros_like(here[1])}
    if "middle" in memory:
        memory |= no_middle(here[0])
    return MotionState(*here, memory)


def states_of(shape: CoarseShape) -> HeldStates | FlownStates:
    """How states of a shell are taken to its coarse shell and back; OptionError for parts that are held in part."""
    momenta, frames = shape.coarse.free_parts, flying_frames(shape.shell)
    if frames is None:
        return HeldStates(shape)
    if momenta is None:
        raise OptionError("the coarse shell must have the same parts without supports as the shell itself")
    return FlownStates(shape, ReducedFlight(shape, frames), momenta)


def flying_frames(shell: Shell) -> FreeFrames | None:
    """Frames of a shell's free parts; None where all are held, OptionError where some are held in part."""
    if not left_free(shell):
        return None
    return frames_of(shell, np.asarray(shell.unknowns.prolong(rigid_motions(shell))), "leave all supports out")
