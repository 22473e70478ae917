r"""Equilibria with Coulomb's friction: exact stick and slip [alart1991]; theory 13.

In a step of the load, from positions ``x_0`` on, a vertex that touches either sticks, its position along the surface
prescribed, or slips by s under the force :math:`-\mu\lambda\,s/|s|` along the surface. With the force T of the iterate
and a stiffness r of the vertex, :math:`T - r s` decides: it sticks where that is at most :math:`\mu\lambda`, else it
slips and T has its direction. Normal forces are those of the iterate before, so that the equations are symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.contact import kernels
from modalshell.contact.active_set import ActiveSet, Rest
from modalshell.contact.descent import EASY, FAILURES, FALL, RISE, first_drag
from modalshell.contact.rotated import Rotated
from modalshell.contact.statics import rest_on_contacts
from modalshell.contact.touching import EXACT_GAP, INSIDE, Touching
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index, Mask
from modalshell.modes.rigid import left_free
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED
from modalshell.statics import mixed_newton as method
from modalshell.statics.potential import Potential

LOAD_STEPS = 10
"""Steps of the load from the rest shape."""
SLIDES = "it slides: friction does not hold the shell"
_UNHELD = "no equilibrium was found before anything rubs: hold the shell, begin in touch, or simulate its damped motion"
_SUB_STEPS = 150
"""Steps in the thick fluid at most."""
MOST, _SLOW = 150, 30
"""Iterations of a step at most, and of one in the thick fluid."""
_PULL = 1e-9
"""Pull, as a share of all forces, that rounding explains."""
_HELD = 3e-7
"""Share of Coulomb's limit by which a vertex that sticks may exceed it: the accuracy of the forces."""
_FAR = 1e3
"""Move, as a share of the shell's size, that only a shell makes which nothing holds."""
_FALLS, _TOUCH = 200, 0.1 * EXACT_GAP
"""Steps of a fall at most, each as long as the least gap, and the gap, as a share of the shell's size, that ends it."""


@dataclass(frozen=True)
class _Sets:
    """Which rows (r,) touch, and which of these stick.

    Those that slip do so under forces ``drag`` (r, 3) [N] along the surface, which turn with their slips by ``stiff``
    (r,) [N/m] across themselves.
    """

    active: Mask
    sticks: Mask
    drag: Array
    stiff: Array

    def same(self, other: _Sets) -> bool:
        return bool((self.active == other.active).all() and (self.sticks == other.sticks).all())


class Rubbed(NamedTuple):
    """Where a solve ended."""

    rest: Rest
    """Positions, what touches, and the forces along the normals."""
    friction: Array
    """Forces [N] along the surfaces; shape (n, 3)."""
    message: str
    """Why there is no answer; "" where there is one."""
    sets: _Sets
    """What sticks and slips."""


def rest_with_friction(problem: Potential, touching: Touching, start: Array, steps: int) -> Rubbed:
    """Equilibrium from ``start`` (n, 3) [m] on a way on which the load grows in equal ``steps``.

    What touches at the beginning of a step rubs in it; what comes to touch within it does from the next one on, and in
    the last one while the shell goes there in a thick fluid. So does it where a step finds no end: the sets of a free
    shell may let go of all that sticks, though friction holds it. OptionError for a start inside a collider.
    """
    touching.refuse_inside(start)
    reached = initial_friction(touching, _fallen(problem, touching, start))
    iterations, loose = 0, bool(left_free(problem.shell))
    for count in range(1, steps + 1):
        loaded = problem.loaded(count / steps)
        step = FrictionStep(loaded, touching, reached.rest.point)
        found = step.solve(reached, MOST) if step.rubs else _unrubbed(loaded, touching, reached)
        iterations += found.rest.iterations
        # What touches first in the last step has no further one to rub in.
        first = count == steps and not step.rubs and step.would_rub(found.rest.active)
        if first or not arrived(touching, reached, found):
            slow = _slowly(loaded, touching, reached)
            iterations += slow.rest.iterations
            found = slow if arrived(touching, reached, slow) else slow._replace(message=found.message)
        if not arrived(touching, reached, found):
            why = "" if found.message == SLIDES and not loose else found.message
            message = f"{why or 'stick and slip did not settle'} at {count / steps:.3g} of the load"
            residual = min(reached.rest.residual, found.rest.residual)
            rest = replace(reached.rest, residual=residual, iterations=iterations, converged=False)
            return reached._replace(rest=rest, message=message)
        reached = found
    return reached._replace(rest=replace(reached.rest, iterations=iterations))


def _fallen(problem: Potential, touching: Touching, start: Array) -> Array:
    """Where a free shell at ``start`` (n, 3) [m] comes to touch as it moves along its load; else the start."""
    forces, shell = problem.force(start), problem.shell
    load, fall = forces.sum(axis=0), 0.0
    strength = float(np.linalg.norm(load))
    if shell.unknowns.count < start.size or shell.mesh.components.any():
        return start
    if strength <= _PULL * float(np.linalg.norm(forces, axis=1).sum()):
        return start  # a direction of rounding
    for _ in range(_FALLS):
        x = start + (fall / strength) * load
        gap = float(touching.distances(x).min(initial=np.inf))
        if gap <= _TOUCH * touching.size:
            # Gaps of first order may lead into what is steep, such as a cliff of a height field.
            return x if gap >= -_TOUCH * touching.size else start
        fall += gap  # no surface is nearer
        if fall > _FAR * touching.size:
            break
    return start


def arrived(touching: Touching, before: Rubbed, found: Rubbed) -> bool:
    """Whether a step found a minimum that does not lie behind a collider."""
    return bool(found.rest.stable) and not touching.crossed(before.rest.point, found.rest.point)


def _unrubbed(problem: Potential, touching: Touching, before: Rubbed) -> Rubbed:
    """Where a step ends at whose beginning nothing rubs: it may be that of a sheet without stiffness."""
    rest = rest_on_contacts(problem, touching, before.rest.point)
    sets = replace(before.sets, active=rest.active, sticks=np.zeros_like(rest.active))
    message = "" if rest.stable else _UNHELD
    return Rubbed(rest, np.zeros_like(before.friction), message, sets)


def _slowly(problem: Potential, touching: Touching, before: Rubbed) -> Rubbed:
    """Where the shell comes to in a thick fluid, in each step of which it rubs from where that begins.

    It has no end if it drifts off.
    """
    drag = first_drag(ActiveSet.at_rest(problem, touching, before.rest.point), before.rest.point)[1]
    reached, failures, iterations = before, 0, 0
    for _ in range(_SUB_STEPS):
        x = reached.rest.point
        found = FrictionStep(problem.dragged(x, drag), touching, x).solve(reached, _SLOW, method.LOOSE)
        iterations += found.rest.iterations
        if not arrived(touching, reached, found):
            drag, failures = drag * RISE, failures + 1
            if failures == FAILURES:
                break
            continue
        reached, failures = found, 0
        if float(np.abs(found.rest.point - before.rest.point).max()) > _FAR * touching.size:
            break
        if found.rest.iterations > EASY:
            continue
        drag *= FALL
        end = FrictionStep(problem, touching, found.rest.point)
        last = end.solve(found, _SLOW)
        iterations += last.rest.iterations
        if not end.rubs and end.would_rub(last.rest.active):
            continue  # first to where it touches
        if arrived(touching, found, last):
            return last._replace(rest=replace(last.rest, iterations=iterations))
    return reached._replace(rest=replace(reached.rest, iterations=iterations, stable=False))


@final
class FrictionStep:
    """One step of the load, from positions ``begin`` (n, 3) [m]."""

    def __init__(self, problem: Potential, touching: Touching, begin: Array) -> None:
        self._problem, self._touching, self._begin = problem, touching, begin
        self._solver = ActiveSet.at_rest(problem, touching, begin)
        self._friction = np.where(touching.distances(begin) <= INSIDE * touching.size, touching.friction, 0.0)
        self._axes = touching.at(touching.time)  # rows of the normals, and two of each along the surface
        self._axes.vertices = np.tile(touching.vertices, 3)

    @property
    def rubs(self) -> bool:
        """Whether anything with friction touches at its beginning."""
        return bool(self._friction.any())

    def would_rub(self, active: Mask) -> bool:
        """Whether any of the rows (r,) that touch at its end has friction."""
        return bool(self._touching.friction[active].any())

    def slipping(self, before: Rubbed, x: Array) -> Rubbed:
        """The step ``before`` with what slips on a way to x (n, 3) [m], by its forces and in the direction of that."""
        rows = np.flatnonzero(before.sets.active & (self._friction > 0.0))
        vertices, normals = self._touching.vertices[rows], self._touching.normals(self._begin, rows)
        slip = x[vertices] - self._begin[vertices]
        slip -= np.sum(slip * normals, axis=1, keepdims=True) * normals
        length = np.linalg.norm(slip, axis=1)
        far = length > EXACT_GAP * self._touching.size
        sticks, drag = before.sets.sticks.copy(), np.zeros_like(before.sets.drag)
        sticks[rows] = ~far
        limit = self._friction[rows] * before.rest.pushes[rows]
        drag[rows[far]] = -(limit[far] / length[far])[:, None] * slip[far]
        return before._replace(sets=replace(before.sets, sticks=sticks, drag=drag, stiff=np.zeros(sticks.size)))

    def solve(self, before: Rubbed, most: int, accepted: float = method.ACCEPTED, first: Array | None = None) -> Rubbed:
        """At most ``most`` Newton steps with sets of what sticks and slips, from those of the step ``before``.

        They begin where the step does, or at a ``first`` guess (n, 3) [m]. Where a residual larger than that of an
        answer is ``accepted``, the end has no verdict.
        """
        x, touching, message = (self._begin if first is None else first).copy(), self._touching, ""
        pushes, active, stresses = before.rest.pushes, self._solver.near(self._begin), None
        sticks = active & (self._friction > 0.0) & ~(before.sets.active & ~before.sets.sticks)
        sets = replace(before.sets, active=active, sticks=sticks)
        size, best, allowed, repeated, solved = np.inf, np.inf, 0.0, False, False
        for iteration in range(most + 1):
            gradient, hessian = self._problem.linearise(x, GAUSS_NEWTON if stresses is None else MIXED, stresses)
            gradient = gradient - self._on_unknowns(sets.drag)
            equations, normals, rows = self._equations(x, gradient, hessian, sets, pushes)
            size = float(np.linalg.norm(equations.unbalanced(gradient))) / self._solver.scale(pushes)
            solved = repeated and size <= max(accepted, allowed)
            least = accepted > method.ACCEPTED or size <= method.GOAL or size > 0.5 * best  # of rounding
            if (solved and least) or not np.isfinite(size) or iteration == most:
                break
            best = min(size, best) if solved else np.inf
            diagonal = hessian.diagonal()
            try:
                direction, found = equations.solve()
                far = float(np.abs(direction).max(initial=0.0)) > _FAR * touching.size
            except SolverError:
                far = True
            if far:
                message = SLIDES
                break
            x, share, allowed, stresses = self._solver.moved(x, hessian, direction, rows)
            last = sets
            sets, pushes = self._next(x, sets, (equations.frames.rows, found), normals, diagonal)
            allowed /= self._solver.scale(pushes)
            repeated = share > 0.999 and sets.same(last)
        limited = size > method.ACCEPTED
        rest = Rest(x, sets.active, np.where(sets.active, pushes, 0.0), size, iteration, solved, limited=limited)
        if accepted > method.ACCEPTED:
            return Rubbed(replace(rest, stable=solved), self._on_vertices(sets.drag), message, sets)
        return self._settled(rest, sets, message)

    def _on_unknowns(self, forces: Array) -> Array:
        """Forces (r, 3) [N] of rows on the free unknowns (N,)."""
        return np.asarray(self._problem.shell.unknowns.restrict(self._on_vertices(forces).ravel()))

    def _on_vertices(self, forces: Array) -> Array:
        whole = np.zeros_like(self._begin)
        np.add.at(whole, self._touching.vertices, forces)
        return whole

    def _equations(
        self, x: Array, gradient: Array, hessian: sps.csc_array, sets: _Sets, pushes: Array
    ) -> tuple[Rotated, Array, Index]:
        """Newton's equations, gaps prescribed and places of what sticks; normals (r, 3), and the rows that touch."""
        rows, held = np.flatnonzero(sets.active), np.flatnonzero(sets.sticks)
        gap, normal, curvature = self._touching.gaps(x, rows)
        slides = np.flatnonzero(sets.stiff)
        if slides.size:
            t = sets.drag[slides] / np.linalg.norm(sets.drag[slides], axis=1, keepdims=True)
            n = self._touching.normals(x, slides)
            blocks = np.eye(3) - n[:, :, None] * n[:, None, :] - t[:, :, None] * t[:, None, :]
            own = self._touching.across(slides, sets.stiff[slides, None, None] * blocks)
            starts, sizes = self._touching.starts(slides)
            kernels.add_blocks(hessian.indptr, hessian.indices, hessian.data, starts, sizes, own)
        normals = np.zeros((sets.active.size, 3))
        normals[rows] = normal
        along = _along(normals[held])
        slip = x[self._touching.vertices[held]] - self._begin[self._touching.vertices[held]]
        count = sets.active.size
        ids = np.concatenate([rows, held + count, held + 2 * count])
        directions = np.concatenate([normal, along[0], along[1]])
        off = np.concatenate([gap, *(np.sum(slip * axis, axis=1) for axis in along)])
        bent = np.concatenate([curvature, np.zeros((2 * held.size, 3, 3))])
        forces = np.concatenate([pushes[rows], np.zeros(2 * held.size)])
        equations = Rotated(self._problem, self._axes, gradient, hessian, ids, forces, (off, directions, bent))
        return equations, normals, rows

    def _next(
        self, x: Array, sets: _Sets, found: tuple[Index, Array], normals: Array, diagonal: Array
    ) -> tuple[_Sets, Array]:
        """The next sets and forces (r,) along the normals, by those ``found`` of Newton's step to x (n, 3)."""
        count, touching = sets.active.size, self._touching
        of_axes = np.zeros(3 * count)
        of_axes[found[0]] = found[1]
        pushes, first, second = of_axes.reshape(3, count)
        active = sets.active & (pushes > -_PULL * self._solver.scale(pushes))
        entered = self._solver.entered(x, sets.active)
        pushes = np.where(active, np.maximum(pushes, 0.0), 0.0)
        held, slides = np.flatnonzero(sets.sticks), np.flatnonzero(sets.active & ~sets.sticks)
        along, trial = _along(normals[held]), sets.drag.copy()
        trial[held] = first[held, None] * along[0] + second[held, None] * along[1]
        slip = x[touching.vertices[slides]] - self._begin[touching.vertices[slides]]
        slip -= np.sum(slip * normals[slides], axis=1, keepdims=True) * normals[slides]
        starts, sizes = touching.starts(slides)
        slots = starts[:, None] + np.minimum(np.arange(3), sizes[:, None] - 1)
        stiffness = np.zeros(count)
        stiffness[slides] = diagonal[slots].mean(axis=1)
        trial[slides] -= stiffness[slides, None] * slip
        length, limit = np.linalg.norm(trial, axis=1), self._friction * pushes
        sticks = active & (self._friction > 0.0) & (length <= limit * (1.0 + _HELD))
        share = np.where(active & ~sticks, limit / np.maximum(length, 1e-300), 0.0)
        return _Sets(active | entered, sticks, share[:, None] * trial, share * stiffness), pushes

    def _settled(self, rest: Rest, sets: _Sets, message: str) -> Rubbed:
        """The end with its verdict, and the forces that balance the shell exactly where it is."""
        if not rest.converged:
            return Rubbed(rest, self._on_vertices(sets.drag), message, sets)
        gradient, hessian = self._problem.linearise(rest.point, EXACT)
        gradient = gradient - self._on_unknowns(sets.drag)
        equations, normals, _ = self._equations(rest.point, gradient, hessian, sets, rest.pushes)
        stable = equations.definite_factor() is not None
        of_axes = np.zeros(3 * sets.active.size)
        of_axes[equations.frames.rows] = equations.frames.pushes(gradient)
        pushes, *sideways = of_axes.reshape(3, -1)
        held, drag = np.flatnonzero(sets.sticks), sets.drag.copy()
        for force, axis in zip(sideways, _along(normals[held]), strict=True):
            drag[held] += force[held, None] * axis
        rest = replace(rest, pushes=np.maximum(pushes, 0.0), stable=stable)
        message = "" if stable else SLIDES
        return Rubbed(rest, self._on_vertices(drag), message, sets)


def initial_friction(touching: Touching, start: Array) -> Rubbed:
    """Friction before the first step: nothing touches or slips."""
    none = np.zeros(touching.vertices.size)
    rest = Rest(start, none > 0.0, none, np.inf, 0, False)
    return Rubbed(rest, np.zeros_like(start), "", _Sets(rest.active, rest.active, np.zeros((none.size, 3)), none))


def _along(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (k, 3) across each of some normals (k, 3)."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
