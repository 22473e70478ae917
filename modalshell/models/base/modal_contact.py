"""Contacts of modal models: statics, and what follows each step."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.friction import creep_note
from modalshell.contact.modal import ModalContacts
from modalshell.contact.modal_kernels import implicit_euler
from modalshell.contact.pressed import Pressed
from modalshell.contact.resting import STILL, Resting
from modalshell.contact.touching import checked_contacts, refuse_friction, touched_frame
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.integrators.full.sdirk2 import SDIRK2
from modalshell.integrators.full.second_order import GAMMA
from modalshell.integrators.modal.base import DeadForce
from modalshell.integrators.state import COST, PUSHES, MotionState
from modalshell.loads import Loading
from modalshell.models.base.constrained_step import HELD
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.led_contact import LedTargets, hold_patches, led_from, press_led
from modalshell.models.base.manipulation import MET, PatchTargets
from modalshell.models.base.modal_motion import EULER, ModalMotion
from modalshell.models.base.pressed_motion import BEYOND, LOCAL, TAKEN, PressedMotion
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.staying import staying
from modalshell.statics.continuation import Steps
from modalshell.supports.constraints import Constraint

_PROBLEMS, _LED = 40, 200
"""Quadratic problems in a row at most, and with constraints, whose patches may buckle a shell."""
_SETTLED = 1e-8
"""Change of the coordinates, in the norm of their energy, over their size, at which statics has settled."""
_FAINT = 1e-6
"""Amplitude, as a share of the shell's size, of a swing in the lowest mode below which implicit Euler ends it."""
_LENGTHS = 16
"""Lengths of steps of which compliances are kept."""
Felt = tuple[Array, Array | None]
"""A modal force (m,), and how it falls with the rates (m, m) [1/s]; None where it does not."""
_LONGEST = 0.5
"""Longest move [rad] of a quadratic problem's step: a part of the shell turns by no more."""


def modal_contacts(model: ModalMotion, contacts: Sequence[Contact]) -> ModalContacts:
    """The contacts of a modal model; OptionError where it cannot take them."""
    given = checked_contacts(contacts)
    if model.frames is None and model.basis.rigid_modes:
        raise OptionError(
            f"{model.name} takes contacts of parts that their supports hold, or that have none and all six rigid modes "
            f"(got {model.basis.rigid_modes} rigid modes): hold more vertices, ask for more modes, or take DS"
        )
    for index, contact in enumerate(given):
        if contact.push_out:
            raise OptionError(f"contact {index} has push_out, which {model.name} does not take: take DS")

    turns, shape, tiles = not model.straight, model.contact_shape, model.contact_tiles
    hooks = model.warped_positions, model.contact_rows
    return ModalContacts(given, model.basis, *hooks, near=model.contact_frame, turns=turns, shape=shape, tiles=tiles)


def equilibrium_on_modal_contacts(
    model: ModalMotion,
    loading: Loading,
    start: Array | None,
    contacts: Sequence[Contact],
    constraints: Sequence[Constraint],
) -> tuple[Equilibrium, Array]:
    """Equilibrium with contacts, by quadratic problems one after the other; and its coordinates (m,).

    At q each takes the energy's exact slope and curvature, contact forces as loads with them, and the gaps to first
    order. Where they do not settle, or lead through a collider, the load comes in steps.
    """
    if model.frames is not None:
        raise OptionError(
            f"statics of {model.name} take contacts of shells that supports hold: hold some vertices, take DS or "
            "coarse DS, or let simulate bring a free shell to rest with damping"
        )
    refuse_friction(checked_contacts(contacts), f"statics of {model.name}")
    pressing = modal_contacts(model, contacts)
    rest = model.shell.rest_positions
    pressing.touching.refuse_inside(rest if start is None else start)
    q = np.zeros(model.basis.count) if start is None else model.coordinates_of(start)
    led = led_from(model, pressing, q, constraints) if constraints else None
    steps = Steps(1.0 if led is None else led.first)
    pushes, iterations = np.zeros(pressing.touching.vertices.size), 0
    x, local, change = rest + model.raw_displacement(q), np.zeros_like(rest), np.inf
    while steps.fraction < 1.0:
        with np.errstate(over="ignore", invalid="ignore"):  # of problems that run away, and are refused
            pressed, change, taken = _settle(model, pressing, loading, steps.target, (q, pushes, local), led)
        iterations += taken
        if pressed is None or pressing.touching.crossed(
            x, reached := rest + model.raw_displacement(pressed.q) + pressed.local
        ):
            if steps.refuse():
                continue
            break
        q, pushes, local, x = pressed.q, pressed.pushes, pressed.local, reached
        steps.accept()
    converged = steps.fraction >= 1.0
    forces, touches, deepest, _ = touched_frame(pressing.touching, x, pushes)
    answer = Equilibrium(
        x,
        Outcome.CONVERGED if converged else Outcome.NOT_CONVERGED,
        "" if converged else f"the contact set did not settle at {steps.target:.3g} of the load: take DS or coarse DS",
        iterations,
        change,
        None,
        coordinates=q,
        contact_forces=forces,
        in_contact=touches,
        deepest=deepest,
    )
    if led is not None:
        unbalanced = model.basis.eigenvalues * q - model.modal_force(q, loading.force(x)) - pressing.pull(q, forces)
        answer = led.answered(answer, local, unbalanced)
    return answer, q


def _settle(
    model: ModalMotion,
    pressing: ModalContacts,
    loading: Loading,
    share: float,
    begin: tuple[Array, Array, Array],
    led: LedTargets | None,
) -> tuple[Pressed | None, float, int]:
    """Quadratic problems under a share of the load; None where they do not settle, the last change, their number.

    Constraints are led that share of their way under the whole load, from where they are met without contacts. The
    beginning are coordinates (m,), forces (r,) [N], and displacements (n, 3) [m] beyond the modes.
    """
    eigenvalues, rest = model.basis.eigenvalues, model.shell.rest_positions
    (q, pushes, local), change, turns = begin, np.inf, np.abs(model.basis.rotations).max(axis=0)
    if led is not None:
        x = rest + model.raw_displacement(q)
        pushed = model.modal_force(q, loading.force(x)) + pressing.pull(q, pressing.touching.forces(x, pushes))
        q, share = led.near(pushed / eigenvalues, 1.0 / eigenvalues, q, local, share), 1.0
    for count in range(1, (_PROBLEMS if led is None else _LED) + 1):
        x = rest + model.raw_displacement(q)
        load = share * loading.force(x)
        # Contact forces act by their work, whatever the model's rule for loads.
        forces, unbalanced = pressing.touching.forces(x, pushes), eigenvalues * q - model.modal_force(q, load)
        try:
            if led is not None:
                forces = forces + led.forces(q, unbalanced - pressing.pull(q, forces), len(x))
            bent = model.work_curvature(q, forces)
            hessian = np.diag(eigenvalues) - model.modal_force_jacobian(q, load) - bent
            if led is not None:
                hessian = led.stiffened(q, hessian, eigenvalues)
            compliance = np.asarray(np.linalg.inv(hessian), np.float64)
            free = q - compliance @ unbalanced
            if led is not None:
                free, compliance = led.along(q, free, compliance)
        except np.linalg.LinAlgError:
            return None, change, count
        pressed = pressing.pressed_on(free, compliance, pressing.state(q, pushes, 0.0))
        move = pressed.q - q
        turn = float(np.abs(move) @ turns)
        part = min(1.0, _LONGEST / turn) if turn > 0.0 else 1.0
        scale = float(np.sqrt(eigenvalues @ pressed.q**2)) or 1.0
        change = float(np.sqrt(eigenvalues @ move**2)) / scale
        if not np.isfinite(change):
            return None, change, count
        q, pushes = q + part * move, pressed.pushes
        met = led is None or led.off(pressed) <= MET
        if change <= _SETTLED and pressed.solved and met:
            return pressed, change, count
    return None, change, count


REST, REST_PUSHES = "rests_at", "rest_pushes"
"""Names in a state's memory of the coordinates (m,) and contact forces (r,) [N] of the last whole frame; infinite where
the shell did not rest."""


class ModalPressedMotion(PressedMotion):
    """What follows each step of a modal model with contacts.

    Where a vertex touches, or would, a step of implicit Euler is taken in the step's place.
    """

    missed = np.zeros(0)
    """What the last step has left to targets of constraints (k,), [m] or [rad]."""

    def __init__(self, model: ModalMotion, setup: MotionSetup) -> None:
        super().__init__(model, setup)
        self._damp = setup.damping.of_modes(model.basis.eigenvalues)
        self._impulses = dict[float, Array]()
        self._ended: tuple[Array, Array] | None = None

    @staticmethod
    def _contacts_of(model: ModalMotion, contacts: Sequence[Contact]) -> ModalContacts:
        found = modal_contacts(model, contacts)
        for index, contact in enumerate(contacts):
            if model.frames is None and (contact.friction or contact.restitution):
                raise OptionError(
                    f"contact {index} has friction or restitution, which motions of {model.name} take of shells "
                    "without supports alone: take DS or coarse DS"
                )
        return found

    @property
    def note(self) -> str:
        """What is said of friction; "" without it."""
        pressing = self._pressing
        return creep_note(pressing.touching.size, self._setup.dt) if pressing.rubs else ""

    def touched(self, state: MotionState) -> bool:
        """Whether a state is pushed: the next step is one of implicit Euler, whatever the model's rule."""
        return bool(np.count_nonzero(state.memory[PUSHES]))

    def enters(self, x: Array, time: float) -> Array | None:
        """Gaps (r,) [m] of a step's end at positions x (n, 3) and ``time`` [s] where something touches, else None."""
        self._pressing.at(time)
        gaps = self._pressing.gaps(x)
        return gaps if self._pressing.touched(gaps) else None

    def lead(self, targets: Callable[[float, Array], PatchTargets]) -> None:
        """Meet ``targets`` of constraints, at a time [s] and near coordinates (m,); OptionError of free parts."""
        raise OptionError(
            f"{self._model.name} takes contacts or constraints of free parts, not both: hold some vertices, or take DS"
        )

    def rest(self, before: MotionState, felt: Callable[[], Array], dt: float) -> MotionState | None:
        """The end of a step of ``dt`` [s] of a shell at rest; None of one that is not. Its modal force is (m,)."""
        return None

    def continued(
        self, before: MotionState, dead: DeadForce, when: tuple[float, float], base: Array, load: Array
    ) -> tuple[MotionState, Array] | tuple[None, None]:
        """The end of a step of order two on contacts that stay as they are, ``when`` it begins and how long it is [s].

        The force is that of a ``dead`` load (n, 3) [N]; ``base`` and what else is returned are as for :meth:`follow`.
        None where what touches does not stay, and of motions that have no such step.
        """
        return None, None

    @abstractmethod
    def follow(
        self, before: MotionState, felt: Felt, when: tuple[float, float], gaps: Array | None, base: Array
    ) -> tuple[MotionState, bool, Array | None]:
        """The end of a step under the force ``felt`` at the rates of its beginning; ``when`` it ends, its length [s].

        ``gaps`` (r,) [m] are those near its end, of its beginning if they are not known; ``base`` (n, 3) [m] are the
        positions at its beginning without what is beyond the modes. Also returns whether the contacts were solved, and
        such positions of its end, if they are known.
        """

    def _gaps(self, state: MotionState, base: Array) -> Array:
        """Gaps (r,) [m] of a state, whose positions without what is beyond the modes are ``base`` (n, 3) [m]."""
        ended = self._ended
        if ended is not None and ended[0] is state.coordinates:
            return ended[1]
        return self._pressing.gaps(base + self.local(state))

    def _compliance(self, dt: float) -> Array:
        """Change (m,) of the coordinates [s^2] in a step of implicit Euler per modal force."""
        if dt not in self._impulses:
            if len(self._impulses) == _LENGTHS:
                self._impulses.clear()
            self._impulses[dt] = EULER.impulse(self._model.basis.eigenvalues, self._damp, dt)[0]
        return self._impulses[dt]


@final
class ModalContactMotion(ModalPressedMotion):
    """Steps of a modal model whose supports hold it: the nearest ends outside the colliders.

    They are the nearest in the norm of inertia and stiffness.
    """

    def __init__(self, model: ModalMotion, setup: MotionSetup) -> None:
        super().__init__(model, setup)
        nowhere = np.full(model.basis.count, np.inf)
        if self._pressing.asks or setup.loading.by_velocity:  # steps with a drag ask for derivatives, too
            self._none[TAKEN] = nowhere
        self._moves = {REST: nowhere, REST_PUSHES: self._pressing.no_pushes}
        self._none |= self._moves
        self._resting: Resting | None = None
        self._staying = staying(self._pressing, model.basis.eigenvalues, conservative=model.conservative)
        self._still = np.zeros(model.basis.count)
        self._slowest = float(np.sqrt(model.basis.eigenvalues.min()))
        self._targets: Callable[[float, Array], PatchTargets] | None = None

    def lead(self, targets: Callable[[float, Array], PatchTargets]) -> None:
        """See :meth:`ModalPressedMotion.lead`."""
        self._targets, self._none[TAKEN] = targets, np.full(self._model.basis.count, np.inf)
        if not self._model.integrator.backward:
            self._moves = self._moves | {HELD: np.zeros(self._model.basis.count)}
        hold_patches(self._pressing, self._setup.constraints)

    def rest(self, before: MotionState, felt: Callable[[], Array], dt: float) -> MotionState | None:
        """The end of a step at rest; see :meth:`ModalPressedMotion.rest`."""
        memory, model = before.memory, self._model
        if self._targets is not None:
            return None
        at, compliance, resting = memory[REST], self._compliance(dt), self._resting
        if resting is None or resting.about[0] is not at or resting.compliance is not compliance:
            if not math.isfinite(at[0]):
                return None
            about = at, memory[REST_PUSHES], memory[LOCAL], memory.get(TAKEN, at)
            resting = self._resting = Resting(self._pressing, about, compliance, model.basis.eigenvalues)
        ends, pushes, energy = np.empty((4, at.size)), np.empty(memory[PUSHES].size), np.empty(1)
        force = felt()
        if not resting.frame((before.coordinates, before.rates), force, dt, (ends, pushes, energy)):
            return None
        after = MotionState(ends[2], ends[3])
        kept = {name: memory[name] for name in (LOCAL, TAKEN, REST, REST_PUSHES) if name in memory}
        kept |= model.integrator.stood_in_for(before, after, force, dt).memory
        kept[PUSHES], kept[BEYOND] = pushes, energy
        return MotionState(after.coordinates, after.rates, kept)

    def continued(
        self, before: MotionState, dead: DeadForce, when: tuple[float, float], base: Array, load: Array
    ) -> tuple[MotionState, Array] | tuple[None, None]:
        """The end of a step of SDIRK2; see :meth:`ModalPressedMotion.continued`.

        None where it would gain more than little energy, too, if the force has a potential.
        """
        model, pressing, memory, dt = self._model, self._pressing, before.memory, when[1]
        q, v = before.coordinates, before.rates
        if COST not in memory or self._targets is not None:
            return None, None
        if pressing.moved(self._still, v) <= _FAINT * pressing.touching.size * self._slowest:
            return None, None  # it is to come to rest
        begin = Pressed(q, memory[LOCAL], memory[PUSHES], True, base, self.energy(before), memory.get(TAKEN))
        whole = self._staying.whole(begin, v, dead, load, when, self._compliance(GAMMA * dt))
        end = None if whole is None else whole.pressed
        if whole is None or end is None or end.positions is None:
            return None, None
        after = MotionState(end.q, whole.rates)
        self._ended = None if end.gaps is None or pressing.moving else (end.q, end.gaps)
        after.memory = self._kept(before, end) | model.integrator.stood_in_for(before, after, whole.force, dt).memory
        after.memory[COST][0] = (SDIRK2.error_constant * dt) ** 2 * whole.bent
        return after, end.positions

    def _kept(self, before: MotionState, pressed: Pressed) -> dict[str, Array]:
        """What is kept of the end of a step."""
        pressing, memory = self._pressing, self._memory(pressed) | self._moves
        if pressed.at is not None:
            memory[TAKEN] = pressed.at
        # Not at once after one that did not stay: what creeps is not given a problem every frame.
        begins = pressed.solved and pressing.rests and not math.isfinite(before.memory[REST][0])
        if begins and pressing.moved(before.coordinates, pressed.q) <= STILL * pressing.touching.size:
            memory[REST], memory[REST_PUSHES] = pressed.q, pressed.pushes
        return memory

    def follow(
        self, before: MotionState, felt: Felt, when: tuple[float, float], gaps: Array | None, base: Array
    ) -> tuple[MotionState, bool, Array | None]:
        """The end of a step; see :meth:`ModalPressedMotion.follow`."""
        model, pressing, (force, drag), (time, dt) = self._model, self._pressing, felt, when
        if gaps is None:
            pressing.at(time)
            gaps = self._gaps(before, base)
        q, rates, compliance = before.coordinates, before.rates, self._compliance(dt)
        ends = np.empty((3, q.size))
        implicit_euler(q, rates, force, compliance, model.basis.eigenvalues, dt, ends)
        free, _, ahead = ends
        if drag is not None:  # it falls from the rates of the beginning to those of the end
            pull, stiffness = (free - q) / compliance + drag @ rates, np.diag(1.0 / compliance) + drag / dt
            compliance = np.asarray(np.linalg.inv(stiffness), np.float64)
            free = q + compliance @ pull
        kept = before.memory[LOCAL], before.memory[PUSHES], before.memory.get(TAKEN)
        if self._targets is None:
            pressed = pressing.press(free, compliance, (ahead, q, base), gaps, kept)
        else:
            led = LedTargets(self._targets(time, q))
            pressed = press_led(model, pressing, led, (free, compliance), (q, base), gaps, kept)
            self.missed = led.missed(pressed.q, pressed.local)
        memory = self._kept(before, pressed)
        if pressed.gaps is not None and not pressing.moving:
            self._ended = pressed.q, pressed.gaps
        after = MotionState(pressed.q, (pressed.q - q) / dt)
        memory |= model.integrator.stood_in_for(before, after, force, dt).memory
        return MotionState(after.coordinates, after.rates, memory), pressed.solved, pressed.positions
