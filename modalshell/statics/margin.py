"""Stability margin: the share of stiffness that stresses leave, by Lanczos; and where a bar's step began."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.modes import Factor
from modalshell.modes.kept_factor import solution_by_kept_factor
from modalshell.shell import GAUSS_NEWTON, Shell
from modalshell.statics.warped import turned_axes

TOLERANCE = 0.05
"""Residual of the lowest ratio, over what the stresses take, at which it is found: its own error is of second order."""
FAINT = 0.1
"""What the stresses take from which on that tolerance is relative: less is far from any critical load."""
FEWEST, FEWEST_EARLY, STEPS = 6, 4, 40
"""Lanczos iterations: the fewest, the fewest of an early margin, and the most."""
SLACK = 2.0
"""Factor on that tolerance for early margins, which are right to a tenth of what the stresses take."""
FAR, UNSEEN = 0.5, 1e-3
"""Distance of a ratio from all found ones at which early iterations must not miss it, and share of the start from which
on its direction shows."""
LITTLE_STEP, CLEAR = 0.02, 0.5
"""Second step of a bar, over the displacement, up to which the margin where it began serves, and margin above which it
does."""
ENDED = 1e-10
"""Length of a Lanczos vector, over that of what was multiplied, below which the iterations have found all there is."""
_CLOSE = 1e-3
"""Residual of a step's equations at which iterations with the factor of another step have solved them."""


class Margin(NamedTuple):
    """The lowest ratio of two stiffnesses."""

    value: float
    """The least ``v . K v / v . K_1 v``: 1 without stress, 0 at a critical point, negative past it."""
    direction: Array
    """Where it is least; shape (N,)."""
    products: int
    """Products with the difference of the stiffnesses, and solves with the factor, that it took."""


def lowest_ratio(
    solve: Callable[[Array], Array], softening: Callable[[Array], Array], start: Array, *, early: bool = False
) -> Margin:
    """The least ``v . (K_1 + G) v / v . K_1 v``, by Lanczos iterations on ``K_1^-1 G`` in the inner product of K_1.

    Numerator and denominator are of one state, so that the ratio depends on neither rotations nor units. ``solve``
    gives ``K_1^-1 b`` for b (N,), K_1 positive definite, ``softening`` gives ``G v``, G symmetric, and ``start`` (N,)
    is the right side from which the iterations start. The ratio is found from above, to about a twentieth of what it
    lacks to 1.

    An ``early`` ratio is found to :data:`SLACK` times that, and fewer than :data:`FEWEST` iterations do where a
    direction of a ratio :data:`FAR` from all found ones would have shown, had it a share :data:`UNSEEN` in the start:
    after k iterations the polynomial that vanishes at the found ratios makes of the start a vector as long as the
    product of the k numbers off the diagonal, and multiplies that direction by ``FAR^k`` at least.
    """
    vector = solve(start)
    length = np.sqrt(max(float(vector @ start), 0.0)) or 1.0
    most = min(STEPS, start.size)
    vectors, images = np.empty((most, start.size)), np.empty((most, start.size))  # images are K_1 times vectors
    vectors[0], images[0] = vector / length, start / length
    tridiagonal, share, tolerance = np.zeros((most, most)), 1.0, TOLERANCE * (SLACK if early else 1.0)
    for step in range(most):
        count = step + 1
        image = softening(vectors[step])
        tridiagonal[step, step] = vectors[step] @ image
        following = solve(image)
        # Twice, as rounding would let found directions come back.
        for _ in range(2):
            shares = images[:count] @ following
            following = following - shares @ vectors[:count]
            image = image - shares @ images[:count]
        beside = np.sqrt(max(float(following @ image), 0.0))
        share *= beside / FAR
        values, shapes = np.linalg.eigh(tridiagonal[:count, :count])
        lowest, residual = float(values[0]), float(beside * abs(shapes[-1, 0]))
        ended = beside <= ENDED * max(float(np.abs(values).max()), 1e-300)
        enough = count >= FEWEST or (early and count >= FEWEST_EARLY and share <= UNSEEN)
        if ended or count == most or (enough and residual <= tolerance * max(abs(lowest), FAINT)):
            break
        tridiagonal[step, count] = tridiagonal[count, step] = beside
        vectors[count], images[count] = following / beside, image / beside
    return Margin(1.0 + lowest, shapes[:, 0] @ vectors[:count], count)


def probe(count: int) -> Array:
    """Forces (N,) on unknowns from which the iterations for the margin start: any, but always the same."""
    return np.random.default_rng(0).standard_normal(count)


class Begun(NamedTuple):
    """Positions (n, 3) [m] where a step began, its Hessian, and the factor that solved it.

    The factor is of this Hessian, or, where ``unstressed``, of that of the bar's first step. By it the bar's second
    step and the margin each do without a factorisation of their own.
    """

    x: Array
    hessian: sps.csc_array
    factor: Factor
    unstressed: bool = False

    def direction(self, shell: Shell, x: Array, hessian: sps.csc_array, gradient: Array) -> Array | None:
        """Newton direction (N,) at x (n, 3) by iterations with this step's factor; None where it does not serve."""
        axes = turned_axes(shell, self.x, x)
        return solution_by_kept_factor(self.factor, hessian, -gradient, _CLOSE, axes)

    def margin(self, shell: Shell, off: float, moved: float) -> float | None:
        """The margin where a step began of length ``off``, under dead loads; None where it is long, or not clear.

        ``moved`` is the displacement, a length alike. The lowest ratio r of G to ``K_1 + G`` makes it ``1 / (1 - r)``.
        The factor of the first step, where that served for both, is of ``K_1`` alone: to that it is ``1 + r``.
        """
        if not (off <= LITTLE_STEP * moved and self.factor.is_definite()):
            return None
        # Internal unknowns, the last ones, have no part in the difference.
        geometric = self.hessian - shell.pattern.free_matrix(shell.hessian(self.x, GAUSS_NEWTON))
        whole = np.zeros(geometric.shape[0])

        def softening(values: Array) -> Array:
            whole[: values.size] = values
            return np.asarray((geometric @ whole)[: values.size])

        ratio = lowest_ratio(self.factor.solve, softening, probe(shell.unknowns.count), early=self.unstressed).value
        margin = ratio if self.unstressed else 1.0 / (2.0 - ratio)
        return margin if margin > CLEAR else None
