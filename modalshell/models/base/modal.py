"""Base of modal models: coordinates, time steps per mode, constraints, and the balance of rigid modes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import cast, final

import numpy as np
import scipy.linalg.lapack
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from modalshell.constraints.constraints import Constraint
from modalshell.constraints.manipulation import PatchTargets, meet
from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal import ImplicitEuler, ModalIntegrator
from modalshell.integrators.modal.base import ForceInTime
from modalshell.integrators.state import COST, Damping, MotionSetup, MotionState
from modalshell.loads import Loading
from modalshell.models.base.distortion import Distortion
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import LEAD, FrameModel, Model, Stepper, probes
from modalshell.models.base.reduced_sensitivity import ModalTangent
from modalshell.models.base.settle import self_consistent
from modalshell.models.base.warp import Warp
from modalshell.models.reduction.load_quadrature import LoadQuadrature
from modalshell.modes import Basis
from modalshell.modes.rigid import rigid_share
from modalshell.statics.dense import WorkPotential
from modalshell.statics.least_potential import WOUND_UP, Statics, Workable
from modalshell.statics.modal_balance import balance, differences
from modalshell.statics.path import Followable
from modalshell.supports import Pose

CONSTRAINT_MET = 1e-6
"""Residual of a constraint, as a share of the shell's size or in radians, above which it counts as not met."""

_FIXED_POINT = 1e-7
"""Relative change of the coordinates at which a fixed-point iteration has converged."""
_FIXED_POINT_LIMIT = 200
"""Fixed-point iterations at most."""
_OUT_OF_REACH_LIMIT = 20
"""Number of iterations after which unreached targets are abandoned."""
_STOPPED = 0.5
"""Change of the rates by a drag on them, within a step, as a share of the rates, from which it stops the shell."""
_EULER = ImplicitEuler()


class ModalModel(Warp, FrameModel):
    """A model whose unknowns are the m modal coordinates q.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    integrator : str or ModalIntegrator
        "exponential" (second order, exact where the modal forces do not turn), "implicit_euler" (first order, loses
        energy; that of the paper), "implicit_midpoint" (second order, keeps the energy of linear motion), the key of
        any other :class:`ModalIntegrator`, or a rule itself.
    """

    def __init__(self, basis: Basis, *, integrator: str | ModalIntegrator = "exponential") -> None:
        self.basis = checked_kind("basis", basis, Basis)
        self.shell = basis.shell
        self.integrator: ModalIntegrator = ModalIntegrator.chosen(integrator)
        self._identity = np.eye(basis.count)
        self._distortion = Distortion(self.shell.mesh)
        self._damp: tuple[Damping, Array] | None = None
        self._mass = np.repeat(self.shell.mass, 3)
        self._size = float(np.ptp(self.shell.rest_positions, axis=0).max())
        self._mass_size = self._size * float(np.sqrt(self.shell.mass.sum()))

    def sensitivity(self, state: Equilibrium, wrt: str | Sequence[str], *, of: ArrayLike | None = None) -> Array:
        """Derivative of an equilibrium under dead loads, that of the modes by the material with it; see :class:`Model`.

        Repeated eigenvalues do no harm, unless the basis ends within one. Rest angles act by the couples that they
        cause at rest, in the frame of the modes' own elastic forces.
        """
        return ModalTangent(self, state).derivative(wrt, of)

    def on_basis(self, basis: Basis) -> ModalModel:
        """The same model on another basis of its shell."""
        return type(self)(basis)

    def coordinates_of(self, positions: ArrayLike) -> Array:
        """Modal coordinates (m,) of the mass-weighted projection of ``positions`` (n, 3)."""
        displacement = (self.shell.checked_positions(positions) - self.shell.rest_positions).ravel()
        return np.asarray(self.basis.modes.T @ (self._mass * displacement))

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        """Static answer from the model's own :meth:`_free_statics`."""
        return self._answer(self._free_statics(load, self._first_coordinates(start)))

    def _solve_constrained(
        self, loading: Loading, start: Array | None, constraints: Sequence[Constraint]
    ) -> Equilibrium:
        def solve(load: Array, start: Array | None) -> Equilibrium:
            return self._constrained_answer(load, self._first_coordinates(start), constraints)

        return self_consistent(solve, loading, start) if loading.live else solve(loading.dead, start)

    def _solve_live(self, loading: Loading, start: Array | None) -> Equilibrium:
        """Static answer under loads that change, by Newton on the modal balance."""
        begin, basis = self._first_coordinates(start), self.basis

        def force(q: Array, factor: float) -> Array:
            positions = self.shell.rest_positions + self.raw_displacement(q)
            return factor * self.modal_force(q, loading.force(positions))

        def slope(q: Array, factor: float) -> Array:
            return differences(lambda q: force(q, factor), q, basis.rotations)

        with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as no fixed point
            found = balance(
                force, slope, basis.eigenvalues, basis.rigid_modes, self.largest_turn, begin, first_step=1.0, retry=True
            )
        return self._answer(found)

    def _first_coordinates(self, start: Array | None) -> Array | None:
        """Coordinates (m,) of a start (n, 3) of statics; SolverError where an elastic mode has no stiffness."""
        slack = np.flatnonzero(self.basis.eigenvalues[self.basis.rigid_modes :] <= 0.0)
        if slack.size:
            raise SolverError(
                f"elastic mode {slack[0]} has no stiffness (got eigenvalue 0), so that statics has no answer: give the "
                "material a stretch, shear and flexure above 0, or let simulate move the shell"
            )
        return None if start is None else self.coordinates_of(start)

    def _answer(self, found: Statics) -> Equilibrium:
        """The equilibrium at given coordinates."""
        positions = self.shell.rest_positions + self.raw_displacement(found.q)
        return Equilibrium(
            positions,
            *self._distortion.judged(found.outcome, found.message, positions),
            found.iterations,
            found.residual,
            found.stable,
            coordinates=found.q,
        )

    def largest_turn(self, q: Array) -> float:
        """Largest rotation [rad] of a part of the shell at q; a linear model knows none."""
        return 0.0

    @cached_property
    def _turns(self) -> Array | None:
        """Largest rotation [rad] of a part in each mode (m,); None where no mode has any."""
        turns = np.array([self.largest_turn(unit) for unit in self._identity])
        return turns if turns.any() else None

    def fault(self, state: MotionState, positions: Array) -> Outcome | None:
        """Wound up if a part rotated by more than 2 pi, distorted if the surface is stretched or folded over."""
        # Rotations are linear in q: what the modes' own largest ones add up to bounds them.
        q, turns = state.coordinates, self._turns
        if turns is not None and not np.abs(q) @ turns <= WOUND_UP and self.largest_turn(q) > WOUND_UP:
            return Outcome.WOUND_UP
        return Outcome.DISTORTED if self._distortion.of(positions) else None

    @abstractmethod
    def _free_statics(self, load: Array, start: Array | None) -> Statics:
        """Answer to a load (n, 3), from coordinates ``start`` (m,) if there are any."""

    def _constrained_answer(self, load: Array, start: Array | None, constraints: Sequence[Constraint]) -> Equilibrium:
        """Least modal energy under the constraints, the modal force iterated until it settles."""
        if self.basis.rigid_modes:
            raise OptionError(
                "statics under constraints needs a shell that its supports hold; clamp some vertices, or let simulate "
                "bring a free shell to rest with damping"
            )
        compliance = 1.0 / self.basis.eigenvalues
        q = np.zeros(self.basis.count) if start is None else start
        targets = self._targets(constraints, q)
        change, iterations, nearest = np.inf, 0, np.inf
        while change > _FIXED_POINT and iterations < _FIXED_POINT_LIMIT:
            if iterations == _OUT_OF_REACH_LIMIT and nearest > CONSTRAINT_MET:
                break
            before = q
            iterations += 1
            q, residual = meet(targets, compliance * self.modal_force(q, load), compliance, q)
            nearest = min(nearest, float(np.abs(residual).max()))
            work = float(np.sum(self.basis.eigenvalues * q**2)) or 1.0
            change = float(np.sqrt(np.sum(self.basis.eigenvalues * (q - before) ** 2) / work))
            if not load.any():  # no modal force that could still turn
                change = 0.0
        missed = targets.lengths(residual)
        outcome, message = Outcome.CONVERGED, ""
        if change > _FIXED_POINT and nearest <= CONSTRAINT_MET:
            outcome, message = Outcome.NO_FIXED_POINT, "the modal force under these constraints does not settle"
        elif np.abs(residual).max() > CONSTRAINT_MET:
            outcome, message = Outcome.OUT_OF_REACH, f"a constraint is left {missed.max():.2e} from its target"
        # The modal forces that are not in balance, as forces [N] and moments [N m] of the constraints.
        out_of_balance = self.basis.eigenvalues * q - self.modal_force(q, load)
        multipliers = np.linalg.lstsq(targets(q)[1].T, out_of_balance, rcond=None)[0].reshape(-1, 3)
        answer = self._answer(Statics(q, change, iterations, outcome, message))
        return replace(answer, constraint_residuals=missed, constraint_reactions=multipliers / targets.units[:, None])

    def followable(self, load: Array) -> Followable:
        """The modal potential, for models that know the work of a load and its derivatives."""
        if not self.conservative or not hasattr(self, "work"):
            return super().followable(load)
        if self.basis.rigid_modes:
            raise OptionError(f"a path needs a shell that its supports hold (got {self.basis.rigid_modes} rigid modes)")
        return Followable(
            WorkPotential(load, np.zeros(self.basis.count), cast("Workable", self)),
            lambda q: self.shell.rest_positions + self.raw_displacement(q),
            self.coordinates_of,
            lambda q, force: self.modal_force(q, force),
        )

    def rigid_load(self, load: Array) -> float:
        """Fraction of the load, in the modes' norm, on rigid modes, which have no resistance in statics."""
        if self.basis.rigid_modes == 0 or not load.any():
            return 0.0
        return rigid_share(self.shell, load)  # on all of them: the basis may have been asked for fewer

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest real part of the eigenvalues of ``Lambda - dp/dq`` [1/s^2]."""
        if answer.coordinates is None:
            return None
        tangent = np.diag(self.basis.eigenvalues) - self.modal_force_jacobian(answer.coordinates, load)
        return float(scipy.linalg.eigvals(tangent).real.min())

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion; constraints are met by the modal forces of least work."""
        return ModalStepper(self, setup)

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """Modal state at rest."""
        q = np.zeros(self.basis.count) if positions is None else self.coordinates_of(positions)
        return self.integrator.at_rest(q)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step of the integrator for every mode."""
        return self.march(state, dt, lambda q, *_: self.modal_force(q, load), damping), True

    def march(self, state: MotionState, dt: float, force: ForceInTime, damping: Damping) -> MotionState:
        """One step of the integrator under modal forces that are asked for where they are needed."""
        damp = self._modal_damping(damping)
        return self.integrator.advance(state, force, self.basis.eigenvalues, damp, dt, self._mass_size)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error (m,) in the coordinates that a step has made, by the integrator's theory."""
        return self.integrator.local_error(before, after, self.basis.eigenvalues, dt)

    def largest_move(self, change: Array) -> float:
        """Largest displacement [m] of a vertex by a small ``change`` (m,), of those that the modes move most."""
        return super().largest_move(self._probes @ change)

    @cached_property
    def _probes(self) -> Array:
        return probes(self.basis.modes)

    def growth(self, stiffness: float, damp: float, dt: float) -> complex:
        """What steps multiply an oscillation by, by the integrator's theory."""
        return complex(max(self.integrator.multipliers(stiffness, damp, dt)[0], key=abs))

    def _modal_damping(self, damping: Damping) -> Array:
        """Damping [1/s] of the modes (m,), kept from step to step."""
        kept = self._damp  # read once: another thread may ask for another meanwhile
        if kept is None or kept[0] is not damping:
            kept = self._damp = damping, damping.of_modes(self.basis.eigenvalues)
        return kept[1]

    def drag_at(self, q: Array, vertices: Index, drag: Array) -> Array:
        """Drag (m, m) in the turned modes of one (k, 3, 3) [N s/m] at some vertices."""
        rows = self.turned_rows(q, vertices)
        return np.tensordot(rows, drag @ rows, ((0, 1), (0, 1)))

    def load_quadrature(self, loading: Loading) -> LoadQuadrature | None:
        """A cheap sum of the loads that change, for steps of this model, if there is one."""
        return None

    def stops(self, dt: float, damping: Damping, drag: Array) -> bool:
        """Whether a drag (m, m) in the modes stops the shell within a step; a force kept from before throws it back."""
        by_rate = self.integrator.response(self.basis.eigenvalues, self._modal_damping(damping), dt)[1]
        return bool((by_rate * np.abs(drag).sum(axis=1)).max() > _STOPPED)

    def euler_step(self, state: MotionState, dt: float, force: Array, damping: Damping) -> MotionState:
        """A step of implicit Euler under a modal ``force`` (m,), as a rule that keeps forces keeps it."""
        q, v, damp = state.coordinates, state.rates, self._modal_damping(damping)
        after = MotionState(*_EULER.step(q, v, lambda _: force, self.basis.eigenvalues, damp, dt))
        gain, none = force - state.memory["force"], np.zeros_like(q)
        error = 0.5 * dt * (after.rates - v)
        cost = [part @ part for part in (error, after.rates - v, after.coordinates - q)]
        keeps = {"force": force, "gain": gain, "curvature": none, "step": np.array([dt]), COST: np.array(cost)}
        return MotionState(after.coordinates, after.rates, keeps)

    def slowed(
        self, state: MotionState, rates: Array, dt: float, damping: Damping, drag: Array, rule: ModalIntegrator
    ) -> MotionState:
        """``state`` after a step of a rule, corrected by implicit modal forces ``-drag (v - rates)`` at its end."""
        by_position, by_rate = rule.response(self.basis.eigenvalues, self._modal_damping(damping), dt)
        # LAPACK at once: this runs each frame, and NumPy takes three times as long to check its arguments.
        whole = self._identity + by_rate[:, None] * drag
        gain = scipy.linalg.lapack.dgesv(whole, state.rates - rates)[2]
        force = -(drag @ gain)
        memory = state.memory
        if "force" in memory:
            memory = memory | {"force": memory["force"] + force}
        return MotionState(state.coordinates + by_position * force, state.rates + by_rate * force, memory)

    def turned_rows(self, q: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) of the modes at some vertices, rotated with them."""
        rows = self._patch_rows(self.basis.modes, vertices)
        turns = Rotation.from_rotvec(self._patch_rows(self.basis.rotations, vertices) @ q).as_matrix()
        return np.asarray(turns @ rows)

    def check_step(self, dt: float, damping: Damping) -> None:
        """Refuse ratios that are not those of the modes."""
        damping.of_modes(self.basis.eigenvalues)

    def decay_rate(self, dt: float, damping: Damping) -> float:
        """Rate [1/s] at which the slowest mode loses energy, numerical damping included; 0 with rigid modes."""
        eigenvalues = self.basis.eigenvalues
        return self.integrator.decay_rate(eigenvalues, damping.of_modes(eigenvalues), dt)

    def meet_constraints(
        self,
        before: MotionState,
        free: MotionState,
        dt: float,
        damping: Damping,
        targets_at: Callable[[float], PatchTargets],
    ) -> tuple[MotionState, Array]:
        """Move a step's end onto the constraints by the modal forces of least work [choi2007, section 4.4].

        ``free`` is the end of a step from ``before`` without them, ``targets_at`` gives targets at a share of the step.
        The forces act throughout the step, and patches then move with their targets. Where rates are the differences of
        coordinates, and where a target was not met at the step's beginning, so that it jumps, the forces act at the
        step's end.
        """
        eigenvalues, damp, targets = self.basis.eigenvalues, self._modal_damping(damping), targets_at(1.0)
        compliance, by_rate = self.integrator.impulse(eigenvalues, damp, dt)
        q, residual = meet(targets, free.coordinates, compliance, free.coordinates)
        move = q - free.coordinates
        if self.integrator.backward or np.abs(targets_at(0.0)(before.coordinates)[0]).max() > CONSTRAINT_MET:
            rates = free.rates + move / dt
        else:
            rates, jacobian = free.rates + by_rate / compliance * move, targets(q)[1]
            wanted = (residual - targets_at(1.0 - LEAD)(q)[0]) / (LEAD * dt)
            rates = rates + np.linalg.lstsq(jacobian, wanted - jacobian @ rates, rcond=None)[0]
        return MotionState(q, rates, free.memory), targets.lengths(residual)

    def patch_position(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch at q, and its Jacobian (3, m)."""
        raise self.no_constraints()

    def patch_rotation(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean rotation vector (3,) [rad] of a patch at q, and its Jacobian (3, m)."""
        rows = self._patch_rows(self.basis.rotations, vertices).mean(axis=0)
        return rows @ q, rows

    @staticmethod
    def _patch_rows(matrix: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) of the patch's vertices in a (3n, m) matrix."""
        return np.asarray(matrix.reshape(-1, 3, matrix.shape[1])[vertices])

    def _targets(
        self, constraints: Sequence[Constraint], present: Array, time: float = 0.0, pose: Pose | None = None
    ) -> PatchTargets:
        """Constraints at ``time`` [s] as equations in q, near ``present`` (m,), in the frame of the supports."""
        values = {"position": self.patch_position, "orientation": self.patch_rotation}
        return PatchTargets(constraints, time, pose, values, self._size, present)

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy ``q^T Lambda q / 2`` [J]."""
        return float(0.5 * self.basis.eigenvalues @ state.coordinates**2)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy of the modal rates [J]."""
        return float(0.5 * state.rates @ state.rates)

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state."""
        return np.asarray(self.shell.rest_positions + self.raw_displacement(state.coordinates))


@final
class ModalStepper(Stepper):
    """Steps under loads at few points where these serve, and onto constraints."""

    model: ModalModel

    def __init__(self, model: ModalModel, setup: MotionSetup) -> None:
        super().__init__(model, setup, in_frame=True)
        if isinstance(model.integrator, ImplicitEuler):
            self._lead = 1.0  # its velocities are the moves of the vertices over a step
        self._quadrature = None if setup.supports is not None else self.model.load_quadrature(setup.loading)

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the model's rule, onto the constraints."""
        model, damping = self.model, self.setup.damping
        last: list[tuple[Array, Array]] = []

        def force(q: Array, rates: Array, share: float) -> Array:
            pushed, drag = self._push(begin + share * dt, load, MotionState(q, rates))
            last[:] = [] if drag is None else [(rates, drag)]
            return pushed

        after, rule = model.march(state, dt, force, damping), model.integrator
        if last and "force" in after.memory and model.stops(dt, damping, last[0][1]):
            rule, pushed = _EULER, force(state.coordinates, state.rates, 1.0)
            after = model.euler_step(state, dt, pushed, damping)
        if last:
            after = model.slowed(after, last[0][0], dt, damping, last[0][1], rule)
        if self.setup.constraints:
            after = self._met(begin, dt, state, after)
            if "force" in after.memory:
                after.memory["force"] = force(after.coordinates, after.rates, 1.0)
        return after, True

    def _push(self, time: float, load: Array, state: MotionState) -> tuple[Array, Array | None]:
        """Modal force (m,) of all loads on a state, and how it falls with the rates (m, m)."""
        q, model = state.coordinates, self.model
        if self._quadrature is None:
            load, drag = self.felt(time, load, state)
            return model.modal_force(q, load), None if drag is None else model.drag_at(q, *drag)
        own, lead = self.own_positions(state), self._lead * self.setup.dt
        by_velocity = self.setup.loading.by_velocity
        last = own - lead * model.velocities(state, own, lead) if by_velocity else own
        push, slope = self._quadrature.push(q, own, last, 1.0 / lead, time)
        push += model.modal_force(q, self._quadrature.dead(load, time))
        return push, slope if by_velocity else None

    def _met(self, begin: float, dt: float, state: MotionState, free: MotionState) -> MotionState:
        """``free``, the state after a step from ``state``, moved onto the constraints."""
        setup = self.setup

        def targets_at(share: float) -> PatchTargets:
            time = begin + share * dt
            pose = None if self._frame is None else self._frame.at(time)
            return self.model._targets(setup.constraints, state.coordinates, time, pose)

        after, self.residuals = self.model.meet_constraints(state, free, dt, setup.damping, targets_at)
        return after


def as_modal(model: Model) -> ModalModel | None:
    """``model`` if its unknowns are modal coordinates, else None."""
    return model if isinstance(model, ModalModel) else None
