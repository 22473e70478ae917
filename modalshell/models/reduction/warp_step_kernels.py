"""A step of the exponential rule for modal warping under a load, in one call (theory 12, eq. 5 and 6)."""

import numpy as np

from modalshell.integrators.modal.exponential_kernels import correct, predict
from modalshell.kernels.compiler import njit
from modalshell.kernels.push import ROWS, push_frame, work_frame


@njit(error_model="numpy", fastmath=False)
def warp_step(modal, rows, powers, sampled, c, ratio, most, largest, q, v, kept, last, ends, cost):  # type: ignore[no-untyped-def]
    """Write a step under a load in ``rows``, as of :func:`push_frame`, into ``ends`` (6, m) and ``cost`` (3,).

    As :func:`correct` does, then the force at the end and the coordinates that were predicted. Returns whether what
    that function returns is beyond ``most`` or ``largest``: then the force is asked for again, but by the caller where
    a sample may tell (``sampled``).
    """
    force, foreseen, work, beyond = ends[4], ends[5], np.empty(ROWS), False
    predict(c, q, v, kept, ends)
    while True:  # one call of the long kernel, which is compiled where it is called
        push_frame(modal, rows, powers, ends[0], work, force)
        if beyond:
            return True
        for mode in range(q.size):
            foreseen[mode] = ends[0, mode]
        missed, whole = correct(c, ratio, q, v, kept, force, last, ends, cost)
        beyond = missed > most or whole > largest
        if sampled or not beyond:
            return beyond


@njit(error_model="numpy", fastmath=False)
def work_step(modal, rows, powers, c, ratio, most, largest, q, v, kept, last, ends, cost):  # type: ignore[no-untyped-def]
    """The same under the gradient of the work of :func:`work_frame`, which is asked for again where it must be.

    Returns whether it was.
    """
    force, work, beyond = ends[4], np.empty(2 * ROWS), False
    predict(c, q, v, kept, ends)
    while True:  # as above
        work_frame(modal, rows, powers, ends[0], work, force)
        if beyond:
            return True
        missed, whole = correct(c, ratio, q, v, kept, force, last, ends, cost)
        beyond = missed > most or whole > largest
        if not beyond:
            return False
