"""Compiled arithmetic of a step of the exponential rule: some twenty operations on vectors of a few modes."""

from modalshell.kernels.compiler import njit


@njit(error_model="numpy", fastmath=False)
def predict(c, q, v, kept, ahead, rates):  # type: ignore[no-untyped-def]
    """Flow of coordinates and rates under the ``kept`` force; ``c`` (8, m) are the coefficients of a :class:`Flow`."""
    for k in range(q.size):
        ahead[k] = c[0, k] * q[k] + c[1, k] * v[k] + c[4, k] * kept[k]
        rates[k] = c[2, k] * q[k] + c[3, k] * v[k] + c[6, k] * kept[k]


@njit(error_model="numpy", fastmath=False)
def correct(c, reach, lost, ratio, q, v, kept, pushed, last, ahead, rates, gain, curvature):  # type: ignore[no-untyped-def]
    """Correct a prediction for the force ``pushed`` there; ``reach`` (m,) turns the force's curvature into an error.

    ``lost`` (m,) turns the change of rates into that of implicit Euler, in the modes that take its coefficients.

    ``gain`` and ``curvature`` (m,) of the force are written, ``last`` being the gain of the step before, and ``ratio``
    the step over the one before. Returns the square of the correction, and those of the step's error and of the changes
    of rates and coordinates.
    """
    missed = error = gained = moved = 0.0
    for k in range(q.size):
        change = pushed[k] - kept[k]
        off = c[5, k] * change
        ahead[k] += off
        rates[k] += c[7, k] * change
        gain[k] = change
        curvature[k] = 2.0 * ratio / (1.0 + ratio) * (change - ratio * last[k])
        missed += off * off
        gain_of_rates = rates[k] - v[k]
        error += (reach[k] * curvature[k]) ** 2 + (lost[k] * gain_of_rates) ** 2
        gained += gain_of_rates**2
        moved += (ahead[k] - q[k]) ** 2
    return missed, error, gained, moved
