"""Equilibria with contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from modalshell.contact.active_set import DIRECT, ActiveSet, Rest
from modalshell.contact.descent import descend
from modalshell.contact.layered import LayeredEnergy, Patterns, pressure_of
from modalshell.contact.layers import Layers
from modalshell.contact.touching import Touching, put_out
from modalshell.core.typing import Array
from modalshell.statics import mixed_newton as method
from modalshell.statics.continuation import Steps
from modalshell.statics.newton import rules_of
from modalshell.statics.potential import Potential

_SHALLOW = 1e-3
"""Depth, as a share of the shell's size, from which a start is led out in steps."""
_FIRST_STEP = 0.125
"""First share of the way out."""
_HALFWAY = 0.25
"""Depth, as a share of the collider's smallest radius, from which a start may be on the wrong side of its middle."""
_CLOSE = 0.1
"""Distance of layers, as a share of the gap, below which the barrier is stiffened."""
_STIFFER, _STIFFENED = 8.0, 6
"""By how much, and how often at most."""


def rest_on_contacts(
    problem: Potential, touching: Touching, start: Array, guess: Callable[[], Array | None] | None = None
) -> Rest:
    """Minimum of a potential outside the contacts' colliders, from ``start`` (n, 3) [m].

    The whole load is tried at once, with the rows that touch at the start; where that ends at no minimum, or at one
    that lies behind a collider, it is tried from the ``guess`` (n, 3) that is then asked for, if there is one; then, of
    loads without a potential, in growing shares; where that does not help either, the shell goes downhill from the
    start, by :mod:`.descent`. A start inside colliders that push out is led out in steps, without a guess: the surfaces
    come from where they touch its deepest vertices.

    Iterations are Newton's of all that was tried; but from the guess on where the minimum is found from it. OptionError
    for a start inside a collider that does not push out; names the vertex and its depth.
    """
    touching.refuse_inside(start)
    depth = touching.deepest_by_contact(start)
    if depth.min(initial=0.0) >= -_SHALLOW * touching.size:
        rest = _directly(problem, touching, start)
        if rest.stable:
            return rest
        begin, tried = None if guess is None else guess(), rest.iterations
        if begin is not None and np.isfinite(begin).all():
            rest = _from_guess(problem, touching, start, begin)
            if rest.stable:
                return rest
            tried += rest.iterations
        if problem.live is not None and not problem.live.conservative:
            rest = _growing(problem, touching, start, tried)
            if rest.stable:
                return rest
            tried = rest.iterations
        return _slowly(problem, touching, start, tried)
    x, iterations, steps = start, 0, Steps(_FIRST_STEP)
    while steps.fraction < 1.0:
        led = touching.with_bounds(depth * (1.0 - steps.target)) if steps.target < 1.0 else touching
        rest = _directly(problem, led, x)
        iterations += rest.iterations
        if not rest.stable:
            if steps.refuse():
                continue
            rest = _slowly(problem, led, x, 0)
            iterations += rest.iterations
            if not rest.converged:
                break
        x = rest.point
        steps.accept()
    return replace(rest, iterations=iterations)


def rest_on_layers(problem: Potential, touching: Touching, layers: Layers, start: Array) -> tuple[Rest, Layers]:
    """Minimum with a barrier between ``layers`` in it, outside colliders, from ``start`` (n, 3) [m]; and the layers.

    The shell goes downhill, by :mod:`.descent`. The barrier is stiffened, from the load over the area on, until no two
    layers are nearer than a small part of the gap. OptionError for a start that crosses itself, or inside a collider.
    """
    touching.refuse_inside(start)
    layers.refuse_crossing(start, "at the start")
    patterns = Patterns(problem.factoriser.backend)
    pressure = pressure_of(problem.force(start), problem) or problem.scale_at(start) / problem.shell.mesh.area
    iterations = 0
    for _ in range(_STIFFENED):
        layers = layers.stiff(pressure)
        layered = replace(problem, further=LayeredEnergy(layers, patterns))
        rest = _slowly(layered, touching, start, iterations)
        iterations = rest.iterations
        if not rest.converged or layers.least(rest.point) >= _CLOSE * layers.gap:
            break
        start, pressure = rest.point, _STIFFER * pressure
    return rest, layers


def sides_note(touching: Touching, start: Array) -> str:
    """What is said of a ``start`` (n, 3) [m] near the middle of a collider, which knows no side; "" of others."""
    gaps = touching.distances(start)
    for index, contact in enumerate(touching.contacts):
        depth, radius = -float(gaps[touching.of_contact(index)].min(initial=0.0)), contact.collider.smallest_radius
        if depth > max(_HALFWAY * radius, _SHALLOW * touching.size):
            return (
                f"the start is {depth:.2g} m inside contact {index}, {depth / radius:.2g} of its smallest radius, and "
                "was pushed out on the nearer side: where that is the wrong one, begin on the other (start=)"
            )
    return ""


def _directly(problem: Potential, touching: Touching, start: Array) -> Rest:
    """Where Newton's steps with active sets lead from a start; not stable where they lead through a collider."""
    solver = ActiveSet.at_rest(problem, touching, start)
    rest = solver.settled(solver.iterate(start, solver.near(start), rules_of(problem, method.GOAL, DIRECT)))
    return replace(rest, stable=False) if rest.stable and touching.crossed(start, rest.point) else rest


def _growing(problem: Potential, touching: Touching, start: Array, iterations: int) -> Rest:
    """Where the shell comes to as the load grows, after some ``iterations`` in vain: for loads without a potential."""
    x, steps = start, Steps(_FIRST_STEP)
    while True:
        rest = _directly(problem.loaded(steps.target), touching, x)
        iterations += rest.iterations
        if rest.stable:
            x = rest.point
            steps.accept()
            if steps.fraction >= 1.0:
                return replace(rest, iterations=iterations)
        elif not steps.refuse():
            return replace(rest, point=x, converged=False, iterations=iterations)


def _from_guess(problem: Potential, touching: Touching, start: Array, guess: Array) -> Rest:
    """Where a guess leads that is put out of the colliders; not stable where the start may not come down to there."""
    rest = _directly(problem, touching, put_out(touching, guess, np.ones(len(touching.contacts), dtype=bool)))
    if not rest.stable:
        return rest
    higher = problem.potential(rest.point)[0] > problem.potential(start)[0]
    return replace(rest, stable=False) if higher or touching.crossed(start, rest.point) else rest


def _slowly(problem: Potential, touching: Touching, start: Array, iterations: int) -> Rest:
    """Where the way downhill leads, after some ``iterations`` in vain."""
    solver = ActiveSet.at_rest(problem, touching, start)
    rest = descend(solver, start, rules_of(problem, method.GOAL, DIRECT))
    return replace(rest, iterations=iterations + rest.iterations)
