"""Derivatives of eigenvalues and modes by a constant of the material [nelson1976; fox1968]."""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from modalshell.core.errors import OptionError, SolverError
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array
from modalshell.modes.eigenpairs import mass_scaled
from modalshell.modes.rigid import RigidFreeSolver, rigid_motions
from modalshell.shell import GAUSS_NEWTON, Shell
from modalshell.shell.energies_of import material_constants

_APART = 1e-5
"""Relative gap of eigenvalues below which their modes have no derivatives of their own."""
_MODE = 1e-4
"""Share of a vector by which it may differ from what one inverse iteration makes of it, and be a mode."""
_TOLERANCE = 1e-11
_ITERATIONS = 200
_ROUNDING = 1e-9
"""Share of a mode up to which its derivative outside the basis, times the constant, is rounding."""

Product = Callable[[Array], Array]


class VibrationModes(ReadOnlyArrays, ABC):
    """Modes (3n, m) of a shell with their eigenvalues (m,) [1/s^2], the first ones rigid."""

    shell: Shell
    eigenvalues: Array
    modes: Array
    rigid_modes: int

    @property
    def frequencies(self) -> Array:
        """Natural frequencies (m,) [Hz]."""
        return np.sqrt(self.eigenvalues) / (2.0 * np.pi)

    @property
    def count(self) -> int:
        """Number of modes m."""
        return int(self.eigenvalues.size)


@final
@short_repr
@dataclass(frozen=True)
class BasisSensitivity:
    """Derivatives of a basis by a constant of its material.

    Attributes
    ----------
    eigenvalues : ndarray, shape (m,)
        Of the eigenvalues [1/s^2 per unit of the constant].
    frequencies : ndarray, shape (m,)
        Of the natural frequencies [Hz per unit of the constant]; zero of rigid modes.
    modes : ndarray, shape (3n, m)
        Of the modes, mass-orthonormal as they are [1/sqrt(kg) per unit of the constant].
    """

    eigenvalues: Array
    frequencies: Array
    modes: Array


@final
@dataclass(frozen=True)
class SpanSlope:
    """Derivative of a basis up to a turn of its modes among themselves, which needs no gaps between them."""

    modes: Array
    """Of mass-orthonormal vectors that span what the modes span; shape (3n, m)."""
    stiffness: Array
    """Of the stiffness on these vectors; shape (m, m)."""


def span_slope(basis: VibrationModes, name: str) -> SpanSlope:
    """Derivative of the span of a basis by a constant.

    With ``dM = mu M``, the part outside the span solves ``(K - lambda_i M) y_i = -dK phi_i`` there, by conjugate
    gradients with one factor of K; inside it the vectors stay mass-orthonormal. OptionError for attachment vectors, a
    name that is no constant, or where ``count`` cut a repeated eigenvalue in two.
    """
    shell, unknowns = basis.shell, basis.shell.unknowns
    known = material_constants(shell.material)
    if name not in known:
        raise OptionError(f"wrt must be one of {', '.join(known)}, one number for the whole mesh (got {name!r})")
    fields = basis.modes.reshape(-1, 3, basis.count)
    rest = shell.rest_positions
    rates = [shell.rates_by_constant(name, rest, step) for step in np.ascontiguousarray(np.moveaxis(fields, 2, 0))]
    forces = np.asarray(unknowns.restrict(np.stack(rates, axis=2).reshape(rest.size, -1)))
    modes = np.asarray(unknowns.values(basis.modes))
    growth = 1.0 / known[name] if name in ("density", "thickness") else 0.0
    stiffness = modes.T @ forces
    stiffness = 0.5 * (stiffness + stiffness.T) - growth * np.diag(basis.eigenvalues)
    outside = _outside(basis, modes, forces, abs(known[name]) or 1.0) if np.abs(forces).any() else np.zeros_like(modes)
    return SpanSlope(np.asarray(unknowns.prolong(outside - 0.5 * growth * modes)), stiffness)


def basis_sensitivity(basis: VibrationModes, name: str) -> BasisSensitivity:
    """Derivatives of eigenvalues and modes by a constant; see :meth:`modalshell.Basis.sensitivity`."""
    if basis.shell.stressed:
        raise OptionError("derivatives of modes are those about a mesh without stress: build the shell without it")
    values, rigid = basis.eigenvalues, basis.rigid_modes
    gaps = np.diff(values[rigid:]) / values[rigid + 1 :] if values.size > rigid + 1 else np.ones(1)
    if gaps.min() < _APART:
        first = rigid + int(gaps.argmin())
        raise OptionError(
            f"modes {first} and {first + 1} share an eigenvalue ({values[first]:.6g} and {values[first + 1]:.6g} "
            "1/s^2), so that they have no derivatives of their own: break the symmetry of the mesh, or ask for fewer "
            "modes"
        )
    slope = span_slope(basis, name)
    # d phi_i inside the span: phi_j (phi_j . dK phi_i) / (lambda_i - lambda_j); rigid modes stay rigid.
    apart = values[None, :] - values[:, None]
    apart[:rigid, :rigid] = 1.0
    np.fill_diagonal(apart, 1.0)
    turns = slope.stiffness / apart
    np.fill_diagonal(turns, 0.0)
    turns[:rigid] = turns[:, :rigid] = 0.0
    rates = np.where(np.arange(values.size) < rigid, 0.0, np.diagonal(slope.stiffness))
    sizes = 4.0 * np.pi * np.sqrt(np.where(values > 0.0, values, 1.0))
    return BasisSensitivity(rates, rates / sizes, slope.modes + basis.modes @ turns)


def _outside(basis: VibrationModes, modes: Array, forces: Array, size: float) -> Array:
    """Solutions (N, m) of ``(K - lambda_i M) y_i = -forces_i`` that are mass-orthogonal to the modes (N, m)."""
    shell = basis.shell
    mass = shell.unknowns.masses(shell.mass)
    data = shell.hessian(shell.rest_positions, GAUSS_NEWTON)
    rigid = rigid_motions(shell)
    solver = RigidFreeSolver(shell.pattern.free_matrix(data), rigid, mass)
    root = np.sqrt(mass)
    for i in range(basis.rigid_modes, basis.count):
        again = basis.eigenvalues[i] * solver.solve(mass * modes[:, i])
        if np.linalg.norm(root * (again - modes[:, i])) > _MODE:
            raise OptionError(f"vector {i} of the basis is no mode: leave attachments out of solve_modes")
    scaled, known = mass_scaled(shell, data), root[:, None] * modes
    if rigid.shape[1] > basis.rigid_modes:
        known = np.linalg.qr(np.hstack([root[:, None] * rigid, known[:, basis.rigid_modes :]]))[0]

    def clear(vector: Array) -> Array:
        return np.asarray(vector - known @ (known.T @ vector))

    def solve(vector: Array) -> Array:
        return clear(root * solver.solve(root * vector))

    found = np.zeros_like(modes)
    for i in range(basis.rigid_modes, basis.count):
        value = float(basis.eigenvalues[i])
        push = clear(-forces[:, i] / root)
        if size * np.linalg.norm(solve(push)) <= _ROUNDING:
            continue

        def product(vector: Array, value: float = value) -> Array:
            return clear(scaled @ vector - value * vector)

        solution = _conjugate_gradients(product, solve, push)
        if solution is None:
            raise SolverError(
                f"the derivative of mode {i} was not found: the next eigenvalue above the basis is (nearly) the same; "
                "ask for more modes or for fewer"
            )
        found[:, i] = solution / root
    return found


def _conjugate_gradients(product: Product, precondition: Product, push: Array) -> Array | None:
    """Solution (N,) of ``A x = push``; the residual counts as the preconditioner sees it. None without convergence."""
    solution, residual = np.zeros_like(push), push.copy()
    step = seen = precondition(residual)
    first = last = float(residual @ seen)
    for _ in range(_ITERATIONS):
        moved = product(step)
        curvature = float(step @ moved)
        if not curvature > 0.0:
            return None
        solution += last / curvature * step
        residual -= last / curvature * moved
        seen = precondition(residual)
        now = float(residual @ seen)
        if now <= _TOLERANCE**2 * first:
            return solution
        step, last = seen + now / last * step, now
    return None
