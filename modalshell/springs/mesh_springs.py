"""Springs on a triangle mesh: along its edges, and across its hinges."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_each, checked_kind, checked_number
from modalshell.core.errors import MaterialError
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell import Shell
from modalshell.springs.springs import Springs

REFERENCE_FOLD = 0.2
"""Change of a fold angle [rad] at which a spring across a hinge has the energy of the hinge."""


def mesh_springs(mesh: TriangleMesh, structural: ArrayLike, flexion: ArrayLike, damping: ArrayLike = 0.0) -> Springs:
    """Springs along the edges (structural) and between the far vertices of each hinge (flexion), as cloth has them.

    Parameters
    ----------
    mesh : TriangleMesh
        Its lengths are the rest lengths.
    structural : array_like, shape () or (E,)
        Stiffness along the edges [N/m].
    flexion : array_like, shape () or (H,)
        Stiffness across the hinges [N/m].
    damping : array_like, shape () or (E + H,)
        Of every spring [N s/m].

    Returns
    -------
    Springs
        The edges, then the hinges. Where two hinges, or a hinge and an edge, span the same pair (a fan of three
        triangles) the stiffnesses add up.

    Raises
    ------
    MaterialError
        For stiffnesses of the wrong shape, not finite, or negative.
    """
    checked_kind("mesh", mesh, TriangleMesh)
    edges, far = len(mesh.edges), len(mesh.hinges)
    each = (("structural", structural, edges), ("flexion", flexion, far))
    stiffness: Array = np.concatenate([checked_each(*given, MaterialError) for given in each])
    dampers = checked_each("damping", damping, edges + far, MaterialError)
    pairs = np.concatenate([mesh.edges, np.sort(mesh.hinges[:, 2:], axis=1)])
    unique, first, inverse = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    if len(unique) < len(pairs):
        order = np.argsort(first)
        pairs = unique[order]
        stiffness, dampers = (
            np.bincount(inverse.ravel(), values).astype(np.float64)[order] for values in (stiffness, dampers)
        )
    lengths = np.linalg.norm(mesh.vertices[pairs[:, 1]] - mesh.vertices[pairs[:, 0]], axis=1)
    return Springs(pairs, lengths, stiffness, dampers)


def shell_springs(shell: Shell, reference_fold: float = REFERENCE_FOLD) -> Springs:
    """Springs that approximate a shell's energies, about its shape without stress.

    Edges take the shell's shear stiffness exactly (``2 k_h / l0``); the area energy is left out. A spring across a
    hinge takes the stiffness at which it holds the energy of the hinge, ``k_f dtheta^2 l0 / h0``, for a change of the
    fold angle by ``reference_fold`` (on the mean over both directions). Where the hinge is flat at rest the distance of
    its far vertices changes as the square of the fold angle, so the spring's energy is of fourth order: it is too soft
    below the reference and too stiff above. Where it is folded at rest the energies agree to second order.

    Parameters
    ----------
    shell : Shell
        A shell of edge springs and hinges.
    reference_fold : float, optional
        Change of the fold angle [rad] at which the energies agree, in (0, pi/2].

    Returns
    -------
    Springs
        A spring for each edge, and one across each hinge.

    Raises
    ------
    MaterialError
        For a fold out of range, or a shell that has not the three energies of a discrete shell.
    """
    checked_kind("shell", shell, Shell)
    fold = checked_number("reference_fold", reference_fold, MaterialError, above=0.0, at_most=0.5 * np.pi, unit="rad")
    weights = {element.name: element for element in shell.elements}
    if "flexure" not in weights or "shear" not in weights:
        raise MaterialError("springs can be made from a shell with shear and flexure only (got one of springs?)")
    distances = _far_distances(shell.rest_mesh, fold)
    energy = weights["flexure"].weight * fold**2
    change = np.mean((distances[1:] - distances[0]) ** 2, axis=0)
    return mesh_springs(shell.rest_mesh, 2.0 * weights["shear"].weight, 2.0 * energy / change)


def _far_distances(mesh: TriangleMesh, change: float) -> Array:
    """Distance of each hinge's far vertices (3, H) [m]: at rest, and with the fold ``change`` [rad] less or more."""
    x0, x1, x2, x3 = np.moveaxis(mesh.vertices[mesh.hinges], 1, 0)
    along = (x1 - x0) / np.linalg.norm(x1 - x0, axis=1, keepdims=True)

    def split(far: Array) -> tuple[Array, Array]:
        arm = far - x0
        offset = np.einsum("hx,hx->h", arm, along)
        return offset, arm - offset[:, None] * along

    (offset_2, arm_2), (offset_3, arm_3) = split(x2), split(x3)
    height_2, height_3 = np.linalg.norm(arm_2, axis=1), np.linalg.norm(arm_3, axis=1)
    cosine = np.clip(np.einsum("hx,hx->h", arm_2, arm_3) / (height_2 * height_3), -1.0, 1.0)
    opening = np.arccos(cosine) + np.array([0.0, change, -change])[:, None]
    squared = height_2**2 + height_3**2 - 2.0 * height_2 * height_3 * np.cos(opening) + (offset_2 - offset_3) ** 2
    return np.sqrt(squared)
