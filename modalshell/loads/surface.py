"""Surface loads: pressure and wind."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import as_array, checked_number, checked_switch, checked_vectors
from modalshell.core.errors import LoadError, OptionError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only_copy
from modalshell.core.typing import Array, Index, Vector
from modalshell.loads.applied import AppliedLoad, Corners, SurfaceForm, length
from modalshell.loads.base import LiveLoad
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, selected


def area_vectors(corners: Corners) -> Corners:
    """Area times unit normal (E, 3) [m^2] of triangles (E, 3, 3), by their winding."""
    return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def selected_faces(mesh: TriangleMesh, sel: Selection | None) -> Index:
    """Triangles (E, 3) whose three corners are selected; all of them without a selection."""
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if sel is None:
        return faces
    chosen = faces[selected("sel", sel, mesh)[faces].all(axis=1)]
    if not len(chosen):
        raise OptionError("sel selects vertices, but no triangle between three of them: select more")
    return chosen


@final
class Pressure(LiveLoad, ReadOnlyArrays, key="pressure"):
    """A pressure on the surface, along the triangles' normals: a third of each triangle's force at each corner.

    Follower pressure acts on the deformed triangles. On a closed surface, or one whose boundary is held, it is the
    gradient of ``-p V``, V the enclosed volume; with a free boundary, or a free junction
    whose triangles' edges do not cancel, it has no potential (theory 16, eq. 2).

    Parameters
    ----------
    p : float
        Pressure [Pa]; a positive one pushes along the normals, which follow from the winding of the triangles.
    follower : bool
        Whether it follows the surface; otherwise the forces stay those on the shape at rest.
    sel : selection, optional
        Vertices; the pressure acts on the triangles between them. By default all.

    Raises
    ------
    LoadError
        If ``p`` is not finite.
    OptionError
        If ``follower`` is not True or False.
    """

    def __init__(self, p: float, follower: bool = True, sel: Selection | None = None) -> None:
        self.p = checked_number("p", p, unit="Pa", error=LoadError)
        self.sel = None if sel is None else checked_selection("sel", sel)
        self.follower = checked_switch("follower", follower)

    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N] at rest; OptionError where ``sel`` selects no triangle of ``mesh``."""
        return self._applied(mesh).force(mesh.vertices)

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad | None:  # noqa: ARG002
        """Pressure on the triangles where they are; None if it is dead."""
        return self._applied(mesh) if self.follower else None

    def _applied(self, mesh: TriangleMesh) -> AppliedLoad:
        faces, p, about = selected_faces(mesh, self.sel), self.p, mesh.vertices.mean(axis=0)
        if np.linalg.norm(about) < _FAR * mesh.moment_length:
            about = np.zeros(3)  # on planes of symmetry that go through it this is a potential

        def forces(corners: Corners, velocities: Corners, time: float, chosen: Index) -> Corners:  # noqa: ARG001
            return np.repeat(p / 3.0 * area_vectors(corners)[:, None], 3, axis=1)

        def energy(x: Array) -> float:  # about a far origin volumes are differences of large ones
            one, two, three = np.moveaxis((x - about)[faces], 1, 0)
            return -p / 6.0 * float(np.vdot(one, np.cross(two, three)))

        return AppliedLoad(faces, forces, energy, held=_boundary(faces), form=SurfaceForm(pressure=p))


_FAR = 10.0
"""Distance of the mesh's mean from the origin, in its lengths, from which volumes are taken about that mean."""


def _boundary(faces: Index) -> Index:
    """Vertices on edges at which triangles do not cancel: of boundaries, junctions, twists of one-sided strips."""
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    unique, which = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    senses = np.bincount(which.ravel(), np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0), len(unique))
    return np.unique(unique[senses != 0.0])


@final
class Wind(LiveLoad, ReadOnlyArrays, key="wind"):
    r"""Wind on the surface, by its velocity relative to every triangle.

    With the relative velocity :math:`u = u_n n + u_t` at the triangle's centre, split along its unit normal n and its
    plane, the force on a triangle of area A is

    .. math:: f = \tfrac12 \rho A \left( c_n |u_n| u_n n + c_t |u_t| u_t \right),

    the cross-flow rule: pressure by the normal component, friction by the tangential one. A flat plate at incidence
    :math:`\alpha` so has the normal force :math:`\tfrac12 \rho A c_n U^2 \sin^2 \alpha`, its drag and lift being the
    components of that. A third of the force acts at each corner. Wind has no potential.

    From Python the velocity may be a function ``velocity(points, time) -> (k, 3)`` of points (k, 3) [m] in the world
    and the time [s]; the stiffness neglects its gradient in space.

    Parameters
    ----------
    velocity : (float, float, float) or callable
        Of the air [m/s].
    density : float
        Of the air [kg/m^3].
    normal, tangential : float
        Coefficients c_n and c_t.
    sel : selection, optional
        Vertices; the wind acts on the triangles between them. By default all.

    Raises
    ------
    LoadError
        For a velocity that is not three finite numbers, or a negative density or coefficient.
    """

    def __init__(
        self,
        velocity: Vector | Callable[[Array, float], ArrayLike],
        density: float = 1.2,
        normal: float = 1.0,
        tangential: float = 0.01,
        sel: Selection | None = None,
    ) -> None:
        self.velocity: Array | Callable[[Array, float], ArrayLike]
        if callable(velocity):
            self.velocity = velocity
        else:
            self.velocity = read_only_copy(checked_vectors("velocity", velocity, (3,)))
        self.density = checked_number("density", density, at_least=0.0, unit="kg/m^3", error=LoadError)
        self.normal = checked_number("normal", normal, at_least=0.0, error=LoadError)
        self.tangential = checked_number("tangential", tangential, at_least=0.0, error=LoadError)
        self.sel = None if sel is None else checked_selection("sel", sel)

    def velocity_at(self, points: Array, time: float) -> Array:
        """Velocity (k, 3) [m/s] of the air at points (k, 3) [m]; LoadError where a function gives another shape."""
        if not callable(self.velocity):
            return self.velocity
        found = as_array("the wind's velocity", self.velocity(points, time), f"{points.shape}", LoadError)
        if found.shape not in ((), (1,), (3,), (1, 3), (len(points), 1), points.shape):
            raise LoadError(
                f"the wind's velocity must have shape {points.shape}, a row for each point (got {found.shape}): "
                "return one velocity (3,) or as many as points"
            )
        return checked_vectors("the wind's velocity", np.broadcast_to(found, points.shape), points.shape)

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad:  # noqa: ARG002
        """Wind on the triangles where they are."""
        by_normal, by_tangent = 0.5 * self.density * self.normal, 0.5 * self.density * self.tangential

        def forces(corners: Corners, velocities: Corners, time: float, chosen: Index) -> Corners:  # noqa: ARG001
            air = self.velocity_at(corners.real.mean(axis=1), time)
            relative = air - velocities.mean(axis=1)
            areas = area_vectors(corners)
            area = length(areas)[:, None]
            unit = areas / np.where(area.real > 0.0, area, 1.0)  # a collapsed triangle has no normal, and no force
            across = np.sum(relative * unit, axis=1)[:, None]
            tangent = relative - across * unit
            slip = np.sum(tangent * tangent, axis=1)[:, None]
            # Its root has no derivative where nothing slips; the force's there is zero.
            slip = np.where(slip.real > 0.0, slip, 1.0) ** 0.5 * (slip.real > 0.0)
            size = np.where(across.real < 0.0, -across, across)
            force = by_normal * size * across * areas + by_tangent * area * slip * tangent
            return np.repeat(force[:, None] / 3.0, 3, axis=1)

        form = SurfaceForm(0.0, by_normal, by_tangent, self.velocity_at if callable(self.velocity) else self.velocity)
        return AppliedLoad(selected_faces(mesh, self.sel), forces, by_velocity=True, form=form)
