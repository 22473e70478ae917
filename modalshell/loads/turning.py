"""Loads that rotate with the surface: moments along edges, and follower forces."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.checks import checked_number
from modalshell.core.errors import LoadError, OptionError
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array, Index
from modalshell.loads.applied import AppliedLoad, Corners, TurningForm, length
from modalshell.loads.base import LiveLoad
from modalshell.loads.forces import SelectedForce
from modalshell.loads.surface import area_vectors
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, selected


@final
class EdgeMoment(LiveLoad, ReadOnlyArrays, key="moment"):
    """A bending moment along the edges whose two ends are selected, on the triangle at each edge, about the edge.

    The moment acts on the triangle as a force along its normal at the corner off the edge, and the opposite force on
    the edge. It rotates with the triangle. A moment about an edge that itself rotates in space has no potential.

    It works on the triangle's rotation, a third of a cell inwards from the edge. `Isotropic` shells that bend in two
    directions at the edge meet it to first order in the size of the cells: a free square plate with moments on all of
    its edges bends up to 3.1 % too much on 24 cells a side.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices: a text such as ``"x > 0.99"`` about the shape at rest, a mask, or indices.
    m : float
        Moment for each length of the edges at rest [N]. On a boundary edge a positive one bends the surface towards
        its normals: the corner off the edge is pushed against the normal, so that the free edge rises along it. An
        edge between two triangles gets half of it from either one, in opposite senses about the edge. Edges where three
        sheets meet, or a one-sided surface turns over, take none.

    Raises
    ------
    LoadError
        If ``m`` is not finite.
    """

    def __init__(self, sel: Selection, m: float) -> None:
        self.sel = checked_selection("sel", sel)
        self.m = checked_number("m", m, unit="N", error=LoadError)

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad:  # noqa: ARG002
        """The couples; OptionError where ``sel`` selects no edge of ``mesh``, or one without two sides."""
        chosen = selected("sel", self.sel, mesh)
        joined = mesh.edges[mesh.joints.edges]
        if (taken := chosen[joined].all(axis=1)).any():
            raise OptionError(
                f"sel selects the edge between the vertices {joined[taken][0].tolist()}, where three sheets meet or "
                "the surface turns over, so that a moment has no sense there: leave one of them out, or take forces"
            )
        stencils = []
        for apex in range(3):
            turned = np.roll(np.asarray(mesh.faces, dtype=np.int64), -1 - apex, axis=1)  # first two: the edge
            stencils.append(turned[chosen[turned[:, :2]].all(axis=1)])
        edges = np.concatenate(stencils)
        if not len(edges):
            raise OptionError(f"sel selects {chosen.sum()} vertices, but no edge between two of them: select more")
        ends = np.sort(edges[:, :2], axis=1)
        _, which, counts = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
        rest = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
        moments = self.m * rest / counts[which.ravel()]

        def forces(corners: Corners, velocities: Corners, time: float, chosen: Index) -> Corners:  # noqa: ARG001
            one, two, apex = np.moveaxis(corners, 1, 0)
            along, areas = two - one, area_vectors(corners)
            squared = np.sum(along * along, axis=1)
            foot = (np.sum((apex - one) * along, axis=1) / squared)[:, None]
            # Unit normal over the height above the edge.
            lever = areas * (0.5 * squared**0.5 / np.sum(areas * areas, axis=1))[:, None]
            push = -moments[chosen][:, None] * lever
            return np.stack([-(1.0 - foot) * push, -foot * push, push], axis=1)

        one, two, apex = np.moveaxis(mesh.vertices[edges], 1, 0)
        foot = np.sum((apex - one) * (two - one), axis=1) / rest**2
        push = -moments * 0.5 * rest / np.linalg.norm(area_vectors(mesh.vertices[edges]), axis=1)
        weights = push[:, None] * np.stack([foot - 1.0, -foot, np.ones_like(foot)], axis=1)
        return AppliedLoad(edges, forces, form=TurningForm(weights))


@final
class FollowerForce(LiveLoad, SelectedForce, key="follower"):
    """A force at each selected vertex that rotates with the triangles around it. It has no potential.

    Every triangle at the vertex carries a share by its area at rest, and turns it as the triangle itself turns: with
    the rotation in its deformation (the polar one), which neither the order nor the winding of its corners changes.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices: a text such as ``"x > 0.99"`` about the shape at rest, a mask, or indices.
    force : (float, float, float)
        Force at each of them on the shape at rest [N].

    Raises
    ------
    LoadError
        If ``force`` is not three finite numbers.
    """

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad:  # noqa: ARG002
        """The force in the frames of the triangles; OptionError where ``sel`` selects no vertex of ``mesh``."""
        chosen = selected("sel", self.sel, mesh)
        areas = np.asarray(mesh.face_areas)
        around = np.bincount(np.asarray(mesh.faces).ravel(), np.repeat(areas, 3), len(chosen))
        stencils, shares = [], []
        for first in range(3):
            turned = np.roll(np.asarray(mesh.faces, dtype=np.int64), -first, axis=1)  # the vertex comes first
            at = chosen[turned[:, 0]]
            stencils.append(turned[at])
            shares.append(areas[at] / around[turned[at, 0]])
        triangles, share = np.concatenate(stencils), np.concatenate(shares)
        shapes = triangle_shapes(mesh.vertices[triangles])
        local = np.einsum("eij,i->ej", triangle_frames(mesh.vertices[triangles], shapes), self.vector) * share[:, None]

        def forces(corners: Corners, velocities: Corners, time: float, chosen: Index) -> Corners:  # noqa: ARG001
            out = np.zeros_like(corners)
            out[:, 0] = np.einsum("eij,ej->ei", triangle_frames(corners, shapes[chosen]), local[chosen])
            return out

        return AppliedLoad(triangles, forces, form=TurningForm(share[:, None] * [1.0, 0.0, 0.0], self.vector))


def triangle_shapes(corners: Corners) -> Corners:
    """Shapes (E, 2) of triangles: how far the third corner is along the first edge, and its length, by the height."""
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.stack([np.sum(edge * other, axis=1), np.sum(edge * edge, axis=1)], axis=1) / (
        2.0 * length(area_vectors(corners))[:, None]
    )


def triangle_frames(corners: Corners, shapes: Corners) -> Corners:
    """Frames of triangles of ``shapes`` (E, 2) at rest as they turn, as columns (E, 3, 3).

    At rest the first is along the first edge; the last is the normal. With the deformation F in the plane, J a quarter
    turn and e the first axis at rest, F + J F J^T is its polar rotation times a number, and takes e along
    ``F e - J F J e``.
    """
    edge, other, normal = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], area_vectors(corners)
    normal = normal / length(normal)[:, None]
    along = edge + np.cross(normal, shapes[:, :1] * edge - shapes[:, 1:] * other)
    along = along / length(along)[:, None]
    return np.stack([along, np.cross(normal, along), normal], axis=2)
