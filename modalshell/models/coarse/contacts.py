"""Contacts of coarse discrete shells, at rest and in motion: exact at the coarse vertices, put out at the fine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.touching import Touching, checked_contacts, put_out, refuse_friction
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import PRESSED, MotionState
from modalshell.loads import Loading
from modalshell.models.base.contact_motion import ContactMotion
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.implicit import LoadAt
from modalshell.models.base.settle import self_consistent
from modalshell.models.base.setup import MotionSetup
from modalshell.supports.constraints import Constraint


def coarse_equilibrium_on_contacts(
    model: Any, loading: Loading, start: Array | None, contacts: Sequence[Contact], constraints: Sequence[Constraint]
) -> Equilibrium:
    """Equilibrium of the coarse shell with contacts at its own vertices, prolonged.

    Loads are those on the fine shell, and it begins at ``start`` (n, 3) [m] or at rest. Fine vertices that prolongation
    leaves inside are put onto the colliders: such an answer is a start of DS. Contact forces are those of the coarse
    vertices, at the fine vertices nearest to them. OptionError for what is no contact, friction, constraints, which it
    takes none of, or a start inside a collider.
    """
    given = checked_contacts(contacts)
    if constraints:
        raise model.no_constraints()
    refuse_friction(given, "statics on a coarse shell")
    fine, own = Touching(given, model.shell), model.coarse_contacts(given)
    under = Touching(own, model.coarse.shell)
    if start is not None:
        fine.refuse_inside(start)

    def solve(load: Array, start: Array | None) -> Equilibrium:
        begin = None
        if start is not None:
            begin = put_out(under, model.sampled(start), np.array([not contact.push_out for contact in given]))
        below = model.coarse.shell.loading(force=model.restrict(load))
        answer = model.coarse._solve_touching(below, begin, own, ())  # of which some may have no vertex that moves
        x = put_out(fine, model.prolong(answer.positions), np.ones(len(given), dtype=bool))
        forces, touches = model.spread(answer.contact_forces, answer.in_contact)
        return replace(
            answer,
            positions=x,
            coordinates=answer.positions,
            contact_forces=forces,
            in_contact=touches,
            deepest=max(0.0, -float(fine.distances(x).min(initial=0.0))),
        )

    return self_consistent(solve, loading, start) if loading.live else solve(loading.dead, start)


def equilibrium_or_coarse_contacts(
    model: Any,
    free: Callable[[], Equilibrium],
    loading: Loading,
    start: Array | None,
    contacts: Sequence[Contact],
    constraints: Sequence[Constraint],
) -> Equilibrium:
    """The ``free`` equilibrium of a model where that touches nothing, else that of its coarse shell with the contacts.

    The other parameters are those of :func:`coarse_equilibrium_on_contacts`.
    """
    if not constraints:
        touching = Touching(checked_contacts(contacts), model.shell)
        begin = model.shell.rest_positions if start is None else start
        touching.refuse_inside(begin)
        found = free()
        x = found.positions
        if found.converged and not (touching.distances(x) < 0.0).any() and not touching.crossed(begin, x):
            return replace(found, contact_forces=np.zeros_like(x), in_contact=np.zeros(len(x), dtype=bool))
    found = coarse_equilibrium_on_contacts(model, loading, start, contacts, constraints)
    how = f"answered by {model.name}: contacts press on the shell"
    return replace(found, coordinates=None, message="; ".join(part for part in (how, found.message) if part))


@final
class CoarseContactMotion:
    """Takes steps with contacts: the model's own where nothing touches, else those of its coarse shell.

    These are as :class:`ContactMotion` takes them of DS, the coarse vertices staying out of the colliders. Fine ones
    between them may dip by what the surface is off them: ``deepest`` of a frame is that of the fine vertices. The
    ``model``, coarse DS or the hybrid, is about ``origin`` (3,) [m] in the world. ``touching`` are the contacts of the
    fine vertices.
    """

    presses = False
    """Coarse vertices are its unknowns: nothing is pressed in beyond them."""

    def __init__(self, model: Any, setup: MotionSetup, origin: Array) -> None:
        given = checked_contacts(setup.contacts, setup.supports)
        self._model, self._setup, self._under = model, setup, model.on_coarse
        self.touching = Touching(given, model.shell, origin)
        self._led = np.array([not contact.push_out for contact in given])
        coarse = self._under.coarse.shell
        own = self._under.coarse_contacts(given)
        self._motion = ContactMotion(model.integrator, setup, coarse, origin, contacts=own)

    @property
    def note(self) -> str:
        """What a message says of friction."""
        return self._motion.note

    def begin(self, state: MotionState, positions: Array) -> MotionState:
        """A start at ``positions`` (n, 3) [m], refused inside a collider; coarse vertices that are in are put out."""
        self.touching.refuse_inside(positions)
        begun = self.entered(state, 0.0)
        self._motion.steps.begin(self._model.as_coarse(begun).coordinates)
        return begun

    def entered(self, state: MotionState, time: float) -> MotionState:
        """A state at ``time`` [s] that is not of this motion, its coarse vertices put out of the colliders."""
        coarse = self._model.as_coarse(state)
        placed = put_out(self._motion.steps.now.at(time), coarse.coordinates, self._led)
        if not np.array_equal(placed, coarse.coordinates):
            state = MotionState(placed, coarse.rates, coarse.memory)
        return self.clear(state)

    def clear(self, state: MotionState) -> MotionState:
        """A state that no contact force has acted on yet."""
        return self._marked(self._motion.clear(state), pressed=False)

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
        after = self._model.remembered(state, after)
        return self._marked(after, pressed=bool(self._motion.steps.pushes.any())), solved

    @staticmethod
    def _marked(state: MotionState, *, pressed: bool) -> MotionState:
        return MotionState(state.coordinates, state.rates, state.memory | {PRESSED: np.full((1, 1), float(pressed))})

    def energy(self, state: MotionState) -> float:
        """None [J] but the model's own."""
        return 0.0

    def frame(self, state: MotionState, positions: Array, time: float) -> TouchedFrame:
        """What touches in a state whose fine vertices are at ``positions`` (n, 3) [m], at ``time`` [s]."""
        found = self._motion.steps.frame(self._model.as_coarse(state).coordinates, time)
        deepest = max(0.0, -float(self.touching.at(time).distances(positions).min(initial=0.0)))
        forces, touches = self._under.spread(found.forces, found.touches)
        return TouchedFrame(forces, touches, deepest)
