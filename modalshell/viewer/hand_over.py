"""Transfer of a motion from one model to another."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from modalshell.models.modal import ModalModel, as_modal
from modalshell.motion import Motion
from modalshell.typing import Array

_WORTH_IT = 0.02
"""Share by which a round must lessen the squared misfit for another to be worth it."""


def hand_over(before: Motion | None, positions: Array, model: ModalModel) -> tuple[Array, Array]:
    """Coordinates (m,) and rates (m,) with which ``model`` continues.

    Parameters
    ----------
    before : Motion or None
        The motion so far, unless it has diverged. If its model is the same but for the number of modes, so is what
        follows.
    positions : ndarray, shape (n, 3)
        The shape [m] that any other model is brought as near to as it can, at rest, in the shell's frame.
    model : ModalModel
        The model that continues.
    """
    last = None if before is None else as_modal(before.model)
    if before is not None and last is not None and type(last) is type(model):
        mass = np.repeat(model.shell.mass, 3)
        transfer = model.basis.modes.T @ (mass[:, None] * last.basis.modes)
        return transfer @ before.state.coordinates, transfer @ before.state.rates
    coordinates = nearest_coordinates(model, positions)
    return coordinates, np.zeros_like(coordinates)


def nearest_coordinates(model: ModalModel, positions: Array) -> Array:
    """Coordinates (m,) whose shape is nearest to ``positions`` (n, 3) in the norm of the mass.

    The projection of a large bend on the modes alone, when warped, is another bend.
    """
    weight = np.sqrt(np.repeat(model.shell.mass, 3))
    wanted = positions - model.shell.rest_positions

    def misfit(coordinates: Array) -> Array:
        return weight * (model.raw_displacement(coordinates) - wanted).ravel()

    return least_squares(misfit, model.coordinates_of(positions), method="lm", ftol=_WORTH_IT).x
