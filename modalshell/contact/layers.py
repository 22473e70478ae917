"""The barrier of self-contact on one shell: energy, gradient, Hessian, friction and collision-free steps."""

from __future__ import annotations

import copy
import importlib
import importlib.util
from typing import Any, Self, final

import numpy as np

from modalshell.contact import pair_kernels, pair_move_kernels
from modalshell.contact.friction import slip_limit
from modalshell.contact.near_pairs import Barrier, NearPairs, Rubbing
from modalshell.contact.self_contact import SelfContact
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.shell import Shell

_SHARE = 0.25
"""Gap, as a share of the least distance at rest, where none is given."""
_BLOCK = 256
"""Edges whose boxes are compared with all triangles at once."""
_MARGIN = 0.25
"""Way, in gaps, that vertices may move before pairs are looked for again."""
_STRIDE, _PARTS = 2.0, 32
"""Longest way, in mean edges, on which pairs are looked for at once, and how many such parts a way has at most."""


@final
class Layers:
    """Pairs of a shell's triangles and edges that share no vertex, and their barrier.

    ``gap`` [m] is the distance at which its forces begin, and ``stiffness`` kappa [Pa]. OptionError where ipctk is
    missing, or parts of the shell at rest are nearer to each other than the gap.
    """

    def __init__(self, contact: SelfContact, shell: Shell) -> None:
        self._ipc, self.shell = _library(), shell
        mesh, rest = shell.mesh, shell.rest_positions
        chosen = contact.vertices(mesh)
        self._faces = faces = mesh.faces[chosen[mesh.faces].all(axis=1)]
        if not len(faces):
            raise OptionError(f"sel of self-contact has no triangle (got {int(chosen.sum())} vertices)")
        long = float(np.linalg.norm(np.diff(rest[mesh.edges], axis=1), axis=2).mean())
        at_rest = NearPairs(faces, rest, long, 0.0)
        self._edges = at_rest.edges
        parts = (np.asfortranarray(part, np.int32) for part in (self._edges, faces))
        self._mesh = self._ipc.CollisionMesh(np.asfortranarray(rest), *parts)
        self.refuse_crossing(rest, "at rest")
        apart = min(long, at_rest.barrier(rest, long).least)
        self.gap = _SHARE * apart if contact.gap is None else contact.gap
        if not self.gap < apart:
            raise OptionError(
                f"gap must be less than {apart:.3g} m, the least distance in the shell at rest of triangles and edges "
                f"that share no vertex (got {self.gap:.3g} m): take a smaller gap, or a coarser mesh"
            )
        self.friction, self.stiffness = contact.friction, 1.0
        self._near, self._stride = NearPairs(faces, rest, self.gap, _MARGIN * self.gap), _STRIDE * long
        self._size, self._mass, self._limit = shell.mesh.moment_length, shell.mass, 0.0
        self._rubbing: Rubbing | None = None
        self._known: tuple[Array, Barrier] | None = None
        self._known_slid: tuple[Rubbing, Array, tuple[float, Array]] | None = None

    def stiff(self, stiffness: float) -> Self:
        """The same with another stiffness [Pa] of the barrier."""
        other = copy.copy(self)
        other.stiffness = stiffness
        return other

    def rubbed(self, x: Array, dt: float, whole: float) -> Self:
        """The same with the friction of a step of ``dt`` [s] from x (n, 3), by the forces there; see `slip_limit`."""
        if not self.friction:
            return self
        other, at = copy.copy(self), self._at(x)
        rubbing = other._rubbing = self._near.rubbing(x, self.gap, at, self.friction * self.stiffness)
        other._limit = slip_limit(self._size, rubbing.strengths, self._mass[np.unique(rubbing.pairs)], dt, whole)
        return other

    def value(self, x: Array) -> float:
        """Energy [J] at x (n, 3)."""
        value = self.stiffness * self._at(x).energy
        if self._rubbing is not None:
            value += self._slid(self._rubbing, x)[0]
        return value

    def gradient(self, x: Array) -> Array:
        """Its derivatives (n, 3) [N]."""
        gradient = self.stiffness * self._at(x).gradient
        if self._rubbing is not None:
            gradient += self._slid(self._rubbing, x)[1]
        return gradient

    @property
    def near_pairs(self) -> Index:
        """Vertices (p, 4) of the pairs on the way that was last looked at."""
        return self._near.pairs

    def stencils(self, x: Array) -> list[Index]:
        """Vertices (p, 4) of the pairs nearer than the gap at x (n, 3), and of those that rub."""
        at = self._at(x)
        return [at.pairs[at.active]] + ([] if self._rubbing is None else [self._rubbing.pairs])

    def add_hessian(self, x: Array, slots: list[Index], strides: Index, data: Array, *, definite: bool) -> None:
        """Add its second derivatives to a pattern's entries; positive semi-definite for each pair if so asked.

        ``slots`` (p, 4, 4) say where the blocks of :meth:`stencils` begin, ``strides`` (n,) how long rows are.
        """
        at = self._at(x)
        areas = self.stiffness * at.areas
        pair_kernels.add_hessian(
            x, at.pairs, at.faced, areas, at.limits, self.gap, at.active, not definite, slots[0], strides, data
        )
        if self._rubbing is not None:
            self._rubbing.add_hessian(x, self._limit, slots[1], strides, data)

    def near(self, x: Array) -> bool:
        """Whether a pair is nearer than the gap at x (n, 3)."""
        return self._at(x).active.size > 0

    def least(self, x: Array) -> float:
        """Smallest distance [m] of a pair at x (n, 3); the gap where none is nearer."""
        return min(self._at(x).least, self.gap)

    def free_part(self, x: Array, moved: Array) -> float:
        """Part of the straight way from x to ``moved``, both (n, 3), on which no pair meets.

        Where vertices move far past each other, what is found is that of its first parts.
        """
        way = moved - x
        longest = float(np.sqrt(np.sum((way - way.mean(axis=0)) ** 2, axis=1).max()))
        if not np.isfinite(longest):
            return 1.0  # what follows finds positions that are not finite
        count = max(1, int(np.ceil(min(longest / self._stride, 1e9))))
        begin = x
        for part in range(min(count, _PARTS)):
            end = moved if part + 1 == count else x + (part + 1) / count * way
            self._near.about(begin, end)
            free = pair_move_kernels.free_part(begin, end, self._near.pairs, self._near.faced)
            if free < 1.0:
                return float((part + free) / count)
            begin = end
        return min(1.0, _PARTS / count)

    def refuse_crossing(self, x: Array, when: str) -> None:
        """Raise OptionError where an edge crosses or touches a triangle at x (n, 3); names both."""
        if not self._ipc.has_intersections(self._mesh, np.asfortranarray(x)):
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

    def _at(self, x: Array) -> Barrier:
        """The barrier at x (n, 3), over its stiffness; that of the last place is kept."""
        if self._known is None or not np.array_equal(self._known[0], x):
            self._known = x.copy(), self._near.barrier(x, self.gap)
        return self._known[1]

    def _slid(self, rubbing: Rubbing, x: Array) -> tuple[float, Array]:
        """Energy and gradient of friction at x (n, 3); those of the last place are kept, as both are asked for."""
        known = self._known_slid
        if known is None or known[0] is not rubbing or not np.array_equal(known[1], x):
            known = self._known_slid = rubbing, x.copy(), rubbing.energy_gradient(x, self._limit)
        return known[2]


def _library() -> Any:
    """ipctk, on one thread: its sums then have the same bits each time."""
    if importlib.util.find_spec("ipctk") is None:
        raise OptionError("self-contact needs ipctk, which is not installed: pip install 'modalshell[contact]'")
    ipctk: Any = importlib.import_module("ipctk")

    ipctk.set_num_threads(1)
    ipctk.set_logger_level(ipctk.LoggerLevel.error)
    return ipctk
