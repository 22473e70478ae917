"""Base of full models, whose unknowns are the vertices: Newton statics and time steps."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_number
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Timings
from modalshell.core.typing import Array, Index
from modalshell.core.units import at_most
from modalshell.integrators.free_parts import FreeParts
from modalshell.integrators.full import ExplicitEuler, FullIntegrator
from modalshell.integrators.full.base import hold, oscillation
from modalshell.integrators.state import CREASES, MotionState
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium, where_level
from modalshell.models.base.free_statics import balanced, goes_along, pushed_share, refuse_drifting
from modalshell.models.base.full_stepper import FullStepper
from modalshell.models.base.model import RIGID_LOAD, Model
from modalshell.models.base.sensitivity import Tangent, checked_names, checked_state, checked_weights
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import Stepper
from modalshell.modes import Factoriser, TangentStiffness, largest_eigenvalue, lowest_tangent_eigenvalue
from modalshell.modes.rigid import left_free
from modalshell.shell import EXACT, Shell
from modalshell.shell.damping import Damping
from modalshell.statics.bifurcation import BIFURCATION, LIMIT
from modalshell.statics.boundary import continue_boundary, missed_by, reactions_of
from modalshell.statics.continuation import equilibrium
from modalshell.statics.creases import equilibrium_with_creases
from modalshell.statics.flutter import without_flutter
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.newton import Factored
from modalshell.statics.path import Followable
from modalshell.statics.potential import Potential
from modalshell.statics.refine import refine
from modalshell.statics.verdict import verdict
from modalshell.supports import Pose, SupportPath, Unknowns
from modalshell.supports.constraints import Constraint, HeldPatch, held_patches

_ENDS = {LIMIT: "limit point", BIFURCATION: "bifurcation"}
_LEFT = "symmetry was broken: a saddle was left along its unstable mode, to the lower of both sides"
_KEPT = 1e-5
"""Move, in sizes of the shell, within which statics keep a factor that takes in internal unknowns: it costs four times
that of a hinge shell, for which another factor is as cheap as a second solve."""
_ROUNDING = 1e-10
"""Share of the mean diagonal entry of a Hessian below which an eigenvalue counts as zero."""


class FullModel(Model):
    """A model in which every vertex is an unknown; its energies are those of its shell's elements.

    Statics is Newton's method; ``residual`` is the out-of-balance force over the load, or without one over the forces
    at the start, accepted at 1e-7. From a start (a cheaper model's answer, say) the whole load is tried at once, and
    where that fails the potential is minimised from there. Without a start the load is applied in steps that grow and
    shrink with the solver's success; where a step ends at no minimum (the shell snaps) the potential is minimised from
    the last stable state instead, as the shell would move in a thick fluid; ``message`` names the limit point or
    bifurcation that ends the branch. A saddle on the way is left along its unstable mode, to the lower of both sides,
    and ``message`` says so. Patches under constraints are led to their targets as moving boundaries; ``residual`` there
    is relative to load and reactions. Parts that may drift bear dead loads in balance, put back where they were; other
    loads push them away. The parameters are those of :class:`modalshell.DiscreteShell`.

    Attributes
    ----------
    costs : dict
        Seconds of assembly, factorisation and solution so far.
    """

    of_material = True
    """Whether the energies are those of the shell's material."""
    follows_snaps = True

    def __init__(
        self,
        shell: Shell,
        *,
        integrator: str | FullIntegrator = "composite",
        allow_unstable_step: bool = False,
        step_tolerance: float = 1e-6,
        backend: str | None = None,
    ) -> None:
        self.shell = checked_kind("shell", shell, Shell)
        self.integrator: FullIntegrator = FullIntegrator.chosen(integrator)
        self.allow_unstable_step = allow_unstable_step
        self._largest_eigenvalue: float | None = None
        self.step_tolerance = checked_number("step_tolerance", step_tolerance, above=0.0, at_most=1e-2)
        self.factoriser = Factoriser(backend)
        self.costs = Timings()
        self.live: LiveLoads | None = None
        self.drag: Array | None = None
        self._start_shell: Shell | None = None
        self._carried: tuple[Shell, SupportPath, float, float] | None = None
        self._free_parts: tuple[Unknowns, FreeParts | None] | None = None

    def stepped_by(self, integrator: str | FullIntegrator) -> Self:
        """The same model with another rule of its steps."""
        other = copy.copy(self)
        other.integrator = FullIntegrator.chosen(integrator)
        return other

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        return self._solve_live(Loading(self.shell.rest_positions, load), start)

    def _solve_live(self, loading: Loading, start: Array | None) -> Equilibrium:
        if not left_free(self.shell) or (loading.live and not goes_along(self.shell, loading)):
            return where_level(self._solve_constrained(loading, start, ()), loading, self._curves_down)
        if (share := self.rigid_load(loading.dead)) > RIGID_LOAD:
            x = np.array(self.shell.rest_positions if start is None else start)
            return Equilibrium(x, Outcome.NO_EQUILIBRIUM, "", 0, share, None, creases=self.shell.crease_state)

        def solve(shell: Shell, begin: Array | None) -> Equilibrium:
            model = copy.copy(self)
            model.shell, model.factoriser = shell, Factoriser(self.factoriser.backend)
            end = model._solve_constrained(loading, begin, ())
            return where_level(end, loading, model._curves_down, drifts=True)

        return balanced(self.shell, loading, start, solve)

    def rigid_load(self, load: Array) -> float:
        """Share of a load (n, 3) along free translations; free turns can find a balance."""
        return pushed_share(self.shell, load) if load.any() else 0.0

    def _patches(self, constraints: Sequence[Constraint]) -> list[HeldPatch]:
        return held_patches(constraints, self.shell.rest_positions, self.shell.mesh.faces, self.shell.unknowns)

    def _solve_constrained(
        self, loading: Loading, start: Array | None, constraints: Sequence[Constraint]
    ) -> Equilibrium:
        load, before = loading.dead, dict(self.costs)
        patches = self._patches(constraints)
        problem, origin = self.problem(loading)
        first = None if start is None else hold(self.shell, start) - origin
        shell, live, kept = problem.shell, problem.live, problem.shell.crease_state
        if patches:
            shell.refuse_creases("an equilibrium under constraints", "leave out one of both")
        with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
            if patches:
                # The load comes with the first step: a loose shell may have no rest of its own under it.
                own = Factoriser(self.factoriser.backend)
                result = continue_boundary(shell, load, first, patches, origin, own, self.costs, live)
            elif kept is not None:
                result, kept = equilibrium_with_creases(problem, first)
            else:
                result = refine(problem, equilibrium(problem, first), problem.scale_at(first))
            result = result if patches else without_flutter(problem, result)
        notes = [f"a stable branch ends at a {_ENDS[kind]} at {share:.4g} of the load" for kind, share in result.jumps]
        note = "; ".join([*dict.fromkeys(notes), *[_LEFT] * result.left_saddle])
        if not result.converged and not patches:
            note = left_free(self.shell) or note
        return Equilibrium(
            result.point + origin if origin.any() else result.point,
            *verdict(result.residual, result.stable, limited=result.limited, note=note, follows=problem.unsymmetric),
            result.iterations,
            result.residual,
            result.stable,
            costs=self.costs.since(before),
            constraint_residuals=missed_by(constraints, patches, result.point, origin),
            constraint_reactions=reactions_of(shell, constraints, patches, result.point, load, live),
            creases=kept,
        )

    def _solve_touching(
        self, loading: Loading, start: Array | None, contacts: Sequence[Any], constraints: Sequence[Constraint]
    ) -> Equilibrium:
        from modalshell.models.base.touching import equilibrium_on_contacts  # not without contacts

        self.shell.refuse_creases("an equilibrium with contacts", "let a motion come to rest, or leave out one of both")
        problem, origin = self.problem(loading)
        first = None if start is None else hold(self.shell, start)
        return equilibrium_on_contacts(
            problem, origin, first, contacts, constraints, self.costs, lambda: self._near_contacts(loading, contacts)
        )

    def _near_contacts(self, loading: Loading, contacts: Sequence[Any]) -> Array | None:
        """Positions (n, 3) [m] near the equilibrium with contacts, from a cheaper model; None without one."""
        return None

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest eigenvalue [1/s^2] of the tangent stiffness, loads' too, over the mass; 0 where it is singular."""
        model = self if answer.creases is None else self.with_creases(answer.creases.angles)
        of_load = answer.load_matrix(model.shell.pattern)
        return model.lowest_eigenvalue(answer.positions, of_load, symmetric=answer.conservative)

    def lowest_eigenvalue(self, positions: Array, of_load: Any = None, *, symmetric: bool = True) -> float:
        """As :func:`.lowest_tangent_eigenvalue` at ``positions`` (n, 3) [m]; 0 where it is singular."""
        x = self.shell.checked_positions(positions)
        try:
            return lowest_tangent_eigenvalue(self.shell, x, of_load, symmetric=symmetric)
        except SolverError:
            return 0.0

    def centred(self) -> tuple[Self, Array]:
        """The same model about the origin, where coordinates have the smallest rounding, and where its origin was."""
        shell, origin = self.shell.centred()
        if not origin.any():
            return self, origin
        model = copy.copy(self)
        model.shell = shell
        return model, origin

    def problem(self, loading: Loading) -> tuple[Potential, Array]:
        """The potential under a load about the origin (see :meth:`centred`), and where its origin was (3,) [m]."""
        model, origin = self.centred()
        live = LiveLoads(loading, origin=origin) if loading.live else None
        return model._statics(loading.dead, live), origin

    @abstractmethod
    def holding(self, vertices: Index) -> FullModel:
        """The same model, with further vertices held."""

    def _statics(self, load: Array, live: LiveLoads | None = None) -> Potential:
        kept_within = _KEPT if self.shell.pattern.internal is not None else 0.0
        rest = self.shell.rest_positions
        return Potential(load, rest, self.shell, self.factoriser, self.costs, live, kept_within=kept_within)

    def sensitivity(self, state: Equilibrium, wrt: str | Sequence[str], *, of: ArrayLike | None = None) -> Array:
        """Derivative of an equilibrium, by the implicit-function theorem.

        With the out-of-balance force r(x, theta), ``dx/dtheta = -(dr/dx)^-1 dr/dtheta`` on the free unknowns: one
        factorisation of the tangent stiffness, and one solve for each of the k columns; or one solve alone with ``of``.
        As :meth:`Model.sensitivity`, by every constant of the material that is one number for the whole mesh ("young",
        "poisson", "thickness", "density" of an Isotropic; "stretch", "shear", "flexure", "density" of a Material), and
        by "supports": positions of the vertices that supports hold (k = 3 each, in the order of their numbers, along
        what they leave free zero), clamped edges keeping their slope.
        """
        refuse_drifting(self.shell, "sensitivity")
        loading = checked_state(state).loading
        assert loading is not None
        self.shell.checked_positions(state.positions)
        self.shell.refuse_creases("a derivative of an equilibrium")
        names, weights = checked_names(wrt), checked_weights(of, self.shell)
        tangent = self.tangent(state, loading)
        for name in names:
            tangent.check(name, adjoint=weights is not None)
        if weights is None:
            return np.concatenate([tangent.forward(name) for name in names], axis=2)
        solved = tangent.solve(weights)
        return np.concatenate([tangent.adjoint(name, solved, weights) for name in names])

    def tangent(self, state: Equilibrium, loading: Loading, factor: Factored | None = None) -> Tangent:
        """The tangent at a state under a load, with the factor of its exact Hessian where that is known."""
        live = LiveLoads(loading) if loading.live else None
        return Tangent(self._statics(loading.dead, live), state, of_material=self.of_material, factor=factor)

    def followable(self, load: Array) -> Followable:
        """The shell about the origin, every vertex an unknown."""
        self.shell.refuse_creases("a path of equilibria")
        model, origin = self.centred()
        restrict = model.shell.unknowns.restrict
        return Followable(
            model._statics(load),
            lambda x: x + origin,
            lambda positions: hold(self.shell, positions) - origin,
            lambda _, force: np.asarray(restrict(force.ravel())),
        )

    def stable_step(self, damping: Damping | None = None) -> float:
        """Largest stable step [s] of the integrator at the rest shape; of explicit Euler if the integrator is implicit.

        The stiffest mode decides, and is found by Lanczos on ``M^-1 K``. Dashpots add their own largest rate.
        """
        if self._largest_eigenvalue is None:
            self._largest_eigenvalue = largest_eigenvalue(self.shell)
        squared = self._largest_eigenvalue
        damping = damping or Damping()
        viscosity = damping.stiffness_factor * squared
        if self.shell.has_dashpots:
            viscosity += largest_eigenvalue(self.shell, self.shell.damping_matrix(self.shell.rest_positions, 0.0))
        rule = self.integrator if self.integrator.explicit else ExplicitEuler()
        return rule.stable_step(squared, damping.mass_factor, viscosity)

    def is_saddle(self, state: MotionState) -> bool:
        """Whether the potential has negative curvature; False for a shell without supports."""
        return bool(self.shell.unknowns.supported.any() and self.as_creased(state)._curves_down(state.coordinates))

    def _curves_down(self, x: Array) -> bool | None:
        """Whether the potential has negative curvature, beyond rounding, at x (n, 3) [m]; None where not known."""
        problem = self._statics(np.zeros_like(x))
        hessian = problem.linearise(x, EXACT)[1]
        if problem.definite_factor(hessian) is not None:
            return False
        rounding = _ROUNDING * float(np.abs(hessian.diagonal()).mean() / self.shell.mass.mean())
        try:
            return TangentStiffness(self.shell, hessian, self.factoriser).curves_down(rounding)
        except SolverError:
            return None

    def check_step(self, dt: float, damping: Damping) -> None:
        """Refuse an explicit step above the stability estimate."""
        super().check_step(dt, damping)
        if self.integrator.explicit and not self.allow_unstable_step and dt > (stable := self.stable_step(damping)):
            raise OptionError(
                f"dt must be at most {at_most(stable, 3)} s by {self.integrator.name} on this shell (got {dt:.3g} s): "
                "shorten it, take integrator 'composite', or allow_unstable_step = true"
            )

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest."""
        x = self.shell.rest_positions if positions is None else self.shell.checked_positions(positions)
        return self.integrator.start(self, hold(self.shell, x))

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m]: the coordinates themselves, copied."""
        return state.coordinates.copy()

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s]: the rates themselves."""
        return state.rates

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error (n, 3) [m] that a step has made, by the integrator's theory."""
        return self.integrator.local_error(before, after, dt)

    def growth(self, stiffness: float, damp: float, dt: float) -> complex:
        """What steps multiply an oscillation by, by the integrator's theory."""
        return self.integrator.growth(oscillation(stiffness, damp, dt))

    def as_creased(self, state: MotionState) -> Self:
        """The model whose creases have the plastic folds of a state; itself where it has none."""
        return self.with_creases(state.memory[CREASES]) if CREASES in state.memory else self

    def with_creases(self, angles: Array) -> Self:
        """The model whose creases have plastic folds (C,) [rad]."""
        model = copy.copy(self)
        model.shell = self.shell.creased(angles)
        if self._start_shell is not None:
            model._start_shell = self._start_shell.creased(angles)
        if self._carried is not None:
            model._carried = self._carried[0].creased(angles), *self._carried[1:]
        return model

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy [J], with what the hardening of creases has stored."""
        return self.as_creased(state).shell.stored_energy(self.positions(state))

    def stepper(self, setup: MotionSetup, *, in_frame: bool = False) -> Stepper:
        """What takes the steps of one motion; patches under constraints are moved as boundaries."""
        patches = self._patches(setup.constraints)
        model = self.holding(np.concatenate([patch.vertices for patch in patches])) if patches else self
        in_frame |= self.shell.unknowns.matrix is not None  # supports of single components turn with their frame
        return FullStepper(model, setup.felt_by(self.integrator), patches, in_frame=in_frame)

    @property
    def free_parts(self) -> FreeParts | None:
        """Parts of the shell that nothing holds, kept as long as its supports are."""
        if self._free_parts is None or self._free_parts[0] is not self.shell.unknowns:
            self._free_parts = self.shell.unknowns, FreeParts.of(self.shell)
        return self._free_parts[1]

    @property
    def start_shell(self) -> Shell:
        """The shell with what clamps its edges where it is at the beginning of a step."""
        return self._start_shell or self.shell

    def shell_at(self, share: float) -> Shell:
        """The shell with what clamps its edges where it is at a ``share`` of the rule's step."""
        if self._carried is None:
            return self.shell
        shell, path, begin, dt = self._carried
        return shell.posed(path.at(begin + share * dt).to_world)

    def carried(self, path: SupportPath, rule: tuple[float, float], begin: float = 0.0, end: float = 0.0) -> Self:
        """The model for moving supports, which take along what clamps edges, from one share of a step to another.

        ``rule`` are the time and the length [s] of the rule's step.
        """
        model = copy.copy(self)
        model._carried = self.shell, path, *rule
        if (after := model.shell_at(end)) is self.shell:
            return self
        model.shell, model._start_shell = after, model.shell_at(begin)
        return model

    def placed(self, state: MotionState, pose: Pose) -> MotionState:
        """``state``, relative to the supports, at a pose of these and their speed; what the integrator keeps turns."""
        turned = {name: kept @ pose.rotation.T if kept.ndim == 2 else kept for name, kept in state.memory.items()}
        rates = pose.world_velocities(state.coordinates, state.rates)
        return MotionState(pose.to_world(state.coordinates), rates, turned)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step of the integrator; for implicit ones, whether the solve converged."""
        return self.integrator.step(self, state, dt, load, damping, held)

    def under(self, live: LiveLoads, before: Array, dt: float) -> Self:
        """The model under loads that change within a step of ``dt`` [s] from the positions ``before`` (n, 3) [m]."""
        body = copy.copy(self)
        body.live = replace(live, before=before, rate=1.0 / dt)
        return body
