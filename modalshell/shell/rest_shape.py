r"""Rest shapes that are not those of the mesh: strains and curvatures at which a sheet has no stress.

A curvature :math:`\kappa_0` at which triangle T has no moment is one by its folds, :math:`\gamma_{0,k}` with
:math:`\sum_k (l_k / A_T) \gamma_{0,k} n_k n_k^T = \kappa_0`. As the share of a fold is free, only the sum over the
triangles at an edge counts: it is added to the rest angle (theory 15, eq. 5). A strain :math:`E_0` without force
changes half the squared length of an edge d by :math:`d \cdot E_0 d`, the mean over its triangles: strains that do not
fit together are those of the edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import as_array, checked_number, shown
from modalshell.core.errors import MaterialError, MeshError
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.fields import triangle_axes
from modalshell.shell.sheet import Sheet, checked_constant
from modalshell.shell.split_folds import SplitFolds
from modalshell.shell.triangle_pairs import moment_tensors

Tensor = float | ArrayLike | Callable[[Array], ArrayLike]
"""A number for all directions or a symmetric tensor in space, for all triangles or each, or a function of theirs."""


@final
@dataclass(frozen=True)
class Temperature(ReadOnlyArrays):
    """A change of temperature from that at which the mesh is at rest.

    Parameters
    ----------
    change : float or array_like of shape (T,)
        Of the middle surface [K].
    expansion : float
        Coefficient of linear expansion of the sheet [1/K].
    through : float or array_like of shape (T,)
        What the face to which the normals point is warmer than the other one [K].

    Raises
    ------
    MaterialError
        For values that are not finite, or of another shape.
    """

    change: float | ArrayLike
    expansion: float
    through: float | ArrayLike = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "expansion", checked_number("expansion", self.expansion, MaterialError, unit="1/K"))
        for name in ("change", "through"):
            object.__setattr__(self, name, checked_constant(name, getattr(self, name), "K", ratio=True))


@final
class RestShape(NamedTuple):
    """Shape without stress of the triangles by themselves."""

    folds: Array
    """Fold of each triangle at the edge from each corner to the next [rad]; shape (T, 3)."""
    squares: Array
    """Change of half the squared length of every edge [m^2]; shape (E,)."""
    warmed: Array
    """The part of the folds that goes with one over the thickness [rad]: of a temperature that changes through it.
    Shape (T, 3)."""

    def offsets(self, mesh: TriangleMesh, folds: SplitFolds) -> Array:
        """What is added to the rest angles (H,) of the hinges."""
        bends = np.zeros(len(mesh.faces), dtype=bool)
        bends[folds.faces[folds.faces >= 0]] = True
        parts = np.where(bends[:, None], self.folds, 0.0)
        edges = mesh.hinge_edges

        def at(faces: Any) -> Array:
            return np.asarray(np.sum(parts[faces] * (mesh.face_edges[faces] == edges[:, None]), axis=1))

        first, second = (at(faces) for faces in mesh.hinge_faces.T)
        if mesh.joints.edges.size:
            corners = mesh.faces.ravel()
            one, other = (corners[half] < corners[3 * (half // 3) + (half + 1) % 3] for half in mesh.joints.hinge_wings)
            alike = np.where(one == other, -1.0, 1.0)
            first[np.isin(edges, mesh.joints.edges)] *= alike
        found = np.asarray(folds.sources.T @ (first + second))
        own = folds.faces[:, [0, 0, 0, 1, 1]]
        turned = (folds.corners[:, [0, 0, 0, 1, 1]] + np.array([1, 2, 3, 2, 3])) % 3
        ghosts = folds.folds >= len(folds.hinges) - len(folds.ghosts)
        found[folds.folds[ghosts]] = parts[own[ghosts], turned[ghosts]]
        found[len(found) - len(folds.reflections) :] *= 2.0  # hinges at a plane of symmetry are halved
        return found


def rest_shape(
    mesh: TriangleMesh,
    material: Any,
    prestrain: Tensor | None,
    curvature: Tensor | None,
    temperature: Temperature | None,
) -> RestShape | None:
    """The rest shape of what is given, None for nothing; MaterialError for what does not fit."""
    if prestrain is None and curvature is None and temperature is None:
        return None
    if not isinstance(material, Sheet):
        raise MaterialError(
            "prestrain, rest_curvature and temperature need a sheet such as ms.Isotropic, not a Material"
        )
    strain = np.zeros((len(mesh.faces), 3)) if prestrain is None else _tensors("prestrain", prestrain, mesh)
    bent = np.zeros((len(mesh.faces), 3)) if curvature is None else _tensors("rest_curvature", curvature, mesh)
    warm = np.zeros_like(bent)
    if temperature is not None:
        if not isinstance(temperature, Temperature):
            raise MaterialError(f"temperature must be an ms.Temperature (got {shown(temperature)})")
        strain = strain + _tensors("change", temperature.expansion * np.asarray(temperature.change), mesh)
        through = temperature.expansion * np.asarray(temperature.through)
        if through.any():
            thickness = material.thicknesses(mesh)
            if thickness is None:
                raise MaterialError("through needs a sheet with a thickness (got one of stiffnesses alone)")
            warm = _tensors("through", through / thickness, mesh)
    every = np.arange(len(mesh.faces))
    units = moment_tensors(mesh, every, np.full_like(every, 2))
    factors = mesh.face_areas[:, None] * np.array([1.0, 1.0, 2.0])
    folds, warmed = (np.einsum("tik,ti->tk", units, factors * tensors) for tensors in (bent + warm, warm))
    corners = mesh.vertices[mesh.faces]
    sides = np.einsum("tkx,tax->tka", np.roll(corners, -1, axis=1) - corners, triangle_axes(mesh, mesh.vertices))
    first, second = sides[:, :, 0], sides[:, :, 1]
    own = first**2 * strain[:, 0, None] + second**2 * strain[:, 1, None] + 2.0 * first * second * strain[:, 2, None]
    edges = mesh.face_edges.ravel()
    squares = np.bincount(edges, own.ravel(), len(mesh.edges)) / np.bincount(edges, minlength=len(mesh.edges))
    return RestShape(folds, squares, warmed)


def own_copy(given: Tensor | None) -> Tensor | None:
    """What was given, checked, without arrays that the caller may change later."""
    return given if given is None or callable(given) else np.array(given)


def mesh_at_rest(mesh: TriangleMesh, rest: TriangleMesh | ArrayLike | None) -> TriangleMesh:
    """The mesh of the shape without stress: ``mesh`` itself for None; MeshError for one with other triangles."""
    if rest is None or rest is mesh:
        return mesh
    if not isinstance(rest, TriangleMesh):
        vertices = as_array("rest", rest, "a TriangleMesh or its vertices (n, 3)", MeshError)
        if vertices.shape != mesh.vertices.shape:
            raise MeshError(
                f"rest must have the {len(mesh.vertices)} vertices of the mesh (got shape {vertices.shape})"
            )
        rest = TriangleMesh(vertices, mesh.faces)
    if not np.array_equal(rest.faces, mesh.faces):
        raise MeshError(
            f"rest must have the triangles of the mesh, vertex by vertex (got {len(rest.faces)} triangles on "
            f"{len(rest.vertices)} vertices against {len(mesh.faces)} on {len(mesh.vertices)}): move the vertices of "
            "one mesh to make the other"
        )
    return rest


def _tensors(name: str, given: Tensor, mesh: TriangleMesh) -> Array:
    """Components 11, 22, 12 (T, 3) in the triangles' axes of numbers, or of tensors in space."""
    raw = given(mesh.vertices[mesh.faces].mean(axis=1)) if callable(given) else given
    value = as_array(name, raw, "a number, a tensor (3, 3), or one per triangle", MaterialError).astype(np.float64)
    count = len(mesh.faces)
    if value.shape not in ((), (count,), (3, 3), (count, 3, 3)) or not np.isfinite(value).all():
        raise MaterialError(
            f"{name} must be a number, a symmetric tensor (3, 3), or one of them per triangle, ({count},) or "
            f"({count}, 3, 3), finite (got {shown(raw)})"
        )
    if value.ndim < 2 and value.shape != (3, 3):
        one = np.broadcast_to(value, (count,))
        return np.stack([one, one, np.zeros(count)], axis=1)
    # By the tensor's size: one turned in space has zeros that rounding has made unlike.
    apart, size = np.abs(value - np.swapaxes(value, -1, -2)), np.abs(value).max(axis=(-1, -2), keepdims=True)
    if (apart > 1e-9 * size).any():
        raise MaterialError(f"{name} must be a symmetric tensor (got {shown(raw)})")
    axes = triangle_axes(mesh, mesh.vertices)
    inside = np.einsum("tax,txy,tby->tab", axes, np.broadcast_to(value, (count, 3, 3)), axes)
    return np.stack([inside[:, 0, 0], inside[:, 1, 1], inside[:, 0, 1]], axis=1)
