"""Modal derivatives: changes of the modes along one another, and the basis they form [barbic2005; theory 10, eq. 1]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.memory import demand_memory
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.modes.attachments import orthonormal_extension
from modalshell.modes.basis import Basis
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.shell import EXACT, Shell

_STEP, _HALVINGS = 0.1, 8
"""First difference step, the largest change of an edge vector over its length, and how often it is halved at most."""
_EXTRAPOLATED = 1e-6
"""Change by the last halving, in the fourth order, at which the steps are short enough for the sixth."""


@short_repr
@dataclass(frozen=True)
class DerivativeBasis:
    """Modes, their derivatives, and an orthonormal basis of both; elastic ones, without rigid motions."""

    modes: Basis
    """The vibration modes; m of them, Phi, are elastic."""
    derivatives: Array
    """Psi: psi_ij for i <= j, in the order of ``numpy.triu_indices(m)``; symmetric in i and j [1/kg]. Shape
    (3n, m (m + 1) / 2)."""
    vectors: Array
    """U, mass-orthonormal and ``U^T K U`` diagonal, zero at held vertices; its first m columns are Phi [1/sqrt(kg)].
    Shape (3n, r)."""
    eigenvalues: Array
    """That diagonal [1/s^2]: those of the modes, then ascending ones. Shape (r,)."""
    difference_error: float
    """Largest relative change of a differenced force ``(dK/dq_j) phi_i``, of fourth order, when its step is halved,
    before the two are extrapolated."""
    asymmetry: float
    """Largest relative difference between ``(dK/dq_j) phi_i`` and ``(dK/dq_i) phi_j``, which are the same."""

    @property
    def shell(self) -> Shell:
        """The shell that the basis belongs to."""
        return self.modes.shell

    @property
    def size(self) -> int:
        """Number of basis vectors r."""
        return int(self.vectors.shape[1])

    def edge_change(self, z: Array) -> float:
        """Largest change of an edge vector over its length for coordinates z (r,): about the largest turn [rad]."""
        return float(edge_changes(self.shell, (self.vectors @ z).reshape(-1, 3, 1)).max())


_DERIVATIVE_BYTES = 40.0
"""For each pair of modes and unknown: the forces, their transpose, the answers and their orthonormal basis."""


def modal_derivatives(modes: Basis, *, backend: str | None = None) -> DerivativeBasis:
    """Solve ``K psi_ij = -(dK/dq_j) phi_i`` for all pairs of elastic modes with one factor of K.

    Along a curved static path ``u(q) = Phi q + sum_ij psi_ij q_i q_j / 2 + O(q^3)`` under the loads ``K Phi q``. Where
    supports leave rigid motions free, inertial loads of these balance the right sides, and the answers have no share in
    them. ``modes`` are elastic ones and all rigid ones; ``backend`` is that of :class:`modalshell.modes.Factoriser`.
    SolverError if K is too ill-conditioned for its inverse to have a meaning.
    """
    shell = modes.shell
    size = _DERIVATIVE_BYTES * modes.count**2 * shell.rest_positions.size
    demand_memory(f"the derivatives of {modes.count} modes", size, "take fewer modes")
    rigid, unknowns = modes.rigid_modes, shell.unknowns
    forces, difference_error, asymmetry = _derivative_forces(shell, modes.modes[:, rigid:])
    # At rest the exact Hessian is its Gauss-Newton part, positive definite beside rigid motions.
    data, mass = shell.hessian(shell.rest_positions, EXACT), unknowns.masses(shell.mass)
    solved = RigidFreeSolver.of(shell, data, backend).solve(-unknowns.restrict(forces))
    derivatives = unknowns.prolong(solved)
    found = orthonormal_extension(unknowns.values(modes.modes), solved, mass)
    vectors, count = np.asarray(unknowns.prolong(found[:, rigid:])), modes.count - rigid
    # The new vectors are K-orthogonal to the modes as they are M-orthogonal to them: only they need turning.
    new = vectors[:, count:]
    further, turned = np.linalg.eigh(new.T @ shell.pattern.product(data, new))
    if not (further > 0.0).all():  # NaN too
        raise SolverError(
            f"the modal derivatives have no positive stiffness (lowest {further.min():.3g} 1/s^2): the mesh is too "
            "ill-conditioned for them; remesh needles, or make the stiffnesses more alike"
        )
    vectors[:, count:] = new @ turned
    eigenvalues = np.concatenate([modes.eigenvalues[rigid:], further])
    return DerivativeBasis(modes, derivatives, vectors, eigenvalues, difference_error, asymmetry)


def _derivative_forces(shell: Shell, modes: Array) -> tuple[Array, float, float]:
    """``(dK/dq_j) phi_i`` for i <= j (3n, m (m + 1) / 2), the error of the differences, and their asymmetry.

    Central differences of the exact Hessian along each mode at a step, a half and a quarter of it, extrapolated to
    sixth order. Steps are as long as that allows: rounding of the Hessian, over the step, errs in proportion to the
    membrane's stiffness, and the answers to it are those of the bending.
    """
    count = modes.shape[1]
    fields = modes.reshape(-1, 3, count)
    steps = _STEP / edge_changes(shell, fields).max(axis=0)
    forces = np.empty((count, count, shell.rest_positions.size))
    error = 0.0
    for j in range(count):
        slopes = [_stiffness_slope(shell, modes, fields[:, :, j], share * steps[j]) for share in (1.0, 0.5, 0.25)]
        for halving in range(_HALVINGS + 1):
            coarse, middle, fine = slopes[-3:]
            former, latter = (4.0 * middle - coarse) / 3.0, (4.0 * fine - middle) / 3.0
            if halving == _HALVINGS or _change(former, latter) <= _EXTRAPOLATED:
                break
            slopes.append(_stiffness_slope(shell, modes, fields[:, :, j], 0.125 * 0.5**halving * steps[j]))
        forces[:, j] = ((16.0 * latter - former) / 15.0).T
        error = max(error, _change(former, latter))
    transposed = forces.swapaxes(0, 1)
    scale = np.linalg.norm(forces, axis=2).max()
    asymmetry = float(np.linalg.norm(forces - transposed, axis=2).max() / scale)
    rows, columns = np.triu_indices(count)
    return 0.5 * (forces + transposed)[rows, columns].T, error, asymmetry


def _change(former: Array, latter: Array) -> float:
    """Largest relative change of a column; modes of spans that share nothing have columns of zeros."""
    size = np.linalg.norm(latter, axis=0)
    return float((np.linalg.norm(latter - former, axis=0) / np.where(size > 0.0, size, 1.0)).max())


def _stiffness_slope(shell: Shell, modes: Array, direction: Array, step: float) -> Array:
    """``(dK/dq) Phi`` (3n, m) along ``direction`` (n, 3)."""
    ahead, behind = (shell.hessian(shell.rest_positions + side * step * direction, EXACT) for side in (1.0, -1.0))
    return (shell.pattern.product(ahead, modes) - shell.pattern.product(behind, modes)) / (2.0 * step)


def edge_changes(shell: Shell, fields: Array) -> Array:
    """Change of every edge vector over its length (edges, k) for displacement fields (n, 3, k)."""
    ends = shell.mesh.edges
    return np.linalg.norm(fields[ends[:, 1]] - fields[ends[:, 0]], axis=1) / shell.mesh.edge_lengths[:, None]
