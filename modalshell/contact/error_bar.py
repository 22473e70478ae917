"""Error bars of answers with contacts: what touches keeps its gap while Newton's steps are taken (theory 14)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.active_set import ActiveSet, Rest
from modalshell.contact.contact import Contact
from modalshell.contact.rotated import Frames, Rotated
from modalshell.contact.touching import INSIDE, Touching, refuse_friction
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.modes import Factor
from modalshell.shell import Shell
from modalshell.statics.error_bar import Estimator
from modalshell.statics.margin import Margin
from modalshell.statics.potential import Potential
from modalshell.supports.constraints import LedVertices

_LEAST, _MOST = 2, 8
"""Newton steps of a bar: those without contacts, and at most, until the set of what touches repeats."""


@final
class ContactEstimator(Estimator):
    """Finds error bars of answers under contacts, of a shell that its supports hold.

    What touches at the answer is prescribed in each of Newton's steps, as statics do, and what pulls or enters changes
    the set. Two steps are taken, or more until the set repeats; where it does not, there is no bar. The margin is that
    on the motions that keep the gaps, forces that turn with curved surfaces softening the shell there.

    Colliders are as they are at time 0. On ``led`` vertices, which constraints lead, contacts do not push. Contacts
    with friction raise OptionError, unless loads have it in them: ``rubbed``. ``unsettled`` says whether what touches
    did not settle at the last bar.
    """

    def __init__(
        self, shell: Shell, contacts: Sequence[Contact], led: LedVertices | None = None, *, rubbed: bool = False
    ) -> None:
        super().__init__(shell, led)
        if not rubbed:
            refuse_friction(contacts, "error bars")
        self.touching = self._met = Touching(contacts, self.shell, self.origin)
        self.unsettled = False
        self._rest: Rest | None = None
        self._frames: Frames | None = None
        self._held = np.empty((0, 3, 3))

    def look(self, time: float, ahead: Array | None = None) -> None:
        """Take the colliders where they are at ``time`` [s], and shapes whose stresses are ``ahead`` (n, 3) [m]."""
        met = self._met.at(time)
        self.touching = met if ahead is None else met.behind(ahead)

    def _steps(self, problem: Potential, x: Array) -> tuple[Array, list[Array]]:
        touching, self.unsettled = self.touching, False
        gap = touching.distances(x)
        depth = -float(gap.min(initial=0.0))
        rows = touching.movable(x, np.flatnonzero(gap <= INSIDE * touching.size))
        x = x.copy()
        touching.put_on(x, rows, np.zeros(rows.size))
        solver = ActiveSet(problem, touching, problem.measure(problem.push_at(x)))
        self._rest, stresses = solver.correct(x, _LEAST, _MOST, self._way, self._led_step)
        self._way = None
        self.unsettled = not self._rest.converged
        if self.unsettled:
            where = f", from an answer {depth:.2g} m inside a collider" if depth > INSIDE * touching.size else ""
            raise SolverError(f"what touches has not settled in {_MOST} Newton steps{where}")
        return self._rest.point, stresses

    def refined(self) -> tuple[Array, list[Array]]:
        """Positions (n, 3) [m] after further steps like those of the last bar, and the stresses that they predict."""
        last = self._last()
        with np.errstate(over="ignore", invalid="ignore"):
            x, stresses = self._steps(last.problem, last.x)
        return x + self.origin, stresses

    def pushed(self) -> Array:
        """Forces (n, 3) [N] of the colliders where the last steps ended."""
        assert self._rest is not None
        return self.touching.forces(self._rest.point, self._rest.pushes)

    def margin(self, problem: Potential, x: Array, stresses: list[Array]) -> Margin:
        """The stability margin at x (n, 3) with predicted stresses, of motions along the colliders."""
        touching, rest = self.touching, self._rest
        assert rest is not None
        rows = np.flatnonzero(rest.active)
        gaps, normals, curvatures = touching.gaps(x, rows)
        self._frames = Frames(touching, rows, normals, gaps)
        kept = np.isin(rows, self._frames.rows)
        self._held = rest.pushes[self._frames.rows, None, None] * touching.across(self._frames.rows, curvatures[kept])
        return super().margin(problem, x, stresses)

    def _factor(self, problem: Potential, stiffness: sps.csc_array) -> Factor | None:
        assert self._rest is not None
        assert self._frames is not None
        rows, x = self._frames.rows, self._rest.point
        none = np.zeros(rows.size)
        gaps = self.touching.gaps(x, rows)
        equations = Rotated(problem, self.touching, np.zeros(0), stiffness, rows, none, gaps)
        return problem.definite_factor(equations.matrix(np.zeros(stiffness.shape[0])))

    def _along(self, values: Array) -> Array:
        assert self._frames is not None
        return np.asarray(self._frames.turned(values, back=True))

    def _across(self, along: Array, force: Array) -> Array:
        frames = self._frames
        assert frames is not None
        starts, sizes = self.touching.starts(frames.rows)
        slots, used = starts[:, None] + np.arange(3), np.arange(3) < sizes[:, None]
        slots = np.where(used, slots, 0)
        pulled = np.einsum("kab,kb->ka", self._held, np.where(used, along[slots], 0.0))
        force = force.copy()
        np.subtract.at(force, slots[used], pulled[used])
        turned = frames.turned(force)
        turned[frames.unknowns] = 0.0
        return np.asarray(turned)
