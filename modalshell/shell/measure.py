"""Error measures, fields, support reactions and the dimensionless load Gamma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.loads import Load
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import area_vectors
from modalshell.shell.shell import Shell


def displacement_error(
    positions: ArrayLike, reference: ArrayLike, shape: TriangleMesh | Shell, *, weighted: bool = True
) -> float:
    """Relative displacement error ``|a - b| / |b - rest|`` (theory 1, eq. 5).

    Parameters
    ----------
    positions, reference : array_like, shape (n, 3)
        The answer a and the reference b [m].
    shape : TriangleMesh or Shell
        Gives the rest positions, and the weights: a shell's vertex masses, or a mesh's vertex areas.
    weighted : bool
        Whether to weight vertices (the norm of the mass matrix), or to count every vertex alike.

    Raises
    ------
    LoadError
        For positions of the wrong shape or not finite.
    OptionError
        If the reference does not move, so that no relative error exists.
    """
    mesh = shape.mesh if isinstance(shape, Shell) else checked_kind("shape", shape, TriangleMesh)
    a, b = _checked(positions, mesh), _checked(reference, mesh)
    if not weighted:
        weights = np.ones(len(mesh.vertices))
    elif isinstance(shape, Shell):
        weights = shape.mass
    else:
        weights = mesh.shared_among_corners(mesh.face_areas)
    moved = float(np.sum(weights[:, None] * (b - mesh.vertices) ** 2))
    if moved == 0.0:
        raise OptionError("the reference does not move, so no relative error exists (got reference = rest positions)")
    return float(np.sqrt(np.sum(weights[:, None] * (a - b) ** 2) / moved))


def field(shell: Shell, positions: ArrayLike, name: str) -> Array:
    """Field of a deformed shell, one number per triangle (T,).

    Parameters
    ----------
    shell : Shell
        The shell.
    positions : array_like, shape (n, 3)
        Vertex positions [m].
    name : str
        A field of :class:`~modalshell.ShellFields`, such as "curvature" [1/m] or "von_mises" [Pa]; of a tensor its
        principal value of the largest size, with its sign.

    Raises
    ------
    LoadError
        For positions of the wrong shape or not finite.
    OptionError
        For an unknown name, or a field that needs a thickness if the material has none.
    """
    return checked_kind("shell", shell, Shell).fields(positions).scalar(name)


def support_reactions(
    shell: Shell,
    positions: ArrayLike,
    *,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
) -> Array:
    """Force (k, 3) [N] of each of the k supports on a shell in equilibrium: together they balance the load.

    The sums over the vertices of :meth:`Shell.support_reactions`, in the order of ``shell.supports``: supports that
    hold a vertex along one direction share its force evenly, and a tie passes its own on to those of its vertices.

    Parameters
    ----------
    shell : Shell
        The shell.
    positions : array_like, shape (n, 3)
        Vertex positions in equilibrium [m].
    gravity, force, loads : optional
        The load, as in :meth:`Model.equilibrium`.

    Raises
    ------
    LoadError
        For arrays of the wrong shape or not finite, or where a triangle has collapsed.
    """
    shares = checked_kind("shell", shell, Shell).support_reactions(positions, gravity=gravity, force=force, loads=loads)
    return np.array([share.sum(axis=0) for share in shares]).reshape(-1, 3)


def area_change(positions: ArrayLike, mesh: TriangleMesh) -> float:
    """Relative change of the surface area, ``A(positions) / A(rest) - 1``."""
    normals = area_vectors(_checked(positions, checked_kind("mesh", mesh, TriangleMesh)), mesh.faces)
    return float(0.5 * np.linalg.norm(normals, axis=1).sum() / mesh.area - 1.0)


def gamma_per_gravity(shell: Shell) -> float:
    """Gamma at unit gravity: the weight of a shell clamped at its end of smallest x over its bending stiffness.

    ``Gamma = (weight per length) L^3 / EI``, with the bending stiffness EI of a beam whose free end drops as far: by
    ``Gamma / 8`` of the free length in the linear limit (theory 1, eq. 4). The drop is solved with all unknowns of the
    shell.

    Parameters
    ----------
    shell : Shell
        Clamped at one end, free at its largest x.

    Returns
    -------
    float
        Gamma of a gravity of 1 m/s^2 along -z [s^2/m].

    Raises
    ------
    OptionError
        If nothing is clamped, or the vertices of largest x are.
    """
    x = checked_kind("shell", shell, Shell).rest_positions[:, 0]
    length = x.max() - x[shell.clamped].max(initial=-np.inf)
    if not 0.0 < length < np.inf:
        raise OptionError("Gamma needs a shell that is clamped at one end and free at its largest x")
    unknowns = shell.unknowns
    stiffness = unknowns.restrict(unknowns.restrict(shell.stiffness()).T).tocsc()
    weight = unknowns.restrict(shell.gravity_force((0.0, 0.0, -1.0)).ravel())
    displacement = unknowns.prolong(spla.spsolve(stiffness, weight))
    drop = -displacement.reshape(-1, 3)[x > x.max() - 1e-9 * length, 2].mean()
    return float(8.0 * drop / length)


def _checked(positions: ArrayLike, mesh: TriangleMesh) -> Array:
    return checked_vectors("positions", positions, mesh.vertices.shape)
