"""A step of the exponential rule for modal warping under a dead load, in one call (theory 12, eq. 5 and 6)."""

import numpy as np

from modalshell.integrators.modal.exponential_kernels import correct, predict
from modalshell.kernels.compiler import njit
from modalshell.kernels.push import ROWS, push_change, push_frame


@njit(error_model="numpy", fastmath=False)
def warp_step(  # type: ignore[no-untyped-def]
    modal, rows, sample, sampled, powers, c, ratio, most, largest, q, v, kept, last, ends, cost
):
    """Write what :class:`Exponential` writes of a step into ``ends`` (5, m) and ``cost`` (3,), the last force with it.

    The load is in ``rows``, that on a ``sample`` of vertices, if there is one, in ``sampled``, as of
    :func:`push_change`. Beyond ``most`` or ``largest``, which bound what :func:`correct` returns, the force is asked
    for again, or its change.

    Returns whether it was asked for again, and whether by the sample.
    """
    force, work = ends[4], np.empty(ROWS)
    predict(c, q, v, kept, ends)
    push_frame(modal, rows, powers, ends[0], work, force)
    foreseen = ends[0].copy()
    missed, whole = correct(c, ratio, q, v, kept, force, last, ends, cost)
    if not (missed > most or whole > largest):
        return 0, 0
    if sample.size:
        change = np.empty(q.size)
        if push_change(sample, sampled, powers, foreseen, ends[0], force, work, change):
            for mode in range(q.size):
                force[mode] += change[mode]
            return 0, 1
    push_frame(modal, rows, powers, ends[0], work, force)
    return 1, int(sample.size > 0)
