"""Gradient of the energy in extended precision, which recovers what rounding loses in a balance of forces.

In double precision the rounding of positions alone puts a stiff sheet out of balance: each edge is off by some 1e-16 of
the *shell's* size, and its stiffness makes a force of that. Here displacements are kept apart from the rest shape, and
measures are differences from those at rest, so that small displacements have small errors. Extended precision is
``numpy.longdouble``: 64 bits of mantissa on x86, 53 (no gain but that of the differences) on some other machines.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array, Index

Extended = NDArray[np.longdouble]

_SMALL = 1e-3
"""Change of an element, as a share of its size, up to which its measure is integrated along the displacement."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def measure_changes(kernel: Any, stencils: Index, rest: Array, displacement: Extended) -> tuple[Extended, Extended]:
    """Changes (elements,) of a generated kernel's measures from ``rest`` to ``rest + displacement``, and their slopes.

    A measure's change is the difference of its values; where that would cancel, its gradient integrated along the
    displacement by Gauss's rule, whose error is of eighth order. Both positions are (n, 3) [m]; slopes (unknowns,
    elements) are those at the end.
    """
    exact: Extended = rest.astype(np.longdouble)
    edges, moved = (
        np.moveaxis(field[stencils[:, 1:]] - field[stencils[:, :1]], 0, 2).reshape(kernel.UNKNOWNS, -1)
        for field in (exact, displacement)
    )
    slope = np.empty_like(edges)
    change = kernel.first_derivatives.py_func(*(edges + moved), slope) - kernel.measure.py_func(*edges)
    if kernel.PERIODIC:
        change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
    small = np.abs(moved).max(axis=0) < _SMALL * np.abs(edges).max(axis=0)
    if small.any():
        change[small] = _integrated(kernel, edges[:, small], moved[:, small])
    return change, slope


def add_forces(stencils: Index, stress: Extended | Array, slope: Extended, total: Extended) -> None:
    """Add the ``stress`` (elements,) of measures with slopes (unknowns, elements) to a gradient (n, 3)."""
    parts = np.moveaxis((stress * slope).reshape(-1, 3, slope.shape[1]), 2, 0)
    np.add.at(total, stencils[:, 1:], parts)
    np.add.at(total, stencils[:, 0], -parts.sum(axis=1))


def _integrated(kernel: Any, edges: Extended, moved: Extended) -> Extended:
    total = np.zeros(edges.shape[1], dtype=np.longdouble)
    slope = np.empty_like(edges)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        kernel.first_derivatives.py_func(*(edges + 0.5 * (1.0 + node) * moved), slope)
        total += 0.5 * weight * (slope * moved).sum(axis=0)
    return total
