"""What constraints make of the model that switches itself: modes that answer them, and linear answers under them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array
from modalshell.models.auto.answered import Answer, solver_at_rest
from modalshell.models.auto.checks import HeldCheck
from modalshell.models.auto.levels import ModalLevel
from modalshell.models.base.bars import led_vertices
from modalshell.models.base.setup import MotionSetup
from modalshell.models.coarse.profile_step import quick_check
from modalshell.models.rotation_strain import RotationStrain
from modalshell.modes import Basis
from modalshell.modes.attachments import with_attachments
from modalshell.modes.basis import lowest_modes
from modalshell.modes.modal_rotation import rotation_matrix
from modalshell.shell import GAUSS_NEWTON, Shell
from modalshell.statics.error_bar import ErrorEstimator
from modalshell.supports.constraints import Constraint
from modalshell.supports.led import LedVertices

_OF_LEVELS = ("_templates", "room", "periods", "answers", "_gaps", "unfit", "_checked_on")
"""What the model keeps of its levels and modes."""


def both_refused(name: str) -> OptionError:
    """The error of contacts and constraints together."""
    return OptionError(f"{name} takes contacts or constraints, not both: take DS, or move the supports instead")


def under_constraints(model: Any, setup: MotionSetup) -> Any:
    """The model that switches itself, with levels that answer a motion's constraints; OptionError where it has none."""
    if not setup.constraints:
        return model
    if setup.contacts:
        raise both_refused(model.name)
    if model._free is not None:
        raise OptionError(f"{model.name} in free flight takes no constraints: hold some vertices, or take MWTS or DS")
    led = copy.copy(model)
    for name in _OF_LEVELS:
        led.__dict__.pop(name, None)
    led.basis = basis_under(model.basis, setup.constraints)
    full = [level for level in model.levels if not level.quadratic]
    led.levels = [ModalLevel(led.basis, RotationStrain, RotationStrain.name), *full]
    led.level_names = tuple(level.name for level in led.levels)
    led._about_origin, led._unpacked = {}, (None, None)
    return led


def check_under(shell: Shell, setup: MotionSetup) -> HeldCheck:
    """What sees a motion under constraints."""
    led = led_vertices(shell, setup.constraints, setup.supports)
    assert led is not None
    quick = quick_check(shell.holding(led.vertices), early=True)
    estimator = ErrorEstimator(shell, quick, early=True, led=led)
    return HeldCheck(shell, setup.loading, setup.damping, estimator, supports=setup.supports, led=led)


def basis_under(basis: Basis, constraints: Sequence[Constraint]) -> Basis:
    """Modes of a shell with its static shapes under forces on what tells where patches are.

    Those of a shell without stress at rest: of others the modes alone.
    """
    shell, led = basis.shell, led_vertices(basis.shell, constraints)
    if shell.stressed or led is None:
        return basis
    rows = np.concatenate([3 * point.vertices[0] + np.arange(3) for point in led.points()])
    forces = np.zeros((shell.rest_positions.size, rows.size))
    forces[rows, np.arange(rows.size)] = 1.0
    known = np.asarray(shell.unknowns.values(basis.modes))
    eigenvalues, free = with_attachments(shell, basis.eigenvalues, known, forces, None)
    modes = np.asarray(shell.unknowns.prolong(free))
    rotations = shell.unknowns.turns(np.asarray(rotation_matrix(shell.mesh) @ modes))
    return replace(basis, eigenvalues=eigenvalues, modes=read_only(modes), rotations=read_only(rotations))


def modes_between(basis: Basis, led: LedVertices) -> Basis:
    """As many modes of a shell whose led vertices are held: motions that constraints leave, in which errors add up."""
    held = basis.shell.holding(led.vertices)
    return lowest_modes(held, min(basis.count, held.unknowns.count))[0]


@final
class ConstrainedAnswers:
    """Compares the linear answers of a shell under constraints and a load with what its modes have of them.

    Parameters
    ----------
    basis : Basis
        The modes.
    led : LedVertices
        Vertices that constraints lead.
    """

    def __init__(self, basis: Basis, led: LedVertices) -> None:
        self._modes, self._led, shell = basis.modes, led, basis.shell
        self._held, self._mass = shell.holding(led.vertices), np.repeat(shell.mass, 3)
        self._stiffness = self._held.hessian(shell.rest_positions, GAUSS_NEWTON)
        self._solver = solver_at_rest(self._held)

    def of(self, force: Array, time: float) -> Answer:
        """The answer to forces (n, 3) [N] where the vertices are led to their places at ``time`` [s]."""
        held, led = self._held, self._led
        way = np.zeros_like(force)
        way[led.vertices] = led.at(time) - held.rest_positions[led.vertices]
        pull = held.pattern.product(self._stiffness, way.ravel())
        moved = np.asarray(held.unknowns.prolong(self._solver.solve(held.unknowns.restrict(force.ravel() - pull))))
        moved = moved + way.ravel()
        missing = moved - self._modes @ (self._modes.T @ (self._mass * moved))
        return Answer(*(float(np.sqrt(np.vdot(self._mass * part, part))) for part in (moved, missing)))
