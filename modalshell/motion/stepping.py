"""A time-stepping run whose state can be saved and restored."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.constraints import Constraint
from modalshell.constraints.constraints import checked_constraints
from modalshell.core.checks import checked_kind, checked_number, checked_vectors
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.integrators.state import Damping, MotionSetup
from modalshell.loads import Loading
from modalshell.models import Model
from modalshell.shell import Shell
from modalshell.supports import SupportPath

STEPS = (1e-15, 1e15)
"""Shortest and longest step [s] that is taken: squares of steps enter sums with one."""
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
    load : ndarray, shape (n, 3)
        The sum of the dead loads [N], which may be replaced between steps.
    count : int
        Steps done.
    state : MotionState
        The model's state after them.
    unconverged : int
        Steps whose own solver did not converge.
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
    ) -> None:
        if not isinstance(damping, Damping):
            damping = Damping(*checked_vectors("damping", damping, (2,), OptionError).tolist())
        shell = model.shell
        model.check_step(checked_step(dt), damping)
        if supports is not None:
            checked_kind("supports", supports, SupportPath)
        if supports is not None and not shell.unknowns.supported.any():
            raise SupportError("supports move the held vertices, but this shell holds none: name them with clamped=")
        self.setup = MotionSetup(dt, damping, loading, supports, checked_constraints(constraints, shell))
        self.load = loading.dead
        self.stepper = model.stepper(self.setup)
        self.state = self.stepper.start(None if start is None else shell.checked_positions(start))
        self.count, self.unconverged, self.finite = 0, 0, True
        self._remarks: dict[str, int] = {}
        self._moved = np.empty(shell.rest_positions.shape)

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

    def place(self, positions: Array) -> None:
        """Put every vertex at ``positions`` (n, 3) [m] at rest, as far as the model can."""
        self.state = self.stepper.state_at(positions, self.time)

    def energies(self) -> Array:
        """Kinetic and elastic energy and potential of the load (3,) [J]."""
        own = self.stepper.own_positions(self.state)
        moved = np.subtract(own, self.model.shell.rest_positions, out=self._moved)
        model, state, loading = self.present_model, self.state, self.setup.loading
        potential = -float(np.vdot(self.load, moved))
        if loading.live:
            potential += loading.live_energy(self.positions(), self.time)
        return np.array([model.kinetic_energy(state), model.elastic_energy(state), potential])

    def fault(self) -> Outcome | None:
        """What is wrong with the state, if the model cannot describe it."""
        return self.model.fault(self.state, self.stepper.own_positions(self.state))

    def advance(self) -> None:
        """Take one step."""
        with np.errstate(over="ignore", invalid="ignore"):
            state, converged = self.stepper.advance(self.count * self.setup.dt, self.setup.dt, self.state, self.load)
            # False for NaN, too.
            squares = float(np.vdot(state.coordinates, state.coordinates) + np.vdot(state.rates, state.rates))
            self.finite = squares < _FARTHEST**2
        self.unconverged += not converged
        self.state = state
        self.count += 1
        if remark := self.model.remark(state):
            self._remarks.setdefault(remark, self.count)

    @property
    def remarks(self) -> list[str]:
        """What the model says of its states, each sentence once, with the time from which it holds."""
        return [
            remark if first == 1 else f"from {first * self.setup.dt:.6g} s on {remark}"
            for remark, first in self._remarks.items()
        ]

    def snapshot(self) -> dict[str, Array]:
        """Checkpoint: all arrays that the next step depends on; :meth:`restore` resumes from it bit for bit."""
        counts = np.array([self.count, self.unconverged], dtype=np.float64)
        arrays = {"counts": counts, "constraint_residuals": self.constraint_residuals}
        return arrays | {f"{_STATE}{part}": array for part, array in self.state.arrays().items()}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Resume from a :meth:`snapshot` of the same motion."""
        self.count, self.unconverged = (int(number) for number in arrays["counts"])
        self.stepper.residuals = np.array(arrays["constraint_residuals"])
        self.state = self.state.with_arrays({part: np.array(arrays[f"{_STATE}{part}"]) for part in self.state.arrays()})
