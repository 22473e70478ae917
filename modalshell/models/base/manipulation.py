"""Constraints in modal coordinates, met with the least modal work [choi2007, section 4.4]."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array, Index
from modalshell.supports import Pose
from modalshell.supports.constraints import Constraint, nearest_branch

Evaluate = Callable[[Array], tuple[Array, Array]]
"""Residual (k,), target less value, and Jacobian (k, m) of the constrained values at q."""

MET = 1e-8
"""Residual, lengths as shares of the shell's size and angles in radians, at which constraints count as met."""
_SOFTEST, _HARDER, _HARDEST = 1e-3, 0.01, 1e-14
"""First softness eps of the constraints, the factor from one to the next, and the last."""
REACHED = 1e-7
"""Derivative of constrained values, over the largest one, below which it is rounding: the root of the last softness."""
_PASSES = 12
"""Gauss-Newton steps at one softness at most."""
_LEAST_GAIN, _SETTLED = 1e-12, 1e-4
"""Gain as a share of what is minimised, and change of coordinates as a share of theirs, at which steps end."""
_CONTRACTION = 0.5
"""Share of the change before to which the next one falls, where linearised constraints settle."""
_HARDLY_REACHED = 1e-8
"""Response of a combination of constraints, as a share of the largest one, below which modes hardly reach its target:
it is met from soft to hard, or if below the last softness not at all."""
STAGE, _STAGE_SOFTNESS = 0.15, 1e-5
"""Largest residual met in one stage, and the softness of the constraints until the last stage."""
_MOST_STAGES = 200
"""Enough for 30 times the shell's size; modes do not reach farther targets."""
_HARDLY_LESS = 0.7
"""Share of the residual that a harder constraint must beat, or the target counts as out of reach."""


def out_of_reach(missed: float) -> str:
    """Message of constraints that modes do not meet, by ``missed`` [m or rad] at most."""
    return f"a constraint is left {missed:.2e} from its target: take more modes, or ds, which stretches"


@final
class PatchTargets:
    """Targets of constraints at one time as equations in modal coordinates; called, they :data:`Evaluate`.

    Targets are taken at ``time`` [s], into the frame of supports in a ``pose``, and rotations to the branch nearest to
    the ``present`` coordinates (m,). For "position" and "orientation" ``values`` give the mean (3,) of a patch at q,
    and its Jacobian (3, m). ``units`` (k,) are ``size`` [m] of positions, and 1 rad.
    """

    def __init__(
        self,
        constraints: Sequence[Constraint],
        time: float,
        pose: Pose | None,
        values: Mapping[str, Callable[[Array, Index], tuple[Array, Array]]],
        size: float,
        present: Array,
    ) -> None:
        self._parts = []
        for constraint in constraints:
            goal, value = constraint.at(time), values[constraint.kind]
            if constraint.kind == "position":
                goal = goal if pose is None else pose.to_shell(goal)
            else:
                if pose is not None:
                    goal = (Rotation.from_matrix(pose.rotation).inv() * Rotation.from_rotvec(goal)).as_rotvec()
                goal = nearest_branch(goal, value(present, constraint.vertices)[0])
            self._parts.append((constraint, goal, value))
        self.units = np.array([size if constraint.kind == "position" else 1.0 for constraint in constraints])

    def __call__(self, q: Array) -> tuple[Array, Array]:
        """Residuals (3 k,) in their units, and Jacobian (3 k, m)."""
        residuals, jacobians = [], []
        for (constraint, goal, value), unit in zip(self._parts, self.units, strict=True):
            mean, jacobian = value(q, constraint.vertices)
            residuals.append((goal - mean) / unit)
            jacobians.append(jacobian / unit)
        return np.concatenate(residuals), np.vstack(jacobians)

    def local_means(self, local: Array) -> Array:
        """Parts (3 k,), in their units, of the values that displacements (n, 3) [m] beyond the modes have."""
        means = [local[one.vertices].mean(axis=0) * (one.kind == "position") for one, _, _ in self._parts]
        return (np.array(means) / self.units[:, None]).ravel()

    def reactions(self, jacobian: Array, unbalanced: Array) -> Array:
        """Forces [N] and moments [N m] (k, 3) of the constraints that bear an ``unbalanced`` modal force (m,)."""
        multipliers = np.linalg.lstsq(jacobian.T, unbalanced, rcond=REACHED)[0].reshape(-1, 3)
        return np.asarray(multipliers / self.units[:, None])

    def spread(self, reactions: Array, count: int) -> Array:
        """Forces (n, 3) [N] of reactions (k, 3) on the ``count`` vertices of a shell; moments have none."""
        forces = np.zeros((count, 3))
        for (constraint, _, _), reaction in zip(self._parts, reactions, strict=True):
            if constraint.kind == "position":
                forces[constraint.vertices] += reaction / constraint.vertices.size
        return forces

    def lengths(self, residuals: Array) -> Array:
        """Length of each constraint's residual (k,): [m] for positions, [rad] for orientations."""
        return np.asarray(np.linalg.norm(residuals.reshape(-1, 3), axis=1) * self.units)


@np.errstate(over="ignore", invalid="ignore")  # absurd loads are beyond it
def meet(evaluate: Evaluate, free: Array, compliance: Array, start: Array) -> tuple[Array, Array, Array]:
    """Least ``(q - q_free)^T G^-1 (q - q_free) / 2`` among the q that meet the constraints.

    Solves ``q = q_free + G J^T mu`` with ``r = eps mu``. Targets that the modes reach well are met at the last, least
    eps by a few linearised constraints, ``(J G J^T + eps I) mu = r + J (q - q_free)``. Others are met for eps from soft
    to hard, where each pass is a Gauss-Newton step with a line search; a harder constraint that brings its target no
    nearer is not followed: the stiff modes would be shaken for nothing.

    ``evaluate`` gives the residual, target less value, and the Jacobian of the values at q; ``free`` (m,) are the
    coordinates without the constraints, and ``compliance`` (m,) is the diagonal of G, their response to modal forces,
    by the time step or in statics; ``start`` (m,) is on the branch to be kept. Returns q (m,), and there the residual
    (k,) and the Jacobian (k, m).
    """
    root = np.sqrt(compliance)
    z: Array = (start - free) / root
    residual, jacobian = evaluate(start)
    unit = float(np.sum((jacobian * root) ** 2)) / len(residual) or 1.0
    # Far targets are led there in stages: a single leap would land on another branch.
    first, stages = residual, int(min(np.ceil(np.abs(residual).max() / STAGE), _MOST_STAGES))
    for stage in range(1, stages):
        left = first * (1.0 - stage / stages)

        def on_the_way(q: Array, left: Array = left) -> tuple[Array, Array]:
            residual, jacobian = evaluate(q)
            return residual - left, jacobian

        begin = z, residual - left, jacobian
        done = _reached(on_the_way, free, root, *begin)
        z, residual, jacobian = done or _minimise(on_the_way, free, root, *begin, _STAGE_SOFTNESS * unit)
        residual = residual + left
    best = _reached(evaluate, free, root, z, residual, jacobian)
    if best is not None:
        return free + root * best[0], *best[1:]
    best = z, residual, jacobian
    softness = _SOFTEST
    stalls = 0
    while softness >= _HARDEST:
        z, residual, jacobian = _minimise(evaluate, free, root, z, residual, jacobian, softness * unit)
        size, before = float(np.abs(residual).max()), float(np.abs(best[1]).max())
        # The first answer is taken as it is: leading may have ended nearer, by more work.
        if softness == _SOFTEST or size <= _HARDLY_LESS * before:
            best, stalls = (z, residual, jacobian), 0
        else:
            stalls += 1
        if size <= MET or stalls == 2:
            break
        softness *= _HARDER
    return free + root * best[0], *best[1:]


def _reached(
    evaluate: Evaluate, free: Array, root: Array, z: Array, residual: Array, jacobian: Array
) -> tuple[Array, Array, Array] | None:
    """The least z that meets targets, by linearised constraints from z; None of targets that modes hardly reach."""
    before = np.inf
    for _ in range(_PASSES):
        scaled = jacobian * root
        try:
            values, ways = np.linalg.eigh(scaled @ scaled.T)
        except np.linalg.LinAlgError:  # not finite, under absurd loads
            return None
        kept = values > _HARDEST * values[-1]
        values, ways = values[kept], ways[:, kept]
        if not kept.any() or values[0] <= _HARDLY_REACHED * values[-1]:
            return None
        move = ((residual + scaled @ z) @ ways / values) @ ways.T @ scaled - z
        z = z + move
        length = float(np.linalg.norm(move))
        if length > _CONTRACTION * before:
            return None
        before = length
        residual, jacobian = evaluate(free + root * z)
        if length <= _SETTLED * float(np.linalg.norm(z)):
            return (z, residual, jacobian) if np.abs(residual).max() <= MET else None
    return None


def _minimise(
    evaluate: Evaluate, free: Array, root: Array, z: Array, residual: Array, jacobian: Array, epsilon: float
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on ``|z|^2 + |r|^2 / epsilon`` from z, where residual and Jacobian are known."""

    def merit(z: Array, residual: Array) -> float:
        return float(z @ z + residual @ residual / epsilon)

    value = merit(z, residual)
    for _ in range(_PASSES):
        scaled = jacobian * root
        try:
            mu = np.linalg.solve(scaled @ scaled.T + epsilon * np.eye(len(residual)), residual + scaled @ z)
        except np.linalg.LinAlgError:  # targets that no softness tells apart, under absurd loads
            break
        move = scaled.T @ mu - z
        if value - merit(z + move, residual - scaled @ move) <= _LEAST_GAIN * value:
            break
        length = 1.0
        while length > 1e-4:
            trial = z + length * move
            found, slope = evaluate(free + root * trial)
            lower = merit(trial, found)
            if lower < value:
                break
            length *= 0.5
        else:
            break
        gain, value = value - lower, lower
        z, residual, jacobian = trial, found, slope
        if gain <= _LEAST_GAIN * value or np.abs(residual).max() <= 0.1 * MET:
            break
    return z, residual, jacobian
