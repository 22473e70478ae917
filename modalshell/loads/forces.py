"""Dead forces on vertices and along edges."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.checks import checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only_copy
from modalshell.core.typing import Array, Vector
from modalshell.loads.base import Load
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, selected


class SelectedForce(Load, ReadOnlyArrays):
    """One vector for selected vertices."""

    def __init__(self, sel: Selection, force: Vector) -> None:
        self.sel = checked_selection("sel", sel)
        self.vector = read_only_copy(checked_vectors("force", force, (3,)))


@final
class PointForce(SelectedForce, key="point"):
    """A force at each selected vertex: k vertices bear k times as much in all.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices: a text such as ``"x > 0.99"`` about the shape at rest, a mask, or indices.
    force : (float, float, float)
        Force at each of them [N].

    Raises
    ------
    LoadError
        If ``force`` is not three finite numbers.
    """

    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N]; OptionError where ``sel`` selects no vertex of ``mesh``."""
        return np.where(selected("sel", self.sel, mesh)[:, None], self.vector, 0.0)


@final
class LineForce(SelectedForce, key="line"):
    """A force along the edges whose two ends are selected.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices: a text such as ``"x > 0.99"`` about the shape at rest, a mask, or indices.
    force : (float, float, float)
        Force for each length of the edges at rest [N/m]; half of an edge's goes to each of its ends.

    Raises
    ------
    LoadError
        If ``force`` is not three finite numbers.
    """

    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N]; OptionError where ``sel`` selects no edge of ``mesh``."""
        chosen = selected("sel", self.sel, mesh)
        edges = np.flatnonzero(chosen[mesh.edges].all(axis=1))
        if edges.size == 0:
            raise OptionError(f"sel selects {chosen.sum()} vertices, but no edge between two of them: select more")
        length = np.zeros(len(mesh.vertices))
        np.add.at(length, mesh.edges[edges], 0.5 * mesh.edge_lengths[edges, None])
        return length[:, None] * self.vector
