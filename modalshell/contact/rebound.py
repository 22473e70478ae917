"""Rebounds in steps of full models: impulses that give what strikes its speeds, on the whole shell (theory 13, eq. 11).

An impulse at a vertex moves what the vertex takes along within a step: of a stiff plate all, of a limp one itself. So
rates change by it as they do by a force in a step of implicit Euler, by the inverse of its matrix.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np

from modalshell.contact.rotated import Rotated
from modalshell.contact.touching import EXACT_GAP, Touching
from modalshell.core.typing import Array, Index
from modalshell.shell import GAUSS_NEWTON
from modalshell.statics.potential import Potential

BOUNCE = 3.0
"""Speed, over what the load gives a vertex in a step, below which nothing bounces."""
_SETS = 12
"""Sets of rows that get impulses, at most."""
_RUBBED = 4
"""Solves for friction, whose impulses change those along the normals, and these it."""
_SLOWER = 1e-9
"""Part of the largest speed by which rows may be slower than wanted."""


@final
class Rebound:
    """Impulses at the end of a step of implicit Euler of ``dt`` [s], with contacts and positions (n, 3) [m] there."""

    def __init__(self, problem: Potential, touching: Touching, x: Array, dt: float) -> None:
        self._problem, self._touching, self._dt = problem, touching, dt
        self._hessian = problem.linearise(x, GAUSS_NEWTON)[1]
        self._still = np.zeros(problem.push.size)

    def along(self, rows: Index, normals: Array, needed: Array, first: Index) -> tuple[Array, Array, Index]:
        """Change (n, 3) [m/s] of the rates by the least impulses that make rows faster along their normals.

        The ``rows`` (k,) that touch have ``normals`` (k, 3) and are to be faster by ``needed`` (k,) [m/s] at least;
        ``first`` are those sure to get an impulse, or nearly. Also returns the impulses (k,) [N s], and which of the
        rows got any.
        """
        goal, chosen = _SLOWER * float(np.abs(needed).max()), np.asarray(first)
        vertices = self._touching.vertices[rows]
        for _ in range(_SETS):
            impulses = np.zeros(rows.size)
            change, impulses[chosen] = self._solved(rows[chosen], normals[chosen], needed[chosen], self._still)
            slow = np.sum(normals * change[vertices], axis=1) < needed - goal
            slow[chosen] = False
            again = np.flatnonzero((impulses > 0.0) | slow)
            if np.array_equal(again, chosen):
                break
            chosen = again
        return change, np.maximum(impulses, 0.0), chosen

    def across(self, rows: Index, normals: Array, impulses: Array) -> tuple[Array, Array]:
        """Change (n, 3) [m/s] of the rates by ``impulses`` (k, 3) [N s] that leaves the speeds along normals alone.

        And the impulses (k,) [N s] along the normals that this takes.
        """
        force = np.zeros((len(self._problem.origin), 3))
        np.add.at(force, self._touching.vertices[rows], impulses / self._dt)
        gradient = np.asarray(-self._problem.shell.unknowns.restrict(force.ravel()))
        return self._solved(rows, normals, np.zeros(rows.size), gradient)

    def rubbed(
        self, rows: Index, normals: Array, found: tuple[Array, Array], slips: Array, friction: Array
    ) -> tuple[Array, Array, Array]:
        """Change (n, 3) [m/s], impulses (k,) along the normals and of friction (k, 3) [N s] with that against slips.

        By Coulomb's law, at most until what slips stops. ``found`` are the change and impulses without it, ``slips``
        (k, 3) [m/s] those before, and ``friction`` (k,) the coefficients of some rows.
        """
        (change, alone), sizes = found, np.linalg.norm(slips, axis=1)
        ways = -slips / np.where(sizes > 0.0, sizes, np.inf)[:, None]
        impulses, held, vertices = alone, np.zeros_like(slips), self._touching.vertices[rows]
        slower, part, after = np.zeros_like(change), 1.0, slips + change[vertices]
        for _ in range(_RUBBED):
            held = (friction * impulses)[:, None] * ways
            if not held.any():
                break
            slower, also = self.across(rows, normals, held)
            part = min(1.0, max(0.0, -float(np.sum(held * after)) / float(np.sum(held * slower[vertices]))))
            impulses = np.maximum(alone + part * also, 0.0)
        return change + part * slower, impulses, part * held

    def _solved(self, rows: Index, normals: Array, faster: Array, gradient: Array) -> tuple[Array, Array]:
        """Change (n, 3) [m/s] of the rates under a ``gradient`` that makes rows ``faster``, and its impulses there."""
        flat = -self._dt * faster, normals, np.zeros((rows.size, 3, 3))
        none, impulses = np.zeros(rows.size), np.zeros(rows.size)
        equations = Rotated(self._problem, self._touching, gradient, self._hessian, rows, none, flat)
        direction, forces = equations.solve()
        impulses[np.isin(rows, equations.frames.rows)] = self._dt * forces
        return self._problem.shell.unknowns.prolong(direction).reshape(-1, 3) / self._dt, impulses


def striking(speed: float | Array, gained: float | Array, needed: float | Array) -> Any:
    """Speed [m/s] with which what closes with a ``speed`` at the beginning of a step strikes within it.

    ``gained`` is what it would gain in the whole step, and ``needed`` the speed that would close the gap in just that.
    By the speed of the beginning a rebound would lose what the load gives on the way (theory 13, eq. 11).
    """
    return np.sqrt(speed**2 + 2.0 * gained * needed)


def gaps_and_speeds(
    touching: Touching, rows: Index, x: Array, time: float, there: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Gaps (k,) [m] of rows at positions x (n, 3) where a step begins, at ``time`` [s], and speeds (k,) [m/s].

    Those which its collider gives in the step to what lies on it, and which do not make it strike: none of what begins
    apart. ``there`` are the normals and velocities (k, 3) [m/s] of the collider at its end.
    """
    (normals, drift), before = there, touching.at(time).with_bounds(None)
    gaps = before.gaps(x, rows)[0]
    gained = np.abs(np.sum(normals * (drift - before.velocities(x, rows)), axis=1))
    return gaps, np.where(gaps > EXACT_GAP * touching.size, 0.0, gained)


def rebounded(
    touching: Touching,
    step: tuple[Potential, float],
    before: tuple[Array, Array, float],
    after: tuple[Array, Array, Array],
    loads: Array,
    rows: Index,
) -> tuple[Array, Array]:
    """Rates (n, 3) [m/s] after the rebounds of what struck in a step, and their impulses (n, 3) [N s].

    All that touches gets impulses; what does not strike, for no further speed. A step has no more energy after them
    than before it, and what the load and moving colliders give.

    Parameters
    ----------
    touching : Touching
        The contacts at its end.
    step : tuple
        The potential of the last step of implicit Euler in it, and how long that was [s].
    before : tuple
        Positions and rates (n, 3) at its beginning, and when that was [s].
    after : tuple of ndarray, shape (n, 3)
        Positions and rates at its end, and the impulses [N s] that contacts have given in it.
    loads : ndarray, shape (n, 3)
        What the load pushes with [N].
    rows : ndarray of int, shape (k,)
        What touches.
    """
    (old, old_rates, time), (x, rates, given), mass = before, after, touching.shell.mass
    vertices, dt, nothing = touching.vertices[rows], touching.time - time, np.zeros_like(x)
    normals, drift = touching.normals(x, rows), touching.velocities(x, rows)
    alone = rates - given / np.maximum(mass, 1e-300)[:, None]
    was, leaves, free = (np.sum(normals * (one[vertices] - drift), axis=1) for one in (old_rates, rates, alone))
    reach = dt * np.linalg.norm(loads[vertices], axis=1) / mass[vertices]
    gaps, faster = gaps_and_speeds(touching, rows, old, time, (normals, drift))
    kept = touching.restitution[rows]
    strikes = (kept > 0.0) & (-was > BOUNCE * (reach + faster))
    if not strikes.any():
        return rates, nothing
    speeds = striking(-was, np.minimum(np.maximum(was - free, 0.0), reach), np.maximum(gaps, 0.0) / dt)
    rebound = Rebound(step[0], touching, x, step[1])
    needed = np.where(strikes, kept * speeds, 0.0) - leaves
    change, impulses, chosen = rebound.along(rows, normals, needed, np.flatnonzero(strikes))
    slips = rates[vertices] - drift - leaves[:, None] * normals
    forced = np.zeros_like(slips)
    if touching.friction[rows].any():
        own = rows[chosen], normals[chosen], (change, impulses[chosen]), slips[chosen], touching.friction[rows[chosen]]
        change, impulses[chosen], forced[chosen] = rebound.rubbed(*own)
    forced += impulses[:, None] * normals
    lost = touching.shell.energy(old) - touching.shell.energy(x) + float(np.sum(loads * (x - old)))
    lost += 0.5 * float(mass @ np.sum(old_rates**2 - rates**2, axis=1)) + float(np.sum(given[vertices] * drift))
    share = _share(lost, float(np.sum(forced * drift)), mass, rates, change)
    np.add.at(nothing, vertices, share * impulses[:, None] * normals)
    return rates + share * change, nothing


def _share(lost: float, work: float, mass: Array, rates: Array, change: Array) -> float:
    """Share of a change of rates (n, 3) after which a step has no more energy than the ``work`` [J] of it gives.

    ``lost`` [J] is what it has lost without the change.
    """
    slope = float(mass @ np.sum(rates * change, axis=1)) - work
    bend = 0.5 * float(mass @ np.sum(change**2, axis=1))
    if slope + bend <= lost or bend == 0.0:
        return 1.0
    return min(1.0, float(np.sqrt(slope**2 + 4.0 * bend * max(lost, 0.0)) - slope) / (2.0 * bend))
