"""Free parts of a shell whose shape follows from few coordinates, in frames of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol, final

import numpy as np

from modalshell.core.cost import count_read
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.integrators.free_parts import axial, inertia_of, left_jacobian, turn_of, vector_of
from modalshell.integrators.full.implicit_rule import EulerStart, EulerSteps, steps_of
from modalshell.integrators.state import MotionState
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.base.implicit import AskedSteps, LoadAt, ModelSteps
from modalshell.models.base.stepper import LEAD
from modalshell.modes.rigid import left_free, rigid_share
from modalshell.shell import Shell
from modalshell.shell.damping import Damping


class ReducedShape(Protocol):
    """Shapes of a shell in few coordinates z (s,), of free parts in their frames."""

    @property
    def shell(self) -> Shell:
        """The shell, of n vertices."""

    def at(self, z: Array) -> Array:
        """Positions (n, 3) [m]."""

    def flow(self, z: Array, rates: Array) -> Array:
        """Velocities (n, 3) [m/s]."""

    def project(self, moved: Array) -> Array:
        """Coordinates (s,) of displacements (n, 3) [m], small ones of elastic modes."""


@final
class LinearShape:
    """Shapes ``X + U z``, U (3n, s) mass-orthonormal."""

    def __init__(self, shell: Shell, vectors: Array) -> None:
        self.shell, self._vectors = shell, vectors

    def at(self, z: Array) -> Array:
        """Positions (n, 3) [m]."""
        count_read(self._vectors.nbytes)
        return self.shell.rest_positions + self.flow(z, z)

    def flow(self, z: Array, rates: Array) -> Array:
        """Velocities (n, 3) [m/s]."""
        return np.asarray(self._vectors @ rates).reshape(-1, 3)

    def project(self, moved: Array) -> Array:
        """Coordinates (s,) of the mass-weighted projection of displacements (n, 3) [m]."""
        return np.asarray((self.shell.mass[:, None] * moved).ravel() @ self._vectors)


def frames_of(shell: Shell, rigid: Array, advice: str) -> FreeFrames | None:
    """Frames of the parts that no support holds, by rigid modes (3n, r); None where all are held.

    OptionError with an ``advice`` where supports leave a part some rigid motions, or the modes lack one.
    """
    loose = left_free(shell)
    if not loose:
        return None
    frames = FreeFrames.of(shell, rigid)
    if frames is None or rigid.shape[1] != 6 * len(frames.parts):
        raise OptionError(
            f"parts of a shell must be held by their supports, or have none, but {loose}: a linear basis cannot turn; "
            f"hold more vertices with clamped=, {advice}, or use DiscreteShell, RigidShell or ModalWarping"
        )
    return frames


@final
class Anchored:
    """Coordinates z (s,) of a shell that its supports hold: no frames, of what :class:`ReducedFlight` gives."""

    count = 0

    def __init__(self, shape: ReducedShape) -> None:
        self._shape = shape

    def whole(self, z: Array) -> Array:
        """Coordinates z (s,) themselves."""
        return z

    def start(self, positions: Array) -> Array:
        """Coordinates (s,) of positions (n, 3) [m]."""
        return self._shape.project(positions - self._shape.shell.rest_positions)

    def positions(self, q: Array) -> Array:
        """Positions (n, 3) [m] at q (s,)."""
        return self._shape.at(q)

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state at ``own`` (n, 3), over a short time ``lead`` [s]."""
        return np.asarray((own - self._shape.at(state.coordinates - lead * state.rates)) / lead)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of a state."""
        return 0.5 * float(np.sum(state.rates**2))

    def rigid_load(self, load: Array) -> float:
        """Share of a load (n, 3) that moves free parts as rigid bodies."""
        return 0.0

    def local_error(self, error: Array, before: MotionState, after: MotionState) -> Array:
        """Errors (s,) of a step, as they are."""
        return error

    def steps(self, model: Any, begin: tuple[MotionState, float], load_at: LoadAt, damping: Damping) -> EulerSteps:
        """Steps of implicit Euler of a model."""
        return ModelSteps(model, load_at, damping)


@final
class ReducedFlight:
    """Coordinates (r + s,) of a shell with free parts: those of rigid modes, as in :class:`FreeFrames`, and z (s,).

    ``shape`` is what z, which has no rigid motions, makes of the shell.
    """

    def __init__(self, shape: ReducedShape, frames: FreeFrames) -> None:
        self.frames, self.count, self._of_z = frames, frames.count, shape

    def whole(self, z: Array) -> Array:
        """Coordinates or rates (r + s,) of z (s,), frames at rest."""
        return np.concatenate([np.zeros(self.count), z])

    def shape(self, q: Array) -> Array:
        """Positions (n, 3) [m] in the frames at q (r + s,)."""
        return self._of_z.at(q[self.count :])

    def start(self, positions: Array) -> Array:
        """Coordinates (r + s,) of positions (n, 3) [m]."""
        return self.frames.coordinates_of(positions, self.shape, lambda moved: self.whole(self._of_z.project(moved)))

    def positions(self, q: Array) -> Array:
        """Positions (n, 3) [m] in the world at q (r + s,)."""
        return self.frames.positions(q, self.shape)

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state, those in the frames over a short time ``lead`` [s]."""
        return self.frames.velocities(state, lead, self.shape)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of a state, that of its frames with it."""
        return self.frames.kinetic_energy(state, self.shape)

    def rigid_load(self, load: Array) -> float:
        """Share of a load (n, 3) that moves free parts as rigid bodies."""
        return rigid_share(self._of_z.shell, load) if load.any() else 0.0

    def local_error(self, error: Array, before: MotionState, after: MotionState) -> Array:
        """Errors (r + s,) of a step without false ones of frames whose rotation vectors jump at half a turn."""
        moves = [state.memory["move"] for state in (before, after) if "move" in state.memory]
        moves.append(after.coordinates - before.coordinates)
        if max(np.abs(self.frames.poses(move)[:, 1]).max() for move in moves) > 0.5 * np.pi:
            error = self.frames.elastic(error)
        return error

    def steps(self, model: Any, begin: tuple[MotionState, float], load_at: LoadAt, damping: Damping) -> EulerSteps:
        """Steps of implicit Euler of a model within one step of a rule from a state over a time [s]: ``begin``."""
        return steps_of(FlyingSteps(model, begin, load_at, damping), self, damping)

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

    def predicted_frames(self, state: MotionState, load: Array, time: float) -> tuple[Array, Array]:
        """Frames and their rates (P, 2, 3) a ``time`` [s] after a state under a load (n, 3) [N], to second order."""
        q, rates, frames = state.coordinates, state.rates, self.frames
        x, flow = frames.shaped(q, self.shape), self._of_z.flow(q[self.count :], rates[self.count :])
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
class FlyingSteps(AskedSteps):
    """Steps of implicit Euler of z in the frames, within one step of a rule; loads are those expected at their ends.

    Rotation vectors of frames are no straight coordinates: where a frame is at an end follows from the rule's beginning
    alone, and what the rule makes of its coordinates is left out.
    """

    def __init__(self, model: Any, begin: tuple[MotionState, float], load_at: LoadAt, damping: Damping) -> None:
        super().__init__(model, load_at, damping)
        self._flight, (self._begin, self._dt) = model.flight, begin

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """State at the end, and whether its equations were solved."""
        flight, time, r = self._flight, start.end * self._dt, self._flight.count
        frames, load = flight.frames, np.zeros_like(self._model.shell.rest_positions)
        for _ in range(2):  # loads by velocity need that which loads give, else they are of first order
            load, drag = self._load_at(self._seen(start, *flight.predicted_frames(self._begin, load, time)))
        self._load = load
        seen = self._seen(start, *flight.predicted_frames(self._begin, load, time)).guess
        ahead = np.concatenate([seen.coordinates[:r], (start.origin + start.dt * start.expected_rates)[r:]])
        own = np.zeros_like(load)

        def kept(q: Array, balanced: Array) -> Array:
            own[:] = balanced
            return np.zeros_like(q)

        push = frames.push(ahead, load, kept, flight.shape, (seen.rates, LEAD * self._dt))[:r]
        elastic = self._elastic(start)
        size = float(np.linalg.norm(start.dt * push + seen.rates[:r]))  # of the rigid modes' forces and inertia
        z, solved = self._model.euler_step(elastic, own, self._damping, size)
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
        names, r = ("origin", "rates", "expected_rates", "near", "viscous_at"), self._flight.count
        parts = {name: getattr(start, name)[r:] for name in names}
        states = [
            (weight, MotionState(one.coordinates[r:], one.rates[r:]), when) for weight, one, when in start.made_of
        ]
        return replace(start, **parts, made_of=tuple(states))

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex in its frame by a small ``move`` of the coordinates."""
        return super().turn(coordinates[self._flight.count :], move[self._flight.count :])
