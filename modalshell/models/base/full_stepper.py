"""What takes the steps of full models: brings them loads, supports, patches and contacts as each step needs them."""

from __future__ import annotations

from functools import cached_property, partial
from typing import Any, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full import ImplicitRule
from modalshell.integrators.full.implicit_rule import EulerStart, ShellSteps, steps_of
from modalshell.integrators.state import MotionState
from modalshell.models.base.crease_motion import CreaseMotion
from modalshell.models.base.stepper import ContactStepper
from modalshell.statics.live_loads import LiveLoads


@final
class FullStepper(ContactStepper):
    """Steps that take loads as they change within them, and edges clamped to supports along with these.

    In the frame of supports that move, loads are those expected at the end of a step, of explicit rules those at the
    time of its middle: they act in the world.
    """

    model: Any
    takes_constraints = True

    def _moving_contacts(self) -> Any:
        """What takes the steps with contacts."""
        from modalshell.models.base.contact_motion import ContactMotion  # not without contacts

        frame = None if self._frame is None else self.setup.supports
        return ContactMotion(self.model.integrator, self.setup, self.model.shell, self.origin, frame=frame)

    @cached_property
    def creases(self) -> CreaseMotion | None:
        """What takes the steps with creases; None without."""
        known = self.model.shell.creases
        if known is None or not self.model.of_material:
            return None
        return CreaseMotion(known, self.setup.damping)

    def start(self, positions: Array | None) -> MotionState:
        """State at rest relative to the supports, where these are at time 0, and at their speed.

        Patches begin where positions are.
        """
        return self._begun(super().start(positions))

    def _at_rest(self, positions: Array | None) -> MotionState:
        """The same without contacts and creases."""
        state = super()._at_rest(positions)
        if positions is not None and self._patches:
            x, led = state.coordinates.copy(), np.concatenate([patch.vertices for patch in self._patches])
            x[led] = (positions - self.origin)[led]
            state = self.model.integrator.start(self.model, x)
        return state if self._path is None else self.model.placed(state, self._path.at(0.0))

    def _begun(self, state: MotionState) -> MotionState:
        """A start that knows what its creases have kept."""
        kept = self.model.shell.crease_state
        return state if self.creases is None else self.creases.begin(state, kept.angles, kept.dissipated)

    def state_at(self, positions: Array, time: float) -> MotionState:
        """State at rest with every vertex at ``positions`` (n, 3) [m] in the world, held ones too."""
        state = super().state_at(positions, time)
        if self._frame is None:
            state.coordinates = positions - self.origin
        return self._begun(state)

    def model_at(self, time: float) -> Any:
        """The model with its supports where they are at ``time`` [s]."""
        return self.model if self._path is None else self.model.carried(self._path, (time, self.setup.dt))

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the model's rule."""
        rule, creases = self.model.integrator, self.creases
        if creases is None:
            return self._advanced(self.model, begin, dt, state, load)
        if self._contacts is None and isinstance(rule, ImplicitRule):
            return creases.advance(self.model, partial(self._at, begin, dt, load=load), state, dt)
        after, solved = self._advanced(self.model.as_creased(state), begin, dt, state, load)
        return creases.after(self.model_at(begin + dt), state, after), solved

    def _advanced(
        self, model: Any, begin: float, dt: float, state: MotionState, load: Array
    ) -> tuple[MotionState, bool]:
        """One step of the model's rule by ``model``, whose creases do not yield."""
        damping, rule = self.setup.damping, model.integrator

        def at(start: EulerStart) -> tuple[Any, Array, Array | None]:
            return self._at(begin, dt, start, load, model=model)

        if self._contacts is not None and isinstance(rule, ImplicitRule):
            return self._contacts.advance(model, at, begin, dt, state)
        if isinstance(rule, ImplicitRule):
            steps = ShellSteps(model, at, damping)
            return rule.march(steps_of(steps, model.free_parts, damping), state, dt)
        x, rates = state.coordinates, state.rates
        whole = EulerStart(x, rates, dt, 1.0, rates, x, 0.0, x)
        body, load, held = self._at(begin, dt, whole, load, explicit=not rule.takes_live, model=model)
        after, solved = rule.step(body, state, dt, load, damping, held)
        if self._contacts is not None:
            after, outside = self._contacts.after_explicit(body, x, after, begin + dt, dt)
            return after, solved and outside
        return after, solved

    def _at(
        self, begin: float, dt: float, start: EulerStart, load: Array, *, explicit: bool = False, model: Any = None
    ) -> tuple[Any, Array, Array | None]:
        """Model, dead load and held places of a step of implicit Euler; ``explicit`` ones take loads of the middle."""
        model, loading = self.model if model is None else model, self.setup.loading
        time, path = begin + start.end * dt, self._path or self._frame
        when, state = time, start.guess
        if explicit:
            ahead = start.origin + model.integrator.leads * dt * start.rates
            when, state = begin + 0.5 * dt, MotionState(ahead, start.rates)
        if self._path is not None:
            drag_time, dragged = (when, state) if model.integrator.explicit else (time, start.guess)
            model = model.carried(self._path, (begin, dt), start.near_time, start.end)
            load = load + self.drag_along(self._path, drag_time, dragged.coordinates)
        held = self._held_positions(time, None if path is None else path.at(time))
        if self._frame is not None:
            load, _ = self.load_in_frame(when, load, state, start.side)
        elif loading.live and explicit:
            load = load + loading.live_force(state.coordinates + self.origin, state.rates, when)
        elif loading.live:
            model = model.under(LiveLoads(loading, time, self.origin), start.origin, start.dt)
        return model, load, held
