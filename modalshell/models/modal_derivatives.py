"""MD-ROM: the true energy on modes and their derivatives, with cubature [barbic2005; an2008]."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_count, checked_kind
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array, Index
from modalshell.integrators.full import FullIntegrator
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import MotionState
from modalshell.kernels.rotations import largest_turn
from modalshell.loads import Loading
from modalshell.models.base.bars import bar_on_shell
from modalshell.models.base.distortion import Distortion
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.implicit import ImplicitModel, LoadAt, implicit_rule, slowed
from modalshell.models.base.model import probes
from modalshell.models.base.reduced_sensitivity import LinearTangent, dead_state, gradients_by_rest_angles
from modalshell.models.base.setup import MotionSetup
from modalshell.models.reduction.cubature import MUCH_KEPT, Cubature, checked_loads, default_loads, train
from modalshell.models.reduction.derivatives import modal_derivatives
from modalshell.models.reduction.free_flight import Anchored, LinearShape, ReducedFlight, frames_of
from modalshell.models.reduction.reduced_energy import ReducedEnergy, ReducedPotential
from modalshell.modes import model_basis
from modalshell.shell import GAUSS_NEWTON, Shell
from modalshell.shell.damping import Damping
from modalshell.statics.continuation import equilibrium
from modalshell.statics.newton import mixed_newton
from modalshell.statics.path import Followable
from modalshell.statics.verdict import verdict
from modalshell.supports.constraints import Constraint

_STEP_GOAL = 1e-6
"""Out-of-balance force, as a share of load and inertia, at which an implicit step's Newton stops."""

_HOLDS = 0.1
"""Error bar of an answer under contacts from which a message tells of it."""
_LOCKED = "its vectors may not hold the shell's shape under the contacts ({}): take coarse DS or DS"


@final
class ModalDerivatives(ImplicitModel):
    """MD-ROM: ``x = X + U z``, U of modes and modal derivatives, under the shell's own energy of x.

    Stiffening, twist and couplings of modes come from the energy itself, and a linear basis with derivatives holds
    turns up to about 90 degrees. Its shapes stretch a little, though, at fourth order in the turn, and a membrane that
    is very much stiffer than the bending makes that count: a strip whose tip turns by 38 degrees is 0.1 % off at a
    length over thickness of 100, 3 % at 300 and 17 % at 1,000.

    Statics finds a minimum of ``E(X + U z) - f.U z``, from rest along a growing load, or from a start; ``residual`` is
    ``|grad E - p| / |p|`` of the reduced forces in the norm of the inverse rest stiffness, without a load over the
    forces at the start, accepted at 1e-7. It does not measure what the basis cannot represent. Parts without supports
    fly in frames of their own, bent by U there.

    Parameters
    ----------
    shell : Shell
        A shell, each part of which supports hold or do not touch.
    count : int
        Number of modes, the rigid ones among them; with the derivatives of m elastic modes there are up to
        ``m + m (m + 1) / 2`` coordinates.
    cubature : bool or int
        Whether to sum the energy over few weighted elements that are found in training: as many as it takes for 0.5 %
        on the training loads, or at most this number.
    training_loads : sequence of array_like, shape (n, 3), optional
        Loads [N] to train on; every fourth is held out and only tells the error. Without it
        :func:`modalshell.models.reduction.cubature.default_loads`.
    backend : str, optional
        Factorisation to use; see :class:`modalshell.modes.Factoriser`.
    integrator : str or FullIntegrator
        Rule of its steps: "bdf2", "composite", "sdirk2" or "implicit" (Euler).

    Attributes
    ----------
    basis : DerivativeBasis
        U and its parts.
    energy : ReducedEnergy
        The energy in use.
    cubature : Cubature or None
        Result of the training, with its error on held-out loads.
    flight : Anchored or ReducedFlight
        Frames of the parts that no support holds.

    Raises
    ------
    OptionError
        If supports leave a part some rigid motions, no elastic mode is left, or an option is out of range.
    """

    name = "MD-ROM"

    def __init__(
        self,
        shell: Shell,
        count: int = 8,
        *,
        cubature: bool | int = False,
        training_loads: Sequence[ArrayLike] | None = None,
        backend: str | None = None,
        integrator: str | FullIntegrator = "bdf2",
    ) -> None:
        self.integrator = implicit_rule(integrator)
        self.shell = checked_kind("shell", shell, Shell)
        self._distortion = Distortion(shell.mesh)
        most = None if isinstance(cubature, bool) else checked_count("cubature", cubature)
        loads = None if training_loads is None else checked_loads(training_loads, shell)
        modes = model_basis(shell, count, backend=backend)
        frames = frames_of(shell, modes.modes[:, : modes.rigid_modes], "ask for more modes")
        if modes.rigid_modes == modes.count:
            raise OptionError(
                f"modal derivatives need elastic modes (got {modes.count} rigid ones): ask for more modes"
            )
        self.basis = modal_derivatives(modes, backend=backend)
        self._vectors = self.basis.vectors
        self._shape = shape = LinearShape(shell, self._vectors)
        self.flight = Anchored(shape) if frames is None else ReducedFlight(shape, frames)
        self._scaling = np.sqrt(self.basis.eigenvalues)
        self.energy = ReducedEnergy(shell, self._vectors)
        self.cubature: Cubature | None = None
        if cubature:
            self.cubature = train(self.basis, self.energy, default_loads(self.basis) if loads is None else loads, most)
            self.energy = self.cubature.energy
            if self.cubature.share > MUCH_KEPT:
                warnings.warn(
                    f"cubature keeps {100.0 * self.cubature.share:.0f} % of the elements, which saves next to nothing: "
                    "leave it out for so few elements, or ask for fewer modes, or for a number of elements "
                    "(cubature=N), which costs accuracy",
                    ModalShellWarning,
                    stacklevel=2,
                )

    def coordinates_of(self, positions: ArrayLike) -> Array:
        """Coordinates (r,) of the mass-weighted projection of ``positions`` (n, 3), of free parts in their frames."""
        return self.flight.start(self.shell.checked_positions(positions))[self.flight.count :]

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        problem = self.statics_of(load)
        with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
            found = equilibrium(problem, None if start is None else self.coordinates_of(start))
        positions = self.positions_at(found.point)
        return Equilibrium(
            positions,
            *self._distortion.judged(*verdict(found.residual, found.stable), positions),
            found.iterations,
            found.residual,
            found.stable,
            coordinates=found.point,
        )

    def _solve_touching(
        self, loading: Loading, start: Array | None, contacts: Sequence[Any], constraints: Sequence[Constraint]
    ) -> Equilibrium:
        from modalshell.models.reduction.contact import reduced_equilibrium_on_contacts  # not without contacts

        if constraints:
            raise self.no_constraints()
        found = reduced_equilibrium_on_contacts(self, loading, start, contacts)
        outcome, message = self._distortion.judged(found.outcome, found.message, found.positions)
        if found.converged:  # limp sheets: the vectors may hold the load, but not the shape between the contacts
            bar = bar_on_shell(self.true_shell, found.positions, loading, contacts)
            if not (bar.valid and bar.displacement <= _HOLDS):
                message = "; ".join(part for part in (message, _LOCKED.format(bar)) if part)
        return replace(found, outcome=outcome, message=message)

    def contact_motion(self, setup: MotionSetup, origin: Array) -> Any:
        """What takes the steps of a motion with contacts."""
        from modalshell.models.reduction.contact import ReducedContactMotion  # not without contacts

        return ReducedContactMotion(self, setup, _STEP_GOAL)

    def statics_of(self, load: Array) -> ReducedPotential:
        """The potential under a load (n, 3) [N]."""
        push = load.ravel() @ self._vectors
        return ReducedPotential(push, np.zeros_like(push), self.energy, self._scaling, self.basis.edge_change)

    def sensitivity(self, state: Equilibrium, wrt: str | Sequence[str], *, of: ArrayLike | None = None) -> Array:
        """Derivative of an equilibrium under dead loads at a held span; see :class:`Model`.

        U stays as it was built: loads, the density, and Young's modulus of an :class:`Isotropic` leave its span as it
        is; a model that is built with another constant has another span, and with it another error. By rest angles
        it is that of the same energy on the same span, too. A model with cubature has derivatives by loads,
        the density, and constants that scale all its elements.
        """
        z, vectors = dead_state(state)[0], self._vectors
        hessian = self.energy.hessian(z)[2]
        x = self.positions_at(z)

        def by_constant(name: str) -> Array:
            if name == "young" and not self.shell.energies:  # of elements with weights, too
                return -self.energy.gradient(z)[1] / self.shell.material.young  # type: ignore[union-attr]
            self._refuse_cubature(name)
            return -(self.shell.rates_by_constant(name, x).ravel() @ vectors)

        def by_rest_angles() -> Array:
            self._refuse_cubature("rest_angles")
            return -gradients_by_rest_angles(self.shell, x, vectors)

        tangent = LinearTangent(self.shell, state, hessian, vectors, vectors, by_constant, by_rest_angles)
        return tangent.derivative(wrt, of)

    def _refuse_cubature(self, name: str) -> None:
        if self.cubature is not None:
            raise OptionError(f"cubature's weights were trained at one value of {name}: take cubature=False, or DS")

    def followable(self, load: Array) -> Followable:
        """The reduced potential, coordinates z as unknowns."""
        return Followable(
            self.statics_of(load),
            self.positions_at,
            self.coordinates_of,
            lambda _, force: force.ravel() @ self._vectors,
        )

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest eigenvalue [1/s^2] of the reduced Hessian, that of loads that follow in it."""
        if answer.coordinates is None:
            return None
        vectors, hessian = self._vectors, self.energy.hessian(answer.coordinates)[2]
        return answer.lowest_eigenvalue(hessian, self.shell.pattern, lambda: (vectors, vectors))

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest; with free parts, of the coordinates of their frames and z."""
        if positions is None:
            return self.integrator.at_rest(self.flight.whole(np.zeros(self.basis.size)))
        return self.integrator.at_rest(self.flight.start(self.shell.checked_positions(positions)))

    def march(self, state: MotionState, dt: float, load_at: LoadAt, damping: Damping) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s]; the integrator evaluates the loads at its own times and states."""
        return self.integrator.march(self.flight.steps(self, (state, dt), load_at, damping), state, dt)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error in the coordinates that a step has made, by the integrator's theory."""
        error = super().local_error(before, after, dt)
        return None if error is None else self.flight.local_error(error, before, after)

    def euler_step(self, start: EulerStart, load: Array, damping: Damping, size: float = 0.0) -> tuple[Array, bool]:
        """Minimise ``E + d.(I/h^2 + C/h) d / 2 - (p + v/h).d``, d the step of h of z.

        Forces of the whole step, to which the residual relates, are at least of a ``size``.
        """
        problem, scale = self.step_problem(start, load.ravel() @ self._vectors, damping)
        scale = max(scale, size)
        guess = start.origin + start.dt * start.rates
        stresses = problem.energy.predicted_stresses(start.near, np.zeros_like(guess))
        answer = mixed_newton(problem, guess, scale, goal=_STEP_GOAL, stresses=stresses)
        if not answer.converged:
            answer = problem.descend(start.near, scale)
        return answer.point, answer.converged

    def step_problem(
        self, start: EulerStart, push: Array, damping: Damping, fall: Array | None = None
    ) -> tuple[ReducedPotential, float]:
        """The potential of such a step under reduced forces (r,) at the rates expected, and the size of its forces.

        ``fall`` (r, r) [1/s] is by how much they are less per rate above these.
        """
        z, dt = start.origin, start.dt
        quadratic = np.eye(z.size) * (1.0 / dt**2 + damping.mass_factor / dt)
        if fall is not None:
            quadratic, push = quadratic + fall / dt, push + fall @ start.expected_rates
        push, eigenvalues, energy = push + start.rates / dt, self.basis.eigenvalues, self.energy
        if damping.stiffness_factor:
            energy = energy.damped(start, damping.stiffness_factor)
            eigenvalues = eigenvalues * (1.0 + damping.stiffness_factor / dt)
        scaling = np.sqrt(eigenvalues + np.diagonal(quadratic))
        problem = ReducedPotential(push, z, energy, scaling, self.basis.edge_change, quadratic=quadratic)
        return problem, problem.scale_at(z)

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small ``move`` (r,) of the coordinates."""
        moved = (self._vectors @ move).reshape(-1, 3)
        return float(largest_turn(self.positions_at(coordinates), moved, self.shell.mesh.faces))

    def largest_move(self, change: Array) -> float:
        """Largest displacement [m] of a vertex by a small ``change`` (r,), of those that the vectors move most."""
        return super().largest_move(self._probes @ change)

    @cached_property
    def _probes(self) -> Array:
        rigid = self.basis.modes.modes[:, : self.flight.count]
        eigenvalues = np.concatenate([np.zeros(self.flight.count), self.basis.eigenvalues])
        return probes(np.hstack([rigid, self._vectors]), eigenvalues, self.shell.mesh)

    def rows(self, vertices: Index) -> Array:
        """Rows (k, 3, r) that take rates to velocities of some vertices."""
        return np.asarray(self._vectors.reshape(-1, 3, self._vectors.shape[1])[vertices])

    def dragged(
        self, state: MotionState, before: MotionState, dt: float, damping: Damping, vertices: Index, drag: Array
    ) -> MotionState:
        """The reduced forces' fall ``-D (v - v_n)`` taken at the step's end."""
        z, rows = before.coordinates, self.rows(vertices)
        return slowed(state, before, dt, damping, self.energy.hessian(z, GAUSS_NEWTON)[2], rows, drag)

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state."""
        return self.flight.positions(state.coordinates)

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state; see :meth:`Model.velocities`."""
        return self.flight.velocities(state, own, lead)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of the rates, and of the frames of free parts."""
        return self.flight.kinetic_energy(state)

    def rigid_load(self, load: Array) -> float:
        """Share of a load (n, 3) that moves free parts as rigid bodies."""
        return self.flight.rigid_load(load)

    def fault(self, state: MotionState, positions: Array) -> Outcome | None:
        """Distorted where the surface stretched or folded over, by the criteria of all modal models."""
        return Outcome.DISTORTED if self._distortion.of(positions) else None

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy [J] as the model has it: by cubature if it is on."""
        return self.energy.value(state.coordinates[self.flight.count :])

    def positions_at(self, z: Array) -> Array:
        """Vertex positions (n, 3) [m] at coordinates z (r,)."""
        return self._shape.at(z)
