"""Contacts of modal models whose patches constraints lead: both hold, in statics and at the end of each step.

Constraints linearised at q leave the contacts motions of a compliance ``G - G C^T (C G C^T)^-1 C G``, G being that of
all coordinates and C the constraints' Jacobian; where these lead, they are linearised again. What contacts press in
beyond the modes leaves the means of patches where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np

from modalshell.contact.led import refuse_led_inside
from modalshell.contact.modal import ModalContacts
from modalshell.contact.pressed import Pressed
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.manipulation import MET, REACHED, STAGE, PatchTargets, meet, out_of_reach
from modalshell.models.base.modal_motion import CONSTRAINT_MET, ModalMotion
from modalshell.models.base.settle import extrapolated
from modalshell.supports.constraints import Constraint

_LEAST = 0.005
"""Stiffness, over that of the modes, that problems of statics have at least: where a shell buckles there is none."""
_MEMORY = 4
"""Passes that foresee the next one."""
_PASSES = 20
"""Linearisations of constraints in a step at most."""


@final
class LedTargets:
    """Targets of constraints, as :class:`PatchTargets` has them, with what contacts press in at the patches.

    Statics leads the patches from ``start`` (m,); ``first`` is the first part of their way that it takes.
    """

    def __init__(self, targets: PatchTargets, start: Array | None = None) -> None:
        self._targets, self._way = targets, np.zeros(1) if start is None else targets(start)[0]
        self._local = self._later = self._unreached = np.zeros(1)
        self._seen: list[tuple[Array, Array]] = []
        self._known: tuple[Array, tuple[Array, Array]] | None = None
        self.first = min(1.0, STAGE / max(float(np.abs(self._way).max()), 1e-300))

    def __call__(self, q: Array) -> tuple[Array, Array]:
        """Residuals (3k,) and Jacobian (3k, m) at q (m,); what modes do not reach of a target is none."""
        residuals, jacobian = self._at(q)
        return residuals - self._local - self._later - self._unreached, jacobian

    def _at(self, q: Array) -> tuple[Array, Array]:
        """The targets alone at q (m,): each pass asks several times where it is."""
        if self._known is None or not np.array_equal(self._known[0], q):
            self._known = q.copy(), self._targets(q)
        return self._known[1]

    def near(self, free: Array, compliance: Array, start: Array, local: Array, share: float = 1.0) -> Array:
        """Coordinates (m,) that meet the targets without contacts, as near as modes do, from ``start`` (m,).

        What is ``local`` (n, 3) [m], beyond the modes, stays; a ``share`` of the way is enough.
        """
        self._local, self._seen = self._targets.local_means(local), []
        self._unreached, self._later = np.zeros(1), (1.0 - share) * self._way
        q, self._unreached, _ = meet(self, free, compliance, start)
        return q

    def along(self, q: Array, free: Array, compliance: Array) -> tuple[Array, Array]:
        """Ends ``free`` (m,) and compliance (m, m) of motions that keep to the constraints linearised at q (m,).

        They are made of those of all motions, whose compliance is (m,) or (m, m).
        """
        whole = np.diag(compliance) if compliance.ndim == 1 else compliance
        residuals, jacobian = self(q)
        given = whole @ jacobian.T
        given = given @ np.linalg.pinv(jacobian @ given, rcond=REACHED)
        kept = whole - given @ (jacobian @ whole)
        return free + given @ (residuals + jacobian @ (q - free)), np.ascontiguousarray(kept)

    def stiffened(self, q: Array, hessian: Array, eigenvalues: Array) -> Array:
        """A Hessian (m, m), stiffer where it is hardly so on motions that keep to the constraints at q (m,)."""
        root = np.sqrt(eigenvalues)
        _, sizes, axes = np.linalg.svd(self(q)[1] / root)
        free = axes[int((sizes > REACHED * sizes[:1]).sum()) :] / root
        along = free @ (hessian + hessian.T) @ free.T
        least = 0.5 * float(np.linalg.eigvalsh(along)[0]) if len(free) else 1.0
        return hessian + max(0.0, _LEAST - least) * np.diag(eigenvalues)

    def off(self, pressed: Pressed) -> float:
        """Largest residual of the targets where contacts leave the shell, with what they have pressed in.

        What they will have pressed in next is foreseen, by Anderson's extrapolation.
        """
        found = self._targets.local_means(pressed.local)
        off = self(pressed.q)[0] + self._local - found
        if not np.isfinite(off).all():
            return np.inf
        self._seen = [*self._seen[1 - _MEMORY :], (self._local, found - self._local)]
        self._local = extrapolated(*map(list, zip(*self._seen, strict=True)))
        return float(np.abs(off).max())

    def missed(self, q: Array, local: Array) -> Array:
        """Lengths (k,), [m] or [rad], of what is left to the targets at q (m,) and ``local`` (n, 3) [m] beyond it."""
        return self._targets.lengths(self._at(q)[0] - self._targets.local_means(local))

    def forces(self, q: Array, unbalanced: Array, count: int) -> Array:
        """Forces (n, 3) [N] on ``count`` vertices of constraints that bear an ``unbalanced`` modal force (m,) at q."""
        return self._targets.spread(self._targets.reactions(self._at(q)[1], unbalanced), count)

    def answered(self, answer: Equilibrium, local: Array, unbalanced: Array) -> Equilibrium:
        """An answer with what it has left to the targets, and the reactions to an ``unbalanced`` modal force (m,).

        What is ``local`` (n, 3) [m] is beyond its modes.
        """
        assert answer.coordinates is not None
        q = answer.coordinates
        missed, reactions = self.missed(q, local), self._targets.reactions(self._at(q)[1], unbalanced)
        answer = replace(answer, constraint_residuals=missed, constraint_reactions=reactions)
        if not answer.converged or (missed <= CONSTRAINT_MET * self._targets.units).all():
            return answer
        return replace(answer, outcome=Outcome.OUT_OF_REACH, message=out_of_reach(float(missed.max())))


def hold_patches(pressing: ModalContacts, constraints: Sequence[Constraint]) -> None:
    """Leave patches where they are in what contacts press in."""
    pressing.hold([constraint.vertices for constraint in constraints if constraint.kind == "position"])


def led_from(
    model: ModalMotion, pressing: ModalContacts, start: Array, constraints: Sequence[Constraint]
) -> LedTargets:
    """Targets of statics that leads patches from a ``start`` (m,); OptionError where these put a vertex inside."""
    hold_patches(pressing, constraints)
    for constraint in constraints:
        if constraint.kind == "position" and constraint.vertices.size == 1:
            refuse_led_inside(pressing.touching, constraint.vertices, constraint.at(0.0)[None])
    return LedTargets(model._targets(constraints, start), start)


def press_led(
    model: ModalMotion,
    pressing: ModalContacts,
    targets: LedTargets,
    step: tuple[Array, Array],
    begin: tuple[Array, Array],
    gaps: Array,
    before: tuple[Array, Array, Array | None],
) -> Pressed:
    """As :meth:`ModalContacts.press`, of what also meets targets.

    ``step`` are the coordinates without contacts and constraints and the compliance, (m,) or (m, m), ``begin`` those
    and positions before. Each pass is Newton's on the coordinates, forces and reactions; where none meets the targets,
    what is nearest to them is returned, of these and of what contacts alone do, as not solved.
    """
    (free, compliance), (last, base), (local, pushes, _) = step, begin, before
    kept = before
    whole = np.diag(compliance) if compliance.ndim == 1 else compliance
    q, stiffness = targets.near(free, whole.diagonal(), free, local), np.asarray(np.linalg.inv(whole), np.float64)
    best, least, known = None, np.inf, gaps
    for _ in range(_PASSES):
        x, unbalanced = pressing.positions(q) + local, stiffness @ (q - free)
        forces = pressing.touching.forces(x, pushes)
        borne = unbalanced - pressing.pull(q, forces)
        if not np.isfinite(borne).all():
            break
        hessian = stiffness - model.work_curvature(q, forces + targets.forces(q, borne, len(x)))
        try:
            soft = np.asarray(np.linalg.inv(targets.stiffened(q, hessian, stiffness.diagonal())), np.float64)
            aims = targets.along(q, q - soft @ unbalanced, soft)
        except np.linalg.LinAlgError:  # of passes that run away
            break
        pressed = pressing.press(*aims, (q, last, base), known, kept)
        off = targets.off(pressed)
        if pressed.solved and off <= MET:
            return pressed
        if pressed.solved and off < least:
            best, least = pressed, off
        assert pressed.positions is not None
        assert pressed.gaps is not None
        q = last = pressed.q
        base, known = pressed.positions, np.minimum(gaps, pressed.gaps)
        local, pushes = pressed.local, pressed.pushes
        kept = local, pushes, pressed.at
    alone = pressing.press(free, compliance, (free, *begin), gaps, before)
    if best is None or targets.off(alone) < least:
        best = alone
    return best._replace(solved=False)
