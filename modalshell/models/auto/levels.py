"""Levels of the model that switches itself: models that take over a motion from one another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.free_parts import (
    FittedFrames,
    FreeParts,
    axial,
    crossed,
    inertia_of,
    left_jacobian,
    turn_of,
    vector_of,
)
from modalshell.integrators.state import MotionState
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.base.modal import ModalModel
from modalshell.models.base.model import Model
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import LEAD, Stepper
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.modes import Basis
from modalshell.shell.damping import Damping

_FITS = 12
"""Gauss-Newton steps of a fit."""


class Level(ABC):
    """A model, and states of it made of the positions and velocities of every vertex in the frame of the supports."""

    model: Model
    name: str
    quadratic: ClassVar[bool] = False
    """Whether its elastic energy is quadratic about rest, so that it knows no snap."""

    def check_step(self, dt: float, damping: Damping) -> None:
        """Raise OptionError if the model cannot step by ``dt``, or with this ``damping``."""
        self.model.check_step(dt, damping)

    @property
    def still(self) -> Model:
        """The model of shapes at rest, those of free parts in their frames."""
        return self.model

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion."""
        return self.model.stepper(setup)

    @abstractmethod
    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State at positions x (n, 3) [m] with velocities v (n, 3) [m/s], as near as the model comes."""

    def left(self, stepper: Stepper, state: MotionState, dt: float) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and velocities (n, 3) [m/s] of a state."""
        return stepper.local_positions(state), self.velocities(stepper, state, dt)

    def velocities(self, stepper: Stepper, state: MotionState, dt: float) -> Array:
        """Velocities (n, 3) [m/s] of a state after a step of ``dt`` [s]."""
        return np.array(stepper.velocities(state, LEAD * dt))

    def packed(self, template: MotionState, state: MotionState, room: int) -> Array:
        """All numbers of a state like a ``template`` in one array, filled up with zeros to ``room``."""
        arrays, numbers = state.arrays(), np.zeros(room)
        parts = [arrays[name].ravel() for name in template.arrays()]
        np.concatenate(parts, out=numbers[: sum(part.size for part in parts)])
        return numbers

    def unpacked(self, template: MotionState, numbers: Array) -> MotionState:
        """The state of :meth:`packed`, like a ``template``; more numbers may follow."""
        arrays, place = {}, 0
        for name, part in template.arrays().items():
            arrays[name] = numbers[place : place + part.size].reshape(part.shape).copy()
            place += part.size
        return template.with_arrays(arrays)


@final
class FullLevel(Level):
    """DS: positions and velocities are its own.

    Steps of a small shell are compiled: those of coarse DS on the shell's own mesh, by the rule of DS and to its
    tolerance. They take loads as they are expected at the end of a step, which those are that depend on time alone,
    and no contacts.
    """

    model: DiscreteShell

    def __init__(self, model: DiscreteShell) -> None:
        self.model, self.name = model, model.name

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion."""
        plain = not (setup.contacts or setup.constraints)
        by_time = plain and all(load.constant is not None for load in setup.loading.live)
        if by_time and self._compiled is not None:
            return self._compiled.stepper(setup)
        return self.model.stepper(setup, in_frame=True)

    @cached_property
    def _compiled(self) -> CoarseDiscreteShell | None:
        """The model with compiled steps, whose states are those of DS; None where none serve the shell."""
        model = self.model
        if model.free_parts is not None:
            return None
        compiled = CoarseDiscreteShell(
            model.shell, model.shell, step_tolerance=model.step_tolerance, integrator=model.integrator
        )
        return compiled if compiled.is_compiled else None

    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State with these velocities, as if its first step were to come."""
        state = stepper.local_state_at(x, time)
        rates = self.model.shell.unknowns.project(v)
        rates[self.model.shell.clamped] = 0.0
        return stepper.outside(MotionState(state.coordinates, rates, state.memory), time)


@final
class CoarseLevel(Level):
    """Coarse DS: the fine surface is sampled at the coarse vertices."""

    model: CoarseDiscreteShell

    def __init__(self, model: CoarseDiscreteShell) -> None:
        self.model, self.name = model, model.name

    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State with the sampled velocities."""
        state, coarse = stepper.local_state_at(x, time), stepper.model
        moved = coarse.sampled(coarse.shell.rest_positions + v) - coarse.coarse.shell.rest_positions
        moved[coarse.coarse.shell.clamped] = 0.0
        return MotionState(state.coordinates, moved, state.memory)


@final
class ModalLevel(Level):
    """A modal model: coordinates are fitted to the positions, rates to the velocities, in the norm of the mass.

    ``make`` makes the model of its modes, at first use.
    """

    quadratic = True

    def __init__(self, basis: Basis, make: Callable[[Basis], ModalModel], name: str) -> None:
        self._basis, self._make, self.name = basis, make, name
        self._every = np.arange(len(basis.shell.mass))

    @cached_property
    def model(self) -> ModalModel:  # type: ignore[override]
        """The model, made where it is wanted: of most motions the first one alone is."""
        return self._make(self._basis)

    @cached_property
    def still(self) -> ModalModel:
        """The model itself, with free parts that without rigid modes."""
        if self.model.frames is None:
            return self.model
        basis, r = self._basis, self._basis.rigid_modes
        parts = {name: getattr(basis, name)[..., r:] for name in ("eigenvalues", "modes", "rotations")}
        return self.model.on_basis(replace(basis, rigid_modes=0, **parts))

    def check_step(self, dt: float, damping: Damping) -> None:
        """Raise OptionError if modes cannot step with a damping."""
        damping.of_modes(self._basis.eigenvalues)

    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State whose shape is the nearest to x, by Gauss-Newton from the projection of the displacement."""
        modal, own = stepper.model, x - stepper.origin
        if modal.frames is not None:
            return self._flown(modal, modal.frames, own, v)
        q, root = modal.nearest(own), np.sqrt(modal.shell.mass)[:, None]
        rows = (root[:, :, None] * modal.warped_rows(q, self._every)).reshape(-1, q.size)
        rates = np.linalg.lstsq(rows, (root * v).ravel(), rcond=None)[0]
        state = modal.integrator.at_rest(q)
        return stepper.outside(MotionState(q, rates, state.memory), time)

    def resting_load(self, stepper: Stepper, state: MotionState) -> Array:
        """Load (n, 3) [N] under which a state without free parts rests: nearly the least, in accelerations it gives."""
        modal, root, q = stepper.model, np.sqrt(self.model.shell.mass)[:, None], state.coordinates
        rows = (root[:, :, None] * modal.warped_rows(q, self._every)).reshape(-1, q.size)
        lift, load = np.linalg.pinv(rows.T), np.zeros((len(root), 3))
        for _ in range(_FITS):  # rows are rotated modes, nearly the derivatives that forces take
            missing = modal.basis.eigenvalues * q - modal.modal_force(q, load)
            load = load + root * (lift @ missing).reshape(-1, 3)
        return np.asarray(load)

    def _flown(self, modal: ModalModel, frames: FreeFrames, x: Array, v: Array) -> MotionState:
        """The same in frames, which move with the shape: centres and momenta are those of x and v."""
        rest, mass, still = modal.shell.rest_positions, modal.shell.mass[:, None], self.still
        own, flow, turns, momenta = x.copy(), v.copy(), [], np.empty((len(frames.parts), 2, 3))
        fitted = FittedFrames(rest, FreeParts(frames.parts))
        for part, centre, momentum in zip(frames.parts, frames.centres, momenta, strict=True):
            arms, drift = x[part.vertices] - part.mean(x[part.vertices]), part.mean(v[part.vertices])
            turn = fitted.turn(part, x)
            own[part.vertices], flow[part.vertices] = arms @ turn + centre, v[part.vertices] - drift
            momentum[:] = part.total * drift, axial(part.moments(arms, flow[part.vertices]))
            turns.append(turn)
        q = still.basis.modes.T @ np.ravel(mass * (own - rest))
        for _ in range(_FITS):
            change = self._nearest(frames, q, own - rest - still.raw_displacement(q))
            q = q + change[: q.size]
            for number, (part, (moved, turned)) in enumerate(
                zip(frames.parts, change[q.size :].reshape(-1, 2, 3), strict=True)
            ):
                arms, further = own[part.vertices], turn_of(turned)
                mean = part.mean(arms)
                own[part.vertices] = (arms - mean) @ further + (mean - moved)
                turns[number] = turns[number] @ further
        for part, turn in zip(frames.parts, turns, strict=True):
            flow[part.vertices] = flow[part.vertices] @ turn
        rates = self._nearest(frames, q, flow)[: q.size]
        poses, speeds = np.empty((2, len(frames.parts), 2, 3))
        bent = rest + still.raw_displacement(q)
        for part, centre, turn, momentum, pose, speed in zip(
            frames.parts, frames.centres, turns, momenta, poses, speeds, strict=True
        ):
            arms = bent[part.vertices] - part.mean(bent[part.vertices])
            pose[:] = part.mean(x[part.vertices]) - centre, vector_of(turn)
            spin = np.linalg.solve(inertia_of(part.moments(arms, arms)), turn.T @ momentum[1])
            speed[:] = momentum[0] / part.total, np.linalg.solve(left_jacobian(-pose[1]), spin)
        still_frames = np.zeros(frames.count)
        place = frames.with_poses(np.concatenate([still_frames, q]), poses)
        state = frames.at_rest(modal.integrator.at_rest(place))
        return MotionState(place, frames.with_poses(np.concatenate([still_frames, rates]), speeds), state.memory)

    def _nearest(self, frames: FreeFrames, q: Array, moved: Array) -> Array:
        """Changes of q (m,), then displacements and turns (P, 2, 3) of the frames, nearest to displacements (n, 3)."""
        shell, still = self.model.shell, self.still
        rows = np.zeros((*moved.shape, q.size + 6 * len(frames.parts)))
        rows[:, :, : q.size] = still.warped_rows(q, self._every)
        bent = shell.rest_positions + still.raw_displacement(q)
        for number, part in enumerate(frames.parts):
            arms, first = bent[part.vertices] - part.mean(bent[part.vertices]), q.size + 6 * number
            for axis, unit in enumerate(np.eye(3)):
                rows[part.vertices, axis, first + axis] = 1.0
                rows[part.vertices, :, first + 3 + axis] = crossed(unit, arms)
        root = np.sqrt(shell.mass)[:, None]
        weighted = (root[:, :, None] * rows).reshape(-1, rows.shape[2])
        return np.asarray(np.linalg.lstsq(weighted, (root * moved).ravel(), rcond=None)[0])
