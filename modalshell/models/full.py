"""Full models, whose unknowns are the vertices: statics by Newton's method, and steps by four integrators."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from modalshell.checks import checked_choice, checked_kind, checked_number
from modalshell.constraints.constraints import Constraint, held_patches
from modalshell.errors import OptionError, SolverError
from modalshell.models.base import Damping, Equilibrium, Model, MotionState
from modalshell.modes import Factoriser, largest_eigenvalue, lowest_tangent_eigenvalue
from modalshell.shell import Shell
from modalshell.statics.boundary import lead
from modalshell.statics.full import equilibrium, scale_of
from modalshell.statics.newton import Potential, solve
from modalshell.statics.refine import refine
from modalshell.statics.verdict import verdict
from modalshell.timings import Timings
from modalshell.typing import Array, Index

_LEFT = "symmetry was broken: a saddle was left along its unstable mode, to the lower of both sides"
Integrator = Literal["implicit", "linear_implicit", "explicit", "verlet"]


class FullModel(Model):
    """A model in which every vertex is an unknown; its energies are those of its shell's elements.

    Statics is Newton's method; ``residual`` is the out-of-balance force over the load, accepted at 1e-7. From a start
    (a cheaper model's answer, say) the whole load is tried at once, and where that fails the potential is minimised
    from there. Without a start the load is applied in steps that grow and shrink with the solver's success; where a
    step ends at no minimum (the shell snaps) the potential is minimised from the last stable state instead, as the
    shell would move in a thick fluid. A saddle on the way is left along its unstable mode, to the lower of both sides,
    and ``message`` says so. Patches under constraints are led to their targets
    as moving boundaries; ``residual`` there is relative to load and reactions.

    Parameters
    ----------
    shell : Shell
        The shell.
    integrator : {"implicit", "linear_implicit", "explicit", "verlet"}
        ``"implicit"``: implicit Euler, solved to ``step_tolerance`` (first order, stable at any step, loses energy).
        ``"linear_implicit"``: one Newton step of it [baraff1998], Hessian projected; first order too, and stable as
        long as one linearisation serves a step. ``"explicit"``: explicit Euler with the new velocity moving the
        positions (symplectic, first order, the paper's choice for DS, stable below :meth:`stable_step` only).
        ``"verlet"``: velocity Verlet with centred mass damping (symplectic, second order, but first in the damping
        that follows strain rates; stable below :meth:`stable_step` only).
    allow_unstable_step : bool
        Whether explicit Euler and Verlet may go on above their stability estimate.
    step_tolerance : float
        Out-of-balance force at which an implicit step's Newton stops, as a share of its load and inertia.
    backend : str, optional
        Factorisation to use; see :func:`modalshell.modes.available_backends`.

    Attributes
    ----------
    costs : dict
        Seconds of assembly, factorisation and solution so far.
    """

    takes_constraints = True

    def __init__(
        self,
        shell: Shell,
        *,
        integrator: Integrator = "implicit",
        allow_unstable_step: bool = False,
        step_tolerance: float = 1e-6,
        backend: str | None = None,
    ) -> None:
        checked_choice("integrator", integrator, get_args(Integrator))
        self.shell = checked_kind("shell", shell, Shell)
        self.integrator: Integrator = integrator
        self.allow_unstable_step = allow_unstable_step
        self._largest_eigenvalue: float | None = None
        self.step_tolerance = checked_number("step_tolerance", step_tolerance, above=0.0, at_most=1e-2)
        self._factoriser = Factoriser(backend)
        self.costs = Timings()

    def _solve(self, load: Array, start: Array | None, constraints: Sequence[Constraint]) -> Equilibrium:
        before = dict(self.costs)
        patches = held_patches(constraints, self.shell) if constraints else []
        first = None if start is None else self._held(start)
        # About the origin, where coordinates have the smallest rounding.
        model = copy.copy(self)
        model.shell, origin = self.shell.centred()
        if origin.any() and first is not None:
            first = first - origin
        with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
            if patches:
                # The load comes with the first step: a loose shell may have no rest of its own under it.
                result = lead(
                    model.shell, load, first, patches, origin, Factoriser(self._factoriser.backend), self.costs
                )
            else:
                problem = model._statics(load)
                result = refine(problem, equilibrium(problem, first), scale_of(problem, first))
        return Equilibrium(
            result.positions + origin if origin.any() else result.positions,
            *verdict(result.residual, result.stable, limited=result.limited, note=_LEFT if result.left_saddle else ""),
            result.iterations,
            result.residual,
            result.stable,
            costs=self.costs.since(before),
            constraint_residuals=np.zeros(len(constraints)),
        )

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:  # noqa: ARG002 (dead loads)
        """Lowest eigenvalue [1/s^2] of the tangent stiffness over the mass; 0 where it is singular to the last bit."""
        return self.lowest_eigenvalue(answer.positions)

    def lowest_eigenvalue(self, positions: Array) -> float:
        """Lowest eigenvalue [1/s^2] of the tangent stiffness over the mass at ``positions`` (n, 3) [m]."""
        try:
            return lowest_tangent_eigenvalue(self.shell, positions)
        except SolverError:
            return 0.0

    @abstractmethod
    def holding(self, vertices: Index) -> FullModel:
        """The same model, with further vertices held."""

    def _held(self, positions: Array, held: Array | None = None) -> Array:
        """``positions`` with the held vertices where they belong: at ``held`` (h, 3), or at rest."""
        placed = positions.copy()
        placed[self.shell.clamped] = self.shell.rest_positions[self.shell.clamped] if held is None else held
        return placed

    def _statics(self, load: Array) -> Potential:
        return Potential(self.shell, load, self.shell.rest_positions, self._factoriser, self.costs)

    def stable_step(self, damping: Damping | None = None) -> float:
        """Largest stable step of explicit Euler, or of Verlet if that is the integrator, at the rest shape [s].

        For one mode, ``v+ = v - h (omega^2 x + c v)``, ``x+ = x + h v+`` is stable while
        ``h^2 omega^2 + 2 h c < 4``; with ``c = xi + zeta omega^2`` the stiffest mode decides, and is found by Lanczos
        on ``M^-1 K``. Dashpots add their own largest rate. Verlet takes xi at mid-step, which leaves it out of c.
        """
        if self._largest_eigenvalue is None:
            self._largest_eigenvalue = largest_eigenvalue(self.shell)
        squared = self._largest_eigenvalue
        damping = damping or Damping()
        c = damping.stiffness_factor * squared + (self.integrator != "verlet") * damping.mass_factor
        if self.shell.has_dashpots:
            c += largest_eigenvalue(self.shell, self.shell.damping_matrix(self.shell.rest_positions, 0.0))
        return float((np.sqrt(c**2 + 4.0 * squared) - c) / squared)

    def check_step(self, dt: float, damping: Damping) -> None:
        """Refuse an explicit step above the stability estimate."""
        if self.integrator in ("explicit", "verlet") and not self.allow_unstable_step:
            stable = self.stable_step(damping)
            if dt > stable:
                name = {"explicit": "explicit Euler", "verlet": "Verlet"}[self.integrator]
                raise OptionError(
                    f"{name} needs a step of at most {stable:.3g} s on this shell (got {dt:.3g} s): shorten "
                    "the step, use integrator='implicit', or pass allow_unstable_step=True"
                )

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest."""
        x = self._held(self.shell.rest_positions if positions is None else self.shell.checked_positions(positions))
        rates = np.zeros_like(x)
        inner = self._inner_force(x, rates, Damping()) if self.integrator == "verlet" else None
        return MotionState(x, rates, inner)

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m]: the coordinates themselves."""
        return state.coordinates

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step of the integrator; for implicit ones, whether the solve converged."""
        advance = {
            "implicit": self._implicit,
            "linear_implicit": self._linear_implicit,
            "explicit": self._explicit,
            "verlet": self._verlet,
        }[self.integrator]
        return advance(state, dt, load, damping, held)

    def _inner_force(self, x: Array, rates: Array, damping: Damping) -> Array:
        """Elastic force and the damping that follows strain rates (n, 3) [N]."""
        force = -self.shell.energy_gradient(x)[1]
        if damping.stiffness_factor or self.shell.has_dashpots:
            force += self.shell.damping_force(x, rates, damping.stiffness_factor)
        return force

    def _explicit(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        shell, x = self.shell, state.coordinates
        force = load + self._inner_force(x, state.rates, damping)
        rates = state.rates * (1.0 - dt * damping.mass_factor) + dt * force / shell.mass[:, None]
        rates[shell.clamped] = 0.0 if held is None else (held - x[shell.clamped]) / dt
        return MotionState(x + dt * rates, rates), True

    def _verlet(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """``x+ - 2 x + x- = h^2 a`` as two half kicks about a drift; the inner force is carried, one a step."""
        shell, x = self.shell, state.coordinates
        drag, kick = 0.5 * dt * damping.mass_factor, 0.5 * dt / shell.mass[:, None]
        assert state.carried is not None
        inner = state.carried
        middle = state.rates * (1.0 - drag) + kick * (load + inner)
        middle[shell.clamped] = 0.0 if held is None else (held - x[shell.clamped]) / dt
        x = x + dt * middle
        inner = self._inner_force(x, middle, damping)
        rates = (middle + kick * (load + inner)) / (1.0 + drag)
        rates[shell.clamped] = middle[shell.clamped]
        return MotionState(x, rates, inner), True

    def _step_potential(self, state: MotionState, dt: float, load: Array, damping: Damping) -> tuple[Potential, float]:
        """``E + |x - x_n|^2 (M/h^2 + C/h) / 2 - (f + M v/h).(x - x_n)``, C at the step's beginning; and its scale."""
        shell, x = self.shell, state.coordinates
        quadratic = np.zeros(shell.pattern.indices.size)
        if damping.stiffness_factor or shell.has_dashpots:
            quadratic = shell.damping_matrix(x, damping.stiffness_factor) / dt
        quadratic[shell.pattern.diagonal] += np.repeat(shell.mass, 3) * (1.0 / dt**2 + damping.mass_factor / dt)
        push = load + shell.mass[:, None] * state.rates / dt
        problem = Potential(shell, push, x, self._factoriser, self.costs, quadratic)
        return problem, problem.scale or float(np.linalg.norm(problem.residual(x))) or 1.0

    def _implicit(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Minimise the step's potential."""
        x = state.coordinates
        problem, scale = self._step_potential(state, dt, load, damping)
        start = self._held(x + dt * state.rates, held)
        result = solve(problem, start, scale, self.step_tolerance, self.shell.predicted_stresses(x, start - x))
        return MotionState(result.positions, (result.positions - x) / dt), result.converged

    def _linear_implicit(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """One Newton step on the step's potential from where the shell is, Hessian projected [baraff1998, eq. 6]."""
        x, free = state.coordinates, self.shell.free_unknowns
        problem, _ = self._step_potential(state, dt, load, damping)
        moved = self._held(x, held) - x
        gradient, hessian = problem.linearise_led(x, moved)
        factor = problem.definite_factor(hessian)
        if factor is None:
            return MotionState(x.copy(), np.zeros_like(x)), False
        moved.reshape(-1)[free] = problem.step(factor, gradient)
        return MotionState(x + moved, moved / dt), True
