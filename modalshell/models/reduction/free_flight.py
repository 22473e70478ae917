"""Free parts of a shell whose shape is linear in few coordinates, in frames of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.integrators.free_parts import axial, inertia_of, left_jacobian, turn_of, vector_of
from modalshell.integrators.full.implicit_rule import EulerStart, LoadedSteps
from modalshell.integrators.state import MotionState
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.base.implicit import LoadAt
from modalshell.models.base.stepper import LEAD
from modalshell.models.reduction.derivatives import DerivativeBasis
from modalshell.modes import Basis
from modalshell.modes.rigid import left_free
from modalshell.shell.damping import Damping


@final
class ReducedFlight:
    """Coordinates (r + s,) of a shell with free parts: those of rigid modes, as in :class:`FreeFrames`, and z (s,).

    Parameters
    ----------
    basis : DerivativeBasis
        The vectors U of z, without rigid motions.
    frames : FreeFrames
        Frames of the free parts.
    """

    def __init__(self, basis: DerivativeBasis, frames: FreeFrames) -> None:
        self.frames, self.count, self._basis = frames, frames.count, basis

    @staticmethod
    def frames_of(modes: Basis) -> FreeFrames | None:
        """Frames of the parts that no support holds; None where all are held.

        OptionError where supports leave a part some rigid motions, or the modes lack one of these or any other.
        """
        loose = left_free(modes.shell)
        if not loose:
            return None
        frames = FreeFrames.of(modes)
        if frames is None or not modes.rigid_modes == 6 * len(frames.parts) < modes.count:
            raise OptionError(
                "modal derivatives need parts that their supports hold, or that have none and elastic modes with all "
                f"six rigid ones, but {loose} (got {modes.count} modes, {modes.rigid_modes} of them rigid): a linear "
                "basis cannot turn; hold more vertices with clamped=, ask for more modes, or use DiscreteShell, "
                "RigidShell or ModalWarping"
            )
        return frames

    def whole(self, z: Array) -> Array:
        """Coordinates or rates (r + s,) of z (s,), frames at rest."""
        return np.concatenate([np.zeros(self.count), z])

    def shape(self, q: Array) -> Array:
        """Positions (n, 3) [m] in the frames at q (r + s,)."""
        return self._basis.shell.rest_positions + (self._basis.vectors @ q[self.count :]).reshape(-1, 3)

    def force(self, q: Array, load: Array) -> Array:
        """Reduced forces (r + s,) of a load (n, 3) [N] in the frames."""
        return self.whole(load.ravel() @ self._basis.vectors)

    def start(self, positions: Array) -> Array:
        """Coordinates (r + s,) of positions (n, 3) [m]."""
        mass = self._basis.shell.mass[:, None]
        return self.frames.coordinates_of(
            positions, self.shape, lambda moved: self.whole((mass * moved).ravel() @ self._basis.vectors)
        )

    def local_error(self, error: Array, before: MotionState, after: MotionState) -> Array:
        """Errors (r + s,) of a step without false ones of frames whose rotation vectors jump at half a turn."""
        moves = [state.memory["move"] for state in (before, after) if "move" in state.memory]
        moves.append(after.coordinates - before.coordinates)
        if max(np.abs(self.frames.poses(move)[:, 1]).max() for move in moves) > 0.5 * np.pi:
            error = self.frames.elastic(error)
        return error

    # ---- momenta, as of :class:`modalshell.integrators.full.implicit_rule.Floating`

    def momenta(self, x: Array, rates: Array) -> Array:
        """Momenta (P, 2, 3) at coordinates and rates (r + s,)."""
        return self.frames.momenta(x, rates, self.shape)

    def wrenches(self, x: Array, load: Array) -> Array:
        """Forces and torques (P, 2, 3) of a load (n, 3) [N] at coordinates (r + s,)."""
        return self.frames.split(x, load, self.shape)[1]

    def carried(self, before: MotionState, after: MotionState, first: Array, last: Array, dt: float) -> MotionState:
        """``after`` a step from ``before``, brought to its momenta."""
        return self.frames.landed(before, after, 0.5 * dt * (first + last), last, dt, self.shape)[0]

    def foreseen(self, state: MotionState, load: Array, time: float) -> tuple[Array, Array]:
        """Frames and their rates (P, 2, 3) a ``time`` [s] after a state under a load (n, 3) [N], to second order."""
        q, rates, frames = state.coordinates, state.rates, self.frames
        x, flow = frames.shaped(q, self.shape), (self._basis.vectors @ rates[self.count :]).reshape(-1, 3)
        poses, speeds, spins = frames.poses(q), frames.poses(rates), frames.spins(q, rates)
        for part, pose, speed, spin, wrench in zip(
            frames.parts, poses, speeds, spins, self.wrenches(q, load), strict=True
        ):
            arms, v, turn = x[part.vertices], flow[part.vertices], turn_of(pose[1])
            inertia = inertia_of(part.moments(arms, arms))
            own = np.linalg.solve(inertia, axial(part.moments(arms, v - part.mean(v))))
            faster = np.linalg.solve(inertia, turn.T @ wrench[1] - np.cross(spin, inertia @ spin))
            gain = time / part.total * wrench[0]
            pose[0] += time * (speed[0] + 0.5 * gain)
            pose[1] = vector_of(turn @ turn_of(time * (spin - own + 0.5 * time * faster)))
            speed[0] += gain
            speed[1] = np.linalg.solve(left_jacobian(-pose[1]), spin + time * faster)
        return poses, speeds


@final
class FlyingSteps(LoadedSteps):
    """Steps of implicit Euler of z in the frames, within one step of a rule; loads are those expected at their ends.

    Rotation vectors of frames are no straight coordinates: where a frame is at an end follows from the rule's beginning
    alone, and what the rule makes of its coordinates is left out.
    """

    def __init__(self, model: Any, begin: tuple[MotionState, float], load_at: LoadAt, damping: Damping) -> None:
        self._model, self._flight, self._load_at, self._damping = model, model.flight, load_at, damping
        self._begin, self._dt = begin
        self._load: Array | None = None

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """State at the end, and whether its equations were solved."""
        flight, time, r = self._flight, start.end * self._dt, self._flight.count
        frames, load = flight.frames, np.zeros_like(self._model.shell.rest_positions)
        for _ in range(2):  # loads by velocity need that which loads give, else they are of first order
            load, drag = self._load_at(self._seen(start, *flight.foreseen(self._begin, load, time)))
        self._load = load
        seen = self._seen(start, *flight.foreseen(self._begin, load, time)).guess
        ahead = np.concatenate([seen.coordinates[:r], start.guess_ahead[r:]])
        push = frames.push(ahead, load, flight.force, flight.shape, (seen.rates, LEAD * self._dt))
        elastic = self._elastic(start)
        size = float(np.linalg.norm(start.dt * push[:r] + seen.rates[:r]))  # of the rigid modes' forces and inertia
        z, solved = self._model.pushed_step(elastic, push[r:], self._damping, size)
        after = elastic.after(z)
        if drag is not None:
            vertices, slopes = drag
            turns = np.stack([*(turn_of(vector) for _, vector in frames.poses(ahead)), np.eye(3)])
            turns = turns[frames.labels[vertices]]
            expected = MotionState(elastic.origin, elastic.expected_rates)
            slopes = turns.swapaxes(1, 2) @ slopes @ turns
            after = self._model.dragged(after, expected, start.dt, self._damping, vertices, slopes)
        x = np.concatenate([seen.coordinates[:r], after.coordinates])
        return MotionState(x, np.concatenate([seen.rates[:r], after.rates])), solved

    def _seen(self, start: EulerStart, poses: Array, speeds: Array) -> EulerStart:
        """The same step, whose guess has the frames there."""
        frames, r = self._flight.frames, self._flight.count
        rates = frames.with_poses(start.expected_rates, speeds)
        origin = frames.with_poses(start.origin, poses - start.dt * speeds)
        moved = np.concatenate([rates[:r], start.rates[r:]])
        return replace(start, origin=origin, rates=moved, expected_rates=rates)

    def _elastic(self, start: EulerStart) -> EulerStart:
        """The step of z alone."""
        names = "origin", "rates", "expected_rates", "near", "viscous_at"
        return replace(start, **{name: getattr(start, name)[self._flight.count :] for name in names})

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex in its frame by a small ``move`` of the coordinates."""
        return float(self._model.turn(coordinates[self._flight.count :], move[self._flight.count :]))

    def load_on(self, x: Array) -> Array:
        """Load (n, 3) [N] of the last step."""
        assert self._load is not None
        return self._load
