"""Compiled: signed distances of points from planes, capsules, spheres, cylinders and boxes, and their normals.

A collider is a kind and a row of numbers where its motion has brought it: see :func:`packed`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modalshell.contact.base import BOX, CYLINDER, PLANE, ROUND
from modalshell.contact.contact import Contact
from modalshell.core.typing import Array
from modalshell.kernels.compiler import UNCOUNTED, njit

_NUMBERS = 20
"""Numbers of a collider at most."""
_EYE, _ORIGIN = np.eye(3), np.zeros((1, 3))

Packed = tuple[NDArray[np.int64], Array]
"""Kinds (c,) and numbers (c, 20) of contacts."""


def forms_of(contacts: Sequence[Contact]) -> Packed | None:
    """Kinds and numbers of the contacts' colliders before they move; None as of :func:`packed`."""
    kinds, numbers = np.empty(len(contacts), np.int64), np.zeros((len(contacts), _NUMBERS))
    for index, contact in enumerate(contacts):
        form = contact.collider.packed()
        if form is None:
            return None
        kinds[index], own = form
        numbers[index, : len(own)] = own
    return kinds, numbers


def packed(contacts: Sequence[Contact], forms: Packed | None, time: float, origin: Array | None) -> Packed | None:
    """Kinds and numbers of contacts at ``time`` [s], about an ``origin`` (3,); None where one has no compiled form."""
    if forms is None:
        return None
    kinds, numbers = forms[0], forms[1].copy()
    for kind, own, contact in zip(kinds, numbers, contacts, strict=True):
        if contact.motion is None and origin is None:
            continue
        turn, place = _EYE, _ORIGIN[0]
        if contact.motion is not None:
            pose = contact.motion.at(time)
            turn, place = pose.rotation, pose.to_world(_ORIGIN)[0]
        _move(kind, own, turn, place if origin is None else place - origin)
    return kinds, numbers


def _move(kind: int, own: Array, turn: Array, place: Array) -> None:
    """Turn (3, 3) and displace (3,) [m] a collider, in its numbers (20,)."""
    if kind == PLANE:
        own[:3] = turn @ own[:3]
        own[3] += own[:3] @ place
        return
    own[:3] = turn @ own[:3] + place
    if kind == BOX:
        own[3:12] = (turn @ own[3:12].reshape(3, 3)).ravel()
    else:
        own[3:6] = turn @ own[3:6]


def common_normal(bodies: Packed) -> Array | None:
    """Normal (3,) of packed contacts that are planes with the same one; None of others."""
    kinds, numbers = bodies
    if not len(kinds) or (kinds != PLANE).any() or (numbers[1:, :3] != numbers[0, :3]).any():
        return None
    return numbers[0, :3]


_kernel = njit(error_model="numpy", fastmath=False)
_plain = njit(error_model="numpy", fastmath=False, **UNCOUNTED)


@njit(error_model="numpy", fastmath=False, forceinline=True, **UNCOUNTED)
def _away(x, y, z, radius, normal):  # type: ignore[no-untyped-def]
    """Distance from a ball about the origin, and the normal there."""
    distance = math.sqrt(x * x + y * y + z * z)
    if distance > 0.0:
        normal[0], normal[1], normal[2] = x / distance, y / distance, z / distance
    return distance - radius


@_plain
def _across(along, normal):  # type: ignore[no-untyped-def]
    """A unit normal across a unit vector, where every one serves."""
    axis = 0
    for i in range(1, 3):
        if abs(along[i]) < abs(along[axis]):
            axis = i
    size = math.sqrt(max(1.0 - along[axis] * along[axis], 1e-300))
    for i in range(3):
        normal[i] = ((1.0 if i == axis else 0.0) - along[axis] * along[i]) / size


@njit(error_model="numpy", fastmath=False, forceinline=True, **UNCOUNTED)
def _from_axis(p, x, y, z):  # type: ignore[no-untyped-def]
    """The way to a point from the nearest one of a capsule's axis. Numbers: a, the axis, its length, the radius."""
    x, y, z = x - p[0], y - p[1], z - p[2]
    along = min(max(x * p[3] + y * p[4] + z * p[5], 0.0), p[6])
    return x - along * p[3], y - along * p[4], z - along * p[5]


@_plain
def _round(p, x, y, z, normal):  # type: ignore[no-untyped-def]
    """Of a capsule, or a ball: its axis has no length."""
    x, y, z = _from_axis(p, x, y, z)
    normal[0], normal[1], normal[2] = 0.0, 0.0, 0.0
    gap = _away(x, y, z, p[7], normal)
    if gap == -p[7]:
        _across(p[3:6], normal)
    return gap


@_plain
def _cylinder(p, x, y, z, normal):  # type: ignore[no-untyped-def]
    """Of a cylinder with flat ends; numbers as those of a capsule."""
    x, y, z, half = x - p[0], y - p[1], z - p[2], 0.5 * p[6]
    along = x * p[3] + y * p[4] + z * p[5]
    beyond = abs(along - half) - half
    side = _away(x - along * p[3], y - along * p[4], z - along * p[5], p[7], normal)
    if side == -p[7]:
        _across(p[3:6], normal)
    sign = 1.0 if along > half else -1.0
    if side <= 0.0:
        if beyond > side:
            for i in range(3):
                normal[i] = sign * p[3 + i]
            return beyond
        return side
    if beyond <= 0.0:
        return side
    far = math.sqrt(side * side + beyond * beyond)
    for i in range(3):
        normal[i] = side / far * normal[i] + beyond / far * sign * p[3 + i]
    return far


@_plain
def _box(p, x, y, z, normal):  # type: ignore[no-untyped-def]
    """Of a rounded box. Numbers: its centre, its rotation by rows, its half lengths less the rounding, this."""
    x, y, z = x - p[0], y - p[1], z - p[2]
    u, v, w = (
        x * p[3] + y * p[6] + z * p[9],
        x * p[4] + y * p[7] + z * p[10],
        x * p[5] + y * p[8] + z * p[11],
    )
    a, b, c = abs(u) - p[12], abs(v) - p[13], abs(w) - p[14]
    if a > 0.0 or b > 0.0 or c > 0.0:
        u = math.copysign(max(a, 0.0), u)
        v = math.copysign(max(b, 0.0), v)
        w = math.copysign(max(c, 0.0), w)
        distance = math.sqrt(u * u + v * v + w * w)
        gap = distance - p[15]
        u, v, w = u / distance, v / distance, w / distance
    else:
        gap = max(a, b, c)
        u = math.copysign(1.0 if a == gap else 0.0, u)
        v = math.copysign(1.0 if b == gap and a != gap else 0.0, v)
        w = math.copysign(1.0 if a != gap and b != gap else 0.0, w)
        gap -= p[15]
    for i in range(3):
        normal[i] = p[3 + 3 * i] * u + p[4 + 3 * i] * v + p[5 + 3 * i] * w
    return gap


@_plain
def gap_at(kind, p, x, y, z, normal):  # type: ignore[no-untyped-def]
    """Gap [m] of a point from a packed contact, and the ``normal`` (3,) there."""
    if kind == PLANE:
        normal[0], normal[1], normal[2] = p[0], p[1], p[2]
        return x * p[0] + y * p[1] + z * p[2] - p[3]
    if kind == ROUND:
        return _round(p, x, y, z, normal)
    if kind == CYLINDER:
        return _cylinder(p, x, y, z, normal)
    assert kind == BOX
    return _box(p, x, y, z, normal)


@njit(error_model="numpy", fastmath=False, forceinline=True)
def gap_and_normal(bodies, contact, x, y, z, normal):  # type: ignore[no-untyped-def]
    """Gap [m] of a point from one of some packed contacts, and the ``normal`` (3,) there; planes at once."""
    kinds, numbers = bodies
    if kinds[contact] != PLANE:
        return gap_at(kinds[contact], numbers[contact], x, y, z, normal)
    a, b, c = numbers[contact, 0], numbers[contact, 1], numbers[contact, 2]
    normal[0], normal[1], normal[2] = a, b, c
    return x * a + y * b + z * c - numbers[contact, 3]


@_kernel
def gaps_of(bodies, vertices, contact_of, x, out):  # type: ignore[no-untyped-def]
    """Gaps ``out`` (r,) [m] of rows, each a vertex of positions x (n, 3) and a packed contact; the least one."""
    return gaps_beyond(bodies, vertices, contact_of, x, x[:0], np.empty(3), out)


@_plain
def gaps_beyond(bodies, vertices, contact_of, x, local, normal, out):  # type: ignore[no-untyped-def]
    """The same at ``x + local``, if these are any (0, 3) or (n, 3); ``normal`` (3,) is written to."""
    kinds, numbers = bodies
    least, moved = np.inf, local.size > 0
    for row in range(vertices.size):
        contact, v = contact_of[row], vertices[row]
        a, b, c = x[v, 0], x[v, 1], x[v, 2]
        if moved:
            a, b, c = a + local[v, 0], b + local[v, 1], c + local[v, 2]
        if kinds[contact] == PLANE:
            gap = a * numbers[contact, 0] + b * numbers[contact, 1] + c * numbers[contact, 2] - numbers[contact, 3]
        elif kinds[contact] == ROUND:
            a, b, c = _from_axis(numbers[contact], a, b, c)
            gap = math.sqrt(a * a + b * b + c * c) - numbers[contact, 7]
        else:
            gap = gap_at(kinds[contact], numbers[contact], a, b, c, normal)
        out[row] = gap
        if not gap >= least:
            least = gap
    return least


@_kernel
def frame_of(bodies, rows_of, pushes, x, forces, touches):  # type: ignore[no-untyped-def]
    """What touches at positions x (n, 3) [m], of ``pushes`` (r,) [N] along the normals of all rows; the least gap [m].

    ``rows_of`` are vertices and packed contacts (r,); ``forces`` (n, 3) [N] and what ``touches`` (n,) are written to.
    """
    vertices, contact_of = rows_of
    normal, least = np.empty(3), 0.0
    for v in range(touches.size):
        touches[v] = False
        forces[v, 0] = forces[v, 1] = forces[v, 2] = 0.0
    for row in range(vertices.size):
        v, push = vertices[row], pushes[row]
        gap = gap_and_normal(bodies, contact_of[row], x[v, 0], x[v, 1], x[v, 2], normal)
        if not gap >= least:
            least = gap
        if push != 0.0:
            touches[v] = True
            for i in range(3):
                forces[v, i] += push * normal[i]
    return least
