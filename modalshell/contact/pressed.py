"""Where contacts leave a modal shell."""

from __future__ import annotations

from typing import NamedTuple

from modalshell.core.typing import Array


class Pressed(NamedTuple):
    """Where contacts leave a modal shell.

    Attributes
    ----------
    q : ndarray, shape (m,)
        Coordinates.
    local : ndarray, shape (n, 3)
        Displacements [m] beyond the modes.
    pushes : ndarray, shape (r,)
        Forces [N] along the normals, of all rows.
    solved : bool
        Whether the gaps of all rows met their tolerance.
    positions : ndarray or None, shape (n, 3)
        Positions [m] at q, without what is beyond the modes, where they are known.
    energy : float
        Elastic energy [J] of what is beyond the modes.
    at : ndarray, shape (m,), or None
        Where the positions' derivatives were taken, if they were asked for.
    gaps : ndarray or None, shape (r,)
        Gaps [m] of all rows, where they are known.
    """

    q: Array
    local: Array
    pushes: Array
    solved: bool
    positions: Array | None = None
    energy: float = 0.0
    at: Array | None = None
    gaps: Array | None = None
