"""Candidate elements of cubature, their forces at the training poses, and weighted sums of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import final

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.models.reduction.derivatives import DerivativeBasis
from modalshell.shell.elastic_energy import Part
from modalshell.shell.elements import ElementSet, ElementSum
from modalshell.shell.split_fold_energy import SplitFoldEnergy

_MOST = 4000
"""Largest number of candidate elements; a random sample of more."""
_SHARE_ERROR = 1e-3
"""Root of the energy that a direction of fold shares may have in the poses, as a share of theirs, to be left out."""


class Candidates(ABC):
    """Elements to choose from, in groups of one kind each; ``stencils`` are their vertices, -1 if absent.

    Attributes
    ----------
    groups : list of ndarray of int
        Those that can move, or a random sample of them.
    total : int
        Total number of elements.
    """

    def __init__(self, basis: DerivativeBasis, stencils: Sequence[Index]) -> None:
        self.basis, shell = basis, basis.shell
        held = np.append(shell.clamped, True)
        groups: list[Index] = [np.flatnonzero(~held[group].all(axis=1)) for group in stencils]
        count = sum(group.size for group in groups)
        if count > _MOST:
            groups = picked(groups, np.sort(np.random.default_rng(0).choice(count, _MOST, replace=False)))
        self.groups, self.total = groups, sum(map(len, stencils))
        self._fields = (basis.vectors / np.sqrt(basis.eigenvalues)).reshape(-1, 3, basis.size)

    @abstractmethod
    def columns(self, poses: Array, sizes: Array) -> Array:
        """Generalised force of each candidate at each of ``poses`` (p, r), over ``sizes`` (p,): (p * (r + s), N).

        By coordinates over the root of their eigenvalues, and by s internal unknowns of the energy.
        """

    @abstractmethod
    def part(self, groups: Sequence[Index], factors: Array) -> Part:
        """Energy of chosen elements, group by group, times ``factors`` of all of them."""

    def _positions(self, poses: Array) -> Iterable[Array]:
        for pose in poses:
            yield self.basis.shell.rest_positions + (self.basis.vectors @ pose).reshape(-1, 3)

    def _separate(
        self, poses: Array, stencils: Index, parts: Sequence[tuple[ElementSet, Index, Array, Array]]
    ) -> Array:
        """Forces (p, elements, r) of ``parts`` (set, stencils, rest, weight), each element with separate vertices."""
        # The gradient of a sum then holds each one's apart.
        fields = self._fields[stencils].reshape(len(stencils), -1, self.basis.size)
        forces = np.empty((len(poses), len(stencils), self.basis.size))
        for out, x in zip(forces, self._positions(poses), strict=True):
            own = x[stencils].reshape(-1, 3)
            gradient = np.zeros_like(own)
            for elements, corners, rest, weight in parts:
                elements.kernel.add_gradient(own, corners, rest, weight, gradient)
            np.matmul(gradient.reshape(len(stencils), 1, -1), fields, out=out[:, None])
        return forces

    def _of_sets(self, poses: Array, sets: Sequence[ElementSet], groups: Sequence[Index]) -> list[Array]:
        forces = []
        for e, chosen in zip(sets, groups, strict=True):
            own = np.arange(e.stencils[chosen].size).reshape(chosen.size, -1)
            forces.append(self._separate(poses, e.stencils[chosen], [(e, own, e.rest[chosen], e.weight[chosen])]))
        return forces


def picked(groups: Sequence[Index], numbers: Index) -> list[Index]:
    """Of groups that are numbered one after the other, the entries of the sorted ``numbers``, group by group."""
    starts = np.cumsum([0, *(group.size for group in groups)])
    cuts = np.searchsorted(numbers, starts)
    return [
        group[numbers[low:high] - start]
        for group, start, low, high in zip(groups, starts[:-1], cuts[:-1], cuts[1:], strict=True)
    ]


def candidates_of(basis: DerivativeBasis, poses: Array, sizes: Array) -> Candidates:
    """Candidates of the shell's energy; ``poses`` (p, r) are those to train on, held by forces of ``sizes`` (p,)."""
    energy = basis.shell.elastic_energy
    if isinstance(energy, SplitFoldEnergy):
        return SplitFoldCandidates(basis, energy.halved(), poses, sizes)
    return DiscreteShellCandidates(basis, basis.shell.elements)


def _columns(forces: Sequence[Array], sizes: Array) -> Array:
    """Forces of each group (p, elements, q), over ``sizes``, as columns (p * q, N)."""
    scaled = [(group / sizes[:, None, None]).transpose(0, 2, 1).reshape(-1, group.shape[1]) for group in forces]
    return np.hstack(scaled)


def _parts(groups: Sequence[Index], factors: Array) -> list[Array]:
    return np.split(factors, np.cumsum([group.size for group in groups])[:-1])


@final
class DiscreteShellCandidates(Candidates):
    """Triangles, and elements of each set on neither triangles nor edges: hinges first.

    A triangle stands for its stretch and for its shares of its edges' shear, which alone may be negative, or hold too
    little.
    """

    def __init__(self, basis: DerivativeBasis, elements: Sequence[ElementSet]) -> None:
        mesh = basis.shell.mesh
        self._elements = elements
        self._on_faces = [e for e in elements if np.array_equal(e.stencils, mesh.faces)]
        self._on_edges = [e for e in elements if np.array_equal(e.stencils, mesh.edges)]
        self._others = [e for e in elements if e not in (*self._on_faces, *self._on_edges)]
        # A half, or all of a boundary edge, stands for an edge in one of its triangles.
        self._edge_shares = 1.0 / np.bincount(mesh.face_edges.ravel(), minlength=len(mesh.edges))
        super().__init__(basis, [mesh.faces, *(e.stencils for e in self._others)])

    def columns(self, poses: Array, sizes: Array) -> Array:
        """Generalised forces (p * r, N)."""
        mesh, triangles = self.basis.shell.mesh, self.groups[0]
        sides = mesh.face_edges[triangles].ravel()
        corners = np.arange(3 * triangles.size).reshape(-1, 3)
        ends = corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        shares = self._edge_shares[sides]
        parts = [(e, corners, e.rest[triangles], e.weight[triangles]) for e in self._on_faces]
        parts += [(e, ends, e.rest[sides], e.weight[sides] * shares) for e in self._on_edges]
        forces = [self._separate(poses, mesh.faces[triangles], parts)]
        return _columns([*forces, *self._of_sets(poses, self._others, self.groups[1:])], sizes)

    def part(self, groups: Sequence[Index], factors: Array) -> Part:
        """Weighted triangles, each with its shares of its edges, and weighted elements of the other sets."""
        mesh, parts = self.basis.shell.mesh, _parts(groups, factors)
        of_edges = np.zeros(len(mesh.edges))
        np.add.at(of_edges, mesh.face_edges[groups[0]], parts[0][:, None])
        sides = np.flatnonzero(of_edges)
        on_edges = (sides, (of_edges * self._edge_shares)[sides])
        others = iter(zip(groups[1:], parts[1:], strict=True))
        chosen = [
            (groups[0], parts[0]) if e in self._on_faces else on_edges if e in self._on_edges else next(others)
            for e in self._elements
        ]
        energy = ElementSum(list(self._elements), len(mesh.vertices))
        return energy.part([indices for indices, _ in chosen], [values for _, values in chosen])


@final
class SplitFoldCandidates(Candidates):
    """Pairs of triangles that bend, membrane over pairs and over single triangles, and elements of further sets.

    The fold shares, which follow from all pairs, are sought among few fields: leading singular vectors of the
    shares at the poses and of their rates along all coordinates. A weighted sum is least over these, so that its
    pairs must hold the balance of moments too, along each of them.
    """

    def __init__(self, basis: DerivativeBasis, energy: SplitFoldEnergy, poses: Array, sizes: Array) -> None:
        self._energy = energy
        super().__init__(basis, energy.element_stencils)
        linear = energy.share_rates(basis.shell.rest_positions, self._fields)
        at_poses = np.column_stack([energy.least_shares(x) for x in self._positions(poses)]) / sizes
        # Coordinates and sizes make the energies about one half.
        root = np.sqrt(energy.share_stiffness.diagonal())[:, None]
        vectors, values, _ = np.linalg.svd(root * np.hstack([linear, at_poses]), full_matrices=False)
        self._shares = vectors[:, values > _SHARE_ERROR] / root

    def columns(self, poses: Array, sizes: Array) -> Array:
        """Generalised forces (p * (r + s), N)."""
        own = [
            self._energy.element_forces(x, self.groups[:3], self._fields, self._shares) for x in self._positions(poses)
        ]
        forces = [np.array(group) for group in zip(*own, strict=True)]
        sets = self._energy.further_elements
        for group in self._of_sets(poses, sets, self.groups[3:]):
            forces.append(np.pad(group, ((0, 0), (0, 0), (0, self._shares.shape[1]))))
        return _columns(forces, sizes)

    def part(self, groups: Sequence[Index], factors: Array) -> Part:
        """Weighted elements, least over the shares' fields."""
        return self._energy.part(groups, _parts(groups, factors), self._shares)
