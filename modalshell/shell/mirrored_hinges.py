"""Hinges at edges in symmetry planes, whose fourth vertex is the mirror image of the third.

Seen from the first vertex, which lies in the plane, the image is ``R (x_2 - x_0)`` away, R the reflection: a fold of
three vertices.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, final

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import numbers_of_edges
from modalshell.shell.kernels import split_folds as kernels
from modalshell.shell.kernels.generated import flexure


def add_fold_curvatures(
    points: Array, hinges: Index, couples: Array, projected: bool, slots: Index, strides: Index, data: Array
) -> None:
    """Add ``sum couple Hess theta`` to the CSR values ``data``, or its positive semi-definite part if ``projected``."""
    if couples.any():  # else, as at rest, neither kernel need be compiled
        add = kernels.add_convex_fold_curvatures if projected else kernels.add_fold_curvatures
        add(points, hinges, couples, slots, strides, data)


@final
class MirroredHinges:
    """The last s of the ``hinges`` (H, 4), each with the mirror image of its third vertex for a fourth.

    Half of the fold belongs to either side: angles and slopes are halved, and written as those of three vertices. The
    ``reflections`` are R (s, 3, 3).
    """

    def __init__(self, hinges: Index, reflections: Array) -> None:
        self._reflections = reflections
        self.places = np.arange(len(hinges) - len(reflections), len(hinges))
        self._hinges = hinges[self.places]

    def edges(self, mesh: TriangleMesh) -> Index:
        """The hinges' edges, numbered as in the mesh."""
        return numbers_of_edges(mesh.edges, self._hinges[:, :2])

    def placed(self, points: Any) -> Any:
        """Points, or displacements, of vertices and ghosts with the mirror images where they belong."""
        first, apex, image = (self._hinges[:, k] for k in (0, 2, 3))
        points[image] = points[first] + _reflected(self._reflections, points[apex] - points[first])
        return points

    def halve(self, angles: Any, slopes: Any) -> None:
        """Take half of the angles (H,), and of the slopes (H, 9) with the image's as its vertex has them."""
        places = self.places
        angles[places] *= 0.5
        own = slopes[places]
        own[:, 3:6] += _reflected(self._reflections, own[:, 6:9])
        own[:, 6:9] = 0.0
        slopes[places] = 0.5 * own

    def spread(self, state: Any, couples: Array, gradient: Array) -> None:
        """Spread what the planes resist of ``couples`` (H,); see :func:`spread_across`."""
        own = self._hinges[:, :3]
        pushed = couples[self.places, None] * state.slopes[self.places, 3:6]
        spread_across(self._reflections, state.points[own], pushed, own, gradient)

    def without(self, couples: Array) -> Array:
        """Couples (H,) of the other hinges, zero at these."""
        others = couples.copy()
        others[self.places] = 0.0
        return others

    def add_curvatures(
        self, points: Array, couples: Array, projected: bool, slots: Index, strides: Index, data: Array
    ) -> None:
        """Add ``sum couple Hess (theta / 2)`` to the CSR values ``data``, or its positive semi-definite part."""
        count = self.places.size
        if count:
            own, blocks = np.ascontiguousarray(points[self._hinges].reshape(-1, 3)), _Blocks(count)
            half = 0.5 * couples[self.places]
            add_fold_curvatures(own, blocks.hinges, half, projected, *blocks.place)
            blocks.scatter(self._reflections, self._hinges[:, :3], slots[self.places], strides, data)


@final
class MirroredFlexure:
    """The flexure kernel on three vertices, the fourth being the third's image by a ``reflection`` R (3, 3).

    It takes the place of a generated kernel.
    """

    VERTICES, UNKNOWNS, PERIODIC = 3, 6, flexure.PERIODIC

    def __init__(self, reflection: Array) -> None:
        self.reflection = reflection

    @property
    def measure(self) -> Any:
        """The fold, of arrays of six edge-relative unknowns."""
        return SimpleNamespace(py_func=lambda *own: flexure.measure.py_func(*own, *self.reflection @ np.stack(own[3:])))

    @property
    def first_derivatives(self) -> Any:
        """The same with its slopes."""

        def derivatives(*own_and_slope: Any) -> Any:
            *own, slope = own_and_slope
            whole = np.empty((flexure.UNKNOWNS, slope.shape[1]), dtype=slope.dtype)
            value = flexure.first_derivatives.py_func(*own, *self.reflection @ np.stack(own[3:]), whole)
            slope[:] = whole[:6]
            slope[3:] += self.reflection @ whole[6:]
            return value

        return SimpleNamespace(py_func=derivatives)

    def measures(self, x: Array, stencils: Index, out: Array) -> None:
        """Write the folds into ``out``."""
        flexure.measures(*self._whole(x, stencils), out)

    def energy(self, x: Array, stencils: Index, rest: Array, weight: Array) -> float:
        """Sum of w (theta - theta0)^2."""
        return float(flexure.energy(*self._whole(x, stencils), rest, weight))

    def add_gradient(self, x: Array, stencils: Index, rest: Array, weight: Array, gradient: Array) -> float:
        """Add the energy's gradient to ``gradient`` (n, 3); return the energy."""
        points, hinges = self._whole(x, stencils)
        own = np.zeros(points.shape)
        total = flexure.add_gradient(points, hinges, rest, weight, own)
        self._add(own, stencils, gradient)
        return float(total)

    def linear_stress(self, x: Array, step: Array, stencils: Index, rest: Array, weight: Array, stress: Array) -> None:
        """Write the stress that a linearised step predicts."""
        points, hinges = self._whole(x, stencils)
        flexure.linear_stress(points, self._whole(step, stencils)[0], hinges, rest, weight, stress)

    def spread(self, x: Array, stencils: Index, rest: Array, weight: Array, gradient: Array) -> None:
        """Spread what the plane resists of the gradient; see :func:`spread_across`."""
        corners, own = x[stencils], np.zeros((stencils.size, 3))
        self.add_gradient(corners.reshape(-1, 3), np.arange(stencils.size).reshape(-1, 3), rest, weight, own)
        spread_across(np.tile(self.reflection, (len(stencils), 1, 1)), corners, own[2::3], stencils, gradient)

    def add_damping(self, x: Array, velocity: Array, stencils: Index, weight: Array, force: Array) -> None:
        """Add the damping force to ``force`` (n, 3)."""
        points, hinges = self._whole(x, stencils)
        own = np.zeros(points.shape)
        flexure.add_damping(points, self._whole(velocity, stencils)[0], hinges, weight, own)
        self._add(own, stencils, force)

    def add_stiffness(
        self,
        x: Array,
        stencils: Index,
        rest: Array,
        weight: Array,
        stress: Array,
        geometric: int,
        slots: Index,
        strides: Index,
        data: Array,
        gradient: Array,
    ) -> float:
        """Add gradient and Hessian; return the energy."""
        points, hinges = self._whole(x, stencils)
        own, blocks = np.zeros(points.shape), _Blocks(len(stencils))
        total = flexure.add_stiffness(points, hinges, rest, weight, stress, geometric, *blocks.place, own)
        self._add(own, stencils, gradient)
        blocks.scatter(np.tile(self.reflection, (len(stencils), 1, 1)), stencils, slots, strides, data)
        return float(total)

    def _whole(self, x: Array, stencils: Index) -> tuple[Array, Index]:
        """Points of every hinge by itself, its image among them, and the hinges of them."""
        points = np.empty((len(stencils), 4, 3))
        points[:, :3] = x[stencils]
        points[:, 3] = points[:, 0] + (points[:, 2] - points[:, 0]) @ self.reflection
        hinges = np.arange(4 * len(stencils)).reshape(-1, 4)
        points.flags.writeable = hinges.flags.writeable = (
            False  # as shells have them: kernels are compiled for one kind
        )
        return points.reshape(-1, 3), hinges

    def _add(self, own: Array, stencils: Index, gradient: Array) -> None:
        parts = own.reshape(-1, 4, 3)
        image = parts[:, 3] @ self.reflection
        parts[:, 2] += image
        parts[:, 0] += parts[:, 3] - image
        np.add.at(gradient, stencils, parts[:, :3])


@final
class _Blocks:
    """Hessians (s, 12, 12) of hinges by themselves, to be added to a pattern as blocks of three vertices."""

    def __init__(self, count: int) -> None:
        self.hinges = np.arange(4 * count).reshape(-1, 4)
        self._blocks = np.zeros((count, 12, 12))
        slots = 144 * np.arange(count)[:, None, None] + 36 * np.arange(4)[:, None] + 3 * np.arange(4)
        slots = slots.astype(np.int32)  # as those of patterns
        self.place = slots, np.full(4 * count, 12), self._blocks.reshape(-1)

    def scatter(self, reflections: Array, stencils: Index, slots: Index, strides: Index, data: Array) -> None:
        """Add them to ``data``, images following their vertices by the ``reflections`` (s, 3, 3)."""
        follow = np.zeros((len(stencils), 12, 9))
        follow[:, :9] = np.eye(9)
        follow[:, 9:, :3] = np.eye(3) - reflections
        follow[:, 9:, 6:] = reflections
        small = (np.swapaxes(follow, 1, 2) @ self._blocks @ follow).reshape(-1, 3, 3, 3, 3).swapaxes(2, 3)
        rows = strides[stencils][:, :, None, None, None] * np.arange(3)[:, None]
        np.add.at(data, slots[:, :3, :3, None, None] + rows + np.arange(3), small)


def spread_across(reflections: Array, corners: Array, pushed: Array, stencils: Index, gradient: Array) -> None:
    """Let what planes resist act on the edges where the third ``corners`` (s, 3, 3) stand, as couples about them do.

    It is minus the part across the planes of the forces ``pushed`` (s, 3) on the third corners. Slopes have it at the
    first ones, which is as good where these are held, but not for their reactions.
    """
    edge, apex = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    foot = np.sum(edge * apex, axis=1) / np.sum(edge * edge, axis=1)
    moved = 0.5 * foot[:, None] * (pushed - _reflected(reflections, pushed))
    np.add.at(gradient, stencils[:, 0], moved)
    np.add.at(gradient, stencils[:, 1], -moved)


def _reflected(reflections: Array, vectors: Any) -> Any:
    return np.einsum("hij,hj->hi", reflections, vectors)
