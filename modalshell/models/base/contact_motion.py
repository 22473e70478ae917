"""Motion of full models with contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, final

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.layers import Layers
from modalshell.contact.steps import TouchingSteps
from modalshell.contact.touching import Touching, parted, put_out
from modalshell.core.errors import OptionError
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.full import SDIRK2, FullIntegrator, ImplicitRule
from modalshell.integrators.full.base import inner_force
from modalshell.integrators.full.implicit_rule import EulerStart, ShellSteps, StageOf, steps_of
from modalshell.integrators.full.linear_implicit_euler import LinearisedEuler
from modalshell.integrators.full.second_order import SecondOrderRule
from modalshell.integrators.state import GIVEN, MIDDLE_GIVEN, PUSHES, MotionState
from modalshell.models.base.kept_sets import KeptSteps
from modalshell.models.base.setup import MotionSetup
from modalshell.shell import Shell
from modalshell.statics.potential import Potential
from modalshell.supports import SupportPath

FreeStep = Callable[[], tuple[MotionState, bool, Array]]
"""Takes a step without contacts: the state at its end, whether it was solved, and positions (n, 3) [m] there."""


@final
class ContactMotion:
    """Takes the steps of a full model with contacts.

    While nothing touches, the model's rule steps, and a rule of order two does so on contacts that stay as they are
    (:class:`modalshell.models.base.kept_sets.KeptSteps`), or SDIRK2 where it would gain energy. Where something strikes
    or parts, or would have entered, or that would gain energy, too, or layers would meet on the straight way of a step
    or at the rates before it, implicit Euler stands in for it, whose steps are minima of a potential, outside the
    colliders: they find the contact forces exactly, and never gain energy from a collider at rest. After explicit
    steps, and the one of linear implicit Euler, what entered is put onto its collider and loses its speed inward.

    The shell is about ``origin`` (3,) [m] in the world; states may be in a moving ``frame``. ``contacts`` are those of
    the shell's own vertices, where they are not those of the setup. OptionError for colliders that move too fast, and
    ``push_out`` or self-contact with explicit rules.
    """

    presses = False
    """Vertices are its unknowns: nothing is pressed in beyond them."""

    def __init__(
        self,
        rule: FullIntegrator,
        setup: MotionSetup,
        shell: Shell,
        origin: Array,
        *,
        contacts: Sequence[Contact] | None = None,
        frame: SupportPath | None = None,
    ) -> None:
        given, own = parted(setup.contacts if contacts is None else contacts, frame)
        for index, contact in enumerate(given):
            if contact.push_out and not isinstance(rule, ImplicitRule):
                raise OptionError(f"contact {index} has push_out, which {rule.name} does not take: take 'composite'")
        layers = None
        if own is not None:
            if not isinstance(rule, ImplicitRule):
                raise OptionError(f"self-contact needs implicit steps (got {rule.name}): take 'composite'")
            layers = Layers(own, shell)
            weight = np.linalg.norm(setup.loading.dead, axis=1).sum()
            layers = layers.stiff(float(weight + shell.mass.sum() * layers.gap / setup.dt**2) / shell.mesh.area)
        self._rule: Any = rule
        self._on_kept: list[Any] = [rule]
        if isinstance(rule, SecondOrderRule) and not isinstance(rule, SDIRK2):
            self._on_kept.append(SDIRK2())  # which gains less often
        self._setup = setup
        stand_ins = rule.stand_ins if isinstance(rule, ImplicitRule) else 1
        self.steps = TouchingSteps(given, shell, origin, setup.dt, stand_ins, layers)

    @property
    def note(self) -> str:
        """What is said of friction: what sticks creeps by a part of each step of implicit Euler; of others nothing."""
        if not isinstance(self._rule, ImplicitRule):
            return ""
        return self.steps.friction_note

    def advance(
        self, model: Any, at: StageOf, begin: float, dt: float, state: MotionState, free: FreeStep | None = None
    ) -> tuple[MotionState, bool]:
        """The state a step of ``dt`` [s] after ``state``, that at the time ``begin`` [s]; and whether it was solved.

        ``free`` takes the step where nothing touches, if that is not ``model`` by its own rule.
        """
        steps, rule, damping = self.steps, self._rule, self._setup.damping
        x, end = state.coordinates, begin + dt
        if PUSHES in state.memory:
            steps.pushes = state.memory[PUSHES].copy()
        steps.go_on(begin)
        steps.let_in(x, begin, dt)
        if not (steps.touches(x, begin) or steps.enters(x, end) or steps.meet(x, x + dt * state.rates)):
            if free is None:
                euler = steps_of(ShellSteps(model, at, damping), model.free_parts, damping)
                after, solved = rule.march(euler, state, dt)
                reached = after.coordinates
            else:
                after, solved, reached = free()
            if not (steps.enters(reached, end) or steps.meet(x, reached)):
                steps.pushes[:] = 0.0
                return self._kept(after), solved and not steps.now.at(end).passed(x, reached)
        loads, was = np.zeros_like(x), steps.pushes

        def felt(start: EulerStart) -> tuple[Any, Array, Array | None]:
            body, load, held = at(start)
            loads[:] = load if body.live is None else load + body.live.force(x)
            if body.drag is not None:  # what the matrix takes of it again at the rates expected
                loads[:] -= body.shell.pattern.product(body.drag, start.expected_rates.ravel()).reshape(-1, 3)
            return body, load, held

        if (kept := self._kept_step(model, felt, loads, begin, dt, state)) is not None:
            return kept, True

        def minimum(
            problem: Potential, first: Array, scale: float, goal: float, stresses: list[Array], share: float
        ) -> tuple[Array, bool]:
            return steps.solve(problem, first, scale, goal, stresses, begin + share * dt)

        after, solved = rule.standing_in(ShellSteps(model, felt, damping, minimum), state, dt)
        rates = steps.struck(after.coordinates, after.rates, (x, state.rates, begin), loads)
        smooth = solved and rates is after.rates and steps.stays(was)
        after = rule.stood_in_for(state, MotionState(after.coordinates, rates), dt, smooth=smooth)
        return self._kept(after, {GIVEN: steps.given_since(begin)}), solved

    def _kept_step(
        self, model: Any, felt: StageOf, loads: Array, begin: float, dt: float, state: MotionState
    ) -> MotionState | None:
        """The state after a step of order two on contacts that stay as they are; None where they do not.

        It is one of SDIRK2 where the rule itself would gain energy, and none where that would, too. ``loads`` (n, 3)
        become those that are ``felt`` [N].
        """
        steps, rule = self.steps, self._rule
        if not (GIVEN in state.memory and steps.pushes.any() and steps.may_stay):
            return None
        make, pushes = partial(ShellSteps, model, felt, self._setup.damping), steps.pushes
        for one in self._on_kept:
            own = KeptSteps(make, steps, state, begin, dt)
            after, solved = one.continued(own, state, dt)
            if solved and not own.gains(after, loads):
                given = own.given()
                steps.gave(begin, given[GIVEN])
                after.memory |= {} if one is rule else rule.further(after, after)
                return self._kept(after, given)
            own.undo(pushes)
            if not solved:
                break
        return None

    def after_explicit(
        self, model: Any, before: Array, after: MotionState, time: float, dt: float
    ) -> tuple[MotionState, bool]:
        """The end of an explicit step of ``dt`` [s] at ``time`` [s], with what entered put back.

        And whether it did not lead through a collider from where it was ``before`` (n, 3) [m].
        """
        drag = dt * self._setup.damping.mass_factor if isinstance(self._rule, LinearisedEuler) else 0.0
        x, rates = self.steps.projected(after.coordinates, after.rates, time, dt, drag)
        memory = after.memory
        if "force" in memory and x is not after.coordinates:  # that of where it was
            memory = memory | {"force": inner_force(model.shell, x, rates, self._setup.damping)}
        return self._kept(MotionState(x, rates, memory)), not self.steps.now.passed(before, x)

    def _kept(self, state: MotionState, given: dict[str, Array] | None = None) -> MotionState:
        """A state with the contact forces that the next step needs, and what contacts have ``given`` in this one."""
        memory = state.memory
        if isinstance(self._rule, SecondOrderRule):
            none = np.zeros_like(state.coordinates)
            memory = memory | {GIVEN: none, MIDDLE_GIVEN: none} | (given or {})
        elif not self.steps.rubs:
            return state
        return MotionState(state.coordinates, state.rates, memory | {PUSHES: self.steps.pushes.copy()})

    @property
    def touching(self) -> Touching:
        """The contacts at the end of the last step."""
        return self.steps.now

    def frame(self, state: MotionState, positions: Array, time: float) -> TouchedFrame:
        """What touches in a state at ``time`` [s], whose coordinates are the positions."""
        return self.steps.frame(state.coordinates, time)

    def energy(self, state: MotionState) -> float:
        """Energy [J] of the barrier of self-contact in a state."""
        return self.steps.energy(state.coordinates)

    def entered(self, state: MotionState, time: float) -> MotionState:
        """A state of another motion with what lies inside colliders at ``time`` [s] put onto them."""
        touching = self.steps.now.at(time)
        x = put_out(touching, state.coordinates, np.ones(len(touching.contacts), dtype=bool))
        return self.clear(MotionState(x, state.rates, state.memory))

    def clear(self, state: MotionState) -> MotionState:
        """A state that no contact force has acted on yet: those of a step long ago are not its own."""
        self.steps.pushes = np.zeros_like(self.steps.pushes)
        return self._kept(state)

    def begin(self, state: MotionState, positions: Array) -> MotionState:
        """A start, refused inside a collider; supports may have moved ``positions`` on to its coordinates."""
        self.steps.begin(state.coordinates)
        return self._kept(state)
