"""Operations of a record that knows the elastic energy of a compiled step; see :mod:`.profile_newton`.

Each record registers its own by :func:`modalshell.statics.mixed_newton.operation_of`; they are compiled with the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.linalg import Profile


def energy(elastic: Any, room: Any, x: Array) -> float:
    """Elastic energy at ``x`` (n, 3); its gradient goes to ``room``."""
    return float(elastic.energy(room, x))


def assemble(elastic: Any, body: Any, room: Any, x: Array) -> None:
    """Write the gradient and the Hessian at ``x`` to ``room``, its geometric part with the stresses there."""
    elastic.assemble(body, room, x)


def soften(elastic: Any, body: Any, room: Any, x: Array) -> None:
    """Write the geometric part of the Hessian at ``x`` to ``room``, with the stresses there."""
    elastic.soften(body, room, x)


def harden(elastic: Any, body: Any, room: Any, x: Array) -> None:
    """Write the gradient and the first part of the Hessian at ``x`` to ``room``, this as its second matrix."""
    elastic.harden(body, room, x)


def resist(elastic: Any, room: Any, x: Array) -> None:
    """Write forces by which the first part of the Hessian at ``x`` resists ``room.step``, in place of a gradient."""
    elastic.resist(room, x)


def predict(elastic: Any, room: Any, x: Array) -> None:
    """Write the stresses after ``room.step``, by the measures linearised at ``x``."""
    elastic.predict(room, x)


def block_places(profile: Profile, rows: Index, columns: Index) -> Index:
    """Where blocks begin in the profile; -1 above the diagonal, and for rows or columns that have none (-1)."""
    rows, columns = np.broadcast_arrays(rows, columns)
    begins = profile.starts[:-1] - profile.first  # of each block of rows, were its first column that of the matrix
    return np.asarray(np.where((columns >= 0) & (columns <= rows), begins[rows] + 3 * columns, -1))
