"""Lee's frame as an elastica: two inextensible beams that meet at a right angle, hinged at both far ends.

A load pushes down on the horizontal beam at a fifth of its length from the corner. Internal force and moment are
integrated along the frame from its foot (``theta' = m``, ``m' = F x t``), so that an equilibrium is a root of three
equations in the foot's angle and force; the load is followed by arc length. Lengths in those of a beam, L, loads in
``EI / L^2``.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

LOADED_AT = 0.2
"""Distance of the load from the corner [L]."""
_STEPS = 30
"""Steps of integration over each of the three pieces."""


def ends_of(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moment and misplacement (3, k) at the far hinge, and displacements (2, k) of the loaded point.

    ``unknowns`` (4, k) are the angle and the force (2) at the foot, and the load, of k frames at once.
    """
    angle, load = unknowns[0], unknowns[3]
    pull = unknowns[1:3].copy()
    state = np.zeros((4, angle.size))  # angle, moment, x, z
    state[0] = angle
    loaded = np.zeros((2, angle.size))

    def rate(y: np.ndarray) -> np.ndarray:
        along, up = np.cos(y[0]), np.sin(y[0])
        return np.array([y[1], pull[0] * up - pull[1] * along, along, up])

    for length, turn, push in ((1.0, -0.5 * np.pi, 0.0), (LOADED_AT, 0.0, 1.0), (1.0 - LOADED_AT, 0.0, 0.0)):
        h = length / _STEPS
        for _ in range(_STEPS):  # Runge and Kutta's fourth order
            one = rate(state)
            two = rate(state + 0.5 * h * one)
            three = rate(state + 0.5 * h * two)
            state = state + h / 6.0 * (one + 2.0 * (two + three) + rate(state + h * three))
        if push:
            loaded = state[2:] - [[LOADED_AT], [1.0]]
        state[0] += turn
        pull[1] += push * load
    return state[1:] - [[0.0], [1.0], [1.0]], loaded


def frame_path(until: float = 0.75, step: float = 0.1, most: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Loads (k,) and drops (k,) [L] of the loaded point along the frame's path, until a drop of ``until``."""

    def jacobian(point: np.ndarray) -> np.ndarray:
        steps = 1e-5 * np.eye(4)
        both = ends_of(point[:, None] + np.hstack([steps, -steps]))[0]
        return np.asarray((both[:, :4] - both[:, 4:]) / 2e-5)

    point = np.array([0.5 * np.pi, 0.0, 0.0, 0.0])
    tangent = np.array([0.0, 0.0, 0.0, 1.0])
    loads, drops = [0.0], [0.0]
    weights = np.array([1.0, 0.1, 0.1, 0.1])  # forces are some tens
    while len(loads) < most and drops[-1] < until:
        direction = np.linalg.svd(jacobian(point))[2][-1]
        direction *= np.sign((weights * direction) @ (weights * tangent)) / np.linalg.norm(weights * direction)
        guess = point + step * direction
        new = guess.copy()
        for _ in range(20):
            residual = np.append(ends_of(new[:, None])[0][:, 0], (weights**2 * direction) @ (new - guess))
            change = np.linalg.solve(np.vstack([jacobian(new), weights**2 * direction]), residual)
            new = new - change
            if np.abs(change).max() < 1e-8:
                break
        else:
            raise RuntimeError("the elastica's path was lost")
        point, tangent = new, direction
        loads.append(float(point[3]))
        drops.append(float(-ends_of(point[:, None])[1][1, 0]))
    return np.array(loads), np.array(drops)


def limit_loads(loads: np.ndarray) -> list[float]:
    """Loads at the extremes of a path whose points are evenly spaced, by a cubic spline."""
    spline = CubicSpline(np.arange(loads.size), loads)
    return [float(spline(place)) for place in spline.derivative().roots(extrapolate=False)]
