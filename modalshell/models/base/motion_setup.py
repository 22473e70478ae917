"""What decides a motion but for its model: step, damping, loads, and the paths of supports and constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from modalshell.constraints import Constraint
from modalshell.integrators.state import Damping
from modalshell.loads import Loading
from modalshell.supports import SupportPath


@final
@dataclass(frozen=True, eq=False)
class MotionSetup:
    """What decides a motion, but for its model and its start.

    Attributes
    ----------
    dt : float
        Step [s].
    damping : Damping
        Damping.
    loading : Loading
        The loads.
    supports : SupportPath or None
        Moves the supports.
    constraints : sequence of Constraint
        On patches of vertices.
    """

    dt: float
    damping: Damping
    loading: Loading
    supports: SupportPath | None = None
    constraints: Sequence[Constraint] = ()
