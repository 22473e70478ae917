"""Hybrid model: POD of a coarse shell's motions with assumed membrane stresses, trained on random loads (theory 11)."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Self, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_callback, checked_kind
from modalshell.core.typing import Array, Index, Progress
from modalshell.integrators.full import BDF2, FullIntegrator
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import PRESSED, MotionState
from modalshell.loads import Load, Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.implicit import LoadAt, implicit_rule, slowed
from modalshell.models.base.reduced_sensitivity import LinearTangent, dead_state
from modalshell.models.coarse.on_coarse import OnCoarse
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.hybrid.assumed_stress import ReducedStress, StressPotential, measures_of, reduce_energy
from modalshell.models.hybrid.coarse_states import CoarseShape, states_of
from modalshell.models.hybrid.compliance import LinearCompliance
from modalshell.models.hybrid.farthest import Farthest
from modalshell.models.hybrid.reduced_shell import ReducedShell
from modalshell.models.hybrid.slopes import STEP, differences, forces_by_constants
from modalshell.models.hybrid.stated_error import coarse_errors, next_to_snap, stated
from modalshell.models.hybrid.trained_file import read_trained, trainable, write_trained
from modalshell.models.hybrid.training import SMALL, Trained, Training, train
from modalshell.models.reduction.derivatives import edge_changes
from modalshell.shell import EXACT, GAUSS_NEWTON, Shell
from modalshell.shell.damping import Damping
from modalshell.statics.continuation import equilibrium
from modalshell.statics.dense import force_scaling
from modalshell.statics.verdict import verdict
from modalshell.supports.constraints import Constraint


@final
class HybridStress(OnCoarse):
    """POD of a coarse discrete shell with assumed membrane stresses; it follows a snap in tenths of a millisecond.

    Positions are in the span of m vectors, trained on random loads about a given one; the membrane's energy is that of
    m trained stress states, so a basis that misses positions by a little does not lock; see
    :mod:`modalshell.models.hybrid.assumed_stress`. Loads whose linear answer the model does not have, states whose
    membrane the stresses do not see, and steps that fail are handed to :class:`CoarseDiscreteShell`, and taken back
    when they may be; so are states that a contact presses on. Damping by the stiffness has trained stresses of its own:
    those that resist the strains' rates, by which frames that turn the shell far are damped most. Parts without
    supports fly in frames of their own. Motions beyond training, or next to a snap, say so at their end. ``residual``
    of statics is the reduced gradient over the load's, each coordinate's over the root of its stiffness.

    Use :meth:`trained` or :meth:`load`.

    Attributes
    ----------
    held_out_error : float
        90th percentile of the motions' errors against the coarse shell on loads that were not in training.
    coarse_errors : ndarray, shape (c, 2)
        Shares of the load of training, and the coarse shell's own error against DS at rest under each, at most 1.
    training : str
        What it was trained on.

    Raises
    ------
    OptionError
        If the coarse shell has further energies than its material's.
        If supports leave a part some rigid motions and not all.
    """

    name = "hybrid"
    follows_snaps = True

    def __init__(
        self, shell: Shell, coarse: Shell, trained: Trained, *, integrator: str | FullIntegrator = "bdf2"
    ) -> None:
        self.shell = checked_kind("shell", shell, Shell)
        self.integrator = implicit_rule(integrator)
        self.coarse = CoarseDiscreteShell(shell, trainable(coarse), integrator=self.integrator)
        self.coarse_shell = self.coarse.coarse_shell
        self.held_out_error, self.training = trained.held_out_error, trained.description
        self.coarse_errors, self._stated = trained.coarse_errors, stated(trained)
        self._trained, self._basis = trained, trained.basis
        at_origin = measures_of(coarse.centred()[0], trained.turned)
        self._reduced: ReducedStress = reduce_energy(at_origin, trained.basis, trained.stresses)
        self._weighted = np.ascontiguousarray((trained.basis * np.repeat(coarse.mass, 3)[:, None]).T)
        self._about()
        size = trained.basis.shape[1]
        self._scaling = np.ones(size)
        own = self._hessian(np.zeros(size))
        self._scaling = force_scaling(own)
        little = 2.0 * SMALL * trained.energy if self.flight.count else None
        self._compliance = LinearCompliance(coarse, trained.basis, own, little)
        self._farthest = Farthest(self._statics(np.zeros(size)), trained.energy, self.flight.count)

    def _about(self) -> None:
        """Make what knows where the shells are."""
        self._shape = CoarseShape(self.coarse, self._basis, self._weighted)
        self._moving = ReducedShell(self._trained, self._reduced, self._shape, self._push)
        self._states = states_of(self._shape)
        self.flight = self._states.flight

    @classmethod
    def trained(
        cls,
        shell: Shell,
        *,
        gravity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        loads: Sequence[Load] | None = None,
        coarse: Shell | None = None,
        modes: int | None = None,
        motions: int | None = None,
        seed: int = 0,
        error: float | None = None,
        on_step: Progress | None = None,
        integrator: str | FullIntegrator = "bdf2",
    ) -> HybridStress:
        """Train on random loads about a given one.

        Parameters
        ----------
        shell : Shell
            The shell.
        gravity, force, loads : optional
            The load about which to train, as in :meth:`equilibrium`.
        coarse : Shell, optional
            A coarse shell of the same surface, which is reduced; by default ``shell`` itself.
        modes : int, optional
            Vectors m of the basis, by default 32 of hinges, 44 of shell theory, and up to 64 where these miss an error
            of 0.03 and more serve; with ``error`` the most, by default 64.
        motions : int, optional
            Motions through the random loads, and back, to train on, by default 120 of shell theory and 40 of hinges; a
            sixth as many, at least 10, are held out. Each is of 30 frames under the load and 15 after it, eight to a
            period of the lowest mode.
        seed : int
            Of the random loads.
        error : float, optional
            Wanted ``held_out_error``: the basis grows from 16 to 24, 32, 44 and 64 vectors, as far as ``modes`` lets
            it and at last to these, until it is met. Where none meets it, the best is taken, and a
            :class:`ModalShellWarning` says so.
        on_step : callable, optional
            Called with the motions done and their total.
        integrator : str or FullIntegrator
            Rule of its steps: "bdf2", "composite", "sdirk2" or "implicit" (Euler).

        Raises
        ------
        OptionError
            For a load of zero, energies other than the material's, or options out of range.
        """
        checked_kind("shell", shell, Shell)
        on_step = checked_callback("on_step", on_step)
        load, small = shell.total_load(gravity, force, loads), trainable(coarse or shell)
        training = Training(modes, measures_of(small).motions if motions is None else motions, seed, error)
        model = CoarseDiscreteShell(shell, small)
        found = train(small, model.restrict(load), training, on_step)
        found = replace(found, coarse_errors=coarse_errors(model, load, training.frames))
        return cls(shell, small, found, integrator=integrator)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trained data to an ``.npz`` file (no pickle)."""
        write_trained(path, self._trained, self.coarse.coarse.shell)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        shell: Shell,
        coarse: Shell | None = None,
        *,
        integrator: str | FullIntegrator = "bdf2",
    ) -> HybridStress:
        """Read what :meth:`save` wrote, for the same shells; FileFormatError if it is damaged or of other shells."""
        small = coarse or shell
        trained = read_trained(path, trainable(small))
        return cls(shell, small, trained, integrator=integrator)

    def centred(self) -> tuple[Self, Array]:
        """The same model about the origin, and where its origin was."""
        coarse, origin = self.coarse.centred()
        if not origin.any():
            return self, origin
        model = copy.copy(self)
        model.shell, model.coarse = coarse.shell, coarse
        model._about()
        return model, origin

    def refusal(self, load: Array) -> str:
        """Why a coarse load (k, 3) [N] is handed over, by its linear compliance; empty where it is not."""
        return self._compliance.refusal(load)

    def _push(self, load: Array) -> Array | None:
        """Force (m,) of a load (n, 3) [N]; None where that is handed over."""
        down = self.coarse.restrict(load)
        return None if self.refusal(down) else down.ravel() @ self._basis

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        down = self.coarse.restrict(load)
        if reason := self.refusal(down):
            return self._handed_over(load, start, reason)
        problem = self._statics(down.ravel() @ self._basis)
        found = equilibrium(problem, None if start is None else self.flight.start(start)[self.flight.count :])
        z = found.point
        if not found.converged or not self._moving.sees_state(z):
            return self._handed_over(load, start, "the assumed stresses do not see the membrane there")
        ended = verdict(found.residual, True, note=stated(self._trained, next_to_snap(problem, z, found.jumps)))
        positions = self._shape.fine(self._shape.under(z))
        return Equilibrium(positions, *ended, found.iterations, found.residual, True, coordinates=z)

    def _statics(self, push: Array) -> StressPotential:
        return StressPotential(
            push, np.zeros_like(push), self._reduced, self._scaling, self._edge_change, self._moving.count
        )

    def _edge_change(self, z: Array) -> float:
        """Largest relative change of an edge vector of the coarse shell by z."""
        return float(edge_changes(self.coarse.coarse.shell, self._shape.moved(z)[:, :, None]).max())

    @property
    def _step(self) -> float:
        """Step [kg^(1/2) m] of differences by the coordinates: it changes edges by at most a share of their lengths."""
        return STEP / max(self._edge_change(unit) for unit in np.eye(self._basis.shape[1]))

    def _handed_over(self, load: Array, start: Array | None, reason: str) -> Equilibrium:
        answer = self.coarse.equilibrium(force=load, start=start)
        message = "; ".join(part for part in (f"answered by {self.coarse.name}: {reason}", answer.message) if part)
        return replace(answer, message=message, coordinates=None)

    def remark(self, state: MotionState) -> str:
        """The range of training, or that the coarse shell has taken the step, and why."""
        if state.coordinates.ndim == 1:
            return self._stated
        reason = "the trained states do not hold the motion"
        if not self._moving.held_last():
            reason = "the trained model does not hold the load"
        if np.any(state.memory.get(PRESSED, False)):
            reason = "contacts press on the shell"
        return f"answered by {self.coarse.name}: {reason}"

    def _hessian(self, z: Array) -> Array:
        """Hessian of the energy, that of hinges with a rest angle without their second derivatives."""
        return self._statics(np.zeros_like(z)).linearise(z, EXACT)[1]

    def account(self, state: MotionState) -> str:
        """That a motion went beyond the energies of training, or came next to a snap."""
        return self._farthest.account(state)

    def _energy(self, z: Array) -> tuple[float, Array]:
        """Energy [J] and its gradient."""
        return self._statics(np.zeros_like(z)).potential(z)

    def sensitivity(self, state: Equilibrium, wrt: str | Sequence[str], *, of: ArrayLike | None = None) -> Array:
        """Derivative of an equilibrium under dead loads as trained, no matter what training would change.

        See :class:`Model`; constants are those of the coarse shell.
        """
        z = dead_state(state)[0]
        hessian = differences(lambda z: self._energy(z)[1], z, self._step)
        measures = measures_of(self.coarse.coarse.shell, self._trained.turned)
        constants = forces_by_constants(measures, self._reduced, self._trained.stresses, self._basis, z)
        tangent = LinearTangent(self.shell, state, hessian, *self._moves(z), constants)
        return tangent.derivative(wrt, of)

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest eigenvalue [1/s^2] of the reduced Hessian, that of loads that follow in it.

        Of answers by the coarse shell it is that shell's.
        """
        z = answer.coordinates
        if z is None:
            answer = replace(answer, coordinates=self.coarse.sampled(answer.positions))
            return self.coarse.tangent_eigenvalue(answer, load)
        return answer.lowest_eigenvalue(self._hessian(z), self.shell.pattern, lambda: self._moves(z))

    def _moves(self, z: Array) -> tuple[Array, Array]:
        """What takes rates of z to velocities of the vertices (3n, m), and loads there to forces on z."""
        columns = differences(lambda z: self._shape.fine(self._shape.under(z)).ravel(), z, self._step)
        spread = np.asarray(self.coarse.weights @ self._basis.reshape(len(self._shape.rest), -1))
        return columns, spread.reshape(columns.shape)

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest, of coordinates (m,), those of frames of free parts before them.

        Of a shell with free parts it is one of the coarse shell where the basis does not hold the start.
        """
        flight = self.flight
        if positions is None:
            return self._farthest.begun(self.integrator.at_rest(flight.whole(np.zeros(self._basis.shape[1]))))
        q = flight.start(given := self.shell.checked_positions(positions))
        if flight.count and not (self._shape.near(given, q, flight) and self._moving.sees_state(q[flight.count :])):
            return self._farthest.begun(self.coarse.start_motion(given))
        return self._farthest.begun(self.integrator.at_rest(q))

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s] under a ``load`` (n, 3) [N] that stays: mostly in one call."""
        if type(self.integrator) is BDF2 and state.coordinates.ndim == 1 and not self.flight.count:
            after = self._moving.bdf2_step(state, dt, load, damping)
            if after is not None:
                return self.remembered(state, after), True
        return super().step(state, dt, load, damping, held)

    def remembered(self, before: MotionState, after: MotionState) -> MotionState:
        """The state ``after`` a step, whose memory knows how far the motion has gone."""
        return self._farthest.seen(before, after)

    def march(self, state: MotionState, dt: float, load_at: LoadAt, damping: Damping) -> tuple[MotionState, bool]:
        """Steps in the coordinates, or of the coarse shell's positions (k, 3) where that must be."""
        if (reduced := self._taken_back(state)) is not None:
            steps = self.flight.steps(self, (reduced, dt), load_at, damping)
            after, solved = self.integrator.march(steps, reduced, dt)
            if solved:
                return self.remembered(state, self._states.landed(state, reduced, after)), True
        after, solved = self.coarse.march(self.as_coarse(state), dt, load_at, damping)
        return self.remembered(state, after), solved

    @property
    def on_coarse(self) -> CoarseDiscreteShell:
        """The coarse shell that bears contacts."""
        return self.coarse

    def as_coarse(self, state: MotionState) -> MotionState:
        """A state in positions (k, 3) [m] of the coarse vertices."""
        return state if state.coordinates.ndim == 2 else self._states.as_coarse(state)

    def _solve_touching(
        self, loading: Loading, start: Array | None, contacts: Sequence[Any], constraints: Sequence[Constraint]
    ) -> Equilibrium:
        from modalshell.models.coarse.contacts import equilibrium_or_coarse_contacts  # not without contacts

        free = partial(self.solved, loading, start)
        return equilibrium_or_coarse_contacts(self.coarse, free, loading, start, contacts, constraints)

    def euler_step(self, start: EulerStart, load: Array, damping: Damping, size: float = 0.0) -> tuple[Array, bool]:
        """Coordinates z (m,) after a step of implicit Euler; not solved where the trained model does not hold it."""
        return self._moving.euler_step(start, load, damping)

    def dragged(
        self, state: MotionState, before: MotionState, dt: float, damping: Damping, vertices: Index, drag: Array
    ) -> MotionState:
        """The loads' fall ``-D (v - v_n)`` taken at the step's end."""
        z = before.coordinates
        rows = np.asarray(self.coarse.weights[vertices] @ self._basis.reshape(len(self._shape.rest), -1))
        stiffness = self._statics(np.zeros_like(z)).linearise(z, GAUSS_NEWTON)[1]
        return slowed(state, before, dt, damping, stiffness, rows.reshape(-1, 3, z.size), drag)

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a coarse vertex by a small ``move`` (m,) of the coordinates."""
        return self.coarse.turn(self._shape.under(coordinates), self._shape.moved(move))

    def _taken_back(self, state: MotionState) -> MotionState | None:
        """The coordinates of a state; None where the basis does not hold a coarse one."""
        if state.coordinates.ndim == 1:
            return state
        z, held = self._shape.nearest(self._states.local(state.coordinates))
        return self._states.reduced(state) if held and self._moving.sees_state(z) else None

    def positions(self, state: MotionState) -> Array:
        """Fine positions (n, 3) [m]."""
        x = state.coordinates
        return self._shape.fine(x) if x.ndim == 2 else self.flight.positions(x)

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s] of a state; see :meth:`Model.velocities`."""
        known = self.coarse if state.coordinates.ndim == 2 else self.flight
        return known.velocities(state, own, lead)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of the rates, and of the frames of free parts."""
        return (self.coarse if state.coordinates.ndim == 2 else self.flight).kinetic_energy(state)

    def rigid_load(self, load: Array) -> float:
        """Share of a load (n, 3) that moves free parts as rigid bodies."""
        return self.flight.rigid_load(load)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array | None:
        """Error in the coordinates that a step has made, by the integrator's theory; none where these changed."""
        error = super().local_error(before, after, dt)
        if error is None or {part.shape for part in (before.coordinates, after.coordinates)} != {error.shape}:
            return error
        return error if error.ndim == 2 else self.flight.local_error(error, before, after)

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy [J], of the assumed stresses where the state is one of coordinates."""
        x = state.coordinates
        return self.coarse.elastic_energy(state) if x.ndim == 2 else self._energy(x[self.flight.count :])[0]

    def squared(self, vector: Array) -> float:
        """Square [kg m^2] of coordinates (m,), or of coarse vectors (k, 3) in the norm of their mass."""
        return self.coarse.squared(vector) if vector.ndim == 2 else float(vector @ vector)

    def largest_move(self, change: Array) -> float:
        """Largest displacement [m] of a coarse vertex by a small ``change``."""
        return super().largest_move(change if change.ndim == 2 else self._states.moved(change))
