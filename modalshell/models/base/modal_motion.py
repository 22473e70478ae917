"""Base of modal models in motion: coordinates, time steps per mode, constraints, and frames of free parts."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np
import scipy.linalg.lapack
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal import ImplicitEuler, ModalIntegrator
from modalshell.integrators.modal.base import DeadForce, ForceInTime, ModalStep
from modalshell.integrators.state import MotionState
from modalshell.loads import Loading
from modalshell.models.base.buckling_range import BucklingRange
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.base.manipulation import PatchTargets
from modalshell.models.base.model import FrameModel, probes
from modalshell.models.base.shape import ModalShape
from modalshell.models.base.stepper import LEAD
from modalshell.models.reduction.load_quadrature import LoadQuadrature
from modalshell.modes import Basis
from modalshell.shell.damping import Damping
from modalshell.statics.modal_balance import differences
from modalshell.supports import Pose
from modalshell.supports.constraints import Constraint

CONSTRAINT_MET = 1e-6
"""Residual of a constraint, as a share of the shell's size or in radians, above which it counts as not met."""

FAST_SPIN = 0.3
"""Spin, as a share of the lowest elastic frequency, from which what it does to stiffness counts: a tenth."""
FAST = (
    f"a part without supports spins faster than {FAST_SPIN:g} of its lowest elastic frequency: linear modes lack the "
    "stiffness that spin gives; take DS"
)

_STOPPED = 0.5, 1.0
"""Change of the rates by a drag on them, within a step, as a share of the rates, from which it stops the shell: held by
supports, and in flight, where implicit Euler costs more than it saves below."""
EULER = ImplicitEuler()
"""What steps a shell that a drag stops."""


class ModalMotion(ModalShape, FrameModel):
    """A model of m modal coordinates q in motion; :class:`modalshell.models.base.modal.ModalModel` has its statics.

    Free parts fly in frames of their own, of which the coordinates of their rigid modes tell where they are: see
    :class:`FreeFrames`. A subclass defines what becomes of the other coordinates, see :class:`ModalShape`.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    integrator : str or ModalIntegrator
        Rule of the steps.

    Attributes
    ----------
    frames : FreeFrames or None
        Frames of the parts that no support holds.
    """

    def __init__(self, basis: Basis, *, integrator: str | ModalIntegrator = "exponential") -> None:
        self.basis = checked_kind("basis", basis, Basis, "ms.solve_modes(shell, count) makes one")
        self.shell = basis.shell
        self.integrator = self._rule(integrator)
        self.frames = FreeFrames.of(basis.shell, basis.modes[:, : basis.rigid_modes])
        self._identity, self._range = np.eye(basis.count), BucklingRange(basis.shell)
        self._damp: tuple[Damping, Array] | None = None
        self._impulsed: tuple[tuple[ModalIntegrator, Damping, float], tuple[Array, Array]] | None = None
        self._mass_size = self.shell.mesh.extent * float(np.sqrt(self.shell.mass.sum()))

    def _rule(self, integrator: str | ModalIntegrator) -> ModalIntegrator:
        rule: ModalIntegrator = ModalIntegrator.chosen(integrator)
        return rule if self.straight else rule.under_turning_forces()

    def stepped_by(self, integrator: str | ModalIntegrator) -> Self:
        """The same model with another rule of its steps."""
        other = copy.copy(self)
        other.integrator = self._rule(integrator)
        return other

    # ---- positions and forces

    def displacement(self, q: ArrayLike) -> Array:
        """Vertex displacements (n, 3) [m] at modal coordinates ``q`` (m,); OptionError if these are not finite."""
        return self.raw_displacement(checked_vectors("q", q, (self.basis.count,), OptionError))

    def raw_displacement(self, q: Array) -> Array:
        """Displacements (n, 3) [m], without input checks."""
        if self.frames is None:
            return self.warped(q)
        return self.frames.positions(q, self.warped_positions) - self.shell.rest_positions

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state."""
        if self.frames is None:
            return self.warped_positions(state.coordinates)
        return self.frames.positions(state.coordinates, self.warped_positions)

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state; see :meth:`Model.velocities`."""
        if self.frames is None:
            return super().velocities(state, own, lead)
        return self.frames.velocities(state, lead, self.warped_positions)

    def displacement_gradient(self, q: Array, weights: Array) -> Array:
        """Derivatives (m,) at q of the displacements, contracted with weights (n, 3)."""
        if self.frames is None:
            return self.warped_gradient(q, weights)
        return self.frames.pull(q, weights, self.warped_gradient, self.warped_positions)

    def modal_force(self, q: Array, load: Array) -> Array:
        """Modal force (m,) of a load (n, 3) [N] at q; on the rigid modes of free parts, derivatives of its work."""
        if self.frames is None:
            return self.warped_force(q, load)
        return self.frames.pull(q, load, self.warped_force, self.warped_positions)

    def modal_force_jacobian(self, q: Array, load: Array) -> Array:
        """Derivatives ``dp/dq`` (m, m) of the modal force at q; differences where frames of free parts move."""
        if self.frames is None:
            return self.warped_jacobian(q, load)
        whole = differences(lambda q: self.modal_force(q, load), q, self.basis.rotations)
        whole = 0.5 * (whole + whole.T) if self.conservative else whole
        bent = self.frames.bending(q, load, self.warped_jacobian, self.warped_positions)
        return self.frames.with_elastic(whole, bent)

    def work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work ``f . u(q)`` [J] of a load (n, 3) [N] and its gradient (m,); of models that know it."""
        if self.frames is None:
            return self.warped_work(q, load)
        return float(np.vdot(load, self.raw_displacement(q))), self.displacement_gradient(q, load)

    def work_curvature(self, q: Array, load: Array) -> Array:
        """Second derivatives (m, m) of the work."""
        if self.frames is None:
            return self.warped_curvature(q, load)
        whole = differences(lambda q: self.displacement_gradient(q, load), q, self.basis.rotations)
        bent = self.frames.bending(q, load, self.warped_curvature, self.warped_positions)
        return self.frames.with_elastic(0.5 * (whole + whole.T), bent)

    def push(self, q: Array, rates: Array, load: Array, dt: float) -> Array:
        """Modal force (m,) of a load (n, 3) [N] on a shell that moves in steps of ``dt`` [s], inertial ones with it.

        On the rigid modes of free parts it is that of the load's forces and torques.
        """
        if self.frames is None:
            return self.modal_force(q, load)
        return self.frames.push(q, load, self.warped_force, self.warped_positions, (rates, LEAD * dt))

    def coordinates_of(self, positions: ArrayLike) -> Array:
        """Modal coordinates (m,) of the mass-weighted projection of ``positions`` (n, 3), of free parts in frames."""
        given = self.shell.checked_positions(positions)
        if self.frames is None:
            return self._projected(given - self.shell.rest_positions)
        return self.frames.coordinates_of(given, self.warped_positions, self._projected)

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """Modal state at rest, of the nearest shape."""
        if positions is None:
            q = np.zeros(self.basis.count)
        elif self.frames is None:
            q = self.nearest(self.shell.checked_positions(positions))
        else:
            q = self.coordinates_of(positions)
        state = self.integrator.at_rest(q)
        return state if self.frames is None else self.frames.at_rest(state)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step of the integrator for every mode."""
        return self.march(state, dt, lambda q, rates, _: self.push(q, rates, load, dt), damping)

    def march(
        self,
        state: MotionState,
        dt: float,
        force: ForceInTime,
        damping: Damping,
        dead: DeadForce | None = None,
    ) -> tuple[MotionState, bool]:
        """One step of the integrator, which evaluates the modal forces at its own times and states.

        ``dead`` is what is known of them at the end of the step where they are those of a load by itself.

        Also returns whether the frames of free parts turned as they should.
        """
        damp, eigenvalues, frames = self._modal_damping(damping), self.basis.eigenvalues, self.frames
        step = ModalStep(eigenvalues, damp, dt, self._mass_size, dead if frames is None else None)
        if frames is None:
            return self.integrator.advance(state, force, step), True
        seen: list[Array] = []

        def felt(q: Array, rates: Array, share: float) -> Array:
            seen.append(force(frames.predicted(q, state.memory["turn_back"], share * dt), rates, share))
            return seen[-1]

        after = self.integrator.advance(state, felt, step)
        memory = state.memory
        first = memory["force"] if "force" in memory and memory["step"][0] else seen[0]
        if self.integrator.forced_at < 1.0:
            first = seen[-1]  # one of the middle serves all of the step
        return frames.flown(state, after, (first, seen[-1]), dt, damping.mass_factor, self.warped_positions)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error (m,) in the coordinates that a step has made, by the integrator's theory."""
        return self.integrator.local_error(before, after, self.basis.eigenvalues, dt)

    def beyond_range(self, answer: Equilibrium, constraints: Sequence[Constraint]) -> str:
        """That the load of an answer, and what else pushes, is beyond the linear buckling load."""
        return "" if self.frames is not None else self._range.remark(answer, constraints)

    def squared(self, vector: Array) -> float:
        """Square [kg m^2] of coordinates (m,): modes are orthonormal in the norm of the mass."""
        return float(vector @ vector)

    def largest_move(self, change: Array) -> float:
        """Largest displacement [m] of a vertex by a small ``change`` (m,), of those that the modes move most."""
        return super().largest_move((self._probes @ change).reshape(-1, 3))

    @cached_property
    def _probes(self) -> Array:
        """Rows (3k, m) of the modes."""
        return probes(self.basis.modes, self.basis.eigenvalues, self.shell.mesh).reshape(-1, self.basis.count)

    def growth(self, stiffness: float, damp: float, dt: float) -> complex:
        """What steps multiply an oscillation by, by the integrator's theory."""
        return complex(max(self.integrator.multipliers(stiffness, damp, dt)[0], key=abs))

    def _modal_damping(self, damping: Damping) -> Array:
        """Damping [1/s] of the modes (m,), kept from step to step."""
        kept = self._damp  # read once: another thread may ask for another meanwhile
        if kept is None or kept[0] is not damping:
            kept = self._damp = damping, damping.of_modes(self.basis.eigenvalues)
        return kept[1]

    def impulse(self, damping: Damping, dt: float, rule: ModalIntegrator | None = None) -> tuple[Array, Array]:
        """What a modal force throughout a step does, see :meth:`ModalIntegrator.impulse`; kept from step to step.

        The step is one of the model's own rule, or of another.
        """
        rule = self.integrator if rule is None else rule
        key, kept = (rule, damping, dt), self._impulsed  # read once: as of the damping
        if kept is None or kept[0] != key:
            damp = self._modal_damping(damping)
            kept = self._impulsed = key, rule.impulse(self.basis.eigenvalues, damp, dt)
        return kept[1]

    def drag_at(self, q: Array, vertices: Index, drag: Array) -> Array:
        """Drag (m, m) in the turned modes of one (k, 3, 3) [N s/m] at some vertices."""
        rows = self.turned_rows(q, vertices)
        return np.tensordot(rows, drag @ rows, ((0, 1), (0, 1)))

    def load_quadrature(self, loading: Loading) -> LoadQuadrature | None:
        """A cheap sum of the loads that change, for steps of this model, if there is one."""
        return None

    def stops(self, dt: float, damping: Damping, drag: Array) -> bool:
        """Whether a drag (m, m) in the modes stops the shell within a step: a kept force would throw it back."""
        by_rate = self.integrator.response(self.basis.eigenvalues, self._modal_damping(damping), dt)[1]
        return bool((by_rate * np.abs(drag).sum(axis=1)).max() > _STOPPED[self.frames is not None])

    def euler_step(self, state: MotionState, dt: float, force: Array, damping: Damping) -> tuple[MotionState, bool]:
        """A step of implicit Euler under a modal ``force`` (m,), with what the model's rule keeps of it.

        Also returns whether the frames of free parts turned as they should.
        """
        damp = self._modal_damping(damping)
        ends = EULER.step(state.coordinates, state.rates, lambda _: force, self.basis.eigenvalues, damp, dt)
        after = self.integrator.stood_in_for(state, MotionState(*ends), force, dt)
        if self.frames is None:
            return after, True
        return self.frames.flown(state, after, (force, force), dt, damping.mass_factor, self.warped_positions)

    def slowed(
        self, state: MotionState, rates: Array, dt: float, damping: Damping, drag: Array, rule: ModalIntegrator
    ) -> MotionState:
        """``state`` after a step of a rule, corrected by implicit modal forces ``-drag (v - rates)`` at its end."""
        by_position, by_rate = rule.response(self.basis.eigenvalues, self._modal_damping(damping), dt)
        # LAPACK at once: this runs each frame, and NumPy takes three times as long to check its arguments.
        whole, gain = self._identity + by_rate[:, None] * drag, state.rates - rates
        if self.frames is not None:
            gain = self.frames.spun(state.coordinates, gain)
        gain = scipy.linalg.lapack.dgesv(whole, gain)[2]
        force = -(drag @ gain)
        memory = state.memory
        if "force" in memory:
            memory = memory | {"force": memory["force"] + force}
        moved, faster = by_position * force, by_rate * force
        if self.frames is not None:
            moved, faster = (self.frames.unspun(state.coordinates, part) for part in (moved, faster))
        return MotionState(state.coordinates + moved, state.rates + faster, memory)

    def turned_rows(self, q: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) that take rates to velocities of some vertices; those of frames are angular velocities."""
        if self.frames is None:
            return self.warped_rows(q, vertices)
        return self.frames.rows(q, vertices, self.warped_rows, self.warped_positions)

    def contact_rows(self, q: Array, vertices: Index) -> Array:
        """Derivatives (k, 3, m) of some vertices' positions by the coordinates; by differences unless overridden."""
        return differences(lambda q: self.warped(q)[vertices], q, self.basis.rotations)

    def contact_frame(self, q: Array, vertices: Index, directions: Array | None) -> tuple[Array, Array | None]:
        """Positions (k, 3) [m] of some vertices at q, and their derivatives (k, d, m) along ``directions`` (d, 3)."""
        points = self.warped_positions(q)[vertices]
        return points, None if directions is None else directions @ self.contact_rows(q, vertices)

    def check_step(self, dt: float, damping: Damping) -> None:
        """Refuse ratios that are not those of the modes."""
        damping.of_modes(self.basis.eigenvalues)

    def decay_rate(self, dt: float, damping: Damping) -> float:
        """Rate [1/s] at which the slowest mode loses energy, numerical damping included; 0 with rigid modes."""
        eigenvalues = self.basis.eigenvalues
        return self.integrator.decay_rate(eigenvalues, damping.of_modes(eigenvalues), dt)

    def patch_position(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch at q, and its Jacobian (3, m)."""
        if self.frames is None:
            return self.warped_patch(q, vertices)
        return self.frames.patch_position(q, vertices, self.warped_patch, self.warped_gradient, self.warped_positions)

    def patch_rotation(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean rotation vector (3,) [rad] of a patch at q, and its Jacobian (3, m)."""
        rows = self._patch_rows(self.basis.rotations, vertices).mean(axis=0)
        return (rows @ q, rows) if self.frames is None else self.frames.patch_rotation(q, vertices, rows)

    @staticmethod
    def _patch_rows(matrix: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) of the patch's vertices in a (3n, m) matrix."""
        return np.asarray(matrix.reshape(-1, 3, matrix.shape[1])[vertices])

    def _targets(
        self, constraints: Sequence[Constraint], present: Array, time: float = 0.0, pose: Pose | None = None
    ) -> PatchTargets:
        """Constraints at ``time`` [s] as equations in q, near ``present`` (m,), in the frame of the supports."""
        values = {"position": self.patch_position, "orientation": self.patch_rotation}
        return PatchTargets(constraints, time, pose, values, self.shell.size, present)

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy ``q^T Lambda q / 2`` [J], with what the stresses at rest have stored."""
        return self._at_rest + float(0.5 * self.basis.eigenvalues @ state.coordinates**2)

    @cached_property
    def _at_rest(self) -> float:
        """Elastic energy [J] of a settled shell at rest, as discrete shells have it too: once for all frames."""
        return self.shell.energy_at_rest

    def remark(self, state: MotionState) -> str:
        """That a part without supports spins faster than linear modes can tell its shape; "" otherwise."""
        if self.frames is None or self._slowest is None:
            return ""
        spins = np.linalg.norm(self.frames.spins(state.coordinates, state.rates), axis=1)
        return FAST if spins.max() > FAST_SPIN * self._slowest else ""

    @cached_property
    def _slowest(self) -> float | None:
        """Lowest angular frequency [rad/s] of an elastic mode."""
        elastic = self.basis.eigenvalues[self.basis.rigid_modes :]
        return float(np.sqrt(max(elastic[0], 0.0))) if elastic.size else None

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of the modal rates, and of the frames of free parts."""
        if self.frames is not None:
            return self.frames.kinetic_energy(state, self.warped_positions)
        return float(0.5 * state.rates @ state.rates)
