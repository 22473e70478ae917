"""Free unknowns of a supported shell, and the affine map from them to vertex positions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.errors import SupportError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.supports.base import Support

_HELD = 1e-8
"""Least eigenvalue of a vertex's combined held directions for a direction to count as held."""


class Unknowns(ReadOnlyArrays, ABC):
    """Unknowns y (N,) of the displacements ``u = P y`` (3n,) that the supports allow.

    The columns of P are orthogonal, those of one vertex in the norm of the mass, too.
    """

    count: int
    """Number of unknowns N."""
    held: Mask
    """Vertices that cannot move; shape (n,)."""
    supported: Mask
    """Vertices that have supports; shape (n,)."""
    matrix: sps.csr_array | None = None
    """P, where it is more than a selection of vertices."""

    @abstractmethod
    def restrict(self, vectors: Any) -> Any:
        """Generalised forces ``P^T f`` (N,) or (N, k) of forces (3n,) or (3n, k)."""

    @abstractmethod
    def prolong(self, values: Any) -> Any:
        """Displacements ``P y`` (3n,) or (3n, k) of values (N,) or (N, k)."""

    @abstractmethod
    def values(self, displacement: Any) -> Any:
        """Values (N,) or (N, k) of displacements (3n,) or (3n, k); of others, those of the nearest that is allowed."""

    @abstractmethod
    def project(self, displacement: Array, mass: Array | None = None) -> Array:
        """The displacement (n, 3) that the supports allow nearest to one that leaves held vertices where they are.

        In the norm of vertex masses (n,) if they are given.
        """

    @abstractmethod
    def turns(self, rotations: Array) -> Array:
        """Rotation vectors (3n, k) of vertices, less what would turn their displacements out of their supports."""

    @abstractmethod
    def masses(self, mass: Array) -> Array:
        """Diagonal of ``P^T M P`` (N,) [kg] for vertex masses (n,)."""

    @abstractmethod
    def resisted(self, displacements: Array) -> Array:
        """The part (k, 3, m) of displacements (n, 3, m) that the supports resist, at the k vertices with supports."""


@final
class VertexUnknowns(Unknowns):
    """The positions of the vertices that are not ``held`` (n,)."""

    def __init__(self, held: Mask) -> None:
        self.held = self.supported = read_only(held)
        self._size = 3 * held.size
        self.indices: Index = read_only((3 * np.flatnonzero(~held)[:, None] + np.arange(3)).ravel())
        self.count = self.indices.size

    def restrict(self, vectors: Any) -> Any:
        """Entries of the free vertices."""
        return vectors[self.indices]

    def values(self, displacement: Any) -> Any:
        """Entries of the free vertices."""
        return displacement[self.indices]

    def prolong(self, values: Any) -> Any:
        """Displacements, zero at held vertices."""
        whole = np.zeros((self._size, *values.shape[1:]), dtype=values.dtype)
        whole[self.indices] = values
        return whole

    def project(self, displacement: Array, mass: Array | None = None) -> Array:  # noqa: ARG002 (the same in any norm)
        """The displacement itself."""
        return displacement

    def turns(self, rotations: Array) -> Array:
        """The rotation vectors themselves."""
        return rotations

    def masses(self, mass: Array) -> Array:
        """Mass of each unknown's vertex."""
        return np.repeat(mass, 3)[self.indices]

    def resisted(self, displacements: Array) -> Array:
        """Displacements of the held vertices."""
        return displacements[self.held]


@final
class MappedUnknowns(Unknowns):
    """Unknowns of vertices that are held along some directions only, or move together.

    ``matrix`` (3n, N) is P, ``supported`` (n,) are the vertices that have supports, and ``axes`` (s, 3, 3) projections
    on the axes about which each of them may rotate.
    """

    matrix: sps.csr_array

    def __init__(self, matrix: sps.csr_array, supported: Mask, axes: Array) -> None:
        self.matrix = matrix
        self._axes = axes
        self.supported = read_only(supported)
        self.count = matrix.shape[1]
        self._transposed = sps.csr_array(matrix.T)
        self._squares = sps.csr_array(self._transposed.multiply(self._transposed))
        self._sizes = np.asarray(self._squares.sum(axis=1))
        entries = np.diff(matrix.indptr).reshape(-1, 3)
        self.held = read_only((entries == 0).all(axis=1))

    def restrict(self, vectors: Any) -> Any:
        """Products with the columns of P."""
        return self._transposed @ vectors

    def prolong(self, values: Any) -> Any:
        """Product with P."""
        return self.matrix @ values

    def values(self, displacement: Any) -> Any:
        """Products with the columns of P over their squares."""
        products = self.restrict(displacement)
        return products / self._sizes.reshape(-1, *[1] * (products.ndim - 1))

    def project(self, displacement: Array, mass: Array | None = None) -> Array:
        """Displacement of its values."""
        if mass is None:
            values = self.values(displacement.ravel())
        else:
            values = self.restrict((mass[:, None] * displacement).ravel()) / self.masses(mass)
        return np.asarray(self.prolong(values).reshape(-1, 3))

    def turns(self, rotations: Array) -> Array:
        """Turns about the normal in planes, about the line on lines; none of tied vertices."""
        turned = rotations.reshape(self.held.size, 3, -1).copy()
        turned[self.supported] = self._axes @ turned[self.supported]
        return turned.reshape(rotations.shape)

    def masses(self, mass: Array) -> Array:
        """Sum of the masses that move with each unknown."""
        return np.asarray(self._squares @ np.repeat(mass, 3))

    def resisted(self, displacements: Array) -> Array:
        """What is left of displacements without that of their values."""
        flat = displacements.reshape(3 * self.held.size, -1)
        return np.asarray((flat - self.prolong(self.values(flat))).reshape(displacements.shape)[self.supported])


def supported_unknowns(supports: Sequence[Support], mesh: TriangleMesh) -> Unknowns:
    """Unknowns that supports leave of a mesh.

    OptionError for a support that selects no vertex. SupportError for vertices that do not fit their support, ties that
    contradict others, or where nothing can move.
    """
    count = len(mesh.vertices)
    squares = np.zeros((count, 3, 3))
    """Sum of the projections on the directions along which each vertex is held."""
    tied = np.zeros((count, 3, 3))
    """Projection on the directions along which each moves with others."""
    groups: list[tuple[Index, Array]] = []
    for support in supports:
        chosen, directions = support.vertices(mesh), support.directions()
        projection = directions.T @ directions
        if not support.ties:
            squares[chosen] += projection
            continue
        twice = np.flatnonzero(chosen & (np.abs(tied @ projection) > _HELD).any(axis=(1, 2)))
        if twice.size:
            raise SupportError(f"two ties prescribe vertex {twice[0]} along one direction: make one tie of them")
        tied[chosen] += projection
        groups.append((np.flatnonzero(chosen), directions))
    if not groups:
        held, frames, still = _directions(squares)
        if not (still & ~held[:, None]).any():
            return _some(VertexUnknowns(held))
    across = np.eye(3) - tied
    crossed = np.flatnonzero((np.abs(across @ squares @ tied) > _HELD).any(axis=(1, 2)))
    if crossed.size:
        raise SupportError(
            f"vertex {crossed[0]} is tied along directions that another support holds in part: tie along those that it "
            "leaves free"
        )
    _, frames, still = _directions(squares + tied)
    vertex, direction = np.nonzero(~still)
    columns = [(3 * vertex[:, None] + np.arange(3), frames[vertex, :, direction])]
    for vertices, directions in groups:
        own = (directions @ squares[vertices] @ directions.T).sum(axis=0)
        values, turned = np.linalg.eigh(own)
        for free in (turned.T @ directions)[values <= _HELD]:
            columns.append(((3 * vertices[:, None] + np.arange(3)).reshape(1, -1), np.tile(free, vertices.size)[None]))
    rows = np.concatenate([places.ravel() for places, _ in columns])
    entries = np.concatenate([values.ravel() for _, values in columns])
    sizes = np.concatenate([np.full(len(places), places.shape[1]) for places, _ in columns])
    matrix = sps.csr_array((entries, (rows, np.repeat(np.arange(sizes.size), sizes))), shape=(3 * count, sizes.size))
    matrix.eliminate_zeros()
    supported = np.asarray((squares + tied).any(axis=(1, 2)))
    _, frames, still = _directions(squares)
    kept = np.where(np.equal(still.sum(axis=1), 1)[:, None], still, ~still | still.all(axis=1, keepdims=True))
    axes = np.einsum("nik,nk,njk->nij", frames, kept, frames)
    axes[np.flatnonzero(tied.any(axis=(1, 2)))] = 0.0
    return _some(MappedUnknowns(matrix, supported, axes[np.flatnonzero(supported)]))


def _directions(squares: Array) -> tuple[Mask, Array, Mask]:
    """Vertices that are wholly held (n,), frames (n, 3, 3) of columns, and which of these are held (n, 3)."""
    frames, still = np.tile(np.eye(3), (len(squares), 1, 1)), np.zeros((len(squares), 3), dtype=bool)
    some = np.flatnonzero(squares.any(axis=(1, 2)))
    values, frames[some] = np.linalg.eigh(squares[some])
    still[some] = values > _HELD
    return np.asarray(still.all(axis=1)), frames, still


def _some(unknowns: Unknowns) -> Unknowns:
    if unknowns.count == 0:
        raise SupportError(f"the supports hold all {unknowns.held.size} vertices, so nothing can move: leave some free")
    return unknowns
