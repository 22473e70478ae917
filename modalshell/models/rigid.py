"""Rigid model: a shell without deformation, which rests on its supports or moves as a rigid body."""

from __future__ import annotations

from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array, Index
from modalshell.integrators.state import Damping, MotionState
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import FrameModel
from modalshell.modes.modal_rotation import cross_matrices
from modalshell.modes.rigid import left_free, rigid_motions, rigid_share
from modalshell.shell import Shell

_TOLERANCE = 1e-13
"""Relative tolerance of the angular momentum after a step."""
_NEWTON_LIMIT = 30
"""Largest number of Newton iterations per step."""


@final
class RigidShell(FrameModel):
    """A shell without deformation, the cheapest rung: its displacement is that of its supports, or of a rigid body.

    Held, it rests (moving supports carry it along exactly). Free, coordinates are the displacement of the centre of
    mass [m] and the rotation vector from rest [rad], rates the velocity [m/s] and the angular velocity in the world's
    frame [rad/s]; a step takes the velocity's change first (symplectic Euler) and solves Euler's equations in the
    discrete form of Moser and Veselov, which conserves angular momentum to rounding [moser1991]. About a principal axis
    these have an answer while a step turns the body by less than one radian; longer steps are not converged. A free
    shell has no equilibrium under a net force or torque: ``residual`` is their share of the load.

    Parameters
    ----------
    shell : Shell
        A shell in one piece that its supports hold entirely, or that has none.

    Raises
    ------
    OptionError
        If the supports leave only some rigid motions free, or the shell is in several loose pieces.
    """

    name = "rigid"

    def __init__(self, shell: Shell) -> None:
        self.shell = checked_kind("shell", shell, Shell)
        loose = rigid_motions(shell).shape[1]
        self._free = loose == 6 and not shell.unknowns.supported.any()
        if loose and not self._free:
            raise OptionError(
                f"a rigid shell must be in one piece and held entirely or not at all, but {left_free(shell)}: clamp "
                "more vertices, or none"
            )
        self._mass = float(shell.mass.sum())
        self._centre = np.asarray(shell.mass @ shell.rest_positions / self._mass)
        self._arms = shell.rest_positions - self._centre
        self._moments = self._arms.T @ (shell.mass[:, None] * self._arms)
        """Second moments J = ``sum m r r^T`` [kg m^2] about the centre of mass at rest."""
        self._inertia = np.trace(self._moments) * np.eye(3) - self._moments

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        """Rest, the only answer."""
        stable = None if self._free else True
        return Equilibrium(
            self.shell.rest_positions.copy(), Outcome.CONVERGED, "", 0, 0.0, stable, coordinates=self._rest()
        )

    def rigid_load(self, load: Array) -> float:
        """Share of the load that moves a free shell as a rigid body."""
        return rigid_share(self.shell, load) if self._free and load.any() else 0.0

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest, the rotation fitted to ``positions`` (n, 3) in the norm of the mass [kabsch1976]."""
        z = self._rest()
        positions = None if positions is None else self.shell.checked_positions(positions)
        if positions is not None and self._free:
            centre = self.shell.mass @ positions / self._mass
            turn, _ = Rotation.align_vectors(positions - centre, self._arms, self.shell.mass)
            z = np.concatenate([centre - self._centre, turn.as_rotvec()])
        return MotionState(z, np.zeros_like(z))

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step; ``mass_factor`` slows both velocities, implicitly, and there is no strain for the other factor."""
        if not self._free:
            return state, True
        slowed = 1.0 / (1.0 + dt * damping.mass_factor)
        z, rates = state.coordinates, state.rates
        turn = Rotation.from_rotvec(z[3:])
        attitude = turn.as_matrix()
        velocity = slowed * (rates[:3] + dt * load.sum(axis=0) / self._mass)
        torque = np.cross(self._arms @ attitude.T, load).sum(axis=0)
        momentum = slowed * (attitude @ self._inertia @ attitude.T @ rates[3:] + dt * torque)
        increment, converged = self._increment(dt * attitude.T @ momentum, dt * attitude.T @ rates[3:])
        after = turn * Rotation.from_rotvec(increment)
        # The momentum is what is conserved: the angular velocity follows from it and the new attitude.
        new = after.as_matrix()
        spin = new @ np.linalg.solve(self._inertia, new.T @ momentum)
        coordinates = np.concatenate([z[:3] + dt * velocity, after.as_rotvec()])
        return MotionState(coordinates, np.concatenate([velocity, spin])), converged

    def dragged(
        self, state: MotionState, before: MotionState, dt: float, damping: Damping, vertices: Index, drag: Array
    ) -> MotionState:
        """The fall of force and torque with the velocity and the spin, taken at the step's end."""
        if not self._free:
            return state
        z = state.coordinates
        turn = Rotation.from_rotvec(z[3:])
        arms = turn.apply(self._arms[vertices])
        rows = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -cross_matrices(arms)], axis=2)
        attitude = turn.as_matrix()
        inertia = np.zeros((6, 6))
        inertia[:3, :3], inertia[3:, 3:] = self._mass * np.eye(3), attitude @ self._inertia @ attitude.T
        inertia *= 1.0 + dt * damping.mass_factor
        whole = inertia + dt * np.tensordot(rows, drag @ rows, ((0, 1), (0, 1)))
        rates = before.rates + np.linalg.solve(whole, inertia @ (state.rates - before.rates))
        fall = rates - state.rates
        turned = Rotation.from_rotvec(dt * fall[3:]) * turn
        return MotionState(np.concatenate([z[:3] + dt * fall[:3], turned.as_rotvec()]), rates)

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state."""
        if not self._free:
            return self.shell.rest_positions.copy()
        z = state.coordinates
        return Rotation.from_rotvec(z[3:]).apply(self._arms) + self._centre + z[:3]

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of the body's motion and spin."""
        if not self._free:
            return np.zeros_like(self._arms)
        arms = Rotation.from_rotvec(state.coordinates[3:]).apply(self._arms)
        return np.asarray(state.rates[:3] + np.cross(state.rates[3:], arms))

    def angular_momentum(self, state: MotionState) -> Array:
        """Angular momentum (3,) about the centre of mass [kg m^2/s], in the world's frame."""
        if not self._free:
            return np.zeros(3)
        attitude = Rotation.from_rotvec(state.coordinates[3:]).as_matrix()
        return attitude @ self._inertia @ attitude.T @ state.rates[3:]

    def elastic_energy(self, state: MotionState) -> float:
        """Zero: it does not deform."""
        return 0.0

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of its motion and spin."""
        if not self._free:
            return 0.0
        velocity, spin = state.rates[:3], state.rates[3:]
        return float(0.5 * self._mass * velocity @ velocity + 0.5 * spin @ self.angular_momentum(state))

    def _rest(self) -> Array:
        return np.zeros(6 if self._free else 0)

    def _increment(self, impulse: Array, guess: Array) -> tuple[Array, bool]:
        """Rotation c (3,) [rad] of a step, in the body frame, whose discrete momentum is ``impulse``; by Newton."""
        inertia, moments = self._inertia, self._moments
        c = guess
        size = float(np.linalg.norm(impulse))
        for _ in range(_NEWTON_LIMIT):
            momentum, slope = _discrete_momentum(c, inertia, moments)
            if np.linalg.norm(momentum - impulse) <= _TOLERANCE * size:
                return c, True
            try:
                c = c - np.linalg.solve(slope, momentum - impulse)
            except np.linalg.LinAlgError:
                break
        residual = np.linalg.norm(_discrete_momentum(c, inertia, moments)[0] - impulse)
        # Beyond about a radian a step there is no answer (about a principal axis the momentum is that of sin c): the
        # turn then is that of the angular velocity, and the step is not converged.
        return (c, True) if residual <= 1e-9 * size else (guess, False)


def _discrete_momentum(c: Array, inertia: Array, moments: Array) -> tuple[Array, Array]:
    """Axial vector of ``F J - J F^T`` with ``F = exp[c]``, and its derivative by c (3, 3) [moser1991].

    ``F = I + a [c] + b [c]^2`` makes it ``a (tr(J) I - J) c - b c x J c``.
    """
    squared = float(c @ c)
    angle = np.sqrt(squared)
    if angle < 1e-3:
        a, b, da, db = 1.0 - squared / 6.0, 0.5 - squared / 24.0, -1.0 / 3.0, -1.0 / 12.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
        da, db = (np.cos(angle) - a) / squared, (a - 2.0 * b) / squared
    spun, twisted = inertia @ c, np.cross(c, moments @ c)
    slope = a * inertia + np.outer(da * spun - db * twisted, c)
    slope -= b * (cross_matrices(c) @ moments - cross_matrices(moments @ c))
    return np.asarray(a * spun - b * twisted), np.asarray(slope)
