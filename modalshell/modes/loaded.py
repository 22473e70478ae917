"""Small vibrations about a loaded state."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Protocol, final

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike

from modalshell.core.checks import finite_answer
from modalshell.core.errors import ModalShellWarning, OptionError, SolverError
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array
from modalshell.loads.applied import BodyForm
from modalshell.modes.derivatives import VibrationModes
from modalshell.modes.eigenpairs import canonical_pairs, dense_pairs, lanczos_pairs, mass_scaled
from modalshell.modes.factorisation import Factoriser, condensed_factor
from modalshell.modes.flutter import complex_among
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.modes.unsymmetric import general_factor
from modalshell.shell import EXACT, Shell
from modalshell.shell.pattern import SparsePattern

_GYROSCOPIC = 0.01
"""Change of a frequency by Coriolis forces, as a share, that is worth a warning."""
_DENSE_BELOW = 150
"""Unknowns up to which a dense solver finds all eigenpairs."""


class State(Protocol):
    """An equilibrium."""

    @property
    def positions(self) -> Array:
        """Vertex positions (n, 3) [m]."""

    @property
    def conservative(self) -> bool:
        """Whether the load has a potential."""

    def load_stiffness(self, pattern: SparsePattern) -> Array:
        """Minus the derivatives of the load's forces, as entries of a Hessian."""


@final
@short_repr
@dataclass(frozen=True)
class LoadedModes(VibrationModes):
    """Small vibrations of a shell about a stable state.

    Attributes
    ----------
    shell : Shell
        The shell.
    positions : ndarray, shape (n, 3)
        The state [m].
    eigenvalues : ndarray, shape (m,)
        Squared angular frequencies [1/s^2], ascending.
    modes : ndarray, shape (3n, m)
        Mass-orthonormal displacements from the state, as supports allow them [1/sqrt(kg)]; under a load without a
        potential each is of length one in the norm of the mass, but they are not orthogonal.
    conservative : bool
        Whether the load has a potential.
    rigid_modes : int
        Zero: a stable state has no rigid motions.
    """

    shell: Shell
    positions: Array
    eigenvalues: Array
    modes: Array
    conservative: bool = True
    rigid_modes: int = 0


@final
class UnstableState(OptionError):
    """Vibrations were asked for about a state whose stiffness is not positive definite."""


def loaded_modes(shell: Shell, about: State | ArrayLike, count: int, backend: str | None) -> tuple[LoadedModes, int]:
    """The ``count`` lowest vibrations about a state, or positions (n, 3) [m]; see :func:`modalshell.solve_modes`.

    And how many of them are of eigenspaces that ``count`` does not cut.
    """
    given: Any = about
    _warn_of_what_is_left_out(given)
    found, whole = _about(shell, given, count, backend)
    _warn_of_coriolis(given, found)
    return found, whole


def _about(shell: Shell, given: Any, count: int, backend: str | None) -> tuple[LoadedModes, int]:
    """The vibrations, and how many of them are of eigenspaces that ``count`` does not cut."""
    state: State | None = given if hasattr(given, "load_stiffness") else None
    x = shell.checked_positions(getattr(given, "positions", given))
    unknowns = shell.unknowns
    if count > unknowns.count:
        raise OptionError(f"count must be at most {unknowns.count}, the number of free unknowns (got {count})")
    mass = unknowns.masses(shell.mass)
    data = shell.hessian(x, EXACT)
    if state is not None:
        data += state.load_stiffness(shell.pattern)
    if not np.isfinite(data).all():
        raise OptionError("about must be a stable state (got one whose stiffness is not finite)")
    if state is not None and not state.conservative:
        matrix = sps.csc_array(shell.pattern.free_matrix(data).T)  # its arrays are those of CSR
        values, vectors, whole = general_pairs(shell, matrix, count)
        modes = np.asarray(unknowns.prolong(vectors / np.sqrt(mass)[:, None]))
        return LoadedModes(shell, read_only(x.copy()), read_only(values), read_only(modes), conservative=False), whole
    root, none = np.sqrt(mass), np.empty((mass.size, 0))
    wanted = min(count + 1, mass.size)
    unstable = UnstableState(
        "about must be a stable state of a shell that its supports hold (got one about which the stiffness is not "
        "positive definite): see its stable and its converged; under loads that follow the shell, pass the equilibrium "
        "itself"
    )
    if mass.size <= max(_DENSE_BELOW, 3 * wanted):
        dense = np.asarray(mass_scaled(shell, data) @ np.eye(mass.size))
        dense = 0.5 * (dense + dense.T)
        if np.linalg.eigvalsh(dense)[0] <= 0.0:
            raise unstable
        values, vectors = dense_pairs(dense, none, wanted)
    else:
        try:
            solver = RigidFreeSolver(shell.pattern.free_matrix(data), none, mass, backend)
        except SolverError as error:
            raise unstable from error
        if not solver.factor.is_definite():
            raise unstable
        values, vectors = lanczos_pairs(solver, root, none, wanted)
    values, vectors, whole = canonical_pairs(shell, values, vectors, count)
    modes = np.asarray(unknowns.prolong(vectors / root[:, None]))
    finite_answer("the modes", values, modes)
    return LoadedModes(shell, read_only(x.copy()), read_only(values.copy()), read_only(modes)), whole


def _warn_of_what_is_left_out(about: Any) -> None:
    touching, held = np.any(getattr(about, "in_contact", False)), np.size(getattr(about, "constraint_residuals", ()))
    if touching or held:
        what, mend = ("contacts", "touches") if touching else ("constraints", "they hold")
        warnings.warn(
            f"about is a state under {what}, which vibrations about it leave out: the shell moves freely there; clamp "
            f"what {mend} in another shell to hold it",
            ModalShellWarning,
            stacklevel=4,
        )


def _warn_of_coriolis(about: Any, found: LoadedModes) -> None:
    """Say so where the Coriolis forces of a turning frame would change frequencies, by those of the modes' own span."""
    live, modes = getattr(getattr(about, "loading", None), "live", ()), found.modes
    turning = [(one.factor_at(0.0), one.form) for one in live if isinstance(one.form, BodyForm) and one.by_velocity]
    if not turning:
        return
    count, vectors = modes.shape[1], modes.reshape(-1, 3, modes.shape[1])
    felt = sum(factor * form.mass[:, None, None] * (form.by_velocity @ vectors) for factor, form in turning)
    gyroscopic = modes.T @ np.reshape(felt, modes.shape)
    system = np.block([[np.zeros((count, count)), np.eye(count)], [-np.diag(found.eigenvalues), -gyroscopic]])
    rates = np.sort(np.linalg.eigvals(system).imag)[-count:] / (2.0 * np.pi)
    worst = int(np.argmax(np.abs(rates / found.frequencies - 1.0)))
    if np.abs(rates / found.frequencies - 1.0)[worst] > _GYROSCOPIC:
        warnings.warn(
            "about is a state in a turning frame, whose Coriolis forces vibrations about it leave out: they would make "
            f"{rates[worst]:.4g} Hz of the {found.frequencies[worst]:.4g} Hz of mode {worst + 1}; take that of a "
            "motion of DS",
            ModalShellWarning,
            stacklevel=4,
        )


def general_pairs(shell: Shell, matrix: sps.csc_array, count: int) -> tuple[Array, Array, int]:
    """As :func:`canonical_pairs`, eigenvectors (N, m) of length one, of an unsymmetric stiffness over the mass.

    ``matrix`` is that of the free unknowns, with the internal ones after them.

    OptionError where one is complex or not positive: such a state flutters or drifts away.
    """
    mass = shell.unknowns.masses(shell.mass)
    factor = condensed_factor(general_factor(matrix, Factoriser()), shell.pattern.internal_count)
    root = np.sqrt(mass)

    def inverse(vector: Array) -> Array:
        return root * factor.solve(root * vector.ravel())

    if mass.size <= max(_DENSE_BELOW, 3 * count):
        inverses, vectors = np.linalg.eig(np.stack([inverse(unit) for unit in np.eye(mass.size)], axis=1))
    else:
        operator = spla.LinearOperator((mass.size, mass.size), matvec=inverse, dtype=np.float64)
        start = np.random.default_rng(0).standard_normal(mass.size)
        try:
            inverses, vectors = spla.eigs(operator, count + 1, which="LM", v0=start)
        except spla.ArpackError as error:
            raise SolverError(f"the modes about the state did not converge: {error}") from error
    order = np.argsort(-np.abs(inverses), kind="stable")[:count]
    inverses, vectors = inverses[order], vectors[:, order]
    if (inverses.real <= 0.0).any() or complex_among(inverses):
        raise OptionError(
            "about must be a stable state (got one that flutters or drifts away under its load, which has no "
            "potential): see its stable and its converged"
        )
    # Real ones, as the largest entry is; of a pair that hardly flutters one takes what is left, the imaginary part.
    turned = [(one / one[np.argmax(np.abs(one))], value) for one, value in zip(vectors.T, inverses, strict=True)]
    vectors = np.stack([one.imag if value.imag < 0.0 else one.real for one, value in turned], axis=1)
    vectors /= np.linalg.norm(vectors, axis=0)
    found = canonical_pairs(shell, 1.0 / inverses.real, vectors, count)
    finite_answer("the modes", *found[:2])
    return found
