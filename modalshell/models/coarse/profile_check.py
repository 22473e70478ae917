"""Compiled error bars of small shells: two mixed Newton steps and the stability margin, in one function.

They are those of :mod:`modalshell.statics.error_bar`, by the parts of a compiled step (:mod:`.profile_newton`): of the
milliseconds that a bar of some hundred vertices takes through sparse algebra most are the interpreter's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.by_reference import by_reference
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, dot, load, store
from modalshell.kernels.packed import spread as everywhere
from modalshell.linalg.profile import add_product, factorise, solve
from modalshell.models.coarse import profile_elasticity as elasticity
from modalshell.models.coarse.profile_newton import Body, Step, outer, spread, still
from modalshell.statics import margin
from modalshell.statics import mixed_newton as method
from modalshell.statics.mixed_newton import START, write

_FEWEST: int = np.int64(margin.FEWEST)  # type: ignore[assignment]  # a plain integer is compiled in as a constant
_FEWEST_EARLY: int = np.int64(margin.FEWEST_EARLY)  # type: ignore[assignment]
_BISECTIONS: int = np.int64(80)  # type: ignore[assignment]
_INVERSE: int = np.int64(3)  # type: ignore[assignment]
"""Halvings that find the lowest eigenvalue of a tridiagonal matrix, and inverse iterations its vector."""
_FIRST_STEP, _BY_KEPT_FACTOR, _SECOND_STEP, _AFTERWARDS = (np.int64(k) for k in range(4))
"""Stages: the first step; the second by iterations with the factor of the first, or by its own; and for the margin
where those do not serve."""
_LITTLE_STEP, _CLEAR = margin.LITTLE_STEP, margin.CLEAR
_CLOSE = 1e-2
_ITERATIONS: int = np.int64(6)  # type: ignore[assignment]
_JUDGED: int = np.int64(2)  # type: ignore[assignment]
_HOPEFUL = 0.2
"""Residual at which iterations with the factor of another step have solved a step's equations, and the most of them;
the iteration after which they are aborted, if the residual is larger than the last number. The first is above that of
:mod:`modalshell.statics.margin`: the step is short, and its error a hundredth of it."""
_JUST_BELOW = 1e-13
"""Distance below that eigenvalue, in sizes of the matrix, at which it is definite for certain."""
_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True} | UNCOUNTED


class Lanczos(NamedTuple):
    """Room for Lanczos iterations: vectors one after the other, their images, and the tridiagonal matrix."""

    vectors: Array
    images: Array
    diagonal: Array
    beside: Array
    pivots: Array
    shape: Array


def make_lanczos(body: Body) -> Lanczos:
    """Room for the iterations of a body."""
    most = margin.STEPS + 1
    vectors, images = np.zeros((2, most * 3 * body.first.size))
    return Lanczos(vectors, images, *np.zeros((4, most)))


@njit(**_options)
def _pivots(lanczos, count, value):  # type: ignore[no-untyped-def]
    """Write pivots of the tridiagonal matrix less ``value``; whether all are positive."""
    diagonal, beside, pivots = lanczos.diagonal, lanczos.beside, lanczos.pivots
    pivots[0] = diagonal[0] - value
    for k in range(1, count):
        if not pivots[k - 1] > 0.0:
            return False
        pivots[k] = diagonal[k] - value - beside[k - 1] * beside[k - 1] / pivots[k - 1]
    return pivots[count - 1] > 0.0


@njit(**_options)
def _lowest(lanczos, count, size):  # type: ignore[no-untyped-def]
    """Lowest eigenvalue of the tridiagonal matrix, of a ``size`` at most, by bisection; and its vector's last part."""
    beside, pivots, shape = lanczos.beside, lanczos.pivots, lanczos.shape
    low, high = -size, size
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _pivots(lanczos, count, middle):
            low = middle
        else:
            high = middle
    _pivots(lanczos, count, low - _JUST_BELOW * size)
    # As nothing beside the diagonal is negative, signs alternate in the lowest vector: the first guess has part of it.
    for k in range(count):
        shape[k] = 1.0 - 2.0 * (k % 2)
    for _ in range(_INVERSE):
        for k in range(1, count):
            shape[k] -= beside[k - 1] / pivots[k - 1] * shape[k - 1]
        shape[count - 1] /= pivots[count - 1]
        for k in range(count - 2, -1, -1):
            shape[k] = (shape[k] - beside[k] * shape[k + 1]) / pivots[k]
        length = 0.0
        for k in range(count):
            length += shape[k] * shape[k]
        for k in range(count):
            shape[k] /= np.sqrt(length)
    return low, abs(shape[count - 1])


@njit(**_options)
def _take(values, start, other, begin, count, factor):  # type: ignore[no-untyped-def]
    """Take ``factor`` times ``count`` numbers of ``other`` from those of ``values``."""
    whole, wide = count // LANES * LANES, everywhere(factor)
    for k in range(0, whole, LANES):
        store(values, start + k, load(values, start + k) - wide * load(other, begin + k))
    for k in range(whole, count):
        values[start + k] -= factor * other[begin + k]


@njit(**_options)
def _lowest_ratio(body, room, lanczos, probe, early):  # type: ignore[no-untyped-def]
    """:func:`modalshell.statics.margin.lowest_ratio` less 1, G in ``room.values``, a factor in ``room.second``."""
    vectors, images, diagonal, beside = lanczos.vectors, lanczos.images, lanczos.diagonal, lanczos.beside
    first, starts, wide = body.first, body.starts, probe.size
    tolerance = margin.TOLERANCE * (margin.SLACK if early else 1.0)
    most = min(diagonal.size - 1, 3 * body.free.size)
    size, lowest, before, length, share = 0.0, 0.0, 0.0, 0.0, 1.0
    for count in range(most + 1):
        here, there = (count - 1) * wide, count * wide
        image, following = images[there : there + wide], vectors[there : there + wide]
        if count == 0:
            write(probe, image)
        else:
            for k in range(wide):
                vectors[here + k] /= length
                images[here + k] /= length
                image[k] = 0.0
            add_product(room.values, first, starts, vectors[here:there], image)
            diagonal[count - 1] = dot(vectors, here, images, there, wide)
        write(image, following)
        solve(room.second, first, starts, room.own, room.pivots, following)
        for twice in range(2 * count):  # as rounding would let found directions come back
            k = twice % count
            lanczos.shape[k] = dot(images, k * wide, vectors, there, wide)
            if k == count - 1:
                for j in range(count):
                    _take(vectors, there, vectors, j * wide, wide, lanczos.shape[j])
                    _take(images, there, images, j * wide, wide, lanczos.shape[j])
        length = np.sqrt(max(dot(vectors, there, images, there, wide), 0.0))
        if count == 0:
            continue
        beside[count - 1] = length
        size = max(size, abs(diagonal[count - 1]) + before + length)
        before = length
        share *= length / margin.FAR
        ended = length <= margin.ENDED * max(size, 1e-300) or count == most
        enough = count >= _FEWEST or (early and count >= _FEWEST_EARLY and share <= margin.UNSEEN)
        if ended or enough:
            lowest, last = _lowest(lanczos, count, size)
            if ended or length * last <= tolerance * max(abs(lowest), margin.FAINT):
                return lowest, count
    return lowest, most


@njit(**_options)
def _solve_near(body, room, lanczos, x):  # type: ignore[no-untyped-def]
    """Solve for ``room.residual`` into ``room.way`` by conjugate gradients with the factor in ``room.second``.

    The matrix is the first part of the Hessian at ``x``, which is not assembled, and what is in ``room.values``.
    Returns the iterations; 0 where they do not serve.
    """
    first, starts, wide, way = body.first, body.starts, room.way.size, room.way
    direction, rest = lanczos.vectors[:wide], lanczos.vectors[wide : 2 * wide]
    image, solved = lanczos.images[:wide], lanczos.images[wide : 2 * wide]
    write(room.residual, rest)
    way[:] = 0.0
    direction[:] = 0.0
    whole, slope = dot(rest, 0, rest, 0, wide), np.inf
    for count in range(1, _ITERATIONS + 1):
        write(rest, solved)
        solve(room.second, first, starts, room.own, room.pivots, solved)
        last, slope = slope, dot(rest, 0, solved, 0, wide)
        for k in range(wide):
            direction[k] = solved[k] + slope / last * direction[k]
            image[k] = 0.0
        add_product(room.values, first, starts, direction, image)
        spread(body, room, direction, 1.0)
        elasticity.resist(body.elastic, room, x)
        for k in range(body.free.size):  # internal unknowns follow: no force is theirs
            for axis in range(3):
                image[3 * body.rows[k] + axis] -= room.gradient[body.free[k], axis]
        curvature = dot(direction, 0, image, 0, wide)
        if not (slope > 0.0 and curvature > 0.0):
            return 0
        _take(way, 0, direction, 0, wide, -slope / curvature)
        _take(rest, 0, image, 0, wide, slope / curvature)
        left = dot(rest, 0, rest, 0, wide)
        if left <= _CLOSE**2 * whole:
            return count
        if count == _JUDGED and left > _HOPEFUL**2 * whole:
            return 0
    return 0


@njit(**_options)
def check(body, room, swapped, lanczos, start, load, probe, early):  # type: ignore[no-untyped-def]
    """Two mixed steps from ``start`` (n, 3), which are left in the room's ``x``, and the stability margin there.

    The records are :class:`~modalshell.kernels.by_reference.Placed`; ``swapped`` is the room with the two matrices in
    each other's place. ``probe`` (3b,) is where Lanczos iterations start.

    If it may be ``early``, and the first step is short, a few iterations with its factor solve the second step, where
    they do. The margin is then found where the second step began, without another factor. By the first step's factor,
    of ``K_1``, it is ``1 + r``, r being the lowest ratio of G to ``K_1``; by a factor of the second step's own, of
    ``K_1 + G``, it is ``1 / (1 - r)``. That serves where the second step is short and the margin large. In checks of
    motions drawn by a seed, 1 less the margin was then within 0.022 and 9 % of that after the step; in the 54 checks
    that took the first step's factor, within 0.014 and 5 %.

    Returns the margin, not a number where a pivot vanishes or the first part is not definite; the Lanczos iterations,
    those of the second step with them; the factorisations; and passes over the elements without one.
    """
    x, elastic, products, factors, passes, negative, near, short = room.x, body.elastic, 0, 0, 0, 0, 0, False
    write(start, x)
    write(load, room.push)
    still(room)
    step = by_reference(Step(body, room, body.rest, x, room.slots))
    for stage in range(_AFTERWARDS + 1):  # a loop, as each place that calls a kernel is compiled anew
        if (stage == _BY_KEPT_FACTOR and not early) or (stage == _SECOND_STEP and near > 0):
            continue
        if stage == _SECOND_STEP:
            if early:
                write(room.values, room.second)  # G is at the same place
            elasticity.assemble(elastic, body, room, x)
        elif stage == _BY_KEPT_FACTOR:
            elasticity.energy(elastic, room, x)
        else:
            elasticity.harden(elastic, body, room, x)
        if stage != _AFTERWARDS:
            outer(step)
        if stage in (_BY_KEPT_FACTOR, _AFTERWARDS):
            elasticity.soften(elastic, body, room, x)
        matrix, way = room.values if stage == _SECOND_STEP else room.second, room.residual
        if stage == _BY_KEPT_FACTOR:
            near = _solve_near(body, room, lanczos, x) if short else 0
            products += near
            passes += 2 + near  # energy, second part, and what resists each direction
            if near == 0:
                continue
            way = room.way
        else:
            factors += 1
            negative = factorise(matrix, body.first, body.starts, room.own, room.pivots)
            if negative < 0 or (negative > 0 and stage == _AFTERWARDS):
                break
        ended = stage == _AFTERWARDS
        if not ended:
            write(x, room.slots[START])
            if stage != _BY_KEPT_FACTOR:
                solve(matrix, body.first, body.starts, room.own, room.pivots, way)
            spread(body, room, way, -1.0)
            method.advance(step)
            short = _is_short(body, x, room.slots[START])
            ended = early and stage != _FIRST_STEP and negative == 0 and short
        if ended:
            own = swapped if stage == _SECOND_STEP else room
            lowest, more = _lowest_ratio(body, own, lanczos, probe, stage == _BY_KEPT_FACTOR)
            products += more
            left = 1.0 / (1.0 - lowest) if stage == _SECOND_STEP else 1.0 + lowest
            if stage == _AFTERWARDS or left > _CLEAR:
                return left, products, factors, passes
    return np.nan, products, factors, passes


@njit(**_options)
def _is_short(body, x, before):  # type: ignore[no-untyped-def]
    """Whether the way from ``before`` (n, 3) to x is short against that from rest, in the norm of the mass."""
    moved, whole = 0.0, 0.0
    for v in range(x.shape[0]):
        for axis in range(3):
            moved += body.mass[v] * (x[v, axis] - before[v, axis]) ** 2
            whole += body.mass[v] * (x[v, axis] - body.rest[v, axis]) ** 2
    return moved <= _LITTLE_STEP**2 * whole
