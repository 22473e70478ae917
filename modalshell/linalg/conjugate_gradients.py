"""Conjugate gradients preconditioned by a multifrontal factor, compiled [hestenes1952].

One kernel from the first residual to the last: its sums do not depend on how many threads a BLAS has.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import dot
from modalshell.linalg.analysis import Panels
from modalshell.linalg.triangular_solves import solve

_ONE: int = np.int64(1)  # type: ignore[assignment]
"""Right side of a solve; numba would compile the solve once more for a number that is written out at the call."""

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}


class Stop(NamedTuple):
    """When conjugate gradients end."""

    accuracy: float
    """Norm of the residual over that of the right side."""
    most: int
    """Iterations at most."""
    serves: float
    """Accuracy that serves at the last of them."""
    judged: int
    """Iterations after which their rate tells whether they will get half the way to the accuracy, in digits."""


class Rows(NamedTuple):
    """A symmetric matrix by rows."""

    starts: Any
    columns: Any
    data: Any


class Preconditioner(NamedTuple):
    """A factor of a matrix near by."""

    values: Any
    """Its panels, in either precision."""
    panels: Panels
    """Where these are."""
    order: Any
    """Unknowns in the order of elimination; shape (N,)."""
    height: int
    """Rows of the highest panel."""
    flips: Any
    """Its negative pivots: none."""
    axes: Any
    """Where each axis has turned to, since its matrix, with the vertices whose positions are the first unknowns; shape
    (3, f, 3)."""


@njit(**_options)
def solve_near(factor: Preconditioner, matrix: Rows, right: Any, stop: Stop) -> Any:
    """Solve ``A x = right`` with the factor of a matrix near A.

    Returns the solution (N,), the number of solves with the factor, and whether the accuracy is met: not where a
    direction has no or negative curvature.
    """
    values, size = factor.values, right.size
    found, direction, image, residual = np.zeros(size), np.zeros(size), np.empty(size), right.copy()
    permuted, work = np.zeros(size, values.dtype), np.zeros(factor.height + 64 // values.itemsize, values.dtype)
    first = np.sqrt(dot(right, 0, right, 0, size))
    relative, slope = 1.0, np.inf
    for iteration in range(1, stop.most + 1):
        scale = relative * first  # single precision holds no small numbers
        if not scale > 0.0:
            return found, iteration - 1, False
        _turn(factor.axes, residual, image, True)
        for k in range(size):
            permuted[k] = image[factor.order[k]] / scale
        solve(values, factor.panels, permuted, _ONE, work, factor.flips)
        for k in range(size):
            image[factor.order[k]] = permuted[k] * scale
        _turn(factor.axes, image, image, False)
        last, slope = slope, dot(residual, 0, image, 0, size)
        for k in range(size):
            direction[k] = image[k] + (slope / last) * direction[k]
        _multiply(matrix, direction, image)
        curvature = dot(direction, 0, image, 0, size)
        if not (curvature > 0.0 and slope > 0.0):
            return found, iteration, False
        for k in range(size):
            found[k] += (slope / curvature) * direction[k]
            residual[k] -= (slope / curvature) * image[k]
        relative = np.sqrt(dot(residual, 0, residual, 0, size)) / first
        if relative <= stop.accuracy or (iteration == stop.most and relative <= stop.serves):
            return found, iteration, True
        if iteration == stop.judged and not relative ** (stop.most / iteration) <= stop.accuracy**0.5:
            return found, iteration, False
    return found, stop.most, False


@njit(**_options)
def _turn(axes: Any, x: Any, out: Any, back: bool) -> None:
    """Write x with the unknowns of vertices turned, or turned ``back``, into ``out``."""
    for v in range(axes.shape[1]):
        a, b, c = x[3 * v], x[3 * v + 1], x[3 * v + 2]
        for k in range(3):
            if back:
                out[3 * v + k] = axes[k, v, 0] * a + axes[k, v, 1] * b + axes[k, v, 2] * c
            else:
                out[3 * v + k] = axes[0, v, k] * a + axes[1, v, k] * b + axes[2, v, k] * c
    for k in range(3 * axes.shape[1], x.size):
        out[k] = x[k]


@njit(**_options)
def _multiply(matrix: Rows, x: Any, out: Any) -> None:
    """Write the product of a matrix with ``x`` into ``out``; sums in packed registers would take longer."""
    starts, columns, data = matrix.starts, matrix.columns, matrix.data
    for row in range(out.size):
        total = 0.0
        for entry in range(np.uintp(starts[row]), np.uintp(starts[row + 1])):
            total += data[entry] * x[np.uintp(columns[entry])]
        out[row] = total
