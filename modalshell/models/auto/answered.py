"""How much of the linear answer to a load a basis of modes lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.modes import Basis
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.shell import GAUSS_NEWTON, Shell

_ALIKE = 0.05
"""What a load may have that is no multiple of the last one, as a share of it, for the same answer to serve."""


class Answer(NamedTuple):
    """Lengths of the linear answer to a load in the norm of the mass [kg^(1/2) m]."""

    whole: float
    """Of all of it."""
    missing: float
    """Of what the modes lack."""


def along(force: Array, memory: dict[str, Array]) -> float | None:
    """Factor of a force (n, 3) [N] on ``memory["pushed"]`` where it is nearly a multiple of that.

    Another one stands there from then on, ``memory["ahead"]`` (1,) is set to zero, and None is returned.
    """
    last = memory["pushed"]
    size = float(np.vdot(last, last))
    share = float(np.vdot(force, last)) / size if size > 0.0 else 0.0
    if float(np.linalg.norm(force - share * last)) <= _ALIKE * float(np.linalg.norm(force)):
        return share
    memory["pushed"], memory["ahead"] = force.copy(), np.zeros(1)
    return None


class SumAnswers(NamedTuple):
    """Linear answers to sums of forces."""

    products: Array
    """Products of the answers to k forces in the norm of the mass, and of what the modes lack of them [kg m^2];
    shape (2, k, k)."""

    def of(self, factors: Array) -> Answer | None:
        """The answer to the forces times factors (k,); None where that is none."""
        whole, missing = (self.products @ factors @ factors).tolist()
        return Answer(math.sqrt(whole), math.sqrt(max(missing, 0.0))) if 0.0 < whole < math.inf else None


@final
class LinearAnswers:
    """Compares the linear answers of a shell with those of its modes.

    The answer ``u = K^-1 f`` at rest has the modal part ``Phi Lambda^-1 Phi^T f = Phi Phi^T M u`` (theory 14, eq. 8).
    The factorisation that the modes were found with serves all loads, and one solve all that are multiples of each
    other. Of parts without supports the balanced share of loads counts, and displacements without rigid ones.
    """

    def __init__(self, basis: Basis, at_rest: Callable[[], RigidFreeSolver]) -> None:
        self._basis, self._solver = basis, at_rest
        self._mass = np.repeat(basis.shell.mass, 3)

    def of(self, force: Array) -> Answer:
        """The answer to forces (n, 3) [N]."""
        moved, rest = self._both(force)
        return Answer(self._length(moved), self._length(rest))

    def of_sums(self, forces: Sequence[Array]) -> SumAnswers:
        """The answers to sums of forces (n, 3) [N]."""
        both = np.array([self._both(force) for force in forces]) * np.sqrt(self._mass)
        return SumAnswers(np.einsum("ika,jka->kij", both, both))

    def _both(self, force: Array) -> tuple[Array, Array]:
        """The linear answer (3n,) [m] to forces (n, 3) [N], and what the modes lack of it."""
        unknowns, modes = self._basis.shell.unknowns, self._basis.modes
        moved = np.asarray(unknowns.prolong(self._solver().solve(np.asarray(unknowns.restrict(force.ravel())))))
        rest = moved - modes @ (modes.T @ (self._mass * moved))
        return moved, rest

    def following(self, force: Array, memory: dict[str, Array]) -> Answer:
        """As :meth:`of`, from the last load that was solved for where the force is nearly a multiple of it.

        That load stands in ``memory["pushed"]`` (n, 3) [N], its answer in ``memory["answer"]`` (2,). A new one sets
        ``memory["ahead"]`` (1,) to zero.
        """
        share = along(force, memory)
        if share is None:
            memory["answer"], share = np.array(self.of(force)), 1.0
        whole, missing = abs(share) * memory["answer"]
        return Answer(float(whole), float(missing))

    def _length(self, moved: Array) -> float:
        return float(np.sqrt(np.vdot(self._mass * moved, moved)))


def solver_at_rest(shell: Shell) -> RigidFreeSolver:
    """Solver of the stiffness at rest, of free parts on the complement of their rigid motions."""
    return RigidFreeSolver.of(shell, shell.hessian(shell.rest_positions, GAUSS_NEWTON))
