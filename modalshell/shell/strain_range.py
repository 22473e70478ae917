"""Whether a deformed sheet is within the small strains that its material's law is meant for (theory 6)."""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array
from modalshell.shell.fields import membrane_strain, principal_values
from modalshell.shell.sheet import Sheet
from modalshell.shell.shell import Shell

_SMALL = 0.1
"""Largest principal strain of the middle surface: there laws that agree at small strains differ by 15 %."""
_SHARE = 0.01
"""Share of the area beyond it from which an answer says so: less surrounds point forces and corners of clamps."""


def strained_beyond(shell: Shell, positions: Array) -> str:
    """What is said of ``positions`` (n, 3) [m] where strains are large; "" within the range, and of hinge shells."""
    if not isinstance(shell.material, Sheet):
        return ""
    mesh, rest = shell.rest_mesh, shell.rest_shape
    tensors = membrane_strain(mesh, positions, None if rest is None else rest.squares)
    strains = np.abs(principal_values(tensors)).max(axis=1)
    share = mesh.face_areas[strains > _SMALL].sum() / mesh.area
    if share <= _SHARE:
        return ""
    return (
        f"the membrane strains by up to {100.0 * strains.max():.2g} %, by more than {100.0 * _SMALL:.0f} % on "
        f"{100.0 * share:.0f} % of the area: the material's law is meant for small strains"
    )


def ends_strained(shell: Shell, positions: Array) -> str:
    """The same of the ``positions`` (n, 3) [m] where a motion ends."""
    said = strained_beyond(shell, positions)
    return f"at its end {said}" if said else ""
