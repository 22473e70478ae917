"""What answers of modal models say of loads beyond the linear buckling load."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from modalshell.core.cost import counted
from modalshell.core.typing import Array
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.shell import Shell
from modalshell.statics.buckling import ADVICE, BucklingCheck
from modalshell.supports.constraints import Constraint


@final
class BucklingRange:
    """Judges whether loads are beyond a shell's linear buckling load; the last one is kept.

    Modes have the stiffness at rest, and so no snap, however small the residual of their answer.
    """

    def __init__(self, shell: Shell) -> None:
        self._shell, self._check = shell, BucklingCheck(shell)
        self._known: tuple[Array, bytes, bool] | None = None

    def __reduce__(self) -> tuple[Any, ...]:  # a copy finds the factor again, which is larger than the rest of a model
        return BucklingRange, (self._shell,)

    def remark(self, answer: Equilibrium, constraints: Sequence[Constraint]) -> str:
        """What is said of an answer; "" if nothing.

        What contacts and position constraints push counts as load, and patches are held where they are.
        """
        shell, loading = self._shell, answer.loading
        if loading is None:
            return ""
        load, patches = loading.force(shell.rest_positions).copy(), np.empty(0, np.int64)
        if answer.contact_forces.size:
            load += answer.contact_forces
        for constraint, reaction in zip(constraints, answer.constraint_reactions, strict=bool(constraints)):
            patches = np.union1d(patches, constraint.vertices)
            if constraint.kind == "position":
                load[constraint.vertices] += reaction / constraint.vertices.size
        known = self._known  # read once: another thread may judge another meanwhile
        if known is None or known[1] != patches.tobytes() or not (load == known[0]).all():
            held = shell.holding(patches) if patches.size else None
            with counted():  # it is no work of the model
                known = self._known = load, patches.tobytes(), self._check.buckles(load, held)
        return ADVICE if known[2] else ""
