"""Implicit rules of order one and two, each made of steps of implicit Euler of another length from another state.

``IE(h', x', v')`` minimises ``E(x) + |x - x'|^2 (1/h'^2 + xi/h') M / 2 - (f + M v'/h').(x - x')``, and what damping by
the stiffness takes of changes of measures (theory 12, eq. 10); ``v = (x - x')/h'``.
Every rule here asks for such steps alone, so that one solver serves them all, sparse, dense and compiled.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal, Protocol, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body, FullIntegrator, hold, step_potential
from modalshell.integrators.state import MotionState
from modalshell.kernels.rotations import largest_turn
from modalshell.shell.damping import Damping
from modalshell.shell.elastic_energy import nearest_measures
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.mixed_newton import STRAIGHT_TURN
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential, solve


@final
@dataclass(frozen=True, eq=False)
class EulerStart:
    """Where a step of implicit Euler within a rule's step begins, and ends."""

    origin: Array
    rates: Array
    """x' and v', in the model's own unknowns."""
    dt: float
    """h' [s]."""
    end: float
    """When it ends, as a share of the rule's step."""
    expected_rates: Array
    """Rates expected at its end, at which loads that are not solved for are taken."""
    near: Array
    """A state without false strains, whose stresses the first iterate takes."""
    near_time: float
    """When that is, as a share of the rule's step."""
    viscous_at: Array
    """Where a reduced shell takes the viscous matrix of its bending."""
    made_of: tuple[tuple[float, MotionState, float], ...] = ()
    """States with their weights whose rates add up to v', and when they are, as shares of the rule's step: so do the
    momenta of free parts, and the measures of the shell from which damping by the stiffness counts their changes."""
    viscous_ahead: bool = False
    """Whether ``viscous_at`` is as near to its end as where the rates lead."""
    side: Literal["before"] | None = None
    """Side of a jump in time at its end of which it takes loads; None where they are the only ones of a frame, which
    then stand for the time on both sides."""

    @property
    def reduced(self) -> tuple[Array, Array, Array, Array, Array]:
        """What a reduced shell's step takes: x', v', ``near``, ``viscous_at``, and where Newton's method begins.

        The last two are one where they may be: slopes there serve both.
        """
        first = self.viscous_at if self.viscous_ahead else self.origin + self.dt * self.rates
        return self.origin, self.rates, self.near, self.viscous_at, first

    def damping_measures(
        self, changes: Callable[[float, MotionState], list[Array]], periods: list[Array | float | None]
    ) -> list[Array]:
        """Changes of measures that damping is measured from: the weighted sum of those of the rule's states.

        Measures with ``periods`` are shifted to those nearest to the latest state: the angle of a fold past half a turn
        jumps by a whole one, which is no change.
        """
        found = [changes(when, state) for _, state, when in self.made_of]
        latest = max(range(len(found)), key=lambda place: self.made_of[place][2])
        total = [np.zeros(())] * len(periods)
        for (weight, *_), measures in zip(self.made_of, found, strict=True):
            kinds = zip(total, measures, found[latest], periods, strict=True)
            total = [known + weight * nearest_measures(own, of, period) for known, own, of, period in kinds]
        return total

    @property
    def guess(self) -> MotionState:
        """State expected at its end."""
        return MotionState(self.origin + self.dt * self.rates, self.expected_rates)

    def after(self, coordinates: Array) -> MotionState:
        """State at its end, at ``coordinates``."""
        return MotionState(coordinates, (coordinates - self.origin) / self.dt)


class EulerSteps(ABC):
    """Steps of implicit Euler of one model within one step of a rule."""

    @abstractmethod
    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """State at the end, and whether its equations were solved."""

    @abstractmethod
    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small ``move`` of the coordinates."""

    def landed(self, before: MotionState, after: MotionState, dt: float) -> MotionState:  # noqa: ARG002
        """``after`` a whole step from ``before``, with the momenta of free parts that its steps of Euler gave."""
        return after


class ImplicitRule(FullIntegrator):
    """A rule made of steps of implicit Euler; see :class:`EulerStart`.

    Where the motion is violent, where a rule has no step before to go on from, and where its own equations are not
    solved, steps of implicit Euler stand in for it.
    """

    takes_live = True
    stand_ins: ClassVar[int] = 1
    """Steps of implicit Euler that stand in for one of the rule."""

    @abstractmethod
    def growth(self, rate: complex) -> complex:
        """What ``y' = lambda y`` is multiplied by in a step of h, for ``rate = h lambda``."""

    @abstractmethod
    def march(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s]; also returns whether the equations were solved."""

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest, with what the rule keeps from step to step."""
        return MotionState(coordinates, np.zeros_like(coordinates))

    def stood_in_for(
        self,
        before: MotionState,  # noqa: ARG002
        after: MotionState,
        dt: float,  # noqa: ARG002
        *,
        smooth: bool = False,  # noqa: ARG002
    ) -> MotionState:
        """``after`` a step of ``dt`` [s] by implicit Euler from ``before``, to go on from as from a start.

        Or, where it was ``smooth``, as from any other.
        """
        return MotionState(after.coordinates, after.rates)

    def continued(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:  # noqa: ARG002
        """The rule's own step after the one before, in which nothing stands in; not solved if there is none."""
        return state, False

    def standing_in(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """Steps of implicit Euler that cost as much as one of the rule of ``dt`` [s]; and whether they were solved."""
        return euler_steps(euler, state, dt, self.stand_ins)

    def start(self, body: Body, positions: Array) -> MotionState:  # noqa: ARG002
        """State at rest at ``positions`` (n, 3) [m]."""
        return self.at_rest(positions)

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Advance under a ``load`` that stays, held vertices going straight to where they are ``held``."""
        first = state.coordinates[body.shell.clamped]

        def at(start: EulerStart) -> tuple[Body, Array, Array | None]:
            return body, load, None if held is None else first + start.end * (held - first)

        return self.march(steps_of(ShellSteps(body, at, damping), body.free_parts, damping), state, dt)


def euler_step(euler: EulerSteps, state: MotionState, dt: float, begin: float, end: float) -> tuple[MotionState, bool]:
    """A step of implicit Euler over the part of a step of ``dt`` [s] from ``begin`` to ``end``, shares of it."""
    x, v = state.coordinates, state.rates
    return euler.solve(EulerStart(x, v, (end - begin) * dt, end, v, x, begin, x, ((1.0, state, begin),)))


def euler_steps(euler: EulerSteps, state: MotionState, dt: float, count: int) -> tuple[MotionState, bool]:
    """As many steps of implicit Euler, alike, over a step of ``dt`` [s]; and whether all were solved."""
    solved = True
    for k in range(count):
        state, one = euler_step(euler, state, dt, k / count, (k + 1) / count)
        solved = solved and one
    return state, solved


StageOf = Callable[[EulerStart], tuple[Body, Array, Array | None]]
"""What a shell feels: body, dead load (n, 3) [N] and places (h, 3) [m] of the held vertices at the end of a step."""
StepMinimum = Callable[[Potential, Array, float, float, list[Array], float], tuple[Array, bool]]
"""What finds the minimum (n, 3) of a step's potential where contacts bound it, and whether that is one.

It takes the potential, a first guess, the load's size, the goal, predicted stresses, and the share of the rule's step
at which the step ends.
"""


class LoadedSteps(EulerSteps):
    """Steps of implicit Euler that know the load that they took."""

    @abstractmethod
    def load_on(self, x: Array) -> Array:
        """Load [N] of the last step on every vertex, at its end x."""


@final
class ShellSteps(LoadedSteps):
    """Steps of implicit Euler of a shell whose unknowns are its vertices."""

    def __init__(self, body: Body, at: StageOf, damping: Damping, minimum: StepMinimum | None = None) -> None:
        self._body, self._at, self._damping, self._minimum = body, at, damping, minimum
        self._known: list[tuple[MotionState, list[Array]]] = []
        self._felt: tuple[Array, LiveLoads | None] | None = None
        self._last: tuple[float, NewtonResult] | None = None

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """Minimise the potential of the step, with the factor of an earlier one of this length where that serves."""
        body, load, held = self._at(start)
        self._felt = load, body.live
        shell, begun = body.shell, body.start_shell
        if self._damping.stiffness_factor or shell.has_dashpots:
            begun_with = start.damping_measures(partial(self._changes, body), shell.elastic_energy.periods)
            damp = begun_with, self._damping.stiffness_factor, start.dt
            shell, begun = shell.damped(*damp), begun.damped(*damp)
        problem, scale = step_potential(body, start.origin, start.rates, start.dt, load, self._damping, body.drag)
        problem = replace(problem, shell=shell)
        near, first = hold(shell, start.near, held), hold(shell, start.origin + start.dt * start.rates, held)
        # Stresses predicted along the straight way to a turned place would be a compression (theory 12).
        stresses = begun.predicted_stresses(start.near, np.zeros_like(near))
        if self._minimum is not None:
            point, solved = self._minimum(problem, first, scale, body.step_tolerance, stresses, start.end)
            return start.after(point), solved
        kept = self._last[1] if self._last is not None and self._last[0] == start.dt else None
        guess = first if self.turn(near, first - near) <= STRAIGHT_TURN else near
        result = solve(problem, guess, scale, body.step_tolerance, stresses, kept, near)
        self._last = (start.dt, result) if result.converged else None
        return start.after(result.point), result.converged

    def _changes(self, body: Body, when: float, state: MotionState) -> list[Array]:
        """Changes of measures in a state, at a share of the rule's step."""
        found = next((changes for known, changes in self._known if known is state), None)
        if found is None:
            found = body.shell_at(when).changes(state.coordinates)
            self._known.append((state, found))
        return found

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small move (n, 3) [m]."""
        return float(largest_turn(coordinates, move, self._body.shell.mesh.faces))

    def load_on(self, x: Array) -> Array:
        """Load (n, 3) [N] of the last step, at its end x (n, 3)."""
        assert self._felt is not None
        load, live = self._felt
        return load if live is None else load + live.force(x)


class Floating(Protocol):
    """What knows the momenta (parts, 2, 3) of free parts; see :class:`FreeParts`."""

    def momenta(self, x: Array, rates: Array) -> Array:
        """Momenta of coordinates and rates."""

    def wrenches(self, x: Array, load: Array) -> Array:
        """Forces and torques of a load."""

    def carried(self, before: MotionState, after: MotionState, first: Array, last: Array, dt: float) -> MotionState:
        """``after`` a step from ``before``, brought to its momenta."""


@final
class Flight(EulerSteps):
    """Steps of implicit Euler of a shell with free parts, and what becomes of the momenta of these.

    A rule takes the momenta as it takes the rates, each step of Euler changing them by its own forces and torques. At
    the end of the rule's step the parts are moved and turned as rigid bodies so that they have them: centres fall as
    they should, and what solves and quadrature add to the angular momentum, an error of the rule's own order, is gone.
    """

    def __init__(self, euler: LoadedSteps, free: Floating, damping: Damping) -> None:
        self._euler, self._free, self._drag = euler, free, damping.mass_factor
        self._known: list[tuple[MotionState, Array]] = []

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """A step of Euler, and its momenta."""
        after, solved = self._euler.solve(start)
        x = after.coordinates
        momenta = sum((weight * self._momenta(state) for weight, state, _ in start.made_of), np.zeros(()))
        momenta = momenta + start.dt * self._free.wrenches(x, self._euler.load_on(x))
        self._known.append((after, momenta / (1.0 + start.dt * self._drag)))
        return after, solved

    def landed(self, before: MotionState, after: MotionState, dt: float) -> MotionState:
        """``after`` a whole step from ``before``, its free parts brought to their momenta."""
        return self._free.carried(before, after, self._momenta(before), self._momenta(after), dt)

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small ``move`` of the coordinates."""
        return self._euler.turn(coordinates, move)

    def _momenta(self, state: MotionState) -> Array:
        for known, momenta in self._known:
            if known is state:
                return momenta
        momenta = self._free.momenta(state.coordinates, state.rates)
        self._known.append((state, momenta))
        return momenta


def steps_of(euler: LoadedSteps, free: Floating | None, damping: Damping) -> EulerSteps:
    """The same steps, those of a shell with free parts."""
    return euler if free is None else Flight(euler, free, damping)
