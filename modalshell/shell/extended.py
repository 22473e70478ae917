"""The energy's gradient in extended precision, from displacements: what rounding leaves out of a balance of forces.

In double precision the rounding of positions alone puts a stiff sheet out of balance: each edge is off by some 1e-16 of
the *shell's* size, and its stiffness makes a force of that. Here displacements are kept apart from the rest shape, and
measures are differences from those at rest, so that small displacements have small errors. Extended precision is
``numpy.longdouble``: 64 bits of mantissa on x86, 53 (no gain but that of the differences) on some other machines.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modalshell.shell.elements import ElementSet
from modalshell.typing import Array

Extended = NDArray[np.longdouble]

_SMALL = 1e-3
"""Change of an element, as a share of its size, up to which its measure is integrated along the displacement."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def extended_gradient(elements: Sequence[ElementSet], rest: Array, displacement: Extended) -> Extended:
    """Gradient (n, 3) [N] of the energy at ``rest + displacement``, both (n, 3) [m].

    A measure's change is the difference of its values; where that would cancel, its gradient integrated along the
    displacement by Gauss's rule, whose error is of eighth order.
    """
    exact: Extended = rest.astype(np.longdouble)
    total = np.zeros(displacement.shape, dtype=np.longdouble)
    for e in elements:
        relative = e.stencils[:, 1:]
        edges, moved = (
            np.moveaxis(field[relative] - field[e.stencils[:, :1]], 0, 2).reshape(e.kernel.UNKNOWNS, -1)
            for field in (exact, displacement)
        )
        slope = np.empty_like(edges)
        now = e.kernel.first_derivatives.py_func(*(edges + moved), slope)
        change = now - e.kernel.measure.py_func(*edges)
        if e.kernel.PERIODIC:
            change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
        small = np.abs(moved).max(axis=0) < _SMALL * np.abs(edges).max(axis=0)
        if small.any():
            change[small] = _integrated(e, edges[:, small], moved[:, small])
        stored = np.empty(len(e.stencils))
        e.kernel.measures(rest, e.stencils, stored)
        force = 2.0 * e.weight * (change + (stored - e.rest)) * slope
        parts = np.moveaxis(force.reshape(-1, 3, force.shape[1]), 2, 0)
        np.add.at(total, relative, parts)
        np.add.at(total, e.stencils[:, 0], -parts.sum(axis=1))
    return total


def _integrated(e: ElementSet, edges: Extended, moved: Extended) -> Extended:
    total = np.zeros(edges.shape[1], dtype=np.longdouble)
    slope = np.empty_like(edges)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        e.kernel.first_derivatives.py_func(*(edges + 0.5 * (1.0 + node) * moved), slope)
        total += 0.5 * weight * (slope * moved).sum(axis=0)
    return total
