"""Levels of the model that switches itself: models that take over a motion from one another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.state import MotionState
from modalshell.models.base.modal import ModalModel
from modalshell.models.base.model import Model
from modalshell.models.base.stepper import LEAD, Stepper
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.discrete_shell import DiscreteShell

_FITS = 12
"""Gauss-Newton steps of a fit."""


class Level(ABC):
    """A model, and states of it made of the positions and velocities of every vertex.

    Attributes
    ----------
    model : Model
        The model.
    quadratic : bool
        Whether its elastic energy is quadratic about rest, so that it knows no snap.
    """

    model: Model
    quadratic: ClassVar[bool] = False

    @abstractmethod
    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State at positions x (n, 3) [m] with velocities v (n, 3) [m/s] in the world, as near as the model comes."""

    def left(self, stepper: Stepper, state: MotionState, time: float, dt: float) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and velocities (n, 3) [m/s] of a state."""
        own = stepper.own_positions(state)
        return stepper.positions(state, time), np.array(stepper.model.velocities(state, own, LEAD * dt))

    def packed(self, state: MotionState) -> Array:
        """All numbers of a state in one array."""
        return np.concatenate([part.ravel() for part in state.arrays().values()])

    def unpacked(self, template: MotionState, numbers: Array) -> MotionState:
        """The state of :meth:`packed`, like a ``template``; more numbers may follow."""
        arrays, place = {}, 0
        for name, part in template.arrays().items():
            arrays[name] = numbers[place : place + part.size].reshape(part.shape).copy()
            place += part.size
        return template.with_arrays(arrays)


@final
class FullLevel(Level):
    """DS: positions and velocities are its own."""

    def __init__(self, model: DiscreteShell) -> None:
        self.model = model

    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State with these velocities, as if its first step were to come."""
        state = stepper.state_at(x, time)
        rates = self.model.shell.unknowns.project(v)
        rates[self.model.shell.clamped] = 0.0
        return MotionState(state.coordinates, rates, state.memory)


@final
class CoarseLevel(Level):
    """Coarse DS: the fine surface is sampled at the coarse vertices."""

    def __init__(self, model: CoarseDiscreteShell) -> None:
        self.model = model

    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State with the sampled velocities."""
        state, coarse = stepper.state_at(x, time), stepper.model
        moved = coarse.sampled(coarse.shell.rest_positions + v) - coarse.coarse.shell.rest_positions
        moved[coarse.coarse.shell.clamped] = 0.0
        return MotionState(state.coordinates, moved, state.memory)


@final
class ModalLevel(Level):
    """A modal model: coordinates are fitted to the positions, rates to the velocities, in the norm of the mass."""

    quadratic = True

    def __init__(self, model: ModalModel) -> None:
        self.model = model
        self._every = np.arange(len(model.shell.mass))

    def entered(self, stepper: Stepper, x: Array, v: Array, time: float) -> MotionState:
        """State whose shape is the nearest to x, by Gauss-Newton from the projection of the displacement."""
        modal, own = stepper.model, x - stepper.origin
        rest, root = modal.shell.rest_positions, np.sqrt(modal.shell.mass)[:, None]
        q = modal.basis.modes.T @ np.ravel(modal.shell.mass[:, None] * (own - rest))
        for _ in range(_FITS):
            rows = (root[:, :, None] * modal.warped_rows(q, self._every)).reshape(-1, q.size)
            missing = own - rest - modal.raw_displacement(q)
            q = q + np.linalg.lstsq(rows, (root * missing).ravel(), rcond=None)[0]
        rows = (root[:, :, None] * modal.warped_rows(q, self._every)).reshape(-1, q.size)
        rates = np.linalg.lstsq(rows, (root * v).ravel(), rcond=None)[0]
        state = modal.integrator.at_rest(q)
        return MotionState(q, rates, state.memory)
