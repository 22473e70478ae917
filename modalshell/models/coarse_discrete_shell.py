"""Coarse DS: discrete shells on a coarse mesh of the surface, prolonged to the fine one (theory 11, eq. 1)."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self, final

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_number, checked_vectors
from modalshell.core.errors import MeshError, ModalShellWarning, OptionError
from modalshell.core.typing import Array, Index
from modalshell.integrators.full import FullIntegrator
from modalshell.integrators.full.implicit_rule import EulerStart, ShellSteps
from modalshell.integrators.state import MotionState
from modalshell.kernels.rotations import largest_turn
from modalshell.loads import Loading
from modalshell.mesh.closest import closest_points, common_parts
from modalshell.models.base.crease_motion import CreaseMotion
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.free_statics import drifting_parts, fixed, goes_along, put_back, relieved
from modalshell.models.base.implicit import LoadAt, implicit_rule
from modalshell.models.base.settle import judged, self_consistent
from modalshell.models.coarse.free_parts import ProlongedParts
from modalshell.models.coarse.on_coarse import OnCoarse
from modalshell.models.coarse.profile_step import profile_step
from modalshell.models.coarse.prolongation import Prolongation, own_triangles
from modalshell.models.coarse.taken_over import CreasesBelow
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.modes import Factoriser
from modalshell.modes.rigid import left_free
from modalshell.modes.tangent import with_further
from modalshell.shell import GAUSS_NEWTON, Shell
from modalshell.shell.damping import Damping
from modalshell.shell.strain_range import ends_strained
from modalshell.supports.constraints import Constraint

_APART = 0.2
"""Distance between the meshes, as a share of the surface's size, from which they are not the same surface."""


@final
class CoarseDiscreteShell(OnCoarse):
    """DS on fewer vertices: it bends, stiffens and snaps as a shell does, a little too stiff and a little too coarse.

    Positions are prolonged to the fine mesh by moving least squares in the tangent plane [lancaster1981], which stop at
    sharp folds; loads are restricted with the same weights. A step of implicit Euler runs in one compiled function,
    with a profile factorisation, where the coarse shell has no further energies and its supports hold whole vertices;
    else as that of :class:`DiscreteShell`, six to ten times slower, as all steps are where creases yield.

    Contacts hold exactly at the coarse vertices, by the same sets as those of :class:`DiscreteShell`; forces are stated
    at the fine vertices nearest to them. Fine vertices between these may enter a collider: by the square of the coarse
    edges over eight times a radius at which the surface, or the collider, bends more than the prolonged one does.
    :meth:`equilibrium` puts such vertices onto the collider. Motions do not; ``deepest`` is their penetration.

    Parameters
    ----------
    shell : Shell
        The fine shell, whose positions are computed.
    coarse : Shell
        The same surface with fewer vertices: its own material for its mesh, and the same supports; see
        :func:`coarse_shell`.
    step_tolerance : float
        Out-of-balance force at which a step's Newton stops, as a share of its load and inertia.
    integrator : str or FullIntegrator
        Rule of its steps: "bdf2", "composite", "sdirk2" or "implicit" (Euler).

    Raises
    ------
    MeshError
        If the meshes are apart: they are not the same surface.
    OptionError
        If ``step_tolerance`` is not between 0 and 0.01.
    """

    name = "coarse DS"
    follows_snaps = True
    free_parts: ProlongedParts | None

    def __init__(
        self,
        shell: Shell,
        coarse: Shell,
        *,
        step_tolerance: float = 1e-3,
        integrator: str | FullIntegrator = "bdf2",
    ) -> None:
        self.integrator = implicit_rule(integrator)
        self.shell = checked_kind("shell", shell, Shell)
        self.step_tolerance = checked_number("step_tolerance", step_tolerance, above=0.0, at_most=1e-2)
        self.coarse = DiscreteShell(checked_kind("coarse", coarse, Shell), step_tolerance=self.step_tolerance)
        self.coarse_shell = coarse
        mesh, under = shell.mesh, coarse.mesh
        self._creases = CreasesBelow.of(self.shell, coarse)
        if (self._creases is None) != (self.shell.creases is None):
            raise OptionError("creases must be those of both shells, or of none: make coarse by ms.coarse_shell")
        folds = None if coarse.creases is None else under.hinge_edges[coarse.creases.hinges]
        self._prolongation = Prolongation(under, mesh, folds)
        distance = self._prolongation.distance
        if distance.max() > _APART * mesh.size:
            worst = int(distance.argmax())
            raise MeshError(
                f"the coarse mesh is another surface: vertex {worst} is {distance[worst]:.3g} m from it, the shell is "
                f"{mesh.size:.3g} m long; make both from one shape"
            )
        if torn := self._prolongation.torn.size:
            vertex = int(mesh.edges[self._prolongation.torn[0], 0])
            warnings.warn(
                f"layers of the shell are closer together than the coarse mesh follows them: {torn} edges, the first at"
                f" vertex {vertex}, have ends next to two of its layers, so that answers may be off by much; take more "
                "triangles, whose chords are less deep than half the gap between layers",
                ModalShellWarning,
                stacklevel=2,
            )
        if under is mesh:
            self._above, self._shares = own_triangles(mesh)
        else:
            self._above, self._shares, _ = closest_points(mesh, under.vertices, common_parts(mesh, under))
        self._step = profile_step(coarse)
        self._exact = coarse is shell  # the same shell: of several minima of a step that of DS
        self.free_parts = ProlongedParts.of(shell, coarse, self._prolongation)

    @property
    def is_compiled(self) -> bool:
        """Whether its steps are compiled, as those of small shells are."""
        return self._step is not None

    def of_any_minimum(self) -> Self:
        """The same, whose compiled steps on the shell's own mesh may end at another minimum than those of DS.

        Violent steps have several. Where any serves, one is not looked for twice, and again by sparse algebra.
        """
        model = copy.copy(self)
        model._exact = False
        return model

    @property
    def weights(self) -> sps.csr_array:
        """Weights (n, k) of :meth:`prolong`, and of :meth:`restrict`."""
        return self._prolongation.matrix

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        """Static equilibrium of the coarse shell, prolonged; a start (n, 3) is sampled to begin from."""
        return self._solve_coarse(self._prolongation.restrict(load), None if start is None else self.sampled(start))

    def _solve_coarse(self, load: Array, begin: Array | None) -> Equilibrium:
        """The same by load and start on the coarse vertices (k, 3)."""
        answer = self.coarse.equilibrium(force=load, start=begin)
        kept = answer.creases
        if kept is not None and self._creases is not None:
            kept = self._creases.state_of(kept)
        return replace(answer, positions=self._prolonged(answer.positions), coordinates=answer.positions, creases=kept)

    def _solve_live(self, loading: Loading, start: Array | None) -> Equilibrium:
        """Equilibrium under loads that follow; free parts whose turns these go along with are held in all ways."""
        if not left_free(self.shell) or not goes_along(self.shell, loading):
            return super()._solve_live(loading, start)
        own, held = self.coarse.shell, copy.copy(self)
        parts = drifting_parts(own, np.zeros_like(own.rest_positions))
        held.coarse = copy.copy(self.coarse)
        held.coarse.shell, held.coarse.factoriser = fixed(own, parts), Factoriser(self.coarse.factoriser.backend)

        def solve(load: Array, start: Array | None) -> Equilibrium:
            begin = None if start is None else self.sampled(start)
            restricted = self._prolongation.restrict(load)
            return held._solve_coarse(relieved(own, restricted, own.rest_positions if begin is None else begin), begin)

        found = judged(self_consistent(solve, loading, start), loading, held.tangent_eigenvalue)
        assert found.coordinates is not None
        back = put_back(found.coordinates, parts, own, None if start is None else self.sampled(start))
        return replace(found, positions=self._prolonged(back), coordinates=back)

    def _solve_touching(
        self, loading: Loading, start: Array | None, contacts: Sequence[Any], constraints: Sequence[Constraint]
    ) -> Equilibrium:
        from modalshell.models.coarse.contacts import coarse_equilibrium_on_contacts  # not without contacts

        return coarse_equilibrium_on_contacts(self, loading, start, contacts, constraints)

    @property
    def nearest(self) -> Index:
        """The fine vertex (k,) nearest to each coarse one."""
        corners = self.shell.mesh.faces[self._above]
        return np.asarray(corners[np.arange(len(corners)), self._shares.argmax(axis=1)])

    @property
    def on_coarse(self) -> Self:
        """The coarse shell that bears contacts: its own."""
        return self

    def coarse_contacts(self, contacts: Sequence[Any]) -> list[Any]:
        """Contacts of the coarse vertices, each of those whose nearest fine one may touch."""
        return [contact.on(contact.vertices(self.shell.mesh)[self.nearest]) for contact in contacts]

    def spread(self, forces: Array, touches: Array) -> tuple[Array, Array]:
        """Contact forces (n, 3) [N], and what touches (n,), of those of coarse vertices, at the nearest fine ones."""
        shape = self.shell.rest_positions.shape
        above, touched = np.zeros(shape), np.zeros(shape[0], dtype=bool)
        np.add.at(above, self.nearest, forces)
        touched[self.nearest[touches]] = True
        return above, touched

    def centred(self) -> tuple[Self, Array]:
        """The same model about the origin, and where its origin was."""
        shell, origin = self.shell.centred()
        if not origin.any():
            return self, origin
        model = copy.copy(self)
        model.shell, model.coarse = shell, copy.copy(self.coarse)
        model.coarse.shell = self.coarse.shell.shifted(origin)
        model._step = profile_step(model.coarse.shell)
        return model, origin

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest eigenvalue [1/s^2] of the coarse shell's tangent stiffness, loads' too, over its mass."""
        if answer.coordinates is None:
            return None
        model = self.coarse
        if answer.creases is not None and self._creases is not None:
            model = model.with_creases(self._creases.restricted(answer.creases.angles))
        further = answer.load_matrix(self.shell.pattern)
        if further is not None:
            spread = sps.csr_array(sps.kron(self.weights, sps.eye_array(3)))
            further = sps.csr_array(spread.T @ further @ spread)
        return model.lowest_eigenvalue(answer.coordinates, further, symmetric=answer.conservative)

    def crease_angles(self, angles: Array) -> Array:
        """Plastic folds (C,) [rad] of the fine shell's creases."""
        return angles if self._creases is None else self._creases.prolonged(angles)

    def own_crease_angles(self, angles: Array) -> Array:
        """Plastic folds [rad] of the coarse shell's creases from those (C,) of the fine one's."""
        return angles if self._creases is None else self._creases.restricted(angles)

    def prolong(self, positions: ArrayLike) -> Array:
        """Fine positions (n, 3) [m] from coarse ones (k, 3) [m]; LoadError if these are of another shape or not finite.

        Vertices that the fine shell holds stay at rest.
        """
        return self._prolonged(self.coarse.shell.checked_positions(positions))

    def restrict(self, load: ArrayLike) -> Array:
        """Load (k, 3) [N] on the coarse vertices from one on the fine ones (n, 3) [N]: the same total force.

        LoadError if it is of another shape or not finite.
        """
        return self._prolongation.restrict(checked_vectors("load", load, self.shell.rest_positions.shape))

    def _prolonged(self, positions: Array) -> Array:
        fine = self._prolongation.prolong(positions)
        fine[self.shell.clamped] = self.shell.rest_positions[self.shell.clamped]
        return fine

    def flow(self, positions: Array, rates: Array) -> Array:
        """Fine velocities (n, 3) [m/s] by coarse positions (k, 3) [m] and their rates (k, 3) [m/s]."""
        fine = self._prolongation.flow(positions, rates)
        fine[self.shell.clamped] = 0.0
        return fine

    def sampled(self, positions: Array) -> Array:
        """Coarse positions (k, 3) [m] where the fine surface has its displacement there."""
        return self.sampled_from(positions - self.shell.rest_positions)

    def sampled_from(self, moved: Array) -> Array:
        """The same by displacements (n, 3) [m] of the fine surface."""
        corners = moved[self.shell.mesh.faces[self._above]]
        return self.coarse.shell.rest_positions + np.einsum("kc,kcx->kx", self._shares, corners)

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State of the coarse shell at rest."""
        begin = None if positions is None else self.sampled(self.shell.checked_positions(positions))
        state = self.integrator.at_rest(self.coarse.start_motion(begin).coordinates)
        kept = self.coarse.shell.crease_state
        return state if kept is None else self._crease_motion(Damping()).begin(state, kept.angles, kept.dissipated)

    def account(self, state: MotionState) -> str:
        """What is said of a motion that ends with large membrane strains."""
        return ends_strained(self.shell, self.positions(state))

    def _crease_motion(self, damping: Damping) -> CreaseMotion:
        creases = self.coarse.shell.creases
        assert creases is not None
        return CreaseMotion(creases, damping)

    def march(self, state: MotionState, dt: float, load_at: LoadAt, damping: Damping) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s] under loads that are asked for where they are needed; creases yield in it."""
        if self._creases is None:
            return super().march(state, dt, load_at, damping)

        def at(start: EulerStart) -> tuple[Any, Array, Array | None]:
            return own, self.carried(load_at(start)[0]), None

        own = self.coarse.stepped_by(self.integrator)
        return self._crease_motion(damping).advance(own, at, state, dt)

    def euler_step(self, start: EulerStart, load: Array, damping: Damping) -> tuple[Array, bool]:
        """Positions (k, 3) [m] of the coarse shell after a step of implicit Euler, in the frame of its supports."""
        down = self.carried(load)
        if self._step is not None:
            moved, solved = self._step(start, down, damping, self.step_tolerance, straight=self._exact)
            if solved:
                return moved, True
        after, solved = ShellSteps(self.coarse, lambda _: (self.coarse, down, None), damping).solve(start)
        return after.coordinates, solved

    def dragged(
        self, state: MotionState, before: MotionState, dt: float, damping: Damping, vertices: Index, drag: Array
    ) -> MotionState:
        """The loads' fall ``-D (v - v_n)`` taken at the step's end, against inertia and the tangent stiffness there."""
        shell, unknowns = self.coarse.shell, self.coarse.shell.unknowns
        rows = sps.csr_array(sps.kron(self.weights[vertices], sps.eye_array(3)))
        each = np.arange(len(drag) + 1)
        fall = sps.csr_array(rows.T @ sps.bsr_array((dt * drag, each[:-1], each)) @ rows)
        inertia = sps.diags_array(np.repeat((1.0 + dt * damping.mass_factor) * shell.mass, 3))
        data = shell.hessian(state.coordinates, GAUSS_NEWTON)
        stiffness = dt * (dt + damping.stiffness_factor) * shell.pattern.free_matrix(data)
        matrix = with_further(shell, stiffness, sps.csr_array(fall + inertia))
        lost = np.zeros(matrix.shape[0])
        lost[: unknowns.count] = unknowns.restrict(fall @ (state.rates - before.rates).ravel())
        change = spla.spsolve(matrix, lost)[: unknowns.count]
        rates = state.rates - unknowns.prolong(change).reshape(state.rates.shape)
        return MotionState(state.coordinates + dt * (rates - state.rates), rates)

    def resisting(self, vertices: Index, drag: Array, rates: Array) -> tuple[DiscreteShell, Array]:
        """The coarse shell whose steps resist velocities by a ``drag`` (j, 3, 3) [N s/m] at some fine vertices (j,).

        And the load (k, 3) [N] that undoes this at ``rates`` (k, 3) [m/s], at which loads were taken. Each coarse
        vertex has its share of the drag, so that the matrix keeps its pattern.
        """
        shares, model = abs(self.weights[vertices]), copy.copy(self.coarse)
        blocks = (shares.T @ (drag.reshape(-1, 9) / shares.sum(axis=1)[:, None])).reshape(-1, 3, 3)
        model.drag = model.shell.pattern.block_diagonal(blocks)
        return model, model.shell.pattern.product(model.drag, rates.ravel()).reshape(-1, 3)

    def carried(self, load: Array) -> Array:
        """Load (k, 3) [N] on the coarse vertices in motion of one on the fine ones (n, 3) [N]."""
        down = self._prolongation.restrict(load)
        return down if self.free_parts is None else self.free_parts.balanced(load, down)

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a coarse vertex by a small ``move`` (k, 3) [m]."""
        return float(largest_turn(coordinates, move, self.coarse.shell.mesh.faces))

    def positions(self, state: MotionState) -> Array:
        """Fine positions (n, 3) [m]."""
        return self._prolonged(state.coordinates)

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy of the coarse shell [J]."""
        return self.coarse.elastic_energy(state)

    def squared(self, vector: Array) -> float:
        """Square [kg m^2] of a vector (k, 3) in the norm of the coarse mass."""
        return self.coarse.squared(vector)
