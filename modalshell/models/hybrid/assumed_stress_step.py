"""Compiled implicit Euler steps of a reduced energy with assumed membrane stresses; see :mod:`.assumed_stress`."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.shell.kernels.generated.flexure import first_derivatives

_MOST, _STALLED = 25, 6
"""Largest number of iterations per step, and of iterations without halving the residual before it fails."""
_DESCENT = 100
"""Steps of a descent at most."""
_LOOSE, _NEAR = 1e-3, 0.3
"""Relative residuals of a descent's steps, and from which it tries to end by mixed Newton."""
_SADDLES, _HALVINGS = 4, 20
"""Saddles that a descent leaves, and halvings of the state's size where the search along the way out begins."""

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}
_summing = _options | {"fastmath": {"contract", "nsz", "reassoc"}}


@njit(**_summing)
def _quadratic(form, z, stresses, strains, slopes, hessian):  # type: ignore[no-untyped-def]
    """Write ``d_k`` and their slopes (m, K); add ``sum_k s_k B_k`` to the lower triangle of ``hessian``.

    One pass over the numbers, which are what a step reads: sums run over the contiguous k.
    """
    linear, pairs = form.linear, form.pairs
    count, modes = linear.shape
    slopes[:, :modes] = 0.0
    place = 0
    for i in range(count):
        for j in range(i):
            total = 0.0
            for k in range(modes):
                slopes[i, k] += pairs[place, k] * z[j]
                slopes[j, k] += pairs[place, k] * z[i]
                total += pairs[place, k] * stresses[k]
            hessian[i, j] += total
            place += 1
        total = 0.0
        for k in range(modes):
            slopes[i, k] += pairs[place, k] * z[i]
            total += pairs[place, k] * stresses[k]
        hessian[i, i] += total
        place += 1
    strains[:modes] = 0.0
    for i in range(count):
        for k in range(modes):
            strains[k] += z[i] * (linear[i, k] + 0.5 * slopes[i, k])
            slopes[i, k] += linear[i, k]


@njit(**_options)
def _predict(slopes, step, strains, stresses):  # type: ignore[no-untyped-def]
    """Write the stresses (K,) after ``step`` (m,), by the strains linearised where they are."""
    for k in range(stresses.size):
        stresses[k] = strains[k]
    for i in range(step.size):
        for k in range(stresses.size):
            stresses[k] += step[i] * slopes[i, k]


@njit(**_summing)
def _hinges(reduced, z, strains, slopes):  # type: ignore[no-untyped-def]
    """Write the angles' changes and slopes, times the roots of their weights, behind those of the membrane."""
    count, first = z.size, reduced.membrane.linear.shape[1]
    x = reduced.rest.copy()
    for v in range(x.shape[0]):
        for axis in range(3):
            total = 0.0
            for i in range(count):
                total += reduced.modes[v, axis, i] * z[i]
            x[v, axis] += total
    local, row = np.empty(9), np.empty(count)
    for h in range(reduced.hinges.shape[0]):
        a, b, c, d = reduced.hinges[h]
        angle = first_derivatives(
            x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2],
            x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2],
            x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2], local,
        )  # fmt: skip
        root = reduced.roots[h]
        strains[first + h] = root * ((angle - reduced.angles[h] + np.pi) % (2.0 * np.pi) - np.pi)
        row[:] = 0.0
        for axis in range(3):
            p, q, r = root * local[axis], root * local[3 + axis], root * local[6 + axis]
            for i in range(count):
                row[i] += p * reduced.modes[b, axis, i] + q * reduced.modes[c, axis, i] + r * reduced.modes[d, axis, i]
                row[i] -= (p + q + r) * reduced.modes[a, axis, i]
        slopes[:, first + h] = row


@njit(**_summing)
def _add_squares(slopes, factor, matrix):  # type: ignore[no-untyped-def]
    """Add ``factor`` times the slopes' products to the lower triangle of ``matrix`` (m, m)."""
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = 0.0
            for k in range(slopes.shape[1]):
                total += slopes[i, k] * slopes[j, k]
            matrix[i, j] += factor * total


@njit(**_summing)
def energy_terms(reduced, z, stresses, strains, slopes, gradient, hessian):  # type: ignore[no-untyped-def]
    """Energy [J] of z; writes strains (K + H,), their slopes (m, K + H), the gradient and the Hessian's lower triangle.

    Strains are ``d_k`` and the changes of the hinges' angles, scaled: half their squares are the energy. The Hessian
    takes ``sum_k s_k B_k`` with the ``stresses`` (K,) given, and leaves out the second derivatives of the angles.
    """
    count = z.size
    hessian[:] = reduced.flat
    total = 0.0
    for i in range(count):
        bent = 0.0
        for j in range(count):
            bent += reduced.flat[i, j] * z[j]
        gradient[i] = bent
        total += 0.5 * z[i] * bent
    _quadratic(reduced.membrane, z, stresses, strains, slopes, hessian)
    _hinges(reduced, z, strains, slopes)
    _add_squares(slopes, 1.0, hessian)
    for k in range(strains.size):
        total += 0.5 * strains[k] * strains[k]
    for i in range(count):
        pull = 0.0
        for k in range(strains.size):
            pull += slopes[i, k] * strains[k]
        gradient[i] += pull
    return total


@njit(**_options)
def evaluate(reduced, z, stresses):  # type: ignore[no-untyped-def]
    """What :func:`energy_terms` finds: energy, strains, slopes, gradient and Hessian."""
    count, modes = reduced.membrane.linear.shape
    strains = np.empty(modes + reduced.angles.size)
    slopes, gradient, hessian = np.empty((count, strains.size)), np.empty(count), np.empty((count, count))
    value = energy_terms(reduced, z, stresses, strains, slopes, gradient, hessian)
    return value, strains, slopes, gradient, hessian


@njit(**_summing)
def _solve_in_place(matrix, vector):  # type: ignore[no-untyped-def]
    """Solve by ``L D L^T`` in place, no pivots exchanged; the number of negative pivots, or -1 where one is zero."""
    count, negative = vector.size, 0
    for i in range(count):
        for j in range(i):
            total = 0.0
            for k in range(j):
                total += matrix[i, k] * matrix[j, k]
            matrix[i, j] -= total
        pivot = matrix[i, i]
        for j in range(i):
            scaled = matrix[i, j] / matrix[j, j]
            pivot -= matrix[i, j] * scaled
            vector[i] -= scaled * vector[j]
            matrix[i, j] = scaled
        if not 0.0 < abs(pivot) < np.inf:
            return -1
        negative += pivot < 0.0
        matrix[i, i] = pivot
    for i in range(count - 1, -1, -1):
        vector[i] /= matrix[i, i]
        for k in range(i + 1, count):
            vector[i] -= matrix[k, i] * vector[k]
    return negative


@njit(**_options)
def _mixed(reduced, start, moved, stresses, outer, push, goal, most, least):  # type: ignore[no-untyped-def]
    """Mixed Newton from ``moved``, which it moves, with ``stresses`` (K,), which it updates.

    ``outer`` (m, m) is the quadratic part about ``start``. Returns whether it met ``goal``, and at a minimum, the
    energy there, and the iterations.
    """
    count, modes = reduced.membrane.linear.shape
    strains = np.empty(modes + reduced.angles.size)
    slopes, gradient, hessian = np.empty((count, strains.size)), np.empty(count), np.empty((count, count))
    best, stalled, negative = np.inf, 0, 0
    for iteration in range(most + 1):
        value = energy_terms(reduced, moved, stresses, strains, slopes, gradient, hessian)
        residual = gradient + outer @ (moved - start) - push
        size = np.sqrt(np.sum(residual * residual))
        if iteration >= least and size <= goal:
            stresses[:] = strains[:modes]
            return True, negative == 0, value, iteration
        stalled = 0 if size < 0.5 * best else stalled + 1
        best = min(best, size)
        if stalled > _STALLED or iteration == most or not np.isfinite(size):
            break
        hessian += outer
        step = -residual
        negative = _solve_in_place(hessian, step)
        if negative < 0:
            break
        _predict(slopes, step, strains, stresses)
        moved += step
    return False, False, np.inf, iteration


@njit(**_options)
def potential(reduced, z, start, outer, push):  # type: ignore[no-untyped-def]
    """Potential [J] with a quadratic part about ``start``, its gradient (m,), and the d_k (K,)."""
    modes = reduced.membrane.linear.shape[1]
    energy, strains, _, gradient, _ = evaluate(reduced, z, np.zeros(modes))
    pull = outer @ (z - start)
    return energy + np.sum((z - start) * (0.5 * pull - push)), gradient + pull - push, strains[:modes].copy()


@njit(**_options)
def _leave_saddle(reduced, moved, start, outer, push, stresses):  # type: ignore[no-untyped-def]
    """Move ``moved`` off a saddle, along the direction in which the potential curves down most; the potential there.

    Steps double for as long as the potential falls: the first valley is looked for, on either side.
    """
    hessian = evaluate(reduced, moved, stresses)[4] + outer
    for i in range(moved.size):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    way = np.linalg.eigh(hessian)[1][:, 0].copy()
    size = np.sqrt(np.sum(moved * moved))
    best, least = moved.copy(), potential(reduced, moved, start, outer, push)[0]
    for sign in (-1.0, 1.0):
        last, length = np.inf, sign * size * 2.0**-_HALVINGS
        while abs(length) < size:
            trial = moved + length * way
            value = potential(reduced, trial, start, outer, push)[0]
            if not value < last:
                break
            last = value
            length *= 2.0
            if value < least:
                best, least = trial, value
    moved[:] = best
    return least


@njit(**_options)
def _descend(reduced, start, moved, stresses, outer, push, scale, tolerance):  # type: ignore[no-untyped-def]
    """Go downhill from ``moved``, which it moves, by steps with a drag; what :func:`_mixed` returns."""
    value, gradient, present = potential(reduced, moved, start, outer, push)
    drag = 1e-2 * outer[0, 0]
    unit = np.eye(moved.size)
    iterations, left = 0, 0
    for _ in range(_DESCENT):
        trial = moved.copy()
        stresses[:] = present
        solved, _, _, taken = _mixed(
            reduced, moved, trial, stresses, outer + drag * unit, push - outer @ (moved - start), _LOOSE * scale, 12, 1
        )
        iterations += taken
        reached, gradient, found = potential(reduced, trial, start, outer, push)
        if not (solved and reached <= value):
            drag *= 4.0
            if not np.isfinite(drag):
                break
            continue
        moved[:] = trial
        value, present = reached, found
        drag *= 0.25
        if np.sqrt(np.sum(gradient * gradient)) > _NEAR * scale:
            continue
        stresses[:] = present
        solved, minimum, energy, taken = _mixed(reduced, start, trial, stresses, outer, push, tolerance * scale, 12, 1)
        iterations += taken
        if solved and potential(reduced, trial, start, outer, push)[0] <= value + 1e-9 * abs(value):
            moved[:] = trial
            if minimum or left == _SADDLES:
                return True, minimum, energy, iterations
            left += 1
            value = _leave_saddle(reduced, moved, start, outer, push, stresses)
            present = potential(reduced, moved, start, outer, push)[2]
    return False, False, np.inf, iterations


@njit(**_options)
def implicit_step(reduced, z, rates, force, dt, drag, viscosity, tolerance):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton, the d_k being its stresses.

    ``force`` (m,) is the load's; ``drag`` [1/s] and ``viscosity`` [s] are Rayleigh's factors. The viscous matrix is
    that of the strains' slopes before the step, as for discrete shells.

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
    count, modes = reduced.membrane.linear.shape
    further = reduced.viscous.linear.shape[1]
    slopes = np.empty((count, max(modes, further) + reduced.angles.size))
    strains, unused, outer = np.empty(slopes.shape[1]), np.empty((count, count)), np.zeros((count, count))
    if viscosity > 0.0:
        _quadratic(reduced.viscous, z, np.zeros(further), strains, slopes, unused)
        _add_squares(slopes[:, :further], viscosity / dt, outer)
        _hinges(reduced, z, strains, slopes)
        _add_squares(slopes[:, modes : modes + reduced.angles.size], viscosity / dt, outer)
        for i in range(count):
            for j in range(i):
                outer[j, i] = outer[i, j]
        outer += reduced.flat * (viscosity / dt)
    for i in range(count):
        outer[i, i] += 1.0 / (dt * dt) + drag / dt
    push = force + rates / dt
    scale = max(np.sqrt(np.sum(push * push)), 1e-3 * np.sqrt(np.sum(z * z)) / (dt * dt))
    moved = z + dt * rates
    stresses = np.zeros(modes)
    _quadratic(reduced.membrane, z, stresses, strains, slopes, unused)
    _predict(slopes, dt * rates, strains, stresses)
    _, minimum, energy, iterations = _mixed(reduced, z, moved, stresses, outer, push, tolerance * scale, _MOST, 1)
    if not minimum:
        moved = z.copy()
        _, minimum, energy, further = _descend(reduced, z, moved, stresses, outer, push, scale, tolerance)
        iterations += further
    return moved, minimum, energy, 0.5 * np.sum(stresses * stresses), iterations
