"""Linear buckling: load factors at which the stresses of the linear solution cancel the stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy.linalg
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike

from modalshell.brief import brief
from modalshell.checks import checked_count, checked_kind
from modalshell.errors import LoadError, OptionError, SolverError
from modalshell.loads import Load
from modalshell.modes import Factor, Factoriser, condensed_factor
from modalshell.modes.rigid import left_free
from modalshell.sharing import ReadOnlyArrays, read_only
from modalshell.shell import GAUSS_NEWTON, MIXED, Shell
from modalshell.typing import Array

ADVICE = (
    "the load is beyond the shell's linear buckling load: it may snap, which this model cannot follow; "
    "modalshell advise names a model of a scene that does"
)
_DENSE_BELOW = 60
"""Unknowns up to which a dense solver finds all factors."""
_RESTARTS = 60
"""Restarts of Lanczos, within which factors converge that stand apart from the shapes that never buckle."""
_NONE = 1e-9
"""Inverse of a factor, as a share of the largest one, below which it is rounding."""


@final
@brief
@dataclass(frozen=True)
class Buckling(ReadOnlyArrays):
    """Linear buckling of a shell under a load.

    Attributes
    ----------
    factors : ndarray, shape (k,)
        Multiples of the load at which the shell buckles, ascending, all positive; none where it never does.
    modes : ndarray, shape (3n, k)
        Shapes in which it does, of largest displacement 1.
    """

    factors: Array
    modes: Array


def buckling_factors(
    shell: Shell,
    count: int = 1,
    *,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
) -> Buckling:
    """The lowest factors by which a load buckles a shell, by linear theory.

    Solves ``(K + lambda K_g) phi = 0``, K the stiffness at rest and K_g the geometric stiffness under the stresses of
    the linear answer [bathe1996, section 6.8.2]. That is exact where the shell hardly moves before it buckles; where it
    bends first, follow :func:`modalshell.equilibrium_path`. There may be fewer factors than asked for: of a load that
    pulls, none.

    Parameters
    ----------
    shell : Shell
        A shell that its supports hold.
    count : int
        Number of factors k at most.
    gravity, force, loads
        The load, as in :meth:`Model.equilibrium`; loads that follow the shell count as they are at rest.

    Raises
    ------
    LoadError
        For a load of the wrong shape, not finite, or of no force on what can move.
    OptionError
        For a ``count`` that is none, or a shell that its supports leave free.
    SolverError
        If the stiffness at rest cannot be factorised, or the factors do not converge.
    """
    count = checked_count("count", count)
    checked_kind("shell", shell, Shell)
    load = shell.total_load(gravity, force, loads)
    if not shell.unknowns.restrict(load.ravel()).any():
        raise LoadError("buckling needs a load on what the supports leave free (got none)")
    if loose := left_free(shell):
        raise OptionError(f"buckling needs a shell that its supports hold, but {loose}: hold more vertices")
    rest, unknowns, pattern = shell.rest_positions, shell.unknowns, shell.pattern
    stiffness = shell.energy_gradient_hessian(rest, GAUSS_NEWTON)[2]
    factor = _definite_factor(shell, stiffness)
    if factor is None:
        raise SolverError("the stiffness at rest is not positive definite: check the mesh for slivers")
    geometric = pattern.matrix(_loaded(shell, factor, load) - stiffness)
    size = unknowns.count

    def softening(values: Array) -> Array:
        return -np.asarray(unknowns.restrict(geometric @ unknowns.prolong(values)))

    def resisting(values: Array) -> Array:
        return np.asarray(unknowns.restrict(pattern.product(stiffness, unknowns.prolong(values))))

    wanted = min(count, size)
    if size <= max(_DENSE_BELOW, 3 * wanted):
        identity = np.eye(size)
        left, right = softening(identity), resisting(identity)
        inverses, vectors = scipy.linalg.eigh(0.5 * (left + left.T), 0.5 * (right + right.T))
    else:
        operator, mass, inverse = (
            spla.LinearOperator((size, size), matvec=product, dtype=np.float64)
            for product in (softening, resisting, factor.solve)
        )
        start = np.random.default_rng(0).standard_normal(size)
        try:
            inverses, vectors = spla.eigsh(
                operator, k=wanted, M=mass, Minv=inverse, which="LA", v0=start, ncv=min(size, 2 * wanted + 20),
                maxiter=_RESTARTS,
            )  # fmt: skip
        except spla.ArpackNoConvergence as error:
            # Shapes that the load does not soften crowd about zero, which Lanczos does not tell apart.
            inverses, vectors = np.real(error.eigenvalues), np.real(error.eigenvectors).reshape(size, -1)
        except spla.ArpackError as error:
            raise SolverError(f"the buckling factors did not converge: {error}") from error
    order = np.argsort(-inverses)[:wanted]
    order = order[inverses[order] > _NONE * np.abs(inverses).max(initial=0.0)]
    modes = np.asarray(unknowns.prolong(vectors[:, order]))
    modes /= np.linalg.norm(modes.reshape(len(rest), 3, order.size), axis=1).max(axis=0, initial=1e-300)
    return Buckling(read_only(1.0 / inverses[order]), read_only(modes))


def buckles(shell: Shell, load: Array) -> bool:
    """Whether the stresses of the linear answer to ``load`` (n, 3) [N] make the stiffness at rest indefinite.

    Exact where the shell hardly moves before it snaps. Never said of a shell that its supports do not hold, or without
    a load.
    """
    if not (load.any() and shell.unknowns.supported.any()):
        return False
    factor = _definite_factor(shell, shell.energy_gradient_hessian(shell.rest_positions, GAUSS_NEWTON)[2])
    return factor is not None and _definite_factor(shell, _loaded(shell, factor, load)) is None


def _loaded(shell: Shell, factor: Factor, load: Array) -> Array:
    """Hessian values at rest with the stresses of the linear answer to a load (n, 3)."""
    rest, unknowns = shell.rest_positions, shell.unknowns
    answer = unknowns.prolong(factor.solve(unknowns.restrict(load.ravel()))).reshape(-1, 3)
    return shell.energy_gradient_hessian(rest, MIXED, shell.predicted_stresses(rest, answer))[2]


def _definite_factor(shell: Shell, data: Array) -> Factor | None:
    """Factor of a Hessian on the shell's pattern if it is positive definite."""
    try:
        factor = Factoriser().definite(shell.pattern.free_matrix(data))
    except SolverError:
        return None
    if not factor.is_definite():
        return None
    internal = shell.pattern.internal
    return condensed_factor(factor, 0 if internal is None else internal.count)
