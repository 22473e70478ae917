"""What a step makes of errors that add up, in one call: of a few modes each operation on arrays takes a microsecond."""

import numpy as np

from modalshell.kernels.compiler import njit


@njit(error_model="numpy", fastmath=False)
def advance(rows, q, flow, stiffness, cubic, farthest, out):  # type: ignore[no-untyped-def]
    """Write the rows (5, m) after a step to coordinates q (m,) into ``out``; see :class:`.drift.Drift`.

    ``flow`` (4, m) are the coefficients e11, e12, e21 and e22 of the modes. Returns how far the motion is off beyond
    the present s.
    """
    share = share_of(rows[4], q, farthest)
    if cubic:
        share *= share * share
    total = 0.0
    for k in range(q.size):
        present = share * rows[3, k]
        gap, rate = rows[0, k] - present, rows[1, k]
        off, speed = flow[0, k] * gap + flow[1, k] * rate, flow[2, k] * gap + flow[3, k] * rate
        out[0, k], out[1, k], out[2, k], out[3, k], out[4, k] = present + off, speed, present, rows[3, k], rows[4, k]
        total += off * off + speed * speed / stiffness[k]
    return np.sqrt(total)


@njit(error_model="numpy", fastmath=False)
def share_of(seen, q, farthest):  # type: ignore[no-untyped-def]
    """The share of the coordinates of a check (m,) that others (m,) have, up to ``farthest``; none of such of none."""
    size, along = 0.0, 0.0
    for k in range(q.size):
        size += seen[k] * seen[k]
        along += seen[k] * q[k]
    share = along / size if size > 0.0 else 0.0
    return max(-farthest, min(farthest, share)) if np.isfinite(share) else 0.0
