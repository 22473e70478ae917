"""One rank's rows of an implicit step's matrix, as 3 x 3 blocks in compressed rows."""

from modalshell.kernels.compiler import njit


@njit(error_model="numpy", fastmath=False)
def fill(starts, others, lower, blocks, weight, free, values):  # type: ignore[no-untyped-def]
    """Write the blocks of every row into ``values`` (springs + rows, 3, 3), the diagonal one after the ``lower`` ones.

    Row i has ``weight[i] I`` plus the sum of its springs' ``a I + m m^T`` (``blocks``, see
    :mod:`modalshell.springs.kernels.blocks`) on the diagonal and minus each off it. Blocks that join a particle that
    is not ``free`` are 0, so that the matrix stays symmetric and leaves it alone.
    """
    for i in range(starts.size - 1):
        diagonal = starts[i] + i + lower[i]
        for row in range(3):
            for column in range(3):
                values[diagonal, row, column] = weight[i] if row == column else 0.0
        for s in range(starts[i], starts[i + 1]):
            slot = s + i if s - starts[i] < lower[i] else s + i + 1
            both = free[i] * free[others[s]]
            for row in range(3):
                for column in range(3):
                    value = blocks[s, 1 + row] * blocks[s, 1 + column]
                    if row == column:
                        value += blocks[s, 0]
                    values[slot, row, column] = -both * value
                    values[diagonal, row, column] += value
