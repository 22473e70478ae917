"""Compiled implicit Euler steps of a reduced energy with assumed membrane stresses; see :mod:`.assumed_stress`.

The method is that of :mod:`modalshell.statics.mixed_newton`, the d_k being its stresses.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, dot, load, load_first, spread, store, total
from modalshell.models.hybrid.assumed_stress import ReducedStress
from modalshell.models.hybrid.bending_kernels import add_coupled, add_couplings, hinge_angles, write_products
from modalshell.statics import mixed_newton as method
from modalshell.statics.mixed_newton import ALL_CHECKED, DESCENT, MOST, STALLED, START, Rules, operation_of, solve_step

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}
_operation = _options | UNCOUNTED


@njit(**_options)
def _quadratic(form, z, stresses, strains, slopes, hessian):  # type: ignore[no-untyped-def]
    """Write ``d_k`` and their slopes (m, K); add ``sum_k s_k B_k`` to the lower triangle of ``hessian``.

    One pass over the numbers, which are what a step reads: sums run over the contiguous k.
    """
    linear, pairs = form.linear, form.pairs.reshape(-1)
    count, modes = linear.shape
    width = -(-modes // LANES) * LANES
    rest = modes - (width - LANES)
    products, known = np.zeros(count * width), np.zeros(width)
    for k in range(modes):
        known[k] = stresses[k]
    place = 0
    for i in range(count):
        here = spread(z[i])
        for j in range(i + 1):
            there, p, q, sums = spread(z[j]), i * width, j * width, spread(0.0)
            for k in range(0, width, LANES):
                numbers = load(pairs, place + k) if k + LANES <= modes else load_first(pairs, place + k, rest)
                store(products, p + k, load(products, p + k) + numbers * there)
                if j < i:
                    store(products, q + k, load(products, q + k) + numbers * here)
                sums = sums + numbers * load(known, k)
            hessian[i, j] += total(sums)
            place += modes
    for k in range(modes):
        strains[k] = 0.0
    for i in range(count):
        for k in range(modes):
            slope = products[i * width + k]
            strains[k] += z[i] * (linear[i, k] + 0.5 * slope)
            slopes[i, k] = linear[i, k] + slope


@njit(**_options)
def _predict(slopes, step, strains, stresses):  # type: ignore[no-untyped-def]
    """Write the stresses (K,) after ``step`` (m,), by the strains linearised where they are."""
    for k in range(stresses.size):
        stresses[k] = strains[k]
    for i in range(step.size):
        for k in range(stresses.size):
            stresses[k] += step[i] * slopes[i, k]


@njit(**_options)
def _add_squares(slopes, first, size, factor, matrix):  # type: ignore[no-untyped-def]
    """Add ``factor`` times the products of ``size`` slopes to the lower triangle of ``matrix`` (m, m)."""
    count = matrix.shape[0]
    width = -(-count // LANES) * LANES
    turned, made = np.zeros(size * width), np.empty(width * width)
    for i in range(count):
        for k in range(size):
            turned[k * width + i] = slopes[i, first + k]
    write_products(turned, turned, width, True, made)
    for i in range(count):
        for j in range(i + 1):
            matrix[i, j] += factor * made[i * width + j]


@njit(**_options)
def energy_terms(reduced, z, stresses, strains, slopes, gradient, hessian):  # type: ignore[no-untyped-def]
    """Energy [J] of z; writes strains (K + H,), their slopes (m, K + H), the gradient and the Hessian's lower triangle.

    Strains are ``d_k`` and the changes of the hinges' angles, scaled: half their squares are the energy, but for the
    flat hinges' and what couples hinges. The Hessian takes ``sum_k s_k B_k`` with the ``stresses`` (K,) given, and
    leaves out the second derivatives of the angles and of the normals.
    """
    count, bending, first = z.size, reduced.bending, reduced.membrane.linear.shape[1]
    flat, energy = bending.flat.reshape(-1), 0.0
    for i in range(count):
        for j in range(count):
            hessian[i, j] = bending.flat[i, j]
        bent = dot(flat, i * count, z, 0, count)
        gradient[i] = bent
        energy += 0.5 * z[i] * bent
    _quadratic(reduced.membrane, z, stresses, strains, slopes, hessian)
    x = hinge_angles(bending, z, first, strains, slopes)
    _add_squares(slopes, 0, strains.size, 1.0, hessian)
    energy += 0.5 * dot(strains, 0, strains, 0, strains.size)
    rows, width = slopes.reshape(-1), slopes.shape[1]
    for i in range(count):
        gradient[i] += dot(rows, i * width, strains, 0, strains.size)
    if bending.across.shape[0] > 0:
        others = np.empty((bending.across.shape[0], count))
        energy += add_couplings(bending, z, x, first, strains, slopes, others, gradient)
        add_coupled(slopes, first, others, 1.0, hessian)
    return energy


@njit(**_options)
def evaluate(reduced, z, stresses):  # type: ignore[no-untyped-def]
    """What :func:`energy_terms` finds: energy, strains, slopes, gradient and Hessian."""
    count, modes = reduced.membrane.linear.shape
    strains = np.empty(modes + reduced.bending.angles.size)
    slopes, gradient, hessian = np.empty((count, strains.size)), np.empty(count), np.empty((count, count))
    value = energy_terms(reduced, z, stresses, strains, slopes, gradient, hessian)
    return value, strains, slopes, gradient, hessian


@njit(**_options)
def _solve_in_place(matrix, vector):  # type: ignore[no-untyped-def]
    """Solve by ``L D L^T`` in place, no pivots exchanged; the number of negative pivots, or -1 where one is zero."""
    count, negative = vector.size, 0
    for i in range(count):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    for k in range(count):  # rows of D L^T above the diagonal, those of L below
        pivot = matrix[k, k]
        if not 0.0 < abs(pivot) < np.inf:
            return -1
        negative += pivot < 0.0
        for i in range(k + 1, count):
            scaled = matrix[k, i] / pivot
            matrix[i, k] = scaled
            for j in range(i, count):
                matrix[i, j] -= scaled * matrix[k, j]
            vector[i] -= scaled * vector[k]
    for i in range(count):
        vector[i] /= matrix[i, i]
    for i in range(count - 1, 0, -1):
        last = vector[i]
        for k in range(i):
            vector[k] -= matrix[i, k] * last
    return negative


class Step(NamedTuple):
    """A step about ``origin`` (m,), ``outer`` (m, m) being its quadratic part: the problem of mixed Newton."""

    reduced: ReducedStress
    origin: Array
    outer: Array
    push: Array
    x: Array
    stresses: Array
    strains: Array
    slopes: Array
    gradient: Array
    hessian: Array
    slots: Array
    way: Array
    numbers: Array


_SCALE, _DRAG, _NEGATIVE, _ENERGY = range(4)
"""Places in a step's numbers: of forces, of a descent, negative pivots of the last factor, the elastic energy."""


@operation_of(Step, method.residual, **_operation)
def _residual(p):  # type: ignore[no-untyped-def]
    """Energy, strains, Hessian and out-of-balance force; its size."""
    return _balance(p)


@njit(**_options)
def _balance(p):  # type: ignore[no-untyped-def]
    p.numbers[_ENERGY] = energy_terms(p.reduced, p.x, p.stresses, p.strains, p.slopes, p.gradient, p.hessian)
    count, outer, u = p.x.size, p.outer.reshape(-1), np.empty(p.x.size)
    for i in range(count):
        u[i] = p.x[i] - p.origin[i]
    for i in range(count):
        p.gradient[i] += dot(outer, i * count, u, 0, count) - p.push[i]
        p.gradient[i] += p.numbers[_DRAG] * (p.x[i] - p.slots[START, i])
    return np.sqrt(dot(p.gradient, 0, p.gradient, 0, count)) / p.numbers[_SCALE]


@operation_of(Step, method.potential, **_operation)
def _potential(p):  # type: ignore[no-untyped-def]
    """Potential, and size of the out-of-balance force."""
    size, value = _balance(p), p.numbers[_ENERGY]
    for i in range(p.x.size):
        move = p.x[i] - p.origin[i]
        for j in range(p.x.size):
            value += 0.5 * move * p.outer[i, j] * (p.x[j] - p.origin[j])
        value -= move * p.push[i]
    return value, size


@operation_of(Step, method.solve, **_operation)
def _solve(p, accuracy):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Newton's direction, into the array of the gradient."""
    for i in range(p.x.size):
        for j in range(i + 1):
            p.hessian[i, j] += p.outer[i, j]
        p.hessian[i, i] += p.numbers[_DRAG]
        p.gradient[i] = -p.gradient[i]
    p.numbers[_NEGATIVE] = _solve_in_place(p.hessian, p.gradient)
    return p.numbers[_NEGATIVE] >= 0.0


@operation_of(Step, method.advance, **_operation)
def _advance(p):  # type: ignore[no-untyped-def]
    """Move along the direction."""
    _predict(p.slopes, p.gradient, p.strains, p.stresses)
    for i in range(p.x.size):
        p.x[i] += p.gradient[i]
    return 0.0


@operation_of(Step, method.is_minimum, **_operation)
def _is_minimum(p):  # type: ignore[no-untyped-def]
    """Whether the last factor has no negative pivot."""
    return p.numbers[_NEGATIVE] == 0.0


@operation_of(Step, method.drag, **_operation)
def _drag(p, factor):  # type: ignore[no-untyped-def]
    """Set the drag about START, and the stresses of the iterate."""
    p.numbers[_DRAG] = factor
    _balance(p)
    for k in range(p.stresses.size):
        p.stresses[k] = p.strains[k]


@operation_of(Step, method.first_drag, **_operation)
def _first_drag(p, size):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Drag to begin with: a hundredth of the inertia, as coordinates have no size of their own."""
    return 0.01 * p.outer[0, 0]


@operation_of(Step, method.point_downhill, **_options)
def _point_downhill(p):  # type: ignore[no-untyped-def]
    """Find the direction in which the potential curves down most."""
    _balance(p)
    count = p.x.size
    for i in range(count):
        for j in range(i + 1):
            p.hessian[i, j] += p.outer[i, j]
            p.hessian[j, i] = p.hessian[i, j]
    curvatures, ways = np.linalg.eigh(p.hessian)
    size = np.sqrt(dot(p.x, 0, p.x, 0, count))
    for i in range(count):
        p.way[i] = size * ways[i, 0]
    return curvatures[0]


@operation_of(Step, method.step_aside, **_operation)
def _step_aside(p, fraction):  # type: ignore[no-untyped-def]
    """Move along that direction."""
    for i in range(p.x.size):
        p.x[i] = p.slots[START, i] + fraction * p.way[i]


@njit(**_options)
def implicit_step(reduced, start, force, dt, drag, viscosity, tolerance):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton, and descent where that fails.

    ``start`` holds coordinates and rates, a state without false strains, and where the viscous matrix is taken.
    Newton's method begins where the rates lead, with the stresses of that state. ``force`` (m,) is the load's; ``drag``
    [1/s] and ``viscosity`` [s] are Rayleigh's factors. The viscous matrix is that of the strains' slopes, as for
    discrete shells.

    Returns
    -------
    z : ndarray, shape (m,)
        Coordinates after the step, or where the solver gave up.
    solved : bool
        Whether the residual met the tolerance at a minimum.
    energy, seen : float
        Elastic energy, and its share in the assumed stresses [J].
    iterations : int
        Iterations.
    """
    z, rates, near, viscous_at = start
    count, modes = reduced.membrane.linear.shape
    further = reduced.viscous.linear.shape[1]
    slopes = np.empty((count, max(modes, further) + reduced.bending.angles.size))
    strains, unused, outer = np.empty(slopes.shape[1]), np.empty((count, count)), np.zeros((count, count))
    if viscosity > 0.0:
        factor, bending = viscosity / dt, reduced.bending
        _quadratic(reduced.viscous, viscous_at, np.zeros(further), strains, slopes, unused)
        _add_squares(slopes, 0, further, factor, outer)
        x = hinge_angles(bending, viscous_at, modes, strains, slopes)
        _add_squares(slopes, modes, bending.angles.size, factor, outer)
        if bending.across.shape[0] > 0:
            others, none = np.empty((bending.across.shape[0], count)), np.zeros(count)
            add_couplings(bending, viscous_at, x, modes, strains, slopes, others, none)
            add_coupled(slopes, modes, others, factor, outer)
        for i in range(count):
            for j in range(i + 1):
                outer[i, j] += factor * bending.flat[i, j]
                outer[j, i] = outer[i, j]
    push, begin, way, slots = np.empty(count), np.empty(count), np.empty(count), np.empty((2, count))
    for i in range(count):
        outer[i, i] += 1.0 / (dt * dt) + drag / dt
        push[i] = force[i] + rates[i] / dt
        begin[i] = z[i] + dt * rates[i]
        slots[START, i] = near[i]
    scale = max(np.sqrt(dot(push, 0, push, 0, count)), 1e-3 * np.sqrt(dot(z, 0, z, 0, count)) / (dt * dt))
    scale = scale if scale > 0.0 else 1.0
    stresses = np.zeros(modes)
    _quadratic(reduced.membrane, near, stresses, strains, slopes, unused)
    for k in range(modes):
        stresses[k] = strains[k]
    slopes, strains = (
        np.empty((count, modes + reduced.bending.angles.size)),
        np.empty(modes + reduced.bending.angles.size),
    )
    step = Step(
        reduced, z, outer, push, begin, stresses, strains, slopes, np.empty(count), unused, slots, way,
        np.array([scale, 0.0, 0.0, np.inf]),
    )  # fmt: skip
    found = solve_step(step, Rules(tolerance, tolerance, 0.0, ALL_CHECKED, MOST, STALLED, DESCENT))
    seen = 0.5 * dot(strains, 0, strains, 0, modes)
    return step.x, found.solved, step.numbers[_ENERGY], seen, found.iterations
