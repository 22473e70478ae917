r"""Coulomb's friction in steps of implicit Euler, smoothed, with the contact forces of the step before, or of the step.

The work of friction in a step is taken as the potential :math:`D = \sum_v \mu \lambda_v f(|s_v|)` of the slips s, with
:math:`f' = 2 y - y^2` at :math:`y = |s| / s_0 < 1` and one beyond [li2020]. It is convex and never negative, so that a
step still lowers the energy. Below the threshold a body creeps, at ``s_0 / h (1 - sqrt(1 - tan(slope) / mu))``;
``s_0`` falls with the square of short steps ``h``, so that creep goes with them (theory 13).
"""

from __future__ import annotations

from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.contact import kernels
from modalshell.contact.touching import Touching
from modalshell.core.typing import Array

SLIP = 2e-4
"""Slip in a step, as a share of the shell's size, up to which friction has not reached its full size, at most."""

_LEAST = 1e-3
"""Share of that slip below which it does not fall: what it is would be lost in the error of a step's solution."""

_STEADY = 0.25
"""Change of a contact force in a step, over the largest, up to which friction takes that of the step before."""

TANGENT, SECANT, STUCK = range(3)
"""Ways to take friction as linear; see :meth:`Friction.linear`."""


def creep_note(size: float, dt: float) -> str:
    """What a motion of a shell of a size [m] in steps of ``dt`` [s] says of friction."""
    return (
        f"friction is smoothed: what sticks creeps at {SLIP * size / dt:.2g} m/s (1 - sqrt(1 - r)), r being the share "
        "of Coulomb's limit that it needs, and no faster than that limit by itself would make it in a step"
    )


def slip_limit(size: float, strengths: Array, masses: Array, dt: float, whole: float) -> float:
    """Slip [m] in a step up to which friction has not reached its full size, on a shell of a ``size`` [m].

    At most that to which this size would take what it acts on, from rest: were it longer, friction would vanish as
    steps become short. Parts of a step have their share of it, and creep at the speed of the whole.

    ``strengths`` are the largest forces [N] of friction, and ``masses`` [kg] those of the vertices that they act on.
    The step of implicit Euler takes ``dt`` [s], one that is not divided ``whole``.
    """
    most, force, mass = SLIP * size, float(strengths.sum()), float(masses.sum())
    if force * whole**2 < most * mass:
        most = max(force * whole**2 / mass, _LEAST * most)
    return most * dt / whole


def better_forces(pushes: Array, lagged: Array, *, settled: bool) -> Array | None:
    """Contact forces (r,) [N] by which friction is to act in a step, in place of ``lagged`` ones; None if these serve.

    What touches for the first time has no force of the step before. Where forces change much, as in a strike, those of
    the step itself are taken, once: what strikes would be rubbed twice, by the force of its step and after it.
    ``pushes`` (r,) [N] are the forces of the step by the ``lagged`` ones; ``settled`` says that these have been
    replaced in the step already.
    """
    largest = max(pushes.max(initial=0.0), lagged.max(initial=0.0))
    if not settled and (np.abs(pushes - lagged) > _STEADY * largest).any():
        return pushes
    new = (pushes > 0.0) & (lagged <= 0.0)
    return np.where(new, pushes, lagged) if new.any() else None


@final
class Friction:
    """Friction of one step of ``dt`` [s], by contact forces ``pushes`` (r,) [N]; it acts on ``vertices`` (k,).

    Contacts and positions x (n, 3) [m] are those at the beginning; ``whole`` [s] is a step that is not divided.
    """

    def __init__(self, touching: Touching, pushes: Array, x: Array, dt: float, whole: float) -> None:
        strength = touching.friction * pushes
        self._rows = np.flatnonzero(strength > 0.0)
        self._strength = strength[self._rows]
        self._touching, self.vertices = touching, touching.vertices[self._rows]
        self._limit = slip_limit(touching.size, self._strength, touching.shell.mass[self.vertices], dt, whole)
        normals = touching.normals(x, self._rows)
        self._across = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        self._begin = x[self.vertices] + touching.ways(x, self._rows, dt)
        self._starts, self._sizes = touching.starts(self._rows)

    def held_back(self, x: Array, masses: Array) -> Array:
        """A guess x (n, 3) of the step's end, without slips beyond the limit that friction can stop in the step.

        ``masses`` (n,) are the vertices' [kg] over the square of the step [s^2]. From there Newton's method reaches
        what sticks from one side; from a slip beyond the limit it would pass it, to and fro.
        """
        slip, share, _ = self._slips(x)
        stops = (share > 1.0) & (share * self._limit * masses[self.vertices] <= self._strength)
        if not stops.any():
            return x
        x = x.copy()
        x[self.vertices[stops]] -= slip[stops]
        return x

    def _slips(self, x: Array) -> tuple[Array, Array, Array]:
        """Slips (k, 3) [m], their lengths over the limit (k,), and f' (k,)."""
        slip = np.einsum("kij,kj->ki", self._across, x[self.vertices] - self._begin)
        share = np.linalg.norm(slip, axis=1) / self._limit
        return slip, share, np.where(share < 1.0, 2.0 * share - share**2, 1.0)

    def value(self, x: Array) -> float:
        """D [J] at x (n, 3)."""
        _, share, _ = self._slips(x)
        inner = share**2 - share**3 / 3.0
        return float(self._strength @ np.where(share < 1.0, inner, share - 1.0 / 3.0)) * self._limit

    def forces(self, x: Array) -> Array:
        """Gradient (n, 3) [N] of D at x."""
        gradient = np.zeros_like(x)
        np.add.at(gradient, self.vertices, self._gradient(*self._slips(x)))
        return gradient

    def _gradient(self, slip: Array, share: Array, slope: Array) -> Array:
        """Gradient (k, 3) [N] of D by the positions of its vertices."""
        per_slip = self._strength * np.where(share > 0.0, slope / np.maximum(share, 1e-300), 2.0) / self._limit
        return np.asarray(per_slip[:, None] * slip)

    def linear(self, x: Array, rule: int = TANGENT) -> tuple[Array, Array]:
        """Gradient (k, 3) [N] of D at x (n, 3) by the positions of its vertices, and stiffness (k, 3, 3) [N/m].

        That is the derivative of the gradient, or of the quadratic function that is nowhere below D and touches it at
        x, or the gradient and stiffness that all would have if they slipped within the limit.
        """
        slip, share, slope = self._slips(x)
        if rule == STUCK:
            share, slope = np.zeros_like(share), np.zeros_like(slope)
        length = np.maximum(share, 1e-300) * self._limit
        across = self._strength * np.where(share > 0.0, slope / length, 2.0 / self._limit)
        along = self._strength * np.where(share < 1.0, 2.0 - 2.0 * share, 0.0) / self._limit
        unit = slip / length[:, None]
        blocks = across[:, None, None] * self._across
        if rule == TANGENT:
            turn = unit[:, :, None] * unit[:, None, :] * (share > 0.0)[:, None, None]
            blocks += (along - across)[:, None, None] * turn
        return self._gradient(slip, share, slope), blocks

    def add(self, x: Array, gradient: Array, hessian: sps.csc_array) -> Array:
        """The gradient (N,) with that of D at x (n, 3); its second derivatives are added to the Hessian, in place."""
        touching = self._touching
        own = touching.across(self._rows, self.linear(x)[1])
        kernels.add_blocks(hessian.indptr, hessian.indices, hessian.data, self._starts, self._sizes, own)
        return np.asarray(gradient + touching.shell.unknowns.restrict(self.forces(x).ravel()))
