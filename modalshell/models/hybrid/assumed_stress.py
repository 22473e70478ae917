"""Reduced energy with assumed membrane stresses (Hellinger-Reissner), on a basis that would lock otherwise.

Small errors of the basis cause large membrane strains. The membrane energy is therefore that of
stresses in the span of a few trained ones, ``E_m = max_s (s . d - sum_e s_e^2 / (4 w_e))`` [hellinger1914;
reissner1950]: with stress modes that are orthonormal in the complementary energy it is ``sum_k d_k^2 / 2``, each
``d_k = b_k . z + z . B_k z / 2`` a quadratic form of the coordinates z, so no element is evaluated. Flat hinges bend by
a constant matrix, which resists some strains, too: the stresses leave that energy to it. Hinges with an angle at rest
are evaluated as they are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from modalshell.core.typing import Array, Index
from modalshell.shell import Shell
from modalshell.shell.smoothed_membrane import PAIR, edge_numbers, strain_of_lengths

_FLAT = 1e-6
"""Rest angle [rad] up to which a hinge is flat."""
_RESISTED = 0.9
"""Largest share of a membrane mode's energy that flat hinges take where stresses take the rest."""


class Quadratic(NamedTuple):
    """Quadratic forms ``b_k . z + z . B_k z / 2`` of coordinates (m,).

    Attributes
    ----------
    linear : ndarray, shape (m, K)
        ``b_k``.
    pairs : ndarray, shape (m (m + 1) / 2, K)
        Lower triangles of the ``B_k``, row by row.
    """

    linear: Array
    pairs: Array


class ReducedStress(NamedTuple):
    """Energy of coordinates z (m,): K stress modes, H hinges with an angle at rest on S vertices.

    Attributes
    ----------
    membrane : Quadratic
        ``d_k``.
    viscous : Quadratic
        The same of the stresses that resist the rates of the membrane's strains.
    flat : ndarray, shape (m, m)
        Stiffness of the flat hinges.
    rest, modes : ndarray, shape (S, 3) and (S, 3, m)
        The other hinges' vertices at rest [m], and their rows of the basis.
    hinges : ndarray of int64, shape (H, 4)
        Stencils of these hinges in their vertices.
    angles, roots : ndarray, shape (H,)
        Angles at rest [rad], and roots of twice stiffness over rest size.
    """

    membrane: Quadratic
    viscous: Quadratic
    flat: Array
    rest: Array
    modes: Array
    hinges: Index
    angles: Array
    roots: Array


def reduce_energy(shell: Shell, basis: Array, stresses: Array, viscous: Array) -> ReducedStress:
    """Reduced energy of a discrete shell.

    Parameters
    ----------
    shell : Shell
        Its element sets are stretch, shear and flexure.
    basis : ndarray, shape (3n, m)
        V, of displacements.
    stresses, viscous : ndarray, shape (T + E, K) and (T + E, L)
        Modes of elastic and of viscous stresses of triangles and edges; see :func:`stress_modes`.
    """
    flexure = shell.elements[2]
    vertices, columns = shell.rest_positions, basis.reshape(-1, 3, basis.shape[1])
    flat = _flat(shell)
    used, hinges = np.unique(flexure.stencils[~flat], return_inverse=True)
    return ReducedStress(
        _strain_measures(shell, columns, elastic_stresses(shell, stresses)),
        _strain_measures(shell, columns, _edge_stresses(shell, viscous)),
        _flat_bending(vertices, columns, flexure.stencils[flat], flexure.weight[flat]),
        np.ascontiguousarray(vertices[used]),
        np.ascontiguousarray(columns[used]),
        np.ascontiguousarray(hinges.reshape(-1, 4), dtype=np.int64),
        flexure.rest[~flat].copy(),
        np.sqrt(2.0 * flexure.weight[~flat]),
    )


def _flat(shell: Shell) -> NDArray[np.bool_]:
    return np.abs(shell.elements[2].rest) <= _FLAT


def _edge_stresses(shell: Shell, stresses: Array) -> Array:
    """Stresses (E, K) of the edges that do the work of those of triangles and edges (T + E, K)."""
    stretch, shear, _ = shell.elements
    sides = shell.mesh.face_edges
    squares = shear.rest[sides] ** 2
    # dA / dl_i = l_i (l_j^2 + l_k^2 - l_i^2) / (8 A) at rest
    slopes = shear.rest[sides] * (squares.sum(axis=1)[:, None] - 2.0 * squares) / (8.0 * stretch.rest[:, None])
    along = stresses[len(stretch.rest) :].copy()
    for side in range(3):
        np.add.at(along, sides[:, side], slopes[:, side, None] * stresses[: len(stretch.rest)])
    return along


def elastic_stresses(shell: Shell, stresses: Array, factors: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Array:
    """Stresses (E, k) of edges; half the sum of squares of their work is the membrane's energy less the hinges' share.

    The bending of flat hinges by ``j`` is meant for isometric motions. Strains of the two triangles enter ``j`` by the
    jumps of E_nn and 2 E_tn across the edge: that energy is left to the hinges, and taken from the stresses. Modes of
    whose energy the hinges take more than :data:`_RESISTED` are left to the hinges altogether.

    Parameters
    ----------
    stresses : ndarray, shape (T + E, K)
        Modes of elastic stresses.
    factors : tuple of float
        Of the stiffnesses of triangles, edges and hinges.
    """
    shear, mesh = shell.elements[1], shell.mesh
    hinges = shell.elements[2].stencils[_flat(shell)]
    weights = 2.0 * factors[2] * shell.elements[2].weight[_flat(shell)]
    strains = _compliance(shell, factors[:2])[:, None] * stresses
    edges = edge_numbers(mesh, hinges, PAIR)
    rows = np.zeros((len(hinges), 2, len(PAIR)))
    rows[:, :, [0, 1, 2]] = strain_of_lengths(mesh, hinges[:, [0, 1, 2]])[:, 1:]
    rows[:, :, [0, 3, 4]] -= strain_of_lengths(mesh, hinges[:, [0, 1, 3]], -1.0)[:, 1:]
    jumps = np.einsum("hpe,hek->hpk", rows, (shear.rest[:, None] * strains[-len(shear.rest) :])[edges])
    resisted = np.zeros((len(shear.rest), stresses.shape[1]))
    np.add.at(resisted, edges, np.einsum("h,hpe,hpk->hek", weights, rows, jumps))
    fractions, turned = scipy.linalg.eigh(np.einsum("h,hpk,hpl->kl", weights, jumps, jumps), stresses.T @ strains)
    kept = fractions < _RESISTED
    remaining = _edge_stresses(shell, stresses) - shear.rest[:, None] * resisted
    return np.asarray(remaining @ (turned[:, kept] / np.sqrt(1.0 - fractions[kept])))


def _compliance(shell: Shell, factors: tuple[float, ...] = (1.0, 1.0)) -> Array:
    """Strain (T + E,) for each unit of stress of triangles and edges, 0 where there is no stiffness."""
    weight = np.concatenate([f * elements.weight for f, elements in zip(factors, shell.elements[:2], strict=True)])
    return np.divide(0.5, weight, out=np.zeros(weight.size), where=weight > 0.0)


def _strain_measures(shell: Shell, columns: Array, along: Array) -> Quadratic:
    """Work of every mode of edge stresses ``along`` (E, K) on the strains of the edges."""
    vertices, edges = shell.rest_positions, shell.elements[1].stencils
    across = columns[edges[:, 1]] - columns[edges[:, 0]]
    arms = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    scaled = along / shell.elements[1].rest[:, None]
    linear = np.einsum("exm,ek->mk", across * arms[:, :, None], scaled, optimize=True)
    rows = np.tril_indices(columns.shape[2])[0]
    pairs = np.empty((len(rows), along.shape[1]))
    for row in range(columns.shape[2]):  # products of all pairs at once would be large
        products = np.einsum("ex,exj->ej", across[:, :, row], across[:, :, : row + 1])
        pairs[rows == row] = products.T @ scaled
    return Quadratic(np.ascontiguousarray(linear), pairs)


def _flat_bending(vertices: Array, columns: Array, hinges: Index, weights: Array) -> Array:
    """Stiffness (m, m) of ``w |j|^2``, j the sum over both sides of the offset from the rest foot over the height."""
    total = np.zeros((columns.shape[2],) * 2)
    if len(hinges) == 0:
        return total
    first, second = vertices[hinges[:, 0]], vertices[hinges[:, 1]]
    edge = second - first
    length = np.sum(edge**2, axis=1)
    offsets = np.zeros((len(hinges), 3, columns.shape[2]))
    for opposite in (2, 3):
        arm = vertices[hinges[:, opposite]] - first
        along = np.sum(arm * edge, axis=1) / length
        height = np.linalg.norm(arm - along[:, None] * edge, axis=1)[:, None, None]
        along = along[:, None, None]
        foot = (1.0 - along) * columns[hinges[:, 0]] + along * columns[hinges[:, 1]]
        offsets += (columns[hinges[:, opposite]] - foot) / height
    tall = offsets.reshape(-1, columns.shape[2])
    return np.asarray(tall.T @ (np.repeat(2.0 * weights, 3)[:, None] * tall))


def stress_modes(shell: Shell, leading: Array, snapshots: Array, count: int) -> Array:
    """Stress modes (T + E, K), orthonormal in ``sum_e s_e s'_e / (2 w_e)``: of ``leading`` states, then by POD.

    ``leading`` (T + E, l) and ``snapshots`` (T + E, s) are stresses of triangles and edges.
    """
    root = np.sqrt(_compliance(shell))[:, None]
    first = scipy.linalg.orth(root * leading, rcond=1e-8)[:, :count]
    return np.asarray(_extended(first, root * snapshots, count) / np.where(root > 0.0, root, np.inf))


def _extended(first: Array, snapshots: Array, count: int) -> Array:
    """``count`` orthonormal columns: ``first``, then the leading left singular vectors of what snapshots add."""
    remainder = snapshots - first @ (first.T @ snapshots)
    vectors, sizes, _ = np.linalg.svd(remainder, full_matrices=False)
    further = min(count - first.shape[1], int(np.sum(sizes > 1e-9 * sizes[0])))
    return np.concatenate([first, vectors[:, :further]], axis=1)


def position_modes(shell: Shell, leading: Array, snapshots: Array, count: int, stiffness: Any) -> Array:
    """Basis V (3n, m), mass-orthonormal, ``V^T K V`` diagonal: ``leading`` modes, then POD of the remainder.

    ``leading`` (3n, l) and ``snapshots`` (3n, s) are displacements, ``stiffness`` (3n, 3n) is that at rest.
    """
    root = np.sqrt(np.repeat(shell.mass, 3))[:, None]
    first = scipy.linalg.orth(root * leading, rcond=1e-10)[:, :count]
    basis = _extended(first, root * snapshots, count) / root
    _, turned = np.linalg.eigh(basis.T @ (stiffness @ basis))
    return np.asarray(basis @ turned)
