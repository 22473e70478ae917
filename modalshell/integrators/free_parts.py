"""Parts of a shell that nothing holds: their momenta, and the motion of their centres and frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array, Index
from modalshell.integrators.state import MotionState
from modalshell.kernels import rotations
from modalshell.kernels.momentum import exponential, keeping_turn, rotation_vector
from modalshell.shell import Shell

_STRETCHED, _ANCHORED = 1.01, 1e-6
"""A stretch, and the share of its energy that a rigid motion costs from which something holds a shell."""


def inertia_of(moments: Array) -> Array:
    """Inertia (..., 3, 3) of second moments ``sum m r r^T`` (..., 3, 3)."""
    return np.asarray(np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments)


def axial(moments: Array) -> Array:
    """``sum m a x b`` (3,) of ``sum m b a^T`` (3, 3); of one or many (B, 3, 3)."""
    m = moments.T
    return np.array([m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]]).T


def crossed(vector: Array, arms: Array) -> Array:
    """``vector x arms`` of one vector (3,) and many (k, 3)."""
    x, y, z = vector
    return np.asarray(arms @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]))


def turn_of(vector: Array) -> Array:
    """Rotation (3, 3) of a rotation vector (3,)."""
    found = np.empty((3, 3))
    exponential(vector, found)
    return found


def vector_of(turn: Array) -> Array:
    """Rotation vector (3,) of a rotation (3, 3)."""
    found = np.empty(3)
    rotation_vector(turn, found)
    return found


def left_jacobian(vector: Array) -> Array:
    """Rt(w) (..., 3, 3), which takes rates of rotation vectors (..., 3) to angular velocities in the world's frame."""
    found = np.empty((vector.size // 3, 3, 3))
    rotations.averages(vector.reshape(-1, 3), found)
    return found.reshape(*vector.shape, 3)


def turn_keeping(moments: Array, impulse: Array, guess: Array) -> tuple[Array, bool]:
    """Rotation F (3, 3) with ``sum m a x F b = impulse``, near a ``guess`` (3,) [rad]; and whether there is one.

    ``moments`` (3, 3) is ``sum m b a^T`` of two shapes about their centres. With a shape at both ends of a step, in
    axes that turn with it, this is the discrete top of [moser1991], that of a body that changes its shape.
    """
    turn = np.empty((3, 3))
    found = keeping_turn(np.ascontiguousarray(moments), impulse, guess, turn)
    return turn, bool(found)


@final
@dataclass(frozen=True, eq=False)
class FreePart:
    """A connected part without supports."""

    vertices: Index | slice
    """Its vertices."""
    mass: Array
    """Their masses [kg]; shape (k,)."""

    @cached_property
    def total(self) -> float:
        """Mass [kg]."""
        return float(self.mass.sum())

    def mean(self, values: Array) -> Array:
        """Mean (3,) of its own vertices' values (k, 3) by the mass: of positions, the centre."""
        return np.asarray(self.mass @ values) / self.total

    def moments(self, a: Array, b: Array) -> Array:
        """``sum m b a^T`` (3, 3) of its own vertices' vectors (k, 3)."""
        return np.asarray((self.mass[:, None] * b).T @ a)

    def balanced(self, arms: Array, forces: Array) -> Array:
        """Forces (k, 3) [N] at arms (k, 3) [m] from the centre, less those that accelerate the part as a rigid body."""
        turning = np.asarray(np.linalg.solve(inertia_of(self.moments(arms, arms)), axial(forces.T @ arms)))
        return np.asarray(forces - self.mass[:, None] * (forces.sum(axis=0) / self.total + crossed(turning, arms)))


def _anchored(shell: Shell, part: Index | slice) -> bool:
    """Whether a rigid motion of a part costs energy, as a share of that of a small stretch."""
    rest = shell.rest_positions
    moved, stretched = rest.copy(), rest.copy()
    moved[part] = rest[part] @ turn_of(np.array([0.4, 0.3, -0.2])).T + shell.size * np.array([0.3, -0.2, 0.1])
    stretched[part] *= _STRETCHED
    least, rigid, much = (shell.elastic_energy.energy(x) for x in (rest, moved, stretched))
    return abs(rigid - least) > _ANCHORED * abs(much - least)


class RigidMove(NamedTuple):
    """A turn about a centre that moves, and a change of velocity and spin."""

    centre: Array
    velocity: Array
    """Where the centre was [m], and its velocity [m/s]; shape (3,)."""
    turn: Array
    """Rotation about it; shape (3, 3)."""
    new_centre: Array
    new_velocity: Array
    """Where it belongs, and its velocity; shape (3,)."""
    spin: Array
    """Angular velocity to add [rad/s]; shape (3,)."""


@final
class FreeParts:
    """All free parts of a shell; see :meth:`of`.

    Momenta, forces and torques are (parts, 2, 3): of the whole part, and about its own centre.
    """

    def __init__(self, parts: tuple[FreePart, ...]) -> None:
        self.parts = parts

    @classmethod
    def of(cls, shell: Shell) -> FreeParts | None:
        """The parts that no support holds, and that no element joins to one that is held; None without any.

        Nor where an energy does not leave rigid motions free, such as that of a foundation.
        """
        supported, labels = shell.unknowns.supported, shell.mesh.components
        if supported.any() and not np.setdiff1d(labels, labels[supported]).size:
            return None
        count, joined = connected_components(shell.pattern.blocks, directed=False)
        loose = np.setdiff1d(np.arange(count), joined[supported])
        if count == 1 and loose.size:
            whole = slice(None)
            return None if _anchored(shell, whole) else cls((FreePart(whole, shell.mass),))
        parts = (np.flatnonzero(joined == part) for part in loose)
        chosen = [part for part in parts if not _anchored(shell, part)]
        return cls(tuple(FreePart(part, shell.mass[part]) for part in chosen)) if chosen else None

    def momenta(self, x: Array, rates: Array) -> Array:
        """Momenta at positions (n, 3) [m] and velocities (n, 3) [m/s]."""
        found = np.empty((len(self.parts), 2, 3))
        for at, part in zip(found, self.parts, strict=True):
            own, v = x[part.vertices], rates[part.vertices]
            at[0] = part.mass @ v
            at[1] = axial(part.moments(own - part.mean(own), v - at[0] / part.total))
        return found

    def wrenches(self, x: Array, load: Array) -> Array:
        """Forces and torques of a load (n, 3) [N] at positions (n, 3) [m]."""
        found = np.empty((len(self.parts), 2, 3))
        for at, part in zip(found, self.parts, strict=True):
            own, pushed = x[part.vertices], load[part.vertices]
            at[0] = pushed.sum(axis=0)
            at[1] = axial(pushed.T @ (own - part.mean(own)))
        return found

    def moves(self, before: Array, after: MotionState, first: Array, last: Array, dt: float) -> list[RigidMove]:
        """Rigid moves that bring ``after``, a step from positions ``before`` (n, 3), to its momenta.

        Momenta go from ``first`` to ``last``; their mean over the step says how far centres move, and by what discrete
        momentum ``sum m x_n x x_{n+1}`` parts turn. A part that no rotation brings there keeps its own.
        """
        found = []
        for part, start, end in zip(self.parts, first, last, strict=True):
            old, new, rates = (x[part.vertices] for x in (before, after.coordinates, after.rates))
            centre, own, drift = part.mean(old), part.mean(new), part.mean(rates)
            arms, mean = new - own, 0.5 * dt * (start + end)
            turn, kept = turn_keeping(part.moments(old - centre, arms), mean[1], np.zeros(3))
            if not kept:
                turn = np.eye(3)
            arms, relative = arms @ turn.T, (rates - drift) @ turn.T
            missing = end[1] - axial(part.moments(arms, relative))
            spin = np.linalg.solve(inertia_of(part.moments(arms, arms)), missing)
            found.append(RigidMove(own, drift, turn, centre + mean[0] / part.total, end[0] / part.total, spin))
        return found

    def moved(self, state: MotionState, moves: list[RigidMove]) -> MotionState:
        """A state of positions (n, 3) and rates whose parts are moved."""
        x, rates = state.coordinates.copy(), state.rates.copy()
        for part, move in zip(self.parts, moves, strict=True):
            arms = (x[part.vertices] - move.centre) @ move.turn.T
            x[part.vertices] = arms + move.new_centre
            relative = (rates[part.vertices] - move.velocity) @ move.turn.T
            rates[part.vertices] = relative + np.cross(move.spin, arms) + move.new_velocity
        return MotionState(x, rates, state.memory)

    def carried(self, before: MotionState, after: MotionState, first: Array, last: Array, dt: float) -> MotionState:
        """``after`` a step from ``before``, with the :meth:`moves` that its momenta ask for."""
        return self.moved(after, self.moves(before.coordinates, after, first, last, dt))


@final
class FittedFrames:
    """Frames of free parts, of least distance from ``rest`` (k, 3) [m] in the norm of the mass [kabsch1976].

    Displacements in them have no turn, as those of elastic modes. Without parts all stays as it is.
    """

    def __init__(self, rest: Array, parts: FreeParts | None) -> None:
        self.rest, self.parts = rest, () if parts is None else parts.parts

    def turn(self, part: FreePart, x: Array) -> Array:
        """Rotation (3, 3) of a part at positions (k, 3) [m] of all vertices."""
        arms, first = x[part.vertices], self.rest[part.vertices]
        arms, first = arms - part.mean(arms), first - part.mean(first)
        return np.asarray(Rotation.align_vectors(arms, first, part.mass)[0].as_matrix())

    def local(self, x: Array) -> Array:
        """Positions (k, 3) [m] in the frames."""
        found = x.copy()
        for part in self.parts:
            arms = x[part.vertices]
            found[part.vertices] = (arms - part.mean(arms)) @ self.turn(part, x) + part.mean(self.rest[part.vertices])
        return found

    def load_in_frames(self, x: Array, load: Array) -> Array:
        """Load (k, 3) [N] in the world that turns with the frames at x (k, 3) [m], balanced by the parts' inertia."""
        found = load.copy()
        for part in self.parts:
            given, arms = load[part.vertices] @ self.turn(part, x).T, x[part.vertices]
            found[part.vertices] = part.balanced(arms - part.mean(arms), given)
        return found
