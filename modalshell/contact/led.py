"""Equilibria with contacts of shells whose patches are led to their targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sps

from modalshell.contact.active_set import ActiveSet, Rest
from modalshell.contact.descent import descend
from modalshell.contact.rotated import Rotated
from modalshell.contact.touching import INSIDE, Touching, put_out
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.typing import Array, Index
from modalshell.shell import Shell
from modalshell.statics import mixed_newton as method
from modalshell.statics.boundary import FIRST_STEP, places, predicted
from modalshell.statics.continuation import Steps
from modalshell.statics.newton import rules_of
from modalshell.statics.potential import Potential
from modalshell.supports.constraints import HeldPatch

_MOST = 40
"""Iterations of a step at most: those of :data:`.mixed_newton.CONTINUED`, and some in which sets change."""


def rest_of_led(
    problem: Potential, shell: Shell, touching: Touching, patches: Sequence[HeldPatch], start: Array, origin: Array
) -> Rest:
    """Minimum outside colliders with the patches at their targets, led there from ``start`` (n, 3) [m] in steps.

    The whole load comes with the first step. Each is predicted along the tangent, on which what touches stays on its
    collider, and solved by Newton's steps with active sets; where that ends at no minimum, or behind a collider, the
    step is shortened, and at last the shell goes downhill from where it is, with the patches at the step's end.

    Parameters
    ----------
    problem : Potential
        On the shell with the patches' vertices held.
    shell : Shell
        The shell without, about ``origin`` (3,) [m] in the world.
    touching : Touching
        The contacts of the held shell, without friction.
    patches : sequence of HeldPatch
        The patches, with targets in the world.
    start : ndarray, shape (n, 3)
        Where the way begins.
    origin : ndarray, shape (3,)
        As above.

    Raises
    ------
    OptionError
        For a start inside a collider, or targets there: contacts do not push on patches.
    """
    touching.refuse_inside(start)
    vertices = np.concatenate([patch.vertices for patch in patches])
    begin, steps, iterations = start[vertices], Steps(FIRST_STEP), 0
    _refuse_targets(touching, vertices, places(patches, begin, origin, 1.0) + origin)
    size = problem.measure(problem.push)
    rest = Rest(start, np.zeros(touching.vertices.size, dtype=bool), np.zeros(touching.vertices.size), 1.0, 0, False)
    rest = replace(rest, active=ActiveSet(problem, touching, size).near(start))
    while steps.fraction < 1.0:
        steps.limit()
        target = places(patches, begin, origin, steps.target)
        led = _step(problem, shell, touching, rest, (vertices, target, size))
        iterations += led.iterations
        if not led.stable:
            if steps.refuse():
                continue
            led = _slowly(problem, touching, rest, (vertices, target, size))
            iterations += led.iterations
            if not led.converged:
                return replace(led, iterations=iterations)
        rest = led
        steps.accept()
    return replace(rest, iterations=iterations)


def _refuse_targets(touching: Touching, vertices: Index, target: Array) -> None:
    """Raise OptionError where patches' ``vertices`` (k,) have their ``target`` (k, 3) [m] in the world inside a collider."""
    for index, contact in enumerate(touching.contacts):
        gap = np.asarray(contact.distance(target, touching.time))
        gap = np.where(contact.vertices(touching.shell.mesh)[vertices], gap, np.inf)
        worst = int(np.argmin(gap))
        if gap[worst] < -INSIDE * touching.size:
            kind = type(contact.collider).__name__
            raise OptionError(
                f"a constraint leads vertex {vertices[worst]} to {-gap[worst]:.3g} m inside contact {index} ({kind}): "
                "move its target or the collider, or leave the vertex out of the contact's sel"
            )


def _step(
    problem: Potential, shell: Shell, touching: Touching, rest: Rest, way: tuple[Index, Array, float]
) -> Rest:
    """Where a step leads that takes ``vertices`` (k,) to a target (k, 3); stable if it found a minimum outside."""
    vertices, target, size = way
    failed = replace(rest, converged=False, stable=False, iterations=1)
    rows, x = np.flatnonzero(rest.active), rest.point

    def direction(gradient: Array, hessian: sps.csc_array) -> Array:
        gaps = touching.gaps(x, rows)
        return Rotated(problem, touching, gradient, hessian, rows, rest.pushes[rows], gaps).solve()[0]

    try:
        guess, stresses, reaction, straight = predicted(problem, shell, x, vertices, target, direction)
        if not (straight and np.isfinite(guess).all()):
            return failed
        solver = ActiveSet(problem, touching, max(size, reaction))
        rules = rules_of(problem, method.GOAL, _MOST)
        found = solver.settled(solver.iterate(guess, rest.active, rules, stresses))
    except SolverError:
        return failed
    found = replace(found, iterations=1 + found.iterations)
    return replace(found, stable=False) if found.stable and touching.crossed(x, found.point) else found


def _slowly(problem: Potential, touching: Touching, rest: Rest, way: tuple[Index, Array, float]) -> Rest:
    """Where the way downhill leads with ``vertices`` (k,) at once at their target (k, 3)."""
    vertices, target, size = way
    x = rest.point.copy()
    x[vertices] = target
    x = put_out(touching, x, np.ones(len(touching.contacts), dtype=bool))
    scale = max(size, problem.measure(problem.residual(x)))
    return descend(ActiveSet(problem, touching, scale), x, rules_of(problem, method.GOAL, _MOST))
