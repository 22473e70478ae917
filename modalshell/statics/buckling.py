"""Linear buckling: load factors at which the stresses of the linear solution cancel the stiffness."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, final

import numpy as np
import scipy.linalg
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_count, checked_kind
from modalshell.core.errors import LoadError, ModalShellWarning, OptionError, SolverError
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import ReadOnlyArrays, read_only
from modalshell.core.typing import Array
from modalshell.loads import Load
from modalshell.modes import Factor, Factoriser, condensed_factor
from modalshell.modes.resolution import unresolved_remark
from modalshell.modes.rigid import left_free
from modalshell.modes.settled import distance_from_balance
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED, Shell
from modalshell.statics.live_loads import LiveLoads

ADVICE = (
    "the load is beyond the shell's linear buckling load: it may snap, which this model cannot follow; "
    "modalshell advise names a model of a scene that does"
)
_DENSE_BELOW = 60
"""Unknowns up to which a dense solver finds all factors."""
_RESTARTS = 60
"""Number of Lanczos restarts, enough for factors separate from those of shapes that never buckle."""
_LATER_RESTARTS, _ROUGHLY, _FINELY, _WIDER_BASIS = 15, 1e-2, 1e-6, 4
"""Where those are not enough: restarts, tolerances that tell whether there are factors, and of these, and by how much
more Lanczos vectors."""
_MORE = 6
"""Number of additional eigenvalues of an unsymmetric problem, since complex ones are discarded."""
_REAL = 1e-6
"""Share of an eigenvalue up to which its imaginary part is rounding."""
_Pairs = tuple[NDArray[Any], NDArray[Any]]
"""Eigenvalues (k,) and vectors (N, k), real or complex."""
_NONE = 1e-9
"""Inverse of a factor, as a share of the largest one, below which it is rounding."""


@final
@short_repr
@dataclass(frozen=True)
class Buckling(ReadOnlyArrays):
    """Linear buckling of a shell under a load.

    Attributes
    ----------
    factors : ndarray, shape (k,)
        Multiples of the load at which the shell buckles, ascending, all positive; none where it never does.
    modes : ndarray, shape (3n, k)
        Shapes in which it does, of largest displacement 1.
    conservative : bool
        Whether the load has a potential. Without one a shell may flutter below every factor, which linear buckling does
        not see: ``stable`` of an equilibrium does.
    displacements : ndarray, shape (k,)
        Largest displacement of the linear answer at each factor [m]: where it is not small against the shell, the shell
        bends before it buckles, and the factor means nothing.
    """

    factors: Array
    modes: Array
    conservative: bool = True
    displacements: Array = field(default_factory=lambda: np.empty(0))


def buckling_factors(
    shell: Shell,
    count: int = 1,
    *,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
) -> Buckling:
    """The lowest factors by which a load buckles a shell, by linear theory.

    Solves ``(K + lambda (K_g + K_f)) phi = 0`` (theory 8, eq. 7), K the stiffness at rest, with the stresses that a
    prestrain or a temperature has caused there, K_g the geometric stiffness under those of the linear answer
    [bathe1996, section 6.8.2], and K_f that of loads that follow the shell, unsymmetric where they have no potential.
    That is exact where the shell hardly moves before it buckles; where it
    bends first, follow :func:`modalshell.equilibrium_path`. There may be fewer factors than asked for: of a load that
    pulls, none.

    Parameters
    ----------
    shell : Shell
        A shell that its supports hold.
    count : int
        Number of factors k at most.
    gravity, force, loads : optional
        The load, as in :meth:`Model.equilibrium`; loads of time count as they are at time 0.

    Returns
    -------
    Buckling
        Load factors and mode shapes. A ModalShellWarning names shapes with fewer than four edges of the mesh a half
        wave, and a shell that bends farther than its own extent before the lowest factor.

    Raises
    ------
    LoadError
        For a load of the wrong shape, not finite, or of no force on what can move.
    OptionError
        For an invalid ``count``, a shell that its supports leave free, or one whose own stresses are in no equilibrium.
    SolverError
        If the stiffness at rest cannot be factorised, own stresses buckle the shell, or the factors do not converge.
    """
    count = checked_count("count", count)
    checked_kind("shell", shell, Shell)
    loading = shell.loading(gravity, force, loads)
    load = loading.force(shell.rest_positions)
    if not shell.unknowns.restrict(load.ravel()).any():
        raise LoadError("buckling needs a load on what the supports leave free (got none)")
    if loose := left_free(shell):
        raise OptionError(f"buckling needs a shell that its supports hold, but {loose}: hold more vertices")
    rest, unknowns, pattern = shell.rest_positions, shell.unknowns, shell.pattern
    stiffness, factor = _at_rest(shell)
    answer = _linear_answer(shell, factor, load)
    softer = _loaded(shell, answer) - stiffness
    LiveLoads(loading).add_stiffness(pattern, rest, softer)
    geometric = pattern.matrix(softer)
    size = unknowns.count

    def softening(values: Array) -> Array:
        return -np.asarray(unknowns.restrict(geometric @ unknowns.prolong(values)))

    def resisting(values: Array) -> Array:
        return np.asarray(unknowns.restrict(pattern.product(stiffness, unknowns.prolong(values))))

    wanted = min(count, size)
    find = _inverses if loading.conservative else _general_inverses
    inverses, vectors = find(softening, resisting, factor, size, wanted)
    order = np.argsort(-inverses)[:wanted]
    order = order[inverses[order] > _NONE * np.abs(inverses).max(initial=0.0)]
    modes = np.asarray(unknowns.prolong(vectors[:, order]))
    modes /= np.linalg.norm(modes.reshape(len(rest), 3, order.size), axis=1).max(axis=0, initial=1e-300)
    if remark := unresolved_remark(shell.mesh, modes, "buckling mode", "load factors"):
        warnings.warn(remark, ModalShellWarning, stacklevel=2)
    factors = 1.0 / inverses[order]
    moved = factors * np.linalg.norm(answer, axis=1).max()
    found = Buckling(read_only(factors), read_only(modes), loading.conservative, read_only(moved))
    if bent := bent_remark(shell, found):
        warnings.warn(bent, ModalShellWarning, stacklevel=2)
    return found


def bent_remark(shell: Shell, found: Buckling) -> str | None:
    """A remark where the linear answer at the lowest factor is larger than the shell, which bends before; else None."""
    share = float(found.displacements.min(initial=np.inf)) / shell.mesh.extent
    if not 1.0 < share < np.inf:
        return None
    return (
        f"linear theory does not hold at the lowest factor, {found.factors[0]:.4g}: by it the shell moves {share:.3g} "
        "times its own extent there. It bends and does not buckle; modalshell path (ms.equilibrium_path) follows it"
    )


def _at_rest(shell: Shell) -> tuple[Array, Factor]:
    """Hessian values at rest and their factor; an error where the shell is in no stable equilibrium there."""
    if shell.crease_state is not None and shell.crease_state.angles.any():
        shell.refuse_creases("linear buckling of a folded shell")
    if shell.stressed and (off := distance_from_balance(shell, Factoriser())) is not None:
        raise OptionError(
            "buckling needs a shell without stress at rest, or in equilibrium (got one of a prestrain, rest_curvature, "
            f"temperature or rest, of which Newton's first step is {off:.3g} m): let it come to rest first, "
            "shell.settled(ms.DiscreteShell(shell).equilibrium().positions)"
        )
    stiffness = _unloaded(shell)
    factor = _definite_factor(shell, stiffness)
    if factor is not None:
        return stiffness, factor
    if shell.stressed:
        raise SolverError("the shell is not stable under its own stresses: it buckles without a load already")
    raise SolverError("the stiffness at rest is not positive definite: check the mesh for slivers")


def _inverses(
    softening: Callable[[Array], Array], resisting: Callable[[Array], Array], factor: Factor, size: int, wanted: int
) -> tuple[Array, Array]:
    """Largest ``1 / lambda``, and vectors, of a load with a potential: the problem is symmetric."""
    if size <= max(_DENSE_BELOW, 3 * wanted):
        identity = np.eye(size)
        left, right = softening(identity), resisting(identity)
        try:
            values, vectors = scipy.linalg.eigh(0.5 * (left + left.T), 0.5 * (right + right.T))
        except scipy.linalg.LinAlgError as error:
            raise SolverError(
                "the stiffness at rest is singular to rounding, so that there is nothing to soften: hold more "
                "vertices, or give a material that resists shear"
            ) from error
        return np.asarray(values), np.asarray(vectors)
    operator, mass, inverse = (
        spla.LinearOperator((size, size), matvec=product, dtype=np.float64)
        for product in (softening, resisting, factor.solve)
    )
    start = np.random.default_rng(0).standard_normal(size)

    def solve(tolerance: float, vectors: int, restarts: int) -> _Pairs:
        found: _Pairs = spla.eigsh(
            operator, k=wanted, M=mass, Minv=inverse, which="LA", v0=start, ncv=min(size, vectors), maxiter=restarts,
            tol=tolerance,
        )  # fmt: skip
        return found

    values, vectors = _largest(solve, 2 * wanted + 20)
    return np.real(values), np.real(vectors).reshape(size, -1)


def _largest(solve: Callable[[float, int, int], _Pairs], vectors: int) -> _Pairs:
    """Eigenvalues and vectors by ``solve``, of a tolerance, a number of Lanczos vectors and one of restarts.

    Shapes that the load does not soften crowd about zero, which Lanczos does not tell apart: of those it finds none. A
    cylinder under an axial load has its first factors crowded instead, which a wider basis finds, to :data:`_FINELY`.
    """
    try:
        try:
            return solve(0.0, vectors, _RESTARTS)
        except spla.ArpackNoConvergence as error:
            found = error.eigenvalues, error.eigenvectors
        try:
            rough = solve(_ROUGHLY, vectors, _LATER_RESTARTS)[0]
        except spla.ArpackNoConvergence:
            return found
        try:
            return solve(_FINELY, _WIDER_BASIS * vectors, _LATER_RESTARTS)
        except spla.ArpackNoConvergence as error:
            about = 1.0 / np.real(rough).max()
            raise SolverError(
                f"the buckling factors lie too close together to be separated: the lowest is about {about:.3g}; ask "
                "for another count, or take a coarser mesh"
            ) from error
    except spla.ArpackError as error:
        raise SolverError(f"the buckling factors did not converge: {error}") from error


def _general_inverses(
    softening: Callable[[Array], Array], resisting: Callable[[Array], Array], factor: Factor, size: int, wanted: int
) -> tuple[Array, Array]:
    """Real ones among the largest inverses of factors (k,), and shapes (N, k), of an unsymmetric softening."""
    if size <= max(_DENSE_BELOW, 3 * (wanted + _MORE)):
        identity = np.eye(size)
        inverses, vectors = scipy.linalg.eig(softening(identity), resisting(identity))
    else:
        operator = spla.LinearOperator(
            (size, size), matvec=lambda y: factor.solve(softening(y.ravel())), dtype=np.float64
        )
        start, most = np.random.default_rng(0).standard_normal(size), min(wanted + _MORE, size - 2)

        def solve(tolerance: float, vectors: int, restarts: int) -> _Pairs:
            found: _Pairs = spla.eigs(
                operator, most, which="LR", v0=start, ncv=min(size, vectors), maxiter=restarts, tol=tolerance
            )
            return found

        inverses, vectors = _largest(solve, 2 * most + 20)
        vectors = vectors.reshape(size, -1)
    real = np.abs(inverses.imag) <= _REAL * np.abs(inverses)
    shapes = [(one / one[np.argmax(np.abs(one))]).real for one in vectors[:, real].T]
    return inverses[real].real, np.array(shapes).reshape(-1, size).T


def buckles(shell: Shell, load: Array) -> bool:
    """Whether a ``load`` (n, 3) [N] is beyond a shell's linear buckling load; see :class:`BucklingCheck`."""
    return BucklingCheck(shell).buckles(load)


@final
class BucklingCheck:
    """Whether the stresses of linear answers make a shell's stiffness at rest indefinite, whose factor is kept.

    Exact where the shell hardly moves before it snaps. Never said of a shell that its supports do not hold, or without
    a load.

    Parameters
    ----------
    shell : Shell
        The shell.
    """

    def __init__(self, shell: Shell) -> None:
        self._shell = shell

    @cached_property
    def _at_rest(self) -> Factor | None:
        return _definite_factor(self._shell, _unloaded(self._shell))

    def buckles(self, load: Array, held: Shell | None = None) -> bool:
        """Whether a ``load`` (n, 3) [N] does; of the same shell ``held`` by further supports, if it is given."""
        shell = self._shell
        held = held or shell  # its supports may clamp patches, whose slopes have entries then
        if not (load.any() and shell.unknowns.supported.any()):
            return False
        factor = self._at_rest
        if factor is None:
            return False
        with np.errstate(over="ignore", invalid="ignore"):  # absurd loads are beyond it
            loaded = _loaded(held, _linear_answer(shell, factor, load))
        return not np.isfinite(loaded).all() or _definite_factor(held, loaded) is None


def _unloaded(shell: Shell) -> Array:
    """Hessian values at rest: with the stresses that a shell has there, which no load factor multiplies."""
    return shell.hessian(shell.rest_positions, EXACT if shell.stressed else GAUSS_NEWTON)


def _linear_answer(shell: Shell, factor: Factor, load: Array) -> Array:
    """Displacements (n, 3) [m] of linear theory under a load (n, 3) [N]."""
    unknowns = shell.unknowns
    return np.asarray(unknowns.prolong(factor.solve(unknowns.restrict(load.ravel())))).reshape(-1, 3)


def _loaded(shell: Shell, answer: Array) -> Array:
    """Hessian values at rest with the stresses of the linear answer (n, 3) [m] to a load."""
    rest = shell.rest_positions
    return shell.hessian(rest, MIXED, shell.predicted_stresses(rest, answer))


def _definite_factor(shell: Shell, data: Array) -> Factor | None:
    """Factor of a Hessian on the shell's pattern if it is positive definite."""
    try:
        factor = Factoriser().definite(shell.pattern.free_matrix(data))
    except SolverError:
        return None
    if not factor.is_definite():
        return None
    return condensed_factor(factor, shell.pattern.internal_count)
