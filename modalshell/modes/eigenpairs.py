"""Lowest eigenpairs of K phi = lambda M phi by shift-invert Lanczos [choi2007, eq. 6-7]."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import scipy.linalg
import scipy.sparse as sps
import scipy.sparse.linalg as spla

from modalshell.core.checks import finite_answer
from modalshell.core.errors import REPAIR, OptionError, SolverError
from modalshell.core.typing import Array
from modalshell.modes.block_lanczos import BLOCK, largest_pairs
from modalshell.modes.rigid import RigidFreeSolver, rigid_motions, six_motions
from modalshell.shell import GAUSS_NEWTON, Shell

_DENSE_BELOW = 150
"""Unknowns up to which a dense solver finds all eigenpairs."""
_REPEATED = 1e-9
"""Relative gap below which eigenvalues count as repeated; others keep their own modes."""

_RESIDUAL_LIMIT = 1e-8
"""Residual over |K| |phi| above which a mode is refused."""
_ILL_CONDITIONED = (
    "the stiffness is too ill-conditioned: take needles (aspects of 1e4 and more) away, as "
    f"{REPAIR} does, or make the stiffnesses more alike"
)
_AGREEMENT = 0.05
"""Relative difference between an eigenvalue and its mode's strain energy from which the mode is rounding."""
_FALSE_STIFFNESS = 0.5
"""Largest fraction of the lowest eigenvalue that rounding may give to rigid motions; more can lose a mode."""
_LOOSE = 1e-6
"""Share of the largest strain energy below which a mode is loose, and its eigenvalue is rounding with good reason."""
_GLANCE = 1e-3
"""Tolerance of a first look for missed modes; what lies no further above the last mode is looked at closely."""
_CLOSELY = 1e-9
"""Tolerance next to known modes: inside a repeated eigenvalue the last digits need not converge."""
_LARGE = 15_000
"""Unknowns from which a factor is beyond the cache, and a solve with several right sides takes little longer."""
_TRUE = 1e-6
"""Residual of the inverse over the eigenvalue from which pairs that blocks have found are not taken."""
_KEPT = 4_000_000
"""Numbers of a stiffness up to which it is kept with its factor; a larger one is made again for the last checks."""
_CROWD = 24
"""Modes that are sought where fewer do not converge: their Krylov space is larger."""
_RESTARTS = 100
"""Restarts after which a mode that has not converged is sought again without the others."""

AtRest = Callable[[], RigidFreeSolver] | None
"""Gives the solver of the stiffness at rest, where that is kept."""


def eigenpairs(
    shell: Shell, count: int, backend: str | None = None, at_rest: AtRest = None
) -> tuple[Array, Array, int, float, str, int]:
    """The ``count`` lowest eigenpairs of the shell's free unknowns, rigid motions first.

    ``at_rest`` gives the solver of the stiffness where that is kept; another one is made and let go.

    Returns
    -------
    eigenvalues : ndarray, shape (count,)
        Ascending [1/s^2]; exactly zero for rigid motions.
    modes : ndarray, shape (N, count)
        Mass-orthonormal modes of the free unknowns.
    rigid_modes : int
        Number of modes that are rigid motions.
    residual : float
        Largest ``|K phi - lambda M phi| / (|K| |phi|)``, in the mass-scaled problem.
    backend : str
        Library that held the factor.
    whole : int
        Number of leading modes whose eigenspaces ``count`` does not cut.
    """
    mass = shell.unknowns.masses(shell.mass)
    size = mass.size
    rigid = rigid_motions(shell)
    elastic = count - rigid.shape[1]
    if size - rigid.shape[1] < elastic:
        raise OptionError(f"count must be at most {size}, the number of free unknowns (got {count})")
    root = np.sqrt(mass)

    def assembled() -> Array:
        # At rest the exact Hessian is its Gauss-Newton part: positive semi-definite to the last bit.
        return shell.hessian(shell.rest_positions, GAUSS_NEWTON)

    stiffness = cache(assembled) if shell.pattern.size <= _KEPT else assembled
    name = "dense"
    if elastic <= 0:
        values, vectors = np.empty(0), np.empty((size, 0))
        rigid, whole = rigid[:, :count], 0
    else:
        # One mode more shows whether the last one asked for is part of a repeated eigenvalue.
        wanted = min(elastic + 1, size - rigid.shape[1])
        if size <= max(_DENSE_BELOW, 3 * wanted):
            dense = np.asarray(mass_scaled(shell, stiffness()) @ np.eye(size))
            values, vectors = dense_pairs(0.5 * (dense + dense.T), root[:, None] * rigid, wanted)
        else:
            # The factor is the peak of memory: no large matrix but its own stands beside it.
            solver = (
                at_rest()
                if at_rest is not None
                else RigidFreeSolver(shell.pattern.free_matrix(stiffness()), rigid, mass, backend)
            )
            name = solver.factor.backend
            values, vectors = lanczos_pairs(solver, root, root[:, None] * rigid, wanted)
            del solver
        values, vectors, whole = canonical_pairs(shell, values, vectors, elastic)
    data, modes = stiffness(), vectors / root[:, None]
    residuals = _residuals(shell, data, root, modes, values)
    residual = float(residuals.max(initial=0.0))
    if residual > _RESIDUAL_LIMIT:
        raise SolverError(
            f"mode {int(residuals.argmax())} has a residual of {residual:.1e} |K| |phi|, above {_RESIDUAL_LIMIT:.0e}: "
            "the stiffness is too ill-conditioned; check for slivers, which "
            f"{REPAIR} takes away, and for stiffnesses many decades apart"
        )
    strain = _strain_eigenvalues(shell, modes, values)
    _check_rounding(shell, data, values, strain)
    # Already in order, to rounding: repeated ones must not change places by it.
    eigenvalues = np.concatenate([np.zeros(rigid.shape[1]), np.maximum.accumulate(strain)])
    return eigenvalues, np.hstack([rigid, modes]), rigid.shape[1], residual, name, rigid.shape[1] + whole


def mass_scaled(shell: Shell, data: Array) -> spla.LinearOperator:
    """``M^-1/2 K M^-1/2`` on the free unknowns (N, N), from K's entries on the pattern, without internal unknowns."""
    whole, inner = scaled_by_mass(shell, shell.pattern.free_matrix(data))[0], shell.pattern.internal
    if inner is None:
        return spla.aslinearoperator(whole)
    above, solve = whole[:, : shell.unknowns.count], inner.solve
    rows, coupling = sps.csr_array(above[: shell.unknowns.count]), sps.csr_array(above[shell.unknowns.count :])

    def product(vectors: Array) -> Array:
        return rows @ vectors - coupling.T @ solve(coupling @ vectors)

    return spla.LinearOperator(rows.shape, matvec=product, matmat=product, dtype=np.float64)


def _residuals(shell: Shell, data: Array, root: Array, modes: Array, values: Array) -> Array:
    """``|K phi - lambda M phi| / (|K| |phi|)`` of each mode, mass-scaled; M^1/2 is ``root`` (N,), K has ``data``."""
    matrix, unknowns = shell.pattern.free_matrix(data), shell.unknowns
    np.abs(matrix.data, out=matrix.data)
    sums = matrix @ np.concatenate([1.0 / root, np.zeros(matrix.shape[0] - root.size)])
    norm = float((sums[: root.size] / root).max(initial=0.0)) or 1.0
    forces = unknowns.restrict(shell.pattern.product(data, unknowns.prolong(modes)))
    found = np.linalg.norm(forces / root[:, None] - root[:, None] * modes * values, axis=0) / norm
    finite_answer("the stiffness over the mass", norm, found)
    return np.asarray(found)


def scaled_by_mass(shell: Shell, matrix: sps.csc_array) -> tuple[sps.csc_array, Array]:
    """``M^-1/2 K M^-1/2`` of the free unknowns and of the internal ones, which have no mass; and ``M^1/2`` (N,)."""
    scaled = matrix.copy()
    masses = np.sqrt(shell.unknowns.masses(shell.mass))
    root = np.concatenate([masses, np.ones(scaled.shape[0] - masses.size)])
    scaled.data = scaled.data / (np.repeat(root, np.diff(scaled.indptr)) * root[scaled.indices])
    finite_answer("the stiffness over the mass", scaled.data)
    return scaled, masses


def largest_eigenvalue(shell: Shell, data: Array | None = None) -> float:
    """Upper estimate (within 1e-4) of the largest squared angular frequency of the rest shape [1/s^2].

    With ``data``, values on the shell's pattern, of the matrix ``M^-1 data`` instead.
    """
    if data is None:
        data = shell.hessian(shell.rest_positions, GAUSS_NEWTON)
    scaled = mass_scaled(shell, data)
    start = np.random.default_rng(0).standard_normal(scaled.shape[0])
    value = spla.eigsh(scaled, k=1, which="LM", v0=start, tol=1e-4, return_eigenvectors=False)
    return float(value[0]) * (1.0 + 1e-4)


def dense_pairs(matrix: Array, rigid: Array, wanted: int) -> tuple[Array, Array]:
    """Eigenpairs of a small matrix on the complement of the (orthonormal) rigid motions."""
    basis = scipy.linalg.null_space(rigid.T) if rigid.shape[1] else np.eye(matrix.shape[0])
    reduced = basis.T @ matrix @ basis
    try:
        # Those of the inverse, by Cholesky: in the matrix itself the lowest drown in eps |K| where a mesh has needles.
        inverse, vectors = scipy.linalg.eigh(np.eye(len(reduced)), reduced)
    except np.linalg.LinAlgError:  # loose, or too ill-conditioned: told apart by the strain energies
        values, vectors = np.linalg.eigh(reduced)
        return values[:wanted], basis @ vectors[:, :wanted]
    vectors = vectors[:, ::-1][:, :wanted]
    return 1.0 / inverse[::-1][:wanted], basis @ (vectors / np.linalg.norm(vectors, axis=0))


def lanczos_pairs(solver: RigidFreeSolver, root: Array, rigid: Array, wanted: int) -> tuple[Array, Array]:
    """Shift-invert at zero in the mass-scaled problem, whose mass matrix is the identity.

    A Krylov space holds one vector of each eigenspace: it sees further copies of a repeated eigenvalue by rounding
    alone, and may end without some. So what was found is projected out, and a new start looks for what is still lower.
    """
    random = np.random.default_rng(0)
    found = _lowest_by_blocks(solver, root, rigid, wanted) if root.size >= _LARGE else None
    if found is not None and not _fills_a_block(found[0]):
        return found
    values, vectors = found if found is not None else _lowest(solver, root, rigid, wanted, random)
    while True:
        known = np.hstack([rigid, vectors])
        if values.size < wanted:  # some did not converge: without the others they do
            more = _lowest(solver, root, known, wanted - values.size, random, _CLOSELY)
        elif known.shape[1] == root.size:
            break
        else:
            lowest, start = _lowest(solver, root, known, 1, random, _GLANCE)
            if lowest.size and lowest[0] > (1.0 + _GLANCE) * values[wanted - 1]:
                break
            more = _lowest(solver, root, known, 1, random, _CLOSELY, start)
            if more[0].size and more[0][0] >= (1.0 - _REPEATED) * values[wanted - 1]:
                break
        if not more[0].size:  # in a crowd of eigenvalues a larger Krylov space tells them apart
            crowd = min(_CROWD, (root.size - known.shape[1]) // 4)
            more = _lowest(solver, root, known, crowd, random, _CLOSELY)
        if not more[0].size:
            found = _lowest_by_blocks(solver, root, rigid, wanted, wanted)
            if found is not None:
                return found
            raise SolverError(
                f"only {values.size} of {wanted} modes converged; ask for fewer, or check the mesh for slivers, which "
                f"{REPAIR} takes away"
            )
        values, vectors = np.concatenate([values, more[0]]), np.hstack([vectors, more[1]])
        order = np.argsort(values, kind="stable")[: max(wanted, more[0].size)]
        values, vectors = values[order], vectors[:, order]
    return values[:wanted], vectors[:, :wanted]


def _lowest_by_blocks(
    solver: RigidFreeSolver, root: Array, known: Array, wanted: int, block: int = BLOCK
) -> tuple[Array, Array] | None:
    """The lowest ``wanted`` pairs, orthogonal to the orthonormal columns ``known``; None where they do not converge.

    They hold up to ``block`` copies of an eigenvalue.
    """

    def inverse(vectors: Array) -> Array:
        return _outside(known, root[:, None] * solver.solve(root[:, None] * vectors))

    start = np.random.default_rng(0).standard_normal((root.size, block))
    found = largest_pairs(inverse, _outside(known, start), wanted)
    if found is None:
        return None
    order = np.argsort(1.0 / found[0])
    values, vectors = found[0][order], found[1][:, order]
    # What the tolerance leaves lies in high modes, where K weighs it most: one more solve.
    solved = inverse(vectors)
    # The recurrence holds for a symmetric operator; a factor with pivots of other rows may be far from one.
    if not (np.linalg.norm(solved - vectors * values, axis=0) <= _TRUE * np.abs(values)).all():
        return None
    return 1.0 / values, np.linalg.qr(solved)[0]


def _fills_a_block(values: Array) -> bool:
    """Whether as many eigenvalues as a block has vectors are nearly the same: there may be more of them."""
    apart = values[BLOCK - 1 :] - values[: values.size - BLOCK + 1]
    return bool((apart <= _GLANCE * np.abs(values[BLOCK - 1 :])).any())


def _lowest(
    solver: RigidFreeSolver,
    root: Array,
    known: Array,
    wanted: int,
    random: np.random.Generator,
    tolerance: float = 0.0,
    start: Array | None = None,
) -> tuple[Array, Array]:
    """The lowest ``wanted`` pairs, or those of them that converge, orthogonal to the orthonormal columns ``known``."""
    size = root.size

    inverse = spla.LinearOperator(
        (size, size), matvec=lambda b: _outside(known, root * solver.solve(root * np.ravel(b))), dtype=np.float64
    )
    # With its inverse at hand, Lanczos asks of the matrix itself nothing but its shape.
    shape_only = spla.LinearOperator((size, size), matvec=lambda b: np.full_like(b, np.nan), dtype=np.float64)
    start = _outside(known, random.standard_normal(size) if start is None or not start.size else start[:, 0])
    subspace = min(size - known.shape[1], max(wanted * 3 // 2 + 8, wanted + 2))
    try:
        values, vectors = spla.eigsh(
            shape_only,
            k=wanted,
            sigma=0.0,
            which="LM",
            OPinv=inverse,
            v0=start,
            ncv=max(subspace, wanted + 1),
            tol=tolerance,
            maxiter=_RESTARTS,
        )
    except spla.ArpackNoConvergence as error:
        values, vectors = np.real(error.eigenvalues), np.real(error.eigenvectors).reshape(size, -1)
    order = np.argsort(values)
    vectors = _outside(known, vectors[:, order])
    if tolerance:  # what a looser tolerance leaves lies in high modes, where K weighs it most: one more solve each
        for k in range(vectors.shape[1]):
            vectors[:, k] = inverse.matvec(vectors[:, k])
        vectors, _ = np.linalg.qr(vectors)
    return values[order], vectors / np.linalg.norm(vectors, axis=0)


def _outside(known: Array, vectors: Array) -> Array:
    """What of vectors (N,) or (N, k) is orthogonal to the orthonormal columns ``known``."""
    return np.asarray(vectors - known @ (known.T @ vectors))


def _check_rounding(shell: Shell, data: Array, values: Array, strain: Array) -> None:
    """Raise SolverError if modes are lost to rounding: computed ones, or missing ones."""
    apart = np.abs(values - strain) > _AGREEMENT * strain
    bad = np.flatnonzero(apart & (strain > _LOOSE * strain.max(initial=0.0)))
    if bad.size:
        raise SolverError(
            f"elastic mode {bad[0]} (counted from 0) is lost in rounding: its eigenvalue {values[bad[0]]:.3g} 1/s^2 "
            f"and its strain energy {strain[bad[0]]:.3g} 1/s^2 differ, {bad.size} such modes in all; {_remedy(shell)}"
        )
    elastic = strain[strain > _LOOSE * strain.max(initial=0.0)]
    false = _stiffness_of_rounding(shell, data)
    if elastic.size and false > _FALSE_STIFFNESS * elastic.min():
        raise SolverError(
            f"rounding gives rigid motions a stiffness of {false:.3g} 1/s^2, with a lowest eigenvalue of "
            f"{elastic.min():.3g} 1/s^2, so that modes may be wrong or missing; {_remedy(shell)}"
        )


def _remedy(shell: Shell) -> str:
    """What would keep modes from being lost: a stiffness that the material lacks, or ones that are more alike."""
    lacking = [name for name in ("shear", "flexure") if not np.any(getattr(shell.material, name, 1.0))]
    if not lacking:
        return _ILL_CONDITIONED
    return f"of a material without {' and '.join(lacking)} some motions meet no resistance: give it a little, above 0"


def _stiffness_of_rounding(shell: Shell, data: Array) -> float:
    """Largest Rayleigh quotient [1/s^2] that K gives to a rigid motion of the whole shell: zero but for rounding."""
    fields = six_motions(shell.rest_positions).reshape(-1, 6)
    mass = np.repeat(shell.mass, 3)
    # Internal unknowns do not take part in rigid motions. Vertices that share an element with a clamped edge do resist.
    stiffness = shell.pattern.matrix(data)
    clamped = (3 * np.unique(shell.elastic_energy.held_slopes())[:, None] + np.arange(3)).ravel()
    forces = stiffness @ fields
    forces[stiffness[clamped].indices] = 0.0
    return float((np.abs(np.sum(fields * forces, axis=0)) / (mass @ fields**2)).max())


def canonical_pairs(shell: Shell, values: Array, vectors: Array, count: int) -> tuple[Array, Array, int]:
    """The first ``count`` pairs in a form that repeats: a fixed basis in each repeated eigenspace, fixed signs.

    Both are fixed along the mesh's own axes: a shell that is turned has the same modes. And how many of them are of
    eigenspaces that ``count`` does not cut.
    """
    groups = np.concatenate([[0], np.cumsum(np.diff(values) > _REPEATED * np.abs(values[1:]))])
    fixed = vectors.copy()
    for group in range(int(groups[-1]) + 1):
        members = np.flatnonzero(groups == group)
        if members.size > 1:
            space = vectors[:, members]
            probes = np.random.default_rng(1).standard_normal((members.size, len(shell.mass), 3)) @ shell.mesh.axes
            restricted = shell.unknowns.restrict(probes.reshape(members.size, -1).T)
            fixed[:, members], _ = np.linalg.qr(space @ (space.T @ restricted))
    fixed *= canonical_signs(shell, shell.unknowns.prolong(fixed))
    cut = count < groups.size and groups[count] == groups[count - 1]
    whole = int(np.argmax(groups == groups[count])) if cut else count
    return values[:count], fixed[:, :count], whole


def canonical_signs(shell: Shell, fields: Array) -> Array:
    """Signs (k,) that make the leading entries of fields (3n, k) positive, along the mesh's own axes."""
    turned = np.einsum("ij,njk->nik", shell.mesh.axes, fields.reshape(-1, 3, fields.shape[1])).reshape(fields.shape)
    magnitude = np.abs(turned)
    # The first of the nearly largest entries: symmetric modes have several that differ by rounding alone.
    leading = np.argmax(magnitude >= 0.999 * magnitude.max(axis=0), axis=0)
    return np.where(turned[leading, np.arange(leading.size)] < 0.0, -1.0, 1.0)


def _strain_eigenvalues(shell: Shell, modes: Array, approximate: Array) -> Array:
    """Eigenvalues as twice the strain energy of each mass-normalised mode, summed over elements.

    The measures' rates keep the digits that ``phi^T K phi`` loses where membrane and bending stiffness are many decades
    apart.
    """
    values = np.empty_like(approximate)
    for k in range(modes.shape[1]):
        step = shell.unknowns.prolong(modes[:, k])
        values[k] = 2.0 * shell.elastic_energy.linear_energy(shell.rest_positions, step.reshape(-1, 3))
    return values
