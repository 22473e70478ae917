"""Turns of vertices in Newton's steps.

Every vertex is carried along the turn of its own triangles, as in modal warping, so that a long step bends the sheet
instead of stretching it. A factor of the Hessian turns with the vertices, too.
"""

from __future__ import annotations

import numpy as np

from modalshell.core.thread_safety import writeable
from modalshell.core.typing import Array, Index
from modalshell.kernels import rotations
from modalshell.shell import Shell


def _turns(shell: Shell, x: Array, step: Array) -> Array:
    """Rotation vectors (n, 3) of vertices at x (n, 3) by a small ``step`` (n, 3)."""
    turns = np.empty_like(x)
    rotations.vertex_rotations(writeable(x), step, shell.mesh.faces, turns)  # positions at rest are read-only
    return turns


def warped_step(shell: Shell, x: Array, direction: Array, largest_turn: float) -> tuple[Array, Array, float]:
    """Move along ``direction`` (N,), warped (theory 8, eq. 3), until a vertex rotates by ``largest_turn`` [rad].

    Returns
    -------
    positions : ndarray, shape (n, 3)
        The new positions.
    step : ndarray, shape (n, 3)
        The straight step that was warped.
    fraction : float
        How much of ``direction`` that is.
    """
    step = shell.unknowns.prolong(direction).reshape(-1, 3)
    turns = _turns(shell, x, step)
    angle = rotations.largest_angle(turns)
    fraction = 1.0
    if angle > largest_turn:
        fraction = largest_turn / angle
        step *= fraction
        turns *= fraction
    displacement = np.empty_like(x)
    rotations.warp(turns, step, 1.0, displacement)
    return x + shell.unknowns.project(displacement), step, fraction


def led_step(
    shell: Shell, held: Shell, x: Array, step: Array, led: tuple[Index, Array], largest_turn: float
) -> tuple[Array, list[Array], float]:
    """Positions and stresses after a ``step`` (n, 3) [m] from x (n, 3) in which vertices (k,) are led to places (k, 3).

    The ``shell`` does not hold these, so that they turn as they go; ``held`` does, and stresses are of what can move in
    it. Also returned is how much of the step that is.
    """
    moved, _, fraction = warped_step(shell, x, shell.unknowns.values(step.ravel()), largest_turn)
    vertices, places = led
    moved[vertices] = places
    return moved, held.predicted_stresses(x, step), fraction


def descent_length(shell: Shell, *, turns: bool) -> float:
    """Length [m] by which descents are measured: one that turns with the shell, or of its box."""
    return shell.mesh.moment_length if turns else shell.size


def sized_way(shell: Shell, direction: Array, *, turns: bool = True) -> Array:
    """A direction (N,) at a length that moves no vertex, or no unknown, by more than :func:`descent_length`."""
    moves = np.abs(direction)
    if turns:
        moves = np.linalg.norm(shell.unknowns.prolong(direction).reshape(-1, 3), axis=1)
    return direction * (descent_length(shell, turns=turns) / max(float(moves.max()), 1e-300))


def turned_axes(shell: Shell, since: Array, x: Array) -> Array | None:
    """Where the axes turn to with the free vertices (3, f, 3), from ``since`` (n, 3) to x.

    None where the unknowns are not displacements along the axes.
    """
    if shell.unknowns.matrix is not None:
        return None
    turns = _turns(shell, since, x - since)[shell.free]
    axes = np.empty((3, *turns.shape))
    for axis, unit in zip(axes, np.eye(3), strict=True):
        rotations.rotate(turns, np.tile(unit, (len(turns), 1)), 1.0, axis)
    return axes
