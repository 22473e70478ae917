"""Warp kernel of a Verlet step of a grid of masses.

Imported only where a device is asked for: Warp is an optional dependency. No ``from __future__ import annotations``
here, since Warp reads the annotations.
"""

from typing import Any

import warp as wp


@wp.func
def pull(now: Any, i: int, j: int, down: int, right: int, rest: Any, stiffness: Any, tiny: Any) -> Any:
    """What the spring to the neighbour ``down`` rows and ``right`` columns on adds to a step; 0 off the grid."""
    here = now[i, j]
    k = i + down
    m = j + right
    if k < 0 or k >= now.shape[0] or m < 0 or m >= now.shape[1]:
        return here - here
    offset = now[k, m] - here
    return (stiffness - stiffness * rest / wp.sqrt(wp.dot(offset, offset) + tiny)) * offset


@wp.func
def four_pulls(now: Any, i: int, j: int, down: int, right: int, rest: Any, stiffness: Any, tiny: Any) -> Any:
    """The pull of that neighbour, and of those a quarter, a half and three quarters of a turn on."""
    along = pull(now, i, j, down, right, rest, stiffness, tiny) + pull(now, i, j, -down, -right, rest, stiffness, tiny)
    across = pull(now, i, j, right, -down, rest, stiffness, tiny) + pull(now, i, j, -right, down, rest, stiffness, tiny)
    return along + across


@wp.kernel(enable_backward=False)
def verlet_step(
    now: wp.array2d[Any],
    before: wp.array2d[Any],
    pinned: wp.array2d[wp.bool],
    spacing: Any,
    structural: Any,
    shear: Any,
    flexion: Any,
    tiny: Any,
    keep: Any,
    fall: Any,
) -> None:
    """One step of every mass, written over the places ``before``.

    ``now`` and ``before`` are vectors (rows, columns) [m]; ``structural``, ``shear`` and ``flexion`` are stiffness over
    mass and ``fall`` is gravity, times dt^2 over drag's share; ``keep`` is the share of the last step's displacement
    that goes on, ``tiny`` [m^2] what keeps a spring of no length from dividing by zero.
    """
    i, j = wp.tid()
    here = now[i, j]
    if pinned[i, j]:
        before[i, j] = here
        return
    step = keep * (here - before[i, j]) + fall
    step += four_pulls(now, i, j, 0, 1, spacing, structural, tiny)
    step += four_pulls(now, i, j, 1, 1, wp.sqrt(spacing * spacing + spacing * spacing), shear, tiny)
    step += four_pulls(now, i, j, 0, 2, spacing + spacing, flexion, tiny)
    before[i, j] = here + step
