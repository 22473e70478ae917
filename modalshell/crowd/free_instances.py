"""Instances of a shell without supports: every free part of each flies in a frame of its own, as those of one model.

The frames are those of :class:`modalshell.models.base.free_frames.FreeFrames`, for many instances at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array
from modalshell.integrators.free_parts import FreePart, axial, inertia_of, left_jacobian
from modalshell.integrators.modal.flow import free_flow
from modalshell.kernels.momentum import keeping_turns
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.base.stepper import LEAD

Shapes = Callable[[Array], Array]
"""Positions (B, n, 3) [m] of the warps at coordinates (B, m), without frames."""
Push = Callable[[Array, Array], Array]
"""Modal forces (B, m) at coordinates (B, m) of accelerations (B, n, 3) of the vertices."""


def _times(matrices: Array, vectors: Array) -> Array:
    """``M v`` of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _solved(matrices: Array, vectors: Array) -> Array:
    """``M^-1 v`` of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0])


def _moments(part: FreePart, a: Array, b: Array) -> Array:
    """``sum m b a^T`` (B, 3, 3) of a part's vectors (B, k, 3)."""
    return np.asarray((part.mass[:, None] * b).transpose(0, 2, 1) @ a)


def _inertia(part: FreePart, arms: Array) -> Array:
    return inertia_of(_moments(part, arms, arms))


@final
class FreeInstances:
    """The frames of B instances at coordinates (B, m), by those of one; ``drag`` is the mass's damping [1/s]."""

    def __init__(self, frames: FreeFrames, drag: float) -> None:
        self.frames, self.parts, self._drag = frames, frames.parts, drag
        self._held = np.flatnonzero(frames.labels < 0)

    def placed(self, q: Array, poses: tuple[Array, Array] | None) -> tuple[Array, Array]:
        """Rotations (B, P + 1, 3, 3) and places (B, P + 1, 3) [m] of the parts' centres, and of what is held.

        ``poses`` are rotations (B, 9) and translations (B, 3) of the instances as a whole.
        """
        own = self.frames.poses(q)
        count = len(q), len(self.parts) + 1
        turns, moves = np.tile(np.eye(3), (*count, 1, 1)), np.zeros((*count, 3))
        turns[:, :-1], moves[:, :-1] = _turns(own[:, :, 1]), self.frames.centres + own[:, :, 0]
        if poses is None:
            return turns, moves
        whole = poses[0].reshape(-1, 1, 3, 3)
        return whole @ turns, _times(whole, moves) + poses[1][:, None]

    def centred(self, x: NDArray[Any]) -> NDArray[Any]:
        """Positions (B, n, 3) with every free part about its own mean; changed in place."""
        for part in self.parts:
            own = x[:, part.vertices]
            x[:, part.vertices] = own - (part.mass / part.total @ own)[:, None].astype(x.dtype)
        return x

    def place(self, x: NDArray[Any], turns: Array, moves: Array) -> None:
        """Put shapes (B, n, 3) where :meth:`placed` says, in place."""
        self.centred(x)
        for number in range(len(self.parts) + 1):
            chosen = self._held if number == len(self.parts) else self.parts[number].vertices
            back = turns[:, number].transpose(0, 2, 1).astype(x.dtype)
            x[:, chosen] = x[:, chosen] @ back + moves[:, None, number].astype(x.dtype)

    def _spins(self, q: Array, rates: Array) -> Array:
        """Angular velocities (B, P, 3) [rad/s] in the frames' own axes."""
        return _times(left_jacobian(-self.frames.poses(q)[:, :, 1]), self.frames.poses(rates)[:, :, 1])

    def push(self, q: Array, rates: Array, felt: Array, dt: float, shapes: Shapes, push: Push) -> Array:
        """Modal forces (B, m) of accelerations ``felt`` (B, 3), with those of the frames' turns.

        An acceleration of all vertices does not bend a free part. On the rigid modes it is a force.
        """
        elastic, spins = self.frames.elastic(q), self._spins(q, rates)
        given, forces = np.zeros((len(q), len(self.frames.labels), 3)), np.zeros((len(q), len(self.parts), 2, 3))
        given[:, self._held] = felt[:, None]
        if spins.any():
            x, v = self._moving(elastic, self.frames.elastic(rates), LEAD * dt, shapes)
            for number, part in enumerate(self.parts):
                arms, spin = x[:, part.vertices], spins[:, number]
                inertia = _inertia(part, arms)
                faster = _solved(inertia, -np.cross(spin, _times(inertia, spin)))[:, None]
                along = np.cross(spin[:, None], arms) + 2.0 * v[:, part.vertices]
                given[:, part.vertices] = -np.cross(faster, arms) - np.cross(spin[:, None], along)
        for number, part in enumerate(self.parts):
            forces[:, number, 0] = part.total * felt
        pushed, count = push(elastic, given) if given.any() else np.zeros_like(q), self.frames.count
        slack = pushed[:, :count] @ self.frames.others.T
        pushed[:, :count] = slack + forces.reshape(len(q), -1) @ self.frames.to_poses
        return pushed

    def _moving(self, elastic: Array, rates: Array, lead: float, shapes: Shapes) -> tuple[Array, Array]:
        """Shapes (B, n, 3) [m] about their centres, and their velocities in frames that turn with their mean motion."""
        x = shapes(elastic)
        v = self.centred((x - shapes(elastic - lead * rates)) / lead)
        self.centred(x)
        for part in self.parts:
            arms, own = x[:, part.vertices], v[:, part.vertices]
            turning = _solved(_inertia(part, arms), axial(_moments(part, arms, own)))
            v[:, part.vertices] = own - np.cross(turning[:, None], arms)
        return x, v

    def flown(
        self, before: tuple[Array, Array], after: tuple[Array, Array], ends: tuple[Array, Array], dt: float,
        shapes: Shapes,
    ) -> tuple[Array, Array, Array]:  # fmt: skip
        """Coordinates, rates (B, m) and turns back (B, P, 3) a step on; see :meth:`FreeFrames.flown`.

        ``before`` and ``after`` are coordinates and rates, ``ends`` the modal forces (B, m) at the step's two ends.
        """
        c, (q0, v0), (q1, v1) = free_flow(self._drag, dt), before, after
        count, inverse = self.frames.count, self.frames.from_poses
        first, last = ((end[:, :count] @ inverse).reshape(len(q0), -1, 2, 3) for end in ends)
        x0, x1 = (self.centred(shapes(self.frames.elastic(q))) for q in (q0, q1))
        poses, speeds, spins = self.frames.poses(q0), self.frames.poses(v0), self._spins(q0, v0)
        turns, back = _turns(poses[:, :, 1]), np.empty_like(spins)
        for number, part in enumerate(self.parts):
            y0, y1, turn = x0[:, part.vertices], x1[:, part.vertices], turns[:, number]
            start, change, inertia = first[:, number], last[:, number] - first[:, number], _inertia(part, y0)
            angular = _times(turn, _times(inertia, spins[:, number]))
            momenta = np.stack([part.total * speeds[:, number, 0], angular], axis=1)
            moved = c.e12 * momenta + c.a1 * start + c.a2 * change
            momenta = c.e22 * momenta + c.b1 * start + c.b2 * change
            poses[:, number, 0] += moved[:, 0] / part.total
            speeds[:, number, 0] = momenta[:, 0] / part.total
            impulse = _times(turn.transpose(0, 2, 1), moved[:, 1])
            steps = np.empty_like(turn)
            keeping_turns(_moments(part, y0, y1), impulse, _solved(inertia, impulse), steps)
            turn = turn @ steps
            vector = Rotation.from_matrix(turn).as_rotvec()
            spin = _solved(_inertia(part, y1), _times(turn.transpose(0, 2, 1), momenta[:, 1]))
            own = left_jacobian(-vector)
            poses[:, number, 1], speeds[:, number, 1] = vector, _solved(own, spin)
            turned = Rotation.from_matrix(steps).as_rotvec() / dt - 0.5 * (spins[:, number] + spin)
            back[:, number] = _solved(own, turned)
        return self.frames.with_poses(q1, poses), self.frames.with_poses(v1, speeds), back


def _turns(vectors: Array) -> Array:
    """Rotations (..., 3, 3) of rotation vectors (..., 3)."""
    return np.asarray(Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()).reshape(*vectors.shape, 3)
