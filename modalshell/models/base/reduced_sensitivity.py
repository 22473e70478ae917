"""Derivatives of equilibria in few coordinates: of modal models, reduced energies and trained ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.errors import OptionError, SolverError
from modalshell.core.slope import slope
from modalshell.core.typing import Array
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.modal_motion import ModalMotion
from modalshell.models.base.sensitivity import (
    LOADS,
    checked_constant,
    checked_names,
    checked_state,
    checked_weights,
    load_rates,
)
from modalshell.modes.derivatives import span_slope
from modalshell.modes.modal_rotation import rotation_matrix
from modalshell.shell import Shell

_CONDITION = 1e14
_OTHERS = (*LOADS, "rest_angles")
"""What is no constant of the material."""
_TURN = 1e-3
"""Turn [rad] over which displacements are differenced."""


class ReducedTangent(ABC):
    """What a parameter does to an equilibrium in coordinates q (r,)."""

    shell: Shell
    state: Equilibrium

    @abstractmethod
    def tangent(self) -> Array:
        """Derivative (r, r) of the out-of-balance force by the coordinates."""

    @abstractmethod
    def reduced_forces(self, load: Array) -> Array:
        """Generalised forces (r, k) of changes of the load (n, 3, k)."""

    @abstractmethod
    def by_constant(self, name: str) -> Array:
        """Generalised force (r,) of a change of a constant, without that of the load."""

    def by_rest_angles(self) -> Array:
        """Generalised forces (r, H) of changes of the rest angles."""
        raise OptionError("this model has no derivative by rest angles: take DS")

    @abstractmethod
    def forward(self, rates: Array, name: str) -> Array:
        """Derivatives (n, 3, k) of the positions by a parameter, from those of the coordinates (r, k)."""

    @abstractmethod
    def adjoint(self, weights: Array, rates: Array, name: str) -> Array:
        """Derivatives (k,) of a scalar whose derivatives by the positions are ``weights`` (n, 3)."""

    def by_force(self, weights: Array | None, solved: Array) -> Array:
        """Derivative by the force on every vertex, with the tangent's inverse (r, r)."""
        raise OptionError("wrt='force' has no derivative here (got 'force'): take 'load' or 'gravity'")

    def derivative(self, wrt: str | Sequence[str], of: ArrayLike | None) -> Array:
        """Derivatives (n, 3, k), or (k,) with ``of``."""
        names, weights = checked_names(wrt), checked_weights(of, self.shell)
        for name in names:
            if name == "supports":
                raise OptionError("the span of a reduced model ends at its supports where they are: take DS")
            if name not in _OTHERS:
                checked_constant(self.shell, name, _OTHERS)
        tangent = self.tangent()
        if not np.linalg.cond(tangent) < _CONDITION:
            raise SolverError("the tangent of the equilibrium is singular, so that it has no derivatives")
        found = []
        for name in names:
            if name == "force":
                found.append(self.by_force(weights, np.asarray(np.linalg.inv(tangent), dtype=np.float64)))
                continue
            if name == "rest_angles":
                forces = self.by_rest_angles()
            else:
                forces = self.reduced_forces(load_rates(self.shell, self.state, name))
                if name not in LOADS:
                    forces = forces + self.by_constant(name)[:, None]
            rates = np.asarray(np.linalg.solve(tangent, forces), dtype=np.float64)
            found.append(self.forward(rates, name) if weights is None else self.adjoint(weights, rates, name))
        return np.concatenate(found, axis=-1)


def dead_state(state: Equilibrium) -> tuple[Array, Array]:
    """Coordinates (r,) and dead load (n, 3) of a converged state; OptionError for any other."""
    loading = checked_state(state).loading
    assert loading is not None
    if state.coordinates is None or state.coordinates.ndim != 1:
        raise OptionError(f"state must be one of this model's coordinates (got {state.message or 'positions alone'})")
    if loading.live:
        raise OptionError("reduced models have derivatives under dead loads alone: take DS for loads that follow")
    return state.coordinates, loading.dead


def gradients_by_rest_angles(shell: Shell, x: Array, fields: Array) -> Array:
    """Derivatives (r, H) of the gradient at ``x`` (n, 3) along ``fields`` (3n, r) by every hinge's rest angle."""
    steps = np.ascontiguousarray(fields.T).reshape(-1, *x.shape)
    return np.stack([shell.elastic_energy.pulled_by_rest_angles(x, step) for step in steps])


@final
class ModalTangent(ReducedTangent):
    """The tangent of a modal model, whose displacements are a function of the linear ones ``Phi q``.

    A change of the modes therefore adds to Phi q what further modes would: derivatives come from the same model on a
    basis that has the modes' derivatives after them.
    """

    def __init__(self, model: ModalMotion, state: Equilibrium) -> None:
        self._q, self._load = dead_state(state)
        self.shell, self.state, self._model = model.shell, state, model
        self._further: dict[str, tuple[ModalMotion, Array]] = {}

    def tangent(self) -> Array:
        """``Lambda - dp/dq``; rigid modes stay at zero."""
        rigid = self._model.basis.rigid_modes
        matrix = np.diag(self._model.basis.eigenvalues) - self._model.modal_force_jacobian(self._q, self._load)
        matrix[:rigid] = matrix[:, :rigid] = 0.0
        matrix[np.arange(rigid), np.arange(rigid)] = float(np.abs(np.diagonal(matrix)).mean())
        return np.asarray(matrix)

    def reduced_forces(self, load: Array) -> Array:
        """Modal forces of the elastic modes."""
        forces = [self._model.modal_force(self._q, np.ascontiguousarray(load[:, :, k])) for k in range(load.shape[2])]
        return self._elastic(np.stack(forces, axis=1))

    def by_constant(self, name: str) -> Array:
        """``(dPhi . dp/dPhi) - dLambda q``."""
        further, stiffness = self._extended(name)
        count, still = self._q.size, np.concatenate([self._q, np.zeros_like(self._q)])
        slope = further.modal_force_jacobian(still, self._load)[:count, count:] @ self._q
        return self._elastic(further.modal_force(still, self._load)[count:] + slope - stiffness @ self._q)

    def by_rest_angles(self) -> Array:
        """Those of the linear couples, at rest, in the frame of the modes' own elastic forces."""
        return self._elastic(-gradients_by_rest_angles(self.shell, self.shell.rest_positions, self._model.basis.modes))

    def forward(self, rates: Array, name: str) -> Array:
        """Differences of fourth order of the displacement along the rates, or the coordinates if these are fewer."""
        if name in _OTHERS and rates.shape[1] > self._q.size:
            return (self._columns() @ rates).reshape(*self.shell.rest_positions.shape, -1)
        return np.stack([self._along(*self._directed(rate, name)) for rate in rates.T], axis=2)

    def adjoint(self, weights: Array, rates: Array, name: str) -> Array:
        """By the gradient of the weights' work, which is exact."""
        parts = [self._directed(rate, name) for rate in rates.T]
        model, q, _ = parts[0]
        return np.stack([direction for _, _, direction in parts]) @ model.displacement_gradient(q, weights)

    def by_force(self, weights: Array | None, solved: Array) -> Array:
        """The compliance, by the symmetry of models that have a potential."""
        if not self._model.conservative:
            raise OptionError("wrt='force' needs a modal force with a potential: take consistent_force=True")
        solved = self._elastic(self._elastic(solved).T).T
        if weights is not None:
            rate = solved.T @ self._model.displacement_gradient(self._q, weights)
            return self._along(self._model, self._q, rate).ravel()
        columns = self._columns()
        return (columns @ solved @ columns.T).reshape(*self.shell.rest_positions.shape, -1)

    def _columns(self) -> Array:
        """Derivatives (3n, m) of the displacements by the coordinates."""
        return np.stack([self._along(self._model, self._q, unit).ravel() for unit in np.eye(self._q.size)], axis=1)

    def _elastic(self, rows: Array) -> Array:
        rows = rows.copy()
        rows[: self._model.basis.rigid_modes] = 0.0
        return rows

    def _directed(self, rate: Array, name: str) -> tuple[ModalMotion, Array, Array]:
        """Model, coordinates, and direction in which a parameter moves them."""
        if name in _OTHERS:
            return self._model, self._q, rate
        still = np.concatenate([self._q, np.zeros_like(self._q)])
        return self._extended(name)[0], still, np.concatenate([rate, self._q])

    def _along(self, model: ModalMotion, q: Array, direction: Array) -> Array:
        turn = np.abs(model.basis.rotations @ direction).max()
        return slope(model.raw_displacement, q, direction, _TURN / max(float(turn), 1e-300))

    def _extended(self, name: str) -> tuple[ModalMotion, Array]:
        """The model on the modes and their derivatives by a constant, and the derivative of the stiffness on them."""
        if name not in self._further:
            basis, unknowns = self._model.basis, self.shell.unknowns
            slope = span_slope(basis, name)
            rotations = unknowns.turns(np.asarray(rotation_matrix(self.shell.mesh) @ slope.modes))
            whole = replace(
                basis,
                eigenvalues=np.tile(basis.eigenvalues, 2),
                modes=np.hstack([basis.modes, slope.modes]),
                rotations=np.hstack([basis.rotations, rotations]),
            )
            self._further[name] = self._model.on_basis(whole), slope.stiffness
        return self._further[name]


@final
class LinearTangent(ReducedTangent):
    """The tangent of a model whose positions are linear in its coordinates.

    ``hessian`` (r, r) is the potential's, exact; ``columns`` (3n, r) are the derivatives of the positions by the
    coordinates, and ``reduced`` (3n, r) takes a force to a generalised one. ``by_constant`` gives the derivative (r,)
    of the elastic force by a constant, ``by_rest_angles`` its derivatives (r, H).
    """

    def __init__(
        self,
        shell: Shell,
        state: Equilibrium,
        hessian: Array,
        columns: Array,
        reduced: Array,
        by_constant: Callable[[str], Array],
        by_rest_angles: Callable[[], Array] | None = None,
    ) -> None:
        self.shell, self.state = shell, state
        self._hessian, self._columns, self._reduced = hessian, columns, reduced
        self._by_constant, self._by_rest_angles = by_constant, by_rest_angles

    def tangent(self) -> Array:
        """The Hessian."""
        return self._hessian

    def reduced_forces(self, load: Array) -> Array:
        """Reduced forces."""
        return np.asarray(self._reduced.T @ load.reshape(len(self._reduced), -1))

    def by_constant(self, name: str) -> Array:
        """Derivative of the elastic force."""
        return np.zeros(len(self._hessian)) if name == "density" else self._by_constant(name)

    def by_rest_angles(self) -> Array:
        """Derivatives of the elastic force."""
        return super().by_rest_angles() if self._by_rest_angles is None else self._by_rest_angles()

    def forward(self, rates: Array, name: str) -> Array:
        """Product with the columns."""
        return np.asarray(self._columns @ rates).reshape(*self.shell.rest_positions.shape, -1)

    def adjoint(self, weights: Array, rates: Array, name: str) -> Array:
        """Product with the weighted columns."""
        return np.asarray((weights.ravel() @ self._columns) @ rates)

    def by_force(self, weights: Array | None, solved: Array) -> Array:
        """The compliance on the span."""
        if weights is not None:
            return np.asarray(self._reduced @ (solved.T @ (weights.ravel() @ self._columns)))
        return (self._columns @ solved @ self._reduced.T).reshape(*self.shell.rest_positions.shape, -1)
