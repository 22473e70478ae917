"""The barrier of self-contact on one shell, by ipctk: energy, gradient, Hessian, friction and collision-free steps."""

from __future__ import annotations

import copy
import importlib
import importlib.util
from typing import Any, Self, final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.friction import SLIP
from modalshell.contact.self_contact import SelfContact
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.shell import Shell

_SHARE = 0.25
"""Gap, as a share of the least distance at rest, where none is given."""
_BLOCK = 256
"""Edges whose boxes are compared with all triangles at once."""


@final
class Layers:
    """Pairs of a shell's triangles and edges that share no vertex, and their barrier.

    Parameters
    ----------
    contact : SelfContact
        Gap, friction and vertices.
    shell : Shell
        The shell.

    Attributes
    ----------
    gap : float
        Distance [m] at which forces begin.
    stiffness : float
        kappa [Pa].
    shell : Shell
        The shell.

    Raises
    ------
    OptionError
        Where ipctk is missing, or parts of the shell at rest are nearer to each other than the gap.
    """

    def __init__(self, contact: SelfContact, shell: Shell) -> None:
        self._ipc, self.shell = _library(), shell
        mesh, rest = shell.mesh, shell.rest_positions
        chosen = contact.vertices(mesh)
        numbers = np.cumsum(chosen) - 1
        self._vertices: Index = np.flatnonzero(chosen)
        self._whole, self._count = bool(chosen.all()), len(rest)
        self._edges = mesh.edges[chosen[mesh.edges].all(axis=1)]
        self._faces = mesh.faces[chosen[mesh.faces].all(axis=1)]
        if not len(self._faces):
            raise OptionError(f"sel of self-contact has no triangle (got {int(chosen.sum())} vertices)")
        parts = [np.asfortranarray(numbers[part], np.int32) for part in (self._edges, self._faces)]
        self._mesh = self._ipc.CollisionMesh(self._own(rest), *parts)
        self._detection = self._ipc.AdditiveCCD()
        self.refuse_crossing(rest, "at rest")
        apart = self._least_at_rest(rest)
        self.gap = _SHARE * apart if contact.gap is None else contact.gap
        if not self.gap < apart:
            raise OptionError(
                f"gap must be less than {apart:.3g} m, the least distance in the shell at rest of triangles and edges "
                f"that share no vertex (got {self.gap:.3g} m): take a smaller gap, or a coarser mesh"
            )
        self.friction, self.stiffness = contact.friction, 1.0
        self._limit = SLIP * shell.size
        self._rubbing: Any = None
        self._begin = self._own(rest)
        self._known: tuple[Array, Any] | None = None

    def stiff(self, stiffness: float) -> Self:
        """The same with another stiffness [Pa] of the barrier."""
        other = copy.copy(self)
        other.stiffness = stiffness
        return other

    def rubbed(self, x: Array) -> Self:
        """The same with the friction of a step from x (n, 3), by the forces there."""
        if not self.friction:
            return self
        other, own = copy.copy(self), self._own(x)
        other._rubbing = self._ipc.TangentialCollisions()
        other._rubbing.build(self._mesh, own, self._pairs(x), self._barrier(), self.friction)
        other._begin = own
        return other

    def value(self, x: Array, *, rubbing: bool = True) -> float:
        """Energy [J] at x (n, 3); without what friction adds if not ``rubbing``."""
        own = self._own(x)
        value = float(self._barrier()(self._pairs(x), self._mesh, own))
        if rubbing and self._rubbing is not None:
            value += float(self._sliding()(self._rubbing, self._mesh, np.asfortranarray(own - self._begin)))
        return value

    def gradient(self, x: Array, *, rubbing: bool = True) -> Array:
        """Its derivatives (n, 3) [N]."""
        own = self._own(x)
        found = self._barrier().gradient(self._pairs(x), self._mesh, own)
        if rubbing and self._rubbing is not None:
            found = found + self._sliding().gradient(self._rubbing, self._mesh, np.asfortranarray(own - self._begin))
        gradient = np.zeros((self._count, 3))
        gradient[self._vertices] = found.reshape(-1, 3)
        return gradient

    def hessian(self, x: Array, *, definite: bool) -> sps.csr_array | None:
        """Second derivatives (3n, 3n) in whole blocks, if any; positive semi-definite for each pair if so asked."""
        method = self._ipc.PSDProjectionMethod
        own, chosen = self._own(x), method.CLAMP if definite else method.NONE
        parts = []
        if len(pairs := self._pairs(x)):
            parts.append(self._barrier().hessian(pairs, self._mesh, own, chosen))
        if self._rubbing is not None and len(self._rubbing):
            moved = np.asfortranarray(own - self._begin)
            parts.append(self._sliding().hessian(self._rubbing, self._mesh, moved, chosen))
        if not parts:
            return None
        blocks = sps.csr_array(sum(parts[1:], parts[0])).tobsr((3, 3))
        if not self._whole:
            rows = np.repeat(self._vertices, np.diff(blocks.indptr))
            places = sps.coo_array((np.arange(1, rows.size + 1), (rows, self._vertices[blocks.indices])))
            sorted_ = sps.csr_array(places, shape=(self._count,) * 2)
            blocks = sps.bsr_array(
                (blocks.data[sorted_.data - 1], sorted_.indices, sorted_.indptr), shape=(3 * self._count,) * 2
            )
        return sps.csr_array(blocks)

    def near(self, x: Array) -> bool:
        """Whether a pair is nearer than the gap at x (n, 3)."""
        return len(self._pairs(x)) > 0

    def least(self, x: Array) -> float:
        """Smallest distance [m] of a pair at x (n, 3); the gap where none is nearer."""
        pairs = self._pairs(x)
        return float(np.sqrt(pairs.compute_minimum_distance(self._mesh, self._own(x)))) if len(pairs) else self.gap

    def free_part(self, x: Array, moved: Array) -> float:
        """Part of the straight way from x to ``moved``, both (n, 3), on which no pair meets."""
        begin, end = self._own(x), self._own(moved)
        found = self._ipc.compute_collision_free_stepsize(self._mesh, begin, end, narrow_phase_ccd=self._detection)
        return float(found)

    def refuse_crossing(self, x: Array, when: str) -> None:
        """Raise OptionError where an edge crosses or touches a triangle at x (n, 3); names both."""
        if not self._ipc.has_intersections(self._mesh, self._own(x)):
            return
        edge, face = self._crossing(x)
        raise OptionError(
            f"edge {tuple(edge.tolist())} crosses triangle {tuple(face.tolist())} of the shell {when}: self-contact "
            "needs a start without crossings; move the start, or leave these vertices out of sel"
        )

    def _crossing(self, x: Array) -> tuple[Index, Index]:
        """The first edge, and a triangle that it crosses, by their vertices."""
        corners, ends = x[self._faces], x[self._edges]
        low, high = corners.min(axis=1), corners.max(axis=1)
        for first in range(0, len(ends), _BLOCK):
            part = ends[first : first + _BLOCK]
            meets = (part.min(axis=1)[:, None] <= high) & (part.max(axis=1)[:, None] >= low)
            for e, f in np.argwhere(meets.all(axis=2)):
                edge, face = self._edges[first + e], self._faces[f]
                if not np.isin(edge, face).any() and self._ipc.is_edge_intersecting_triangle(*x[edge], *x[face]):
                    return edge, face
        return self._edges[0], self._faces[0]

    def _least_at_rest(self, rest: Array) -> float:
        own, reach = self._own(rest), float(np.linalg.norm(np.diff(rest[self._edges], axis=1), axis=2).mean())
        pairs = self._ipc.NormalCollisions()
        pairs.build(self._mesh, own, reach)
        return min(reach, float(np.sqrt(pairs.compute_minimum_distance(self._mesh, own)))) if len(pairs) else reach

    def _barrier(self) -> Any:
        return self._ipc.BarrierPotential(self.gap, self.stiffness, True)

    def _sliding(self) -> Any:
        return self._ipc.FrictionPotential(self._limit)

    def _own(self, x: Array) -> Array:
        return np.asfortranarray(x if self._whole else x[self._vertices])

    def _pairs(self, x: Array) -> Any:
        """Pairs nearer than the gap at x (n, 3); those of the last place are kept."""
        if self._known is None or not np.array_equal(self._known[0], x):
            pairs = self._ipc.NormalCollisions()
            pairs.use_area_weighting = True
            pairs.build(self._mesh, self._own(x), self.gap)
            self._known = x.copy(), pairs
        return self._known[1]


def _library() -> Any:
    """ipctk, on one thread: its sums then have the same bits each time."""
    if importlib.util.find_spec("ipctk") is None:
        raise OptionError("self-contact needs ipctk, which is not installed: pip install 'modalshell[contact]'")
    ipctk: Any = importlib.import_module("ipctk")

    ipctk.set_num_threads(1)
    ipctk.set_logger_level(ipctk.LoggerLevel.error)
    return ipctk
