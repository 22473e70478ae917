"""Motion of coarse discrete shells, and of what moves by their means, with contacts at the coarse vertices."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from modalshell.contact.touching import Touching, checked_contacts, put_out
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import PRESSED, MotionState
from modalshell.models.base.contact_motion import ContactMotion
from modalshell.models.base.implicit import LoadAt
from modalshell.models.base.setup import MotionSetup


@final
class CoarseContactMotion:
    """Takes steps with contacts: the model's own where nothing touches, else those of its coarse shell.

    These are as :class:`ContactMotion` takes them of DS, the coarse vertices staying out of the colliders. Fine ones
    between them may dip by what the surface is off them: ``deepest`` of a frame is that of the fine vertices. The
    ``model``, coarse DS or the hybrid, is about ``origin`` (3,) [m] in the world.
    """

    def __init__(self, model: Any, setup: MotionSetup, origin: Array) -> None:
        given = checked_contacts(setup.contacts, setup.supports)
        self._model, self._setup, self._under = model, setup, model.on_coarse
        self._fine = Touching(given, model.shell, origin)
        self._led = np.array([not contact.push_out for contact in given])
        coarse = self._under.coarse.shell
        own = self._under.coarse_contacts(given)
        self._motion = ContactMotion(model.integrator, setup, coarse, origin, contacts=own)

    @property
    def touching(self) -> Touching:
        """The contacts of the fine vertices."""
        return self._fine

    @property
    def note(self) -> str:
        """What a message says of friction."""
        return self._motion.note

    def begin(self, state: MotionState, positions: Array) -> MotionState:
        """A start at ``positions`` (n, 3) [m], refused inside a collider; coarse vertices that are in are put out."""
        self._fine.refuse_inside(positions)
        coarse = self._model.as_coarse(state)
        placed = put_out(self._motion.steps.now, coarse.coordinates, self._led)
        if not np.array_equal(placed, coarse.coordinates):
            state = MotionState(placed, coarse.rates, coarse.memory)
        return self._marked(self._motion.begin(state, placed), pressed=False)

    def advance(self, begin: float, dt: float, state: MotionState, load_at: LoadAt) -> tuple[MotionState, bool]:
        """The state a step of ``dt`` [s] after ``state``, that at ``begin`` [s]; and whether it was solved."""
        model, under, damping = self._model, self._under, self._setup.damping

        def at(start: EulerStart) -> tuple[Any, Array, Array | None]:
            load, drag = load_at(start)
            if drag is None:
                return under.coarse, under.carried(load), None
            coarse, further = under.resisting(*drag, start.expected_rates)
            return coarse, under.carried(load) + further, None

        def free() -> tuple[MotionState, bool, Array]:
            after, solved = model.march(state, dt, load_at, damping)
            return after, solved, model.as_coarse(after).coordinates

        after, solved = self._motion.advance(under.coarse, at, begin, dt, model.as_coarse(state), free)
        return self._marked(after, pressed=bool(self._motion.steps.pushes.any())), solved

    @staticmethod
    def _marked(state: MotionState, *, pressed: bool) -> MotionState:
        return MotionState(state.coordinates, state.rates, state.memory | {PRESSED: np.full((1, 1), float(pressed))})

    def frame(self, state: MotionState, positions: Array, time: float) -> TouchedFrame:
        """What touches in a state whose fine vertices are at ``positions`` (n, 3) [m], at ``time`` [s]."""
        found = self._motion.steps.frame(self._model.as_coarse(state).coordinates, time)
        deepest = max(0.0, -float(self._fine.at(time).distances(positions).min(initial=0.0)))
        forces, touches = self._under.spread(found.forces, found.touches)
        return TouchedFrame(forces, touches, deepest)
