"""Base of models that are stepped by steps of implicit Euler of their own, in the frame of their supports."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Self, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.integrators.full import FullIntegrator, ImplicitRule
from modalshell.integrators.full.base import oscillation
from modalshell.integrators.full.implicit_rule import EulerStart, Floating, LoadedSteps, steps_of
from modalshell.integrators.state import MotionState
from modalshell.models.base.model import FrameModel
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import LEAD, ContactStepper, Drag, Stepper
from modalshell.shell.damping import Damping

LoadAt = Callable[[EulerStart], tuple[Array, Drag | None]]
"""The load (n, 3) [N] of a step of implicit Euler, and how it falls with velocities."""
_STRAIGHT = 0.1
"""Largest turn [rad] of a correction for this fall that is taken straight on, not solved for: it stretches by half of
its square."""


def implicit_rule(choice: str | FullIntegrator) -> ImplicitRule:
    """The implicit rule of a key; OptionError for any other."""
    rule = FullIntegrator.chosen(choice)
    if not isinstance(rule, ImplicitRule):
        kept = [key for key, kind in FullIntegrator.known.items() if issubclass(kind, ImplicitRule)]
        raise OptionError(f"integrator must be one of {', '.join(kept)} for this model (got {rule.key!r})")
    return rule


def slowed(
    state: MotionState, before: MotionState, dt: float, damping: Damping, stiffness: Array, rows: Array, drag: Array
) -> MotionState:
    """``state`` (m,) after a step from ``before``, with the fall ``-D (v - v_n)`` of the loads taken at its end.

    Coordinates are orthonormal in the norm of the mass, ``stiffness`` (m, m) is their tangent, ``rows`` (k, 3, m)
    take rates to velocities of the vertices of ``drag`` (k, 3, 3) [N s/m].
    """
    inertia = np.eye(len(stiffness)) * (1.0 + dt * damping.mass_factor)
    inertia += dt * (dt + damping.stiffness_factor) * stiffness
    whole = inertia + dt * np.tensordot(rows, drag @ rows, ((0, 1), (0, 1)))
    rates = before.rates + np.linalg.solve(whole, inertia @ (state.rates - before.rates))
    return MotionState(state.coordinates + dt * (rates - state.rates), rates)


class ImplicitModel(FrameModel):
    """A model with states in the frame of its supports; its integrator makes steps of those of implicit Euler."""

    integrator: ImplicitRule
    free_parts: Floating | None = None
    """Parts that nothing holds, of a model that takes such shells and has no frames for them."""

    def stepped_by(self, integrator: str | FullIntegrator) -> Self:
        """The same model, and what it hands over to, with another implicit rule of its steps."""
        other = copy.copy(self)
        other.integrator = implicit_rule(integrator)
        for name, part in vars(self).items():
            if isinstance(part, ImplicitModel):
                setattr(other, name, part.stepped_by(integrator))
        return other

    def contact_motion(self, setup: MotionSetup, origin: Array) -> Any:
        """What takes the steps of a motion with contacts about ``origin`` (3,) [m], of models that take these."""
        raise self.no_contacts()

    @abstractmethod
    def euler_step(self, start: EulerStart, load: Array, damping: Damping) -> tuple[Array, bool]:
        """Coordinates after a step of implicit Euler under ``load`` (n, 3) [N]; also whether it was solved."""

    @abstractmethod
    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small ``move`` of the coordinates."""

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error in the coordinates that a step has made, by the integrator's theory; none where these changed."""
        if before.rates.shape != after.rates.shape:
            return np.zeros_like(after.rates)
        return self.integrator.local_error(before, after, dt)

    def growth(self, stiffness: float, damp: float, dt: float) -> complex:
        """What steps multiply an oscillation by, by the integrator's theory."""
        return self.integrator.growth(oscillation(stiffness, damp, dt))

    def march(self, state: MotionState, dt: float, load_at: LoadAt, damping: Damping) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s]; the integrator evaluates the loads at its own times and states."""
        steps = steps_of(ModelSteps(self, load_at, damping), self.free_parts, damping)
        return self.integrator.march(steps, state, dt)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s] under a ``load`` (n, 3) [N] that stays."""
        return self.march(state, dt, lambda _: (load, None), damping)

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion; see :meth:`Model.stepper`."""
        return ImplicitStepper(self, setup.felt_by(self.integrator), in_frame=True)


class AskedSteps(LoadedSteps):
    """Steps of implicit Euler of a model, under loads that are asked for where they are needed."""

    def __init__(self, model: Any, load_at: LoadAt, damping: Damping) -> None:
        self._model, self._load_at, self._damping = model, load_at, damping
        self._load: Array | None = None

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small ``move`` of the coordinates."""
        return self._model.turn(coordinates, move)

    def load_on(self, x: Array) -> Array:
        """Load (n, 3) [N] of the last step."""
        assert self._load is not None
        return self._load


@final
class ModelSteps(AskedSteps):
    """Those of the model's own equations."""

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """State at the end, and whether its equations were solved."""
        load, drag = self._load_at(start)
        self._load, model = load, self._model
        coordinates, solved = model.euler_step(start, load, self._damping)
        after = start.after(coordinates)
        if drag is None:
            return after, solved
        vertices, slopes = drag
        slower = model.dragged(after, MotionState(start.origin, start.expected_rates), start.dt, self._damping, *drag)
        if model.turn(after.coordinates, slower.coordinates - after.coordinates) <= _STRAIGHT:
            return slower, solved
        less = MotionState(after.coordinates, slower.rates - start.expected_rates)
        speeds = model.velocities(less, model.positions(less), LEAD * start.dt)[vertices]
        self._load = load.copy()
        np.subtract.at(self._load, vertices, (slopes @ speeds[:, :, None])[:, :, 0])
        coordinates, solved = model.euler_step(start, self._load, self._damping)
        return start.after(coordinates), solved


@final
class ImplicitStepper(ContactStepper):
    """Steps under loads as they are expected at the end of each step of implicit Euler, without constraints."""

    model: ImplicitModel

    def _moving_contacts(self) -> Any:
        """What takes the steps with contacts."""
        return self.model.contact_motion(self.setup, self.origin)

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the model's rule."""

        def load_at(start: EulerStart) -> tuple[Array, Drag | None]:
            return self.load_in_frame(begin + start.end * dt, load, start.guess, start.side)

        if self._contacts is not None:
            return self._contacts.advance(begin, dt, state, load_at)
        if self._frame is None and not self.setup.loading.live:
            return self.model.step(state, dt, load, self.setup.damping)
        return self.model.march(state, dt, load_at, self.setup.damping)
