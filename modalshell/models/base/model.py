"""Abstract base of all models: equilibrium under a load, and time steps; and what takes the steps of a motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_switch, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array, Index
from modalshell.integrators.state import MotionState
from modalshell.loads import Load, Loading
from modalshell.mesh import TriangleMesh
from modalshell.models.base.bars import bar_on_shell, check_bar
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.settle import judged, self_consistent
from modalshell.models.base.setup import MotionSetup, given_contacts
from modalshell.models.base.stepper import DeadLoadStepper, Stepper
from modalshell.modes.rigid import left_free
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.statics.path import Followable
from modalshell.supports.constraints import Constraint, checked_constraints

if TYPE_CHECKING:
    from modalshell.contact import Contact  # scenes without contacts do not import it

NO_POTENTIAL = "the load follows the shell"
"""Said of every answer under a load without a potential: no fault."""
RIGID_LOAD = 1e-9
"""Share of the load's norm that may act on rigid motions before a free shell counts as having no equilibrium."""
_REPEATED, _ALIKE = 1e-6, 64
"""Relative gap of eigenvalues that count as one, and of sizes; vertices of one size up to which all are looked at."""


class Model(ABC):
    """One rung of the ladder on one shell, with states in the world's frame; see :class:`FrameModel` for another."""

    name: str
    shell: Shell
    follows_snaps: ClassVar[bool] = False
    """Whether it leaves a branch where DS does, and so stays on the one that DS is on."""
    coarse_shell: Shell | None = None
    """The coarse shell on which it stands, if it does."""

    @property
    def true_shell(self) -> Shell:
        """The shell whose DS its answers are meant to be near."""
        return self.shell

    def equilibrium(
        self,
        *,
        gravity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        loads: Sequence[Load] | None = None,
        start: ArrayLike | None = None,
        constraints: Sequence[Constraint] | None = None,
        bar: bool = False,
        contacts: Sequence[Contact] | None = None,
    ) -> Equilibrium:
        """Equilibrium under a load; the class documents the method and the measure ``residual``.

        Parameters
        ----------
        gravity : array_like, shape (3,), optional
            Acceleration [m/s^2] that acts on every vertex's mass.
        force : array_like, shape (n, 3), optional
            Further force on every vertex [N].
        loads : sequence of Load, optional
            Further loads, such as :class:`~modalshell.PointForce`. Those that follow the shell, such as
            :class:`~modalshell.Pressure`, act as they are at the answer; loads of time as they are at time 0.
        start : array_like, shape (n, 3), optional
            Positions [m] from which to look for the answer. Where creases yield, the load changes gradually from
            the one that holds the shell there; without a start it grows from zero.
        constraints : sequence of Constraint, optional
            Prescribed positions and orientations of patches, for models that take constraints.
        bar : bool
            Whether to estimate the answer's error against DS on the same shell: two Newton steps and a stability margin
            beyond the answer, for about a third of the time of DS; see :class:`~modalshell.ErrorBar`.
        contacts : sequence of Contact or SelfContact, optional
            Colliders that vertices stay out of, as they are at time 0, for models that take contacts.

        Returns
        -------
        Equilibrium
            Does not raise if it fails to converge: see ``converged``, ``outcome`` and ``message``.

        Raises
        ------
        LoadError
            For loads or positions of the wrong shape or not finite.
        OptionError
            For constraints or contacts of a model that takes none, for constraints that contradict one another or the
            supports, for a start inside a collider, for a contact whose vertices supports all hold, or for a ``bar``
            under contacts with friction, or of a shell that its supports do not hold.
        SolverError
            If extreme input drives the positions out of the finite numbers.
        """
        watch = Stopwatch()
        loading = self.shell.loading(gravity, force, loads)
        begin = None if start is None else self.shell.checked_positions(start)
        wanted, touching = checked_constraints(constraints, self.shell.unknowns), given_contacts(contacts, self.shell)
        if checked_switch("bar", bar):
            check_bar(self.true_shell, constraints=wanted, contacts=touching)
        found = self.solved(loading, begin, touching, wanted)
        if not loading.conservative:
            message = "; ".join(part for part in (found.message, NO_POTENTIAL) if part)
            found = replace(found, conservative=False, message=message)
        if not (wanted or touching) and (rigid := self.rigid_load(loading.force(found.positions))) > RIGID_LOAD:
            message = f"the load pushes a shell: {left_free(self.shell)}"
            found = replace(found, outcome=Outcome.NO_EQUILIBRIUM, message=message, residual=rigid, stable=None)
        weight = None if gravity is None else checked_vectors("gravity", gravity, (3,))
        found = replace(found, seconds=watch(), loading=loading, gravity=weight, mesh=self.shell.mesh)
        if touching or wanted:
            found = replace(found, contacts=touching, constraints=tuple(wanted))
        if found.converged and (beyond := self.beyond_range(found, wanted)):
            found = replace(found, message="; ".join(filter(None, [found.message, beyond])))
        if not bar:
            return found
        return replace(found, bar=bar_on_shell(self.true_shell, found.positions, loading, touching, wanted))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.shell!r})"

    @abstractmethod
    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        """Static answer to a load (n, 3) [N] from ``start`` (n, 3) [m], checked; its seconds are filled in later."""

    def solved(
        self,
        loading: Loading,
        start: Array | None,
        contacts: Sequence[Contact] = (),
        constraints: Sequence[Constraint] = (),
    ) -> Equilibrium:
        """Answer of the model itself from ``start`` (n, 3) [m], unchecked; loads beyond its range are not sought."""
        if contacts:
            return self._solve_touching(loading, start, contacts, constraints)
        if constraints:
            return self._solve_constrained(loading, start, constraints)
        return self._solve_live(loading, start) if loading.live else self._solve(loading.dead, start)

    def _solve_live(self, loading: Loading, start: Array | None) -> Equilibrium:
        """Equilibrium under configuration-dependent loads; by a sequence of dead loads unless overridden."""
        found = self_consistent(self._solve, loading, start)
        # What floats has no stiffness along some motions, which is no sign of a saddle.
        return found if left_free(self.shell) else judged(found, loading, self.tangent_eigenvalue)

    def _solve_constrained(
        self, loading: Loading, start: Array | None, constraints: Sequence[Constraint]
    ) -> Equilibrium:
        """Equilibrium under constraints, of models that take these."""
        raise self.no_constraints()

    def _solve_touching(
        self,
        loading: Loading,
        start: Array | None,
        contacts: Sequence[Contact],
        constraints: Sequence[Constraint],
    ) -> Equilibrium:
        """Equilibrium with contacts, of models that take these."""
        raise self.no_contacts()

    def no_contacts(self) -> OptionError:
        """The error of a model that takes no contacts."""
        return OptionError(f"{self.name} takes no contacts: take DS, or another model of a shell that bends")

    def no_constraints(self) -> OptionError:
        """The error of a model that takes no constraints."""
        return OptionError(f"{self.name} takes no position or orientation constraints: use a modal model or DS")

    def sensitivity(self, state: Equilibrium, wrt: str | Sequence[str], *, of: ArrayLike | None = None) -> Array:
        """Derivative of an equilibrium by parameters of the shell and its load, by the implicit-function theorem.

        Parameters
        ----------
        state : Equilibrium
            A converged answer of this model.
        wrt : str or sequence of str
            By what, k numbers in all: a constant of the material that is one number for the whole mesh, such as
            "young", "thickness", "flexure" or "density"; "gravity" (k = 3); "load", a factor on the whole load;
            "force", that on every vertex (k = 3n); "rest_angles", those of the mesh's hinges (k = H) [rad], which the
            hybrid has no derivative by. DS has more.
        of : array_like, shape (n, 3), optional
            Derivative of a scalar by the positions: with it the scalar's derivatives are found.

        Returns
        -------
        ndarray, shape (n, 3, k), or (k,) with ``of``
            Per unit of each.

        Raises
        ------
        OptionError
            For a model without derivatives, a state that has not converged or was not found by :meth:`equilibrium`
            without constraints, a ``wrt`` that the model does not know, or loads that it does not take here.
        SolverError
            Where the state has no derivatives, at the end of a branch.
        """
        raise OptionError(f"{self.name} has no derivatives: take DS, LMA, MWTS, RSW, MD-ROM or the hybrid")

    def followable(self, load: Array) -> Followable:
        """The model as :func:`modalshell.equilibrium_path` follows it under a growing ``load`` (n, 3) [N].

        Raises
        ------
        OptionError
            Where its equilibria are not those of a potential.
        """
        raise OptionError(
            f"{self.name} has no path of equilibria to follow, as its force is not that of a potential, or its answer "
            "is linear: take DS, RSW or MD-ROM"
        )

    def rigid_load(self, load: Array) -> float:
        """Fraction of a load (n, 3) along rigid motions without resistance in statics."""
        return 0.0

    def beyond_range(self, answer: Equilibrium, constraints: Sequence[Constraint]) -> str:
        """The message about a converged answer under a load outside of the model's range; "" if none."""
        return ""

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest squared angular frequency [1/s^2] of small motion about ``answer`` under ``load`` (n, 3) [N].

        Negative, or of negative real part, at an unstable state; None for models without a tangent.
        """
        return None

    def stepped_by(self, integrator: str) -> Self:
        """The same model with another rule of its steps in time; OptionError for one that it does not take."""
        raise OptionError(f"{self.name} has no rule of time to choose (got integrator={integrator!r}): leave it out")

    @abstractmethod
    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest at ``positions`` (n, 3); by default at the rest shape."""

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion.

        Raises
        ------
        OptionError
            For constraints of a model that takes none, or that contradict one another.
        """
        return DeadLoadStepper(self, setup)

    @abstractmethod
    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s] under ``load`` (n, 3) [N]; also returns whether the step's own solver converged.

        ``held`` (h, 3) [m] is where the held vertices are at the step's end, for models in the world's frame.
        """

    def dragged(
        self,
        state: MotionState,
        before: MotionState,
        dt: float,
        damping: Damping,
        vertices: Index,
        drag: Array,
    ) -> MotionState:
        """``state`` after a step from ``before`` under the loads there, corrected for how these fall with velocity.

        ``drag`` (k, 3, 3) [N s/m] is minus the derivative of the forces on ``vertices`` (k,) by their velocities.
        Without it light shells in a wind overshoot. Models without such a term ignore it.
        """
        return state

    @abstractmethod
    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state, a new array each time."""

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state at ``own`` (n, 3), by where it was a short time ``lead`` [s] before."""
        earlier = MotionState(state.coordinates - lead * state.rates, state.rates)
        return np.asarray((own - self.positions(earlier)) / lead)

    def centred(self) -> tuple[Model, Array]:
        """The model to step, and where its origin lies (3,) [m]: that of a shell far away is one about the origin."""
        return self, np.zeros(3)

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy [J]."""
        return self.shell.elastic_energy.energy(self.positions(state))

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J], in the model's own frame."""
        return 0.5 * self.squared(state.rates)

    def squared(self, vector: Array) -> float:
        """Square [kg m^2] of a vector in the model's own unknowns, in the norm of the mass."""
        mass = self.shell.mass[:, None] if vector.ndim == 2 else 1.0
        return float(np.sum(mass * vector**2))

    def largest_move(self, change: Array) -> float:
        """Largest displacement [m] of a vertex by a small ``change`` of the coordinates."""
        return float(np.sqrt(np.sum(change**2, axis=1).max()))

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error in the coordinates that a step of ``dt`` [s] has made; None where the rule knows none."""
        return None

    def growth(self, stiffness: float, damp: float, dt: float) -> complex:
        """What steps multiply motion by that oscillates with ``stiffness`` [1/s^2] and ``damp`` [1/s], if known."""
        return complex(np.nan)

    def mean_growth(self, state: MotionState, stiffness: float, damp: float, dt: float) -> complex:
        """The same of the steps that have led to a state, on average."""
        return self.growth(stiffness, damp, dt)

    def decay_rate(self, dt: float, damping: Damping) -> float:
        """Rate [1/s] at which steps of ``dt`` eat the energy of small free motion at least; 0 where it is unknown."""
        return 0.0

    def fault(self, state: MotionState, positions: Array) -> Outcome | None:
        """Outcome of a state at ``positions`` (n, 3) that is outside the model's range; None if it is inside."""
        return None

    def remark(self, state: MotionState) -> str:
        """Message about the validity of a state, or about the method that found it; "" if there is none."""
        return ""

    level_names: tuple[str, ...] = ()
    """Models among which it switches, by the number in a state's memory "level"."""

    def account(self, state: MotionState) -> str:
        """The model's message about a motion that ends in a state; "" if none."""
        return ""

    def as_coarse(self, state: MotionState) -> MotionState:
        """A state as a coarse shell under the model has it, where steps may go there; else the state itself."""
        return state

    def crease_angles(self, angles: Array) -> Array:
        """Plastic folds (C,) [rad] of the shell's creases from those that a state keeps."""
        return angles

    def own_crease_angles(self, angles: Array) -> Array:
        """Plastic folds [rad] that a state keeps from those (C,) of the shell's creases."""
        return angles

    def is_saddle(self, state: MotionState) -> bool:
        """Whether a state at rest under a dead load is unstable."""
        return False

    def check_step(self, dt: float, damping: Damping) -> None:
        """Raise OptionError if this model cannot step by ``dt``, or with this ``damping``."""
        if damping.ratios:
            raise OptionError(
                f"ratios must be left out: {self.name} has no modes to damp one by one; or take a modal model"
            )


def probes(modes: Array, eigenvalues: Array, mesh: TriangleMesh) -> Array:
    """Rows (k, 3, m) of modes (3n, m) at the vertices where each one is largest, or all of one eigenvalue together.

    Rigid motions have the eigenvalue 0, and are looked at in each part of the mesh. Of vertices that move alike, as in
    a symmetric mesh, all are taken, so that their numbers do not matter, or those far from the middle where many are.
    """
    rows = modes.reshape(-1, 3, modes.shape[1])
    sizes, order = np.sum(rows**2, axis=1), np.argsort(eigenvalues, kind="stable")
    ends = np.flatnonzero(np.diff(eigenvalues[order]) > _REPEATED * np.abs(eigenvalues[order[1:]])) + 1
    middle = mesh.vertices - mesh.vertices.mean(axis=0)
    chosen = []
    for group in np.split(order, ends):
        rigid = not np.abs(eigenvalues[group]).any()
        for part in range(mesh.components.max() + 1) if rigid else (None,):
            own = np.arange(len(rows)) if part is None else np.flatnonzero(mesh.components == part)
            alike = own[_largest(sizes[own][:, group].sum(axis=1))]
            if alike.size > _ALIKE:
                alike = alike[_largest(np.sum(middle[alike] ** 2, axis=1))]
            chosen.append(alike)
    return np.ascontiguousarray(rows[np.unique(np.concatenate(chosen))])


def _largest(sizes: Array) -> NDArray[np.bool_]:
    """Which of some sizes (k,) are the largest, to rounding."""
    return np.asarray(sizes >= (1.0 - _REPEATED) * sizes.max())


class FrameModel(Model):
    """A model with states in the frame of its supports, whose motion is felt as inertial loads."""

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion; see :meth:`Model.stepper`."""
        return DeadLoadStepper(self, setup, in_frame=True)
