"""Kernels of the discrete-shell energies on the storage of a profile factorisation, without second derivatives.

Those of a Hessian take four times the operations of a gradient, and the first part of it has no use for them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.shell.kernels import elements
from modalshell.shell.kernels.generated import flexure, shear, stretch

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}


@njit(inline="always", **_options)
def _add_square(given, element, vertices, deviation, slopes, matrix, gradient):  # type: ignore[no-untyped-def]
    """Add an element's force, and ``2 w grad g grad g^T`` in blocks below the diagonal; ``slopes`` is (3 vertices,)."""
    stencils, weight, slots = given
    values, strides = matrix
    stiffness = 2.0 * weight[element]
    for axis in range(3):  # the first vertex moves against the others
        slopes[axis] = 0.0
        for vertex in range(1, vertices):
            slopes[axis] -= slopes[3 * vertex + axis]
    for first in range(vertices):
        v = stencils[element, first]
        for axis in range(3):
            gradient[v, axis] += stiffness * deviation * slopes[3 * first + axis]
        for second in range(vertices):
            slot = slots[element, first, second]
            if slot >= 0:
                for axis in range(3):
                    mine = stiffness * slopes[3 * first + axis]
                    for other in range(3):
                        values[slot + axis * strides[v] + other] += mine * slopes[3 * second + other]


@njit(entry=False, **_options)
def harden_triangles(x, given, rest, matrix, gradient):  # type: ignore[no-untyped-def]
    """Add the gradient of areas' energy, and the first part of its Hessian.

    ``given`` are stencils, weights, and slots of blocks; ``matrix`` are its values, and strides of vertices.
    """
    slopes = np.empty(9)
    for element in range(rest.size):
        value = stretch.first_derivatives(*stretch.relative(x, given[0], element), slopes[3:])
        _add_square(given, element, 3, value - rest[element], slopes, matrix, gradient)


@njit(entry=False, **_options)
def harden_edges(x, given, rest, matrix, gradient):  # type: ignore[no-untyped-def]
    """The same of lengths."""
    slopes = np.empty(6)
    for element in range(rest.size):
        value = shear.first_derivatives(*shear.relative(x, given[0], element), slopes[3:])
        _add_square(given, element, 2, value - rest[element], slopes, matrix, gradient)


@njit(entry=False, **_options)
def harden_hinges(x, given, rest, matrix, gradient):  # type: ignore[no-untyped-def]
    """The same of fold angles."""
    slopes = np.empty(12)
    for element in range(rest.size):
        value = flexure.first_derivatives(*flexure.relative(x, given[0], element), slopes[3:])
        _add_square(given, element, 4, elements.principal(value - rest[element]), slopes, matrix, gradient)
