"""Manipulation constraints: prescribed position or orientation of a vertex or a patch, and vertices that they lead."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from modalshell.core.checks import checked_number, checked_vectors, shown
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only
from modalshell.core.typing import Array, Index
from modalshell.kernels import rotations
from modalshell.mesh.selection import mixes_masks
from modalshell.supports.path import SupportPath
from modalshell.supports.unknowns import Unknowns

Target = ArrayLike | Callable[[float], ArrayLike]
"""Three numbers, or a function of the time [s] that gives them."""

_JUMP, _HALVINGS = 0.6, 12
"""Share of a target's way in a step that is a jump if it takes no longer than this many halves of halves of it."""
_LINE = 1e-3
"""Width over length of a patch up to which its vertices lie on a line."""


class Constraint(ReadOnlyArrays):
    """A constraint on the mean of a patch; make a :class:`PositionConstraint` or an :class:`OrientationConstraint`.

    Attributes
    ----------
    vertices : ndarray of int
        The patch.
    kind : {"position", "orientation"}
        What is constrained.
    """

    kind: Literal["position", "orientation"]

    def __init__(self, vertices: ArrayLike, target: Target) -> None:
        try:
            given = np.atleast_1d(np.asarray(vertices))
        except ValueError:  # rows of unequal length
            given = np.empty(0)
        self._masked = given.size if given.dtype == bool else None
        if given.dtype == bool:
            given = np.flatnonzero(given)
        elif mixes_masks(vertices):
            given = np.empty(0)
        if given.ndim != 1 or given.size == 0 or not np.issubdtype(given.dtype, np.integer):
            raise OptionError(f"vertices of a constraint must be one index, some, or a mask (got {shown(vertices)})")
        self.vertices: Index = read_only(np.unique(given.astype(np.int64)))
        self._target = target if callable(target) else read_only(np.array(self._checked(target)))
        self.at(0.0)

    def at(self, time: float) -> Array:
        """Target (3,) at ``time`` [s]."""
        time = checked_number("time", time, unit="s")
        return self._checked(self._target(time) if callable(self._target) else self._target).copy()

    def _checked(self, value: ArrayLike) -> Array:
        return checked_vectors(f"the target of the {self.kind} constraint", value, (3,), OptionError)


class PositionConstraint(Constraint):
    """Prescribes the mean position of a vertex or a patch, in the world frame.

    Parameters
    ----------
    vertices : int, array_like of int or of bool
        The vertex or patch; none of them held by a support.
    target : array_like, shape (3,), or callable
        The point [m], or a function of time [s] that gives it.

    Raises
    ------
    OptionError
        If the patch is empty or the target is no finite vector.
    """

    kind = "position"


class OrientationConstraint(Constraint):
    """Prescribes the mean rotation of a vertex or a patch from its rest orientation.

    Full models turn a single vertex, or a row of them on one line, with the triangles around it as one rigid piece.

    Parameters
    ----------
    vertices : int, array_like of int or of bool
        The vertex or patch; none of them held by a support.
    target : array_like, shape (3,), or callable
        Rotation vector [rad] in the world, or a function of time [s] that gives it. Modal models take, of all rotation
        vectors that mean the same, the one nearest their present state.

    Raises
    ------
    OptionError
        If the patch is empty or the target is no finite vector.
    """

    kind = "orientation"


def _change(kind: str, first: Array, second: Array) -> float:
    """Distance of two targets (3,) [m], or the angle between them [rad]."""
    if kind == "position":
        return float(np.linalg.norm(second - first))
    # By quaternions, to 1e-8: each step asks, and SciPy makes a rotation in the time of a modal step.
    lengths = np.linalg.norm([first, second], axis=1, keepdims=True)
    vectors = 0.5 * np.sinc(lengths / (2.0 * math.pi)) * [first, second]
    cosine = math.prod(np.cos(0.5 * lengths[:, 0])) + vectors[0] @ vectors[1]
    return 2.0 * math.acos(min(abs(cosine), 1.0))


def jumps(constraint: Constraint, begin: float, end: float, least: float) -> bool:
    """Whether a target jumps by at least ``least``, in [m] or [rad], at a time between two [s]."""
    kind, low, high = constraint.kind, constraint.at(begin), constraint.at(end)
    if np.array_equal(low, high):
        return False
    change = _change(kind, low, high)
    wanted = max(least, _JUMP * change)
    for _ in range(_HALVINGS):
        if change < wanted:
            return False
        middle = 0.5 * (begin + end)
        between = constraint.at(middle)
        first, second = _change(kind, low, between), _change(kind, between, high)
        if first > second:
            end, high, change = middle, between, first
        else:
            begin, low, change = middle, between, second
    return change >= wanted


def checked_constraints(constraints: Sequence[Constraint] | None, unknowns: Unknowns) -> list[Constraint]:
    """The constraints as a list, each on free vertices of a shell; else OptionError or SupportError."""
    try:
        given = list(() if constraints is None else constraints)
    except TypeError as error:
        raise OptionError(f"constraints must be a list of constraints (got {shown(constraints)})") from error
    count = len(unknowns.supported)
    seen = set()
    for constraint in given:
        if not isinstance(constraint, Constraint):
            raise OptionError(f"constraints must be position or orientation constraints (got {shown(constraint)})")
        if constraint._masked not in (None, count):
            raise SupportError(f"the mask of a constraint must have {count} entries (got {constraint._masked})")
        outside = constraint.vertices[(constraint.vertices < 0) | (constraint.vertices >= count)]
        if outside.size:
            raise SupportError(f"a constraint names vertex {outside[0]}, but the mesh has vertices 0 to {count - 1}")
        held = constraint.vertices[unknowns.supported[constraint.vertices]]
        if held.size:
            raise SupportError(f"a constraint names vertex {held[0]}, which a support holds already")
        key = (constraint.kind, constraint.vertices.tobytes())
        if key in seen:
            raise OptionError(f"two {constraint.kind} constraints name the same patch of vertices; keep one")
        seen.add(key)
    return given


def nearest_branch(rotation_vector: Array, present: Array) -> Array:
    """Of all rotation vectors of one rotation, the one nearest to ``present``; all (3,) [rad]."""
    length = float(np.linalg.norm(rotation_vector))
    first, second, _ = rotations.coefficients(*rotation_vector)
    angle = math.atan2(first * length, 1.0 - second * length**2)  # in (-pi, pi], of the same rotation
    if abs(angle) < 1e-12:  # whole turns about any axis: take the present one
        size = float(np.linalg.norm(present))
        turns = round(size / (2.0 * math.pi))
        if turns:
            return present / size * turns * 2.0 * math.pi
    if length == 0.0:
        return np.zeros(3)
    axis = rotation_vector / length
    if abs(angle) >= 1e-12:
        angle += 2.0 * math.pi * round((float(axis @ present) - angle) / (2.0 * math.pi))
    return axis * angle


class HeldPatch:
    """A patch that a full model moves as one rigid piece, exactly.

    A vertex or patch with a position constraint alone moves without turning; with an orientation constraint on the
    same patch it turns about its mean position. A single vertex that is to be turned, or vertices on one line, which
    show no turn about it, take their neighbours with them.
    """

    def __init__(
        self,
        rest: Array,
        faces: Index,
        unknowns: Unknowns,
        position: Constraint,
        orientation: Constraint | None,
    ) -> None:
        self.position, self.orientation = position, orientation
        self.vertices = position.vertices
        center = rest[self.vertices].mean(axis=0)
        if orientation is not None and _on_a_line(rest[self.vertices] - center):
            touching = np.isin(faces, self.vertices).any(axis=1)
            self.vertices = np.setdiff1d(faces[touching], np.flatnonzero(unknowns.supported))
        self._center = center
        self._arms = rest[self.vertices] - center

    def at(self, time: float, share: float = 1.0) -> Array:
        """Positions (k, 3) [m] of the patch's vertices at ``time`` [s], or ``share`` of the way there from rest."""
        center = self._center + share * (self.position.at(time) - self._center)
        if self.orientation is None:
            return center + self._arms
        turn = Rotation.from_rotvec(share * self.orientation.at(time))
        return center + turn.apply(self._arms)


def _on_a_line(arms: Array) -> bool:
    """Whether points (k, 3) about their mean are one point, or lie on one line."""
    extents = np.linalg.svd(arms, compute_uv=False)
    return bool(extents.size < 2 or extents[1] <= _LINE * extents[0])


def held_patches(constraints: Sequence[Constraint], rest: Array, faces: Index, unknowns: Unknowns) -> list[HeldPatch]:
    """The constraints as rigidly moved patches; OptionError for an orientation without a position, or for overlaps."""
    turns = {c.vertices.tobytes(): c for c in constraints if c.kind == "orientation"}
    patches = []
    for constraint in constraints:
        if constraint.kind == "position":
            turn = turns.pop(constraint.vertices.tobytes(), None)
            patches.append(HeldPatch(rest, faces, unknowns, constraint, turn))
    if turns:
        raise OptionError(
            "DS moves patches as boundaries: an orientation constraint needs a position constraint on the same vertices"
        )
    taken = np.concatenate([np.empty(0, np.int64), *(patch.vertices for patch in patches)])
    if np.unique(taken).size < taken.size:
        raise OptionError("patches of different constraints share a vertex (or its neighbours): keep them apart")
    if taken.size and np.delete(~unknowns.held, taken).sum() == 0:
        raise OptionError(
            f"constraints move all {taken.size} vertices that supports do not hold, so that nothing is left to solve "
            "for: leave some of them out, or move the mesh"
        )
    return patches


@final
class LedVertices:
    """Where patches lead their vertices, in the frame of the supports.

    Attributes
    ----------
    vertices : ndarray of int, shape (k,)
        Vertices of the patches, one after the other.
    """

    def __init__(self, patches: Sequence[HeldPatch], path: SupportPath | None = None) -> None:
        self._patches, self._path = patches, path
        self.vertices: Index = np.concatenate([patch.vertices for patch in patches])

    def at(self, time: float) -> Array:
        """Positions (k, 3) [m] of the vertices at ``time`` [s]."""
        places = np.concatenate([patch.at(time) for patch in self._patches])
        return places if self._path is None else self._path.at(time).to_shell(places)

    def way(self, x: Array, places: Array, there: float) -> Array | None:
        """Displacements (n, 3) [m] from x (n, 3) to places (k, 3) [m]; None where they are put there.

        They are where none is longer than ``there`` [m].
        """
        way = np.zeros_like(x)
        way[self.vertices] = places - x[self.vertices]
        if np.abs(way).max() > there:
            return way
        x[self.vertices] = places
        return None
