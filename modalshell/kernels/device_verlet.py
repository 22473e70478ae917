"""One source for the processor and for GPUs: a Verlet step of a grid of masses, in NVIDIA's Warp.

Imported only where a device is asked for: Warp is an optional dependency. No ``from __future__ import annotations``
here, since Warp reads the annotations.
"""

from typing import Any

import warp as wp


@wp.func
def pull(now: Any, before: Any, i: int, j: int, down: int, right: int, rest: Any, stiffness: Any, damping: Any) -> Any:
    """What the spring to the neighbour ``down`` rows and ``right`` columns on adds to a step; 0 off the grid."""
    here = now[i, j]
    k = i + down
    m = j + right
    if k < 0 or k >= now.shape[0] or m < 0 or m >= now.shape[1]:
        return here - here
    offset = now[k, m] - here
    length = wp.length(offset)
    tension = stiffness * (length - rest)
    if damping > damping - damping:
        apart = offset - (before[k, m] - before[i, j])
        tension += damping * (wp.dot(offset, apart) / length)
    return (tension / length) * offset


@wp.kernel(enable_backward=False)
def verlet_step(
    before: wp.array2d[Any],
    now: wp.array2d[Any],
    after: wp.array2d[Any],
    pinned: wp.array2d[wp.bool],
    spacing: Any,
    structural: Any,
    shear: Any,
    flexion: Any,
    damping: Any,
    keep: Any,
    fall: Any,
) -> None:
    """One step of every mass; ``after`` may be ``before`` where the springs are not damped.

    ``before``, ``now``, ``after`` : (rows, columns) vectors [m]. ``structural``, ``shear``, ``flexion`` are stiffness
    dt^2 / mass, ``damping`` is the springs' times dt / mass, ``keep`` is 1 - drag dt and ``fall`` gravity dt^2.
    """
    i, j = wp.tid()
    here = now[i, j]
    if pinned[i, j]:
        after[i, j] = here
        return
    step = keep * (here - before[i, j]) + fall
    side = spacing
    step += pull(now, before, i, j, 0, 1, side, structural, damping)
    step += pull(now, before, i, j, 0, -1, side, structural, damping)
    step += pull(now, before, i, j, 1, 0, side, structural, damping)
    step += pull(now, before, i, j, -1, 0, side, structural, damping)
    side = wp.sqrt(spacing * spacing + spacing * spacing)
    step += pull(now, before, i, j, 1, 1, side, shear, damping)
    step += pull(now, before, i, j, 1, -1, side, shear, damping)
    step += pull(now, before, i, j, -1, 1, side, shear, damping)
    step += pull(now, before, i, j, -1, -1, side, shear, damping)
    side = spacing + spacing
    step += pull(now, before, i, j, 0, 2, side, flexion, damping)
    step += pull(now, before, i, j, 0, -2, side, flexion, damping)
    step += pull(now, before, i, j, 2, 0, side, flexion, damping)
    step += pull(now, before, i, j, -2, 0, side, flexion, damping)
    after[i, j] = here + step
