"""Work of dead loads, in one pass over the vertices."""

from modalshell.kernels.compiler import njit


@njit(error_model="numpy", fastmath=False)
def dead_work(load, x, rest):  # type: ignore[no-untyped-def]
    """Work [J] of a load (n, 3) [N] from ``rest`` (n, 3) [m] to ``x`` (n, 3) [m]; in three separate sums."""
    along_x, along_y, along_z = 0.0, 0.0, 0.0
    for v in range(load.shape[0]):
        along_x += load[v, 0] * (x[v, 0] - rest[v, 0])
        along_y += load[v, 1] * (x[v, 1] - rest[v, 1])
        along_z += load[v, 2] * (x[v, 2] - rest[v, 2])
    return along_x + along_y + along_z
