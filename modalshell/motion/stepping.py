"""A time-stepping run whose state can be saved and restored."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_number, checked_vectors
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.outcome import Outcome
from modalshell.core.thread_safety import read_only
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.state import COST, MotionState
from modalshell.loads import Loading
from modalshell.models import Model
from modalshell.models.base.setup import MotionSetup, given_contacts
from modalshell.motion.step_error import SEEN_FROM, StepErrors, Tolerance
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.statics.error_bar import share_as_text
from modalshell.supports import SupportPath
from modalshell.supports.constraints import Constraint, checked_constraints, jumps

if TYPE_CHECKING:
    from modalshell.contact import Contact

STEPS = (1e-15, 1e15)
"""Shortest and longest step [s] that is taken: squares of steps enter sums with one."""
_PARTS = 1 << 12
"""Parts of a step, the shortest that a tolerance asks for."""
_JUMP = 1e-3
"""Jump of a constraint's target, in the shell's sizes or [rad], of which a motion says something."""
_FAR_OFF, _THERE = 0.05, 1e-6
"""Distance of a first frame from its start, over the start's displacement, from which it is reported; and over the
shell's size, up to which it is none, as rounding of float32 is."""
_EASY = 0.1
"""Share of the allowed error below which the next step is twice as long."""
_FIRST = 4
"""Halvings of the first step by a tolerance: its error is not known, as nothing was before."""
_STATE = "state_"
"""Before the names of the state's arrays in a checkpoint."""
_FARTHEST = 1e60
"""Coordinate or rate from which a motion counts as diverged: energies hold fourth powers of lengths."""


def checked_step(dt: float) -> float:
    """Step [s] as a float, or OptionError."""
    return checked_number("dt", dt, at_least=STEPS[0], at_most=STEPS[1], unit="s")


@final
class Motion:
    """A model in motion under loads, moving supports and constraints; see :func:`simulate` for the parameters.

    Attributes
    ----------
    setup : MotionSetup
        Step, damping, loads, supports and constraints.
    stepper : Stepper
        Takes the model's steps.
    count : int
        Steps done.
    state : MotionState
        The model's state after them.
    errors : StepErrors
        What its steps have cost so far.
    unconverged : int
        Steps whose own solver did not converge.
    remarked : dict
        What the model has said of its states, and after which step first.
    finite : bool
        Whether the state still consists of finite numbers, none beyond 1e60.
    """

    def __init__(
        self,
        model: Model,
        loading: Loading,
        *,
        dt: float,
        damping: tuple[float, float] | Damping = (0.0, 0.0),
        start: ArrayLike | None = None,
        supports: SupportPath | None = None,
        constraints: Sequence[Constraint] | None = None,
        contacts: Sequence[Contact] | None = None,
        tolerance: Tolerance | None = None,
    ) -> None:
        if not isinstance(damping, Damping):
            damping = Damping(*checked_vectors("damping", damping, (2,), OptionError).tolist())
        shell = model.shell
        model.check_step(checked_step(dt), damping)
        if supports is not None:
            checked_kind("supports", supports, SupportPath)
        if supports is not None and not shell.unknowns.supported.any():
            raise SupportError("supports move the held vertices, but this shell holds none: name them with clamped=")
        wanted = checked_constraints(constraints, shell.unknowns)
        divided = tolerance is not None
        self.setup = MotionSetup(dt, damping, loading, supports, wanted, given_contacts(contacts, shell), divided)
        self._load = loading.dead.copy()
        self.stepper = model.stepper(self.setup)
        given = None if start is None else shell.checked_positions(start)
        self.state = self.stepper.start(given)
        self.errors = StepErrors(self.stepper, self.state)
        self._tolerance = tolerance
        if tolerance is not None:
            if not self.errors.are_known(dt):
                fault = "does not know its steps' errors: leave it out"
                raise OptionError(
                    f"tolerance divides steps by their errors, and {model.name} by this integrator {fault}"
                )
            self.errors.halvings = _FIRST
        self.count, self.unconverged, self.finite = 0, 0, True
        self._start_missed = "" if given is None else self._missed(given)
        self.remarked: dict[str, int] = {}

    @property
    def load(self) -> Array:
        """The sum of the dead loads (n, 3) [N], read-only; it may be replaced as a whole between steps."""
        return read_only(self._load.view())

    @load.setter
    def load(self, load: ArrayLike) -> None:
        # A copy: steppers know a load that they have seen by its array.
        self._load = checked_vectors("load", load, self._load.shape).copy()

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self.count * self.setup.dt

    @property
    def shell(self) -> Shell:
        """The shell in the world."""
        return self.stepper.shell

    @property
    def model(self) -> Model:
        """The model that moves: of a shell far from the origin, one about the origin."""
        return self.stepper.model

    @property
    def present_model(self) -> Model:
        """The model with its supports where they are now."""
        return self.stepper.model_at(self.time)

    @property
    def constraint_residuals(self) -> Array:
        """What is left to each constraint's target (k,), [m] or [rad]."""
        return self.stepper.residuals

    def positions(self) -> Array:
        """Vertex positions (n, 3) [m] in the world."""
        return self.stepper.positions(self.state, self.time)

    def touched(self) -> TouchedFrame | None:
        """What touches now, with contacts; else None."""
        return self.stepper.touched(self.state, self.time)

    def _missed(self, start: Array) -> str:
        """What is said of a start (n, 3) [m], supports in their rest pose, that the model does not come near to."""
        mass, path, x = self.shell.mass, self.setup.supports, self.positions()
        x = x if path is None else path.at(0.0).to_shell(x)
        off, moved = (float(mass @ np.sum((start - one) ** 2, axis=1)) for one in (x, self.shell.rest_positions))
        if off <= _FAR_OFF**2 * moved + float(mass.sum()) * (_THERE * self.shell.size) ** 2:
            return ""
        share = share_as_text(float(np.sqrt(off / (moved or off))))
        return f"the motion begins {share} of the start's displacement off it, as near as {self.model.name} comes"

    def place(self, positions: Array) -> None:
        """Put every vertex at ``positions`` (n, 3) [m] at rest, as far as the model can."""
        self.state = self.stepper.state_at(positions, self.time)

    def energies(self) -> Array:
        """Kinetic and elastic energy and potential of the load (3,) [J]."""
        model, state, loading = self.present_model, self.state, self.setup.loading
        potential = -self.stepper.load_work(self._load, state)
        if loading.live:
            own = self.stepper.loaded_positions(state)
            potential += loading.live_potential(self.stepper.in_world(own, self.time), self.time)
        elastic = model.elastic_energy(state) + self.stepper.further_energy(state)
        return np.array([model.kinetic_energy(state), elastic, potential])

    def fault(self) -> Outcome | None:
        """What is wrong with the state, if the model cannot describe it."""
        return self.model.fault(self.state, self.stepper.own_positions(self.state))

    def advance(self) -> None:
        """Take one step."""
        with np.errstate(over="ignore", invalid="ignore"):
            converged = self._whole_step() if self._tolerance is None else self._divided_step()
        self.unconverged += not converged
        self.count += 1
        for remark in (self.stepper.remark(self.state, self.time), self._jumped()):
            if remark:
                self.remarked.setdefault(remark, self.count)

    def _jumped(self) -> str:
        """What is said of a constraint whose target has jumped in the last step; "" of others."""
        begin, units = self.time - self.setup.dt, {"position": self.shell.size, "orientation": 1.0}
        for place, constraint in enumerate(self.setup.constraints):
            if jumps(constraint, begin, self.time, _JUMP * units[constraint.kind]):
                return (
                    f"the motion depends on the step, as the target of constraint {place} has jumped, the faster the "
                    "shorter steps are: let it take some time"
                )
        return ""

    def _whole_step(self) -> bool:
        """Take a step as long as it is; whether it was solved."""
        dt, before = self.setup.dt, self.state
        after, converged = self.stepper.advance(self.time, dt, before, self._load)
        cost = self.errors.of_step(before, after, dt)
        if self._go_on(after, cost):
            self.errors.see(after)
            self.errors.add(dt, cost, after)
        return converged

    def _divided_step(self) -> bool:
        """Take a step in parts, halved as often as the tolerance asks for; whether all of them were solved."""
        assert self._tolerance is not None
        errors, tolerance, place, solved = self.errors, self._tolerance, 0, True
        while place < _PARTS:
            part = _PARTS >> errors.halvings
            dt, before = self.setup.dt * part / _PARTS, self.state
            begin = self.time + self.setup.dt * place / _PARTS
            after, converged = self.stepper.advance(begin, dt, before, self._load)
            errors.see(after)
            cost, allowed = errors.of_step(before, after, dt), errors.allowed(tolerance, dt, after)
            error = errors.length(cost[0])
            if part > 1 and not (converged and error <= allowed):
                errors.halvings += 1
                continue
            self.stepper.took_part(after, begin + dt, dt, self.time)
            place, solved = place + part, solved and converged
            if not self._go_on(after, cost):
                break
            errors.add(dt, cost, after)
            # Twice the step has eight times the error, and may have twice as much.
            if part < _PARTS and error <= _EASY * allowed and place % (2 * part) == 0:
                errors.halvings -= 1
        return solved

    def _go_on(self, after: MotionState, cost: tuple[float, float, float]) -> bool:
        """Take a step's end; whether it is finite."""
        self.state = after
        squares = cost[1] + cost[2]
        if COST not in after.memory or self.errors.looks:
            squares = float(np.vdot(after.coordinates, after.coordinates) + np.vdot(after.rates, after.rates))
        self.finite = squares < _FARTHEST**2  # False for NaN, too
        return self.finite

    @property
    def remarks(self) -> list[str]:
        """What the model says of its states, each sentence once, with the time from which it holds."""
        notes = [note for note in (self._start_missed, self.stepper.note) if note]
        if self._tolerance is not None:
            notes += filter(None, [self.errors.excess_note(self._tolerance), self.errors.many(self.count)])
        return notes + [
            remark if first == 1 else f"from {first * self.setup.dt:.6g} s on {remark}"
            for remark, first in self.remarked.items()
        ]

    def snapshot(self) -> dict[str, Array]:
        """Checkpoint: all arrays that the next step depends on; :meth:`restore` resumes from it bit for bit."""
        counts = np.array([self.count, self.unconverged], dtype=np.float64)
        arrays = {"counts": counts, "constraint_residuals": self.constraint_residuals, **self.errors.arrays()}
        return arrays | {f"{_STATE}{part}": array for part, array in self.state.arrays().items()}

    def extents(self) -> dict[str, set[tuple[int, ...]]]:
        """Shapes that each array of a :meth:`snapshot` may come to have: two where steps may go to a coarse shell."""
        rest, found = self.model.start_motion(), {name: {array.shape} for name, array in self.snapshot().items()}
        for state in (rest, self.model.as_coarse(rest)):
            for part, array in state.arrays().items():
                found.get(f"{_STATE}{part}", set()).add(array.shape)
        kinds = found[f"{_STATE}coordinates"]
        if len(kinds) > 1:
            found[SEEN_FROM] |= kinds
        return found

    def restore(self, arrays: dict[str, Array]) -> None:
        """Resume from a :meth:`snapshot` of the same motion."""
        self.count, self.unconverged = (int(number) for number in arrays["counts"])
        self.stepper.residuals = np.array(arrays["constraint_residuals"])
        self.errors.restore(arrays)
        self.state = self.state.with_arrays({part: np.array(arrays[f"{_STATE}{part}"]) for part in self.state.arrays()})
