"""Attachment vectors, static shapes under given loads, and the orthonormal extension of a basis by them or others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.typing import Array
from modalshell.loads import Load
from modalshell.modes.factorisation import Factoriser, condensed_factor
from modalshell.modes.rigid import left_free
from modalshell.shell import GAUSS_NEWTON, Shell

_DEPENDENT = 1e-6
"""Least relative part of a vector orthogonal to the basis for it to be added."""


def orthonormal_extension(leading: Array, further: Array, mass: Array) -> Array:
    """``leading`` (N, m), mass-orthonormal, followed by what is new in ``further`` (N, k), orthonormalised.

    QR with column pivoting on unit columns; a column whose new part is below :data:`_DEPENDENT` gets no vector.
    """
    root = np.sqrt(mass)[:, None]
    known, new = root * leading, root * further
    size = np.linalg.norm(new, axis=0)
    new = new[:, size > 0.0] / size[size > 0.0]
    for _ in range(2):  # once more for the digits that cancellation took
        new -= known @ (known.T @ new)
    orthonormal, triangle, _ = scipy.linalg.qr(new, mode="economic", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diagonal(triangle)) > _DEPENDENT))
    found = orthonormal[:, :rank]
    found, _ = np.linalg.qr(found - known @ (known.T @ found))
    return np.hstack([leading, found / root])


def attached_forces(shell: Shell, attachments: Sequence[Load | ArrayLike] | None) -> Array:
    """The loads as forces (3n, k) [N] on a shell that its supports must hold."""
    if attachments is None:
        return np.empty((shell.rest_positions.size, 0))
    if not isinstance(attachments, list | tuple) or not attachments:
        raise OptionError(f"attachments must be a list of loads or of forces (n, 3) (got {shown(attachments)})")
    if loose := left_free(shell):
        raise OptionError(f"attachments need a shell that its supports hold, but {loose}: hold more vertices")
    forces = [
        shell.total_load(loads=[entry]) if isinstance(entry, Load) else shell.total_load(force=entry)
        for entry in attachments
    ]
    return np.stack([force.ravel() for force in forces], axis=1)


def with_attachments(
    shell: Shell, eigenvalues: Array, modes: Array, forces: Array, backend: str | None
) -> tuple[Array, Array]:
    """Eigenvalues (m,) and modes (N, m) of the free unknowns, extended by the static solutions under forces (3n, k).

    New vectors are rotated so that the stiffness is diagonal on them: their eigenvalues are Ritz values, above those of
    the modes.
    """
    data = shell.hessian(shell.rest_positions, GAUSS_NEWTON)
    factor = Factoriser(backend, use="solve").definite(shell.pattern.free_matrix(data))
    solve = condensed_factor(factor, shell.pattern.internal_count).solve
    answers = solve(np.asarray(shell.unknowns.restrict(forces)))
    found = orthonormal_extension(modes, answers, shell.unknowns.masses(shell.mass))
    new = np.asarray(shell.unknowns.prolong(found[:, modes.shape[1] :]))
    values, turned = np.linalg.eigh(new.T @ shell.pattern.product(data, new))
    if not (values > 0.0).all():  # NaN too
        raise SolverError(
            f"the attachments have no positive stiffness (lowest {values.min():.3g} 1/s^2): the stiffness is too "
            "ill-conditioned; remesh needles, or make the stiffnesses more alike"
        )
    return np.concatenate([eigenvalues, values]), np.hstack([modes, found[:, modes.shape[1] :] @ turned])
