"""A reduced energy with assumed membrane stresses: Hellinger-Reissner on a basis that would lock.

A basis that misses positions by a little makes large membrane strains. The membrane energy is therefore that of
stresses in the span of a few trained ones, ``E_m = max_s (s . d - sum_e s_e^2 / (4 w_e))`` [hellinger1914;
reissner1950]: with stress modes that are orthonormal in the complementary energy it is ``sum_k d_k^2 / 2``, each
``d_k = b_k . z + z . B_k z / 2`` a quadratic form of the coordinates z, so no element is evaluated. Flat hinges bend by
a constant matrix; hinges with an angle at rest are evaluated as they are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from modalshell.kernels.compiler import njit
from modalshell.kernels.generated.flexure import first_derivatives
from modalshell.shell import Shell
from modalshell.typing import Array, Index

_FLAT = 1e-6
"""Rest angle [rad] up to which a hinge is flat."""
_MOST, _STALLED = 25, 6
"""Iterations of a step at most, and those without halving the residual after which it is given up."""
_DESCENT = 100
"""Steps of a descent at most."""
_LOOSE, _NEAR = 1e-3, 0.3
"""Relative residuals of a descent's steps, and from which it tries to end by mixed Newton."""

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}


class ReducedStress(NamedTuple):
    """Energy of coordinates z (m,): K stress modes, H hinges with an angle at rest on S vertices.

    Attributes
    ----------
    linear, quadratic : ndarray, shape (K, m) and (K, m, m)
        ``b_k`` and ``B_k``.
    flat : ndarray, shape (m, m)
        Stiffness of the flat hinges.
    rest, modes : ndarray, shape (S, 3) and (S, 3, m)
        The other hinges' vertices at rest [m], and their rows of the basis.
    hinges : ndarray of int64, shape (H, 4)
        Stencils of these hinges in their vertices.
    angles, weights : ndarray, shape (H,)
        Angles at rest [rad], and stiffness over rest size.
    """

    linear: Array
    quadratic: Array
    flat: Array
    rest: Array
    modes: Array
    hinges: Index
    angles: Array
    weights: Array


def reduce_energy(shell: Shell, basis: Array, stresses: Array) -> ReducedStress:
    """Reduced energy of a discrete shell.

    Parameters
    ----------
    shell : Shell
        Its first element sets are stretch, shear and flexure.
    basis : ndarray, shape (3n, m)
        V, of displacements.
    stresses : ndarray, shape (T + E, K)
        Stress modes of triangles and edges; see :func:`stress_modes`.
    """
    stretch, shear, flexure = shell.elements
    vertices, count = shell.rest_positions, basis.shape[1]
    columns = basis.reshape(-1, 3, count)
    edges = shear.stencils
    across = columns[edges[:, 1]] - columns[edges[:, 0]]
    arms = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    along = stresses[len(stretch.rest) :].copy()
    of_edges = {tuple(sorted(edge)): number for number, edge in enumerate(edges.tolist())}
    corners = stretch.stencils
    sides = np.array([[of_edges[tuple(sorted((int(t[i]), int(t[i - 2]))))] for i in range(3)] for t in corners])
    squares = shear.rest[sides] ** 2
    # dA / dl_i = l_i (l_j^2 + l_k^2 - l_i^2) / (8 A) at rest
    slopes = shear.rest[sides] * (squares.sum(axis=1)[:, None] - 2.0 * squares) / (8.0 * stretch.rest[:, None])
    for side in range(3):
        np.add.at(along, sides[:, side], slopes[:, side, None] * stresses[: len(stretch.rest)])
    scaled = along / shear.rest[:, None]
    linear = np.einsum("ek,ex,exm->km", scaled, arms, across, optimize=True)
    tall = across.reshape(-1, count)
    quadratic = np.array([tall.T @ (np.repeat(mode, 3)[:, None] * tall) for mode in scaled.T])
    sharp = np.abs(flexure.rest) > _FLAT
    flat = _flat_bending(vertices, columns, flexure.stencils[~sharp], flexure.weight[~sharp])
    used, hinges = np.unique(flexure.stencils[sharp], return_inverse=True)
    return ReducedStress(
        linear,
        quadratic,
        flat,
        np.ascontiguousarray(vertices[used]),
        np.ascontiguousarray(columns[used]),
        np.ascontiguousarray(hinges.reshape(-1, 4), dtype=np.int64),
        flexure.rest[sharp].copy(),
        flexure.weight[sharp].copy(),
    )


def _flat_bending(vertices: Array, columns: Array, hinges: Index, weights: Array) -> Array:
    """Stiffness (m, m) of ``w |j|^2``, j the sum over both sides of the offset from the rest foot over the height."""
    total = np.zeros((columns.shape[2],) * 2)
    if len(hinges) == 0:
        return total
    first, second = vertices[hinges[:, 0]], vertices[hinges[:, 1]]
    edge = second - first
    length = np.sum(edge**2, axis=1)
    offsets = np.zeros((len(hinges), 3, columns.shape[2]))
    for opposite in (2, 3):
        arm = vertices[hinges[:, opposite]] - first
        share = np.sum(arm * edge, axis=1) / length
        height = np.linalg.norm(arm - share[:, None] * edge, axis=1)[:, None, None]
        share = share[:, None, None]
        foot = (1.0 - share) * columns[hinges[:, 0]] + share * columns[hinges[:, 1]]
        offsets += (columns[hinges[:, opposite]] - foot) / height
    tall = offsets.reshape(-1, columns.shape[2])
    return np.asarray(tall.T @ (np.repeat(2.0 * weights, 3)[:, None] * tall))


def stress_modes(shell: Shell, leading: Array, snapshots: Array, count: int) -> Array:
    """Stress modes (T + E, K), orthonormal in ``sum_e s_e s'_e / (2 w_e)``: of ``leading`` states, then by POD.

    ``leading`` (T + E, l) and ``snapshots`` (T + E, s) are stresses of triangles and edges.
    """
    weight = np.concatenate([shell.elements[0].weight, shell.elements[1].weight])
    root = np.sqrt(np.where(weight > 0.0, 0.5 / np.where(weight > 0.0, weight, 1.0), 0.0))[:, None]
    first = scipy.linalg.orth(root * leading, rcond=1e-8)[:, :count]
    left = root * snapshots
    left = left - first @ (first.T @ left)
    further = _leading_left_vectors(left, count - first.shape[1])
    return np.asarray(np.concatenate([first, further], axis=1) / np.where(root > 0.0, root, np.inf))


def _leading_left_vectors(columns: Array, count: int) -> Array:
    """The leading left singular vectors of many columns."""
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, : min(count, int(np.sum(sizes > 1e-9 * sizes[0])))])


def position_modes(shell: Shell, leading: Array, snapshots: Array, count: int, stiffness: Any) -> Array:
    """Basis V (3n, m), mass-orthonormal, ``V^T K V`` diagonal: of ``leading`` modes, then POD of what is left.

    ``leading`` (3n, l) and ``snapshots`` (3n, s) are displacements, ``stiffness`` (3n, 3n) is that at rest.
    """
    root = np.sqrt(np.repeat(shell.mass, 3))[:, None]
    first = scipy.linalg.orth(root * leading, rcond=1e-10)[:, :count]
    left = root * snapshots
    left = left - first @ (first.T @ left)
    basis = np.concatenate([first, _leading_left_vectors(left, count - first.shape[1])], axis=1) / root
    _, turned = np.linalg.eigh(basis.T @ (stiffness @ basis))
    return np.asarray(basis @ turned)


@njit(**_options)
def energy_terms(reduced, z, strains, slopes, gradient, hessian):  # type: ignore[no-untyped-def]
    """Energy [J] of z; writes d_k, their slopes (K, m), the gradient, and the Hessian without ``sum_k s_k B_k``."""
    count, modes = z.size, reduced.linear.shape[0]
    total = 0.0
    gradient[:] = 0.0
    for i in range(count):
        for j in range(count):
            gradient[i] += reduced.flat[i, j] * z[j]
        total += 0.5 * z[i] * gradient[i]
    for k in range(modes):
        strain = 0.0
        matrix = reduced.quadratic[k]
        for i in range(count):
            bent = 0.0
            for j in range(count):
                bent += matrix[i, j] * z[j]
            slopes[k, i] = reduced.linear[k, i] + bent
            strain += z[i] * (reduced.linear[k, i] + 0.5 * bent)
        strains[k] = strain
        total += 0.5 * strain * strain
    gradient += slopes.T @ strains
    hessian[:] = reduced.flat + slopes.T @ slopes
    hinge_count = reduced.hinges.shape[0]
    if hinge_count == 0:
        return total
    x = reduced.rest.copy()
    for v in range(x.shape[0]):
        for axis in range(3):
            for i in range(count):
                x[v, axis] += reduced.modes[v, axis, i] * z[i]
    local = np.empty(9)
    rows = np.empty((hinge_count, count))
    for h in range(hinge_count):
        a, b, c, d = reduced.hinges[h]
        angle = first_derivatives(
            x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2],
            x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2],
            x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2], local,
        )  # fmt: skip
        change = (angle - reduced.angles[h] + np.pi) % (2.0 * np.pi) - np.pi
        weight = reduced.weights[h]
        total += weight * change * change
        for i in range(count):
            row = 0.0
            for axis in range(3):
                origin = reduced.modes[a, axis, i]
                row += local[axis] * (reduced.modes[b, axis, i] - origin)
                row += local[3 + axis] * (reduced.modes[c, axis, i] - origin)
                row += local[6 + axis] * (reduced.modes[d, axis, i] - origin)
            gradient[i] += 2.0 * weight * change * row
            rows[h, i] = np.sqrt(2.0 * weight) * row
    hessian += rows.T @ rows
    return total


@njit(**_options)
def _solve_in_place(matrix, vector):  # type: ignore[no-untyped-def]
    """Solve by ``L D L^T`` in place, no pivots exchanged; the number of negative pivots, or -1 where one is zero."""
    count, negative = vector.size, 0
    for i in range(count):
        for j in range(i):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total
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
    """Mixed Newton from ``moved``, which it moves; whether it met ``goal``, and at a minimum.

    ``outer`` (m, m) is the quadratic part about ``start``, ``stresses`` those predicted with ``moved``.
    """
    count, modes = moved.size, reduced.linear.shape[0]
    strains, slopes, gradient = np.empty(modes), np.empty((modes, count)), np.empty(count)
    hessian = np.empty((count, count))
    best, stalled, negative = np.inf, 0, 0
    for iteration in range(most + 1):
        energy_terms(reduced, moved, strains, slopes, gradient, hessian)
        residual = gradient + outer @ (moved - start) - push
        size = np.sqrt(np.sum(residual * residual))
        if iteration >= least and size <= goal:
            return True, negative == 0
        stalled = 0 if size < 0.5 * best else stalled + 1
        best = min(best, size)
        if stalled > _STALLED or iteration == most or not np.isfinite(size):
            break
        hessian += outer
        for k in range(modes):
            for i in range(count):
                for j in range(count):
                    hessian[i, j] += stresses[k] * reduced.quadratic[k, i, j]
        step = -residual
        negative = _solve_in_place(hessian, step)
        if negative < 0:
            break
        stresses[:] = strains + slopes @ step
        moved += step
    return False, False


@njit(**_options)
def potential(reduced, z, start, outer, push):  # type: ignore[no-untyped-def]
    """Potential [J] with a quadratic part about ``start``, its gradient (m,), and the d_k (K,)."""
    count, modes = z.size, reduced.linear.shape[0]
    strains, slopes, gradient = np.empty(modes), np.empty((modes, count)), np.empty(count)
    energy = energy_terms(reduced, z, strains, slopes, gradient, np.empty((count, count)))
    pull = outer @ (z - start)
    return energy + np.sum((z - start) * (0.5 * pull - push)), gradient + pull - push, strains


@njit(**_options)
def _descend(reduced, start, moved, outer, push, scale, tolerance):  # type: ignore[no-untyped-def]
    """Go downhill from ``moved``, which it moves, by steps with a drag; whether it has found a minimum."""
    value, gradient, stresses = potential(reduced, moved, start, outer, push)
    drag = 1e-2 * outer[0, 0]
    unit = np.eye(moved.size)
    for _ in range(_DESCENT):
        trial = moved.copy()
        solved, _ = _mixed(
            reduced, moved, trial, stresses.copy(), outer + drag * unit, push - outer @ (moved - start),
            _LOOSE * scale, 12, 1,
        )  # fmt: skip
        reached, gradient, present = potential(reduced, trial, start, outer, push)
        if not (solved and reached <= value):
            drag *= 4.0
            if not np.isfinite(drag):
                break
            continue
        moved[:] = trial
        value, stresses = reached, present
        drag *= 0.25
        if np.sqrt(np.sum(gradient * gradient)) > _NEAR * scale:
            continue
        solved, minimum = _mixed(reduced, start, trial, stresses.copy(), outer, push, tolerance * scale, 12, 1)
        if minimum and potential(reduced, trial, start, outer, push)[0] <= value + 1e-9 * abs(value):
            moved[:] = trial
            return True
    return False


@njit(**_options)
def implicit_step(reduced, z, rates, force, dt, drag, viscosity, tolerance):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton, the d_k being its stresses; z' and whether it is solved.

    ``force`` (m,) is the load's; ``drag`` [1/s] and ``viscosity`` [s] are Rayleigh's factors.
    """
    count, modes = z.size, reduced.linear.shape[0]
    strains, slopes, gradient = np.empty(modes), np.empty((modes, count)), np.empty(count)
    hessian = np.empty((count, count))
    energy_terms(reduced, z, strains, slopes, gradient, hessian)
    outer = np.eye(count) * (1.0 / (dt * dt) + drag / dt)
    if viscosity > 0.0:
        outer += hessian * (viscosity / dt)
    push = force + rates / dt
    scale = max(np.sqrt(np.sum(push * push)), 1e-3 * np.sqrt(np.sum(z * z)) / (dt * dt))
    moved = z + dt * rates
    stresses = strains + slopes @ (dt * rates)
    _, minimum = _mixed(reduced, z, moved, stresses, outer, push, tolerance * scale, _MOST, 1)
    if not minimum:
        moved = z.copy()
        minimum = _descend(reduced, z, moved, outer, push, scale, tolerance)
    return moved, minimum
