"""A modal model takes up the motion of another model."""

from __future__ import annotations

import numpy as np

from modalshell.models.modal import ModalModel, as_modal
from modalshell.motion import Motion
from modalshell.typing import Array

_ROUNDS = 10
"""Gauss-Newton rounds at most."""
_HALVINGS = 3
"""Halvings of a step that brings the shape no nearer."""
_WORTH_IT = 0.99
"""Share of the misfit that a round may leave for another to be worth it."""
_DIFFERENCE = 1e-6
"""Change of a coordinate over which displacements are differenced, as a share of the largest coordinate."""


def hand_over(before: Motion | None, positions: Array, model: ModalModel) -> tuple[Array, Array]:
    """Coordinates (m,) and rates (m,) with which ``model`` goes on.

    Parameters
    ----------
    before : Motion or None
        The motion so far, unless it has diverged. If its model is the same but for the number of modes, so is what
        follows.
    positions : ndarray, shape (n, 3)
        The shape [m] that any other model is brought as near to as it can, at rest, in the shell's frame.
    model : ModalModel
        The model that goes on.
    """
    last = None if before is None else as_modal(before.model)
    if before is not None and last is not None and type(last) is type(model):
        mass = np.repeat(model.shell.mass, 3)
        transfer = model.basis.modes.T @ (mass[:, None] * last.basis.modes)
        return transfer @ before.state.coordinates, transfer @ before.state.rates
    coordinates = nearest_coordinates(model, positions)
    return coordinates, np.zeros_like(coordinates)


def nearest_coordinates(model: ModalModel, positions: Array) -> Array:
    """Coordinates (m,) whose shape is nearest to ``positions`` (n, 3) in the norm of the mass: Gauss-Newton.

    The projection of a large bend on the modes alone, when warped, is another bend.
    """
    weight = np.sqrt(np.repeat(model.shell.mass, 3))
    wanted = positions - model.shell.rest_positions

    def misfit(coordinates: Array) -> Array:
        return weight * (model.raw_displacement(coordinates) - wanted).ravel()

    q = model.coordinates_of(positions)
    left = misfit(q)
    for _ in range(_ROUNDS):
        size, change = float(np.linalg.norm(left)), _DIFFERENCE * float(np.abs(q).max())
        if change == 0.0:
            break
        jacobian = np.column_stack([(misfit(q + change * unit) - left) / change for unit in np.eye(q.size)])
        step = np.linalg.lstsq(jacobian, -left, rcond=None)[0]
        for _ in range(_HALVINGS):
            trial = misfit(q + step)
            if np.linalg.norm(trial) < size:
                break
            step = 0.5 * step
        else:
            break
        q, left = q + step, trial
        if np.linalg.norm(left) > _WORTH_IT * size:
            break
    return q
