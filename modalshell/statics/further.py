"""What a potential may have beyond a shell's energy and loads: an energy of another pattern, that bounds steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.modes import Factoriser
from modalshell.shell import Shell

Moved = tuple[Array, list[Array], float]
"""Positions (n, 3) [m] and stresses after a step, and the part of the direction that it is."""


class Further(Protocol):
    """A further energy."""

    def value(self, x: Array) -> float:
        """Energy [J] at x (n, 3)."""

    def gradient(self, x: Array) -> Array:
        """Its derivatives (n, 3) [N]."""

    def matrix(self, shell: Shell, data: Array, x: Array, *, exactly: bool) -> sps.csc_array:
        """The Hessian of a shell, by the entries ``data`` on its pattern, with this energy's at x (n, 3).

        These are definite for each of its parts unless ``exactly``.
        """

    def bounded(self, move: Callable[[float], Moved], x: Array) -> Moved:
        """What ``move`` gives for the part of a direction, from x (n, 3), that this energy allows."""

    def factoriser_of(self, hessian: sps.csc_array, plain: Factoriser) -> Factoriser:
        """What factorises a Hessian, ``plain`` where it has the shell's own pattern."""
