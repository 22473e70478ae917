"""Base of integrators of full models: forces in motion, and the incremental potential of an implicit step."""

from __future__ import annotations

import cmath
from abc import abstractmethod
from typing import ClassVar, Protocol

import numpy as np

from modalshell.core.registry import Registry
from modalshell.core.timings import Timings
from modalshell.core.typing import Array
from modalshell.integrators.base import Integrator
from modalshell.integrators.free_parts import FreeParts
from modalshell.integrators.state import MotionState
from modalshell.modes import Factoriser
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.potential import Potential


class Body(Protocol):
    """What a rule needs of the model that it steps."""

    shell: Shell
    """Energies, masses and held vertices, what clamps edges where it is at the step's end."""
    step_tolerance: float
    """Out-of-balance force at which an implicit step is solved, as a share of its load and inertia."""
    factoriser: Factoriser
    """Factors the equations of implicit steps."""
    costs: Timings
    """Where their seconds are added."""
    live: LiveLoads | None
    """Loads that change within a step, for implicit integrators."""
    drag: Array | None
    """Entries [N s/m], on the shell's pattern, of the matrix by which dead loads fall with velocities in a step."""

    @property
    def start_shell(self) -> Shell:
        """The shell with what clamps its edges where it is at the beginning of a step."""

    @property
    def free_parts(self) -> FreeParts | None:
        """Parts of the shell that nothing holds."""

    def shell_at(self, share: float) -> Shell:
        """The shell with what clamps its edges where it is at a ``share`` of the rule's step."""


class FullIntegrator(Integrator):
    """A rule for ``M x'' + C x' = f(x) + load``, every vertex an unknown."""

    known: ClassVar[Registry[type[FullIntegrator]]] = Registry("integrator")
    explicit: ClassVar[bool] = False
    """Whether it has a longest stable step, which :meth:`stable_step` returns."""
    takes_live: ClassVar[bool] = False
    """Whether it takes the loads ``body.live`` at the step's end; else ``load`` holds those at the time of its middle.
    """
    leads: ClassVar[float] = 0.5
    """Part of a step by which positions move on at its first rates before ``load`` is taken there; without
    ``takes_live``."""
    joins: ClassVar[bool] = False
    """Whether it answers forces that are joined by straight lines between its steps' ends with an error of order
    two."""

    def start(self, body: Body, positions: Array) -> MotionState:  # noqa: ARG002 (for rules that keep something)
        """State at rest at ``positions`` (n, 3) [m]."""
        return MotionState(positions, np.zeros_like(positions))

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:  # noqa: ARG002
        """Error in the coordinates that a step of ``dt`` [s] has made; None where it is not known."""
        return None

    def growth(self, rate: complex) -> complex:  # noqa: ARG002
        """What ``y' = lambda y`` is multiplied by in a step of h, for ``rate = h lambda``; NaN where not known."""
        return complex(np.nan)

    @abstractmethod
    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s] under ``load`` (n, 3) [N]; also returns whether the step's equations were solved.

        ``held`` (h, 3) [m] are the positions of the held vertices at the step's end; by default those at rest.
        """

    def stable_step(self, stiffness: float, drag: float, viscosity: float) -> float:  # noqa: ARG002
        """Longest stable step [s] for a mode of ``stiffness`` lambda [1/s^2].

        ``drag`` [1/s] is its damping by the mass, ``viscosity`` [1/s] that by strain rates.
        """
        return np.inf


class EulerRule(FullIntegrator):
    """A rule of order one by which small oscillations go as by implicit Euler."""

    def growth(self, rate: complex) -> complex:
        """``1 / (1 - h lambda)``."""
        return 1.0 / (1.0 - rate)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array:
        """``h^2 v' / 2``."""
        return 0.5 * dt * (after.rates - before.rates)


def oscillation(stiffness: float, damp: float, h: float) -> complex:
    """``h lambda`` of ``q'' + damp q' + stiffness q = 0``: the root of positive imaginary part, or the slower one."""
    return complex(h * (-0.5 * damp + cmath.sqrt(0.25 * damp**2 - stiffness)))


def symplectic_limit(stiffness: float, damp: float) -> float:
    """Step [s] below which ``v+ = v - h (lambda x + c v)``, ``x+ = x + h v+`` is stable: ``h^2 lambda + 2 h c < 4``."""
    return float((np.sqrt(damp**2 + 4.0 * stiffness) - damp) / stiffness)


def hold(shell: Shell, positions: Array, held: Array | None = None) -> Array:
    """Copy of ``positions`` with the held vertices where they belong: at ``held`` (h, 3), or at rest."""
    placed = positions.copy()
    if shell.unknowns.matrix is not None:
        placed = shell.rest_positions + shell.unknowns.project(positions - shell.rest_positions)
    placed[shell.clamped] = shell.rest_positions[shell.clamped] if held is None else held
    return placed


def led_rates(shell: Shell, rates: Array, x: Array, dt: float, held: Array | None) -> Array:
    """Velocities (n, 3) [m/s] that supports allow, and that lead the held vertices to ``held`` within a step."""
    led = shell.unknowns.project(rates, shell.mass)
    led[shell.clamped] = 0.0 if held is None else (held - x[shell.clamped]) / dt
    return led


def pull_rate(body: Body, x: Array, dt: float) -> Array | float:
    """Rate [N/s] at which supports that move in this step change the gradient at ``x``; see ElasticEnergy.pull."""
    if body.shell is body.start_shell:
        return 0.0
    return body.start_shell.elastic_energy.pull(x, body.shell.elastic_energy) / dt


def inner_force(shell: Shell, x: Array, rates: Array, damping: Damping, by_supports: Array | float = 0.0) -> Array:
    """Elastic force and the damping that follows strain rates (n, 3) [N].

    ``by_supports`` (n, 3) [N/s] is the :func:`pull_rate` of moving supports.
    """
    force: Array = -shell.energy_gradient(x)[1]
    if damping.stiffness_factor or shell.has_dashpots:
        force += shell.damping_force(x, rates, damping.stiffness_factor) - damping.stiffness_factor * by_supports
    return force


def step_potential(
    body: Body, x: Array, rates: Array, dt: float, load: Array, damping: Damping, viscosity: Array | None = None
) -> tuple[Potential, float]:
    """``E + |y - x|^2 (M/h^2 + C/h) / 2 - (f + M v/h).(y - x)`` of a step from x (n, 3), rates v; and its scale.

    ``viscosity`` is the viscous matrix, if there is one.
    """
    shell = body.shell
    push = load + shell.mass[:, None] * rates / dt
    problem = Potential(
        push,
        x,
        shell,
        body.factoriser,
        body.costs,
        body.live,
        quadratic=None if viscosity is None else viscosity / dt,
        inertia=shell.mass * (1.0 / dt**2 + damping.mass_factor / dt),
        kept_within=np.inf,
    )
    return problem, problem.scale_at(x)
