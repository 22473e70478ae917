"""Rigid model: a shell without deformation, which rests on its supports or moves as a rigid body."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array, Index
from modalshell.integrators.free_parts import inertia_of, turn_keeping
from modalshell.integrators.modal.flow import free_flow
from modalshell.integrators.state import MotionState
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import FrameModel
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import Drag, Stepper
from modalshell.modes.modal_rotation import cross_matrices
from modalshell.modes.rigid import left_free, rigid_motions, rigid_share
from modalshell.shell import Shell
from modalshell.shell.damping import Damping

LoadAt = Callable[[MotionState, float], tuple[Array, Drag | None]]
"""The load (n, 3) [N] on a state at a share of the step, and how it falls with velocities."""


@final
class RigidShell(FrameModel):
    """A shell without deformation, the cheapest rung: its displacement is that of its supports, or of a rigid body.

    Held, it rests (moving supports carry it along exactly). Free, coordinates are the displacement of the centre of
    mass [m] and the rotation vector from rest [rad], rates the velocity [m/s] and the angular velocity in the world's
    frame [rad/s]. Both momenta follow the exact flow under a force and a torque that change linearly over a step, by
    their values at its beginning, kept from the step before, and at its expected end. The body turns by Euler's
    equations in the discrete form of Moser and Veselov, which conserves angular momentum to rounding [moser1991]: order
    two. About a principal axis these have an answer while a step turns the body by less than one radian; longer steps
    are not converged. A free shell has no equilibrium under a net force or torque: ``residual`` is their share of the
    load.

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
        self._inertia = inertia_of(self._moments)

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
        return MotionState(z, np.zeros_like(z), {"wrench": np.zeros_like(z), "known": np.zeros(1)})

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion; see :meth:`Model.stepper`."""
        return RigidStepper(self, setup.averaged, in_frame=True)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step; ``mass_factor`` slows both velocities, and there is no strain for the other factor."""
        return self.march(state, dt, lambda *_: (load, None), damping)

    def march(self, state: MotionState, dt: float, load_at: LoadAt, damping: Damping) -> tuple[MotionState, bool]:
        """One step, under the loads at its beginning and its expected end."""
        if not self._free:
            return state, True
        z, rates, c = state.coordinates, state.rates, free_flow(damping.mass_factor, dt)
        turn = Rotation.from_rotvec(z[3:])
        memory = state.memory
        known = "known" in memory and bool(memory["known"][0])
        first = memory["wrench"] if known else self._wrench(state, load_at(state, 0.0)[0])
        faster = np.linalg.solve(self._inertias(turn), first)
        change = dt * (rates + 0.5 * dt * faster)
        ahead = np.concatenate([z[:3] + change[:3], (Rotation.from_rotvec(change[3:]) * turn).as_rotvec()])
        expected = MotionState(ahead, np.asarray(rates + dt * faster))
        load, drag = load_at(expected, 1.0)
        last = self._wrench(expected, load)
        momenta = self._inertias(turn) @ rates
        end = c.e22 * momenta + c.b1 * first + c.b2 * (last - first)
        if drag is not None:
            # The force at the end falls with what the velocities there are above those expected.
            fall = self._drag(ahead, *drag)
            inertia = self._inertias(turn)
            missed = np.linalg.solve(inertia + c.b2 * fall, end - inertia @ expected.rates)
            last = last - fall @ missed
            end = end - c.b2 * (fall @ missed)
        moved = c.e12 * momenta + c.a1 * first + c.a2 * (last - first)
        impulse = turn.inv().apply(moved[3:])
        guess = np.asarray(np.linalg.solve(self._inertia, impulse), dtype=np.float64)
        step, found = turn_keeping(self._moments, impulse, guess)
        # Beyond about a radian a step there is no answer (about a principal axis the momentum is that of sin c): the
        # turn then is that of the angular velocity, and the step is not converged.
        after = turn * (Rotation.from_matrix(step) if found else Rotation.from_rotvec(guess))
        coordinates = np.concatenate([z[:3] + moved[:3] / self._mass, after.as_rotvec()])
        kept = {"wrench": last, "known": np.ones(1)}
        rates = np.asarray(np.linalg.solve(self._inertias(after), end), dtype=np.float64)
        return MotionState(coordinates, rates, kept), found

    def _inertias(self, turn: Rotation) -> Array:
        """Mass and inertia (6, 6) of the turned body, in the world's frame."""
        attitude, whole = turn.as_matrix(), self._mass * np.eye(6)
        whole[3:, 3:] = attitude @ self._inertia @ attitude.T
        return whole

    def _wrench(self, state: MotionState, load: Array) -> Array:
        """Force and torque about the centre (6,) of a load (n, 3) [N]."""
        arms = Rotation.from_rotvec(state.coordinates[3:]).apply(self._arms)
        return np.concatenate([load.sum(axis=0), np.cross(arms, load).sum(axis=0)])

    def _drag(self, z: Array, vertices: Index, drag: Array) -> Array:
        """How force and torque fall with velocity and spin (6, 6)."""
        arms = Rotation.from_rotvec(z[3:]).apply(self._arms[vertices])
        rows = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -cross_matrices(arms)], axis=2)
        return np.asarray(np.tensordot(rows, drag @ rows, ((0, 1), (0, 1))))

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state."""
        if not self._free:
            return self.shell.rest_positions.copy()
        z = state.coordinates
        return np.ascontiguousarray(Rotation.from_rotvec(z[3:]).apply(self._arms) + self._centre + z[:3])

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of the body's motion and spin."""
        if not self._free:
            return np.zeros_like(self._arms)
        arms = Rotation.from_rotvec(state.coordinates[3:]).apply(self._arms)
        return np.asarray(state.rates[:3] + np.cross(state.rates[3:], arms))

    def squared(self, vector: Array) -> float:
        """Square [kg m^2] of a displacement and a rotation (6,), in the norm of the mass."""
        if not self._free:
            return 0.0
        return float(self._mass * vector[:3] @ vector[:3] + vector[3:] @ self._inertia @ vector[3:])

    def largest_move(self, change: Array) -> float:
        """Largest displacement [m] of a vertex by a small displacement and rotation (6,), at most."""
        if not self._free:
            return 0.0
        reach = np.linalg.norm(self._arms, axis=1).max()
        return float(np.linalg.norm(change[:3]) + reach * np.linalg.norm(change[3:]))

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


@final
class RigidStepper(Stepper):
    """Steps under loads as they are where the body is expected, without constraints."""

    model: RigidShell

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the body."""

        def load_at(at: MotionState, share: float) -> tuple[Array, Drag | None]:
            return self.load_in_frame(begin + share * dt, load, at)

        return self.model.march(state, dt, load_at, self.setup.damping)
