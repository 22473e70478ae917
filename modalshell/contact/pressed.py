"""Where contacts leave a modal shell."""

from __future__ import annotations

from typing import NamedTuple

from modalshell.core.typing import Array


class Pressed(NamedTuple):
    """Where contacts leave a modal shell."""

    q: Array
    """Coordinates; shape (m,)."""
    local: Array
    """Displacements [m] beyond the modes; shape (n, 3)."""
    pushes: Array
    """Forces [N] along the normals, of all rows; shape (r,)."""
    solved: bool
    """Whether the gaps of all rows met their tolerance."""
    positions: Array | None = None
    """Positions [m] at q, without what is beyond the modes, where they are known; shape (n, 3)."""
    energy: float = 0.0
    """Elastic energy [J] of what is beyond the modes."""
    at: Array | None = None
    """Where the positions' derivatives were taken, if they were asked for; shape (m,)."""
    gaps: Array | None = None
    """Gaps [m] of all rows, where they are known; shape (r,)."""
