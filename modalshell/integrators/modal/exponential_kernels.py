"""Compiled arithmetic of a step of the exponential rule: some twenty operations on vectors of a few modes."""

from modalshell.kernels.compiler import UNCOUNTED, njit


@njit(error_model="numpy", fastmath=False, **UNCOUNTED)
def predict(c, q, v, kept, out):  # type: ignore[no-untyped-def]
    """Flow of coordinates and rates under the ``kept`` force, into the first two rows of ``out``.

    ``c`` (11, m) are the coefficients of a :class:`Flow`, two of a step's error, and the stiffness.
    """
    for k in range(q.size):
        out[0, k] = c[0, k] * q[k] + c[1, k] * v[k] + c[4, k] * kept[k]
        out[1, k] = c[2, k] * q[k] + c[3, k] * v[k] + c[6, k] * kept[k]


@njit(error_model="numpy", fastmath=False, **UNCOUNTED)
def correct(c, ratio, q, v, kept, pushed, last, out, cost):  # type: ignore[no-untyped-def]
    """Correct a prediction in ``out`` for the force ``pushed`` (m,) there.

    Returns the squares of the correction, and of that force on the modes that are not rigid: those whose stiffness, row
    10 of ``c`` (11, m), is positive. Row 8 turns the force's curvature into an error, row 9 the change of rates into
    that of implicit Euler, in the modes that take its coefficients.

    Gain and curvature of the force become rows 2 and 3 of ``out``, ``last`` (m,) being the gain of the step before,
    and ``ratio`` the step over the one before; ``cost`` (3,) the squares of the step's error and of the changes of
    rates and coordinates.
    """
    missed = whole = error = gained = moved = 0.0
    for k in range(q.size):
        change = pushed[k] - kept[k]
        off = c[5, k] * change
        out[0, k] += off
        out[1, k] += c[7, k] * change
        out[2, k] = change
        out[3, k] = 2.0 * ratio / (1.0 + ratio) * (change - ratio * last[k])
        missed += off * off
        if c[10, k] > 0.0:
            whole += pushed[k] * pushed[k]
        gain_of_rates = out[1, k] - v[k]
        error += (c[8, k] * out[3, k]) ** 2 + (c[9, k] * gain_of_rates) ** 2
        gained += gain_of_rates**2
        moved += (out[0, k] - q[k]) ** 2
    cost[0], cost[1], cost[2] = error, gained, moved
    return missed, whole


@njit(error_model="numpy", fastmath=False, **UNCOUNTED)
def stand_in(h, before, after, pushed, kept, out, cost):  # type: ignore[no-untyped-def]
    """Gain and curvature of the force, rows of ``out`` (2, m), and ``cost`` (3,) of a step of implicit Euler.

    ``before`` and ``after`` are coordinates and rates (m,), ``pushed`` and ``kept`` the forces (m,) of both.
    """
    gained = moved = error = 0.0
    for k in range(pushed.size):
        gain = after[1][k] - before[1][k]
        error += (0.5 * h * gain) ** 2
        gained += gain**2
        moved += (after[0][k] - before[0][k]) ** 2
        out[0, k], out[1, k] = pushed[k] - kept[k], 0.0
    cost[0], cost[1], cost[2] = error, gained, moved
