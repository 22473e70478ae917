r"""Creases: edges whose rest angle is a state, as it yields under a moment.

Edge e with the fold angle :math:`\theta_e`, the plastic fold :math:`\psi_e` and the couple
:math:`\mu_e = \partial W / \partial \theta_e` yields where the moment per length leaves the elastic range about that of
linear hardening,

.. math:: |\mu_e / l_e - H \psi_e| \le M_y .

What is beyond goes into the rest angle, :math:`\theta_{0,e} + \psi_e`. Hardening is kinematic (Prager's): the state
is :math:`\psi` alone, :math:`l_e H \psi_e^2 / 2` is stored, and a step from :math:`\psi` to :math:`\psi'` turns
:math:`l_e M_y |\psi'_e - \psi_e|` into heat, which is never negative. At given positions the new state is the least of

.. math:: W(x, \psi') + \sum_e l_e \left(H \psi_e'^2 / 2 + M_y |\psi'_e - \psi_e|\right),

a convex problem with a constant matrix, as W is quadratic in the rest angles ([simo1998], theory 15, eq. 6 and 7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self, final

import numpy as np

from modalshell.core.checks import LARGEST, as_array, checked_kind, checked_number, shown
from modalshell.core.errors import LoadError, MaterialError, OptionError
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import ReadOnlyArrays, read_only, read_only_copy
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, mixes_masks, selected
from modalshell.mesh.topology import numbers_of_edges

_SWEEPS = 200
"""Sweeps over the creases at most, in search of those that yield."""
_ROUNDING = 1e-5
"""Angle [deg] above that of a crease up to which a fold is no larger than it, but for rounding."""
_SOFTEST = 1e-12
"""Stiffness against yielding over that at fixed positions, below which creases form a mechanism."""


@final
@dataclass(frozen=True)
class Crease(ReadOnlyArrays):
    """Edges that keep a part of their fold: they yield under a moment; see :mod:`modalshell.shell.creases`.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), of int, or of int, shape (k, 2)
        Vertices: every edge between two of them is a crease; or pairs of vertices, which are the edges themselves.
    yield_moment : float
        Moment per length of the edge [N] at which it yields, M_y.
    hardening : float
        Further moment per length [N] for a plastic fold of one radian, H. Released, the crease keeps at most M_y / H.
    angle : float, optional
        Creases are only those of the edges at which the sheet is folded at rest by more than this [deg].

    Raises
    ------
    MaterialError
        For a yield moment that is not positive, or a negative hardening.
    OptionError
        For a selection that cannot be one, or an ``angle`` out of range.
    """

    sel: Selection
    yield_moment: float
    hardening: float = 0.0
    angle: float | None = None

    def __post_init__(self) -> None:
        pairs = not isinstance(self.sel, str) and np.ndim(self.sel) == 2
        if pairs:
            entries = as_array("sel", self.sel, "pairs of vertices (k, 2)", OptionError, "iu")
            if entries.shape[1] != 2 or not entries.size:
                raise OptionError(f"sel must be vertices, or pairs of vertices (k, 2) (got shape {entries.shape})")
            if mixes_masks(self.sel):
                raise OptionError(f"sel must be pairs of vertices (k, 2), not true or false (got {shown(self.sel)})")
            object.__setattr__(self, "sel", read_only_copy(entries))
        else:
            object.__setattr__(self, "sel", checked_selection("sel", self.sel))
        for name, least in (("yield_moment", {"above": 0.0}), ("hardening", {"at_least": 0.0})):
            value = checked_number(name, getattr(self, name), MaterialError, unit="N", **least)
            object.__setattr__(self, name, value)
        if self.angle is not None:
            value = checked_number("angle", self.angle, at_least=0.0, at_most=180.0, unit="deg")
            object.__setattr__(self, "angle", value)

    def hinges(self, mesh: TriangleMesh, at_rest: TriangleMesh | None = None) -> Index:
        """Hinges of the mesh that are its creases; OptionError if there is none, or at a junction.

        Folds are those of the mesh ``at_rest``, if that is another one.
        """
        if not isinstance(self.sel, str) and np.ndim(self.sel) == 2:
            pairs = np.asarray(self.sel)
            chosen = numbers_of_edges(mesh.edges, pairs)
            if (chosen < 0).any():
                a, b = sorted(pairs[np.argmax(chosen < 0)].tolist())
                raise OptionError(f"sel names the pair ({a}, {b}), which is no edge of the mesh")
        else:
            among = selected("sel", self.sel, mesh)
            chosen = np.flatnonzero(among[mesh.edges].all(axis=1))
        if (joined := np.isin(chosen, mesh.joints.edges)).any():
            ends = mesh.edges[chosen[joined][0]].tolist()
            raise OptionError(f"sel has edge {ends}, a junction: a crease is an edge of two triangles")
        found = np.flatnonzero(np.isin(mesh.hinge_edges, chosen))
        if self.angle is not None:
            folded = mesh if at_rest is None else at_rest
            sides = folded.face_normals[folded.hinge_faces[found]]
            cosine = np.sum(sides[:, 0] * sides[:, 1], axis=1).clip(-1.0, 1.0)
            found = found[np.degrees(np.arccos(cosine)) > self.angle + _ROUNDING]
        if not found.size:
            least = "" if self.angle is None else f", folded by more than {self.angle:g} degrees at rest,"
            raise OptionError(
                f"sel has no edge of two triangles{least} between its vertices (got {shown(self.sel)}): select both "
                "ends of every edge of the crease"
            )
        return found


@final
@short_repr
@dataclass(frozen=True, eq=False)
class CreaseState(ReadOnlyArrays):
    """What creases keep.

    Attributes
    ----------
    angles : ndarray, shape (C,)
        Plastic fold of every crease [rad], in the order of :attr:`CreaseSet.hinges`; positive as the hinge's angle.
    dissipated : float
        Heat that they have made so far [J].

    Raises
    ------
    LoadError
        For angles of another shape or not finite, or negative heat.
    """

    angles: Array
    dissipated: float = 0.0

    def __post_init__(self) -> None:
        value = as_array("angles", self.angles, "plastic folds (C,) [rad]", LoadError).astype(np.float64)
        if value.ndim != 1 or not (np.abs(value) <= LARGEST).all():
            raise LoadError(f"angles must be finite plastic folds (C,) [rad] (got {shown(self.angles)})")
        object.__setattr__(self, "angles", read_only_copy(value))
        heat = checked_number("dissipated", self.dissipated, LoadError, at_least=0.0, unit="J")
        object.__setattr__(self, "dissipated", heat)


class _Slip(NamedTuple):
    """Change of plastic folds (C,) [rad], and whether all conditions of yielding are met."""

    change: Array
    settled: bool


@final
@dataclass(frozen=True, eq=False)
class CreaseSet(ReadOnlyArrays):
    """The creases of a shell."""

    hinges: Index
    """Their hinges among those of the mesh; shape (C,)."""
    limits: Array
    """Couple at which each yields, ``l M_y`` [N m]; shape (C,)."""
    hardening: Array
    """``l H`` [N m/rad]; shape (C,)."""
    count: int
    """Number of hinges of the mesh."""

    @classmethod
    def of(cls, creases: Sequence[Crease], mesh: TriangleMesh, at_rest: TriangleMesh) -> Self | None:
        """The creases on a mesh, None without any; OptionError for an edge that belongs to two of them.

        Lengths and folds are those of the mesh ``at_rest``.
        """
        if isinstance(creases, Crease) or not isinstance(creases, Sequence):
            raise OptionError(f"creases must be a list of ms.Crease (got {shown(creases)})")
        if not creases:
            return None
        hinges = [checked_kind(f"creases[{i}]", each, Crease).hinges(mesh, at_rest) for i, each in enumerate(creases)]
        owner = np.full(len(mesh.hinges), -1)
        for index, own in enumerate(hinges):
            if (owner[own] >= 0).any():
                hinge = int(own[np.argmax(owner[own] >= 0)])
                ends = mesh.edges[mesh.hinge_edges[hinge]].tolist()
                raise OptionError(f"creases[{index}] has edge {ends}, which is one of creases[{owner[hinge]}], too")
            owner[own] = index
        chosen = np.flatnonzero(owner >= 0)
        lengths = at_rest.edge_lengths[at_rest.hinge_edges[chosen]]
        limits = lengths * np.array([crease.yield_moment for crease in creases])[owner[chosen]]
        hardening = lengths * np.array([crease.hardening for crease in creases])[owner[chosen]]
        return cls(read_only(chosen), read_only(limits), read_only(hardening), len(mesh.hinges))

    def checked(self, angles: object) -> Array:
        """Plastic folds (C,) [rad] as an array; LoadError for another number of them, or what is not finite."""
        value = as_array("creases", angles, f"plastic folds ({self.hinges.size},) [rad]", LoadError).astype(np.float64)
        if value.shape != self.hinges.shape or not np.isfinite(value).all():
            raise LoadError(f"creases must be {self.hinges.size} finite plastic folds [rad] (got {shown(angles)})")
        return value

    def on_mesh(self, angles: Array) -> Array:
        """Rest angles (H,) that plastic folds (C,) add to the hinges of the mesh."""
        every = np.zeros(self.count)
        every[self.hinges] = angles
        return every

    def drive(self, couples: Array, angles: Array) -> Array:
        """What yields (C,) [N m]: couples (C,) less those of hardening."""
        return couples - self.hardening * angles

    def heat(self, before: Array, after: Array) -> float:
        """Heat [J] of a step from plastic folds to others."""
        return float(np.sum(self.limits * np.abs(after - before)))

    def stored(self, angles: Array) -> float:
        """Energy [J] that hardening has stored."""
        return 0.5 * float(np.sum(self.hardening * angles**2))

    def yield_residual(self, drive: Array, slipped: Array) -> Array:
        """Residuals (C,) [N m] of the yield conditions; ``slipped`` (C,) [rad] are the step's plastic folds so far."""
        still = np.maximum(np.abs(drive) - self.limits, 0.0)
        return np.where(slipped == 0.0, still, np.abs(drive - np.sign(slipped) * self.limits))

    def flow(self, stiffness: Array, drive: Array, slipped: Array, chosen: Mask) -> _Slip:
        """Further plastic folds of the ``chosen`` creases (C,), which meet the conditions if the rest stay as they are.

        Returns the change (C,) [rad], and whether it was found.

        Parameters
        ----------
        stiffness : ndarray, shape (c, c)
            Minus the derivative of the chosen creases' couples by their plastic folds [N m/rad].
        drive : ndarray, shape (C,)
            What yields [N m]; see :meth:`drive`.
        slipped : ndarray, shape (C,)
            Plastic fold of the step so far [rad].
        chosen : ndarray of bool, shape (C,)
            Which may yield, c of them.
        """
        matrix = stiffness + np.diag(self.hardening[chosen])
        limits, before = self.limits[chosen], slipped[chosen]
        total, settled = _least_work(matrix, drive[chosen] + matrix @ before, limits, before)
        change = np.zeros_like(drive)
        change[chosen] = total - before
        return _Slip(change, settled)


def _least_work(matrix: Array, push: Array, limits: Array, start: Array) -> tuple[Array, bool]:
    """Minimum q (c,) of ``q A q / 2 - push q + sum limits |q|``, A positive definite, and whether it was found.

    By the set of what yields: those that do solve linear equations, one that turns round is taken out, and the one
    farthest beyond its limit taken in. Minimisation by coordinates finds the first set.
    """
    q, diagonal = start.copy(), np.diagonal(matrix)
    for _ in range(3):
        for i in range(q.size):
            rest = push[i] - matrix[i] @ q + diagonal[i] * q[i]
            q[i] = np.sign(rest) * max(abs(rest) - limits[i], 0.0) / diagonal[i]
    signs = np.sign(q)
    for _ in range(_SWEEPS):
        q = np.zeros_like(push)
        active = np.flatnonzero(signs)
        if active.size:
            own = matrix[np.ix_(active, active)]
            q[active] = np.linalg.solve(own, push[active] - signs[active] * limits[active])
        turned = (signs != 0.0) & (np.sign(q) == -signs)
        if turned.any():
            signs[turned] = 0.0
            continue
        residual = push - matrix @ q
        over = np.where(signs == 0.0, np.abs(residual) - limits, 0.0)
        if over.max(initial=0.0) <= 1e-13 * limits.max():
            return q, True
        worst = int(np.argmax(over))
        signs[worst] = np.sign(residual[worst])
    return q, False


def is_definite(stiffness: Array, fixed: Array) -> bool:
    """Whether a stiffness (c, c) of creases is positive definite, against the one at ``fixed`` positions (c, c)."""
    try:
        np.linalg.cholesky(stiffness - _SOFTEST * np.diag(np.diagonal(fixed)))
    except np.linalg.LinAlgError:
        return False
    return True
