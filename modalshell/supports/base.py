"""Base class of supports, and their registry."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np

from modalshell.core.checks import checked_kind, shown
from modalshell.core.errors import SupportError
from modalshell.core.registry import Registry
from modalshell.core.thread_safety import ReadOnlyArrays, read_only
from modalshell.core.typing import Array, Mask
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, selected


class Support(ReadOnlyArrays, ABC):
    """What holds selected vertices of a shell.

    A subclass with a key is known to scenes: with ``class Pin(Support, key="pin")`` each table ``[[supports]]`` of
    ``kind = "pin"`` is such a support, its further keys the parameters of the constructor.

    Attributes
    ----------
    sel : str, ndarray of bool or of int
        The vertices, by a text about the shape at rest, a mask, or indices.
    """

    key: ClassVar[str]
    clamps: ClassVar[bool] = False
    """Whether edges between two of its vertices cannot turn."""
    ties: ClassVar[bool] = False
    """Whether its vertices move together along the directions, instead of being held."""

    def __init_subclass__(cls, *, key: str = "") -> None:
        cls.key = key
        if key:
            SUPPORTS[key] = cls

    def __init__(self, sel: Selection) -> None:
        self.sel = checked_selection("sel", sel)

    def plain(self) -> dict[str, Any]:
        """The parameters of its constructor, as texts and lists."""
        plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}
        if isinstance(self.sel, np.ndarray) and self.sel.dtype == bool:
            plain["sel"] = np.flatnonzero(self.sel).tolist()
        return plain

    @abstractmethod
    def directions(self) -> Array:
        """Orthonormal directions (k, 3) along which the vertices are held."""

    def mirror(self) -> Array | None:
        """Normal (3,) of the plane in which the shell is its own mirror image, if there is one."""
        return None

    def vertices(self, mesh: TriangleMesh) -> Mask:
        """Mask (n,) of its vertices of a mesh; OptionError where it selects none."""
        return selected("sel", self.sel, mesh)

    def on(self, mesh: TriangleMesh) -> Self:
        """The same support, of the vertices that it has on ``mesh`` whatever shape that takes."""
        other = copy.copy(self)
        other.sel = read_only(self.vertices(mesh))
        return other


SUPPORTS: Registry[type[Support]] = Registry("support")
"""Every support by its key."""
_HELD = 1e-9
"""Share of the largest number of vertices by which a direction is held, up to which it is rounding."""


def complement(unit: Array) -> Array:
    """Two unit directions (2, 3) at right angles to a ``unit`` one (3,); axes where that is an axis."""
    first = np.eye(3)[(int(np.argmax(np.abs(unit))) + 1) % 3]
    first = first - unit * (first @ unit)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(unit, first)])


def checked_supports(supports: Sequence[Support]) -> tuple[Support, ...]:
    """The supports as a tuple; SupportError if one is not a support."""
    try:
        given = tuple(supports)
    except TypeError as error:
        raise SupportError(f"supports must be a list of supports (got {shown(supports)})") from error
    return tuple(checked_kind("each of supports", support, Support) for support in given)  # type: ignore[type-abstract]


def shared_reactions(supports: Sequence[Support], mesh: TriangleMesh, reactions: Array) -> list[Array]:
    """The share (n, 3) of each support in ``reactions`` (n, 3) [N] on a mesh.

    Each takes the force along its own directions; supports that hold a vertex along the same one share it evenly. Ties
    hold nothing: a tie takes what no other support takes at its vertices, and passes the sum of that on to the supports
    that hold some of them.
    """
    shares = [np.zeros_like(reactions) for _ in supports]
    if not supports:
        return shares
    chosen = np.stack([support.vertices(mesh) for support in supports], axis=1)
    ties, left = np.array([support.ties for support in supports]), reactions
    for kind in (~ties, ties):
        for held in np.unique(chosen & kind, axis=0):
            vertices, active = np.flatnonzero(((chosen & kind) == held).all(axis=1)), np.flatnonzero(held)
            directions = [supports[int(k)].directions() for k in active]
            # The least forces along all directions whose sum is the reaction.
            forces = left[vertices] @ np.linalg.pinv(np.vstack([np.empty((0, 3)), *directions]))
            ends = np.cumsum([len(own) for own in directions])
            for k, own, end in zip(active, directions, ends, strict=True):
                shares[k][vertices] = forces[:, end - len(own) : end] @ own
        left = reactions - np.sum(shares, axis=0)
    holding = [(of, one.directions().T @ one.directions()) for of, one in enumerate(supports) if not one.ties]
    for tie in np.flatnonzero(ties).tolist():
        both = [(of, projection, chosen[:, of] & chosen[:, tie]) for of, projection in holding]
        counted = np.zeros((3, 3)) + sum(there.sum() * projection for _, projection, there in both)
        each = np.linalg.pinv(counted, rcond=_HELD) @ shares[tie].sum(axis=0)
        for of, projection, there in both:
            shares[of][there] += projection @ each
            shares[tie][there] -= projection @ each
    return shares
