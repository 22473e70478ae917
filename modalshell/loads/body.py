"""Body loads: weight, and inertial forces of a moving frame (theory 16, eq. 4)."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.checks import checked_vectors
from modalshell.core.errors import LoadError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only_copy
from modalshell.core.typing import Array, Index, Vector
from modalshell.loads.applied import AppliedLoad, BodyForm, Corners
from modalshell.loads.base import LiveLoad
from modalshell.mesh import TriangleMesh


class _MassLoad(LiveLoad, ReadOnlyArrays):
    """A load in proportion to the masses of the vertices."""

    def force(self, mesh: TriangleMesh) -> Array:  # noqa: ARG002
        """LoadError: a mesh alone has no mass."""
        raise LoadError(
            f"{type(self).__name__} needs the masses of a shell, which a mesh has not: pass it as loads= to "
            "equilibrium, simulate or shell.total_load"
        )


@final
class SelfWeight(_MassLoad, key="weight"):
    """The shell's own weight, as by ``gravity=``; with :class:`Scaled` it may change in time.

    Parameters
    ----------
    gravity : (float, float, float)
        Acceleration [m/s^2].

    Raises
    ------
    LoadError
        If ``gravity`` is not three finite numbers.
    """

    def __init__(self, gravity: Vector = (0.0, 0.0, -9.81)) -> None:
        self.gravity = read_only_copy(checked_vectors("gravity", gravity, (3,)))

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad:
        """The weight of every vertex."""
        return constant_load(mesh, mass[:, None] * self.gravity)


@final
class FrameInertia(_MassLoad, key="frame"):
    """Inertial forces in an accelerating and rotating frame; the shell's positions are those in the frame.

    ``f = -m (a + alpha x r + omega x (omega x r) + 2 omega x v)`` with r from the frame's origin: its acceleration,
    Euler, centrifugal and Coriolis forces. It has a potential unless ``angular_acceleration`` is other than zero.

    Parameters
    ----------
    acceleration : (float, float, float)
        Of the frame's origin [m/s^2].
    angular_velocity, angular_acceleration : (float, float, float)
        Of the frame [rad/s], [rad/s^2].
    origin : (float, float, float)
        The frame's origin [m].

    Raises
    ------
    LoadError
        If one of them is not three finite numbers.
    """

    def __init__(
        self,
        acceleration: Vector = (0.0, 0.0, 0.0),
        angular_velocity: Vector = (0.0, 0.0, 0.0),
        angular_acceleration: Vector = (0.0, 0.0, 0.0),
        origin: Vector = (0.0, 0.0, 0.0),
    ) -> None:
        self.acceleration = read_only_copy(checked_vectors("acceleration", acceleration, (3,)))
        self.angular_velocity = read_only_copy(checked_vectors("angular_velocity", angular_velocity, (3,)))
        self.angular_acceleration = read_only_copy(checked_vectors("angular_acceleration", angular_acceleration, (3,)))
        self.origin = read_only_copy(checked_vectors("origin", origin, (3,)))

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad:
        """The inertial forces of every vertex."""
        turn, speeding, origin = self.angular_velocity, self.angular_acceleration, self.origin
        if not (turn.any() or speeding.any()):
            return constant_load(mesh, mass[:, None] * -self.acceleration)

        def forces(corners: Corners, velocities: Corners, time: float, chosen: Index) -> Corners:  # noqa: ARG001
            arm = corners - origin
            felt = self.acceleration + np.cross(speeding, arm)
            felt = felt + np.cross(turn, np.cross(turn, arm) + 2.0 * velocities)
            return -mass[chosen][:, None, None] * felt

        def energy(x: Array) -> float:
            arm = x - origin
            centrifugal = 0.5 * np.sum(np.cross(turn, arm) ** 2, axis=1)
            return float(mass @ (arm @ self.acceleration - centrifugal))

        vertices = np.arange(len(mass), dtype=np.int64)[:, None]
        conservative = None if speeding.any() else energy
        spin, speed = (np.cross(vector, np.eye(3)).T for vector in (turn, speeding))  # w x r = [w] r
        by_position = speed + spin @ spin
        form = BodyForm(mass, by_position @ origin - self.acceleration, by_position, 2.0 * spin)
        return AppliedLoad(vertices, forces, conservative, by_velocity=bool(turn.any()), form=form)


def constant_load(mesh: TriangleMesh, force: Array) -> AppliedLoad:
    """Forces (n, 3) [N] that do not change."""
    vertices = np.flatnonzero(force.any(axis=1))
    acting, rest = force[vertices, None], mesh.vertices

    def forces(corners: Corners, velocities: Corners, time: float, chosen: Index) -> Corners:  # noqa: ARG001
        return acting[chosen].astype(corners.dtype)

    return AppliedLoad(
        vertices[:, None], forces, lambda x: -float(np.vdot(force, x - rest)), by_position=False, constant=force
    )
