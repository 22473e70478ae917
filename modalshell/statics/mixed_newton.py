"""Mixed Newton, descent in a thick fluid and the way off a saddle, for sparse, profile and dense algebra alike.

A nearly inextensible sheet defeats plain Newton: a step along the tangent stretches the membrane by its square, so a
line search lets only tiny steps through. The mixed step [magisano2017] treats the element stresses as unknowns of
their own: after elimination the equations are Newton's, but the geometric part of the Hessian takes each stress from
the last linearised step instead of the (huge) stress of the over-stretched iterate. Full steps then converge in a few
iterations whatever the membrane stiffness (theory 8, eq. 1 and 2).

The methods are written once, over nine operations of a problem that holds its iterate ``x``, changed in place, and two
``slots`` of its shape. Python calls them with an object that has these operations as methods. Compiled code calls them
with a record, a ``NamedTuple`` of arrays, whose operations are registered by :func:`operation_of`; they are compiled
with their caller.

All residuals are relative to the problem's scale of forces.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload, register_jitable

from modalshell.core.typing import Array
from modalshell.kernels.by_reference import record_of
from modalshell.kernels.compiler import COUNTED, UNCOUNTED
from modalshell.kernels.linked import LINKED

GOAL = 1e-10
"""Residual that is aimed at: near what double precision leaves."""
ACCEPTED = 1e-7
"""Residual at which an answer counts as converged."""
STALLED = 7
"""Iterations without halving the residual after which mixed Newton gives up."""
LINEAR = 0.3
"""Residual of linear equations that a kept factor solves, at most: over the gradient, and over the goal."""
FIRST = 5e-3
"""The same where no iteration before tells how fast Newton's method converges; its first step gains less."""
LARGEST_TURN = 1.0
"""Of a vertex in one step [rad]: a warped step is exact for a turn of its own, and neighbours differ by less."""
STRAIGHT_TURN = 0.4
"""Turn [rad] of a vertex along the straight way of an implicit step up to which Newton's method begins at its end, else
where the step begins: a straight way stretches what turns, by half the square of the turn."""
MOST: int = np.int64(40)  # type: ignore[assignment]  # compiled code takes a plain integer for a constant
CONTINUED: int = np.int64(25)  # type: ignore[assignment]
SHORT: int = np.int64(12)  # type: ignore[assignment]
"""Iterations at most; within a continuation and a descent, where a failure only costs a smaller step, fewer."""
DESCENT = 150
"""Steps of a descent at most."""
EASY = 5
"""Iterations in a step of a descent up to which the drag falls."""
LOOSE = 1e-3
"""Residual of the steps of a descent: the next step lowers the rest."""
NEAR = 0.3
"""Residual from which a descent tries to end by Newton's method."""
FIRST_MOVE = 0.05
"""Move of a free shell under the out-of-balance force, in its sizes, that the first drag of a descent allows."""
HIGHER = 1e-9
"""Rise of the potential, as a share of it, that rounding explains."""
SADDLES = 4
"""Saddles that a descent leaves."""
HALVINGS = 20
"""Halvings of the state's size where the search along the way off a saddle begins."""
ALL_CHECKED: int = np.int64(0)  # type: ignore[assignment]
"""No iteration goes without a residual."""
START: int = np.int64(0)  # type: ignore[assignment]
BEST: int = np.int64(1)  # type: ignore[assignment]
"""Slots of a problem: where a solve, or a step of a descent, begins; and the best iterate so far."""

_plain = LINKED | {"error_model": "numpy"} | UNCOUNTED
_jitable = register_jitable(**_plain)


class Rules(NamedTuple):
    """When mixed Newton ends."""

    goal: float
    """Residual that is aimed at."""
    accepted: float
    """Residual at which an iterate counts as solved once the residual no longer halves."""
    untouched: float
    """Residual at which the start itself counts as solved: a step must be taken, or a small load on a fast shell would
    never act."""
    unchecked: int
    """First iterations that do not ask for the residual, where a solution assembles its own equations."""
    most: int
    """Iterations at most."""


class Solved(NamedTuple):
    """How a solve ended: the residual, the iterations, whether it is solved, and the number of saddles left."""

    residual: float
    iterations: int
    solved: bool
    saddles: int


# ---- operations


def residual(problem: Any) -> float:
    """Out-of-balance force at the iterate."""
    return float(problem.residual())


def solve(problem: Any, accuracy: float) -> bool:
    """Find Newton's direction at the iterate, the linear equations to ``accuracy``; whether there is one."""
    return bool(problem.solve(accuracy))


def advance(problem: Any) -> float:
    """Move the iterate along the direction and predict its stresses; the residual there that rounding explains."""
    return float(problem.advance())


def is_minimum(problem: Any) -> bool:
    """Whether the Hessian is positive definite: at the iterate, or in compiled code and steps as last factorised."""
    return bool(problem.is_minimum())


def potential(problem: Any) -> tuple[float, float]:
    """Potential and residual at the iterate."""
    value, size = problem.potential()
    return float(value), float(size)


def drag(problem: Any, factor: float) -> None:
    """Add ``factor |x - START|^2 / 2`` in the norm of the mass, in place of an earlier one; stresses of the iterate."""
    problem.drag(factor)


def first_drag(problem: Any, size: float) -> float:
    """Drag under which a residual of ``size`` moves the mass by about :data:`FIRST_MOVE` of the shell's size."""
    return float(problem.first_drag(size))


def point_downhill(problem: Any) -> float:
    """Find the way in which the potential curves down most, as long as the state is large; its curvature."""
    return float(problem.point_downhill())


def step_aside(problem: Any, fraction: float) -> None:
    """Move the iterate from START along that way, by a fraction of it."""
    problem.step_aside(fraction)


def operation_of(record: type, operation: Callable[..., Any], **options: Any) -> Callable[[Any], Any]:
    """Decorator: ``operation`` for a problem of this record, in compiled code, is the function, by numba's options."""

    def register(function: Any) -> Any:
        def choose(problem: Any, *_: Any) -> Any:
            return function if record_of(problem) is record else None

        overload(operation, jit_options=LINKED | COUNTED | options, strict=False)(choose)  # type: ignore[arg-type]
        return function

    return register


# ---- methods


def write(values: Array, out: Array) -> None:
    """Write ``values`` (n, 3) or (n,) to the first ones of ``out``."""
    out[: len(values)] = values


@overload(write, jit_options=_plain, strict=False)  # type: ignore[arg-type]
def _compiled_write(values: Any, out: Any) -> Any:  # noqa: ARG001
    """The same by loops: a slice brings the message for shapes that differ, half of what is compiled for a step."""

    def flat(values, out):  # type: ignore[no-untyped-def]
        for k in range(values.size):
            out[k] = values[k]

    def rows(values, out):  # type: ignore[no-untyped-def]
        for v in range(values.shape[0]):
            for axis in range(3):
                out[v, axis] = values[v, axis]

    return flat if values.ndim == 1 else rows


@_jitable
def iterate(problem: Any, rules: Rules) -> Solved:
    """Full mixed Newton steps from the iterate with its stresses; gives up when the residual stops falling.

    The problem's best iterate is its iterate at the end.
    """
    x, slots = problem.x, problem.slots
    best, found_at, stalled, allowed, last, solved = np.inf, -1, 0, 0.0, np.inf, False
    accuracy = LINEAR
    for iteration in range(rules.most + 1):
        if iteration >= rules.unchecked:
            size = residual(problem)
            if not np.isfinite(size):
                break
            stalled = 0 if size <= 0.5 * best else stalled + 1
            # The start is no answer, though balanced more nearly than the goal, or than rounding lets any other be.
            if size < best or (found_at == 0 and size <= max(allowed, rules.goal)):
                best, found_at = size, iteration
                solved = size <= (rules.accepted if iteration > 0 else rules.untouched)
            solved = solved or (found_at > 0 and best <= allowed)
            ended = solved and (size <= rules.goal or stalled > 0)
            if ended or iteration == rules.most or stalled == STALLED:
                break
            if found_at == iteration:
                write(x, slots[BEST])
            # As Newton's method converges by squares, so may the linear equations [dembo1982].
            wanted = min(LINEAR, min(1.0, size / last) ** 2) if last < np.inf else FIRST
            accuracy = max(LINEAR * rules.goal / size, wanted)
            last = size
        if not solve(problem, accuracy):
            break
        allowed = advance(problem)
    if 0 <= found_at < iteration:
        write(slots[BEST], x)
    return Solved(best, iteration, solved, 0)


@_jitable
def descend(problem: Any, rules: Rules) -> Solved:
    """Go downhill from the iterate to a minimum, as the shell would move in a thick fluid; saddles are left.

    Steps of implicit Euler on ``drag M dx/dt = -grad V`` (theory 8, eq. 4), each solved by mixed Newton, whose number
    of iterations does not feel the membrane. The drag falls with success, down to plain Newton steps, and grows where a
    step fails. It ends by Newton's method, or at a minimum within the goal from which that leads nowhere.
    """
    x, slots = problem.x, problem.slots
    loose = Rules(LOOSE, LOOSE, GOAL, ALL_CHECKED, SHORT)
    value, size = potential(problem)
    factor, iterations, saddles, left = first_drag(problem, size), 0, 0, -np.inf
    for _ in range(DESCENT):
        write(x, slots[START])
        drag(problem, factor)
        step = iterate(problem, loose)
        iterations += step.iterations
        drag(problem, 0.0)
        reached, out_of_balance = potential(problem) if step.solved else (np.inf, np.inf)
        if not reached <= value:
            write(slots[START], x)
            factor *= 4.0
            if not np.isfinite(factor):
                break
            continue
        value, size = reached, out_of_balance
        if step.iterations <= EASY:
            factor *= 0.5
        if size > NEAR or (size > LOOSE and not is_minimum(problem)):
            continue
        write(x, slots[START])
        last = iterate(problem, Rules(rules.goal, rules.accepted, rules.untouched, ALL_CHECKED, SHORT))
        iterations += last.iterations
        reached = potential(problem)[0] if last.solved else np.inf
        ended = reached <= value + HIGHER * abs(value)
        minimum = ended and is_minimum(problem)
        if not minimum and left > value and reached > 0.5 * (left + value):  # up again to the saddle that was left
            ended = False
        if not ended:
            write(slots[START], x)
            if size <= rules.goal:  # in a flat valley
                drag(problem, 0.0)
                if is_minimum(problem):
                    return Solved(size, iterations, True, saddles)
            continue
        if minimum or saddles == SADDLES:
            return Solved(last.residual, iterations, minimum, saddles)
        saddles, left = saddles + 1, reached
        value, factor = leave_saddle(problem, reached)
    return Solved(size, iterations, False, saddles)


@_jitable
def leave_saddle(problem: Any, value: float) -> tuple[float, float]:
    """Move the iterate off a saddle; the potential there, and a drag that steadies the way down.

    Both ways are tried. Steps double for as long as the potential falls, or stays to rounding as it does at first
    next to a shallow valley: the first valley is looked for, not the deepest one.
    """
    x, slots = problem.x, problem.slots
    write(x, slots[START])
    write(x, slots[BEST])
    curvature = point_downhill(problem)
    for sign in (1.0, -1.0):
        last = np.inf
        for halvings in range(HALVINGS, 0, -1):
            step_aside(problem, sign * 0.5**halvings)
            reached = potential(problem)[0]
            if not reached <= last + HIGHER * abs(last):
                break
            last = reached
            if reached < value:
                value = reached
                write(x, slots[BEST])
    write(slots[BEST], x)
    return value, 2.0 * abs(curvature)


@_jitable
def solve_step(problem: Any, rules: Rules) -> Solved:
    """One implicit step: mixed Newton, and descent from START where it fails or ends at no minimum.

    The last Hessian on the way stands for the one at the end: with inertia in it the two agree well enough, and a
    factorisation is saved.
    """
    found = iterate(problem, rules)
    if found.solved and is_minimum(problem):
        return found
    write(problem.slots[START], problem.x)
    further = descend(problem, rules)
    return Solved(further.residual, found.iterations + further.iterations, further.solved, further.saddles)
