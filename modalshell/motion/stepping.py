"""A time-stepping run whose state can be saved and restored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from modalshell.constraints import Constraint
from modalshell.constraints.constraints import HeldPatch, checked_constraints, held_patches
from modalshell.core.checks import checked_kind, checked_number, checked_vectors
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array, Index
from modalshell.integrators.state import Damping, MotionState
from modalshell.loads import Load
from modalshell.models import Model
from modalshell.models.base.modal import as_modal
from modalshell.models.base.model import ResolvedTarget
from modalshell.models.reduction.load_quadrature import LoadQuadrature
from modalshell.motion.supports import Pose, SupportPath
from modalshell.statics.live_loads import LiveLoads

STEPS = (1e-15, 1e15)
"""Shortest and longest step [s] that is taken: squares of steps enter sums with one."""
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
    shell : Shell
        The shell in the world.
    model : Model
        The model that moves: of a shell far from the origin, one about the origin.
    loading : Loading
        The loads.
    load : ndarray, shape (n, 3)
        The sum of the dead ones [N], which may be replaced between steps.
    count : int
        Steps done.
    state : MotionState
        The model's state after them.
    unconverged : int
        Steps whose own solver did not converge.
    finite : bool
        Whether the state still consists of finite numbers, none beyond 1e60.
    constraint_residuals : ndarray, shape (k,)
        What is left to each constraint's target.
    """

    def __init__(
        self,
        model: Model,
        *,
        dt: float,
        gravity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        loads: Sequence[Load] | None = None,
        damping: tuple[float, float] | Damping = (0.0, 0.0),
        start: ArrayLike | None = None,
        supports: SupportPath | None = None,
        constraints: Sequence[Constraint] | None = None,
    ) -> None:
        self.dt = checked_step(dt)
        if not isinstance(damping, Damping):
            damping = Damping(*checked_vectors("damping", damping, (2,), OptionError).tolist())
        self.damping = damping
        self.loading = model.shell.loading(gravity, force, loads)
        self.load = self.loading.dead
        model.check_step(self.dt, self.damping)
        shell = model.shell
        if supports is not None:
            checked_kind("supports", supports, SupportPath)
        if supports is not None and not shell.unknowns.supported.any():
            raise SupportError("supports move the held vertices, but this shell holds none: name them with clamped=")
        self.supports = supports
        self.constraints = checked_constraints(constraints, shell)
        self._patches: list[HeldPatch] = []
        if self.constraints and model.moves_patches:
            self._patches = held_patches(self.constraints, shell)
            model = model.holding(np.concatenate([patch.vertices for patch in self._patches]))
        self.shell = model.shell
        # About the origin, where coordinates have the smallest rounding.
        self.model, self._origin = model.centred()
        self._off_centre = bool(self._origin.any())
        model = self.model
        self.state = model.start_motion(None if start is None else shell.checked_positions(start) - self._origin)
        if supports is not None:
            self.state = model.placed(self.state, self._pose(supports, 0.0))
        self._before = self.state
        self._known: list[tuple[MotionState, Array]] = []
        self._moved = np.empty(model.shell.rest_positions.shape)
        self._quadrature: LoadQuadrature | None = None
        if (modal := as_modal(model)) is not None and supports is None:
            self._quadrature = modal.load_quadrature(self.loading)
        self.count, self.unconverged, self.finite = 0, 0, True
        self._remarks: dict[str, int] = {}
        self.constraint_residuals = np.zeros(len(self.constraints))

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self.count * self.dt

    def positions(self) -> Array:
        """Vertex positions (n, 3) [m] in the world."""
        own = self._own(self.state)
        if self.supports is None or not self.model.in_shell_frame:
            return own + self._origin if self._off_centre else own
        moved = self._pose(self.supports, self.time).to_world(own)
        return moved + self._origin if self._off_centre else moved

    def place(self, positions: Array) -> None:
        """Put every vertex of a model in the world's frame at ``positions`` (n, 3) [m], held ones too."""
        self.state.coordinates = positions - self._origin

    def _pose(self, supports: SupportPath, time: float) -> Pose:
        """Where the supports are, in the coordinates of the model."""
        pose = supports.at(time)
        return replace(pose, pivot=pose.pivot - self._origin) if self._off_centre else pose

    def energies(self) -> Array:
        """Kinetic and elastic energy and potential of the load (3,) [J]."""
        moved = np.subtract(self._own(self.state), self.model.shell.rest_positions, out=self._moved)
        model, state = self.present_model, self.state
        potential = -float(np.vdot(self.load, moved))
        if self.loading.live:
            potential += self.loading.live_energy(self.positions(), self.time)
        return np.array([model.kinetic_energy(state), model.elastic_energy(state), potential])

    @property
    def present_model(self) -> Model:
        """The model with its supports where they are now."""
        if self.supports is None or self.model.in_shell_frame:
            return self.model
        pose = self._pose(self.supports, self.time)
        return self.model.carried(pose, pose)

    def fault(self) -> Outcome | None:
        """What is wrong with the state, if the model cannot describe it."""
        return self.model.fault(self.state, self._own(self.state))

    def _own(self, state: MotionState) -> Array:
        """Positions (n, 3) [m] in the model's frame; those of the last two states are kept, as each serves twice."""
        for known, positions in self._known:
            if known is state:
                return positions
        positions = self.model.positions(state)
        if not self.model.new_positions:
            positions = positions.copy()
        self._known = [*self._known[-1:], (state, positions)]
        return positions

    def advance(self) -> None:
        """Take one step."""
        model, dt, time = self.model, self.dt, (self.count + 1) * self.dt
        load, held, pose, changing = self.load, None, None, self.loading.live
        quadrature = self._quadrature
        lagging = bool(changing) and not model.takes_live_loads and quadrature is None
        if lagging:
            load = self.loading.moving_force(load, *self._last_positions(), 1.0 / dt, time)
        if self.supports is not None:
            pose = self._pose(self.supports, time)
            if not model.in_shell_frame:
                model = model.carried(self._pose(self.supports, self.time), pose)
            else:
                current = self._own(self.state)
                velocities = (current - self._own(self._before)) / dt
                load = pose.shell_load(load, model.shell.mass, current, velocities)
        if self._patches or (pose is not None and not model.in_shell_frame):
            held = self._held_positions(time, pose)
        with np.errstate(over="ignore", invalid="ignore"):
            if quadrature is not None and (modal := as_modal(model)) is not None:
                load = quadrature.dead(load, time)
                own, before = self._own(self.state), self._own(self._before)
                pushed = quadrature.push(self.state.coordinates, own, before, 1.0 / dt, time)
                state, converged = modal.step_by_quadrature(self.state, dt, load, self.damping, pushed), True
            elif changing and model.takes_live_loads:
                live = LiveLoads(self.loading, time, self._origin)
                state, converged = model.step_live(self.state, dt, load, self.damping, held, live)
            else:
                state, converged = model.step(self.state, dt, load, self.damping, held)
            if lagging and self.loading.by_velocity:
                state = model.dragged(state, self.state, dt, self.damping, *self._drag(time, pose))
            if self.constraints and not model.moves_patches:
                targets = [_resolved(constraint, time, pose) for constraint in self.constraints]
                state, self.constraint_residuals = model.meet_constraints(state, self.state, dt, self.damping, targets)
            # False for NaN, too.
            squares = float(np.vdot(state.coordinates, state.coordinates) + np.vdot(state.rates, state.rates))
            self.finite = squares < _FARTHEST**2
        self.unconverged += not converged
        self._before, self.state = self.state, state
        self.count += 1
        if remark := model.remark(state):
            self._remarks.setdefault(remark, self.count)

    @property
    def remarks(self) -> list[str]:
        """What the model says of its states, each sentence once, with the time from which it holds."""
        return [
            remark if first == 1 else f"from {first * self.dt:.6g} s on {remark}"
            for remark, first in self._remarks.items()
        ]

    def _last_positions(self) -> tuple[Array, Array]:
        """Positions (n, 3) [m] in the world frame, now and one step earlier; equal at the start."""
        now, before = self.positions(), self._own(self._before)
        if self.supports is not None and self.model.in_shell_frame:
            before = self._pose(self.supports, max(self.count - 1, 0) * self.dt).to_world(before)
        return now, before + self._origin if self._off_centre else before

    def _drag(self, time: float, pose: Pose | None) -> tuple[Index, Array]:
        """Drag of the loads at some vertices, in the model's frame; see :meth:`Loading.drag`."""
        now, before = self._last_positions()
        vertices, blocks = self.loading.drag(now, (now - before) / self.dt, time)
        return vertices, blocks if pose is None else pose.rotation.T @ blocks @ pose.rotation

    def snapshot(self) -> dict[str, Array]:
        """Checkpoint: all arrays that the next step depends on; :meth:`restore` resumes from it bit for bit."""
        counts = np.array([self.count, self.unconverged], dtype=np.float64)
        arrays = {"counts": counts, "constraint_residuals": self.constraint_residuals}
        for name, state in self._states().items():
            arrays |= {f"{name}_{part}": array for part, array in state.arrays().items()}
        return arrays

    def _states(self) -> dict[str, MotionState]:
        """The states that the next step depends on."""
        if (self.supports is not None or self.loading.by_velocity) and self.model.in_shell_frame:
            return {"now": self.state, "before": self._before}
        return {"now": self.state}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Resume from a :meth:`snapshot` of the same motion."""
        self.count, self.unconverged = (int(number) for number in arrays["counts"])
        self.constraint_residuals = np.array(arrays["constraint_residuals"])
        states = [
            state.with_arrays({part: np.array(arrays[f"{name}_{part}"]) for part in state.arrays()})
            for name, state in self._states().items()
        ]
        self.state, self._before = states[0], states[-1]

    def _held_positions(self, time: float, pose: Pose | None) -> Array:
        """Where supports and patches are at ``time``, in the order of the held vertices."""
        shell, own = self.model.shell, self.model.in_shell_frame
        placed = shell.rest_positions if pose is None or own else pose.to_world(shell.rest_positions)
        placed = placed.copy()
        for patch in self._patches:
            target = patch.at(time) - self._origin
            placed[patch.vertices] = target if pose is None or not own else pose.to_shell(target)
        return placed[shell.clamped]


def _resolved(constraint: Constraint, time: float, pose: Pose | None) -> ResolvedTarget:
    """The constraint's target at ``time``, in the frame of the supports."""
    value = constraint.at(time)
    if pose is not None:
        if constraint.kind == "position":
            value = pose.to_shell(value)
        else:
            value = (Rotation.from_matrix(pose.rotation).inv() * Rotation.from_rotvec(value)).as_rotvec()
    return ResolvedTarget(constraint.kind, constraint.vertices, value)
