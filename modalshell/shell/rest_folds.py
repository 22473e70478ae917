"""Rest angles of the split-fold energy: those of a rest shape, those that creases keep, and derivatives by them."""

from __future__ import annotations

import copy
from abc import abstractmethod
from dataclasses import replace
from typing import Any, Self

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh
from modalshell.shell.elastic_energy import ElasticEnergy
from modalshell.shell.elements import ElementSum
from modalshell.shell.fold_shares import FoldShares, Measures
from modalshell.shell.mirrored_hinges import MirroredHinges
from modalshell.shell.rest_shape import RestShape
from modalshell.shell.split_folds import SplitFolds, mirror_images


class RestFolds(ElasticEnergy):
    """A split-fold energy by its rest angles: W is quadratic in them, with one constant matrix."""

    _parts: tuple[Any, ...]
    _folds: SplitFolds
    _shares: FoldShares
    _rest_angles: Array
    _rest_squares: Array
    _rest_shape: RestShape | None
    _plastic: Array | None
    _anchor: TriangleMesh | None
    _mirrors: MirroredHinges
    _further: ElementSum
    _factor: float = 1.0
    """Of the energy of folds and stretches."""

    @abstractmethod
    def bending(self, x: Array) -> tuple[Array, Array]:
        """Bending moments conjugate to each triangle's folds, and energies [J]: (T, 3) [N m] and (T,)."""

    @abstractmethod
    def _measured(self, x: Array) -> Measures:
        """Measures at positions x (n, 3)."""

    @abstractmethod
    def _rates(self, state: Measures, step: Array) -> tuple[Array, Array]:
        """Rates of the measures along ``step`` (n, 3)."""

    @abstractmethod
    def _gradient(self, state: Measures, couples: Array, tensions: Array) -> Array:
        """Gradient (n, 3) of couples (H,) and tensions (E,)."""

    def resting(self, shape: RestShape) -> Self:
        """The same energy, least at a rest shape in place of the mesh's own."""
        other = copy.copy(self)
        other._rest_shape = shape
        other._rest_angles = self._rest_angles + shape.offsets(self._parts[0], self._folds)
        other._rest_squares = self._rest_squares + shape.squares
        return other

    def changes(self, x: Array) -> list[Array]:
        """Changes of folds, of half the squared lengths, and of the measures of further sets at ``x``."""
        state = self._measured(x)
        return [state.folds, state.stretches, *self._further.changes(x)]

    @property
    def periods(self) -> list[Array | float | None]:
        """Period of every fold, a turn, which is half of one for the half of a mirrored fold; lengths have none."""
        turns = np.full(self._rest_angles.size, 2.0 * np.pi)
        turns[self._mirrors.places] *= 0.5
        return [turns, None, *self._further.periods]

    def damped(self, begun: list[Array], factor: float, dt: float) -> Self:
        """Sum of it and of what damping takes in a step of ``dt`` [s] in which measures change from ``begun``."""
        other, share = copy.copy(self), factor / (dt + factor)
        folds = share * begun[0]
        folds[self._mirrors.places] *= 2.0
        other._factor = 1.0 + factor / dt
        other._rest_angles, other._rest_squares = self._rest_angles + folds, self._rest_squares + share * begun[1]
        other._further = self._further.damped(begun[2:], factor, dt)
        return other

    def pulled_by_rest_angles(self, x: Array, weights: Array) -> Array:
        """Derivative (H,) of ``weights . gradient`` at ``x`` by the rest angle of every hinge of the mesh."""
        couples = self._shares.couples(self._rates(self._measured(x), weights)[0])
        return self._folds.of_hinges(-couples)

    def gradient_by_thickness_at_rest(self, x: Array, thickness: float) -> Array:
        """Derivative (n, 3) of the gradient by the ``thickness`` [m], as far as the rest angles depend on it."""
        if self._rest_shape is None:
            return np.zeros_like(x)
        warmed = self._rest_shape._replace(folds=self._rest_shape.warmed).offsets(self._parts[0], self._folds)
        warmed[self._mirrors.places] *= 0.5  # as the folds there are
        return self._gradient(
            self._measured(x), self._shares.couples(warmed / thickness), np.zeros_like(self._rest_squares)
        )

    def anchored(self, mesh: TriangleMesh) -> Self:
        """The same energy with clamped edges that keep the slope of another mesh than that at rest."""
        folds, count = self._folds, len(mesh.vertices)
        start, end, apex, _ = folds.hinges[folds.hinges[:, 3] >= count].T
        other = copy.copy(self)
        other._anchor = mesh
        other._folds = replace(folds, ghosts=mirror_images(mesh.vertices, start, end, apex))
        return other

    def with_rest_angles(self, angles: Array) -> Self:
        """The same energy with ``angles`` (H,) [rad] added to the rest angles of the mesh's hinges."""
        other = copy.copy(self)
        other._plastic = angles if self._plastic is None else self._plastic + angles
        other._rest_angles = self._rest_angles + self._folds.sources.T @ angles
        return other

    def fold_couples(self, x: Array, hinges: Index) -> Array:
        """Derivatives (C,) [N m] of the energy at ``x`` by the fold angles of some hinges of the mesh."""
        return self._folds.of_hinges(self._shares.couples(self._measured(x).folds))[hinges]

    def fold_stiffness(self, hinges: Index) -> Array:
        """Derivatives (C, C) [N m/rad] of these couples by those angles."""
        own = self._folds.sources[hinges]
        return np.asarray(own @ self._shares.couples(own.T.toarray()))

    def rest_angle_pulls(self, x: Array, hinges: Index) -> Array:
        """Derivatives (C, n, 3) [N/rad] of the gradient at ``x`` by the rest angles of some hinges of the mesh."""
        state, none = self._measured(x), np.zeros_like(self._rest_squares)
        couples = self._shares.couples(self._folds.sources[hinges].T.toarray()).T
        return -np.stack([self._gradient(state, np.ascontiguousarray(own), none) for own in couples])
