"""Contacts of a shell whose positions are linear in few coordinates: statics, and steps of implicit Euler.

Mixed Newton's steps, each a small complementarity problem (theory 13, eq. 7 and 8): of the least of the quadratic
model of the energy outside the colliders to first order, with what the shell gives way beyond its vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np
import scipy.linalg

from modalshell.contact.contact import Contact
from modalshell.contact.modal import ModalContacts
from modalshell.contact.pressed import Pressed
from modalshell.contact.touching import checked_contacts, touched_frame
from modalshell.core.errors import OptionError
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array, Index
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import PUSHES, MotionState
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.implicit import AskedSteps, LoadAt
from modalshell.models.base.pressed_motion import LOCAL, PressedMotion
from modalshell.models.base.settle import self_consistent
from modalshell.models.base.setup import MotionSetup
from modalshell.models.reduction.vertex_turns import VertexTurns
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED
from modalshell.shell.damping import Damping
from modalshell.statics import mixed_newton as method
from modalshell.statics.continuation import Steps
from modalshell.statics.verdict import verdict

_MOST = 40
"""Steps at most."""
_DOUBLINGS = 40
"""Doublings at most, from what the Hessian lacks on, of the stiffness along gaps."""


class Settled(NamedTuple):
    """Where the steps ended: the coordinates and forces, the residual, the number of steps, and whether they ended."""

    pressed: Pressed
    residual: float
    iterations: int
    solved: bool


def reduced_contacts(model: Any, contacts: Sequence[Contact]) -> ModalContacts:
    """The contacts of a model with ``basis.vectors``; OptionError where it cannot take them."""
    given, basis = checked_contacts(contacts), model.basis
    if model.flight.count:
        raise OptionError(
            f"{model.name} takes contacts of shells that supports hold: hold some vertices, or take DS, coarse DS, the "
            "hybrid, or in motion LMA, MWTS or RSW"
        )
    for index, contact in enumerate(given):
        if contact.friction or contact.push_out or contact.restitution:
            raise OptionError(
                f"contact {index} has friction, push_out or restitution, which {model.name} does not take: take DS or "
                "coarse DS"
            )
    rows = basis.vectors.reshape(-1, 3, basis.size)
    turns = VertexTurns(model.shell.mesh, model.shell.rest_positions)

    def rows_at(q: Array, vertices: Index) -> Array:  # noqa: ARG001 (they are the same everywhere)
        return np.asarray(rows[vertices])

    span = replace(basis.modes, modes=basis.vectors, eigenvalues=basis.eigenvalues)
    return ModalContacts(given, span, model.positions_at, rows_at, turns=lambda q: turns.vectors(model.positions_at(q)))


def settle(
    problem: Any,
    pressing: ModalContacts,
    begin: Pressed,
    scale: float,
    goal: float,
    stresses: list[Array] | None = None,
    *,
    at_start: float = 1.0,
) -> Settled:
    """Least potential outside the colliders, by mixed Newton with contacts from ``begin``.

    ``problem`` is a :class:`~modalshell.models.reduction.reduced_energy.ReducedPotential`, ``scale`` the size of its
    load, to which the residual relates, ``stresses`` those predicted at the beginning. Without a load and contact
    forces the residual is over the forces ``at_start``.
    """
    pressed, residual = begin, np.inf
    for count in range(_MOST + 1):
        z, pushes = pressed.q, pressed.pushes
        gradient, hessian = problem.linearise(z, GAUSS_NEWTON if stresses is None else MIXED, stresses)
        state = pressing.state(z, pushes, pressed.local)
        x = pressing.positions(z) + state.local
        out = gradient - pressing.pull(z, pressing.touching.forces(x, pushes))
        whole = max(scale, problem.measure(gradient - out)) or at_start
        residual = problem.measure(out) / whole
        if not np.isfinite(residual) or (pressed.solved and residual <= goal) or count == _MOST:
            break
        hessian = hessian - pressing.turning(z, x, pushes)
        if not problem.factor(hessian).is_definite():
            stiffened = _stiffened(problem, pressing, hessian, pressed)
            hessian = problem.linearise(z, GAUSS_NEWTON)[1] if stiffened is None else stiffened
        compliance = np.linalg.inv(hessian)
        found = pressing.pressed_on(z - compliance @ gradient, compliance, state)
        moved, stresses, _ = problem.moved(z, found.q - z)
        pressed = found._replace(q=moved)
    pressed = pressed._replace(local=state.local)
    return Settled(pressed, residual, count, bool(pressed.solved and residual <= goal))


def _stiffened(problem: Any, pressing: ModalContacts, hessian: Array, pressed: Pressed) -> Array | None:
    """A Hessian (m, m) that is positive definite on the motions that keep the gaps, made so on all of them.

    Surfaces that turn under large forces take more than the shell's stiffness from motions into them, which the gaps
    forbid. Stiffness along the gaps of what is pushed replaces it, no more than must be. Where the steps end these gaps
    move no more, and what was added gives no force. None where it does not help.
    """
    rows = np.flatnonzero(pressed.pushes)
    if not rows.size:
        return None
    held = pressing.along(pressed.q, rows) / problem.scaling
    added = problem.scaling[:, None] * (held.T @ held) * problem.scaling
    scaled = hessian / problem.scaling[:, None] / problem.scaling
    share = abs(float(np.linalg.eigvalsh(scaled)[0])) / (float(np.sum(held**2)) or 1.0)
    for _ in range(_DOUBLINGS):
        if problem.factor(hessian + share * added).is_definite():
            return hessian + share * added
        share *= 2.0
    return None


def reduced_equilibrium_on_contacts(
    model: Any, loading: Loading, start: Array | None, contacts: Sequence[Contact]
) -> Equilibrium:
    """Equilibrium with contacts of a model linear in its coordinates, from positions ``start`` (n, 3) [m] or rest.

    Loads come in steps where that must be.
    """
    pressing = reduced_contacts(model, contacts)
    pressing.touching.refuse_inside(model.shell.rest_positions if start is None else start)

    def solve(load: Array, start: Array | None) -> Equilibrium:
        return _rest(model, pressing, load, start)

    return self_consistent(solve, loading, start) if loading.live else solve(loading.dead, start)


def _rest(model: Any, pressing: ModalContacts, load: Array, start: Array | None) -> Equilibrium:
    """Equilibrium under a dead load (n, 3) [N]."""
    z, rows = np.zeros(model.basis.size), pressing.touching.vertices.size
    if start is not None:
        z = model.coordinates_of(start)
    x = model.positions_at(z)
    pressed, steps, iterations = Pressed(z, np.zeros_like(x), np.zeros(rows), False), Steps(), 0
    whole = model.statics_of(load)
    scale, at_start = whole.measure(whole.push), whole.scale_at(z)
    while steps.fraction < 1.0:
        problem = model.statics_of(steps.target * load)
        goal = method.ACCEPTED if steps.target == 1.0 else problem.path_goal
        with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
            found = settle(problem, pressing, pressed, scale, goal, at_start=at_start)
        iterations += found.iterations
        reached = model.positions_at(found.pressed.q) + found.pressed.local
        if not found.solved or pressing.touching.crossed(x, reached):
            if steps.refuse():
                continue
            break
        pressed, x = found.pressed, reached
        steps.accept()
    converged = steps.fraction >= 1.0
    stable = _stable(problem, pressing, found.pressed) if converged else None
    outcome, message = verdict(found.residual if converged else np.inf, stable)
    if not converged:
        message = f"the contact set did not settle at {steps.target:.3g} of the load: take DS or coarse DS"
    forces, touches, deepest, _ = touched_frame(pressing.touching, x, pressed.pushes)
    return Equilibrium(
        x,
        outcome,
        message,
        iterations,
        found.residual,
        stable,
        coordinates=pressed.q,
        contact_forces=forces,
        in_contact=touches,
        deepest=deepest,
    )


def _stable(problem: Any, pressing: ModalContacts, pressed: Pressed) -> bool:
    """Whether the exact Hessian is positive definite on the motions that keep the gaps."""
    rows = np.flatnonzero(pressed.pushes)
    hessian = problem.linearise(pressed.q, EXACT)[1]
    held = pressing.along(pressed.q, rows) / problem.scaling
    left = scipy.linalg.null_space(held) if rows.size else np.eye(pressed.q.size)
    part = left.T @ (hessian / problem.scaling[:, None] / problem.scaling) @ left
    return bool(part.size == 0 or np.linalg.eigvalsh(part)[0] > 0.0)


@final
class _PressedSteps(AskedSteps):
    """Steps of implicit Euler of a model that contacts press on, within one that begins at ``when`` [s], of a length.

    ``given`` (n, 3) [N s] are the impulses of the colliders so far, and ``stays`` whether what they push on is what
    they pushed on at the beginning. If it ``must`` be, a step in which it is not counts as not solved.
    """

    def __init__(
        self,
        model: Any,
        motion: tuple[ModalContacts, Damping, float],
        begin: Pressed,
        load_at: LoadAt,
        when: tuple[float, float],
        *,
        must: bool = False,
    ) -> None:
        self._pressing, damping, self._goal = motion
        super().__init__(model, load_at, damping)
        self._when, self._must = when, must
        self.pressed, self.given = begin, np.zeros_like(begin.local)
        self._was, self.stays = begin.pushes > 0.0, True

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """State at the end, and whether its equations were solved."""
        (load, drag), model, fall = self._load_at(start), self._model, None
        if drag is not None:
            rows = model.rows(drag[0])
            fall = np.tensordot(rows, drag[1] @ rows, ((0, 1), (0, 1)))
        push = load.ravel() @ model.basis.vectors
        problem, scale = model.step_problem(start, push, self._damping, fall)
        guess, (begin_at, whole) = start.origin + start.dt * start.rates, self._when
        self._pressing.at(begin_at + start.end * whole)
        stresses = problem.energy.predicted_stresses(start.near, np.zeros_like(guess))
        begin = self.pressed._replace(q=guess, positions=None)
        found = settle(problem, self._pressing, begin, scale, self._goal, stresses)
        self.pressed = found.pressed
        reached = self._model.positions_at(found.pressed.q) + found.pressed.local
        self.given += start.dt * self._pressing.touching.forces(reached, found.pressed.pushes)
        self.stays &= np.array_equal(found.pressed.pushes > 0.0, self._was)
        after = start.after(found.pressed.q)
        if drag is not None:
            lost = drag[1] @ (rows @ (after.rates - start.expected_rates))[:, :, None]
            np.subtract.at(load, drag[0], lost[:, :, 0])
        self._load = load
        return after, found.solved and (self.stays or not self._must)


@final
class ReducedContactMotion(PressedMotion):
    """Takes the steps of a model linear in its coordinates with contacts: the model's own where nothing touches.

    On colliders at rest the rule goes on as long as what touches stays as it is, and little energy is gained, which
    slower rates give back. Elsewhere implicit Euler stands in for it, and its end is the least of its potential outside
    the colliders. ``goal`` is the residual of a step.
    """

    _mean: tuple[Array | None, Array | float] = None, 0.0  # coordinates where a step ended, and forces (n, 3) [N] in it

    def frame(self, state: MotionState, positions: Array, time: float) -> TouchedFrame:
        """What touches in a state; forces are the means of the step, whatever the parts in which it was taken."""
        found, (at, forces) = super().frame(state, positions, time), self._mean
        return found._replace(forces=np.asarray(forces)) if at is state.coordinates else found

    def __init__(self, model: Any, setup: MotionSetup, goal: float) -> None:
        super().__init__(model, setup)
        self._goal = goal

    @staticmethod
    def _contacts_of(model: Any, contacts: Sequence[Contact]) -> ModalContacts:
        return reduced_contacts(model, contacts)

    def advance(self, begin: float, dt: float, state: MotionState, load_at: LoadAt) -> tuple[MotionState, bool]:
        """The state a step of ``dt`` [s] after ``state``, that at ``begin`` [s]; and whether it was solved."""
        model, pressing, damping = self._model, self._pressing, self._setup.damping
        kept = state.memory
        own = MotionState(state.coordinates, state.rates, {k: v for k, v in kept.items() if k not in self._none})
        pressing.at(begin + dt)
        if not kept[PUSHES].any():
            after, solved = model.march(own, dt, load_at, damping)
            reached = model.positions(after)
            if not pressing.touched(pressing.gaps(reached)):
                return self.clear(after), solved and not pressing.touching.passed(model.positions(own), reached)
        first = Pressed(state.coordinates, kept[LOCAL], kept[PUSHES], False)
        given = model, (pressing, damping, self._goal), first, load_at, (begin, dt)
        rule, pushed = model.integrator, kept[PUSHES].any()
        if pushed and not pressing.moving:
            euler = _PressedSteps(*given, must=True)
            after, solved = rule.continued(euler, own, dt)
            after = self._ended(after, euler.pressed)
            slower = self._slowed(state, after, euler) if solved else None
            if slower is not None:
                return slower, True
        euler = _PressedSteps(*given)
        after, solved = rule.standing_in(euler, own, dt)
        self._mean = after.coordinates, euler.given / dt
        after = rule.stood_in_for(own, after, dt, smooth=bool(solved and pushed and euler.stays))
        return self._ended(after, euler.pressed), solved

    def _ended(self, after: MotionState, pressed: Pressed) -> MotionState:
        """The end of a step with what contacts press in."""
        return MotionState(after.coordinates, after.rates, after.memory | self._memory(pressed))

    def _slowed(self, before: MotionState, after: MotionState, euler: _PressedSteps) -> MotionState | None:
        """The end of a step on colliders at rest without what it has gained; None where that is more than little."""
        model, load = self._model, euler.load_on(after.coordinates)
        moved = model.positions_at(after.coordinates) - model.positions_at(before.coordinates)
        slower = self.slower(before, after, float(np.vdot(load, moved)))
        if slower in (0.0, 1.0):
            return after if slower else None
        less, memory = (slower - 1.0) * after.rates, after.memory
        gains = {name: memory[name] + less for name in ("gain", "middle_gain") if name in memory}
        return MotionState(after.coordinates, after.rates + less, memory | gains)
