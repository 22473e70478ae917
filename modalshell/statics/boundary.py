"""Statics of discrete shells under constraints, by continuation of the patches to their targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sps

from modalshell.core.errors import SolverError
from modalshell.core.timings import Timings
from modalshell.core.typing import Array, Index
from modalshell.modes import Factoriser
from modalshell.shell import EXACT, GAUSS_NEWTON, Shell
from modalshell.statics.continuation import Steps
from modalshell.statics.flutter import without_flutter
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.mixed_newton import ACCEPTED, CONTINUED
from modalshell.statics.newton import NewtonResult, is_minimum, mixed_newton
from modalshell.statics.potential import Potential
from modalshell.statics.refine import refine
from modalshell.statics.warped import led_step
from modalshell.supports.constraints import Constraint, HeldPatch

FIRST_STEP = 0.25
"""First fraction of a motion of the boundary taken in one step."""
_STEP_TURN = 0.6
"""Largest predicted rotation [rad] of a vertex per step."""


def continue_boundary(
    shell: Shell,
    load: Array,
    start: Array | None,
    patches: Sequence[HeldPatch],
    origin: Array,
    factoriser: Factoriser,
    costs: Timings,
    live: LiveLoads | None = None,
) -> NewtonResult:
    """Equilibrium with the patches at their targets, moved there from ``start`` (n, 3), or rest, in steps that adapt.

    Targets are in the world's frame, where the shell's origin is at ``origin`` (3,).

    Each step is predicted along the tangent, warped, and solved by mixed Newton; where that ends at no minimum the step
    is shortened, and at last the potential is minimised.
    """
    vertices = np.concatenate([patch.vertices for patch in patches])
    held = shell.holding(vertices)
    problem = Potential(load, shell.rest_positions, held, factoriser, costs, live)
    x = shell.rest_positions if start is None else start
    begin, steps, iterations = x[vertices], Steps(FIRST_STEP), 0
    size = problem.measure(problem.push)

    def direction(gradient: Array, hessian: sps.csc_array) -> Array:
        return problem.step(problem.factor(hessian), gradient)

    while steps.fraction < 1.0:
        steps.limit()
        target = places(patches, begin, origin, steps.target)
        try:
            guess, stresses, reaction, straight = predicted(problem, shell, x, vertices, target, direction)
            scale = max(size, reaction, 1e-300)
            result = mixed_newton(problem, guess, scale, limit=CONTINUED, stresses=stresses)
            iterations += 1 + result.iterations
            solved = straight and is_minimum(problem, result)
        except SolverError:
            solved = False
        if not solved:
            if steps.refuse():
                continue
            guess = x.copy()
            guess[vertices] = target
            scale = max(size, float(np.linalg.norm(problem.residual(guess))), 1e-300)
            result = problem.descend(guess, scale)
            iterations += result.iterations
            if not result.converged:
                return replace(result, iterations=iterations)
        x = result.point
        steps.accept()
    result = without_flutter(problem, refine(problem, replace(result, iterations=iterations), scale))
    if result.limited and (residual := unstressed(problem, result.point)) is not None:
        return replace(result, residual=residual, converged=True, limited=False)
    return result


def places(patches: Sequence[HeldPatch], begin: Array, origin: Array, fraction: float) -> Array:
    """Where the patches are at a fraction of their way from ``begin`` (k, 3), about the shell's origin (k, 3).

    Patches that turn do so rigidly, from rest: straight ways would crush them, and a start is left behind.
    """
    if any(patch.orientation is not None for patch in patches):
        return np.concatenate([patch.at(0.0, fraction) - origin for patch in patches])
    end = np.concatenate([patch.at(0.0) - origin for patch in patches])
    return np.asarray(begin + fraction * (end - begin))


def predicted(
    problem: Potential,
    shell: Shell,
    x: Array,
    vertices: Index,
    target: Array,
    solve: Callable[[Array, sps.csc_array], Array],
) -> tuple[Array, list[Array], float, bool]:
    """Positions and stresses where the patches' vertices come to ``target`` (k, 3), along the tangent at x.

    ``solve`` gives Newton's direction (N,) of a gradient (N,) and a Hessian. Also returns the size of the reaction [N]
    there, and whether no vertex turns too far.
    """
    held, moved = problem.shell, np.zeros_like(x)
    moved[vertices] = target - x[vertices]
    gradient, hessian = problem.linearise(x, EXACT)
    tangent = held.hessian(x, EXACT)
    pull = held.pattern.product(tangent, moved.ravel())
    direction = solve(gradient + held.unknowns.restrict(pull), hessian)
    moved += held.unknowns.prolong(direction).reshape(-1, 3)
    reaction = float(np.linalg.norm(held.pattern.product(tangent, moved.ravel()).reshape(-1, 3)[vertices]))
    guess, stresses, fraction = led_step(shell, held, x, moved, (vertices, target), _STEP_TURN)
    return guess, stresses, reaction, fraction > 0.999


def unstressed(problem: Potential, x: Array) -> float | None:
    """Residual of a shell that no load acts on, where rounding explains all its forces at x (n, 3), reactions too.

    That is of a shell which its patches have moved as a rigid body: there is no force to which its balance relates.
    None of other shells.
    """
    if problem.push_at(x).any():
        return None
    noise = problem.rounding(x, problem.linearise(x, GAUSS_NEWTON)[1], 0.0)
    forces = float(np.linalg.norm(problem.shell.energy_gradient(x)[1]))
    return ACCEPTED * float(np.linalg.norm(problem.residual(x))) / noise if forces <= noise else None


def _by_vertices(patches: Sequence[HeldPatch]) -> dict[bytes, HeldPatch]:
    """The patches by the vertices that their constraints name."""
    return {patch.position.vertices.tobytes(): patch for patch in patches}


def missed_by(constraints: Sequence[Constraint], patches: Sequence[HeldPatch], x: Array, origin: Array) -> Array:
    """How far patches at x (n, 3), about the ``origin`` (3,), are from constraints' targets: [m] or [rad], (k,)."""
    of_patch = _by_vertices(patches)
    missed = np.empty(len(constraints))
    for index, constraint in enumerate(constraints):
        patch = of_patch[constraint.vertices.tobytes()]
        target, own = patch.at(0.0), x[patch.vertices] + origin
        if constraint.kind == "position":
            missed[index] = np.linalg.norm((own - target).mean(axis=0))
        else:
            arms, ends = own - own.mean(axis=0), target - target.mean(axis=0)
            chord = float(np.linalg.norm(arms - ends)) / max(float(np.linalg.norm(ends)), 1e-300)
            missed[index] = 2.0 * np.arcsin(min(1.0, 0.5 * chord))  # about axes across the patch
    return missed


def reactions_of(
    shell: Shell,
    constraints: Sequence[Constraint],
    patches: Sequence[HeldPatch],
    x: Array,
    load: Array,
    live: LiveLoads | None,
) -> Array:
    """Forces [N] and moments [N m] (k, 3) of constraints on a shell in equilibrium at x (n, 3)."""
    if not patches:
        return np.empty((0, 3))
    held = shell.holding(np.concatenate([patch.vertices for patch in patches]))
    residual = held.energy_gradient(x)[1] - (load if live is None else load + live.force(x))
    of_patch = _by_vertices(patches)
    reactions = np.empty((len(constraints), 3))
    for reaction, constraint in zip(reactions, constraints, strict=True):
        vertices = of_patch[constraint.vertices.tobytes()].vertices
        forces, arms = residual[vertices], x[vertices] - x[constraint.vertices].mean(axis=0)
        reaction[:] = forces.sum(axis=0) if constraint.kind == "position" else np.cross(arms, forces).sum(axis=0)
    return reactions
