"""Frames of the free parts of a modal model: rigid bodies whose shape the elastic modes change.

A part that no support holds has six rigid modes. Their coordinates are, by an invertible linear map, the displacement
of the part's centre of mass and the rotation vector of its frame, so that small ones are those of linear modes; their
rates are the time derivatives of these. The elastic coordinates give the shape in the frame, its mean taken away.

Centre and momenta follow the exact flow under a force and a torque that change linearly over a step, by whatever rule
the elastic modes go. The frame turns so that the discrete momentum ``sum m x_n x x_{n+1}`` is the integral of the
angular momentum: a shape that changes by itself turns back what it would turn [moser1991].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array, Index
from modalshell.integrators.free_parts import (
    FreeParts,
    axial,
    crossed,
    inertia_of,
    left_jacobian,
    turn_keeping,
    turn_of,
    vector_of,
)
from modalshell.integrators.modal.flow import free_flow
from modalshell.integrators.state import MotionState
from modalshell.modes.modal_rotation import cross_matrices
from modalshell.shell import Shell

_EVEN = 1e-13
"""Share of a load that is rounding where the rest of it is the same acceleration of every vertex."""
Shape = Callable[[Array], Array]
"""Positions (n, 3) [m] of the warp at coordinates (m,), those of free parts in their frames."""

Gradient = Callable[[Array, Array], Array]
"""Derivatives (m,) of the warp at coordinates (m,), contracted with weights (n, 3); a new array."""
Patch = Callable[[Array, Index], tuple[Array, Array]]
"""Mean position (3,) [m] of the warp at some vertices, and its Jacobian (3, m)."""


@final
class FreeFrames:
    """Frames of all free parts of a shell at ``rest`` (n, 3) [m]; see the module.

    Attributes
    ----------
    count : int
        Number r of rigid modes.
    to_poses, from_poses : ndarray, shape (6 P, r), (r, 6 P)
        What takes the coordinates of all rigid modes to displacements and rotation vectors of the P frames, and back.
    centres : list of ndarray, shape (3,)
        The parts' centres at rest [m].
    labels : ndarray, shape (n,)
        Number of every vertex' part, -1 where it has none.
    others : ndarray, shape (r, r)
        Projection of the rigid coordinates on motions that parts with supports are left.
    """

    def __init__(self, rest: Array, parts: FreeParts, to_poses: Array) -> None:
        self._rest, self.parts, self.count = rest, parts.parts, to_poses.shape[1]
        self.to_poses, self.from_poses = to_poses, np.linalg.pinv(to_poses)
        self.others = np.eye(self.count) - self.from_poses @ to_poses
        self._all_free = len(to_poses) == self.count
        self.centres = [part.mean(self._rest[part.vertices]) for part in parts.parts]
        self.labels = np.full(len(self._rest), -1)
        for number, part in enumerate(parts.parts):
            self.labels[part.vertices] = number
        self._kept: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, shell: Shell, rigid: Array) -> FreeFrames | None:
        """The frames by rigid modes (3n, r); None without free parts, or with fewer rigid modes than these have."""
        parts = FreeParts.of(shell) if rigid.shape[1] else None
        if parts is None:
            return None
        modes, rows = rigid.reshape(-1, 3, rigid.shape[1]), []
        for part in parts.parts:
            own, x = modes[part.vertices], shell.rest_positions[part.vertices]
            arms = x - part.mean(x)
            moment = np.einsum("n,nij,njr->ir", part.mass, cross_matrices(arms), own)
            rows += [np.tensordot(part.mass / part.total, own, 1)]
            rows += [np.linalg.solve(inertia_of(part.moments(arms, arms)), moment)]
        found = cls(shell.rest_positions, parts, np.vstack(rows))
        return found if np.linalg.matrix_rank(found.to_poses) == len(found.to_poses) else None

    # ---- coordinates and positions

    def elastic(self, q: Array) -> Array:
        """Coordinates or rates (..., m) without those of the frames."""
        shape = q.copy()
        shape[..., : self.count] = 0.0 if self._all_free else (self.others @ q[..., : self.count].T).T
        return shape

    def poses(self, q: Array) -> Array:
        """Displacements [m] and rotation vectors [rad] of the frames (..., P, 2, 3), or their rates, at q (..., m)."""
        return np.asarray((self.to_poses @ q[..., : self.count].T).T).reshape(*q.shape[:-1], -1, 2, 3)

    def with_poses(self, q: Array, poses: Array) -> Array:
        """Coordinates or rates (..., m) with those of the frames (..., P, 2, 3)."""
        whole = self.elastic(q)
        whole[..., : self.count] += self._rigid(poses)
        return whole

    def _rigid(self, poses: Array) -> Array:
        """Coordinates (..., r) of the rigid modes, or their rates, of frames (..., P, 2, 3)."""
        return np.asarray((self.from_poses @ poses.reshape(*poses.shape[:-3], -1).T).T)

    def shaped(self, q: Array, shape: Shape) -> Array:
        """Positions of the warp at q (m,) with every free part about its own centre; kept for the last q."""
        kept = self._kept  # read once: another thread may ask for others meanwhile
        elastic = self.elastic(q)
        if kept is not None and np.array_equal(kept[0], elastic):
            return kept[1]
        x = shape(elastic)
        for part in self.parts:
            x[part.vertices] -= part.mean(x[part.vertices])
        self._kept = elastic, x
        return x

    def positions(self, q: Array, shape: Shape) -> Array:
        """Positions (n, 3) [m] in the world at q (m,)."""
        x = self.shaped(q, shape).copy()
        for part, centre, (moved, vector) in zip(self.parts, self.centres, self.poses(q), strict=True):
            x[part.vertices] = x[part.vertices] @ turn_of(vector).T + (centre + moved)
        return x

    def coordinates_of(self, positions: Array, shape: Shape, project: Callable[[Array], Array]) -> Array:
        """Coordinates (m,) of positions (n, 3): shapes in frames that fit best in the norm of the mass [kabsch1976].

        ``project`` takes displacements (n, 3) to coordinates.
        """
        own, poses = positions.copy(), np.empty((len(self.parts), 2, 3))
        for part, centre, pose in zip(self.parts, self.centres, poses, strict=True):
            x = positions[part.vertices]
            pose[0] = part.mean(x) - centre
            turn, _ = Rotation.align_vectors(x - part.mean(x), self._rest[part.vertices] - centre, part.mass)
            own[part.vertices] = (x - part.mean(x)) @ turn.as_matrix() + centre
        q = self.with_poses(project(own - self._rest), poses)
        bent = self.shaped(q, shape)
        for part, pose in zip(self.parts, poses, strict=True):
            x = positions[part.vertices]
            turn, _ = Rotation.align_vectors(x - part.mean(x), bent[part.vertices], part.mass)
            pose[1] = turn.as_rotvec()
        return self.with_poses(q, poses)

    # ---- loads

    def pull(self, q: Array, weights: Array, gradient: Gradient, shape: Shape) -> Array:
        """Derivatives (m,) at q of the positions, contracted with weights (n, 3)."""
        own, forces = self.split(q, weights, shape)
        for force, (_, vector) in zip(forces, self.poses(q), strict=True):
            force[1] = left_jacobian(vector).T @ force[1]
        return self._joined(gradient(self.elastic(q), own), forces)

    def bending(self, q: Array, load: Array, jacobian: Gradient, shape: Shape) -> Array:
        """Derivatives (m, m) of modal forces by the elastic coordinates, frames resting."""
        return jacobian(self.elastic(q), self.split(q, load, shape)[0])

    def with_elastic(self, whole: Array, bent: Array) -> Array:
        """A matrix (m, m) with the part of another that belongs to elastic modes."""
        whole[self.count :, self.count :] = bent[self.count :, self.count :]
        return whole

    def push(self, q: Array, load: Array, force: Gradient, shape: Shape, moving: tuple[Array, float]) -> Array:
        """Modal forces (m,) of a load (n, 3) [N]; those of the rigid modes are forces and torques, taken to the modes.

        A load that accelerates every vertex alike does not bend the shape. Inertial loads of the turning frames do, by
        the rates (m,) and a short time [s] over which velocities are differences: ``moving``.
        """
        own, forces = self.split(q, load, shape)
        rates, lead = moving
        spins = self.spins(q, rates)
        if spins.any() or forces[:, 1].any():
            speed = self._speeds(q, rates, lead, shape) if spins.any() else np.zeros_like(own)
            self._add_inertia(q, spins, speed, forces, own, shape)
        pushed = force(self.elastic(q), own) if own.any() else np.zeros_like(q)
        return self._joined(pushed, forces)

    def _add_inertia(self, q: Array, spins: Array, speed: Array, forces: Array, own: Array, shape: Shape) -> None:
        """Add Euler, centrifugal and Coriolis forces to loads (n, 3) in the frames; see :meth:`Pose.shell_load`."""
        x = self.shaped(q, shape)
        for part, spin, (_, torque), pose in zip(self.parts, spins, forces, self.poses(q), strict=True):
            arms, v = x[part.vertices], speed[part.vertices]
            inertia = inertia_of(part.moments(arms, arms))
            twist = turn_of(pose[1]).T @ torque
            faster = np.linalg.solve(inertia, twist - np.cross(spin, inertia @ spin))
            felt = crossed(faster, arms) + crossed(spin, crossed(spin, arms) + 2.0 * v)
            own[part.vertices] -= part.mass[:, None] * felt

    def _speeds(self, q: Array, rates: Array, lead: float, shape: Shape) -> Array:
        """Velocities (n, 3) [m/s] of the warp at q, those of free parts in frames that turn with their mean motion."""
        elastic = self.elastic(q)
        speed = (shape(elastic) - shape(elastic - lead * self.elastic(rates))) / lead
        x = self.shaped(q, shape)
        for part in self.parts:
            arms, v = x[part.vertices], speed[part.vertices]
            v = v - part.mean(v)
            own = np.asarray(np.linalg.solve(inertia_of(part.moments(arms, arms)), axial(part.moments(arms, v))))
            speed[part.vertices] = v - crossed(own, arms)
        return speed

    def _joined(self, elastic: Array, forces: Array) -> Array:
        elastic[: self.count] = self.others @ elastic[: self.count] + self.to_poses.T @ forces.ravel()
        return elastic

    def split(self, q: Array, load: Array, shape: Shape) -> tuple[Array, Array]:
        """A load (n, 3) in the frames less its mean acceleration, and forces and torques (P, 2, 3) in the world."""
        own, forces, poses = load.copy(), np.zeros((len(self.parts), 2, 3)), self.poses(q)
        for part, found, (_, vector) in zip(self.parts, forces, poses, strict=True):
            given = load[part.vertices]
            found[0] = given.sum(axis=0)
            uneven = given - part.mass[:, None] * (found[0] / part.total)
            if np.abs(uneven).max() <= _EVEN * np.abs(given).max():
                own[part.vertices] = 0.0
                continue
            turn = turn_of(vector)
            own[part.vertices] = uneven = uneven @ turn
            found[1] = turn @ axial(uneven.T @ self.shaped(q, shape)[part.vertices])
        return own, forces

    # ---- patches of vertices

    def rows(self, q: Array, vertices: Index, warped: Callable[[Array, Index], Array], shape: Shape) -> Array:
        """Rows (k, 3, m) that take rates to velocities of some vertices; those of frames are angular velocities."""
        rows, x, labels = warped(self.elastic(q), vertices), self.shaped(q, shape), self.labels[vertices]
        rows[:, :, : self.count] = rows[:, :, : self.count] @ self.others
        for number, (_, vector) in enumerate(self.poses(q)):
            chosen, turn = labels == number, turn_of(vector)
            arms = x[vertices[chosen]] @ turn.T
            rows[chosen] = turn @ rows[chosen]
            rows[chosen, :, : self.count] += self._rigid_rows(number, arms, np.eye(3))
        return rows

    def _rigid_rows(self, number: int, arms: Array, jacobian: Array) -> Array:
        """Rows (k, 3, r) of a frame's motion at arms (k, 3) in the world, angular velocities by ``jacobian``."""
        moved, turned = self.to_poses[6 * number : 6 * number + 3], self.to_poses[6 * number + 3 : 6 * number + 6]
        return np.asarray(moved - cross_matrices(arms) @ jacobian @ turned)

    def spun(self, q: Array, rates: Array) -> Array:
        """Rates (m,) with angular velocities in place of the rates of rotation vectors."""
        speeds = self.poses(rates)
        for (_, vector), speed in zip(self.poses(q), speeds, strict=True):
            speed[1] = left_jacobian(vector) @ speed[1]
        return self.with_poses(rates, speeds)

    def unspun(self, q: Array, rates: Array) -> Array:
        """The inverse of :meth:`spun`."""
        speeds = self.poses(rates)
        for (_, vector), speed in zip(self.poses(q), speeds, strict=True):
            speed[1] = np.linalg.solve(left_jacobian(vector), speed[1])
        return self.with_poses(rates, speeds)

    def patch_position(
        self, q: Array, vertices: Index, patch: Patch, gradient: Gradient, shape: Shape
    ) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch, and its Jacobian (3, m)."""
        elastic, poses, labels = self.elastic(q), self.poses(q), self.labels[vertices]
        value, jacobian = np.zeros(3), np.zeros((3, q.size))
        for number in np.unique(labels):
            chosen = vertices[labels == number]
            share = len(chosen) / len(vertices)
            place, slope = patch(elastic, chosen)
            slope = slope.copy()
            slope[:, : self.count] = slope[:, : self.count] @ self.others
            if number >= 0:
                part, (moved, vector) = self.parts[number], poses[number]
                turn, weights = turn_of(vector), np.zeros((3, *self._rest.shape))
                for axis in range(3):
                    weights[axis, part.vertices, axis] = part.mass / part.total
                mean = np.stack([gradient(elastic, weight) for weight in weights])
                arm = turn @ (place - part.mean(shape(elastic)[part.vertices]))
                place, slope = arm + self.centres[number] + moved, turn @ (slope - mean)
                slope[:, : self.count] = self._rigid_rows(number, arm[None], left_jacobian(vector))[0]
            value, jacobian = value + share * place, jacobian + share * slope
        return value, jacobian

    def patch_rotation(self, q: Array, vertices: Index, rows: Array) -> tuple[Array, Array]:
        """Rotation vector (3,) [rad] of a patch, and its Jacobian (3, m), by rows (3, m) of the modal rotations."""
        rows, number = rows.copy(), int(self.labels[vertices[0]])
        rows[:, : self.count] = rows[:, : self.count] @ self.others
        own = rows @ self.elastic(q)
        if number < 0:
            return own, rows
        vector = self.poses(q)[number, 1]
        turn = turn_of(vector)
        whole = vector_of(turn @ turn_of(own))
        rows = turn @ left_jacobian(own) @ rows
        rows[:, : self.count] += left_jacobian(vector) @ self.to_poses[6 * number + 3 : 6 * number + 6]
        return whole, np.asarray(np.linalg.solve(left_jacobian(whole), rows), dtype=np.float64)

    # ---- motion

    def spins(self, q: Array, rates: Array) -> Array:
        """Angular velocities (P, 3) [rad/s] in the frames' own axes."""
        poses, speeds = self.poses(q), self.poses(rates)
        return np.array([left_jacobian(-vector) @ speed for (_, vector), (_, speed) in zip(poses, speeds, strict=True)])

    def predicted(self, q: Array, back: Array, time: float) -> Array:
        """Expected coordinates (..., m): frames also turn ``back`` (..., P, 3) what shapes turn, for a ``time`` [s]."""
        if not back.any():
            return q
        q = q.copy()
        q[..., : self.count] += time * self._rigid(np.stack([np.zeros_like(back), back], axis=-2))
        return q

    def flown(
        self, before: MotionState, after: MotionState, ends: tuple[Array, Array], dt: float, drag: float, shape: Shape
    ) -> tuple[MotionState, bool]:
        """``after`` a step from ``before``, its frames where forces and torques bring them; also whether they turned.

        ``ends`` are the modal forces (m,) at the step's beginning and end, ``drag`` [1/s] is the mass's damping. A
        frame that would turn by more than about a radian in the step has no such turn, and goes by its spin.
        """
        c = free_flow(drag, dt)
        start, last = ((self.from_poses.T @ end[: self.count]).reshape(-1, 2, 3) for end in ends)
        change, momenta = last - start, self.momenta(before.coordinates, before.rates, shape)
        moved = c.e12 * momenta + c.a1 * start + c.a2 * change
        return self.landed(before, after, moved, c.e22 * momenta + c.b1 * start + c.b2 * change, dt, shape)

    def landed(
        self, before: MotionState, after: MotionState, moved: Array, momenta: Array, dt: float, shape: Shape
    ) -> tuple[MotionState, bool]:
        """The same by the ``momenta`` (P, 2, 3) at the end, and by their integral ``moved`` (P, 2, 3) over the step."""
        x0, x1 = self.shaped(before.coordinates, shape), self.shaped(after.coordinates, shape)
        poses, speeds = self.poses(before.coordinates), self.poses(before.rates)
        spins, back, solved = self.spins(before.coordinates, before.rates), np.zeros((len(poses), 3)), True
        for number, part in enumerate(self.parts):
            y0, y1, pose, speed = x0[part.vertices], x1[part.vertices], poses[number], speeds[number]
            turn = turn_of(pose[1])
            pose[0] += moved[number, 0] / part.total
            speed[0] = momenta[number, 0] / part.total
            impulse = turn.T @ moved[number, 1]
            guess = np.linalg.solve(inertia_of(part.moments(y0, y0)), impulse)
            step, found = turn_keeping(part.moments(y0, y1), impulse, guess)
            if not found:
                step, solved = turn_of(guess), False
            turn = turn @ step
            pose[1] = vector_of(turn)
            spin = np.linalg.solve(inertia_of(part.moments(y1, y1)), turn.T @ momenta[number, 1])
            own = left_jacobian(-pose[1])
            speed[1] = np.linalg.solve(own, spin)
            turned = vector_of(step) / dt - 0.5 * (spins[number] + spin)
            back[number] = np.linalg.solve(own, turned)
        memory = after.memory | {"turn_back": back}
        q, rates = self.with_poses(after.coordinates, poses), self.with_poses(after.rates, speeds)
        return MotionState(q, rates, memory), solved

    def momenta(self, q: Array, rates: Array, shape: Shape) -> Array:
        """Momenta (P, 2, 3) of the parts, angular ones about their centres, in the world."""
        x, found = self.shaped(q, shape), self.poses(rates)
        for part, pose, spin, at in zip(self.parts, self.poses(q), self.spins(q, rates), found, strict=True):
            inertia = inertia_of(part.moments(x[part.vertices], x[part.vertices]))
            at[:] = part.total * at[0], turn_of(pose[1]) @ inertia @ spin
        return found

    def velocities(self, state: MotionState, lead: float, shape: Shape) -> Array:
        """Velocities (n, 3) [m/s]: those of the shape with its own angular momentum turned back, and of the frames."""
        q, rates = state.coordinates, state.rates
        own, found = self.shaped(q, shape), self._speeds(q, rates, lead, shape)
        spins, poses, speeds = self.spins(q, rates), self.poses(q), self.poses(rates)
        for part, spin, pose, speed in zip(self.parts, spins, poses, speeds, strict=True):
            turning = found[part.vertices] + crossed(spin, own[part.vertices])
            found[part.vertices] = turning @ turn_of(pose[1]).T + speed[0]
        return found

    def kinetic_energy(self, state: MotionState, shape: Shape) -> float:
        """Kinetic energy [J] of the frames' motion and of the elastic modes in them."""
        q, rates = state.coordinates, state.rates
        elastic, x = self.elastic(rates), self.shaped(q, shape)
        total = 0.5 * float(elastic @ elastic)
        for part, spin, speed in zip(self.parts, self.spins(q, rates), self.poses(rates), strict=True):
            inertia = inertia_of(part.moments(x[part.vertices], x[part.vertices]))
            total = total + 0.5 * part.total * float(speed[0] @ speed[0]) + 0.5 * float(spin @ inertia @ spin)
        return total

    def at_rest(self, state: MotionState) -> MotionState:
        """A state at rest with what the frames keep."""
        state.memory["turn_back"] = np.zeros((len(self.parts), 3))
        return state
