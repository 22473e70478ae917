"""Base of modal models: statics in modal coordinates, with constraints and rigid modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, cast, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.errors import OptionError, SolverError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.integrators.modal import ImplicitEuler, ModalIntegrator
from modalshell.integrators.modal.base import DeadForce, ForceInTime
from modalshell.integrators.state import PUSHES, MotionState
from modalshell.loads import Loading
from modalshell.models.base.constrained_step import begun, force_held, meet_constraints
from modalshell.models.base.distortion import Distortion
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.manipulation import PatchTargets, meet, out_of_reach
from modalshell.models.base.modal_motion import CONSTRAINT_MET, EULER, ModalMotion
from modalshell.models.base.model import Model
from modalshell.models.base.reduced_sensitivity import ModalTangent
from modalshell.models.base.settle import judged, self_consistent
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import ContactStepper, Stepper
from modalshell.modes import Basis
from modalshell.modes.rigid import rigid_share
from modalshell.statics.dense import WorkPotential
from modalshell.statics.least_potential import WOUND_UP, Statics, Workable, least_potential
from modalshell.statics.modal_balance import balance, differences
from modalshell.statics.path import Followable
from modalshell.supports.constraints import Constraint

_FIXED_POINT = 1e-7
"""Relative change of the coordinates at which a fixed-point iteration has converged."""
_FIXED_POINT_LIMIT = 200
"""Fixed-point iterations at most."""
Feels = tuple[ForceInTime, list[tuple[Array, Array]]]
"""A modal force, which lists the rates (m,) and its fall (m, m) with these where it depends on them."""
_OUT_OF_REACH_LIMIT = 20
"""Number of iterations after which unreached targets are abandoned."""


class ModalModel(ModalMotion):
    """A model whose unknowns are the m modal coordinates q; the parameters are :class:`modalshell.LinearModal`'s."""

    def __init__(self, basis: Basis, *, integrator: str | ModalIntegrator = "exponential") -> None:
        super().__init__(basis, integrator=integrator)
        self._distortion = Distortion(self.shell.mesh)

    def sensitivity(self, state: Equilibrium, wrt: str | Sequence[str], *, of: ArrayLike | None = None) -> Array:
        """Derivative of an equilibrium under dead loads, that of the modes by the material with it; see :class:`Model`.

        Repeated eigenvalues do no harm, unless the basis ends within one. Rest angles act by the couples that they
        cause at rest, in the frame of the modes' own elastic forces.
        """
        if self.shell.stressed:
            raise OptionError(f"{self.name} has no derivatives about a mesh under stress: take DS")
        return ModalTangent(self, state).derivative(wrt, of)

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
        asked = found.stable and not (loading.conservative or basis.rigid_modes)
        answer = self._answer(found)
        return judged(answer, loading, self.tangent_eigenvalue) if asked else answer

    def _solve_touching(
        self, loading: Loading, start: Array | None, contacts: Sequence[Any], constraints: Sequence[Constraint]
    ) -> Equilibrium:
        from modalshell.models.base.modal_contact import equilibrium_on_modal_contacts  # not without contacts

        self._first_coordinates(start)
        found, q = equilibrium_on_modal_contacts(self, loading, start, contacts, constraints)
        outcome, message = self._distortion.judged(found.outcome, found.message, found.positions)
        return replace(found, outcome=outcome, message=message, coordinates=q)

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

    @cached_property
    def _turns(self) -> Array | None:
        """Largest rotation [rad] of a part in each mode (m,); None where no mode has any."""
        turns = np.array([self.largest_turn(unit) for unit in self._identity])
        return turns if turns.any() else None

    def fault(self, state: MotionState, positions: Array) -> Outcome | None:
        """Wound up if a part rotated by more than 2 pi, distorted if the surface is stretched or folded over."""
        # Rotations are linear in q: what the modes' own largest ones add up to bounds them.
        q, turns = state.coordinates, self._turns
        if self.frames is not None:
            q = self.frames.elastic(q)
        if turns is not None and not np.abs(q) @ turns <= WOUND_UP and self.largest_turn(q) > WOUND_UP:
            return Outcome.WOUND_UP
        # Of free parts and what contacts press in, coordinates do not tell where vertices are.
        tells = self.frames is None and PUSHES not in state.memory
        said = self._distortion.of(positions, partial(self.farthest, q) if tells else None)
        return Outcome.DISTORTED if said else None

    def _free_statics(self, load: Array, start: Array | None) -> Statics:
        """Answer to a load (n, 3), from coordinates ``start`` (m,) if there are any.

        The minimum of the potential where the force has one, else the balance by Newton along a growing load.
        """
        if self.conservative:
            return least_potential(self, load, start)

        def force(q: Array, share: float) -> Array:
            return self.modal_force(q, share * load)

        def slope(q: Array, share: float) -> Array:
            return self.modal_force_jacobian(q, share * load)

        basis = self.basis
        return balance(force, slope, basis.eigenvalues, basis.rigid_modes, self.largest_turn, start)

    def _constrained_answer(self, load: Array, start: Array | None, constraints: Sequence[Constraint]) -> Equilibrium:
        """Least modal energy under the constraints, the modal force iterated until it settles."""
        if self.basis.rigid_modes:
            raise OptionError(
                "statics under constraints needs a shell that its supports hold; clamp some vertices, or let simulate "
                "bring a free shell to rest with damping"
            )
        compliance, change, iterations, nearest = 1.0 / self.basis.eigenvalues, np.inf, 0, np.inf
        q = np.zeros(self.basis.count) if start is None else start
        targets, push = self._targets(constraints, q), self.modal_force(q, load)
        while change > _FIXED_POINT and iterations < _FIXED_POINT_LIMIT:
            if iterations == _OUT_OF_REACH_LIMIT and nearest > CONSTRAINT_MET:
                break
            before, pushed, iterations = q, push, iterations + 1
            q, residual, jacobian = meet(targets, compliance * push, compliance, q)
            push = self.modal_force(q, load)
            if not np.isfinite([*q, *push, *jacobian.ravel()]).all():
                q, push, change, (residual, jacobian) = before, pushed, np.inf, targets(before)
                break
            nearest = min(nearest, float(np.abs(residual).max()))
            work = float(np.sum(self.basis.eigenvalues * q**2)) or 1.0
            change = float(np.sqrt(np.sum(self.basis.eigenvalues * (q - before) ** 2) / work))
            change = change if load.any() else 0.0  # no modal force that could still turn
        missed, outcome, message = targets.lengths(residual), Outcome.CONVERGED, ""
        if not np.isfinite(change):
            outcome, message = Outcome.DIVERGED, "loads or targets are beyond what numbers hold"
        elif change > _FIXED_POINT and nearest <= CONSTRAINT_MET:
            outcome, message = Outcome.NO_FIXED_POINT, "the modal force under these constraints does not settle"
        elif np.abs(residual).max() > CONSTRAINT_MET:
            outcome, message = Outcome.OUT_OF_REACH, out_of_reach(float(missed.max()))
        # The modal forces that are not in balance, as forces [N] and moments [N m] of the constraints.
        reactions = targets.reactions(jacobian, self.basis.eigenvalues * q - push)
        answer = self._answer(Statics(q, change, iterations, outcome, message))
        return replace(answer, constraint_residuals=missed, constraint_reactions=reactions)

    def followable(self, load: Array) -> Followable:
        """The modal potential, for models that know the work of a load and its derivatives."""
        if not self.conservative:
            return super().followable(load)
        if self.basis.rigid_modes:
            raise OptionError(f"a path needs a shell that its supports hold (got {self.basis.rigid_modes} rigid modes)")
        return Followable(
            WorkPotential(load, np.zeros(self.basis.count), cast("Workable", self)),
            lambda q: self.shell.rest_positions + self.raw_displacement(q),
            self.coordinates_of,
            lambda q, force: self.modal_force(q, force),
        )

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion; constraints are met by the modal forces of least work."""
        return ModalStepper(self, setup.averaged)

    def rigid_load(self, load: Array) -> float:
        """Fraction of the load, in the modes' norm, on rigid modes, which have no resistance in statics."""
        pushes = self.basis.rigid_modes > 0 and load.any()
        return rigid_share(self.shell, load) if pushes else 0.0  # on all: the basis may have been asked for fewer

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest real part of the eigenvalues of ``Lambda - dp/dq`` [1/s^2], that of loads that follow in it."""
        if (q := answer.coordinates) is None:
            return None
        tangent = np.diag(self.basis.eigenvalues) - self.modal_force_jacobian(q, load)

        def moves() -> Array:  # of the answer itself: rows for contacts leave out what far turns add to them
            return self.by_differences(self.raw_displacement, q).reshape(-1, q.size)

        return answer.lowest_real_part(tangent, self.shell.pattern, moves, lambda force: self.modal_force(q, force))


@final
class ModalStepper(ContactStepper):
    """Steps under loads at few points where these serve, and onto constraints."""

    model: ModalModel
    takes_constraints = True
    _steady: Array | None = None
    """Dead load (n, 3) [N] under which the last pressed step ended, if no other force changes in time."""
    _seen: Array | None = None
    _dead: DeadForce | None = None
    """The modal force of the dead load that was seen last, if no other force acts."""

    def __init__(self, model: ModalModel, setup: MotionSetup) -> None:
        super().__init__(model, setup, in_frame=True)
        # Points serve warps about supports that rest, not frames that fly.
        still = setup.supports is None and self.model.frames is None
        self._quadrature = self.model.load_quadrature(setup.loading) if still else None
        # A load that stays, on a shell about supports that rest, changes with the coordinates alone.
        self._stays = still and self._quadrature is None and not setup.loading.live
        if isinstance(model.integrator, ImplicitEuler):
            self._lead = 1.0  # its velocities are the moves of the vertices over a step

    def _moving_contacts(self) -> Any:
        """What follows steps with contacts."""
        from modalshell.models.base.free_contact import FreeContactMotion  # not without contacts
        from modalshell.models.base.modal_contact import ModalContactMotion

        motion = ModalContactMotion if self.model.frames is None else FreeContactMotion
        contacts = motion(self.model, self.setup)
        if self.setup.constraints:
            contacts.lead(self._targets)
        return contacts

    def start(self, positions: Array | None) -> MotionState:
        """State at rest at ``positions`` (n, 3) [m], as near as its shapes come, refused inside a collider."""
        state = super().start(positions)
        return begun(self.model, state) if self.setup.constraints else state

    def state_at(self, positions: Array, time: float) -> MotionState:
        """State at rest with every vertex at ``positions`` (n, 3) [m], as far as the model can."""
        state = super().state_at(positions, time)
        return begun(self.model, state) if self.setup.constraints else state

    def outside(self, state: MotionState, time: float) -> MotionState:
        """A state that another motion's was put into at ``time`` [s], pressed out of the colliders."""
        self._steady = None
        return super().outside(state, time)

    def load_work(self, load: Array, state: MotionState) -> float:
        """Work [J] of a dead load (n, 3) [N] from rest to a state, by its coordinates where these tell it at once."""
        if self._dead is not None and load is self._seen and self._dead.work is not None:
            return self._dead.work(state.coordinates)
        return super().load_work(load, state)

    def advance(self, begin: float, dt: float, state: MotionState, load: Array) -> tuple[MotionState, bool]:
        """One step of the model's rule, onto the constraints, and outside the contacts' colliders."""
        model, damping, contacts = self.model, self.setup.damping, self._contacts
        last: list[tuple[Array, Array]] = []
        if self._stays and load is not self._seen:
            self._seen, self._dead = load, model.dead_force(load)
        dead = end = self._dead
        if self._quadrature is not None and not self._quadrature.by_points:
            end = self._quadrature.dead_force(load, begin + dt)

        def force(q: Array, rates: Array, share: float) -> Array:
            if (known := end if share == 1.0 else dead) is not None:
                return known.at(q)
            pushed, drag = self._push(begin + share * dt, load, MotionState(q, rates))
            last[:] = [] if drag is None else [(rates, drag)]
            return pushed

        if contacts is not None and contacts.touched(state):
            return self._pressed(state, (force, last), (begin, dt), load)
        felt = force_held(model, state, (dt, damping), force, last) if self.setup.constraints else force
        rule, known = model.integrator, end if felt is force else None
        after, solved = model.march(state, dt, felt, damping, known)
        if last and ("force" in after.memory or rule.forced_at < 1.0) and model.stops(dt, damping, last[0][1]):
            rule, pushed = EULER, force(state.coordinates, state.rates, 1.0)
            after, solved = model.euler_step(state, dt, pushed, damping)
        if last:
            at, (rates, drag) = rule.forced_at, last[0]
            if at < 1.0:  # of the velocity there, which is as far from the one that the force was asked for at
                rates, drag = (rates - (1.0 - at) * state.rates) / at, at * drag
            after = model.slowed(after, rates, dt, damping, drag, rule)
        if self.setup.constraints and np.isfinite(after.coordinates).all():  # else the motion ends here
            after = self._met(begin, dt, state, after, rule)
            if "force" in after.memory:
                after.memory["force"] = force(after.coordinates, after.rates, 1.0)
        if contacts is None:
            return after, solved
        after, places = contacts.clear(after), self.loaded_positions
        if (gaps := contacts.enters(places(after), begin + dt)) is not None:
            return self._pressed(state, (force, last), (begin, dt), load, gaps)
        return after, solved and not contacts.touching.passed(places(state), places(after))

    def _pressed(
        self, state: MotionState, feels: Feels, when: tuple[float, float], load: Array, gaps: Array | None = None
    ) -> tuple[MotionState, bool]:
        """The end of a step that contacts press on, of implicit Euler in the place of the rule's."""
        force, falls = feels

        def pushed() -> Array:
            known = gaps is None and load is self._steady  # the end of a pressed step under the same force
            return state.memory["force"] if known else force(state.coordinates, state.rates, 1.0)

        after, solved, own = None, True, None
        if gaps is None and not self.setup.loading.by_velocity:
            after = self._contacts.rest(state, pushed, when[1])
        if after is None:
            base = self.loaded_positions(state)
            if gaps is None and self._stays and self._dead is not None:
                after, own = self._contacts.continued(state, self._dead, when, base, load)
        foreseen = own is not None  # to third order in the step: the force was asked for at such an end
        if after is None:
            felt = pushed(), falls[0][1] if falls else None
            after, solved, own = self._contacts.follow(state, felt, (sum(when), when[1]), gaps, base)
            self.residuals = self._contacts.missed
        self._known = self._known if own is None else [*self._known[-1:], (after, own)]
        self._steady = None
        if "force" in after.memory and not foreseen:
            after.memory["force"] = force(after.coordinates, after.rates, 1.0)
            self._steady = load if self._frame is None and not self.setup.loading.live else None
        return after, solved

    def _push(self, time: float, load: Array, state: MotionState) -> tuple[Array, Array | None]:
        """Modal force (m,) of all loads on a state, and how it falls with the rates (m, m)."""
        q, model = state.coordinates, self.model
        if self._quadrature is None:
            load, drag = self.load_in_frame(time, load, state)
            pushed = model.push(q, state.rates, load, self.setup.dt)
            return pushed, None if drag is None else model.drag_at(q, *drag)
        lead, by_velocity = self._lead * self.setup.dt, self.setup.loading.by_velocity
        own = self.own_positions(state) if self._quadrature.by_points else model.shell.rest_positions
        last = own - lead * model.velocities(state, own, lead) if by_velocity else own
        push, slope = self._quadrature.push(q, own, last, 1.0 / lead, time)
        dead = self._quadrature.dead_force(load, time)
        push += dead.at(q) if dead is not None else model.modal_force(q, self._quadrature.dead(load, time))
        return push, slope if by_velocity else None

    def _met(
        self, begin: float, dt: float, state: MotionState, free: MotionState, rule: ModalIntegrator
    ) -> MotionState:
        """``free``, the state after a step of a rule from ``state``, moved onto the constraints."""
        damping, targets = self.setup.damping, lambda share: self._targets(begin + share * dt, state.coordinates)
        after, self.residuals = meet_constraints(self.model, state, free, (dt, damping), targets, rule)
        return after

    def _targets(self, time: float, q: Array) -> PatchTargets:
        """Targets of the constraints at ``time`` [s], near q (m,)."""
        pose = None if self._frame is None else self._frame.at(time)
        return self.model._targets(self.setup.constraints, q, time, pose)


def as_modal(model: Model) -> ModalModel | None:
    """``model`` if its unknowns are modal coordinates, else None."""
    return model if isinstance(model, ModalModel) else None
