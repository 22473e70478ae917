"""What contacts push, in steps that leave all of it pushed, at these vertices alone (theory 13, eq. 7 and 8).

A vertex that a part of a step would take inside would be pushed, and no longer would what is pushed stay as it is. So
no other vertex is a candidate, and all are looked at once, at the step's end.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np

from modalshell.contact import warp_kernels
from modalshell.contact.modal import FAR, SETTLED, SMALL, ModalContacts
from modalshell.contact.pressed import Pressed
from modalshell.core.typing import Array, Index


@final
class Staying:
    """Steps of implicit Euler of warps in closed form on what stays pushed.

    Parameters
    ----------
    pressing : ModalContacts
        The contacts.
    eigenvalues : ndarray, shape (m,)
        Stiffness of the modes [1/s^2].
    """

    def __init__(self, pressing: ModalContacts, eigenvalues: Array) -> None:
        size = pressing.touching.size
        self._pressing, self._eigenvalues = pressing, eigenvalues
        self._limits = SETTLED * size, FAR * size, SMALL * size
        self._kept: Any = None
        self._chosen = -1, b""
        self._forces: Array
        self._local: Array
        self._pushes: Array
        self._energy = 0.0

    def begin(self, before: Pressed) -> None:
        """Begin where contacts push ``before``."""
        rows = np.flatnonzero(before.pushes)
        shapes, key = self._pressing.shapes, rows.tobytes()
        if self._chosen != (shapes.begun, key):
            self._kept = self._pressing.gathered(rows)
            self._chosen = shapes.begun, key
        self._forces, self._local = before.pushes[rows], before.local[self._kept[1]].T.copy()
        self._pushes = np.empty((rows.size, 3))

    def part(self, begin: tuple[Array, Array], force: Array, dt: float, compliance: Array) -> Array | None:
        """Coordinates (m,) where a step of ``dt`` [s] ends, under a modal ``force`` (m,); None where a vertex opens.

        ``begin`` are coordinates and rates (m,), ``compliance`` is G.
        """
        end = np.empty(force.size)
        step, found = (*begin, force, compliance, self._eigenvalues, dt), (end, self._forces, self._local, self._pushes)
        self._energy, stays = warp_kernels.stay(self._kept, self._pressing.bodies, step, found, self._limits)
        return end if stays else None

    def end(self, q: Array) -> Pressed | None:
        """Where the last part has led, q (m,); None where it leads another vertex inside."""
        rows, _, slots = self._kept[:3]
        base, local, gaps, least = self._pressing.ended(q, slots, self._pushes)
        if not least >= -self._limits[0]:
            return None
        pushes = self._pressing.no_pushes
        pushes[rows] = self._forces
        return Pressed(q, local, pushes, True, base, self._energy, None, gaps)
