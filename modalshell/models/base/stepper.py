"""What takes the steps of one motion: brings a model the loads, moving supports and constraints of each step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Index
from modalshell.integrators.state import MotionState
from modalshell.loads.work import dead_work
from modalshell.models.base.setup import MotionSetup
from modalshell.shell import Shell
from modalshell.supports import Pose, SupportPath
from modalshell.supports.constraints import HeldPatch
from modalshell.supports.path import Side

Drag = tuple[Index, Array]
"""Vertices (k,), and minus the derivatives (k, 3, 3) [N s/m] of the forces there by their velocities."""
LEAD = 1e-3
"""Share of a step over which velocities are differences of positions."""


class Moving(Protocol):
    """What a stepper needs of the model that it moves; see :class:`modalshell.models.Model`."""

    shell: Shell

    def centred(self) -> tuple[Any, Array]:
        """The model to step, and where its origin lies (3,) [m]."""

    def no_constraints(self) -> OptionError:
        """The error of a model that takes no constraints."""

    def no_contacts(self) -> OptionError:
        """The error of a model that takes no contacts."""


class Stepper(ABC):
    """Takes the steps of one motion of a model: brings it the loads, moving supports and constraints of each step.

    ``patches`` are held vertices that are moved; with ``in_frame`` states are in the frame of the supports. The shell
    is that in the world, the model that about ``origin`` (3,) [m], where coordinates have the smallest rounding;
    ``residuals`` (k,) are what is left to each constraint's target, [m] or [rad].
    """

    takes_constraints: ClassVar[bool] = False
    takes_contacts: ClassVar[bool] = False
    """Whether it takes steps under constraints, and with contacts."""

    def __init__(
        self, model: Moving, setup: MotionSetup, patches: Sequence[HeldPatch] = (), *, in_frame: bool = False
    ) -> None:
        if setup.constraints and not self.takes_constraints:
            raise model.no_constraints()
        if setup.contacts and not self.takes_contacts:
            raise model.no_contacts()
        self.shell, self.setup = model.shell, setup
        self.model: Any
        self.model, self.origin = model.centred()
        self.residuals = np.zeros(len(setup.constraints))
        self._off_centre = bool(self.origin.any())
        path = setup.supports
        if path is not None and self._off_centre:
            path = path.about(self.origin)
        # Supports move the frame of the states, or held vertices in the world.
        self._frame: SupportPath | None = path if in_frame else None
        self._path: SupportPath | None = None if in_frame else path
        self._patches = patches
        self._lead = LEAD
        self._known: list[tuple[MotionState, Array]] = []

    def start(self, positions: Array | None) -> MotionState:
        """State at rest at ``positions`` (n, 3) [m] in the rest pose of the supports, where these are at time 0."""
        return self.model.start_motion(None if positions is None else positions - self.origin)

    def state_at(self, positions: Array, time: float) -> MotionState:
        """State at rest with every vertex at ``positions`` (n, 3) [m] in the world, as far as the model can."""
        own = positions - self.origin
        return self.model.start_motion(own if self._frame is None else self._frame.at(time).to_shell(own))

    def own_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the frame of the states; those of the last two are kept, as each serves twice."""
        for known, positions in self._known:
            if known is state:
                return positions
        positions = self.model.positions(state)
        self._known = [*self._known[-1:], (state, positions)]
        return positions

    def positions(self, state: MotionState, time: float) -> Array:
        """Positions (n, 3) [m] in the world."""
        return self.in_world(self.own_positions(state), time)

    def local_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the frame of the supports, which is the world's where these rest."""
        own = self.own_positions(state)
        return own + self.origin if self._off_centre else own

    def local_state_at(self, positions: Array, time: float) -> MotionState:
        """The state of :meth:`state_at` at ``positions`` (n, 3) [m] in the frame of the supports."""
        return self.state_at(positions if self._frame is None else self.in_world(positions - self.origin, time), time)

    def velocities(self, state: MotionState, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state in its frame, by where it was a short time ``lead`` [s] before."""
        return np.asarray(self.model.velocities(state, self.own_positions(state), lead))

    def outside(self, state: MotionState, time: float) -> MotionState:
        """A state that another motion's was put into at ``time`` [s], with what lies inside colliders put out."""
        return state

    def in_world(self, own: Array, time: float) -> Array:
        """Positions (n, 3) [m] in the world of ``own`` ones in the frame of the states."""
        if self._frame is not None:
            own = self._frame.at(time).to_world(own)
        return own + self.origin if self._off_centre else own

    def loaded_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the frame of the states on which loads do their work."""
        return self.own_positions(state)

    def load_work(self, load: Array, state: MotionState) -> float:
        """Work [J] of a dead load (n, 3) [N] from rest to a state."""
        return float(dead_work(load, self.loaded_positions(state), self.model.shell.rest_positions))

    def further_energy(self, state: MotionState) -> float:
        """Elastic energy [J] of a state in addition to the model's own."""
        return 0.0

    def touched(self, state: MotionState, time: float) -> TouchedFrame | None:
        """What touches in a state at ``time`` [s], with contacts."""
        return None

    def took_part(self, state: MotionState, time: float, dt: float, begin: float) -> None:  # noqa: B027
        """Take note of the end at ``time`` [s] of a part, ``dt`` [s] long, of the step that began at ``begin`` [s]."""

    def remark(self, state: MotionState, time: float) -> str:
        """Message about a state at ``time`` [s]; "" if there is none."""
        return str(self.model.remark(state))

    def model_at(self, time: float) -> Any:
        """The model with its supports where they are at ``time`` [s]."""
        return self.model

    @property
    def note(self) -> str:
        """What a message says of how steps are taken; "" if there is nothing to say."""
        return ""

    @abstractmethod
    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """The state a step of ``dt`` [s] after ``state``, that at the time ``begin`` [s].

        ``load`` (n, 3) [N] is the sum of the dead loads in the world. Also returns whether the model's own solver
        converged.
        """

    def load_in_frame(
        self, time: float, load: Array, state: MotionState, side: Side | None = None
    ) -> tuple[Array, Drag | None]:
        """Load (n, 3) [N] in the frame of the states at ``time`` [s], inertial ones with it, and how it falls.

        ``load`` (n, 3) [N] are the dead loads in the world, ``state`` is where the shell is then. How the load falls
        with velocities is None where it does not. ``side`` is that of a jump of the frame's acceleration, see
        :meth:`SupportPath.at <modalshell.SupportPath.at>`.
        """
        loading, pose = self.setup.loading, None if self._frame is None else self._frame.at(time, side)
        live = bool(loading.live)
        turns = pose is not None and bool(pose.turn_rate.any() or pose.turn_acceleration.any())
        if pose is None and not live:
            return load, None
        own = self.own_positions(state) if live or turns else self.model.shell.rest_positions
        rates, drag, lead = np.zeros_like(own), None, self._lead * self.setup.dt
        if turns or loading.by_velocity:
            rates = self.model.velocities(state, own, lead)
        if live:
            now = last = self.in_world(own, time)
            if loading.by_velocity:
                last = self.in_world(own - lead * rates, time - lead)
                vertices, slopes = loading.drag(now, (now - last) / lead, time)
                drag = vertices, slopes if pose is None else pose.rotation.T @ slopes @ pose.rotation
            load = loading.moving_force(load, now, last, 1.0 / lead if loading.by_velocity else 0.0, time)
        if pose is not None:
            load = pose.shell_load(load, self.model.shell.mass, own, rates)
        return load, drag

    def drag_along(self, path: SupportPath, time: float, positions: Array) -> Array:
        """Force (n, 3) [N] of the damping by the mass on a shell in the world that moves with its supports.

        Such damping slows velocities relative to the supports, ``xi M (v - v_s)``, v_s being that of a body which moves
        along with these.
        """
        damping, lead = self.setup.damping, LEAD * self.setup.dt
        if damping.mass_factor == 0.0:
            return np.zeros_like(positions)
        moved = positions - path.at(time - lead).to_world(path.at(time).to_shell(positions))
        return np.asarray(damping.mass_factor / lead * self.model.shell.mass[:, None] * moved)

    def _held_positions(self, time: float, pose: Pose | None) -> Array | None:
        """Where the held vertices are at ``time``, in their order; None where they rest."""
        shell, moved = self.model.shell, pose is not None and self._frame is None
        if not self._patches and not moved:
            return None
        placed = pose.to_world(shell.rest_positions) if pose is not None and moved else shell.rest_positions.copy()
        for patch in self._patches:
            target = patch.at(time) - self.origin
            placed[patch.vertices] = target if pose is None or moved else pose.to_shell(target)
        return placed[shell.clamped]


class ContactStepper(Stepper):
    """Steps with contacts, which may press vertices in beyond what the model's own coordinates give.

    What takes them is asked to ``begin`` a motion, to ``clear`` a state of contact forces, to put out of the colliders
    one that has ``entered`` from another motion, what touches in a ``frame``, and for its ``touching``, ``energy`` [J]
    beyond the model's own and ``note``; where it ``presses``, also for the ``local`` displacements (n, 3) [m].
    """

    takes_contacts = True
    _given: tuple[float, Array | float] = -np.inf, 0.0
    """When the last step began that was taken in parts [s], and the impulses (n, 3) [N s] of the colliders in it."""

    def __init__(
        self, model: Moving, setup: MotionSetup, patches: Sequence[HeldPatch] = (), *, in_frame: bool = False
    ) -> None:
        super().__init__(model, setup, patches, in_frame=in_frame)
        self._contacts: Any = self._moving_contacts() if setup.contacts else None
        self._presses = self._contacts is not None and self._contacts.presses

    @abstractmethod
    def _moving_contacts(self) -> Any:
        """What takes the steps with contacts; OptionError where the model cannot take these."""

    def start(self, positions: Array | None) -> MotionState:
        """State at rest at ``positions`` (n, 3) [m], as near as the model comes, refused inside a collider."""
        state = self._at_rest(positions)
        if self._contacts is None:
            return state
        own = self.model.shell.rest_positions if positions is None else positions - self.origin
        return self._contacts.begin(state, own)

    def _at_rest(self, positions: Array | None) -> MotionState:
        """The same without contacts."""
        return super().start(positions)

    def state_at(self, positions: Array, time: float) -> MotionState:
        """State at rest with every vertex at ``positions`` (n, 3) [m] in the world, as far as the model can."""
        state = super().state_at(positions, time)
        return state if self._contacts is None else self._contacts.clear(state)

    def outside(self, state: MotionState, time: float) -> MotionState:
        """A state that another motion's was put into at ``time`` [s], out of the colliders."""
        return state if self._contacts is None else self._contacts.entered(state, time)

    def own_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the frame of the states, with what contacts press in."""
        own = super().own_positions(state)
        return own + self._contacts.local(state) if self._presses else own

    def loaded_positions(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the frame of the states, without what contacts press in."""
        return super().own_positions(state)

    def velocities(self, state: MotionState, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state, without those of what contacts press in."""
        return np.asarray(self.model.velocities(state, self.loaded_positions(state), lead))

    def further_energy(self, state: MotionState) -> float:
        """Elastic energy [J] of what contacts press in, and of the barrier of self-contact."""
        return 0.0 if self._contacts is None else float(self._contacts.energy(state))

    @property
    def note(self) -> str:
        """What a message says of the contacts' friction."""
        return "" if self._contacts is None else str(self._contacts.note)

    def remark(self, state: MotionState, time: float) -> str:
        """Message about a state at ``time`` [s]: of the model, or that vertices are led into a collider."""
        remark, moved = super().remark(state, time), self._path or self._frame
        if remark or self._contacts is None or not (self._patches or moved):
            return remark
        held = np.flatnonzero(self.shell.clamped) if moved else np.empty(0, dtype=np.int64)
        led = np.concatenate([held, *(patch.vertices for patch in self._patches)])
        inside = self._contacts.touching.at(time).inside(self.own_positions(state), led)
        who = "constraints" if self._patches else "supports"
        return f"{who} lead vertices into contact {inside[0]}, which does not push on these" if inside else ""

    def touched(self, state: MotionState, time: float) -> TouchedFrame | None:
        """What touches in a state at ``time`` [s], with contacts."""
        found = self._touched_last(state, time)
        begin, given = self._given
        if found is None or not begin < time <= begin + 1.5 * self.setup.dt:
            return found
        return found._replace(forces=np.asarray(given / self.setup.dt))

    def took_part(self, state: MotionState, time: float, dt: float, begin: float) -> None:
        """Take note of the impulses of a part of a step; see :meth:`Stepper.took_part`."""
        found, (known, given) = self._touched_last(state, time) if self._presses else None, self._given
        if found is not None:  # else the frame's forces are those of all parts already
            self._given = begin, (given if known == begin else 0.0) + dt * found.forces

    def _touched_last(self, state: MotionState, time: float) -> TouchedFrame | None:
        """What touches in a state at ``time`` [s], with forces of the last part of its step."""
        if self._contacts is None:
            return None
        found = self._contacts.frame(state, self.own_positions(state), time)
        return found if self._frame is None else found._replace(forces=found.forces @ self._frame.at(time).rotation.T)


@final
class DeadLoadStepper(Stepper):
    """Steps under loads at the time of the middle of each, where the shell is at its beginning; without constraints."""

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the model."""
        damping, time = self.setup.damping, begin + dt
        when, pose = begin + 0.5 * dt, None
        load, drag = self.load_in_frame(when, load, state)
        if self._path is not None:
            pose, load = self._path.at(time), load + self.drag_along(self._path, when, self.own_positions(state))
        after, solved = self.model.step(state, dt, load, damping, self._held_positions(time, pose))
        return (after if drag is None else self.model.dragged(after, state, dt, damping, *drag)), solved
